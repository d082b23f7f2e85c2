"""Fronts and trends: told from eddies at the level that is asked for, and as well as that can be done."""

import json

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.block_checks import CHANGES
from bayes_rs.fits.block_states import block_states
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.noise_choice import noise_and_records
from bayes_rs.fits.steadiness import (
    STEADY,
    TESTS,
    Changes,
    Modulation,
    find_changes,
    make_tests,
    shapes_of,
    statistic,
    whitening_of,
)
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.spectra.record_lengths import REPORT, with_own_length_scale
from bayes_rs.turbulence.mann import MannTurbulence

N_PART = 64
COVARIANCE = np.exp(-np.arange(N_PART) / 3.0)
FLOW = MannTurbulence(dissipation=0.05, length_scale=15.0, gamma=3.2, name="test")
SIGMAS = 4.0


def cholesky(covariance=COVARIANCE):
    return np.linalg.cholesky(scipy.linalg.toeplitz(covariance))


class TestLaws:
    def test_whitened_parts_are_independent_and_know_no_mean(self):
        whitening = whitening_of(COVARIANCE)
        matrix = scipy.linalg.toeplitz(COVARIANCE) + 0.002 * np.eye(N_PART)
        np.testing.assert_allclose(whitening @ matrix @ whitening.T, np.eye(N_PART - 1), atol=1e-10)
        np.testing.assert_allclose(whitening.sum(axis=1), 0.0, atol=1e-10)

    def test_shapes_change_by_one_and_have_no_mean(self):
        for shapes in shapes_of(N_PART).values():
            np.testing.assert_allclose(shapes.mean(axis=1), 0.0, atol=1e-12)
        assert np.all(np.ptp(shapes_of(N_PART)["front"], axis=1) > 0.7)

    def test_one_shape_explains_a_beta_variable_of_steady_air(self):
        tests = make_tests(tuple(COVARIANCE), ("trend",), 600.0, STEADY)
        expected = scipy.stats.beta(0.5, 0.5 * (N_PART - 2))
        assert scipy.stats.kstest(tests.null["trend"], expected.cdf).pvalue > 1e-4

    def test_neither_level_nor_mean_counts(self):
        tests = make_tests(tuple(COVARIANCE), ("front",), 600.0, STEADY)
        wind = np.random.default_rng(1).standard_normal((5, N_PART)) @ cholesky().T
        one = statistic(wind @ tests.whitening.T, tests.white["front"])
        other = statistic((7.0 * wind + 3.0) @ tests.whitening.T, tests.white["front"])
        np.testing.assert_allclose(other[0], one[0], rtol=1e-9)
        np.testing.assert_array_equal(other[1], one[1])

    def test_no_test_beats_the_best_possible_one(self):
        """Neyman and Pearson: with the shape, the sign and the level known, power is Φ(δ − z)."""
        tests = make_tests(tuple(COVARIANCE), ("trend",), 600.0, STEADY)
        level, rng = 0.02, np.random.default_rng(2)
        limit = np.quantile(tests.null["trend"], 1.0 - level)
        line = tests.shapes["trend"][0]
        for size in (1.0, 2.0, 4.0):
            wind = rng.standard_normal((4000, N_PART)) @ cholesky().T + size * line
            power = np.mean(statistic(wind @ tests.whitening.T, tests.white["trend"])[0] > limit)
            known = whitening_of(COVARIANCE) @ (size * line)
            best = scipy.stats.norm.sf(scipy.stats.norm.isf(level) - np.linalg.norm(known))
            error = SIGMAS * np.sqrt(0.25 / 4000)
            assert power < best + error
            assert power > 0.5 * best - error

    def test_a_front_is_much_like_one_of_the_shapes_wherever_it_is(self):
        """As seen by parts in which it may begin and end anywhere; steps at their borders only miss a tenth of it."""
        tests = make_tests(tuple(COVARIANCE), ("front",), 600.0, STEADY)
        rng, number = np.random.default_rng(3), 50
        since = (np.arange(N_PART * number) + 0.5) / (N_PART * number) * 600.0
        moments = rng.uniform(60.0, 540.0, 200)
        front = np.clip((since - moments[:, None]) / 10.0 + 0.5, 0.0, 1.0).reshape(200, N_PART, number).mean(axis=-1)
        share, _ = statistic(front @ tests.whitening.T, tests.white["front"])
        assert np.mean(share) > 0.93
        assert np.min(share) > 0.8

    def test_intermittent_air_asks_for_more(self):
        calm, other = (
            make_tests(tuple(COVARIANCE), ("front",), 600.0, air).null["front"]
            for air in (STEADY, Modulation(0.6, 100.0))
        )
        assert np.quantile(other, 0.98) > np.quantile(calm, 0.98) + 0.01

    @pytest.mark.parametrize("place", [8, 16])
    def test_what_a_change_adds(self, place):
        middle = (np.arange(N_PART) + 0.5) / N_PART
        trend = 2.0 * (middle - 0.5)
        step = 3.0 * ((np.arange(N_PART) >= place) - (1.0 - place / N_PART))
        changes = Changes(np.array([[0.001, 0.001]]), np.stack([trend, step])[None], np.array([True]))
        uu, vv, uv = changes.added(0.02)[0]
        share = place / N_PART
        assert uu == pytest.approx(2.0**2 / 12.0, rel=2.0 / N_PART**2)
        assert vv == pytest.approx(9.0 * share * (1.0 - share))
        assert uv == pytest.approx(np.mean(trend * step))
        np.testing.assert_array_equal(changes.added(0.001), 0.0)

    def test_the_shares_leave_the_level_room(self):
        assert sum(test.share for test in TESTS) < 1.0


