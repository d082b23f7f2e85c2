"""Campaigns: laws of the hyperprior, every move against references that share nothing with it, and the tables."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bayes_rs import InputError
from bayes_rs.campaign import CampaignPosterior, campaign_table, hyperprior, prior_from_stresses, small_matrices
from bayes_rs.campaign.cells import make_cells, size_correlation, speed_bin
from bayes_rs.campaign.conjugate import means_posterior, sums_of
from bayes_rs.campaign.hyperprior import (
    MOST_SCATTER,
    Hyper,
    draw_coordinates,
    draw_hyper,
    draw_scatter,
    group_root,
    log_density_of_scatter,
    mean_root,
    row_of_scores,
    scatter_odds,
    scatter_of_odds,
    scores_of_row,
)
from bayes_rs.campaign.learning import hyper_values, learnt_prior
from bayes_rs.campaign.record_choice import choose_records
from bayes_rs.campaign.record_moves import unseen_directions
from bayes_rs.campaign.sampling import _Run, can_learn, sample_campaign
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.likelihoods.base import Likelihood
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.posteriors import diagnostics
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.priors.registry import CampaignPrior, FlatPrior, RatioPrior, WeakPrior, load_campaign_prior, make_prior

SPEED = np.array([4.2, 4.4, 7.9, 8.1, 8.3, 11.0, 15.2, 3.6])
GROUP = ["day", "night", "day", "day", "night", "night", "day", "day"]


@dataclass(frozen=True)
class Silent(Likelihood):
    """A likelihood that tells nothing."""

    gain: np.ndarray
    offset: np.ndarray
    n_datum: np.ndarray
    dof: float = np.inf
    place: None = None

    def log_density(self, stress, offset=None, gradient=None):  # noqa: ARG002
        return np.zeros(stress.shape[:2])

    def whitened_residual(self, stress, offset=None, gradient=None):  # noqa: ARG002
        return np.zeros((*stress.shape[:2], 1))


def silent(n, prior=None):
    likelihood = Silent(np.ones((n, 1, 6)), np.zeros((n, 1)), np.ones(n, dtype=np.int64))
    return Posterior(likelihood, WeakPrior() if prior is None else prior)


def beams(opening_deg, stress, relative_sd, seed, prior=None):
    """Posterior of five beams on a cone and one along its axis, whose variances scatter independently."""
    theta = np.append(np.arange(5) * 2.0 * np.pi / 5.0, 0.0)
    phi = np.deg2rad(opening_deg) * np.append(np.ones(5), 0.0)
    direction = np.stack([-np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta) * np.sin(phi)], axis=-1)
    gain = np.broadcast_to(design_matrix(direction), (len(stress), 6, 6))
    covariance = np.broadcast_to(relative_sd**2 * np.eye(6), (len(stress), 6, 6))
    log_variance = np.log1p(relative_sd**2)
    normal = np.random.default_rng(seed).standard_normal((len(stress), 6))
    variance = np.einsum("rbk,rk->rb", gain, stress) * np.exp(np.sqrt(log_variance) * normal - 0.5 * log_variance)
    likelihood = log_normal_likelihood(variance, np.ones(variance.shape, dtype=bool), gain, covariance)
    return Posterior(likelihood, WeakPrior() if prior is None else prior)


def dense_covariance(scatter, speed_share, group_share, cells):
    """Covariance of all records' coordinates, written out from the model in words: (6 n_record)²."""
    free = np.eye(6) - scatter
    own = speed_share / np.linalg.inv(free)[0, 0]
    of_size = np.zeros((6, 6))
    of_size[0, 0] = own
    kernel = size_correlation(cells.speed, cells.speed)
    n = len(cells.of_record)
    whole = np.zeros((n, 6, n, 6))
    for k in range(n):
        for j in range(n):
            a, b = cells.of_record[k], cells.of_record[j]
            alike = 1.0 if cells.group_of[a] == cells.group_of[b] else 1.0 - group_share
            whole[k, :, j, :] = alike * (free - of_size) + kernel[cells.bin_of[a], cells.bin_of[b]] * of_size
            if j == k:
                whole[k, :, j, :] += scatter
    return whole.reshape(6 * n, 6 * n)


