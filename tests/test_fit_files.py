"""Files to a folder of results: the same numbers whatever the chunks, interruptions and bad files."""

import gzip
import json
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import distributed
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from folder_scene import (
    DURATION,
    FITTING,
    N_RECORD,
    RECORDING,
    SCAN,
    make_series,
    run,
    write_file,
    write_files,
    write_noise,
)

from bayes_rs import InputError, MissingExtraError, fit, make_records, open_fit, read
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.file_options import FileOptions
from bayes_rs.fits import from_files, plan
from bayes_rs.fits.settings import Settings
from bayes_rs.fits.tables import part_names
from bayes_rs.fits.workers import connect
from bayes_rs.output import output_folder, write_run
from bayes_rs.records import record_store
from bayes_rs.result_folder import open_result_folder

pytestmark = pytest.mark.slow
TESTS = Path(__file__).parent
N_FILE = 5


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(plan, "PART_RECORDS", 128)


@pytest.fixture
def saved_after_every_file(monkeypatch):
    """Keep what was read after every file, which takes as long as all the rest."""
    monkeypatch.setattr(record_store, "SAVE_SECONDS", 0.0)


@pytest.fixture(scope="module")
def series():
    return make_series()


@pytest.fixture(scope="module")
def files(series, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files") / "year"
    write_files(folder, series, N_FILE)
    return folder


@pytest.fixture(scope="module")
def noise(tmp_path_factory):
    file = tmp_path_factory.mktemp("noise") / "noise.nc"
    write_noise(file)
    return file


@pytest.fixture(scope="module")
def whole(files, noise, tmp_path_factory):
    """The folder of an uninterrupted run."""
    output = tmp_path_factory.mktemp("whole") / "out"
    run(files, output, noise)
    return output


def same(one, other):
    """Check that two runs have the same tables and records, bit by bit."""
    pd.testing.assert_frame_equal(open_fit(one).summary(), open_fit(other).summary(), check_exact=True)
    for name in ("summary", "posterior"):
        for file in part_names(open_result_folder(one), name):
            assert (one / file).read_bytes() == (other / file).read_bytes()
    xr.testing.assert_identical(*(xr.load_dataset(of / "records.nc", engine="h5netcdf") for of in (one, other)))


def read_in_chunks(monkeypatch, n_row):
    """Let `fit_files` read so many rows of a file at a time."""
    monkeypatch.setattr(from_files, "store_records", partial(record_store.store_records, chunk_rows=n_row))


def runs_that_stop(files, noise, *stops):
    """Run for each (output, number of the write, signal) after the other; return the exit codes and stderr."""
    words = [":".join(map(str, stop)) for stop in stops]
    command = [sys.executable, TESTS / "folder_scene.py", files, noise, *words]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)  # noqa: S603 - our own
    codes = [int(code) for code in done.stdout.split()]
    assert len(codes) == len(stops), done.stderr
    return codes, done.stderr


class TestNumbers:
    def test_they_are_those_of_the_whole_series(self, files, noise, whole):
        series = read(sorted(files.iterdir()), SCAN)
        records = make_records(series, SCAN, **RECORDING)
        found = xr.load_dataset(whole / "records.nc", engine="h5netcdf")
        for name in records.data_vars:
            np.testing.assert_array_equal(found[name], records[name])
        assert found.sizes["record"] == N_RECORD
        for name in ("records_report", "read_report"):
            assert json.loads(found.attrs[name]) == json.loads(records.attrs[name]), name
        in_memory = fit(records, SCAN, noise=noise, **FITTING)
        pd.testing.assert_frame_equal(in_memory.summary(), open_fit(whole).summary(), check_exact=True)

    @pytest.mark.parametrize(("chunk_rows", "workers"), [(37, 1), (500, 2)])
    def test_they_do_not_depend_on_chunks_and_workers(
        self, files, noise, whole, tmp_path, monkeypatch, chunk_rows, workers
    ):
        read_in_chunks(monkeypatch, chunk_rows)
        run(files, tmp_path / "out", noise, workers=workers)
        same(tmp_path / "out", whole)

    def test_files_that_overlap_are_read_side_by_side(self, series, noise, whole, tmp_path, monkeypatch):
        read_in_chunks(monkeypatch, 100)
        for beam in (0, 1):
            write_files(tmp_path / f"beam-{beam}", series.isel(sample=series["beam"].values == beam), 2)
        found = run([tmp_path / "beam-0", tmp_path / "beam-1"], tmp_path / "out", noise)
        assert found.run["bad_files"] == {}
        pd.testing.assert_frame_equal(open_fit(tmp_path / "out").summary(), open_fit(whole).summary(), check_exact=True)

    def test_what_was_read_is_counted(self, series, whole):
        run = json.loads((whole / "run.json").read_text())
        assert run["n_file"] == N_FILE
        assert run["read_counts"]["samples"] == series.sizes["sample"]
        assert (run["bad_files"], run["finished"]) == ({}, True)
        assert set(run["seconds"]) == {"fitting"}


