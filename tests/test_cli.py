"""The command line: what it writes, its exit codes, and the one line that it says of bad input."""

import json
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scenes import plain_noise

from bayes_rs import STRESSES, WorkerError, cli, load_scan, open_fit
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.priors.ratio import WeakPrior

START = np.datetime64("2020-01-01T12:00", "ns")
STRESS = np.array([1.0, 0.6, 0.4, 0.0, -0.2, 0.0])
FILES = {
    *("run.json", "fit-key.json", "fingerprints.jsonl", "records", "records.nc", "noise.nc", "prior.parquet"),
    *("summary", "posterior", "draws", "predicted", "posterior.nc", "stresses.png", "corner.png"),
    *("summary.csv", "stresses.csv"),
}
KEPT_DRAWS = {"draws", "predicted", "posterior.nc", "corner.png"}
NO_DRAWS = ("--draws", "none")
"""What a test needs that looks at no draws and at no picture of them."""
REPORT = 4
"""Lines of a read report of a file in which nothing is wrong."""
HEADLINE = 3
"""Lines of the headline of a fit."""


def velocities():
    """Radial velocities of two records of six beams at 1 Hz: vr = n·(u + U), u white with the covariance `STRESS`."""
    scan = load_scan("6-beam")
    n_time = 1200
    wind = np.random.default_rng(51).multivariate_normal([10.0, 0.0, 0.0], unpack_stress(STRESS), (n_time, 6))
    return pd.DataFrame(
        {
            "time": np.repeat(START + np.arange(n_time) * np.timedelta64(1, "s"), 6),
            "beam": np.tile(np.arange(6), n_time),
            "radial_velocity": np.einsum("tbi,bi->tb", wind, scan.line_of_sight).ravel(),
        }
    )


def write(table, path):
    table.to_csv(path, index=False, date_format="%Y-%m-%dT%H:%M:%S")
    return path


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    """Folder with good.csv, its noise, and the noise of another scan."""
    folder = tmp_path_factory.mktemp("inputs")
    write(velocities(), folder / "good.csv")
    scan = load_scan("6-beam")
    plain_noise(scan).save(folder / "noise.nc")
    plain_noise(load_scan("6-beam", opening_angle_deg=20.0)).save(folder / "other.nc")
    return folder


