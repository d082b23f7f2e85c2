"""Priors: one checker that all pass, and what each one says of itself."""

import numpy as np
import pytest
from scipy import stats

from bayes_rs import InputError, NotPositiveDefiniteError
from bayes_rs.campaign import prior_from_stresses
from bayes_rs.geometry.stress import is_realizable
from bayes_rs.intervals import EQUAL_TAILED, HIGHEST_DENSITY, interval_of
from bayes_rs.models import TURBULENCES
from bayes_rs.priors.interface import _WIDTH_DRAWS, _WIDTH_SEED
from bayes_rs.priors.mann_family import family_shape
from bayes_rs.priors.registry import (
    PRIORS,
    FlatPrior,
    GaussianPrior,
    MannPrior,
    Prior,
    RatioPrior,
    SamplePrior,
    WeakPrior,
    make_prior,
)
from bayes_rs.turbulence.mann import load_turbulence
from bayes_rs.turbulence.one_point import scaled_stresses

MEAN = np.array([1.0, 0.6, 0.35, 0.1, -0.25, 0.05])
WIDE = 0.09 * (np.eye(6) + 0.3)


def log_ratios(stress):
    """ln uu, ln vv/uu, ln ww/uu and the Fisher transforms of ρ_uv, ρ_uw and of v and w given u, by regression on u."""
    uu, vv, ww, uv, uw, vw = stress.T
    partial = (vw - uv * uw / uu) / np.sqrt((vv - uv**2 / uu) * (ww - uw**2 / uu))
    return np.column_stack(
        [
            np.log(uu),
            np.log(vv / uu),
            np.log(ww / uu),
            *np.arctanh([uv / np.sqrt(uu * vv), uw / np.sqrt(uu * ww), partial]),
        ]
    )


def skewed_sample(n, seed):
    """Tensors whose log-ratios are skewed, and depend on each other through a normal copula."""
    rng = np.random.default_rng(seed)
    correlation = 0.5 * np.eye(6) + 0.5 * np.outer([1, -1, 1, 1, -1, 1], [1, -1, 1, 1, -1, 1])
    score = rng.standard_normal((n, 6)) @ np.linalg.cholesky(correlation).T
    inner = [-0.3, -0.7, -1.3, 0.0, -0.4, 0.1] + np.array([0.8, 0.3, 0.4, 0.2, 0.2, 0.2]) * 2.0 * np.expm1(0.5 * score)
    uu, vv, ww = np.exp(inner[:, 0]), np.exp(inner[:, 0] + inner[:, 1]), np.exp(inner[:, 0] + inner[:, 2])
    b, c = np.tanh(inner[:, 3]) * np.sqrt(vv), np.tanh(inner[:, 4]) * np.sqrt(ww)
    rest = np.tanh(inner[:, 5]) * np.sqrt((vv - b * b) * (ww - c * c))
    return np.column_stack([uu, vv, ww, np.sqrt(uu) * b, np.sqrt(uu) * c, b * c + rest])


EVERY = [
    *(make() for make in PRIORS.values()),
    WeakPrior(log_sd_vv=1.5, z_sd=1.0),
    FlatPrior(bound=0.3),
    RatioPrior(vv=0.8, sd_vv=0.1, uw=-0.4, sd_uw=0.1, vw=0.2),
    MannPrior(tolerance=1e-9, gamma_low=2.0, gamma_high=4.0),
    GaussianPrior(MEAN, WIDE),
    GaussianPrior(1e-2 * MEAN, 1e-9 * np.eye(6), name="narrow"),
    GaussianPrior([0.3, 0.3, -0.1, 0.0, 0.0, 0.0], WIDE, name="off the cone"),
    SamplePrior(skewed_sample(300, 1)),
    SamplePrior(WeakPrior().draw(50, seed=2), width=1.5, name="few"),
    prior_from_stresses(RatioPrior(vv=0.8, sd_vv=0.1, uw=-0.4).draw(60, seed=3), np.linspace(4.0, 12.0, 60)),
]


def gradient_of_log_density(prior, coordinate, step):
    """Central differences, shape (n, n_coordinate)."""
    shift = step * np.eye(prior.n_coordinate)
    return (prior.log_density(coordinate[:, None] + shift) - prior.log_density(coordinate[:, None] - shift)) / (
        2.0 * step
    )


