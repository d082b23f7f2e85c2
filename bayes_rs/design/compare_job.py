"""The comparison of scans as a job: a folder with table, figure and JSON, and lines that say what it found."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_rs._version import __version__
from bayes_rs.design.compare_options import CompareOptions
from bayes_rs.design.comparing import ENOUGH, compare, enough_beams
from bayes_rs.design.scan_grid import DESIGN
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.options import from_plain, to_plain
from bayes_rs.output import check_output_folder, output_folder, write_csv, write_run

_MOST_LINES = 24  # of a table that is printed
_DESIGN_IN_WORDS = {
    "n_beam": "beams",
    "opening_angle_deg": "opening angle",
    "focus_distance": "focus distance",
    "tilt_deg": "tilt",
    "yaw_deg": "yaw",
    "duration": "record length",
}


def run_compare(
    scans: Sequence[str], output: str | Path, *, options: Mapping[str, Any] | None = None, overwrite: bool = False
) -> tuple[pd.DataFrame, list[str]]:
    """Compare scans and write what comes of it.

    Parameters
    ----------
    scans : sequence of str
        As for `compare`: names or files.
    output : str or Path
        Folder to write: ``comparison.csv``, ``comparison.json``, ``comparison.png`` and ``run.json``.
    options : mapping, optional
        Fields of `CompareOptions`; turbulences and priors by name or file.
    overwrite : bool
        Replace the folder of an earlier run.

    Returns
    -------
    table : DataFrame
        From `compare`.
    words : list of str
        Lines to print.

    Raises
    ------
    InputError
        If the folder exists, or a scan or an option is not valid.
    """
    from bayes_rs.design.comparison_plot import comparison  # noqa: PLC0415 - matplotlib is slow to load

    check_output_folder(output, overwrite=overwrite)
    chosen = from_plain(CompareOptions, options or {}, where="the options of compare")
    scene = {"scans": list(scans), **to_plain(chosen)}
    table = compare(list(scans), **(options or {}))
    with output_folder(output, overwrite=overwrite) as folder:
        write_csv(table, folder / "comparison.csv", index=False)
        rows = json.loads(table.to_json(orient="records"))
        (folder / "comparison.json").write_text(
            json.dumps({"bayes_rs": __version__, "scene": scene, "rows": rows}, indent=1, ensure_ascii=False) + "\n",
            encoding="utf-8",
            newline="\n",
        )
        comparison(table).savefig(folder / "comparison.png", dpi=130)
        write_run(folder, {"bayes_rs": __version__, "command": "compare", **scene})
    return table, comparison_words(table)


def comparison_words(table: pd.DataFrame) -> list[str]:
    """Say how wide the intervals are, which scan is best for each stress, and what more beams or time would buy.

    Parameters
    ----------
    table : DataFrame
        From `compare`.

    Returns
    -------
    lines : list of str
        For each turbulence, prior and kind of records a table with a column for each stress.
    """
    lines: list[str] = []
    rows = table[table["estimator"] == "posterior"]
    for (flow, prior, data), some in rows.groupby(["turbulence", "prior", "data"], sort=False):
        entries = [*_width_rows(some), *_best_rows(some), *_beam_rows(some), *_centre_rows(some), *_duration_rows(some)]
        size = max(len(label) for label, _ in entries) + 1
        lines += ["", f"expected 90 % width over uu; turbulence {flow}, prior {prior}, {data} records"]
        lines.append(" " * size + "".join(f"{name:>9}" for name in STRESSES))
        lines += [f"{label:<{size}}" + "".join(f"{cell:>9}" for cell in cells) for label, cells in entries]
        if not _is_of_one_name(some):
            lines.append(_best_line(some))
        lines += _decided_lines(some)
        if _beam_rows(some):
            lines.append(f"enough: from there on, all widths are within {100.0 * ENOUGH:g} % of that of the most beams")
    return lines[1:]


_Rows = list[tuple[str, list[str]]]


def _width_rows(some: pd.DataFrame) -> _Rows:
    """Return the width of every scan, if there are not too many to read."""
    cells = some.groupby(["scan", "duration"], sort=False)
    if len(cells) > _MOST_LINES:
        return []
    several = some["duration"].nunique() > 1
    rows = []
    for (scan, duration), cell in cells:
        width = cell.set_index("stress")["width_ratio"]
        label = f"{scan}, {duration:g} s" if several else f"{scan}"
        rows.append((label, [f"{width[name]:.2f}" for name in STRESSES]))
    return rows


def _decided_lines(some: pd.DataFrame) -> list[str]:
    """Say what the data decide of each stress with every scan, if there are not too many to read."""
    cells = list(some.groupby(["scan", "duration"], sort=False))
    if len(cells) > _MOST_LINES:
        return []
    several = some["duration"].nunique() > 1
    labels = [f"{scan}, {duration:g} s" if several else f"{scan}" for (scan, duration), _ in cells]
    size = max(len(label) for label in labels) + 1
    lines = ["decided by the data (1) or by the prior (0), and how many stresses are learnt, of 6"]
    lines.append(" " * size + "".join(f"{name:>9}" for name in (*STRESSES, "learnt")))
    for label, (_, cell) in zip(labels, cells, strict=True):
        of_stress = cell.set_index("stress")
        values = [*of_stress["decided"][list(STRESSES)], of_stress["stresses_learnt"].iloc[0]]
        lines.append(f"{label:<{size}}" + "".join(f"{value + 0.0:>9.2f}" for value in values))
    return lines


def _best_rows(some: pd.DataFrame) -> _Rows:
    """Return the narrowest width of each stress, and what its scan is in all that varies over scans of one name."""
    best = [some[some["stress"] == name].nsmallest(1, "width_ratio").iloc[0] for name in STRESSES]
    rows = [("narrowest", [f"{row['width_ratio']:.2f}" for row in best])]
    varied = [name for name in _DESIGN_IN_WORDS if some[name].nunique() > 1]
    if _is_of_one_name(some):
        rows += [(f"  {_DESIGN_IN_WORDS[name]}", [f"{row[name]:g}" for row in best]) for name in varied]
    return rows


def _is_of_one_name(some: pd.DataFrame) -> bool:
    """Say whether all scans are one that is changed; what differs between others is more than the table's columns."""
    return some["scan"].str.partition("@")[0].nunique() == 1