@pytest.fixture
def bayes_rs(monkeypatch, capsys):
    """Run a command line in this process; return exit code, stdout and the lines of stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["bayes-rs", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return caught.value.code or 0, out, err.splitlines()

    return run


@pytest.fixture
def fit(bayes_rs, inputs, tmp_path):
    """Fit a file with the usual noise, to tmp_path/out."""

    def run(file, *more, scan="6-beam", noise=inputs / "noise.nc", output=tmp_path / "out"):
        return bayes_rs("fit", file, "--scan", scan, "--noise", noise, "--ess", 200, "-v", "-o", output, *more)

    return run


@pytest.fixture(scope="session")
def finished(inputs, tmp_path_factory):
    """The output folder of a fit of good.csv, and its standard output; by the script itself, in its own process."""
    folder = tmp_path_factory.mktemp("finished") / "out"
    script = Path(sys.executable).parent / "bayes-rs"
    options = ["--scan", "6-beam", "--noise", inputs / "noise.nc", "--ess", "200", "--verbose", "-o", folder]
    done = subprocess.run(  # noqa: S603 - our own script
        [script, "fit", inputs / "good.csv", *options], check=False, capture_output=True, text=True, timeout=120
    )
    return folder, done


def refusal(code, out, err, *parts, report=0):
    """Check that input was refused: exit code 2, one line after the read report, and in it all of `parts`."""
    assert code == 2
    assert out == ""
    assert not any("Traceback" in line for line in err)
    assert len(err) == report + 1
    assert [line.startswith("bayes-rs: ") for line in err] == [False] * report + [True]
    for part in parts:
        assert part in err[-1]


def summary_of(folder):
    return pd.read_csv(folder / "summary.csv", keep_default_na=False, na_values={"mean": [""]})


class TestHelp:
    def test_help_names_all_commands(self, bayes_rs):
        code, out, err = bayes_rs("--help")
        assert (code, err) == (0, [])
        for command in ("demo", "scans", "records", "calibrate", "fit", "corner", "boxes"):
            assert f"\n  {command} " in out

    @pytest.mark.parametrize("command", ["demo", "scans", "records", "calibrate", "fit", "corner", "boxes"])
    def test_each_command_has_its_help(self, bayes_rs, command):
        code, out, _ = bayes_rs(command, "--help")
        assert code == 0
        assert f"bayes-rs {command} [OPTIONS]" in out.splitlines()[0]

    def test_version(self, bayes_rs):
        assert bayes_rs("--version")[:2] == (0, f"bayes-rs, version {version('bayes_rs')}\n")

    def test_unknown_command(self, bayes_rs):
        code, _, err = bayes_rs("guess")
        assert code == 2
        assert "No such command 'guess'." in err[-1]


class TestScans:
    def test_every_scan_is_listed_with_what_it_sees(self, bayes_rs):
        code, out, err = bayes_rs("scans")
        assert (code, err) == (0, [])
        rows = {
            line.split()[0]: line.split(maxsplit=4)[1:]
            for line in out.splitlines()[1:]
            if line and line[0] in "bsz2456p"
        }
        assert rows["50-beam"][:2] == ["50", "5"]
        assert rows["50-beam"][3] == "sees uv, uw, vw; sees uu only together with vv + ww"
        assert rows["6-beam"][1] == "6"
        assert rows["6-beam"][3] == "sees all six stresses"
        assert rows["staring"] == ["1", "1", "1.0", "sees uu; does not see vv, ww, uv, uw, vw"]


class TestRecords:
    def test_records_are_the_moments_of_the_file(self, bayes_rs, inputs, tmp_path):
        file = tmp_path / "new" / "records.nc"
        code, out, err = bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", file)
        assert (code, out) == (0, f"2 records in {file}\n")
        assert "7200 samples, 0 without a velocity" in err
        groups = velocities().groupby([np.repeat([0, 1], 3600), "beam"])["radial_velocity"]
        with xr.open_dataset(file, engine="h5netcdf") as records:
            # rounding: the CSV file holds every digit
            np.testing.assert_allclose(records["variance"], groups.var(ddof=0).unstack(), rtol=1e-12)
            np.testing.assert_allclose(records["mean"], groups.mean().unstack(), rtol=1e-12)
            assert records["wind_speed"].values == pytest.approx(10.0, abs=0.2)

    def test_an_existing_file_is_kept_without_overwrite(self, bayes_rs, inputs, tmp_path):
        file = tmp_path / "records.nc"
        file.write_text("mine")
        arguments = ("records", inputs / "good.csv", "--scan", "6-beam", "-o", file)
        refusal(*bayes_rs(*arguments), str(file), "exists: give another name, or overwrite it")
        assert file.read_text() == "mine"
        assert bayes_rs(*arguments, "--overwrite")[0] == 0
        assert file.stat().st_size > 1000

    def test_a_file_that_cannot_be_written(self, bayes_rs, inputs):
        output = inputs / "good.csv" / "records.nc"
        refusal(
            *bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", output), "Cannot write", str(output)
        )

    def test_columns_and_beams_can_be_mapped(self, bayes_rs, inputs, tmp_path):
        table = velocities().rename(columns={"radial_velocity": "RWS"})
        table["beam"] = "LOS" + table["beam"].astype(str)
        file = write(table, tmp_path / "theirs.csv")
        mapping = [f"--beam-number=LOS{number}={number}" for number in range(6)]
        output = tmp_path / "records.nc"
        code, _, _ = bayes_rs(
            "records", file, "--scan", "6-beam", "--column", "radial_velocity=RWS", *mapping, "-o", output
        )
        assert code == 0
        plain = tmp_path / "plain.nc"
        bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", plain)
        with xr.open_dataset(output, engine="h5netcdf") as theirs, xr.open_dataset(plain, engine="h5netcdf") as ours:
            assert theirs.equals(ours)

    @pytest.mark.parametrize(
        ("option", "message"),
        [
            ("--column=RWS", "--column 'RWS': write it as OURS=THEIRS."),
            ("--beam-number=LOS2", "--beam-number 'LOS2': write it as THEIRS=OURS."),
            ("--beam-number=LOS2=two", "--beam-number 'LOS2=two': 'two' must be a whole number."),
        ],
    )
    def test_a_mapping_that_is_none(self, bayes_rs, inputs, tmp_path, option, message):
        code, out, err = bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", tmp_path / "r.nc", option)
        assert (code, out) == (2, "")
        assert err[-1].endswith(message)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("more", [["--column=RWS"], ["--duration=long"], ["--wrong"]])
    def test_wrong_options_are_told_in_one_line(self, bayes_rs, inputs, tmp_path, more):
        refusal(*bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", tmp_path / "r.nc", *more))


class TestFit:
    def test_the_script_writes_the_folder(self, finished):
        folder, done = finished
        assert done.returncode == 0
        found, *_, last = done.stdout.splitlines()
        assert found.endswith("; 2 of 2 records fitted")
        assert last == f"results in {folder}"
        told = done.stderr.splitlines()  # no warning, no progress bar where there is no terminal
        kinds = (
            "noise was made for L = ",
            "instrument noise from the spectra: 0.9",
            "scatter of the variances",
            "steadiness: ",
            "flag other_length_scale: 2 of 2",
        )
        assert len(told) == REPORT + len(kinds)  # the velocities are white, and the noise is that of eddies
        assert all(line.startswith(kind) for line, kind in zip(told[REPORT:], kinds, strict=True))
        assert {path.name for path in folder.iterdir()} == FILES

    def test_it_says_what_the_scan_sees_what_the_prior_is_and_how_far_the_data_decided(self, finished):
        folder, done = finished
        sight, prior, before, after, medians, plain, learnt, decided, *_ = done.stdout.splitlines()[HEADLINE:]
        assert sight == "scan 6-beam: sees all six stresses"
        assert prior == f"prior {WeakPrior().in_words()}"
        table = summary_of(folder)
        widths = (table["high"] - table["low"]).groupby(table["stress"]).median()[list(STRESSES)]
        for line, wanted in ((before, WeakPrior().interval_widths(0.9)), (after, widths)):
            listed = dict(part.split() for part in line.rsplit(": ", 1)[1].split(", "))
            np.testing.assert_allclose([float(listed[name]) for name in STRESSES], wanted, rtol=0.0051)  # three digits
        for line, column in ((medians, "median"), (plain, "least_squares")):
            listed = dict(part.split() for part in line.rsplit(": ", 1)[1].split(", "))
            mean = table.groupby("stress")[column].mean()[list(STRESSES)]
            for name, number in mean.items():  # of two records mean and median are the same
                assert listed[name] == (f"{number:.3g}" if np.isfinite(number) else "–")
        rows = pd.read_parquet(folder / "posterior")
        assert learnt.endswith(f": {rows['stresses_learnt'].mean():.1f} of 6")
        for line, column in ((decided, "decided"),):
            mean = table.groupby("stress")[column].mean()
            listed = dict(part.split() for part in line.rsplit(": ", 1)[1].split(", "))
            assert list(listed) == list(STRESSES)
            # two decimals are written; of two records mean and median are the same
            np.testing.assert_allclose([float(listed[name]) for name in STRESSES], mean[list(STRESSES)], atol=0.005001)

    def test_pictures_are_pictures(self, finished):
        for name in ("stresses.png", "corner.png"):
            image = matplotlib.image.imread(finished[0] / name)
            assert min(image.shape[:2]) > 1000
            assert len(np.unique(image[::7, ::7].reshape(-1, image.shape[2]), axis=0)) > 20

    def test_run_file_tells_what_was_run(self, finished):
        run = json.loads((finished[0] / "run.json").read_text())
        assert run["settings"]["fit"]["seed"] == 1
        assert run["settings"]["fit"]["target_ess"] == 200
        assert (run["scan"], run["scan_key"]) == ("6-beam", load_scan("6-beam").key)
        assert run["bayes_rs"] == version("bayes_rs")
        assert run["packages"]["emcee"] == version("emcee")
        assert (run["n_record"], run["n_fitted"]) == (2, 2)
        assert {name for name, count in run["flags"].items() if count} == {"other_length_scale"}
        assert run["source_files"] == ["good.csv"]
        assert run["noise"]["method"] == "given"
        assert set(run["seconds"]) == {"fitting"}

    def test_the_folder_gives_the_result_back(self, finished):
        result = open_fit(finished[0])
        assert result["posterior/stress"].sizes["record"] == 2
        table = summary_of(finished[0])
        assert table["time"].unique().tolist() == ["2020-01-01T12:00:00", "2020-01-01T12:10:00"]
        means = result["posterior/stress"].mean(("chain", "draw")).values.ravel()
        np.testing.assert_allclose(table["mean"], means, rtol=1e-12)  # every digit is written

    def test_the_posterior_knows_the_stress_that_the_file_was_made_with(self, finished):
        rows = summary_of(finished[0]).set_index(["stress", "record"])
        # uu from six beams with 24 % noise each, correlated: four standard deviations of 0.24 hold it
        assert rows.loc["uu"]["mean"].to_numpy() == pytest.approx(STRESS[0], abs=4.0 * 0.24)
        assert (rows.loc["uu"]["low"].astype(float) > 0.0).all()

    @pytest.mark.usefixtures("no_pictures")
    def test_the_same_seed_and_the_records_in_between_give_the_same_numbers(
        self, fit, bayes_rs, finished, inputs, tmp_path
    ):
        """Through this process instead of the script's, and from records.nc instead of the CSV file."""
        records = tmp_path / "records.nc"
        assert bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", records)[0] == 0
        assert fit(records)[0] == 0
        expected = (finished[0] / "summary.csv").read_text()
        assert (tmp_path / "out" / "summary.csv").read_text() == expected
        assert open_fit(tmp_path / "out")["posterior"].identical(open_fit(finished[0])["posterior"])
        more = ("--seed", 2, "--derived", "tke", "--prior", "flat", "--prob", 0.5, *NO_DRAWS)
        assert fit(records, "--overwrite", *more)[0] == 0
        other = summary_of(tmp_path / "out")
        assert set(other["prob"]) == {0.5}
        assert "tke" in set(other["stress"])
        assert json.loads((tmp_path / "out" / "run.json").read_text())["prior_name"] == "flat"

    def test_records_of_another_scan_are_refused(self, fit, finished):
        records = finished[0] / "records.nc"
        refusal(
            *fit(records, scan="50-beam"), str(records), "made with another scan, '6-beam', than '50-beam' (beams 6, "
        )

    def test_failures_are_listed_and_the_exit_code_tells(self, fit, tmp_path):
        """Record 0 is all NaN, record 1 good, record 2 has 80 samples of the 480 that are needed."""
        table = velocities()
        table.loc[:3599, "radial_velocity"] = np.nan
        short = table[-480:].assign(time=lambda rows: rows["time"] + np.timedelta64(600, "s"))
        code, out, err = fit(write(pd.concat([table, short]), tmp_path / "bad.csv"))
        assert code == 1
        assert out.splitlines()[0].endswith("; 1 of 3 records fitted")
        assert err[-2:] == [
            "record 0 (2020-01-01T12:00): no_usable_beam",
            "record 2 (2020-01-01T12:20): no_usable_beam",
        ]
        assert any("flag too_few_samples (fewer than 480)" in line for line in err)
        table = summary_of(tmp_path / "out")
        missing = table["mean"].isna().groupby(table["record"]).all()
        assert missing.tolist() == [True, False, True]
        assert len(table) == 18
        assert {path.name for path in (tmp_path / "out").iterdir()} == FILES

    def test_nothing_that_can_be_fitted_is_an_outcome_too(self, fit, tmp_path):
        table = velocities().assign(radial_velocity=np.nan)
        code, out, err = fit(write(table, tmp_path / "nan.csv"))
        assert code == 1
        assert out.splitlines()[0].endswith(" 0 of 2 records fitted")
        assert [line for line in err if line.startswith("record ")] == err[-2:]
        assert {path.name for path in (tmp_path / "out").iterdir()} == FILES - {"corner.png"}

    @pytest.mark.usefixtures("no_pictures")
    @pytest.mark.parametrize(("value", "word"), [(np.nan, "all_missing"), (-9.0, "constant")])
    def test_a_beam_that_says_nothing_is_left_out(self, fit, tmp_path, value, word):
        table = velocities()
        table.loc[table["beam"] == 4, "radial_velocity"] = value
        code, out, err = fit(write(table, tmp_path / "one.csv"), *NO_DRAWS)
        assert code == 0
        assert out.splitlines()[0].endswith("; 2 of 2 records fitted")
        assert any(f"flag {word}: 2 of 12 beams of records" in line for line in err)
        words = {tuple(flag.split(";")) for flag in summary_of(tmp_path / "out")["flag"]}
        assert {first for first, *_ in words} == {"beam_left_out"}
        assert {more for _, *rest in words for more in rest} <= {"other_length_scale"}  # white, as all of these are
        used = open_fit(tmp_path / "out")["observed_data/used"].values
        assert used.tolist() == [[1, 1, 1, 1, 0, 1]] * 2