@pytest.mark.usefixtures("saved_after_every_file")
class TestInterruptions:
    # writes: run.json twice, then for each of 5 files a part and the state, or the state only, then the fit's
    @pytest.mark.parametrize("numbers", [(8, 15), pytest.param((3, 4, 5, 13), marks=pytest.mark.long)])
    def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_bits(self, files, noise, whole, tmp_path, numbers):
        outputs = [tmp_path / str(number) for number in numbers]
        stops = [(*one, "SIGKILL") for one in zip(outputs, numbers, strict=True)]
        codes, errors = runs_that_stop(files, noise, *stops)
        assert codes == [-signal.SIGKILL] * len(numbers), errors
        for output in outputs:
            run(files, output, noise, resume=True)
            same(output, whole)
            assert not list(output.glob("**/.[0-9p]*"))

    def test_one_that_is_killed_and_interrupted_again_and_again(self, files, noise, whole, tmp_path):
        stops = ((3, "SIGKILL"), (4, "SIGINT"), (5, "SIGKILL"), (7, "SIGINT"))
        codes, errors = runs_that_stop(files, noise, *((tmp_path / "out", *stop) for stop in stops))
        assert 0 not in codes
        assert errors.count("KeyboardInterrupt") >= 2
        assert errors.count("with resume goes on from") == 2
        run(files, tmp_path / "out", noise, resume=True)
        same(tmp_path / "out", whole)

    def test_files_that_were_read_are_not_read_again(self, files, noise, tmp_path, monkeypatch):
        read = []
        stream = record_store.stream_files

        def failing(paths, *arguments, **options):
            if options["chunk_rows"] != record_store._PEEK:
                read.extend(paths)
                if len(read) == 4:
                    raise KeyboardInterrupt
            return stream(paths, *arguments, **options)

        monkeypatch.setattr(record_store, "stream_files", failing)
        with pytest.raises(KeyboardInterrupt) as caught:
            run(files, tmp_path / "out", noise)
        assert "goes on from there" in caught.value.__notes__[0]
        words = []
        run(files, tmp_path / "out", noise, resume=True, say=words.append)
        assert words[0] == "3 of 5 files were read by an earlier run"
        assert sorted(read) == sorted([*files.iterdir(), read[3]])

    def test_a_part_that_cannot_be_read_means_to_begin_anew(self, files, noise, whole, tmp_path):
        run(files, tmp_path / "out", noise)
        (tmp_path / "out" / "records" / "part-000001.nc").write_bytes(b"")
        words = []
        run(files, tmp_path / "out", noise, resume=True, say=words.append)
        assert not any("files were read by an earlier run" in line for line in words)
        same(tmp_path / "out", whole)

    def test_other_options_are_refused(self, files, noise, whole):
        for other, what in (
            ({"seed": 4}, "seed"),
            ({"prob": 0.5}, "prob"),
            ({"duration": 30.0}, "record options"),
            ({"frozen_run": 7}, "quality rules"),
            ({"positive": "towards"}, "reading options"),
            ({"target": "ensemble", "prior": "flat", "seed": 5}, "seed, prior and target"),
        ):
            with pytest.raises(InputError, match=f"is of a run that differs in {what}, so it cannot be resumed"):
                run(files, whole, noise, resume=True, **other)

    def test_a_file_that_is_not_there_leaves_no_folder_and_replaces_none(self, files, noise, tmp_path):
        for name, words in (("no.csv", "does not exist: check its path"), ("no*.csv", "matches no file")):
            with pytest.raises(InputError, match=words):
                run(files / name, tmp_path / "out", noise)
        assert not (tmp_path / "out").exists()
        with output_folder(tmp_path / "out") as folder:
            write_run(folder, {"n": "old"})
        with pytest.raises(InputError, match="does not exist"):
            run(files / "no.csv", tmp_path / "out", noise, overwrite=True)
        assert "old" in (tmp_path / "out" / "run.json").read_text()
        assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []

    def test_bad_options_are_refused_before_a_folder_is_made(self, files, noise, tmp_path):
        for other in ({"draws": "all"}, {"prior": "strong"}, {"workers": 0}, {"target": "truth"}):
            with pytest.raises(InputError):
                run(files, tmp_path / "out", noise, **other)
        assert not (tmp_path / "out").exists()

    def test_a_turbulence_that_is_none_is_said_before_files_are_read(self, files, tmp_path):
        (tmp_path / "air.toml").write_text(
            'title = "t"\nsource = "s"\ndissipation = 0.05\nlength_scale = 60.0\ngamma = 100.0\n'
        )
        for name, words in (("calm", "No preset 'calm'"), (str(tmp_path / "air.toml"), "Invalid gamma 100.* to 15;")):
            given = {"files": [str(files)], "scan": "6-beam", "turbulence": name, "output": str(tmp_path / "out")}
            with pytest.raises(InputError, match=words):
                from_files.fit_files(Settings().changed(**given))
        assert not (tmp_path / "out").exists()


