"""The fit: calibration on records of known R, flags, targets, refusals."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of
from scipy import stats

from bayes_rs import InputError, NoiseMismatchError, load_scan, load_turbulence, make_records, simulate
from bayes_rs.fits.fitting import fit
from bayes_rs.fits.flags import FLAGS, flag_words
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.choice import noise_for_records
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_words import probe_loss
from bayes_rs.priors.registry import FlatPrior, WeakPrior

fit = partial(fit, campaign="off")
"""What one record tells is tested."""


def simulated(name, n_record, prior, seed, **overrides):
    scan = load_scan(name, **overrides)
    noise = plain_noise(scan)
    rng = np.random.default_rng(seed)
    stress = prior.draw(n_record, rng)
    return scan, noise, stress, records_of(draw_variances(stress, scan, noise, rng), scan)


class TestCalibration:
    """Truths drawn from the prior, data from the noise model: intervals must hold the truth as often as they say."""

    @pytest.mark.parametrize("name", ["4-beam", "6-beam", "50-beam"])
    @pytest.mark.parametrize(
        "prior", [WeakPrior(), pytest.param(FlatPrior(), marks=pytest.mark.slow)], ids=["weak", "flat"]
    )
    def test_intervals_hold_the_truth_as_often_as_they_say(self, name, prior):
        n_record = 300
        scan, noise, stress, records = simulated(name, n_record, prior, seed=11)
        result = fit(records, scan, noise=noise, prior=prior, seed=1, target_ess=400)
        draws = result["posterior/stress"].transpose("record", "component", "chain", "draw").values
        rank = (draws.reshape(n_record, 6, -1) < stress[:, :, None]).mean(axis=-1)
        for level in (0.5, 0.8, 0.9, 0.95):
            inside = np.count_nonzero(np.abs(rank - 0.5) < 0.5 * level, axis=0)
            # 24 counts in each of six cases: a two-sided level of 1e-5 gives a false alarm in 700 seeds
            assert np.all(inside >= stats.binom.ppf(5e-6, n_record, level))
            assert np.all(inside <= stats.binom.ppf(1.0 - 5e-6, n_record, level))
        for index in range(6):
            # 36 such tests: a false alarm in 28 000 seeds; the drawn truths depend on the processor's eigenvectors
            assert stats.kstest(rank[:, index], "uniform").pvalue > 1e-6

    def test_noise_that_is_too_small_is_caught(self):
        """The test above has power: halving the noise's standard deviation breaks the coverage of uu."""
        scan, _, stress, records = simulated("6-beam", 200, WeakPrior(), seed=12)
        smaller = plain_noise(scan, relative_variance=0.015)
        table = fit(records, scan, noise=smaller, seed=1, target_ess=200).summary()
        rows = table[table["stress"] == "uu"]
        inside = np.count_nonzero((rows["low"] < stress[:, 0]) & (stress[:, 0] < rows["high"]))
        assert inside < stats.binom.ppf(1e-6, 200, 0.9)


