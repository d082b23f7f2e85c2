"""The numbers that the page's script draws, as plain JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.summarizing import OF_RECORD
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.decided import PRIOR_BELOW, is_priors
from bayes_rs.posteriors.prior_at_size import prior_interval_at_size, sizes_of
from bayes_rs.posteriors.sampling.chains import PARETO_K_LIMIT, R_HAT_LIMIT
from bayes_rs.records.layout import TURBINE
from bayes_rs.report.availability import Availability
from bayes_rs.report.packing import pack, pack_few, pack_rows, pack_steps, plain
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.series import Series, time_axis

DRAW_BYTES = 2_400_000
"""What the draws of all records may take of the page."""
MOST_DRAWS = 600
LEAST_DRAWS = 100
MOST_TI_POINTS = 1000
MOST_SHAPE_POINTS = 2000
MOST_PICKED = 60_000
"""Records up to which each can be picked: more than a year of ten minutes."""
MOST_BESIDE = 10_000
"""Records up to which each one's table says what the data decided, and least squares: 2 MB of the page of a year."""
_NODES = 12
"""Relative uncertainties of a size at which the page has the prior's interval."""
_PAIRS = [(i, j) for i in range(len(STRESSES)) for j in range(i + 1, len(STRESSES))]


def series_data(series: Series) -> dict[str, Any]:
    """Return the points of the panels along time."""
    kinds = ("median", "low", "high", *(("spread_low", "spread_high") if series.binned else ()))
    known = series.intensity
    return {
        "start": [round(value, 3) for value in series.start.tolist()],
        "width": series.width,
        "binned": series.binned,
        "count": series.count.tolist(),
        "failed": series.n_failed.tolist(),
        "remarked": series.n_remarked.tolist(),
        "priors": series.priors.astype(np.int64).T.tolist(),
        "room": plain(np.moveaxis(series.room, 1, 2), 3),
        **{name: plain(getattr(series, name).T) for name in kinds},
        **({"ti": {name: plain(known[name]) for name in kinds}} if known else {}),
    }


def over_bins(found: ReportData, series: Series, values: FloatArray) -> list[Any]:
    """Return numbers of the records (n_record,) at the points of a series: medians of a bin's."""
    if not series.binned:
        return plain(values)  # a point is a record
    place = np.searchsorted(series.start, time_axis(found)[0], side="right") - 1
    parts = [values[(place == point) & np.isfinite(values)] for point in range(len(series.start))]
    return plain(np.array([np.median(some) if len(some) else np.nan for some in parts]))


def availability_data(availability: Availability, found: ReportData) -> dict[str, Any]:
    """Return the heat map of the beams."""
    position, width, _ = time_axis(found)
    ends = np.append(position, position[-1] + width)
    return {
        "beam": availability.beam,
        "edges": [round(value, 3) for value in ends[availability.edges].tolist()],
        "share": plain(availability.share, 3),
        "usable": plain(availability.usable, 3),
        "of_samples": availability.of_samples,
    }