def slope_of_stress(prior, coordinate, step):
    """Central differences, shape (n, n_coordinate, 6)."""
    shift = step * np.eye(prior.n_coordinate)
    return (prior.stress(coordinate[:, None] + shift) - prior.stress(coordinate[:, None] - shift)) / (2.0 * step)


def log_volume(prior, coordinate):
    """ln |∂stress/∂coordinate| of six coordinates, by fourth-order differences."""
    shift = 1e-3 * np.eye(6)
    near = prior.stress(coordinate[:, None] + shift) - prior.stress(coordinate[:, None] - shift)
    far = prior.stress(coordinate[:, None] + 2.0 * shift) - prior.stress(coordinate[:, None] - 2.0 * shift)
    return np.linalg.slogdet((8.0 * near - far) / 12e-3)[1]


@pytest.mark.parametrize("prior", EVERY, ids=lambda prior: f"{prior.name}")
class TestEveryPrior:
    def test_draws_are_realizable(self, prior):
        draws = prior.draw(20_000, seed=1)
        assert draws.shape == (20_000, 6)
        assert draws.dtype == np.float64
        assert is_realizable(draws).all()

    def test_extreme_coordinates_give_realizable_tensors(self, prior):
        """No clipping anywhere: eight standard deviations off in every coordinate is a tensor like any other."""
        corners = 8.0 * np.random.default_rng(2).integers(-1, 2, (3000, prior.n_coordinate))
        stress = prior.stress(corners)
        assert np.isfinite(stress).all()
        assert is_realizable(stress).all()
        assert np.isfinite(prior.log_density(corners)).all()

    def test_density_is_normalized(self, prior):
        """E[p/q] = 1 under a Student-t q with heavier tails than p, within its own Monte-Carlo error."""
        draws = prior.draw_coordinate(20_000, np.random.default_rng(3))
        assert draws.shape == (20_000, prior.n_coordinate)
        other = stats.multivariate_t(draws.mean(axis=0), 1.2 * np.cov(draws, rowvar=False), df=5.0, seed=4)
        points = other.rvs(200_000)
        ratio = np.exp(prior.log_density(points) - other.logpdf(points))
        error = ratio.std() / np.sqrt(len(ratio))
        assert error < 0.01  # so that the law has power
        normalizer = getattr(prior, "share_error", 0.0) / getattr(prior, "share", 1.0)
        assert abs(ratio.mean() - 1.0) < 5.0 * np.hypot(error, normalizer)

    def test_draws_follow_the_density(self, prior):
        """Stein's identity E[φ ∂ ln p + ∂φ] = 0 for waves φ of random direction: it holds for draws from p alone."""
        rng = np.random.default_rng(5)
        coordinate = prior.draw_coordinate(40_000, rng)
        scale = coordinate.std(axis=0)
        slope = gradient_of_log_density(prior, coordinate, 1e-4)
        for direction in rng.standard_normal((12, prior.n_coordinate)) / np.sqrt(prior.n_coordinate):
            phase = coordinate @ (direction / scale) + rng.uniform(0.0, 2.0 * np.pi)
            value = np.sin(phase)[:, None] * slope + np.cos(phase)[:, None] * direction / scale
            error = value.std(axis=0) / np.sqrt(len(value))
            assert np.all(np.abs(value.mean(axis=0)) < 5.0 * error)  # 1000 numbers: a false alarm in 1700 runs

    def test_map_and_density_are_smooth(self, prior):
        """Halving the step of central differences takes three quarters of their error away: no kink, no jump."""
        coordinate = prior.draw_coordinate(3000, np.random.default_rng(6))
        steps = 4e-3, 2e-3, 1e-3
        stress = prior.stress(coordinate)
        scale = np.sqrt(stress[:, [0, 1, 2, 0, 0, 1]] * stress[:, [0, 1, 2, 1, 2, 2]])[:, None, :]
        slopes = [slope_of_stress(prior, coordinate, step) / scale for step in steps]
        gradients = [gradient_of_log_density(prior, coordinate, step) for step in steps]
        for coarse, middle, fine in (slopes, gradients):
            error = np.abs(middle - fine).max()
            rounding = 1e-12 * np.abs(fine).max() / steps[-1] + 1e-9
            assert error < 0.3 * np.abs(coarse - middle).max() + rounding  # 0.25, and the next order

    def test_coordinates_and_stresses_are_one_to_one(self, prior):
        """The map has full rank: the six stresses move in six directions."""
        coordinate = prior.draw_coordinate(50, np.random.default_rng(7))
        jacobian = slope_of_stress(prior, coordinate, 1e-5)
        if prior.name != "mann" or prior.tolerance > 1e-6:  # on the family itself five directions are 1e-9 deep
            rank = np.linalg.matrix_rank(jacobian / np.abs(jacobian).max(axis=(1, 2), keepdims=True), tol=1e-9)
            assert np.all(rank == 6)

    def test_shape_of_the_answers_is_that_of_the_question(self, prior):
        coordinate = prior.draw_coordinate(6, np.random.default_rng(8))
        cube = coordinate.reshape(2, 3, -1)
        np.testing.assert_allclose(prior.stress(cube).reshape(6, 6), prior.stress(coordinate), rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(prior.log_density(cube).ravel(), prior.log_density(coordinate), rtol=1e-12)
        assert prior.log_density(coordinate[0]).shape == ()
        assert prior.stress(coordinate[0]).shape == (6,)

    def test_the_layout_in_memory_changes_no_bit(self, prior):
        """Samplers hold each coordinate of a record's draws as a run of numbers, which is calculated in another way."""
        coordinate = prior.draw_coordinate(60, np.random.default_rng(8)).reshape(3, 20, -1)
        runs = np.ascontiguousarray(coordinate.swapaxes(1, 2)).swapaxes(1, 2)
        np.testing.assert_array_equal(prior.stress(runs), prior.stress(coordinate))
        np.testing.assert_array_equal(prior.log_density(runs), prior.log_density(coordinate))

    def test_coordinates_are_not_changed(self, prior):
        coordinate = prior.draw_coordinate(6, np.random.default_rng(8))
        before = coordinate.copy()
        prior.stress(coordinate)
        prior.log_density(coordinate)
        np.testing.assert_array_equal(coordinate, before)

    def test_same_seed_same_draws(self, prior):
        np.testing.assert_array_equal(prior.draw(5, seed=7), prior.draw(5, seed=7))
        assert not np.any(prior.draw(5, seed=7)[:, 0] == prior.draw(5, seed=8)[:, 0])

    def test_words_are_one_line_and_begin_with_the_name(self, prior):
        words = prior.in_words()
        assert words.startswith(f"{prior.name}: ")
        assert "\n" not in words

    def test_interval_widths_are_those_of_draws(self, prior):
        ends = np.quantile(prior.draw(100_000, seed=9), [0.25, 0.75], axis=0)
        width = prior.interval_widths(0.5)
        # a quartile of n draws has the error 0.43/√n in probability; 15 of these cover two quartiles of two samples
        np.testing.assert_allclose(width, ends[1] - ends[0], rtol=15.0 * 0.43 / np.sqrt(100_000) / 0.25)
        assert np.all(prior.interval_widths(0.9) > width)

    def test_widened_is_wider(self, prior):
        wider = prior.widened(1.5)
        assert type(wider) is type(prior)
        assert np.all(wider.interval_widths(0.8) > 1.05 * prior.interval_widths(0.8))
        np.testing.assert_allclose(prior.widened(1.0).interval_widths(), prior.interval_widths(), rtol=1e-9)
        with pytest.raises(InputError, match=r"Invalid factor 0.0 in prior .*above zero"):
            prior.widened(0.0)

    def test_probability_of_an_interval_is_checked(self, prior):
        with pytest.raises(InputError, match=r"Invalid prob 1.0: it must be between 0 and 1"):
            prior.interval_widths(1.0)


@pytest.mark.parametrize("prior", [WeakPrior(), WeakPrior(z_uw=0.1), RatioPrior(sd_vw=0.5)], ids=repr)
def test_widths_that_are_kept_are_those_of_the_draws_and_of_each_prior_its_own(prior):
    for _ in range(2):
        for prob, kind in ((0.5, EQUAL_TAILED), (0.5, HIGHEST_DENSITY), (0.8, EQUAL_TAILED)):
            low, high = interval_of(prior.draw(_WIDTH_DRAWS, _WIDTH_SEED).T, prob, kind)
            width = prior.interval_widths(prob, kind)
            np.testing.assert_array_equal(width, high - low)
            width[:] = 0.0  # the caller's own


class _Forgetful(FlatPrior):
    """A flat prior whose density has a factor too many, smooth and near one."""

    def log_density(self, coordinate):
        return super().log_density(coordinate) + 0.3 * np.sin(coordinate[..., 1])


class _Kinked(WeakPrior):
    """A prior whose map has a kink of a few per cent."""

    def stress(self, coordinate):
        bent = coordinate + 0.05 * np.abs(coordinate)
        return super().stress(bent)


@pytest.mark.parametrize(
    ("prior", "law"),
    [
        (_Forgetful(), "test_draws_follow_the_density"),
        (_Forgetful(), "test_density_is_normalized"),
        (_Kinked(), "test_map_and_density_are_smooth"),
    ],
)
def test_the_checker_has_power(prior, law):
    with pytest.raises(AssertionError):
        getattr(TestEveryPrior(), law)(prior)


class TestOwnPrior:
    def test_four_methods_are_enough(self):
        class Isotropic(Prior):
            name = "isotropic"

            def stress(self, coordinate):
                return np.exp(coordinate[..., :1]) * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])

            def log_density(self, coordinate):
                return -0.5 * np.sum(coordinate**2, axis=-1) - 3.0 * np.log(2.0 * np.pi)

            def draw_coordinate(self, n_draw, rng):
                return rng.standard_normal((n_draw, 6))

            def in_words(self):
                return "isotropic: size only"

        prior = Isotropic()
        assert prior.n_coordinate == 6
        assert prior.interval_widths()[0] == pytest.approx(np.exp(1.645) - np.exp(-1.645), rel=0.02)
        with pytest.raises(InputError, match=r"Prior 'isotropic' cannot be widened by 2: give it the method `widened`"):
            prior.widened(2.0)


