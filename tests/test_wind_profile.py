"""Profiles of the mean wind: exact on exact means, covered in simulated ones, and refused where nothing is seen."""

import numpy as np
import pytest
from scipy import stats
from test_wind_mean import FALSE_ALARM, FLOW, records_of

import bayes_rs as brs
from bayes_rs import InputError, load_scan
from bayes_rs.wind import wind_profile
from bayes_rs.wind.profile import LAWS, VON_KARMAN

HUB = 90.0
SHAPES = {
    "power": lambda z: (z / HUB) ** 0.18,
    "log": lambda z: np.log(z / 0.03) / np.log(HUB / 0.03),
    "linear": lambda z: 1.0 + 0.003 * (z - HUB),
}


def exact_records(scan, law, *, yaw_deg=0.0, veer=0.0, speed=9.0):
    """Means of the beams in a sheared and veering wind, beam by beam."""
    mean = []
    for n, distance in zip(scan.level_direction, scan.focus_distance, strict=True):
        z = HUB + distance * n[2]
        direction = np.deg2rad(yaw_deg + veer * (z - HUB))
        mean.append(speed * SHAPES[law](z) * (n[0] * np.cos(direction) - n[1] * np.sin(direction)))
    return records_of([mean], scan, yaw_deg=yaw_deg, wind_speed=speed)


@pytest.mark.parametrize("law", list(LAWS))
class TestExact:
    @pytest.mark.parametrize("veer", [0.0, 0.1])
    def test_recovers_what_the_means_were_made_of(self, law, veer):
        scan = load_scan("50-beam", tilt_deg=2.0)
        records = exact_records(scan, law, yaw_deg=12.0, veer=veer)
        found = wind_profile(records, scan, turbulence=FLOW, hub_height=HUB, law=law, veer=bool(veer))
        assert found["wind_speed"].item() == pytest.approx(9.0, rel=1e-8)
        assert found["yaw"].item() == pytest.approx(12.0, rel=1e-7)
        if law == "power":
            assert found["shear_exponent"].item() == pytest.approx(0.18, rel=1e-6)
        if law == "log":
            assert found["roughness_length"].item() == pytest.approx(0.03, rel=1e-5)
            star = VON_KARMAN * 9.0 / np.log(HUB / 0.03)
            assert found["friction_velocity"].item() == pytest.approx(star, rel=1e-6)
        if law == "linear":
            assert found["shear"].item() == pytest.approx(9.0 * 0.003, rel=1e-6)
        if veer:
            assert found["veer"].item() == pytest.approx(veer, rel=1e-6)
        assert found["chi_square"].item() == pytest.approx(0.0, abs=1e-8)
        np.testing.assert_allclose(found["beam_wind_speed"][0], 9.0 * SHAPES[law](found["height"][0]), rtol=1e-6)

    def test_another_reference_height_is_the_same_profile(self, law):
        scan = load_scan("6-beam")
        records = exact_records(scan, law, yaw_deg=5.0)
        records = records.assign(mean=records["mean"] + 0.02 * np.arange(6))  # not exact, so that the weights matter
        one, other = (
            wind_profile(records, scan, turbulence=FLOW, hub_height=HUB, law=law, reference_height=z)
            for z in (HUB, 70.0)
        )
        np.testing.assert_allclose(one["chi_square"], other["chi_square"], rtol=1e-7)
        shape = LAWS[law].shape(one[LAWS[law].name].values, np.array([70.0]), HUB)
        np.testing.assert_allclose(other["wind_speed"], one["wind_speed"] * shape, rtol=1e-7)
        if law == "log":
            np.testing.assert_allclose(one["log_roughness_length"], other["log_roughness_length"], rtol=1e-6)
            np.testing.assert_allclose(one["log_roughness_length_sd"], other["log_roughness_length_sd"], rtol=1e-6)

    def test_standard_deviations_against_small_changes_of_the_means(self, law):
        """sd² = g · M g, with g the change of each number with each mean, by finite differences."""
        scan = load_scan("6-beam")
        records = exact_records(scan, law, yaw_deg=5.0)
        options = {"turbulence": FLOW, "hub_height": HUB, "law": law, "scale": "turbulence"}
        step = 1e-4
        covariance = brs.wind.mean_error.record_mean_covariance(records, scan, FLOW, scale="turbulence")[0]
        covariance = covariance + 0.01**2 * np.eye(6)
        names = ["wind_speed", "yaw", LAWS[law].name, *{"log": ["friction_velocity"], "linear": ["shear"]}.get(law, [])]
        plain = wind_profile(records, scan, **options)
        moved = [
            [
                wind_profile(records.assign(mean=records["mean"] + sign * step * (np.arange(6) == b)), scan, **options)
                for sign in (1, -1)
            ]
            for b in range(6)
        ]
        for name in names:
            slope = np.array([(up[name].item() - down[name].item()) / (2.0 * step) for up, down in moved])
            assert plain[f"{name}_sd"].item() == pytest.approx(np.sqrt(slope @ covariance @ slope), rel=1e-4)


