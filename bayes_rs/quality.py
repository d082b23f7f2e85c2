"""Which samples count: the named filters on radial velocities, each of which says how many it dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_count, check_positive
from bayes_rs.errors import InputError

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

FILTERS = ("missing", "status", "cnr", "despike")
DESPIKE_RULES = ("median",)
MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation, of a Gaussian."""


@dataclass(frozen=True)
class QualityRules:
    """The checked options of the filters; the meaning of each is in `bayes_rs.make_records`."""

    status_valid: float | None = None
    cnr_range: tuple[float, float] | None = None
    despike: str | None = None
    despike_window: int = 11
    despike_threshold: float = 5.0

    def __post_init__(self) -> None:
        """Check the options."""
        if self.cnr_range is not None:
            try:
                low, high = (float(bound) for bound in self.cnr_range)
            except (TypeError, ValueError):
                low, high = np.nan, np.nan
            if not low < high:
                raise InputError(
                    f"Invalid cnr_range {self.cnr_range!r} dB: it must be a pair (low, high) with low < high."
                )
        if self.despike is not None:
            check_choice(self.despike, DESPIKE_RULES, what="despike")
        if check_count(self.despike_window, what="despike_window", minimum=3) % 2 == 0:
            raise InputError(f"Invalid despike_window {self.despike_window}: it must be an odd number of samples.")
        check_positive(self.despike_threshold, what="despike_threshold", unit="")


def usable(
    velocity: FloatArray,
    beam: IntArray,
    group: IntArray,
    *,
    cnr: FloatArray | None,
    status: FloatArray | None,
    rules: QualityRules,
) -> tuple[BoolArray, dict[str, int]]:
    """Say which samples pass all filters, and how many each filter dropped.

    A sample counts for the first filter that drops it, in the order of `FILTERS`.

    Parameters
    ----------
    velocity : ndarray, shape (n_sample,)
        Radial velocities, m/s, beam after beam and each in time's order.
    beam, group : ndarray of int, shape (n_sample,)
        Beam, and record and beam together, of each sample.
    cnr, status : ndarray, shape (n_sample,), or None
        Carrier-to-noise ratio, dB, and the instrument's status.
    rules : QualityRules
        What the filters ask for.

    Returns
    -------
    keep : ndarray of bool, shape (n_sample,)
        Which samples count.
    dropped : dict
        Number of samples dropped by each filter.
    """
    keep = np.isfinite(velocity)
    dropped = {"missing": int((~keep).sum())}

    def apply(name: str, passes: BoolArray) -> None:
        dropped[name] = int((keep & ~passes).sum())
        keep[~passes] = False

    everything = np.ones(len(velocity), dtype=bool)
    known_status = rules.status_valid is not None and status is not None
    apply("status", status == rules.status_valid if known_status else everything)  # type: ignore[arg-type]
    if rules.cnr_range is not None and cnr is not None:
        apply("cnr", (cnr >= rules.cnr_range[0]) & (cnr <= rules.cnr_range[1]))  # an unknown CNR does not pass
    else:
        apply("cnr", everything)
    passes = everything.copy()
    if rules.despike == "median":
        passes[keep] = ~is_spike(
            velocity[keep],
            beam[keep],
            group[keep],
            window=rules.despike_window,
            threshold=rules.despike_threshold,
        )
    apply("despike", passes)
    return keep, dropped


def is_spike(velocity: FloatArray, beam: IntArray, group: IntArray, *, window: int, threshold: float) -> BoolArray:
    """Find spikes by the median rule: |v − m| > k · 1.4826 · MAD.

    Parameters
    ----------
    velocity : ndarray, shape (n_sample,)
        Finite radial velocities, m/s, beam after beam and each in time's order.
    beam, group : ndarray of int, shape (n_sample,)
        Beam, and record and beam together, of each sample.
    window : int
        Number of samples w of the running median m, odd; mirrored at a beam's ends.
    threshold : float
        k.

    Returns
    -------
    spike : ndarray of bool, shape (n_sample,)
        Which samples are spikes.

    Notes
    -----
    m is the median of the w usable samples of the same beam about the sample, MAD the median of |v − m| over the record
    and beam. Where MAD is zero (a value that repeats) the rule has no scale and drops nothing.
    """
    deviation = np.empty_like(velocity)
    edges = np.flatnonzero(np.diff(beam)) + 1
    for values, out in zip(np.split(velocity, edges), np.split(deviation, edges), strict=True):
        out[:] = (
            np.abs(values - scipy.ndimage.median_filter(values, size=window, mode="mirror")) if len(values) else 0.0
        )
    mad = group_median(deviation, group)
    return np.asarray((deviation > threshold * MAD_TO_SIGMA * mad) & (mad > 0.0))


def group_median(values: FloatArray, group: IntArray) -> FloatArray:
    """Return for each entry the median of its group."""
    order = np.lexsort((values, group))
    _, start, inverse, count = np.unique(group[order], return_index=True, return_inverse=True, return_counts=True)
    ranked = values[order]
    median = 0.5 * (ranked[start + (count - 1) // 2] + ranked[start + count // 2])
    result = np.empty_like(values)
    result[order] = median[inverse]
    return result
