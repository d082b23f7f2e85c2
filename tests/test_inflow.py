"""Stresses with gradients: exact identities, one density for all likelihoods, calibration, an independent reference."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from other_likelihoods import OTHER_LIKELIHOODS
from scenes import draw_variances, plain_noise, records_of
from scipy import stats

from bayes_rs import InputError, Nuisances, fit, inflow_confounding, load_scan
from bayes_rs.fits.batch import Batch, FitOptions, make_posterior
from bayes_rs.fits.flags import FLAGS
from bayes_rs.geometry.forward import design_matrix, radial_variance
from bayes_rs.geometry.inflow import gradient_columns
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, REFERENCE_STRESS, reduced_log_normal_likelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.likelihoods.reduced_noise import ReducedNoise
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import RecordNuisances
from bayes_rs.priors.ratio import WeakPrior

fit = partial(fit, campaign="off")
"""What one record tells is tested."""

NEUTRAL = [1.0, 0.5, 0.27, 0.0, -0.15, 0.0]
MAKERS = {**LIKELIHOODS, **OTHER_LIKELIHOODS}


def beam_factor(scan, lateral, vertical):
    """What gradients (n_record,), per 100 m, multiply the beams' variances by, shape (n_record, n_beam)."""
    point = scan.focus_distance[:, None] * scan.level_direction
    point = point - point.mean(axis=0)
    return np.exp((np.outer(lateral, point[:, 1]) + np.outer(vertical, point[:, 2])) / 100.0)


def build(name, scan, variance, place=None, gain=None, used=None, offset=0.0, **options):
    shape = (len(variance), scan.n_beam)
    return MAKERS[name](
        variance,
        np.ones(shape, dtype=bool) if used is None else used,
        np.broadcast_to(design_matrix(scan), (*shape, 6)) if gain is None else gain,
        np.broadcast_to(plain_noise(scan).covariance[0], (*shape, scan.n_beam)),
        offset,
        place=None if place is None else np.broadcast_to(place, (*shape, place.shape[-1])),
        **options,
    )


