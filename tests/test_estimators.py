"""The classic point estimators: laws, numpy's own least squares, Monte Carlo, and a measured hour."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs.design.estimators import ESTIMATORS, IEC_RATIOS
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.registry import WeakPrior

TRUTH = np.array([1.8, 0.9, 0.5, 0.1, -0.4, 0.05])
STRESS = arrays(np.float64, 6, elements=st.floats(-0.3, 0.3)).map(
    lambda part: part + np.array([1.8, 0.9, 0.8, 0.0, 0.0, 0.0])
)
"""Positive definite: each row's covariances sum to less than its variance."""
ROUNDING = 1e-11
"""Rounding of variances of order 1, times the condition number of the six beams at 15°, about 100, times sums."""
SIX = brs.load_scan("6-beam")
CONE = brs.load_scan("50-beam")
COSINE_SQUARED = np.cos(np.deg2rad(15.0)) ** 2
BEST = {"lsq": "6-beam", "lsq-no-cross": "6-beam"}


def noise_free(stress, scan, **options):
    """Records of a scan that measures these stresses exactly, at the scan's own yaw."""
    variance = brs.geometry.radial_variance(scan, np.atleast_2d(stress))
    return records_of(variance, scan, yaw_deg=float(np.rad2deg(scan.yaw)), **options)


def stresses(stress, scan, **options):
    """The stresses that an estimator finds in exact variances, shape (6,)."""
    return brs.estimate(noise_free(stress, scan), scan, **options)["stress"].values[0]


