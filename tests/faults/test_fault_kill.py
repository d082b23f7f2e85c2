"""Signals at any moment: afterwards an output is absent, whole or resumable, and half of it is never read as whole."""

import os
import shutil
import signal
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fault_scenes import CALIBRATE, FIT, OF_RECORDS, RECORDS, WITHOUT_PICTURES, run, start, write_scene

import bayes_rs as brs
from bayes_rs import InputError
from bayes_rs.cli.group import commands
from bayes_rs.fits import plan
from bayes_rs.noise.file import load_noise
from bayes_rs.output import output_folder, write_run
from bayes_rs.result_folder import open_result_folder

pytestmark = pytest.mark.slow
SMALL_PARTS = """
import signal
from bayes_rs import __main__ as command
before = signal.signal(signal.SIGINT, command._stop)
open("begun", "w").close()
from bayes_rs.cli import fit_commands
from bayes_rs.fits import plan
fit_commands.draw_pictures = lambda *_: None
plan.PART_RECORDS = 5
signal.signal(signal.SIGINT, before)
command.main()
"""
"""The command, with parts so small that a small fit has many moments. Before it has begun, Python itself is loaded."""
N_FILE = 16
"""Files of the parts of that fit."""
LONG = ("fit", "records.nc", *OF_RECORDS, "--draws", "float32")
KILLS = [("parent", "KILL"), ("parent", "INT"), ("workers", "KILL"), ("all", "TERM")]
MORE_KILLS = [(who, name) for who in ("parent", "workers", "all") for name in ("KILL", "TERM", "HUP", "INT")]
TWENTY_KILLS = MORE_KILLS + [("parent", name) for name in ("KILL", "TERM", "HUP", "INT")] * 2


def kill_at(process, seconds):
    """Kill a process so long after its start; return whether that was before its end."""
    time.sleep(seconds)
    process.kill()
    process.communicate()
    return process.returncode != 0


def workers_of(process):
    """The processes that work for one."""
    with suppress(OSError):  # it has ended
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        return [int(child) for child in children if "popen_loky" in Path(f"/proc/{child}/cmdline").read_text()]
    return []


def send(process, who, name):
    """Send a signal to a process, to one of its workers, or to all of them; return what it wrote to stderr."""
    number = getattr(signal, f"SIG{name}")
    if who != "parent":
        targets = workers_of(process)
        for target in targets if who == "all" else targets[:1]:
            with suppress(ProcessLookupError):
                os.kill(target, number)
    if who != "workers":
        process.send_signal(number)
    return process.communicate()[1]


def when_there_are(n_file, folder, process, *, then):
    """Wait until the command has begun and its folder has so many files of parts, and a moment longer."""
    begun = folder.with_name("begun")
    while process.poll() is None and not (begun.exists() and len(list(folder.rglob("part-*.parquet"))) >= n_file):
        time.sleep(0.01)
    begun.unlink(missing_ok=True)
    time.sleep(then)


