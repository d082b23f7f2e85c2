"""Criteria of a scan: one number for how well it would know R, before anything is measured."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayes_rs._validation import FloatArray, check_array, check_choice, check_non_negative, check_positive
from bayes_rs.design.beam_space import BeamSpace
from bayes_rs.errors import InputError, NotPositiveDefiniteError, in_short
from bayes_rs.geometry.forward import RANK_TOLERANCE, design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import described, option
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.theory.pairs import seconds_of_pairs
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

TWICE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often each stress stands among the nine elements of the tensor."""
_PROB = 0.9
_LEAST_SECONDS = 2e-3  # of a noise of few beams
_STEP = 1e-4  # central differences of the prior's map
_REACHED = 1e-6  # the prior's tensor must come so close to the turbulence's, relative to uu


@described
@dataclass(frozen=True, kw_only=True)
class CriterionOptions:
    """What a scan is judged by.

    Raises
    ------
    InputError
        If a value is not valid.
    """

    criterion: str = option(
        "width",
        "width: expected width of the 90 % credible intervals, over uu; trace: total variance of R by least squares "
        "under equal and independent noise, for which nothing of the following matters",
        choices="bayes_rs.design.scan_criteria:CRITERIA",
    )
    stresses: Sequence[str] = option(
        (),
        "Stresses whose widths count, all if not given; with a weight as vv=3",
        flag="--stress",
        metavar="STRESS[=WEIGHT]",
    )
    turbulence: str | MannTurbulence | tuple[str | MannTurbulence, ...] = option(
        "fu-2022",
        "Turbulence of the flow, by its name or file; of several, the worst case counts",
        choices="bayes_rs.models:TURBULENCES",
        open=True,
    )
    prior: str | Prior = option("weak", "Prior", choices="bayes_rs.priors.registry:PRIORS", open=True)
    wind_speed: float = option(10.0, "Mean wind speed", unit="m/s")
    duration: float = option(600.0, "Length of a record", unit="s")
    yaw_deg: float | Sequence[float] | None = option(
        None,
        "Wind direction relative to the lidar's axis, that of the scan if not given; of several, the worst case counts",
        unit="degrees",
        flag="--yaw",
    )

    def __post_init__(self) -> None:
        check_choice(self.criterion, tuple(CRITERIA), what="criterion")
        if self.criterion != "width" and self.stresses:
            raise InputError(
                f"The criterion {self.criterion!r} counts the whole tensor: stresses are for 'width' only."
            )
        check_positive(self.wind_speed, what="wind_speed", unit="m/s")
        check_positive(self.duration, what="duration", unit="s")
        _ = self.weights, self.yaws

    @property
    def weights(self) -> FloatArray:
        """One weight for each stress; their sum is 1."""
        given = [self.stresses] if isinstance(self.stresses, str) else list(self.stresses or STRESSES)
        names = [text.partition("=")[0] for text in given]
        if len(set(names)) != len(names):
            raise InputError(f"Invalid stresses {given}: name each once.")
        full = np.zeros(len(STRESSES))
        for text, name in zip(given, names, strict=True):
            check_choice(name, STRESSES, what="stress")
            full[STRESSES.index(name)] = _weight(text, name)
        if not np.any(full > 0.0):
            raise InputError(f"Invalid stresses {given}: one must have a weight above zero.")
        return full / np.sum(full)

    @property
    def yaws(self) -> list[float | None]:
        """Wind directions, rad; None for that of the scan."""
        if self.yaw_deg is None:
            return [None]
        degrees = check_array(np.atleast_1d(np.asarray(self.yaw_deg)), (None,), what="yaw_deg")
        if len(degrees) == 0 or np.any(np.abs(degrees) > 180.0):
            raise InputError(
                f"Invalid yaw_deg {degrees.tolist()}: give at least one direction, each from -180 to 180 degrees."
            )
        return list(np.deg2rad(degrees).tolist())

    def flows(self) -> list[MannTurbulence]:
        """Return the turbulences."""
        given = [self.turbulence] if isinstance(self.turbulence, (str, MannTurbulence)) else list(self.turbulence)
        if not given:
            raise InputError("Invalid turbulence []: give one, or several for the worst case over them.")
        return [as_turbulence(flow) for flow in given]

    def check_size(self, scan: Scan) -> None:
        """Refuse a scan whose noise is too large to be computed."""
        if self.criterion == "width":
            sample_counts(scan, self.duration)

    def seconds(self, scan: Scan) -> float:
        """Estimate the time of one evaluation, s."""
        if self.criterion != "width":
            return 1e-6 * scan.n_beam
        n_state = len(self.flows()) * len(self.yaws)
        return n_state * (_LEAST_SECONDS + seconds_of_pairs(scan, self.duration / scan.scan_duration))

    def make(self) -> ScanCriterion:
        """Return the criterion."""
        return CRITERIA[self.criterion](self)


