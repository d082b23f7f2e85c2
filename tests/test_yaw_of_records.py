"""Directions as uncertain as each record says, and length scales of the records, through every kind of fit."""

import json
from functools import partial

import folder_scene
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from fit_scene import NOISE, SCAN, make_records

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.fits import from_files, plan
from bayes_rs.fits.noise_choice import _with_yaw_sd
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.records import record_store

OWN = Nuisances(yaw_sd_deg="records")
FLOW = brs.load_turbulence("fu-2022")
OPTIONS = {"noise": NOISE, "seed": 3, "target_ess": 100, "sampler": "auto"}


@pytest.fixture(scope="module")
def records():
    return make_records(12).assign(yaw_sd=("record", np.linspace(0.0, 11.0, 12)))


class TestFolder:
    @pytest.mark.parametrize("size", [1, 5, 128])
    def test_the_size_of_a_part_changes_no_number(self, records, monkeypatch, tmp_path, size):
        monkeypatch.setattr(plan, "PART_RECORDS", size)
        found = brs.fit(records, SCAN, output=tmp_path / "out", nuisances=OWN, **OPTIONS).summary()
        expected = brs.fit(records, SCAN, nuisances=OWN, **OPTIONS).summary()
        pd.testing.assert_frame_equal(found[expected.columns], expected, check_exact=True, check_dtype=False)

    def test_other_deviations_are_another_fit(self, records, tmp_path):
        brs.fit(records, SCAN, output=tmp_path / "out", nuisances=OWN, **OPTIONS)
        other = records.assign(yaw_sd=records["yaw_sd"] + 1.0)
        with pytest.raises(brs.InputError, match="is of a run that differs in records"):
            brs.fit(other, SCAN, output=tmp_path / "out", nuisances=OWN, resume=True, **OPTIONS)


class TestJobs:
    def test_a_folder_is_the_same_in_any_chunks(self, tmp_path, monkeypatch):
        folder_scene.write_files(tmp_path / "year", folder_scene.make_series(), 3)
        folder_scene.write_noise(tmp_path / "noise.nc")
        said = []
        more = {"nuisances": Nuisances(yaw_sd_deg="records", yaw_sd_missing_deg=20.0), "say": said.append}
        for name, chunk_rows in (("one", 37), ("two", 5000)):
            monkeypatch.setattr(from_files, "store_records", partial(record_store.store_records, chunk_rows=chunk_rows))
            folder_scene.run(tmp_path / "year", tmp_path / name, tmp_path / "noise.nc", **more)
        one, two = (brs.open_fit(tmp_path / name).summary() for name in ("one", "two"))
        pd.testing.assert_frame_equal(one, two, check_exact=True)
        records = xr.load_dataset(tmp_path / "one" / "records.nc")
        scan, flow = folder_scene.SCAN, folder_scene.FLOW
        wind = brs.wind.mean_wind(records, scan, turbulence=flow)
        np.testing.assert_array_equal(records["yaw_sd"], wind["yaw_sd"])
        noise = brs.noise.load(tmp_path / "noise.nc")
        plain = {"noise": noise, "target_ess": 100, "seed": 3, "sampler": "auto", "nuisances": more["nuisances"]}
        expected = brs.fit(wind, scan, **plain).summary()
        pd.testing.assert_frame_equal(one[expected.columns], expected, check_exact=True, check_dtype=False)
        assert any(
            line.startswith("uncertainty of the wind's direction: from the beams' means") and "records without" in line
            for line in said
        )
        run = json.loads((tmp_path / "one" / "run.json").read_text())
        assert run["nuisances"] == "yaw ± what each record says (20° where it does not) (one standard deviation)"

    def test_the_check_of_the_prior_takes_it(self, tmp_path):
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=1)
        records = brs.make_records(series, scan)
        brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False).save(tmp_path / "noise.nc")
        table = brs.prior_sensitivity(
            records, scan, seed=1, noise=tmp_path / "noise.nc", factors=[2.0], sampler="direct", nuisances=OWN
        )
        assert len(table) == 12

    def test_what_is_there_is_kept_and_other_directions_are_refused(self):
        scan = brs.load_scan("6-beam")
        records = brs.make_records(brs.simulate(scan, FLOW, wind_speed=10.0, n_records=3, seed=2), scan)
        said = []
        assert _with_yaw_sd(records, scan, NOISE, Nuisances(), said.append) is records
        assert _with_yaw_sd(records, scan, NOISE, Nuisances(yaw_sd_deg=2.0), said.append) is records
        own = records.assign(yaw_sd=("record", [1.0, 2.0, 3.0]))
        assert _with_yaw_sd(own, scan, NOISE, OWN, said.append) is own
        assert said == []
        turned = records.assign(yaw=records["yaw"] + xr.DataArray([0.0, 360.0, 0.1], dims="record"))
        with pytest.raises(
            brs.InputError, match=r"Invalid yaw .* degrees of record 2, one of 1: its beams' means give"
        ):
            _with_yaw_sd(turned, scan, NOISE, OWN, said.append)

    def test_the_length_scales_of_records_reach_the_noise_that_is_made(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path / "cache"))
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=2, seed=1)
        records = brs.make_records(series, scan)
        records = xr.concat([records, records], dim="record").drop_vars("time")
        records = records.isel(record=[0, 2]).assign(length_scale=("record", [20.0, 160.0]))
        said = []
        found = brs.fit(records, scan, seed=1, sampler="direct", target_ess=1000, say=said.append)
        assert any(", L 20 to 160 m" in line for line in said)
        width = np.log(found["posterior/stress"].sel(component="uu")).std(("chain", "draw")).values
        # the same variances; eight times the eddies are an eighth as many in a record. sd of 1000 draws: 2.2 %
        assert width[1] > 1.2 * width[0]
        made = brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False)
        made.save(tmp_path / "noise.nc")
        other = brs.fit(records, scan, seed=1, sampler="direct", target_ess=1000, noise=tmp_path / "noise.nc")
        assert other.flags["outside_noise"] == 2


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    scan = brs.load_scan("2-beam")
    series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=2, seed=1)
    frame = series.to_dataframe().reset_index()[["time", "beam", "radial_velocity"]]
    frame.to_csv(folder / "day.csv", index=False)
    brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False).save(folder / "noise.nc")
    return folder


