"""Boxes of Mann turbulence: which way is up, what they hold, and the grid that a scene needs."""

import sys

import numpy as np
import pytest

from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.simulation.boxes import MAX_POINTS, BoxGrid, BoxMaker, choose_grid, generator_name
from bayes_rs.turbulence.mann import MannTurbulence

FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
SMALL = BoxGrid((128, 16, 16), (16.0, 16.0, 16.0))


@pytest.fixture(scope="module")
def maker():
    return BoxMaker(FLOW, SMALL)


@pytest.fixture(scope="module")
def boxes(maker):
    return np.stack([maker.make(seed).velocity for seed in range(100)])


class TestLaws:
    def test_momentum_goes_down(self, maker, boxes):
        """With z up and shear upwards, ⟨uw⟩ < 0; a flipped axis or component would show here."""
        assert maker.tensor[0, 2] < -0.2
        assert np.mean(boxes[:, 0] * boxes[:, 2]) < -0.2

    def test_eddies_lean_with_the_shear(self, boxes):
        """What is higher is further downstream: u correlates better along (+x, +z) than along (+x, −z)."""
        u = boxes[:, 0]
        forward = np.mean(u * np.roll(u, (-3, -2), axis=(1, 3)))
        backward = np.mean(u * np.roll(u, (-3, 2), axis=(1, 3)))
        assert forward > backward + 0.1

    def test_no_stress_across_the_plane_of_symmetry(self, maker):
        # zero in the model; hipersim's correction of the lowest wave numbers breaks the symmetry by a few 1e-3
        assert abs(maker.tensor[0, 1]) < 0.01
        assert abs(maker.tensor[1, 2]) < 0.01

    def test_spectrum_is_what_boxes_hold_on_average(self, maker, boxes):
        per_box = np.einsum("bixyz,bjxyz->bij", boxes, boxes) / SMALL.n_point
        error = per_box.std(axis=0, ddof=1) / np.sqrt(len(boxes))
        assert np.all(np.abs(per_box.mean(axis=0) - maker.tensor) < 4.5 * error)  # Monte Carlo, nine entries

    def test_spectrum_along_the_wind_is_what_boxes_hold(self, maker, boxes):
        waves = np.fft.rfft(boxes, axis=2) / SMALL.shape[0]
        power = np.mean(np.abs(waves) ** 2, axis=(3, 4))  # (box, component, k1)
        power[..., 1:-1] *= 2.0
        error = power.std(axis=0, ddof=1) / np.sqrt(len(boxes))
        expected = np.einsum("kii->ik", maker.spectrum)
        assert np.all(np.abs(power.mean(axis=0) - expected) < 5.5 * error)  # Monte Carlo, 195 entries, skewed

    def test_dissipation_scales_the_velocity(self, maker):
        double = BoxMaker(MannTurbulence(0.10, 61.0, 3.2), SMALL)
        np.testing.assert_allclose(double.tensor, 2.0 * maker.tensor, rtol=1e-12)
        expected = np.sqrt(2.0) * maker.make(3).velocity
        np.testing.assert_allclose(double.make(3).velocity, expected, rtol=1e-5, atol=1e-6)  # single precision

    def test_variances_are_near_those_of_an_infinite_domain(self):
        tensor = BoxMaker(FLOW, BoxGrid((1024, 32, 32), (10.0, 12.0, 12.0))).tensor
        infinite = FLOW.stresses()
        # a box lacks long and small eddies: 10 % here; without HighFreqComp it would be 20 to 40 %
        np.testing.assert_allclose(np.diag(tensor), infinite[:3], rtol=0.15)
        assert tensor[0, 2] == pytest.approx(infinite[4], rel=0.15)


class TestMaker:
    def test_same_seed_same_box(self, maker, boxes):
        np.testing.assert_array_equal(maker.make(7).velocity, boxes[7])

    def test_another_seed_another_box(self, boxes):
        assert abs(np.corrcoef(boxes[0, 0].ravel(), boxes[1, 0].ravel())[0, 1]) < 0.5

    def test_shape(self, boxes):
        assert boxes.shape == (100, 3, *SMALL.shape)

    def test_wave_numbers(self, maker):
        assert maker.wave_number[1] == pytest.approx(2.0 * np.pi / SMALL.size[0])
        assert maker.spectrum.shape == (len(maker.wave_number), 3, 3)

    def test_name_and_version(self):
        assert generator_name().startswith("hipersim 0.")

    def test_missing_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "hipersim", None)
        with pytest.raises(MissingExtraError, match=r'run pip install "bayes_rs\[boxes\]", or use method="theory"'):
            BoxMaker(FLOW, SMALL)


class TestGrid:
    @pytest.mark.parametrize("length_scale", [5.0, 61.0, 300.0])
    @pytest.mark.parametrize("record_length", [300.0, 6000.0, 12000.0])
    def test_is_large_and_fine_enough(self, length_scale, record_length):
        grid = choose_grid(MannTurbulence(0.05, length_scale, 3.2), record_length=record_length, extent=50.0)
        assert grid.n_point <= MAX_POINTS
        assert grid.size[0] >= max(1.2 * record_length, 24.0 * length_scale) * (1.0 - 1e-9)
        assert min(grid.size[1:]) >= max(12.0 * length_scale, 100.0) * (1.0 - 1e-9)
        assert grid.spacing[0] <= length_scale / 3.0
        assert max(grid.spacing[1:]) <= length_scale / 1.5

    def test_seed_flow_has_room_for_three_records(self):
        assert choose_grid(FLOW, record_length=6000.0, extent=51.0).size == pytest.approx((18300.0, 732.0, 732.0))

    def test_wide_scans_get_wide_boxes(self):
        assert choose_grid(FLOW, record_length=600.0, extent=500.0).size[1] >= 1000.0

    def test_too_large(self):
        with pytest.raises(InputError, match=r"would need more than 25000000 grid points: use method='theory'"):
            choose_grid(MannTurbulence(0.05, 1.0, 3.2), record_length=6000.0, extent=100.0)

    @pytest.mark.parametrize("shape", [(127, 16, 16), (128, 2, 16)])
    def test_odd_or_tiny_numbers(self, shape):
        with pytest.raises(InputError, match="every number must be even and at least 4"):
            BoxGrid(shape, (1.0, 1.0, 1.0))

    def test_spacing(self):
        with pytest.raises(InputError, match=r"Invalid spacing 0\.0 m"):
            BoxGrid((4, 4, 4), (1.0, 0.0, 1.0))

    def test_record_length(self):
        with pytest.raises(InputError, match=r"Invalid record_length -1\.0 m"):
            choose_grid(FLOW, record_length=-1.0)
