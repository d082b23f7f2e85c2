"""Calibration in boxes: against exact covariances, its invariants, and where noise is kept."""

import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from noise_checks import check_noise

from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise import store as noise_store
from bayes_rs.noise.at_states import noise_key
from bayes_rs.noise.box_noise import Boxes, noise_from_boxes
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.choice import noise_for_records
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.store import cache_folder, find_shipped_noise
from bayes_rs.simulation.boxes import BoxGrid, BoxMaker
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence

at_states_module = sys.modules[noise_key.__module__]
box_noise_module = sys.modules[noise_from_boxes.__module__]

FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="fu-2022")
WIDE_EDDIES = MannTurbulence(dissipation=0.05, length_scale=100.0, gamma=3.2)  # few grid points for short records
GRID = BoxGrid((128, 16, 16), (12.0, 24.0, 24.0))  # 1536 × 384 × 384 m: 5 ms a box
BOXES = 400  # the fourth moments behind an error have long tails: with 60 boxes it can be out by half
SHORT = {"method": Boxes(n_boxes=2), "wind_speed": 10.0, "duration": 60.0}  # a second


def short(**changes):
    return {**SHORT, "method": Boxes(n_boxes=2, **changes)}


def state(scan, *, wind_speed=10.0, yaw=0.0, duration=60.0):
    return RecordState(scan, wind_speed, yaw, duration)


@pytest.fixture(scope="module")
def six_beams():
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    return scan, noise_from_boxes([state(scan, yaw=0.2)], FLOW, BOXES, 1, grid=GRID)[0]


@pytest.fixture
def no_boxes(monkeypatch):
    def fail(*_arguments):
        raise AssertionError("a box was made")

    monkeypatch.setattr(at_states_module, "noise_from_boxes", fail)