class TestExactData:
    @settings(deadline=None)  # the first call compiles and imports
    @given(STRESS)
    def test_six_beams_give_every_tensor_back(self, stress):
        found = brs.estimate(noise_free(stress, SIX), SIX)
        np.testing.assert_allclose(found["stress"].values[0], stress, atol=ROUNDING)
        assert found["identified"].all()
        assert found["realizable"].all()

    def test_a_cone_gives_the_covariances_and_leaves_the_variances_open(self):
        found = brs.estimate(noise_free(TRUTH, CONE), CONE)
        assert found["identified"].values[0].tolist() == [False, False, False, True, True, True]
        assert np.isnan(found["stress"].values[0, :3]).all()
        np.testing.assert_allclose(found["stress"].values[0, 3:], TRUTH[3:], atol=ROUNDING)
        assert not found["realizable"].values[0]  # no tensor is determined

    def test_a_cone_gives_the_combinations_that_it_sees(self):
        slope = np.tan(np.deg2rad(15.0)) ** 2
        rows = {
            "mean": [1.0, 0.5 * slope, 0.5 * slope, 0.0, 0.0, 0.0],
            "difference": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
            "energy": [0.5, 0.5, 0.5, 0.0, 0.0, 0.0],
        }
        found = brs.estimate(noise_free(TRUTH, CONE), CONE, combinations=rows)
        assert found["name"].values.tolist() == list(rows)
        assert found["combination_identified"].values[0].tolist() == [True, True, False]
        wanted = np.array(list(rows.values())) @ TRUTH
        np.testing.assert_allclose(found["combination"].values[0, :2], wanted[:2], atol=ROUNDING)
        assert np.isnan(found["combination"].values[0, 2])

    def test_at_the_magic_angle_one_cone_gives_the_kinetic_energy(self):
        scan = brs.load_scan("50-beam", opening_angle_deg=float(np.rad2deg(np.arctan(np.sqrt(2.0)))))
        found = brs.estimate(noise_free(TRUTH, scan), scan, combinations={"energy": [0.5, 0.5, 0.5, 0, 0, 0]})
        assert float(found["combination"][0, 0]) == pytest.approx(0.5 * TRUTH[:3].sum(), abs=ROUNDING)
        assert not found["identified"].values[0, :3].any()

    @pytest.mark.parametrize("method", ESTIMATORS)
    def test_every_method_is_right_where_its_assumption_holds(self, method):
        form = ESTIMATORS[method](*IEC_RATIOS)
        unknown = np.array([1.8, 0.9, 0.5, 0.1, -0.4, 0.05])[np.isin(brs.STRESSES, form.estimated)]
        truth = form.basis @ unknown
        found = stresses(truth, brs.load_scan(BEST.get(method, "50-beam")), method=method)
        estimated = np.isin(brs.STRESSES, form.estimated)
        np.testing.assert_allclose(found[estimated], truth[estimated], atol=ROUNDING)
        assert np.isnan(found[~estimated]).all()

    def test_the_ratios_are_those_of_vv_and_of_ww(self):
        """Two beams to the sides do not see ww; the same two on edge do not see vv."""
        truth = [1.8, 0.5 * 1.8, 0.1 * 1.8, 0.0, 0.0, 0.0]
        for direction in ([0.8, 0.6, 0.0], [0.8, 0.0, 0.6]):
            scan = brs.Scan("one", [direction], [98.0], [0.0], 1.0)
            found = stresses(truth, scan, method="ratio", ratio_vv=0.5, ratio_ww=0.1)
            assert found[0] == pytest.approx(1.8, rel=1e-13)
        assert stresses([1.8, 0.64 * 1.8, 0.25 * 1.8, 0.0, 0.0, 0.0], SIX, method="ratio")[0] == pytest.approx(1.8)

    def test_four_beams_on_one_cone_cannot_have_four_stresses(self):
        scan = brs.load_scan("4-beam")
        found = brs.estimate(noise_free(TRUTH, scan), scan, method="lsq-no-cross")
        assert found["identified"].values[0].tolist() == [False, False, False, False, True, False]

    def test_the_corners_of_a_square_with_a_centre_see_vv_and_ww_only_together(self):
        """At 45° every beam has n₂² = n₃²: the matrix of the four-stress fit is singular, as the paper says."""
        scan, together = brs.load_scan("5-beam"), {"across": [0.0, 0.5, 0.5, 0.0, 0.0, 0.0]}
        truth = [1.8, 0.9, 0.5, 0.0, -0.4, 0.0]
        found = brs.estimate(noise_free(truth, scan), scan, method="lsq-no-cross", combinations=together)
        assert found["identified"].values[0].tolist() == [True, False, False, False, True, False]
        np.testing.assert_allclose(found["stress"].values[0, [0, 4]], [1.8, -0.4], atol=ROUNDING)
        assert float(found["combination"][0, 0]) == pytest.approx(0.7, abs=ROUNDING)

    def test_a_reduced_fit_to_a_cone_puts_half_of_vv_and_ww_into_uu(self):
        """vv and ww add (vv + ww)/2 sin²φ on average round the cone; the covariances have other harmonics."""
        isotropic_across = np.array([1.8, 0.7, 0.7, 0.1, -0.4, 0.05])
        found = stresses(isotropic_across, CONE, method="lsq-reduced")
        assert found[0] == pytest.approx(1.8 + 0.7 * np.tan(np.deg2rad(15.0)) ** 2, abs=ROUNDING)
        np.testing.assert_allclose(found[3:], isotropic_across[3:], atol=ROUNDING)