class TestFlat:
    def test_uniform_over_realizable_tensors(self):
        """Against rejection from the box of all symmetric tensors: the definition itself."""
        rng = np.random.default_rng(6)
        box = np.concatenate([rng.uniform(0.0, 1.0, (600_000, 3)), rng.uniform(-1.0, 1.0, (600_000, 3))], axis=1)
        accepted = box[is_realizable(box)]
        draws = FlatPrior(bound=1.0).draw(len(accepted), seed=7)
        for statistic in (lambda s: s, lambda s: np.abs(s[:, 3:]), lambda s: s[:, [3]] * s[:, [4]] * s[:, [5]]):
            for index in range(statistic(draws).shape[1]):
                assert stats.ks_2samp(statistic(accepted)[:, index], statistic(draws)[:, index]).pvalue > 1e-3

    def test_marginals_in_closed_form(self):
        stress = FlatPrior(bound=3.0).draw(50_000, seed=8)
        fisher = log_ratios(stress)[:, 3:]
        for index in range(3):
            assert stats.kstest((stress[:, index] / 3.0) ** 2, "uniform").pvalue > 1e-3
        for index, power in enumerate((1.5, 1.5, 1.0)):
            assert stats.kstest(0.5 + 0.5 * np.tanh(fisher[:, index]), stats.beta(power, power).cdf).pvalue > 1e-3

    @pytest.mark.parametrize(("shift", "aside"), [(0.0, 1.0), (-3.0, 0.1), (-6.0, 1e-3)])
    def test_density_over_the_stresses_is_constant_at_every_size(self, shift, aside):
        """p(R) = 16/(π² bound⁶), from draws near the bound down to uu at 10⁻⁵ of it: density and Jacobian."""
        prior = FlatPrior()
        coordinate = prior.draw_coordinate(200, np.random.default_rng(9))
        coordinate[:, :3] = shift + coordinate[:, :3] * (0.3 if shift else 1.0)
        coordinate[:, 3:] *= aside  # both so that the determinant of the differences does not cancel
        density = prior.log_density(coordinate) - log_volume(prior, coordinate)
        # fourth-order differences with step 1e-3: 1e-12 of the fifth derivative, and rounding of 1e-13/1e-3
        np.testing.assert_allclose(density, np.log(16.0 / np.pi**2) - 6.0 * np.log(25.0), atol=1e-6)

    def test_small_tensors_keep_their_digits(self):
        """With the bound at 25, variances of 1e-2 and of 1e-12 m² s⁻² have coordinates as good as any."""
        for uu in (1.0, 1e-2, 1e-6, 1e-12):
            coordinate = np.zeros(6)
            coordinate[0] = stats.norm.ppf((uu / 25.0) ** 2)
            # d ln uu = ½ |z| dz, with |z| up to 15 and 15 ε of rounding in z
            assert FlatPrior().stress(coordinate)[0] == pytest.approx(uu, rel=1e-12)

    def test_flat_is_not_weak(self):
        """The density of uu grows with uu: s = uu/bound has mean 2/3."""
        uu = FlatPrior(bound=3.0).draw(100_000, seed=8)[:, 0] / 3.0
        assert uu.mean() == pytest.approx(2.0 / 3.0, abs=5.0 * np.sqrt(1.0 / 18.0 / 100_000))

    def test_widened_bound(self):
        assert FlatPrior(bound=2.0).widened(3.0).bound == pytest.approx(6.0)