class TestConfounding:
    @pytest.mark.parametrize("name", ["6-beam", "50-beam", "zx-tm"])
    @pytest.mark.parametrize("angle", [15.0, 45.0])
    def test_a_gradient_of_uu_is_uw_to_one_cone(self, name, angle):
        """n₁² z ∂uu/∂z = 2 n₁ n₃ δuw with δuw = −½ f cos φ ∂uu/∂z, beam by beam; a lateral gradient is uv."""
        scan = load_scan(name, opening_angle_deg=angle, tilt_deg=0.0)
        tensor, gradient = np.array([1.3, 0.6, 0.3, 0.1, -0.2, 0.05]), 0.002
        point = scan.focus_distance[:, None] * scan.level_direction
        for axis, component in ((1, 3), (2, 4)):
            sloping = np.tile(tensor, (scan.n_beam, 1))
            sloping[:, 0] += gradient * point[:, axis]
            found = np.diag(radial_variance(scan, sloping))
            faked = tensor.copy()
            faked[component] -= 0.5 * np.unique(scan.focus_distance)[0] * np.cos(np.deg2rad(angle)) * gradient
            # a centre beam is on the axis, and sees neither
            np.testing.assert_allclose(found, radial_variance(scan, faked), rtol=1e-12)

    @pytest.mark.parametrize("name", ["6-beam", "50-beam", "zx-tm"])
    def test_the_table_knows_it(self, name):
        scan = load_scan(name, tilt_deg=0.0)
        table = inflow_confounding(scan, [2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        cosine = np.abs(scan.line_of_sight[:, 0]).min()
        fake = -0.5 * scan.focus_distance[0] / 100.0 * cosine * 2.0
        for gradient, stress in (("lateral_gradient", "uv"), ("vertical_gradient", "uw")):
            rows = table[table["gradient"] == gradient].set_index("stress")
            np.testing.assert_allclose(rows.loc[stress, "change"], fake, rtol=1e-8)
            np.testing.assert_allclose(rows.loc[stress, "over_uu"], 0.5 * fake, rtol=1e-8)
            np.testing.assert_allclose(rows["change"].drop(stress), 0.0, atol=1e-7)  # directions have nine digits
            np.testing.assert_allclose(rows["hidden"], 1.0, rtol=1e-9)

    @pytest.mark.parametrize("name", ["6-beam", "50-beam"])
    def test_isotropic_stresses_hide_their_gradient_from_one_cone(self, name):
        """n·R n is the same for all beams, so its gradient is n₃ times a constant: 2 n₁ n₃ δuw again."""
        scan = load_scan(name, tilt_deg=0.0)
        rows = inflow_confounding(scan, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]).query("gradient == 'vertical_gradient'")
        ring = scan.line_of_sight[np.abs(scan.line_of_sight[:, 0]) < 0.999]
        expected = 0.5 * scan.focus_distance[0] / 100.0 / ring[0, 0]
        np.testing.assert_allclose(rows.set_index("stress").loc["uw", "change"], expected, rtol=1e-8)
        np.testing.assert_allclose(rows["hidden"], 1.0, rtol=1e-9)

    def test_what_is_hidden_is_what_stresses_reproduce(self):
        """The change of the table is a fit of the sloping variances that no other change of the stresses beats."""
        scan = load_scan("51-beam-planes")
        table = inflow_confounding(scan, NEUTRAL).query("gradient == 'vertical_gradient'")
        level = radial_variance(scan, np.array(NEUTRAL))
        sloping = level * gradient_columns(scan.geometry())[:, 1] / 100.0
        rest = (radial_variance(scan, table["change"].to_numpy()) - sloping) / level
        np.testing.assert_allclose(1.0 - np.sum(rest**2) / np.sum((sloping / level) ** 2), table["hidden"], rtol=1e-9)
        np.testing.assert_allclose(rest @ (design_matrix(scan) / level[:, None]), 0.0, atol=1e-9)
        assert table["hidden"].iloc[0] < 0.95  # several planes tell a gradient from stresses, in part

    def test_noise_gives_the_sd_of_generalized_least_squares(self):
        scan = load_scan("6-beam-planes")
        noise = plain_noise(scan)
        table = inflow_confounding(scan, NEUTRAL, noise=noise)
        relative = design_matrix(scan) / (design_matrix(scan) @ NEUTRAL)[:, None]
        place = gradient_columns(scan.geometry()) / 100.0
        basis, _ = np.linalg.qr(np.concatenate([relative, place], axis=1))
        weight = basis @ np.linalg.inv(basis.T @ np.log(1.0 + noise.covariance[0]) @ basis) @ basis.T
        for name, column in zip(("lateral_gradient", "vertical_gradient"), place.T, strict=True):
            columns = np.concatenate([relative, column[:, None]], axis=1)
            covariance = np.linalg.inv(columns.T @ weight @ columns)
            rows = table[table["gradient"] == name]
            np.testing.assert_allclose(rows["sd"], np.sqrt(covariance[-1, -1]), rtol=1e-6)
            # what least squares gives to the stresses if the gradient is left out: −C_Rγ / C_γγ, Frisch and Waugh
            np.testing.assert_allclose(rows["change"], -covariance[:6, -1] / covariance[-1, -1], rtol=1e-5, atol=1e-7)

    def test_what_is_hidden_has_no_sd(self):
        scan = load_scan("6-beam")
        assert np.isinf(inflow_confounding(scan, NEUTRAL, noise=plain_noise(scan))["sd"]).all()
        assert inflow_confounding(scan, NEUTRAL)["sd"].isna().all()
        assert (inflow_confounding(load_scan("staring"), NEUTRAL)["hidden"] == 1.0).all()

    def test_a_lateral_gradient_of_the_mean_wind_is_a_yaw_error(self):
        """n₁ y ∂U/∂y = n₂ δV with δV = −f cos φ ∂U/∂y to one cone, and a vertical one is a vertical wind."""
        scan = load_scan("6-beam", tilt_deg=0.0)
        direction, slope = scan.line_of_sight, 0.01
        cosine = np.abs(direction[:, 0]).min()
        for axis in (1, 2):
            sloping = direction[:, 0] * slope * scan.focus_distance * direction[:, axis]
            np.testing.assert_allclose(sloping, direction[:, axis] * -98.0 * cosine * slope, rtol=1e-9, atol=1e-12)

    def test_a_tensor_that_is_not_one_is_refused(self):
        with pytest.raises(InputError, match="must be realizable"):
            inflow_confounding(load_scan("6-beam"), [1.0, 0.5, 0.27, 0.9, 0.0, 0.0])
        with pytest.raises(InputError, match="no variance"):
            inflow_confounding(load_scan("staring"), [0.0, 1.0, 1.0, 0.0, 0.0, 0.0])


class TestPlace:
    def test_it_counts_from_the_middle_of_the_points(self):
        scan = load_scan("6-beam", tilt_deg=5.0)
        columns = gradient_columns(scan.geometry())
        np.testing.assert_allclose(columns.mean(axis=0), 0.0, atol=1e-12)
        point = scan.focus_distance[:, None] * scan.level_direction
        np.testing.assert_allclose(np.diff(columns, axis=0), np.diff(point[:, 1:], axis=0), atol=1e-6)

    def test_only_what_is_on_has_a_column(self):
        scan = load_scan("6-beam")
        both = gradient_columns(scan.geometry())
        assert Nuisances(yaw_sd_deg=2.0).place(scan.geometry()) is None
        vertical = Nuisances(vertical_gradient_sd=0.4)
        assert vertical.names == ("vertical_gradient",)
        np.testing.assert_allclose(vertical.place(scan.geometry()), 0.004 * both[:, 1:])
        lateral = Nuisances(lateral_gradient_sd=0.2, yaw_sd_deg=1.0)
        assert lateral.names == ("yaw_error", "lateral_gradient")
        np.testing.assert_allclose(lateral.place(scan.geometry()), 0.002 * both[:, :1])
        assert lateral.without_gradients() == Nuisances(yaw_sd_deg=1.0)

    def test_twice_the_distance_and_half_the_gradient_is_the_same(self):
        near, far = load_scan("6-beam"), load_scan("6-beam", focus_distance=196.0)
        np.testing.assert_allclose(
            Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.2).place(near.geometry()),
            Nuisances(vertical_gradient_sd=0.25, lateral_gradient_sd=0.1).place(far.geometry()),
            rtol=1e-9,
            atol=1e-12,
        )

    def test_coordinates_become_gradients_beside_the_other_nuisances(self):
        choice = Nuisances(
            yaw_sd_deg=2.0, instrument_noise_log_sd=0.5, vertical_gradient_sd=0.4, lateral_gradient_sd=0.2
        )
        nuisances = RecordNuisances(choice, np.zeros(1), 0.05)
        coordinate = np.array([[[0.0, 1.0, -0.5, 2.0]]])
        values = nuisances.values(coordinate)
        assert {name: value.item() for name, value in values.items()} == pytest.approx(
            {
                "yaw_error": 0.0,
                "instrument_noise": 0.05 * np.exp(0.5),
                "lateral_gradient": -0.1,
                "vertical_gradient": 0.8,
            }
        )
        stress, offset, gradient = nuisances.apply(np.array([[NEUTRAL]]), coordinate)
        np.testing.assert_allclose(stress[0, 0], NEUTRAL, atol=1e-15)
        assert offset.item() == pytest.approx(0.05 * np.exp(0.5))
        np.testing.assert_array_equal(gradient, [[[-0.5, 2.0]]])
        assert nuisances.apply(np.array([[NEUTRAL]]), coordinate)[0].shape == (1, 1, 6)

    def test_words_and_errors(self):
        assert Nuisances(vertical_gradient_sd=0.3).in_words() == (
            "vertical gradient of ln R ± 0.3 per 100 m (one standard deviation)"
        )
        with pytest.raises(InputError, match="lateral_gradient_sd"):
            Nuisances(lateral_gradient_sd=-1.0)


