"""Variances and covariances of beams together: theory against simulation, laws, the data, and the fit."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scenes import point_scan
from test_sonic_series import write_toa5

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.fits.digest import digest
from bayes_rs.fits.fit_options import NoiseOptions
from bayes_rs.fits.headline import measured_by
from bayes_rs.fits.noise_choice import fit_inputs
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.stress import pack_stress, unpack_stress
from bayes_rs.likelihoods.base import beam_data
from bayes_rs.likelihoods.covariances import ViewData, covariance_forms, covariance_likelihood, factor_products
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, log_normal_likelihood
from bayes_rs.records.beam_correlation import MOST_BEAMS, correlated_beams, pair_columns
from bayes_rs.theory.beam_covariances import (
    Views,
    coherence_slopes,
    component_weights,
    covariance_moments,
    view_pairs,
)
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.one_point import one_point_spectra
from bayes_rs.turbulence.two_point import velocity_covariance

FLOW = brs.load_turbulence("fu-2022")
SCAN = brs.load_scan("6-beam@opening_angle_deg=30")
N_SAMPLE = 600
ROUNDING = 1e-12
TABLES = 2e-3  # of uu: the tolerance of the covariances, and what the sums over few lags add
FEW_LAGS = 5e-3  # relative error of sums of squares from few lags


def moments_of(scan=SCAN, flow=FLOW, *, wind_speed=10.0, yaw=0.0, n_sample=N_SAMPLE):
    return covariance_moments(Views.of_scan(scan, yaw), flow, wind_speed=wind_speed, n_sample=n_sample)


def slopes_of(scan=SCAN, flow=FLOW):
    return coherence_slopes(Views.of_scan(scan, 0.0), flow, wind_speed=10.0, n_sample=N_SAMPLE)


def expected_of(moments, direction):
    first, second = view_pairs(len(direction))
    return np.sum(component_weights(direction[first], direction[second]) * moments.tensor, axis=-1)


def data_means(moments, direction):
    n_view = len(direction)
    first, second = (side[n_view:] for side in view_pairs(n_view))
    expected = expected_of(moments, direction)
    own = expected[:n_view]
    return np.concatenate([np.log(own), np.arctanh(expected[n_view:] / np.sqrt(own[first] * own[second]))])


def random_stress(rng, count):
    root = rng.normal(size=(count, 3, 3))
    return pack_stress(root @ root.swapaxes(-1, -2))


class TestTheory:
    def test_expected_covariances_are_those_of_an_obvious_sum(self):
        """E y_ab = Σ_ij P_ij C_ab(j, i) / N, sample by sample, at the samples' own places and times."""
        scan = point_scan([[-0.9, 0.3, 0.3], [-0.9, -0.3, 0.3]], times=[0.0, 2.0], scan_duration=5.0)
        n = 24
        found = covariance_moments(Views.of_scan(scan, 0.1), FLOW, wind_speed=8.0, n_sample=n)
        direction = scan.at_yaw(0.1)
        place = direction[:, None] * scan.focus_distance[:, None, None] + np.zeros((2, n, 3))
        place[:, :, 0] -= 8.0 * (scan.beam_time[:, None] + scan.scan_duration * np.arange(n))
        for datum, (a, b) in enumerate(zip(*view_pairs(2), strict=True)):
            apart = place[b][None] - place[a][:, None]
            tensor = velocity_covariance(apart, FLOW, tolerance=1e-4)
            centre = np.eye(n) - 1.0 / n
            slow = np.einsum("ij,jkpq,ki->pq", centre, tensor, centre) / n
            np.testing.assert_allclose(
                found.tensor[datum], pack_stress(slow), atol=TABLES * FLOW.stresses()[0], rtol=0.0
            )

    def test_moments_of_the_data_are_those_of_simulated_records(self):
        """ln y and z of 500 records: standard deviations within 4 standard errors, means too, as a whole."""
        n_record = 500
        scan = brs.load_scan("4-beam@opening_angle_deg=20")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=n_record, seed=3)
        records = brs.make_records(series, scan, correlations=True)
        data = np.concatenate([np.log(records["variance"].values), np.arctanh(records["beam_correlation"].values)], 1)
        moments = moments_of(scan)
        sd = np.sqrt(moments.covariance.diagonal())
        off = (data.mean(axis=0) - data_means(moments, scan.at_yaw(0.0)) - moments.bias) / (sd / np.sqrt(n_record))
        assert np.max(np.abs(off)) < 4.0
        ratio = data.std(axis=0) / sd
        # a standard deviation of n records has the relative error 1/sqrt(2n); ln y and z are of first order, 3 %
        assert np.max(np.abs(ratio - 1.0)) < 4.0 / np.sqrt(2.0 * n_record) + 0.03
        whitened = np.linalg.solve(np.linalg.cholesky(moments.covariance), (data - data.mean(axis=0)).T)
        assert np.linalg.eigvalsh(np.cov(whitened)).max() < 1.5

    def test_variances_scatter_as_the_noise_of_the_package_has_it(self):
        noise = brs.noise.theory(SCAN, FLOW, wind_speed=10.0)
        own = moments_of().covariance[: SCAN.n_beam, : SCAN.n_beam]
        # ln(1 + K) on the diagonal, and beside it K times what that is there: less by half of K's difference, 0.03
        np.testing.assert_allclose(own, np.log1p(noise.covariance[0]), rtol=0.03)
        np.testing.assert_allclose(np.diag(own), np.diag(np.log1p(noise.covariance[0])), rtol=FEW_LAGS)

    def test_a_beam_twice_is_correlated_to_one(self):
        scan = point_scan([[-0.9, 0.3, 0.3], [-0.9, 0.3, 0.31]])
        z = data_means(moments_of(scan), scan.at_yaw(0.0))[2]
        assert z > 2.0

    def test_larger_eddies_are_closer_beams(self):
        """The slopes with lateral and vertical scale are those of a scan whose points are closer together."""
        slope = slopes_of()[SCAN.n_beam :]
        assert np.all(slope[:, 1:3] > -0.02)
        assert np.max(slope[:, 1]) > 0.1

    def test_another_anisotropy_comes_with_the_length_scale_that_the_spectra_then_tell(self):
        """The slope with ln Γ is that of the data of other flows, and these have the same spectrum of u."""
        flows = [
            MannTurbulence(1.0, FLOW.length_scale * np.exp(-1.5 * step), FLOW.gamma * np.exp(step))
            for step in (0.0, 0.1)
        ]
        low, high = (data_means(moments_of(flow=flow), SCAN.at_yaw(0.0)) for flow in flows)
        np.testing.assert_allclose(
            slopes_of()[SCAN.n_beam :, 3], (high - low)[SCAN.n_beam :] / 0.1, atol=1e-9, rtol=0.0
        )
        wave = np.geomspace(1e-3, 1e-1, 20)

        def shape(flow):
            values = one_point_spectra(wave, dissipation=1.0, length_scale=flow.length_scale, gamma=flow.gamma)[:, 0]
            spectrum = np.log(wave * values)
            return spectrum - spectrum.mean()

        own = shape(replace(FLOW, dissipation=1.0))
        far = MannTurbulence(1.0, FLOW.length_scale * 0.72**-1.5, FLOW.gamma * 0.72)
        fixed = replace(far, length_scale=FLOW.length_scale)
        assert np.std(shape(far) - own) < 0.3 * np.std(shape(fixed) - own)

    def test_the_dissipation_scales_tensor_and_record_alone(self):
        one, other = moments_of(), moments_of(flow=replace(FLOW, dissipation=2.0 * FLOW.dissipation))
        np.testing.assert_allclose(other.tensor, 2.0 * one.tensor, rtol=1e-9)
        np.testing.assert_allclose(other.record, 2.0 * one.record, rtol=1e-9)
        for name in ("covariance", "bias"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9, atol=1e-12)

    def test_probed_beams_lose_variance(self):
        probed, points = (
            brs.load_scan(f"zx-300@{change}") for change in ("focus_distance=98", "focus_distance=98,probe=point")
        )
        some = probed.beam[::10]
        with_probe, without = (moments_of(scan.select(some)) for scan in (probed, points))
        direction = probed.select(some).at_yaw(0.0)
        n = len(some)
        assert np.all(expected_of(with_probe, direction)[:n] < expected_of(without, direction)[:n])