@pytest.fixture(scope="module")
def scene():
    scan = brs.load_scan("2-beam")
    return (
        scan,
        brs.simulate(scan, FLOW, wind_speed=10.0, n_records=250, seed=6),
        theory_noise(scan, FLOW, wind_speed=10.0),
    )


def with_wind(series, scan, change):
    """Add a change of the wind along x, m/s, of the time since each record began, s."""
    since = (series["time"].values.astype("datetime64[ns]").astype(np.int64) % 600_000_000_000) * 1e-9
    along = dict(zip(scan.beam.tolist(), scan.level_direction[:, 0].tolist(), strict=True))
    added = np.array([along[beam] for beam in series["beam"].values.tolist()]) * change(since)
    return series.assign(radial_velocity=series["radial_velocity"] + added)


def found_in(series, scan, noise):
    records = brs.make_records(series, scan)
    return find_changes(records, block_states(records, scan, noise))


class TestRecords:
    def test_false_alarms_are_as_few_as_asked_for(self, scene):
        changes = found_in(scene[1], scene[0], scene[2])
        alarms = np.mean(changes.clear(0.02).any(axis=1))
        assert alarms < 0.02 + SIGMAS * np.sqrt(0.02 / 250)

    def test_p_values_are_not_all_large(self, scene):
        changes = found_in(scene[1], scene[0], scene[2])
        assert 0.1 < np.mean(changes.clear(0.5).any(axis=1)) < 0.6

    @pytest.mark.parametrize(
        ("change", "gradual", "size"),
        [(lambda t: 3.0 * (t > 240.0), False, 3.0), (lambda t: -4.0 * t / 600.0, True, -4.0)],
    )
    def test_changes_are_found_and_measured(self, scene, change, gradual, size):
        scan, series, noise = scene
        changes = found_in(with_wind(series, scan, change), scan, noise)
        clear = changes.clear(0.02)[:, 0]
        assert clear.mean() > 0.95
        assert np.mean(changes.gradual[clear] == gradual) > 0.6
        assert np.median(changes.size(0.02)[clear, 0]) == pytest.approx(size, rel=0.1)
        time = (np.arange(600) + 0.5) * 1.0
        assert np.median(changes.added(0.02)[clear, 0]) == pytest.approx(np.var(change(time)), rel=0.2)

    def test_a_change_across_is_found_across(self, scene):
        scan, series, noise = scene
        since = (series["time"].values.astype("datetime64[ns]").astype(np.int64) % 600_000_000_000) * 1e-9
        across = dict(zip(scan.beam.tolist(), scan.level_direction[:, 1].tolist(), strict=True))
        step = np.array([across[beam] for beam in series["beam"].values.tolist()]) * 3.0 * np.sign(since - 300.0)
        changes = found_in(series.assign(radial_velocity=series["radial_velocity"] + step), scan, noise)
        clear = changes.clear(0.02)
        assert clear[:, 1].mean() > 0.9
        assert clear[:, 0].mean() < 0.3


@pytest.fixture(scope="module")
def air():
    flow = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="test")
    scan = brs.load_scan("2-beam")
    return scan, brs.simulate(scan, flow, wind_speed=10.0, n_records=250, seed=9), flow