class TestLaws:
    @settings(deadline=None)  # the first call compiles and imports
    @given(arrays(np.float64, 50, elements=st.floats(0.1, 5.0)))
    def test_isotropy_is_cos_squared_times_the_projection_on_one_cone(self, variance):
        """(1 + iso) = (1 + LSP)·cos²φ for any data, so for the relative errors of means as well."""
        records = records_of(variance[None], CONE)
        projected, isotropic = (
            brs.estimate(records, CONE, method=name)["stress"][0, 0] for name in ("lsp", "isotropy")
        )
        assert float(isotropic) == pytest.approx(float(projected) * COSINE_SQUARED, rel=1e-13)

    @settings(deadline=None)  # the first call compiles and imports
    @given(STRESS)
    def test_the_two_simple_estimators_are_the_ends_of_what_the_cone_allows(self, stress):
        """uu of every tensor that fits the cone's mean variance with 0 ≤ (vv + ww)/2 ≤ uu lies between them."""
        variance = brs.geometry.radial_variance(CONE, stress).mean()
        low, high = (stresses(stress, CONE, method=name)[0] for name in ("isotropy", "lsp"))
        for across, end in ((lambda uu: uu, low), (lambda _: 0.0, high)):
            assert end * COSINE_SQUARED + across(end) * (1.0 - COSINE_SQUARED) == pytest.approx(variance, abs=ROUNDING)
        uu, across = stress[0], 0.5 * (stress[1] + stress[2])
        assert (low <= uu + ROUNDING) == (across <= uu + ROUNDING)
        assert (uu <= high + ROUNDING) == (across >= -ROUNDING)

    def test_isotropic_turbulence_gives_its_variance_to_isotropy_and_more_to_the_projection(self):
        truth = [0.7, 0.7, 0.7, 0.0, 0.0, 0.0]
        assert stresses(truth, CONE, method="isotropy")[0] == pytest.approx(0.7, rel=1e-13)
        assert stresses(truth, CONE, method="lsp")[0] == pytest.approx(0.7 / COSINE_SQUARED, rel=1e-13)
        scan = brs.load_scan("spinnerlidar")
        n_1 = scan.line_of_sight[:, 0]
        assert stresses(truth, scan, method="isotropy")[0] == pytest.approx(0.7, rel=1e-13)
        assert stresses(truth, scan, method="lsp")[0] == pytest.approx(0.7 * (n_1**2).sum() / (n_1**4).sum(), rel=1e-13)

    def test_a_ratio_of_one_is_isotropy_and_of_zero_the_projection(self):
        for ratio, method in ((1.0, "isotropy"), (0.0, "lsp")):
            found = stresses(TRUTH, CONE, method="ratio", ratio_vv=ratio, ratio_ww=ratio)
            assert found[0] == stresses(TRUTH, CONE, method=method)[0]

    @settings(deadline=None)  # the first call compiles and imports
    @given(STRESS, st.floats(0.0, 2.0))
    def test_extra_variance_on_all_beams_is_isotropic_stress(self, stress, extra):
        records = noise_free(stress, SIX)
        more = records.assign(variance=records["variance"] + extra)
        shift = brs.estimate(more, SIX)["stress"] - brs.estimate(records, SIX)["stress"]
        np.testing.assert_allclose(shift.values[0], extra * np.array([1, 1, 1, 0, 0, 0]), atol=ROUNDING)

    @settings(deadline=None)  # the first call compiles and imports
    @given(STRESS, st.floats(-180.0, 180.0))
    def test_the_yaw_of_each_record_turns_the_tensor(self, stress, yaw_deg):
        """The same variances at another yaw are of the tensor turned with the wind's frame."""
        records = noise_free(stress, SIX)
        turned = records.assign(yaw=records["yaw"] + yaw_deg)
        wanted = brs.geometry.rotate_stress(stress, yaw_matrix(np.deg2rad(yaw_deg)))
        np.testing.assert_allclose(brs.estimate(turned, SIX)["stress"].values[0], wanted, atol=ROUNDING)

    def test_a_cone_seen_from_the_side_leaves_other_stresses_open(self):
        records = noise_free(TRUTH, CONE)
        records["yaw"][:] = 20.0
        assert brs.estimate(records, CONE)["identified"].values[0].tolist() == [False, False, False, False, True, True]

    def test_the_scans_own_yaw_does_not_count(self):
        records = noise_free(TRUTH, SIX)
        xr.testing.assert_identical(
            brs.estimate(records, SIX)["stress"], brs.estimate(records, SIX.with_yaw(0.3))["stress"]
        )