class TestForms:
    def test_the_model_s_own_stresses_give_the_model_s_covariances(self):
        moments = moments_of(yaw=0.2)
        direction = SCAN.at_yaw(0.2)
        first, second = view_pairs(SCAN.n_beam)
        form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
        np.testing.assert_allclose(factor_products(moments.record) @ form, expected_of(moments, direction), rtol=1e-10)

    def test_points_have_the_variance_n_r_n_for_all_stresses(self):
        moments, stress = moments_of(), random_stress(np.random.default_rng(1), 50)
        direction = SCAN.at_yaw(0.0)
        first, second = view_pairs(SCAN.n_beam)
        form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
        found = (factor_products(stress) @ form)[:, : SCAN.n_beam]
        np.testing.assert_allclose(found, stress @ design_matrix(direction).T, rtol=FEW_LAGS)

    def test_covariances_are_those_of_transformed_velocities(self):
        """n_a · T C Tᵀ n_b with T = L(R) L(R_m)⁻¹, written out."""
        moments, (stress,) = moments_of(), random_stress(np.random.default_rng(2), 1)
        direction = SCAN.at_yaw(0.0)
        first, second = view_pairs(SCAN.n_beam)
        form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
        turn = np.linalg.cholesky(unpack_stress(stress)) @ np.linalg.inv(
            np.linalg.cholesky(unpack_stress(moments.record))
        )
        whole = turn @ unpack_stress(moments.tensor) @ turn.T
        expected = np.einsum("di,dij,dj->d", direction[first], whole, direction[second])
        np.testing.assert_allclose(factor_products(stress) @ form, expected, rtol=1e-9, atol=1e-9)

    def test_no_realizable_stresses_make_a_correlation_beyond_one(self):
        moments, stress = moments_of(), random_stress(np.random.default_rng(3), 2000)
        direction = SCAN.at_yaw(0.0)
        first, second = view_pairs(SCAN.n_beam)
        form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
        found = factor_products(stress) @ form
        n = SCAN.n_beam
        assert np.all(np.abs(found[:, n:]) < np.sqrt(found[:, first[n:]] * found[:, second[n:]]))


