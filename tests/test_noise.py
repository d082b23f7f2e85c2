"""Noise and its files."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from noise_checks import check_noise

from bayes_rs.errors import InputError, NoiseMismatchError, NotPositiveDefiniteError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.models import models_folder
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.flow_states import REACH
from bayes_rs.noise.noise import Noise
from bayes_rs.turbulence.mann import MannTurbulence

FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="fu-2022")
SHIPPED = {
    "staring": load_scan("staring"),
    "4-beam": load_scan("4-beam"),
    "5-beam": load_scan("5-beam"),
    "6-beam": load_scan("6-beam"),
    "50-beam": load_scan("50-beam"),
    "51-beam": load_scan("51-beam"),
    "zx-tm-point": load_scan("zx-tm@probe=point"),
    "6-beam-45deg-52m": load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0),
    "50-beam-45deg-52m": load_scan("50-beam", opening_angle_deg=45.0, focus_distance=52.0),
    "pulsed-4-beam-point": load_scan("pulsed-4-beam@probe=point"),
}

SHIPPED_BANKS = {
    name: name
    for name in ("staring", "2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam", "zx-tm", "pulsed-4-beam")
} | {f"{name}-point": f"{name}@probe=point" for name in ("zx-tm", "pulsed-4-beam")}


def make_noise(scan, *, wind_speed=10.0, yaw=0.0, **changes):
    factor = np.random.default_rng(scan.n_beam).normal(size=(scan.n_beam, 2 * scan.n_beam))
    numbers = {
        "bias": np.full(scan.n_beam, -0.1),
        "gain": design_matrix(scan),
        "covariance": 0.06 * factor @ factor.T,
        "beam": scan.beam,
        "scan_name": scan.name,
        "scan_geometry": scan.geometry(),
        "wind_speed": wind_speed,
        "yaw": yaw,
        "duration": 600.0,
        "turbulence": FLOW,
        "method": "given",
        "details": {"note": "made up", "numbers": [1, 2.5]},
    }
    return Noise(**{**numbers, **changes})


class TestEveryNoise:
    @pytest.mark.parametrize("name", ["staring", "6-beam", "pulsed-4-beam", "spinnerlidar"])
    def test_given(self, name, tmp_path):
        scan = load_scan(name)
        check_noise(make_noise(scan), scan, tmp_path)

    def test_with_standard_error_and_a_count(self, tmp_path):
        scan = load_scan("4-beam")
        check_noise(make_noise(scan, standard_error=np.full((4, 4), 0.01), n_realizations=12.5), scan, tmp_path)

    def test_one_state_may_be_given_without_its_axis(self):
        scan = load_scan("4-beam")
        one = make_noise(scan, n_realizations=12.5)
        arrays = {name: getattr(one, name) for name in ("bias", "gain", "covariance", "wind_speed", "yaw")}
        assert make_noise(scan, **arrays, n_realizations=[12.5]).to_dataset().identical(one.to_dataset())

    def test_of_one_turbulence_a_records_own_has_no_influence_but_on_its_reach(self):
        noise = make_noise(load_scan("4-beam"))
        own = noise.for_records([10.0, 10.0, 10.0], 0.0, length_scale=[30.0, 62.0, np.nan], gamma=3.2)
        plain = noise.for_records([10.0, 10.0, 10.0], 0.0)
        for name in ("bias", "gain", "covariance", "wind_speed", "yaw"):
            np.testing.assert_array_equal(getattr(own, name), getattr(plain, name))
        assert own.outside.tolist() == [True, False, False]
        assert noise.for_records([10.0, 10.0], 0.0, gamma=[3.3, 3.4]).outside.tolist() == [False, True]

    def test_bank(self, tmp_path):
        scan = load_scan("4-beam")
        bank = Noise.join(tuple(make_noise(scan, wind_speed=u, yaw=y) for u in (5.0, 10.0) for y in (-0.3, 0.3)))
        check_noise(bank, scan, tmp_path)

    @pytest.mark.parametrize("name", SHIPPED)
    def test_shipped(self, name, tmp_path):
        noise = load_noise(models_folder("noise") / f"{name}.nc")
        check_noise(noise, SHIPPED[name], tmp_path)
        assert noise.method == "boxes"
        assert noise.duration == 600.0
        assert noise.details["n_boxes"] >= 150
        np.testing.assert_allclose(noise.gain, design_matrix(SHIPPED[name].at_yaw(noise.yaw)), atol=1e-15)
        assert np.all(noise.bias < 0.0)
        assert np.all(np.linalg.eigvalsh(noise.covariance) > 0.0)
        for index in range(len(noise)):
            assert noise.state(index).details["mean_deviation_sigmas"] < 5.0

    @pytest.mark.parametrize("name", SHIPPED_BANKS)
    def test_shipped_bank_by_theory(self, name, tmp_path):
        file = models_folder("noise") / f"{name}-theory.nc"
        bank, scan = load_noise(file), load_scan(SHIPPED_BANKS[name])
        check_noise(bank, scan, tmp_path)
        assert bank.method == "theory"
        assert bank.interpolation_error < 0.01
        assert bank.details["interpolation_error_beams"] == scan.n_beam
        assert (bank.wind_speed.min(), bank.wind_speed.max()) == (2.5, 40.0)
        np.testing.assert_allclose(np.rad2deg([bank.yaw.min(), bank.yaw.max()]), [-60.0, 60.0])
        assert file.stat().st_size < 300_000

    def test_everything_shipped_is_tested(self):
        banks = {f"{name}-theory" for name in SHIPPED_BANKS}
        assert {file.stem for file in models_folder("noise").glob("*.nc")} == set(SHIPPED) | banks


class TestShippedNumbers:
    @pytest.mark.parametrize(
        ("file", "name", "fingerprint"),
        [
            ("6-beam", "covariance", "45bec518c3fe1a27"),
            ("6-beam", "standard_error", "aee3d598b09f1473"),
            ("pulsed-4-beam-point", "covariance", "3b8d4c08a1f91485"),
            ("6-beam-theory", "covariance", "d6694eccb213e8e7"),
            ("zx-tm-theory", "bias", "4041fe32251214c8"),
        ],
    )
    def test_arrays_are_those_of_version_0_1_0(self, file, name, fingerprint):
        """Bit by bit: compared with what 0.1.0 read when the two classes for noise became one."""
        values = getattr(load_noise(models_folder("noise") / f"{file}.nc"), name)
        assert hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16] == fingerprint

    def test_relative_error_of_the_along_wind_variance_is_about_a_quarter(self):
        noise = load_noise(models_folder("noise") / "staring.nc")
        spread = float(noise.relative_error[0, 0])
        error = float(noise.standard_error[0, 0, 0]) / (2.0 * spread)
        # 0.2658 is what the boxes' spectrum gives by the formula of Isserlis, 0.2585 an infinite domain's;
        # the rest is Monte Carlo, four standard errors
        assert spread == pytest.approx(0.2658, abs=4.0 * error)
        assert error < 0.01

    def test_errors_of_neighbouring_beams_are_strongly_correlated(self):
        correlation = load_noise(models_folder("noise") / "4-beam.nc").correlation[0]
        pairs = correlation[np.triu_indices(4, k=1)]
        assert pairs.min() > 0.3
        assert pairs.max() < 0.98
        close = load_noise(models_folder("noise") / "50-beam.nc").correlation[0]
        assert np.diagonal(close, offset=1).min() > 0.95  # 3.2 m apart

    def test_mirror_images_have_the_same_noise(self):
        noise = load_noise(
            models_folder("noise") / "4-beam.nc"
        )  # beams at 45°, 135°, 225°, 315°: y → −y swaps 0,1 and 2,3
        swap = [1, 0, 3, 2]
        gap = np.abs(noise.covariance - noise.covariance[:, swap][:, :, swap])
        assert np.all(gap < 5.0 * np.sqrt(2.0) * noise.standard_error + 1e-12)

    def test_lighter_wind_is_noisier(self):
        bank = load_noise(models_folder("noise") / "pulsed-4-beam-point.nc")
        ahead = np.flatnonzero(bank.yaw == 0.0)
        error = bank.relative_error[ahead].mean(axis=1)
        assert np.all(np.diff(error[np.argsort(bank.wind_speed[ahead])]) < 0.0)

    def test_half_the_wind_speed_is_nearly_the_root_of_two_in_noise(self):
        bank = load_noise(models_folder("noise") / "pulsed-4-beam-point.nc")
        slow, fast = (
            bank.relative_error[(bank.yaw == 0.0) & (bank.wind_speed == speed)].mean() for speed in (4.5, 14.0)
        )
        assert 1.3 < slow / fast < np.sqrt(14.0 / 4.5)  # records long against the eddies reach the root from below


class TestBank:
    def make_bank(self):
        """Four states in the corners of a net and one more, so that they form none."""
        scan = load_scan("4-beam")
        states = [(4.0, -0.5), (4.0, 0.5), (9.0, -0.5), (9.0, 0.5), (80.0, 0.2)]
        return Noise.join(tuple(make_noise(scan, wind_speed=u, yaw=y) for u, y in states))

    @pytest.mark.parametrize(
        ("wind_speed", "yaw", "state"),
        [(1.0, -3.0, 0), (5.9, 0.01, 1), (6.1, -0.01, 2), (25.0, 1.0, 3), (9.0, 0.5 + 2.0 * np.pi, 3)],
    )
    def test_nearest_in_logarithm_of_speed_and_in_yaw(self, wind_speed, yaw, state):
        noise = self.make_bank().for_records([wind_speed], [yaw])  # √(4 · 9) = 6 is half way in ln U
        assert noise.state.tolist() == [state]

    def test_every_array_is_that_of_the_nearest_state(self):
        bank, number = self.make_bank(), np.arange(5.0)
        bank = replace(
            bank, bias=bank.bias + 0.01 * number[:, None], covariance=bank.covariance * (number[:, None, None] + 1.0)
        )
        noise = bank.for_records([9.0, 4.0, 9.0], [0.5, 0.5, -0.5])
        for record, state in enumerate((3, 1, 2)):
            np.testing.assert_array_equal(noise.bias[record], bank.bias[state])
            np.testing.assert_array_equal(noise.covariance[record], bank.covariance[state])

    def test_what_is_outside_is_marked(self):
        """The distance to the nearest state counts, also between the states."""
        noise = self.make_bank().for_records([3.9, 3.0, 120.0, 9.0, 9.0, 6.0], [0.5, 0.5, 0.2, 0.53, 0.6, 0.0])
        assert noise.outside.tolist() == [False, True, True, False, True, True]

    def test_scalars_are_broadcast(self):
        assert self.make_bank().for_records([4.0, 9.0, 9.0], 0.5).state.tolist() == [1, 3, 3]

    def test_wind_speed_that_is_not_positive(self):
        with pytest.raises(InputError, match=r"Invalid wind_speed 0 m/s of record 1: it must be above zero\."):
            self.make_bank().for_records([4.0, 0.0], 0.0)

    def test_not_a_number(self):
        with pytest.raises(InputError, match="yaw of the records: the entry at \\(0,\\) is nan"):
            self.make_bank().for_records([4.0], [np.nan])

    def test_models_of_different_scans(self):
        with pytest.raises(InputError, match="can be joined if it is of one scan: the beams are"):
            Noise.join((make_noise(load_scan("4-beam")), make_noise(load_scan("5-beam"))))

    def test_models_of_different_record_lengths(self):
        scan = load_scan("4-beam")
        with pytest.raises(InputError, match=r"of one record length, dissipation and method: 600 s, .*; and 1800 s"):
            Noise.join((make_noise(scan), make_noise(scan, duration=1800.0)))

    def test_no_model(self):
        with pytest.raises(InputError, match="There is no noise to join"):
            Noise.join(())


class TestReach:
    """How far from its states noise may be used: a step away, intervals are 5 % too narrow or too wide."""

    def test_noise_of_16_metres_per_second_is_not_for_4(self):
        scan = load_scan("6-beam")
        noise, own = (theory_noise(scan, FLOW, wind_speed=speed) for speed in (16.0, 4.0))
        used = noise.for_records([4.0, 15.0], 0.0)
        assert used.outside.tolist() == [True, False]
        assert np.all(own.relative_error[0] > 1.4 * np.sqrt(np.diagonal(used.covariance[0])))  # what it would hide

    @pytest.mark.parametrize("name", ["6-beam", "6-beam@opening_angle_deg=45", "zx-tm"])
    @pytest.mark.parametrize("axis", range(4))
    def test_a_step_changes_the_width_of_an_interval_by_5_percent_at_most(self, name, axis):
        scan = load_scan(name)
        scan = scan.select(scan.beam[:: max(scan.n_beam // 6, 1)])
        state = np.array([np.log(10.0), np.deg2rad(20.0), np.log(FLOW.length_scale), FLOW.gamma])
        spread = []
        for sign in (-1.0, 0.0, 1.0):
            u, yaw, scale, gamma = state + sign * np.eye(4)[axis] * REACH[axis]
            flow = replace(FLOW, length_scale=float(np.exp(scale)), gamma=float(gamma))
            spread.append(theory_noise(scan, flow, wind_speed=float(np.exp(u)), yaw=float(yaw)).relative_error[0])
        error = np.abs(np.stack(spread) / spread[1] - 1.0).max()
        assert 0.02 < error < 0.055  # not needlessly careful, either

    def test_distances_add_up(self):
        noise = make_noise(load_scan("4-beam"))
        step = 10.0 * np.exp(np.array([0.99, 0.5, 0.5]) * REACH[0])
        assert noise.for_records(step, [0.0, 0.49 * REACH[1], 0.51 * REACH[1]]).outside.tolist() == [False, False, True]
        assert noise.for_records([10.0], 2.0 * np.pi).outside.tolist() == [False]


class TestNet:
    """States that form a net are interpolated."""

    speeds, yaws = (4.0, 8.0, 16.0), (-0.4, 0.0, 0.4)

    def bank(self, power=1.0, order=None, **changes):
        scan = load_scan("4-beam")
        base = make_noise(scan)
        models = [
            replace(
                base,
                covariance=base.covariance * (10.0 / u) ** power,
                gain=design_matrix(scan.at_yaw(y)),
                wind_speed=u,
                yaw=y,
                **changes,
            )
            for u in self.speeds
            for y in self.yaws
        ]
        return Noise.join(tuple(models[i] for i in (range(9) if order is None else order)))

    def test_a_power_of_the_wind_speed_is_followed_exactly(self):
        speeds = np.geomspace(4.0, 16.0, 7)
        noise = self.bank(power=1.3).for_records(speeds, 0.17)
        want = make_noise(load_scan("4-beam")).covariance * (10.0 / speeds[:, None, None]) ** 1.3
        np.testing.assert_allclose(noise.covariance, want, rtol=1e-12)
        np.testing.assert_allclose(noise.wind_speed, speeds, rtol=1e-14)
        assert len(set(noise.state.tolist())) == 7

    def test_order_of_the_states_does_not_matter(self):
        mixed = np.random.default_rng(1).permutation(9)
        one, other = (bank.for_records([5.0, 11.0], [0.1, -0.3]) for bank in (self.bank(), self.bank(order=mixed)))
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-13)

    def test_a_net_without_one_state_is_none(self):
        assert self.bank().net is not None
        assert self.bank(order=range(8)).net is None

    def test_records_of_one_wind_speed_differ_by_their_direction(self):
        bank = self.bank()
        turned = replace(bank, covariance=bank.covariance * (1.0 + bank.yaw[:, None, None]))
        noise = turned.for_records([8.0, 8.0], [-0.4, 0.4])
        np.testing.assert_allclose(noise.covariance[1], noise.covariance[0] * 1.4 / 0.6, rtol=1e-12)
        assert noise.state[0] != noise.state[1]

    def test_records_do_not_depend_on_each_other(self):
        together = self.bank().for_records([5.0, 7.0, 7.0, 11.0], [0.1, 0.2, 0.2, -0.3])
        alone = self.bank().for_records([7.0], [0.2])
        for name in ("bias", "gain", "covariance", "wind_speed", "yaw"):
            np.testing.assert_array_equal(getattr(together, name)[1], getattr(alone, name)[0])
        assert together.state[1] == together.state[2] != together.state[0]

    def test_outside_is_the_edge_and_is_marked(self):
        noise = self.bank().for_records([1.0, 8.0, 3.9, 8.0], [0.0, 2.0, 0.0, 0.41])
        edge = self.bank().for_records([4.0, 8.0, 4.0, 8.0], [0.0, 0.4, 0.0, 0.4])
        np.testing.assert_array_equal(noise.covariance, edge.covariance)
        assert noise.outside.tolist() == [True, True, False, False]
        np.testing.assert_allclose(noise.wind_speed, [4.0, 8.0, 4.0, 8.0])
        speed, yaw, outside = self.bank().locate([1.0, 8.0, 3.9, 8.0], [0.0, 2.0, 0.0, 0.41])
        np.testing.assert_array_equal(speed, noise.wind_speed)
        np.testing.assert_array_equal(yaw, noise.yaw)
        np.testing.assert_array_equal(outside, noise.outside)

    def test_gain_is_at_the_records_own_yaw_even_outside(self):
        scan = load_scan("4-beam")
        noise = self.bank().for_records([5.0, 5.0], [0.123, 1.1])
        want = design_matrix(scan.at_yaw(np.array([0.123, 1.1])))
        np.testing.assert_allclose(noise.gain, want, atol=1e-8)  # directions of a geometry are rounded to 1e-9

    def test_what_the_probe_takes_is_interpolated(self):
        scan = load_scan("4-beam")
        bank = Noise.join(
            tuple(
                make_noise(scan, wind_speed=u, yaw=0.0, gain=design_matrix(scan.at_yaw(0.0)) * (1.0 - change))
                for u, change in ((5.0, 0.1), (10.0, 0.3))
            )
        )
        noise = bank.for_records([np.sqrt(50.0)], [0.0])
        np.testing.assert_allclose(noise.gain[0], 0.8 * design_matrix(scan), atol=1e-8)

    def test_positive_semidefinite_between_singular_matrices(self):
        """Rank one at each of five states, turning from state to state: third order leaves negative eigenvalues."""
        scan = load_scan("4-beam")
        vectors = [np.cos(turn + np.arange(4.0)) for turn in (0.0, 1.1, 2.5, 2.9, 4.0)]
        bank = Noise.join(
            tuple(make_noise(scan, wind_speed=2.0 ** (i + 1), covariance=np.outer(v, v)) for i, v in enumerate(vectors))
        )
        noise = bank.for_records(np.geomspace(2.0, 32.0, 41), 0.0)
        eigenvalues = np.linalg.eigvalsh(noise.covariance)
        assert np.all(eigenvalues[:, 0] > -1e-14 * eigenvalues[:, -1])
        assert noise.negative_part.max() > 0.01  # there was something to take away, and it is told
        assert noise.negative_part[0] == 0.0

    def test_several_turbulences_need_a_net_and_are_asked_for(self, tmp_path):
        scan = load_scan("4-beam")
        models = [
            make_noise(
                scan,
                wind_speed=u,
                bias=np.full(4, -0.001 * scale),
                turbulence=replace(FLOW, length_scale=scale, gamma=gamma),
            )
            for u in (5.0, 10.0)
            for scale in (30.0, 60.0)
            for gamma in (2.0, 3.0)
        ]
        bank = Noise.join(tuple(models))
        noise = bank.for_records([7.0], [0.0], length_scale=[np.sqrt(1800.0)], gamma=[2.5])
        np.testing.assert_allclose(noise.bias, -0.045)
        one = bank.at_turbulence(np.sqrt(1800.0), 2.5)
        assert len(one) == 2
        assert (one.turbulence.length_scale, one.turbulence.gamma) == (np.sqrt(1800.0), 2.5)
        np.testing.assert_allclose(one.for_records([7.0], [0.0]).bias, -0.045)
        with pytest.raises(InputError, match="spans length_scale 30 to 60: give the length_scale of the records"):
            bank.for_records([7.0], [0.0])
        with pytest.raises(InputError, match="3 turbulences and form no net; only a net"):
            Noise.join(tuple(models[:3]))
        with pytest.raises(InputError, match="form no net, so nothing can be interpolated"):
            TestBank().make_bank().at_turbulence(61.0, 3.2)
        bank.save(tmp_path / "bank.nc")
        again = load_noise(tmp_path / "bank.nc")
        assert again.to_dataset().identical(bank.to_dataset())
        assert again.length_scale.tolist() == [30.0, 30.0, 60.0, 60.0] * 2

    def test_single_precision(self, tmp_path):
        scan = load_scan("50-beam")
        root = np.random.default_rng(3).normal(size=(50, 3))  # rank 3: rounding makes eigenvalues negative
        bank = Noise.join(
            tuple(
                make_noise(scan, wind_speed=u, covariance=root @ root.T / u, gain=1.01 * design_matrix(scan))
                for u in (5.0, 10.0)
            )
        )
        bank.save(tmp_path / "double.nc")
        bank.save(tmp_path / "single.nc", single_precision=True)
        assert (tmp_path / "single.nc").stat().st_size < 0.6 * (tmp_path / "double.nc").stat().st_size
        again = load_noise(tmp_path / "single.nc")
        for have, want in zip(again.covariance, bank.covariance, strict=True):
            np.testing.assert_allclose(have, want, atol=1e-7 * np.abs(want).max())
        np.testing.assert_allclose(again.gain, bank.gain, atol=1e-7)
        np.testing.assert_allclose(again.bias, bank.bias, rtol=1e-7)


class TestWrongScan:
    def differs(self, message, **change):
        scan = load_scan("6-beam")
        other = replace(scan, name="other", **change)
        with pytest.raises(NoiseMismatchError, match=message) as caught:
            make_noise(scan).check_scan(other)
        assert str(caught.value).startswith("The noise of scan '6-beam' was not made for scan 'other': ")
        assert "Run calibrate for this scan" in str(caught.value)
        assert caught.value.difference

    def test_beams(self):
        self.differs(r"the beams are \[0, 1, 2, 3, 4, 5\] in the noise and \[1", beam=np.arange(6) + 1)

    def test_direction(self):
        tilted = load_scan("6-beam", opening_angle_deg=15.01).beam_direction
        self.differs(r"the direction of beam 0 is \(-0\.9659, 0\.0000, 0\.2588\)", beam_direction=tilted)

    def test_tilt(self):
        self.differs("the direction of beam 0", tilt=0.01)

    def test_focus_distance(self):
        self.differs(
            "the focus distance of beam 0 is 98 m in the noise and 52 m in the scan",
            focus_distance=np.full(6, 52.0),
        )

    def test_timing(self):
        self.differs("the time within the scan of beam 1 is 0.166667 s", beam_time=np.zeros(6))

    def test_scan_duration(self):
        self.differs("the scan takes 1 s in the noise and 2 s in the scan", scan_duration=2.0)

    def test_another_name_is_no_difference(self):
        scan = load_scan("6-beam")
        make_noise(scan).check_scan(replace(scan, name="my lidar"))

    def test_rounding_is_no_difference(self):
        scan = load_scan("6-beam")
        make_noise(scan).check_scan(replace(scan, focus_distance=scan.focus_distance + 3e-9))


class TestInvalidNumbers:
    def test_asymmetric_covariance(self):
        scan = load_scan("2-beam")
        with pytest.raises(InputError, match=r"the entry at \(0, 1\) is 0\.1 and its mirror image is 0\.2"):
            make_noise(scan, covariance=[[1.0, 0.1], [0.2, 1.0]])

    def test_negative_eigenvalue(self):
        with pytest.raises(NotPositiveDefiniteError, match="its smallest eigenvalue is -1, and") as caught:
            make_noise(load_scan("2-beam"), covariance=[[1.0, 2.0], [2.0, 1.0]])
        assert caught.value.smallest_eigenvalue == pytest.approx(-1.0)

    def test_singular_covariance_is_accepted(self):
        assert make_noise(load_scan("2-beam"), covariance=np.full((2, 2), 0.06)).covariance[0, 0, 1] == 0.06

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"bias": [0.0]}, r"Invalid bias in noise of scan '2-beam' of shape \(1,\): the shape must be \(2\)"),
            ({"gain": np.ones((2, 5))}, r"gain .*the shape must be \(2, 6\)"),
            ({"covariance": np.full((2, 2), np.nan)}, r"covariance .*the entry at \(0, 0\) is nan"),
            ({"standard_error": np.ones(2)}, "standard_error"),
            ({"beam": [0, 5]}, r"Invalid beam \[0, 5\] .*its scan_geometry has the beams \[0, 1\]"),
            ({"beam": []}, "at least one"),
            ({"scan_geometry": {"beam": [0, 1]}}, "'direction' is missing; take it from Scan.geometry"),
            ({"wind_speed": 0.0}, "Invalid wind_speed 0.0 m/s"),
            ({"yaw": np.inf}, "Invalid yaw in noise of scan '2-beam': the entry at .* is inf"),
            ({"duration": -1.0}, "Invalid duration -1.0 s"),
            ({"method": "guess"}, "Unknown method of a noise 'guess': it must be one of boxes, theory, given"),
            ({"n_realizations": 0.0}, "Invalid n_realizations 0.0"),
            ({"length_scale": 30.0}, "Invalid turbulence .*: its length_scale is 61 and that of the first state is 30"),
            ({"state_details": [{}, {}]}, "Invalid state_details .*: 2 for 1 states; give one for each"),
            ({"wind_speed": [8.0, 9.0]}, "Invalid bias"),
            ({"details": {"x": object()}}, "details .* must be plain JSON values"),
        ],
    )
    def test_message(self, change, message):
        with pytest.raises(InputError, match=message):
            make_noise(load_scan("2-beam"), **change)


class TestFiles:
    def test_missing_file(self, tmp_path):
        with pytest.raises(InputError, match=r"No noise file .*none\.nc'"):
            load_noise(tmp_path / "none.nc")

    @pytest.mark.parametrize("content", [b"", b"this is no NetCDF file"])
    def test_something_else(self, content, tmp_path):
        (tmp_path / "bad.nc").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as NetCDF") as caught:
            load_noise(tmp_path / "bad.nc")
        assert "\n" not in str(caught.value)

    def test_half_a_file(self, tmp_path):
        make_noise(load_scan("6-beam")).save(tmp_path / "whole.nc")
        content = (tmp_path / "whole.nc").read_bytes()
        (tmp_path / "half.nc").write_bytes(content[: len(content) // 2])
        with pytest.raises(InputError, match=r"cannot be read as NetCDF: .*truncated.*; check that it is complete"):
            load_noise(tmp_path / "half.nc")

    def test_another_netcdf_file(self, tmp_path):
        xr.Dataset({"a": 1.0}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
        with pytest.raises(InputError, match="is not a noise file of bayes_rs: make one with calibrate"):
            load_noise(tmp_path / "other.nc")

    def change(self, tmp_path, edit):
        edit(make_noise(load_scan("6-beam")).to_dataset()).to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
        return tmp_path / "changed.nc"

    def test_future_format(self, tmp_path):
        file = self.change(tmp_path, lambda data: data.assign_attrs(format_version=99))
        with pytest.raises(InputError, match="has format version 99 and this program reads 1"):
            load_noise(file)

    def test_missing_variable(self, tmp_path):
        file = self.change(tmp_path, lambda data: data.drop_vars("covariance"))
        with pytest.raises(
            InputError, match=r"is damaged: Its arrays have no covariance with dims .*: calibrate again"
        ):
            load_noise(file)

    def test_changed_numbers(self, tmp_path):
        file = self.change(tmp_path, lambda data: data.assign(covariance=-data["covariance"]))
        with pytest.raises(InputError, match=r"is damaged: .*its smallest eigenvalue is"):
            load_noise(file)

    def test_details_that_are_no_json(self, tmp_path):
        file = self.change(tmp_path, lambda data: data.assign_attrs(details="{"))
        with pytest.raises(
            InputError, match=r"is damaged: Its arrays cannot be used: details = '\{': .*; calibrate again"
        ):
            load_noise(file)

    def test_existing_file_is_not_overwritten(self, tmp_path):
        noise = make_noise(load_scan("2-beam"))
        file = tmp_path / "noise.nc"
        file.write_bytes(b"mine")
        with pytest.raises(InputError, match="exists: give another name, or overwrite=True"):
            noise.save(file)
        assert file.read_bytes() == b"mine"
        noise.save(file, overwrite=True)
        assert load_noise(file).scan_name == "2-beam"

    def test_missing_folder(self, tmp_path):
        with pytest.raises(InputError, match=r"Cannot write .*give a folder that exists and can be written"):
            make_noise(load_scan("2-beam")).save(tmp_path / "none" / "noise.nc")

    def test_nothing_is_left_behind_by_a_failed_write(self, tmp_path, monkeypatch):
        monkeypatch.setattr(xr.Dataset, "to_netcdf", _full_disk)
        with pytest.raises(InputError, match=r"Cannot write .*No space left on device"):
            make_noise(load_scan("2-beam")).save(tmp_path / "noise.nc")
        assert list(tmp_path.iterdir()) == []

    def test_many_beams_fit_into_a_file(self, tmp_path):
        beams = 2000  # a NetCDF attribute holds 64 kB at most: the geometry must not be one
        scan = Scan("many", np.tile([[-1.0, 0.0, 0.0]], (beams, 1)), np.full(beams, 98.0), np.zeros(beams), 1.0)
        noise = make_noise(load_scan("2-beam"))
        noise = replace(
            noise,
            bias=np.zeros(beams),
            gain=design_matrix(scan),
            covariance=np.eye(beams),
            beam=scan.beam,
            scan_geometry=scan.geometry(),
        )
        noise.save(tmp_path / "many.nc")
        load_noise(tmp_path / "many.nc").check_scan(scan)


def _full_disk(*_args, **_kwargs):
    raise OSError(28, "No space left on device")