class TestAgainstNumpy:
    def test_records_are_solved_as_lstsq_solves_them(self):
        """Every record with its own yaw and beams, 40 of them, by numpy's least squares on its own."""
        rng = np.random.default_rng(3)
        scan = brs.load_scan("51-beam")
        records = records_of(rng.uniform(0.5, 2.0, (40, 51)), scan)
        records["yaw"][:] = rng.uniform(-20.0, 20.0, 40)
        records["flag"][:] = rng.random((40, 51)) < 0.5
        found = brs.estimate(records, scan)["stress"].values
        for k in range(40):
            used = records["flag"].values[k] == 0
            matrix = brs.geometry.design_matrix(scan.at_yaw(np.deg2rad(float(records["yaw"][k]))))[used]
            if used[-1]:
                wanted = np.linalg.lstsq(matrix, records["variance"].values[k, used])[0]
                np.testing.assert_allclose(found[k], wanted, rtol=1e-10, atol=1e-10)  # rounding × condition, 100
            else:
                assert np.isnan(found[k, :4]).all()  # the cone alone, seen from the side
        assert 5 < np.isfinite(found[:, 0]).sum() < 35

    def test_flagged_beams_have_no_part(self):
        records = noise_free(np.stack([TRUTH, TRUTH]), SIX)
        records["variance"][1, 2] = 1e6
        records["flag"][1, 2] = 1
        found = brs.estimate(records, SIX, method="lsp")["stress"].values[:, 0]
        scan = SIX.select(np.delete(SIX.beam, 2))
        assert found[1] == pytest.approx(stresses(TRUTH, scan, method="lsp")[0], rel=1e-13)
        assert not brs.estimate(records, SIX)["identified"].values[1].any() or found[1] != found[0]

    def test_records_do_not_depend_on_their_company(self):
        rng = np.random.default_rng(4)
        noise = plain_noise(SIX)
        records = records_of(rng.uniform(0.5, 2.0, (30, 6)), SIX)
        whole = brs.estimate(records, SIX, noise=noise)
        for k in (0, 17):
            alone = brs.estimate(records.isel(record=[k]), SIX, noise=noise)
            np.testing.assert_allclose(whole["stress"][k], alone["stress"][0], rtol=1e-12)
            np.testing.assert_allclose(whole["standard_error"][k], alone["standard_error"][0], rtol=1e-12)

    def test_beams_that_the_records_lack_are_left_out_of_the_scan(self):
        records = noise_free(TRUTH, SIX).isel(beam=[5, 0, 1])
        scan = SIX.select(records["beam"].values)
        found = brs.estimate(records, SIX, method="isotropy")["stress"][0, 0]
        assert float(found) == pytest.approx(stresses(TRUTH, scan, method="isotropy")[0])


class TestRecordsWithoutAnEstimate:
    def test_they_stay_as_nan(self):
        records = noise_free(np.stack([TRUTH] * 4), SIX)
        records["flag"][1] = 1
        records["yaw"][2] = np.nan
        records["variance"][3] = np.nan
        found = brs.estimate(records, SIX, noise=plain_noise(SIX), combinations={"energy": [0.5, 0.5, 0.5, 0, 0, 0]})
        assert found.sizes["record"] == 4
        assert found["realizable"].values.tolist() == [True, False, False, False]
        for name in ("stress", "standard_error", "combination", "combination_standard_error"):
            assert np.isfinite(found[name].values[0]).all()
            assert np.isnan(found[name].values[1:]).all()

    def test_without_a_wind_speed_there_is_an_estimate_but_no_error(self):
        records = noise_free(np.stack([TRUTH] * 2), SIX)
        records["wind_speed"][1] = np.nan
        found = brs.estimate(records, SIX, noise=plain_noise(SIX))
        np.testing.assert_allclose(found["stress"].values[1], TRUTH, atol=ROUNDING)
        assert np.isnan(found["standard_error"].values[1]).all()
        weighted = brs.estimate(records, SIX, noise=plain_noise(SIX), weights="noise")
        assert np.isnan(weighted["stress"].values[1]).all()
        np.testing.assert_allclose(weighted["stress"].values[0], TRUTH, atol=100 * ROUNDING)

    def test_a_tensor_that_is_not_realizable_is_called_so(self):
        not_realizable = np.array([1.8, 0.9, -0.1, 0.0, 0.0, 0.0])
        found = brs.estimate(noise_free(np.stack([TRUTH, not_realizable]), SIX), SIX)
        assert found["realizable"].values.tolist() == [True, False]
        np.testing.assert_allclose(found["stress"].values[1], not_realizable, atol=ROUNDING)

    def test_methods_that_assume_stresses_are_judged_with_what_they_assume(self):
        records = noise_free(TRUTH, CONE)
        assert brs.estimate(records, CONE, method="lsp")["realizable"].all()
        assert not brs.estimate(records, CONE, method="lsq-reduced")["realizable"].any()  # uv ≠ 0 beside vv = 0