class TestLongFit:
    """Fits of any number of records: with fewer draws, several workers, and interrupted ones."""

    @pytest.fixture
    def long_fit(self, fit, inputs):
        def run(*more, **options):
            return fit(inputs / "good.csv", "--sampler", "auto", *more, **options)

        return run

    def test_neither_workers_nor_the_draws_that_are_kept_change_a_number(self, long_fit, tmp_path):
        code, out, err = long_fit("--draws", "none", "--workers", 2)
        assert code == 0, err
        folder = tmp_path / "out"
        assert {file.name for file in folder.iterdir()} == FILES - KEPT_DRAWS
        assert out.splitlines()[-1] == f"results in {folder}"
        assert any(line.startswith("decided by the data") for line in out.splitlines())
        code, kept, _ = long_fit(output=tmp_path / "kept")
        assert code == 0
        assert (folder / "summary.csv").read_bytes() == (tmp_path / "kept" / "summary.csv").read_bytes()
        assert kept.splitlines()[:-1] == out.splitlines()[:-1]
        for run in (folder, tmp_path / "kept"):
            assert json.loads((run / "run.json").read_text())["words"] == out.splitlines()[HEADLINE:-1]
        records = xr.load_dataset(tmp_path / "kept" / "records.nc")
        xr.testing.assert_identical(xr.load_dataset(folder / "records.nc"), records)

    @pytest.mark.usefixtures("no_pictures")
    def test_records_of_several_files_are_one_campaign(self, fit, bayes_rs, inputs, tmp_path):
        whole = tmp_path / "whole.nc"
        assert bayes_rs("records", inputs / "good.csv", "--scan", "6-beam", "-o", whole)[0] == 0
        for record, name in enumerate(("one", "two")):
            some = xr.load_dataset(whole).isel(record=[record]).drop_encoding()  # each has its own unit of time
            some.to_netcdf(tmp_path / f"{name}.nc", engine="h5netcdf")
        files = [tmp_path / "one.nc", tmp_path / "two.nc"]
        assert fit(files[0], files[1], "--draws", "none")[0] == 0
        assert fit(whole, "--draws", "none", output=tmp_path / "whole")[0] == 0
        assert len(pd.read_csv(tmp_path / "out" / "summary.csv")) == 12
        assert (tmp_path / "out" / "summary.csv").read_bytes() == (tmp_path / "whole" / "summary.csv").read_bytes()
        refusal(*fit(files[0], files[0], output=tmp_path / "twice"), "1 records start at the same time as another")
        some = xr.load_dataset(files[1])
        for name, other, part in (
            ("beams", some.isel(beam=slice(0, 5)), "have beams [0, 1, 2, 3, 4] and those in"),
            ("duration", some.assign_attrs(duration=300.0), "have duration 300.0 and those in"),
        ):
            other.to_netcdf(tmp_path / f"{name}.nc", engine="h5netcdf")
            refusal(*fit(files[0], tmp_path / f"{name}.nc", output=tmp_path / "mixed"), part, "fit them separately")

    @pytest.mark.usefixtures("no_pictures")
    def test_run_file_tells_what_was_run(self, long_fit, tmp_path):
        assert long_fit("--yaw-sd", 2, "--inflation", 1.3, "--draws", "none")[0] == 0
        run = json.loads((tmp_path / "out" / "run.json").read_text())
        assert run["nuisances"] == "yaw ± 2°, noise inflated by 1.3 (one standard deviation)"
        assert run["settings"]["fit"]["sampler"] == "auto"
        assert set(run["packages"]) == {"emcee", "numpy", "scipy", "xarray", "pandas"}

    def test_without_draws_there_is_no_corner_plot(self, long_fit, bayes_rs, tmp_path):
        assert long_fit("--draws", "none")[0] == 0
        refusal(*bayes_rs("corner", tmp_path / "out"), "draws")

    @pytest.mark.usefixtures("no_pictures")
    def test_a_run_is_resumed_and_another_is_refused(self, long_fit, tmp_path):
        assert long_fit("--draws", "none")[0] == 0
        numbers = (tmp_path / "out" / "summary.csv").read_bytes()
        shutil.rmtree(tmp_path / "out" / "posterior")
        (tmp_path / "out" / "summary.csv").unlink()
        refusal(*long_fit("--draws", "none"), "exists: give another name, or overwrite it")
        code, _, err = long_fit("--draws", "none", "--resume")
        assert code == 0
        assert not any("records were finished by an earlier run" in line for line in err)
        assert "1 of 1 files were read by an earlier run" in err
        assert (tmp_path / "out" / "summary.csv").read_bytes() == numbers
        assert "2 of 2 records were finished by an earlier run" in long_fit("--draws", "none", "--resume")[2]
        refusal(
            *long_fit("--draws", "none", "--resume", "--seed", 7),
            "is of a run that differs in seed, so it cannot be resumed: give the same, another name, or overwrite",
        )

    def test_an_error_says_what_is_kept(self, long_fit, monkeypatch):
        def full(*_args, **_options):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("bayes_rs.fits.fit_writing.write_table", full)
        code, out, err = long_fit("--draws", "none")
        assert (code, out) == (2, "")
        assert err[-2] == "bayes-rs: No space left on device: see to it where the output goes, and run it again."
        assert "0 of 2 records are finished and kept in" in err[-1]
        assert "with resume goes on from there" in err[-1]

    def test_an_interrupt_says_what_is_kept(self, long_fit, monkeypatch):
        def interrupt(*_args, **_options):
            raise KeyboardInterrupt

        monkeypatch.setattr("bayes_rs.fits.fit_writing.write_table", interrupt)
        code, _, err = long_fit("--draws", "none")
        assert code == 130
        assert err[-2] == "bayes-rs: interrupted."
        assert "with resume goes on from there" in err[-1]

    def test_workers_that_die_are_told_in_one_line(self, long_fit, monkeypatch):
        def give_up(*_args, **_options):
            raise WorkerError("The worker processes died 4 times in a row.")

        monkeypatch.setattr("bayes_rs.fits.workers.run_serial", give_up)
        code, _, err = long_fit("--draws", "none")
        assert code == 2
        assert err[-2] == "bayes-rs: The worker processes died 4 times in a row."

    def test_many_records_keep_no_draws(self, long_fit, monkeypatch, tmp_path):
        monkeypatch.setattr("bayes_rs.fits.fit_options.MOST_KEPT", 1)
        monkeypatch.setattr("bayes_rs.fits.fit_writing.MOST_CSV", 1)
        assert long_fit()[0] == 0
        assert {file.name for file in (tmp_path / "out").iterdir()} == FILES - KEPT_DRAWS - {"summary.csv"}

    def test_failures_are_listed_up_to_a_number(self, fit, monkeypatch, tmp_path):
        monkeypatch.setattr("bayes_rs.fits.words._LISTED", 1)
        table = velocities()
        table["radial_velocity"] = np.nan
        code, out, err = fit(write(table, tmp_path / "none.csv"), "--draws", "none")
        assert code == 1
        assert out.splitlines()[0].endswith(" 0 of 2 records fitted")
        assert err[-2] == "record 0 (2020-01-01T12:00): no_usable_beam"
        assert err[-1] == "and 1 more records: see the column flag of the summary"

    @pytest.mark.usefixtures("no_pictures")
    def test_an_uncertain_length_scale_gets_noise_that_spans_it(self, bayes_rs, monkeypatch, tmp_path):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path / "cache"))
        table = velocities()
        common = ["--scan", "2-beam", "--ess", 100, "--sampler", "direct", "--length-scale-sd", 0.1, "-v"]
        common += NO_DRAWS
        file = write(table[table["beam"] < 2], tmp_path / "two.csv")
        code, _, err = bayes_rs("fit", file, *common, "-o", tmp_path / "out")
        assert code == 0, err
        assert any(", L " in line and line.startswith("noise: calculated") for line in err)
        run = json.loads((tmp_path / "out" / "run.json").read_text())
        assert run["nuisances"] == "length scale within a factor 1.1 (one standard deviation)"

    @pytest.mark.parametrize(
        ("more", "parts"),
        [
            (
                ("--sampler", "nuts"),
                ("Invalid value for '--sampler': 'nuts' is not one of 'emcee',",),
            ),
            (("--yaw-sd", -1), ("Invalid yaw_sd_deg -1",)),
            (("--inflation-dof", 1), ("Invalid inflation_dof 1",)),
            (("--instrument-noise", 0, "--instrument-noise-sd", 0.5), ("Invalid instrument_noise 0",)),
            (
                ("--length-scale", 50),
                ("Invalid length_scale 50 m with length_scale_log_sd records",),
            ),
        ],
    )
    def test_a_value_that_is_not_valid(self, fit, inputs, more, parts):
        refusal(*fit(inputs / "good.csv", *more), *parts)

    def test_noise_of_one_length_scale_for_several(self, fit, inputs):
        code, out, err = fit(inputs / "good.csv", "--length-scale-sd", 0.2)
        assert (code, out) == (2, "")
        assert err[-2].startswith("bayes-rs: The noise knows one length scale only")
        assert "the same call with resume goes on from there" in err[-1]

    def test_a_number_of_workers_is_refused_before_anything_is_read(self, fit, inputs):
        refusal(*fit(inputs / "good.csv", "--draws", "none", "--workers", 0), "Invalid workers 0")

    def test_help_has_the_options(self, bayes_rs):
        _, out, _ = bayes_rs("fit", "--help")
        for option in ("--sampler", "--workers", "--draws", "--resume", "--yaw-sd", "--inflation-dof"):
            assert f"  {option} " in out


