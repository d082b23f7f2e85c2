"""The samplers: the right posterior, the same for a seed whatever is sampled beside it."""

from dataclasses import replace

import numpy as np
import pytest
from plain_emcee import register
from scenes import draw_variances, plain_noise

from bayes_rs import load_scan
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.log_normal import LogNormalLikelihood, log_normal_likelihood
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, laplace_proposal
from bayes_rs.posteriors.sampling import SAMPLERS, sample
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE
from bayes_rs.posteriors.sampling.direct import sample_direct
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.posteriors.sampling.ensemble import RecordSampler
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.posteriors.sampling.streams import RecordStreams
from bayes_rs.priors.registry import FlatPrior, WeakPrior

QUICK = ("emcee", "direct", "auto")


def build(scan, n_record, prior, seed):
    noise = plain_noise(scan)
    rng = np.random.default_rng(seed)
    variance = draw_variances(prior.draw(n_record, rng), scan, noise, rng)
    shape = (n_record, scan.n_beam)
    return log_normal_likelihood(
        variance,
        np.ones(shape, dtype=bool),
        np.broadcast_to(design_matrix(scan), (*shape, 6)),
        np.broadcast_to(noise.covariance[0], (*shape, scan.n_beam)),
    )


KNOWN = {}
"""References of likelihoods, which are the same for every sampler."""


def reference_posterior(likelihood: LogNormalLikelihood, record: int, prior, n_draw: int):
    """Mean, sd and quantiles of ln or plain stresses by importance sampling from the prior: no proposal, no chain."""
    key = (likelihood.datum.tobytes(), likelihood.whitening.tobytes(), record, repr(prior), n_draw)
    if key not in KNOWN:
        KNOWN[key] = weigh_prior(likelihood, record, prior, n_draw)
    return KNOWN[key]


def weigh_prior(likelihood: LogNormalLikelihood, record: int, prior, n_draw: int):
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


def draw(name, likelihood, prior, *, target_ess=4000, keys=None, seed=5, max_extension=5):
    keys = np.arange(likelihood.n_record) if keys is None else keys
    return sample(name, Posterior(likelihood, prior), keys=keys, effort=Effort(seed, target_ess, max_extension))[0]


def check_sampler(name, likelihood, prior, *, n_reference, records=(0, 1), target_ess=4000):
    """The checker that every sampler passes: mean, sd and tails against the reference, within Monte-Carlo error."""
    chains = draw(name, likelihood, prior, target_ess=target_ess)
    assert not chains.missed(target_ess).any()
    for record in records:
        mean, sd, quantiles, reference_ess = reference_posterior(likelihood, record, prior, n_reference)
        assert reference_ess > 300.0
        error = np.sqrt(1.0 / chains.ess_bulk[record] + 1.0 / reference_ess)  # of a mean, in units of sd
        flat = chains.stress[record].reshape(-1, 6).T
        assert np.all(np.abs(flat.mean(axis=1) - mean) < 5.0 * error * sd)
        # the sd of a skewed posterior is known half as well as that of a normal one
        assert np.all(np.abs(flat.std(axis=1) / sd - 1.0) < 5.0 * 2.0 * error)
        for index in range(6):
            share = (flat[index][:, None] < quantiles[index]).mean(axis=0)
            tail_error = np.sqrt([0.0475, 0.25, 0.0475]) * error[index]
            assert np.all(np.abs(share - [0.05, 0.5, 0.95]) < 5.0 * tail_error)


@pytest.mark.parametrize("sampler", QUICK)
@pytest.mark.parametrize("name", ["staring", "4-beam", "6-beam", "50-beam", "spinnerlidar@probe=point"])
def test_posterior_under_the_weak_prior(name, sampler):
    prior = WeakPrior(log_sd_uu=0.5)  # narrow in size, so that the prior's own draws can be the reference
    many = name == "spinnerlidar@probe=point"
    check_sampler(
        sampler,
        build(load_scan(name), 3, prior, 1),
        prior,
        n_reference=60_000 if many else 300_000,
        target_ess=500 if many else 4000,
    )