class TestStandardErrors:
    @pytest.mark.parametrize("method", ["lsq", "lsq-no-cross", "lsq-reduced", "lsp", "isotropy", "ratio"])
    @pytest.mark.parametrize("weights", ["none", "noise"])
    def test_they_are_the_scatter_of_many_records(self, method, weights):
        """Errors evaluated at the truth, against the scatter of 20 000 records of small noise.

        The sample variance of n nearly normal numbers has a relative standard deviation of √(2/n), its root half of
        it: 0.5 %. The noise is 3 %, so that what is beyond first order is about 0.1 %. Five standard deviations.
        """
        n_record = 20_000
        scan = brs.load_scan(BEST.get(method, "6-beam"))
        noise = plain_noise(scan, relative_variance=0.03**2)
        form = ESTIMATORS[method](*IEC_RATIOS)
        truth = form.basis @ TRUTH[np.isin(brs.STRESSES, form.estimated)]
        drawn = draw_variances(np.tile(truth, (n_record, 1)), scan, noise, np.random.default_rng(8))
        options = {"method": method, "weights": weights, "noise": noise}
        energy = {"energy": [0.5, 0.5, 0.5, 0.0, 0.0, 0.0]}
        scattered = brs.estimate(records_of(drawn, scan), scan, combinations=energy, **options)
        exact = brs.estimate(noise_free(truth, scan), scan, combinations=energy, **options)
        estimated = np.isin(brs.STRESSES, form.estimated)
        ratio = scattered["stress"].values[:, estimated].std(axis=0) / exact["standard_error"].values[0, estimated]
        np.testing.assert_allclose(ratio, 1.0, atol=5 * 0.005 + 0.002)
        ratio = scattered["combination"].std("record").values / exact["combination_standard_error"].values[0]
        np.testing.assert_allclose(ratio, 1.0, atol=5 * 0.005 + 0.002)

    def test_for_one_beam_it_is_the_noise_of_the_beam(self):
        scan = brs.load_scan("staring")
        found = brs.estimate(
            noise_free(TRUTH, scan), scan, noise=plain_noise(scan, relative_variance=0.06), method="lsp"
        )
        assert float(found["standard_error"][0, 0]) == pytest.approx(1.8 * np.sqrt(0.06), rel=1e-14)

    def test_weights_make_no_error_larger(self):
        """Gauss and Markov: with the covariance of the unweighted fit, for every record and stress."""
        scan = brs.load_scan("51-beam")
        noise = plain_noise(scan)
        rng = np.random.default_rng(9)
        records = records_of(draw_variances(WeakPrior().draw(50, seed=1), scan, noise, rng), scan)
        plain, weighted = (
            brs.estimate(records, scan, noise=noise, weights=weights)["standard_error"].values
            for weights in ("none", "noise")
        )
        known = np.isfinite(weighted)
        assert known.sum() > 250
        assert np.all(weighted[known] <= plain[known] * (1.0 + 1e-9))
        assert np.min(weighted[known] / plain[known]) < 0.99

    def test_weights_change_nothing_where_beams_are_as_many_as_stresses(self):
        rng = np.random.default_rng(10)
        records = records_of(rng.uniform(0.8, 1.2, (5, 6)), SIX)
        np.testing.assert_allclose(
            brs.estimate(records, SIX, noise=plain_noise(SIX), weights="noise")["stress"],
            brs.estimate(records, SIX)["stress"],
            atol=100 * ROUNDING,  # times the condition of the noise, below 100
        )

    def test_weighted_fits_are_those_of_the_normal_equations(self):
        """(AᵀWA)⁻¹AᵀWy with W written out, one record with beams left out."""
        rng = np.random.default_rng(11)
        scan = brs.load_scan("51-beam")
        noise = plain_noise(scan)
        records = records_of(rng.uniform(0.9, 1.1, (1, 51)), scan, yaw_deg=7.0)
        records["flag"][0, ::3] = 1
        used = records["flag"].values[0] == 0
        matrix = brs.geometry.design_matrix(scan.at_yaw(np.deg2rad(7.0)))[used]
        y = records["variance"].values[0, used]
        mean = matrix @ np.linalg.lstsq(matrix, y)[0]
        inverse = np.linalg.inv(noise.covariance[0][np.ix_(used, used)] * np.outer(mean, mean))
        normal = matrix.T @ inverse @ matrix
        found = brs.estimate(records, scan, noise=noise, weights="noise")
        np.testing.assert_allclose(
            found["stress"].values[0], np.linalg.solve(normal, matrix.T @ inverse @ y), rtol=1e-7
        )
        wanted = np.sqrt(np.diag(np.linalg.inv(normal)))
        np.testing.assert_allclose(found["standard_error"].values[0], wanted, rtol=1e-7)

    def test_a_bank_gives_each_record_its_own_noise(self):
        faster = replace(plain_noise(SIX, relative_variance=0.09), wind_speed=20.0)
        noise = Noise.join((plain_noise(SIX, relative_variance=0.04), faster))
        records = noise_free(np.stack([TRUTH, TRUTH]), SIX)
        records["wind_speed"][:] = [10.0, 20.0]
        error = brs.estimate(records, SIX, noise=noise)["standard_error"].values
        np.testing.assert_allclose(error[1] / error[0], 1.5, rtol=ROUNDING)


