"""Nets by theory: their stated errors, their cache, and which noise records get from them."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scenes import records_of

from bayes_rs.errors import InputError
from bayes_rs.fits import parts
from bayes_rs.fits.fitting import fit
from bayes_rs.geometry.probe import ContinuousWaveProbe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise import at_states, net
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.choice import noise_for_records
from bayes_rs.noise.net import measure_interpolation, refined_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.store import find_shipped_noise
from bayes_rs.turbulence.interpolation import combine, find_net, interpolate_covariance, nearest_semidefinite
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence

FLOW = load_turbulence("fu-2022")
FREE = {"wind_speed": [4.0, 18.0], "yaw_deg": [-25.0, 33.0], "cache": False}


@pytest.fixture
def no_theory(monkeypatch):
    def fail(*_arguments, **_options):
        raise AssertionError("noise was calculated")

    monkeypatch.setattr(at_states, "theory_noise", fail)


def relative_distance(have, want):
    return np.linalg.norm(have - want, axis=(-2, -1)) / np.linalg.norm(want, axis=(-2, -1))


def measured_error(noise, scan):
    """The largest relative error of K in the middle of every cell of a net over wind speed and direction."""
    speeds, yaws = np.log(np.unique(noise.wind_speed)), np.unique(noise.yaw)
    middles = [(ends[1:] + ends[:-1]) / 2.0 if len(ends) > 1 else ends for ends in (speeds, yaws)]
    points = [(np.exp(speed), yaw) for speed in middles[0] for yaw in middles[1]]
    truth = [theory_noise(scan, FLOW, wind_speed=speed, yaw=yaw).covariance for speed, yaw in points]
    return np.max(relative_distance(noise.for_records(*np.transpose(points)).covariance, np.concatenate(truth)))


class TestStatedError:
    @pytest.mark.parametrize("name", ["6-beam", "pulsed-4-beam"])
    def test_holds_at_random_states(self, name):
        scan = load_scan(name)
        bank = refined_noise(scan, FLOW, **FREE)
        assert bank.interpolation_error <= 0.01
        rng = np.random.default_rng(2)
        speed, yaw = np.exp(rng.uniform(np.log(4.0), np.log(18.0), 25)), np.deg2rad(rng.uniform(-25.0, 33.0, 25))
        noise = bank.for_records(speed, yaw)
        truth = [theory_noise(scan, FLOW, wind_speed=u, yaw=y) for u, y in zip(speed, yaw, strict=True)]
        error = relative_distance(noise.covariance, np.concatenate([one.covariance for one in truth]))
        # the error is measured in the middle of the cells, which need not be the very worst place of one
        assert np.max(error) < 1.2 * bank.interpolation_error
        assert np.max(error) > 0.1 * bank.interpolation_error
        np.testing.assert_allclose(noise.bias, [one.bias[0] for one in truth], atol=2e-3)
        # the design matrix is exact at every yaw; what a probe changes in it, up to a fifth, is interpolated over 20°
        exact = not load_scan(name).probe.parameters()
        np.testing.assert_allclose(noise.gain, [one.gain[0] for one in truth], atol=1e-8 if exact else 5e-3)

    def test_some_beams_stand_for_all(self):
        scan = load_scan("51-beam").select(np.arange(0, 50, 2))
        bank = refined_noise(scan, FLOW, wind_speed=[5.0, 10.0], yaw_deg=[0.0, 20.0], error_beams=5, cache=False)
        assert bank.details["interpolation_error_beams"] == 5
        assert measured_error(bank, scan) == pytest.approx(bank.interpolation_error, rel=0.5)

    def test_the_net_is_refined_until_it_is_good_enough(self):
        coarse, fine = (refined_noise(load_scan("staring"), FLOW, **FREE, tolerance=t) for t in (0.05, 3e-4))
        assert 3e-4 < coarse.interpolation_error <= 0.05
        assert fine.interpolation_error <= 3e-4
        assert len(fine) > len(coarse)
        kept, all_of_them = (
            set(zip(noise.wind_speed.tolist(), noise.yaw.round(9).tolist(), strict=True)) for noise in (coarse, fine)
        )
        assert kept < all_of_them
        for measured in (measured_error, measure_interpolation):
            assert measured(fine, load_scan("staring")) == pytest.approx(fine.interpolation_error)

    def test_a_limit_of_states_is_told_by_the_error(self, monkeypatch):
        monkeypatch.setattr(net, "_MOST_STATES", 20)
        bank = refined_noise(load_scan("staring"), FLOW, **FREE, tolerance=1e-6)
        assert len(bank) <= 20
        assert bank.interpolation_error > 1e-6

    def test_ranges_without_extent_are_one_node(self):
        bank = refined_noise(load_scan("staring"), FLOW, wind_speed=[7.3, 7.3], yaw_deg=[-10.0, 10.0], cache=False)
        assert np.unique(bank.wind_speed).tolist() == [7.3]
        one = refined_noise(load_scan("staring"), FLOW, wind_speed=[7.3], cache=False)
        assert len(one) == 1
        assert measured_error(refined_noise(load_scan("2-beam"), FLOW, **FREE), load_scan("2-beam")) <= 0.01

    def test_one_length_scale_that_is_not_the_turbulences_own(self, tmp_path):
        scan, other = load_scan("staring"), replace(FLOW, length_scale=13.9)
        for _ in range(2):  # calculated, and from the cache
            bank = refined_noise(scan, FLOW, wind_speed=[8.0, 9.0], length_scale=[13.9], cache=tmp_path)
            assert set(bank.length_scale.tolist()) == {13.9}
        expected = refined_noise(scan, other, wind_speed=[8.0, 9.0], cache=False)
        np.testing.assert_array_equal(bank.covariance, expected.covariance)

    def test_length_scale_and_anisotropy_are_axes_too(self):
        scan = load_scan("2-beam")
        bank = refined_noise(
            scan, FLOW, wind_speed=[9.0], length_scale=[35.0, 70.0], gamma=[3.1, 3.9], tolerance=0.02, cache=False
        )
        assert bank.interpolation_error <= 0.02
        noise = bank.for_records([9.0], [scan.yaw], length_scale=[50.0], gamma=[3.5])
        truth = theory_noise(scan, replace(FLOW, length_scale=50.0, gamma=3.5), wind_speed=9.0)
        assert relative_distance(noise.covariance[0], truth.covariance[0]) < 1.2 * bank.interpolation_error

    def test_a_probe_is_interpolated(self):
        scan = replace(load_scan("2-beam"), probe=ContinuousWaveProbe(rayleigh_length=6.1))
        bank = refined_noise(scan, FLOW, wind_speed=[8.0, 14.0], yaw_deg=[0.0, 20.0], duration=120.0, cache=False)
        noise = bank.for_records([11.0], np.deg2rad([9.0]))
        truth = theory_noise(scan, FLOW, wind_speed=11.0, yaw=np.deg2rad(9.0), duration=120.0)
        assert relative_distance(noise.covariance[0], truth.covariance[0]) < 0.012
        np.testing.assert_allclose(noise.gain[0], truth.gain[0], atol=2e-3)
        assert np.max(noise.gain[0, :, 0] / load_scan("2-beam").line_of_sight[:, 0] ** 2) < 1.0

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"wind_speed": []}, "Invalid wind_speed"),
            ({"wind_speed": [0.0, 5.0]}, "Invalid wind_speed .*numbers above zero"),
            ({"yaw_deg": [np.nan]}, "Invalid yaw_deg: the entry at"),
            ({"tolerance": 0.0}, "Invalid tolerance"),
        ],
    )
    def test_message(self, change, message):
        with pytest.raises(InputError, match=message):
            refined_noise(load_scan("staring"), FLOW, **{**FREE, **change})

    def test_states_without_a_net_cannot_be_measured(self):
        one = theory_noise(load_scan("staring"), FLOW, wind_speed=9.0)
        with pytest.raises(InputError, match="form no net"):
            measure_interpolation(one, load_scan("staring"))


class TestCache:
    def make(self, folder, **changes):
        options = {**FREE, "cache": folder, **changes}
        scan = options.pop("scan", load_scan("2-beam"))
        return refined_noise(scan, options.pop("turbulence", FLOW), **options)

    @pytest.mark.usefixtures("no_theory")
    def test_second_time_nothing_is_calculated(self, tmp_path, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(at_states, "theory_noise", theory_noise)
            first = self.make(tmp_path)
        assert self.make(tmp_path).to_dataset().identical(first.to_dataset())
        # the nodes do not move with the records: another day in the same cells
        assert self.make(tmp_path, wind_speed=[3.0, 15.0], yaw_deg=[-30.0, 25.0]).interpolation_error < 0.01

    @pytest.mark.parametrize(
        "changes",
        [
            {"wind_speed": [4.0, 21.0]},
            {"yaw_deg": [-25.0, 45.0]},
            {"duration": 1800.0},
            {"tolerance": 0.02},
            {"error_beams": 1},
            {"turbulence": replace(FLOW, gamma=3.3)},
            {"turbulence": replace(FLOW, length_scale=62.0)},
            {"length_scale": [60.0, 61.0]},
            {"scan": load_scan("2-beam", focus_distance=99.0)},
        ],
    )
    @pytest.mark.usefixtures("no_theory")
    def test_anything_else_is_calculated(self, tmp_path, changes, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(at_states, "theory_noise", theory_noise)
            self.make(tmp_path)
        with pytest.raises(AssertionError, match="noise was calculated"):
            self.make(tmp_path, **changes)

    def test_a_damaged_file_is_calculated_again(self, tmp_path):
        first = self.make(tmp_path)
        next(tmp_path.glob("*.nc")).write_bytes(b"damaged")
        assert self.make(tmp_path).to_dataset().identical(first.to_dataset())


class TestForRecords:
    def records(self, wind_speed, yaw, duration=600.0):
        return xr.Dataset({"wind_speed": ("record", wind_speed), "yaw": ("record", yaw)}, attrs={"duration": duration})

    @pytest.mark.usefixtures("no_theory")
    def test_shipped(self):
        records = self.records([4.0, 9.0, np.nan, 24.0], [-50.0, 0.0, 0.0, 33.0])
        noise = noise_for_records(records, load_scan("6-beam"), FLOW)
        assert noise.in_words(records["wind_speed"], np.deg2rad(records["yaw"])) == (
            "noise: shipped, fu-2022, method theory, 35 states (2.5 to 40 m/s, yaw -60 to 60°, L 61 m); "
            "interpolated, with an error of at most 0.72 %"
        )

    def test_the_error_that_is_told_is_that_where_records_are(self, tmp_path):
        scan = load_scan("staring")
        flow = {"length_scale": [15.0, 150.0], "wind_speed": [6.0, 24.0], "yaw_deg": [0.0, 0.0]}
        noise = refined_noise(scan, FLOW, **flow, tolerance=0.05, cache=tmp_path)
        errors = np.array(noise.details["interpolation_errors"])
        sizes = [max(len(axis) - 1, 1) for axis in noise.net.axes]
        assert errors.shape == (np.prod(sizes),)
        assert errors.max() == pytest.approx(noise.interpolation_error, rel=0.01)  # three digits are kept
        # the middle of the cell that holds U = 10.5 m/s and L = 100 m, by theory alone
        speeds, lengths = np.exp(noise.net.axes[0]), np.exp(noise.net.axes[2])
        at, of = np.searchsorted(speeds, 10.5) - 1, np.searchsorted(lengths, 100.0) - 1
        speed, length = (np.sqrt(axis[i] * axis[i + 1]) for axis, i in ((speeds, at), (lengths, of)))
        truth = theory_noise(scan, replace(FLOW, length_scale=length), wind_speed=speed, yaw=0.0)
        between = noise.for_records([speed], [0.0], length_scale=[length])
        own = relative_distance(between.covariance, truth.covariance)[0]
        assert own < 0.5 * noise.interpolation_error
        words = noise.in_words([10.5, np.nan], [0.0, 0.0], length_scale=[100.0, 30.0])
        assert f"interpolated, with an error of {100.0 * own:.2g} % at the records" in words
        everywhere = noise.in_words([7.0, 20.0], [0.0, 0.0], length_scale=[[100.0, np.nan], [17.0, 40.0]])
        assert f"{100.0 * own:.2g} %" not in everywhere
        worst = f"with an error of at most {100.0 * noise.interpolation_error:.2g} %"
        assert worst in noise.in_words()
        assert worst in noise.in_words([10.5], [0.0])  # whose length scale is not said

    @pytest.mark.usefixtures("no_theory")
    def test_shipped_for_some_of_the_beams(self):
        noise = noise_for_records(self.records([4.0, 9.0], [0.0, 5.0]), load_scan("6-beam").select([4, 1]), FLOW)
        assert noise.beam.tolist() == [4, 1]

    def test_shipped_is_close_to_theory_and_apart_from_boxes(self):
        scan = load_scan("pulsed-4-beam")
        bank = find_shipped_noise(scan, FLOW, method="theory")
        truth = theory_noise(scan, FLOW, wind_speed=7.7, yaw=0.41)
        error = relative_distance(bank.for_records([7.7], [0.41]).covariance[0], truth.covariance[0])
        assert error < 1.2 * bank.interpolation_error
        points = load_scan("pulsed-4-beam@probe=point")
        assert find_shipped_noise(points, FLOW, method="boxes").method == "boxes"
        assert find_shipped_noise(load_scan("6-beam", opening_angle_deg=45.0, focus_distance=52.0), FLOW) is None
        with pytest.raises(InputError, match="Unknown method of shipped noise 'lines'"):
            find_shipped_noise(scan, FLOW, method="lines")

    def test_records_beyond_the_shipped_bank_get_their_own(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        noise = noise_for_records(self.records([0.2, 9.0, 30.0], [-70.0, 0.0, 5.0]), load_scan("staring"), FLOW)
        words = noise.in_words([0.2, 9.0, 30.0], np.deg2rad([-70.0, 0.0, 5.0]))
        assert np.rad2deg(noise.yaw.min()) == pytest.approx(-80.0)
        assert noise.wind_speed.min() == 0.625
        assert "noise: calculated, fu-2022, method theory, " in words
        assert words.endswith("; 1 of 3 records are outside and use its edge")

    def test_one_state_is_calculated_alone(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        noise = noise_for_records(self.records([8.3, 8.3], [4.0, 4.0]), load_scan("2-beam"), FLOW)
        assert noise.wind_speed.tolist() == [8.3]
        assert noise.in_words() == "noise: calculated, fu-2022, method theory, 1 state (8.3 m/s, yaw 4°, L 61 m)"

    def test_one_length_scale_of_all_records(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        records, scan = self.records([8.0, 9.0], [0.0, 5.0]), load_scan("2-beam")
        for _ in range(2):
            noise = noise_for_records(records, scan, FLOW, length_scale=[13.9, 13.9])
            assert noise.for_records([8.0, 9.0], [0.0, 0.1], length_scale=[13.9, 13.9]).covariance.shape == (2, 2, 2)
            assert set(noise.length_scale.tolist()) == {13.9}
            assert ", L 13.9 m); interpolated" in noise.in_words()
        with pytest.raises(InputError, match="Invalid length_scale"):
            noise_for_records(records, scan, FLOW, length_scale=[-1.0])

    def test_another_turbulence(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        flow = MannTurbulence(dissipation=0.05, length_scale=30.0, gamma=2.5, name="mine")
        noise = noise_for_records(self.records([8.0, 9.0], [0.0, 5.0]), load_scan("2-beam"), flow)
        assert "calculated, mine" in noise.in_words()
        assert set(noise.length_scale.tolist()) == {30.0}
        assert noise.interpolation_error <= 0.01


class TestInterpolation:
    def test_weights_sum_to_one_and_repeat_cubics(self):
        rng = np.random.default_rng(1)
        axis = np.sort(rng.normal(size=7))
        net = find_net(axis[:, None])
        at = np.linspace(axis[0], axis[-1], 31)[:, None]
        weights, inside = net.weights(at)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
        np.testing.assert_allclose(weights @ axis**3, at[:, 0] ** 3, atol=1e-11)
        np.testing.assert_array_equal(inside, at)

    def test_continuous_across_the_nodes(self):
        net = find_net(np.arange(6.0)[:, None])
        values = np.random.default_rng(3).normal(size=6)
        for node in range(1, 5):
            below, above = (combine(net.weights([[node + step]])[0], values) for step in (-1e-9, 1e-9))
            np.testing.assert_allclose(below, above, atol=1e-7)

    @pytest.mark.parametrize("size", [(), (1,), (6,), (6, 6), (30, 30)])
    def test_no_row_depends_on_those_beside_it(self, size):
        """Few rows are combined one by one, and many state by state: to the last bit the same."""
        rng = np.random.default_rng(5)
        weights = np.where(rng.random((200, 60)) < 0.5, rng.normal(size=(200, 60)), 0.0)
        values = rng.normal(size=(60, *size))
        together = combine(weights, values)
        np.testing.assert_array_equal(together, [combine(row[None], values)[0] for row in weights])
        np.testing.assert_array_equal(together[:7], combine(weights[:7], values))
        np.testing.assert_allclose(together, np.tensordot(weights, values, axes=1), atol=1e-12)

    def test_two_axes_in_any_order(self):
        states = np.array([(a, b) for a in (0.0, 1.0, 3.0) for b in (-1.0, 2.0)])[
            np.random.default_rng(4).permutation(6)
        ]
        weights, _ = find_net(states).weights([[0.7, 0.5]])
        np.testing.assert_allclose(weights @ (states[:, 0] ** 2 * states[:, 1]), 0.7**2 * 0.5, rtol=1e-12)

    @pytest.mark.parametrize("states", [[[1.0, 2.0]], [[1.0, 2.0], [1.0, 2.0]], [[0.0, 0.0], [1.0, 1.0]]])
    def test_no_net(self, states):
        assert find_net(states) is None

    def test_nearest_semidefinite_is_no_farther_from_any_semidefinite_matrix(self):
        rng = np.random.default_rng(6)
        for _ in range(50):
            root = rng.normal(size=(6, rng.integers(1, 7)))
            truth, off = root @ root.T, rng.normal(size=(6, 6))
            guess = truth + 0.3 * (off + off.T)
            nearest, below = nearest_semidefinite(guess[None])
            assert np.linalg.norm(nearest[0] - truth) <= np.linalg.norm(guess - truth) * (1.0 + 1e-12)
            assert np.linalg.eigvalsh(nearest[0])[0] > -1e-13
            assert (below[0] > 0.0) == (np.linalg.eigvalsh(guess)[0] < 0.0)

    def test_variances_of_zero_are_no_error(self):
        covariance = np.array([[[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 2.0]]])
        between, _ = interpolate_covariance(covariance, np.array([[0.5, 0.5]]))
        np.testing.assert_allclose(between[0], [[0.0, 0.0], [0.0, np.sqrt(2.0)]], atol=1e-300)


class TestFit:
    """What `fit` makes of a bank."""

    @pytest.fixture
    def scene(self):
        scan = load_scan("2-beam")
        bank = refined_noise(scan, FLOW, wind_speed=[5.0, 20.0], yaw_deg=[-20.0, 20.0], cache=False)
        records = records_of(np.random.default_rng(1).uniform(0.8, 1.2, (4, 2)), scan)
        records["wind_speed"][:] = [6.0, 7.7, 15.0, 31.0]
        records["yaw"][:] = [3.0, -12.0, 0.0, 5.0]
        return scan, bank, records

    def test_a_record_has_the_same_posterior_alone_and_in_company(self, scene):
        scan, bank, records = scene
        together = fit(records, scan, noise=bank, seed=3, target_ess=100)
        alone = fit(records.isel(record=[1]), scan, noise=bank, seed=3, target_ess=100)
        for name in ("posterior/stress", "posterior_predictive/variance"):
            np.testing.assert_array_equal(alone[name].values[:, :, 0], together[name].values[:, :, 1])

    def test_noise_between_the_states_is_that_of_theory_there(self, scene):
        scan, bank, records = scene
        one = records.isel(record=[1])
        exact = theory_noise(scan, FLOW, wind_speed=7.7, yaw=np.deg2rad(-12.0))
        spread = [
            fit(one, scan, noise=noise, seed=3, target_ess=2000)["posterior/stress"].std(("chain", "draw")).values
            for noise in (bank, exact)
        ]
        np.testing.assert_allclose(spread[0], spread[1], rtol=0.02)  # 1 % of K, half of it in a standard deviation

    def test_records_outside_are_counted(self, scene):
        scan, bank, records = scene
        assert bank.wind_speed.max() == 20.0
        result = fit(records, scan, noise=bank, seed=3, target_ess=100)
        assert result.attrs["n_outside_noise"] == 1

    def test_chunks_do_not_change_anything(self, scene, monkeypatch):
        scan, bank, records = scene
        whole = fit(records, scan, noise=bank, seed=3, target_ess=100)["posterior/stress"]
        monkeypatch.setattr(parts, "_CHUNK_NUMBERS", 8)  # two records of two beams
        np.testing.assert_array_equal(fit(records, scan, noise=bank, seed=3, target_ess=100)["posterior/stress"], whole)

    def test_records_with_a_turbulence_of_their_own(self):
        scan = load_scan("staring")
        models = [
            replace(
                theory_noise(scan, FLOW, wind_speed=9.0),
                turbulence=replace(FLOW, length_scale=scale),
                length_scale=scale,
            )
            for scale in (30.0, 120.0)
        ]
        models[1] = replace(models[1], covariance=4.0 * models[0].covariance)
        records = records_of(np.ones((2, 1)), scan)
        records["wind_speed"][:] = 9.0
        bank = Noise.join(tuple(models))
        with pytest.raises(InputError, match="spans length_scale 30 to 120"):
            fit(records, scan, noise=bank, seed=1, turbulence="fu-2022")
        records["length_scale"] = ("record", [30.0, 120.0])
        sd = fit(records, scan, noise=bank, seed=1)["posterior/stress"].sel(component="uu").std(("chain", "draw"))
        assert float(sd[1] / sd[0]) > 1.5
