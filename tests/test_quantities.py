"""What numbers may be: one rule for command line, settings files and Python; what is no number is refused at once."""

import re
from dataclasses import fields

import numpy as np
import pytest

import bayes_rs as brs
from bayes_rs import InputError, MannTurbulence, Nuisances, QualityRules
from bayes_rs._validation import (
    as_generator,
    as_items,
    as_number,
    as_numbers,
    as_whole_numbers,
    check_choice,
    check_count,
    check_finite,
    check_log_normal,
    check_non_negative,
    check_positive,
    check_prob,
    check_seed,
    check_switch,
)
from bayes_rs.design.compare_options import CompareOptions
from bayes_rs.design.scan_criteria import CriterionOptions
from bayes_rs.design.scan_limits import ScanLimits
from bayes_rs.errors import in_short
from bayes_rs.file_options import FileOptions
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.settings import OutputOptions, Settings
from bayes_rs.options import options_of
from bayes_rs.quantities import LIMITS
from bayes_rs.records.record_options import RecordOptions


class Thing:
    """Of no kind that is expected; tests in several processes call it the same."""

    def __repr__(self):
        return "<a thing>"


NO_NUMBERS = ["3.2", "", b"3", True, None, 1j, np.complex128(1j), [3.2], np.array([3.2]), np.array("3"), Thing(), {}]


def refusal(call, *arguments, **options):
    with pytest.raises(InputError) as raised:
        call(*arguments, **options)
    text = str(raised.value)
    assert "\n" not in text
    assert len(text) < 700
    return text


class TestChecks:
    @pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
    @pytest.mark.parametrize("check", [check_positive, check_non_negative, check_finite])
    def test_what_is_no_number_is_none(self, check, value):
        assert np.isnan(as_number(value))
        assert refusal(check, value, what="duration", unit="s").startswith("Invalid duration ")

    @pytest.mark.parametrize("value", [3, 3.0, np.float32(3.0), np.int8(3), np.array(3.0)], ids=repr)
    def test_numbers_of_all_kinds_are_taken(self, value):
        assert check_positive(value, what="duration", unit="s") == 3.0

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 10**400, np.ma.masked], ids=str)
    def test_what_is_not_finite_is_refused(self, value):
        assert "it must be a finite number" in refusal(check_positive, value, what="duration", unit="s")

    @pytest.mark.parametrize("value", [1e300, 1e-300, 1e9])
    def test_limits_are_those_of_the_quantity(self, value):
        assert refusal(check_positive, value, what="duration", unit="s") == (
            f"Invalid duration {value!r} s: it must be from 0.01 to 2.6784e+06 s; 600 is usual."
        )

    def test_what_has_no_limits_of_its_own_has_wide_ones(self):
        assert check_positive(1e-9, what="tolerance", unit="") == 1e-9
        assert "from 1e-12 to 1e+12" in refusal(check_positive, 1e300, what="tolerance", unit="")
        assert check_finite(-1e300, what="entry of invalid", unit="") == -1e300

    @pytest.mark.parametrize("name", LIMITS)
    def test_limits_are_limits(self, name):
        assert LIMITS[name].least < LIMITS[name].most

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("wind_speed", 0.1),
            ("duration", 86400.0),
            ("length_scale", 1000.0),
            ("focus_distance", 3000.0),
            ("n_beams", 400),
            ("gamma", 5.0),
            ("target_ess", 20_000),
            ("scan_duration", 300.0),
            ("instrument_noise", 1e-4),
        ],
    )
    def test_legitimate_use_is_within(self, name, value):
        assert LIMITS[name].least <= value <= LIMITS[name].most

    @pytest.mark.parametrize(
        "value", [0.0, 1.0, 1e-300, 1.0 - 1e-16, "0.9", None, True, np.array([0.5, 0.9])], ids=repr
    )
    def test_a_probability_is_within_0_and_1(self, value):
        assert "Invalid prob" in refusal(check_prob, value)
        assert check_prob(0.999) == 0.999

    @pytest.mark.parametrize("value", [-1, 2**63, 2**70, 1.0, True, "1", None], ids=repr)
    @pytest.mark.parametrize("check", [check_seed, as_generator])
    def test_seeds_have_one_rule(self, check, value):
        assert "it must be a whole number from 0 to 2**63 - 1" in refusal(check, value)
        check(2**63 - 1)
        check(np.int64(0))

    def test_a_generator_is_taken_only_where_a_run_need_not_be_repeated(self):
        rng = np.random.default_rng(1)
        assert as_generator(rng) is rng
        assert "so that the run can be repeated" in refusal(check_seed, rng)

    def test_counts(self):
        assert "at most 100000; 1000 is usual" in refusal(check_count, 10_000_000, what="target_ess")
        assert "at most 1000000000" in refusal(check_count, 2**70, what="n_draw")
        assert refusal(check_count, True, what="n_draw").endswith("a whole number of at least 1.")

    @pytest.mark.parametrize("value", [3, None, np.array(["mean", "none"]), ["mean"], 10**400], ids=str)
    def test_choices_are_texts(self, value):
        assert "it must be one of mean, none" in refusal(check_choice, value, ("mean", "none"), what="detrend")

    @pytest.mark.parametrize(
        "values",
        ["3", ["3"], [1j], np.array([1j]), [True], np.array(["a"]), [10**400], Thing(), [[1], [1, 2]]],
        ids=str,
    )
    def test_arrays_are_of_numbers(self, values):
        assert "it must be an array of numbers" in refusal(as_numbers, values, what="stress")

    def test_whole_numbers_switches_lists_and_priors_of_a_size(self):
        assert as_whole_numbers([1.0, 2], what="beam").tolist() == [1, 2]
        assert "they must be whole numbers" in refusal(as_whole_numbers, [1.5], what="beam")
        assert "must be True or False" in refusal(check_switch, 1, what="veer")
        assert check_switch(np.True_, what="veer") is True
        assert as_items("uu", what="derived") == ["uu"]
        assert as_items(np.array([1.0, 2.0]), what="factors") == [1.0, 2.0]
        for wrong in (None, {"a": 1}, object(), np.array(3.0)):
            assert "it must be a list" in refusal(as_items, wrong, what="factors")
        for wrong in (None, 60.0, (60.0,), (60.0, 0.8, 1.0), ("60", 0.8), (60.0, 1e300)):
            assert "Invalid length_scale" in refusal(
                check_log_normal, wrong, what="length_scale_prior", unit="m", width="length_scale_log_sd"
            )

    def test_values_are_shown_in_one_short_line(self):
        class Rude:
            def __repr__(self):
                raise RuntimeError

        assert len(in_short("x" * 5000)) < 250
        assert "\n" not in in_short(np.eye(30))
        assert in_short(Rude()).startswith("<Rude")