class TestFilesThatChange:
    @pytest.fixture
    def copied(self, files, tmp_path):
        folder = tmp_path / "year"
        folder.mkdir()
        for file in files.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        return folder

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda file: file.write_bytes(file.read_bytes() + b"\n"), r"its size was \d+ and is \d+ bytes"),
            (lambda file: file.write_bytes(file.read_bytes().replace(b"9", b"8", 1)), "its first bytes differ"),
            (lambda file: file.touch(), "its time of change differs"),
        ],
    )
    def test_a_changed_file_is_noticed(self, copied, noise, tmp_path, change, words):
        run(copied, tmp_path / "out", noise)
        change(copied / "7-day.csv")
        with pytest.raises(InputError, match=rf"7-day.csv' was changed since .*\({words}\): restore it, or overwrite"):
            run(copied, tmp_path / "out", noise, resume=True)
        run(copied, tmp_path / "out", noise, overwrite=True)

    def test_a_file_that_is_gone_is_noticed(self, copied, noise, tmp_path):
        run(copied, tmp_path / "out", noise)
        (copied / "7-day.csv").unlink()
        with pytest.raises(InputError, match=r"7-day.csv' was read by the run .* not among the files now: give the sa"):
            run(copied, tmp_path / "out", noise, resume=True)

    def test_later_files_are_added(self, copied, noise, whole, tmp_path):
        last = (copied / "5-day.csv").read_bytes()
        (copied / "5-day.csv").unlink()
        assert run(copied, tmp_path / "out", noise).n_record < N_RECORD
        (copied / "5-day.csv").write_bytes(last)
        assert run(copied, tmp_path / "out", noise, resume=True).n_record == N_RECORD
        same(tmp_path / "out", whole)


def without_skipped_files(folder):
    """Take the files that were skipped out of the report of reading, and return them."""
    records = xr.load_dataset(folder / "records.nc", engine="h5netcdf")
    report = json.loads(records.attrs["read_report"])
    skipped, report["files_skipped"] = report["files_skipped"], []
    records.attrs["read_report"] = json.dumps(report)
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    return skipped


