"""Beam pairs: exact in uniform wind, matched as a slow search does, and biased as theory says."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import bayes_rs as brs
from bayes_rs import InputError, Scan, load_scan, load_turbulence
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.wind import pair_stresses, reconstruct_pairs
from bayes_rs.wind.pairs import _matched

FLOW = load_turbulence("fu-2022")
START = np.datetime64("2020-09-03T19:00", "ns")


def series_of(scan, wind, n=5):
    """Every beam at its own time, in uniform wind."""
    second = scan.beam_time[:, None] + scan.scan_duration * np.arange(n)
    velocity = np.broadcast_to((scan.level_direction @ wind)[:, None], second.shape)
    return xr.Dataset(
        {"radial_velocity": ("sample", velocity.ravel())},
        coords={
            "time": ("sample", START + (second.ravel() * 1e9).astype(np.int64).astype("timedelta64[ns]")),
            "beam": ("sample", np.repeat(scan.beam, n)),
        },
    )


def side_by_side(angle_deg, *, time=(0.0, 0.0)):
    angle = np.deg2rad(angle_deg)
    directions = [[-np.cos(angle), side * np.sin(angle), 0.0] for side in (-1.0, 1.0)]
    return Scan("pair", directions, focus_distance=[98.0, 98.0], beam_time=list(time), scan_duration=1.0)


class TestReconstruction:
    def test_exact_in_uniform_wind(self):
        scan = load_scan("pulsed-4-beam")
        wind = np.array([8.0, -2.0, 0.0])
        found = reconstruct_pairs(series_of(scan, wind), scan)
        assert set(zip(found["first_beam"].values.tolist(), found["second_beam"].values.tolist(), strict=True)) == {
            (0, 1),
            (2, 3),
        }
        np.testing.assert_allclose(found["u"], 8.0, rtol=1e-12)
        np.testing.assert_allclose(found["v"], -2.0, rtol=1e-12)

    def test_vertical_pairs(self):
        scan = load_scan("pulsed-4-beam", tilt_deg=0.0)
        found = reconstruct_pairs(series_of(scan, np.array([8.0, 0.0, 0.5])), scan, plane="vertical")
        assert set(found["first_beam"].values.tolist()) == {0, 1}
        np.testing.assert_allclose(found["u"], 8.0, rtol=1e-12)
        np.testing.assert_allclose(found["w"], 0.5, rtol=1e-12)

    def test_times(self):
        scan = side_by_side(15.0, time=(0.0, 0.5))
        found = reconstruct_pairs(series_of(scan, np.array([8.0, 0.0, 0.0])), scan)
        np.testing.assert_array_equal(found["time_offset"], 0.5)
        np.testing.assert_array_equal(
            (found["time"].values - START) / np.timedelta64(1, "ms"), 250 + 1000 * np.arange(5)
        )
        assert found.attrs["samples_without_partner"] == 0

    def test_missing_samples_take_their_partners_along(self):
        scan = side_by_side(15.0)
        series = series_of(scan, np.array([8.0, 0.0, 0.0]))
        velocity = series["radial_velocity"].values.copy()
        velocity[2] = np.nan
        found = reconstruct_pairs(series.assign(radial_velocity=("sample", velocity)), scan)
        assert found.sizes["sample"] == 4
        assert found.attrs["samples_without_partner"] == 1
        assert np.isfinite(found["u"]).all()

    @given(
        st.lists(st.integers(0, 60), max_size=12, unique=True),
        st.lists(st.integers(0, 60), max_size=12, unique=True),
        st.sampled_from([1.0, 3.0, 100.0]),
    )
    def test_matching(self, first, second, tolerance):
        """One to one, within the tolerance, no two left over that could be matched, and the nearest of all is in."""
        a, b = (np.sort(np.array(values, dtype=np.int64)) * 1_000_000_000 for values in (first, second))
        one, other = _matched(a, b, tolerance)
        assert len(set(one.tolist())) == len(one) == len(other) == len(set(other.tolist()))
        gap = np.abs(a[one] - b[other])
        assert np.all(gap <= tolerance * 1e9)
        left, right = np.delete(a, one), np.delete(b, other)
        if len(left) and len(right):
            assert np.abs(left[:, None] - right).min() > tolerance * 1e9
        if len(a) and len(b) and np.abs(a[:, None] - b).min() <= tolerance * 1e9:
            assert gap.min() == np.abs(a[:, None] - b).min()

    @pytest.mark.parametrize(
        ("name", "options", "message"),
        [
            ("staring", {}, r"Scan 'staring' has no horizontal pair of beams"),
            ("2-beam", {"pairs": [(0, 7)]}, r"Invalid pair \(0, 7\) of scan '2-beam': give two of its beams, \[0, 1\]"),
            ("2-beam", {"plane": "vertical", "pairs": [(0, 1)]}, r"see the same direction in the vertical plane"),
            ("2-beam", {"plane": "other"}, r"Unknown plane of pairs 'other'"),
        ],
    )
    def test_refuses(self, name, options, message):
        scan = load_scan(name)
        with pytest.raises(InputError, match=message):
            reconstruct_pairs(series_of(scan, np.array([8.0, 0.0, 0.0])), scan, **options)


class TestBias:
    @pytest.mark.parametrize("angle", [15.0, 30.0])
    def test_the_formula_of_the_docstring(self, angle):
        scan = side_by_side(angle)
        found = pair_stresses(scan, FLOW, wind_speed=10.0).isel(pair=0)
        uu, vv = FLOW.stresses()[:2]
        apart = [0.0, 2.0 * 98.0 * np.sin(np.deg2rad(angle)), 0.0]
        covariance = brs.turbulence.velocity_covariance(apart, FLOW)
        rho_u, rho_v = covariance[0, 0] / uu, covariance[1, 1] / vv
        tangent = np.tan(np.deg2rad(angle)) ** 2
        of_u = 0.5 * (1.0 + rho_u) * uu + 0.5 * (1.0 - rho_v) * tangent * vv
        of_v = 0.5 * (1.0 + rho_v) * vv + 0.5 * (1.0 - rho_u) / tangent * uu
        # errors of covariances, 1e-4 of uu, are divided by sin² φ
        np.testing.assert_allclose(found["measured"].sel(stress=["uu", "vv"]), [of_u, of_v], atol=4e-4 * uu / 0.067)

    def test_no_separation_no_bias(self):
        """Beams of a pair at the lidar itself see the same air."""
        scan = Scan("near", side_by_side(15.0).beam_direction, [1e-6, 1e-6], [0.0, 0.0], 1.0)
        found = pair_stresses(scan, FLOW, wind_speed=10.0, yaw_deg=20.0)
        np.testing.assert_allclose(found["measured"].values[0], found["true"], rtol=1e-3, atol=3e-3)

    def test_true_stresses_are_those_along_the_lidars_axes(self):
        found = pair_stresses(side_by_side(15.0), FLOW, wind_speed=10.0, yaw_deg=30.0)
        turn = yaw_matrix(np.deg2rad(30.0))
        tensor = turn @ unpack_stress(FLOW.stresses()) @ turn.T
        np.testing.assert_allclose(found["true"], [tensor[0, 0], tensor[1, 1], tensor[0, 1]], rtol=1e-12)

    @pytest.mark.parametrize("plane", ["horizontal", "vertical"])
    def test_against_simulated_series(self, plane):
        """Variances of u and v of pairs about the true mean, from 100 records of independent turbulence."""
        scan = load_scan("pulsed-4-beam", tilt_deg=0.0, yaw_deg=10.0)
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=100, seed=5)
        pairs = [(2, 3)] if plane == "horizontal" else [(0, 2)]
        found = reconstruct_pairs(series, scan, plane=plane, pairs=pairs)
        expected = pair_stresses(scan, FLOW, wind_speed=10.0, plane=plane, pairs=pairs).isel(pair=0)["measured"]
        n = scan.level_direction[list(pairs[0])]
        axes = [0, 1] if plane == "horizontal" else [0, 2]
        mean = np.linalg.solve(n[:, axes], 10.0 * scan.at_yaw(scan.yaw)[list(pairs[0]), 0])
        names = ["u", "v"] if plane == "horizontal" else ["u", "w"]
        deviation = np.stack([found[name].values - m for name, m in zip(names, mean, strict=True)])
        record = ((found["time"].values - found["time"].values[0]) / np.timedelta64(600, "s")).astype(int)
        for row, column, value in ((0, 0, expected[0]), (1, 1, expected[1]), (0, 1, expected[2])):
            per_record = np.bincount(record, deviation[row] * deviation[column]) / np.bincount(record)
            error = per_record.std() / np.sqrt(len(per_record))
            assert per_record.mean() == pytest.approx(float(value), abs=4.5 * error)  # one false alarm in 150 000
