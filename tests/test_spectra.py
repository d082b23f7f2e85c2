"""Spectra of radial velocities: what they add up to, what is expected of them, and what the Mann fit finds in them."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import optimize, stats
from scipy.linalg import toeplitz

import bayes_rs as brs
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.information import information_ratio
from bayes_rs.spectra.lag_window import fourier_rows, lag_windows, ordinate_correlation, ordinates
from bayes_rs.spectra.mann_fit import _States
from bayes_rs.spectra.whittle import profile_likelihood

START = np.datetime64("2020-01-01T00:00", "ns")
FLOW = brs.load_turbulence("fu-2022")
STARING = brs.load_scan("staring")


def staring(interval):
    return replace(STARING, scan_duration=interval)


def series_of(velocity, interval, jitter=0.0, seed=0):
    """A series of one beam from velocities (n_record, n_sample), NaN left out as missing rows."""
    n_record, n = velocity.shape
    second = 600.0 * np.arange(n_record)[:, None] + interval * np.arange(n)
    second = second + jitter * interval * np.random.default_rng(seed).uniform(0.0, 1.0, second.shape)
    there = np.isfinite(velocity)
    return xr.Dataset(
        {"radial_velocity": ("sample", velocity[there])},
        coords={
            "time": ("sample", START + (second[there] * 1e9).astype("timedelta64[ns]")),
            "beam": ("sample", np.zeros(there.sum(), dtype=int)),
        },
    )


def autoregressive(phi, n_record, n, seed):
    """Records of an AR(1) process of unit variance, about −10 m/s."""
    rng = np.random.default_rng(seed)
    out = np.empty((n_record, n))
    out[:, 0] = rng.standard_normal(n_record)
    for i in range(1, n):
        out[:, i] = phi * out[:, i - 1] + np.sqrt(1.0 - phi**2) * rng.standard_normal(n_record)
    return out - 10.0


def gaps(n, share, seed):
    return np.random.default_rng(seed).uniform(size=n) > share


class TestLagWindows:
    @pytest.mark.parametrize("n", [24, 25])
    @pytest.mark.parametrize("tapers", [0, 1, 3])
    @pytest.mark.parametrize("share", [0.0, 0.3])
    def test_they_are_the_quadratic_form_of_the_record(self, n, tapers, share):
        present, interval = gaps(n, share, 4), 2.0
        covariance = 0.8 ** np.arange(n) * np.cos(0.3 * np.arange(n))
        k, sides = ordinates(n)
        index = np.flatnonzero(present)
        project = np.eye(len(index)) - 1.0 / len(index)
        matrix = project @ toeplitz(covariance)[np.ix_(index, index)] @ project
        rows = (
            np.ones((1, n))
            if tapers == 0
            else np.sin(np.pi * np.outer(np.arange(1, tapers + 1), np.arange(1, n + 1)) / (n + 1))
        )
        rows = rows[:, index] / np.linalg.norm(rows[:, index], axis=1, keepdims=True)
        wave = np.exp(-2j * np.pi * np.outer(k, index) / n)
        slow = [
            interval * side * np.mean([np.real((h * w).conj() @ matrix @ (h * w)) for h in rows])
            for side, w in zip(sides, wave, strict=True)
        ]
        assert lag_windows(present, interval, tapers) @ covariance == pytest.approx(slow, rel=1e-10)  # rounding

    def test_the_rows_remove_any_constant(self):
        present = gaps(30, 0.3, 1)
        rows = fourier_rows(present, 2)
        assert np.abs((rows * present).sum(axis=-1)).max() < 1e-12  # rounding
        assert np.all(rows[..., ~present] == 0.0)

    def test_a_long_tapered_record_shows_the_closed_spectrum_of_an_autoregression(self):
        phi, n, interval = 0.9, 2048, 0.5
        found = lag_windows(np.ones(n, dtype=bool), interval, 1) @ phi ** np.arange(n)
        k, _ = ordinates(n)
        closed = 2.0 * interval * (1.0 - phi**2) / np.abs(1.0 - phi * np.exp(-2j * np.pi * k / n)) ** 2
        inner = slice(10, -1)  # the lowest frequencies lose to the mean, the last is the Nyquist frequency
        assert found[inner] == pytest.approx(closed[inner], rel=0.01)  # curvature over the taper's width

    def test_tapers_correlate_neighbours_and_none_does_not(self):
        assert ordinate_correlation(64, 0) == pytest.approx(np.eye(33)[0], abs=1e-12)
        one = ordinate_correlation(64, 1)
        assert one[0] == pytest.approx(1.0)
        assert one[1] == pytest.approx(0.25, abs=0.02)  # Σ h² exp(2πij/N) of a long sine taper is −½
        assert one[2] < 1e-3


class TestAliasing:
    """The expected spectrum of a sampled beam is the folded spectrum of the model, an independent quadrature."""

    @pytest.mark.parametrize("interval", [1.0, 4.0])
    def test_spectra_fold_about_the_nyquist_frequency(self, interval):
        speed, n = 10.0, 2048
        beam = scaled_autocovariance(
            np.array([-1.0, 0.0, 0.0]),
            speed * interval * np.arange(n),
            np.array([FLOW.length_scale]),
            gamma=FLOW.gamma,
            probe=STARING.probe,
            probe_length=0.0,
            tolerance=2e-5,
        )[0]
        found = FLOW.velocity_scale**2 * lag_windows(np.ones(n, dtype=bool), interval, 1) @ beam
        k, _ = ordinates(n)
        index = np.array([100, 200, 500, 800, 1000])
        f = k[index] / (n * interval)
        fold = np.arange(-400, 401) / interval
        k1 = 2.0 * np.pi * np.abs(f[:, None] + fold) / speed
        grid = np.geomspace(k1.min(), k1.max(), 400)
        log_f = np.log(FLOW.spectra(grid)[:, 0])
        one = np.exp(np.interp(np.log(k1), np.log(grid), log_f))
        folded = 2.0 * (2.0 * np.pi / speed) * one.sum(axis=1)
        alone = 2.0 * (2.0 * np.pi / speed) * np.exp(np.interp(np.log(2 * np.pi * f / speed), np.log(grid), log_f))
        assert found[index] == pytest.approx(folded, rel=0.01)  # 400 folds leave 0.5 %, the table of C 2e-5 of uu
        assert folded[-1] > 1.8 * alone[-1]  # so that a spectrum without aliasing would fail


class TestRadialSpectra:
    def test_parseval(self):
        velocity = autoregressive(0.7, 3, 600, 1)
        series = series_of(velocity, 1.0)
        records = brs.make_records(series, STARING)
        spectra = brs.spectra.radial_spectra(series, STARING, records)
        assert spectra["spectrum"].sum("frequency").values / 600.0 == pytest.approx(records["variance"].values)
        assert spectra["variance"].values == pytest.approx(records["variance"].values)
        assert spectra["frequency"].values[[0, -1]] == pytest.approx([1.0 / 600.0, 0.5])

    def test_a_sine_has_its_power_at_its_frequency(self):
        wave = 2.0 * np.sin(2.0 * np.pi * 30 * np.arange(600) / 600.0)[None] + 5.0
        series = series_of(wave, 1.0)
        spectrum = brs.spectra.radial_spectra(series, STARING, brs.make_records(series, STARING))["spectrum"].values[
            0, 0
        ]
        assert spectrum[29] / 600.0 == pytest.approx(2.0)  # amplitude² / 2
        assert np.delete(spectrum, 29).max() < 1e-20

    @pytest.mark.parametrize("tapers", [0, 2])
    def test_gappy_records_have_the_expected_spectrum(self, tapers):
        n_record, n, phi = 400, 150, 0.8
        there = np.array([gaps(n, 0.2, seed) for seed in range(3)])[np.arange(n_record) % 3]
        velocity = np.where(there, autoregressive(phi, n_record, n, 2), np.nan)
        there[:, [0, -1]] = True  # the ends fix the slots
        velocity[:, [0, -1]] = autoregressive(phi, n_record, n, 2)[:, [0, -1]]
        series = series_of(velocity, 4.0)
        records = brs.make_records(series, staring(4.0), min_availability=0.5)
        spectra = brs.spectra.radial_spectra(series, staring(4.0), records, tapers=tapers)
        for pattern in range(3):
            some = spectra["spectrum"].values[pattern::3, 0]
            expected = lag_windows(there[pattern], 4.0, tapers) @ phi ** np.arange(n)
            z = (some.mean(axis=0) - expected) / (some.std(axis=0) / np.sqrt(len(some)))
            assert np.abs(z).max() < 4.5  # 75 frequencies, three times: 4.5 standard errors
            ratio = (some / expected).mean(axis=-1)  # of a record: with gaps its estimates are correlated
            assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std() / np.sqrt(len(some))

    def test_samples_that_the_records_dropped_are_dropped(self):
        velocity = autoregressive(0.7, 1, 600, 3)
        series = series_of(velocity, 1.0)
        cnr = np.zeros(600)
        cnr[100:150] = -30.0
        series = series.assign(cnr=("sample", cnr))
        records = brs.make_records(series, STARING, quality=brs.QualityRules(cnr_range=(-23.0, 10.0)))
        spectra = brs.spectra.radial_spectra(series, STARING, records)
        assert int(spectra["count"].values[0, 0]) == int(records["count"].values[0, 0]) == 550
        assert np.all(np.isnan(spectra["radial_velocity"].values[0, 0, 100:150]))
        assert spectra["variance"].values == pytest.approx(records["variance"].values)

    def test_flagged_beams_have_none(self):
        velocity = autoregressive(0.7, 2, 600, 3)
        velocity[1, 100:] = np.nan
        series = series_of(velocity, 1.0)
        spectra = brs.spectra.radial_spectra(series, STARING, brs.make_records(series, STARING))
        assert np.isfinite(spectra["spectrum"].values[0]).all()
        assert np.isnan(spectra["spectrum"].values[1]).all()
        fit = brs.spectra.fit_spectra(spectra, STARING, progress=False)
        assert np.isfinite(fit["length_scale"].values).tolist() == [True, False]

    def test_jitter_is_taken_to_slots_and_uneven_times_are_refused(self):
        velocity = autoregressive(0.7, 1, 150, 3)
        even = brs.spectra.radial_spectra(
            series := series_of(velocity, 4.0), staring(4.0), brs.make_records(series, staring(4.0))
        )
        shaken = series_of(velocity, 4.0, jitter=0.1)
        other = brs.spectra.radial_spectra(shaken, staring(4.0), brs.make_records(shaken, staring(4.0)))
        assert other["spectrum"].values == pytest.approx(even["spectrum"].values, rel=1e-3)  # that of the interval
        assert 0.01 < float(other["timing_spread"].max()) < 0.05  # uniform over 0.1: 0.029
        wild = series_of(velocity, 4.0, jitter=0.99)
        with pytest.raises(brs.InputError, match=r"not evenly spaced: they lie 0\.2"):
            brs.spectra.radial_spectra(wild, staring(4.0), brs.make_records(wild, staring(4.0)))

    def test_input_is_checked(self):
        series = series_of(autoregressive(0.7, 1, 600, 3), 1.0)
        records = brs.make_records(series, STARING)
        with pytest.raises(brs.InputError, match="Invalid tapers 50"):
            brs.spectra.radial_spectra(series, STARING, records, tapers=50)
        with pytest.raises(brs.InputError, match="do not say how they were made"):
            brs.spectra.radial_spectra(series, STARING, records.assign_attrs(duration=600.0).drop_attrs())
        with pytest.raises(brs.InputError, match="have no spectrum with dims"):
            brs.spectra.average_spectra(records)


class TestAverages:
    @pytest.mark.parametrize("tapers", [0, 3])
    def test_the_band_holds_the_expected_spectrum_as_often_as_it_says(self, tapers):
        phi, groups, size, n = 0.6, 60, 5, 150
        series = series_of(autoregressive(phi, groups * size, n, 7), 4.0)
        spectra = brs.spectra.radial_spectra(
            series, staring(4.0), brs.make_records(series, staring(4.0)), tapers=tapers
        )
        expected = lag_windows(np.ones(n, dtype=bool), 4.0, tapers) @ phi ** np.arange(n)
        truth = brs.spectra.average_spectra(
            spectra.isel(record=[0]).assign(spectrum=(("record", "beam", "frequency"), expected[None, None]))
        )["spectrum"].values[0]
        held = []
        for group in range(groups):
            one = brs.spectra.average_spectra(spectra, records=slice(group * size, (group + 1) * size))
            held.append((one["low"].values[0] <= truth) & (truth <= one["high"].values[0]))
        # 60 groups of 17 bins, nearly independent: standard error 0.0094, four of them, and 0.02 for the level of a
        # record, whose scatter counts as if records differed
        assert np.mean(held) == pytest.approx(0.9, abs=0.058)

    def test_more_records_make_it_narrower(self):
        series = series_of(autoregressive(0.6, 20, 150, 8), 4.0)
        spectra = brs.spectra.radial_spectra(series, staring(4.0), brs.make_records(series, staring(4.0)))
        few, many = brs.spectra.average_spectra(spectra, records=slice(0, 2)), brs.spectra.average_spectra(spectra)
        ratio = many["dof"].values / few["dof"].values
        assert np.all((ratio > 8.0) & (ratio < 10.5))  # twenty over two, less what unequal variances cost


class TestWhittle:
    def test_the_profile_is_the_maximum(self):
        rng = np.random.default_rng(1)
        n = 80
        shape = np.stack([1.0 / (0.05 + np.linspace(0.01, 1.0, n)) ** p for p in (1.0, 1.7)])
        white = np.full(n, 2.0)
        spectrum = (3.0 * shape[1] + 0.4 * white) * rng.exponential(size=n)
        weight = np.ones(n)
        weight[-1] = 0.5
        found = profile_likelihood(spectrum, weight, shape, white, floor=0.1, floor_sd=1.5)

        for i in range(2):

            def loss(theta, row=shape[i]):
                total = np.exp(theta[0]) * row + theta[1] * white
                if np.any(total <= 0.0):
                    return np.inf
                return np.sum(weight * (np.log(total) + spectrum / total)) + 0.5 * ((theta[1] - 0.1) / 1.5) ** 2

            best = optimize.minimize(loss, [0.0, 0.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
            assert -found.log_density[i] == pytest.approx(best.fun, abs=1e-5)
            assert [found.log_size[i], found.floor[i]] == pytest.approx(best.x, abs=1e-2)

    def test_a_known_floor_stays(self):
        found = profile_likelihood(np.ones(9), np.ones(9), np.ones((1, 9)), np.ones(9), floor=0.25, floor_sd=0.0)
        assert found.floor[0] == 0.25
        assert np.exp(found.log_size[0]) == pytest.approx(0.75, rel=1e-3)
        assert found.covariance[0, 1, 1] == 0.0


def state(**changes):
    return {
        "wind_speed": 10.0,
        "yaw": 0.0,
        "length_scale": 61.0,
        "gamma": 3.2,
        "interval": 4.0,
        "n_slot": 150,
        "tapers": 0,
        "floor": 0.0,
        "floor_sd": 0.0,
        **changes,
    }


class TestInformation:
    def test_two_beams_that_see_the_same_count_once(self):
        one = staring(4.0)
        two = replace(
            one,
            beam_direction=np.repeat(one.beam_direction, 2, axis=0),
            focus_distance=np.repeat(one.focus_distance, 2),
            beam_time=np.repeat(one.beam_time, 2),
            beam=np.array([0, 1]),
        )
        alone, both = information_ratio(one, **state()), information_ratio(two, **state())
        assert both == pytest.approx(alone * [0.5, 0.5, 1.0], rel=1e-6)

    def test_without_tapers_one_beam_is_nearly_what_it_claims(self):
        ratio = information_ratio(staring(4.0), **state(floor_sd=0.2))
        assert np.all((ratio > 0.8) & (ratio < 1.2))

    def test_tapers_claim_too_much(self):
        assert information_ratio(staring(4.0), **state(tapers=3))[1] < 0.4


@pytest.fixture(scope="module")
def recovered():
    """Spectra and fit of 160 records of a staring beam every 4 s."""
    scan = staring(4.0)
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=160, seed=21)
    records = brs.make_records(series, scan)
    spectra = brs.spectra.radial_spectra(series, scan, records)
    return scan, records, spectra, brs.spectra.fit_spectra(spectra, scan, progress=False)


class TestMannFit:
    def test_the_length_scale_is_recovered(self, recovered):
        _, _, _, fit = recovered
        error, width = np.log(fit["length_scale"].values / 61.0), fit["length_scale_log_sd"].values
        assert abs(error.mean()) < 0.2  # a bias of the posterior mean under a prior at 60 m: measured 0.05 to 0.13
        assert error.std() < width.mean()  # the truth is at the prior's median: errors are smaller than the posterior
        held = np.mean(np.abs(error) < stats.norm.ppf(0.95) * width)
        assert held > 0.9 - 3.0 * np.sqrt(0.09 / 160)  # three binomial standard errors below

    def test_many_records_pin_it_down(self, recovered):
        _, _, _, fit = recovered
        pooled = brs.spectra.pool_length_scale(fit)
        width = float(pooled["length_scale_log_sd"][0])
        assert width < 0.09
        assert abs(np.log(float(pooled["length_scale"][0]) / 61.0)) < 3.5 * width
        by_half = brs.spectra.pool_length_scale(fit, np.arange(160) % 2)
        assert by_half["n_record"].values.tolist() == [80, 80]
        assert by_half["length_scale_log_sd"].values == pytest.approx(np.sqrt(2.0) * width, rel=0.35)

    def test_the_dissipation_is_recovered(self, recovered):
        _, _, _, fit = recovered
        error = np.log(fit["dissipation"].values / 0.05)
        assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(160) + 0.03
        assert error.std() < 1.3 * fit["dissipation_log_sd"].values.mean()

    def test_what_is_expected_of_a_record_is_what_is_seen_on_average(self, recovered):
        _, _, spectra, fit = recovered
        ratio = (spectra["spectrum"] / fit["expected"]).values[:, 0]
        z = (ratio.mean(axis=0) - 1.0) / (ratio.std(axis=0) / np.sqrt(160))
        assert np.abs(z).max() < 4.5

    @pytest.mark.parametrize(("flow", "speed"), [("stable-offshore", 8.0), ("unstable-offshore", 12.0)])
    def test_other_length_scales_are_told_apart(self, flow, speed):
        scan, flow = staring(2.0), brs.load_turbulence(flow)
        series = brs.simulate(scan, flow, wind_speed=speed, n_records=60, seed=5)
        spectra = brs.spectra.radial_spectra(series, scan, brs.make_records(series, scan))
        pooled = brs.spectra.pool_length_scale(brs.spectra.fit_spectra(spectra, scan, gamma=flow.gamma, progress=False))
        width = float(pooled["length_scale_log_sd"][0])
        assert abs(np.log(float(pooled["length_scale"][0]) / flow.length_scale)) < 3.5 * width < 0.6

    def test_the_dimension_of_gamma_is_averaged_over(self, recovered):
        scan, _, spectra, fit = recovered
        some = spectra.isel(record=slice(0, 4))
        both = brs.spectra.fit_spectra(some, scan, gamma=[2.2, 3.2, 4.2], progress=False)
        assert np.all((both["gamma"].values > 2.2) & (both["gamma"].values < 4.2))
        assert np.all(both["gamma_sd"].values > 0.5)  # one beam hardly sees it: uniform on three nodes has 0.82
        alone = brs.spectra.fit_spectra(some, scan, gamma=[3.2], progress=False)
        assert alone["length_scale"].values == pytest.approx(fit["length_scale"].values[:4], rel=0.02)

    def test_records_do_not_depend_on_the_numbers_beside_them_but_through_the_ratio(self, recovered):
        scan, _, spectra, fit = recovered
        other = brs.spectra.fit_spectra(spectra.isel(record=slice(0, 3)), scan, progress=False)
        ratio = other.attrs["information_ratio"][0] / fit.attrs["information_ratio"][0]
        assert ratio == pytest.approx(1.0, abs=0.1)
        assert other["expected"].values == pytest.approx(fit["expected"].values[:3], rel=0.02)

    def test_a_probe_along_the_wind_leaves_a_spectrum_that_is_positive_at_every_length_scale(self):
        """Its pulse takes nearly all of the fast eddies: what is left is of the size of the covariances' errors."""
        scan, n_slot = brs.load_scan("pulsed-4-beam@focus_distance=178"), 150
        length_scale = np.exp(np.arange(1.8, 5.5, 0.12))
        spectra = xr.Dataset(
            {
                "spectrum": (("record", "beam", "frequency"), np.ones((1, 4, n_slot // 2))),
                "radial_velocity": (("record", "beam", "slot"), np.ones((1, 4, n_slot))),
                "variance": (("record", "beam"), np.ones((1, 4))),
                "wind_speed": ("record", [4.4]),
                "yaw": ("record", [-15.0]),
            },
            attrs={"interval": 4.0, "tapers": 0},
        )
        states = _States(spectra, scan, np.array([3.2]), np.log(length_scale), 0.0, None)
        shape, white = states.shapes(0, 2, length_scale, 3.2)
        covariance = scaled_autocovariance(
            scan.at_yaw(np.deg2rad(-15.0))[2],
            4.4 * 4.0 * np.arange(n_slot),
            length_scale,
            gamma=3.2,
            probe=scan.probe,
            probe_length=float(scan.probe_length[2]),
        )
        plain = covariance @ states.windows(np.ones(n_slot, dtype=bool)).T
        assert plain.min() < 0.0
        assert shape.min() > 0.0
        kept = plain > 1e-4 * covariance[:, :1] * white
        assert kept.mean() > 0.99
        assert np.array_equal(shape[kept], plain[kept])

    def test_input_is_checked(self, recovered):
        scan, _, spectra, fit = recovered
        for options, words in (
            ({"gamma": [3.2, 3.2]}, "Invalid gamma"),
            ({"beams": "some"}, "Unknown beams 'some'"),
            ({"instrument_noise_sd": -1.0}, "Invalid instrument_noise_sd -1.0"),
            ({"length_scale_prior": (0.0, 1.0)}, "Invalid length_scale_prior 0.0 m in its median"),
        ):
            with pytest.raises(brs.InputError, match=words):
                brs.spectra.fit_spectra(spectra, scan, **options)
        with pytest.raises(brs.InputError, match="one label for each of the 160 records"):
            brs.spectra.pool_length_scale(fit, [1, 2])
        with pytest.raises(brs.InputError, match="nothing to fit"):
            brs.spectra.fit_spectra(spectra.assign(wind_speed=np.nan * spectra["wind_speed"]), scan)


class TestFeedingTheNoise:
    def test_records_get_their_own_length_scale(self, recovered):
        _, records, _, fit = recovered
        with_own = brs.spectra.with_length_scale(records, fit)
        assert with_own["length_scale"].values == pytest.approx(fit["length_scale"].values)
        assert "gamma" not in with_own
        one = brs.spectra.with_length_scale(records, fit, brs.spectra.pool_length_scale(fit))
        assert np.ptp(one["length_scale"].values) == 0.0
        broken = fit.assign(length_scale=fit["length_scale"].where(fit["length_scale"]["record"] != 3))
        filled = brs.spectra.with_length_scale(records, broken)
        assert filled.attrs["length_scale_from_others"] == 1
        assert filled["length_scale"].values[3] == pytest.approx(
            float(brs.spectra.pool_length_scale(fit)["length_scale"][0])
        )
        with pytest.raises(brs.InputError, match="not of these records"):
            brs.spectra.with_length_scale(records.isel(record=slice(0, 5)), fit)

    def test_the_noise_of_the_fit_follows_it(self, recovered):
        scan, records, _, fit = recovered
        some = brs.spectra.with_length_scale(records, fit).isel(record=slice(0, 6))
        scale = some["length_scale"].values
        bank = brs.noise.calibrate(
            scan, FLOW, records=some, length_scale=[float(scale.min()), float(scale.max())], progress=False
        )
        noise = bank.for_records(
            some["wind_speed"].values, np.deg2rad(some["yaw"].values), length_scale=scale, gamma=np.full(6, 3.2)
        )
        sure = brs.Nuisances(length_scale_log_sd=0.0)
        own = brs.fit(some, scan, noise=bank, seed=1, sampler="direct", nuisances=sure, progress=False)
        common = brs.spectra.with_length_scale(records, fit, brs.spectra.pool_length_scale(fit)).isel(
            record=slice(0, 6)
        )
        plain = brs.fit(common, scan, noise=bank, seed=1, sampler="direct", nuisances=sure, progress=False)
        order = np.argsort(scale)
        assert np.all(np.diff(noise.covariance[order, 0, 0]) > 0.0)  # larger eddies, fewer of them in a record

        def width(result):
            log_uu = np.log(result["posterior"]["stress"].sel(component="uu").values)
            return log_uu.transpose(2, 0, 1).reshape(6, -1).std(axis=1)

        change = np.log(width(own) / width(plain))
        assert change[order[0]] < -0.03  # a shorter scale than the common one: a narrower posterior
        assert change[order[-1]] > 0.03


class TestAlongWind:
    def test_beams_at_angles_give_the_spectrum_of_u(self):
        scan, speed = brs.load_scan("pulsed-4-beam"), 10.0
        series = brs.simulate(scan, FLOW, wind_speed=speed, n_records=30, seed=3)
        spectra = brs.spectra.radial_spectra(series, scan, brs.make_records(series, scan))
        fit = brs.spectra.fit_spectra(spectra, scan, instrument_noise_sd=0.0, progress=False)
        along = brs.spectra.along_wind_spectra(spectra, scan, fit)
        n = spectra.sizes["slot"]
        u = scaled_autocovariance(
            np.array([1.0, 0.0, 0.0]),
            speed * 4.0 * np.arange(n),
            np.array([61.0]),
            gamma=3.2,
            probe=scan.probe,
            probe_length=0.0,
        )[0]
        expected = FLOW.velocity_scale**2 * lag_windows(np.ones(n, dtype=bool), 4.0, 0) @ u
        values = along["spectrum"].values
        z = (values.mean(axis=0) - expected) / (values.std(axis=0, ddof=1) / np.sqrt(30))
        # a mean over 30 records and its own scatter: Student's t of 29, beyond 5.5 at one frequency in 150,000
        assert np.abs(z).max() < 5.5
        plain = spectra["spectrum"].values.mean(axis=1)
        assert abs(np.log(plain.mean() / expected.mean())) > abs(np.log(values.mean() / expected.mean()))


class TestPicture:
    def test_a_panel_for_each_beam_with_measured_band_and_fitted_curve(self, recovered, tmp_path):
        _, _, spectra, fit = recovered
        figure = brs.plot.spectra(spectra, fit)
        (panel,) = figure.axes
        averages = brs.spectra.average_spectra(spectra)
        measured = panel.lines[0]
        assert measured.get_xdata() == pytest.approx(averages["frequency"].values)
        assert measured.get_ydata() == pytest.approx((averages["frequency"] * averages["spectrum"]).values.ravel())
        inside = (averages["low"] < panel.lines[1].get_ydata() / averages["frequency"].values) & (
            panel.lines[1].get_ydata() / averages["frequency"].values < averages["high"]
        )
        assert float(inside.mean()) > 0.6
        figure.savefig(tmp_path / "spectra.png")
        with pytest.raises(brs.InputError, match="not of these spectra"):
            brs.plot.spectra(spectra.isel(record=[0]), fit)