class TestHyperprior:
    @pytest.mark.parametrize("group", [None, GROUP])
    def test_every_record_has_the_prior_that_it_has_alone(self, group):
        """Whatever the hyperparameters are made of, z_k is standard normal: mean, covariance and shape."""
        cells = make_cells(SPEED, group)
        rng = np.random.default_rng(1)
        n = 20_000
        z = draw_coordinates(draw_hyper(n, cells, rng), cells, rng)
        for record in range(len(SPEED)):
            np.testing.assert_allclose(z[:, record].mean(axis=0), 0.0, atol=5.0 / np.sqrt(n))
            # products of two normal numbers have the variances 1 and 2
            np.testing.assert_allclose(np.cov(z[:, record], rowvar=False), np.eye(6), atol=5.0 * np.sqrt(2.0 / n))
            for i in range(6):
                assert stats.kstest(z[:, record, i], "norm").pvalue > 1e-5  # 48 of them

    def test_the_means_have_the_covariance_that_is_written_down(self):
        cells = make_cells(SPEED, GROUP)
        rng = np.random.default_rng(2)
        one = draw_hyper(1, cells, rng)
        n = 40_000
        many = Hyper(
            *(np.repeat(getattr(one, name), n, axis=0) for name in ("scatter", "speed_share", "group_share", "score"))
        )
        many = many.with_score(rng.standard_normal(many.score.shape))
        z = draw_coordinates(many, cells, rng).reshape(n, -1)
        whole = dense_covariance(one.scatter[0], one.speed_share[0], one.group_share[0], cells)
        np.testing.assert_allclose(np.cov(z, rowvar=False), whole, atol=6.0 * np.sqrt(2.0 / n))

    def test_roots(self):
        scatter = draw_scatter(50, np.random.default_rng(3))
        root = mean_root(scatter)
        np.testing.assert_allclose(root @ root.swapaxes(-1, -2), np.eye(6) - scatter, atol=1e-12)
        np.testing.assert_array_equal(root[:, 1:, -1], 0.0)
        share = np.array([0.0, 0.3, 1.0])
        group = group_root(share, 3)
        np.testing.assert_allclose(
            group @ group, (1.0 - share)[:, None, None] + share[:, None, None] * np.eye(3), atol=1e-12
        )

    def test_draws_follow_the_density(self):
        """A random walk under the density finds the same distribution of log-scatter and correlation as the draws."""
        rng = np.random.default_rng(4)
        drawn = draw_scatter(4000, rng)
        assert np.linalg.eigvalsh(drawn)[:, -1].max() < MOST_SCATTER
        walked = draw_scatter(4000, rng)
        for _ in range(60):  # the walk must leave the distribution of the draws as it is
            step = np.tril(0.15 * rng.standard_normal((4000, 6, 6)))
            matrix = np.eye(6) + step
            new = matrix @ walked @ matrix.swapaxes(-1, -2)
            _, log_det = np.linalg.slogdet(matrix)
            inverse = np.linalg.inv(matrix) - np.eye(6)
            # density of the step and of the one that leads back, and the measures of Σ and of lower triangles
            change = 0.5 * np.sum((step**2 - np.tril(inverse) ** 2), axis=(1, 2)) / 0.15**2
            diagonal = np.log(np.abs(np.einsum("nii->ni", matrix)))
            change -= 7.0 * diagonal.sum(axis=1)  # of the inverse of a lower triangular matrix: Π d_i^-(p + 1)
            log_ratio = log_density_of_scatter(new) - log_density_of_scatter(walked) + 7.0 * log_det + change
            accept = (np.log(rng.uniform(size=4000)) < log_ratio) & (diagonal.min(axis=1) > -30.0)
            walked = np.where(accept[:, None, None], new, walked)
        for i in range(6):
            assert stats.ks_2samp(walked[:, i, i], drawn[:, i, i]).pvalue > 1e-4
        assert stats.ks_2samp(walked[:, 0, 1], drawn[:, 0, 1]).pvalue > 1e-4
        assert stats.ks_2samp(np.linalg.det(walked), np.linalg.det(drawn)).pvalue > 1e-4


class TestMovesOfScatter:
    """What the moves of Σ that carry the records along are made of."""

    def test_scores_of_a_row_are_normal_and_lead_back(self):
        rng = np.random.default_rng(16)
        scatter = hyperprior._draw_untruncated(20_000, rng)
        order = np.array([3, 0, 5, 4, 1, 2])  # any: the hyperprior has no order
        lower = np.linalg.cholesky(scatter[:, order[:, None], order])
        score = scores_of_row(lower[:, -1])
        np.testing.assert_allclose(row_of_scores(score), lower[:, -1], rtol=1e-7, atol=1e-10)
        for column in score.T:
            assert stats.kstest(column, "norm").pvalue > 1e-4
        above = lower[:, np.tril_indices(5)[0], np.tril_indices(5)[1]]
        both = np.corrcoef(np.concatenate([score, above], axis=1).T)
        off = both[:6] - np.eye(6, both.shape[1])
        assert np.abs(off).max() < 5.0 / np.sqrt(20_000)

    def test_odds_lead_back_and_have_the_volume_that_they_say(self):
        scatter = draw_scatter(5, np.random.default_rng(17))
        odds = scatter_odds(scatter)
        found, volume = scatter_of_odds(odds)
        np.testing.assert_allclose(found, scatter, rtol=1e-9, atol=1e-12)
        lower = np.tril_indices(6)
        jacobian = np.empty((5, 21, 21))
        for place, (i, j) in enumerate(zip(*lower, strict=True)):
            step = np.zeros((6, 6))
            step[i, j] = step[j, i] = 1e-6
            above, below = scatter_of_odds(odds + step)[0], scatter_of_odds(odds - step)[0]
            jacobian[:, :, place] = ((above - below) / 2e-6)[:, lower[0], lower[1]]
        want = np.linalg.slogdet(jacobian)[1] - 21.0 * np.log(MOST_SCATTER)
        np.testing.assert_allclose(volume, want, rtol=1e-5, atol=1e-5)  # of the differences