class TestCorner:
    @pytest.fixture
    def folder(self, finished, tmp_path):
        shutil.copytree(finished[0], tmp_path / "out")
        return tmp_path / "out"

    def test_a_record_by_its_start(self, bayes_rs, folder):
        code, out, err = bayes_rs("corner", folder, "--record", "2020-01-01T12:10")
        assert (code, err) == (0, [])
        picture = folder / "corner-2020-01-01T1210.png"
        assert out == f"{picture}\n"
        assert picture.stat().st_size > 20_000

    def test_a_picture_is_kept_without_overwrite(self, bayes_rs, folder, tmp_path):
        picture = tmp_path / "mine.pdf"
        picture.write_text("mine")
        refusal(*bayes_rs("corner", folder, "-o", picture), str(picture), "exists: give another name, or overwrite it")
        assert picture.read_text() == "mine"
        assert bayes_rs("corner", folder, "-o", picture, "--overwrite")[0] == 0
        assert picture.read_bytes().startswith(b"%PDF")

    def test_a_record_that_is_not_there(self, bayes_rs, finished):
        refusal(*bayes_rs("corner", finished[0], "--record", "7"), "No record 7: there are 2, numbered from 0.")
        refusal(*bayes_rs("corner", finished[0], "--record", "noon"), "Invalid record 'noon'", "2020-09-04T12:00")

    def test_a_folder_without_a_result(self, bayes_rs, tmp_path):
        refusal(*bayes_rs("corner", tmp_path), f"No results in {str(tmp_path)!r}: it has no fingerprints.jsonl")

    def test_a_result_that_is_damaged(self, bayes_rs, folder):
        file = next((folder / "draws").rglob("*.parquet"))
        file.write_bytes(file.read_bytes()[:2000])
        refusal(*bayes_rs("corner", folder, "--overwrite"), file.name, str(folder))


