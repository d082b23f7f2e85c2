"""Diagnostics for many records at once, against ArviZ, emcee and closed forms."""

import numpy as np
import pytest

from bayes_rs import InputError
from bayes_rs.posteriors import diagnostics


def autoregressive(rho, shape, seed):
    rng = np.random.default_rng(seed)
    draws = np.empty(shape)
    draws[..., 0] = rng.normal(size=shape[:-1])
    for step in range(1, shape[-1]):
        draws[..., step] = rho * draws[..., step - 1] + np.sqrt(1.0 - rho**2) * rng.normal(size=shape[:-1])
    return draws


@pytest.fixture(scope="module")
def cases():
    stuck = np.repeat(autoregressive(0.0, (8, 40), 3), 5, axis=-1)  # values that repeat, as rejected steps do
    shifted = autoregressive(0.3, (8, 200), 4) + np.repeat([0.0, 1.5], 4)[:, None]
    return np.stack(
        [
            autoregressive(0.0, (8, 200), 0),
            autoregressive(0.9, (8, 200), 1),
            autoregressive(-0.5, (8, 200), 2),
            stuck,
            shifted,
        ]
    )


class TestAgainstArviz:
    def test_bulk_ess(self, cases, arviz):
        expected = [arviz.ess(case, method="bulk") for case in cases]
        np.testing.assert_allclose(diagnostics.ess_bulk(cases), expected, rtol=1e-10)  # the same algorithm: rounding

    def test_tail_ess(self, cases, arviz):
        expected = [arviz.ess(case, method="tail", prob=(0.05, 0.95)) for case in cases]
        np.testing.assert_allclose(diagnostics.ess_tail(cases), expected, rtol=1e-10)

    def test_r_hat_of_independent_chains(self, cases, arviz):
        expected = [arviz.rhat(case) for case in cases]
        np.testing.assert_allclose(diagnostics.r_hat(cases, n_ensemble=8), expected, rtol=1e-10)


def test_autocorrelation_time_is_that_of_emcee():
    import emcee  # noqa: PLC0415 - slow to load

    draws = autoregressive(0.8, (16, 2000), 5)
    expected = emcee.autocorr.integrated_time(draws.T[:, :, None], c=5, has_walkers=True)[0]
    # emcee averages normalized autocorrelations over walkers, as we do
    assert diagnostics.autocorrelation_time(draws) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_an_autoregressive_chain(rho):
    """τ = (1 + ρ)/(1 − ρ); its relative standard deviation is about (2(2M + 1)/N)^½ with a window of M lags (Sokal)."""
    exact = (1.0 + rho) / (1.0 - rho)
    draws = autoregressive(rho, (32, 4000), 6)
    tolerance = 5.0 * np.sqrt(2.0 * (2.0 * 5.0 * exact + 1.0) / draws.size)
    assert diagnostics.autocorrelation_time(draws) == pytest.approx(
        exact, rel=tolerance + 0.01
    )  # 1 %: the window's cut


def test_r_hat_over_ensembles_sees_what_differs_between_ensembles():
    draws = autoregressive(0.2, (32, 200), 7)
    assert diagnostics.r_hat(draws, 4) < 1.01
    assert diagnostics.r_hat(draws + np.repeat([0.0, 0.0, 0.0, 1.0], 8)[:, None], 4) > 1.05


def test_r_hat_over_ensembles_sees_a_drift():
    draws = autoregressive(0.2, (32, 200), 8)
    assert diagnostics.r_hat(draws + np.linspace(0.0, 2.0, 200), 4) > 1.05


def test_r_hat_over_ensembles_sees_a_different_spread():
    draws = autoregressive(0.2, (32, 200), 9)
    assert diagnostics.r_hat(draws * np.repeat([1.0, 1.0, 1.0, 3.0], 8)[:, None], 4) > 1.05


def test_batches_are_the_same_as_one_at_a_time(cases):
    for function in (diagnostics.ess_bulk, diagnostics.ess_tail, diagnostics.autocorrelation_time):
        np.testing.assert_array_equal(function(cases), [function(case) for case in cases])


def test_constant_chains_have_no_effective_size():
    assert np.isnan(diagnostics.ess_bulk(np.ones((4, 10))))
    assert np.isnan(diagnostics.r_hat(np.ones((4, 10)), 4))


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="Chains of 3 draws are too short"):
        diagnostics.ess_bulk(np.ones((4, 3)))
    with pytest.raises(InputError, match=r"Invalid n_ensemble 3: it must divide the number of chains, 8"):
        diagnostics.r_hat(np.ones((8, 10)), 3)
