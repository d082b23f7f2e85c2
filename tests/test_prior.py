"""Priors: one checker that all pass, and what each one says of itself."""

import numpy as np
import pytest
from scipy import stats

from bayes_rs import InputError
from bayes_rs.prior import PRIORS, FlatPrior, WeakPrior, make_prior
from bayes_rs.stress import is_realizable

EVERY = [*(make() for make in PRIORS.values()), WeakPrior(log_sd_vv=1.5, z_sd=1.0), FlatPrior(bound=0.3)]


@pytest.mark.parametrize("prior", EVERY, ids=lambda prior: f"{prior.name}")
class TestEveryPrior:
    def test_draws_are_realizable(self, prior):
        assert is_realizable(prior.draw(20_000, seed=1)).all()

    def test_draws_follow_the_density(self, prior):
        """Each coordinate's histogram against the density, integrated over the others by their independence."""
        coordinate = prior.draw_coordinate(50_000, np.random.default_rng(2))
        centre = np.median(coordinate, axis=0)
        grid = np.linspace(-40.0, 40.0, 80_001)
        for index in range(6):
            points = np.tile(centre, (len(grid), 1))
            points[:, index] = grid
            density = np.exp(prior.log_density(points) - prior.log_density(centre))
            cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
            cumulative /= cumulative[-1]
            test = stats.kstest(coordinate[:, index], lambda x, c=cumulative: np.interp(x, grid, c))
            assert test.pvalue > 1e-4  # 6 coordinates of 4 priors: a false alarm in 400 runs, and the seed is fixed

    def test_density_is_normalized(self, prior):
        """∏ of six one-dimensional integrals: the coordinates are independent."""
        grid = np.linspace(-60.0, 60.0, 60_001)
        centre = np.median(prior.draw_coordinate(1000, np.random.default_rng(3)), axis=0)
        log_integral = 0.0
        for index in range(6):
            points = np.tile(centre, (len(grid), 1))
            points[:, index] = grid
            relative = np.exp(prior.log_density(points) - prior.log_density(centre))
            log_integral += np.log(np.trapezoid(relative, grid))
        assert log_integral + prior.log_density(centre) == pytest.approx(0.0, abs=1e-6)  # trapezoid, smooth integrand

    def test_coordinates_and_stresses_are_one_to_one(self, prior):
        coordinate = prior.draw_coordinate(50, np.random.default_rng(4))
        step = 1e-6 * np.eye(6)
        jacobian = (prior.stress(coordinate[:, None] + step) - prior.stress(coordinate[:, None] - step)) / 2e-6
        assert np.all(np.abs(np.linalg.det(jacobian)) > 0.0)

    def test_same_seed_same_draws(self, prior):
        np.testing.assert_array_equal(prior.draw(5, seed=7), prior.draw(5, seed=7))


def test_flat_prior_is_uniform_over_realizable_tensors():
    """Against rejection from the box of all symmetric tensors: the definition itself."""
    rng = np.random.default_rng(6)
    box = np.concatenate([rng.uniform(0.0, 1.0, (600_000, 3)), rng.uniform(-1.0, 1.0, (600_000, 3))], axis=1)
    accepted = box[is_realizable(box)]
    draws = FlatPrior(bound=1.0).draw(len(accepted), seed=7)
    for statistic in (lambda s: s, lambda s: np.abs(s[:, 3:]), lambda s: s[:, [3]] * s[:, [4]] * s[:, [5]]):
        for index in range(statistic(draws).shape[1]):
            assert stats.ks_2samp(statistic(accepted)[:, index], statistic(draws)[:, index]).pvalue > 1e-3


def test_flat_prior_is_not_weak():
    """The density of uu grows with uu: s = uu/bound has mean 2/3."""
    uu = FlatPrior(bound=3.0).draw(100_000, seed=8)[:, 0] / 3.0
    assert uu.mean() == pytest.approx(2.0 / 3.0, abs=5.0 * np.sqrt(1.0 / 18.0 / 100_000))


def test_weak_prior_has_the_documented_medians_and_widths():
    stress = WeakPrior().draw(200_000, seed=9)
    log_ratio = np.log(stress[:, 1:3] / stress[:, :1])
    correlation = stress[:, 3:] / np.sqrt(stress[:, [0, 0, 1]] * stress[:, [1, 2, 2]])
    spread = 5.0 / np.sqrt(200_000)  # five standard errors of a mean in units of the sd
    np.testing.assert_allclose(np.log(stress[:, 0]).mean(), 0.0, atol=2.0 * spread)
    np.testing.assert_allclose(np.log(stress[:, 0]).std(), 2.0, rtol=spread)
    np.testing.assert_allclose(log_ratio.mean(axis=0), np.log([0.5, 0.27]), atol=0.6 * spread)
    np.testing.assert_allclose(log_ratio.std(axis=0), [0.5, 0.6], rtol=spread)
    np.testing.assert_allclose(np.arctanh(correlation[:, :2]).mean(axis=0), [0.0, -0.3], atol=0.35 * spread)


def test_words_give_the_widths():
    assert "factor 50 either way" in WeakPrior().in_words()
    assert "below 25 m² s⁻²" in FlatPrior().in_words()


def test_unknown_and_invalid_priors_are_refused():
    with pytest.raises(InputError, match=r"Unknown prior 'jeffreys': it must be one of weak, flat"):
        make_prior("jeffreys")
    with pytest.raises(
        InputError, match=r"Invalid bound -1.0 m² s⁻² in prior 'flat': it must be a finite number above"
    ):
        FlatPrior(bound=-1.0)
    with pytest.raises(InputError, match=r"Invalid log_sd_vv 0.0 in prior 'weak'"):
        WeakPrior(log_sd_vv=0.0)
