"""Boxes of turbulence for draws of a fit: from the posterior of R to the input of a simulator of loads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray, as_generator, check_count, check_non_negative, check_positive
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.output import output_folder, write_csv
from bayes_rs.progress import progress as progress_bar
from bayes_rs.simulation.boxes import BoxGrid, hipersim_for
from bayes_rs.simulation.load_box import BoxOptions, check_stresses
from bayes_rs.simulation.virtual import box_seeds
from bayes_rs.turbulence.mann import MannTurbulence

TABLE = "boxes.csv"
"""File that says what each box was made of."""
_DISSIPATION = 0.05  # plays no part: the box gets the draw's stresses


@dataclass(frozen=True)
class _Flow:
    """Length scale, m, its uncertainty as a standard deviation of ln L, and anisotropy of a record."""

    length_scale: float
    log_sd: float
    gamma: float


def export_boxes(
    fit: Fit,
    record: RecordKey,
    output: str | Path,
    *,
    seed: int,
    grid: BoxGrid | None = None,
    n_box: int = 6,
    format: str = "hawc2",  # noqa: A002 - the word that everyone uses
    length_scale: float | None = None,
    gamma: float | None = None,
    hub_height: float | None = None,
    shear_exponent: float = 0.0,
    overwrite: bool = False,
    progress: bool | None = None,
) -> pd.DataFrame:
    """Write boxes of Mann turbulence for draws of a record's posterior, one for each draw.

    Parameters
    ----------
    fit : Fit
        With draws.
    record : int, str, datetime, Timestamp or datetime64
        Number of a record, or its start (UTC; a text is an ISO time).
    output : str or Path
        Folder to write.
    seed : int
        Seed: it chooses the draws and the length scales, and makes the seed of every box.
    grid : BoxGrid, optional
        The grid of every box: its length should be the wind speed times the duration of the record. By default that,
        160 m wide and high, of 2048 × 32 × 32 points.
    n_box : int
        How many draws.
    format : str
        ``"hawc2"``, ``"bladed"``, ``"turbsim"`` or ``"netcdf"``.
    length_scale, gamma : float, optional
        Length scale, m, and anisotropy of all boxes, instead of the fit's.
    hub_height, shear_exponent, overwrite
        As for `bayes_rs.simulation.export_box`.
    progress : bool, optional
        A progress bar on stderr; by default only on a terminal.

    Returns
    -------
    boxes : pandas.DataFrame
        A row a box: ``box``, ``file`` (the first of it), ``record``, ``draw`` (its place among all draws of the
        record), the six stresses, m² s⁻², ``length_scale`` (m), ``gamma``, ``wind_speed`` (m/s) and ``seed``. The
        folder has it as ``boxes.csv``.

    Raises
    ------
    InputError
        If the fit kept no draws, there are not as many, the record was not fitted, it is not known which length scale
        it has, or a number is not valid.
    MissingExtraError
        If hipersim is not installed.

    Notes
    -----
    Every box has the R of its draw exactly (`bayes_rs.simulation.export_box` says how), so that loads that are
    simulated with all boxes have the distribution that the posterior of R gives them, and that of turbulence with the
    same R. The stresses are about the record's mean (``target="record"``) or what else the fit was of.

    The length scale of a box is drawn from the record's: log-normal, with the median and the deviation of ln L that the
    fit averaged its noise over; where noise of one length scale was given, it is that one. A fit averages over L and
    does not sample it, so that L and R are independent here. Γ is that of the record, or of the noise.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=1, seed=1)
    >>> noise = brs.noise.calibrate("2-beam", wind_speed=10.0)
    >>> fit = brs.fit(brs.make_records(series, "2-beam"), "2-beam", noise=noise, seed=1)
    >>> grid = brs.simulation.BoxGrid((64, 8, 8), (90.0, 10.0, 10.0))
    >>> with tempfile.TemporaryDirectory() as place:
    ...     boxes = export_boxes(fit, 0, f"{place}/boxes", grid=grid, seed=1, n_box=2, format="turbsim")
    >>> boxes["file"].tolist(), boxes["length_scale"].tolist()
    (['box-000.bts', 'box-001.bts'], [61.0, 61.0])
    """
    index = check_fit(fit).find_record(record)
    draws = fit.draws(index).reshape(-1, len(STRESSES))
    count = check_count(n_box, what="n_box")
    if count > len(draws):
        raise InputError(f"Invalid n_box {count}: the record has {len(draws)} draws; write fewer boxes.")
    speed = float(fit.records["wind_speed"].values[index])
    grid = record_grid(fit, index) if grid is None else grid
    chosen = BoxOptions(grid, speed, format, str(fit.settings["fit"]["target"]), hub_height, shear_exponent)
    flow = _flow_of(fit, index, length_scale, gamma)
    rng = as_generator(seed)
    rows = rng.choice(len(draws), count, replace=False)
    lengths = flow.length_scale * np.exp(flow.log_sd * rng.standard_normal(count))
    seeds = box_seeds(rng, count)
    hipersim_for("")
    silent = None if progress is None else not progress
    table = []
    with output_folder(output, overwrite=overwrite) as folder:
        drawn = zip(rows.tolist(), lengths.tolist(), seeds, strict=True)
        for box, (row, length, own) in enumerate(progress_bar(drawn, count, "boxes", disable=silent)):
            stresses = check_stresses(draws[row])
            turbulence = MannTurbulence(_DISSIPATION, length, flow.gamma)
            files = chosen.write(stresses, turbulence, own, folder / f"box-{box:03d}")
            table.append(
                {
                    "box": box,
                    "file": files[0].name,
                    "record": index,
                    "draw": row,
                    **dict(zip(STRESSES, stresses.tolist(), strict=True)),
                    "length_scale": length,
                    "gamma": flow.gamma,
                    "wind_speed": speed,
                    "seed": own,
                }
            )
        found = pd.DataFrame(table)
        write_csv(found, folder / TABLE)
    return found


def record_grid(
    fit: Fit,
    record: RecordKey,
    *,
    points: tuple[int, int, int] = (2048, 32, 32),
    size: tuple[float, float] = (160.0, 160.0),
    length: float | None = None,
) -> BoxGrid:
    """Return the grid of a box for a record.

    Parameters
    ----------
    fit : Fit
        The fit.
    record : int, str, datetime, Timestamp or datetime64
        Number of the record, or its start (UTC; a text is an ISO time).
    points : tuple of int
        Points along the wind, across it and upwards.
    size : tuple of float
        Width and height, m.
    length : float, optional
        Length, m; by default the record's wind speed times its duration.

    Raises
    ------
    InputError
        If there is no such record, it was not fitted, or a number is not valid.
    """
    index = check_fit(fit).find_record(record)
    if length is None:
        length = float(fit.records["wind_speed"].values[index]) * float(fit.records.attrs.get("duration", 600.0))
    along, across, upward = (
        check_positive(number, what=what, unit="m")
        for number, what in ((length, "length"), (size[0], "width"), (size[1], "height"))
    )
    return BoxGrid(points, (along / points[0], across / points[1], upward / points[2]))


def _flow_of(fit: Fit, index: int, length_scale: float | None, gamma: float | None) -> _Flow:
    """Return the length scale of a record, how uncertain the fit took it to be, and its anisotropy."""
    median, log_sd = _length_of(fit, index) if length_scale is None else (length_scale, 0.0)
    own = _of_record(fit, "gamma", index)
    gammas = fit.run["noise"]["gammas"]
    if gamma is None and own is None and len(gammas) != 1:
        raise InputError(f"It is not known which gamma record {index} has: its noise knows {gammas}; give gamma.")
    anisotropy = gamma if gamma is not None else gammas[0] if own is None else own
    return _Flow(
        check_positive(median, what="length_scale", unit="m"),
        log_sd,
        check_non_negative(anisotropy, what="gamma", unit=""),
    )


def _length_of(fit: Fit, index: int) -> tuple[float, float]:
    """Return the median length scale of a record, m, and the standard deviation of ln L that the fit averaged over."""
    nuisances, of_noise = fit.settings["fit"]["nuisances"], fit.run["noise"]["length_scales"]
    if len(of_noise) == 1:
        return float(of_noise[0]), 0.0
    told = nuisances["length_scale_log_sd"]
    own = _of_record(fit, "length_scale", index)
    median = own if nuisances["length_scale"] is None else nuisances["length_scale"]
    if median is None:
        raise InputError(
            f"It is not known which length scale record {index} has: its noise is for {of_noise[0]:g} to "
            f"{of_noise[-1]:g} m; give length_scale."
        )
    sd = _of_record(fit, "length_scale_log_sd", index) if told == "records" else float(told)
    return float(median), 0.0 if sd is None else sd


def _of_record(fit: Fit, name: str, index: int) -> float | None:
    """Return a number of a record; None where it has none."""
    if name not in fit.records:
        return None
    value: FloatArray = np.asarray(fit.records[name].values, dtype=np.float64)
    return float(value[index]) if np.isfinite(value[index]) else None