EXTREMES = [
    (MannTurbulence, {"dissipation": 0.05, "length_scale": 61.0, "gamma": "3.2"}, "Invalid gamma '3.2'"),
    (MannTurbulence, {"dissipation": 0.05, "length_scale": 61.0, "gamma": 1e300}, "Invalid gamma 1e+300"),
    (MannTurbulence, {"dissipation": 0.05, "length_scale": 1e-300, "gamma": 3.2}, "Invalid length_scale 1e-300 m"),
    (MannTurbulence, {"dissipation": True, "length_scale": 61.0, "gamma": 3.2}, "Invalid dissipation True"),
    (FitOptions, {"seed": 2**70}, "Invalid seed 1180591620717411303424"),
    (FitOptions, {"seed": np.random.default_rng(1)}, "Invalid seed, a numpy.random.Generator"),
    (FitOptions, {"target_ess": 10_000_000}, "Invalid target_ess 10000000"),
    (FitOptions, {"max_extension": 10**9}, "Invalid max_extension 1000000000"),
    (FitOptions, {"prob": 1e-300}, "Invalid prob 1e-300"),
    (FitOptions, {"prob": "0.9"}, "Invalid prob '0.9'"),
    (FitOptions, {"instrument_noise": 1e300}, "Invalid instrument_noise 1e+300 m² s⁻²"),
    (FitOptions, {"instrument_noise": True}, "Invalid instrument_noise True"),
    (FitOptions, {"campaign_unsteady": "yes"}, "Invalid campaign_unsteady 'yes'"),
    (FitOptions, {"prior": 3}, "Unknown prior '3'"),
    (Nuisances, {"vertical_gradient_sd": 1e300}, "Invalid vertical_gradient_sd 1e+300 per 100 m"),
    (Nuisances, {"lateral_gradient_sd": 1e-300}, "Invalid lateral_gradient_sd 1e-300 per 100 m"),
    (Nuisances, {"inflation_dof": "many"}, "Invalid inflation_dof 'many'"),
    (Nuisances, {"yaw_sd_deg": [2.0]}, "Invalid yaw_sd_deg [2.0]"),
    (QualityRules, {"wind_sectors": 1e9}, "Invalid wind_sectors 1000000000.0"),
    (QualityRules, {"despike_window": 10**9 - 1}, "Invalid despike_window 999999999"),
    (QualityRules, {"trend_level": "0.01"}, "Invalid trend_level '0.01'"),
    (RecordOptions, {"duration": 1e-300}, "Invalid duration 1e-300 s"),
    (RecordOptions, {"duration": "600"}, "Invalid duration '600' s"),
    (QualityRules, {"cnr_range": np.array([1j])}, "Invalid cnr_range"),
    (FileOptions, {"time_format": "%n"}, "Invalid time_format '%n': it must be a pattern that can be read and states"),
    (FileOptions, {"time_format": "%Y%"}, "Invalid time_format '%Y%'"),
    (
        FileOptions,
        {"time_format": "%Y %Y"},
        "Invalid time_format '%Y %Y': it must be a pattern that can be read and states",
    ),
    (FileOptions, {"sample_duration": 1e300}, "Invalid sample_duration 1e+300 s"),
    (OutputOptions, {"workers": 10**9}, "Invalid workers 1000000000"),
    (CompareOptions, {"seed": 2**70}, "Invalid seed"),
    (CompareOptions, {"estimators": 3}, "Unknown estimator 3"),
    (CompareOptions, {"wind_speed": "10"}, "Invalid wind_speed '10' m/s"),
    (CriterionOptions, {"stresses": [3.0]}, "Invalid stresses [3.0]"),
    (CriterionOptions, {"stresses": ["vv=many"]}, "Invalid weight of vv 'many'"),
    (ScanLimits, {"max_angle_deg": 30.0, "dwell": 1e9}, "Invalid dwell 1000000000.0 s"),
    (ScanLimits, {"max_angle_deg": 30.0, "scan_duration": 1e-300}, "Invalid scan_duration 1e-300 s"),
    (ScanLimits, {"max_angle_deg": 30.0, "scan_duration": 1e300}, "Invalid scan_duration 1e+300 s"),
    (brs.geometry.PulsedProbe, {"gate_length": 1e300}, "Invalid gate_length 1e+300 m"),
    (brs.geometry.ContinuousWaveProbe, {"rayleigh_length": "6"}, "Invalid rayleigh_length '6' m"),
    (brs.priors.FlatPrior, {"bound": 1e300}, "Invalid bound 1e+300 m² s⁻²"),
    (brs.noise.Boxes, {"seed": 2**70}, "Invalid seed"),
    (brs.load_scan, {"name": "6-beam", "yaw_deg": np.eye(3)}, "Invalid yaw_deg array("),
    (brs.load_scan, {"name": "6-beam", "centre": "3.2"}, "Invalid centre '3.2'"),
    (brs.plan, {"scan": "2-beam", "wind_speed": 1e300}, "Invalid wind_speed 1e+300 m/s"),
    (
        brs.plan,
        {"scan": "2-beam", "wind_speed": 200.0},
        "Invalid wind_speed 200.0 m/s: it must be from 0.001 to 90 m/s",
    ),
    (CompareOptions, {"wind_speed": 200.0}, "Invalid wind_speed 200.0 m/s: it must be from 0.001 to 90 m/s"),
    (CriterionOptions, {"wind_speed": 200.0}, "Invalid wind_speed 200.0 m/s: it must be from 0.001 to 90 m/s"),
    (
        brs.noise.calibrate,
        {"scan": "2-beam", "wind_speed": 200.0},
        "Invalid wind_speed 200.0: it must be from 0.001 to 90;",
    ),
    (brs.noise.theory, {"scan": "2-beam", "wind_speed": "10"}, "Invalid wind_speed '10' m/s"),
    (brs.noise.calibrate, {"scan": "2-beam", "wind_speed": 10.0, "duration": [600.0]}, "Invalid duration [600.0] s"),
    (brs.compare, {"scans": 3}, "Invalid scan 3"),
    (brs.optimize_scan, {"n_beams": 1e-9, "max_angle_deg": 30.0}, "Invalid n_beams 1e-09"),
    (brs.turbulence.cross_spectra, {"wave_number": "", "separation": [0, 0], "turbulence": "fu-2022"}, "wave_number"),
    (
        brs.turbulence.velocity_covariance,
        {"separation": [1e300, 0.0, 0.0], "turbulence": "fu-2022"},
        "Invalid separation: the entry at (0, 0) is 1e+300, and every entry must be from -1e+18 to 1e+18.",
    ),
    (
        brs.noise.calibrate,
        {"scan": "2-beam", "wind_speed": [10.0, 1e300]},
        "Invalid wind_speed: the entry at (1,) is 1e+300, and every entry must be from 0.001 to 90; 3 to 25 are usual",
    ),
    (brs.geometry.radial_variance, {"scan": "6-beam", "stress": np.array([1j])}, "Invalid stress"),
    (brs.geometry.rotate_stress, {"stress": [1, 1, 1, 0, 0, 0], "rotation": 3.0}, "Invalid rotation of shape ()"),
    (brs.inflow_confounding, {"scan": "6-beam", "stress": [1, 1, 1, 0, 0, 0], "noise": ("a", "b")}, "Invalid noise ("),
    (Settings().changed, {"seed": "1"}, "Invalid seed '1'"),
]


