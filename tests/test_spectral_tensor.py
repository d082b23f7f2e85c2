"""Mann's spectral tensor: its laws, its limits, and its value against the printed equations in 40-digit arithmetic."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayes_rs.errors import InputError
from bayes_rs.turbulence.spectral_tensor import eddy_lifetime, spectral_tensor

UNIT = {"dissipation": 1.0, "length_scale": 1.0}
ROUNDING = 1e-13  # a few hundred roundings of double precision
LOG_KL = st.floats(-6.0, 6.0)
ANGLE = st.floats(-np.pi, np.pi)
GAMMA = st.floats(0.0, 6.0)


def wave_vector(log_kl, polar, azimuth):
    return 10.0**log_kl * np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def printed_lifetime(kl, gamma):
    third = mpmath.mpf(1) / 3
    series = mpmath.hyp2f1(third, mpmath.mpf(17) / 6, 4 * third, -(kl**-2))
    return gamma * kl ** (-2 * third) / mpmath.sqrt(series)


def printed_tensor(k, gamma):
    """Mann (1994), Eq. (3.16)-(3.22), as printed, with atan2 for the arctangent."""
    with mpmath.workdps(40):
        k1, k2, k3 = (mpmath.mpf(float(x)) for x in k)
        ksq = k1**2 + k2**2 + k3**2
        beta = printed_lifetime(mpmath.sqrt(ksq), mpmath.mpf(gamma))
        k30 = k3 + beta * k1
        k0sq, hsq = k1**2 + k2**2 + k30**2, k1**2 + k2**2
        c1 = beta * k1**2 * (k0sq - 2 * k30**2 + beta * k1 * k30) / (ksq * hsq)
        c2 = k2 * k0sq / hsq ** mpmath.mpf(1.5) * mpmath.atan2(beta * k1 * mpmath.sqrt(hsq), k0sq - k30 * k1 * beta)
        zeta1, zeta2 = c1 - k2 / k1 * c2, k2 / k1 * c1 + c2
        energy = k0sq**2 / (1 + k0sq) ** (mpmath.mpf(17) / 6)
        a = energy / (4 * mpmath.pi * k0sq**2)
        b = energy / (4 * mpmath.pi * ksq * k0sq)
        uu = a * (k0sq - k1**2 - 2 * k1 * k30 * zeta1 + hsq * zeta1**2)
        vv = a * (k0sq - k2**2 - 2 * k2 * k30 * zeta2 + hsq * zeta2**2)
        ww = energy / (4 * mpmath.pi * ksq**2) * hsq
        uv = a * (-k1 * k2 - k1 * k30 * zeta2 - k2 * k30 * zeta1 + hsq * zeta1 * zeta2)
        uw = b * (-k1 * k30 + hsq * zeta1)
        vw = b * (-k2 * k30 + hsq * zeta2)
        return np.array([[uu, uv, uw], [uv, vv, vw], [uw, vw, ww]], dtype=float)


class TestEddyLifetime:
    @pytest.mark.parametrize("kl", [1e-9, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6])
    def test_equals_the_printed_equation_in_40_digits(self, kl):
        with mpmath.workdps(40):
            exact = float(printed_lifetime(mpmath.mpf(kl), mpmath.mpf(3.2)))
        np.testing.assert_allclose(eddy_lifetime(kl, gamma=3.2), exact, rtol=1e-14)

    def test_has_the_stated_limits(self):
        np.testing.assert_allclose(eddy_lifetime(1e-8, gamma=1.0) * 1e-8, 1.2053058, rtol=1e-7)
        np.testing.assert_allclose(eddy_lifetime(1e9, gamma=1.0), 1e9 ** (-2.0 / 3.0), rtol=1e-10)

    @pytest.mark.parametrize("kl", [0.0, -1.0, np.nan, np.inf])
    def test_refuses_what_is_no_wave_number(self, kl):
        with pytest.raises(InputError, match=r"Invalid wave_number: \|k\|L must be finite and above zero everywhere"):
            eddy_lifetime(kl, gamma=1.0)


class TestValue:
    def test_equals_the_printed_equations_at_random_wave_vectors(self):
        rng = np.random.default_rng(1)
        for _ in range(300):
            k = rng.normal(size=3) * 10.0 ** rng.uniform(-6.0, 6.0)
            gamma = rng.uniform(0.0, 6.0)
            exact = printed_tensor(k, gamma)
            scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
            # Conditioning: k3 + beta k1 may cancel, and Phi changes by its relative error.
            loss = np.abs(k).max() / np.hypot(*k[:2])
            found = spectral_tensor(k, gamma=gamma, **UNIT)
            assert np.all(np.abs(found - exact) <= 1e-12 * loss * np.maximum(scale, np.trace(exact) * 1e-3))

    def test_scales_with_dissipation_and_length(self):
        k = np.random.default_rng(2).normal(size=(50, 3))
        found = spectral_tensor(k / 61.0, dissipation=0.05, length_scale=61.0, gamma=3.2)
        np.testing.assert_allclose(
            found, 0.05 * 61.0 ** (11.0 / 3.0) * spectral_tensor(k, gamma=3.2, **UNIT), rtol=1e-11, atol=1e-9
        )

    @pytest.mark.parametrize("length_scale", [1.0, 1000.0])
    @pytest.mark.parametrize("gamma", [0.0, 3.2, 6.0])
    def test_is_finite_at_every_size_of_wave_vector_and_on_every_axis(self, length_scale, gamma):
        size = np.logspace(-6.0, 6.0, 121)[:, np.newaxis, np.newaxis] / length_scale
        directions = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if i or j or k])
        tensor = spectral_tensor(size * directions, dissipation=0.05, length_scale=length_scale, gamma=gamma)
        assert np.all(np.isfinite(tensor))


class TestLaws:
    @given(LOG_KL, ANGLE, ANGLE, GAMMA)
    def test_incompressible(self, log_kl, polar, azimuth, gamma):
        k = wave_vector(log_kl, polar, azimuth)
        tensor = spectral_tensor(k, gamma=gamma, **UNIT)
        assert np.all(np.abs(k @ tensor) <= 1e-12 * np.linalg.norm(k) * np.trace(tensor))

    @given(LOG_KL, ANGLE, ANGLE, GAMMA)
    def test_symmetric_and_positive_semi_definite(self, log_kl, polar, azimuth, gamma):
        tensor = spectral_tensor(wave_vector(log_kl, polar, azimuth), gamma=gamma, **UNIT)
        assert np.array_equal(tensor, tensor.T)
        assert np.linalg.eigvalsh(tensor)[0] >= -1e-12 * np.trace(tensor)

    @given(LOG_KL, ANGLE, ANGLE, GAMMA)
    def test_reflection_in_y_changes_the_sign_of_what_is_odd_in_v(self, log_kl, polar, azimuth, gamma):
        k = wave_vector(log_kl, polar, azimuth)
        mirror = np.array([1.0, -1.0, 1.0])
        tensor = spectral_tensor(k, gamma=gamma, **UNIT)
        np.testing.assert_array_equal(
            spectral_tensor(k * mirror, gamma=gamma, **UNIT), tensor * np.outer(mirror, mirror)
        )

    @given(LOG_KL, ANGLE, ANGLE, GAMMA)
    def test_the_same_at_minus_k(self, log_kl, polar, azimuth, gamma):
        k = wave_vector(log_kl, polar, azimuth)
        np.testing.assert_array_equal(spectral_tensor(-k, gamma=gamma, **UNIT), spectral_tensor(k, gamma=gamma, **UNIT))

    @given(LOG_KL, ANGLE, ANGLE)
    def test_gamma_zero_is_von_karman_isotropic(self, log_kl, polar, azimuth):
        k = wave_vector(log_kl, polar, azimuth)
        sq = k @ k
        exact = sq**2 / (1 + sq) ** (17 / 6) / (4 * np.pi * sq**2) * (sq * np.eye(3) - np.outer(k, k))
        np.testing.assert_allclose(
            spectral_tensor(k, gamma=0.0, **UNIT), exact, rtol=ROUNDING, atol=ROUNDING * np.trace(exact)
        )

    def test_at_k1_zero_shear_has_turned_w_into_minus_beta_u(self):
        k = np.array([[0.0, 0.3, 0.7], [0.0, 0.0, 0.7]])
        beta = eddy_lifetime(np.linalg.norm(k, axis=1), gamma=3.2)
        plain, tensor = spectral_tensor(k, gamma=0.0, **UNIT), spectral_tensor(k, gamma=3.2, **UNIT)
        np.testing.assert_allclose(tensor[:, 0, 2], -beta * plain[:, 2, 2], rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(tensor[:, 0, 0], plain[:, 0, 0] + beta**2 * plain[:, 2, 2], rtol=1e-12)

    @pytest.mark.parametrize("end", [[0.0, 0.4, 0.9], [0.0, -0.4, 0.9], [0.5, 0.0, -0.9], [0.0, 0.0, 0.9]])
    def test_continuous_where_k1_or_k2_vanishes(self, end):
        end = np.array(end)
        at_end = spectral_tensor(end, gamma=3.2, **UNIT)
        near = spectral_tensor(end + np.array([1e-9, 1e-9, 0.0]), gamma=3.2, **UNIT)
        np.testing.assert_allclose(near, at_end, rtol=0.0, atol=1e-7 * np.trace(at_end))


class TestErrors:
    def test_zero_wave_vector_has_no_limit_under_shear(self):
        with pytest.raises(InputError, match=r"it is zero, where the tensor at gamma = 3.2 depends on the direction"):
            spectral_tensor([0.0, 0.0, 0.0], gamma=3.2, **UNIT)
        np.testing.assert_array_equal(spectral_tensor([0.0, 0.0, 0.0], gamma=0.0, **UNIT), np.zeros((3, 3)))

    def test_wrong_shape(self):
        with pytest.raises(InputError, match=r"Invalid wave_vector of shape \(2,\)"):
            spectral_tensor([0.0, 1.0], gamma=3.2, **UNIT)

    def test_not_finite(self):
        with pytest.raises(InputError, match="Invalid wave_vector: every entry must be finite"):
            spectral_tensor([0.0, 1.0, np.nan], gamma=3.2, **UNIT)

    def test_negative_gamma(self):
        with pytest.raises(InputError, match=r"Invalid gamma -1.0: it must be a finite number, zero or above"):
            spectral_tensor([0.0, 1.0, 0.0], gamma=-1.0, **UNIT)