class TestRatio:
    def test_weak_has_the_documented_medians_and_widths(self):
        stress = WeakPrior().draw(200_000, seed=9)
        log_ratio = np.log(stress[:, 1:3] / stress[:, :1])
        correlation = stress[:, 3:] / np.sqrt(stress[:, [0, 0, 1]] * stress[:, [1, 2, 2]])
        spread = 5.0 / np.sqrt(200_000)  # five standard errors of a mean in units of the sd
        np.testing.assert_allclose(np.log(stress[:, 0]).mean(), 0.0, atol=2.0 * spread)
        np.testing.assert_allclose(np.log(stress[:, 0]).std(), 2.0, rtol=spread)
        np.testing.assert_allclose(log_ratio.mean(axis=0), np.log([0.64, 0.4]), atol=0.9 * spread)
        np.testing.assert_allclose(log_ratio.std(axis=0), [0.5, 0.9], rtol=spread)
        np.testing.assert_allclose(np.arctanh(correlation[:, :2]).mean(axis=0), [0.0, -0.3], atol=0.35 * spread)

    @pytest.mark.parametrize("flow", [*TURBULENCES, "neutral surface layer", "isotropic"])
    def test_the_central_region_of_weak_holds_its_sources_and_isotropic_air(self, flow):
        """Each of the ratios and the correlation inside its central 95 %, and all three inside their joint 95 %."""
        if flow == "neutral surface layer":  # Panofsky and Dutton (1984), Table 7.1: σ over u* of 2.39, 1.92, 1.25
            stress = np.array([2.39**2, 1.92**2, 1.25**2, 0.0, -1.0, 0.0])
        elif flow == "isotropic":
            stress = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        else:
            stress = load_turbulence(flow).stresses()
        weak = WeakPrior()
        distance = np.array(
            [
                np.log(stress[1] / stress[0] / weak.ratio_vv) / weak.log_sd_vv,
                np.log(stress[2] / stress[0] / weak.ratio_ww) / weak.log_sd_ww,
                (np.arctanh(stress[4] / np.sqrt(stress[0] * stress[2])) - weak.z_uw) / weak.z_sd,
            ]
        )
        assert np.all(np.abs(distance) < 1.1)  # as the docstring says; the central 95 % end at 1.96
        assert distance @ distance < stats.chi2.ppf(0.95, 3)

    def test_ratio_has_the_medians_and_widths_that_are_given(self):
        middle = {"uu": 0.7, "vv": 0.6, "ww": 0.3, "uv": 0.1, "uw": -0.4, "vw": 0.2}
        width = {"sd_uu": 0.9, "sd_vv": 0.1, "sd_ww": 0.2, "sd_uv": 0.3, "sd_uw": 0.15, "sd_vw": 0.25}
        inner = log_ratios(RatioPrior(**middle, **width).draw(100_000, seed=10))
        sd = np.array(list(width.values()))
        m = list(middle.values())
        expected = np.concatenate([np.log(m[:3]), np.arctanh(m[3:])])
        assert np.all(np.abs(inner.mean(axis=0) - expected) < 5.0 * sd / np.sqrt(100_000))
        np.testing.assert_allclose(inner.std(axis=0), sd, rtol=5.0 / np.sqrt(200_000))

    def test_ratio_without_numbers_is_weak(self):
        np.testing.assert_allclose(RatioPrior().draw(1000, seed=1), WeakPrior().draw(1000, seed=1), rtol=1e-13)

    def test_widened_multiplies_every_width(self):
        assert WeakPrior().widened(2.0) == WeakPrior(log_sd_uu=4.0, log_sd_vv=1.0, log_sd_ww=1.8, z_sd=0.7)
        wider = RatioPrior().widened(2.0)
        assert (wider.sd_uu, wider.sd_vv, wider.sd_ww, wider.sd_uv) == (4.0, 1.0, 1.8, 0.7)