class TestPower:
    """In air of L = 61 m, where fronts of 3 m/s are 5 standard deviations of what eddies do."""

    @staticmethod
    def with_fronts(series, scan, which):
        """Add steps of 3 m/s, smoothed over 10 s, at any time of the middle 80 % of some records."""
        nanoseconds = series["time"].values.astype("datetime64[ns]").astype(np.int64)
        record = nanoseconds // 600_000_000_000
        record -= record.min()
        rng = np.random.default_rng(4)
        moment, sign = rng.uniform(60.0, 540.0, len(which)), rng.choice([-3.0, 3.0], len(which)) * which
        return with_wind(
            series, scan, lambda since: sign[record] * np.clip((since - moment[record]) / 10.0 + 0.5, 0.0, 1.0)
        )

    def test_fronts_are_found(self, air):
        scan, series, flow = air
        changed = self.with_fronts(series, scan, np.ones(250, dtype=bool))
        clear = found_in(changed, scan, theory_noise(scan, flow, wind_speed=10.0)).clear(0.02).any(axis=1)
        assert clear.mean() > 0.86  # 0.82 with parts of 19 s

    def test_fronts_do_not_make_eddies_long(self, air):
        """In a campaign of which a fifth has fronts, as a default fit sees it."""
        scan, series, _ = air
        front = np.arange(250) % 5 == 0
        records = brs.make_records(self.with_fronts(series, scan, front), scan)
        lines = []
        _, found = noise_and_records(records, scan, None, FitOptions(), NoiseOptions(), lines.append)
        length_scale = found["length_scale"].values
        assert np.median(length_scale[front]) < 1.3 * np.median(length_scale[~front])
        unsteady = found["unsteady"].values > 0
        assert unsteady[front].mean() > 0.75
        assert unsteady[~front].mean() < 0.02 + SIGMAS * np.sqrt(0.02 / 200)
        assert any("left out: " in line and line.startswith("length scale from the spectra of ") for line in lines)

    def test_the_spectra_of_unsteady_records_tell_nothing(self, air):
        scan, series, _ = air
        records = brs.make_records(series, scan)
        out = np.arange(250) % 10 == 0
        asked = []

        def unsteady(these):
            asked.append(float(these["length_scale"].median()))
            return out

        found = with_own_length_scale(records, scan, unsteady=unsteady)
        report = json.loads(found.attrs[REPORT])
        assert len(asked) == 2  # anew, until no more are found
        assert report["n_unsteady"] == 25
        assert report["n_told"] <= 225
        own = np.log(with_own_length_scale(records, scan)["length_scale"].values)
        now = np.log(found["length_scale"].values)
        assert now[out].std() < 0.4 * own[out].std()  # what little is left is how L goes with the wind
        np.testing.assert_allclose(now[~out], own[~out], atol=0.1)


class TestFit:
    def test_flag_and_columns(self, scene):
        scan, series, noise = scene
        time = series["time"].values
        first = series.isel(sample=time < time.min() + np.timedelta64(40, "m"))
        records = brs.make_records(with_wind(first, scan, lambda t: 5.0 * (t > 300.0)), scan)
        lines = []
        found = brs.fit(records, scan, noise=noise, seed=1, target_ess=100, draws="none", say=lines.append)
        assert np.all(found.flag & FLAGS["unsteady"])
        assert found.flags["unsteady"] == found.n_record
        assert any(line.startswith("steadiness: ") and "largest change of the wind" in line for line in lines)
        assert any(line.startswith("flag unsteady: ") for line in found.remarks)
        assert set(CHANGES) <= set(found.records)
        np.testing.assert_allclose(found.records["change_uu"].values, 25.0 / 4.0, rtol=0.3)
        assert found.n_fitted == found.n_record
        off = brs.fit(records, scan, noise=noise, seed=1, target_ess=100, draws="none", unsteady_level=0.0)
        assert off.flags["unsteady"] == 0
        assert "unsteady" not in off.records

    def test_records_without_parts_are_not_compared(self, scene):
        scan, series, noise = scene
        records = brs.make_records(series, scan).isel(record=slice(0, 2)).drop_vars("part_wind")
        assert block_states(records, scan, noise) is None
        found = brs.fit(records, scan, noise=noise, seed=1, target_ess=100, draws="none")
        assert "unsteady" not in found.records

    def test_a_record_without_wind_is_not_compared(self, scene):
        scan, series, noise = scene
        records = brs.make_records(series, scan).isel(record=slice(0, 3)).copy(deep=True)
        records["wind_speed"].values[1] = np.nan
        changes = find_changes(records, block_states(records, scan, noise))
        assert np.isnan(changes.p_value[1]).all()
        assert np.isfinite(changes.p_value[[0, 2]]).all()
        assert np.isnan(changes.size(0.02)[1]).all()

    def test_an_uncertain_length_scale_counts(self, scene):
        """Longer eddies explain more of what is slow: p-values grow, and so they do if L is only perhaps longer."""
        scan, series, noise = scene
        records = brs.make_records(with_wind(series, scan, lambda t: 1.5 * t / 600.0), scan)

        def clear(**own):
            these = records.assign({name: ("record", np.full(250, value)) for name, value in own.items()})
            return find_changes(these, block_states(these, scan, noise)).clear(0.02)[:, 0].mean()

        short, perhaps, long = (
            clear(length_scale=15.0),
            clear(length_scale=15.0, length_scale_log_sd=0.6),
            clear(length_scale=120.0),
        )
        assert short > perhaps > long

    @pytest.mark.parametrize("level", [-0.1, 1.0, np.nan])
    def test_a_level_is_a_share(self, level):
        with pytest.raises(brs.errors.InputError, match="unsteady_level"):
            brs.FitOptions(unsteady_level=level)


def test_streamed_records_are_compared_as_the_whole(scene):
    scan, series, _ = scene
    some = series.isel(sample=slice(0, 12_000))
    order = np.argsort(some["time"].values, kind="stable")
    ordered = some.isel(sample=order)
    chunks = [ordered.isel(sample=slice(first, first + 1700)) for first in range(0, 12_000, 1700)]
    from bayes_rs.records.stream import stream_records  # noqa: PLC0415 - beside its use

    xr.testing.assert_identical(stream_records(chunks, scan).drop_attrs(), brs.make_records(ordered, scan).drop_attrs())