class TestConjugate:
    def setup_method(self):
        given = make_cells(SPEED, GROUP)
        self.cells = given.in_order()
        rng = np.random.default_rng(5)
        self.hyper = draw_hyper(3, self.cells, rng)
        self.z = np.ascontiguousarray(draw_coordinates(self.hyper, self.cells, rng).transpose(2, 0, 1))

    def test_marginal_density_is_that_of_all_records_written_out(self):
        h = self.hyper
        found = means_posterior(h, sums_of(self.z, self.cells), self.cells)
        dense = [
            stats.multivariate_normal(
                cov=dense_covariance(h.scatter[c], h.speed_share[c], h.group_share[c], self.cells)
            ).logpdf(self.z[:, c].T.ravel())
            for c in range(3)
        ]
        constant = -3.0 * len(SPEED) * np.log(2.0 * np.pi)
        np.testing.assert_allclose(found.log_marginal + constant, dense, rtol=1e-9)

    def test_drawn_means_are_those_of_the_regression(self):
        """Mean and covariance of the means given the records, from the dense covariance by conditioning."""
        h, cells = self.hyper, self.cells
        found = means_posterior(h, sums_of(self.z, cells), cells)
        rng = np.random.default_rng(6)
        n = 20_000
        draws = np.stack([found.draw(rng)[1] for _ in range(n)])
        many = Hyper(
            np.repeat(h.scatter[1:2], n, axis=0),
            np.full(n, h.speed_share[1]),
            np.full(n, h.group_share[1]),
            draws,
        )
        means = many.means(cells)[:, cells.of_record].reshape(n, -1)
        whole = dense_covariance(h.scatter[1], h.speed_share[1], h.group_share[1], cells)
        prior = whole - np.kron(np.eye(len(SPEED)), h.scatter[1])
        gain = prior @ np.linalg.inv(whole)
        covariance = prior - gain @ prior
        sd = np.sqrt(np.diag(covariance))
        assert np.abs((means.mean(axis=0) - gain @ self.z[:, 1].T.ravel()) / sd).max() < 5.5 / np.sqrt(n)
        np.testing.assert_allclose(
            np.cov(means, rowvar=False) / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=6.0 * np.sqrt(2.0 / n)
        )