class TestMann:
    def test_shape_is_that_of_the_quadrature(self):
        """The table against the integrals that it was made from, at values that are no nodes."""
        gamma = np.array([0.0, 0.03, 0.37, 1.1, 2.23, 3.2, 4.4, 5.0, 6.0])
        exact = np.array([scaled_stresses(float(g)) for g in gamma]).T
        wanted = [np.log(exact[0]), *np.log(exact[1:3] / exact[0]), np.arctanh(exact[4] / np.sqrt(exact[0] * exact[2]))]
        np.testing.assert_allclose(family_shape(gamma), wanted, atol=1e-6)  # the bound that the docstring states
        assert np.abs(family_shape(gamma) - wanted).max() < 1e-7  # what it is: the printed digits

    def test_no_tolerance_lies_on_the_family(self):
        prior = MannPrior(tolerance=1e-12, size=0.775, sd_size=0.5, gamma_low=3.0, gamma_high=3.4)
        median_size = np.log(scaled_stresses(3.2)[0]) / 0.5
        stress = prior.stress(np.array([median_size, 0.0, 1.0, -2.0, 3.0, 1.0, -1.0]))
        np.testing.assert_allclose(stress, 0.775 * np.array(scaled_stresses(3.2)), rtol=1e-6, atol=1e-10)

    def test_gamma_is_uniform_in_its_range(self):
        prior = MannPrior(gamma_low=1.0, gamma_high=4.0)
        gamma = prior.gamma(prior.draw_coordinate(20_000, np.random.default_rng(11)))
        assert stats.kstest((gamma - 1.0) / 3.0, "uniform").pvalue > 1e-3

    def test_tolerance_is_the_sd_about_the_model(self):
        prior = MannPrior(tolerance=0.07)
        coordinate = prior.draw_coordinate(100_000, np.random.default_rng(12))
        off = log_ratios(prior.stress(coordinate))
        shape = family_shape(prior.gamma(coordinate))
        off[:, [1, 2, 4]] -= shape[1:].T
        np.testing.assert_allclose(off[:, 1:].std(axis=0), 0.07, rtol=5.0 / np.sqrt(200_000))
        assert np.all(np.abs(off[:, 1:].mean(axis=0)) < 5.0 * 0.07 / np.sqrt(100_000))

    def test_widened_stays_in_the_table(self):
        wider = MannPrior(gamma_low=2.0, gamma_high=4.0, tolerance=0.1).widened(4.0)
        assert (wider.gamma_low, wider.gamma_high, wider.tolerance, wider.sd_size) == (0.0, 6.0, 0.4, 8.0)


