"""One batch of records, from variances and noise to draws of their posteriors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.covariance_data import pair_likelihood
from bayes_rs.fits.covariance_states import PairData
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.uncertain_length import averaged_noise, averaged_reduced
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.log_normal import REFERENCE_STRESS, Likelihood, make_likelihood, reduced_log_normal_likelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.likelihoods.reduced_noise import ReducedNoise, reduced
from bayes_rs.likelihoods.scattered import (
    scattered,
    scattered_reduced,
    scattered_sonic,
    shifted,
    shifted_reduced,
)
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.record_noise import RecordNoise, SonicNoise
from bayes_rs.posteriors.nuisance import Nuisances, RecordNuisances
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling import sample
from bayes_rs.posteriors.sampling.chains import BLOCK, Chains
from bayes_rs.posteriors.sampling.streams import RecordStreams
from bayes_rs.posteriors.sonic import draw_sonic
from bayes_rs.priors.registry import Prior


@dataclass(frozen=True)
class Batch:
    """The data of some records.

    Parameters
    ----------
    variance : ndarray, shape (n_record, n_beam)
        Radial variances, m² s⁻².
    used : ndarray of bool, shape (n_record, n_beam)
        Which of them count.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed, m/s.
    yaw : ndarray, shape (n_record,)
        Wind direction relative to the lidar axis, rad.
    key : ndarray of int, shape (n_record,)
        What makes each record's random stream its own.
    flow : dict of str to ndarray, shape (n_record,)
        The records' own ``length_scale`` (m) and ``gamma``, where they have them.
    turn : ndarray, shape (n_record, 6, 6), optional
        What takes the gains to the records' own tilt and roll (`gain_turn`), where those were measured.
    instrument_noise : ndarray, shape (n_record, n_beam), optional
        Variance of the instrument's noise, m² s⁻², where the records hold their own; it replaces that of the options.
    instrument_noise_sd : ndarray, shape (n_record, n_beam), optional
        Its standard deviation over the beam's variance. The error is the same for all beams of a record.
    noise_common_sd : ndarray, shape (n_record,), optional
        Standard deviation of the part of that error that is the same in all records, m² s⁻².
    yaw_sd : ndarray, shape (n_record,), optional
        Standard deviations of the errors of the records' own directions, degrees, where the nuisances leave it to them.
    scatter : ndarray, shape (n_record, 2), optional
        Relative variance of a record's variances beyond theory: what all beams share, and each beam's own.
    length_log_sd : ndarray, shape (n_record,), optional
        Standard deviations of the records' own ln L, which their noise is averaged over.
    probe_sd : ndarray, shape (n_record, n_beam), optional
        Standard deviation of ln y by the unknown length of the probe volume, the same error for all beams of a record.
    group : ndarray of str, shape (n_record,), optional
        The class of each record within a campaign.
    pairs : PairData, optional
        The correlations between beams, where they are used.
    """

    variance: FloatArray
    used: NDArray[np.bool_]
    wind_speed: FloatArray
    yaw: FloatArray
    key: NDArray[np.int64]
    flow: dict[str, FloatArray] = field(default_factory=dict)
    turn: FloatArray | None = None
    instrument_noise: FloatArray | None = None
    instrument_noise_sd: FloatArray | None = None
    noise_common_sd: FloatArray | None = None
    yaw_sd: FloatArray | None = None
    scatter: FloatArray | None = None
    length_log_sd: FloatArray | None = None
    probe_sd: FloatArray | None = None
    group: NDArray[np.str_] | None = None
    pairs: PairData | None = None

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self.variance)

    def take(self, records: NDArray[np.int64] | slice) -> Batch:
        """Return some of the records."""
        return Batch(
            self.variance[records],
            self.used[records],
            self.wind_speed[records],
            self.yaw[records],
            self.key[records],
            {name: values[records] for name, values in self.flow.items()},
            None if self.turn is None else self.turn[records],
            None if self.instrument_noise is None else self.instrument_noise[records],
            None if self.instrument_noise_sd is None else self.instrument_noise_sd[records],
            None if self.noise_common_sd is None else self.noise_common_sd[records],
            None if self.yaw_sd is None else self.yaw_sd[records],
            scatter=None if self.scatter is None else self.scatter[records],
            length_log_sd=None if self.length_log_sd is None else self.length_log_sd[records],
            probe_sd=None if self.probe_sd is None else self.probe_sd[records],
            group=None if self.group is None else self.group[records],
            pairs=None if self.pairs is None else self.pairs.take(records),
        )

    def turned(self, gain: FloatArray) -> FloatArray:
        """Return gains (n_record, n_beam, 6) at the records' own tilt and roll; the noise stays that of the scan's."""
        return gain if self.turn is None else gain @ self.turn

    def prior(self, options: FitOptions) -> Prior:
        """Return the prior of these records."""
        return options.made_prior.for_records(self.wind_speed, None if self.group is None else self.group.tolist())

    def known_noise(self, options: FitOptions) -> FloatArray | float:
        """Return the instrument's noise as the likelihood takes it: 0 where it is uncertain and sampled."""
        if options.nuisances.instrument_noise_log_sd > 0.0:
            return 0.0
        return options.known_instrument_noise if self.instrument_noise is None else self.instrument_noise

    def median_noise(self, options: FitOptions) -> FloatArray | float:
        """Return the median of uncertain noise: that of the options, or (n_record, 1) the mean of the used beams."""
        if self.instrument_noise is None:
            return options.known_instrument_noise
        count = np.maximum(np.count_nonzero(self.used, axis=1, keepdims=True), 1)
        return np.asarray(np.sum(np.where(self.used, self.instrument_noise, 0.0), axis=1, keepdims=True) / count)


