"""Credible intervals: exact ones of known distributions, and the laws that tell the two kinds apart."""

import numpy as np
import pytest
import scipy

from bayes_rs import InputError
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.intervals import INTERVALS, interval_levels, interval_of, interval_words

N = 40_001
"""Draws at even steps of probability: no Monte-Carlo error, and ends as near the exact ones as the steps are."""


def even_draws(distribution):
    return distribution.ppf((np.arange(N) + 0.5) / N)


def narrowest(distribution, prob):
    """Return the exact interval of highest density: that whose lower level minimizes the width."""
    found = scipy.optimize.minimize_scalar(
        lambda below: distribution.ppf(below + prob) - distribution.ppf(below),
        bounds=(1e-12, 1.0 - prob - 1e-12),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return distribution.ppf(found.x), distribution.ppf(found.x + prob)


@pytest.mark.parametrize("prob", [0.5, 0.9])
@pytest.mark.parametrize("distribution", [scipy.stats.norm(2.0, 0.5), scipy.stats.gamma(2.0, scale=0.7)])
class TestExact:
    def test_highest_density(self, distribution, prob):
        low, high = interval_of(even_draws(distribution), prob, "highest-density")
        exact = narrowest(distribution, prob)
        assert high - low == pytest.approx(exact[1] - exact[0], rel=2e-4)  # a few steps
        # near the narrowest the width changes with the square of the place, so the place is only known to a root
        np.testing.assert_allclose([low, high], exact, atol=0.02)

    def test_equal_tailed(self, distribution, prob):
        exact = distribution.interval(prob)
        np.testing.assert_allclose(interval_of(even_draws(distribution), prob), exact, rtol=1e-3)

    def test_both_hold_the_probability(self, distribution, prob):
        draws = np.sort(even_draws(distribution))
        for kind in INTERVALS:
            below, above = interval_levels(draws, prob, kind)
            assert above - below == pytest.approx(prob, abs=2.0 / N)


def test_equal_tailed_is_by_quantiles():
    draws = np.random.default_rng(1).standard_normal((3, 500))
    np.testing.assert_allclose(interval_of(draws, 0.9), np.quantile(draws, [0.05, 0.95], axis=1), rtol=1e-12)


def test_highest_density_is_that_of_arviz():
    import arviz  # noqa: PLC0415 - slow to load

    draws = np.random.default_rng(2).gamma(2.0, size=(4, 700))
    found = np.stack(interval_of(draws, 0.9, "highest-density"), axis=-1)
    expected = [np.asarray(arviz.hdi(row, hdi_prob=0.9)) for row in draws]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_only_the_equal_tailed_one_is_carried_over_by_a_function_that_grows():
    draws = np.random.default_rng(3).standard_normal(10_001)  # so many that the ends are draws themselves
    direct = np.exp(np.stack(interval_of(draws, 0.9)))
    np.testing.assert_allclose(np.stack(interval_of(np.exp(draws), 0.9)), direct, rtol=1e-12)
    mapped = np.exp(np.stack(interval_of(draws, 0.9, "highest-density")))
    assert interval_of(np.exp(draws), 0.9, "highest-density")[1] < 0.9 * mapped[1]


def test_the_kinds_are_named_and_others_refused():
    assert interval_words(0.9, "highest-density") == "90 % interval, highest-density"
    with pytest.raises(InputError, match=r"Invalid prob 1.5: it must be between 0 and 1"):
        interval_of(np.ones(10), 1.5)
    for call in (lambda: interval_of(np.ones(10), 0.9, "hdi"), lambda: FitOptions(interval="hdi")):
        with pytest.raises(InputError, match="interval 'hdi'"):
            call()
