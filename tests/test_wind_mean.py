"""The mean wind and its error: exactness, turning, sums done the slow way, and coverage in simulated records."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import bayes_rs as brs
from bayes_rs import InputError, load_scan, load_turbulence
from bayes_rs.records.flags import RECORD_FLAGS
from bayes_rs.records.given import warn_of_other_scan
from bayes_rs.records.least_squares import horizontal_wind, solve_wind
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.wind import mean_wind
from bayes_rs.wind.mean_error import record_mean_covariance

FLOW = load_turbulence("fu-2022")
ROUNDING = 1e-12
FALSE_ALARM = 1e-5  # of a statistical test: one in 100 000 seeds


def records_of(mean, scan, *, flag=None, variance=None, yaw_deg=0.0, wind_speed=10.0) -> xr.Dataset:
    mean = np.atleast_2d(mean)
    n_record = len(mean)
    return xr.Dataset(
        {
            "mean": (("record", "beam"), mean),
            "variance": (("record", "beam"), np.ones(mean.shape) if variance is None else variance),
            "flag": (("record", "beam"), np.zeros(mean.shape, dtype=int) if flag is None else flag),
            "record_flag": ("record", np.zeros(n_record, dtype=np.uint8)),
            "wind_speed": ("record", np.full(n_record, wind_speed)),
            "yaw": ("record", np.full(n_record, yaw_deg)),
        },
        coords={
            "beam": scan.beam,
            "time": ("record", np.datetime64("2020-01-01", "ns") + np.arange(n_record) * np.timedelta64(600, "s")),
        },
        attrs={"duration": 600.0},
    )


class TestLeastSquares:
    @pytest.mark.parametrize("vertical", [False, True])
    def test_against_numpy_record_by_record(self, vertical):
        rng = np.random.default_rng(1)
        scan = load_scan("6-beam", opening_angle_deg=30.0, tilt_deg=4.0)
        mean, valid = rng.normal(size=(30, 6)), rng.random((30, 6)) < 0.8
        weights = rng.uniform(0.5, 2.0, 6)
        found = solve_wind(mean, valid, scan.level_direction, weights=weights, vertical=vertical)
        for record in range(30):
            rows = scan.level_direction[valid[record], : 2 + vertical]
            if np.linalg.matrix_rank(rows) < 2 + vertical:
                assert not found.seen[record]
                assert np.isnan(found.velocity[record]).all()
                np.testing.assert_array_equal(found.estimator[record], 0.0)
                continue
            np.testing.assert_allclose(found.estimator[record][:, ~valid[record]], 0.0, atol=1e-13)  # rounding
            root = np.sqrt(weights[valid[record]])
            wanted = np.linalg.lstsq(root[:, None] * rows, root * mean[record, valid[record]])[0]
            # the worst set of beams has a condition number of some hundred
            np.testing.assert_allclose(found.velocity[record], wanted, rtol=1e-10, atol=1e-12)

    def test_each_record_is_solved_with_its_own_directions(self):
        rng = np.random.default_rng(6)
        direction = load_scan("6-beam", opening_angle_deg=30.0).level_direction + 0.1 * rng.normal(size=(4, 6, 3))
        wind = rng.normal(size=(4, 2))
        valid = np.ones((4, 6), dtype=bool)
        for lost in ([], [2], [2, 5]):
            valid[1, lost] = False
            mean = np.where(valid, np.einsum("rbc,rc->rb", direction[..., :2], wind), np.nan)
            np.testing.assert_allclose(solve_wind(mean, valid, direction).velocity, wind, rtol=1e-10)

    def test_beams_that_do_not_see_the_wind_have_no_estimator(self):
        valid = np.eye(6, dtype=bool)[:2] + np.array([[True], [False]])
        found = solve_wind(np.ones((2, 6)), valid, load_scan("6-beam").level_direction)
        assert found.seen.tolist() == [True, False]
        assert np.isnan(found.velocity[1]).all()
        np.testing.assert_array_equal(found.estimator[1], 0.0)

    def test_a_staring_lidar_has_an_estimator_of_the_speed_only(self):
        found = horizontal_wind(np.array([[-8.0]]), np.ones((1, 1), dtype=bool), np.array([[-1.0, 0.0, 0.0]]), 0.0)
        assert (found.speed.item(), found.yaw_seen.item(), found.wind_seen.item()) == (8.0, False, True)
        np.testing.assert_array_equal(found.estimator, [[[-1.0], [0.0]]])

    def test_a_record_is_the_same_in_any_company(self):
        rng = np.random.default_rng(2)
        scan = load_scan("6-beam")
        mean, valid = rng.normal(size=(20, 6)), rng.random((20, 6)) < 0.9
        whole = solve_wind(mean, valid, scan.level_direction)
        alone = solve_wind(mean[7:8], valid[7:8], scan.level_direction)
        np.testing.assert_array_equal(whole.velocity[7], alone.velocity[0])

    def test_own_directions_of_each_record_give_what_shared_ones_give(self):
        rng = np.random.default_rng(3)
        scan = load_scan("6-beam")
        mean, valid = rng.normal(size=(20, 6)), np.ones((20, 6), dtype=bool)
        own = np.broadcast_to(scan.level_direction, (20, 6, 3))
        one, other = (horizontal_wind(mean, valid, direction, 0.0) for direction in (scan.level_direction, own))
        np.testing.assert_allclose(one.speed, other.speed, rtol=ROUNDING)
        np.testing.assert_allclose(one.yaw, other.yaw, rtol=ROUNDING)

    @pytest.mark.parametrize("yaw_deg", [20.0, -35.0, 100.0])
    def test_one_beam_leaves_the_direction_to_the_scan(self, yaw_deg):
        scan = load_scan("2-beam", yaw_deg=yaw_deg).select([1])
        mean = 7.0 * scan.line_of_sight[:, :1].T
        found = horizontal_wind(mean, np.ones((1, 1), dtype=bool), scan.level_direction, scan.yaw)
        assert found.speed[0] == pytest.approx(7.0, rel=1e-12)
        assert np.degrees(found.yaw[0]) == pytest.approx(yaw_deg, rel=1e-12)
        assert not found.yaw_seen[0]
        behind = horizontal_wind(-mean, np.ones((1, 1), dtype=bool), scan.level_direction, scan.yaw)
        assert behind.speed[0] == pytest.approx(7.0, rel=1e-12)
        assert abs(np.degrees(behind.yaw[0]) - yaw_deg) == pytest.approx(180.0, rel=1e-12)


class TestMeanWind:
    @pytest.mark.parametrize("yaw_deg", [0.0, 25.0, -130.0, 179.0])
    @pytest.mark.parametrize("name", ["2-beam", "6-beam", "pulsed-4-beam"])
    def test_exact_in_uniform_wind(self, name, yaw_deg):
        scan = load_scan(name, tilt_deg=3.0)
        mean = 8.0 * scan.at_yaw(np.deg2rad(yaw_deg))[:, 0]
        found = mean_wind(records_of(mean, scan), scan, heading_deg=10.0)
        assert found["wind_speed"].item() == pytest.approx(8.0, rel=1e-10)
        assert found["yaw"].item() == pytest.approx(yaw_deg, abs=1e-9)
        assert found["wind_direction"].item() == pytest.approx((10.0 + yaw_deg) % 360.0, abs=1e-9)

    def test_the_compass(self):
        """A lidar that looks north, wind from the east: it comes from the right of who looks out, and blows to −y."""
        scan = load_scan("2-beam")
        wind = np.array([0.0, -5.0, 0.0])
        found = mean_wind(records_of(scan.level_direction @ wind, scan), scan, heading_deg=0.0)
        assert found["wind_direction"].item() == pytest.approx(90.0, abs=1e-9)

    def test_turning_the_wind_turns_the_yaw_and_nothing_else(self):
        scan = load_scan("6-beam", tilt_deg=2.0)
        rng = np.random.default_rng(4)
        yaw = rng.uniform(-170.0, 170.0, 5)
        for turn in (0.0, 3.0):
            mean = np.stack([9.0 * scan.at_yaw(np.deg2rad(one + turn))[:, 0] for one in yaw])
            found = mean_wind(records_of(mean, scan), scan)
            np.testing.assert_allclose(found["yaw"], yaw + turn, atol=1e-8)
            np.testing.assert_allclose(found["wind_speed"], 9.0, rtol=1e-10)

    def test_vertical_component(self):
        scan = load_scan("6-beam", opening_angle_deg=30.0)
        wind = np.array([7.0, 1.0, -0.4])
        found = mean_wind(records_of(scan.level_direction @ wind, scan), scan, vertical=True)
        np.testing.assert_allclose(found["velocity"].values[0], wind, rtol=1e-10)
        flat = mean_wind(
            records_of(load_scan("2-beam").level_direction @ wind, load_scan("2-beam")), load_scan("2-beam")
        )
        assert np.isnan(flat["velocity"].values[0, 2])

    def test_two_beams_do_not_see_a_vertical_component(self):
        scan = load_scan("2-beam")
        found = mean_wind(records_of([[-8.0, -8.0]], scan), scan, vertical=True, turbulence=FLOW)
        assert np.isnan(found["wind_speed"].item())
        assert np.isnan(found["wind_speed_sd"].item())
        assert found["record_flag"].item() & RECORD_FLAGS["wind_not_seen"]

    def test_the_same_as_make_records(self):
        scan = load_scan("6-beam", yaw_deg=12.0)
        records = brs.make_records(brs.simulate(scan, FLOW, wind_speed=9.0, n_records=3, seed=2), scan)
        found = mean_wind(records, scan)
        for name in ("wind_speed", "yaw", "record_flag"):
            np.testing.assert_array_equal(found[name], records[name])

    def test_a_zero_weight_is_a_beam_that_is_not_there(self):
        scan = load_scan("6-beam")
        mean = np.random.default_rng(5).normal(-9.0, 0.1, (1, 6))
        weighted = mean_wind(records_of(mean, scan), scan, weights=[1, 1, 1, 1, 1, 0])
        flag = np.array([[0, 0, 0, 0, 0, 1]])
        without = mean_wind(records_of(mean, scan, flag=flag), scan)
        np.testing.assert_allclose(weighted["yaw"], without["yaw"], rtol=1e-10)

    def test_a_staring_beam_has_a_speed_error_and_no_yaw_error(self):
        scan = load_scan("staring")
        found = mean_wind(records_of([[-8.0]], scan, wind_speed=8.0), scan, turbulence=FLOW, scale="turbulence")
        covariance = brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=8.0)
        # the speed is interpolated in the net of states: below 1 % of a variance
        assert found["wind_speed_sd"].item() == pytest.approx(np.sqrt(covariance[0, 0]), rel=0.01)
        assert np.isnan(found["yaw_sd"].item())
        assert found["record_flag"].item() == RECORD_FLAGS["yaw_not_seen"]

    @pytest.mark.parametrize("vertical", [False, True])
    def test_standard_deviations_against_small_changes_of_the_means(self, vertical):
        """sd² = g · M g, with g the change of speed and direction with each mean, by finite differences."""
        scan = load_scan("6-beam", opening_angle_deg=30.0)
        mean = scan.level_direction @ np.array([6.0, -4.0, 0.2])
        step, options = 1e-4, {"turbulence": FLOW, "scale": "turbulence", "vertical": vertical}
        plain = mean_wind(records_of(mean, scan), scan, **options)
        covariance = record_mean_covariance(plain, scan, FLOW, scale="turbulence")[0]
        moved = [
            [
                mean_wind(records_of(mean + sign * step * (np.arange(6) == b), scan), scan, vertical=vertical)
                for sign in (1, -1)
            ]
            for b in range(6)
        ]
        for name in ("wind_speed", "yaw"):
            slope = np.array([(up[name].item() - down[name].item()) / (2.0 * step) for up, down in moved])
            assert plain[f"{name}_sd"].item() == pytest.approx(np.sqrt(slope @ covariance @ slope), rel=1e-5)

    def test_other_flags_of_a_record_stay(self):
        scan = load_scan("2-beam")
        records = records_of([[-8.0, -8.0]], scan).assign(record_flag=("record", np.array([64], dtype=np.uint8)))
        assert mean_wind(records, scan)["record_flag"].item() == 64

    def test_no_usable_beam_is_no_error(self):
        scan = load_scan("2-beam")
        records = records_of([[-8.0, -8.0], [-8.0, -8.0]], scan, flag=np.array([[0, 0], [1, 1]]))
        found = mean_wind(records, scan, turbulence=FLOW)
        assert np.isfinite(found["wind_speed_sd"].values[0])
        assert np.isnan(found["wind_speed_sd"].values[1])

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"weights": [1.0, -1.0]}, r"Invalid weight -1 of beam 1: it must be zero or above\."),
            ({"heading_deg": [1.0, 2.0]}, r"Invalid heading_deg of shape \(2,\): it must be one number"),
            ({"heading_deg": np.nan}, r"Invalid heading_deg: every heading must be a finite angle"),
            ({"turbulence": FLOW, "scale": "own"}, r"Unknown scale 'own': it must be one of record, turbulence\."),
        ],
    )
    def test_refuses(self, options, message):
        scan = load_scan("2-beam")
        with pytest.raises(InputError, match=message):
            mean_wind(records_of([[-8.0, -8.0]], scan), scan, **options)

    def test_refuses_records_without_means(self):
        scan = load_scan("2-beam")
        with pytest.raises(InputError, match=r"The records have no mean with dims"):
            mean_wind(records_of([[-8.0, -8.0]], scan).drop_vars("mean"), scan)


class TestErrorOfMeans:
    @pytest.mark.parametrize("duration", [40.0, 42.0])  # in the second, two beams have a sample more than the others
    def test_against_the_double_sum(self, duration):
        scan = load_scan("pulsed-4-beam", yaw_deg=20.0, probe="point")
        found = brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=7.0, duration=duration, tolerance=1e-4)
        every = scan.beam_time[:, None] + scan.scan_duration * np.arange(20)
        time = [row[row < duration] for row in every]
        place = scan.focus_distance[:, None] * scan.line_of_sight
        for a in range(4):
            for b in range(4):
                apart = np.tile(place[b] - place[a], (len(time[a]), len(time[b]), 1))
                apart[..., 0] -= 7.0 * (time[b][None, :] - time[a][:, None])
                tensor = brs.turbulence.velocity_covariance(apart, FLOW)
                slow = np.einsum("i,mnij,j->mn", scan.line_of_sight[a], tensor, scan.line_of_sight[b]).mean()
                assert found[a, b] == pytest.approx(slow, abs=2e-4 * FLOW.stresses()[0])  # both are to 1e-4 of uu

    @pytest.mark.parametrize("name", ["6-beam", "pulsed-4-beam"])
    def test_what_the_mean_takes_is_what_the_variance_lacks(self, name):
        """Another way to the same number: the bias of the noise model, from a trace of Toeplitz matrices."""
        scan = load_scan(name)
        found = np.diag(brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=10.0, tolerance=1e-4))
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        records = (1.0 + noise.bias[0]) * (noise.gain[0] @ FLOW.stresses())
        if name == "6-beam":
            whole = brs.geometry.radial_variance(scan, FLOW.stresses())
        else:
            n, zero = scan.line_of_sight, np.zeros((scan.n_beam, 2))
            length = np.tile(scan.probe_length[:, None], (1, 2))
            whole = probed_covariance(n, n, zero, zero[:, :1], FLOW, probe=scan.probe, lengths=length)[:, 0]
        np.testing.assert_allclose(found, whole - records, atol=5e-4 * FLOW.stresses()[0])

    def test_long_records(self):
        """Var → 2 T_i σ²/T: with the two-sided spectrum at k₁ → 0, 2 T_i σ² = 2π F(0)/U."""
        scan = load_scan("staring")
        duration, speed = 40_000.0, 10.0
        found = brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=speed, duration=duration)[0, 0]
        limit = 2.0 * np.pi * FLOW.spectra([1e-6])[0, 0] / (speed * duration)
        assert found == pytest.approx(limit, rel=0.03)  # the next term of the limit is of the order of L/(U T), 1e-3

    def test_scales_with_the_records_own_variance(self):
        scan = load_scan("6-beam")
        mean = np.tile(10.0 * scan.line_of_sight[:, 0], (2, 1))
        variance = np.stack([np.full(6, 1.0), np.full(6, 2.5)])
        found = record_mean_covariance(records_of(mean, scan, variance=variance), scan, FLOW)
        np.testing.assert_allclose(found[1], 2.5 * found[0], rtol=1e-12)
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ FLOW.stresses())
        as_it_is = record_mean_covariance(records_of(mean, scan), scan, FLOW, scale="turbulence")
        own = record_mean_covariance(records_of(mean, scan, variance=np.tile(expected, (2, 1))), scan, FLOW)
        np.testing.assert_allclose(own, as_it_is, rtol=2e-3)  # tolerance of the covariances, 1e-3 of uu

    @pytest.mark.parametrize("name", ["6-beam", "pulsed-4-beam"])
    def test_interpolation_between_states(self, name):
        """The promise of the docstring: below 1 % of the variances of the means."""
        scan = load_scan(name)
        speed, yaw = np.array([3.3, 5.1, 8.4, 12.1, 23.0]), np.array([-27.0, 11.0, 4.0, -9.0, 31.0])
        records = records_of(np.zeros((5, scan.n_beam)), scan).assign(wind_speed=("record", speed), yaw=("record", yaw))
        found = record_mean_covariance(records, scan, FLOW, scale="turbulence")
        for record in range(5):
            exact = brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=speed[record], yaw_deg=yaw[record])
            size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
            assert np.max(np.abs(found[record] - exact) / size) < 0.01

    def test_records_without_a_wind_have_none(self):
        scan = load_scan("2-beam")
        records = records_of([[-8.0, -8.0]], scan, wind_speed=np.nan)
        assert np.isnan(record_mean_covariance(records, scan, FLOW)).all()


@pytest.fixture(scope="module", params=["6-beam", "2-beam", "pulsed-4-beam"])
def simulated(request):
    scan = load_scan(request.param, yaw_deg=15.0)
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=600, seed=11)
    return scan, brs.make_records(series, scan)


@pytest.mark.slow
class TestCoverage:
    """Against simulated records; the bounds are those of counts and variances of 600 independent ones."""

    def test_covariance_of_the_means(self, simulated):
        scan, records = simulated
        deviation = records["mean"].values - 10.0 * scan.line_of_sight[:, 0]
        covariance = brs.wind.beam_mean_covariance(scan, FLOW, wind_speed=10.0)
        square = np.einsum("rb,rb->r", deviation, np.linalg.solve(covariance, deviation.T).T)
        assert stats.kstest(square, "chi2", args=(scan.n_beam,)).pvalue > FALSE_ALARM

    @pytest.mark.parametrize("scale", ["record", "turbulence"])
    def test_intervals_of_speed_and_yaw(self, simulated, scale):
        scan, records = simulated
        found = mean_wind(records, scan, turbulence=FLOW, scale=scale)
        for name, truth in (("wind_speed", 10.0), ("yaw", 15.0)):
            distance = np.abs(found[name].values - truth) / found[f"{name}_sd"].values
            for level in (0.5, 0.9):
                inside = np.count_nonzero(distance < stats.norm.ppf(0.5 + 0.5 * level))
                bound = stats.binom.ppf([0.5 * FALSE_ALARM, 1.0 - 0.5 * FALSE_ALARM], len(distance), level)
                # a scale from the record's own variances is uncertain by a quarter: up to 2 % of the intervals
                slack = 0.02 * len(distance) if scale == "record" else 0.0
                assert bound[0] - slack <= inside <= bound[1] + slack


class TestMeasuredDay:
    def test_direction_of_the_wind(self, iea_folder):
        """The organisers: the beams look to 221.8° and 250.2°, and the wind blows from the sector 180° to 280°."""
        scan = load_scan("pulsed-4-beam")
        series = brs.read(sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv")), scan)
        found = mean_wind(brs.make_records(series, scan), scan, turbulence=FLOW, heading_deg=236.0)
        direction = found["wind_direction"].values
        assert len(direction) == 144
        assert np.all((direction > 180.0) & (direction < 280.0))
        both = np.isfinite(found["yaw_sd"].values)
        assert np.count_nonzero(both) == 136
        # neighbouring records differ by what turbulence explains, and by the weather: no less than the first alone
        step = np.diff(found["yaw"].values) / np.hypot(found["yaw_sd"].values[1:], found["yaw_sd"].values[:-1])
        assert 0.8 < np.nanstd(step) < 2.0


def test_samples_and_records_of_another_scan_are_told(caplog):
    """Whoever names a scan without its options gets numbers of other beams: every way in says so, and only then."""
    scan = brs.load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0)
    series = brs.read(brs.demo_file("6-beam-45"), scan)
    records = brs.make_records(series, scan)
    ways = [
        lambda at: brs.make_records(series, at),
        lambda at: brs.spectra.radial_spectra(series, at, records),
        lambda at: brs.wind.mean_wind(records, at),
        lambda at: brs.fit(records.isel(record=[0]), at, seed=1, sampler="direct", target_ess=100),
    ]
    for way in ways:
        way(scan)
    assert not caplog.messages
    for way in ways:
        caplog.clear()
        way("6-beam")
        assert sum("of another scan, '6-beam', than '6-beam'" in line for line in caplog.messages) == 1
    caplog.clear()
    brs.make_records(brs.read(brs.demo_file("6-beam-45"), "6-beam"), brs.load_scan("6-beam", tilt_deg=5.0))
    assert "(tilt 0° and 5°, in the samples and now)" in caplog.messages[0]


@pytest.mark.parametrize(
    ("cycle", "share", "words"),
    [
        (5.0, 1.0, "(cycle 5 s and 1 s, in the {} and now)"),
        (1.0, 0.0, "(times of single beams, in the {} and now)"),
        (2.0, 0.0, "(cycle 2 s and 1 s, in the {} and now)"),
        (1.0, 0.7, "such as the opening angle, focus distance, tilt, cycle or times of the beams)"),
    ],
)
def test_a_scan_that_differs_in_its_timing_alone_is_told_by_it(cycle, share, words, caplog):
    scan = brs.load_scan("6-beam")
    own = brs.Scan("mine", scan.beam_direction, scan.focus_distance, scan.beam_time * cycle * share, cycle)
    series = brs.simulate(own, "fu-2022", wind_speed=10.0, n_records=1, seed=1)
    for what, data in (("samples", series), ("records", brs.make_records(series, own))):
        caplog.clear()
        warn_of_other_scan(data, scan)
        assert words.format(what) in caplog.messages[0]


def test_wind_from_behind_is_doubted_unless_the_lidar_looks_downwind():
    """As velocities of the wrong sign give it."""
    scan = brs.load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0)
    series = brs.read(brs.demo_file("6-beam-45"), scan)
    records = brs.make_records(series.assign(radial_velocity=-series["radial_velocity"]), scan)
    words = (
        f"the wind comes from behind the lidar in {records.sizes['record']} of {records.sizes['record']} records, and"
    )
    options = {"seed": 1, "sampler": "direct", "target_ess": 100, "campaign": "off"}
    assert words in brs.fit(records, scan, **options).headline().doubtful
    ahead = brs.fit(brs.make_records(series, scan), scan, **options)
    assert "from behind" not in ahead.headline().doubtful
    turned = brs.load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0, yaw_deg=180.0)
    assert turned.key == scan.key
    assert "from behind" not in brs.fit(records, turned, **options).headline().doubtful