class TestTargets:
    def test_ensemble_is_larger_than_record_by_the_bias(self):
        """With one bias for all beams, E[y] = 0.9 A R: R of the infinite record is 1/0.9 of that of the record."""
        prior = WeakPrior(log_sd_uu=50.0)  # no say about the size
        scan, noise, _, records = simulated("6-beam", 3, WeakPrior(), seed=13)
        means = {
            target: fit(records, scan, noise=noise, prior=prior, target=target, seed=1, target_ess=4000)[
                "posterior/stress"
            ]
            .mean(("chain", "draw"))
            .sel(component="uu")
            for target in ("record", "ensemble")
        }
        np.testing.assert_allclose(
            means["ensemble"] / means["record"], 1.0 / 0.9, rtol=5.0 * 0.25 * np.sqrt(2.0 / 4000)
        )

    def test_instrument_noise_is_taken_off(self):
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        stress = np.array([[1.0, 0.6, 0.4, 0.0, -0.2, 0.0]])
        variance = stress @ design_matrix(scan).T
        noise = plain_noise(scan, relative_variance=1e-4)
        narrow = fit(records_of(variance + 0.3, scan), scan, noise=noise, instrument_noise=0.3, seed=1)
        ignored = fit(records_of(variance + 0.3, scan), scan, noise=noise, seed=1)
        trace = {
            name: float(tree["posterior/stress"].sel(component=["uu", "vv", "ww"]).sum("component").mean())
            for name, tree in (("narrow", narrow), ("ignored", ignored))
        }
        assert trace["narrow"] == pytest.approx(2.0, rel=0.02)  # the noise is 1 %, the trace of six beams
        assert trace["ignored"] == pytest.approx(2.9, rel=0.02)  # δ on all beams shifts R by δ I

    def test_yaw_of_a_record_turns_its_stresses(self):
        """R in the mean-wind frame does not depend on how the lidar stands, if the yaw is told."""
        stress = np.array([[1.0, 0.6, 0.4, 0.1, -0.2, 0.05]])
        base = load_scan("6-beam", opening_angle_deg=45.0)
        noise = plain_noise(base, relative_variance=1e-4)
        for yaw in (0.0, 25.0):
            variance = stress @ design_matrix(base.at_yaw(np.deg2rad(yaw))).T
            result = fit(records_of(variance, base, yaw_deg=yaw), base, noise=noise, seed=2)
            mean = result["posterior/stress"].mean(("chain", "draw", "record"))
            np.testing.assert_allclose(mean, stress[0], atol=0.03)  # 1 % noise, amplified less than threefold at 45°


class TestFlags:
    @pytest.fixture
    def scene(self):
        return simulated("6-beam", 5, WeakPrior(), seed=14)

    def test_records_that_cannot_be_fitted_stay_in_the_output(self, scene):
        scan, noise, _, records = scene
        records["flag"][1] = 1
        records["wind_speed"][2] = np.nan
        records["flag"][3, 4] = 2
        result = fit(records, scan, noise=noise, seed=1)
        flag = result["sample_stats/flag"].values
        assert flag.tolist() == [0, FLAGS["no_usable_beam"], FLAGS["no_wind"], FLAGS["beam_left_out"], 0]
        missing = np.isnan(result["posterior/stress"]).all(("chain", "draw", "component")).values
        assert missing.tolist() == [False, True, True, False, False]
        table = result.summary()
        assert len(table) == 30
        assert table[table["record"] == 1]["mean"].isna().all()
        assert set(table[table["record"] == 1]["flag"]) == {"no_usable_beam"}

    def test_a_chain_that_is_too_short_says_so(self, scene):
        scan, noise, _, records = scene
        result = fit(records, scan, noise=noise, seed=1, max_extension=0, prior="flat:bound=100000")
        least = result["sample_stats/ess_bulk"].min("component").values
        table = result.summary()
        said = {record: "short_chain" in rows["flag"].iloc[0] for record, rows in table.groupby("record")}
        assert list(said.values()) == (least < 1000.0).tolist()
        assert any(said.values())

    def test_chains_are_extended_until_the_target_is_met(self, scene):
        scan, noise, _, records = scene
        options = {"noise": noise, "seed": 1, "target_ess": 1000, "prior": "flat:bound=1000"}
        short = fit(records, scan, max_extension=0, **options)
        assert short.flags["short_chain"] > 0
        result = fit(records, scan, **options)
        stats_group = result["sample_stats"]
        assert float(stats_group["ess_bulk"].min()) >= 1000.0
        assert set(stats_group["n_step"].values) > {4.0}  # records that had enough stay as they are
        assert result.flags["short_chain"] == 0

    @pytest.mark.parametrize("target_ess", [1, 333, 1999, 2001])
    def test_any_target_can_be_asked_for(self, scene, target_ess):
        scan, noise, _, records = scene
        result = fit(records.isel(record=[0]), scan, noise=noise, seed=1, target_ess=target_ess, prior="flat")
        assert float(result["sample_stats/ess_bulk"].min()) >= target_ess

    def test_nothing_to_fit_is_a_result_too(self, scene):
        scan, noise, _, records = scene
        records["flag"][:] = 1
        result = fit(records, scan, noise=noise, seed=1)
        assert result.summary()["mean"].isna().all()

    def test_the_input_is_not_touched(self, scene):
        scan, noise, _, records = scene
        before = records.copy(deep=True)
        fit(records, scan, noise=noise, seed=1)
        assert records.identical(before)


