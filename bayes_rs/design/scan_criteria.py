"""Criteria of a scan: one number for how well it would know R, before anything is measured."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.special import ndtri

from bayes_rs._validation import FloatArray, check_array, check_choice, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import RANK_TOLERANCE, design_matrix
from bayes_rs.geometry.probe import PointProbe
from bayes_rs.geometry.scan import Scan, tilt_matrix, yaw_matrix
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.theory.probed import probe_transfer
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace
from bayes_rs.turbulence.two_point import radial_covariance, resolution_for

CRITERIA = ("width", "variance", "trace")
TWICE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often each stress stands among the nine elements of the tensor."""
_PROB = 0.9
_TOLERANCE = 1e-4
_FINEST = 0.1  # of L: distances along the wind closer than this are interpolated
_WIDEST = np.arccos(0.7)  # rad off the axis, up to which the lags resolve how far apart two beams are along the wind
_GROWTH = 1.2  # of the spacing of lags, from one to the next
_DEGREE = 6  # of the polynomial that a probe's gains are fitted by
_N_FITTED = 120  # directions at which they are calculated
_STEP = 1e-4  # central differences of the prior's map
_REACHED = 1e-6  # the prior's tensor must come so close to the turbulence's, relative to uu


class ScanCriterion(ABC):
    """The narrow interface of all criteria.

    Attributes
    ----------
    name : str
        Its name.
    states : tuple of str
        What it is evaluated for; the criterion is the largest value over them.
    """

    name: str
    states: tuple[str, ...]

    @abstractmethod
    def exact(self, scan: Scan) -> FloatArray:
        """Return the value of each state, shape (n_state,)."""

    @abstractmethod
    def fast(self, direction: FloatArray, like: Scan) -> FloatArray:
        """Return values, shape (n, n_state), of many scans at once, perhaps approximately.

        `direction`, shape (n, n_beam, 3), replaces the beam vectors of the scan `like`.
        """

    @abstractmethod
    def in_words(self) -> str:
        """Say in one line what the number is."""


class TraceCriterion(ScanCriterion):
    """tr (AᵀA)⁻¹ over all nine elements of the tensor: the variances by least squares under equal, independent noise.

    Notes
    -----
    With the rows (n₁², n₂², n₃², √2 n₁n₂, √2 n₁n₃, √2 n₂n₃) the six parameters are (uu, vv, ww, √2 uv, √2 uw, √2 vw):
    their squares add up to all nine elements, and the criterion is tr (ÃᵀÃ)⁻¹. Rotations of all beams do not change it.
    """

    name = "trace"
    states = ("any",)

    def exact(self, scan: Scan) -> FloatArray:
        """Return the value, shape (1,)."""
        return trace_criterion(scan.line_of_sight)[np.newaxis]

    def fast(self, direction: FloatArray, like: Scan) -> FloatArray:  # noqa: ARG002 - rotations change nothing
        """Return the values, shape (n, 1)."""
        return trace_criterion(direction)[:, np.newaxis]

    def in_words(self) -> str:
        """Say what the number is."""
        return (
            "trace: total variance of the nine elements of R by least squares, for equal and independent noise of the "
            "beams, over the variance of that noise"
        )


def trace_criterion(direction: FloatArray) -> FloatArray:
    """Return tr (ÃᵀÃ)⁻¹, shape (...), of beam vectors (..., n_beam, 3); infinite if not all stresses are seen."""
    rows = design_matrix(direction) * np.sqrt(1.0 / TWICE)
    values = np.linalg.svd(rows, compute_uv=False)
    if values.shape[-1] < len(STRESSES):
        return np.full(values.shape[:-1], np.inf)
    seen = values[..., -1] > RANK_TOLERANCE * values[..., 0]
    return np.where(seen, np.sum(np.where(seen[..., np.newaxis], values, 1.0) ** -2.0, axis=-1), np.inf)