class TestCommand:
    @staticmethod
    def run(inputs, *more):
        words = [
            "fit",
            inputs / "day.csv",
            "--scan",
            "2-beam",
            "--noise",
            inputs / "noise.nc",
            "--ess",
            100,
            "-v",
            *more,
        ]
        return CliRunner().invoke(commands, [str(word) for word in words])

    @pytest.mark.usefixtures("no_pictures")
    @pytest.mark.parametrize("draws", ["float64", "none"])
    def test_it_is_what_the_functions_give(self, inputs, tmp_path, draws):
        more = ("--sampler", "direct", "--yaw-sd", "records", "--draws", draws, "-o", tmp_path / "out")
        done = self.run(inputs, *more)
        assert done.exit_code == 0, done.output
        assert "uncertainty of the wind's direction: from the beams' means" in done.output
        scan = brs.load_scan("2-beam")
        records = brs.make_records(brs.read(inputs / "day.csv", scan), scan)
        wind = brs.wind.mean_wind(records, scan, turbulence=FLOW)
        found = xr.load_dataset(tmp_path / "out" / "records.nc")
        np.testing.assert_array_equal(found["yaw_sd"], wind["yaw_sd"])
        noise = brs.noise.load(inputs / "noise.nc")
        options = {"noise": noise, "seed": 1, "sampler": "direct", "target_ess": 100, "nuisances": OWN}
        expected = brs.fit(wind, scan, **options).summary()
        table = pd.read_csv(tmp_path / "out" / "summary.csv")
        np.testing.assert_allclose(table["mean"], expected["mean"], rtol=1e-12)
        plain = brs.fit(wind, scan, **{**options, "nuisances": Nuisances()}).summary()
        assert not np.allclose(plain["mean"], expected["mean"], rtol=1e-6)

    @pytest.mark.parametrize(
        ("more", "words"),
        [
            (("--yaw-sd", "beams"), "'beams' must be a number, degrees, or the word records."),
            (("--yaw-sd", 2, "--yaw-sd-missing", 5), "Invalid yaw_sd_missing_deg 5 with yaw_sd_deg 2"),
        ],
    )
    def test_a_value_that_is_not_valid(self, inputs, tmp_path, more, words):
        done = self.run(inputs, *more, "-o", tmp_path / "out")
        assert done.exit_code != 0
        assert words in done.output + str(done.exception)