@pytest.mark.parametrize(("call", "options", "begin"), EXTREMES, ids=[one[2] for one in EXTREMES])
def test_extreme_and_foreign_values_are_refused_in_one_line(call, options, begin):
    assert begin in refusal(call, **options)


CLASSES = {
    RecordOptions: {},
    FileOptions: {},
    QualityRules: {},
    FitOptions: {},
    Nuisances: {},
    CompareOptions: {},
    CriterionOptions: {},
    ScanLimits: {"max_angle_deg": 30.0},
}


@pytest.mark.parametrize(("cls", "name"), [(cls, entry.name) for cls in CLASSES for entry in options_of(cls)], ids=str)
def test_every_option_refuses_what_is_of_no_kind_of_its_own(cls, name):
    """An object, a complex number and a Generator are no value of any option."""
    assert name in {entry.name for entry in fields(cls)}
    for value in (object(), 1j, np.random.default_rng(1), np.datetime64("NaT")):
        refusal(cls, **{**CLASSES[cls], name: value})


def test_the_settings_file_has_the_same_limits(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text("[records]\nduration = 1e300\n", encoding="utf-8")
    expected = re.escape("Invalid duration 1e+300 s: it must be from 0.01 to 2.6784e+06 s; 600 is usual.")
    with pytest.raises(InputError, match=expected):
        Settings.load(file)


class TestRecords:
    """What no atmosphere has is flagged, and says so; what holds nothing is refused."""

    @pytest.fixture(scope="class")
    @staticmethod
    def scene():
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, "fu-2022", wind_speed=10.0, duration=60.0, n_records=3, seed=1)
        noise = brs.noise.calibrate(scan, wind_speed=[9.0, 11.0], duration=60.0, cache=False, progress=False)
        return scan, brs.make_records(series, scan, duration=60.0), noise

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("yaw", 1e300),
            ("yaw", np.inf),
            ("wind_speed", 1e300),
            ("wind_speed", np.inf),
            ("wind_speed", 1e-300),
            ("variance", 1e-300),
            ("variance", np.inf),
        ],
    )
    def test_a_record_that_is_beyond_belief_is_not_fitted(self, scene, name, value):
        scan, records, noise = scene
        changed = records.copy(deep=True)
        changed[name].values[1] = value
        found = brs.fit(changed, scan, noise=noise, seed=1, target_ess=50, campaign="off", progress=False)
        assert found.fitted.tolist() == [True, False, True]
        assert np.isfinite(found.summary().query("record != 1")["mean"]).all()

    def test_records_without_beams_or_without_records(self, scene):
        scan, records, noise = scene
        options = {"noise": noise, "seed": 1}
        assert "they hold no beam" in refusal(brs.fit, records.isel(beam=slice(0)), scan, **options)
        assert "There is no record" in refusal(brs.fit, records.isel(record=slice(0)), scan, **options)
        assert "No beam of scan '2-beam' is selected" in refusal(brs.wind.mean_wind, records.isel(beam=slice(0)), scan)
        assert "No beam of scan '2-beam' is selected" in refusal(brs.estimate, records.isel(beam=slice(0)), scan)

    def test_a_tuple_is_no_noise(self, scene):
        scan, records, noise = scene
        for call, options in ((brs.fit, {"seed": 1}), (brs.estimate, {})):
            assert refusal(call, records, scan, noise=(noise,), **options).startswith("Invalid noise (")

    def test_three_draws_are_too_few_for_a_corner_plot(self, scene, monkeypatch):
        scan, records, noise = scene
        found = brs.fit(records, scan, noise=noise, seed=1, target_ess=50, campaign="off", progress=False)
        few = found.draws(0).reshape(-1, 6)[:3]
        monkeypatch.setattr(type(found), "draws", lambda *_: few)
        assert "has 3 draws, and a corner plot needs more than 6" in refusal(brs.plot.corner, found, 0)