class TestLikelihood:
    """m_b = exp(place · gradient) n·R n + noise, in every likelihood."""

    scan = load_scan("6-beam")
    place = Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.3).place(scan.geometry())
    stress = WeakPrior(log_sd_uu=0.5).draw(7, seed=1)
    gradient = np.random.default_rng(2).standard_normal((7, 2))

    def variance(self, offset=0.0):
        signal = radial_variance(self.scan, self.stress) * np.exp(self.gradient @ self.place.T)
        return (signal + offset) * np.exp(0.2 * np.random.default_rng(3).standard_normal(signal.shape))

    @pytest.mark.parametrize("name", [name for name in MAKERS if name != "gaussian-plugin"])
    @pytest.mark.parametrize("dof", [np.inf, 7.0])
    def test_a_known_gradient_is_another_gain(self, name, dof):
        """No more beams than stresses: nothing is reduced, so the two have the same data."""
        variance, factor = self.variance(0.03), np.exp(self.gradient @ self.place.T)
        gain = design_matrix(self.scan) * factor[:, :, None]
        one = build(name, self.scan, variance, gain=gain, offset=0.02, dof=dof)
        other = build(name, self.scan, variance, self.place, offset=0.02, dof=dof)
        tensors, noise = self.stress[:, None], np.full((7, 1), 0.01)
        gradient = self.gradient[:, None]
        np.testing.assert_allclose(
            other.log_density(tensors, noise, gradient), one.log_density(tensors, noise), rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(
            np.sum(other.whitened_residual(tensors, noise, gradient) ** 2, axis=-1),
            np.sum(one.whitened_residual(tensors, noise) ** 2, axis=-1),
            rtol=1e-9,
        )
        np.testing.assert_allclose(other.expected(tensors, noise, gradient), one.expected(tensors, noise), rtol=1e-13)

    def test_the_plugin_has_fixed_noise_about_what_the_gradient_gives(self):
        variance = self.variance(0.03)
        likelihood = build("gaussian-plugin", self.scan, variance, self.place, offset=0.02)
        tensors, noise = self.stress[:, None], np.full((7, 1), 0.01)
        mean = likelihood.expected(tensors, noise, self.gradient[:, None])[:, 0]
        expected = np.einsum("rsb,rb->rs", likelihood.projection, variance - mean)
        np.testing.assert_allclose(
            likelihood.whitened_residual(tensors, noise, self.gradient[:, None])[:, 0], expected, atol=1e-10
        )

    def test_the_plugins_noise_is_that_of_a_fit_with_gradients(self):
        """Without noise, with a long prior for uu and a steep gradient, D is near what made the data."""
        variance = radial_variance(self.scan, np.array([NEUTRAL])) * np.exp([[1.5, 0.0]] @ self.place.T)
        likelihood = build("gaussian-plugin", self.scan, variance, self.place)
        covariance = plain_noise(self.scan).covariance[0]
        # projection = W D⁻¹ with Wᵀ W = K⁻¹, where nothing is reduced: the diagonal of PᵀP is that of K⁻¹ over D²
        fitted = np.sqrt(np.diag(np.linalg.inv(covariance)) / np.sum(likelihood.projection[0] ** 2, axis=0))
        assert np.abs(np.log(fitted / variance[0])).max() < 0.05

    @pytest.mark.parametrize("name", MAKERS)
    @pytest.mark.parametrize("scan_name", ["6-beam", "50-beam"])
    def test_no_gradient_is_gradient_zero(self, name, scan_name):
        scan = load_scan(scan_name)
        place = Nuisances(vertical_gradient_sd=0.5).place(scan.geometry())
        variance = draw_variances(self.stress, scan, plain_noise(scan), np.random.default_rng(1))
        likelihood = build(name, scan, variance, place)
        zero = np.zeros((7, 1, 1))
        np.testing.assert_allclose(
            likelihood.log_density(self.stress[:, None]),
            likelihood.log_density(self.stress[:, None], None, zero),
            rtol=1e-12,
        )

    @pytest.mark.parametrize("name", MAKERS)
    def test_beams_that_a_record_does_not_use_have_no_part(self, name):
        variance, used = self.variance(), np.ones((7, 6), dtype=bool)
        used[:, 2] = False
        spoiled = variance.copy()
        spoiled[:, 2] = 1e6
        tensors, gradient = self.stress[:, None], self.gradient[:, None]
        kept = np.array([0, 1, 3, 4, 5])
        smaller = build(name, self.scan.select(kept), variance[:, kept], self.place[kept])
        masked = build(name, self.scan, spoiled, self.place, used=used)
        np.testing.assert_allclose(
            masked.log_density(tensors, None, gradient), smaller.log_density(tensors, None, gradient), rtol=1e-8
        )

    @pytest.mark.parametrize("name", MAKERS)
    def test_some_of_the_records_and_a_mixture_keep_their_gradients(self, name):
        likelihood = build(name, self.scan, self.variance(), self.place)
        mixture = MixtureLikelihood((likelihood, likelihood), np.array([0.4, 0.6]))
        tensors, gradient, some = self.stress[:, None], self.gradient[:, None], np.array([4, 1])
        whole = likelihood.log_density(tensors, None, gradient)
        for one in (likelihood, mixture):
            np.testing.assert_allclose(
                one.take(some).log_density(tensors[some], None, gradient[some]), whole[some], rtol=1e-12
            )
        residual = mixture.whitened_residual(tensors, None, gradient)
        np.testing.assert_allclose(
            np.sum(residual**2, axis=-1),
            np.sum(likelihood.whitened_residual(tensors, None, gradient) ** 2, axis=-1),
            rtol=1e-12,
        )

    @pytest.mark.parametrize("name", MAKERS)
    def test_arrays_that_run_along_the_records_change_nothing(self, name):
        likelihood = build(name, self.scan, self.variance(), self.place, offset=0.01)
        mixture = MixtureLikelihood((likelihood, likelihood), np.array([0.4, 0.6]))
        rng = np.random.default_rng(2)
        tensors = np.exp(0.2 * rng.standard_normal((7, 3, 1))) * self.stress[:, None]
        tensors[2, 1] = [1.0, 1.0, 1.0, 2.0, 0.0, 0.0]  # no tensor of air
        gradient = self.gradient[:, None] + 0.1 * rng.standard_normal((7, 3, self.gradient.shape[-1]))
        more = (0.02 * rng.uniform(size=(7, 3)), gradient)
        for one in (likelihood, mixture):
            expected = one.log_density(tensors, *more)
            for along in (tensors, np.asfortranarray(tensors)):
                np.testing.assert_allclose(one.records_last().log_density(along, *more), expected, rtol=1e-10)

    def test_many_beams_are_reduced_to_what_stresses_and_gradients_move(self):
        scan = load_scan("51-beam-planes")
        place = Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.5).place(scan.geometry())
        noise = plain_noise(scan)
        variance = draw_variances(self.stress, scan, noise, np.random.default_rng(1))
        likelihood = build("log-normal", scan, variance, place)
        assert likelihood.n_datum.tolist() == [8] * 7
        basis, _ = np.linalg.qr(
            np.concatenate([design_matrix(scan) / (design_matrix(scan) @ REFERENCE_STRESS)[:, None], place], axis=1)
        )
        covariance = np.log(1.0 + noise.covariance[0])
        normal = stats.multivariate_normal(np.zeros(8), basis.T @ covariance @ basis)
        mean = radial_variance(scan, self.stress) * np.exp(self.gradient @ place.T)
        expected = normal.logpdf((np.log(variance / mean) + 0.5 * np.diag(covariance)) @ basis)
        found = likelihood.log_density(self.stress[:, None], None, self.gradient[:, None])[:, 0]
        np.testing.assert_allclose(found, expected, rtol=1e-7)

    def test_noise_that_was_reduced_beforehand_sees_gradients_too(self):
        scan = load_scan("50-beam")
        noise = plain_noise(scan)
        bank = Noise.join(tuple(dataclasses.replace(noise, wind_speed=speed) for speed in (8.0, 12.0)))
        nuisances = Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.3)
        variance = draw_variances(self.stress, scan, noise, np.random.default_rng(1))
        batch = Batch(variance, np.ones(variance.shape, dtype=bool), np.full(7, 10.0), np.zeros(7), np.arange(7))
        options = FitOptions(
            prior=WeakPrior(), target="record", sampler="direct", likelihood="log-normal", nuisances=nuisances,
            instrument_noise=0.0, target_ess=100, max_extension=0, seed=1,
        )  # fmt: skip
        whole, _ = make_posterior(batch, bank, options)
        short = ReducedNoise(bank, nuisances.gradient_names)
        at = short.for_records(batch.wind_speed, batch.yaw)
        place = np.broadcast_to(nuisances.place(bank.scan_geometry), (7, 50, 2))
        likelihood = reduced_log_normal_likelihood(
            variance, at.gain, short.left, at.covariance, at.log_variance, place=place
        )
        assert likelihood.n_datum.tolist() == whole.likelihood.n_datum.tolist() == [7] * 7  # one cone: rank 5, and two
        args = (self.stress[:, None], None, self.gradient[:, None])
        np.testing.assert_allclose(likelihood.log_density(*args), whole.likelihood.log_density(*args), rtol=1e-6)


