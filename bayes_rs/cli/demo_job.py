"""The demo: the main job on embedded data, and why a single opening angle is not enough."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.cli.fit_commands import draw_pictures
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fitting import fit
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.models import demo_file, models_folder
from bayes_rs.output import output_folder, write_run
from bayes_rs.readers.reading import read
from bayes_rs.records.making import make_records

WIND_SPEED = 10.0
"""Mean wind speed of the embedded hour, m/s."""

SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "6-beam-45": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 52.0}),
    "6-beam": ("6-beam", {}),
    "50-beam": ("50-beam", {}),
}
"""Scans of the demo: name of the embedded file, preset, and how it differs from the preset."""

TITLES = {
    "6-beam-45": "six beams: five at 45°, one along the axis",
    "6-beam": "six beams: five at 15°, one along the axis",
    "50-beam": "fifty beams, all at 15°",
}
NOISE_FILES = {"6-beam-45": "6-beam-45deg-52m.nc", "6-beam": "6-beam.nc", "50-beam": "50-beam.nc"}
"""Shipped noise, calibrated on boxes like those that the embedded hour was drawn from."""

_RECORD = 2
"""The record that is drawn."""
_SHOWN = ("uu", "vv", "ww", "uw")
"""Stresses of the picture of two lidars: of six the words would be too small beside each other."""


def run_demo(output: str | Path, *, seed: int = 1, overwrite: bool = False) -> Iterator[str]:
    """Fit the embedded hour of three lidars in the same wind, and write files and pictures.

    Parameters
    ----------
    output : str or Path
        Folder to make: a folder of results for each lidar, ``corner-side-by-side.png`` and ``widths.csv``.
    seed : int
        Seed.
    overwrite : bool
        Replace the folder of an earlier demo.

    Yields
    ------
    line : str
        What was done, and the table of widths.

    Raises
    ------
    InputError
        If the folder may not be written.
    """
    truth = json.loads((models_folder("demo") / "truth.json").read_text(encoding="utf-8"))
    stresses = np.array(truth["stresses_record"])
    with output_folder(output, overwrite=overwrite) as folder:
        fits = {}
        for name, (preset, options) in SCENES.items():
            scan = load_scan(preset, **options)
            records = make_records(read(demo_file(name), scan), scan)
            noise = models_folder("noise") / NOISE_FILES[name]
            fits[name] = fit(records, scan, seed=seed, noise=noise, output=folder / name)
            draw_pictures(fits[name], folder / name)
            yield f"{TITLES[name]}: {fits[name].n_fitted} of {fits[name].n_record} records fitted"
        _side_by_side(fits, stresses).savefig(folder / "corner-side-by-side.png", dpi=130)
        table = width_table(fits)
        table.to_csv(folder / "widths.csv", float_format="%.4f")
        write_run(folder, {"demo": sorted(fits), "seed": seed})
    yield ""
    yield "Width of the 90 % credible interval, m² s⁻², mean over the records"
    yield table.to_string(float_format=lambda value: f"{value:.2f}")
    yield ""
    yield "truth: " + ", ".join(f"{name} {value:z.2f}" for name, value in zip(STRESSES, stresses, strict=True))
    yield ""
    yield (
        "Fifty beams at one opening angle tell no more of vv and ww than the prior does: what is "
        "hatched grey in the pictures is the prior's. One beam along the axis helps little at 15°; a wide angle helps "
        "most."
    )
    yield f"Pictures and files: {output}"


def width_table(fits: dict[str, Fit]) -> pd.DataFrame:
    """Return mean widths of the credible intervals, a row for each lidar; the last row is the prior's own width.

    The prior's width is that of its shape at the size of the first lidar's posterior.
    """
    rows = {}
    for name, found in fits.items():
        table = found.summary()
        width = (table["high"] - table["low"]).groupby(table["stress"]).mean()
        rows[TITLES[name]] = width[list(STRESSES)]
    first = next(iter(fits.values()))
    rows["the prior alone, at the size of the first"] = pd.Series(_prior_width(first), index=list(STRESSES))
    return pd.DataFrame(rows).T


def demo_widths(folder: str | Path) -> dict[str, dict[str, float]]:
    """Return the table of widths of a demo's folder, as plain numbers by lidar and stress."""
    table = pd.read_csv(Path(folder) / "widths.csv", index_col=0)
    return {str(name): {str(stress): float(value) for stress, value in row.items()} for name, row in table.iterrows()}


def _prior_width(found: Fit) -> FloatArray:
    from bayes_rs.intervals import interval_of
    from bayes_rs.plot.corner_plot import prior_at_size

    widths = []
    for record in range(found.n_record):
        low, high = interval_of(prior_at_size(found, record).T, 0.9)
        widths.append(high - low)
    return np.asarray(np.mean(widths, axis=0))


def _side_by_side(fits: dict[str, Fit], truth: FloatArray) -> Any:
    from bayes_rs.pictures import Picture
    from bayes_rs.plot.corner_plot import corner, corner_limits

    shown = ("6-beam-45", "50-beam")
    results = [fits[name] for name in shown]
    limits = corner_limits(results, [_RECORD] * len(shown))
    figure = Picture(figsize=(11.0, 5.6), layout="constrained")
    panels = np.atleast_1d(np.asarray(figure.subfigures(1, len(shown))))
    for panel, name, result in zip(panels, shown, results, strict=True):
        corner(result, _RECORD, stresses=_SHOWN, truth=truth, limits=limits, title=TITLES[name], figure=panel)
    return figure