def garble(file):
    lines = file.read_text().splitlines()
    lines[len(lines) * 3 // 4] = "2000-01-01 00:1?,0,oops"
    file.write_text("\n".join(lines))


def cut_short(file):
    compressed = gzip.compress(file.read_bytes())
    file.with_suffix(".csv.gz").write_bytes(compressed[: len(compressed) // 2])
    file.unlink()


@pytest.fixture(scope="module")
def good(files, noise, tmp_path_factory):
    """The folder of a run of all files but the one that is spoilt."""
    output = tmp_path_factory.mktemp("good") / "out"
    run(sorted(file for file in files.iterdir() if file.name != "7-day.csv"), output, noise)
    assert without_skipped_files(output) == []
    return output


class TestBadFiles:
    @pytest.mark.parametrize(
        "spoil",
        [garble, cut_short, lambda file: file.write_bytes(b""), lambda file: file.write_bytes(bytes(range(256)) * 9)],
        ids=["garbled", "cut short", "empty", "bytes"],
    )
    def test_they_are_named_at_the_end_and_stop_nothing(self, files, good, noise, tmp_path, monkeypatch, spoil):
        folder = tmp_path / "year"
        folder.mkdir()
        for file in files.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        spoil(folder / "7-day.csv")
        for rows in (150, 100_000):  # of some 500 in a file
            read_in_chunks(monkeypatch, rows)
            ((name, reason),) = run(folder, tmp_path / f"{rows}", noise).run["bad_files"].items()
            assert "7-day.csv" in name
            assert reason
            assert json.loads((tmp_path / f"{rows}" / "run.json").read_text())["bad_files"] == {name: reason}
        same(tmp_path / "150", tmp_path / "100000")
        (skipped,) = without_skipped_files(tmp_path / "150")
        assert skipped["name"].removesuffix(".gz") == "7-day.csv"
        same(tmp_path / "150", good)

    def test_none_is_good(self, tmp_path, noise):
        (tmp_path / "a.csv").write_text("time,beam,radial_velocity\noops,0,1\n")
        (tmp_path / "b.csv").write_text("")
        with pytest.raises(InputError, match=r"None of the 2 files can be used; the first: .*a.csv"):
            run(tmp_path, tmp_path / "out", noise)

    def test_one_of_several_side_by_side(self, series, tmp_path):
        for beam in (0, 1):
            write_file(tmp_path / f"{beam}.csv", series.isel(sample=series["beam"].values == beam))
        garble(tmp_path / "1.csv")
        skip = FileOptions(on_bad_file="skip")
        with begin_result_folder(tmp_path / "store", key="k", key_parts={}) as folder:
            found = record_store.store_records(tmp_path, SCAN, folder, reading=skip, chunk_rows=100, duration=DURATION)
        assert [Path(name).name for name in found.bad_files] == ["1.csv"]
        assert found.records["beam"].values.tolist() == [0]

    def test_a_full_disk_is_no_bad_file(self, files, tmp_path, monkeypatch):
        def full(*_args, **_options):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(record_store, "stream_files", full)
        store = begin_result_folder(tmp_path / "store", key="k", key_parts={})
        with pytest.raises(OSError, match="No space left"), store as folder:
            record_store.store_records(files, SCAN, folder, duration=DURATION)


class TestLateSamples:
    def test_they_are_reported(self, series, noise, tmp_path):
        (tmp_path / "year").mkdir()
        first, rest = series.isel(sample=slice(0, 200)), series.isel(sample=slice(200, None))
        again = first.isel(sample=slice(0, 20)).assign_coords(time=first["time"][:20] + np.timedelta64(1, "ms"))
        shuffled = xr.concat(
            [first, rest.isel(sample=slice(0, 900)), again, rest.isel(sample=slice(900, None))], "sample"
        )
        chunks = [shuffled.isel(sample=slice(start, start + 50)) for start in range(0, shuffled.sizes["sample"], 50)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(record_store, "stream_files", lambda *_args, **_options: iter(chunks))
            write_file(tmp_path / "year" / "a.csv", shuffled)
            run(tmp_path / "year", tmp_path / "out", noise)
        assert json.loads((tmp_path / "out" / "run.json").read_text())["samples_late"] == 20


class TestDask:
    def test_an_address_where_nothing_is(self):
        words = (
            r"No Dask scheduler at 'tcp://127.0.0.1:9' .*: give the address that it prints when it starts, such as tcp"
        )
        with pytest.raises(InputError, match=words), connect("tcp://127.0.0.1:9", timeout=0.5):
            pass

    def test_without_the_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        words = r"A Dask cluster needs the package distributed: run pip install"
        with pytest.raises(MissingExtraError, match=words), connect("tcp://127.0.0.1:9"):
            pass

    def test_a_cluster_writes_the_same_files(self, files, noise, whole, tmp_path):
        options = {"processes": True, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0"}
        with distributed.LocalCluster(**options) as cluster:
            run(files, tmp_path / "out", noise, scheduler=cluster.scheduler_address)
        same(tmp_path / "out", whole)
