"""What the page of scans answers: interval widths of a scan in a flow, beside the prior's and those of presets."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.design.scene import DrawnPrior, Scene, try_scene
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_of
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.posteriors.prior_at_size import shapes_of
from bayes_rs.priors.registry import make_prior
from bayes_rs.theory.pair_moments import COARSE
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.two_point import covariance_table

PROB = 0.9
"""Probability of the intervals, with equal tails."""
N_RECORD = 32
"""Records that a width is the mean of. `compare` takes 128; the page says the Monte-Carlo error of fewer."""
GAMMAS = tuple(0.5 * step for step in range(11))
"""Where Γ can be: tables of the spectral tensor are made once for each."""
PRESETS = ("2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam", "pulsed-4-beam")
"""Shipped scans of nacelle lidars whose noise takes a moment."""
_TOLERANCE = 1e-3
"""Largest error of a velocity covariance, relative to the variance of u: it moves widths by up to 0.02 %, and a
turbulence's tables take half the time that they do with the usual 1e-4."""
_PRIOR = "weak"
_SEED = 1
_MOST_KEPT = 64  # answers, 1.6 MB each
_LEAST_BEAMS = {True: 2, False: 1}


@dataclass(frozen=True, kw_only=True)
class Slider:
    """A number that the page asks for.

    Parameters
    ----------
    name : str
        The field of `ScanChoice` or `FlowChoice`.
    label, unit : str
        In words.
    low, high, step : float
        Its range and steps.
    """

    name: str
    label: str
    unit: str
    low: float
    high: float
    step: float


SCAN_SLIDERS = (
    Slider(name="opening_angle_deg", label="Half-cone opening angle", unit="°", low=5.0, high=60.0, step=1.0),
    Slider(name="focus_distance", label="Distance", unit="m", low=20.0, high=300.0, step=2.0),
    Slider(name="n_beams", label="Beams, all", unit="", low=1.0, high=50.0, step=1.0),
    Slider(name="duration", label="Length of a record", unit="s", low=60.0, high=3600.0, step=60.0),
)
FLOW_SLIDERS = (
    Slider(name="wind_speed", label="Wind speed", unit="m/s", low=3.0, high=25.0, step=0.5),
    Slider(name="length_scale", label="Length scale L of the turbulence", unit="m", low=10.0, high=200.0, step=1.0),
    Slider(name="gamma", label="Anisotropy Γ", unit="", low=GAMMAS[0], high=GAMMAS[-1], step=0.5),
    Slider(name="uu", label="Variance uu of the flow", unit="m² s⁻²", low=0.1, high=5.0, step=0.1),
)