@dataclass(frozen=True)
class RecordDraws:
    """Draws and diagnostics of some records.

    Parameters
    ----------
    chains : Chains
        The draws.
    nuisances : dict of str to ndarray, shape (n_record, n_chain, n_draw)
        Draws of the sampled nuisances, in the units of `bayes_rs.posteriors.nuisance.UNITS`.
    predicted : ndarray, shape (n_record, n_chain, n_predicted, n_beam)
        Radial variances that the posterior predicts, m² s⁻²; NaN for beams that a record does not use.
    outside : ndarray of bool, shape (n_record,)
        Whether the noise does not reach to the record.
    clipped : ndarray, shape (n_record,)
        What was clipped to draw a sonic's tensor (`draw_sonic`); 0 for the other targets.
    noise : RecordNoise, optional
        The noise at the median of the records' length scales, where it was needed as a whole; not kept with others'.
    posterior : Posterior, optional
        What was sampled, of records with covariances: what their variances foretell is compared with it. Not kept, too.
    """

    chains: Chains
    nuisances: dict[str, FloatArray]
    predicted: FloatArray
    outside: NDArray[np.bool_]
    clipped: FloatArray
    noise: RecordNoise | None = None
    posterior: Posterior | None = None

    def take(self, records: NDArray[np.int64]) -> RecordDraws:
        """Return the draws of some of the records."""
        return join_draws([self], records)

    def thinned(self, n_draw: int) -> RecordDraws:
        """Return so many draws of each chain, whole blocks of them; what is said of the draws stays that of all."""
        n_block = self.chains.stress.shape[2] // BLOCK
        block = np.arange(n_draw // BLOCK) * n_block // (n_draw // BLOCK)
        draw = (block[:, None] * BLOCK + np.arange(BLOCK)).ravel()
        chains = replace(
            self.chains, coordinate=self.chains.coordinate[:, :, draw], stress=self.chains.stress[:, :, draw]
        )
        nuisances = {name: values[:, :, draw] for name, values in self.nuisances.items()}
        return replace(self, chains=chains, nuisances=nuisances, predicted=self.predicted[:, :, block])


def fit_batch(batch: Batch, noise: Noise, options: FitOptions, *, predict: bool = True) -> RecordDraws:
    """Sample the posteriors of a batch of records.

    Parameters
    ----------
    batch : Batch
        Records with at least one usable beam, a wind speed and a direction.
    noise : Noise
        Noise of the beams of the batch.
    options : FitOptions
        What is the same for all.
    predict : bool
        Draw from the posterior predictive distribution, too.

    Returns
    -------
    draws : RecordDraws
        Bit by bit the same whatever other records are in the batch.
    """
    reduced_rows = _reduced_beforehand(batch, noise, options)
    # each record by itself decides which way it goes, so that it is the same in any company
    ways = [(np.flatnonzero(reduced_rows), _fit_reduced), (np.flatnonzero(~reduced_rows), _fit_whole)]
    parts = [(rows, way(batch.take(rows), noise, options, predict)) for rows, way in ways if len(rows)]
    if len(parts) == 1:
        return parts[0][1]
    back = np.argsort(np.concatenate([rows for rows, _ in parts]))
    return join_draws([draws for _, draws in parts], back)


def posteriors(batch: Batch, noise: Noise, options: FitOptions) -> list[tuple[NDArray[np.int64], Posterior]]:
    """Return the posteriors that `fit_batch` samples, each with the rows of the batch that it is of."""
    reduced_rows = _reduced_beforehand(batch, noise, options)
    ways = [(np.flatnonzero(reduced_rows), _reduced_posterior), (np.flatnonzero(~reduced_rows), make_posterior)]
    return [(rows, way(batch.take(rows), noise, options)[0]) for rows, way in ways if len(rows)]


def _reduced_beforehand(batch: Batch, noise: Noise, options: FitOptions) -> NDArray[np.bool_]:
    """Return which records, those of a scan of many beams that use them all, have their noise reduced beforehand."""
    can = (
        options.target != "sonic"
        and batch.pairs is None
        and options.likelihood == "log-normal"
        and ReducedNoise.suits(noise)
    )
    return np.asarray(batch.used.all(axis=1)) if can else np.zeros(len(batch), dtype=np.bool_)


def join_draws(parts: Sequence[RecordDraws], order: NDArray[np.int64] | slice = slice(None)) -> RecordDraws:
    """Put the draws of several batches together, in the order that is given."""
    chains = Chains(
        **{
            name: np.concatenate([getattr(part.chains, name) for part in parts])[order]
            for name in Chains.__dataclass_fields__
        }
    )
    nuisances = {name: np.concatenate([part.nuisances[name] for part in parts])[order] for name in parts[0].nuisances}
    predicted, outside, clipped = (
        np.concatenate([getattr(part, name) for part in parts])[order] for name in ("predicted", "outside", "clipped")
    )
    return RecordDraws(chains, nuisances, predicted, outside, clipped)


def _fit_whole(batch: Batch, noise: Noise, options: FitOptions, predict: bool) -> RecordDraws:
    """Sample records with the covariances of all their beams."""
    posterior, at_record = make_posterior(batch, noise, options)
    sonic = _sonic_noise(batch, noise, options) if options.target == "sonic" else []
    chains, streams = sample(
        options.sampler,
        posterior,
        keys=batch.key,
        effort=options.effort,
    )
    clipped = np.zeros(len(batch))
    if sonic:  # before anything else is drawn, so that it is the same with and without predictions
        chains, clipped = draw_sonic(posterior, chains, sonic, streams, inflation=options.nuisances.inflation)
    some = chains.coordinate[:, :, BLOCK - 1 :: BLOCK]
    n_beam = batch.variance.shape[1]
    predicted = np.full((*some.shape[:3], n_beam if predict else 0), np.nan)
    if predict:
        flat = some.reshape(len(batch), -1, some.shape[-1])
        expected = posterior.likelihood.expected(*posterior.seen(flat))
        log_covariance = options.nuisances.inflation * np.log1p(at_record.covariance)
        root = _symmetric_root(log_covariance, at_record.state)
        predicted = _predicted(expected, root, batch.used, streams).reshape(predicted.shape)
    whole = chains.coordinate.reshape(len(batch), -1, some.shape[-1])
    return RecordDraws(
        chains,
        {
            name: values.reshape(chains.coordinate.shape[:3])
            for name, values in posterior.nuisance_values(whole).items()
        },
        predicted,
        at_record.outside,
        clipped,
        at_record,
        None if batch.pairs is None else posterior,
    )


def _reduced_posterior(batch: Batch, bank: Noise, options: FitOptions) -> tuple[Posterior, NDArray[np.bool_]]:
    """Return the posterior of records of a many-beam scan, and which of them the noise does not reach."""
    noise = reduced(bank, options.nuisances.gradient_names)
    factors, weights = options.nuisances.length_scale_nodes()
    parts: list[Likelihood] = []
    place = _place(batch, noise.bank, options.nuisances)
    for factor in factors:
        at_node = averaged_reduced(
            noise,
            batch.wind_speed,
            batch.yaw,
            _own_flow(noise.bank, batch, options.nuisances, float(factor)),
            batch.length_log_sd,
        )
        if batch.scatter is not None:
            at_node = scattered_reduced(at_node, noise.left, batch.scatter)
        if batch.instrument_noise_sd is not None:
            at_node = shifted_reduced(at_node, noise.left, batch.instrument_noise_sd)
        if batch.probe_sd is not None:
            at_node = shifted_reduced(at_node, noise.left, batch.probe_sd)
        gain = batch.turned(at_node.gain)
        if options.target == "ensemble":
            gain = gain * (1.0 + at_node.bias)[:, :, None]
        parts.append(
            reduced_log_normal_likelihood(
                batch.variance,
                gain,
                noise.left,
                at_node.covariance,
                at_node.log_variance,
                batch.known_noise(options),
                inflation=options.nuisances.inflation,
                dof=options.nuisances.inflation_dof,
                place=place,
            )
        )
        if factor == 1.0:
            outside = at_node.outside
    likelihood = parts[0] if len(parts) == 1 else MixtureLikelihood(tuple(parts), weights)
    nuisances = RecordNuisances(options.nuisances, batch.yaw, batch.median_noise(options), batch.yaw_sd)
    return Posterior(likelihood, batch.prior(options), nuisances), outside


def _fit_reduced(batch: Batch, bank: Noise, options: FitOptions, predict: bool) -> RecordDraws:
    """Sample records of a many-beam scan; their covariances are needed as a whole only to predict."""
    posterior, outside = _reduced_posterior(batch, bank, options)
    chains, streams = sample(
        options.sampler,
        posterior,
        keys=batch.key,
        effort=options.effort,
    )
    n_chain, n_draw, k = chains.coordinate.shape[1:]
    n_beam = batch.variance.shape[1]
    predicted = np.empty((len(batch), n_chain, n_draw // BLOCK, n_beam if predict else 0))
    full: RecordNoise | None = None
    if predict:
        some = chains.coordinate[:, :, BLOCK - 1 :: BLOCK].reshape(len(batch), -1, k)
        expected = posterior.likelihood.expected(*posterior.seen(some))
        full = _noise_of(bank, batch, options.nuisances, 1.0)
        root = _symmetric_root(options.nuisances.inflation * np.log1p(full.covariance), full.state)
        predicted = _predicted(expected, root, batch.used, streams).reshape(predicted.shape)
    values = posterior.nuisance_values(chains.coordinate.reshape(len(batch), -1, k))
    return RecordDraws(
        chains,
        {name: value.reshape(len(batch), n_chain, n_draw) for name, value in values.items()},
        predicted,
        outside,
        np.zeros(len(batch)),
        full,
    )


def make_posterior(batch: Batch, noise: Noise, options: FitOptions) -> tuple[Posterior, RecordNoise]:
    """Return the posterior of a batch, and the noise of its records (at the median length scale)."""
    factors, weights = options.nuisances.length_scale_nodes()
    # in the lidar's frame, so that the wind's direction does not weight the beams
    reference = design_matrix(np.asarray(noise.scan_geometry["direction"], dtype=np.float64)) @ REFERENCE_STRESS
    parts: list[Likelihood] = []
    place = _place(batch, noise, options.nuisances)
    for factor in factors:
        at_node = _noise_of(noise, batch, options.nuisances, float(factor))
        gain = batch.turned(at_node.gain)
        if options.target == "ensemble":
            gain = gain * (1.0 + at_node.bias)[:, :, None]
        if batch.pairs is not None:
            parts.append(_with_covariances(batch, noise, options, float(factor), gain))
            if factor == 1.0:
                at_record = at_node
            continue
        parts.append(
            make_likelihood(
                options.likelihood,
                batch.variance,
                batch.used,
                gain,
                at_node.covariance,
                batch.known_noise(options),
                inflation=options.nuisances.inflation,
                dof=options.nuisances.inflation_dof,
                reference=reference,
                place=place,
            )
        )
        if factor == 1.0:
            at_record = at_node
    likelihood = parts[0] if len(parts) == 1 else MixtureLikelihood(tuple(parts), weights)
    nuisances = RecordNuisances(options.nuisances, batch.yaw, batch.median_noise(options), batch.yaw_sd)
    return Posterior(likelihood, batch.prior(options), nuisances), at_record


def _with_covariances(batch: Batch, noise: Noise, options: FitOptions, factor: float, gain: FloatArray) -> Likelihood:
    """Return the likelihood of variances and correlations, at a length scale `factor` times that of the records."""
    if batch.pairs is None:
        raise InputError("The batch holds no correlations between beams: prepare it with information 'covariances'.")
    own = _own_flow(noise, batch, options.nuisances, factor)
    size = len(batch)
    return pair_likelihood(
        batch.pairs,
        batch.variance,
        batch.used,
        gain,
        batch.known_noise(options),
        wind_speed=batch.wind_speed,
        yaw=batch.yaw,
        flow=(
            own.get("length_scale", np.full(size, np.median(noise.length_scale))),
            own.get("gamma", np.full(size, np.median(noise.gamma))),
        ),
        length_log_sd=batch.length_log_sd,
        scatter=batch.scatter,
        noise_sd=batch.instrument_noise_sd,
        probe_sd=batch.probe_sd,
        turn=batch.turn,
        place=_place(batch, noise, options.nuisances),
        options=options,
    )


def _place(batch: Batch, noise: Noise, nuisances: Nuisances) -> FloatArray | None:
    """Return where the beams of each record measure, for gradients of R; None if R is the same everywhere."""
    place = nuisances.place(noise.scan_geometry)
    return None if place is None else np.broadcast_to(place, (len(batch), *place.shape))


def _sonic_noise(batch: Batch, noise: Noise, options: FitOptions) -> list[SonicNoise]:
    """Return the moments of a sonic with the beams, for each length scale that the posterior is averaged over."""
    factors, _ = options.nuisances.length_scale_nodes()
    found = [
        noise.sonic_for_records(
            batch.wind_speed, batch.yaw, **_own_flow(noise, batch, options.nuisances, float(factor))
        )
        for factor in factors
    ]
    return found if batch.scatter is None else [scattered_sonic(moments, batch.scatter) for moments in found]


def noise_at_median(batch: Batch, noise: Noise, nuisances: Nuisances) -> RecordNoise:
    """Return the noise of records at the median of their length scales."""
    return _noise_of(noise, batch, nuisances, 1.0)


def _noise_of(noise: Noise, batch: Batch, nuisances: Nuisances, factor: float) -> RecordNoise:
    """Return the noise of records; of their own turbulence where they have one and the noise spans several."""
    own = _own_flow(noise, batch, nuisances, factor)
    found = averaged_noise(noise, batch.wind_speed, batch.yaw, own, batch.length_log_sd)
    if batch.scatter is not None:
        found = scattered(found, batch.scatter)
    for common_sd in (batch.instrument_noise_sd, batch.probe_sd):
        found = found if common_sd is None else shifted(found, common_sd)
    return found


def _own_flow(noise: Noise, batch: Batch, nuisances: Nuisances, factor: float) -> dict[str, FloatArray]:
    """Return the length scale and Γ of records, where they have their own."""
    own = dict(batch.flow)
    if nuisances.length_scale_sd > 0.0:
        if np.ptp(np.log(noise.length_scale)) == 0.0:
            raise InputError(
                "The noise knows one length scale only, so it cannot be averaged over others: make it with "
                "noise.calibrate(..., length_scale=[shortest, longest], tolerance=0.01)."
            )
        if nuisances.length_scale is not None:
            own["length_scale"] = np.full(len(batch), nuisances.length_scale)
        elif "length_scale" not in own:
            raise InputError(
                "The median length scale is not known: give Nuisances a length_scale, or the records a variable of "
                "that name."
            )
        own["length_scale"] = factor * own["length_scale"]
    return own


def _predicted(expected: FloatArray, root: FloatArray, used: NDArray[np.bool_], streams: RecordStreams) -> FloatArray:
    """Draw radial variances, shape (n_record, n_draw, n_beam), from the posterior predictive distribution."""
    n_record, n_draw, n_beam = expected.shape
    normal = streams.normal(np.arange(n_record), (n_draw, n_beam))
    half_variance = 0.5 * np.einsum("rbk,rbk->rb", root, root)
    log_noise = normal @ root.swapaxes(-1, -2) - half_variance[:, None, :]
    return np.where(used[:, None, :], expected * np.exp(log_noise), np.nan)


def _symmetric_root(matrices: FloatArray, state: NDArray[np.int64]) -> FloatArray:
    """Return square roots of positive semi-definite matrices, one decomposition for each different state."""
    _, first, inverse = np.unique(state, return_index=True, return_inverse=True)
    values, vectors = np.linalg.eigh(matrices[first])
    # eigenvalues below zero are rounding: Noise has refused anything more
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]
    return np.asarray(roots[inverse.reshape(-1)])
