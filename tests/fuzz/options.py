"""Fuzz of the command line: every command with one to three of its own options, and values that no one means."""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from fuzz.frame import Case, command
from fuzz.hostile import WORDS, scene

_LEFT_OUT = {"scheduler", "output", "help", "overwrite", "resume"}
"""Options that the frame itself gives, or that wait for a network."""
_LONG_LINE = 1500


def cases(seed: int, n: int) -> Iterator[Case]:
    """Return `n` commands with hostile options."""
    from bayes_rs.cli.group import COMMANDS, commands  # noqa: PLC0415 - as in the frame

    rng = random.Random(seed)  # noqa: S311 - no secret
    bases = _bases(scene().place)
    context = click.Context(commands)
    for number in range(n):
        name = rng.choice([name for name in COMMANDS if name in bases and (name != "demo" or rng.random() < 0.1)])
        made = commands.get_command(context, name)
        assert made is not None
        known = [one for one in made.params if isinstance(one, click.Option) and one.name not in _LEFT_OUT]
        words: list[str] = []
        for parameter in rng.sample(known, min(rng.randint(1, 3), len(known))):
            words += _given(parameter, rng)
        base, options = bases[name]
        if rng.random() < 0.1 and base:
            base = [*base[:-1], rng.choice(WORDS).lstrip("-") or "x"]
        yield Case(f"options {seed}:{number} {name} {words}", command(name, *base, *options, *words), _check)


def _bases(place: Path) -> dict[str, tuple[list[str], list[str]]]:
    """Return arguments and options with which each command runs in a moment."""
    series, records = str(place / "series.csv"), str(place / "records.nc")
    of_file = ["--scan", "2-beam", "--duration", "60"]
    quick = ["--noise", str(place / "noise.nc"), "--ess", "50", "--no-campaign"]
    return {
        "demo": ([], ["-o", "out"]),
        "plan": (["2-beam"], []),
        "records": ([series], [*of_file, "-o", "out.nc"]),
        "calibrate": (["2-beam"], ["--wind-speed", "10", "--duration", "60", "-o", "out.nc"]),
        "fit": ([records], ["--scan", "2-beam", *quick, "-o", "out"]),
        "sensitivity": ([records], ["--scan", "2-beam", *quick[:4], "-o", "out.csv"]),
        "scans": (["6-beam"], ["-o", "out.png"]),
        "look": ([series], ["-o", "out.png"]),
        "find-scan": ([str(place / "rays.nc")], ["--distance", "100", "-o", "out.toml"]),
        "corner": ([str(place / "fit")], ["-o", "out.png"]),
        "report": ([str(place / "fit")], ["-o", "out.html"]),
        "boxes": ([str(place / "fit")], ["--boxes", "1", "--points", "16", "4", "4", "-o", "out"]),
        "spectra": ([series], [*of_file, "-o", "out"]),
        "wind": ([series], [*of_file, "-o", "out.csv"]),
        "compare": (["staring"], ["--records", "4", "-o", "out"]),
        "optimize": ([], ["--beams", "6", "--max-angle", "30", "--starts", "1", "--criterion", "trace", "-o", "out"]),
    }


def _given(parameter: click.Option, rng: random.Random) -> list[str]:
    """Return an option with hostile values, or now and then with one that it has in its list."""
    flag = rng.choice([*parameter.opts, *parameter.secondary_opts])
    if parameter.is_flag:
        return [flag]
    choices = getattr(parameter.type, "choices", ())
    listed: list[Any] = list(choices() if callable(choices) else choices)
    values = []
    for _ in range(parameter.nargs):
        value = str(rng.choice(listed)) if listed and rng.random() < 0.3 else rng.choice(WORDS)
        if parameter.name == "workers" and value in ("3", "12"):
            value = "2"  # more than that is legal, and loads the package as often
        if value == "boxes":
            value = "theory"  # an extra, and minutes
        values.append(value)
    if parameter.nargs == 1 and flag.startswith("--"):
        return [f"{flag}={values[0]}"]
    return [flag, *values]


def _check(code: int | None, text: str) -> str:
    """Say what is wrong with how a command has ended: refused is 2, with a last line that is one of ours."""
    if code not in (0, 1, 2):
        return f"exit code {code}"
    lines = text.strip().splitlines()
    if code == 2 and not any(line.startswith("bayes-rs: ") for line in lines):
        return "refused without a word"
    longest = max((len(line) for line in lines if line.startswith("bayes-rs: ")), default=0)
    return f"a line of {longest} characters" if longest > _LONG_LINE else ""