class ScanCriterion(ABC):
    """The narrow interface of all criteria.

    Attributes
    ----------
    name : str
        Its name.
    states : tuple of str
        What it is evaluated for; the criterion is the largest value over them.
    step : float
        Step of the differences that stand for its slope, rad.
    precision : float
        Change of its logarithm at which a search ends.
    """

    name: str
    states: tuple[str, ...]
    step: float
    precision: float

    @abstractmethod
    def of(self, scan: Scan) -> FloatArray:
        """Return the value of each state, shape (n_state,)."""

    def of_many(self, direction: FloatArray, like: Scan) -> FloatArray:
        """Return values, shape (n, n_state); infinite where beams are too close to each other for the noise's error.

        `direction`, shape (n, n_beam, 3), replaces the beam vectors of the scan `like`.
        """
        values = np.full((len(direction), len(self.states)), np.inf)
        for row, one in zip(values, direction, strict=True):
            try:
                row[:] = self.of(replace(like, beam_direction=one))
            except NotPositiveDefiniteError:
                continue
        return values

    def possible(self, spaces: list[BeamSpace]) -> list[BeamSpace]:
        """Return the kinds of scans that can have a value.

        Raises
        ------
        InputError
            If there is none.
        """
        return spaces

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
    step, precision = 1e-6, 1e-13

    def __init__(self, options: CriterionOptions) -> None:
        del options

    def of(self, scan: Scan) -> FloatArray:
        """Return the value, shape (1,)."""
        return trace_criterion(scan.line_of_sight)[np.newaxis]

    def of_many(self, direction: FloatArray, like: Scan) -> FloatArray:  # noqa: ARG002 - rotations change nothing
        """Return the values, shape (n, 1); infinite where not all stresses are seen."""
        return trace_criterion(direction)[:, np.newaxis]

    def possible(self, spaces: list[BeamSpace]) -> list[BeamSpace]:
        """Return the kinds of scans that see all stresses."""
        if spaces[0].n_beams < len(STRESSES):
            raise InputError(
                f"Invalid n_beams {spaces[0].n_beams}: the criterion 'trace' needs at least {len(STRESSES)} beams to "
                "see all six stresses; use 'width', in which the prior helps."
            )
        kept = [space for space in spaces if space.centre or space.cones != 1]
        if not kept:
            raise InputError(
                "A single cone without a beam along its axis never sees all six stresses, so the criterion 'trace' has "
                "no value: allow a beam along the axis or more cones, or use 'width'."
            )
        return kept

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


