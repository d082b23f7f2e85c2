"""The instrument's noise from spectra and structure functions, and how the fit takes it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import toeplitz

import bayes_rs as brs
from bayes_rs.fits.batch import Batch
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.flags import flag_words
from bayes_rs.simulation.lines import LineMaker
from bayes_rs.spectra.structure_noise import intercept_weights, structure_covariance, structure_function

FLOW = brs.load_turbulence("fu-2022")
STARING = brs.load_scan("staring")


def noisy(scan, noise, n_records, seed, flow=FLOW):
    """Records and spectra of simulated velocities with white noise of a variance."""
    series = brs.simulate(scan, flow, wind_speed=10.0, n_records=n_records, seed=seed)
    white = np.sqrt(noise) * np.random.default_rng(seed).standard_normal(series.sizes["sample"])
    series = series.assign(radial_velocity=series["radial_velocity"] + white)
    records = brs.make_records(series, scan)
    return records, brs.spectra.radial_spectra(series, scan, records)


class TestStructureFunctions:
    def test_they_are_half_the_mean_square_differences_of_what_is_there(self):
        velocity = np.array([1.0, 3.0, np.nan, 2.0, 2.0, 5.0])
        found = structure_function(velocity, 3)
        assert found.value == pytest.approx([0.5 * (4 + 0 + 9) / 3, 0.5 * (1 + 9) / 2, 0.5 * (1 + 1) / 2])
        assert found.pairs.tolist() == [3, 2, 2]

    @pytest.mark.parametrize("share", [0.0, 0.25])
    def test_their_covariance_is_that_of_the_quadratic_forms(self, share):
        n, n_lag = 40, 3
        present = np.random.default_rng(3).uniform(size=n) > share
        c = 0.7 ** np.arange(n + n_lag)
        c[0] += 0.5
        matrix = toeplitz(c[:n])
        forms = []
        for m in range(1, n_lag + 1):
            pairs = [i for i in range(n - m) if present[i] and present[i + m]]
            form = np.zeros((n, n))
            for i in pairs:
                step = np.zeros(n)
                step[i + m], step[i] = 1.0, -1.0
                form += 0.5 * np.outer(step, step) / len(pairs)
            forms.append(form)
        slow = [[2.0 * np.trace(a @ matrix @ b @ matrix) for b in forms] for a in forms]
        assert structure_covariance(c, present, n_lag) == pytest.approx(np.array(slow), rel=1e-10)  # rounding

    def test_the_intercept_of_an_exact_structure_function_is_the_noise(self):
        growth = np.arange(1.0, 6.0) ** (2.0 / 3.0)
        assert intercept_weights(growth) @ (0.3 + 1.7 * growth) == pytest.approx([0.3, 1.7])


class TestEstimate:
    @pytest.mark.parametrize(("interval", "noise"), [(1.0, 0.0), (1.0, 0.1), (4.0, 0.1)])
    def test_structure_functions_are_unbiased_and_know_their_error(self, interval, noise):
        _, spectra = noisy(replace(STARING, scan_duration=interval), noise, 150, 7)
        found = brs.spectra.estimate_instrument_noise(spectra, STARING, FLOW)
        error = found["instrument_noise"].values[:, 0] - noise
        width = found["instrument_noise_sd"].values[:, 0]
        assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(150)
        # the scatter of 150 is known to 6 %, the stated one varies with the size that each record finds
        assert width.mean() == pytest.approx(error.std(), rel=0.25)
        held = np.mean(np.abs(error) < stats.norm.ppf(0.95) * width)
        assert held == pytest.approx(0.9, abs=0.1)  # four binomial standard errors

    def test_the_power_law_is_biased_where_the_interval_is_long(self):
        scan = replace(STARING, scan_duration=4.0)
        _, spectra = noisy(scan, 0.0, 100, 8)
        law = brs.spectra.estimate_instrument_noise(spectra, scan, FLOW, growth="inertial")["instrument_noise"].values
        theory = brs.spectra.estimate_instrument_noise(spectra, scan, FLOW)["instrument_noise"].values
        error = law.std() / 10.0
        assert law.mean() > 8.0 * error  # 0.12 of 1.2 m² s⁻²
        assert abs(theory.mean()) < 4.0 * theory.std() / 10.0

    def test_the_floor_is_found_where_it_is_seen_and_unsure_where_not(self):
        for interval, largest in ((1.0, 0.04), (4.0, 0.2)):
            scan = replace(STARING, scan_duration=interval)
            _, spectra = noisy(scan, 0.1, 40, 9)
            found = brs.spectra.estimate_instrument_noise(spectra, scan, FLOW, method="spectrum")
            error = found["instrument_noise"].values[:, 0] - 0.1
            width = found["instrument_noise_sd"].values[:, 0]
            assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(40)
            assert 0.5 * largest < width.mean() < largest
        assert width.mean() > 0.1  # every 4 s: as large as the noise itself

    def test_a_probe_volume_is_in_the_shape(self):
        probe = brs.geometry.ContinuousWaveProbe(rayleigh_length=15.0)
        scan = replace(STARING, probe=probe)
        _, spectra = noisy(scan, 0.05, 40, 10)
        with_probe = brs.spectra.estimate_instrument_noise(spectra, scan, FLOW)["instrument_noise"].values[:, 0]
        without = brs.spectra.estimate_instrument_noise(spectra, STARING, FLOW)["instrument_noise"].values[:, 0]
        # what the simulator adds where the covariances of probes are not those of any process
        added = LineMaker(scan, FLOW, wind_speed=10.0, n_sample=600).negative_part * FLOW.stresses()[0]
        assert abs(with_probe.mean() - 0.05) < 4.0 * with_probe.std() / np.sqrt(40) + added
        assert without.mean() < 0.05 - 8.0 * without.std() / np.sqrt(40)  # so that leaving it out would fail

    def test_flags_say_what_is_wrong_and_nothing_is_clipped(self):
        _, spectra = noisy(replace(STARING, scan_duration=4.0), 0.0, 30, 11)
        found = brs.spectra.estimate_instrument_noise(spectra, STARING, FLOW)
        noise, flag = found["instrument_noise"].values, found["flag"].values
        assert np.array_equal((flag & 2) > 0, noise < 0.0)
        assert np.any(noise < 0.0)
        tiny = spectra.assign(variance=0.0 * spectra["variance"] + 1e-9)
        again = brs.spectra.estimate_instrument_noise(tiny, STARING, FLOW)
        assert np.array_equal((again["flag"].values & 1) > 0, noise >= 1e-9)
        assert np.all(again["flag"].values & 4)
        assert np.array_equal(again["instrument_noise"].values, noise)

    def test_input_is_checked(self):
        _, spectra = noisy(STARING, 0.0, 1, 1)
        for options, words in (
            ({"method": "cnr"}, "Unknown method"),
            ({"n_lag": 1}, "Invalid n_lag 1"),
            ({"growth": "x"}, "growth"),
        ):
            with pytest.raises(brs.InputError, match=words):
                brs.spectra.estimate_instrument_noise(spectra, STARING, FLOW, **options)


@pytest.fixture(scope="module")
def six():
    """Records of six beams with noise, and the noise found in them."""
    scan = brs.load_scan("6-beam")
    records, spectra = noisy(scan, 0.1, 4, 12)
    return scan, records, brs.spectra.estimate_instrument_noise(spectra, scan, FLOW)


class TestRecordsWithNoise:
    def test_one_number_for_the_instrument_or_each_beam_or_record(self, six):
        _, records, found = six
        one = brs.spectra.with_instrument_noise(records, found, known_positive=False)
        assert one["instrument_noise"].values == pytest.approx(float(found["instrument_noise"].mean()))
        per_beam = brs.spectra.with_instrument_noise(records, found, per="beam", known_positive=False)
        assert per_beam["instrument_noise"].values[2] == pytest.approx(found["instrument_noise"].mean("record").values)
        each = brs.spectra.with_instrument_noise(records, found, per="record", known_positive=False)
        assert np.array_equal(each["instrument_noise"].values, found["instrument_noise"].values)

    def test_a_variance_that_is_known_to_be_positive_has_a_cut_off_distribution(self, six):
        _, records, found = six
        low = found.assign(instrument_noise=0.0 * found["instrument_noise"] - 0.02)
        got = brs.spectra.with_instrument_noise(records, low, per="record")
        sd = low["instrument_noise_sd"].values
        exact = stats.truncnorm(a=0.02 / sd, b=np.inf, loc=-0.02, scale=sd)
        assert got["instrument_noise"].values == pytest.approx(exact.mean(), rel=1e-6)
        assert got["instrument_noise_sd"].values == pytest.approx(exact.std(), rel=1e-5)

    def test_input_is_checked(self, six):
        _, records, found = six
        with pytest.raises(brs.InputError, match="not of these records and beams"):
            brs.spectra.with_instrument_noise(records.isel(record=[0]), found)
        with pytest.raises(brs.InputError, match="holds no number"):
            brs.spectra.with_instrument_noise(
                records, found.assign(instrument_noise=np.nan * found["instrument_noise"])
            )
        with pytest.raises(brs.InputError, match="Unknown per"):
            brs.spectra.with_instrument_noise(records, found, per="day")


class TestFit:
    @pytest.fixture(scope="class")
    @staticmethod
    def noise(six):
        return brs.noise.theory(six[0], FLOW, wind_speed=10.0)

    def draws(self, six, noise, records, **options):
        return brs.fit(records, six[0], noise=noise, seed=1, sampler="direct", progress=False, **options)

    def test_the_same_number_in_records_and_options_is_the_same_fit(self, six, noise):
        _, records, _ = six
        own = records.assign(instrument_noise=(("record", "beam"), np.full((4, 6), 0.1)))
        a = self.draws(six, noise, own, instrument_noise="records")
        b = self.draws(six, noise, records, instrument_noise=0.1)
        assert np.array_equal(a["posterior"]["stress"].values, b["posterior"]["stress"].values)
        assert a.attrs["instrument_noise"] == "records"

    def test_the_noise_of_each_beam_counts(self, six, noise):
        _, records, _ = six
        add = np.linspace(0.0, 0.5, 24).reshape(4, 6)
        more = records.assign(
            variance=records["variance"] + add,
            instrument_noise=(("record", "beam"), add),
        )
        plain, moved = (
            self.draws(six, noise, one, instrument_noise=0.0)["posterior"]["stress"].mean(("chain", "draw")).values
            for one in (records, more)
        )
        back = self.draws(six, noise, more, instrument_noise="records")["posterior"]["stress"]
        back = back.mean(("chain", "draw")).values
        # the noise of a variance grows with it, so the fit is not the same, but most of what was added is taken off
        assert np.abs(back - plain)[:, 0].max() < 0.35 * np.abs(moved - plain)[:, 0].max()

    def test_beams_that_are_all_noise_are_left_out_and_flagged(self, six, noise, tmp_path):
        scan, records, found = six
        own = brs.spectra.with_instrument_noise(records, found)
        values = own["instrument_noise"].values
        values[1, 2] = 2.0 * float(records["variance"].values[1, 2])
        values[3] = 99.0
        result = self.draws(six, noise, own, instrument_noise="records")
        words = [flag_words(int(flag)) for flag in result["sample_stats"]["flag"].values]
        # yaws of -4.2 and 3.4 degrees, and noise for 0 only
        assert words == [
            "outside_noise",
            "beam_left_out;beams_disagree",
            "outside_noise",
            "no_usable_beam;noise_above_variance",
        ]
        options = {"noise": noise, "seed": 1, "sampler": "direct", "instrument_noise": "records"}
        means = brs.fit(own, scan, output=tmp_path / "year", **options).summary()["mean"].to_numpy()
        assert np.array_equal(means, result.summary()["mean"].to_numpy(), equal_nan=True)

    def test_uncertain_noise_has_the_mean_of_the_used_beams_as_median(self):
        used = np.array([[True, True, False], [True, False, False]])
        own = np.array([[0.1, 0.3, 9.0], [0.2, 9.0, 9.0]])
        batch = Batch(np.ones((2, 3)), used, np.ones(2), np.zeros(2), np.arange(2), instrument_noise=own)
        options = FitOptions(instrument_noise="records", nuisances=brs.Nuisances(instrument_noise_log_sd=0.3))
        assert batch.median_noise(options) == pytest.approx(np.array([[0.2], [0.2]]))
        assert batch.known_noise(options) == 0.0
        assert batch.take(np.array([1])).median_noise(options) == pytest.approx(np.array([[0.2]]))

    def test_input_is_checked(self, six, noise):
        _, records, _ = six
        of_beams = records.assign(instrument_noise=("beam", np.full(6, 0.1)))
        with pytest.raises(brs.InputError, match=r"instrument_noise has dims \('beam',\), and must have"):
            self.draws(six, noise, of_beams, instrument_noise="records")
        with pytest.raises(brs.InputError, match="Unknown instrument_noise 'floor'"):
            self.draws(six, noise, records, instrument_noise="floor")
        values = np.full((4, 6), 0.1)
        values[2, 3] = -0.01
        bad = records.assign(instrument_noise=(("record", "beam"), values))
        with pytest.raises(brs.InputError, match=r"Invalid instrument_noise -0.01 m² s⁻² of record 2, beam 3"):
            self.draws(six, noise, bad, instrument_noise="records")