def number_of(value: object) -> float:
    """Return a number of the page, which comes as one or as its text; NaN for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return np.nan
    try:
        return float(value)
    except ValueError:
        return np.nan


def _check(slider: Slider, value: object) -> float:
    """Return a number of the page, or refuse what no slider gives."""
    number = number_of(value)
    if not slider.low <= number <= slider.high:
        unit = f" {slider.unit}" if slider.unit else ""
        raise InputError(
            f"Invalid {slider.name} {in_short(value)}: {slider.label} goes from {slider.low:g} to "
            f"{slider.high:g}{unit}."
        )
    return number


@dataclass(frozen=True, kw_only=True)
class FlowChoice:
    """The flow of the page: a Mann turbulence, the wind, and the length of a record.

    Raises
    ------
    InputError
        If a number is outside what its slider gives.
    """

    wind_speed: float = 10.0
    length_scale: float = 61.0
    gamma: float = 3.0
    uu: float = 1.4
    duration: float = 600.0

    def __post_init__(self) -> None:
        for slider in (*FLOW_SLIDERS, SCAN_SLIDERS[3]):
            object.__setattr__(self, slider.name, _check(slider, getattr(self, slider.name)))
        if self.gamma not in GAMMAS:
            raise InputError(f"Invalid gamma {self.gamma:g}: it goes in steps of 0.5.")

    def turbulence(self) -> MannTurbulence:
        """Return the turbulence whose variance of u is `uu`: all stresses grow with the dissipation."""
        unit = _unit_turbulence(self.length_scale, self.gamma)
        return replace(unit, dissipation=self.uu / float(unit.stresses()[0]))

    @property
    def intensity(self) -> float:
        """Turbulence intensity σ_u / U."""
        return float(np.sqrt(self.uu) / self.wind_speed)


@lru_cache(maxsize=64)
def _unit_turbulence(length_scale: float, gamma: float) -> MannTurbulence:
    return MannTurbulence(dissipation=1.0, length_scale=length_scale, gamma=gamma, name="the page's")


@dataclass(frozen=True, kw_only=True)
class ScanChoice:
    """The scan of the page: one cone, with or without a beam along its axis, once a second.

    Raises
    ------
    InputError
        If a number is outside what its slider gives, or there are too few beams.
    """

    opening_angle_deg: float = 30.0
    focus_distance: float = 98.0
    n_beams: int = 6
    centre: bool = True

    def __post_init__(self) -> None:
        for slider in SCAN_SLIDERS[:2]:
            object.__setattr__(self, slider.name, _check(slider, getattr(self, slider.name)))
        object.__setattr__(self, "n_beams", int(_check(SCAN_SLIDERS[2], self.n_beams)))
        if self.n_beams < _LEAST_BEAMS[self.centre]:
            raise InputError(
                "Invalid n_beams 1: with a beam along the axis there are at least 2; or leave that beam out."
            )

    def scan(self) -> Scan:
        """Return the scan, whose beams see points."""
        return load_scan(
            "6-beam",
            opening_angle_deg=self.opening_angle_deg,
            focus_distance=self.focus_distance,
            n_beams=self.n_beams,
            centre=self.centre,
        )


@dataclass(frozen=True, eq=False)
class Answer:
    """What a scan would know of a flow.

    Parameters
    ----------
    label : str
        What it is called.
    n_beam : int
        Its beams.
    sight : str
        What it sees of R, in words.
    truth : ndarray, shape (6,)
        Stresses of the flow that a record holds, m² s⁻².
    width, error : ndarray, shape (6,)
        Mean width of the 90 % intervals over the records, m² s⁻², and an upper bound on its Monte-Carlo standard error:
        the spread of the records over the root of their number, as if they were not drawn evenly.
    decided : ndarray, shape (6,)
        What the data decided of each stress, mean over the records.
    learnt : float
        Stresses learnt, of six.
    draws : ndarray, shape (n_record, n_draw, 6)
        Posterior draws of the simulated records, m² s⁻².
    """

    label: str
    n_beam: int
    sight: str
    truth: FloatArray
    width: FloatArray
    error: FloatArray
    decided: FloatArray
    learnt: float
    draws: FloatArray = field(repr=False)

    @property
    def of_prior(self) -> list[bool]:
        """Which stresses are the prior's more than the data's."""
        return [bool(one) for one in is_priors(self.decided)]


def answer(scan: ScanChoice | str, flow: FlowChoice) -> Answer:
    """Return what a scan would know of a flow.

    Parameters
    ----------
    scan : ScanChoice or str
        The page's scan, or the name of a preset.
    flow : FlowChoice
        The flow.

    Raises
    ------
    InputError
        If a record is too short for the scan, or the preset is not one of `PRESETS`.
    """
    if isinstance(scan, str) and scan not in PRESETS:
        raise InputError(f"Invalid preset {scan!r}: choose of {', '.join(PRESETS)}.")
    made = load_scan(scan) if isinstance(scan, str) else scan.scan()
    turbulence = flow.turbulence()
    scene = Scene.at(made, turbulence, wind_speed=flow.wind_speed, duration=flow.duration, tolerance=_TOLERANCE)
    found = try_scene(scene.records("fast", N_RECORD, _SEED), scene, known_prior(), seed=_SEED)
    low, high = found.interval(PROB)
    width = high - low
    return Answer(
        label=scan if isinstance(scan, str) else "this scan",
        n_beam=made.n_beam,
        sight=sight(made).in_words(),
        truth=scene.truth,
        width=width.mean(axis=0),
        error=width.std(axis=0, ddof=1) / np.sqrt(len(width)),
        decided=found.decided.mean(axis=0),
        learnt=float(found.learnt.mean()),
        draws=found.draws.reshape(N_RECORD, -1, len(STRESSES)).astype(np.float32),  # for pictures,
    )


class Answers:
    """Answers that were given before, the newest ones."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[ScanChoice | str, FlowChoice], Answer] = OrderedDict()

    def known(self, scan: ScanChoice | str, flow: FlowChoice) -> Answer | None:
        """Return an answer that was given before, or None."""
        return self._kept.get((scan, flow))

    def get(self, scan: ScanChoice | str, flow: FlowChoice) -> Answer:
        """Return an answer, which is made if it is not known."""
        found = self.known(scan, flow)
        if found is None:
            found = self._kept[scan, flow] = answer(scan, flow)
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        return found


@cache
def known_prior() -> DrawnPrior:
    """Return the prior that scans are tried with, with its draws."""
    return DrawnPrior.of(make_prior(_PRIOR))


@cache
def _prior_shape() -> FloatArray:
    """Return draws of the prior's shape R/(uu + vv + ww), shape (n, 6)."""
    return shapes_of(known_prior().draws)


def prior_at_size(draws: FloatArray) -> FloatArray:
    """Return draws of the prior's shape times the sizes uu + vv + ww of a posterior's draws (n, 6), shape (n, 6)."""
    shape = _prior_shape()[: len(draws)]
    return np.asarray(shape * draws[: len(shape), :3].sum(axis=1, keepdims=True))


def prior_widths_at(truth: FloatArray) -> FloatArray:
    """Return the widths of the prior's 90 % intervals where uu + vv + ww is known to be that of `truth`, shape (6,)."""
    low, high = interval_of(_prior_shape().T, PROB)
    return np.asarray((high - low) * truth[:3].sum())


def make_ready() -> None:
    """Make what the slider of Γ would wait for, its neighbours first: stresses and covariances of every Γ."""
    for gamma in sorted(GAMMAS, key=lambda gamma: abs(gamma - FlowChoice.gamma)):
        _unit_turbulence(1.0, gamma).stresses()
        for tolerance in (_TOLERANCE, COARSE):
            covariance_table(gamma, np.zeros((1, 3)), tolerance=tolerance)
