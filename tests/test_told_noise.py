"""The instrument's noise that the octaves of records tell: how well, what is said of it, and what a fit makes of it."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import scipy
import xarray as xr

import bayes_rs as brs
from bayes_rs.campaign.table import campaign_table
from bayes_rs.likelihoods.reduced_noise import ReducedRecordNoise
from bayes_rs.likelihoods.scattered import shifted, shifted_reduced
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.spectra import pooled_noise
from bayes_rs.spectra.octave_likelihood import log_sum
from bayes_rs.spectra.pooled_noise import SHAPE_ERROR, pool_noise
from bayes_rs.spectra.record_lengths import REPORT, _octaves, with_own_length_scale, with_told_noise
from bayes_rs.spectra.told_noise import NOISE_REPORT, noise_words

FLOW = brs.load_turbulence("fu-2022")
SIX = brs.load_scan("6-beam@opening_angle_deg=45,focus_distance=52")


def simulated(length_scale=61.0, noise=0.0, *, scan=SIX, n_records=40, seed=5, size=None):
    """Return records whose samples have white noise of this variance, and sizes of their own."""
    flow = replace(FLOW, length_scale=length_scale)
    series = brs.simulate(scan, flow, wind_speed=9.0, n_records=n_records, seed=seed)
    rng = np.random.default_rng(seed)
    velocity = series["radial_velocity"].values.copy()
    if size is not None:  # of the deviations from the beam's mean, so that the wind stays
        record = ((series["time"] - series["time"][0]) / np.timedelta64(600, "s")).astype(int).values
        for beam in np.unique(series["beam"]):
            own = series["beam"].values == beam
            velocity[own] += (np.sqrt(size)[record[own]] - 1.0) * (velocity[own] - velocity[own].mean())
    noisy = series.assign(
        radial_velocity=("sample", velocity + np.sqrt(noise) * rng.standard_normal(len(velocity))),
    )
    return brs.make_records(noisy, scan)


def report_of(records):
    return json.loads(records.attrs[REPORT])


def told_of(records):
    return json.loads(records.attrs[NOISE_REPORT])


class TestRecords:
    @pytest.mark.parametrize("length_scale", [30.0, 61.0, 200.0])
    def test_noise_is_found_beside_the_length_scale(self, length_scale):
        records = simulated(length_scale, 0.09)
        found = with_own_length_scale(records, SIX)
        noise, sd = (found[name].values[:, 0] for name in ("instrument_noise", "instrument_noise_sd"))
        assert noise.mean() == pytest.approx(0.09, abs=0.012)
        assert np.all(np.abs(noise - 0.09) < 4.0 * sd)
        assert abs(np.log(report_of(found)["length_scale"] / length_scale)) < 0.25
        assert "m/s" in noise_words(found)
        assert "it is taken off" in noise_words(found)

    @pytest.mark.parametrize("length_scale", [15.0, 61.0, 200.0])
    def test_where_there_is_none_next_to_none_is_found(self, length_scale):
        found = with_own_length_scale(simulated(length_scale), SIX)
        share = found["instrument_noise"].mean("beam") / found["variance"].mean("beam")
        assert float(share.max()) < 0.03
        assert float(share.mean()) < 0.02
        # what another shape of spectrum would make look like noise is in its standard deviation
        own = found["instrument_noise_sd"].mean("beam") / found["variance"].mean("beam")
        assert np.all(own.values >= 0.9 * SHAPE_ERROR)

    def test_noise_that_grows_with_the_turbulence(self):
        size = np.geomspace(0.2, 5.0, 60)[np.random.default_rng(1).permutation(60)]
        plain = simulated(n_records=60, size=size)
        same = with_own_length_scale(simulated(noise=0.1, n_records=60, size=size), SIX)
        assert told_of(same)["power"] < 0.2
        assert float(same["instrument_noise"].median()) == pytest.approx(0.1, rel=0.15)
        # the same samples, each record in another size: its noise is in proportion
        for name in ("variance", "octave_variance"):
            plain[name] = simulated(noise=0.1, n_records=60)[name] * size.reshape(-1, *(1,) * (plain[name].ndim - 1))
        grown = with_own_length_scale(plain, SIX)
        assert told_of(grown)["power"] > 0.8
        assert np.median(np.abs(np.log(grown["instrument_noise"].values[:, 0] / (0.1 * size)))) < 0.2

    def test_a_record_does_not_tell_itself_twice(self):
        records = simulated(noise=0.09, n_records=1)
        alone = pool_noise(_octaves(records, SIX, 3.2)[1], median=61.0, log_sd=0.8)
        nothing = simulated(n_records=1)
        assert alone.log_sd[0] > 1.0
        other = pool_noise(_octaves(nothing, SIX, 3.2)[1], median=61.0, log_sd=0.8)
        assert alone.log_share[0] == pytest.approx(other.log_share[0], abs=0.1)

    def test_a_record_alone_tells_its_noise_as_well_as_it_says(self):
        for seed in range(6):
            found = with_own_length_scale(simulated(noise=0.09, n_records=1, seed=seed), SIX)
            error = float(found["instrument_noise"][0, 0]) - 0.09
            assert abs(error) < 3.0 * float(found["instrument_noise_sd"][0, 0])
            assert abs(error) < 0.05

    def test_records_that_are_not_looked_at_have_what_the_others_tell(self, monkeypatch):
        records = simulated(noise=0.09)
        whole = with_own_length_scale(records, SIX)["instrument_noise"].values[:, 0]
        monkeypatch.setattr("bayes_rs.spectra.pooled_noise.MOST_RECORDS", 20)
        half = with_own_length_scale(records, SIX)["instrument_noise"].values[:, 0]
        np.testing.assert_allclose(half, whole, rtol=0.15)

    def test_too_few_samples_tell_none(self):
        slow = replace(brs.load_scan("staring"), scan_duration=30.0)
        records = simulated(noise=0.3, scan=slow)
        found = with_own_length_scale(records, slow)
        assert "instrument_noise" not in found
        assert "do not tell it, and none is taken off" in noise_words(found)

    def test_a_record_without_a_beam_has_none(self):
        records = simulated(noise=0.09)
        records["flag"].values[5] = 1
        found = with_own_length_scale(records, SIX)["instrument_noise"]
        assert (found[5] == 0.0).all()
        assert (found[4] > 0.05).all()

    def test_noise_that_is_known_is_not_looked_for(self):
        records = simulated(100.0, 0.2)
        share = 100.0 * float(np.median(0.2 / records["variance"].mean("beam")))
        own_words = f"instrument noise of the records' own: 0.45 m/s, {share:.1f} % of the variance; it is taken off"
        for given in ({"instrument_noise": 0.2}, {}):
            own = records if given else records.assign(instrument_noise=0.2 + 0.0 * records["variance"])
            found = with_own_length_scale(own, SIX, **given)
            assert abs(np.log(report_of(found)["length_scale"] / 100.0)) < 0.25
            assert "instrument_noise_sd" not in found
            assert noise_words(found) == ("" if given else own_words)
        short = with_own_length_scale(records, SIX, instrument_noise=0.0)
        assert report_of(short)["length_scale"] < 50.0  # noise that is not known of looks like small eddies

    def test_only_the_noise_of_records_with_a_length_scale(self):
        records = simulated(noise=0.09).assign(length_scale=("record", np.full(40, 50.0)))
        found = with_told_noise(records, SIX)
        assert np.all(found["length_scale"] == 50.0)
        assert float(found["instrument_noise"].mean()) == pytest.approx(0.09, abs=0.012)
        bare = with_told_noise(records.drop_vars("octave_variance"), SIX)
        assert "instrument_noise" not in bare
        assert "do not tell it" in noise_words(bare)
        assert with_told_noise(found, SIX) is found

    def test_many_records_whose_noise_differs(self):
        """Errors are as large as they are said to be, also where each record's likelihood is narrow."""
        own = 0.1 * np.exp(0.7 * np.random.default_rng(3).standard_normal(240))
        parts = [simulated(noise=float(s), n_records=1, seed=index) for index, s in enumerate(own)]
        records = xr.concat(parts, "record", combine_attrs="override")
        found = with_own_length_scale(records, SIX)
        z = (found["instrument_noise"].values[:, 0] - own) / found["instrument_noise_sd"].values[:, 0]
        assert z.std() < 1.2
        assert np.mean(np.abs(z) > 3.0) < 0.015