class TestErrors:
    def test_unknown_names(self):
        records = noise_free(TRUTH, SIX)
        with pytest.raises(
            brs.InputError, match="Unknown method of estimation 'ols': it must be one of lsq, lsq-no-cross"
        ):
            brs.estimate(records, SIX, method="ols")
        with pytest.raises(brs.InputError, match="Unknown weights 'all': it must be one of none, noise"):
            brs.estimate(records, SIX, weights="all")

    def test_weights_need_noise(self):
        with pytest.raises(brs.InputError, match="Invalid weights 'noise' without noise: give noise="):
            brs.estimate(noise_free(TRUTH, SIX), SIX, weights="noise")

    def test_ratios_are_for_the_ratio_method(self):
        records = noise_free(TRUTH, SIX)
        with pytest.raises(
            brs.InputError, match=r"ratio_vv 0\.5 and ratio_ww 0\.25 for the method 'lsp': only 'ratio'"
        ):
            brs.estimate(records, SIX, method="lsp", ratio_vv=0.5)
        with pytest.raises(brs.InputError, match=r"Invalid ratio_ww -0\.1: it must be a finite number, zero or above"):
            brs.estimate(records, SIX, method="ratio", ratio_ww=-0.1)

    def test_combinations_have_six_coefficients(self):
        with pytest.raises(brs.InputError, match=r"coefficients of the combination 'energy' of shape \(3,\)"):
            brs.estimate(noise_free(TRUTH, SIX), SIX, combinations={"energy": [0.5, 0.5, 0.5]})

    def test_records_need_their_variables(self):
        with pytest.raises(brs.InputError, match=r"The records have no yaw with dims \('record',\)"):
            brs.estimate(noise_free(TRUTH, SIX).drop_vars("yaw"), SIX)
        with pytest.raises(brs.InputError, match="The records have no wind_speed"):
            brs.estimate(noise_free(TRUTH, SIX).drop_vars("wind_speed"), SIX, noise=plain_noise(SIX))

    def test_noise_of_another_scan_or_length(self):
        other = brs.load_scan("6-beam", opening_angle_deg=30.0)
        with pytest.raises(brs.NoiseMismatchError):
            brs.estimate(noise_free(TRUTH, SIX), SIX, noise=plain_noise(other))
        with pytest.raises(brs.InputError, match="The records last 1800 s and the noise is for records of 600 s"):
            brs.estimate(noise_free(TRUTH, SIX).assign_attrs(duration=1800.0), SIX, noise=plain_noise(SIX))

    def test_singular_noise_cannot_weigh(self):
        noise = plain_noise(SIX, reach=np.inf)  # all beams have the same error
        with pytest.raises(
            brs.NotPositiveDefiniteError, match="correlation matrix is singular: its smallest eigenvalue"
        ):
            brs.estimate(noise_free(TRUTH, SIX), SIX, noise=noise, weights="noise")


