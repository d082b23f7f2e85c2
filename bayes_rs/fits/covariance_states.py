"""What theory expects of the variances and correlations of records: between nodes of wind, direction and length."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.uncertain_length import NODES, WEIGHTS
from bayes_rs.geometry.scan import Scan, ScanByKey, yaw_matrix
from bayes_rs.processor import one_thread
from bayes_rs.records.beam_correlation import CORRELATED_BEAMS, CORRELATION, correlated_beams, pair_columns
from bayes_rs.records.layout import MAST, MAST_POSITION
from bayes_rs.theory.beam_covariances import CovarianceMoments, Views, coherence_slopes, covariance_moments
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.turbulence.mann import MannTurbulence

_STEPS = np.array([0.25, np.deg2rad(10.0), 0.3, 0.5])  # of ln U, yaw, ln L and Γ
_ANCHOR = np.array([0.0, 0.0, 0.0, 3.2])  # the nodes are at this plus steps: most records have the Γ of fu-2022
_SPEEDS, _LENGTHS, _GAMMAS = (1.0, 50.0), (8.0, 600.0), (0.2, 5.2)  # what is beyond gets the theory of these
_LEAST_WEIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class PairData:
    """The correlations of some records, and the beams that they are of.

    Parameters
    ----------
    correlation : ndarray, shape (n_record, n_pair)
        NaN where there is none.
    scan : Scan
        Of these beams alone.
    column : ndarray of int, shape (n_view,)
        Where they stand among the records' beams.
    duration : float
        Length of a record, s.
    mast : ndarray, shape (n_record, 6), optional
        Stresses that a mast measured, m² s⁻²; NaN where there are none.
    position : tuple of float
        Where it did, m in the levelled frame of the lidar.
    """

    correlation: FloatArray
    scan: Scan
    column: NDArray[np.int64]
    duration: float
    mast: FloatArray | None = None
    position: tuple[float, ...] = ()

    @property
    def has_mast(self) -> bool:
        """Whether a mast measured in any of the records."""
        return self.mast is not None and bool(np.isfinite(self.mast[:, :3]).any())

    def take(self, records: NDArray[np.int64] | slice) -> PairData:
        """Return those of some of the records."""
        mast = None if self.mast is None else self.mast[records]
        return replace(self, correlation=self.correlation[records], mast=mast)

    def join(self, others: list[PairData]) -> PairData:
        """Return these and those of other records, one after the other."""
        parts = [self, *others]
        mast = [part.mast for part in parts if part.mast is not None]
        return replace(
            self,
            correlation=np.concatenate([part.correlation for part in parts]),
            mast=np.concatenate(mast) if mast else None,
        )


def check_has_pairs(n_beam: int) -> None:
    """Refuse beams of which no two can have a covariance.

    Raises
    ------
    InputError
        If there are fewer than two.
    """
    if n_beam < 2:
        raise InputError(
            f"Invalid information 'covariances' for records of {n_beam} beam: one beam has no covariance with another; "
            "use information 'variances'."
        )


def pair_data(records: xr.Dataset, scan: Scan, duration: float, *, correlations: bool) -> PairData:
    """Return the correlations that records hold, and what a mast measured beside them.

    Parameters
    ----------
    records : Dataset
        From ``make_records(..., correlations=True)``, and `bayes_rs.wind.with_mast`.
    scan : Scan
        Of the records' beams.
    duration : float
        Length of a record, s.
    correlations : bool
        Whether the correlations are needed; without, all are NaN.

    Raises
    ------
    InputError
        If they are needed, and there are none, or of fewer than two beams.
    """
    mast, position = None, ()
    if MAST in records:
        mast = np.asarray(records[MAST].values, dtype=np.float64)
        position = tuple(json.loads(records.attrs[MAST_POSITION]))
    if not correlations:
        numbers = correlated_beams(scan)
        n_pair = len(numbers) * (len(numbers) - 1) // 2
        column = np.flatnonzero(np.isin(scan.beam, numbers))
        nothing = np.full((records.sizes["record"], n_pair), np.nan)
        return PairData(nothing, scan.select(numbers), column, duration, mast, position)
    if CORRELATION not in records or CORRELATED_BEAMS not in records.attrs:
        raise InputError(
            "The records hold no correlations between beams, which information 'covariances' needs: make them with "
            "correlations=True (--correlations)."
        )
    have = np.array(json.loads(records.attrs[CORRELATED_BEAMS]), dtype=np.int64)
    present = scan.beam[np.isin(scan.beam, have)]
    check_has_pairs(len(present))
    of_pair = pair_columns(present, have)
    values = np.asarray(records[CORRELATION].values, dtype=np.float64)
    correlation = np.where(of_pair >= 0, values[:, of_pair], np.nan)
    column = np.flatnonzero(np.isin(scan.beam, present))
    return PairData(correlation, scan.select(present), column, duration, mast, position)


@dataclass(frozen=True, eq=False)
class RecordMoments:
    """The theory of records' variances and correlations: `CovarianceMoments` along the records.

    Parameters
    ----------
    direction : ndarray, shape (n_record, n_view, 3)
        Unit vectors of the beams in the mean-wind frame of each record.
    tensor, record, ensemble, covariance, bias : ndarray
        As in `CovarianceMoments`, with the records first; tensors over the uu of a record.
    slope : ndarray, shape (n_record, n_datum, 4)
        From `coherence_slopes`.
    """

    direction: FloatArray
    tensor: FloatArray
    record: FloatArray
    ensemble: FloatArray
    covariance: FloatArray
    bias: FloatArray
    slope: FloatArray


def record_moments(
    pairs: PairData,
    wind_speed: FloatArray,
    yaw: FloatArray,
    length_scale: FloatArray,
    gamma: FloatArray,
    length_log_sd: FloatArray | None,
) -> RecordMoments:
    """Return the theory for records, each at its own wind, direction and turbulence.

    Parameters
    ----------
    pairs : PairData
        Of these records: whose beams, and how long a record is.
    wind_speed, yaw, length_scale, gamma : ndarray, shape (n_record,)
        m/s, rad, m and 1.
    length_log_sd : ndarray, shape (n_record,), or None
        Standard deviations of the records' own ln L; their scatter is averaged over it.

    Returns
    -------
    moments : RecordMoments
        Linear between nodes of ln U (steps of 0.25), direction (10°), ln L (0.3) and Γ (0.5), which are calculated once
        each. The directions are the records' own. `slope` times the standard deviation of ln L is not in the
        covariance.
    """
    own = wind_speed, yaw, length_scale, gamma
    middle = CovarianceMoments(*_between(_moments_at, pairs, *own))
    (slope,) = _between(_slopes_at, pairs, *own)
    covariance = middle.covariance
    if length_log_sd is not None and np.any(length_log_sd > 0.0):
        covariance = np.zeros_like(covariance)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            moved = length_scale * np.exp(node * length_log_sd)
            covariance += (
                weight * CovarianceMoments(*_between(_moments_at, pairs, wind_speed, yaw, moved, gamma)).covariance
            )
    direction = pairs.scan.at_yaw(yaw)
    if pairs.mast is not None:
        direction = np.concatenate([direction, np.broadcast_to(np.eye(3), (len(yaw), 3, 3))], axis=1)
    return RecordMoments(direction, **{**middle._asdict(), "covariance": covariance}, slope=slope)


def _between(
    at_node: Callable[..., tuple[FloatArray, ...]],
    pairs: PairData,
    wind_speed: FloatArray,
    yaw: FloatArray,
    length_scale: FloatArray,
    gamma: FloatArray,
) -> list[FloatArray]:
    """Return what is known at nodes for each record, linear between those around it."""
    point = np.stack(
        [
            np.log(np.clip(wind_speed, *_SPEEDS)),
            yaw,
            np.log(np.clip(length_scale, *_LENGTHS)),
            np.clip(gamma, *_GAMMAS),
        ],
        axis=-1,
    )
    place = (point - _ANCHOR) / _STEPS
    # rounding must not make a node of its own of a value that lies at one
    low = np.floor(place + 1e-9)
    share = np.clip(place - low, 0.0, 1.0)
    position = pairs.position if pairs.mast is not None else ()
    of_scan = ScanByKey.of(pairs.scan)
    total: list[FloatArray] = []
    for corner in product((0, 1), repeat=len(_STEPS)):
        weight = np.prod(np.where(corner, share, 1.0 - share), axis=-1)
        some = np.flatnonzero(weight > _LEAST_WEIGHT)
        if len(some) == 0:
            continue
        nodes, of = np.unique(low[some] + corner, axis=0, return_inverse=True)
        made = [at_node(of_scan, pairs.duration, position, *node) for node in nodes.astype(np.int64).tolist()]
        stacked = [np.stack(values) for values in zip(*made, strict=True)]
        if not total:
            total = [np.zeros((len(point), *values.shape[1:])) for values in stacked]
        for into, values in zip(total, stacked, strict=True):
            into[some] += weight[some].reshape(-1, *(1,) * (values.ndim - 1)) * values[of.reshape(-1)]
    return total


@dataclass(frozen=True)
class _Node:
    """What is seen at a node, in which wind."""

    views: Views
    turbulence: MannTurbulence
    wind_speed: float
    n_sample: int

    @classmethod
    def of(cls, scan: Scan, duration: float, position: tuple[float, ...], numbers: tuple[int, ...]) -> _Node:
        """Return that of the numbers of the node along each axis."""
        log_speed, yaw, log_length, gamma = (_ANCHOR + _STEPS * numbers).tolist()
        views = Views.of_scan(scan, yaw)
        if position:
            views = views.with_mast(np.array(position) @ yaw_matrix(yaw))
        turbulence = MannTurbulence(1.0, float(np.exp(log_length)), gamma)
        return cls(views, turbulence, float(np.exp(log_speed)), int(np.min(sample_counts(scan, duration))))


@lru_cache(maxsize=4096)
@one_thread()  # what is kept must not depend on who asked for it first
def _moments_at(scan: ScanByKey, duration: float, position: tuple[float, ...], *numbers: int) -> CovarianceMoments:
    node = _Node.of(scan.scan, duration, position, numbers)
    found = covariance_moments(node.views, node.turbulence, wind_speed=node.wind_speed, n_sample=node.n_sample)
    size = found.record[0]
    return found._replace(tensor=found.tensor / size, record=found.record / size, ensemble=found.ensemble / size)


@lru_cache(maxsize=4096)
@one_thread()
def _slopes_at(scan: ScanByKey, duration: float, position: tuple[float, ...], *numbers: int) -> tuple[FloatArray]:
    node = _Node.of(scan.scan, duration, position, numbers)
    return (coherence_slopes(node.views, node.turbulence, wind_speed=node.wind_speed, n_sample=node.n_sample),)
