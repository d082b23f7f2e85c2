"""SIGKILL at any moment: afterwards an output is absent, whole or resumable, and half of it is never read as whole."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fault_scenes import CALIBRATE, FIT, RECORDS, run, start

import bayes_rs as brs
from bayes_rs import InputError
from bayes_rs.noise.file import load_noise
from bayes_rs.output import output_folder, write_run

pytestmark = pytest.mark.slow
LONG = (*FIT, "--draws", "float32", "--resume")


def kill_at(process, seconds):
    """Kill a process so long after its start; return whether that was before its end."""
    time.sleep(seconds)
    process.kill()
    process.communicate()
    return process.returncode != 0


def moments(n, longest, *, seed):
    return sorted(np.random.default_rng(seed).uniform(0.3, longest, n).tolist())


class TestFiles:
    @pytest.mark.parametrize(
        ("command", "load"),
        [(RECORDS, xr.load_dataset), pytest.param(CALIBRATE, load_noise, marks=pytest.mark.long)],
    )
    def test_it_is_what_was_there_or_whole(self, tmp_path, command, load):
        began = time.monotonic()
        assert run(*command, "-o", "whole.nc", folder=tmp_path)[0] == 0
        longest = time.monotonic() - began
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)
        (tmp_path / "out.nc").write_bytes(b"what was there")
        killed = 0
        for seconds in moments(2, longest, seed=1):
            killed += kill_at(start(*command, "-o", "out.nc", "--overwrite", folder=tmp_path), seconds)
            if (tmp_path / "out.nc").read_bytes() != b"what was there":
                load(tmp_path / "out.nc")
            for cached in (tmp_path / "cache").glob("*.nc"):
                load_noise(cached)
        assert killed
        assert run(*command, "-o", "out.nc", "--overwrite", folder=tmp_path)[0] == 0
        assert str(load(tmp_path / "out.nc")) == str(load(tmp_path / "whole.nc"))

    def test_leftovers_in_a_folder_of_data_are_passed_over(self, tmp_path):
        """A killed command leaves a hidden folder beside its output, with a file in it that looks like data."""
        hidden = tmp_path / ".records.nc-abc"
        hidden.mkdir()
        (hidden / "records.csv").write_text("half")
        good = tmp_path / "good.csv"
        good.write_text("time,beam,radial_velocity\n2020-01-01T00:00:00,0,1.0\n2020-01-01T00:00:01,1,1.0\n")
        series = brs.read(tmp_path, brs.load_scan("2-beam"))
        assert series.sizes["sample"] == 2


class TestFolders:
    def test_a_fit_is_absent_or_whole(self, tmp_path):
        process = start(*FIT, "-o", "out", folder=tmp_path)
        while process.poll() is None and not list(tmp_path.glob("out.partial-*/posterior.nc")):
            time.sleep(0.01)
        process.kill()
        process.communicate()
        assert not (tmp_path / "out").exists()
        (part,) = tmp_path.glob("out.partial-*")
        with pytest.raises(InputError, match=r"it has no run\.json"):
            brs.write_report(part)

    @pytest.mark.parametrize("n_kill", [1, pytest.param(20, marks=pytest.mark.long)])
    def test_a_long_fit_goes_on(self, tmp_path, n_kill):
        assert run(*LONG, "-o", "whole", folder=tmp_path)[0] == 0
        for seconds in moments(n_kill, 5.0, seed=2):
            kill_at(start(*LONG, "-o", "out", folder=tmp_path), seconds)
        assert run(*LONG, "-o", "out", folder=tmp_path)[0] == 0
        for name in ("summary", "posterior", "draws"):
            one, other = (pd.read_parquet(tmp_path / folder / name) for folder in ("whole", "out"))
            pd.testing.assert_frame_equal(one, other)
        assert not list((tmp_path / "out").glob("**/.part*"))
        assert brs.write_report(tmp_path / "out").is_file()

    @pytest.mark.long
    def test_the_page_is_absent_or_whole(self, tmp_path):
        assert run(*LONG, "-o", "out", folder=tmp_path)[0] == 0
        for seconds in moments(2, 3.0, seed=3):
            kill_at(start("report", "out", "--overwrite", folder=tmp_path), seconds)
            page = tmp_path / "out" / "report.html"
            assert not page.exists() or page.read_text(encoding="utf-8").rstrip().endswith("</html>")
        assert run("report", "out", "--overwrite", folder=tmp_path)[0] == 0

    @pytest.mark.parametrize("number", [1, 2, 3])
    def test_replacing_a_folder_loses_neither_the_old_nor_the_new(self, tmp_path, monkeypatch, number):
        """Stopped before any of the renamings and the removal, both are there, each with all its files."""
        final = tmp_path / "out"
        with output_folder(final) as folder:
            write_run(folder, {"n": "old"})
            (folder / "posterior.nc").write_text("old")
        steps = iter(range(100))

        def stopping(original, within):
            def stepping(path, *arguments, **options):
                if path.parent == within and next(steps) == number - 1:
                    os._exit(9)
                return original(path, *arguments, **options)

            return stepping

        child = os.fork()
        if child == 0:
            monkeypatch.setattr(Path, "replace", stopping(Path.replace, tmp_path))
            monkeypatch.setattr(Path, "unlink", stopping(Path.unlink, tmp_path / ".out.replaced"))
            with output_folder(final, overwrite=True) as folder:
                write_run(folder, {"n": "new"})
                (folder / "posterior.nc").write_text("new")
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        places = [place for place in tmp_path.iterdir() if place.is_dir() and any(place.iterdir())]  # and a lock
        assert sorted((place / "posterior.nc").read_text() for place in places) == ["new", "old"]
        assert all((place / "run.json").is_file() for place in places)
