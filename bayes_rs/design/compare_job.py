"""The comparison of scans as a job: a folder with table, figure and JSON, and lines that say what it found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bayes_rs._version import __version__
from bayes_rs.design.comparing import compare
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.output import check_output_folder, output_folder, write_csv, write_run
from bayes_rs.turbulence.mann import load_turbulence


def run_compare(
    scans: Sequence[str],
    output: str | Path,
    *,
    turbulence: Sequence[str] = ("fu-2022",),
    prior: Sequence[str] = ("weak",),
    wind_speed: float = 10.0,
    duration: float = 600.0,
    target: str = "record",
    method: str = "fast",
    n_records: int | None = None,
    seed: int = 1,
    overwrite: bool = False,
) -> tuple[pd.DataFrame, list[str]]:
    """Compare scans and write what comes of it.

    Parameters
    ----------
    scans, wind_speed, duration, prior, target, method, n_records, seed
        As in `compare`.
    output : str or Path
        Folder to write: ``comparison.csv``, ``comparison.json``, ``comparison.png`` and ``run.json``.
    turbulence : sequence of str
        Names or files of turbulences.
    overwrite : bool
        Replace the folder of an earlier run.

    Returns
    -------
    table : DataFrame
        From `compare`.
    words : list of str
        Lines to print.
    """
    from bayes_rs.design.comparison_plot import plot_comparison  # noqa: PLC0415 - matplotlib is slow to load

    check_output_folder(output, overwrite=overwrite, inputs=[*scans, *turbulence])
    table = compare(
        list(scans),
        [load_turbulence(name) for name in turbulence],
        wind_speed=wind_speed,
        duration=duration,
        prior=list(prior),
        target=target,
        method=method,
        n_records=n_records,
        seed=seed,
    )
    scene = {
        "scans": list(scans),
        "turbulence": list(turbulence),
        "prior": list(prior),
        "wind_speed": wind_speed,
        "duration": duration,
        "target": target,
        "method": method,
        "seed": seed,
    }
    with output_folder(output, overwrite=overwrite) as folder:
        write_csv(table, folder / "comparison.csv", index=False)
        rows = json.loads(table.to_json(orient="records"))
        (folder / "comparison.json").write_text(
            json.dumps({"bayes_rs": __version__, "scene": scene, "rows": rows}, indent=1, ensure_ascii=False) + "\n",
            encoding="utf-8",
        )
        plot_comparison(table).savefig(folder / "comparison.png", dpi=130)
        write_run(folder, {"bayes_rs": __version__, "command": "compare", **scene})
    return table, comparison_words(table)


def comparison_words(table: pd.DataFrame) -> list[str]:
    """Say in a small table how wide the intervals are, and name the best scan for each stress."""
    rows = table[table["estimator"] == "posterior"]
    lines = []
    for (flow, prior, data), some in rows.groupby(["turbulence", "prior", "data"], sort=False):
        wide = some.pivot_table(index="scan", columns="stress", values="width_ratio", sort=False)[list(STRESSES)]
        size = max(len(name) for name in wide.index)
        lines += ["", f"expected 90 % width over uu; turbulence {flow}, prior {prior}, {data} records"]
        lines.append(" " * size + "".join(f"{name:>8}" for name in STRESSES))
        lines += [f"{name:<{size}}" + "".join(f"{value:8.2f}" for value in row) for name, row in wide.iterrows()]
        lines.append(f"{'narrowest':<{size}}" + "; ".join(f" {name}: {wide[name].idxmin()}" for name in STRESSES))
    return lines[1:]