class TestSmallMatrices:
    def test_against_linear_algebra(self):
        rng = np.random.default_rng(7)
        half = rng.standard_normal((40, 7, 9))
        matrix = half @ half.swapaxes(-1, -2)
        other = np.diag(rng.uniform(size=7)) + rng.uniform()
        vector = rng.standard_normal((40, 7))
        lower = small_matrices.factor(np.moveaxis(matrix, 0, -1), np.stack([np.zeros((7, 7)), other], axis=-1))
        of_sum = np.tril(np.moveaxis(lower[:, :, 1], -1, 0))
        np.testing.assert_allclose(of_sum, np.linalg.cholesky(matrix + other), atol=1e-12)
        lower = lower[:, :, 0]
        root = np.linalg.cholesky(matrix)
        np.testing.assert_allclose(np.tril(np.moveaxis(lower, -1, 0)), root, atol=1e-12)
        forward = small_matrices.solve_lower(lower, vector.T)
        np.testing.assert_allclose(forward.T, np.linalg.solve(root, vector[..., None])[..., 0], rtol=1e-8)
        backward = small_matrices.solve_upper(lower, vector.T)
        want = np.linalg.solve(root.swapaxes(-1, -2), vector[..., None])[..., 0]
        np.testing.assert_allclose(backward.T, want, rtol=1e-8)
        product = (vector[:, None, :] @ root)[:, 0]
        np.testing.assert_allclose(small_matrices.times_upper(lower, vector.T).T, product, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(small_matrices.log_diagonal(lower), 0.5 * np.linalg.slogdet(matrix)[1], rtol=1e-9)


def run_of(posterior, speed, group, n_chain, n_sweep, seed):
    """Chains after burn-in, with draws kept; nothing is released, so that the other moves have to be right."""
    given = make_cells(speed, group)
    run = _Run(posterior.take(given.order()), posterior.prior, given.in_order(), np.random.default_rng(seed), n_chain)
    run.unseen, run.level = np.empty((6, 0)), np.empty((n_chain, 0))
    run.burn_in()
    run.advance(n_sweep)
    return run


@pytest.fixture(scope="module", params=[GROUP], ids=["two groups"])
def run(request):
    return run_of(silent(len(SPEED)), SPEED, request.param, 24, 800, 8)


@pytest.mark.slow
class TestNothingTold:
    """A campaign whose likelihoods are flat must give back the hyperprior, by all of its moves together."""

    def test_hyperparameters_are_those_of_the_hyperprior(self, run):
        values = hyper_values(run.base, run.hyper_draws(), run.cells)
        prior = hyper_values(run.base, draw_hyper(20_000, run.cells, np.random.default_rng(9)), run.cells)
        for name, drawn in values.items():
            ess = float(diagnostics.diagnose(drawn.reshape(24, -1), 24).ess_bulk)
            assert ess > 50.0, name  # so that the law has power
            for level in (0.1, 0.5, 0.9):
                share = np.mean(drawn < np.quantile(prior[name], level))
                # 90 numbers, errors in units of their own: a false alarm in some thousand runs
                assert abs(share - level) < 4.5 * np.sqrt(level * (1.0 - level) * (1.0 / ess + 1.0 / 20_000)), name

    def test_the_learnt_prior_is_the_prior_that_it_began_with(self, run):
        prior = learnt_prior(run.base, run.hyper_draws(), run.cells)
        at = prior.for_records(np.array([4.0, 8.0, 30.0]), ["day"] * 3)
        covariance = at.root @ at.root.swapaxes(-1, -2)
        np.testing.assert_allclose(at.mean, 0.0, atol=0.2)  # 5/√(effective draws)
        np.testing.assert_allclose(covariance, np.broadcast_to(np.eye(6), (3, 6, 6)), atol=0.2)
        ratio = prior.interval_widths() / WeakPrior().interval_widths()
        np.testing.assert_allclose(ratio[3:], 1.0, atol=0.6)

    def test_records_have_the_prior_that_they_have_alone(self, run):
        z = np.stack(run.kept, axis=1)  # (6, draw, chain, record)
        np.testing.assert_allclose(z.mean(axis=(1, 2)), 0.0, atol=0.25)
        np.testing.assert_allclose(z.std(axis=(1, 2)), 1.0, atol=0.15)


class TestAgainstBruteForce:
    def test_three_records_by_weighing_campaigns_of_the_hyperprior(self):
        """Posterior means and spreads of hyperparameters and records, from 150 000 campaigns without data."""
        speed = np.array([6.0, 6.2, 9.1])
        stress = WeakPrior().stress(
            np.array([[0.3, 0.8, 0.0, 0.0, 0.0, 0.0], [0.6, 0, -1, 0, 0, 0], [1.1, 0, 0, 0, 1, 0]])
        )
        posterior = beams(30.0, stress, 0.8, 10)
        given = make_cells(speed)
        rng = np.random.default_rng(11)
        hyper = draw_hyper(150_000, given, rng)
        z = draw_coordinates(hyper, given, rng)
        log_weight = posterior.likelihood.log_density(posterior.prior.stress(z.swapaxes(0, 1))).sum(axis=0)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        effective = 1.0 / np.sum(weight**2)
        assert effective > 500.0
        want = hyper_values(posterior.prior, hyper, given)
        want |= {f"z {k}, {i}": z[:, k, i] for k in range(3) for i in range(6)}
        run = run_of(posterior, speed, None, 24, 300, 12)
        have = hyper_values(posterior.prior, run.hyper_draws(), run.cells)
        kept = np.stack(run.kept, axis=1).astype(np.float64)
        have |= {f"z {k}, {i}": kept[i, :, :, k].T.ravel() for k in range(3) for i in range(6)}
        for name, value in have.items():
            mean = weight @ want[name]
            sd = np.sqrt(weight @ (want[name] - mean) ** 2)
            ess = float(diagnostics.diagnose(value.reshape(24, -1), 24).ess_bulk)
            error = sd * np.sqrt(1.0 / ess + 1.0 / effective)
            assert abs(value.mean() - mean) < 4.5 * error, name
            assert abs(np.log(value.std() / sd)) < 5.0 * np.sqrt(1.0 / ess + 1.0 / effective), name


@pytest.fixture(scope="module")
def campaign():
    rng = np.random.default_rng(13)
    speed = rng.uniform(5.0, 12.0, 40)
    shape = np.array([1.0, 0.9, 0.6, 0.0, -0.25, 0.0])
    stress = shape * ((0.1 * speed) ** 2 * np.exp(0.3 * rng.standard_normal(40)))[:, None]
    return sample_campaign(beams(45.0, stress, 0.25, 14), speed, seed=15, most_sweeps=600, n_chain=4), stress, speed


class TestSampleCampaign:
    def test_the_campaign_learns_the_ratios(self, campaign):
        found, stress, _ = campaign
        mean = found.stress.mean(axis=2).reshape(-1, 6)
        for i in (0, 1, 2, 4):
            assert abs(mean[:, i].mean() - stress[:, i].mean()) < 3.5 * mean[:, i].std()
        hyper = found.hyper.set_index("name")
        assert hyper.loc["mean ln(ww/uu)", "decided"] > 0.8
        assert hyper.loc["mean ln(uu)", "decided"] > 0.95

    def test_what_is_returned(self, campaign):
        found, _, speed = campaign
        assert found.n_record == 40
        assert found.stress.shape[2:] == (40, 6)
        assert found.stress.shape[0] >= 4
        np.testing.assert_array_equal(found.wind_speed, speed)
        assert list(found.hyper.columns) == [
            "name", "mean", "low", "high", "prior_mean", "prior_low", "prior_high", "interval",
            "decided", "ess", "r_hat"
        ]  # fmt: skip
        assert all(0.0 < share < 1.0 for share in found.acceptance.values())
        assert found.prior.n_record == 40
        assert found.prior_stress.shape[1:] == (40, 6)

    def test_records_keep_their_places(self, campaign):
        """Records are sorted inside; outside, each draw is that of its own record."""
        found, stress, _ = campaign
        size = np.log(found.stress[..., 0]).mean(axis=(0, 1))
        assert np.corrcoef(size, np.log(stress[:, 0]))[0, 1] > 0.95

    def test_same_seed_same_campaign(self, monkeypatch):
        monkeypatch.setattr("bayes_rs.campaign.sampling._BURN_IN", (20,))
        stress = WeakPrior().draw(20, 16)
        posterior, speed = beams(45.0, stress, 0.3, 17), np.linspace(4.0, 9.0, 20)
        one, two = (sample_campaign(posterior, speed, seed=3, most_sweeps=50, n_chain=4) for _ in range(2))
        np.testing.assert_array_equal(one.stress, two.stress)
        assert not one.converged

    def test_a_prior_that_cannot_begin(self):
        assert can_learn(WeakPrior())
        assert can_learn(RatioPrior())
        assert not can_learn(FlatPrior())
        with pytest.raises(InputError, match=r"Prior 'flat' cannot begin a campaign: .*'weak' or 'ratio'"):
            sample_campaign(silent(3, FlatPrior()), np.ones(3), seed=1)

    def test_wind_speeds_and_groups_are_checked(self):
        with pytest.raises(InputError, match=r"Invalid wind_speed of shape \(2,\): .* each of 3 records"):
            sample_campaign(silent(3), np.ones(2), seed=1)
        with pytest.raises(InputError, match=r"Invalid wind speed nan m/s of record 1 of the campaign"):
            sample_campaign(silent(3), np.array([1.0, np.nan, 2.0]), seed=1)
        with pytest.raises(InputError, match=r"Invalid group of 2 entries"):
            sample_campaign(silent(3), np.ones(3), group=["a", "b"], seed=1)


class TestUnseen:
    """Covariances of nearly 0 and alike variances of v and w must not tell how large these are: no beam does."""

    @staticmethod
    def cone():
        """Records of isotropic air, from six beams on one cone."""
        rng = np.random.default_rng(16)
        stress = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * np.exp(0.1 * rng.standard_normal((24, 1)))
        posterior = beams(15.0, stress, 0.02, 17)
        cone_only = posterior.likelihood.gain[:, :5]
        variance = np.einsum("rbk,rk->rb", cone_only, stress) * np.exp(0.02 * rng.standard_normal((24, 5)))
        used = np.ones(variance.shape, dtype=bool)
        covariance = np.broadcast_to(0.02**2 * np.eye(5), (24, 5, 5))
        return Posterior(log_normal_likelihood(variance, used, cone_only, covariance), WeakPrior())

    def test_one_direction_is_unseen(self):
        posterior = self.cone()
        at = WeakPrior().coordinate(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        unseen = unseen_directions(posterior, at)
        assert unseen.shape == (6, 1)
        # along it, the variances of all beams stay the same
        stress = WeakPrior().stress(at + 1e-5 * np.array([[-1.0], [1.0]]) * unseen[:, 0])
        change = posterior.likelihood.gain[0] @ (stress[1] - stress[0])
        np.testing.assert_allclose(change, 0.0, atol=1e-9)
        assert np.abs(stress[1] - stress[0]).max() > 1e-6

    @pytest.mark.slow
    def test_its_mean_keeps_the_width_of_the_prior(self, monkeypatch):
        speed = np.full(24, 8.0)

        def held():
            """Return whether the interval of ww/uu holds the truth, and the sd of the mean along what is unseen."""
            found = sample_campaign(self.cone(), speed, seed=18, most_sweeps=500, n_chain=20)
            row = found.hyper.set_index("name").loc["mean ln(ww/uu)"]
            z = WeakPrior().coordinate(found.stress).mean(axis=2).reshape(-1, 6)
            return row["low"] < 0.0 < row["high"], float(np.std(z @ direction))

        at = WeakPrior().coordinate(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        direction = unseen_directions(self.cone(), at)[:, 0]
        inside, spread = held()
        assert inside
        assert spread > 0.6  # of records and mean together it is 1; the scatter of 24 records averages out
        monkeypatch.setattr("bayes_rs.campaign.record_moves._UNSEEN", -1.0)
        assert held()[1] < spread


class TestChoice:
    def test_every_record_has_the_same_chance(self):
        speed = np.random.default_rng(18).uniform(3.0, 15.0, 200)
        count = np.zeros(200)
        for seed in range(2000):
            chosen = choose_records(speed, 30, seed)
            assert len(np.unique(chosen)) == 30
            count[chosen] += 1
        expected = 2000 * 0.15
        assert np.abs(count - expected).max() < 5.0 * np.sqrt(expected * 0.85)

    def test_as_many_of_each_wind_speed_and_evenly_in_time(self):
        speed = np.repeat([5.0, 9.0], [300, 700])
        np.random.default_rng(19).shuffle(speed)
        chosen = choose_records(speed, 100, 1)
        assert abs(np.count_nonzero(speed[chosen] == 5.0) - 30) <= 1
        gaps = np.diff(
            np.flatnonzero(speed == 5.0)[np.searchsorted(np.flatnonzero(speed == 5.0), chosen[speed[chosen] == 5.0])]
        )
        assert gaps.max() < 4 * gaps.min() + 30

    def test_all_of_few(self):
        np.testing.assert_array_equal(choose_records(np.ones(5), 10, 1), np.arange(5))


def known_campaign(stress, speed, n_prior=200):
    """A campaign whose stresses (n_draw, n_record, 6) are given."""
    cells = make_cells(speed)
    rng = np.random.default_rng(20)
    hyper = draw_hyper(n_prior, cells, rng)
    return CampaignPosterior(
        prior=learnt_prior(WeakPrior(), hyper, cells),
        stress=stress[None],
        wind_speed=speed,
        group=("",) * len(speed),
        hyper=pd.DataFrame(),
        acceptance={},
        n_sweep=1,
        ess=1.0,
        r_hat=1.0,
        converged=True,
        prior_stress=WeakPrior().stress(draw_coordinates(hyper, cells, rng)),
    )


class TestTable:
    def setup_method(self):
        rng = np.random.default_rng(21)
        self.speed = rng.uniform(6.6, 9.4, 60)
        self.stress = WeakPrior().stress(0.3 * rng.standard_normal((50, 60, 6)))

    def test_numbers_are_those_of_loops(self):
        table = campaign_table(known_campaign(self.stress, self.speed), prob=0.8)
        every = table[table["bin"] == "all"].set_index("quantity")
        loops = {
            "uw": [np.mean([r[4] for r in draw]) for draw in self.stress],
            "tke": [np.mean([0.5 * (r[0] + r[1] + r[2]) for r in draw]) for draw in self.stress],
            "ti": [np.mean([r[0] ** 0.5 / u for r, u in zip(draw, self.speed, strict=True)]) for draw in self.stress],
            "u_star": [np.mean([(r[4] ** 2 + r[5] ** 2) ** 0.25 for r in draw]) for draw in self.stress],
            "sd_ww": [np.std([r[2] for r in draw]) for draw in self.stress],
            "rho_vw": [np.mean([r[5] / (r[1] * r[2]) ** 0.5 for r in draw]) for draw in self.stress],
        }
        for name, values in loops.items():
            row = every.loc[name]
            assert row["mean"] == pytest.approx(np.mean(values))
            assert (row["low"], row["high"]) == pytest.approx(tuple(np.quantile(values, [0.1, 0.9])))
        assert (table["n_record"][table["bin"] == "all"] == 60).all()
        assert table["bin"].iloc[0] == "all"
        assert table["decided"].between(0.0, 1.0).all()

    def test_bins_of_wind_speed_have_turbulence_intensity(self):
        table = campaign_table(known_campaign(self.stress, self.speed))
        bins = table[table["bin"] == "7.5-8.5 m/s"].set_index("quantity")
        assert list(bins.index) == ["ti", "ti_p90"]
        part = speed_bin(self.speed) == 8
        ti = np.sqrt(self.stress[:, part, 0]) / self.speed[part]
        assert bins.loc["ti", "n_record"] == part.sum()
        assert bins.loc["ti", "mean"] == pytest.approx(ti.mean())
        # NumPy's "hazen" is linear between the middles of the steps
        assert bins.loc["ti_p90", "mean"] == pytest.approx(np.quantile(ti, 0.9, axis=1, method="hazen").mean())

    def test_difference_estimator(self):
        """An auxiliary that is right gives the mean of all records, from a tenth of them."""
        rng = np.random.default_rng(22)
        speed = rng.uniform(6.6, 9.4, 600)
        truth = WeakPrior().stress(0.3 * rng.standard_normal((600, 6)))
        chosen = choose_records(speed, 60, 1)
        draws = np.repeat(truth[chosen][None], 400, axis=0)
        sampled = known_campaign(draws, speed[chosen])
        row = campaign_table(sampled, wind_speed=speed, stress_mean=truth, chosen=chosen).set_index("quantity")
        assert row["mean"].iloc[0] == pytest.approx(truth[:, 0].mean(), rel=1e-9)
        assert row["n_record"].iloc[0] == 600
        # an auxiliary that tells nothing leaves the error of a sample of 60 of 600
        blunt = np.ones((600, 6)) * [1.0, 0.5, 0.3, 0.0, -0.1, 0.0]
        row = campaign_table(sampled, wind_speed=speed, stress_mean=blunt, chosen=chosen, prob=0.6827).iloc[0]
        error = truth[chosen, 0].std() / np.sqrt(60) * np.sqrt(0.9)
        assert 0.5 * (row["high"] - row["low"]) == pytest.approx(error, rel=0.2)

    def test_what_does_not_fit_is_refused(self):
        campaign = known_campaign(self.stress, self.speed)
        with pytest.raises(InputError, match="Give wind_speed, stress_mean and chosen together"):
            campaign_table(campaign, wind_speed=self.speed)
        with pytest.raises(InputError, match="Invalid chosen of 2 entries"):
            campaign_table(campaign, wind_speed=self.speed, stress_mean=self.stress[0], chosen=np.array([0, 1]))
        with pytest.raises(InputError, match=r"Invalid prob 1.0"):
            campaign_table(campaign, prob=1.0)


class TestLearntPrior:
    def learn(self, n, group=None, seed=23):
        rng = np.random.default_rng(seed)
        speed = rng.uniform(4.0, 14.0, n)
        z = np.array([0.0, 0.5, 1.0, 0.0, -0.4, 0.0]) + 0.2 * rng.standard_normal((n, 6))
        z[:, 0] += np.log(speed / 8.0)
        if group is not None:
            z[:, 1] += np.where(np.array(group) == "day", 0.4, -0.4)
        return prior_from_stresses(WeakPrior().stress(z), speed, group=group, seed=1), z, speed

    def test_many_tensors_decide(self):
        prior, z, _ = self.learn(400)
        at = prior.for_records(np.array([5.0, 8.0, 12.0]))
        np.testing.assert_allclose(at.mean[:, 1:], np.broadcast_to(z[:, 1:].mean(axis=0), (3, 5)), atol=0.06)
        np.testing.assert_allclose(at.mean[:, 0], np.log(np.array([5.0, 8.0, 12.0]) / 8.0), atol=0.1)
        sd = np.sqrt(np.einsum("rik,rik->ri", at.root, at.root))
        np.testing.assert_allclose(sd[:, 1:], 0.2, atol=0.03)
        np.testing.assert_allclose(np.sqrt(prior.covariance[0, 0]), np.std(z[:, 0]), atol=0.06)

    def test_far_from_the_bins_the_size_is_uncertain(self):
        prior, _, _ = self.learn(400)
        near, far = prior.for_records(np.array([8.0, 55.0])).root[:, 0, 0]
        assert far > 2.0 * near
        assert far < 1.05

    def test_few_tensors_leave_most_to_the_prior(self):
        prior, z, _ = self.learn(1)
        assert np.all(np.abs(prior.mean) < np.abs(z).max())
        assert np.all(np.diag(prior.covariance) > 0.2)

    def test_groups_are_told_apart_and_a_new_one_lies_between(self):
        group = ["day", "night"] * 60
        prior, _, _ = self.learn(120, group)
        day, night, new = (prior.for_records(np.array([8.0]), [name]) for name in ("day", "night", "dusk"))
        assert day.mean[0, 1] == pytest.approx(0.9, abs=0.12)
        assert night.mean[0, 1] == pytest.approx(0.1, abs=0.12)
        assert night.mean[0, 1] < new.mean[0, 1] < day.mean[0, 1]
        assert new.root[0, 1, 1] > 1.3 * day.root[0, 1, 1]
        assert prior.groups["day"].n_record == 60

    def test_a_file_brings_it_back(self, tmp_path):
        prior, _, _ = self.learn(60, ["a b", 'c"d'] * 30)
        prior.save(tmp_path / "prior.toml")
        again = make_prior(f"campaign:{tmp_path / 'prior.toml'}")
        assert isinstance(again, CampaignPrior)
        assert again.in_words() == prior.in_words()
        speed = np.array([3.3, 8.0, np.nan])
        for group in (None, ["a b"] * 3):
            one, two = prior.for_records(speed, group), again.for_records(speed, group)
            np.testing.assert_array_equal(one.mean, two.mean)
            np.testing.assert_array_equal(one.root, two.root)

    def test_records_prior_is_normal_and_can_be_taken_apart(self):
        prior, _, _ = self.learn(60)
        at = prior.for_records(np.array([4.0, 8.0, np.nan]))
        z = np.random.default_rng(24).standard_normal((3, 5, 6))
        for k in range(3):
            dense = stats.multivariate_normal(at.mean[k], at.root[k] @ at.root[k].T)
            np.testing.assert_allclose(at.log_density(z)[k], dense.logpdf(z[k]), rtol=1e-10)
        np.testing.assert_array_equal(at.take(np.array([1])).log_density(z[1:2]), at.log_density(z)[1:2])
        np.testing.assert_allclose(at.mean[2], prior.mean)
        assert WeakPrior().for_records(np.ones(2)) == WeakPrior()
        posterior = Posterior(silent(3).likelihood, at)
        assert posterior.take(np.array([2])).prior.mean.shape == (1, 6)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (("base = { ", "base = { color = 1, "), "its base or a table of numbers cannot be used"),
            (("n_record = 60", "n_record = 0"), r"n_record = 0"),
            (("format = ", "former = "), "unknown key|required key"),
            (("wind_speed = [0.25, 0.5", "wind_speed = [0.5, 0.25"), "must be above zero and rise"),
            (("size_mean = [", "size_mean = [1.0, "), "Invalid size_mean of group ''"),
        ],
    )
    def test_a_file_that_is_not_one_is_refused(self, tmp_path, change, message):
        prior, _, _ = self.learn(60)
        path = tmp_path / "prior.toml"
        prior.save(path)
        text = path.read_text(encoding="utf-8")
        assert change[0] in text
        path.write_text(text.replace(*change, 1), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            load_campaign_prior(path)

    def test_no_file(self):
        with pytest.raises(InputError, match=r"There is no file 'nowhere.toml'"):
            make_prior("campaign:nowhere.toml")
        with pytest.raises(InputError, match=r"Invalid prior 'campaign': write campaign:FILE"):
            make_prior("campaign")

    def test_tensors_are_checked(self):
        with pytest.raises(InputError, match=r"of entry 1: it must be positive definite"):
            prior_from_stresses([[1.0, 1.0, 1.0, 0, 0, 0], [1.0, 1.0, 1.0, 1.5, 0, 0]], [5.0, 5.0])
        with pytest.raises(InputError, match=r"Prior 'flat' cannot begin a campaign"):
            prior_from_stresses(np.ones((2, 6)) * [1, 1, 1, 0, 0, 0], [5.0, 5.0], prior="flat")


def test_coordinates_of_stresses_are_the_inverse_map():
    for prior in (WeakPrior(), RatioPrior(vv=0.8, sd_vv=0.1, uw=-0.4, vw=0.2)):
        z = np.random.default_rng(25).standard_normal((200, 6))
        np.testing.assert_allclose(prior.coordinate(prior.stress(z)), z, atol=1e-10)


def ranks_of_campaigns(n_campaign, n_record, seed):
    """Simulation-based calibration: ranks of true hyperparameters among draws, shape (n_campaign, n_number)."""
    ranks = []
    scan = load_scan("6-beam@opening_angle_deg=45")
    gain = design_matrix(np.asarray(scan.geometry()["direction"], dtype=np.float64))
    for index in range(n_campaign):
        rng = np.random.default_rng([seed, index])
        speed = rng.uniform(4.5, 9.5, n_record)
        cells = make_cells(speed)
        hyper = draw_hyper(1, cells, rng)
        prior = WeakPrior()
        z = draw_coordinates(hyper, cells, rng)[0]
        relative = 0.05 * (0.4 * np.eye(6) + 0.6)  # that of a record of ten minutes, roughly
        log_covariance = np.log1p(relative)
        normal = rng.standard_normal((n_record, 6)) @ np.linalg.cholesky(log_covariance).T
        variance = (prior.stress(z) @ gain.T) * np.exp(normal - 0.5 * np.diag(log_covariance))
        likelihood = log_normal_likelihood(
            variance,
            np.ones(variance.shape, dtype=bool),
            np.broadcast_to(gain, (n_record, 6, 6)),
            np.broadcast_to(relative, (n_record, 6, 6)),
        )
        run = run_of(Posterior(likelihood, prior), speed, None, 8, 150, int(rng.integers(2**31)))
        truth = hyper_values(prior, hyper, cells)
        found = hyper_values(prior, run.hyper_draws(), run.cells)
        one = [float(np.mean(found[name] < truth[name][0])) for name in found]
        of_records = np.stack(run.means).reshape(-1, 6)
        ranks.append([*one, *np.mean(of_records < prior.stress(z).mean(axis=0), axis=0)])
    return np.array(ranks)


def chi_square(ranks, n_bin):
    """p-values of uniform ranks, one for each number."""
    return np.array(
        [
            stats.chisquare(np.histogram(column, np.linspace(0.0, 1.0 + 1e-12, n_bin + 1))[0]).pvalue
            for column in ranks.T
        ]
    )


@pytest.mark.slow
def test_calibration_of_a_few_campaigns(monkeypatch):
    monkeypatch.setattr("bayes_rs.campaign.sampling._BURN_IN", (40, 80, 80))
    ranks = ranks_of_campaigns(6, 10, 26)
    # mean ranks of 6 campaigns have the sd 0.29/√6; 34 numbers, not independent
    assert np.abs(ranks.mean(axis=0) - 0.5).max() < 4.0 * 0.2887 / np.sqrt(6.0)


@pytest.mark.long
def test_calibration_of_the_hierarchical_model():
    ranks = ranks_of_campaigns(200, 16, 27)
    pvalue = chi_square(ranks, 10)
    assert pvalue.min() > 1e-4
    assert np.mean(pvalue < 0.05) < 0.25