def renamed(table):
    return table.rename(columns={"radial_velocity": "rws"})


def with_text(table):
    table = table.astype({"radial_velocity": object})
    table.loc[7, "radial_velocity"] = "calm"
    return table


def with_beam_nine(table):
    table.loc[7, "beam"] = 9
    return table


def backwards(table):
    table.loc[600, "time"] = table.loc[0, "time"]
    return table


class TestBadFiles:
    """What, the value, the rule, where: each refused before anything is written."""

    @pytest.mark.parametrize(
        ("spoil", "parts"),
        [
            (
                renamed,
                ["no column 'radial_velocity'", "its columns are 'time', 'beam', 'rws'", "say what the file calls"],
            ),
            (
                with_text,
                ["Invalid radial_velocity 'calm'", "line 9 of file", "it must be a number", "correct the entry"],
            ),
            (with_beam_nine, ["Unknown beam '9'", "line 9 of file", "beams of scan '6-beam', 0, 1, 2, 3, 4, 5"]),
            (backwards, ["Time goes backwards in line 602", "2020-01-01T12:00:00Z comes after 2020-01-01T12:01:39Z"]),
        ],
    )
    def test_a_file_that_cannot_be_used(self, fit, tmp_path, spoil, parts):
        file = write(spoil(velocities()), tmp_path / "bad.csv")
        refusal(*fit(file), str(file), *parts)
        assert list(tmp_path.iterdir()) == [file]

    def test_a_missing_file(self, fit, tmp_path):
        refusal(*fit(tmp_path / "gone.csv"), f"File {str(tmp_path / 'gone.csv')!r} does not exist: check its path.")

    def test_time_going_backwards_can_be_sorted(self, bayes_rs, tmp_path):
        file = write(backwards(velocities()).iloc[1:], tmp_path / "bad.csv")
        options = ("--out-of-order", "sort", "-o", tmp_path / "r.nc")
        code, _, err = bayes_rs("records", file, "--scan", "6-beam", *options)
        assert code == 0
        assert "1 samples out of order, sorted" in err[0]

    @pytest.mark.parametrize(
        ("spoil", "option"),
        [(renamed, "--column"), (with_beam_nine, "--beam-number"), (backwards, "--out-of-order sort")],
    )
    def test_the_advice_names_the_option_of_the_command_line(self, fit, tmp_path, spoil, option):
        refusal(*fit(write(spoil(velocities()), tmp_path / "bad.csv")), option)


