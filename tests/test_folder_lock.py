"""One process at a time fills a folder: a second one is told so, and a dead one's place is taken over."""

import errno
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import fit_scene
import pytest
from fit_scene import N_RECORD, OPTIONS, PART, SCAN, fit_to, make_records

from bayes_rs import InputError, open_fit
from bayes_rs.fits import plan
from bayes_rs.folder_lock import locked
from bayes_rs.output import check_output_folder, output_folder, write_run

TESTS = Path(__file__).parent
HOLD = (
    "import sys\n"
    "from bayes_rs.folder_lock import locked\n"
    "with locked(sys.argv[1]):\n"
    "    print('held', flush=True)\n"
    "    sys.stdin.read()\n"
)
WORK = (
    "import sys, time\n"
    f"sys.path.insert(0, {str(TESTS)!r})\n"
    "import fit_scene\n"
    "from bayes_rs.fits import fit_writing, plan\n"
    "plan.PART_RECORDS = fit_scene.PART\n"
    "def slowly(shared, part):\n"
    "    if part.index == 2:\n"
    "        print('at part two', flush=True)\n"
    "        sys.stdin.read()\n"
    "    return fit_scene.FIT_PART(shared, part)\n"
    "fit_writing.fit_part = slowly\n"
    "fit_scene.fit_to(fit_scene.make_records(), fit_scene.SCAN, sys.argv[1], **fit_scene.OPTIONS)\n"
)


def start(script, folder):
    process = subprocess.Popen(  # noqa: S603 - our own script
        [sys.executable, "-c", script, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline()
    return process


def end(process, how=None):
    if how is None:
        process.stdin.close()
    else:
        process.send_signal(how)
    code = process.wait(timeout=60)
    process.stdout.close()
    if how is not None:
        process.stdin.close()
    return code


@pytest.fixture
def place(tmp_path):
    return tmp_path / "out"


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


class TestLock:
    def test_a_second_process_is_told_who_where_and_what_to_do(self, place):
        other = start(HOLD, place)
        words = (
            rf"Output folder '{re.escape(str(place))}' is being written by another run \(process {other.pid} on .+, "
            r"since \d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ\): wait for its end, stop it, or give another name\."
        )
        with pytest.raises(InputError) as caught, locked(place):
            pass
        assert re.fullmatch(words, str(caught.value))
        assert end(other) == 0

    @pytest.mark.parametrize("how", [None, signal.SIGKILL, signal.SIGTERM])
    def test_it_is_free_when_the_process_is_gone_however_it_went(self, place, how):
        assert end(start(HOLD, place), how) == (0 if how is None else -how)
        with locked(place):
            assert len(hidden(place.parent)) == 1
        assert hidden(place.parent) == []

    def test_an_error_frees_it(self, place):
        for _ in range(2):
            with pytest.raises(ZeroDivisionError), locked(place):
                raise ZeroDivisionError

    def test_other_folders_are_not_concerned(self, tmp_path):
        long_name = "x" * 60
        names = ("out", "out2", f"{long_name}1", f"{long_name}2")
        with ExitStack() as stack:
            for name in names:
                stack.enter_context(locked(tmp_path / name))
            assert len(hidden(tmp_path)) == 4

    def test_one_folder_by_two_names_is_one(self, place, monkeypatch):
        monkeypatch.chdir(place.parent)
        with locked(place), pytest.raises(InputError, match="is being written by another run"), locked("out"):
            pass

    def test_one_that_was_removed_while_it_was_opened_is_made_anew(self, place, monkeypatch):
        """Between opening the file and locking it, the run that held it may have ended and removed it."""
        import bayes_rs.folder_lock as module  # noqa: PLC0415 - to be spoilt

        lock, removed = module._lock, []

        def slow(number):
            if not removed:
                removed.extend(place.parent.glob(".lock-*"))
                removed[0].unlink()
            lock(number)

        monkeypatch.setattr(module, "_lock", slow)
        with locked(place):
            assert len(removed) == 1
            assert len(hidden(place.parent)) == 1
            monkeypatch.undo()
            with pytest.raises(InputError, match="is being written"), locked(place):
                pass

    def test_a_place_without_locks_is_warned_of(self, place, monkeypatch):
        def unknown(_number):
            raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

        monkeypatch.setattr("bayes_rs.folder_lock._lock", unknown)
        with (
            pytest.warns(
                UserWarning, match=r"knows no locks \(Function not implemented\): see to it that no other run"
            ),
            locked(place),
        ):
            pass


class TestReplacing:
    """Commands that write a folder at once do not replace one that another run is filling."""

    @pytest.fixture
    def older(self, place):
        with output_folder(place) as folder:
            write_run(folder, {"n": 1})
        return place

    def test_it_waits_for_nobody_and_spoils_nothing(self, older):
        other = start(HOLD, older)
        with pytest.raises(InputError, match="is being written by another run"):
            check_output_folder(older, overwrite=True)
        with pytest.raises(InputError, match="is being written by another run"), output_folder(older, overwrite=True):
            pytest.fail("nothing is to be done")
        assert sorted(path.name for path in older.iterdir()) == ["fingerprints.jsonl", "run.json"]
        assert end(other) == 0
        check_output_folder(older, overwrite=True)
        with output_folder(older, overwrite=True) as folder:
            write_run(folder, {"n": 2})
        assert '"n": 2' in (older / "run.json").read_text()
        assert [path.name for path in older.parent.iterdir()] == ["out"]

    def test_while_it_writes_no_other_run_begins(self, older):
        with output_folder(older, overwrite=True) as folder:
            write_run(folder, {"n": 2})
            with pytest.raises(InputError, match="is being written by another run"), locked(older):
                pass

    def test_a_new_folder_needs_no_lock(self, place):
        with locked(place), output_folder(place) as folder:
            write_run(folder, {"n": 1})
        assert (place / "run.json").is_file()


@pytest.mark.slow
class TestTwoRuns:
    def test_the_second_stops_and_spoils_nothing_and_takes_over_when_the_first_is_dead(self, place, monkeypatch):
        monkeypatch.setattr(plan, "PART_RECORDS", PART)
        whole = fit_to(make_records(), SCAN, place.parent / "whole", **OPTIONS)
        first = start(WORK, place)
        half_written = place / "summary" / ".half.part-000002.parquet"  # as of the first process, amid a file
        half_written.write_bytes(b"PAR1")
        before = {path: path.stat().st_mtime_ns for path in sorted(place.glob("**/*"))}
        for options in ({"resume": True}, {"overwrite": True}, {}):
            with pytest.raises(InputError, match=rf"is being written by another run \(process {first.pid} on "):
                fit_to(make_records(), SCAN, place, **options, **OPTIONS)
        assert {path: path.stat().st_mtime_ns for path in sorted(place.glob("**/*"))} == before
        assert end(first, signal.SIGKILL) == -signal.SIGKILL
        found = fit_to(make_records(), SCAN, place, resume=True, **OPTIONS)
        assert found.run["n_resumed"] == 2 * PART
        assert found.summary().equals(whole.summary())
        assert not half_written.exists()
        assert hidden(place.parent) == []

    def test_the_first_goes_on_undisturbed(self, place):
        first = start(WORK, place)
        with pytest.raises(InputError, match="is being written by another run"):
            fit_to(make_records(), SCAN, place, resume=True, **OPTIONS)
        assert end(first) == 0
        assert open_fit(place).summary()["record"].nunique() == N_RECORD
        assert fit_scene.PART == PART
