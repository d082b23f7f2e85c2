"""Do the beams of the records of a fit agree? What `check_beams` needs, from records, scan, noise and options."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.alarms.beam_check import Block, check_beams
from bayes_rs.alarms.means import expected_means
from bayes_rs.alarms.patterns import beam_patterns
from bayes_rs.alarms.variances import expected_variances
from bayes_rs.alarms.words import CheckWords
from bayes_rs.fits.batch import Batch, noise_at_median
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.prepare import can_be_fitted, sound_beams
from bayes_rs.geometry.attitude import record_direction
from bayes_rs.geometry.inflow import gradient_columns
from bayes_rs.geometry.probe import PointProbe
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.records.counts import wind_from_behind
from bayes_rs.wind.mean_error import mean_moments

_CHUNK_NUMBERS = 400_000
"""Entries of the covariances of records that are looked at together: 3 MB an array."""
MOST_BEAMS = 64
"""Of more beams, so many are looked at, evenly chosen."""
_SLOWEST, _FASTEST = 1.5, 40.0
"""Wind speeds between which means are looked at, m/s."""
_LEAST_AIR = 0.02
"""Least share of a variance that is taken for the air's, where the instrument's noise is nearly all of it."""
_LOG_STEP = np.log(2.0)


@dataclass(frozen=True)
class RecordBeams:
    """Whether the beams of each record agree, and what that is in words.

    Parameters
    ----------
    disagree : ndarray of bool, shape (n_record,)
        Which records have beams that disagree.
    probability : ndarray, shape (n_record,)
        Probability of data that disagree as much, if nothing is wrong; NaN where nothing could be looked at.
    misfit : ndarray, shape (n_record,)
        Largest distance of a beam's log-variance from what the other beams predict, in standard deviations.
    words : ndarray of object, shape (n_record,)
        What is wrong; empty where nothing is.
    numbers : dict
        What `run.json` says of all records together, as plain values.
    """

    disagree: NDArray[np.bool_]
    probability: FloatArray
    misfit: FloatArray
    words: NDArray[np.object_]
    numbers: dict[str, Any]

    def columns(self, rows: slice) -> dict[str, NDArray[Any]]:
        """Return the columns of some records in the table ``posterior``."""
        return {
            "misfit": self.misfit[rows],
            "beams_probability": self.probability[rows],
            "beams_words": self.words[rows],
        }


def record_beams(records: xr.Dataset, scan: Scan, noise: Noise, batch: Batch, options: FitOptions) -> RecordBeams:
    """Say which records have beams that disagree with each other.

    Parameters
    ----------
    records : Dataset
        The records.
    scan : Scan
        Their scan, with their beams only.
    noise : Noise
        Noise of these beams.
    batch : Batch
        The data of the records.
    options : FitOptions
        Options of the fit.

    Returns
    -------
    beams : RecordBeams
        Of all records; those that are not fitted, and scans of one beam, are not looked at. Of more than `MOST_BEAMS`
        beams so many are looked at, evenly chosen.
    """
    n_record = len(batch)
    unknown = np.full(n_record, np.nan)
    nothing = RecordBeams(np.zeros(n_record, dtype=np.bool_), unknown, unknown, np.full(n_record, "", dtype=object), {})
    fitted = can_be_fitted(batch)
    if scan.n_beam == 1 or not len(fitted):
        return nothing
    some = (records, batch) if len(fitted) == n_record else (records.isel(record=fitted), batch.take(fitted))
    told = look_at_beams(some[0], scan, noise, some[1], options)
    check = told.check
    values = {"disagree": check.disagree, "words": told.records}
    values |= {name: getattr(check, name) for name in ("probability", "misfit")}
    whole = {name: getattr(nothing, name).copy() for name in values}
    for name, found in values.items():
        whole[name][fitted] = found
    return RecordBeams(**whole, numbers=_with_wind(told.numbers(), records["yaw"].values[fitted], scan))


def _with_wind(numbers: dict[str, Any], yaw: FloatArray, scan: Scan) -> dict[str, Any]:
    """Add that the wind comes from behind, as it does where the sign of the velocities is wrong."""
    behind = wind_from_behind(yaw, scan)
    if abs(scan.yaw) > 0.5 * np.pi or 2 * np.count_nonzero(behind) <= len(yaw):
        return numbers
    count = f"{np.count_nonzero(behind)} of {len(yaw)} records"
    line = (
        f"the wind comes from behind the lidar in {count}, and so it does with velocities of the wrong sign: "
        "positive='towards' or 'away' (--positive) says it; of a lidar that looks downwind, its yaw of 180 degrees does"
    )
    return {**numbers, **{name: [line, *numbers[name]] for name in ("words", "together")}}


def look_at_beams(records: xr.Dataset, scan: Scan, noise: Noise, batch: Batch, options: FitOptions) -> CheckWords:
    """Look at the beams of records that can all be fitted, with two beams at least; see `record_beams`."""
    some = np.unique(np.linspace(0, scan.n_beam - 1, min(scan.n_beam, MOST_BEAMS)).round().astype(np.int64))
    if len(some) < scan.n_beam:
        scan, noise = scan.select(scan.beam[some]), noise.select(scan.beam[some])
        records, batch = records.isel(beam=some), _of_beams(batch, some)
    # with those beams, too, that have less than half of the instrument's noise: they are looked for
    batch = replace(batch, used=sound_beams(records))
    data = _Data(records, scan, noise, batch, options)
    patterns = beam_patterns(scan.beam_direction)
    check = check_beams(data.blocks(), patterns, len(batch), accuracy=_accuracy(noise))
    return CheckWords(check, scan.beam, float(np.median(noise.length_scale)))


def _accuracy(noise: Noise) -> float:
    """Return the error of K over its largest entry that probe volumes and shortcuts leave in a usual state."""
    states = noise.state_details or ({},)
    every = [{**noise.details, **own} for own in states]
    return float(np.median([of.get("probe_error", 0.0) + of.get("pair_error_largest", 0.0) for of in every]))


def _of_beams(batch: Batch, some: NDArray[np.int64]) -> Batch:
    own, sd = batch.instrument_noise, batch.instrument_noise_sd
    return replace(
        batch,
        variance=batch.variance[:, some],
        used=batch.used[:, some],
        instrument_noise=None if own is None else own[:, some],
        instrument_noise_sd=None if sd is None else sd[:, some],
    )


class _Data:
    """The records that are looked at."""

    def __init__(self, records: xr.Dataset, scan: Scan, noise: Noise, batch: Batch, options: FitOptions) -> None:
        self.scan, self.noise, self.batch, self.options = scan, noise, batch, options
        self.place = gradient_columns(noise.scan_geometry)
        count = float(records.attrs.get("duration", 600.0)) / scan.scan_duration
        known = np.asarray(records["count"].values, dtype=np.float64) if "count" in records else count
        self.count = np.maximum(np.broadcast_to(known, batch.variance.shape), 1.0)
        self.mean = self.mean_used = None
        if "mean" not in records:
            return
        self.mean = np.asarray(records["mean"].values, dtype=np.float64)
        slow = (batch.wind_speed < _SLOWEST) | (batch.wind_speed > _FASTEST)
        self.mean_used = (records["flag"].values == 0) & np.isfinite(self.mean) & ~slow[:, None]
        self.direction = record_direction(records, scan)
        self.log_speed, self.relative = _mean_theory(scan, noise, batch, float(records.attrs.get("duration", 600.0)))

    def blocks(self) -> Iterator[tuple[Block, Block | None]]:
        """Give log-variances and means of some records at a time."""
        size = max(1, _CHUNK_NUMBERS // self.scan.n_beam**2)
        for first in range(0, len(self.batch), size):
            rows = slice(first, first + size)
            yield self._variances(rows), self._means(rows)

    def _variances(self, rows: slice) -> Block:
        batch, nuisances = self.batch.take(rows), self.options.nuisances
        noise = noise_at_median(batch, self.noise, nuisances)
        gain = batch.turned(noise.gain)
        if self.options.target == "ensemble":
            gain = gain * (1.0 + noise.bias)[:, :, None]
        own = batch.instrument_noise
        offset = self.options.known_instrument_noise if own is None else own
        log_covariance = nuisances.inflation * np.log1p(noise.covariance)
        expected = expected_variances(batch.variance, batch.used, gain, log_covariance, offset, self.place)
        variance = np.where(batch.used, batch.variance, 1.0)
        # over the flow's best variance: over the measured one, the covariance would follow what it is compared with
        best = variance * np.exp(-expected.left)
        noise_share = np.clip(np.broadcast_to(offset, variance.shape) / best, 0.0, 1.0 - _LEAST_AIR)
        # white noise of n samples: the variance of its own variance, and of its product with the air
        own_scatter = 2.0 * noise_share * (2.0 - noise_share) / self.count[rows]
        return Block(batch.used, np.log(variance), expected, 1.0 - noise_share, own_scatter)

    def _means(self, rows: slice) -> Block | None:
        if self.mean is None or self.mean_used is None:
            return None
        batch, used = self.batch.take(rows), self.mean_used[rows]
        mean = np.where(used, self.mean[rows], 0.0)
        direction = self.direction if self.direction.ndim == 2 else self.direction[rows]
        level = np.nanmean(np.where(batch.used, batch.variance, np.nan), axis=1)
        covariance = level[:, None, None] * _between(self.log_speed, self.relative, np.log(batch.wind_speed))
        expected = expected_means(mean, used, direction, self.scan.focus_distance, batch.wind_speed, covariance)
        return Block(used, mean / batch.wind_speed[:, None], expected)


def _mean_theory(scan: Scan, noise: Noise, batch: Batch, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return logarithms of wind speeds, and there the covariance of the beams' means over their mean variance.

    Beams are taken to see points at the middle direction: what that changes is less than `MEAN_FLOOR`.
    """
    flow = noise.turbulence
    if "length_scale" in batch.flow and np.isfinite(batch.flow["length_scale"]).any():
        flow = replace(flow, length_scale=float(np.nanmedian(batch.flow["length_scale"])))
    speed = np.log(np.clip(batch.wind_speed, _SLOWEST, _FASTEST))
    first, last = int(np.floor(speed.min() / _LOG_STEP)), int(np.ceil(speed.max() / _LOG_STEP))
    nodes = _LOG_STEP * np.arange(first, last + 1)
    points, yaw = replace(scan, probe=PointProbe()), float(np.median(batch.yaw))
    made = [mean_moments(points, flow, float(np.exp(node)), yaw, duration, 1e-3) for node in nodes]
    return nodes, np.stack([one.covariance / one.variance.mean() for one in made])


def _between(nodes: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return values (n_node, ...) between nodes, linear; those of the ends beyond."""
    place = np.clip(np.interp(at, nodes, np.arange(len(nodes))), 0, len(nodes) - 1)
    low = np.minimum(place.astype(np.int64), max(len(nodes) - 2, 0))
    high = np.minimum(low + 1, len(nodes) - 1)
    share = (place - low).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[low] + share * values[high])
