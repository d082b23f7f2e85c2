"""Noise that is reduced before it is interpolated: the same posterior as the long way, at states and between them."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import draw_variances, plain_noise

from bayes_rs import InputError, MannTurbulence, load_scan
from bayes_rs.fits.batch import Batch, FitOptions, fit_batch, make_posterior
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.log_normal import reduced_log_normal_likelihood
from bayes_rs.likelihoods.reduced_noise import ReducedNoise
from bayes_rs.noise.net import refined_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.ratio import WeakPrior

OPTIONS = FitOptions(
    prior=WeakPrior(),
    target="record",
    sampler="direct",
    likelihood="log-normal",
    nuisances=Nuisances(),
    instrument_noise=0.0,
    target_ess=200,
    max_extension=2,
    seed=1,
)


def bank_of(scan):
    """States at three wind speeds and three directions, with noise that changes with both."""
    base = plain_noise(scan)
    return Noise.join(
        tuple(
            replace(
                base,
                wind_speed=speed,
                yaw=yaw,
                covariance=base.covariance * (10.0 / speed) * np.cos(yaw),
                gain=design_matrix(scan.at_yaw(yaw)),
            )
            for speed in (5.0, 10.0, 20.0)
            for yaw in (-0.4, 0.0, 0.4)
        )
    )


def batch_of(scan, wind_speed, yaw, seed=1):
    rng = np.random.default_rng(seed)
    n_record = len(wind_speed)
    variance = draw_variances(WeakPrior(log_sd_uu=0.5).draw(n_record, rng), scan, plain_noise(scan), rng)
    return Batch(
        variance,
        np.ones(variance.shape, dtype=bool),
        np.asarray(wind_speed, dtype=float),
        np.asarray(yaw, dtype=float),
        np.arange(n_record),
    )


def densities(batch, bank, options=OPTIONS):
    """Log-likelihoods of the same tensors, the short and the long way."""
    long_way, _ = make_posterior(batch, bank, options)
    noise = ReducedNoise(bank)
    at = noise.for_records(batch.wind_speed, batch.yaw)
    gain = at.gain * (1.0 + at.bias)[:, :, None] if options.target == "ensemble" else at.gain
    short = reduced_log_normal_likelihood(batch.variance, gain, noise.left, at.covariance, at.log_variance)
    draws = WeakPrior(log_sd_uu=0.7).draw(40 * len(batch), 5).reshape(len(batch), 40, 6)
    return short.log_density(draws), long_way.likelihood.log_density(draws)


@pytest.mark.parametrize("name", ["50-beam", "51-beam", "spinnerlidar@probe=point"])
@pytest.mark.parametrize("target", ["record", "ensemble"])
def test_at_the_states_it_is_the_long_way_to_rounding(name, target):
    scan = load_scan(name)
    batch = batch_of(scan, [5.0, 10.0, 20.0, 10.0], [0.0, 0.4, -0.4, 0.0])
    short, long_way = densities(batch, bank_of(scan), replace(OPTIONS, target=target))
    # directions are known to nine digits; whitened residuals are some 1e2 at most, and squared
    np.testing.assert_allclose(short, long_way, rtol=1e-6, atol=1e-6)


def test_between_the_states_it_is_as_good_as_the_interpolation():
    """A theory bank whose covariances are good to 1 %: the densities of plausible tensors differ by that."""
    scan = load_scan("50-beam")
    flow = MannTurbulence(0.05, 61.0, 3.2)
    bank = refined_noise(scan, flow, wind_speed=[7.0, 14.0], yaw_deg=[-20.0, 20.0], cache=False, progress=False)
    batch = batch_of(scan, [8.1, 11.7, 13.0], [0.1, -0.2, 0.3])
    posterior, _ = make_posterior(batch, bank, OPTIONS)
    noise = ReducedNoise(bank)
    at = noise.for_records(batch.wind_speed, batch.yaw)
    short = reduced_log_normal_likelihood(batch.variance, at.gain, noise.left, at.covariance, at.log_variance)
    long_way = posterior.likelihood
    draws = fit_batch(batch, bank, OPTIONS).chains.stress.reshape(3, -1, 6)
    difference = short.log_density(draws) - long_way.log_density(draws)
    # half a χ² of five numbers times an error of up to 1.5 % in the covariance, and what the weights make of it
    assert np.abs(difference - difference.mean(axis=1, keepdims=True)).max() < 0.3
    assert difference.std() < 0.05


@pytest.mark.parametrize("sampler", ["direct", "emcee"])
def test_draws_are_the_same_with_and_without_predictions(sampler):
    """A fit in memory predicts and a long campaign does not: their numbers are the same, between the states, too."""
    scan = load_scan("50-beam")
    batch, bank = batch_of(scan, [9.0, 6.0], [0.1, 0.3]), bank_of(scan)
    options = replace(OPTIONS, sampler=sampler)
    with_, without = (fit_batch(batch, bank, options, predict=predict) for predict in (True, False))
    np.testing.assert_array_equal(with_.chains.stress, without.chains.stress)
    assert np.isfinite(with_.predicted).all()
    assert with_.predicted.shape[-1] == 50
    assert without.predicted.shape == (*with_.predicted.shape[:-1], 0)


def test_a_record_beside_one_that_lacks_a_beam_is_the_record_alone():
    scan = load_scan("50-beam")
    batch, bank = batch_of(scan, [8.0, 12.0, 17.0], [0.1, -0.3, 0.2]), bank_of(scan)
    batch.used[1, 7] = False
    together = fit_batch(batch, bank, OPTIONS)
    for record in range(3):
        alone = fit_batch(batch.take(np.array([record])), bank, OPTIONS)
        np.testing.assert_array_equal(alone.chains.stress[0], together.chains.stress[record])
        np.testing.assert_array_equal(alone.predicted[0], together.predicted[record])
    assert np.isnan(together.predicted[1, ..., 7]).all()


def test_what_it_does_not_suit():
    scan = load_scan("50-beam")
    bank = bank_of(scan)
    assert ReducedNoise.suits(bank)
    assert not ReducedNoise.suits(plain_noise(scan))
    assert not ReducedNoise.suits(bank_of(load_scan("6-beam")))
    assert not ReducedNoise.suits(replace(bank, gain=0.9 * bank.gain))
    assert not ReducedNoise.suits(replace(bank, gain=bank.gain - [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert all(ReducedNoise.suits(bank_of(scan.select(np.arange(n)))) is (n >= 16) for n in (15, 16, 17))


@pytest.mark.parametrize("options", [{"inflation": 0.0}, {"dof": -1.0}])
def test_widths_that_are_not_positive_are_refused(options):
    noise = ReducedNoise(bank_of(load_scan("50-beam")))
    at = noise.for_records([10.0], [0.0])
    with pytest.raises(InputError, match=f"Invalid {next(iter(options))} "):
        reduced_log_normal_likelihood(np.ones((1, 50)), at.gain, noise.left, at.covariance, at.log_variance, **options)


def test_a_record_alone_is_the_record_in_company():
    scan = load_scan("50-beam")
    batch, bank = batch_of(scan, [8.0, 12.0, 17.0], [0.1, -0.3, 0.2]), bank_of(scan)
    together = fit_batch(batch, bank, OPTIONS, predict=False).chains.stress
    alone = fit_batch(batch.take(np.array([1])), bank, OPTIONS, predict=False).chains.stress
    np.testing.assert_array_equal(alone[0], together[1])
