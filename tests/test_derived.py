"""Derived quantities: known tensors, laws, and Lumley's triangle."""

import numpy as np
import pytest
import xarray as xr

from bayes_rs import InputError, fit, load_scan, load_turbulence
from bayes_rs.fits.derived import DERIVED, INTENSITIES, lumley_coordinates, with_derived
from bayes_rs.geometry.forward import radial_variance
from bayes_rs.geometry.stress import rotate_stress
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.plot.lumley_plot import lumley

ISOTROPIC = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
ONE_COMPONENT = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
TWO_COMPONENTS = [0.5, 0.5, 0.0, 0.0, 0.0, 0.0]


def random_stress(n_stress, rank=3, seed=1):
    root = np.random.default_rng(seed).standard_normal((n_stress, 3, rank))
    tensor = root @ root.swapaxes(1, 2)
    return np.stack([tensor[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=-1)


def rotations(n_rotation, seed=2):
    q = np.linalg.qr(np.random.default_rng(seed).standard_normal((n_rotation, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


class TestLumley:
    @pytest.mark.parametrize(
        ("stress", "corner"),
        [(ISOTROPIC, (0.0, 0.0)), (ONE_COMPONENT, (1 / 3, 1 / 3)), (TWO_COMPONENTS, (-1 / 6, 1 / 6))],
    )
    def test_corners(self, stress, corner):
        np.testing.assert_allclose(np.array(lumley_coordinates(np.array(stress))), corner, atol=1e-15)

    def test_realizable_tensors_lie_within(self):
        xi, eta = lumley_coordinates(random_stress(5000))
        assert (eta >= np.abs(xi) - 1e-12).all()
        assert (eta <= np.sqrt(1 / 27 + 2 * xi**3) + 1e-12).all()
        assert (xi < 0).any()
        assert (xi > 0).any()

    def test_two_component_tensors_lie_on_the_upper_border(self):
        xi, eta = lumley_coordinates(random_stress(500, rank=2))
        np.testing.assert_allclose(eta, np.sqrt(1 / 27 + 2 * xi**3), rtol=1e-12)

    def test_a_tensor_that_is_not_realizable_lies_outside(self):
        xi, eta = lumley_coordinates(np.array([1.0, 0.6, -0.1, 0.0, 0.0, 0.0]))
        assert eta > np.sqrt(1 / 27 + 2 * xi**3)

    @pytest.mark.parametrize("name", ["lumley_xi", "lumley_eta", "anisotropy_2", "anisotropy_3", "tke"])
    def test_invariants_do_not_change_when_axes_turn(self, name):
        stress = random_stress(200)
        turned = rotate_stress(stress, rotations(200))
        # a cube root at zero turns rounding of 1e-16 into 1e-5; away from it the relative error is rounding
        np.testing.assert_allclose(DERIVED[name](turned), DERIVED[name](stress), rtol=1e-8, atol=1e-8)


class TestCorrelations:
    def test_known_tensor(self):
        stress = np.array([4.0, 1.0, 0.25, 0.4, -0.5, 0.1])
        values = [DERIVED[f"correlation_{pair}"](stress) for pair in ("uv", "uw", "vw")]
        np.testing.assert_allclose(values, [0.2, -0.5, 0.2], rtol=1e-15)

    def test_realizable_tensors_have_correlations_from_minus_one_to_one(self):
        for pair in ("uv", "uw", "vw"):
            value = DERIVED[f"correlation_{pair}"](random_stress(2000))
            assert (np.abs(value) <= 1.0 + 1e-12).all()
            assert np.ptp(value) > 1.0

    def test_size_does_not_matter(self):
        stress = random_stress(50)
        for pair in ("uv", "uw", "vw"):
            of = DERIVED[f"correlation_{pair}"]
            np.testing.assert_allclose(of(1e-6 * stress), of(stress), rtol=1e-12)


def test_turbulence_intensities_are_of_each_component():
    stress = np.array([[1.44, 0.81, 0.36, 0.0, 0.0, 0.0]])
    values = with_derived(stress, tuple(INTENSITIES), np.array([10.0]))
    np.testing.assert_allclose(values[0, 6:], [0.12, 0.09, 0.06], rtol=1e-15)
    assert np.isnan(with_derived(stress, ["ti_w"])[0, 6])


@pytest.fixture(scope="module")
def result():
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    flow = load_turbulence("fu-2022")
    variance = radial_variance(scan, flow.stresses())
    records = xr.Dataset(
        {
            "variance": (("record", "beam"), np.stack([variance, variance])),
            "flag": (("record", "beam"), np.array([[0] * 6, [1] * 6])),
            "wind_speed": ("record", [10.0, 10.0]),
            "yaw": ("record", [0.0, 0.0]),
        },
        coords={"beam": scan.beam},
        attrs={"duration": 600.0, "scan_key": scan.key},
    )
    return fit(records, scan, noise=calibrate(scan, flow, wind_speed=10.0), seed=1, sampler="direct")


class TestPlot:
    def test_records_are_points_within_the_triangle(self, result):
        axis = lumley(result).axes[0]
        points = axis.containers[0].lines[0].get_xydata()
        assert len(points) == 1  # the other record was not fitted
        xi, eta = points[0]
        assert abs(xi) < eta < np.sqrt(1 / 27 + 2 * xi**3)

    def test_draws_of_a_record(self, result):
        axis = lumley(result, 0).axes[0]
        (draws,) = [line.get_xydata() for line in axis.lines if line.get_label() == "draws"]
        assert 500 < len(draws) <= 4000
        assert (draws[:, 1] <= np.sqrt(1 / 27 + 2 * draws[:, 0] ** 3) + 1e-9).all()

    def test_a_record_that_was_not_fitted(self, result):
        with pytest.raises(InputError, match="Record 1 was not fitted"):
            lumley(result, 1)

    def test_no_fitted_record_is_a_figure_too(self, result):
        records = result.records.assign(flag=result.records["flag"] * 0 + 1)
        scan = result.scan
        broken = fit(records, scan, noise=calibrate(scan, "fu-2022", wind_speed=10.0), seed=1, sampler="direct")
        axis = lumley(broken).axes[0]
        assert axis.get_title().startswith("0 records")
        assert not axis.containers

    @pytest.mark.parametrize("record", [None, 0])
    def test_truth_is_marked_where_it_lies(self, result, record):
        """Axisymmetric, uu = 2 vv = 2 ww: b has the eigenvalues 1/6, −1/12, −1/12, so ξ = η = 1/12."""
        rod, ball = [2.0, 1.0, 1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
        for truth in (rod, [rod, ball]):  # record 1 was not fitted
            axis = lumley(result, record, truth=truth).axes[0]
            (marks,) = [line for line in axis.lines if line.get_label() == "truth"]
            np.testing.assert_allclose(marks.get_xydata(), [[1.0 / 12.0, 1.0 / 12.0]], rtol=1e-12)
            assert "truth" in [text.get_text() for text in axis.get_legend().get_texts()]
        without = lumley(result, record).axes[0]
        assert not any(line.get_label() == "truth" for line in without.lines)

    def test_truth_of_the_wrong_shape(self, result):
        with pytest.raises(InputError, match=r"Invalid truth of shape \(3,\): the shape must be \(6\)"):
            lumley(result, truth=[1.0, 0.5, 0.3])
