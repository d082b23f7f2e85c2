"""What other systems lack or refuse, simulated on this one: none of them was run."""

import ctypes
import errno
import multiprocessing
import os
import subprocess
import sys
import types
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scenes import plain_noise, records_of

import bayes_rs
from bayes_rs import InputError, load_scan, processor, sizes
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.fits import workers
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.folder_tables import DATASETS
from bayes_rs.fits.parts import fit_part
from bayes_rs.fits.plan import plan_fit
from bayes_rs.fits.tables import names_of_part
from bayes_rs.folder_place import check_windows_name
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.ledger import HALF
from bayes_rs.models import models_folder

HERE = Path(__file__).parent
PATH_LIMIT, ROOM = 260, 100
"""Characters of a path on Windows, and how many of them the program takes at most below a folder that a user names."""


def run(*command):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run(  # noqa: S603 - our own
        [sys.executable, *command], capture_output=True, text=True, check=False, env=environment
    )


@pytest.mark.slow
def test_a_fit_where_posix_ends(tmp_path):
    """No fcntl, resource, sysconf, SIGHUP; no file is moved or removed while it is open, no folder put on another."""
    done = run(str(HERE / "system_scene.py"), str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split(",")) == 12
    assert {path.name for path in tmp_path.iterdir() if not path.name.startswith(".lock")} == {
        *("out", "page.html", "scan.toml", "table")
    }


def test_the_command_runs_without_the_signals_of_posix():
    code = (
        "import signal, sys\nfor name in ('SIGHUP', 'SIGALRM', 'setitimer'):\n    delattr(signal, name)\n"
        "sys.argv = ['bayes-rs', '--version']\nfrom bayes_rs.__main__ import main\nmain()"
    )
    done = run("-c", code)
    assert (done.returncode, done.stdout) == (0, f"bayes-rs, version {bayes_rs.__version__}\n")


class TestSpawn:
    """Workers of a context that does not fork: what they need reaches them pickled, and they import it themselves."""

    def test_parts_are_those_of_one_process(self):
        scan = load_scan("6-beam")
        noise, stress = plain_noise(scan), np.array([[1.0, 0.6, 0.4, 0.0, -0.2, 0.0]] * 2)
        records = records_of(stress @ design_matrix(scan).T, scan)
        plan = plan_fit(records, scan, noise, FitOptions(seed=1, target_ess=100), inputs={"records": 1})
        context = multiprocessing.get_context("spawn")
        here = fit_part(plan.shared, plan.parts[0])
        with ProcessPoolExecutor(
            1, mp_context=context, initializer=workers._share, initargs=(plan.shared, os.getpid(), None)
        ) as pool:
            there = pool.submit(workers._work, fit_part, plan.parts[0]).result()
        assert set(there.tables) == set(here.tables)
        for name, table in here.tables.items():
            pd.testing.assert_frame_equal(there.tables[name], table, check_exact=True)

    def test_on_windows_a_worker_waits_for_the_end_of_its_parent(self, monkeypatch):
        """The number of the parent stays what it was there, so that to compare it tells nothing."""
        calls = []
        winapi = types.SimpleNamespace(
            INFINITE=-1,
            OpenProcess=lambda right, inherited, number: calls.append((right, inherited, number)) or "handle",
            WaitForSingleObject=lambda handle, long: calls.append((handle, long)),
        )
        monkeypatch.setattr(processor, "sys", types.SimpleNamespace(platform="win32"))
        monkeypatch.setattr(processor, "_winapi", winapi, raising=False)
        ended = []
        monkeypatch.setattr(processor.os, "_exit", ended.append)
        monkeypatch.setattr(
            processor.threading, "Thread", lambda target, daemon: types.SimpleNamespace(start=target, daemon=daemon)
        )
        processor.end_with(1234)
        assert calls == [(0x00100000, False, 1234), ("handle", -1)]
        assert ended == [1]


class TestMemory:
    def test_windows_says_what_is_free(self, monkeypatch):
        def fill(pointer):
            pointer._obj.free = 3 * 2**30
            assert pointer._obj.size == 64  # of MEMORYSTATUSEX
            return 1

        kernel = types.SimpleNamespace(GlobalMemoryStatusEx=fill)
        monkeypatch.setattr(ctypes, "windll", types.SimpleNamespace(kernel32=kernel), raising=False)
        monkeypatch.setattr(sizes, "sys", types.SimpleNamespace(platform="win32"))
        assert sizes.free_memory() == 3 * 2**30
        kernel.GlobalMemoryStatusEx = lambda _pointer: 0
        assert sizes.free_memory() == float("inf")

    def test_without_proc_it_is_all_that_there_is(self, monkeypatch):
        """As on macOS."""
        monkeypatch.setattr(sizes.Path, "read_text", lambda *_args, **_options: (_ for _ in ()).throw(OSError()))
        assert 0.0 < sizes.free_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


class TestNames:
    @pytest.mark.parametrize("name", ["nul", "NUL.txt", "con", "com1", "LPT9.2020", "a:b", "what?", "year.", "year "])
    def test_names_that_windows_does_not_take(self, name):
        with pytest.raises(InputError, match=r"Cannot write the output folder .*; give another name\."):
            check_windows_name(name)

    @pytest.mark.parametrize("name", ["year", "com10", "null", "month=2020-09", "jahr ä", ".hidden"])
    def test_names_that_it_takes(self, name):
        check_windows_name(name)

    def test_what_is_shipped_has_names_for_every_system(self):
        """No two that differ in upper and lower case alone, none that Windows refuses, none that is long."""
        for root in {Path(bayes_rs.__file__).parent, models_folder("scans").parent, HERE}:
            files = [file.relative_to(root) for file in root.rglob("*") if "__pycache__" not in file.parts]
            for file in files:
                for part in file.parts:
                    check_windows_name(part)
            assert len({file.as_posix().casefold() for file in files}) == len(files)
            assert max(len(file.as_posix()) for file in files) < ROOM

    def test_what_a_fit_writes_leaves_room_in_a_path(self):
        start = np.array(["2020-09-01"], dtype="datetime64[ns]")
        names = [name for dataset in DATASETS for name, _ in names_of_part(dataset, 10**6, start)]
        for name in names:
            folder, _, file = f"range-0080m/{name}".rpartition("/")
            assert len(f"{folder}/{HALF}{file}") < ROOM
            for part in Path(name).parts:
                check_windows_name(part)


def test_a_folder_that_is_kept_is_put_where_none_is(tmp_path, monkeypatch):
    """Where not even an empty folder is replaced by another, as on Windows."""
    plain = os.replace

    def strict(source, target, **options):
        if Path(target).is_dir():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
        plain(source, target, **options)

    monkeypatch.setattr(os, "replace", strict)
    place = tmp_path / "out"
    with begin_result_folder(place, key="1", key_parts={}) as folder:
        folder.finish({"n": 1})
    with begin_result_folder(place, key="2", key_parts={}, overwrite=True) as folder:
        (place / "mine.txt").touch()
        with pytest.warns(UserWarning, match="is kept as"):
            folder.finish({"n": 2})
    (kept,) = tmp_path.glob("out.kept-*")
    assert (kept / "mine.txt").is_file()