@pytest.mark.parametrize("sampler", QUICK)
def test_posterior_of_a_well_conditioned_scan(sampler):
    prior = WeakPrior(log_sd_uu=0.3, log_sd_vv=0.3, log_sd_ww=0.3)
    check_sampler(sampler, build(load_scan("6-beam", opening_angle_deg=45.0), 3, prior, 2), prior, n_reference=600_000)


@pytest.mark.parametrize("sampler", QUICK)
@pytest.mark.parametrize("name", ["6-beam", "50-beam"])
def test_posterior_under_the_flat_prior(name, sampler):
    prior = FlatPrior(bound=2.0)
    check_sampler(sampler, build(load_scan(name), 3, prior, 3), prior, n_reference=600_000, target_ess=1000)


@pytest.fixture
def plain_emcee(monkeypatch):
    """The samplers, and the one that serves for comparison only."""
    monkeypatch.setitem(SAMPLERS, "emcee-plain", None)  # taken out afterwards
    register()


@pytest.mark.usefixtures("plain_emcee")
@pytest.mark.parametrize("name", [pytest.param("staring", marks=pytest.mark.long), "6-beam"])
def test_plain_emcee_gives_the_posterior_too(name):
    prior = WeakPrior(log_sd_uu=0.5)
    check_sampler(
        "emcee-plain", build(load_scan(name), 1, prior, 1), prior, n_reference=300_000, records=(0,), target_ess=800
    )


def test_a_wrong_target_is_caught():
    """The checker has power: a likelihood that is 30 % too sure of itself does not pass."""
    prior = WeakPrior(log_sd_uu=0.5)
    right = build(load_scan("6-beam"), 3, prior, 1)
    wrong = replace(right, datum=1.3 * right.datum, whitening=1.3 * right.whitening)
    flat = draw("direct", wrong, prior).stress[0].reshape(-1, 6)
    _, sd, _, _ = reference_posterior(right, 0, prior, 200_000)
    assert flat[:, 0].std() / sd[0] < 0.85


def test_emcee_on_raw_stresses_gives_the_same_posterior():
    """No coordinates at all: the raw stresses, the limits as an indicator, the stretch move."""
    import emcee  # noqa: PLC0415 - slow to load

    prior = FlatPrior(bound=4.0)  # flat in the stresses themselves: no Jacobian to get wrong
    likelihood = build(load_scan("6-beam", opening_angle_deg=40.0), 1, FlatPrior(bound=2.0), 4)

    def log_probability(stress):
        tensor = stress[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
        inside = np.all(stress[:, :3] < 4.0, axis=1) & (np.linalg.eigvalsh(tensor)[:, 0] > 0.0)
        density = np.full(len(stress), -np.inf)
        density[inside] = likelihood.log_density(stress[None, inside])[0]
        return density

    rng = np.random.default_rng(8)
    ours = draw("emcee", likelihood, prior, target_ess=16_000, seed=6)
    start = ours.stress[0].reshape(-1, 6)[rng.integers(1024, size=64)] * np.exp(0.01 * rng.normal(size=(64, 1)))
    sampler = emcee.EnsembleSampler(64, 6, log_probability, vectorize=True)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(start, 6000)
    plain = sampler.get_chain(discard=500, flat=True)
    effective = len(plain) / max(sampler.get_autocorr_time(quiet=True).max(), 1.0)
    error = np.sqrt(1.0 / effective + 1.0 / ours.ess_bulk.min()) * plain.std(axis=0)
    assert np.all(np.abs(ours.stress[0].reshape(-1, 6).mean(axis=0) - plain.mean(axis=0)) < 5.0 * error)


class TestProposal:
    def test_density_is_normalized_and_belongs_to_the_draws(self):
        prior = WeakPrior()
        proposal = laplace_proposal(Posterior(build(load_scan("6-beam"), 2, prior, 5), prior))
        rng = np.random.default_rng(9)
        draws = proposal.transform(
            rng.standard_normal((2, 200_000, 6)), rng.chisquare(DEGREES_OF_FREEDOM, (2, 200_000))
        )
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
        posterior = Posterior(likelihood, prior)
        mode = laplace_proposal(posterior).mode
        around = mode[:, None] + 0.05 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
        height = posterior.log_density(around)
        assert np.all(height[:, :1] + 1e-3 >= height)  # the iteration stops at gains of 1e-3

    @pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4])
    def test_mode_is_found_at_any_size_of_the_data(self, scale):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 1, prior, 7)
        scaled = replace(likelihood, datum=likelihood.datum + likelihood.whitening.sum(axis=-1) * np.log(scale))
        modes = [prior.stress(laplace_proposal(Posterior(one, prior)).mode) for one in (scaled, likelihood)]
        shift = modes[0][0, 0] / modes[1][0, 0]
        assert np.log(shift) == pytest.approx(np.log(scale), rel=0.15)  # the prior on size pulls a little