class TestLikelihood:
    def made(self, *, correlations=True, noise=0.0):
        moments, rng = moments_of(), np.random.default_rng(4)
        n, n_record = SCAN.n_beam, 5
        data = data_means(moments, SCAN.at_yaw(0.0)) + moments.bias
        data = data + rng.normal(size=(n_record, len(data))) @ np.linalg.cholesky(moments.covariance).T
        variance, correlation = np.exp(data[:, :n]) + noise, np.tanh(data[:, n:])
        if not correlations:
            correlation[:] = np.nan
        used = np.ones(variance.shape, dtype=bool)
        used[0, 2] = False
        direction = SCAN.at_yaw(0.0)
        gain = np.broadcast_to(design_matrix(direction), (n_record, n, 6))
        first, second = view_pairs(n)
        form = covariance_forms(direction[first], direction[second], moments.tensor, moments.record)
        parts = (form, moments.covariance, moments.bias, slopes_of())
        alike = [np.broadcast_to(one, (n_record, *one.shape)) for one in parts]
        own = np.full(variance.shape, noise)
        like = covariance_likelihood(
            beam_data(variance, used, gain, noise), ViewData(variance, used, correlation, own), *alike
        )
        return like, variance, used, gain, moments, noise

    def test_without_correlations_it_is_the_likelihood_of_the_variances(self):
        like, variance, used, gain, moments, _ = self.made(correlations=False)
        n = SCAN.n_beam
        relative = np.broadcast_to(np.expm1(moments.covariance[:n, :n]), (len(variance), n, n))
        other = log_normal_likelihood(variance, used, gain, relative)
        stress = FLOW.stresses() * np.random.default_rng(5).uniform(0.7, 1.3, (len(variance), 40, 6))
        one, two = (each.log_density(stress) for each in (like, other))
        # the stresses can move all six log-variances by themselves: the same but for a constant
        difference = one - two
        # logarithms that differ by 4; n·R n of one is made of sums over few lags
        np.testing.assert_allclose(difference - difference[:, :1], 0.0, atol=1e-3)

    def test_it_is_the_normal_density_of_the_data(self):
        like, *_ = self.made(noise=0.05)
        stress = FLOW.stresses() * np.random.default_rng(6).uniform(0.8, 1.2, (len(like.gain), 3, 6))
        density = like.log_density(stress)
        for record in range(len(like.gain)):
            seen = like.seen[record]
            whole = np.linalg.inv(like.whitening[record][np.ix_(seen, seen)])
            covariance = whole @ whole.T
            for draw in range(3):
                off = (like.datum[record] - like.data_means(stress)[record, draw])[seen]
                expected = -0.5 * (
                    off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(2.0 * np.pi * covariance)[1]
                )
                assert density[record, draw] == pytest.approx(expected, rel=1e-9)

    def test_noise_of_the_instrument_lowers_correlations(self):
        like, *_ = self.made()
        stress = np.broadcast_to(FLOW.stresses(), (len(like.gain), 1, 6))
        quiet, loud = like.data_means(stress), like.data_means(stress, np.full((len(like.gain), 1), 0.2))
        n = SCAN.n_beam
        assert np.all(loud[1, 0, n:] < quiet[1, 0, n:])
        assert np.all(loud[1, 0, :n] > quiet[1, 0, :n])

    def test_stresses_that_are_not_realizable_have_no_likelihood(self):
        like, *_ = self.made()
        stress = np.broadcast_to([1.0, 0.5, 0.2, 0.9, 0.0, 0.0], (len(like.gain), 1, 6))
        assert np.all(like.log_density(stress) == -np.inf)

    def test_few_records_of_it_and_any_layout_in_memory_are_the_same(self):
        like, *_ = self.made()
        stress = FLOW.stresses() * np.random.default_rng(7).uniform(0.8, 1.2, (len(like.gain), 4, 6))
        whole = like.log_density(stress)
        np.testing.assert_array_equal(like.take(np.array([1, 3])).log_density(stress[[1, 3]]), whole[[1, 3]])
        np.testing.assert_allclose(like.records_last().log_density(stress), whole, rtol=ROUNDING)