def files_of(folder):
    """The files that two runs of the same fit have in common, byte for byte."""
    found = {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    return {name: content for name, content in found.items() if name not in ("run.json", "fingerprints.jsonl")}


def moments(n, longest, *, seed):
    return sorted(np.random.default_rng(seed).uniform(0.3, longest, n).tolist())


AT_IMPORT = """
import os, signal, sys
from bayes_rs.__main__ import main
left = int(sys.argv.pop(1))
def count(event, _):
    global left
    left -= event == "import"
    if left == 0 and event == "import":
        os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(count)
main()
"""
"""The command, which interrupts itself at the n-th import: a moment that no load of the machine moves."""


class TestFirstSeconds:
    @pytest.mark.parametrize(
        "n_import",
        [1, 30, 300, 700, *(pytest.param(n, marks=pytest.mark.long) for n in range(75, 1500, 50))],
    )
    def test_an_interrupt_while_modules_are_loaded(self, tmp_path, n_import):
        """A Python that ran a text as code when it was interrupted ends by the signal; a shell says 130 of both."""
        process = start(n_import, *FIT, "-o", "out", folder=tmp_path, own=AT_IMPORT)
        _, errors = process.communicate()
        assert errors.split("\n") == ["", "bayes-rs: interrupted.", ""]
        assert process.returncode in (130, -signal.SIGINT)
        assert not (tmp_path / "out").exists()

    def test_where_interrupts_are_ignored_they_stay_so(self, tmp_path):
        """A shell has the programs in its background ignore them."""
        ignoring = f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n{AT_IMPORT}"
        code, errors = run(30, "scans", folder=tmp_path, own=ignoring)
        assert (code, errors) == (0, "")


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


@pytest.fixture
def fit_here(tmp_path, monkeypatch):
    """Fit in this process what nobody stops: to start another takes longer than the fit."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bayes_rs.cli.fit_commands.draw_pictures", lambda *_: None)

    def fit(*words):
        assert not commands.main(list(words), standalone_mode=False)

    return fit


class TestFolders:
    def test_a_fit_that_has_not_ended_is_none_and_goes_on(self, tmp_path, fit_here):
        write_scene(tmp_path)
        fit = ("fit", "records.nc", *OF_RECORDS)
        process = start(*fit, "-o", "out", folder=tmp_path, own=WITHOUT_PICTURES)
        while process.poll() is None and not (tmp_path / "out" / "posterior.nc").exists():
            time.sleep(0.01)
        process.kill()
        process.communicate()
        with pytest.raises(InputError, match=r"The fit in '.*out' has not ended: resume it, or wait for its end"):
            brs.write_report(tmp_path / "out")
        for name in ("out", "whole"):
            fit_here(*fit, "-o", name)
        one, other = (
            {file.name: file.read_bytes() for file in place.rglob("*") if file.is_file()}
            for place in (tmp_path / "out", tmp_path / "whole")
        )
        for name in one.keys() - {"run.json", "fingerprints.jsonl"}:
            assert one[name] == other[name], name
        assert one.keys() == other.keys()

    @pytest.mark.parametrize("kills", [KILLS, pytest.param(TWENTY_KILLS, marks=pytest.mark.long)])
    def test_any_signal_to_anyone_at_any_moment(self, tmp_path, kills, fit_here, monkeypatch):
        """What is finished is byte for byte that of a run that nobody stopped; what is not is never taken for it."""
        write_scene(tmp_path)
        fit = ("fit", "records.nc", *OF_RECORDS)
        monkeypatch.setattr(plan, "PART_RECORDS", 5)
        fit_here(*fit, "-o", "whole")
        whole = files_of(tmp_path / "whole")
        rng = np.random.default_rng(len(kills))
        out = tmp_path / "out"
        stages = np.sort(rng.integers(0, N_FILE, len(kills))).tolist()
        for (who, name), n_file in zip(kills, stages, strict=True):
            crew = () if who == "parent" else ("--workers", "2")
            process = start(*fit, "-o", "out", *crew, folder=tmp_path, own=SMALL_PARTS)
            when_there_are(n_file, out, process, then=rng.uniform(0.0, 0.3))
            errors = send(process, who, name)
            if who == "parent":
                assert "Traceback" not in errors
            if not out.exists():
                continue
            opened = open_result_folder(out)
            if not opened.finished:
                with pytest.raises(InputError, match=r"The fit in '.*out' has not ended"):
                    brs.open_fit(out)
            for file in opened.names():
                assert opened.damage(file) in (None, "is missing")
                if file in whole and opened.damage(file) is None:
                    assert (out / file).read_bytes() == whole[file], file
        fit_here(*fit, "-o", "out")
        assert files_of(out) == whole

    @pytest.mark.parametrize("n_kill", [1, pytest.param(20, marks=pytest.mark.long)])
    def test_a_long_fit_goes_on(self, tmp_path, n_kill, fit_here):
        write_scene(tmp_path)
        fit_here(*LONG, "-o", "whole")
        for number, seconds in enumerate(moments(n_kill, 5.0, seed=2)):
            process = start(*LONG, "-o", "out", folder=tmp_path, own=WITHOUT_PICTURES)
            time.sleep(seconds)
            send(process, "parent", ("KILL", "TERM", "HUP", "INT")[number % 4])
        fit_here(*LONG, "-o", "out")
        for name in ("summary", "posterior", "draws"):
            one, other = (pd.read_parquet(tmp_path / folder / name) for folder in ("whole", "out"))
            pd.testing.assert_frame_equal(one, other)
        assert not list((tmp_path / "out").glob("**/.half*"))
        assert brs.write_report(tmp_path / "out").is_file()

    @pytest.mark.long
    def test_the_page_is_absent_or_whole(self, tmp_path):
        write_scene(tmp_path)
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
            try:  # never back into the tests
                monkeypatch.setattr(Path, "replace", stopping(Path.replace, tmp_path))
                monkeypatch.setattr(Path, "unlink", stopping(Path.unlink, tmp_path / ".out.replaced"))
                with output_folder(final, overwrite=True) as folder:
                    write_run(folder, {"n": "new"})
                    (folder / "posterior.nc").write_text("new")
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        places = [place for place in tmp_path.iterdir() if place.is_dir() and any(place.iterdir())]  # and a lock
        assert sorted((place / "posterior.nc").read_text() for place in places) == ["new", "old"]
        assert all((place / "run.json").is_file() for place in places)