class TestDataset:
    def test_what_is_in_it(self):
        records = noise_free(np.stack([TRUTH] * 3), SIX)
        found = brs.estimate(records, SIX)
        assert set(found.data_vars) == {"stress", "identified", "realizable"}
        assert found["stress"].dims == ("record", "component")
        assert found["component"].values.tolist() == list(brs.STRESSES)
        xr.testing.assert_identical(found["time"], records["time"])
        assert found.attrs == {
            "method": "lsq",
            "assumption": "nothing",
            "weights": "none",
            "scan": "6-beam",
            "scan_key": SIX.key,
        }
        assert "standard_error" in brs.estimate(records, SIX, noise=plain_noise(SIX))

    def test_it_can_be_saved(self, tmp_path):
        found = brs.estimate(
            noise_free(TRUTH, SIX), SIX, noise=plain_noise(SIX), combinations={"e": [1, 1, 1, 0, 0, 0]}
        )
        found.to_netcdf(tmp_path / "estimates.nc", engine="h5netcdf")
        with xr.open_dataset(tmp_path / "estimates.nc", engine="h5netcdf") as read:
            np.testing.assert_array_equal(read["stress"], found["stress"])

    def test_no_record_is_no_error(self):
        assert brs.estimate(noise_free(TRUTH, SIX).isel(record=slice(0, 0)), SIX).sizes["record"] == 0


class TestMeasuredHour:
    """Least squares on the six lowest heights of a measured six-beam hour: most tensors are not realizable."""

    @pytest.fixture
    def hour(self):
        path = Path(__file__).parents[1].parent / "shared" / "data" / "six-beam-hour" / "wls200s_sixbeam_20210513T12.nc"
        if not path.is_file():
            pytest.skip(f"NOT TESTED ON MEASURED DATA: no file {path.name}, see ../shared/data/six-beam-hour/README.md")
        with xr.open_dataset(path) as data:
            return data.load()

    def test_most_tensors_are_not_realizable(self, hour):
        """21 of 36, and record by record what the inverse of the design matrix says."""
        azimuth = np.deg2rad(72.0 * np.append(np.arange(5), 0))
        elevation = np.deg2rad(np.append(np.full(5, 75.0), 90.0))
        across = np.cos(elevation)
        direction = np.column_stack([across * np.sin(azimuth), across * np.cos(azimuth), np.sin(elevation)])
        scan = brs.Scan("hour", direction, np.full(6, 100.0), 5.0 * np.arange(6.0), scan_duration=30.2)
        slant = np.round(hour["azimuth"].values / 72.0).astype(int) % 5
        beam = np.where(hour["elevation"].values > 80.0, 5, slant)
        start = (hour["time"].values - np.datetime64("2021-05-13T12:00")) // np.timedelta64(600, "s")
        bad = 0
        for gate in range(6):  # slant and vertical gates of the same number are at the same height to 1 %
            velocity = hour["radial_wind_speed"].values[:, gate].astype(np.float64)
            series = xr.Dataset(
                {"radial_velocity": ("sample", velocity)},
                {"time": ("sample", hour["time"].values), "beam": ("sample", beam)},
            )
            records = brs.make_records(series, scan)
            records["yaw"][:] = 0.0  # the frame does not matter to realizability
            found = brs.estimate(records, scan)
            assert found["identified"].all()
            for k in range(6):
                variance = [np.nanvar(velocity[(beam == b) & (start == k)]) for b in range(6)]
                wanted = np.linalg.solve(brs.geometry.design_matrix(scan), variance)
                np.testing.assert_allclose(found["stress"].values[k], wanted, atol=1e-10)  # rounding × condition, 51
                bad += np.linalg.eigvalsh(brs.geometry.unpack_stress(wanted))[0] < 0.0
                assert bool(found["realizable"][k]) == (
                    np.linalg.eigvalsh(brs.geometry.unpack_stress(wanted))[0] >= 0.0
                )
        assert bad == 21
