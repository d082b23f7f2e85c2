"""Samples that look like spikes and were not left out: told of where they matter, and of no clean air."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.quality.spikes import FAR, is_far_out, is_spike
from bayes_rs.readers.looking import look
from bayes_rs.records.belief import doubt_lines
from bayes_rs.records.spike_counts import ADDED, COUNT, has_spikes
from bayes_rs.records.stream import stream_records

SCANS = ("staring", "6-beam@opening_angle_deg=45,focus_distance=52", "windcube-v2", "zx-tm")
SIX = SCANS[1]
SHARES = (0.001, 0.005, 0.02)
INTERMITTENT_SD = (0.2, 0.35)
"""Standard deviations of the logarithm of the air's strength: kurtosis 3.5 and 4.9."""
REMEDY = "despike='median' (--despike median)"


def simulated(scan, n_records=6):
    return brs.simulate(scan, "fu-2022", wind_speed=8.0, n_records=n_records, seed=3)


def intermittent(series, sd):
    """Let the strength of the air wander, with a time scale of 45 s."""
    rng = np.random.default_rng(1)
    seconds = (series["time"].values - series["time"].values.min()) / np.timedelta64(1, "s")
    grid = np.arange(0.0, seconds.max() + 20.0, 10.0)
    strength = np.zeros(len(grid))
    for index, step in enumerate(rng.normal(size=len(grid) - 1), start=1):
        strength[index] = 0.8 * strength[index - 1] + 0.6 * step
    beam, velocity = series["beam"].values, series["radial_velocity"].values
    mean = np.bincount(beam, weights=velocity)[beam] / np.bincount(beam)[beam]
    of_air = mean + (velocity - mean) * np.exp(sd * np.interp(seconds, grid, strength))
    return series.assign(radial_velocity=("sample", of_air))


def spiky(series, share, seed=8):
    """Put random velocities into some samples, as a lidar finds them where its signal is lost."""
    rng = np.random.default_rng(seed)
    n_sample = series.sizes["sample"]
    return series.assign(
        radial_velocity=series["radial_velocity"].where(rng.random(n_sample) >= share, rng.uniform(-30, 30, n_sample))
    )


@pytest.fixture(scope="module", params=SCANS)
def clean(request):
    return request.param, simulated(request.param)


@pytest.fixture(scope="module")
def hour():
    return brs.read(brs.demo_file("6-beam-45"), SIX)


class TestRecords:
    def test_clean_air_is_not_accused(self, clean):
        scan, series = clean
        records = brs.make_records(series, scan)
        assert doubt_lines(records) == []
        assert not has_spikes(records).any()

    @pytest.mark.parametrize("sd", INTERMITTENT_SD)
    def test_nor_is_air_whose_strength_wanders(self, clean, sd):
        """Of the limit of the filter itself 0.4 to 1 % of such samples are beyond, and 3 % of the variance."""
        scan, series = clean
        assert doubt_lines(brs.make_records(intermittent(series, sd), scan)) == []

    @pytest.mark.parametrize("share", SHARES)
    def test_spikes_are_told_with_their_share_and_the_remedy(self, clean, share):
        scan, series = clean
        bad = spiky(series, share)
        planted = int((bad["radial_velocity"] != series["radial_velocity"]).sum())
        records = brs.make_records(bad, scan)
        (line,) = doubt_lines(records)
        assert REMEDY in line
        assert line.startswith(f"{100.0 * records[COUNT].values.sum() / series.sizes['sample']:.2g} % of samples")
        assert 0.7 * planted - 1.0 <= records[COUNT].values.sum() <= planted  # some are as the air by chance
        wrong = records["variance"].values.sum() / brs.make_records(series, scan)["variance"].values.sum() - 1.0
        assert records[ADDED].values.sum() / records["variance"].values.sum() == pytest.approx(
            wrong / (1.0 + wrong), abs=0.05
        )
        assert has_spikes(records).any()

    @pytest.mark.parametrize("share", SHARES)
    def test_nothing_is_left_where_they_were_left_out(self, clean, share):
        scan, series = clean
        records = brs.make_records(spiky(series, share), scan, quality=brs.QualityRules(despike="median"))
        assert doubt_lines(records) == []
        assert not has_spikes(records).any()

    def test_the_same_in_pieces(self, hour):
        series = spiky(hour, 0.005)
        whole = brs.make_records(series, SIX)
        chunks = (series.isel(sample=slice(first, first + 5000)) for first in range(0, series.sizes["sample"], 5000))
        pieces = stream_records(chunks, SIX)
        for name in (COUNT, ADDED, "record_flag"):
            np.testing.assert_array_equal(pieces[name], whole[name])
        assert doubt_lines(pieces) == doubt_lines(whole)

    def test_flagged_beams_do_not_count(self, hour):
        """A beam that is not used raises nothing."""
        beam = hour["beam"].values
        bad = np.where(beam == 3, np.random.default_rng(1).uniform(-89.0, 89.0, len(beam)), hour["radial_velocity"])
        records = brs.make_records(hour.assign(radial_velocity=("sample", bad)), SIX)
        assert (records["flag"].values[:, 3] != 0).all()
        assert not any("spikes" in line for line in doubt_lines(records))

    def test_a_single_bad_beam_of_many_is_told(self):
        series = simulated("zx-tm", 2)
        bad = spiky(series, 0.01)
        bad = bad.assign(radial_velocity=series["radial_velocity"].where(series["beam"] != 7, bad["radial_velocity"]))
        (line,) = doubt_lines(brs.make_records(bad, "zx-tm"))
        assert "those of beam 7 by" in line