class TestGaussian:
    def test_moments_are_those_of_plain_rejection(self):
        """Against NumPy's normal draws, kept where no eigenvalue is negative."""
        plain = np.random.default_rng(13).multivariate_normal(MEAN, WIDE, 400_000)
        kept = plain[is_realizable(plain)]
        prior = GaussianPrior(MEAN, WIDE)
        share = len(kept) / len(plain)
        error = np.hypot(np.sqrt(share * (1.0 - share) / len(plain)), prior.share_error)
        assert abs(prior.share - share) < 5.0 * error
        draws = prior.draw(len(kept), seed=14)
        for index in range(6):
            assert stats.ks_2samp(kept[:, index], draws[:, index]).pvalue > 1e-3
            assert stats.ks_2samp(kept[:, index] * kept[:, 4], draws[:, index] * draws[:, 4]).pvalue > 1e-3

    def test_density_over_the_stresses_is_the_normal_density_over_the_share(self):
        """The Jacobian, exactly: no Monte Carlo."""
        prior = GaussianPrior(MEAN, WIDE)
        coordinate = prior.draw_coordinate(200, np.random.default_rng(15))
        density = prior.log_density(coordinate) - log_volume(prior, coordinate)
        normal = stats.multivariate_normal(MEAN, WIDE).logpdf(prior.stress(coordinate)) - np.log(prior.share)
        np.testing.assert_allclose(density, normal, atol=1e-6)  # differences with step 1e-3, near the cone's edge too

    def test_share_of_a_known_case(self):
        """Of N(0, s² I) in the sense of the Frobenius norm (off-diagonals with half the variance) … is the GOE's."""
        prior = GaussianPrior(np.zeros(6), np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5]))
        exact = 0.25 - np.sqrt(2.0) / (2.0 * np.pi)  # all three eigenvalues of a 3 × 3 GOE positive
        assert abs(prior.share - exact) < 5.0 * prior.share_error

    def test_arrays_that_are_no_moments_are_refused(self):
        with pytest.raises(InputError, match=r"Invalid mean of prior 'gaussian' of shape \(5,\)"):
            GaussianPrior(MEAN[:5], WIDE)
        lopsided = WIDE.copy()
        lopsided[0, 1] += 0.01
        with pytest.raises(InputError, match=r"Invalid covariance of prior 'gaussian': it must be symmetric"):
            GaussianPrior(MEAN, lopsided)
        with pytest.raises(NotPositiveDefiniteError, match=r"smallest eigenvalue is -1 m⁴ s⁻⁴") as caught:
            GaussianPrior(MEAN, np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]))
        assert caught.value.smallest_eigenvalue == pytest.approx(-1.0)

    def test_a_distribution_without_realizable_tensors_is_refused(self):
        with pytest.raises(InputError, match=r"Too few realizable tensors in prior 'gaussian': 0 of 4000000 draws"):
            GaussianPrior(-MEAN, 1e-3 * np.eye(6))


