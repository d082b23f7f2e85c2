"""The Gaussian and gamma likelihoods: against textbook densities, moments of the noise, limits and refusals."""

import numpy as np
import pytest
from other_likelihoods import OTHER_LIKELIHOODS, fitted_variance, power_likelihood, power_moments
from scenes import draw_variances, plain_noise
from scipy import stats

from bayes_rs import InputError, NotPositiveDefiniteError, load_scan
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.base import beam_data
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, REFERENCE_STRESS
from bayes_rs.priors.registry import WeakPrior

MAKERS = {**LIKELIHOODS, **OTHER_LIKELIHOODS}
NAMES = list(MAKERS)
POWERS = {"gaussian": 1.0, "gamma": 1.0 / 3.0}


@pytest.fixture
def stress():
    return WeakPrior(log_sd_uu=0.5).draw(7, seed=1)


def build(name, scan, variance, used=None, *, covariance=None, offset=0.0, **options):
    n_record, n_beam = variance.shape
    matrix = plain_noise(scan).covariance[0] if covariance is None else covariance
    return MAKERS[name](
        variance,
        np.ones_like(variance, dtype=bool) if used is None else used,
        np.broadcast_to(design_matrix(scan), (n_record, n_beam, 6)),
        np.broadcast_to(matrix, (n_record, n_beam, n_beam)),
        offset=offset,
        **options,
    )


def records_of(scan, stress, seed=2):
    return draw_variances(stress, scan, plain_noise(scan), np.random.default_rng(seed))


def at_all(stress, n_record=7):
    return np.broadcast_to(stress, (n_record, len(stress), 6))