def exact_covariance(record_state, maker):
    """Return K of the boxes from their spectral tensor by the formula of Isserlis, with no box made: the slow way."""
    n_x, n_y, n_z = maker.grid.shape
    root = maker._tensor.spectral_vars.astype(np.float64)
    spectral = maker.turbulence.dissipation * np.einsum("ijkyz,ljkyz->ilkyz", root, root)
    k1, k2, k3 = (2.0 * np.pi * np.fft.fftfreq(n, d) for n, d in zip((n_x, n_y, n_z), maker.grid.spacing, strict=True))
    k1 = np.abs(k1[: n_x // 2 + 1])
    twice = np.where((np.arange(n_x // 2 + 1) == 0) | (np.arange(n_x // 2 + 1) == n_x // 2), 1.0, 2.0)
    for corner in ((a, b, c) for a in (0, n_x // 2) for b in (0, n_y // 2) for c in (0, n_z // 2)):
        spectral[(slice(None), slice(None), *corner)] *= 0.5
    direction, scan, count = record_state.line_of_sight, record_state.scan, record_state.n_sample
    position = record_state.focus - np.outer(record_state.wind_speed * scan.beam_time, [1.0, 0.0, 0.0])
    steps = np.subtract.outer(np.arange(count), np.arange(count))
    mean_off = np.eye(count) - 1.0 / count
    covariance, expected = np.empty((scan.n_beam, scan.n_beam)), np.empty(scan.n_beam)
    for a in range(scan.n_beam):
        for b in range(scan.n_beam):
            power = np.einsum("i,ilkyz,l->kyz", direction[a], spectral, direction[b])
            gap = position[a] - position[b]
            across = np.exp(1j * (k2[:, None] * gap[1] + k3[None] * gap[2]))
            cross = twice * np.einsum("kyz,yz->k", power, across)
            lag = gap[0] - record_state.step * np.arange(1 - count, count)
            by_lag = (cross[:, None] * np.exp(1j * np.outer(k1, lag))).sum(axis=0).real
            samples = mean_off @ by_lag[steps + count - 1] @ mean_off
            covariance[a, b] = 2.0 * np.sum(samples**2) / count**2
            if a == b:
                expected[a] = np.trace(samples) / count
    return covariance / np.outer(expected, expected), expected


class TestLaws:
    def test_covariance_is_that_of_the_formula_of_isserlis(self, six_beams):
        """Every entry, within the Monte-Carlo error that the model itself states."""
        scan, noise = six_beams
        maker = BoxMaker(FLOW, GRID)
        exact, expected = exact_covariance(state(scan, yaw=0.2), maker)
        np.testing.assert_allclose(state(scan, yaw=0.2).expected_variance(maker), expected, rtol=1e-6)
        sigmas = (noise.covariance[0] - exact) / noise.standard_error[0]
        assert np.abs(sigmas).max() < 4.5  # 21 different entries, errors from 400 boxes
        assert 0.3 < np.sqrt(np.mean(sigmas**2)) < 2.0  # the stated errors are about right

    def test_stated_error_is_the_scatter_between_seeds(self):
        scan = load_scan("staring")
        models = [noise_from_boxes([state(scan)], FLOW, 10, seed, grid=GRID)[0] for seed in range(24)]
        scatter = np.std([model.covariance[0, 0, 0] for model in models], ddof=1)
        stated = np.sqrt(np.mean([model.standard_error[0, 0, 0] ** 2 for model in models]))
        assert 0.6 < stated / scatter < 1.6  # 24 values give a standard deviation to 15 %; 10 boxes an error to 24 %

    def test_dissipation_scales_out(self, six_beams):
        scan, noise = six_beams
        double = replace(FLOW, dissipation=2.0 * FLOW.dissipation)
        other = noise_from_boxes([state(scan, yaw=0.2)], double, BOXES, 1, grid=GRID)[0]
        np.testing.assert_allclose(other.covariance[0], noise.covariance[0], rtol=1e-4)  # boxes are in single precision
        np.testing.assert_allclose(other.bias[0], noise.bias[0], rtol=1e-9)

    def test_reversed_beams_have_the_same_noise(self):
        """n → −n at the same points: a beam that looks the other way from the other side."""
        direction, distance = load_scan("6-beam").beam_direction, np.full(6, 98.0)
        times = np.zeros(6)
        here = RecordState(Scan("here", direction, distance, times, 1.0), 10.0, 0.0, 60.0)
        boxes = 5

        class Reversed(RecordState):
            """The same points seen from the other side."""

            @property
            def line_of_sight(self):
                return -super().line_of_sight

            @property
            def focus(self):
                return -super().focus

        there = Reversed(here.scan, 10.0, 0.0, 60.0)
        one, other = (noise_from_boxes([s], FLOW, boxes, 1, grid=GRID)[0] for s in (here, there))
        np.testing.assert_array_equal(other.covariance[0], one.covariance[0])
        np.testing.assert_array_equal(other.gain[0], one.gain[0])
        np.testing.assert_array_equal(other.bias[0], one.bias[0])

    def test_gain_is_the_design_matrix_of_the_state(self, six_beams):
        scan, noise = six_beams
        np.testing.assert_allclose(noise.gain[0], design_matrix(scan.with_yaw(0.2)), atol=1e-15)

    def test_gain_times_the_record_tensor_is_the_expectation(self, six_beams):
        scan, noise = six_beams
        maker = BoxMaker(FLOW, GRID)
        variance = np.einsum("bi,ij,bj->b", scan.at_yaw(0.2), maker.tensor, scan.at_yaw(0.2))
        np.testing.assert_allclose(
            (1.0 + noise.bias[0]) * variance, state(scan, yaw=0.2).expected_variance(maker), rtol=1e-12
        )

    def test_longer_records_are_less_noisy(self):
        scan = load_scan("staring")
        short, long = noise_from_boxes(
            [state(scan, duration=30.0), state(scan, duration=120.0)], FLOW, BOXES, 1, grid=GRID
        )
        assert long.covariance[0, 0, 0] < short.covariance[0, 0, 0]
        assert short.bias[0, 0] < long.bias[0, 0] < 0.0

    def test_several_states_share_boxes_and_change_nothing(self, six_beams):
        scan, noise = six_beams
        states = [state(load_scan("4-beam")), state(scan, yaw=0.2), state(scan, wind_speed=7.0)]
        together = noise_from_boxes(states, FLOW, BOXES, 1, grid=GRID)
        np.testing.assert_allclose(together[1].covariance[0], noise.covariance[0], rtol=1e-4)  # single precision
        assert [model.wind_speed for model in together] == [10.0, 10.0, 7.0]

    def test_relative_error_at_the_seed_flow_is_about_a_quarter(self):
        """Ten minutes at 10 m/s, by the formula of Isserlis from the boxes' own spectrum: no Monte Carlo."""
        maker = BoxMaker(FLOW, BoxGrid((3600, 36, 36), (5.1, 20.3, 20.3)))
        power, lag = maker.spectrum[:, 0, 0], 10.0 * np.arange(600)
        covariance = np.cos(np.outer(lag, maker.wave_number)) @ power
        samples = covariance[np.abs(np.subtract.outer(np.arange(600), np.arange(600)))]
        samples = samples - samples.mean(axis=0) - samples.mean(axis=1)[:, None] + samples.mean()
        relative = np.sqrt(2.0 * np.sum(samples**2)) / np.trace(samples)
        assert relative == pytest.approx(0.2585, rel=0.04)  # infinite domain; boxes 12 L wide have 3 % more


class TestEveryNoiseModel:
    def test_from_boxes(self, six_beams, tmp_path):
        check_noise(six_beams[1], six_beams[0], tmp_path)

    def test_bank(self, tmp_path):
        scan = load_scan("4-beam")
        bank = calibrate(scan, WIDE_EDDIES, **{**SHORT, "wind_speed": [5.0, 10.0]}, yaw_deg=[-20.0, 20.0], cache=False)
        assert isinstance(bank, Noise)
        assert bank.wind_speed.tolist() == [5.0, 5.0, 10.0, 10.0]
        np.testing.assert_allclose(np.rad2deg(bank.yaw), [-20.0, 20.0, -20.0, 20.0])
        check_noise(bank, scan, tmp_path)

    def test_details_tell_how_it_was_made(self, six_beams):
        details = six_beams[1].details
        assert details["n_boxes"] == BOXES
        assert details["seed"] == 1
        assert details["grid_shape"] == [128, 16, 16]
        assert details["generator"].startswith("hipersim")
        assert details["n_records"] == BOXES * details["records_per_box"] * details["n_placements"]
        assert len(details["variance_lost"]) == 3
        assert details["mean_deviation_sigmas"] < 5.0
        assert BOXES < six_beams[1].n_realizations <= details["n_records"]


class TestCalibrate:
    def test_one_state_is_a_model_with_the_scans_yaw(self):
        noise = calibrate(load_scan("2-beam", yaw_deg=10.0), WIDE_EDDIES, **SHORT, cache=False)
        assert isinstance(noise, Noise)
        assert noise.yaw == pytest.approx(np.deg2rad(10.0))

    def test_a_generator_is_a_seed_and_is_not_cached(self, tmp_path):
        one = calibrate(load_scan("2-beam"), WIDE_EDDIES, **short(seed=np.random.default_rng(4)), cache=tmp_path)
        other = calibrate(load_scan("2-beam"), WIDE_EDDIES, **short(seed=4), cache=False)
        np.testing.assert_array_equal(one.covariance[0], other.covariance[0])
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"method": "magic"}, "Unknown method of calibration 'magic': it must be one of theory, boxes"),
            ({"wind_speed": -1.0}, "Invalid wind_speed -1.0: it must be from 0.001 to 90"),
            ({"wind_speed": []}, "Invalid wind_speed .*give a number or a sequence of numbers"),
            ({"wind_speed": None}, r"Neither records nor wind_speed is given: give records, .* or wind_speed \(m/s\)"),
            ({"records": xr.Dataset()}, "Both records and wind_speed are given"),
            ({"tolerance": 0.01}, "Invalid tolerance with method 'boxes'"),
            ({"present": [[True]]}, "Invalid present with method 'boxes'"),
            ({"duration": 0.0}, "Invalid duration 0.0 s"),
            ({"duration": 1.0}, "a record must hold at least two scans"),
            ({"yaw_deg": np.inf}, "Invalid yaw_deg"),
        ],
    )
    def test_message(self, change, message, tmp_path):
        with pytest.raises(InputError, match=message):
            calibrate(load_scan("2-beam"), WIDE_EDDIES, **{**SHORT, "cache": tmp_path, **change})

    def test_a_seed_below_zero(self):
        with pytest.raises(InputError, match="Invalid seed -1"):
            Boxes(seed=-1)

    def test_record_longer_than_the_box(self):
        with pytest.raises(InputError, match="A record of 600 s at 10 m/s does not fit into a box of 1536 m"):
            noise_from_boxes([state(load_scan("2-beam"), duration=600.0)], FLOW, 2, 1, grid=GRID)

    def test_missing_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "hipersim", None)
        with pytest.raises(MissingExtraError, match="pip install"):
            calibrate(load_scan("2-beam"), WIDE_EDDIES, **SHORT, cache=False)


class TestKey:
    base = staticmethod(lambda: ([state(load_scan("2-beam"))], FLOW, {"n_boxes": 5, "seed": 1}))

    def key(self, **changes):
        states, turbulence, options = self.base()
        if "state" in changes:
            states = [changes.pop("state")]
        if "turbulence" in changes:
            turbulence = changes.pop("turbulence")
        return noise_key(states, turbulence, boxes=Boxes(**{**options, **changes}))

    @pytest.mark.parametrize(
        "changes",
        [
            {"n_boxes": 6},
            {"seed": 2},
            {"turbulence": replace(FLOW, dissipation=0.051)},
            {"turbulence": replace(FLOW, length_scale=61.1)},
            {"turbulence": replace(FLOW, gamma=3.3)},
            {"state": state(load_scan("2-beam"), wind_speed=10.1)},
            {"state": state(load_scan("2-beam"), yaw=0.01)},
            {"state": state(load_scan("2-beam"), duration=61.0)},
            {"state": state(load_scan("2-beam", focus_distance=99.0))},
            {"state": state(load_scan("2-beam", opening_angle_deg=16.0))},
            {"state": state(load_scan("2-beam", tilt_deg=1.0))},
            {"state": state(replace(load_scan("2-beam"), scan_duration=2.0))},
            {"state": state(replace(load_scan("2-beam"), beam_time=np.zeros(2)))},
            {"state": state(load_scan("2-beam").select([1, 0]))},
        ],
    )
    def test_changes_with_every_ingredient(self, changes):
        assert self.key(**changes) != self.key()

    @pytest.mark.parametrize("name", ["NOISE_VERSION", "generator_name", "grid_for"])
    def test_changes_with_what_makes_the_numbers(self, name, monkeypatch):
        before = self.key()
        other = {
            "NOISE_VERSION": at_states_module.NOISE_VERSION + 1,
            "generator_name": lambda: "hipersim 9.9",
            "grid_for": lambda _states, _turbulence: GRID,
        }[name]
        where = at_states_module if hasattr(at_states_module, name) else box_noise_module
        monkeypatch.setattr(where, name, other)
        assert self.key() != before

    def test_does_not_change_with_names(self):
        renamed = replace(load_scan("2-beam"), name="mine", title="my lidar")
        assert self.key(state=state(renamed), turbulence=replace(FLOW, name="mine")) == self.key()

    def test_does_not_change_with_the_scans_own_yaw(self):
        assert self.key(state=state(load_scan("2-beam", yaw_deg=30.0))) == self.key()


class TestCache:
    def make(self, folder, **changes):
        return calibrate(
            load_scan("2-beam"), WIDE_EDDIES, **{**short(seed=changes.pop("seed", 3)), "cache": folder, **changes}
        )

    def test_second_time_makes_no_box(self, tmp_path, monkeypatch):
        first = self.make(tmp_path / "new" / "folder")
        monkeypatch.setattr(BoxMaker, "make", None)
        second = self.make(tmp_path / "new" / "folder")
        assert second.to_dataset().identical(first.to_dataset())

    def test_bank(self, tmp_path, monkeypatch):
        first = self.make(tmp_path, yaw_deg=[0.0, 10.0])
        monkeypatch.setattr(BoxMaker, "make", None)
        assert self.make(tmp_path, yaw_deg=[0.0, 10.0]).to_dataset().identical(first.to_dataset())

    def test_names_are_those_in_use(self, tmp_path, monkeypatch):
        self.make(tmp_path)
        monkeypatch.setattr(BoxMaker, "make", None)
        scan = replace(load_scan("2-beam"), name="my lidar")
        noise = calibrate(scan, replace(WIDE_EDDIES, name="here"), **short(seed=3), cache=tmp_path)
        assert noise.scan_name == "my lidar"
        assert noise.turbulence.name == "here"

    @pytest.mark.usefixtures("no_boxes")
    def test_false_is_no_cache(self, monkeypatch):
        monkeypatch.setattr(at_states_module, "from_cache", None)
        with pytest.raises(AssertionError, match="a box was made"):
            self.make(False)

    def test_damaged_file_is_calculated_again_and_said_so(self, tmp_path, caplog):
        first = self.make(tmp_path)
        (file,) = tmp_path.iterdir()
        file.write_bytes(file.read_bytes()[:1000])
        with caplog.at_level(logging.WARNING):
            second = self.make(tmp_path)
        assert "is damaged and is calculated again" in caplog.text
        words = "calculated again, because the cached file was damaged: it is not whole"
        assert second.details["cache"].startswith(words)
        np.testing.assert_array_equal(second.covariance[0], first.covariance[0])
        assert load_noise(file).to_dataset().identical(first.to_dataset())  # and the file is whole again

    def test_file_of_another_key_is_not_used(self, tmp_path, caplog):
        self.make(tmp_path, seed=4)
        (other,) = tmp_path.iterdir()
        first = self.make(tmp_path)
        (file,) = set(tmp_path.iterdir()) - {other}
        file.write_bytes(other.read_bytes())
        np.testing.assert_array_equal(self.make(tmp_path).covariance[0], first.covariance[0])
        assert "belongs to another key" in caplog.text

    def test_folder_that_cannot_be_written_is_no_failure(self, tmp_path, caplog):
        (tmp_path / "file").write_text("in the way")
        assert self.make(tmp_path / "file" / "folder").n_beam == 2
        assert "cannot be cached" in caplog.text

    def test_folder(self, monkeypatch, tmp_path):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path / "own"))
        assert cache_folder() == tmp_path / "own"
        monkeypatch.delenv("BAYES_RS_CACHE")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert cache_folder() == tmp_path / "bayes_rs"
        monkeypatch.delenv("XDG_CACHE_HOME")
        assert cache_folder() == Path.home() / ".cache" / "bayes_rs"
        assert cache_folder(tmp_path) == tmp_path


