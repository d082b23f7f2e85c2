"""Covariances and cross-spectra of two points: closed forms, brute force, laws, and the error of the table."""

from functools import lru_cache

import numpy as np
import pytest
from scipy import integrate, interpolate

from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.turbulence import two_point
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.one_point import ISOTROPIC_VARIANCE, isotropic_spectra, one_point_spectra, scaled_stresses
from bayes_rs.turbulence.spectral_tensor import lifetime_shape, scaled_tensor
from bayes_rs.turbulence.two_point import cross_spectra, radial_covariance, velocity_covariance

SEED = load_turbulence("fu-2022")
UNIT = MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=3.2)
ISOTROPIC = MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=0.0)
ROW, COLUMN = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])


def random_separations(n, seed=0):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    return np.exp(rng.uniform(-6.0, 3.0, (n, 1))) * direction / np.linalg.norm(direction, axis=1, keepdims=True)


@lru_cache
def fine_covariances(gamma):
    """What shear changes, at random separations, by a finer quadrature and without a table."""
    fine = two_point.Resolution(0.1, 120, 48, (-18.0, 10.0), (-15.0, 11.0), 0.1, 0.1, 96, 6, False)
    rng = np.random.default_rng(3)
    x = np.concatenate([[0.0], np.exp(rng.uniform(-5.0, 5.5, 12))])
    distance = np.concatenate([[0.0, 0.0], np.exp(rng.uniform(-6.0, 3.0, 12))])
    direction = rng.uniform(-np.pi, np.pi, len(distance))
    m = np.arange(fine.n_harmonic)
    exact = []
    for index, parts in enumerate(two_point._harmonic_covariances(gamma, x, distance, fine)):
        angular = (np.sin if index in (3, 5) else np.cos)(np.outer(m, direction))
        exact.append(np.einsum("md,mdx->dx", angular, parts))
    return x, distance, direction, exact


class TestIsotropic:
    @pytest.mark.parametrize("x", [0.05, 1.0, 4.0])
    def test_longitudinal_and_lateral_functions_are_the_transforms_of_the_spectra(self, x):
        k1 = np.linspace(0.0, 2000.0, 2_000_001)
        spectra = isotropic_spectra(k1)[:, :2] * np.cos(k1 * x)[:, np.newaxis]
        found = 2.0 * integrate.simpson(spectra, x=k1, axis=0)
        tensor = velocity_covariance([x, 0.0, 0.0], ISOTROPIC)
        np.testing.assert_allclose([tensor[0, 0], tensor[1, 1]], found, atol=3e-5)  # what is above k1 = 2000

    def test_rotating_the_separation_rotates_the_covariance(self):
        r, turn = random_separations(20), np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        rotated = velocity_covariance(r @ turn, ISOTROPIC)
        np.testing.assert_allclose(rotated, turn.T @ velocity_covariance(r, ISOTROPIC) @ turn, atol=1e-13)

    def test_spline_of_the_radial_covariance_equals_the_closed_form(self):
        r = np.concatenate([random_separations(200), 1e-9 * random_separations(3), [[0.0, 0.0, 0.0], [90.0, 0.0, 0.0]]])
        n_a, n_b = np.array([[0.6, 0.0, 0.8]]), np.array([[-0.8, 0.36, 0.48]])
        exact = np.einsum("i,nij,j->n", n_a[0], velocity_covariance(r, ISOTROPIC), n_b[0])
        ones = np.ones((len(r), 1))
        found = radial_covariance(ones * n_a, ones * n_b, r[:, 1:], r[:, :1], ISOTROPIC)[:, 0]
        np.testing.assert_allclose(found, exact, atol=1e-10)

    def test_gamma_near_zero_is_near_isotropic(self):
        r = random_separations(20)
        near = velocity_covariance(r, MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=1e-6))
        np.testing.assert_allclose(near, velocity_covariance(r, ISOTROPIC), atol=1e-6)