def picked(found: ReportData) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the records that can be picked: all, or evenly spaced ones of very many."""
    n = len(found.record)
    return np.unique(np.linspace(0, n - 1, min(n, MOST_PICKED)).round().astype(np.int64))


def records_data(found: ReportData, rows: NDArray[np.int64], covariance: FloatArray) -> dict[str, Any]:
    """Return the numbers of some records, and draws of their posteriors as far as the page can hold them.

    Parameters
    ----------
    found : ReportData
        What the report shows.
    rows : ndarray of int, shape (n,)
        The records, from `picked`.
    covariance : ndarray, shape (n, 6, 6)
        Their posterior covariances, m⁴ s⁻⁴.
    """
    position, _, timed = time_axis(found)
    columns = ("median", "low", "high", "mean", "sd")
    numbers = np.stack([found.numbers[name][rows] for name in columns], axis=1)
    sd = np.sqrt(np.einsum("rii->ri", covariance))
    with np.errstate(invalid="ignore", divide="ignore"):  # records that were not fitted, or draws that are all equal
        correlation = np.stack([covariance[:, i, j] / (sd[:, i] * sd[:, j]) for i, j in _PAIRS], axis=1)
    data: dict[str, Any] = {
        "record": pack_steps(found.record[rows]),
        "position": pack_steps(position[rows]),
        "flag": pack_few(found.flag[rows]),
        "speed": pack(found.wind_speed[rows], "f4"),
        "numbers": pack_rows(numbers),
        "correlation": _hundredths(correlation),
        "priors": pack(bits(is_priors(found.numbers["decided"][rows])), "u1"),
        "first": int(np.argmax(found.fitted[rows])),
    }
    if not timed and not np.isnat(found.time[rows]).all():
        data["time"] = pack_steps(in_ms(found.time[rows]))
    if TURBINE in found.records:
        names, place = np.unique(found.records[TURBINE].values[rows].astype(str), return_inverse=True)
        data["turbine"] = {"names": names.tolist(), "place": pack(place, "u2")}
    if len(rows) <= MOST_BESIDE:
        data["decided"] = _hundredths(found.numbers["decided"][rows])
        data["beside"] = pack_rows(np.stack([found.numbers[name][rows] for name in OF_RECORD[1:]], axis=1))
    n_draw = min(MOST_DRAWS, DRAW_BYTES // (16 * len(found.record)))  # six 16-bit numbers, in base64
    if found.draws is not None and n_draw >= LEAST_DRAWS and found.fitted.any():
        draws = found.draws(n_draw)
        data["draws"] = {"n": draws.shape[1], **pack_rows(draws)}
    if found.fitted.any():
        data["prior"] = {"n": len(found.prior_shape), **pack_rows(found.prior_shape)}
    return data


def in_ms(time: NDArray[np.datetime64]) -> FloatArray:
    """Return times as ms since 1970, NaN where there is none."""
    return np.where(np.isnat(time), np.nan, time.astype("datetime64[ns]").astype(np.int64) / 1e6)


def bits(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the columns of (n, n_column) as bits of one number a row, the first the lowest."""
    return np.asarray(flags.astype(np.int64) @ (1 << np.arange(flags.shape[1])))


def room_data(found: ReportData, spread: float) -> dict[str, Any]:
    """Return the ends of the prior's interval at size 1, for relative uncertainties of the size up to the greatest."""
    nodes = np.linspace(0.0, max(spread, 1e-3), _NODES)
    low, high = prior_interval_at_size(found.prior_shape, np.ones(_NODES), nodes, found.prob, found.interval)
    return {"spread": plain(nodes), "low": plain(low.T), "high": plain(high.T)}