class TestRecords:
    def series(self, n_records=3, scan=SCAN):
        return brs.simulate(scan, FLOW, wind_speed=10.0, n_records=n_records, seed=8)

    def test_correlations_are_those_of_an_obvious_loop(self):
        series = self.series()
        records = brs.make_records(series, SCAN, correlations=True)
        assert json.loads(records.attrs["correlated_beams"]) == SCAN.beam.tolist()
        time, beam = series["time"].values, series["beam"].values
        start = records["time"].values
        for record in range(3):
            inside = (time >= start[record]) & (time < start[record] + np.timedelta64(600, "s"))
            own = {b: series["radial_velocity"].values[inside & (beam == b)] for b in SCAN.beam.tolist()}
            pairs = [(a, b) for i, a in enumerate(SCAN.beam.tolist()) for b in SCAN.beam.tolist()[i + 1 :]]
            expected = [np.corrcoef(own[a], own[b])[0, 1] for a, b in pairs]
            np.testing.assert_allclose(records["beam_correlation"].values[record], expected, rtol=1e-9)

    def test_a_gap_of_one_beam_takes_the_partners_out(self):
        series = self.series(1)
        gone = (series["beam"].values == 2) & (np.arange(series.sizes["sample"]) % 5 == 0)
        kept = series.isel(sample=~gone)
        records = brs.make_records(kept, SCAN, correlations=True)
        velocity = {b: kept["radial_velocity"].values[kept["beam"].values == b] for b in (0, 2)}
        at = {b: kept["time"].values[kept["beam"].values == b].astype(np.int64) for b in (0, 2)}
        wait = round((SCAN.beam_time[2] - SCAN.beam_time[0]) * 1e9)
        partner = [int(np.argmin(np.abs(at[0] + wait - moment))) for moment in at[2]]
        expected = np.corrcoef(velocity[0][partner], velocity[2])[0, 1]
        column = pair_columns(np.array([0, 2]), SCAN.beam)[0]
        assert records["beam_correlation"].values[0, column] == pytest.approx(expected, rel=1e-9)

    def test_a_pair_with_too_few_samples_has_none(self):
        series = self.series(1)
        some = (series["beam"].values != 3) | (np.arange(series.sizes["sample"]) < 600)
        found = brs.make_records(series.isel(sample=some), SCAN, correlations=True)["beam_correlation"].values[0]
        columns = pair_columns(np.array([3, 0, 1, 2, 4, 5]), SCAN.beam)[:5]
        assert np.isnan(found[columns]).all()
        assert np.isfinite(np.delete(found, columns)).all()

    def test_pieces_of_a_series_give_the_same(self):
        series = self.series()
        chunks = [series.isel(sample=slice(first, first + 1700)) for first in range(0, series.sizes["sample"], 1700)]
        whole = brs.make_records(series, SCAN, correlations=True)
        pieces = brs.records.stream_records(iter(chunks), SCAN, correlations=True)
        np.testing.assert_array_equal(pieces["beam_correlation"].values, whole["beam_correlation"].values)
        assert pieces.attrs["correlated_beams"] == whole.attrs["correlated_beams"]

    def test_of_many_beams_some_that_lie_far_apart_are_chosen(self):
        scan = brs.load_scan("50-beam")
        numbers = correlated_beams(scan)
        assert len(numbers) == MOST_BEAMS
        place = scan.select(numbers).line_of_sight
        apart = np.linalg.norm(place[:, None] - place, axis=-1) + 10.0 * np.eye(MOST_BEAMS)
        even = np.linalg.norm(scan.line_of_sight[0] - scan.line_of_sight[50 // MOST_BEAMS])
        assert apart.min() > 0.6 * even


@pytest.fixture(scope="module")
def both():
    """A fit of 40 records by their covariances, at 15 degrees."""
    scan = brs.load_scan("6-beam@opening_angle_deg=15")
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=40, seed=9)
    records = brs.make_records(series, scan, correlations=True)
    noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
    fit = brs.fit(records, scan, seed=1, information="covariances", campaign="off", noise=noise)
    return scan, records, fit


def widths(fit, information):
    table = fit.summary(information=information)
    return np.median((table["high"] - table["low"]).to_numpy().reshape(-1, 6), axis=0)


class TestFit:
    def test_intervals_are_narrower_and_hold_the_truth(self, both):
        scan, _, fit = both
        ratio = widths(fit, "covariances") / widths(fit, "variances")
        assert np.all(ratio < 1.0)
        assert 0.35 < ratio[3] < 0.8  # uv, as was foretold
        assert 0.65 < ratio[4] < 0.9  # uw
        truth = covariance_moments(Views.of_scan(scan, 0.0), FLOW, wind_speed=10.0, n_sample=600).record
        table = fit.summary()
        low, high = (table[name].to_numpy().reshape(-1, 6) for name in ("low", "high"))
        holds = ((low <= truth) & (truth <= high)).mean(axis=0)
        # 40 records: 0.9 less four standard errors of 0.047
        assert np.all(holds > 0.71)

    def test_the_variances_alone_are_those_of_a_fit_by_variances(self, both):
        scan, records, _ = both
        some = records.isel(record=[0, 1])
        alone = brs.fit(some, scan, seed=1, campaign="off", noise=brs.noise.theory(scan, FLOW, wind_speed=10.0))
        both_ways = brs.fit(
            some, scan, seed=1, campaign="off", information="covariances",
            noise=brs.noise.theory(scan, FLOW, wind_speed=10.0),
        )  # fmt: skip
        pd.testing.assert_frame_equal(both_ways.summary(information="variances"), alone.summary())
        assert not both_ways.summary().equals(alone.summary())

    def test_in_the_model_s_own_air_the_coherence_is_not_doubted(self, both):
        _, _, fit = both
        found = fit.coherence()
        assert found.n_record == 40
        # 600 squares: a standard error of 0.06, and less than 1 by what the scales of the coherence are given
        assert 0.6 < found.misfit < 1.2
        assert not found.doubted
        assert "do not speak against" in found.in_words()

    def test_beams_that_go_together_as_no_coherence_has_it_are_told(self, both):
        """Correlations of independent beams: what a broken clock, or air without eddies, would give."""
        scan, records, _ = both
        some = records.isel(record=slice(0, 12)).copy()
        some["beam_correlation"] = some["beam_correlation"] * 0.2
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(some, scan, seed=1, information="covariances", campaign="off", noise=noise)
        assert fit.coherence().doubted
        assert "speak against the model's coherence" in fit.headline().doubtful

    def test_what_differs_in_all_records_alike_is_told(self, both):
        """A tenth of a standard deviation, up and down by turns: one record does not tell it, and 40 do."""
        scan, records, fit = both
        own = fit.coherence()
        # the mean of the squares of 15 numbers of variance 1 at most
        assert own.pattern < 2.0
        assert own.pattern_probability > 0.01
        moved = records.copy()
        z = np.arctanh(records["beam_correlation"].values)
        z += 0.1 * z.std(axis=0) * np.where(np.arange(z.shape[1]) % 2, 1.0, -1.0)
        moved["beam_correlation"] = records["beam_correlation"].copy(data=np.tanh(z))
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        found = brs.fit(moved, scan, seed=1, information="covariances", campaign="off", noise=noise).coherence()
        assert found.misfit < 1.3
        assert found.share < 0.2
        assert found.pattern_probability < 1e-5
        assert found.doubted
        assert "in the same way in all of them" in found.in_words()

    def test_a_folder_holds_both(self, both, tmp_path):
        scan, records, _ = both
        written = brs.fit(
            records.isel(record=[0, 1, 2]), scan, seed=1, information="covariances", campaign="off",
            output=tmp_path / "fit", noise=brs.noise.theory(scan, FLOW, wind_speed=10.0),
        )  # fmt: skip
        again = brs.open_fit(tmp_path / "fit")
        for information in ("variances", "covariances"):
            pd.testing.assert_frame_equal(
                again.summary(information=information), written.summary(information=information)
            )
        assert again.coherence() == written.coherence()

    def test_a_record_has_the_same_numbers_in_any_company(self, both):
        scan, records, _ = both
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        options = {"seed": 1, "information": "covariances", "campaign": "off", "noise": noise, "scatter": "theory"}
        options["instrument_noise"] = 0.0  # records tell each other
        one = brs.fit(records.isel(record=[3]), scan, **options).summary()
        three = brs.fit(records.isel(record=[2, 3, 4]), scan, **options).summary(records=1)
        columns = ["mean", "low", "high"]
        pd.testing.assert_frame_equal(one[columns], three[columns])

    @pytest.mark.long
    def test_a_campaign_learns_from_the_variances_alone(self, both):
        """An error of the coherence is the same in all records: pooled, it would be believed."""
        scan, records, _ = both
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        some = records.isel(record=slice(0, 12))
        tables = [
            brs.fit(some, scan, seed=1, information=information, noise=noise, campaign="on").campaign()
            for information in ("variances", "covariances")
        ]
        pd.testing.assert_frame_equal(*tables)

    def test_a_missing_beam_takes_its_pairs_out(self, both):
        scan, records, _ = both
        some = records.isel(record=[0, 1], beam=[0, 1, 3, 4, 5])
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(some, scan, seed=1, information="covariances", campaign="off", noise=noise)
        assert fit.n_fitted == 2
        assert fit.table("posterior")["n_pair"].tolist() == [10.0, 10.0]
        pattern = fit.table("pairs_pattern").filter(like="pair_").to_numpy()
        assert np.isfinite(pattern).sum(axis=1).tolist() == [10, 10]

    def test_a_pair_that_a_record_lacks_adds_nothing_to_the_pattern(self, both):
        scan, records, _ = both
        some = records.isel(record=[0, 1, 2]).copy(deep=True)
        some["beam_correlation"][1, 4] = np.nan
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(some, scan, seed=1, information="covariances", campaign="off", noise=noise)
        pattern = fit.table("pairs_pattern").filter(like="pair_").to_numpy()
        assert np.count_nonzero(np.nan_to_num(pattern), axis=1).tolist() == [15, 14, 15]
        assert fit.table("posterior")["n_pair"].tolist() == [15.0, 14.0, 15.0]
        mean = np.nan_to_num(pattern).mean(axis=0)
        assert fit.coherence().pattern == pytest.approx(3.0 * np.sum(mean**2) / 15.0)

    @pytest.mark.parametrize("without", [[1], [0, 1]])
    def test_records_without_any_go_by_their_variances_and_are_told(self, both, without):
        scan, records, _ = both
        some = records.isel(record=[0, 1]).copy(deep=True)
        some["beam_correlation"][without] = np.nan
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(some, scan, seed=1, information="covariances", campaign="off", noise=noise)
        words = f"{len(without)} of 2 records hold no covariances, and go by their variances alone"
        assert words in fit.headline().doubtful

    def test_two_ranges_tell_more_than_one(self):
        ratio = {}
        for name in ("4-beam@focus_distance=100", "4-beam@focus_distance=80+120"):
            scan = brs.load_scan(name)
            series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=12, seed=10)
            records = brs.make_records(series, scan, correlations=True)
            noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
            fit = brs.fit(records, scan, seed=1, information="covariances", campaign="off", noise=noise)
            ratio[name] = widths(fit, "covariances") / widths(fit, "variances")
        one, two = ratio.values()
        assert np.all(two[[0, 2, 3, 4, 5]] < one[[0, 2, 3, 4, 5]])

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"target": "sonic"}, "Invalid target 'sonic' with information 'covariances'"),
            ({"likelihood": "mine"}, "Invalid likelihood 'mine' with information 'covariances'"),
            ({"coherence_log_sd": -0.1}, "Invalid coherence_log_sd"),
            ({"mast_log_sd": -0.1}, "Invalid mast_log_sd"),
            ({"information": "means"}, "information"),
        ],
    )
    def test_what_does_not_go_together_is_refused(self, monkeypatch, options, words):
        monkeypatch.setitem(LIKELIHOODS, "mine", log_normal_likelihood)
        with pytest.raises(InputError, match=words):
            brs.FitOptions(**{"information": "covariances", **options})

    def test_records_without_correlations_are_refused(self, both):
        scan, records, _ = both
        with pytest.raises(InputError, match="make them with correlations=True"):
            brs.fit(records.drop_vars("beam_correlation"), scan, seed=1, information="covariances")

    def test_a_fit_by_variances_has_no_coherence(self, both):
        scan, records, _ = both
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(records.isel(record=[0]), scan, seed=1, campaign="off", noise=noise)
        with pytest.raises(InputError, match="information='covariances'"):
            fit.coherence()
        with pytest.raises(InputError, match="used no covariances between beams"):
            fit.summary(information="covariances")

    def test_settings_have_the_correlations_made(self):
        assert brs.Settings().changed(information="covariances").records.correlations


