"""Diagnostics of walkers of few steps, against closed forms and an obvious implementation; and planted faults."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, point_scan
from walker_scene import normal, plant, run, two_hills

from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling import sample
from bayes_rs.posteriors.sampling.chains import DRIFT_LIMIT, N_ENSEMBLE, PARETO_K_LIMIT, R_HAT_LIMIT
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.posteriors.sampling.walkers import N_KEPT, diagnose_walkers
from bayes_rs.priors.registry import FlatPrior, WeakPrior


def walkers(rho, n_series, n_walker, seed):
    """Stationary autoregressive walkers, shape (1, n_series, n_walker, N_KEPT)."""
    rng = np.random.default_rng(seed)
    draws = np.empty((1, n_series, n_walker, N_KEPT))
    draws[..., 0] = rng.normal(size=draws.shape[:-1])
    for step in range(1, N_KEPT):
        draws[..., step] = rho * draws[..., step - 1] + np.sqrt(1.0 - rho**2) * rng.normal(size=draws.shape[:-1])
    return draws


class TestDiagnosis:
    @pytest.mark.parametrize("rho", [0.0, 0.4, 0.9])
    def test_effective_size_is_that_of_the_autocorrelation(self, rho):
        n_walker = 512
        lag = np.arange(1, N_KEPT)
        exact = n_walker * N_KEPT / (1.0 + 2.0 * np.sum((1.0 - lag / N_KEPT) * rho**lag))
        found = diagnose_walkers(walkers(rho, 400, n_walker, 1)).ess_bulk[0]
        # γ₁ of independent walkers has an sd of γ₀/√W, and only its positive half counts: 2 · 0.4/√W on average
        expected = exact / (1.0 + 0.8 / np.sqrt(n_walker))
        assert found.mean() == pytest.approx(expected, rel=0.02)
        assert found.std() / found.mean() < 1.3 * np.sqrt(2.0 / n_walker) + 0.02
        assert (found < exact).mean() > 0.5  # it errs to the careful side

    def test_size_of_the_tails_is_that_of_the_share(self):
        found = diagnose_walkers(walkers(0.0, 400, 512, 2)).ess_tail[0]
        # the smaller of two ends, each with an sd of √(2/W)
        assert 0.85 < found.mean() / (512 * N_KEPT) < 1.0

    def test_a_start_that_neighbours_share_is_not_counted_twice(self):
        pairs = np.repeat(walkers(0.9, 400, 256, 3), 2, axis=2)
        single = diagnose_walkers(walkers(0.9, 400, 256, 3)).ess_bulk[0]
        assert diagnose_walkers(pairs).ess_bulk[0].mean() == pytest.approx(single.mean(), rel=0.06)

    def test_r_hat_and_drift_are_those_of_an_obvious_implementation(self):
        draws = np.exp(walkers(0.5, 6, 64, 4))
        draws[..., 2:] *= 1.3
        found = diagnose_walkers(draws)
        for series in range(6):
            hats, drifts = [], []
            one = draws[0, series]
            for values in (one - one.mean(), np.abs(one - np.median(one))):
                groups = values.reshape(N_ENSEMBLE, -1, N_KEPT)
                groups = np.array([half.ravel() for group in groups for half in (group[:, :2], group[:, 2:])])
                n = groups.shape[1]
                hats.append(np.sqrt((n - 1) / n + groups.mean(axis=1).var(ddof=1) / groups.var(axis=1, ddof=1).mean()))
                change = values[:, 2:].sum(axis=1) - values[:, :2].sum(axis=1)
                away = (change - change.mean()).reshape(N_ENSEMBLE, -1)
                beside = max(np.sum(away[:, 1:] * away[:, :-1]), 0.0)
                drifts.append(abs(change.mean()) / (np.sqrt(np.sum(away**2) + 2.0 * beside) / len(change)))
            assert found.r_hat[0, series] == pytest.approx(max(hats), rel=1e-10)
            assert found.drift[0] >= max(drifts) * (1.0 - 1e-10)

    def test_an_agreeing_chain_rarely_drifts(self):
        drift = np.array([diagnose_walkers(walkers(0.4, 6, 512, seed)).drift[0] for seed in range(200)])
        assert drift.max() < DRIFT_LIMIT  # 12 numbers a record: the chance is 7e-6 of each
        assert np.median(drift) < 2.0

    def test_the_usual_formula_for_chains_laid_end_to_end_agrees(self):
        """Walkers end to end in 32 chains, as they are kept: bulk ESS by Geyer's sequence is not smaller by much."""
        draws = walkers(0.5, 100, 512, 5)
        usual = diagnostics.ess_bulk(draws.reshape(1, 100, 32, 64))[0]
        ours = diagnose_walkers(draws).ess_bulk[0]
        assert 0.9 < usual.mean() / ours.mean() < 1.15

    def test_equal_draws_have_no_size(self):
        found = diagnose_walkers(np.ones((1, 2, 64, N_KEPT)))
        assert np.isnan(found.ess_bulk).all()
        assert np.isnan(found.r_hat).all()
        assert found.drift.tolist() == [0.0]


def between(fault):
    """A fault that neither is the hardest to see nor the hardest to mend: in the long run only."""
    return pytest.param(fault, marks=pytest.mark.long)