def prior_room(found: ReportData, rows: NDArray[np.int64], covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return the ends of the prior's interval at the size of each record, and the greatest relative spread of a size.

    Parameters
    ----------
    found, rows, covariance
        As for `records_data`.

    Returns
    -------
    room : ndarray, shape (2, n_record, 6)
        m² s⁻²; NaN for records that are not among the rows or were not fitted.
    spread : float
        Standard deviation over mean of uu + vv + ww, the largest of all records.
    """
    mean, sd = sizes_of(found.numbers["mean"][rows], covariance)
    room = np.full((2, len(found.record), len(STRESSES)), np.nan)
    room[0, rows], room[1, rows] = prior_interval_at_size(found.prior_shape, mean, sd, found.prob, found.interval)
    known = np.isfinite(mean)
    return room, float(np.max(sd[known] / mean[known])) if known.any() else 0.0


def intensity_data(found: ReportData) -> dict[str, Any] | None:
    """Return turbulence intensity against wind speed; None if it is not known of any record."""
    if "ti" not in found.derived:
        return None
    ti, speed = found.derived["ti"], found.wind_speed
    rows = np.flatnonzero(np.isfinite(ti["median"]) & np.isfinite(speed))
    if not len(rows):
        return None
    number = np.floor(speed[rows]).astype(np.int64)
    bins = np.unique(number)
    in_bins = [rows[number == one] for one in bins.tolist()]
    data: dict[str, Any] = {
        "bin": bins.tolist(),
        "count": [len(some) for some in in_bins],
        "priors": [int(is_priors(np.median(found.numbers["decided"][some, 0]))) for some in in_bins],
        **{name: [_short(np.median(ti[name][some])) for some in in_bins] for name in ("median", "low", "high")},
        "spread_low": [_short(np.quantile(ti["median"][some], 0.05)) for some in in_bins],
        "spread_high": [_short(np.quantile(ti["median"][some], 0.95)) for some in in_bins],
    }
    if len(found.record) <= MOST_TI_POINTS:
        data["points"] = {
            "record": rows.tolist(),
            "speed": plain(speed[rows]),
            **{name: plain(ti[name][rows]) for name in ("median", "low", "high")},
            "priors": is_priors(found.numbers["decided"][rows, 0]).astype(np.int64).tolist(),
            "flagged": (found.flag[rows] != 0).astype(np.int64).tolist(),
        }
    return data


def decided_quantiles(found: ReportData) -> FloatArray:
    """Return the 5, 50 and 95 % points over the fitted records of what the data decided, shape (6, 3)."""
    return np.asarray(np.nanquantile(found.numbers["decided"][found.fitted], [0.05, 0.5, 0.95], axis=0).T)


def decided_data(found: ReportData) -> dict[str, Any] | None:
    """Return the points of what the data decided; None if no record was fitted."""
    if not found.fitted.any():
        return None
    points = decided_quantiles(found)
    priors = is_priors(points[:, 1]).astype(np.int64).tolist()
    return {"points": plain(points, 3), "priors": priors, "limit": PRIOR_BELOW}


def shape_data(found: ReportData) -> dict[str, Any] | None:
    """Return the records' points in the Lumley triangle, by `shape_points`; None if no record was fitted."""
    rows = np.flatnonzero(found.fitted)
    if not len(rows):
        return None
    some = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_SHAPE_POINTS)).round().astype(np.int64))
    xi, eta = found.shape.middle[rows[some]].T
    priors = is_priors(found.numbers["decided"][rows[some], :3]).any(axis=1)  # as `shape_is_priors` has it
    points = {"record": rows[some].tolist(), "xi": plain(xi), "eta": plain(eta), "priors": priors.astype(int).tolist()}
    return {**points, "words": found.shape.words}


def _hundredths(values: FloatArray) -> str:
    """Pack numbers from −1.27 to 1.27 to a hundredth; those that are not finite become −128."""
    steps = np.clip(np.rint(100.0 * np.where(np.isfinite(values), values, 0.0)), -127, 127)
    return pack(np.where(np.isfinite(values), steps, -128), "i1")


def worst_diagnostics(found: ReportData) -> dict[str, FloatArray]:
    """Return the worst value of each diagnostic over a record's stresses, shape (n_record,); NaN where it has none."""
    return {
        "ess_bulk": found.numbers["ess_bulk"].min(axis=1),
        "ess_tail": found.numbers["ess_tail"].min(axis=1),
        "r_hat": found.numbers["r_hat"].max(axis=1),
        "pareto_k": np.where(np.isfinite(found.per_record["pareto_k"]), found.per_record["pareto_k"], np.nan),
        "misfit": found.per_record["misfit"],
    }


def diagnostic_limits(found: ReportData) -> dict[str, float | None]:
    """Return the limits beyond which a record is flagged; None where there is none."""
    target = found.run["settings"]["fit"]["target_ess"]
    return {
        "ess_bulk": None if target is None else float(target),
        "ess_tail": None,
        "r_hat": R_HAT_LIMIT,
        "pareto_k": PARETO_K_LIMIT,
        "misfit": None,
    }


def diagnostics_data(found: ReportData) -> list[dict[str, Any]]:
    """Return a histogram over the records of each diagnostic that there is."""
    limits = diagnostic_limits(found)
    panels = []
    for name, values in worst_diagnostics(found).items():
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        low, high = float(known.min()), float(known.max())
        if high - low <= 1e-9 * max(abs(high), 1.0):
            low, high = low - 0.05 * max(abs(low), 0.1), high + 0.05 * max(abs(high), 0.1)
        counts, edges = np.histogram(known, bins=24, range=(low, high))
        panels.append({"name": name, "count": counts.tolist(), "edges": plain(edges, 6), "limit": limits[name]})
    return panels


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None