def mast_table(records, stress):
    return pd.DataFrame({"time": records["time"].values, **dict(zip(brs.STRESSES, np.transpose(stress), strict=True))})


class TestMast:
    def records(self, n_records=20):
        scan = brs.load_scan("4-beam@opening_angle_deg=15")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=n_records, seed=12)
        return scan, brs.make_records(series, scan)

    def test_its_data_scatter_as_a_sonic_s_of_the_package(self):
        """The covariance of ln uu, ln vv, ln ww is that of `sonic_moments`, to first order."""
        views = Views.of_scan(SCAN, 0.0).with_mast(np.array([-50.0, 0.0, 0.0]))
        found = covariance_moments(views, FLOW, wind_speed=10.0, n_sample=N_SAMPLE)
        own = slice(SCAN.n_beam, SCAN.n_beam + 3)
        sonic = brs.noise.sonic_moments(SCAN, FLOW, wind_speed=10.0, position=(-50.0, 0.0, 0.0))
        relative = sonic.covariance[:3, :3] / np.outer(sonic.mean[:3], sonic.mean[:3])
        np.testing.assert_allclose(np.diag(found.covariance[own, own]), np.log1p(np.diag(relative)), rtol=0.02)
        across = found.covariance[: SCAN.n_beam, own]
        expected = brs.noise.theory(SCAN, FLOW, wind_speed=10.0)
        mean = expected.gain[0] @ FLOW.stresses() * (1.0 + expected.bias[0])
        np.testing.assert_allclose(
            across, sonic.cross_covariance[:, :3] / np.outer(mean, sonic.mean[:3]), rtol=0.06, atol=5e-4
        )

    def test_a_sonic_decides_what_the_beams_do_not_see(self):
        scan, records = self.records()
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        truth = moments_of(scan).record
        beside = brs.wind.with_mast(records, mast_table(records, np.tile(truth, (20, 1))), position=(-98, 0, 0))
        alone, both = (brs.fit(one, scan, seed=1, noise=noise, campaign="off") for one in (records, beside))
        ratio = widths(both, None) / widths(alone, None)
        assert ratio[1] < 0.5
        assert ratio[2] < 0.5
        table = both.summary()
        means = table["mean"].to_numpy().reshape(-1, 6).mean(axis=0)
        # the mast says the truth in each record, and its scatter is 0.15 of vv and 0.1 of ww
        np.testing.assert_allclose(means[1:3], truth[1:3], rtol=0.1)

    def test_what_the_beams_say_without_it_is_kept_and_a_mast_of_other_air_is_told(self, tmp_path):
        """A sonic that has twice the uu of the beams, in every record, and one that has theirs."""
        scan, records = self.records()
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        alone = brs.fit(records, scan, seed=1, noise=noise, campaign="off")
        truth = moments_of(scan).record
        rng = np.random.default_rng(5)
        views = Views.of_scan(scan, 0.0).with_mast(np.array([-98.0, 0.0, 0.0]))
        theory = covariance_moments(views, FLOW, wind_speed=10.0, n_sample=N_SAMPLE)
        own = slice(scan.n_beam, scan.n_beam + 3)
        root = np.linalg.cholesky(theory.covariance[own, own])
        stress = np.tile(truth, (20, 1))
        stress[:, :3] *= np.exp(rng.standard_normal((20, 3)) @ root.T)
        for factor, doubted in ((1.0, False), (2.0, True)):
            changed = stress * [factor, 1.0, 1.0, 1.0, 1.0, 1.0]
            beside = brs.wind.with_mast(records, mast_table(records, changed), position=(-98, 0, 0))
            fit = brs.fit(beside, scan, seed=1, noise=noise, campaign="off", output=tmp_path / f"{factor}")
            pd.testing.assert_frame_equal(fit.summary(information="variances"), alone.summary())
            found = fit.coherence()
            assert found.data == ("mast",)
            assert found.doubted == doubted
            assert ("speak against the mast" in fit.headline().doubtful) == doubted
            assert brs.open_fit(tmp_path / f"{factor}").coherence() == found
        page = brs.write_report(fit).read_text()
        assert "By beams and mast and by variances" in page
        assert "they speak against the mast: believe what the variances say" in page

    def test_a_flat_prior_is_what_a_right_mast_speaks_against(self):
        """With vv and ww anywhere up to 25 m² s⁻², those of any mast are unlikely."""
        scan, records = self.records()
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        table = mast_table(records, np.tile(FLOW.stresses(), (20, 1)))
        beside = brs.wind.with_mast(records, table, position=(-98, 0, 0))
        of_prior = {
            prior: brs.fit(beside, scan, seed=1, noise=noise, campaign="off", prior=prior, target_ess=200).coherence()
            for prior in ("weak", "flat")
        }
        assert not of_prior["weak"].doubted
        words = of_prior["flat"].in_words()
        assert "speak against the flat prior, or against the mast: fit with prior 'weak' to tell which" in words
        assert "believe what the variances say" not in words

    def test_a_mast_that_is_there_only_where_nothing_was_fitted(self, tmp_path):
        """There is nothing to compare, which is said, and the report goes without; nor did it measure a record."""
        scan, records = self.records(2)
        records["flag"].values[0] = 1
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1)))
        beside = brs.wind.with_mast(records, table[:1], position=(-98, 0, 0))
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(beside, scan, seed=1, noise=noise, campaign="off", output=tmp_path / "fit")
        with pytest.raises(InputError, match="None of the 1 records that were fitted, of 2, has a covariance between"):
            fit.coherence()
        assert "believe what the variances say" not in brs.write_report(fit).read_text()
        assert [measured_by(fit, record) for record in (0, 1)] == ["the beams and the mast beside", "the beams"]

    def test_a_mast_of_no_record_that_was_fitted_is_not_said_to_have_measured(self, tmp_path):
        """Neither in the headline, nor on the page, nor beside covariances."""
        scan, records = self.records(3)
        table = mast_table(records, np.tile(FLOW.stresses(), (3, 1)))
        beside = brs.wind.with_mast(records, table[:1], position=(-98, 0, 0)).isel(record=[1, 2])
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        fit = brs.fit(beside, scan, seed=1, noise=noise, campaign="off", target_ess=50)
        assert fit.headline().decided.startswith("the beams measured")
        assert measured_by(fit) == "the beams"
        reference = pd.DataFrame({"time": beside["time"].values, "ti": 0.1})
        page = brs.write_report(fit, tmp_path / "page.html", reference=reference).read_text()
        assert "the stresses of a mast beside" not in page
        assert "What a mast measured is among the data" not in page
        assert "mast elsewhere" not in brs.budget(fit, records=[0])["source"].tolist()
        pairs = brs.make_records(
            brs.simulate(scan, FLOW, wind_speed=10.0, n_records=3, seed=12), scan, correlations=True
        )
        beside = brs.wind.with_mast(pairs, table[:1], position=(-98, 0, 0)).isel(record=[1, 2])
        fit = brs.fit(beside, scan, seed=1, noise=noise, campaign="off", target_ess=50, information="covariances")
        assert fit.coherence().data == ("covariances",)

    def test_how_many_records_it_gives_nothing_is_told(self, caplog):
        _, records = self.records(3)
        table = mast_table(records, np.tile(FLOW.stresses(), (3, 1)))
        brs.wind.with_mast(records, table, position=(0, 0, 0))
        assert not caplog.text
        brs.wind.with_mast(records, table[:1], position=(0, 0, 0))
        assert "The mast has no stress of 2 of 3 records." in caplog.text

    def test_one_that_gives_no_record_anything_is_refused(self, tmp_path):
        """Empty columns, a sonic that covers half a record, and one that stands still."""
        _, records = self.records(2)
        table = mast_table(records, [FLOW.stresses(), np.full(6, np.nan)])
        with pytest.raises(InputError, match="that was given has rows of 1 of 1 records, and no variance in any of"):
            brs.wind.with_mast(records.isel(record=[1]), table, position=(0, 0, 0))
        rng = np.random.default_rng(3)
        for n_sample, moves in ((300, 1.0), (600, 0.0)):
            time = records["time"].values[0] + np.arange(n_sample) * np.timedelta64(1, "s")
            wind = {name: ("time", moves * rng.standard_normal(n_sample)) for name in "uvw"}
            more = {name: ("time", np.zeros(n_sample)) for name in ("temperature", "status")}
            file = write_toa5(tmp_path / "sonic.dat", xr.Dataset({**wind, **more}, coords={"time": time}))
            with pytest.raises(InputError, match=r"sonic\.dat' has 1 row, and no variance in any of these"):
                brs.wind.with_mast(records, file, position=(0, 0, 0))

    def test_one_that_has_lost_its_place_is_given_anew(self):
        _, records = self.records(2)
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1)))
        lost = brs.wind.with_mast(records, table, position=(0, 0, 0))
        del lost.attrs["mast_position"]
        assert brs.wind.with_mast(lost, table, position=(0, 0, 1)).attrs["mast_position"] == "[0.0, 0.0, 1.0]"

    def test_a_mast_elsewhere_is_another_fit(self):
        """What tells fits apart, for a run that is resumed, knows where the mast stands."""
        _, records = self.records(2)
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1)))
        here, there = (brs.wind.with_mast(records, table, position=(0, y, 0)) for y in (0, 50))
        one, two = (fit_inputs(one, None, NoiseOptions()) for one in (here, there))
        assert digest(one) != digest(two)

    @pytest.mark.parametrize("option", ["mast_log_sd", "coherence_log_sd"])
    def test_what_only_counts_with_it_is_refused_without(self, option):
        """Also in Python; records that hold a mast use both."""
        scan, records = self.records(2)
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        options = {"seed": 1, "noise": noise, "campaign": "off", "target_ess": 50}
        with pytest.raises(InputError, match=f"The option {option} is only used with"):
            brs.fit(records, scan, **options, **{option: 0.6})
        beside = brs.wind.with_mast(
            records, mast_table(records, np.tile(FLOW.stresses(), (2, 1))), position=(-98, 0, 0)
        )
        one, other = (brs.fit(beside, scan, **options, **more).summary() for more in ({}, {option: 0.6}))
        assert (one["sd"] != other["sd"]).any()

    def test_a_covariance_without_its_variances_is_told(self, caplog):
        _, records = self.records(2)
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1)))
        table.loc[1, "vv"] = np.nan
        brs.wind.with_mast(records, table, position=(0, 0, 0))
        words = "has uv without uu or vv beside it in 1 of 2 rows: it is not used there."
        assert words in caplog.text
        caplog.clear()
        brs.wind.with_mast(records, table.drop(columns=["vv", "uv", "vw"]), position=(0, 0, 0))
        assert not caplog.text

    def test_a_cup_beside_tells_uu_alone(self):
        scan, records = self.records(3)
        cup = pd.DataFrame({"time": records["time"].values, "uu": 1.2})
        beside = brs.wind.with_mast(records, cup, position=(-98, 0, 0))
        assert np.isnan(beside["mast_stress"].values[:, 1:]).all()
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        assert brs.fit(beside, scan, seed=1, noise=noise, campaign="off").n_fitted == 3

    def test_records_without_a_row_have_none(self):
        _, records = self.records(3)
        table = mast_table(records, np.tile(FLOW.stresses(), (3, 1))).iloc[[2]]
        found = brs.wind.with_mast(records, table, position=(0, 0, 0))
        assert np.isnan(found["mast_stress"].values[:2]).all()
        np.testing.assert_allclose(found["mast_stress"].values[2], FLOW.stresses())

    def test_a_sonic_s_dataset_is_taken(self):
        _, records = self.records(2)
        stress = xr.Dataset(
            {"stress": (("record", "component"), np.tile(FLOW.stresses(), (2, 1)))},
            coords={"time": ("record", records["time"].values), "component": list(brs.STRESSES)},
        )
        found = brs.wind.with_mast(records, stress, position=(0, 0, 0))
        np.testing.assert_allclose(found["mast_stress"].values, np.tile(FLOW.stresses(), (2, 1)))

    def test_files_of_tables_are_put_together(self, tmp_path):
        _, records = self.records(3)
        table = mast_table(records, np.tile(FLOW.stresses(), (3, 1)))
        table.iloc[:1].to_csv(tmp_path / "a.csv", index=False)
        table.iloc[1:].drop(columns=["vv", "ww", "uv", "uw", "vw"]).to_csv(tmp_path / "b.csv.gz", index=False)
        for files in (tmp_path, [tmp_path / "b.csv.gz", tmp_path / "a.csv"], str(tmp_path / "*.csv*")):
            found = brs.wind.with_mast(records, files, position=(0, 0, 0))["mast_stress"].values
            np.testing.assert_allclose(found[0], FLOW.stresses())
            np.testing.assert_allclose(found[1:, 0], FLOW.stresses()[0])
            assert np.isnan(found[1:, 1:]).all()
        table.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match="and 1 more has 2 rows of 2000-01-01T00:10"):
            brs.wind.with_mast(records, tmp_path, position=(0, 0, 0))

    @pytest.mark.parametrize("packed", [False, True])
    def test_the_series_of_a_sonic_is_taken(self, packed, tmp_path):
        """Its stresses are made for records of the records' own length."""
        _, records = self.records(2)
        time = records["time"].values[0] + np.arange(1200) * np.timedelta64(1, "s")
        rng = np.random.default_rng(3)
        wind = {name: ("time", rng.normal(mean, 1.0, 1200)) for name, mean in (("u", 9.0), ("v", 1.0), ("w", 0.0))}
        more = {name: ("time", np.zeros(1200)) for name in ("temperature", "status")}
        file = write_toa5(tmp_path / "sonic.dat", xr.Dataset({**wind, **more}, coords={"time": time}))
        expected = brs.wind.sonic_stresses(brs.readers.read_sonic(file))["stress"].values
        if packed:
            with gzip.open(tmp_path / "sonic.dat.gz", "wb") as out:
                out.write(file.read_bytes())
            file = tmp_path / "sonic.dat.gz"
        found = brs.wind.with_mast(records, file, position=(0, 0, 0))["mast_stress"].values
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        short = brs.make_records(
            brs.simulate("2-beam", FLOW, wind_speed=10.0, n_records=2, seed=1), "2-beam", duration=300
        )
        halves = brs.wind.with_mast(short, file, position=(0, 0, 0))["mast_stress"].values
        made = brs.wind.sonic_stresses(brs.readers.read_sonic(file), duration=300.0)["stress"].values
        np.testing.assert_allclose(halves, made[: len(halves)], rtol=1e-9)
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1)))
        table.to_csv(tmp_path / "t.csv", index=False)
        with pytest.raises(InputError, match=r"is a sonic's series, and that in .*t\.csv' is none: give files of one"):
            brs.wind.with_mast(records, [file, tmp_path / "t.csv"], position=(0, 0, 0))

    @pytest.mark.parametrize(("own", "records_of"), [(600.0, 300.0), (60.0, 600.0)])
    def test_stresses_of_another_averaging_time_are_refused(self, own, records_of):
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=2, seed=1)
        records = brs.make_records(series, scan, duration=records_of)
        stress = xr.Dataset(
            {"stress": (("record", "component"), np.tile(FLOW.stresses(), (records.sizes["record"], 1)))},
            coords={"time": ("record", records["time"].values), "component": list(brs.STRESSES)},
            attrs={"duration": own},
        )
        words = f"mast that was given is of periods of {own:g} s, and the records last {records_of:g} s: make it for"
        with pytest.raises(InputError, match=words):
            brs.wind.with_mast(records, stress, position=(0, 0, 0))
        brs.wind.with_mast(records, stress.assign_attrs(duration=records_of), position=(0, 0, 0))

    @pytest.mark.parametrize(("step", "kind"), [(60, "shorter"), (1800, "longer"), (600, "")])
    def test_rows_of_another_step_are_told(self, step, kind, caplog):
        _, records = self.records(4)
        time = records["time"].values[0] + np.arange(8) * np.timedelta64(step, "s")
        gap = np.timedelta64(2400, "s")  # gaps make steps longer, and nothing of it is said
        table = pd.DataFrame({"time": [*time, time[-1] + gap, time[-1] + 2 * gap], "uu": 1.2})
        brs.wind.with_mast(records, table, position=(0, 0, 0))
        words = f"has rows {step} s apart, and the records last 600 s"
        assert (words in caplog.text) == bool(kind)
        assert (f"if rows are of {kind} periods, give those of 600 s" in caplog.text) == bool(kind)

    def test_a_sonic_that_stands_still_for_a_period_has_none_then(self, caplog):
        _, records = self.records(2)
        stress = xr.Dataset(
            {"stress": (("record", "component"), np.tile(FLOW.stresses(), (2, 1)))},
            coords={"time": ("record", records["time"].values), "component": list(brs.STRESSES)},
        )
        stress["stress"][1, 2:] = 0.0
        found = brs.wind.with_mast(records, stress, position=(0, 0, 0))["mast_stress"].values
        np.testing.assert_allclose(found[0], FLOW.stresses())
        assert np.isnan(found[1]).all()
        assert "in which u, v or w does not move, 1 of 2" in caplog.text

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"uu": -1.0}, "a variance is above zero"),
            ({"uw": 9.0}, "beyond the root of uu times ww"),
            (
                {"uu": 1.0, "vv": 1.0, "ww": 1.0, "uv": 0.9, "uw": 0.9, "vw": -0.9},
                "Row 0 of the mast that was given has the smallest principal variance -0.8 m² s⁻²: its covariances do",
            ),
        ],
    )
    def test_what_no_wind_has_is_refused(self, change, words):
        _, records = self.records(2)
        table = mast_table(records, np.tile(FLOW.stresses(), (2, 1))).assign(**change)
        with pytest.raises(InputError, match=words):
            brs.wind.with_mast(records, table, position=(0, 0, 0))

    def test_a_table_without_variances_is_refused(self):
        _, records = self.records(2)
        with pytest.raises(InputError, match="needs time and at least uu"):
            brs.wind.with_mast(records, pd.DataFrame({"time": records["time"].values, "ti": 0.1}), position=(0, 0, 0))

    def test_an_uncertain_direction_is_refused(self):
        scan, records = self.records(2)
        beside = brs.wind.with_mast(records, mast_table(records, np.tile(FLOW.stresses(), (2, 1))), position=(0, 0, 0))
        noise = brs.noise.theory(scan, FLOW, wind_speed=10.0)
        with pytest.raises(InputError, match="with a mast beside the beams"):
            brs.fit(beside, scan, seed=1, noise=noise, nuisances=brs.Nuisances(yaw_sd_deg=2.0))


class TestBudget:
    def test_the_coherence_is_a_source_of_a_fit_that_leans_on_it(self, both):
        _, _, fit = both
        table = brs.budget(fit, records=[0, 1])
        share = table[table["source"] == "coherence"].set_index("stress")["share"]
        assert share["uu"] > 0.0
        assert "mast elsewhere" not in table.attrs["left_out"]


class TestReport:
    def test_the_page_shows_both_and_judges_the_coherence(self, both, tmp_path):
        _, _, fit = both
        page = brs.write_report(fit, tmp_path / "report.html").read_text(encoding="utf-8")
        assert "By covariances and by variances" in page
        assert "do not speak against the model" in page
