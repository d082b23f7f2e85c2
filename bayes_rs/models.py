"""Where the shipped models are: presets of scans and turbulence, calibrated noise."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from bayes_rs.errors import InputError, did_you_mean, in_short, plain_name
from bayes_rs.toml_file import read_toml

_PACKAGE = Path(__file__).resolve().parent
_KINDS = {"scans": ("scan", "6-beam"), "turbulence": ("turbulence", "fu-2022")}
"""What the presets of a kind are, one by one, and the name of one."""


def models_folder(kind: str) -> Path:
    """Return the folder of shipped models of one kind, in an installed wheel or in a checkout.

    Parameters
    ----------
    kind : str
        ``"scans"``, ``"turbulence"`` or ``"noise"``.

    Returns
    -------
    folder : Path
        The folder.

    Raises
    ------
    InputError
        If neither place holds it, which means a damaged installation.
    """
    for folder in (_PACKAGE / "models" / kind, _PACKAGE.parent / "models" / kind):
        if folder.is_dir():
            return folder
    raise InputError(f"The shipped models of kind {kind!r} are missing beside {_PACKAGE}: install bayes_rs again.")


def preset_names(kind: str) -> tuple[str, ...]:
    """Return the names of the shipped TOML presets of one kind, sorted."""
    return tuple(sorted(path.stem for path in models_folder(kind).glob("*.toml")))


def check_is_name(name: object, kind: str) -> None:
    """Refuse what is neither a text nor a path where a model is named, such as records in place of their scan.

    Parameters
    ----------
    name : object
        What was given.
    kind : str
        ``"scans"`` or ``"turbulence"``.

    Raises
    ------
    InputError
        If it is something else.
    """
    if not isinstance(name, (str, Path)):
        what, example = _KINDS[kind]
        value = in_short(name) if isinstance(name, (bool, int, float, type(None))) else f"of type {type(name).__name__}"
        raise InputError(f"Invalid {what} {value}: it must be a {what}, its name, as {example!r}, or its TOML file.")


def find_model(name: str | Path, kind: str) -> Path:
    """Return the TOML file that `name` means: a path to a file, or the name of a shipped preset.

    Parameters
    ----------
    name : str or Path
        Path of a TOML file (anything that ends in ``.toml``), or a preset's name or alias; case, hyphens, underscores,
        points and spaces of a name do not count.
    kind : str
        ``"scans"`` or ``"turbulence"``.

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    InputError
        If there is no such file or preset, or it is no name.
    """
    check_is_name(name, kind)
    if str(name).endswith(".toml"):
        path = Path(name)
        if not os.path.isfile(path):  # noqa: PTH113 - of a name that no file can have, Path.is_file raises
            raise InputError(
                f"No file {in_short(str(path))}: give the path of a TOML file, or one of the names in models/{kind}."
            )
        return path
    names, others = preset_names(kind), preset_aliases(kind)
    meant = next((own for other, own in others.items() if plain_name(other) == plain_name(str(name))), None)
    if meant is None:
        close = did_you_mean(str(name), others)
        listed = f"use one of {', '.join(names)}, or the path of a .toml file"
        raise InputError(f"No preset {in_short(str(name))} in models/{kind}: {listed}{f'; {close}' if close else '.'}")
    return models_folder(kind) / f"{meant}.toml"


@lru_cache(maxsize=4)
def preset_aliases(kind: str) -> dict[str, str]:
    """Return the shipped presets of one kind by all names that they go by.

    Parameters
    ----------
    kind : str
        ``"scans"`` or ``"turbulence"``.

    Returns
    -------
    names : dict of str to str
        The name of the preset by its own name and by each alias in its file.
    """
    names = preset_names(kind)
    own = {name: read_toml(models_folder(kind) / f"{name}.toml").get("aliases", []) for name in names}
    return {name: name for name in names} | {alias: name for name, others in own.items() for alias in others}


def demo_file(name: str) -> Path:
    """Return the file of embedded radial velocities that the demo and the examples use.

    Parameters
    ----------
    name : str
        ``"6-beam-45"`` (the 6-beam scan at 45° and 52 m), ``"6-beam"`` or ``"50-beam"``.

    Returns
    -------
    path : Path
        A Parquet file: one simulated hour at 10 m/s, the same air for all three lidars.

    Raises
    ------
    InputError
        If there is no such file.

    Examples
    --------
    >>> demo_file("6-beam").name
    '6-beam.parquet'
    """
    files = {file.stem: file for file in models_folder("demo").glob("*.parquet")}
    if not isinstance(name, str) or name not in files:
        close = did_you_mean(name, files)
        raise InputError(
            f"No embedded data {in_short(name)}: use one of {', '.join(sorted(files))}{f'; {close}' if close else '.'}"
        )
    return files[name]


class _Presets:
    """The names of the shipped presets of one kind, looked up when they are asked for."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __iter__(self) -> Iterator[str]:
        return iter(preset_names(self.kind))


SCANS = _Presets("scans")
"""Names of the shipped scans."""
TURBULENCES = _Presets("turbulence")
"""Names of the shipped turbulences."""