class TestSeeds:
    def test_a_record_has_the_same_posterior_alone_and_in_company(self):
        scan, noise, _, records = simulated("6-beam", 6, WeakPrior(), seed=15)
        together = fit(records, scan, noise=noise, seed=3)["posterior/stress"]
        alone = fit(records.isel(record=[4]), scan, noise=noise, seed=3)["posterior/stress"]
        np.testing.assert_array_equal(alone.values[:, :, 0], together.values[:, :, 4])

    def test_other_seed_other_draws(self):
        scan, noise, _, records = simulated("6-beam", 1, WeakPrior(), seed=16)
        draws = [fit(records, scan, noise=noise, seed=seed)["posterior/stress"].values for seed in (1, 2)]
        assert not np.array_equal(*draws)


class TestNoiseBank:
    def test_each_record_gets_the_noise_of_its_own_wind_speed(self):
        scan = load_scan("staring")
        calm = replace(plain_noise(scan, relative_variance=0.2), wind_speed=4.0)
        windy = replace(plain_noise(scan, relative_variance=0.01), wind_speed=16.0)
        records = records_of(np.ones((2, 1)), scan)
        records["wind_speed"][:] = [4.5, 15.0]
        table = fit(records, scan, noise=Noise.join((calm, windy)), seed=1).summary()
        width = table[table["stress"] == "uu"].set_index("record")["sd"]
        assert width[0] == pytest.approx(np.sqrt(0.2), rel=0.35)  # skewed, and the prior on size pulls a little
        assert width[1] == pytest.approx(0.1, rel=0.15)


class TestProbe:
    def test_the_variance_that_the_probe_took_is_given_back(self):
        """R comes out the same from probed variances and probed noise as from points: the gain undoes the probe."""
        turbulence = load_turbulence("fu-2022")
        stress = np.array([1.2, 0.77, 0.49, 0.0, -0.36, 0.0])
        trace = {}
        for name in ("pulsed-4-beam@probe=point", "pulsed-4-beam"):
            scan = load_scan(name)
            gain = calibrate(scan, turbulence, wind_speed=10.0, cache=False).gain[0]
            records = records_of(np.tile(gain @ stress, (3, 1)), scan)
            records["wind_speed"][:] = [9.0, 10.0, 11.0]
            records["yaw"][:] = [-20.0, 0.0, 35.0]  # interpolated gains, at which extreme tensors must do no harm
            noise = noise_for_records(records.isel(record=[1]), scan, turbulence)
            spread = noise_for_records(records, scan, turbulence)
            assert np.isfinite(fit(records, scan, noise=spread, seed=1)["posterior/stress"]).all()
            result = fit(records.isel(record=[1]), scan, noise=noise, seed=1, target_ess=4000)
            trace[name] = float(result["posterior/stress"].sel(component=["uu", "vv", "ww"]).sum("component").mean())
        assert trace["pulsed-4-beam"] == pytest.approx(trace["pulsed-4-beam@probe=point"], rel=0.05)

    def test_the_preset_of_an_instrument_undoes_its_probe_and_as_points_reads_low_by_it(self):
        """Records of a virtual lidar with a probe; that of points, fitted as such, has the same bias of the method."""
        flow, count = load_turbulence("fu-2022"), 300
        probed, points = load_scan("pulsed-4-beam"), load_scan("pulsed-4-beam@probe=point")
        noise = {scan.name: calibrate(scan, flow, wind_speed=10.0, cache=False) for scan in (probed, points)}

        def uu(seen_with, fitted_as):
            series = simulate(seen_with, flow, wind_speed=10.0, n_records=count, seed=11)
            records = make_records(series, seen_with).isel(record=slice(0, count))
            records = records.assign(
                wind_speed=("record", np.full(count, 10.0)), yaw=("record", np.zeros(count))
            ).assign_attrs(scan=fitted_as.name, scan_key=fitted_as.key)
            made = fit(records, fitted_as, noise=noise[fitted_as.name], seed=1, sampler="direct", target_ess=400)
            return made["posterior/stress"].sel(component="uu").mean(("chain", "draw")).values

        undone, low, reference = uu(probed, probed), uu(probed, points), uu(points, points)
        error = np.sqrt(undone.var() + reference.var()) / np.sqrt(count) / reference.mean()
        assert error < 0.016
        assert undone.mean() / reference.mean() == pytest.approx(1.0, abs=4.0 * error)  # Monte Carlo
        left = 1.0 - float(probe_loss(noise["pulsed-4-beam"], [10.0], [0.0]).mean())
        assert 0.8 < left < 0.9
        # the same records: what differs is the gain, weighed with R of the posterior here and of the flow there
        assert low.mean() / undone.mean() == pytest.approx(left, abs=0.015)