class TestCrossSpectra:
    @pytest.mark.parametrize(("tolerance", "error"), [(1e-4, 2e-4), (2e-5, 1e-5)])
    def test_equal_a_brute_force_sum_over_k2_and_k3(self, tolerance, error):
        k1, edge = 0.5, np.linspace(-50.0, 50.0, 2001)
        k2, k3 = np.meshgrid(edge, edge, indexing="ij")
        beta = UNIT.gamma * lifetime_shape(np.sqrt(k1**2 + k2**2 + k3**2))
        parts = scaled_tensor(np.full_like(k2, k1), k2, k3, beta)
        for y, z in [(0.3, 0.7), (-1.0, 0.2), (0.0, -2.0), (4.0, 3.0)]:
            phase_y, phase_z = np.exp(1j * edge * y), np.exp(1j * edge * z)
            brute = np.array([phase_y @ part @ phase_z for part in parts]) * (edge[1] - edge[0]) ** 2
            found = cross_spectra([k1], [y, z], UNIT, tolerance=tolerance)[0][ROW, COLUMN]
            np.testing.assert_allclose(found, brute, atol=error * UNIT.spectra([k1])[0, 0])

    @pytest.mark.parametrize("gamma", [0.0, 3.2, 6.0])
    def test_without_separation_it_is_the_one_point_spectrum(self, gamma):
        turbulence = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=gamma)
        k1 = np.array([1e-4, 1e-2, 1.0])
        spectra = turbulence.spectra(k1)
        found = cross_spectra(k1, [0.0, 0.0], turbulence)[:, ROW, COLUMN]
        np.testing.assert_allclose(found, spectra, atol=1e-4 * np.max(spectra, axis=1).min(), rtol=5e-4)

    def test_exchanging_the_points_conjugates(self):
        there, back = (cross_spectra([0.02], [y, z], SEED) for y, z in [(20.0, 30.0), (-20.0, -30.0)])
        np.testing.assert_allclose(there, back.conj(), atol=1e-12)

    def test_coherence_is_at_most_one(self):
        k1 = np.logspace(-4, 0, 9)
        own = SEED.spectra(k1)
        across = np.abs(cross_spectra(k1, [10.0, 5.0], SEED))
        for i in range(3):
            assert np.all(across[:, i, i] <= own[:, i])

    def test_refuses_zero_wave_number(self):
        with pytest.raises(InputError, match="Invalid wave_number: k1 must be a list of finite numbers above zero"):
            cross_spectra([0.0], [1.0, 0.0], SEED)


