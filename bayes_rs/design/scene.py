"""A scan in a flow: its noise, records to try it on, and the posteriors of these records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.design.trial_records import drawn_records, simulated_records
from bayes_rs.fits.batch import fit_batch, join_draws
from bayes_rs.fits.columns import N_PRIOR_DRAW
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.parts import batch_size
from bayes_rs.fits.plan import PRIOR_SEED
from bayes_rs.fits.prepare import prepare
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.intervals import EQUAL_TAILED, interval_of
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.decided import PriorRoom, leading_variance, what_data_decided
from bayes_rs.priors.registry import Prior
from bayes_rs.processor import one_thread
from bayes_rs.theory.sonic_theory import sonic_moments
from bayes_rs.turbulence.mann import MannTurbulence


@dataclass(frozen=True, eq=False)
class Scene:
    """A scan in a flow: its noise, and the stresses that a fit aims at.

    Parameters
    ----------
    scan : Scan
        The scan.
    flow : MannTurbulence
        The turbulence.
    noise : Noise
        The noise of the scan in it.
    target : str
        Which R is the truth: ``"record"`` or ``"ensemble"``.
    truth : ndarray, shape (6,)
        That R, m² s⁻².
    """

    scan: Scan
    flow: MannTurbulence
    noise: Noise
    target: str
    truth: FloatArray

    @classmethod
    def at(
        cls,
        scan: Scan,
        flow: MannTurbulence,
        *,
        wind_speed: float,
        duration: float,
        target: str = "record",
        tolerance: float = 1e-4,
    ) -> Scene:
        """Return the scene of a scan in a flow, whose noise is made by theory.

        Parameters
        ----------
        scan, flow, target
            As for the class.
        wind_speed : float
            Mean wind speed, m/s.
        duration : float
            Length of a record, s.
        tolerance : float
            Largest error of a velocity covariance, relative to the variance of u.

        Raises
        ------
        InputError
            If a record is too short for the scan, or a number is not valid.
        """
        noise = theory_noise(scan, flow, wind_speed=wind_speed, duration=duration, yaw=scan.yaw, tolerance=tolerance)
        return cls(scan, flow, noise, target, truth_of(scan, flow, wind_speed, duration, target, tolerance))

    def records(self, kind: str, count: int, seed: int) -> xr.Dataset:
        """Return records: ``"fast"``, drawn evenly from the noise, or ``"full"``, simulated."""
        noise = self.noise
        if kind == "full":
            return simulated_records(self.scan, self.flow, float(noise.wind_speed[0]), noise.duration, count, seed)
        mean = noise.gain[0] @ self.truth * (1.0 + (noise.bias[0] if self.target == "ensemble" else 0.0))
        return drawn_records(self.scan, noise, mean, self.truth, count, seed)


def truth_of(
    scan: Scan, flow: MannTurbulence, wind_speed: float, duration: float, target: str, tolerance: float = 1e-4
) -> FloatArray:
    """Return the stresses that the fit aims at, shape (6,)."""
    if target == "ensemble":
        return flow.stresses()
    one = scan.select(scan.beam[:1])
    moments = sonic_moments(one, flow, wind_speed=wind_speed, duration=duration, yaw=scan.yaw, tolerance=tolerance)
    return np.asarray(moments.mean, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class DrawnPrior:
    """A prior with its draws, shape (n, 6), m² s⁻²: the same for every scan."""

    prior: Prior
    draws: FloatArray

    @classmethod
    def of(cls, prior: Prior) -> DrawnPrior:
        """Return a prior with the draws that a fit compares its posteriors with."""
        return cls(prior, prior.draw(N_PRIOR_DRAW, PRIOR_SEED))

    def widths(self, prob: float = 0.9, interval: str = EQUAL_TAILED) -> FloatArray:
        """Return the widths of the intervals of the six stresses, shape (6,), m² s⁻²."""
        low, high = interval_of(self.draws.T, prob, interval)
        return np.asarray(high - low)


@dataclass(frozen=True, eq=False)
class TrialPosterior:
    """Posteriors of records of a scene.

    Parameters
    ----------
    draws : ndarray, shape (n_record, n_chain, n_draw, 6)
        Draws of the stresses, m² s⁻².
    decided : ndarray, shape (n_record, 6)
        What the data decided of each stress (`what_data_decided`).
    learnt : ndarray, shape (n_record,)
        Stresses learnt, of six.
    """

    draws: FloatArray
    decided: FloatArray
    learnt: FloatArray

    @property
    def flat(self) -> FloatArray:
        """The draws of all chains after one another, shape (n_record, n, 6), m² s⁻²."""
        return self.draws.reshape(len(self.draws), -1, self.draws.shape[-1])

    def interval(self, prob: float, interval: str = EQUAL_TAILED) -> tuple[FloatArray, FloatArray]:
        """Return the ends of the intervals of the stresses of every record, each of shape (n_record, 6), m² s⁻²."""
        return interval_of(np.moveaxis(self.flat, 1, -1), prob, interval)


def try_scene(records: xr.Dataset, scene: Scene, prior: DrawnPrior, *, seed: int) -> TrialPosterior:
    """Sample the posteriors of records of a scene.

    Parameters
    ----------
    records : Dataset
        From `Scene.records`.
    scene : Scene
        The scene.
    prior : DrawnPrior
        The prior.
    seed : int
        Seed of the sampler.

    Returns
    -------
    found : TrialPosterior
        The draws are bit by bit those of `fit` with this noise, prior, target and seed; what a fit does for data of
        the real air, as alarms, tables and the campaign, is left out.
    """
    options = FitOptions(
        seed=seed, prior=prior.prior, target=scene.target, sampler="auto", draws="float64", campaign="off"
    )
    with one_thread():
        _, noise, batch = prepare(records, scene.scan, scene.noise, options)
        size = batch_size(noise.n_beam)
        parts = [
            fit_batch(batch.take(slice(first, first + size)), noise, options, predict=False)
            for first in range(0, len(batch), size)
        ]
        draws = join_draws(parts).chains.stress
        room = PriorRoom.of(prior.draws, leading_variance(design_matrix(scene.scan.at_yaw(0.0))))
        return TrialPosterior(draws, *what_data_decided(draws, room))