def test_every_sampler_is_checked():
    assert set(QUICK) == set(SAMPLERS)


def test_the_registry_takes_a_sampler_of_your_own(monkeypatch):
    def only_direct(posterior, **options):
        return sample_direct(posterior, **options)

    monkeypatch.setitem(SAMPLERS, "mine", only_direct)
    prior = WeakPrior()
    likelihood = build(load_scan("6-beam"), 2, prior, 8)
    mine, direct = (draw(name, likelihood, prior, target_ess=100) for name in ("mine", "direct"))
    np.testing.assert_array_equal(mine.stress, direct.stress)


@pytest.mark.usefixtures("plain_emcee")
def test_plain_emcee_repeats_itself(monkeypatch):
    monkeypatch.setattr("plain_emcee.N_BURN_IN", 20)
    monkeypatch.setattr("plain_emcee._STRIDE", 4)
    prior = WeakPrior()
    likelihood = build(load_scan("staring"), 1, prior, 8)
    short = {"target_ess": 50, "max_extension": 0}
    runs = [draw("emcee-plain", likelihood, prior, seed=1, **short).coordinate for _ in range(2)]
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.parametrize("sampler", QUICK)
class TestStreams:
    def test_same_seed_same_chain_other_seed_other_chain(self, sampler):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 2, prior, 8)
        runs = [draw(sampler, likelihood, prior, target_ess=100, seed=seed).coordinate for seed in (1, 1, 2)]
        np.testing.assert_array_equal(runs[0], runs[1])
        assert not np.any(runs[0] == runs[2])

    def test_a_record_is_the_same_alone_and_in_company(self, sampler):
        prior = FlatPrior()  # some of its records are extended, others are not
        likelihood = build(load_scan("50-beam"), 5, prior, 9)
        keys = np.array([10, -11, 12, 13, 2**62])  # a start before 1970 is a number below zero
        together = draw(sampler, likelihood, prior, target_ess=300, keys=keys)
        for some in ([3], [4, 1]):
            part = draw(sampler, likelihood.take(np.array(some)), prior, target_ess=300, keys=keys[some])
            np.testing.assert_array_equal(part.coordinate, together.coordinate[some])
            np.testing.assert_array_equal(part.sampler, together.sampler[some])

    def test_a_record_is_the_same_in_any_batch(self, sampler):
        """More records than are sampled together, so that batches are cut elsewhere when some are left out."""
        prior = FlatPrior(bound=1e4)
        likelihood = build(load_scan("6-beam"), 70, WeakPrior(), 15)
        keys = np.arange(70)
        together = draw(sampler, likelihood, prior, target_ess=1000, keys=keys)
        some = np.array([69, 3, 40])
        part = draw(sampler, likelihood.take(some), prior, target_ess=1000, keys=keys[some])
        np.testing.assert_array_equal(part.coordinate, together.coordinate[some])
        np.testing.assert_array_equal(part.stress, together.stress[some])
        np.testing.assert_array_equal(part.ess_bulk, together.ess_bulk[some])

    def test_records_do_not_share_their_numbers(self, sampler):
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 1, prior, 10).take(np.array([0, 0]))
        chains = draw(sampler, likelihood, prior, target_ess=100, keys=np.array([0, 1]))
        assert not np.any(chains.coordinate[0] == chains.coordinate[1])