class TestRefusals:
    @pytest.fixture
    def scene(self):
        return simulated("6-beam", 2, WeakPrior(), seed=17)

    def test_noise_of_another_scan(self, scene):
        scan, _, _, records = scene
        with pytest.raises(NoiseMismatchError):
            fit(records, scan, noise=plain_noise(load_scan("6-beam", opening_angle_deg=20.0)), seed=1)

    def test_noise_of_another_record_length(self, scene):
        scan, noise, _, records = scene
        records.attrs["duration"] = 1800.0
        with pytest.raises(InputError, match=r"records last 1800 s and the noise is for records of 600 s"):
            fit(records, scan, noise=noise, seed=1)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"prior": "vague"}, r"Unknown prior 'vague'"),
            ({"target": "mast"}, r"Unknown target 'mast': it must be one of record, ensemble, sonic"),
            ({"sampler": "nuts"}, r"Unknown sampler 'nuts'"),
            ({"target_ess": 0}, r"Invalid target_ess 0"),
            ({"seed": -1}, r"Invalid seed -1"),
            ({"instrument_noise": -0.1}, r"Invalid instrument_noise -0.1 m² s⁻²"),
        ],
    )
    def test_bad_options(self, scene, change, message):
        scan, noise, _, records = scene
        with pytest.raises(InputError, match=message):
            fit(records, scan, **{"noise": noise, "seed": 1, **change})

    def test_something_else_than_records(self, scene):
        scan, noise, _, records = scene
        with pytest.raises(InputError, match=r"The records have no yaw with dims \('record',\): make them with"):
            fit(records.drop_vars("yaw"), scan, noise=noise, seed=1)

    def test_no_record(self, scene):
        scan, noise, _, records = scene
        with pytest.raises(InputError, match="There is no record"):
            fit(records.isel(record=[]), scan, noise=noise, seed=1)


def test_a_beam_of_infinite_variance_is_left_out():
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    variance = np.tile(draw_variances(WeakPrior().draw(1, seed=3), scan, noise, np.random.default_rng(4)), (2, 1))
    whole = fit(records_of(variance, scan), scan, noise=noise, seed=1, sampler="direct")
    variance[1, 2] = np.inf
    result = fit(records_of(variance, scan), scan, noise=noise, seed=1, sampler="direct")
    assert [flag_words(flag) for flag in result["sample_stats/flag"].values] == ["", "beam_left_out"]
    np.testing.assert_array_equal(result["posterior/stress"][:, :, 0], whole["posterior/stress"][:, :, 0])
    assert np.isfinite(result["posterior/stress"].values).all()