class TestSample:
    def test_marginals_are_those_of_the_sample(self):
        sample = log_ratios(skewed_sample(1000, 16))
        prior = SamplePrior(skewed_sample(1000, 16))
        draws = log_ratios(prior.draw(200_000, seed=17))
        for level in (0.05, 0.25, 0.5, 0.75, 0.95):
            share = (sample < np.quantile(draws, level, axis=0)).mean(axis=0)
            # smoothing moves a quantile by less than three of the sample's own standard errors
            assert np.all(np.abs(share - level) < 3.0 * np.sqrt(level * (1.0 - level) / 1000))

    def test_rank_correlations_are_those_of_the_sample(self):
        sample = skewed_sample(1000, 18)
        wanted = stats.spearmanr(log_ratios(sample)).statistic
        found = stats.spearmanr(log_ratios(SamplePrior(sample).draw(50_000, seed=19))).statistic
        assert np.abs(wanted - found).max() < 3.0 / np.sqrt(1000)
        assert np.abs(wanted[0, 1:]).min() > 0.3  # there is something to recover

    def test_tails_are_normal_beyond_the_sample(self):
        """Ten scores off, the quantile curve runs straight, with a slope of the sample's own size."""
        prior = SamplePrior(skewed_sample(300, 20))
        spread = log_ratios(skewed_sample(300, 20)).std(axis=0)
        for end in (-10.0, 10.0):
            points = np.zeros((3, 6))
            points[:, 0] = end + np.array([-1.0, 0.0, 1.0])
            log_uu = np.log(prior.stress(points)[:, 0])
            assert abs(np.diff(log_uu, n=2)[0]) < 0.01 * spread[0]
            assert 0.1 < np.diff(log_uu)[0] / spread[0] < 4.0

    def test_rows_that_are_not_realizable_are_named(self):
        sample = skewed_sample(60, 21)
        sample[7, 3] = 10.0
        with pytest.raises(InputError, match=r"row 7 has the smallest principal variance -.*\(1 such rows\)"):
            SamplePrior(sample)

    def test_samples_that_make_no_prior_are_refused(self):
        with pytest.raises(InputError, match=r"Too few stresses in prior 'sample': 49 tensors, and at least 50"):
            SamplePrior(skewed_sample(49, 22))
        same = skewed_sample(60, 23)
        with pytest.raises(InputError, match=r"ln uu hardly varies from row to row"):
            SamplePrior(same / same[:, :1])
        tied = np.column_stack([*skewed_sample(60, 24).T[:3], np.zeros((60, 3))])
        with pytest.raises(InputError, match=r"artanh rho_uv hardly varies"):
            SamplePrior(tied)
        with pytest.raises(InputError, match=r"Invalid stresses of prior 'sample' of shape \(60, 5\)"):
            SamplePrior(same[:, :5])
        coordinate = np.random.default_rng(25).standard_normal((60, 6))
        coordinate[:, 2] = coordinate[:, 1]
        with pytest.raises(InputError, match=r"a combination of the stresses does not vary"):
            SamplePrior(RatioPrior().stress(coordinate))

    def test_width_multiplies_the_scores(self):
        """The medians stay, and the quartiles are those of scores twice as far out."""
        prior = SamplePrior(skewed_sample(300, 27))
        one, two = (np.log(p.draw(200_000, seed=28)[:, 0]) for p in (prior, prior.widened(2.0)))
        level = stats.norm.cdf(2.0 * stats.norm.ppf([0.25, 0.5, 0.75]))
        np.testing.assert_allclose(np.quantile(two, [0.25, 0.5, 0.75]), np.quantile(one, level), atol=0.03)