class PosteriorCriterion(ScanCriterion):
    """Criteria of the posterior at the turbulence's own R: interval widths, or total variance.

    Parameters
    ----------
    name : str
        ``"width"`` or ``"variance"``.
    turbulence : sequence of MannTurbulence
        The turbulences; with each of the wind directions they are the states.
    wind_speed, duration : float
        m/s and s.
    yaw : sequence of float, optional
        Wind directions relative to the lidar axis, rad; the scan's own yaw if not given.
    prior : str or Prior
        The prior.
    weights : ndarray, shape (6,)
        Weights of the stresses' widths; their sum is 1.

    Notes
    -----
    A record is taken whose variances are those expected at the turbulence's R, and the posterior is linearized there:
    with g_b = ∂ ln E[y_b]/∂R, Σ = ln(1 + K) of the log-normal likelihood, and C₀ the covariance of the prior,
    linearized at R,

        C = C₀ − C₀ gᵀ (g C₀ gᵀ + Σ)⁻¹ g C₀,

    which is the Gauss–Newton covariance at the mode, but for the shift of the mode by the prior. The 90 % interval of a
    variance R_ii is taken as log-normal, 2 R_ii sinh(1.645 √C_ii / R_ii), that of a covariance as normal.
    """

    def __init__(
        self,
        name: str,
        turbulence: Sequence[MannTurbulence],
        *,
        wind_speed: float,
        duration: float,
        prior: str | Prior,
        weights: FloatArray,
        yaw: Sequence[float] | None = None,
    ) -> None:
        self.name = name
        directions: list[float | None] = [None] if yaw is None else list(yaw)
        self.turbulence = tuple(flow for flow in turbulence for _ in directions)
        self.yaw = tuple(directions) * len(turbulence)
        self.states = _labels(turbulence, directions)
        self.wind_speed = check_positive(wind_speed, what="wind_speed", unit="m/s")
        self.duration = check_positive(duration, what="duration", unit="s")
        self.weights = weights
        self.prior = make_prior(prior)
        self._before = [local_prior_covariance(self.prior, flow) for flow in turbulence for _ in directions]
        self._fast: dict[tuple[Any, ...], _FastNoise] = {}
        self._gains: dict[tuple[Any, ...], _FastGain] = {}

    def exact(self, scan: Scan) -> FloatArray:
        """Return the value of each state from `theory_noise`, shape (n_state,)."""
        noises = [self._noise(scan, index) for index in range(len(self.states))]
        return np.array([self._value(index, noise.gain[0], noise.covariance[0]) for index, noise in enumerate(noises)])

    def fast(self, direction: FloatArray, like: Scan) -> FloatArray:
        """Return values, shape (n, n_state), with covariances at points and at few lags; see `_FastNoise`.

        A probe volume counts in the gain only, not in the covariance.
        """
        level = direction @ tilt_matrix(like.tilt)
        values = np.empty((len(direction), len(self.states)))
        for index, (flow, own) in enumerate(zip(self.turbulence, self.yaw, strict=True)):
            yaw = like.yaw if own is None else own
            line_of_sight = level @ yaw_matrix(yaw)
            key = (index, yaw, like.probe, like.scan_duration, *like.focus_distance, *like.beam_time)
            if key not in self._fast:
                self._fast[key] = _FastNoise(like.with_yaw(yaw), flow, self.wind_speed, self.duration)
                if not isinstance(like.probe, PointProbe):
                    self._gains[key] = _FastGain(like, flow)
            noise = self._fast[key]
            gain = design_matrix(line_of_sight)
            if not isinstance(like.probe, PointProbe):
                gain = gain * self._gains[key].transfer(line_of_sight)
            values[:, index] = self._value(index, gain, noise.covariance(line_of_sight))
        return values

    def widths(self, scan: Scan) -> FloatArray:
        """Return the expected 90 % widths of the six stresses, shape (n_state, 6), m² s⁻²."""
        found = []
        for index, flow in enumerate(self.turbulence):
            noise = self._noise(scan, index)
            found.append(_widths(self._posterior(index, noise.gain[0], noise.covariance[0]), flow.stresses()))
        return np.array(found)

    def in_words(self) -> str:
        """Say what the number is."""
        if self.name == "variance":
            return "variance: posterior variance of R, summed over its nine elements, over the square of its trace"
        chosen = [name for name, weight in zip(STRESSES, self.weights, strict=True) if weight > 0.0]
        equal = len(set(self.weights[self.weights > 0.0].tolist())) == 1
        return (
            f"width: expected width of the 90 % interval over uu, {'mean' if equal else 'weighted mean'} of "
            f"{', '.join(chosen)}"
        )

    def _noise(self, scan: Scan, index: int) -> Noise:
        yaw = self.yaw[index]
        turned = scan if yaw is None else scan.with_yaw(yaw)
        return theory_noise(turned, self.turbulence[index], wind_speed=self.wind_speed, duration=self.duration)

    def _posterior(self, index: int, gain: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return C, shape (..., 6, 6), m⁴ s⁻⁴."""
        stress, before = self.turbulence[index].stresses(), self._before[index]
        slope = gain / (gain @ stress)[..., np.newaxis]
        seen = slope @ before
        data = seen @ slope.swapaxes(-1, -2) + np.log1p(covariance)
        return np.asarray(before - seen.swapaxes(-1, -2) @ np.linalg.solve(data, seen))

    def _value(self, index: int, gain: FloatArray, covariance: FloatArray) -> FloatArray:
        stress, after = self.turbulence[index].stresses(), self._posterior(index, gain, covariance)
        if self.name == "width":
            return np.asarray(_widths(after, stress) @ self.weights / stress[0])
        return np.asarray(np.einsum("...ii->...i", after) @ TWICE / np.sum(stress[:3]) ** 2)


def _widths(covariance: FloatArray, stress: FloatArray) -> FloatArray:
    spread = ndtri(0.5 + 0.5 * _PROB) * np.sqrt(np.einsum("...ii->...i", covariance))
    return np.concatenate([2.0 * stress[:3] * np.sinh(spread[..., :3] / stress[:3]), 2.0 * spread[..., 3:]], axis=-1)


def local_prior_covariance(prior: Prior, turbulence: MannTurbulence) -> FloatArray:
    """Return the covariance of R under a prior that is linearized at the turbulence's R, shape (6, 6), m⁴ s⁻⁴.

    Raises
    ------
    InputError
        If the prior does not reach that R, or is not concave in the logarithm there.

    Notes
    -----
    D H⁻¹ Dᵀ, with D = ∂R/∂x at the coordinates x that the prior maps to R, and H = −∂²ln p/∂x². For a prior that is
    normal in its coordinates H = 1, and this is the delta method.
    """
    stress = turbulence.stresses()
    scale = np.sqrt(np.outer(stress[:3], stress[:3])[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    n = prior.n_coordinate

    def miss(coordinate: FloatArray) -> FloatArray:
        return (prior.stress(coordinate) - stress) / scale

    # the size first, on a line through the centre: far from it the map is exponential
    line = np.linspace(-6.0, 6.0, 121)[:, np.newaxis] * np.eye(n)[0]
    start = line[int(np.argmin(np.sum(miss(line) ** 2, axis=-1)))]
    point = least_squares(miss, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    if not np.max(np.abs(miss(point))) < _REACHED:
        raise InputError(
            f"Prior {prior.name!r} does not hold the stresses of turbulence {turbulence.name or turbulence!r} "
            f"({', '.join(f'{value:.3g}' for value in stress)} m² s⁻²): choose a wider prior, such as 'weak'."
        )
    shift = _STEP * np.eye(n)
    slope = ((prior.stress(point + shift) - prior.stress(point - shift)) / (2.0 * _STEP)).T
    bend = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            corners = np.array([a * shift[i] + b * shift[j] for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]) * 100.0
            signs = np.array([1.0, -1.0, -1.0, 1.0])
            bend[i, j] = -float(signs @ prior.log_density(point + corners)) / (4.0 * (100.0 * _STEP) ** 2)
    bend = 0.5 * (bend + bend.T)
    if np.linalg.eigvalsh(bend)[0] <= 0.0:
        raise InputError(
            f"Prior {prior.name!r} is not concave (in its logarithm) at the stresses of turbulence "
            f"{turbulence.name!r}, so it cannot be linearized there: choose another, such as 'weak'."
        )
    covariance = slope @ np.linalg.solve(bend, slope.T)
    return np.asarray(0.5 * (covariance + covariance.T))


class _FastNoise:
    """Relative covariances of many scans that differ in directions only.

    The covariance of each pair of beams is calculated at lags that are one sample apart about zero (or L/10, if that is
    more) and grow by a fifth each beyond, and interpolated between them by a cubic spline. So ‖P C P‖² and tr(P C P)
    are a quadratic and a linear form of these few numbers, which are worked out once.
    """

    def __init__(self, like: Scan, flow: MannTurbulence, wind_speed: float, duration: float) -> None:
        self.flow, self.wind_speed = flow, wind_speed
        self.focus, self.time = like.focus_distance, like.beam_time
        self.step = wind_speed * like.scan_duration
        n = int(np.ceil(duration / like.scan_duration - 1e-9))
        finest = max(1.0, np.floor(_FINEST * flow.length_scale / self.step))
        # how far from lag 0 a covariance can have its peak: focus distances and sampling times differ
        depth = 1.0 - np.cos(min(_WIDEST + abs(like.yaw), np.pi))
        reach = np.ptp(self.focus) + depth * np.max(self.focus) + wind_speed * np.ptp(self.time)
        lags = [finest * k for k in range(int(np.ceil(reach / self.step / finest)) + 3)]
        while lags[-1] < n - 1:
            lags.append(max(lags[-1] + finest, np.floor(lags[-1] * _GROWTH)))
        half = np.array(lags)[np.array(lags) < n - 1]
        half = np.append(half, n - 1.0)
        self.lag = np.concatenate([-half[:0:-1], half])
        basis = CubicSpline(self.lag, np.eye(len(self.lag)))(np.arange(-(n - 1), n)).T
        self.square = np.array([toeplitz_inner(row, basis, n, n) for row in basis]) / n**2
        self.linear = toeplitz_trace(basis, n) / n
        self.row, self.column = np.triu_indices(like.n_beam)
        promised, _ = resolution_for(_TOLERANCE, flow.gamma)
        self.velocity_error = promised * float(flow.stresses()[0])

    def covariance(self, line_of_sight: FloatArray) -> FloatArray:
        """Return K, shape (n, n_beam, n_beam), of beam vectors (n, n_beam, 3) in the mean-wind frame.

        Its diagonal is raised by the bound on K's error that follows from the tolerance (as in `theory_noise`), so that
        a search does not find scans that profit from the error.
        """
        n, n_beam, _ = line_of_sight.shape
        place = line_of_sight * self.focus[:, np.newaxis]
        place[..., 0] -= self.wind_speed * self.time
        apart = (place[:, self.column] - place[:, self.row]).reshape(-1, 3)
        values = radial_covariance(
            line_of_sight[:, self.row].reshape(-1, 3),
            line_of_sight[:, self.column].reshape(-1, 3),
            apart[:, 1:],
            apart[:, :1] - self.step * self.lag,
            self.flow,
            tolerance=_TOLERANCE,
        )
        inner = np.einsum("pl,pl->p", values @ self.square, values).reshape(n, -1)
        mean = (values @ self.linear).reshape(n, -1)[:, self.row == self.column]
        relative = 2.0 * inner / (mean[:, self.row] * mean[:, self.column])
        full = np.empty((n, n_beam, n_beam))
        full[:, self.row, self.column] = full[:, self.column, self.row] = relative
        error = 2.0 * np.sqrt(2.0 * np.max(relative, axis=1)) * self.velocity_error / np.min(mean, axis=1)
        return np.asarray(full + error[:, np.newaxis, np.newaxis] * np.eye(n_beam))


class _FastGain:
    """What a probe volume leaves of the stresses, for any directions: a polynomial of the beam vector.

    √G_ii is even in n and smooth, so the monomials of degree six of n, which on the sphere span all even degrees up to
    six, are fitted to it at directions evenly over half the sphere.
    """

    def __init__(self, like: Scan, flow: MannTurbulence) -> None:
        self.lengths, self.which = np.unique(like.probe_length, return_inverse=True)
        number = np.arange(_N_FITTED) + 0.5
        ahead, turn = number / _N_FITTED, np.pi * (1.0 + np.sqrt(5.0)) * number  # a Fibonacci lattice
        across = np.sqrt(1.0 - ahead**2)
        vectors = np.stack([-ahead, across * np.cos(turn), across * np.sin(turn)], axis=-1)
        powers = _monomials(vectors)
        fits = []
        for length in self.lengths:
            transfer, _ = probe_transfer(vectors, np.full(_N_FITTED, length), like.probe, flow)
            fits.append(np.linalg.lstsq(powers, np.sqrt(transfer[:, :3]), rcond=None)[0])
        self.fit = np.array(fits)[self.which]

    def transfer(self, line_of_sight: FloatArray) -> FloatArray:
        """Return √(G_ii G_jj), shape (n, n_beam, 6), of beam vectors (n, n_beam, 3)."""
        root = np.einsum("nbm,bmi->nbi", _monomials(line_of_sight), self.fit)
        return np.asarray(root[..., [0, 1, 2, 0, 0, 1]] * root[..., [0, 1, 2, 1, 2, 2]])


def _monomials(vectors: FloatArray) -> FloatArray:
    return np.stack(
        [np.prod(vectors[..., list(which)], axis=-1) for which in combinations_with_replacement(range(3), _DEGREE)],
        axis=-1,
    )


def make_criterion(
    name: str,
    *,
    turbulence: str | MannTurbulence | Sequence[str | MannTurbulence] | None = None,
    wind_speed: float = 10.0,
    duration: float = 600.0,
    prior: str | Prior = "weak",
    stresses: Sequence[str] | None = None,
    weights: Sequence[float] | None = None,
    yaw_deg: float | Sequence[float] | None = None,
) -> ScanCriterion:
    """Return the criterion that a name means; parameters as in `optimize_scan`.

    Raises
    ------
    InputError
        If a name or a number is not valid, or the turbulence is missing.
    """
    check_choice(name, CRITERIA, what="criterion")
    if name != "width" and (stresses is not None or weights is not None):
        raise InputError(f"The criterion {name!r} counts the whole tensor: stresses and weights are for 'width' only.")
    if name == "trace":
        return TraceCriterion()
    given = [turbulence] if isinstance(turbulence, (str, MannTurbulence)) else list(turbulence or ())
    if not given:
        raise InputError(
            f"The criterion {name!r} needs a turbulence: give one, or several for the worst case over them."
        )
    flows = [load_turbulence(flow) if isinstance(flow, str) else flow for flow in given]
    return PosteriorCriterion(
        name,
        flows,
        wind_speed=wind_speed,
        duration=duration,
        prior=prior,
        weights=_stress_weights(stresses, weights),
        yaw=None if yaw_deg is None else _radians(yaw_deg),
    )


def _stress_weights(stresses: Sequence[str] | None, weights: Sequence[float] | None) -> FloatArray:
    """Return one weight for each stress; their sum is 1."""
    names = STRESSES if stresses is None else (stresses,) if isinstance(stresses, str) else tuple(stresses)
    if not names or len(set(names)) != len(names):
        raise InputError(f"Invalid stresses {list(names)}: name at least one, and each once.")
    for stress in names:
        check_choice(stress, STRESSES, what="stress")
    values = check_array(np.ones(len(names)) if weights is None else weights, (len(names),), what="weights")
    if np.any(values < 0.0) or not np.any(values > 0.0):
        raise InputError(f"Invalid weights {values.tolist()}: none may be below zero, and one must be above it.")
    full = np.zeros(len(STRESSES))
    full[[STRESSES.index(stress) for stress in names]] = values
    return full / np.sum(values)


def _radians(yaw_deg: float | Sequence[float]) -> list[float]:
    degrees = check_array(np.atleast_1d(np.asarray(yaw_deg, dtype=np.float64)), (None,), what="yaw_deg")
    if len(degrees) == 0 or np.any(np.abs(degrees) > 180.0):
        raise InputError(
            f"Invalid yaw_deg {degrees.tolist()}: give at least one direction, each from -180 to 180 degrees."
        )
    return [float(angle) for angle in np.deg2rad(degrees)]


def _labels(flows: Sequence[MannTurbulence], yaw: Sequence[float | None]) -> tuple[str, ...]:
    """Return a name for each state, all different."""
    names = [
        f"L={flow.length_scale:g}, gamma={flow.gamma:g}" if flow.name == "unnamed" else flow.name for flow in flows
    ]
    names = [name if names.count(name) == 1 else f"{name} ({index + 1})" for index, name in enumerate(names)]
    turned = [*("" if own is None else f", yaw {np.rad2deg(own):g}°" for own in yaw)]
    return tuple(name + words for name in names for words in turned)