class TestFit:
    def test_gradients_are_in_the_result(self):
        scan = load_scan("6-beam")
        noise = plain_noise(scan)
        records = records_of(draw_variances(WeakPrior().draw(2, 1), scan, noise, np.random.default_rng(1)), scan)
        nuisances = Nuisances(vertical_gradient_sd=0.3, lateral_gradient_sd=0.2)
        result = fit(records, scan, noise=noise, seed=1, target_ess=100, sampler="direct", nuisances=nuisances)
        assert set(result["posterior"].data_vars) == {"stress", "lateral_gradient", "vertical_gradient"}
        assert result["posterior/vertical_gradient"].attrs["units"] == "(100 m)-1"
        assert "vertical gradient of ln R ± 0.3 per 100 m" in result.attrs["nuisances"]

    def test_a_scan_without_extent_returns_the_prior_of_the_gradient(self):
        scan = load_scan("staring")
        noise = plain_noise(scan)
        records = records_of(np.array([[1.0]]), scan)
        options = {"noise": noise, "seed": 1, "target_ess": 4000, "sampler": "direct"}
        result = fit(records, scan, nuisances=Nuisances(vertical_gradient_sd=0.3), **options)
        gradient = result["posterior/vertical_gradient"].values.ravel()
        # 4000 effective draws: five standard errors of a mean and of a standard deviation
        assert abs(gradient.mean()) < 5.0 * 0.3 / np.sqrt(4000)
        assert gradient.std() == pytest.approx(0.3, abs=5.0 * 0.3 / np.sqrt(8000))

    @pytest.mark.parametrize("name", ["6-beam", "6-beam-planes"])
    def test_coverage_with_gradients_that_are_not_known_and_without_them(self, name):
        """Each record has gradients from the prior; ignored, they are taken for uw and uv."""
        n_record, width = 300, 1.0
        scan = load_scan(name, **({"opening_angle_deg": 45.0} if name == "6-beam" else {}))
        noise, rng = plain_noise(scan), np.random.default_rng(4)
        stress, gradient = WeakPrior().draw(n_record, rng), width * rng.standard_normal((2, n_record))
        variance = draw_variances(stress, scan, noise, rng) * beam_factor(scan, *gradient)
        nuisances = Nuisances(vertical_gradient_sd=width, lateral_gradient_sd=width)
        options = {"noise": noise, "seed": 1, "target_ess": 400, "sampler": "auto"}
        result = fit(records_of(variance, scan), scan, nuisances=nuisances, **options)
        flag = result["sample_stats/flag"].values
        assert not np.any(flag & ~FLAGS["beams_disagree"])
        assert np.mean(flag != 0) <= 0.05  # gradients as wide as these are more than the alarm allows for
        self.check(result["posterior/stress"].transpose("record", "component", "chain", "draw").values, stress)
        for index, one in enumerate(("lateral_gradient", "vertical_gradient")):
            draws = result[f"posterior/{one}"].transpose("record", "chain", "draw").values
            self.check(draws[:, None], gradient[index][:, None])
        ignored = fit(records_of(variance, scan), scan, **options)
        draws = ignored["posterior/stress"].transpose("record", "component", "chain", "draw").values
        rank = (draws.reshape(n_record, 6, -1) < stress[:, :, None]).mean(axis=-1)
        inside = np.mean(np.abs(rank - 0.5) < 0.45, axis=0)
        assert inside[3:5].max() < 0.8  # uv and uw, whose 90 % intervals should hold 90 %

    @staticmethod
    def check(draws, truth):
        rank = (draws.reshape(*truth.shape, -1) < truth[:, :, None]).mean(axis=-1)
        for level in (0.5, 0.9):
            inside = np.count_nonzero(np.abs(rank - 0.5) < 0.5 * level, axis=0)
            # 16 counts in each of two cases: two-sided 1e-5 gives a false alarm in 3000 seeds
            assert np.all(inside >= stats.binom.ppf(5e-6, len(rank), level))
            assert np.all(inside <= stats.binom.ppf(1.0 - 5e-6, len(rank), level))
        for column in rank.T:
            assert stats.kstest(column, "uniform").pvalue > 1e-4

    def test_against_importance_sampling_of_the_density_written_out_again(self):
        """As `test_posterior_accuracy`: the likelihood and the gradients from their definitions, dense matrices."""
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        noise, prior = plain_noise(scan), WeakPrior()
        truth = np.array([[1.2, 0.7, 0.4, 0.1, -0.2, 0.05]])
        variance = draw_variances(truth, scan, noise, np.random.default_rng(3)) * beam_factor(scan, [0.3], [-0.5])
        covariance = np.log(1.0 + noise.covariance[0])
        normal = stats.multivariate_normal(np.zeros(6), covariance)

        def weigh(coordinate):
            mean = prior.stress(coordinate[:, :6]) @ design_matrix(scan).T
            mean = mean * beam_factor(scan, 0.4 * coordinate[:, 6], 0.6 * coordinate[:, 7])
            density = normal.logpdf(np.log(variance[0] / mean) + 0.5 * np.diag(covariance))
            return density + stats.norm.logpdf(coordinate).sum(axis=1)

        rng, centre, spread = np.random.default_rng(17), np.zeros(8), np.eye(8)
        for count in (20_000, 50_000, 500_000):
            proposal = stats.multivariate_t(centre, 1.2 * spread, df=5)
            coordinate = proposal.rvs(count, random_state=rng)
            log_weight = weigh(coordinate) - proposal.logpdf(coordinate)
            weight = np.exp(log_weight - log_weight.max())
            weight /= weight.sum()
            centre, spread = weight @ coordinate, np.cov(coordinate, rowvar=False, aweights=weight)
        expected = np.column_stack([prior.stress(coordinate[:, :6]), coordinate[:, 6:] * [0.4, 0.6]])
        mean = weight @ expected
        sd = np.sqrt(weight @ (expected - mean) ** 2)
        nuisances = Nuisances(lateral_gradient_sd=0.4, vertical_gradient_sd=0.6)
        result = fit(
            records_of(variance, scan), scan, noise=noise, seed=1, sampler="direct", target_ess=100_000,
            nuisances=nuisances,
        )  # fmt: skip
        stress = result["posterior/stress"].transpose("component", "chain", "draw", "record").values.reshape(6, -1)
        found = np.vstack([stress, *(result[f"posterior/{name}"].values.ravel() for name in nuisances.names)])
        # effective draws: 1e5 of ours, a third of 5e5 of the reference; five standard errors of the difference
        assert np.abs((found.mean(axis=1) - mean) / sd).max() < 5.0 * np.sqrt(1e-5 + 0.6e-5)
        assert (
            np.abs(found.std(axis=1) / sd - 1.0).max() < 0.03
        )  # tails of uu make its variance less sure than a normal

    def test_a_fit_in_a_folder_has_the_numbers_of_its_draws(self, tmp_path):
        scan = load_scan("6-beam")
        noise = plain_noise(scan)
        records = records_of(draw_variances(WeakPrior().draw(3, 1), scan, noise, np.random.default_rng(1)), scan)
        options = {"noise": noise, "seed": 1, "target_ess": 100, "nuisances": Nuisances(vertical_gradient_sd=0.5)}
        options["sampler"] = "auto"
        found = fit(records, scan, output=tmp_path / "out", draws="none", **options)
        result = fit(records, scan, **options)
        mean = result["posterior/stress"].mean(("chain", "draw")).values.ravel()
        np.testing.assert_allclose(found.summary()["mean"], mean, rtol=1e-12)