class TestPlantedFaults:
    """What a first look says of a fault, and that a record that falls short walks on until its draws are right."""

    def check(self, chains, *, mean=0.0, sd=1.0):
        """Draws are right where nothing is said: the worst of 32 records in six coordinates, in standard errors."""
        told = chains.missed(1000)
        flat = chains.stress.reshape(len(told), -1, 6)
        error = 1.0 / np.sqrt(chains.ess_bulk)
        assert np.all(np.abs(flat.mean(axis=1) - mean)[~told] < 5.0 * (error * sd)[~told])
        assert np.all(np.abs(flat.std(axis=1) / sd - 1.0)[~told] < 0.12)
        return told

    @pytest.mark.parametrize("sampler", ["emcee", "direct"])
    @pytest.mark.parametrize(
        "fault", [{"shift": 1.0}, {"shift": 2.0}, {"shift": 3.0}, {"narrow": 2.0}, {"narrow": 4.0}]
    )
    def test_a_proposal_that_is_off_mends_itself(self, monkeypatch, sampler, fault):
        plant(monkeypatch, **fault)
        assert not self.check(run(normal, sampler=sampler, max_extension=5)).any()

    @pytest.mark.parametrize("sampler", ["emcee", "direct"])
    @pytest.mark.parametrize(
        "fault", [{"shift": 2.0}, between({"shift": 3.0}), between({"narrow": 2.0}), {"narrow": 4.0}]
    )
    def test_one_that_never_mends_is_told_at_once_and_right_or_told_at_the_end(self, monkeypatch, sampler, fault):
        plant(monkeypatch, mends=False, **fault)
        first = run(normal, sampler=sampler)
        assert first.missed(1000).all()
        assert np.all(first.acceptance < 0.3)
        assert np.all(first.ess_bulk.min(axis=1) < 500.0)
        self.check(run(normal, sampler=sampler, max_extension=5))

    def test_a_first_proposal_that_is_far_too_narrow_is_seen_in_r_hat_and_weights(self, monkeypatch):
        plant(monkeypatch, mends=False, narrow=4.0)
        assert np.median(run(normal).r_hat.max(axis=1)) > 1.2
        assert np.median(run(normal, sampler="direct").pareto_k) > 0.7

    def test_a_start_with_wrong_weights_is_a_drift(self, monkeypatch):
        """Weights times exp(z): the start is off by a standard deviation, although its R-hat passes."""
        plant(monkeypatch, tilt=1.0)
        first = run(normal)
        assert np.all(first.drift > DRIFT_LIMIT)
        assert np.median(first.r_hat.max(axis=1)) < R_HAT_LIMIT
        monkeypatch.undo()
        plant(monkeypatch, tilt=1.0)
        assert not self.check(run(normal, max_extension=5)).any()

    def test_a_hill_that_one_ensemble_misses_is_seen_between_the_ensembles(self, monkeypatch):
        plant(monkeypatch, only_one=0)
        first = run(two_hills(12.0))
        assert first.missed(1000).all()
        assert np.median(first.r_hat.max(axis=1)) > 1.2
        assert not run(two_hills(12.0), max_extension=5).missed(1000).any()

    def test_two_hills_hold_their_shares_in_the_end(self, monkeypatch):
        plant(monkeypatch)
        chains = run(two_hills(8.0), max_extension=5)
        assert not chains.missed(1000).any()
        share = (chains.stress[..., 0] > 0.0).mean(axis=(1, 2))
        assert np.all(np.abs(share - 0.5) < 5.0 * 0.5 / np.sqrt(chains.ess_bulk[:, 0]))


def nowhere(coordinate):
    return np.full(coordinate.shape[:-1], -np.inf)


class TestHardPosteriors:
    @pytest.mark.parametrize("sampler", ["emcee", "direct", "auto"])
    @pytest.mark.parametrize("target_ess", [1, 100, 1000])
    def test_a_density_that_is_nowhere_above_zero_has_no_size(self, monkeypatch, sampler, target_ess):
        """Walkers that never had a density stay where they are, each somewhere else: that is no sample."""
        plant(monkeypatch)
        chains = run(nowhere, sampler=sampler, n_record=3, target_ess=target_ess, max_extension=1)
        assert np.isnan(chains.ess_bulk).all()
        assert np.isnan(chains.ess_tail).all()
        assert chains.missed(target_ess).all()

    def test_a_start_that_lacks_the_tails_is_made_from_more_candidates_or_told(self):
        """Two beams with hardly any noise, and no prior to speak of: a thin, bent sheet with long tails."""
        scan = point_scan([[-1.0, 0.84, 0.0], [-1.0, -0.84, 0.0]])
        noise, n = plain_noise(scan, relative_variance=0.002), 16
        rng = np.random.default_rng(4)
        variance = np.repeat(draw_variances(WeakPrior().draw(1, 1), scan, noise, rng), n, axis=0)
        gain = np.broadcast_to(design_matrix(scan), (n, 2, 6))
        covariance = np.broadcast_to(noise.covariance[0], (n, 2, 2))
        posterior = Posterior(log_normal_likelihood(variance, np.ones((n, 2), bool), gain, covariance), FlatPrior())
        long, _ = sample("direct", posterior.take(np.arange(2)), keys=np.arange(2), effort=Effort(7, 60_000, 3))
        chains, _ = sample("emcee", posterior, keys=np.arange(n), effort=Effort(1, 1000, 4))
        end = np.quantile(long.stress[..., 0], 0.95)
        assert (chains.stress[..., 0] > end).mean() > 0.25 * 0.05  # of a start from 768 candidates it was 0.05 of that
        assert (chains.pareto_k > PARETO_K_LIMIT).any()
        assert chains.missed(1000)[chains.pareto_k > PARETO_K_LIMIT].all()