class TestLimits:
    def test_beams_at_one_height_see_no_shear(self):
        scan = load_scan("2-beam-planes") if load_scan("2-beam-planes").n_beam > 3 else load_scan("2-beam")
        records = exact_records(scan, "power")
        found = wind_profile(records, scan, turbulence=FLOW, hub_height=HUB)
        assert np.isnan(found["shear_exponent"].item())
        assert np.isnan(found["wind_speed_sd"].item())

    def test_flagged_beams_do_not_count(self):
        scan = load_scan("6-beam")
        records = exact_records(scan, "power", yaw_deg=4.0)
        mean = records["mean"].values.copy()
        mean[0, 2] = 99.0
        flag = np.zeros((1, 6), dtype=int)
        flag[0, 2] = 1
        found = wind_profile(records_of(mean, scan, flag=flag, yaw_deg=4.0), scan, turbulence=FLOW, hub_height=HUB)
        assert found["shear_exponent"].item() == pytest.approx(0.18, rel=1e-6)
        assert found["degrees_of_freedom"].item() == 2
        few = np.ones((1, 6), dtype=int)
        few[0, :2] = 0
        few = wind_profile(records_of(mean, scan, flag=few, yaw_deg=4.0), scan, turbulence=FLOW, hub_height=HUB)
        assert np.isnan(few["shear_exponent"].item())

    def test_a_record_is_the_same_in_any_company(self):
        scan = load_scan("6-beam")
        mean = np.random.default_rng(3).normal(-9.0, 0.2, (5, 6))
        whole = wind_profile(records_of(mean, scan), scan, turbulence=FLOW, hub_height=HUB)
        alone = wind_profile(records_of(mean[2:3], scan), scan, turbulence=FLOW, hub_height=HUB)
        for name in ("wind_speed", "shear_exponent", "shear_exponent_sd", "chi_square"):
            assert whole[name].values[2] == pytest.approx(alone[name].item(), rel=1e-12)

    def test_a_falling_wind_has_no_roughness_length(self):
        scan = load_scan("6-beam")
        height = HUB + scan.focus_distance * scan.level_direction[:, 2]
        mean = 9.0 * scan.level_direction[:, 0] * (HUB / height) ** 0.1
        found = wind_profile(records_of([mean], scan), scan, turbulence=FLOW, hub_height=HUB, law="log")
        assert found["log_slope"].item() < 0.0
        assert np.isnan(found["roughness_length"].item())

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"hub_height": 5.0}, r"Invalid height -\S+ m of beam \d of scan '6-beam' in record 0"),
            ({"hub_height": -1.0}, r"Invalid hub_height -1.0 m"),
            (
                {"hub_height": HUB, "law": "jet"},
                r"Unknown law of the profile 'jet': it must be one of power, log, linear",
            ),
            ({"hub_height": HUB, "beam_sd": -0.1}, r"Invalid beam_sd -0.1 m/s"),
        ],
    )
    def test_refuses(self, options, message):
        scan = load_scan("6-beam")
        with pytest.raises(InputError, match=message):
            wind_profile(exact_records(scan, "power"), scan, turbulence=FLOW, **options)


@pytest.fixture(scope="module")
def simulated():
    scan = load_scan("6-beam", yaw_deg=10.0)
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=600, seed=21, shear=0.03)
    return scan, brs.make_records(series, scan)


@pytest.mark.slow
class TestCoverage:
    """The shear of `simulate` is linear; for the other laws its means are moved to theirs, which no variance sees."""

    @pytest.mark.parametrize("law", list(LAWS))
    def test_intervals(self, simulated, law):
        scan, records = simulated
        height = HUB + scan.focus_distance * scan.level_direction[:, 2]
        along = scan.line_of_sight[:, 0]
        moved = records.assign(mean=records["mean"] + 10.0 * along * (SHAPES[law](height) - SHAPES["linear"](height)))
        found = wind_profile(moved, scan, turbulence=FLOW, hub_height=HUB, law=law)
        truth = {
            "power": ("shear_exponent", 0.18),
            "log": ("log_roughness_length", np.log(0.03)),
            "linear": ("shear", 0.03),
        }[law]
        for name, value in (("wind_speed", 10.0), ("yaw", 10.0), truth):
            distance = np.abs(found[name].values - value) / found[f"{name}_sd"].values
            for level in (0.5, 0.9):
                inside = np.count_nonzero(distance < stats.norm.ppf(0.5 + 0.5 * level))
                bound = stats.binom.ppf([0.5 * FALSE_ALARM, 1.0 - 0.5 * FALSE_ALARM], len(distance), level)
                slack = 0.03 * len(distance)  # the scale from a record's own variances, and first order in ln z₀
                assert bound[0] - slack <= inside <= bound[1] + slack

    def test_p_values_are_uniform_for_the_right_law(self, simulated):
        scan, records = simulated
        found = wind_profile(records, scan, turbulence=FLOW, hub_height=HUB, law="linear", scale="turbulence")
        assert stats.kstest(found["p_value"].values, "uniform").pvalue > FALSE_ALARM

    def test_p_values_tell_a_beam_that_does_not_belong(self, simulated):
        scan, records = simulated
        wrong = records.assign(mean=records["mean"] + 1.0 * (np.arange(6) == 5))
        found = wind_profile(wrong, scan, turbulence=FLOW, hub_height=HUB, law="linear")
        assert np.median(found["p_value"]) < 0.01
