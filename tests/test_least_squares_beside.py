"""Least squares beside the posterior: that of `estimate`, less the instrument's noise."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import STRESSES, Nuisances, estimate, fit, load_scan
from bayes_rs.fits import least_squares_beside
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.priors import WeakPrior

COLUMNS = ("least_squares", "least_squares_se")


def records_and_noise(name, n_record=5, yaw_deg=(0.0, 7.0, -12.0, 30.0, 0.0), **changes):
    """Records of the weak prior, each with a wind direction of its own."""
    scan = load_scan(name, **changes)
    noise = plain_noise(scan)
    rng = np.random.default_rng(31)
    records = records_of(draw_variances(WeakPrior(log_sd_uu=0.3).draw(n_record, rng), scan, noise, rng), scan)
    records["yaw"].values[:] = yaw_deg[:n_record]
    return records, scan, noise


def beside(found):
    """Least squares and its error in the summary of a fit, each (n_record, 6)."""
    table = found.summary()
    return [table[name].to_numpy().reshape(-1, 6) for name in COLUMNS]


class TestIsThatOfEstimate:
    @pytest.mark.parametrize("name", ["2-beam", "6-beam", "50-beam"])
    def test_for_all_directions_and_missing_beams(self, name):
        records, scan, noise = records_and_noise(name)
        records["flag"].values[1, 0] = 1
        records["flag"].values[2, :2] = 1
        found = fit(records, scan, noise=noise, seed=1, target_ess=200)
        expected = estimate(records, scan, noise=noise)
        for values, variable in zip(beside(found), ("stress", "standard_error"), strict=True):
            wanted = np.where(found.fitted[:, None], expected[variable].values, np.nan)
            # the inverse is of one frame for all records: rounding over the smallest singular value, about 1e-12
            np.testing.assert_allclose(values, wanted, rtol=1e-8, atol=1e-10)

    def test_less_the_noise_of_the_instrument(self):
        records, scan, noise = records_and_noise("6-beam", opening_angle_deg=45.0)
        more = records.copy(deep=True)
        more["variance"] = records["variance"] + 0.3
        expected = estimate(records, scan)["stress"].values
        for options in ({}, {"nuisances": Nuisances(instrument_noise_log_sd=0.3)}):
            found = fit(more, scan, noise=noise, seed=1, target_ess=200, instrument_noise=0.3, **options)
            np.testing.assert_allclose(beside(found)[0], expected, rtol=1e-8, atol=1e-10)
        more["instrument_noise"] = more["variance"] * 0.0 + 0.3
        found = fit(more, scan, noise=noise, seed=1, target_ess=200, instrument_noise="records")
        np.testing.assert_allclose(beside(found)[0], expected, rtol=1e-8, atol=1e-10)

    def test_a_tilt_of_its_own_turns_the_beams(self):
        """Exact variances of a scan that leans back by 4° give the tensor again."""
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        leaning = load_scan("6-beam", opening_angle_deg=45.0, tilt_deg=4.0)
        stress = np.array([[1.0, 0.6, 0.4, 0.1, -0.2, 0.05]])
        records = records_of(stress @ design_matrix(leaning).T, scan)
        records["tilt"] = ("record", [4.0])
        records["roll"] = ("record", [0.0])
        found = fit(records, scan, noise=plain_noise(scan), seed=1, target_ess=200)
        np.testing.assert_allclose(beside(found)[0], stress, atol=1e-9)


class TestTable:
    def test_errors_grow_with_the_inflation(self):
        records, scan, noise = records_and_noise("6-beam", opening_angle_deg=45.0)
        plain, wide = (
            beside(fit(records, scan, noise=noise, seed=1, target_ess=200, nuisances=Nuisances(inflation=factor)))[1]
            for factor in (1.0, 4.0)
        )
        np.testing.assert_allclose(wide, 2.0 * plain, rtol=1e-9)

    def test_an_estimate_that_gives_a_beam_less_than_nothing_has_no_error(self):
        """Least squares give a beam a variance below zero here; its scatter is of no number."""
        records, scan, noise = records_and_noise("6-beam@n_beams=9,opening_angle_deg=45", 1)
        records["variance"].values[0] = [5.0, *[0.01] * 8]  # no tensor has one strong beam of nine
        value, error = beside(fit(records, scan, noise=noise, seed=1, target_ess=200))
        assert np.isfinite(value).all()
        assert (design_matrix(scan) @ value[0]).min() < 0.0
        assert np.isnan(error).all()

    def test_very_many_beams_have_no_errors(self, monkeypatch):
        monkeypatch.setattr(least_squares_beside, "MOST_BEAMS", 5)
        records, scan, noise = records_and_noise("6-beam", 2, opening_angle_deg=45.0)
        value, error = beside(fit(records, scan, noise=noise, seed=1, target_ess=200))
        assert np.isfinite(value).all()
        assert np.isnan(error).all()

    def test_other_intervals_keep_it_and_the_lidars_frame_has_none(self):
        records, scan, noise = records_and_noise("6-beam", opening_angle_deg=45.0)
        found = fit(records, scan, noise=noise, seed=1, target_ess=200)
        table = found.summary(prob=0.5, derived=["tke"])
        stresses = table[table["stress"].isin(STRESSES)]
        for name, expected in zip(COLUMNS, beside(found), strict=True):
            np.testing.assert_array_equal(stresses[name].to_numpy().reshape(-1, 6), expected)
            assert table[table["stress"] == "tke"][name].isna().all()
            assert found.summary(frame="lidar")[name].isna().all()