def test_ensembles_of_a_record_start_apart():
    prior = WeakPrior()
    posterior = Posterior(build(load_scan("6-beam"), 1, prior, 11), prior)
    sampler = RecordSampler(posterior, 1, RecordStreams(1, np.array([0])), n_walker=512)
    position = sampler.coordinate[0].reshape(6, N_ENSEMBLE, 128)
    assert len({tuple(part.ravel()) for part in position.swapaxes(0, 1)}) == N_ENSEMBLE
    means = position.mean(axis=2)
    spread = position.std(axis=(1, 2))
    assert np.all(np.abs(means - means.mean(axis=1, keepdims=True)).max(axis=1) < 4.0 * spread / np.sqrt(128))


class TestDirect:
    def test_more_accurate_than_its_effective_sample_size_says(self):
        """The proposals fill space evenly: means of one record scatter less over seeds than those of random draws."""
        prior = WeakPrior()
        likelihood = build(load_scan("6-beam"), 1, prior, 12)
        runs = [draw("direct", likelihood, prior, target_ess=1000, seed=seed) for seed in range(40)]
        means = np.array([run.stress[0].reshape(-1, 6).mean(axis=0) for run in runs])
        expected = runs[0].stress[0].reshape(-1, 6).std(axis=0) / np.sqrt(runs[0].ess_bulk[0])
        # 39 degrees of freedom: a ratio of standard deviations above 1.37 has a probability of 1e-3
        assert np.all(means.std(axis=0, ddof=1) < 1.37 * expected)

    def test_a_proposal_that_does_not_fit_is_told(self):
        """Two far apart maxima, of which the proposal knows one: uneven weights, or ensembles that differ, say so."""
        log_weight = np.zeros((1, 2048))
        log_weight[0, :3] = 12.0
        assert pareto_k(log_weight)[0] > 0.7

    def test_auto_hands_over_what_direct_cannot_do(self):
        prior = FlatPrior()
        likelihood = build(load_scan("50-beam"), 8, FlatPrior(bound=2.0), 13)
        direct = draw("direct", likelihood, prior, target_ess=1000)
        auto = draw("auto", likelihood, prior, target_ess=1000)
        assert set(auto.sampler) <= {"direct", "emcee"}
        kept = auto.sampler == "direct"
        assert not auto.missed(1000)[kept].any()
        np.testing.assert_array_equal(
            auto.coordinate[kept][: len(direct.coordinate)].shape[1:], direct.coordinate.shape[1:]
        )


class TestParetoK:
    @pytest.mark.parametrize("k", [0.1, 0.4, 0.7, 1.0])
    def test_is_that_of_a_pareto_tail(self, k):
        """Weights with tail index k; the estimate from 135 tail weights has an sd of (1 + k)/√135 (Hosking 1987)."""
        log_weight = k * np.random.default_rng(1).standard_exponential((50, 2048))
        error = (1.0 + k) / np.sqrt(135.0 * 50.0)
        # the weak prior at one half pulls by 10 observations in 145; exponential order statistics bias it by some 0.01
        expected = (k * 135.0 + 5.0) / 145.0
        assert pareto_k(log_weight).mean() == pytest.approx(expected, abs=5.0 * error + 0.02)

    def test_is_that_of_arviz(self, arviz):
        if not hasattr(arviz, "psislw"):
            pytest.skip("this ArviZ has no psislw at its top level")
        rng = np.random.default_rng(2)
        log_weight = np.stack([rng.normal(size=1000), 0.5 * rng.standard_exponential(1000), rng.standard_t(3, 1000)])
        expected = [float(arviz.psislw(one)[1]) for one in log_weight]
        np.testing.assert_allclose(pareto_k(log_weight), expected, rtol=1e-6)  # its sums of weights are rounded

    def test_equal_weights_have_no_tail(self):
        assert pareto_k(np.zeros((1, 100)))[0] == -np.inf