class TestBadScans:
    TOML = """
    title = "mine"
    source = "mine"
    [beams]
    pattern = "list"
    focus_distance = [{distance}]
    [[beams.beam]]
    id = 0
    vector = {vector}
    [timing]
    scan_duration = 1.0
    {more}
    """

    @pytest.mark.parametrize(
        ("changes", "parts"),
        [
            ({"vector": "[0.0, 0.0, 0.0]"}, ["vector = [0.0, 0.0, 0.0]", "the vector of a beam must not be zero"]),
            ({"distance": "-98.0"}, ["beams.focus_distance.0 = -98.0", "should be greater than 0"]),
            ({"more": "speed = 3"}, ["timing.speed = 3", "unknown key; remove it or correct its spelling"]),
            ({"more": "speed ="}, ["is not valid TOML"]),
        ],
        ids=["zero vector", "negative distance", "unknown key", "not TOML"],
    )
    def test_a_scan_file_that_is_not_valid(self, fit, inputs, tmp_path, changes, parts):
        file = tmp_path / "scan.toml"
        file.write_text(self.TOML.format(**{"distance": "98.0", "vector": "[-1.0, 0.0, 0.0]", "more": "", **changes}))
        refusal(*fit(inputs / "good.csv", scan=file), str(file), *parts)
        assert list(tmp_path.iterdir()) == [file]

    def test_the_same_file_without_the_fault_is_taken(self, tmp_path):
        file = tmp_path / "scan.toml"
        file.write_text(self.TOML.format(distance="98.0", vector="[-1.0, 0.0, 0.0]", more=""))
        assert load_scan(file).n_beam == 1

    def test_an_unknown_scan(self, fit, inputs):
        refusal(*fit(inputs / "good.csv", scan="7-beam"), "No preset '7-beam' in models/scans", "50-beam", ".toml file")