class TestFit:
    OPTIONS: ClassVar = {"seed": 1, "sampler": "direct", "campaign": "off", "target_ess": 200}

    @pytest.mark.parametrize("given", [{}, {"turbulence": "fu-2022"}])
    def test_by_default_what_the_records_tell_is_taken_off(self, given):
        records, plain = simulated(noise=0.2, n_records=20), simulated(n_records=20)
        said = []
        fits = {
            "told": brs.fit(records, SIX, say=said.append, **self.OPTIONS, **given),
            "kept": brs.fit(records, SIX, instrument_noise=0.0, **self.OPTIONS, **given),
            "none": brs.fit(plain, SIX, **self.OPTIONS, **given),
        }
        mean = {name: fit.summary().groupby("stress")["mean"].mean() for name, fit in fits.items()}
        for stress in ("uu", "vv", "ww"):
            added = mean["kept"][stress] - mean["none"][stress]
            assert added > 0.1
            assert abs(mean["told"][stress] - mean["none"][stress]) < 0.3 * added
        assert any(line.startswith("instrument noise from the spectra: 0.4") for line in said)
        again = brs.fit(fits["told"].records, SIX, **self.OPTIONS, **given)
        assert again.summary()["mean"].to_numpy() == pytest.approx(fits["told"].summary()["mean"].to_numpy())
        # what a fit found without noise is not what is asked for
        anew = brs.fit(fits["kept"].records, SIX, **self.OPTIONS, **given)
        assert anew.summary()["mean"].to_numpy() == pytest.approx(fits["told"].summary()["mean"].to_numpy(), rel=1e-6)

    def test_a_length_scale_of_ones_own_stays_in_the_records(self):
        records = simulated(noise=0.09, n_records=6).assign(length_scale=("record", np.full(6, 150.0)))
        first = brs.fit(records, SIX, **self.OPTIONS)
        assert np.all(first.records["length_scale"] == 150.0)
        assert first.records["instrument_noise"].mean() > 0.04
        second = brs.fit(first.records, SIX, **self.OPTIONS)
        assert second.summary()["mean"].to_numpy() == pytest.approx(first.summary()["mean"].to_numpy())

    def test_a_record_without_wind_needs_no_noise(self):
        records = simulated(noise=0.09, n_records=4)
        records["wind_speed"].values[2] = np.nan
        fit = brs.fit(records, SIX, nuisances=brs.Nuisances(instrument_noise_log_sd=0.3), **self.OPTIONS)
        assert fit.n_fitted == 3

    def test_noise_of_one_dimension_is_refused(self):
        records = simulated(n_records=4)
        for name in ("instrument_noise", "instrument_noise_sd"):
            bad = records.assign(instrument_noise=0.0 * records["variance"]).assign({name: ("record", np.full(4, 0.1))})
            with pytest.raises(
                brs.InputError, match=rf"records cannot be used: {name} has dims \('record',\), and must"
            ):
                brs.fit(bad, SIX, **self.OPTIONS)

    def test_what_is_not_known_of_it_widens_the_intervals(self):
        records = with_own_length_scale(simulated(noise=0.2, n_records=4), SIX)
        widths = []
        for factor in (0.0, 1.0, 8.0):
            own = records.assign(instrument_noise_sd=factor * records["instrument_noise_sd"])
            table = brs.fit(own, SIX, **self.OPTIONS).summary()
            widths.append((table["high"] - table["low"])[table["stress"] == "ww"].mean())
        assert widths[0] < widths[1] * 1.02
        assert widths[2] > 1.1 * widths[0]

    def test_the_interval_of_a_campaign_holds_its_error(self):
        """All records alike: means keep their values, variances get the noise's error, and tensors stay tensors."""
        stress = np.broadcast_to([1.0, 0.5, 0.4, 0.0, -0.1, 0.0], (1, 2000, 40, 6))
        campaign = SimpleNamespace(
            stress=stress,
            n_record=40,
            wind_speed=np.full(40, 10.0),
            group=("",) * 40,
            prior_stress=stress[0] + np.random.default_rng(2).uniform(0.0, 0.1, (2000, 40, 6)),
        )
        table = campaign_table(campaign, offset_sd=np.full(40, 0.02)).set_index(["quantity", "bin"])
        width = table["high"] - table["low"]
        for name in ("uu", "vv", "ww"):
            assert width[name, "all"] == pytest.approx(2.0 * 1.645 * 0.02, rel=0.08)
        for name, value in (("uu", 1.0), ("ww", 0.4), ("uw", -0.1)):
            assert table.loc[(name, "all"), "mean"] == pytest.approx(value, rel=3e-3)
        assert width["rho_uw", "all"] == pytest.approx(0.0, abs=1e-12)