class TestRule:
    @pytest.mark.parametrize("share", [0.0, 0.001, 0.02, 0.1])
    def test_groups_that_are_passed_over_have_none(self, share):
        """The quick look at the steps loses no sample that the rule finds."""
        rng = np.random.default_rng(5)
        group = np.repeat(np.arange(200), 150)
        velocity = rng.normal(size=len(group))
        velocity = np.where(rng.random(len(group)) < share, rng.uniform(-40, 40, len(group)), velocity)
        expected = is_spike(velocity, group, window=11, threshold=FAR)
        np.testing.assert_array_equal(is_far_out(velocity, group, window=11), expected)
        assert expected.any() == (share > 0.0)

    @pytest.mark.parametrize("n_sample", [0, 1, 2, 3, 4])
    def test_few_samples(self, n_sample):
        assert not is_far_out(np.arange(n_sample, dtype=float), np.zeros(n_sample, dtype=int), window=11).any()


class TestMeasured:
    def test_a_day_of_a_nacelle_lidar_is_not_accused(self, iea_folder):
        scan = brs.load_scan("pulsed-4-beam")
        series = brs.read(sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv")), scan)
        assert not any("spikes" in line for line in doubt_lines(brs.make_records(series, scan)))

    def test_nor_is_an_hour_of_a_scanner(self, six_beam_hour):
        scan = brs.find_scan(six_beam_hour, height=100.0)
        records = brs.make_records(brs.read(six_beam_hour, scan), scan)
        assert not any("spikes" in line for line in doubt_lines(records))


@pytest.fixture(scope="module")
def table(hour, tmp_path_factory):
    place = tmp_path_factory.mktemp("spiky") / "spiky.csv"
    frame = spiky(hour, 0.01).to_dataframe().reset_index()[["time", "beam", "radial_velocity"]]
    pd.DataFrame(frame).to_csv(place, index=False)
    return place


class TestFit:
    def test_the_command_says_it_without_being_asked(self, table, tmp_path, no_pictures):  # noqa: ARG002
        out = tmp_path / "out"
        words = ["fit", str(table), "--scan", SIX, "-o", str(out), "--draws", "none"]
        result = CliRunner().invoke(commands, words)
        assert result.exit_code == 1
        said = " ".join(result.stdout.split())
        assert REMEDY in said[said.index("doubtful:") :]
        assert REMEDY in " ".join(result.stderr.split())
        assert any(REMEDY in line for line in json.loads((out / "run.json").read_text())["doubts"])
        found = brs.open_fit(out)
        assert found.flags["spikes"] == 6
        assert any(REMEDY in line for line in found.failures)

    def test_a_first_look_says_it(self, table):
        found = look(table)
        assert any(REMEDY in line for line in found.lines)
        assert found.words[found.words.index("--despike") + 1] == "median"

    def test_and_not_of_clean_samples(self):
        found = look(brs.demo_file("6-beam-45"))
        assert "--despike" not in found.words
        assert not any("spikes" in line for line in found.lines)

    def test_of_a_cone_by_its_phase(self, tmp_path):
        """Samples of a cone are compared with those of the same part of it."""
        series = simulated("zx-tm", 1)
        for share, name in ((0.0, "clean"), (0.01, "bad")):
            own = spiky(series, share)
            frame = pd.DataFrame(
                {"time": own["time"], "phase": 7.2 * own["beam"], "radial_velocity": own["radial_velocity"]}
            )
            frame.to_csv(tmp_path / f"{name}.csv", index=False)
            assert any("spikes" in line for line in look(tmp_path / f"{name}.csv").lines) == (share > 0.0)
