"""The trade-off as a job: a folder with tables and a figure, and lines that say what it found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from bayes_rs._version import __version__
from bayes_rs.design.trading import ENOUGH, trade_off
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.output import check_output_folder, output_folder, write_csv, write_run
from bayes_rs.priors.registry import make_prior
from bayes_rs.turbulence.mann import load_turbulence

ANGLES = (10.0, 15.0, 20.0, 25.0, 30.0, 37.5, 45.0)
DISTANCES = (30.0, 49.0, 98.0, 150.0, 200.0, 300.0)
NUMBERS = (3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 30, 50)
DURATIONS = (300.0, 600.0, 1200.0, 1800.0, 3600.0)


def run_trade_off(
    output: str | Path,
    *,
    n_beams: int = 6,
    centre: bool = True,
    opening_angle_deg: Sequence[float] = ANGLES,
    focus_distance: Sequence[float] = DISTANCES,
    duration: float = 600.0,
    at: tuple[float, float] = (15.0, 98.0),
    numbers: Sequence[int] = NUMBERS,
    durations: Sequence[float] = DURATIONS,
    turbulence: str = "fu-2022",
    prior: str = "weak",
    wind_speed: float = 10.0,
    scan_duration: float = 1.0,
    probe_of: str | None = None,
    n_records: int = 32,
    seed: int = 1,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
) -> dict[str, pd.DataFrame]:
    """Tabulate and draw the trade-off, and write what comes of it.

    Parameters
    ----------
    output : str or Path
        Folder to make: ``grid.csv``, ``beams.csv``, ``durations.csv``, ``trade-off.png`` and ``run.json``.
    n_beams : int
        Number of beams of the grid and of the durations, a centre beam included.
    centre : bool
        Whether one of them points along the axis. The grid holds the cone without it, too, if so.
    opening_angle_deg, focus_distance : sequence of float
        The grid; at least two of each, degrees and m.
    duration : float
        Record length of the grid and of the numbers of beams, s.
    at : tuple of float
        Opening angle (degrees) and focus distance (m) at which numbers of beams and durations vary.
    numbers : sequence of int
        Numbers of beams, each with and without a centre beam; at least two.
    durations : sequence of float
        Record lengths, s; at least two.
    turbulence, prior, wind_speed, scan_duration, n_records, seed
        As in `trade_off`; names.
    probe_of : str, optional
        A scan whose probe volume the beams have.
    overwrite : bool
        Replace the folder of an earlier run.
    say : callable
        Takes the lines of the summary.

    Returns
    -------
    tables : dict of DataFrame
        ``grid``, ``beams`` and ``durations``, from `trade_off`.

    Raises
    ------
    InputError
        If the folder exists, or an option is not valid.
    """
    from bayes_rs.design.trading_plot import plot_trade_off  # noqa: PLC0415 - matplotlib is slow to load

    check_output_folder(output, overwrite=overwrite, inputs=[turbulence, *([] if probe_of is None else [probe_of])])
    for what, values in (
        ("opening angles", opening_angle_deg),
        ("focus distances", focus_distance),
        ("numbers of beams", numbers),
        ("durations", durations),
    ):
        if len(values) < 2:
            raise InputError(f"Invalid {what} {list(values)}: the figure needs at least two of them.")
    flow, before = load_turbulence(turbulence), make_prior(prior)
    probe = None if probe_of is None else load_scan(probe_of).probe

    def table(
        n: int | Sequence[int],
        kinds: bool | Sequence[bool],
        angles: float | Sequence[float],
        distances: float | Sequence[float],
        lengths: float | Sequence[float],
    ) -> pd.DataFrame:
        return trade_off(
            n_beams=n,
            centre=kinds,
            opening_angle_deg=angles,
            focus_distance=distances,
            duration=lengths,
            turbulence=flow,
            wind_speed=wind_speed,
            prior=before,
            scan_duration=scan_duration,
            probe=probe,
            n_records=n_records,
            seed=seed,
        )

    # the short tables first: what is wrong with an option shows early
    lengths = table(n_beams, centre, at[0], at[1], durations)
    beams = table(numbers, (True, False), at[0], at[1], duration)
    grid = table(n_beams, (True, False) if centre else False, opening_angle_deg, focus_distance, duration)
    with output_folder(output, overwrite=overwrite) as folder:
        for name, part in (("grid", grid), ("beams", beams), ("durations", lengths)):
            write_csv(part, folder / f"{name}.csv", index=False)
        plot_trade_off(grid, beams=beams, durations=lengths).savefig(folder / "trade-off.png", dpi=130)
        write_run(
            folder,
            {
                "bayes_rs": __version__,
                "command": "trade-off",
                "n_beams": n_beams,
                "centre": centre,
                "opening_angle_deg": list(opening_angle_deg),
                "focus_distance": list(focus_distance),
                "duration": duration,
                "at": list(at),
                "numbers": list(numbers),
                "durations": list(durations),
                "turbulence": turbulence,
                "prior": prior,
                "wind_speed": wind_speed,
                "scan_duration": scan_duration,
                "probe_of": probe_of,
                "n_records": n_records,
                "seed": seed,
                "enough_beams": beams.attrs["enough_beams"],
            },
        )
    for line in trade_off_words(grid, beams, lengths):
        say(line)
    return {"grid": grid, "beams": beams, "durations": lengths}


def trade_off_words(grid: pd.DataFrame, beams: pd.DataFrame, durations: pd.DataFrame) -> list[str]:
    """Say where the grid is narrowest, how many beams are enough, and what a centre beam and a longer record buy.

    Parameters
    ----------
    grid, beams, durations : DataFrame
        From `trade_off`, as in `plot_trade_off`.

    Returns
    -------
    lines : list of str
        A table with a column for each stress, and what its rows mean.
    """
    names = [name for name in STRESSES if name in set(grid["stress"])]
    both = grid["centre"].nunique() == 2
    shown = grid[grid["centre"]] if both else grid
    rows: list[tuple[str, list[str]]] = [("", names)]
    best = [shown[shown["stress"] == name].nsmallest(1, "ratio_90").iloc[0] for name in names]
    rows += [
        ("narrowest", [f"{row['ratio_90']:.2f}" for row in best]),
        ("  at opening angle", [f"{row['opening_angle_deg']:g}°" for row in best]),
        ("  at focus distance", [f"{row['focus_distance']:g} m" for row in best]),
    ]
    enough = pd.DataFrame(beams.attrs["enough_beams"])
    most = int(enough["most"].max())
    for kind, words in ((True, "with a centre beam"), (False, "without")):
        found = enough[enough["centre"] == kind].set_index("stress")["enough"]
        if len(found):
            rows.append((f"enough beams, {words}", [str(found[name]) for name in names]))
    numbers = sorted(set(beams["n_beams"]))
    number = min(numbers, key=lambda other: abs(other - int(shown["n_beams"].iloc[0])))
    some = beams[beams["n_beams"] == number]
    wide = some.pivot_table(index="stress", columns="centre", values=["ratio_90", "bias_ratio"])
    if some["centre"].nunique() == 2:
        change = 100.0 * (wide["ratio_90"][True] / wide["ratio_90"][False] - 1.0)
        rows.append((f"a centre beam, of {number}: width", [f"{change[name]:+.1f} %" for name in names]))
        for kind, words in ((True, "  bias over uu with it"), (False, "  bias over uu without")):
            rows.append((words, [f"{wide['bias_ratio'][kind][name]:+.3f}" for name in names]))
    ends = durations.pivot_table(index="stress", columns="duration", values="ratio_90")
    short, long = ends.columns[0], ends.columns[-1]
    change = 100.0 * (ends[long] / ends[short] - 1.0)
    rows.append((f"{short:g} to {long:g} s", [f"{change[name]:+.0f} %" for name in names]))
    size = max(len(label) for label, _ in rows) + 1
    one, where = shown.iloc[0], beams.iloc[0]
    which = "with" if one["centre"] else "without"
    head = (
        f"expected 90 % width over uu; {one['n_beams']} beams {which} a centre beam, records of {one['duration']:g} s"
    )
    foot = (
        f"the rows from 'enough' on are for {where['opening_angle_deg']:g}° and {where['focus_distance']:g} m; enough: "
        f"from there on, all widths are within {100.0 * ENOUGH:g} % of that of {most} beams of the same kind"
    )
    return [head, *(f"{label:<{size}}" + "".join(f"{cell:>9}" for cell in cells) for label, cells in rows), foot]