class TestMoments:
    SD = np.array([[0.1, 0.2, 0.05, 0.1, 0.3, 0.1], [0.0] * 6])

    @pytest.fixture(scope="class")
    @staticmethod
    def at():
        return theory_noise("6-beam", FLOW, wind_speed=10.0).for_records(np.full(2, 10.0), np.zeros(2))

    def test_one_amount_for_all_beams(self, at):
        """y times log-normal factors of mean 1 and standard deviations t, whose logarithms are one normal number."""
        found = shifted(at, self.SD)
        t = self.SD[0]
        s = np.sqrt(np.log1p(t**2))
        np.testing.assert_allclose(found.covariance[0], (1.0 + at.covariance[0]) * np.exp(np.outer(s, s)) - 1.0)
        np.testing.assert_allclose(1.0 + np.diag(found.covariance[0]), (1.0 + np.diag(at.covariance[0])) * (1.0 + t**2))
        assert np.linalg.eigvalsh(np.log1p(found.covariance[0])).min() > 0.0
        np.testing.assert_allclose(found.covariance[1], at.covariance[1], atol=1e-15)
        assert len(np.unique(found.state)) == 2

    def test_reduced_noise_is_the_reduction_of_the_whole(self, at):
        left = np.linalg.qr(np.random.default_rng(2).standard_normal((6, 3)))[0]
        logs = np.log1p(at.covariance)
        reduced = ReducedRecordNoise(at.gain, at.bias, left.T @ logs @ left, np.einsum("rbb->rb", logs), at.outside)
        found = shifted_reduced(reduced, left, self.SD)
        whole = np.log1p(shifted(at, self.SD).covariance)
        np.testing.assert_allclose(found.covariance, left.T @ whole @ left, atol=1e-12)
        np.testing.assert_allclose(found.log_variance, np.einsum("rbb->rb", whole), rtol=1e-12)