@pytest.mark.usefixtures("no_boxes")
class TestShipped:
    def test_found_without_a_box(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "hipersim", None)
        noise = calibrate(load_scan("6-beam"), FLOW, wind_speed=10.0, method="boxes")
        assert isinstance(noise, Noise)
        assert noise.details["n_boxes"] >= 100

    def test_bank_and_one_state_of_it(self):
        scan = load_scan("pulsed-4-beam@probe=point")
        bank = calibrate(scan, FLOW, wind_speed=[4.5, 9.5], yaw_deg=[0.0, 20.0], method="boxes")
        assert isinstance(bank, Noise)
        assert len(bank) == 4
        one = calibrate(scan, FLOW, wind_speed=9.5, yaw_deg=20.0, method="boxes")
        np.testing.assert_array_equal(one.covariance[0], bank.covariance[3])

    def test_some_of_its_beams(self):
        scan = load_scan("pulsed-4-beam@probe=point").select([2, 3])
        bank = find_shipped_noise(scan, FLOW, method="boxes")
        assert isinstance(bank, Noise)
        bank.check_scan(scan)

    @pytest.mark.parametrize("name", ["zx-tm", "pulsed-4-beam"])
    def test_with_the_instruments_probe_by_theory_and_without_by_both(self, name):
        for scan, methods in ((load_scan(name), ("theory",)), (load_scan(f"{name}@probe=point"), ("theory", "boxes"))):
            found = {method: find_shipped_noise(scan, FLOW, method=method) for method in ("theory", "boxes")}
            assert tuple(method for method in found if found[method] is not None) == methods
            for method in methods:
                found[method].check_scan(scan)
                assert found[method].scan_name == scan.name

    @pytest.mark.parametrize(
        ("scan", "turbulence", "changes"),
        [
            (load_scan("6-beam", focus_distance=97.0), FLOW, {}),
            (load_scan("6-beam"), replace(FLOW, gamma=3.3), {}),
            (load_scan("6-beam"), replace(FLOW, dissipation=0.06), {}),
            (load_scan("6-beam"), FLOW, {"duration": 1800.0}),
            (load_scan("6-beam"), FLOW, {"wind_speed": 11.0}),
            (load_scan("6-beam"), FLOW, {"yaw": 0.1}),
        ],
    )
    def test_anything_else_is_not_shipped(self, scan, turbulence, changes):
        for method in ("boxes", "theory"):
            found = find_shipped_noise(load_scan("6-beam"), FLOW, wind_speed=10.0, yaw=0.0, method=method)
            assert found is not None
            assert found.method == method
            assert find_shipped_noise(scan, turbulence, **changes, method=method) is None

    @pytest.mark.parametrize(
        "changes", [{"method": Boxes(seed=2)}, {"method": Boxes(n_boxes=10_000)}, {"cache": False}]
    )
    def test_not_used_for_another_seed_or_more_boxes_or_without_cache(self, changes, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        with pytest.raises(AssertionError, match="a box was made"):
            calibrate(load_scan("staring"), FLOW, **{"wind_speed": 10.0, "method": "boxes", **changes})


class TestForRecords:
    def test_no_wind_speed(self):
        records = xr.Dataset({"wind_speed": ("record", [np.nan]), "yaw": ("record", [0.0])}, attrs={"duration": 600.0})
        with pytest.raises(InputError, match="No record has a wind speed and direction"):
            noise_for_records(records, load_scan("6-beam"), FLOW)


def test_damaged_shipped_file_is_named(tmp_path, monkeypatch):
    (tmp_path / "bad.nc").write_bytes(b"damaged")
    monkeypatch.setattr(noise_store, "models_folder", lambda _kind: tmp_path)
    with pytest.raises(InputError, match=r"bad\.nc' cannot be read"):
        find_shipped_noise(load_scan("6-beam"), FLOW, method="boxes")
