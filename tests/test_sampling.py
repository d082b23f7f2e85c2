"""The sampler: the right posterior, from any start, the same for a seed whatever is sampled beside it."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise

from bayes_rs import diagnostics, load_scan
from bayes_rs.forward import design_matrix
from bayes_rs.likelihood import LogNormalLikelihood, log_normal_likelihood
from bayes_rs.prior import FlatPrior, WeakPrior
from bayes_rs.proposal import laplace_proposal, log_posterior
from bayes_rs.sampling import N_CHAIN, N_ENSEMBLE, RecordSampler

N_STEP = 256


def build(scan, n_record, prior, seed):
    noise = plain_noise(scan)
    rng = np.random.default_rng(seed)
    variance = draw_variances(prior.draw(n_record, rng), scan, noise, rng)
    shape = (n_record, scan.n_beam)
    return log_normal_likelihood(
        variance,
        np.ones(shape, dtype=bool),
        np.broadcast_to(design_matrix(scan), (*shape, 6)),
        np.broadcast_to(noise.covariance, (*shape, scan.n_beam)),
    )


def reference_posterior(likelihood: LogNormalLikelihood, record: int, prior, n_draw: int):
    """Mean, sd and quantiles of ln or plain stresses by importance sampling from the prior: no proposal, no chain."""
    one = likelihood.take(np.array([record]))
    stress = prior.draw(n_draw, seed=99)
    log_weight = np.concatenate([one.log_density(part[None])[0] for part in np.array_split(stress, 50)])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = weight @ stress
    sd = np.sqrt(weight @ (stress - mean) ** 2)
    order = np.argsort(stress, axis=0)
    quantiles = np.stack(
        [np.interp([0.05, 0.5, 0.95], np.cumsum(weight[order[:, k]]), stress[order[:, k], k]) for k in range(6)]
    )
    return mean, sd, quantiles, 1.0 / np.sum(weight**2)


def check_sampler(likelihood, prior, *, n_reference, records=(0, 1)):
    """The checker that every sampler passes: mean, sd and tails against the reference, within Monte-Carlo error."""
    n_record = len(likelihood.datum)
    sampler = RecordSampler(likelihood, prior, 5, np.arange(n_record))
    coordinate, _ = sampler.run(N_STEP, np.arange(n_record))
    draws = np.moveaxis(prior.stress(coordinate), -1, 1)
    ess = diagnostics.ess_bulk(draws)
    for record in records:
        mean, sd, quantiles, reference_ess = reference_posterior(likelihood, record, prior, n_reference)
        assert reference_ess > 300.0
        error = np.sqrt(1.0 / ess[record] + 1.0 / reference_ess)  # of a mean, in units of sd
        flat = draws[record].reshape(6, -1)
        assert np.all(np.abs(flat.mean(axis=1) - mean) < 5.0 * error * sd)
        # the sd of a skewed posterior is known half as well as that of a normal one
        assert np.all(np.abs(flat.std(axis=1) / sd - 1.0) < 5.0 * 2.0 * error)
        for index in range(6):
            share = (flat[index][:, None] < quantiles[index]).mean(axis=0)
            tail_error = np.sqrt([0.0475, 0.25, 0.0475]) * error[index]
            assert np.all(np.abs(share - [0.05, 0.5, 0.95]) < 5.0 * tail_error)


@pytest.mark.parametrize("name", ["staring", "4-beam", "6-beam", "50-beam", "spinnerlidar"])
def test_posterior_under_the_weak_prior(name):
    prior = WeakPrior(log_sd_uu=0.5)  # narrow in size, so that the prior's own draws can be the reference
    check_sampler(build(load_scan(name), 3, prior, 1), prior, n_reference=300_000 if name != "spinnerlidar" else 60_000)


def test_posterior_of_a_well_conditioned_scan():
    prior = WeakPrior(log_sd_uu=0.3, log_sd_vv=0.3, log_sd_ww=0.3)
    check_sampler(build(load_scan("6-beam", opening_angle_deg=45.0), 3, prior, 2), prior, n_reference=600_000)


@pytest.mark.parametrize("name", ["6-beam", "50-beam"])
def test_posterior_under_the_flat_prior(name):
    prior = FlatPrior(bound=2.0)
    check_sampler(build(load_scan(name), 3, prior, 3), prior, n_reference=600_000)


def test_a_wrong_target_is_caught():
    """The checker has power: a likelihood that is 30 % too sure of itself does not pass."""
    prior = WeakPrior(log_sd_uu=0.5)
    right = build(load_scan("6-beam"), 3, prior, 1)
    wrong = LogNormalLikelihood(
        right.gain, right.offset, 1.3 * right.datum, 1.3 * right.whitening, right.log_normalizer, right.n_datum
    )
    sampler = RecordSampler(wrong, prior, 5, np.arange(3))
    coordinate, _ = sampler.run(N_STEP, np.arange(3))
    flat = prior.stress(coordinate)[0].reshape(-1, 6)
    _, sd, _, _ = reference_posterior(right, 0, prior, 200_000)
    assert flat[:, 0].std() / sd[0] < 0.85


def test_plain_emcee_gives_the_same_posterior():
    """emcee as most people would write it: raw stresses, an explicit density with the Jacobian, the stretch move."""
    import emcee  # noqa: PLC0415

    prior = FlatPrior(bound=4.0)  # flat in the stresses themselves: no Jacobian to get wrong
    likelihood = build(load_scan("6-beam", opening_angle_deg=40.0), 1, FlatPrior(bound=2.0), 4)

    def log_probability(stress):
        tensor = stress[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
        inside = np.all(stress[:, :3] < 4.0, axis=1) & (np.linalg.eigvalsh(tensor)[:, 0] > 0.0)
        density = np.full(len(stress), -np.inf)
        density[inside] = likelihood.log_density(stress[None, inside])[0]
        return density

    rng = np.random.default_rng(8)
    ours = RecordSampler(likelihood, prior, 6, np.arange(1))
    start = prior.stress(ours.coordinate)[0]
    start = start[rng.integers(N_CHAIN, size=64)] * np.exp(0.01 * rng.normal(size=(64, 1)))
    sampler = emcee.EnsembleSampler(64, 6, log_probability, vectorize=True)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(start, 6000)
    plain = sampler.get_chain(discard=500, flat=True)
    effective = len(plain) / max(sampler.get_autocorr_time(quiet=True).max(), 1.0)
    coordinate, _ = ours.run(1024, np.arange(1))
    draws = np.moveaxis(prior.stress(coordinate), -1, 1)[0]
    error = np.sqrt(1.0 / effective + 1.0 / diagnostics.ess_bulk(draws).min()) * plain.std(axis=0)
    assert np.all(np.abs(draws.reshape(6, -1).mean(axis=1) - plain.mean(axis=0)) < 5.0 * error)


class TestProposal:
    def test_density_is_normalized_and_belongs_to_the_draws(self):
        prior = WeakPrior()
        proposal = laplace_proposal(build(load_scan("6-beam"), 2, prior, 5), prior)
        rng = np.random.default_rng(9)
        draws = proposal.transform(rng.standard_normal((2, 200_000, 6)), rng.chisquare(6.0, (2, 200_000)))
        # E[N(x)/q(x)] = 1 for any normalized density N, here a normal one of half the width
        factor = 2.0 * proposal.factor
        whitened = (draws - proposal.mode[:, None]) @ factor.swapaxes(-1, -2)
        log_normal = (
            -0.5 * np.sum(whitened**2, axis=-1)
            - 3.0 * np.log(2.0 * np.pi)
            + np.log(np.abs(np.linalg.det(factor)))[:, None]
        )
        ratio = np.exp(log_normal - proposal.log_density(draws))
        error = ratio.std(axis=1) / np.sqrt(ratio.shape[1])
        assert np.all(np.abs(ratio.mean(axis=1) - 1.0) < 5.0 * error)

    def test_mode_is_the_maximum(self):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam", opening_angle_deg=40.0), 5, prior, 6)
        mode = laplace_proposal(likelihood, prior).mode
        around = mode[:, None] + 0.05 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
        height = log_posterior(likelihood, prior, around)
        assert np.all(height[:, :1] + 1e-3 >= height)  # the iteration stops at gains of 1e-3

    @pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4])
    def test_mode_is_found_at_any_size_of_the_data(self, scale):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 1, prior, 7)
        scaled = LogNormalLikelihood(
            likelihood.gain,
            likelihood.offset,
            likelihood.datum + likelihood.whitening.sum(axis=-1) * np.log(scale),
            likelihood.whitening,
            likelihood.log_normalizer,
            likelihood.n_datum,
        )
        shift = (
            prior.stress(laplace_proposal(scaled, prior).mode)[0, 0]
            / prior.stress(laplace_proposal(likelihood, prior).mode)[0, 0]
        )
        assert np.log(shift) == pytest.approx(np.log(scale), rel=0.15)  # the prior on size pulls a little


class TestStreams:
    def test_same_seed_same_chain_other_seed_other_chain(self):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 2, prior, 8)
        chains = [RecordSampler(likelihood, prior, seed, np.arange(2)).run(8, np.arange(2))[0] for seed in (1, 1, 2)]
        np.testing.assert_array_equal(chains[0], chains[1])
        assert not np.any(chains[0] == chains[2])

    def test_a_record_is_the_same_alone_and_in_company(self):
        prior = WeakPrior()
        likelihood = build(load_scan("50-beam"), 5, prior, 9)
        keys = np.array([10, -11, 12, 13, 2**62])  # a start before 1970 is a number below zero
        together, _ = RecordSampler(likelihood, prior, 1, keys).run(16, np.arange(5))
        for some in ([3], [4, 1]):
            part = RecordSampler(likelihood.take(np.array(some)), prior, 1, keys[some])
            np.testing.assert_array_equal(part.run(16, np.arange(len(some)))[0], together[some])

    def test_records_do_not_share_their_numbers(self):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 1, prior, 10).take(np.array([0, 0]))
        chain, _ = RecordSampler(likelihood, prior, 1, np.array([0, 1])).run(8, np.arange(2))
        assert not np.any(chain[0] == chain[1])

    def test_ensembles_of_a_record_start_apart(self):
        prior = WeakPrior()
        sampler = RecordSampler(build(load_scan("6-beam"), 1, prior, 11), prior, 1, np.array([0]))
        position = sampler.coordinate[0].reshape(N_ENSEMBLE, -1, 6)
        means = position.mean(axis=1)
        assert np.abs(means - means.mean(axis=0)).max() < 3.0 * position.std() / np.sqrt(N_CHAIN / N_ENSEMBLE)
