"""A smooth prior from a sample of tensors, such as a year of sonic data or the posterior of another instrument."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import principal_variances
from bayes_rs.priors.interface import N_COORDINATE, NormalPrior, log_ratios_from_stress, stress_from_correlations

LEAST_SAMPLE = 50
"""Fewest tensors that a `SamplePrior` is made from: its 5 and 95 % points then rest on three tensors each."""

_KNOTS = np.array([-2.0, -1.25, -0.6, 0.0, 0.6, 1.25, 2.0])
_TURN = 0.4
"""Distance, in standard normal scores, over which a quantile curve turns from one slope to the next."""
_MOST_LEVELS = 500
_PULL = 0.002
"""Weight of a slope's distance from the overall slope, against all of the sample: it decides only in the tails."""
_SLOPE_RANGE = (0.1, 4.0)
"""Slopes of a quantile curve lie between these multiples of the sample's robust standard deviation."""
_NAMES = ("ln uu", "ln vv/uu", "ln ww/uu", "artanh rho_uv", "artanh rho_uw", "artanh rho_vw.u")


@dataclass(frozen=True, eq=False, repr=False)
class SamplePrior(NormalPrior):
    """The smooth distribution that a sample of Reynolds stress tensors comes from.

    Parameters
    ----------
    stresses : array_like, shape (n, 6)
        Tensors in the order uu, vv, ww, uv, uw, vw, m² s⁻²; at least 50, each with three positive principal variances,
        and about independent of each other.
    width : float
        Factor on the scores: 1 for the distribution of the sample itself.
    name : str
        What the prior is called in results.

    Raises
    ------
    InputError
        If there are fewer than 50 tensors, an entry is not finite, a tensor is not realizable or on the edge of it, or
        a combination of the stresses does not vary.

    Notes
    -----
    A Gaussian copula in x = (ln uu, ln vv/uu, ln ww/uu, artanh ρ_uv, artanh ρ_uw, artanh ρ_vw·u), ρ_vw·u the partial
    correlation of v and w given u: x_k = T_k(width · (C z)_k) with z standard normal, C Cᵀ the correlation matrix of
    the sample's normal scores, and T_k a smooth increasing quantile curve fitted to the sorted sample against its
    normal scores. T_k tends to straight lines beyond the sample's tails, which so become those of a normal
    distribution, and its slope there is pulled, weakly, to that of the whole sample. What the copula cannot hold:
    dependence other than that of a normal distribution, and features of the density narrower than about half a score.

    Examples
    --------
    >>> from bayes_rs.priors.ratio import WeakPrior
    >>> sample = WeakPrior(log_sd_uu=0.5).draw(200, seed=1)
    >>> SamplePrior(sample).draw(2, seed=2).shape
    (2, 6)
    """

    stresses: ArrayLike
    width: float = 1.0
    name: str = "sample"
    _offset: FloatArray = field(init=False, repr=False)
    _slope: FloatArray = field(init=False, repr=False)
    _change: FloatArray = field(init=False, repr=False)
    _mixing: FloatArray = field(init=False, repr=False)
    _n_sample: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the sample, and fit the quantile curves and the correlations of the scores."""
        where = f"prior {self.name!r}"
        check_positive(self.width, what="width", unit="", where=where)
        sample = check_array(self.stresses, (None, N_COORDINATE), what=f"stresses of {where}")
        if len(sample) < LEAST_SAMPLE:
            raise InputError(
                f"Too few stresses in {where}: {len(sample)} tensors, and at least {LEAST_SAMPLE} are needed; with "
                "fewer, use WeakPrior or RatioPrior with their medians and widths."
            )
        variances = principal_variances(sample)
        bad = np.flatnonzero(variances[:, 0] <= 8.0 * np.finfo(np.float64).eps * np.abs(variances[:, 2]))
        if len(bad):
            raise InputError(
                f"Invalid stresses of {where}: row {bad[0]} has the smallest principal variance "
                f"{variances[bad[0], 0]:.3g} m² s⁻², and it must be positive ({len(bad)} such rows); leave those "
                "rows out, or check the order uu, vv, ww, uv, uw, vw."
            )
        inner = log_ratios_from_stress(sample)
        score = scipy.special.ndtri((scipy.stats.rankdata(inner, axis=0) - 0.5) / len(sample))
        keep = object.__setattr__
        keep(self, "stresses", sample.copy())
        spread = _robust_sd(inner)
        for index, name in enumerate(_NAMES):
            if not spread[index] > 1e-9 * (1.0 + np.abs(inner[:, index]).max()):
                raise InputError(
                    f"Invalid stresses of {where}: {name} hardly varies from row to row; a prior needs a width."
                )
        correlation = np.corrcoef(score, rowvar=False)
        if np.linalg.eigvalsh(correlation)[0] < 1e-6:
            raise InputError(
                f"Invalid stresses of {where}: a combination of the stresses does not vary from row to row; "
                "a prior needs a width in all six."
            )
        curves = [_fit_curve(inner[:, index], spread[index]) for index in range(N_COORDINATE)]
        keep(self, "_offset", np.array([curve[0] for curve in curves]))
        slopes = np.array([curve[1] for curve in curves])
        keep(self, "_slope", slopes[:, 0])
        keep(self, "_change", np.diff(slopes, axis=1))
        keep(self, "_mixing", np.linalg.cholesky(correlation))
        keep(self, "_n_sample", len(sample))

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        score = self.width * (coordinate @ self._mixing.T)
        inner = self._offset + self._slope * score
        for knot, change in zip(_KNOTS, self._change.T, strict=True):
            inner += change * _turn(score - knot)
        log_uu = inner[..., 0]
        return stress_from_correlations(log_uu, log_uu + inner[..., 1], log_uu + inner[..., 2], np.tanh(inner[..., 3:]))

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        wider = "" if self.width == 1.0 else f", scores times {self.width:g}"
        return f"{self.name}: smooth distribution (Gaussian copula) of a sample of {self._n_sample} tensors{wider}"

    def widened(self, factor: float) -> Self:
        """Return the prior with all scores times `factor`: the medians stay."""
        check_positive(factor, what="factor", unit="", where=f"prior {self.name!r}")
        return replace(self, width=factor * self.width)


def _turn(value: FloatArray) -> FloatArray:
    """Smooth positive part: 0 far to the left, `value` far to the right."""
    return np.asarray(0.5 * (value + np.sqrt(value * value + _TURN * _TURN)))


def _robust_sd(values: FloatArray) -> FloatArray:
    low, high = np.quantile(values, [0.159, 0.841], axis=0)
    return np.asarray(0.5 * (high - low))


def _fit_curve(values: FloatArray, spread: float) -> tuple[float, FloatArray]:
    """Fit T(s) = a + b₀ s + Σ (b_j − b_{j−1}) turn(s − knot_j) to sorted values; return a and the slopes b > 0."""
    n_level = min(len(values), _MOST_LEVELS)
    level = (np.arange(n_level) + 0.5) / n_level
    score = scipy.special.ndtri(level)
    target = np.quantile(values, level, method="hazen")
    turns = np.stack([score, *(_turn(score - knot) for knot in _KNOTS)], axis=1)
    of_slopes = turns.copy()
    of_slopes[:, :-1] -= turns[:, 1:]  # T as a combination of the slopes themselves
    design = np.concatenate([np.ones((n_level, 1)), of_slopes], axis=1)
    n_slope = of_slopes.shape[1]
    pull = np.sqrt(_PULL * n_level) * np.concatenate([np.zeros((n_slope, 1)), np.eye(n_slope)], axis=1)
    low, high = (factor * spread for factor in _SLOPE_RANGE)
    solution = scipy.optimize.lsq_linear(
        np.concatenate([design, pull]),
        np.concatenate([target, np.sqrt(_PULL * n_level) * np.full(n_slope, spread)]),
        bounds=([-np.inf, *[low] * n_slope], [np.inf, *[high] * n_slope]),
        method="bvls",
    )
    return float(solution.x[0]), np.asarray(solution.x[1:])
