"""Probe volumes: how a lidar weights the radial velocities along its beam, and rules that sum over them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_count, check_positive
from bayes_rs.errors import InputError

PULSES: tuple[str, ...] = ("top-hat", "gaussian")
"""Shapes of a pulse."""

PROBE_ERROR = 2e-3
"""Largest relative error of a covariance of variances by the rules of this module, between beams up to 60° apart.

Measured against sums over 48 × 48 nodes, tests/test_probe.py; a variance itself is better than 2e-4."""

_N_BEAM, _N_DIFFERENCE, _N_PAIR, _N_PAIR_WIDE, _N_INNER = 16, 24, 14, 16, 4
_WEDGE = 0.07
"""Largest 2 √(ℓ_a ℓ_b) sin(angle/2) / L at which two values stand for the distribution of the mean (error 0.2 of its
square)."""
_RESOLVED = {"continuous-wave": 2.0, "pulsed": 0.7}  # rules are made finer where ℓ is more than L over this
_GAUSS_REACH = 4.5  # of r_p: beyond it lies 2e-10 of a Gaussian pulse
_N_FINE = 2000  # points of the measures from which the rules of a pulsed probe are made


class Rule(NamedTuple):
    """A quadrature over the positions ρ (on beam b) and σ (on beam a) that two probes weight, in their lengths ℓ.

    Attributes
    ----------
    difference : ndarray, shape (n,)
        D = ρ − σ.
    mean : ndarray, shape (n,)
        M = (ρ + σ) / 2.
    weight : ndarray, shape (n,)
        Weights; the sum is 1.
    """

    difference: FloatArray
    mean: FloatArray
    weight: FloatArray


@dataclass(frozen=True)
class Probe(ABC):
    """What a probe volume does to a radial velocity: v_b = ∫φ(s; f_b) v(p_b + s n_b) ds.

    A kind of probe has one symmetric shape, stretched by a length ℓ that may depend on the focus distance:
    φ(s; f) = φ₁(s/ℓ(f)) / ℓ(f). Probes do not depend on time.
    """

    kind: ClassVar[str]

    @abstractmethod
    def length(self, focus_distance: ArrayLike) -> FloatArray:
        """Return ℓ, the length by which the shape is stretched, m; 0 for a point; shape of `focus_distance` (m)."""

    @abstractmethod
    def weighting(self, distance: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return φ(s), 1/m, at distances s from the focus along the beam, m; its integral is 1."""

    @abstractmethod
    def transfer(self, wave_number: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return H(κ) = ∫φ(s) exp(iκs) ds at κ = k·n, rad/m; spectra are multiplied by H²."""

    @abstractmethod
    def beam_rule(self, *, fineness: int = 1) -> tuple[FloatArray, FloatArray]:
        """Return positions s/ℓ and weights, whose sum is 1, for φ₁ and functions that change over ℓ/fineness."""

    @abstractmethod
    def difference_rule(self, *, fineness: int = 1) -> Rule:
        """Return a rule over D for functions that may have a cusp at D = 0; its means are 0."""

    @abstractmethod
    def pair_rule(self, *, wide: bool = False, fineness: int = 1) -> Rule:
        """Return a rule over D and M for smooth functions; `wide` where the function changes much with M, too."""

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Return what fixes the probe beside the focus distances, as plain values; empty for a point."""

    @final
    def nodes(self, focus_distance: ArrayLike, *, fineness: int = 1) -> tuple[FloatArray, FloatArray]:
        """Return positions along the beams and weights, such that a probed velocity is Σ_q w_q v(p + s_q n).

        Parameters
        ----------
        focus_distance : array_like, shape (n_beam,)
            Focus distances, m.
        fineness : int
            The number of nodes is 16 times this (8 times for pulses).

        Returns
        -------
        position : ndarray, shape (n_beam, n_node)
            s_q, m.
        weight : ndarray, shape (n_node,)
            w_q; the sum is 1.
        """
        position, weight = self.beam_rule(fineness=check_count(fineness, what="fineness"))
        return self.length(check_array(focus_distance, (None,), what="focus_distance"))[
            :, np.newaxis
        ] * position, weight


@final
@dataclass(frozen=True)
class PointProbe(Probe):
    """No probe volume: the beam sees its focus point only.

    Examples
    --------
    >>> float(PointProbe().transfer(10.0, 98.0))
    1.0
    """

    kind: ClassVar[str] = "point"

    def length(self, focus_distance: ArrayLike) -> FloatArray:
        """Return zeros."""
        return np.zeros_like(np.asarray(focus_distance, dtype=np.float64))

    def weighting(self, distance: ArrayLike, focus_distance: ArrayLike) -> FloatArray:  # noqa: ARG002 - a point has none
        """Refuse: the weighting is Dirac's delta."""
        raise InputError("A point has no weighting function: it sees one place only.")

    def transfer(self, wave_number: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return ones."""
        return np.ones(np.broadcast_shapes(np.shape(wave_number), np.shape(focus_distance)))

    def beam_rule(self, *, fineness: int = 1) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - a point has no width
        """Return the one node at 0."""
        return np.zeros(1), np.ones(1)

    def difference_rule(self, *, fineness: int = 1) -> Rule:  # noqa: ARG002 - a point has no width
        """Return the one node at 0."""
        return Rule(np.zeros(1), np.zeros(1), np.ones(1))

    def pair_rule(self, *, wide: bool = False, fineness: int = 1) -> Rule:  # noqa: ARG002 - a point has no width
        """Return the one node at 0."""
        return self.difference_rule()

    def parameters(self) -> dict[str, Any]:
        """Return nothing."""
        return {}


@final
@dataclass(frozen=True)
class ContinuousWaveProbe(Probe):
    """A focused continuous-wave lidar: Lorentzian weighting.

    Parameters
    ----------
    wavelength : float, optional
        λ, m.
    aperture_radius : float, optional
        a, the radius at which the beam's intensity at the telescope is 1/e² of that on its axis, m.
    rayleigh_length : float, optional
        z_R, m, the same at all focus distances; instead of the two others.

    Raises
    ------
    InputError
        If neither z_R alone nor wavelength and aperture alone are given, or a number is not positive.

    Notes
    -----
    With ℓ = z_R,

        φ(s) = (1/π) z_R / (z_R² + s²),     H(κ) = exp(−z_R |κ|),     z_R = λ f² / (π a²),

    Sonnenschein and Horrigan (1971); the full width at half maximum is 2 z_R. It holds for f much less than πa²/λ
    (1.6 km for 28 mm): the tail that reaches the telescope is not cut off, and the weighting is symmetric.

    For two beams, D/2 and M are each distributed as ρ itself, and for wave vectors with (k·n_a)(k·n_b) > 0 the
    characteristic function exp(−ℓ_a|k·n_a| − ℓ_b|k·n_b|) is met exactly with M = ±√(1 + D²/4) in place of the
    distribution of M at given D, which has that variance (close the path in the upper half plane of D, where only the
    pole at D = 2i counts). So 1-D rules serve for pairs of beams unless the wave vectors between their normal planes
    matter; then M is integrated over its distribution too.

    References
    ----------
    Sonnenschein and Horrigan (1971), Appl. Opt. 10, 1600–1604, doi:10.1364/AO.10.001600.

    Examples
    --------
    >>> probe = ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028)
    >>> probe.length([52.0, 98.0]).round(2)
    array([1.72, 6.1 ])
    >>> float(probe.transfer(0.1, 98.0).round(3))
    0.543
    """

    wavelength: float | None = None
    aperture_radius: float | None = None
    rayleigh_length: float | None = None
    kind: ClassVar[str] = "continuous-wave"

    def __post_init__(self) -> None:
        """Check the numbers."""
        by_optics = self.wavelength is not None or self.aperture_radius is not None
        if by_optics == (self.rayleigh_length is not None):
            raise InputError(
                "Invalid continuous-wave probe: give either rayleigh_length, or wavelength and aperture_radius."
            )
        names = ("wavelength", "aperture_radius") if by_optics else ("rayleigh_length",)
        for name in names:
            value = getattr(self, name)
            if value is None:
                raise InputError(f"Invalid continuous-wave probe: {name} is missing; give it, in m.")
            object.__setattr__(self, name, check_positive(value, what=name, unit="m", where="a continuous-wave probe"))

    def length(self, focus_distance: ArrayLike) -> FloatArray:
        """Return the Rayleigh length z_R, m, shape of `focus_distance`."""
        focus = np.asarray(focus_distance, dtype=np.float64)
        if self.wavelength is None or self.aperture_radius is None:
            return np.full(focus.shape, self.rayleigh_length)
        return np.asarray(self.wavelength * focus**2 / (np.pi * self.aperture_radius**2))

    def weighting(self, distance: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return φ(s) = (1/π) z_R / (z_R² + s²), 1/m."""
        z_r = self.length(focus_distance)
        return np.asarray(z_r / (np.pi * (z_r**2 + np.asarray(distance, dtype=np.float64) ** 2)))

    def transfer(self, wave_number: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return H(κ) = exp(−z_R |κ|)."""
        return np.asarray(np.exp(-self.length(focus_distance) * np.abs(np.asarray(wave_number, dtype=np.float64))))

    def beam_rule(self, *, fineness: int = 1) -> tuple[FloatArray, FloatArray]:
        """Return positions s/z_R, graded over the tails, and weights."""
        return _cauchy_rule(_N_BEAM * fineness)

    def difference_rule(self, *, fineness: int = 1) -> Rule:
        """Return a rule over D, graded towards D = 0 and over the tails: ρ − σ is Lorentzian with twice the length."""
        return _cauchy_difference_rule(fineness)

    def pair_rule(self, *, wide: bool = False, fineness: int = 1) -> Rule:
        """Return a rule over D and M: two values of M for each D, or, if `wide`, eight."""
        return _cauchy_pair_rule(wide, fineness)

    def parameters(self) -> dict[str, Any]:
        """Return kind and Rayleigh length, or kind, wavelength and aperture, m."""
        names = ("rayleigh_length",) if self.wavelength is None else ("wavelength", "aperture_radius")
        return {"kind": self.kind, **{name: float(getattr(self, name)) for name in names}}


@final
@dataclass(frozen=True)
class PulsedProbe(Probe):
    """A pulsed lidar: the pulse, convolved with the range gate.

    Parameters
    ----------
    gate_length : float
        Length of the range gate along the beam Δp, m: c/2 times the time that a gate's signal is taken from.
    pulse : str
        ``"top-hat"`` or ``"gaussian"``.
    pulse_length : float, optional
        Length of the pulse's weighting along the beam, m: c/2 times its duration; for a Gaussian pulse its full width
        at half maximum ΔR. A top-hat pulse is as long as the gate if not given.

    Raises
    ------
    InputError
        If a length is not positive, the pulse is unknown, or a Gaussian pulse has no length.

    Notes
    -----
    Top-hat pulse of length l and gate of the same length: a triangle, Mann et al. (2009),

        φ(s) = (l − |s|) / l²  for |s| < l,     H(κ) = sinc²(κl/2),     sinc x = sin(x)/x;

    of different lengths: a trapezoid, H = sinc(κΔp/2) sinc(κl/2). Gaussian pulse exp(−s²/r_p²) with
    r_p = ΔR / (2 √ln 2), Frehlich (1997):

        φ(s) = [erf((s + Δp/2)/r_p) − erf((s − Δp/2)/r_p)] / (2Δp),     H(κ) = exp(−κ²r_p²/4) sinc(κΔp/2).

    Here ℓ = Δp. How the Doppler spectrum of a gate is turned into a velocity is left out.

    References
    ----------
    Mann et al. (2009), Meteorol. Z. 18, 135–140, doi:10.1127/0941-2948/2009/0370.
    Frehlich (1997), J. Atmos. Oceanic Technol. 14, 54–75, doi:10.1175/1520-0426(1997)014<0054:EOWTOC>2.0.CO;2.

    Examples
    --------
    >>> PulsedProbe(gate_length=30.0).weighting([0.0, 15.0, 30.0], 100.0).round(4)
    array([0.0333, 0.0167, 0.    ])
    """

    gate_length: float
    pulse: str = "top-hat"
    pulse_length: float | None = None
    kind: ClassVar[str] = "pulsed"

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_choice(self.pulse, PULSES, what="pulse of a pulsed probe")
        object.__setattr__(
            self, "gate_length", check_positive(self.gate_length, what="gate_length", unit="m", where="a pulsed probe")
        )
        if self.pulse_length is None and self.pulse == "gaussian":
            raise InputError("Invalid pulsed probe: pulse_length is missing; give a Gaussian pulse its full width, m.")
        length = self.gate_length if self.pulse_length is None else self.pulse_length
        object.__setattr__(
            self, "pulse_length", check_positive(length, what="pulse_length", unit="m", where="a pulsed probe")
        )

    @property
    def ratio(self) -> float:
        """Length of the pulse over that of the gate."""
        return float(self.pulse_length or self.gate_length) / self.gate_length

    def length(self, focus_distance: ArrayLike) -> FloatArray:
        """Return the gate length, m, at all focus distances."""
        return np.full(np.shape(focus_distance), self.gate_length)

    def weighting(self, distance: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return φ(s), 1/m; see the class."""
        s, _ = np.broadcast_arrays(np.asarray(distance, dtype=np.float64), np.asarray(focus_distance))
        return _pulse_shape(s / self.gate_length, self.pulse, self.ratio) / self.gate_length

    def transfer(self, wave_number: ArrayLike, focus_distance: ArrayLike) -> FloatArray:
        """Return H(κ); see the class."""
        k, _ = np.broadcast_arrays(np.asarray(wave_number, dtype=np.float64), np.asarray(focus_distance))
        gate, length = np.sinc(k * self.gate_length / (2.0 * np.pi)), self.ratio * self.gate_length
        if self.pulse == "gaussian":
            return np.asarray(gate * np.exp(-((k * length) ** 2) / (16.0 * np.log(2.0))))
        return np.asarray(gate * np.sinc(k * length / (2.0 * np.pi)))

    def beam_rule(self, *, fineness: int = 1) -> tuple[FloatArray, FloatArray]:
        """Return the Gaussian quadrature of the shape."""
        return _pulse_rules(self.pulse, self.ratio, fineness)[0]

    def difference_rule(self, *, fineness: int = 1) -> Rule:
        """Return a rule over D, graded towards D = 0."""
        return _pulse_rules(self.pulse, self.ratio, fineness)[1]

    def pair_rule(self, *, wide: bool = False, fineness: int = 1) -> Rule:  # noqa: ARG002 - the shape has no tails: one rule serves
        """Return a rule over D and M: the Gaussian quadrature of M at each D."""
        return _pulse_rules(self.pulse, self.ratio, fineness)[2]

    def parameters(self) -> dict[str, Any]:
        """Return kind, pulse and lengths, m."""
        return {
            "kind": self.kind,
            "pulse": self.pulse,
            "gate_length": float(self.gate_length),
            "pulse_length": self.ratio * self.gate_length,
        }


PROBES: dict[str, type[Probe]] = {
    "point": PointProbe,
    "continuous-wave": ContinuousWaveProbe,
    "pulsed": PulsedProbe,
}
"""Kinds of probe volumes, by name."""


def make_probe(kind: str, **parameters: Any) -> Probe:
    """Return a probe by the name of its kind.

    Parameters
    ----------
    kind : str
        ``"point"``, ``"continuous-wave"`` or ``"pulsed"``.
    **parameters
        Those of its class; the ones that are None count as not given.

    Returns
    -------
    probe : Probe
        The probe.

    Raises
    ------
    InputError
        If there is no such kind, or a parameter is unknown, missing or not valid.

    Examples
    --------
    >>> make_probe("pulsed", gate_length=30.0).parameters()["pulse_length"]
    30.0
    """
    check_choice(kind, tuple(PROBES), what="kind of probe")
    given = {name: value for name, value in parameters.items() if value is not None}
    known = [name for name in PROBES[kind].__dataclass_fields__ if name != "kind"]
    for name in given:
        if name not in known:
            allowed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
            raise InputError(f"Unknown parameter {name!r} of a {kind} probe: {allowed}.")
    if kind == "pulsed" and "gate_length" not in given:
        raise InputError("Invalid pulsed probe: gate_length is missing; give it, in m.")
    return PROBES[kind](**given)


def probe_difference(one: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> str:
    """Say how two probes differ, given as `Probe.parameters`, None or empty for a point; empty if they do not.

    Parameters
    ----------
    one, other : mapping or None
        The probe of the noise, and that of the scan.

    Returns
    -------
    difference : str
        Words for a message.
    """
    first, second = dict(one or {}), dict(other or {})
    same = first.keys() == second.keys() and all(
        np.isclose(value, second[name], rtol=1e-9, atol=0.0) if isinstance(value, float) else value == second[name]
        for name, value in first.items()
    )
    return "" if same else f"the probe is {_in_words(first)} in the noise and {_in_words(second)} in the scan"


def _in_words(parameters: Mapping[str, Any]) -> str:
    if not parameters:
        return "a point"
    rest = (f"{name} {value:g} m" if isinstance(value, float) else str(value) for name, value in parameters.items())
    return ", ".join(rest)


def fineness_for(probe: Probe, lengths: FloatArray, length_scale: float) -> NDArray[np.int64]:
    """Return the fineness that rules need for covariances of length scale L: the power of two not below cℓ/L.

    Parameters
    ----------
    probe : Probe
        Its kind decides c.
    lengths : ndarray, shape (..., 2)
        ℓ of the two beams of each pair, m; the longer one counts.
    length_scale : float
        L, m.

    Returns
    -------
    fineness : ndarray of int, shape (...)
        At least 1.
    """
    steps = np.maximum(_RESOLVED.get(probe.kind, 1.0) * np.max(lengths, axis=-1) / length_scale, 1.0)
    return np.asarray(2 ** np.ceil(np.log2(steps) - 1e-9).astype(np.int64), dtype=np.int64)


def needs_wide(first: FloatArray, second: FloatArray, lengths: FloatArray, length_scale: float) -> NDArray[np.bool_]:
    """Tell for which pairs of beams the wide rule is needed: 2 √(ℓ_a ℓ_b) sin(angle/2) above 0.07 L.

    Parameters
    ----------
    first, second : ndarray, shape (n, 3)
        Unit vectors of the two beams, at most 90° apart.
    lengths : ndarray, shape (n, 2)
        ℓ of the two beams, m.
    length_scale : float
        L, m.

    Returns
    -------
    wide : ndarray of bool, shape (n,)
        Whether.
    """
    apart = np.linalg.norm(second - first, axis=-1)
    return np.asarray(np.sqrt(lengths[:, 0] * lengths[:, 1]) * apart > _WEDGE * length_scale)


def _half_circle(fraction: FloatArray) -> FloatArray:
    """Return tan(π/2 · (1 − fraction)), the quantile of a Lorentzian, without cancellation near 0."""
    return np.asarray(1.0 / np.tan(0.5 * np.pi * fraction))


def _cauchy_rule(n: int) -> tuple[FloatArray, FloatArray]:
    """Return a rule for a Lorentzian weighting of length 1 and functions that are smooth, and die off far away.

    Gauss and Legendre's rule in u, where the angle atan(s) = (π/2) u (3 − u²)/2 slows down towards the ends: so the
    nodes reach over the tails, from s = 1 to some thousands, with evenly spaced logarithms.
    """
    u, weight = np.polynomial.legendre.leggauss(n)
    left = 0.5 * (1.0 - np.abs(u)) ** 2 * (2.0 + np.abs(u))
    return np.sign(u) * _half_circle(left), 0.75 * weight * (1.0 - u * u)


@lru_cache(maxsize=8)
def _cauchy_difference_rule(fineness: int) -> Rule:
    node, weight = np.polynomial.legendre.leggauss(_N_DIFFERENCE * fineness)
    u, weight = 0.5 * (node + 1.0), 0.5 * weight
    total = u**2 + (1.0 - u) ** 2
    near = np.tan(0.5 * np.pi * u**2 / total)
    half = np.where(u < 0.5, near, _half_circle((1.0 - u) ** 2 / total))
    weight = weight * u * (1.0 - u) / total**2
    return _frozen(2.0 * np.concatenate([-half, half]), 0.0, np.concatenate([weight, weight]))


@lru_cache(maxsize=16)
def _cauchy_pair_rule(wide: bool, fineness: int) -> Rule:
    outer, weight = _cauchy_rule((_N_PAIR_WIDE if wide else _N_PAIR) * fineness)
    if not wide:
        means, inner = np.sqrt(1.0 + outer**2)[:, np.newaxis], np.ones(1)
    else:  # the distribution of |M|, by its quantiles; they grow as a cube root, so the last ones are graded cubically
        node, inner = np.polynomial.legendre.leggauss(_N_INNER * min(fineness, 2))
        left = (0.5 * (1.0 - node)) ** 3
        inner = 1.5 * inner * (0.5 * (1.0 - node)) ** 2
        means = np.array([_mean_quantile(left, float(abs(t))) for t in outer])
    both = np.concatenate([means, -means], axis=1)
    weights = 0.5 * np.outer(weight, np.concatenate([inner, inner]))
    difference = np.repeat(2.0 * outer, both.shape[1])
    return _frozen(difference, both.ravel(), weights.ravel())


def _mean_quantile(left: FloatArray, t: float) -> FloatArray:
    """Return the |M| that are exceeded with probability `left` at D = 2t, for two Lorentzian positions of length 1.

    The density is (4/π) (1 + t²) / ((1 + (M + t)²) (1 + (M − t)²)), which partial fractions integrate.
    """
    low, high = np.zeros_like(left), np.full_like(left, 1e6 * (1.0 + t))
    for _ in range(100):
        middle = 0.5 * (low + high)
        if t < 1e-3:
            passed = 2.0 / np.pi * (np.arctan(middle) + middle / (1.0 + middle**2))
        else:
            logarithm = np.log((1.0 + (middle + t) ** 2) / (1.0 + (middle - t) ** 2)) / (2.0 * t)
            passed = (logarithm + np.arctan(middle + t) + np.arctan(middle - t)) / np.pi
        low, high = np.where(passed < 1.0 - left, middle, low), np.where(passed < 1.0 - left, high, middle)
    return 0.5 * (low + high)


def _pulse_shape(s: FloatArray, pulse: str, ratio: float) -> FloatArray:
    """Return φ₁ for a gate of length 1 and a pulse `ratio` times as long."""
    if pulse == "gaussian":
        r_p = ratio / (2.0 * np.sqrt(np.log(2.0)))
        return np.asarray(0.5 * (scipy.special.erf((s + 0.5) / r_p) - scipy.special.erf((s - 0.5) / r_p)))
    return np.clip(0.5 * (1.0 + ratio) - np.abs(s), 0.0, min(1.0, ratio)) / ratio


@lru_cache(maxsize=32)
def _pulse_rules(pulse: str, ratio: float, fineness: int) -> tuple[tuple[FloatArray, FloatArray], Rule, Rule]:
    """Return the rules of a pulsed probe: for one beam, for differences, for pairs."""
    reach = 0.5 * (1.0 + ratio)
    if pulse == "gaussian":
        reach = 0.5 + _GAUSS_REACH * ratio / (2.0 * np.sqrt(np.log(2.0)))
    s = reach * ((2.0 * np.arange(_N_FINE) + 1.0) / _N_FINE - 1.0)
    beam = _gauss_rule(s, _pulse_shape(s, pulse, ratio), _N_BEAM // 2 * fineness)
    root = np.sqrt(2.0 * reach) * (np.arange(_N_FINE // 2) + 0.5) / (_N_FINE // 2)
    difference = root**2
    joint = _pulse_shape(s + 0.5 * difference[:, None], pulse, ratio) * _pulse_shape(
        s - 0.5 * difference[:, None], pulse, ratio
    )
    density = joint.sum(axis=1) * root  # of √D
    fine, fine_weight = _gauss_rule(root, density, _N_DIFFERENCE // 2 * fineness)
    coarse, coarse_weight = _gauss_rule(root, density, _N_PAIR // 2 * fineness)
    columns = []
    for value, weight in zip(coarse**2, coarse_weight, strict=True):
        at_d = _pulse_shape(s + 0.5 * value, pulse, ratio) * _pulse_shape(s - 0.5 * value, pulse, ratio)
        mean, inner = _gauss_rule(s, at_d, _N_INNER * min(fineness, 2))
        columns += [
            (sign * value, m, 0.5 * weight * w) for sign in (-1.0, 1.0) for m, w in zip(mean, inner, strict=True)
        ]
    pair = np.array(columns).T
    return (
        beam,
        _frozen(np.concatenate([-(fine**2), fine**2]), 0.0, 0.5 * np.concatenate([fine_weight, fine_weight])),
        _frozen(pair[0], pair[1], pair[2]),
    )


def _gauss_rule(points: FloatArray, weights: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the n-point Gaussian quadrature of a measure of many points: Stieltjes, then Golub and Welsch (1969).

    A measure of no more than n points is its own quadrature, and is returned with the points that it has.
    """
    held = weights > 0.0
    if np.count_nonzero(held) <= n:
        return points[held], weights[held] / np.sum(weights[held])
    measure = weights / np.sum(weights)
    diagonal, off = np.zeros(n), np.zeros(n)
    before, now = np.zeros_like(points), np.ones_like(points)
    for index in range(n):
        diagonal[index] = np.sum(measure * points * now * now)
        following = (points - diagonal[index]) * now - (off[index - 1] if index else 0.0) * before
        off[index] = np.sqrt(np.sum(measure * following * following))
        before, now = now, following / off[index]
    values, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off[:-1], 1) + np.diag(off[:-1], -1))
    return values, vectors[0] ** 2


def _frozen(difference: FloatArray, mean: FloatArray | float, weight: FloatArray) -> Rule:
    rule = Rule(difference, np.broadcast_to(np.asarray(mean), difference.shape), weight / np.sum(weight))
    for array in (rule.difference, rule.weight):
        array.flags.writeable = False
    return rule