class TestTextbook:
    """Densities by scipy, one record and one tensor at a time."""

    @pytest.mark.parametrize("name", ["2-beam", "4-beam", "6-beam"])
    def test_gaussian(self, name, stress):
        """Without surplus beams z = Uᵀ y/m₀ is a one-to-one map: densities differ by a constant, the Jacobian."""
        scan = load_scan(name)
        covariance, matrix = plain_noise(scan).covariance[0], design_matrix(scan)
        variance = records_of(scan, stress)
        expected = np.array(
            [
                [stats.multivariate_normal(m, m[:, None] * covariance * m).logpdf(y) for m in stress @ matrix.T + 0.02]
                for y in variance
            ]
        )
        jacobian = np.log(matrix @ REFERENCE_STRESS).sum()
        density = build("gaussian", scan, variance, offset=0.02).log_density(at_all(stress))
        np.testing.assert_allclose(density, expected + jacobian, rtol=1e-8, atol=1e-8)  # condition of K below 1e4

    @pytest.mark.parametrize("k", [0.03, 0.06, 0.12])
    def test_gamma_of_one_beam_is_the_gamma_distribution(self, k):
        """Shape 1/K; the cube root of a gamma variable is normal to Wilson and Hilferty's error.

        Log-densities of y over the central 99 %: the error grows like K^1.2, and is 0.026 at K = 0.12. That of a
        Gaussian is 2.0 there, and of a log-normal 1.4.
        """
        scan = load_scan("staring")
        y = stats.gamma(1.0 / k, scale=k).ppf(np.linspace(0.005, 0.995, 41))[:, None]
        unit = np.zeros((41, 1, 6))
        unit[:, :, 0] = 1.0 / design_matrix(scan)[0, 0]
        likelihood = build("gamma", scan, y, covariance=np.array([[k]]))
        # from the density of (y/m₀)^(1/3), up to a constant, to that of y
        density = likelihood.log_density(unit)[:, 0] - 2.0 / 3.0 * np.log(y[:, 0])
        expected = stats.gamma(1.0 / k, scale=k).logpdf(y[:, 0])
        assert np.ptp(density - expected) < 0.25 * k
        for name, jacobian in (("gaussian", 0.0), ("log-normal", 1.0)):
            other = build(name, scan, y, covariance=np.array([[k]])).log_density(unit)[:, 0] - jacobian * np.log(
                y[:, 0]
            )
            assert np.ptp(other - expected) > 3.0 * np.sqrt(k)

    @pytest.mark.parametrize("indefinite", [False, True])
    @pytest.mark.parametrize("name", ["50-beam", "51-beam"])
    @pytest.mark.parametrize("kind", list(POWERS))
    def test_reduced_density_is_that_of_the_projected_data(self, name, kind, indefinite, stress):
        """Any orthonormal basis of the column space at the reference shape, and moments without factors of C.

        C may be indefinite where the stresses do not reach, since taking powers need not keep it positive.
        """
        scan, power = load_scan(name), POWERS[kind]
        matrix = design_matrix(scan)
        reference = matrix @ REFERENCE_STRESS
        gradient = matrix / reference[:, None]
        values, vectors = np.linalg.eigh(gradient @ gradient.T)
        basis = vectors[:, values > 1e-12 * values[-1]]
        variance = records_of(scan, stress)
        covariance = plain_noise(scan).covariance[0]
        if indefinite:
            aside = np.random.default_rng(3).standard_normal(scan.n_beam)
            aside -= basis @ (basis.T @ aside)
            aside /= np.linalg.norm(aside)
            covariance = covariance - 2.0 * (aside @ covariance @ aside) * np.outer(aside, aside)
        centre, of_power = power_moments(covariance, power)
        assert (np.linalg.eigvalsh(of_power)[0] < 0.0) == indefinite
        expected = np.empty((7, 7))
        for i, y in enumerate(variance):
            for j, tensor in enumerate(stress):
                scale = (matrix @ tensor / reference) ** power
                mean = basis.T @ (scale * centre)
                noise = basis.T @ (scale[:, None] * of_power * scale) @ basis
                expected[i, j] = stats.multivariate_normal(mean, noise).logpdf(basis.T @ (y / reference) ** power)
        density = build(kind, scan, variance, covariance=covariance).log_density(at_all(stress))
        np.testing.assert_allclose(density, expected, rtol=1e-6)  # eigenvectors of a Gram matrix lose half the digits

    def test_plug_in_noise_is_that_of_the_fitted_variances(self, stress):
        scan = load_scan("6-beam")
        covariance, matrix = plain_noise(scan).covariance[0], design_matrix(scan)
        variance = records_of(scan, stress)
        used = np.ones_like(variance, dtype=bool)
        data = beam_data(variance, used, np.broadcast_to(matrix, (7, 6, 6)), 0.02)
        fitted = fitted_variance(data, np.broadcast_to(covariance, (7, 6, 6)))
        expected = [
            [stats.multivariate_normal(matrix @ r + 0.02, d[:, None] * covariance * d).logpdf(y) for r in stress]
            for y, d in zip(variance, fitted, strict=True)
        ]
        density = build("gaussian-plugin", scan, variance, offset=0.02).log_density(at_all(stress))
        np.testing.assert_allclose(density, expected + np.log(fitted).sum(axis=1)[:, None], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kind", list(POWERS))
def test_eigenvalues_that_are_nothing_are_left_out(kind, stress):
    """Smooth noise, as that of turbulence, of 51 beams needs few of them, to 1e-9 of the smallest that matters."""
    scan = load_scan("51-beam")
    across = (scan.focus_distance[:, None] * scan.line_of_sight)[:, 1:]
    distance = np.linalg.norm(across[:, None] - across[None], axis=-1)
    covariance = 0.06 * np.exp(-((distance / 40.0) ** 2))
    variance = stress @ design_matrix(scan).T
    likelihood = build(kind, scan, variance, covariance=covariance)
    assert likelihood.root.shape[2] <= 30
    whole = np.broadcast_to(power_moments(covariance, POWERS[kind])[1], (7, 51, 51))
    dropped = whole - (likelihood.root * likelihood.sign[:, None, :]) @ likelihood.root.swapaxes(-1, -2)
    smallest = np.linalg.eigvalsh(likelihood.left[0].T @ whole[0] @ likelihood.left[0])
    size = np.linalg.norm(dropped[0], 2)
    # what eigh itself leaves is a few rounding errors of the largest eigenvalue
    assert size < 1e-9 * smallest[smallest > 1e-12].min() + 51 * np.finfo(float).eps * np.linalg.norm(whole[0], 2)


class TestMoments:
    """The covariance of powers is the one that gives y the noise model's moments."""

    def test_cubes_of_the_normal_numbers_have_the_covariance_k(self):
        """By quadrature over two correlated normals. The formula puts K/9 for C_bb, off by (K/9)³/3: error (K/9)⁴."""
        covariance = np.array([[0.10, 0.05, -0.03], [0.05, 0.06, 0.02], [-0.03, 0.02, 0.14]])
        centre, of_power = power_moments(covariance, 1.0 / 3.0)
        node, weight = np.polynomial.hermite_e.hermegauss(12)  # exact for the sixth degree that occurs
        weight = weight / weight.sum()
        for a in range(3):
            for b in range(3):
                pair = of_power[np.ix_([a, b], [a, b])]
                slope = pair[0, 1] / pair[0, 0]
                rest = np.sqrt(max(pair[1, 1] - slope * pair[0, 1], 0.0))
                first = centre[a] + np.sqrt(pair[0, 0]) * node[:, None]
                second = centre[b] + slope * np.sqrt(pair[0, 0]) * node[:, None] + rest * node[None, :]
                both = weight[:, None] * weight[None, :]
                mean_a, mean_b = np.sum(both * first**3), np.sum(both * second**3)
                moment = np.sum(both * (first**3 * second**3)) - mean_a * mean_b
                assert mean_a == pytest.approx(1.0, abs=4.0 * (covariance[a, a] / 9.0) ** 4)
                assert moment == pytest.approx(covariance[a, b], abs=10.0 * (0.14 / 9.0) ** 4)

    def test_diagonal_is_that_of_wilson_and_hilferty(self):
        k = np.array([0.01, 0.06, 0.2])
        centre, of_power = power_moments(np.diag(k), 1.0 / 3.0)
        np.testing.assert_allclose(centre, 1.0 - k / 9.0, rtol=1e-15)
        np.testing.assert_allclose(np.diag(of_power), k / 9.0, rtol=2e-4)  # (K/9)²/3, at most 1.6e-4

    def test_the_gaussian_takes_k_as_it_is(self):
        covariance = np.array([[0.1, 0.05], [0.05, 0.06]])
        centre, of_power = power_moments(covariance, 1.0)
        assert np.array_equal(centre, np.ones(2))
        assert np.array_equal(of_power, covariance)


class TestEveryLikelihood:
    """What the interface promises, for all names."""

    @pytest.mark.parametrize("dof", [np.inf, 8.0])
    @pytest.mark.parametrize("scan_name", ["4-beam", "6-beam"])
    @pytest.mark.parametrize("name", NAMES)
    def test_half_the_square_of_the_residuals_is_minus_the_log_density(self, name, scan_name, dof, stress):
        """But for the determinant: with no surplus beams it is Π m^2p times a constant."""
        scan = load_scan(scan_name)
        likelihood = build(name, scan, records_of(scan, stress), dof=dof)
        residual = likelihood.whitened_residual(at_all(stress))
        total = likelihood.log_density(at_all(stress)) + 0.5 * np.sum(residual**2, axis=2)
        total += POWERS.get(name, 0.0) * np.log(likelihood.expected(at_all(stress))).sum(axis=2)
        np.testing.assert_allclose(total, np.broadcast_to(total[:, :1], total.shape), rtol=0.0, atol=1e-8)

    @pytest.mark.parametrize("name", NAMES)
    def test_shapes_and_records(self, name, stress):
        scan = load_scan("6-beam")
        likelihood = build(name, scan, records_of(scan, stress), offset=0.01)
        some = np.array([4, 1])
        part = likelihood.take(some)
        tensors = at_all(stress)
        assert (likelihood.n_record, part.n_record) == (7, 2)
        assert part.n_datum.tolist() == [6, 6]
        assert likelihood.expected(tensors).shape == (7, 7, 6)
        np.testing.assert_allclose(likelihood.expected(tensors)[0], stress @ design_matrix(scan).T + 0.01)
        np.testing.assert_allclose(part.log_density(tensors[some]), likelihood.log_density(tensors)[some], rtol=1e-12)
        np.testing.assert_allclose(
            part.whitened_residual(tensors[some]), likelihood.whitened_residual(tensors)[some], rtol=1e-9, atol=1e-9
        )

    @pytest.mark.parametrize("name", ["log-normal", "gaussian", "gamma"])
    def test_noise_of_a_draw_adds_to_the_constant_offset(self, name, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        tensors = at_all(stress)
        split = build(name, scan, variance, offset=0.01)
        whole = build(name, scan, variance, offset=0.04)
        extra = np.full((7, 7), 0.03)
        np.testing.assert_allclose(split.log_density(tensors, extra), whole.log_density(tensors), rtol=1e-10)
        np.testing.assert_allclose(
            split.whitened_residual(tensors, extra), whole.whitened_residual(tensors), rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(split.expected(tensors, extra), whole.expected(tensors), rtol=1e-14)

    @pytest.mark.parametrize("name", NAMES)
    def test_noise_on_all_beams_is_isotropic_stress(self, name, stress):
        """Points: n·(R + δI)n = n·Rn + δ."""
        scan = load_scan("6-beam")
        likelihood = build(name, scan, records_of(scan, stress))
        shifted = stress + 0.03 * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(
            likelihood.log_density(at_all(stress), np.full((7, 7), 0.03)),
            likelihood.log_density(at_all(shifted)),
            rtol=1e-9,
        )

    @pytest.mark.parametrize("name", NAMES)
    def test_a_beam_that_is_not_used_changes_nothing(self, name, stress):
        scan = load_scan("6-beam")
        noise = plain_noise(scan)
        variance = records_of(scan, stress)
        used = np.ones_like(variance, dtype=bool)
        used[:, 2] = False
        spoiled = variance.copy()
        spoiled[:, 2] = np.nan
        some = np.array([0, 1, 3, 4, 5])
        smaller = build(name, scan.select(some), variance[:, some], covariance=noise.covariance[0][np.ix_(some, some)])
        extra = np.full((7, 7), 0.02)
        np.testing.assert_allclose(
            build(name, scan, spoiled, used).log_density(at_all(stress), extra),
            smaller.log_density(at_all(stress), extra),
            rtol=1e-9,
        )

    @pytest.mark.parametrize("name", NAMES)
    def test_records_with_different_beams_do_not_touch_each_other(self, name, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        used = np.ones_like(variance, dtype=bool)
        used[0, 1:] = False
        used[3, :2] = False
        together = build(name, scan, variance, used).log_density(at_all(stress))
        for record in range(7):
            alone = build(name, scan, variance[[record]], used[[record]]).log_density(at_all(stress, 1))
            np.testing.assert_allclose(alone[0], together[record], rtol=1e-9)

    @pytest.mark.parametrize("name", NAMES)
    def test_units_shift_a_record_by_a_constant(self, name, stress):
        """The plug-in's fit has a prior, wide but not scale free: its scale may move by 1e-3 of a log-unit's square."""
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        there = build(name, scan, variance).log_density(at_all(stress))
        scaled = build(name, scan, 100.0 * variance).log_density(at_all(100.0 * stress))
        tolerance = 0.2 if name == "gaussian-plugin" else 1e-7
        np.testing.assert_allclose(
            scaled - scaled[:, :1], there - there[:, :1], rtol=tolerance, atol=10.0 * tolerance**2
        )

    @pytest.mark.parametrize("name", ["log-normal", "gaussian", "gamma"])
    def test_a_tensor_that_gives_a_beam_no_variance_has_likelihood_zero(self, name):
        scan = load_scan("2-beam")
        density = build(name, scan, np.ones((1, 2))).log_density(np.array([[-np.ones(6), np.zeros(6)]]))
        assert np.all(np.isneginf(density))


class TestTails:
    @pytest.mark.parametrize("name", NAMES)
    def test_off_changes_no_bit(self, name, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        plain = build(name, scan, variance).log_density(at_all(stress))
        assert np.array_equal(build(name, scan, variance, inflation=1.0, dof=np.inf).log_density(at_all(stress)), plain)

    @pytest.mark.parametrize("name", ["gaussian", "gaussian-plugin", "gamma"])
    def test_inflation_is_a_larger_k(self, name, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        covariance = plain_noise(scan).covariance[0]
        inflated = build(name, scan, variance, inflation=1.5).log_density(at_all(stress))
        larger = build(name, scan, variance, covariance=1.5 * covariance).log_density(at_all(stress))
        np.testing.assert_allclose(inflated, larger, rtol=1e-12)

    def test_inflation_of_the_log_normal_scales_the_log_covariance_and_keeps_the_mean(self, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        covariance = plain_noise(scan).covariance[0]
        inflated = build("log-normal", scan, variance, inflation=1.5).log_density(at_all(stress))
        larger = build("log-normal", scan, variance, covariance=(1.0 + covariance) ** 1.5 - 1.0)
        np.testing.assert_allclose(inflated, larger.log_density(at_all(stress)), rtol=1e-9)

    @pytest.mark.parametrize("name", ["gaussian-plugin", "gaussian"])
    def test_student_is_the_normal_over_an_inflation_that_is_inverse_gamma(self, name, stress):
        """∫N(z; λC) p(λ) dλ with λ = ν/χ²_ν, by the trapezoidal rule in ln χ²: it converges geometrically."""
        scan, dof = load_scan("4-beam"), 7.0
        variance = records_of(scan, stress)
        student = build(name, scan, variance, dof=dof).log_density(at_all(stress))
        log_square = np.linspace(-60.0, 8.0, 2001)
        factor = dof / np.exp(log_square)
        weight = stats.chi2(dof).pdf(np.exp(log_square)) * np.exp(log_square) * (log_square[1] - log_square[0])
        matrix = design_matrix(scan)
        for i in range(7):
            data = beam_data(variance[[i]], np.ones((1, 4), dtype=bool), matrix[None], 0.0)
            own = fitted_variance(data, plain_noise(scan).covariance[0, None])[0]
            scale = np.log(own if name == "gaussian-plugin" else matrix @ REFERENCE_STRESS).sum()
            for j in range(7):
                mean = matrix @ stress[j]
                size = own if name == "gaussian-plugin" else mean
                noise = size[:, None] * plain_noise(scan).covariance[0] * size
                whitened = np.linalg.solve(np.linalg.cholesky(noise), variance[i] - mean)
                terms = np.exp(-0.5 * (whitened @ whitened) / factor) / factor**2
                log_mixture = np.log(np.sum(weight * terms)) - 0.5 * np.linalg.slogdet(2.0 * np.pi * noise)[1]
                # the plug-in's own fit knows no tails, so it is the same for both
                assert student[i, j] == pytest.approx(log_mixture + scale, rel=1e-9)

    @pytest.mark.parametrize("name", NAMES)
    def test_many_degrees_of_freedom_are_normal(self, name, stress):
        scan = load_scan("6-beam")
        variance = records_of(scan, stress)
        normal = build(name, scan, variance).log_density(at_all(stress))
        near = build(name, scan, variance, dof=1e9).log_density(at_all(stress))
        np.testing.assert_allclose(near, normal, rtol=1e-4, atol=1e-4)  # error s²/4ν, and cancellation in gammaln

    @pytest.mark.parametrize("name", NAMES)
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"inflation": 0.0}, r"Invalid inflation 0\.0: it must be a finite number above zero"),
            ({"inflation": np.nan}, r"Invalid inflation nan"),
            ({"dof": -1.0}, r"Invalid dof -1\.0: it must be above zero"),
            ({"dof": np.nan}, r"Invalid dof nan"),
        ],
    )
    def test_refusals(self, name, options, message):
        with pytest.raises(InputError, match=message):
            build(name, load_scan("2-beam"), np.ones((1, 2)), **options)


class TestPlugIn:
    def test_the_fit_is_not_the_data(self, stress):
        """Errors of the fit are smaller than those of y: with more than one beam they are partly averaged out."""
        scan = load_scan("4-beam", opening_angle_deg=30.0)
        truth = np.repeat(stress, 200, axis=0)
        noise = plain_noise(scan, reach=10.0)
        variance = draw_variances(truth, scan, noise, np.random.default_rng(9))
        matrix = design_matrix(scan)
        data = beam_data(
            variance, np.ones_like(variance, dtype=bool), np.broadcast_to(matrix, (*variance.shape, 6)), 0.0
        )
        fitted = fitted_variance(data, np.broadcast_to(noise.covariance[0], (len(truth), 4, 4)))
        error = np.log(fitted / (truth @ matrix.T)).std()
        assert error < 0.9 * np.log(variance / (truth @ matrix.T)).std()

    def test_noise_free_data_are_fitted(self, stress):
        """Without noise to speak of, the fit is the data."""
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        matrix = design_matrix(scan)
        variance = stress @ matrix.T
        data = beam_data(variance, np.ones_like(variance, dtype=bool), np.broadcast_to(matrix, (7, 6, 6)), 0.0)
        fitted = fitted_variance(data, np.broadcast_to(1e-6 * np.eye(6), (7, 6, 6)))
        np.testing.assert_allclose(fitted, variance, rtol=0.01)

    def test_data_without_information_leave_the_centre_of_the_prior(self, stress):
        scan = load_scan("6-beam")
        matrix = design_matrix(scan)
        data = beam_data(
            100.0 * stress @ matrix.T, np.ones((7, 6), dtype=bool), np.broadcast_to(matrix, (7, 6, 6)), 0.0
        )
        fitted = fitted_variance(data, np.broadcast_to(1e8 * np.eye(6), (7, 6, 6)))
        centre = matrix @ WeakPrior().stress(np.zeros(6))
        np.testing.assert_allclose(fitted, np.broadcast_to(centre, fitted.shape), rtol=1e-5)


class TestRefusals:
    @pytest.mark.parametrize("name", NAMES)
    def test_singular_noise(self, name):
        with pytest.raises(NotPositiveDefiniteError, match=r"noise of record 0 is singular: the smallest eigenvalue"):
            build(name, load_scan("2-beam"), np.ones((1, 2)), covariance=np.full((2, 2), 0.06))

    @pytest.mark.parametrize("name", NAMES)
    def test_a_variance_that_is_not_positive(self, name):
        with pytest.raises(InputError, match=r"Invalid variance 0\.0 of record 0, beam 1: it must be positive"):
            build(name, load_scan("2-beam"), np.array([[1.0, 0.0]]))

    def test_unknown_power(self):
        with pytest.raises(InputError, match=r"Invalid power 0\.5: it must be 1 or 1/3"):
            power_likelihood(
                np.ones((1, 1)),
                np.ones((1, 1), dtype=bool),
                np.ones((1, 1, 6)),
                np.full((1, 1, 1), 0.1),
                power=0.5,
            )