class TestToTheLastBit:
    """What is made faster has the same bits: draws depend on them."""

    @pytest.mark.parametrize("shape", [(171, 147), (6, 23, 57), (1, 171), (4, 1)])
    def test_sums_of_exponentials_are_those_of_scipy(self, shape):
        values = 30.0 * np.random.default_rng(1).normal(size=shape)
        values[..., -1] = values.max(axis=-1)  # two that are the largest
        np.testing.assert_array_equal(log_sum(values), scipy.special.logsumexp(values, axis=-1))

    def test_what_the_records_of_a_stream_of_many_ranges_say_is_kept(self):
        """Twenty ranges take turns, each with six records that it remembers."""
        _, octaves = _octaves(simulated(noise=0.2, n_records=6), SIX, 3.2)
        ranges = [replace(octaves, energy=octaves.energy * (1.0 + 0.01 * number)) for number in range(20)]
        for one in ranges:
            pool_noise(one, median=61.0, log_sd=0.8)
        before = pooled_noise._kept_density.cache_info().misses
        pool_noise(ranges[0], median=61.0, log_sd=0.8)
        assert pooled_noise._kept_density.cache_info().misses == before

    def test_records_one_by_one_say_what_they_say_together(self, monkeypatch):
        records = simulated(noise=0.2, n_records=6)
        _, octaves = _octaves(records, SIX, 3.2)
        one_by_one = pool_noise(octaves, median=61.0, log_sd=0.8)
        again = pool_noise(octaves, median=61.0, log_sd=0.8)  # of what is kept
        monkeypatch.setattr(pooled_noise, "_KEPT", 0)
        together = pool_noise(octaves, median=61.0, log_sd=0.8)
        for name in ("log_share", "log_sd", "power", "common_log_sd"):
            np.testing.assert_array_equal(getattr(one_by_one, name), getattr(together, name))
            np.testing.assert_array_equal(getattr(one_by_one, name), getattr(again, name))


