"""One-point stresses and spectra: closed forms, an unlike quadrature, and limits."""

import numpy as np
import pytest
from scipy import special

from bayes_rs.errors import InputError
from bayes_rs.turbulence.one_point import (
    ISOTROPIC_VARIANCE,
    isotropic_spectra,
    isotropic_tensor,
    one_point_spectra,
    scaled_stresses,
)
from bayes_rs.turbulence.spectral_tensor import lifetime_shape, scaled_tensor

UNIT = {"dissipation": 1.0, "length_scale": 1.0}
PROMISED = 1e-8  # relative to uu


def stresses_from_spectra(gamma, step=0.25):
    """Integrate the one-point spectra, whose quadrature shares no variable with that of the stresses."""
    k1 = np.exp(np.arange(-25.0, 22.0, step))
    sheared = one_point_spectra(k1, gamma=gamma, **UNIT) - isotropic_spectra(k1)
    total = 2.0 * step * np.sum(k1[:, np.newaxis] * sheared, axis=0)
    total[:3] += ISOTROPIC_VARIANCE
    return total


def stresses_on_spheres(gamma, n=64):
    """Gauss-Legendre in log |k|, polar angle and azimuth: a third, plain quadrature."""
    node, weight = np.polynomial.legendre.leggauss(n)
    s, weight = 0.5 * (node + 1.0), 0.5 * weight
    k = np.exp(-9.0 + 20.0 * s)[:, None, None]
    polar, azimuth = np.pi * s[None, :, None], np.pi * s[None, None, :]  # the other half is the mirror image
    k1, k2, k3 = k * np.sin(polar) * np.cos(azimuth), k * np.sin(polar) * np.sin(azimuth), k * np.cos(polar)
    measure = 2.0 * 20.0 * np.pi**2 * np.einsum("i,j,k->ijk", weight, weight, weight) * k**3 * np.sin(polar)
    sheared = scaled_tensor(k1, k2, k3, gamma * lifetime_shape(k))
    total = np.array([np.sum(measure * (a - b)) for a, b in zip(sheared, isotropic_tensor(k1, k2, k3), strict=True)])
    total[:3] += ISOTROPIC_VARIANCE
    total[[3, 5]] = 0.0  # odd in k2
    return total


class TestStresses:
    def test_isotropic_closed_form(self):
        closed = special.gamma(2.5) * special.gamma(1 / 3) / special.gamma(17 / 6) / 3
        np.testing.assert_allclose(scaled_stresses(0.0), [closed] * 3 + [0.0] * 3, rtol=1e-15)
        np.testing.assert_allclose(scaled_stresses(1e-9)[:3], [closed] * 3, rtol=1e-12)

    def test_known_value(self):
        np.testing.assert_allclose(scaled_stresses(3.2)[0], 1.77222, atol=5e-6)

    @pytest.mark.parametrize("gamma", [0.3, 3.2, 6.0])
    def test_equal_the_integrals_of_the_spectra(self, gamma):
        stresses = np.array(scaled_stresses(gamma))
        np.testing.assert_allclose(stresses_from_spectra(gamma), stresses, rtol=0.0, atol=PROMISED * stresses[0])

    @pytest.mark.parametrize("gamma", [1.0, 3.2])
    def test_equal_a_plain_quadrature_on_spheres(self, gamma):
        stresses = np.array(scaled_stresses(gamma))
        np.testing.assert_allclose(stresses_on_spheres(gamma), stresses, rtol=0.0, atol=1e-3 * stresses[0])

    @pytest.mark.parametrize("gamma", [1.0, 3.2, 6.0])
    def test_realizable_ordered_and_with_momentum_going_down(self, gamma):
        uu, vv, ww, uv, uw, vw = scaled_stresses(gamma)
        assert uu > vv > ww > 0.0
        assert uv == vw == 0.0
        assert -np.sqrt(uu * ww) < uw < 0.0

    def test_continuous_in_gamma(self):
        left, right = np.array(scaled_stresses(3.2 - 1e-6)), np.array(scaled_stresses(3.2 + 1e-6))
        np.testing.assert_allclose(left, right, atol=5e-6)

    def test_refuses_negative_gamma(self):
        with pytest.raises(InputError, match=r"Invalid gamma -1.0"):
            scaled_stresses(-1.0)


class TestSpectra:
    def test_inertial_range(self):
        k1 = np.array([1e3, 1e4])
        spectra = one_point_spectra(k1, gamma=3.2, **UNIT)
        np.testing.assert_allclose(spectra[:, 0], 9.0 / 55.0 * k1 ** (-5.0 / 3.0), rtol=1e-3)
        np.testing.assert_allclose(spectra[:, 1:3] / spectra[:, :1], 4.0 / 3.0, rtol=3e-3)
        slope = np.log(spectra[1, 4] / spectra[0, 4]) / np.log(10.0)
        np.testing.assert_allclose(slope, -7.0 / 3.0, atol=1e-3)  # the cospectrum of a rapidly distorted cascade

    def test_isotropic_closed_form_by_direct_quadrature(self):
        step = 0.1
        t = np.arange(-12.0, 40.0, step)
        kappa = np.exp(t)
        for k1, exact in zip([0.01, 1.0, 30.0], isotropic_spectra(np.array([0.01, 1.0, 30.0])), strict=True):
            weight = step * kappa**2 * (1 + k1**2 + kappa**2) ** (-17 / 6) / (4 * np.pi)
            uu, vv = np.sum(weight * 2 * np.pi * kappa**2), np.sum(weight * np.pi * (2 * k1**2 + kappa**2))
            np.testing.assert_allclose([uu, vv], exact[:2], rtol=1e-8)

    def test_vanishing_shear_is_isotropic(self):
        k1 = np.array([1e-4, 1.0, 1e4])
        np.testing.assert_allclose(
            one_point_spectra(k1, gamma=1e-7, **UNIT)[:, :3], isotropic_spectra(k1)[:, :3], rtol=1e-6
        )

    def test_against_a_uniform_grid(self):
        k1, gamma = 0.5, 3.2
        edge = np.linspace(-40.0, 40.0, 1601)
        k2, k3 = np.meshgrid(edge, edge, indexing="ij")
        beta = gamma * lifetime_shape(np.sqrt(k1**2 + k2**2 + k3**2))
        grid = np.array([np.sum(part) for part in scaled_tensor(np.full_like(k2, k1), k2, k3, beta)]) * 0.05**2
        found = one_point_spectra([k1], gamma=gamma, **UNIT)[0]
        np.testing.assert_allclose(grid, found, rtol=0.0, atol=2e-3 * found[0])  # what lies outside the grid

    def test_refuses_k1_zero(self):
        with pytest.raises(InputError, match="Invalid wave_number: k1 must be a list of finite numbers above zero"):
            one_point_spectra([0.0], gamma=1.0, **UNIT)