class WidthCriterion(ScanCriterion):
    """Expected width of the 90 % credible intervals over uu, a weighted mean over the stresses.

    Parameters
    ----------
    options : CriterionOptions
        Weights, prior, wind speed and record length, and the states: each turbulence with each wind direction.

    Notes
    -----
    A record is taken whose variances are those expected at the turbulence's R, and the posterior is linearized there:
    with g_b = ∂ ln E[y_b]/∂R, Σ = ln(1 + K) of the log-normal likelihood, and C₀ the covariance of the prior,
    linearized at R,

        C = C₀ − C₀ gᵀ (g C₀ gᵀ + Σ)⁻¹ g C₀,

    which is the Gauss–Newton covariance at the mode, but for the shift of the mode by the prior. The 90 % interval of a
    variance R_ii is taken as log-normal, 2 R_ii sinh(1.645 √C_ii / R_ii), that of a covariance as normal.
    """

    name = "width"
    step, precision = 1e-3, 1e-5  # the noise is smooth piece by piece only: a search for the next digit may never end

    def __init__(self, options: CriterionOptions) -> None:
        flows, yaws = options.flows(), options.yaws
        self.turbulence = tuple(flow for flow in flows for _ in yaws)
        self.yaw = tuple(yaws) * len(flows)
        self.states = _labels(flows, yaws)
        self.wind_speed, self.duration, self.weights = options.wind_speed, options.duration, options.weights
        self.prior = make_prior(options.prior)
        self._before = [local_prior_covariance(self.prior, flow) for flow in flows for _ in yaws]

    def of(self, scan: Scan) -> FloatArray:
        """Return the value of each state, shape (n_state,)."""
        uu = np.array([flow.stresses()[0] for flow in self.turbulence])
        return np.asarray(self.widths(scan) @ self.weights / uu)

    def widths(self, scan: Scan) -> FloatArray:
        """Return the expected 90 % widths of the six stresses, shape (n_state, 6), m² s⁻²."""
        found = []
        for yaw, flow, before in zip(self.yaw, self.turbulence, self._before, strict=True):
            noise = self._noise(scan if yaw is None else scan.with_yaw(yaw), flow)
            found.append(_widths(_posterior(noise, flow.stresses(), before), flow.stresses()))
        return np.array(found)

    def in_words(self) -> str:
        """Say what the number is."""
        chosen = [name for name, weight in zip(STRESSES, self.weights, strict=True) if weight > 0.0]
        equal = len(set(self.weights[self.weights > 0.0].tolist())) == 1
        return (
            f"width: expected width of the 90 % interval over uu, {'mean' if equal else 'weighted mean'} of "
            f"{', '.join(chosen)}"
        )

    def _noise(self, scan: Scan, flow: MannTurbulence) -> Noise:
        return theory_noise(scan, flow, wind_speed=self.wind_speed, duration=self.duration)


CRITERIA: dict[str, type[WidthCriterion] | type[TraceCriterion]] = {"width": WidthCriterion, "trace": TraceCriterion}
"""The criteria by name; each is made of `CriterionOptions`."""


def _posterior(noise: Noise, stress: FloatArray, before: FloatArray) -> FloatArray:
    """Return C, shape (6, 6), m⁴ s⁻⁴; see `WidthCriterion`."""
    slope = noise.gain[0] / (noise.gain[0] @ stress)[:, np.newaxis]
    seen = slope @ before
    data = seen @ slope.T + np.log1p(noise.covariance[0])
    return np.asarray(before - seen.T @ np.linalg.solve(data, seen))


def _widths(covariance: FloatArray, stress: FloatArray) -> FloatArray:
    spread = scipy.special.ndtri(0.5 + 0.5 * _PROB) * np.sqrt(np.diag(covariance))
    return np.concatenate([2.0 * stress[:3] * np.sinh(spread[:3] / stress[:3]), 2.0 * spread[3:]])


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
    point = scipy.optimize.least_squares(miss, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
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


def _weight(text: str, name: str) -> float:
    """Return the weight behind the name of a stress, which is 1 if there is none."""
    words = text.partition("=")[2] if "=" in text else "1"
    try:
        return check_non_negative(float(words), what="weight", unit="")
    except ValueError as error:  # also an InputError
        raise InputError(
            f"Invalid weight of {name} {in_short(words)}: it must be a finite number, zero or above, and not extreme."
        ) from error


def _labels(flows: Sequence[MannTurbulence], yaw: Sequence[float | None]) -> tuple[str, ...]:
    """Return a name for each state, all different."""
    names = [
        f"L={flow.length_scale:g}, gamma={flow.gamma:g}" if flow.name == "unnamed" else flow.name for flow in flows
    ]
    names = [name if names.count(name) == 1 else f"{name} ({index + 1})" for index, name in enumerate(names)]
    turned = [*("" if own is None else f", yaw {np.rad2deg(own):g}°" for own in yaw)]
    return tuple(name + words for name in names for words in turned)