class TestCovariance:
    @pytest.mark.parametrize("gamma", [0.0, 0.5, 3.2, 6.0])
    def test_without_separation_it_is_the_stress_tensor(self, gamma):
        turbulence = MannTurbulence(dissipation=1.0, length_scale=1.0, gamma=gamma)
        stresses = scaled_stresses(gamma)
        np.testing.assert_allclose(
            velocity_covariance(np.zeros(3), turbulence), unpack_stress(stresses), atol=2e-5 * stresses[0]
        )

    @pytest.mark.parametrize("x", [0.1, 1.0, 30.0])
    def test_along_the_wind_it_is_the_transform_of_the_one_point_spectra(self, x):
        log_k = np.arange(-20.0, 8.0, 0.1)
        sheared = one_point_spectra(np.exp(log_k), dissipation=1.0, length_scale=1.0, gamma=3.2)
        spline = interpolate.CubicSpline(log_k, sheared - isotropic_spectra(np.exp(log_k)))
        low, high = np.linspace(-20.0, -6.0, 4001), np.linspace(np.exp(-6.0), 300.0, 1_000_001)
        part = 2.0 * integrate.simpson(spline(np.log(high)) * np.cos(high * x)[:, None], x=high, axis=0)
        part += 2.0 * integrate.simpson(spline(low) * (np.exp(low) * np.cos(np.exp(low) * x))[:, None], x=low, axis=0)
        exact = unpack_stress(part) + velocity_covariance([x, 0.0, 0.0], ISOTROPIC)
        np.testing.assert_allclose(velocity_covariance([x, 0.0, 0.0], UNIT), exact, atol=1e-4 * 1.7722)

    @pytest.mark.parametrize(
        ("gamma", "tolerance"),
        [(g, t) for g in (0.5, 3.2, 6.0) for t in (5e-3, 1e-3, 1e-4, 2e-5)] + [(10.0, t) for t in (3e-3, 3e-4, 6e-5)],
    )
    def test_error_of_the_table_is_below_what_it_promises(self, gamma, tolerance):
        x, distance, direction, exact_parts = fine_covariances(gamma)
        table = two_point.covariance_table(gamma, np.array([[256.0, 20.0, 0.0]]), tolerance=tolerance)
        for index, exact in enumerate(exact_parts):
            weights = np.tile(np.eye(6)[index], (len(distance), 1))
            found = table.project(
                distance * np.sin(direction), distance * np.cos(direction), weights, np.tile(x, (len(distance), 1))
            )
            np.testing.assert_allclose(found, exact, rtol=0.0, atol=table.promised_error * scaled_stresses(gamma)[0])
            place = x[4], distance[5] * np.sin(direction[5]), distance[5] * np.cos(direction[5])
            one = table.components(*np.array(place)[:, np.newaxis])
            np.testing.assert_allclose(one[0, index], found[5, 4], atol=1e-6)
        assert table.promised_error <= tolerance

    def test_symmetric_and_even(self):
        r = random_separations(30)
        covariance = velocity_covariance(r, UNIT)
        np.testing.assert_array_equal(covariance, np.swapaxes(covariance, -1, -2))
        np.testing.assert_allclose(velocity_covariance(-r, UNIT), covariance, atol=1e-12)

    def test_reflection_in_y(self):
        r, mirror = random_separations(30), np.array([1.0, -1.0, 1.0])
        reflected = velocity_covariance(r * mirror, UNIT)
        np.testing.assert_allclose(reflected, velocity_covariance(r, UNIT) * np.outer(mirror, mirror), atol=1e-12)

    def test_incompressible(self):
        """The divergence of C_ij(r) over r_i vanishes, by central differences."""
        step = 1e-2
        r = random_separations(10, seed=4) + 0.5
        shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
        around = velocity_covariance(r[:, None] + shifts, UNIT)
        slopes = (around[:, :3] - around[:, 3:]) / (2.0 * step)  # n, derivative by, i, j
        divergence = np.einsum("niij->nj", slopes)
        np.testing.assert_allclose(divergence, 0.0, atol=2e-3)  # of slopes that are about one

    def test_joint_covariance_of_many_points_is_positive_semi_definite_to_the_error(self):
        points = 2.0 * np.random.default_rng(5).normal(size=(40, 3))
        blocks = velocity_covariance(points[:, None] - points[None], UNIT)
        joint = blocks.transpose(0, 2, 1, 3).reshape(120, 120)
        assert np.linalg.eigvalsh(joint)[0] > -1e-4 * 1.7722 * 120

    def test_scales_with_dissipation_and_length(self):
        r = random_separations(10)
        np.testing.assert_allclose(
            velocity_covariance(61.0 * r, SEED),
            SEED.velocity_scale**2 * velocity_covariance(r, UNIT),
            rtol=1e-9,
            atol=1e-12,
        )

    def test_continuous_down_to_a_millimetre_and_gone_at_ten_kilometres(self):
        near = velocity_covariance([[0.0, 1e-3, 0.0], [1e-3, 0.0, 0.0]], SEED)
        loss = SEED.stresses()[0] - near[:, 0, 0]
        # Kolmogorov: 2 (uu - C_uu) = 1.9652 (r, across: x 4/3) in units of alpha eps^(2/3) r^(2/3)
        along = 0.5 * (18.0 / 55.0) * 4.0194 * 0.05 * 1e-3 ** (2.0 / 3.0)
        np.testing.assert_allclose(loss[1], along, rtol=0.05, atol=1e-4)
        np.testing.assert_allclose(loss[0] / loss[1], 4.0 / 3.0, rtol=0.1)
        far = velocity_covariance([[0.0, 0.0, 1e4], [0.0, 0.0, 2e4]], SEED)
        assert np.all(np.abs(far) < 1e-2 * SEED.stresses()[0])
        np.testing.assert_allclose(
            far[1, 0, 0] / far[0, 0, 0], 0.5, rtol=0.1
        )  # Phi goes as 1/k^2 at k -> 0, so C as 1/r

    @pytest.mark.parametrize("length_scale", [1.0, 5000.0])
    @pytest.mark.parametrize("gamma", [0.0, 6.0])
    def test_finite_at_any_length_scale(self, length_scale, gamma):
        turbulence = MannTurbulence(dissipation=0.05, length_scale=length_scale, gamma=gamma)
        r = np.array([[0.0, 1e-3, 0.0], [-7.2e4, 1.0, 1e4], [1.0, 1e4, 1.0]])
        assert np.all(np.isfinite(velocity_covariance(r, turbulence)))


