"""Nuisances: the law of each, calibration with each drawn from its prior, and nothing changed by those that are off."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of
from scipy import stats

from bayes_rs import InputError, Nuisances, compare_inflow, fit, load_scan, load_turbulence, make_records, simulate
from bayes_rs.fits.batch import noise_at_median
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.prepare import prepare
from bayes_rs.geometry.forward import radial_variance
from bayes_rs.geometry.probe import make_probe
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_length import probe_slope
from bayes_rs.posteriors.nuisance import RecordNuisances
from bayes_rs.priors.registry import WeakPrior
from bayes_rs.wind.mean_vector import mean_wind

fit = partial(fit, campaign="off")
"""What one record tells is tested."""

N_RECORD = 300


def scene(name, seed, n_record=N_RECORD, **overrides):
    scan = load_scan(name, **overrides)
    rng = np.random.default_rng(seed)
    return scan, plain_noise(scan), WeakPrior().draw(n_record, rng), rng


def check_coverage(result, stress, variable="stress", truth=None, some=slice(None)):
    """Ranks of the truth among the draws of some records are uniform: counts inside intervals, and the whole."""
    if variable == "stress":
        draws = result["posterior/stress"].transpose("record", "component", "chain", "draw").values[some]
        rank = (draws.reshape(*draws.shape[:2], -1) < stress[:, :, None]).mean(axis=-1)
    else:
        draws = result[f"posterior/{variable}"].transpose("record", "chain", "draw").values[some]
        rank = (draws.reshape(len(draws), -1) < truth[:, None]).mean(axis=-1)[:, None]
    for level in (0.5, 0.9):
        inside = np.count_nonzero(np.abs(rank - 0.5) < 0.5 * level, axis=0)
        # up to 12 counts in each of five cases: two-sided 1e-5 gives a false alarm in 1700 seeds
        assert np.all(inside >= stats.binom.ppf(5e-6, len(rank), level))
        assert np.all(inside <= stats.binom.ppf(1.0 - 5e-6, len(rank), level))
    for column in rank.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4


class TestLaws:
    def test_none_is_the_same_as_all_off(self):
        scan, noise, stress, rng = scene("6-beam", 1, 3)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        plain = fit(records, scan, noise=noise, seed=1, target_ess=100)
        off = fit(records, scan, noise=noise, seed=1, target_ess=100, nuisances=Nuisances())
        np.testing.assert_array_equal(plain["posterior/stress"].values, off["posterior/stress"].values)
        assert list(off["posterior"].data_vars) == ["stress"]

    @pytest.mark.parametrize(("yaw", "tilt"), [(0.0, 0.0), (20.0, 5.0), (-50.0, -3.0)])
    def test_an_error_of_yaw_and_tilt_is_another_scan(self, yaw, tilt):
        """The nominal beams of Q R Qᵀ measure what the beams that really were there measure of R."""
        yaw_error, tilt_error = 4.0, -2.0
        nominal = load_scan("6-beam", yaw_deg=yaw, tilt_deg=tilt)
        true = load_scan("6-beam", yaw_deg=yaw + yaw_error, tilt_deg=tilt + tilt_error)
        stress = WeakPrior().draw(5, seed=2)
        nuisances = RecordNuisances(Nuisances(yaw_sd_deg=2.0, tilt_sd_deg=1.0), np.deg2rad([yaw]))
        coordinate = np.tile([yaw_error / 2.0, tilt_error / 1.0], (1, 5, 1))
        turned, offset, gradient = nuisances.apply(stress[None], coordinate)
        assert offset is None
        assert gradient is None
        np.testing.assert_allclose(radial_variance(nominal, turned[0]), radial_variance(true, stress), rtol=1e-12)

    def test_a_mixture_is_the_weighted_sum_of_its_parts(self):
        scan, noise, stress, rng = scene("6-beam", 3, 4)
        variance = draw_variances(stress, scan, noise, rng)
        shape = (4, scan.n_beam)
        gain = np.broadcast_to(noise.gain[0], (*shape, 6))
        parts = tuple(
            log_normal_likelihood(
                variance,
                np.ones(shape, dtype=bool),
                gain,
                np.broadcast_to(k * noise.covariance[0], (*shape, scan.n_beam)),
            )
            for k in (0.5, 1.0, 2.0)
        )
        weight = np.array([0.2, 0.5, 0.3])
        mixture = MixtureLikelihood(parts, weight)
        draws = WeakPrior().draw(20, seed=3).reshape(4, 5, 6)
        expected = np.log(sum(w * np.exp(part.log_density(draws)) for w, part in zip(weight, parts, strict=True)))
        np.testing.assert_allclose(mixture.log_density(draws), expected, rtol=1e-12)
        np.testing.assert_allclose(mixture.take(np.array([2])).log_density(draws[[2]]), expected[[2]], rtol=1e-12)
        assert all(
            getattr(mixture, name) is getattr(parts[1], name) for name in ("gain", "offset", "n_datum", "dof", "place")
        )

    def test_the_rule_over_the_length_scale_has_its_moments(self):
        factor, weight = Nuisances(length_scale_log_sd=0.4).length_scale_nodes()
        assert weight.sum() == pytest.approx(1.0)
        assert weight @ np.log(factor) == pytest.approx(0.0, abs=1e-14)
        assert weight @ np.log(factor) ** 2 == pytest.approx(0.16)
        assert 1.0 in factor

    def test_words_name_every_one_with_its_width(self):
        assert Nuisances().in_words() == "nothing but R"
        everything = Nuisances(
            yaw_sd_deg=2.0,
            tilt_sd_deg=1.0,
            instrument_noise_log_sd=0.5,
            length_scale_log_sd=0.4,
            inflation=1.5,
            inflation_dof=5.0,
            vertical_gradient_sd=0.3,
            lateral_gradient_sd=0.2,
        )
        assert everything.in_words() == (
            "yaw ± 2°, tilt ± 1°, instrument noise within a factor 1.6, lateral gradient of ln R ± 0.2 per 100 m, "
            "vertical gradient of ln R ± 0.3 per 100 m, length scale within a factor 1.5, noise inflated by 1.5, "
            "noise inflation uncertain, 5 degrees of freedom (one standard deviation)"
        )


class TestCalibration:
    def test_yaw_that_is_not_known(self):
        scan, noise, stress, rng = scene("6-beam", 4, opening_angle_deg=45.0)
        error = 15.0 * rng.standard_normal(N_RECORD)  # at 10° the wrong fit is found out with some draws only
        variance = np.concatenate(
            [
                draw_variances(one[None], replace(scan, yaw=np.deg2rad(delta)), noise, rng)
                for one, delta in zip(stress, error, strict=True)
            ]
        )
        records = records_of(variance, scan)
        nuisances = Nuisances(yaw_sd_deg=15.0)
        result = fit(records, scan, noise=noise, seed=1, target_ess=400, sampler="auto", nuisances=nuisances)
        check_coverage(result, stress)
        check_coverage(result, stress, "yaw_error", error)
        wrong = fit(records, scan, noise=noise, seed=1, target_ess=400, sampler="auto")
        with pytest.raises(AssertionError):  # uv takes the blame for the yaw
            check_coverage(wrong, stress)

    def test_instrument_noise_that_is_not_known(self):
        scan, noise, stress, rng = scene("6-beam", 5, opening_angle_deg=45.0)
        added = 0.05 * np.exp(0.8 * rng.standard_normal(N_RECORD))
        mean = radial_variance(scan, stress)
        scatter = draw_variances(stress, scan, noise, rng) / mean
        records = records_of(scatter * (mean + added[:, None]), scan)
        nuisances = Nuisances(instrument_noise_log_sd=0.8)
        result = fit(
            records,
            scan,
            noise=noise,
            seed=1,
            target_ess=400,
            sampler="auto",
            instrument_noise=0.05,
            nuisances=nuisances,
        )
        check_coverage(result, stress)
        check_coverage(result, stress, "instrument_noise", added)

    def test_length_scale_that_is_not_known(self):
        """A bank over L whose covariance doubles with it; each record has an L of its own, which nobody knows."""
        scan, noise, stress, rng = scene("6-beam", 6)
        scales = np.array([15.0, 30.0, 60.0, 120.0, 240.0])
        bank = Noise.join(
            tuple(
                replace(
                    noise,
                    covariance=noise.covariance[0] * scale / 60.0,
                    turbulence=replace(noise.turbulence, length_scale=scale),
                    length_scale=scale,
                )
                for scale in scales
            )
        )
        factor, weight = Nuisances(length_scale_log_sd=0.4).length_scale_nodes()
        own = 60.0 * rng.choice(factor, N_RECORD, p=weight)
        variance = np.concatenate(
            [
                draw_variances(
                    one[None],
                    scan,
                    replace(noise, covariance=bank.for_records([10.0], [0.0], length_scale=[scale]).covariance[0]),
                    rng,
                )
                for one, scale in zip(stress, own, strict=True)
            ]
        )
        nuisances = Nuisances(length_scale_log_sd=0.4, length_scale=60.0)
        result = fit(
            records_of(variance, scan), scan, noise=bank, seed=1, target_ess=400, sampler="auto", nuisances=nuisances
        )
        check_coverage(result, stress)

    def test_inflation_that_is_not_known(self):
        scan, noise, stress, rng = scene("6-beam", 7)
        inflation = 5.0 / rng.chisquare(5.0, N_RECORD)
        log_covariance = np.log1p(noise.covariance[0])
        mean = np.log(radial_variance(scan, stress)) - 0.5 * np.diag(log_covariance)
        normal = rng.multivariate_normal(np.zeros(scan.n_beam), log_covariance, N_RECORD, method="eigh")
        records = records_of(np.exp(mean + np.sqrt(inflation)[:, None] * normal), scan)
        nuisances = Nuisances(inflation_dof=5.0)
        result = fit(records, scan, noise=noise, seed=1, target_ess=400, sampler="auto", nuisances=nuisances)
        check_coverage(result, stress)


class TestEffect:
    def test_every_nuisance_widens(self):
        scan, noise, stress, rng = scene("6-beam", 8, 20, opening_angle_deg=45.0)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)

        def width(**options):
            result = fit(records, scan, noise=noise, seed=1, sampler="direct", target_ess=500, **options)
            return float(np.log(result["posterior/stress"].std(("chain", "draw")).sel(component="uv")).mean())

        plain = width()
        assert width(nuisances=Nuisances(yaw_sd_deg=10.0)) > plain + 0.05
        assert width(nuisances=Nuisances(inflation=2.0)) > plain + 0.1
        assert width(nuisances=Nuisances(inflation_dof=3.0)) > plain + 0.03

    def test_units_and_names_are_in_the_result(self):
        scan, noise, stress, rng = scene("6-beam", 9, 2)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        nuisances = Nuisances(yaw_sd_deg=3.0, tilt_sd_deg=1.0, instrument_noise_log_sd=0.5)
        result = fit(records, scan, noise=noise, seed=1, target_ess=100, nuisances=nuisances, instrument_noise=0.01)
        units = {name: result["posterior"][name].attrs["units"] for name in ("yaw_error", "tilt_error")}
        assert units == {"yaw_error": "degree", "tilt_error": "degree"}
        assert result["posterior"]["instrument_noise"].attrs["units"] == "m2 s-2"
        assert float(result["posterior"]["instrument_noise"].min()) > 0.0
        assert "yaw ± 3°" in result.attrs["nuisances"]


class TestYawOfRecords:
    """Each record says itself how uncertain its wind direction is."""

    OWN = Nuisances(yaw_sd_deg="records")

    @staticmethod
    def turned(scan, stress, error_deg, noise, rng):
        """Records whose beams were turned by these errors, one for each record."""
        variance = [
            draw_variances(one[None], replace(scan, yaw=np.deg2rad(delta)), noise, rng)
            for one, delta in zip(stress, error_deg, strict=True)
        ]
        return records_of(np.concatenate(variance), scan)

    @pytest.mark.parametrize("sampler", ["emcee", "direct"])
    def test_equal_deviations_are_the_one_of_all(self, sampler):
        scan, noise, stress, rng = scene("6-beam", 13, 4)
        records = records_of(draw_variances(stress, scan, noise, rng), scan).assign(yaw_sd=("record", np.full(4, 3.0)))
        options = {"noise": noise, "seed": 1, "sampler": sampler, "target_ess": 100}
        own = fit(records, scan, nuisances=self.OWN, **options)
        one = fit(records, scan, nuisances=Nuisances(yaw_sd_deg=3.0), **options)
        for name in ("stress", "yaw_error"):
            np.testing.assert_array_equal(own["posterior"][name].values, one["posterior"][name].values)
        np.testing.assert_array_equal(own["observed_data/yaw_sd"].values, np.full(4, 3.0))
        assert own.attrs["nuisances"] == "yaw ± what each record says (one standard deviation)"

    @pytest.mark.parametrize("sampler", ["emcee", "direct"])
    def test_a_record_is_the_same_in_any_company(self, sampler, monkeypatch):
        scan, noise, stress, rng = scene("6-beam", 14, 5)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        records = records.assign(yaw_sd=("record", [4.0, 0.0, 9.0, 1.0, 25.0]))
        records["flag"].values[1, 2] = 1  # one that goes the other way through a batch
        options = {"noise": noise, "seed": 1, "sampler": sampler, "target_ess": 100, "nuisances": self.OWN}
        whole = fit(records, scan, **options)
        monkeypatch.setattr("bayes_rs.fits.parts._CHUNK", 2)
        parts = fit(records, scan, **options)
        for name in ("stress", "yaw_error"):
            np.testing.assert_array_equal(whole["posterior"][name].values, parts["posterior"][name].values)
            for index in range(5):
                alone = fit(records.isel(record=[index]), scan, **options)["posterior"][name]
                np.testing.assert_array_equal(alone.isel(record=0).values, whole["posterior"][name][:, :, index].values)

    def test_more_uncertain_directions_make_wider_posteriors(self):
        scan, noise, stress, rng = scene("6-beam", 15, 1, opening_angle_deg=45.0)
        variance = np.repeat(draw_variances(stress, scan, noise, rng), 5, axis=0)
        records = records_of(variance, scan).assign(yaw_sd=("record", [0.0, 8.0, 14.0, 24.0, 0.0]))
        options = {"noise": noise, "seed": 1, "sampler": "direct", "target_ess": 4000}
        result = fit(records, scan, nuisances=self.OWN, **options)
        width = result["posterior/stress"].std(("chain", "draw")).sel(component="uv").values
        # a standard deviation of 4000 draws is good to 1/√8000 = 1.1 %; five of them are the least that is told apart
        assert np.all(np.diff(np.log(width[:4])) > 5.0 / np.sqrt(8000.0))
        np.testing.assert_array_equal(result["posterior/yaw_error"].values[:, :, [0, 4]], 0.0)
        known = fit(records, scan, **options)["posterior/stress"]
        found = result["posterior/stress"]
        for index in (0, 4):  # a deviation of 0: the direction is known
            one, other = (draws.isel(record=index).values.reshape(-1, 6) for draws in (known, found))
            error = np.sqrt(2.0 / 4000.0) * one.std(axis=0)
            assert np.all(np.abs(one.mean(axis=0) - other.mean(axis=0)) < 5.0 * error)

    def test_directions_of_two_qualities_in_one_data_set(self):
        scan, noise, stress, rng = scene("6-beam", 16, opening_angle_deg=45.0)
        sd = np.where(np.arange(N_RECORD) % 2, 2.0, 20.0)
        error = sd * rng.standard_normal(N_RECORD)
        records = self.turned(scan, stress, error, noise, rng).assign(yaw_sd=("record", sd))
        options = {"noise": noise, "seed": 1, "target_ess": 400, "sampler": "auto"}
        result = fit(records, scan, nuisances=self.OWN, **options)
        check_coverage(result, stress)
        check_coverage(result, stress, "yaw_error", error)
        # the root mean square of both for all: too much for half of the records, too little for the other
        one = Nuisances(yaw_sd_deg=float(np.sqrt((sd**2).mean())))
        common = fit(records, scan, nuisances=one, **options)
        for some in (sd == 2.0, sd == 20.0):
            check_coverage(result, stress[some], some=some)
            check_coverage(result, stress[some], "yaw_error", error[some], some)
            with pytest.raises(AssertionError):
                check_coverage(common, stress[some], "yaw_error", error[some], some)

    def test_what_the_mean_wind_says_is_used(self):
        scan, flow = load_scan("6-beam"), load_turbulence("fu-2022")
        records = make_records(simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1), scan)
        noise = plain_noise(scan)
        wind = mean_wind(records, scan, turbulence=flow)
        result = fit(wind, scan, noise=noise, seed=1, sampler="direct", nuisances=self.OWN)
        # records without one get it, in the turbulence of the noise
        own = mean_wind(records, scan, turbulence=noise.turbulence)
        made = fit(records, scan, noise=noise, seed=1, sampler="direct", nuisances=self.OWN)
        np.testing.assert_array_equal(made["observed_data/yaw_sd"].values, own["yaw_sd"].values)
        np.testing.assert_array_equal(result["observed_data/yaw_sd"].values, wind["yaw_sd"].values)
        # little of it is seen, so that the posterior is about as wide as the prior; 1000 draws
        width = result["posterior/yaw_error"].std(("chain", "draw")).values
        np.testing.assert_allclose(width, wind["yaw_sd"].values, rtol=0.2)

    def test_a_record_without_one_is_refused_or_gets_what_is_said(self):
        scan, noise, stress, rng = scene("6-beam", 17, 5)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        records = records.assign(yaw_sd=("record", [4.0, np.nan, np.nan, np.nan, 1.0]))
        records["wind_speed"].values[1] = np.nan  # not fitted: nothing is asked of it
        options = {"noise": noise, "seed": 1, "sampler": "direct", "target_ess": 100}
        words = r"Invalid yaw_sd nan degrees of record 2 \(2020-01-01T00:20\), one of 2: .* give yaw_sd_missing_deg"
        with pytest.raises(InputError, match=words):
            fit(records, scan, nuisances=self.OWN, **options)
        bad = records.assign(yaw_sd=("record", [4.0, 4.0, 4.0, 4.0, -1.0]))
        with pytest.raises(InputError, match=r"Invalid yaw_sd -1\.0 degrees of record 4"):
            fit(bad, scan, nuisances=Nuisances(yaw_sd_deg="records", yaw_sd_missing_deg=5.0), **options)
        filled = fit(records, scan, nuisances=Nuisances(yaw_sd_deg="records", yaw_sd_missing_deg=7.0), **options)
        given = records.assign(yaw_sd=("record", [4.0, 0.0, 7.0, 7.0, 1.0]))
        said = fit(given, scan, nuisances=self.OWN, **options)
        np.testing.assert_array_equal(filled["posterior/stress"].values, said["posterior/stress"].values)
        assert filled.attrs["nuisances"].startswith("yaw ± what each record says (7° where it does not)")

    def test_inflows_are_compared_with_it(self):
        scan, noise, stress, rng = scene("6-beam", 18, 2)
        records = records_of(draw_variances(stress, scan, noise, rng), scan).assign(yaw_sd=("record", [3.0, 3.0]))
        options = {"noise": noise, "seed": 1, "n_draw": 500, "leave_one_out": True}
        own = compare_inflow(records, scan, nuisances=replace(self.OWN, vertical_gradient_sd=0.5), **options)
        one = compare_inflow(records, scan, nuisances=Nuisances(yaw_sd_deg=3.0, vertical_gradient_sd=0.5), **options)
        assert own.equals(one)


class TestTurbulenceOfRecords:
    def test_records_out_of_the_noises_reach_are_flagged(self):
        scan, noise, stress, rng = scene("6-beam", 19, 3)  # L = 61 m, Γ = 3.2
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        options = {"noise": noise, "seed": 1, "sampler": "direct", "target_ess": 100}
        plain = fit(records, scan, **options)["posterior/stress"].values
        for name, own, outside in (
            ("length_scale", [61.0, 66.0, 68.0], [False, False, True]),
            ("length_scale", [30.0, 30.0, 30.0], [True, True, True]),
            ("gamma", [2.0, 3.2, 3.3], [True, False, False]),
        ):
            found = fit(records.assign({name: ("record", own)}), scan, **options)
            flag = found["sample_stats/flag"].values
            assert (flag & FLAGS["outside_noise"] > 0).tolist() == outside
            np.testing.assert_array_equal(found["posterior/stress"].values, plain)  # there is no other noise


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"yaw_sd_deg": "beams"}, "Unknown yaw_sd_deg 'beams': it must be one of records"),
            ({"yaw_sd_deg": "records", "yaw_sd_missing_deg": -1.0}, "Invalid yaw_sd_missing_deg -1"),
            ({"yaw_sd_deg": 2.0, "yaw_sd_missing_deg": 1.0}, "Invalid yaw_sd_missing_deg 1 with yaw_sd_deg 2"),
            ({"yaw_sd_deg": -1.0}, "Invalid yaw_sd_deg -1"),
            ({"tilt_sd_deg": np.nan}, "Invalid tilt_sd_deg nan"),
            ({"inflation": 0.0}, "Invalid inflation 0"),
            ({"inflation_dof": 2.0}, "Invalid inflation_dof 2.0: it must be above 2"),
            ({"length_scale": -5.0}, "Invalid length_scale -5"),
        ],
    )
    def test_numbers_that_make_no_sense(self, options, message):
        with pytest.raises(InputError, match=message):
            Nuisances(**options)

    def test_noise_of_one_length_scale_cannot_be_averaged(self):
        scan, noise, stress, rng = scene("6-beam", 10, 2)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        with pytest.raises(InputError, match="knows one length scale only"):
            fit(records, scan, noise=noise, seed=1, nuisances=Nuisances(length_scale_log_sd=0.3))

    def test_uncertain_instrument_noise_needs_a_median(self):
        scan, noise, stress, rng = scene("6-beam", 11, 2)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        for given in ({}, {"instrument_noise": 0.0}):
            with pytest.raises(InputError, match="Invalid instrument_noise 0"):
                fit(records, scan, noise=noise, seed=1, nuisances=Nuisances(instrument_noise_log_sd=0.3), **given)


class TestProbeLength:
    """A probe volume of uncertain length: what a longer one takes of every beam's variance."""

    SCAN = "6-beam@opening_angle_deg=45,probe=zx-300"

    @pytest.mark.parametrize("length_scale", [30.0, 120.0])
    def test_the_slope_is_that_of_noise_made_for_other_lengths(self, length_scale):
        scan = load_scan(self.SCAN)
        flow = replace(load_turbulence("fu-2022"), length_scale=length_scale)
        optics = scan.probe.parameters()
        expected = {}
        for factor in (-0.1, 0.0, 0.1):  # ℓ is proportional to the wavelength
            probe = make_probe(**{**optics, "wavelength": optics["wavelength"] * np.exp(factor)})
            noise = theory_noise(replace(scan, probe=probe), flow, wind_speed=10.0)
            expected[factor] = (1.0 + noise.bias[0]) * (noise.gain[0] @ flow.stresses())
            if factor == 0.0:
                slope = probe_slope(noise, [10.0], [0.0], [length_scale])[0]
        numeric = np.log(expected[-0.1] / expected[0.1]) / 0.2
        # what a record's mean takes of a probed velocity depends on the probe a little
        np.testing.assert_allclose(slope, numeric, rtol=0.05)

    def test_an_error_of_the_length_that_is_in_the_data_is_in_the_interval(self):
        scan, _, stress, rng = scene(self.SCAN, 21)
        noise = plain_noise(scan, relative_variance=0.003)
        sd = 0.8
        slope = probe_slope(noise, np.full(N_RECORD, 10.0), np.zeros(N_RECORD), None)
        variance = draw_variances(stress, scan, noise, rng)
        variance *= np.exp(-sd * rng.standard_normal(N_RECORD)[:, None] * slope - 0.5 * (sd * slope) ** 2)
        options = {"noise": noise, "seed": 1, "target_ess": 400, "sampler": "auto"}
        records = records_of(variance, scan)
        check_coverage(fit(records, scan, nuisances=Nuisances(probe_length_log_sd=sd), **options), stress)
        with pytest.raises(AssertionError):
            check_coverage(fit(records, scan, **options), stress)

    def test_it_widens_by_what_the_beams_share(self):
        """Beams that hang together: the covariance of ln y gets σ² s sᵀ, in closed form."""
        scan, noise, stress, rng = scene(self.SCAN, 22, 4)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        scan, noise, batch = prepare(records, scan, noise, FitOptions(nuisances=Nuisances(probe_length_log_sd=0.5)))
        found = noise_at_median(batch, noise, Nuisances()).covariance
        own = 0.5 * probe_slope(noise, batch.wind_speed, batch.yaw, None)
        log_sd = np.sqrt(np.log1p(own**2))
        wanted = np.log1p(noise.covariance[0]) + log_sd[:, :, None] * log_sd[:, None, :]
        np.testing.assert_allclose(np.log1p(found), wanted, rtol=1e-12)

    def test_points_have_no_length(self):
        scan, noise, stress, rng = scene("6-beam", 23, 2)
        records = records_of(draw_variances(stress, scan, noise, rng), scan)
        with pytest.raises(
            InputError, match=r"Invalid probe_length_log_sd 0\.1: the beams of scan '6-beam' are points"
        ):
            fit(records, scan, noise=noise, seed=1, nuisances=Nuisances(probe_length_log_sd=0.1))