class TestByName:
    def test_words_give_the_widths(self):
        assert "factor 50 either way" in WeakPrior().in_words()
        assert "below 25 m² s⁻²" in FlatPrior().in_words()
        assert "uv -0.60 to 0.60" in RatioPrior().in_words()
        assert "gamma uniform from 0 to 5" in MannPrior().in_words()
        assert "sample of 60 tensors, scores times 2" in SamplePrior(skewed_sample(60, 29), width=2.0).in_words()

    def test_the_numbers_in_the_words(self):
        """Factors are exp(1.96 sd), correlations are tanh(artanh ρ ± 1.96 sd)."""
        assert WeakPrior().in_words() == (
            "weak: uu log-normal about 1 m² s⁻² (factor 50 either way), vv/uu about 0.64 (factor 2.7), "
            "ww/uu about 0.4 (factor 5.8), correlation of u and w about -0.29, the others about 0 (95 %)"
        )
        assert RatioPrior(uv=0.1).in_words() == (
            "ratio: uu log-normal about 1 (factor 50.4), vv/uu log-normal about 0.64 (factor 2.66), ww/uu log-normal "
            "about 0.4 (factor 5.84); correlations uv -0.53 to 0.66, uw -0.76 to 0.37, vw given u -0.60 to 0.60 (95 %)"
        )
        variance = np.diag([0.04, 0.01, 0.01, 0.0025, 0.0025, 0.0009])
        assert GaussianPrior([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], variance).in_words() == (
            "gaussian: normal with mean (1, 0.6, 0.4, 0, -0.2, 0) and standard deviation (0.2, 0.1, 0.1, 0.05, 0.05, "
            "0.03) m² s⁻² in uu, vv, ww, uv, uw, vw, cut to realizable tensors (100 % of it)"
        )

    def test_a_name_with_parameters(self):
        assert make_prior("flat:bound=10") == FlatPrior(bound=10.0)
        assert make_prior("weak: log_sd_vv = 1, z_sd=0.5") == WeakPrior(log_sd_vv=1.0, z_sd=0.5)
        assert make_prior("ratio:vv=0.6,ww=0.3,sd_vv=0.3") == RatioPrior(vv=0.6, ww=0.3, sd_vv=0.3)
        assert make_prior("mann:tolerance=5e-2") == MannPrior(tolerance=0.05)
        prior = MannPrior(tolerance=0.2)
        assert make_prior(prior) is prior

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("jeffreys", r"Unknown prior 'jeffreys': it must be one of weak, "),
            ("flat:limit=3", r"Unknown parameter 'limit' of prior 'flat': it must be one of bound"),
            ("flat:name=3", r"Unknown parameter 'name' of prior 'flat'"),
            ("flat:bound=ten", r"Invalid bound 'ten' of prior 'flat': it must be a number, such as 25"),
            ("flat:bound=-1", r"Invalid bound -1.0 m² s⁻² in prior 'flat': it must be a finite number above"),
            ("flat:bound=nan", r"Invalid bound nan m² s⁻² in prior 'flat'"),
            (
                "flat:10",
                r"Invalid parameter '10' of prior 'flat': write flat:key=value,key=value, such as flat:bound=25",
            ),
            ("flat:", r"Invalid parameter '' of prior 'flat'"),
            ("ratio:vv=1,vv=2", r"Parameter 'vv' of prior 'ratio' is given twice"),
            ("ratio:uw=-1", r"Invalid uw -1.0 in prior 'ratio': it is a correlation, and must be above -1"),
            ("weak:log_sd_vv=0", r"Invalid log_sd_vv 0.0 in prior 'weak'"),
            ("mann:gamma_low=5", r"Invalid range of gamma 5 to 5 in prior 'mann'"),
            ("mann:gamma_high=7", r"Invalid range of gamma 0 to 7 in prior 'mann'.*at most 6"),
        ],
    )
    def test_texts_that_mean_no_prior(self, text, message):
        with pytest.raises(InputError, match=message):
            make_prior(text)
