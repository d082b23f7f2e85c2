"""Transforms in log k: against integrals in closed form."""

import numpy as np
import pytest

from bayes_rs.turbulence.log_transform import bessel_mellin, cosine_mellin, log_convolution, sine_mellin

LOG_K = -16.0 + 0.2 * np.arange(121)
R = np.array([1e-3, 0.1, 1.0, 3.0, 10.0])


class TestClosedForms:
    @pytest.mark.parametrize("bias", [0.3, 0.4])
    def test_hankel_transform_of_a_gaussian(self, bias):
        """The integral of k J_0(kr) exp(-k²/2) is exp(-r²/2), whatever the bias."""
        weights = log_convolution(LOG_K, np.log(R), 0.2, bias, bessel_mellin(0))
        k = np.exp(LOG_K)
        np.testing.assert_allclose(weights @ (k**2 * np.exp(-0.5 * k**2)), np.exp(-0.5 * R**2), atol=1e-5)

    @pytest.mark.parametrize("m", [1, 2, 5])
    def test_hankel_transforms_of_higher_order(self, m):
        """The integral of k^(m+1) J_m(kr) exp(-k²/2) is r^m exp(-r²/2)."""
        weights = log_convolution(LOG_K, np.log(R), 0.2, 0.3, bessel_mellin(m))
        k = np.exp(LOG_K)
        exact = R**m * np.exp(-0.5 * R**2)
        np.testing.assert_allclose(weights @ (k ** (m + 2) * np.exp(-0.5 * k**2)), exact, atol=1e-4 * 3.0**m)

    def test_fourier_transforms_of_an_exponential(self):
        """Integrals of cos(kr) and sin(kr) exp(-k) are 1/(1+r²) and r/(1+r²)."""
        k = np.exp(LOG_K)
        cosine = log_convolution(LOG_K, np.log(R), 0.2, 0.5, cosine_mellin) @ (k * np.exp(-k))
        sine = log_convolution(LOG_K, np.log(R), 0.2, 0.5, sine_mellin) @ (k * np.exp(-k))
        np.testing.assert_allclose(cosine, 1.0 / (1.0 + R**2), atol=1e-5)
        np.testing.assert_allclose(sine, R / (1.0 + R**2), atol=1e-5)