class TestHyperparameters:
    """What the records say of all, and of each without itself, is that of sums of logarithms, one at a time."""

    @staticmethod
    def slowly(density, fine, size, hyper, lengths, usual):
        share = np.exp(hyper[0])
        log_prior = np.log(share / (share + 0.02)) - 0.5 * share * usual / 0.3**2
        evidence = []
        for one, at in zip(np.log(density), size, strict=True):
            of_hyper = []
            for centre, power, spread in zip(*hyper, strict=True):
                log_normal = -0.5 * ((fine - centre - (power - 1.0) * at) / spread) ** 2
                log_normal -= scipy.special.logsumexp(log_normal)
                of_length = scipy.special.logsumexp(one + log_normal[:, None], axis=0)
                of_hyper.append(scipy.special.logsumexp(of_length + np.log(lengths[0]), axis=1))
            evidence.append(of_hyper)
        evidence = np.array(evidence)
        total = log_prior[:, None] + lengths[1] + evidence.sum(axis=0)
        own = scipy.special.logsumexp(total - evidence, axis=2)
        whole = scipy.special.logsumexp(total, axis=1)
        return scipy.special.softmax(whole), scipy.special.softmax(own, axis=1)

    @pytest.mark.parametrize("most", [1.0, 3.0])  # times the mean variance or less; such that priors leave the grid
    def test_weights_are_those_of_sums_of_logarithms(self, most, monkeypatch):
        n_record = 7
        size = np.geomspace(1.0 / most**4, most**4, n_record)
        records = simulated(noise=0.05, n_records=n_record, size=size)
        _, octaves = _octaves(records, SIX, 3.2)
        length = pooled_noise._steps(pooled_noise.length_nodes()[[0, -1]], 0.1)
        fine = pooled_noise._steps(pooled_noise._SHARES, 0.05)
        lengths = pooled_noise._length_hypers(length, 61.0, 0.8)
        hyper = tuple(axis.ravel() for axis in np.meshgrid([-6.9, -5.0, -3.0, -1.0], [0.0, 0.5, 1.0], [0.1, 0.7]))
        given = (pooled_noise._density(octaves), fine, np.log(size), hyper, lengths, 0.6)
        monkeypatch.setattr(pooled_noise, "_HYPERS", 5)  # in parts
        weight, own = pooled_noise._posterior(*given)
        slow_weight, slow_own = self.slowly(*given)
        np.testing.assert_allclose(weight, slow_weight, rtol=1e-10, atol=1e-14)
        np.testing.assert_allclose(own, slow_own, rtol=1e-10, atol=1e-14)
        assert np.abs(own - weight).max() > 0.01  # a record's own word counts