def _best_line(some: pd.DataFrame) -> str:
    """Name the scan that is best for each stress."""
    best = [some[some["stress"] == name].nsmallest(1, "width_ratio").iloc[0] for name in STRESSES]
    return "narrowest: " + "; ".join(f"{row['stress']} {row['scan']}" for row in best)


def _beam_rows(some: pd.DataFrame) -> _Rows:
    """Return how many beams are enough, for each kind of scans that differ in their number of beams only."""
    alike = [name for name in DESIGN if name != "n_beam"]
    if not _is_of_one_name(some) or not (some.groupby([*alike, "stress"])["n_beam"].nunique() > 1).any():
        return []
    found = enough_beams(some)
    told = [name for name in alike if found[name].nunique() > 1]
    rows = []
    for case, part in found.groupby(alike, sort=False):
        where = ", ".join(_in_words(name, value) for name, value in zip(alike, case, strict=True) if name in told)
        numbers = part.set_index("stress")["enough"]
        rows.append((f"enough beams{f', {where}' if where else ''}", [str(numbers[name]) for name in STRESSES]))
    return rows


def _centre_rows(some: pd.DataFrame) -> _Rows:
    """Return what a beam along the axis changes: medians over scans that differ in it only."""
    some = some.assign(bias_ratio=some["bias"] * some["width_ratio"] / some["width_90"])
    alike = [name for name in DESIGN if name != "centre"]
    wide = some.pivot_table(index=[*alike, "stress"], columns="centre", values=["width_ratio", "bias_ratio"]).dropna()
    if some["centre"].nunique() < 2 or wide.empty:
        return []
    change = 100.0 * (wide["width_ratio"][True] / wide["width_ratio"][False] - 1.0).groupby("stress").median()
    rows = [("a centre beam: width", [f"{change[name]:+.1f} %" for name in STRESSES])]
    for kind, words in ((True, "  bias over uu with it"), (False, "  bias over uu without")):
        bias = wide["bias_ratio"][kind].groupby("stress").median()
        rows.append((words, [f"{bias[name]:+.3f}" for name in STRESSES]))
    return rows


def _duration_rows(some: pd.DataFrame) -> _Rows:
    """Return what longer records buy: the median change of a width from the shortest to the longest."""
    if some["duration"].nunique() < 2:
        return []
    wide = some.pivot_table(index=["scan", "stress"], columns="duration", values="width_ratio")
    short, long = wide.columns[0], wide.columns[-1]
    change = 100.0 * (wide[long] / wide[short] - 1.0).groupby("stress").median()
    return [(f"{short:g} to {long:g} s: width", [f"{change[name]:+.0f} %" for name in STRESSES])]


def _in_words(name: str, value: Any) -> str:
    if name == "centre":
        return "with a centre beam" if value else "without a centre beam"
    return f"{_DESIGN_IN_WORDS[name]} {value:g}"