class TestBadNoise:
    def test_noise_of_another_scan(self, fit, inputs, tmp_path):
        parts = ["was not made for scan '6-beam'", "the direction of beam 0 is", "Run calibrate for this scan"]
        refusal(*fit(inputs / "good.csv", noise=inputs / "other.nc"), *parts)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
    def test_a_file_that_was_cut_off(self, fit, inputs, tmp_path, keep):
        content = (inputs / "noise.nc").read_bytes()
        file = tmp_path / "cut.nc"
        file.write_bytes(content[: int(keep * len(content))])
        refusal(*fit(inputs / "good.csv", noise=file), str(file), "damaged")
        assert list(tmp_path.iterdir()) == [file]

    @pytest.mark.parametrize("name", ["covariance", "gain"])
    def test_a_file_that_lacks_a_variable(self, fit, inputs, tmp_path, name):
        file = tmp_path / "part.nc"
        with xr.open_dataset(inputs / "noise.nc", engine="h5netcdf") as dataset:
            dataset.drop_vars(name).to_netcdf(file, engine="h5netcdf")
        refusal(*fit(inputs / "good.csv", noise=file), str(file), "is damaged", name)

    @pytest.mark.parametrize("name", ["duration", "length_scale", "format_version"])
    def test_a_file_with_text_for_a_number(self, fit, inputs, tmp_path, name):
        file = tmp_path / "text.nc"
        with xr.open_dataset(inputs / "noise.nc", engine="h5netcdf") as dataset:
            dataset.assign_attrs({name: "long"}).to_netcdf(file, engine="h5netcdf")
        word = "format version long" if name == "format_version" else "damaged"
        refusal(*fit(inputs / "good.csv", noise=file), str(file), word, "calibrate again")

    def test_a_missing_file(self, fit, inputs, tmp_path):
        refusal(*fit(inputs / "good.csv", noise=tmp_path / "gone.nc"), "No noise file", "gone.nc")