class TestRadialCovariance:
    def test_is_the_projection_of_the_tensor(self):
        r = random_separations(25, seed=6)
        rng = np.random.default_rng(7)
        n_a, n_b = rng.normal(size=(2, 25, 3))
        exact = np.einsum("ni,nij,nj->n", n_a, velocity_covariance(r, UNIT), n_b)
        np.testing.assert_allclose(radial_covariance(n_a, n_b, r[:, 1:], r[:, :1], UNIT)[:, 0], exact, atol=1e-9)

    @pytest.mark.parametrize("tolerance", [5e-3, 1e-3, 1e-4])
    def test_separations_of_the_table_are_not_interpolated_and_the_same(self, tolerance):
        rng = np.random.default_rng(8)
        n_a, n_b = rng.normal(size=(2, 9, 3))
        across = rng.normal(size=(9, 2))
        step = two_point.resolution_for(tolerance, UNIT.gamma)[1].table_step
        one = 0.01 * np.sinh(step * np.arange(-12, 13))
        same = radial_covariance(n_a, n_b, across, np.broadcast_to(one, (9, 25)), UNIT, tolerance=tolerance)
        each = radial_covariance(n_a, n_b, across, np.tile(one, (9, 1)), UNIT, tolerance=tolerance)
        np.testing.assert_allclose(same, each, atol=1e-5 if tolerance == 5e-3 else 1e-9)  # single precision, or double

    @pytest.mark.parametrize("n_place", [3, 150])  # below and above what the components are weighted once for
    @pytest.mark.parametrize("tolerance", [5e-3, 1e-4])
    def test_many_places_of_a_pair_are_as_many_pairs(self, n_place, tolerance):
        rng = np.random.default_rng(9)
        n_a, n_b = rng.normal(size=(2, 11, 3))
        across = rng.normal(size=(11 * n_place, 2)) * 10.0 ** rng.uniform(-2.0, 2.0, (11 * n_place, 1))
        along = rng.normal(size=(11 * n_place, 7)) * 10.0
        found = radial_covariance(n_a, n_b, across, along, UNIT, tolerance=tolerance)
        each = (np.repeat(of, n_place, axis=0) for of in (n_a, n_b))
        want = radial_covariance(*each, across, along, UNIT, tolerance=tolerance)
        np.testing.assert_allclose(found, want, atol=1e-5 if tolerance == 5e-3 else 1e-12)
        assert np.min(across[:, 0]) < 0.0 < np.max(across[:, 0])
        assert np.max(np.abs(across)) > 20.0  # where the isotropic part is nothing

    def test_places_that_no_pair_has(self):
        n = np.ones((2, 3))
        with pytest.raises(InputError, match=r"across of shape \(3, 2\): give as many places to each of 2 pairs"):
            radial_covariance(n, n, np.zeros((3, 2)), np.zeros((3, 1)), UNIT)

    def test_isotropic_variance(self):
        n = np.array([[0.6, 0.0, 0.8]])
        found = radial_covariance(n, n, [[0.0, 0.0]], [[0.0]], ISOTROPIC)
        np.testing.assert_allclose(found, ISOTROPIC_VARIANCE, rtol=1e-14)


def test_tables_of_one_gamma_share_their_harmonics(monkeypatch):
    """They reach differently far, and the harmonics are on the same wave numbers."""
    made, harmonics = [], two_point._harmonics
    monkeypatch.setattr(two_point, "_harmonics", lambda *of: made.append(of) or harmonics(*of))
    tables = [two_point.covariance_table(2.71, np.array([[reach, 0.1, 0.1]]), tolerance=5e-3) for reach in (1.0, 500.0)]
    assert tables[0].shape != tables[1].shape
    assert len(made) == 1


class TestErrors:
    def test_wrong_shape(self):
        with pytest.raises(
            InputError, match=r"Invalid separation of shape \(2,\): the last dimension must hold x, y and z"
        ):
            velocity_covariance([1.0, 2.0], SEED)

    def test_not_finite(self):
        with pytest.raises(InputError, match="Invalid separation: the entry at"):
            velocity_covariance([1.0, 2.0, np.nan], SEED)

    def test_tolerance_that_cannot_be_kept(self):
        with pytest.raises(
            InputError,
            match=r"Invalid tolerance 1e-09: the smallest error that the theory keeps at gamma = 3.2 is 2e-05",
        ):
            velocity_covariance([1.0, 2.0, 3.0], SEED, tolerance=1e-9)