class TestBadOutput:
    def test_an_existing_folder(self, fit, inputs, finished):
        before = (finished[0] / "run.json").read_text()
        parts = [f"Output folder {str(finished[0])!r} exists", "give another name, or overwrite it"]
        refusal(*fit(inputs / "good.csv", output=finished[0]), *parts)  # before anything is read
        assert (finished[0] / "run.json").read_text() == before

    def test_overwrite_of_a_folder_that_is_not_ours(self, fit, inputs, tmp_path):
        folder = tmp_path / "thesis"
        folder.mkdir()
        (folder / "chapter.tex").write_text("years of work")
        answer = fit(inputs / "good.csv", "--overwrite", output=folder)
        refusal(*answer, str(folder), "was not made by bayes-rs (it has no fingerprints.jsonl)", "remove it yourself")
        assert (folder / "chapter.tex").read_text() == "years of work"

    def test_a_place_that_cannot_be_written(self, fit, inputs, tmp_path):
        file = tmp_path / "file"
        file.write_text("text")
        answer = fit(inputs / "good.csv", output=file / "out")
        refusal(*answer, "Cannot write the output folder", str(file / "out"), "can be written")

    def test_the_demo_does_not_replace_a_folder_either(self, bayes_rs, tmp_path):
        refusal(*bayes_rs("demo", "-o", tmp_path), f"Output folder {str(tmp_path)!r} exists")


class TestBadOptions:
    @pytest.mark.parametrize(
        ("option", "parts"),
        [
            (["--prior", "vague"], ["Unknown prior 'vague': it must be one of weak, "]),
            (
                ["--target", "mean"],
                ["Invalid value for '--target': 'mean' is not one of 'record',"],
            ),
            (["--ess", "0"], ["Invalid target_ess 0: it must be a whole number of at least 1."]),
            (["--seed", "-1"], ["Invalid seed -1"]),
            (["--instrument-noise", "-0.1"], ["Invalid instrument_noise -0.1 m² s⁻²"]),
        ],
    )
    def test_a_value_that_is_not_valid(self, fit, inputs, tmp_path, option, parts):
        refusal(*fit(inputs / "good.csv", *option), *parts)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("option", "part"),
        [
            (["--duration", "0"], "Invalid duration 0.0 s"),
            (["--duration", "7"], "Invalid duration 7.0 s: it must divide a day"),
            (["--min-availability", "1.5"], "Invalid min_availability 1.5: it must be from 0 to 1."),
            (["--format", "excel"], "Invalid value for '--format': 'excel' is not one of 'auto', 'halo',"),
        ],
    )
    def test_reading_and_record_options(self, fit, inputs, option, part):
        refusal(*fit(inputs / "good.csv", *option), part)

    def test_a_rule_for_what_the_files_do_not_have(self, fit, inputs):
        code, out, err = fit(inputs / "good.csv", "--cnr-range", -20, 0)
        assert (code, out) == (2, "")
        assert "the series has no cnr" in err[0]

    @pytest.mark.parametrize("option", [["--prob", "2"], ["--derived", "mood"]])
    def test_options_of_the_summary_are_checked_before_the_sampling(self, fit, inputs, tmp_path, option):
        refusal(*fit(inputs / "good.csv", *option), option[1])
        assert list(tmp_path.iterdir()) == []

    def test_calibrate_refuses_an_existing_file_before_it_computes(self, bayes_rs, inputs, monkeypatch):
        def computed(*_args, **_options):
            pytest.fail("computed before the output file was checked")

        monkeypatch.setattr("bayes_rs.noise.calibrating.calibrate", computed)
        answer = bayes_rs("calibrate", "staring", "--wind-speed", 10, "-o", inputs / "noise.nc")
        refusal(*answer, "noise.nc", "exists", "--overwrite")


class TestPlan:
    def test_it_prints_what_is_computed_and_what_is_skipped(self, bayes_rs):
        code, out, err = bayes_rs("plan", "50-beam", "--wind-speed", 8)
        assert code == 0
        assert err == []
        assert "50-beam (50 beams), 600 s at 8 m/s" in out
        assert "50 variances a record are reduced to 5 numbers" in out

    def test_bad_input_is_one_line(self, bayes_rs):
        refusal(*bayes_rs("plan", "7-beam"), "No preset '7-beam'")
        refusal(*bayes_rs("plan", "6-beam", "--wind-speed", -1), "Invalid wind_speed -1.0 m/s")
