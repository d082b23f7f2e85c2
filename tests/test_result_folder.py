"""A folder of results: what is damaged is named, and nothing that we did not write is ever removed."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from bayes_rs import InputError
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.errors import LostResultsError
from bayes_rs.fits.tables import names_of_part, part_names, read_table, write_table
from bayes_rs.folder_place import partial_of, replaced_of
from bayes_rs.ledger import HALF, LEDGER, read_ledger
from bayes_rs.output import check_output_folder, output_folder, write_run
from bayes_rs.result_folder import RUN_FILE, list_beside, open_result_folder

BEGIN = partial(begin_result_folder, key="k", key_parts={"prior": "weak", "seed": "1"})
LAYOUT = {"record": "whole", "mean": "number", "flag": "text"}
OTHER = partial(begin_result_folder, key="k2", key_parts={"prior": "weak", "seed": "2"})
NAMES = [f"summary/month=2020-0{month}/part-00000{part}.parquet" for part, month in ((0, 9), (1, 9), (2, 8))]
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
TOOK_PLACE = "from bayes_rs import folder_place, result_folder, ledger, begin_folder\n"


def table(part, n_row=20):
    values = np.random.default_rng(part).normal(size=n_row)
    return pd.DataFrame({"record": np.arange(n_row) + 100 * part, "mean": values, "flag": ["ok", ""] * (n_row // 2)})


def fill(folder, names=NAMES):
    for part, name in enumerate(names):
        if folder.damage(name):
            write_table(folder, name, table(part))


def finished(place, begin=BEGIN, text="first", **options):
    with begin(place, **options) as folder:
        fill(folder)
        folder.write_text("note.txt", text)
        folder.finish({"n_record": 60})
    return place


def contents(place):
    return {
        file.relative_to(place).as_posix(): file.read_bytes() for file in sorted(place.rglob("*")) if file.is_file()
    }


def listed(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def place(tmp_path):
    return tmp_path / "out"


class TestWriting:
    def test_a_finished_folder(self, place):
        with BEGIN(place) as folder:
            assert json.loads((place / RUN_FILE).read_text())["finished"] is False
            fill(folder)
            folder.finish({"n_record": 60})
        found = open_result_folder(place)
        assert found.finished
        assert found.damaged() == {}
        assert found.names() == sorted([*NAMES, RUN_FILE])
        assert found.run() == {
            "finished": True, "key": "k", "key_parts": {"prior": "weak", "seed": "1"}, "n_record": 60,
        }  # fmt: skip
        assert listed(place.parent) == ["out"]

    def test_tables_come_back_in_the_order_of_the_records(self, place):
        found = open_result_folder(finished(place))
        whole = read_table(found, part_names(found, "summary"), LAYOUT)
        pd.testing.assert_frame_equal(whole, pd.concat([table(0), table(1), table(2)], ignore_index=True))
        assert list(read_table(found, NAMES[:1], {"mean": "number"}).columns) == ["mean"]

    def test_names_of_parts(self):
        time = np.array(["2020-08-31T23:50", "2020-09-01T00:00"], dtype="datetime64[ns]")
        names = names_of_part("summary", 7, time)
        assert [name for name, _ in names] == [f"summary/month=2020-0{month}/part-000007.parquet" for month in (8, 9)]
        assert [rows.tolist() for _, rows in names] == [[True, False], [False, True]]
        assert names_of_part("draws", 7, np.full(2, np.datetime64("NaT", "ns")))[0][0] == "draws/part-000007.parquet"

    def test_a_resumed_run_leaves_the_same_bytes(self, tmp_path):
        whole = contents(finished(tmp_path / "whole"))
        for stop in range(4):
            place = tmp_path / f"out{stop}"
            with pytest.raises(ZeroDivisionError), BEGIN(place) as folder:  # noqa: PT012 - it fails amid its work
                fill(folder, NAMES[:stop])
                raise ZeroDivisionError
            assert place.exists() == (stop > 0)
            finished(place, resume=True)
            assert contents(place) == whole
            finished(place, resume=True)
            assert contents(place) == whole

    def test_an_error_says_where_the_results_are(self, place):
        with pytest.raises(ZeroDivisionError) as caught, BEGIN(place) as folder:  # noqa: PT012 - it fails amid its work
            fill(folder)
            raise ZeroDivisionError
        words = f"What was finished is kept in {str(place)!r}: the same call with resume goes on from there."
        assert caught.value.__notes__ == [words]
        own = ZeroDivisionError()
        own.add_note(f"3 of 6 records are finished and kept in {str(place)!r}.")
        with pytest.raises(ZeroDivisionError) as caught, BEGIN(place, resume=True):
            raise own
        assert len(caught.value.__notes__) == 1

    def test_bad_input_is_to_be_corrected_before_it_goes_on(self, place):
        with pytest.raises(InputError) as caught, BEGIN(place) as folder:  # noqa: PT012 - it fails amid its work
            fill(folder)
            raise InputError("No such mast.")
        (note,) = caught.value.__notes__
        assert "once the input is corrected, the same call with resume goes on from there" in note

    def test_folders_above_go_again_with_it_if_they_were_made_for_it(self, place):
        place.parent.mkdir(exist_ok=True)
        with pytest.raises(ZeroDivisionError), BEGIN(place.parent / "there" / "below" / "out"):
            raise ZeroDivisionError
        assert listed(place.parent) == []
        (place.parent / "there").mkdir()
        with pytest.raises(ZeroDivisionError), BEGIN(place.parent / "there" / "below" / "out"):
            raise ZeroDivisionError
        assert listed(place.parent) == ["there"]

    def test_a_folder_without_results_is_removed_again(self, place):
        with pytest.raises(ZeroDivisionError) as caught, BEGIN(place):
            raise ZeroDivisionError
        assert not hasattr(caught.value, "__notes__")
        assert listed(place.parent) == []
        finished(place)
        before = contents(place)
        with pytest.raises(ZeroDivisionError), OTHER(place, overwrite=True):
            raise ZeroDivisionError
        assert listed(place.parent) == ["out"]
        assert contents(place) == before

    def test_a_file_is_removed_with_its_empty_folders(self, place):
        with BEGIN(place) as folder:
            fill(folder)
            for name in NAMES:
                folder.remove(name)
            folder.remove("what never was")
            assert listed(place) == [LEDGER, RUN_FILE]
            folder.finish({})
        assert open_result_folder(place).names() == [RUN_FILE]

    def test_the_writer_sees_the_ending_of_the_name(self, place):
        with BEGIN(place) as folder:
            folder.write("a/state.npz", lambda file: np.savez(file, n=np.arange(3)))
            folder.finish({})
        assert open_result_folder(place).names("a/") == ["a/state.npz"]

    @pytest.mark.parametrize("name", ["Größe 2020", "two\nlines", "\udcff", "ä" * 120, "-o"])
    def test_names_that_nobody_expects(self, tmp_path, name):
        for overwrite in (False, True):
            with BEGIN(tmp_path / name, overwrite=overwrite) as folder:
                folder.write_text("Übersicht/\udcff = ä.txt", "text")
                folder.finish({})
        assert open_result_folder(tmp_path / name).damaged() == {}
        assert listed(tmp_path) == [name]

    def test_a_folder_for_reading_is_not_written(self, place):
        with pytest.raises(RuntimeError, match="is open for reading only"):
            open_result_folder(finished(place)).write_text("a.txt", "text")


class TestDamage:
    def test_every_flipped_bit_is_found(self, place):
        """In every file of the folder, the list itself among them; and resuming makes the same folder of it again."""
        before = contents(finished(place))
        random = np.random.default_rng(14)
        names = sorted(before)
        silent = []
        for _ in range(800):
            name = names[random.integers(len(names))]
            content = bytearray(before[name])
            content[random.integers(len(content))] ^= 1 << random.integers(8)
            (place / name).write_bytes(content)
            try:
                found = open_result_folder(place)
            except InputError:
                assert name == LEDGER
            else:
                if found.finished and name not in found.damaged():
                    silent.append(name)
            (place / name).write_bytes(before[name])
        assert silent == []

    @pytest.mark.parametrize("name", [NAMES[1], RUN_FILE, LEDGER])
    def test_what_was_changed_is_made_again(self, place, name):
        before = contents(finished(place))
        for at in range(0, len(before[name]), max(1, len(before[name]) // 25)):
            content = bytearray(before[name])
            content[at] ^= 4
            (place / name).write_bytes(content)
            finished(place, resume=True)
            assert contents(place) == before

    def spoilt(self, place, name, how):
        file = place / name
        if how == "missing":
            file.unlink()
        elif how == "truncated":
            os.truncate(file, 100)
        elif how == "fewer rows":
            pq.write_table(pq.read_table(file).slice(0, 5), file)
        elif how == "another schema":
            pq.write_table(pq.read_table(file).drop_columns(["mean"]), file)
        elif how == "a folder":
            file.unlink()
            file.mkdir()

    @pytest.mark.parametrize(
        ("how", "words"),
        [
            ("missing", "is missing"),
            ("truncated", r"has 100 bytes, and \d+ were written"),
            ("fewer rows", r"has \d+ bytes, and \d+ were written"),
            ("another schema", r"has \d+ bytes, and \d+ were written"),
            ("a folder", "is not a file|cannot be read"),
        ],
    )
    def test_a_damaged_file_is_named(self, place, how, words):
        finished(place)
        self.spoilt(place, NAMES[1], how)
        found = open_result_folder(place)
        assert list(found.damaged()) == [NAMES[1]]
        assert re.fullmatch(words, found.damage(NAMES[1]))
        message = rf"File '.*{NAMES[1]}' ({words}): resume the fit to make it again\."
        for read in (found.checked, found.read, lambda name: read_table(found, [name], LAYOUT)):
            with pytest.raises(InputError, match=message):
                read(NAMES[1])
        assert len(read_table(found, [NAMES[0]], LAYOUT)) == 20

    def test_bytes_of_the_same_length(self, place):
        (finished(place) / "note.txt").write_text("FIRST")
        with pytest.raises(InputError, match=r"note.txt' was changed since it was written: resume the fit"):
            open_result_folder(place).read("note.txt")

    def test_a_file_that_is_not_listed(self, place):
        (finished(place) / "mine.parquet").write_bytes(b"PAR1")
        with pytest.raises(InputError, match=r"mine.parquet' is not in fingerprints.jsonl"):
            open_result_folder(place).read("mine.parquet")

    def test_a_line_that_was_being_written_says_nothing(self, place):
        with BEGIN(place) as folder:
            fill(folder)
            lines = (place / LEDGER).read_bytes()
        (place / LEDGER).write_bytes(lines[:-20])
        found = open_result_folder(place)
        assert found.damage(NAMES[1]) is None
        assert found.damage(NAMES[2]) == "is not in fingerprints.jsonl"
        finished(place, resume=True)
        assert open_result_folder(place).damaged() == {}

    def test_a_line_that_was_changed_is_not_believed(self, place):
        lines = (finished(place) / LEDGER).read_text()
        (place / LEDGER).write_text(lines.replace('"n_byte": 5', '"n_byte": 6'))
        with pytest.raises(InputError, match=r"fingerprints.jsonl' was changed since it was written: resume the fit"):
            open_result_folder(place)

    def test_lines_that_are_gone_are_missed(self, place):
        lines = (finished(place) / LEDGER).read_text().splitlines(keepends=True)
        for gone in range(len(lines)):
            (place / LEDGER).write_text("".join(lines[:gone] + lines[gone + 1 :]))
            with suppress(InputError):
                assert not open_result_folder(place).finished or gone == 0  # the first holds the key, no file

    def test_places_without_results(self, tmp_path):
        with pytest.raises(
            InputError, match=r"No results in '.*': it has no fingerprints.jsonl; give the output folder"
        ):
            open_result_folder(tmp_path)
        with pytest.raises(InputError, match=r"No folder '.*none': give the output folder of a bayes-rs run"):
            open_result_folder(tmp_path / "none")


class TestEnd:
    """The end counts what it owes."""

    def test_a_part_that_is_gone(self, place):
        with pytest.raises(LostResultsError) as caught, BEGIN(place) as folder:  # noqa: PT012 - it fails at the end
            fill(folder)
            (place / NAMES[1]).unlink()
            folder.finish({})
        assert str(caught.value) == (
            f"Output folder {str(place)!r} is not finished: 1 file that this run wrote cannot be used ({NAMES[1]} is "
            "missing); resume to make them again."
        )
        assert caught.value.damage == {NAMES[1]: "is missing"}
        assert not open_result_folder(place).finished
        assert json.loads((place / RUN_FILE).read_text())["finished"] is False
        finished(place, resume=True)
        assert open_result_folder(place).damaged() == {}

    def test_many_are_counted(self, place):
        with pytest.raises(LostResultsError, match=r"9 files .* and 4 more\)"), BEGIN(place) as folder:  # noqa: PT012 - it fails at the end
            for number in range(9):
                folder.write_text(f"{number}.txt", "text")
                (place / f"{number}.txt").unlink()
            folder.finish({})

    @pytest.mark.parametrize("again", [False, True])
    def test_the_folder_is_renamed_while_it_is_written(self, place, again):
        words = "was moved or removed while a run was writing it: move it back"
        with pytest.raises(LostResultsError, match=words), BEGIN(place) as folder:  # noqa: PT012 - it fails at the end
            fill(folder, NAMES[:2])
            place.rename(place.parent / "moved")
            if again:
                place.mkdir()
            fill(folder)
        assert place.exists() == again
        assert not again or listed(place) == []
        if again:
            place.rmdir()
        (place.parent / "moved").rename(place)
        finished(place, resume=True)
        assert open_result_folder(place).damaged() == {}

    def test_the_folder_is_renamed_before_the_end(self, place):
        with pytest.raises(LostResultsError, match="was moved or removed"), BEGIN(place) as folder:  # noqa: PT012 - it fails at the end
            fill(folder)
            place.rename(place.parent / "moved")
            folder.finish({})
        assert listed(place.parent) == ["moved"]


class TestOverwriting:
    def test_the_old_result_goes_when_the_new_one_is_whole(self, place):
        old = contents(finished(place))
        with OTHER(place, overwrite=True) as folder:
            assert folder.path == partial_of(place) == place.parent / "out.partial"
            fill(folder)
            folder.write_text("note.txt", "second")
            assert contents(place) == old
            folder.finish({})
            assert folder.path == place
        assert (place / "note.txt").read_text() == "second"
        assert listed(place.parent) == ["out"]
        assert listed(place) == [LEDGER, "note.txt", RUN_FILE, "summary"]
        assert open_result_folder(place).damaged() == {}

    def test_an_unfinished_run_may_be_replaced(self, place):
        with BEGIN(place) as folder:
            fill(folder)
        (place / "summary" / f"{HALF}part-000009.parquet").write_bytes(b"PAR1")
        with pytest.raises(InputError, match=r"exists, from a run of the same data and options: resume to go on"):
            BEGIN(place).__enter__()
        with pytest.raises(InputError, match=r"exists: give another name, or overwrite it"):
            OTHER(place).__enter__()
        finished(place, OTHER, overwrite=True)
        assert listed(place.parent) == ["out"]

    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("notes.txt", "holds 'notes.txt', which bayes-rs did not write: move it, or give another name"),
            ("mine/of/2020/data.csv", "holds 'mine/of/2020/data.csv', which bayes-rs did not write"),
            (
                "summary/month=2020-09/part-000077.parquet",
                "holds 'summary/month=2020-09/part-000077.parquet', which bay",
            ),
            ("note.txt", "holds 'note.txt', which was changed since bayes-rs wrote it: move it, or give another name"),
            (RUN_FILE, "holds 'run.json', which was changed since bayes-rs wrote it"),
            (NAMES[1], rf"holds '{NAMES[1]}', which was changed since bayes-rs wrote it"),
        ],
    )
    def test_what_we_did_not_write_is_refused_by_name(self, place, name, words):
        (finished(place) / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text("years of work")
        before = contents(place)
        for begin in (
            partial(BEGIN, place, overwrite=True),
            partial(OTHER, place, overwrite=True, resume=True),
            partial(output_folder, place, overwrite=True),
        ):
            with pytest.raises(InputError, match=f"Output folder '.*out' {words}"):
                begin().__enter__()
        with pytest.raises(InputError, match=words):
            check_output_folder(place, overwrite=True)
        assert contents(place) == before
        assert listed(place.parent) == ["out"]

    def test_a_strangers_folder_is_refused_whatever_it_holds(self, place):
        place.mkdir()
        (place / RUN_FILE).write_text('{"key": "k", "finished": false}')
        (place / "chapter.tex").write_text("years of work")
        for options in ({"overwrite": True}, {"overwrite": True, "resume": True}):
            with pytest.raises(
                InputError, match=r"was not made by bayes-rs \(it has no fingerprints.jsonl\), so it is"
            ):
                BEGIN(place, **options).__enter__()
        assert listed(place) == ["chapter.tex", RUN_FILE]

    def test_another_result_in_it_is_a_strangers(self, place):
        finished(place)
        finished(place / "nested")
        with pytest.raises(InputError, match=r"holds 'nested/fingerprints.jsonl', which bayes-rs did not write"):
            BEGIN(place, overwrite=True).__enter__()
        assert open_result_folder(place / "nested").damaged() == {}

    def test_an_empty_folder_is_replaced(self, place):
        place.mkdir()
        assert open_result_folder(finished(place, overwrite=True)).finished

    def test_a_file_that_appears_meanwhile_is_kept(self, place):
        finished(place)
        with (  # noqa: PT031 - the warning comes at the end
            pytest.warns(
                UserWarning, match=r"The earlier folder '.*out' is kept as '.*out.kept-.*': it holds 'notes.txt'"
            ),
            OTHER(place, overwrite=True) as folder,
        ):
            (place / "notes.txt").write_text("years of work")
            folder.write_text("note.txt", "second")
            folder.finish({})
        assert (place / "note.txt").read_text() == "second"
        (kept,) = place.parent.glob("out.kept-*")
        assert (kept / "notes.txt").read_text() == "years of work"
        assert (kept / "note.txt").read_text() == "first"
        assert len(listed(place.parent)) == 2

    def test_a_folder_in_the_way_is_not_touched(self, place):
        finished(place)
        finished(place.parent / "out.partial")  # a user's own, by that name
        before = contents(place.parent)
        with pytest.raises(InputError, match=r"out.partial' is in the way: the run that is to replace '.*out' writes"):
            BEGIN(place, overwrite=True).__enter__()
        assert contents(place.parent) == before

    def test_notes_in_the_folder_of_an_interrupted_overwriting(self, place):
        finished(place)
        with OTHER(place, overwrite=True) as folder:
            fill(folder)
        (partial_of(place) / "notes.txt").write_text("years of work")
        with pytest.raises(InputError, match=r"'.*out.partial' holds 'notes.txt', which bayes-rs did not write"):
            BEGIN(place, overwrite=True).__enter__()
        assert (partial_of(place) / "notes.txt").is_file()

    def test_a_report_goes_with_its_folder(self, place):
        (finished(place) / "report.html").write_text("page")
        list_beside(place / "report.html")
        found = open_result_folder(place)
        assert found.finished
        assert "report.html" not in found.names()
        (place / "report.html").unlink()  # it is not owed
        finished(place, resume=True)
        (place / "report.html").write_text("page")
        list_beside(place / "report.html")
        finished(place, OTHER, overwrite=True)
        assert not (place / "report.html").exists()

    def test_a_report_of_a_run_that_goes_on(self, place, monkeypatch):
        with BEGIN(place) as folder:
            fill(folder)
            (place / "report.html").write_text("page")
            monkeypatch.chdir(place)
            list_beside(Path("report.html"))
            folder.finish({})
        assert read_ledger(place).beside == {"report.html"}
        finished(place, OTHER, overwrite=True)

    def test_a_report_in_a_folder_of_folders(self, place):
        with output_folder(place) as folder:
            finished(folder / "first")
            write_run(folder, {})
        (place / "first" / "report.html").write_text("page")
        list_beside(place / "first" / "report.html")
        assert open_result_folder(place).damaged() == {}
        assert open_result_folder(place / "first").damaged() == {}
        with output_folder(place, overwrite=True) as folder:
            write_run(folder, {})
        assert listed(place) == [LEDGER, RUN_FILE]


class TestResuming:
    def test_another_run_is_refused_with_what_differs(self, place):
        finished(place)
        with pytest.raises(
            InputError, match=r"is of a run that differs in seed, so it cannot be resumed: give the same"
        ):
            OTHER(place, resume=True).__enter__()

    def test_it_goes_on_in_the_folder_that_is_to_replace_another(self, place):
        finished(place)
        with pytest.raises(ZeroDivisionError) as caught, OTHER(place, overwrite=True) as folder:  # noqa: PT012 - it fails amid its work
            fill(folder, NAMES[:2])
            raise ZeroDivisionError
        assert "is kept in" in caught.value.__notes__[0]
        assert "out.partial" in caught.value.__notes__[0]
        assert (place / "note.txt").read_text() == "first"
        with pytest.raises(InputError, match="exists, from a run of the same data and options: resume to go on"):
            OTHER(place).__enter__()
        with OTHER(place, resume=True) as folder:
            assert [folder.damage(name) is None for name in NAMES] == [True, True, False]
            fill(folder)
            folder.finish({})
        assert listed(place.parent) == ["out"]
        assert not (place / "note.txt").exists()

    def test_overwriting_anew_forgets_the_interrupted_one(self, place):
        finished(place)
        with OTHER(place, overwrite=True) as folder:
            fill(folder)
        with BEGIN(place, overwrite=True) as folder:
            assert folder.names() == [RUN_FILE]
            fill(folder)
            folder.finish({})
        assert listed(place.parent) == ["out"]

    def test_the_key_is_known_when_its_line_or_run_json_is_damaged(self, place):
        lines = (finished(place) / LEDGER).read_bytes()
        (place / LEDGER).write_bytes(b"x" + lines[1:])
        with BEGIN(place, resume=True) as folder:
            assert all(folder.damage(name) is None for name in NAMES)
            folder.finish({})
        (place / RUN_FILE).write_text("{}")
        finished(place, resume=True)
        (place / LEDGER).write_bytes(b"x" + lines[1:])
        (place / RUN_FILE).write_text("{}")
        with pytest.raises(InputError, match="exists: give another name"):
            BEGIN(place, resume=True).__enter__()

    def test_what_was_listed_and_has_no_name_yet_gets_it(self, place, monkeypatch):
        replace = Path.replace

        def killed(path, target):
            if Path(target).name == "note.txt":
                raise KeyboardInterrupt
            return replace(path, target)

        with BEGIN(place) as folder:
            fill(folder)
            folder.write_text("note.txt", "first")
        with pytest.raises(KeyboardInterrupt), BEGIN(place, resume=True) as folder:  # noqa: PT012 - it fails amid its work
            monkeypatch.setattr(Path, "replace", killed)
            folder.write_text("note.txt", "second")
        monkeypatch.undo()
        assert (place / "note.txt").read_text() == "first"
        with BEGIN(place, resume=True) as folder:
            assert folder.read("note.txt") == b"second"
            assert not list(place.rglob(f"{HALF}*"))
            folder.finish({})

    def test_what_its_successor_never_replaced_is_made_again(self, place):
        with BEGIN(place) as folder:
            folder.write_text("note.txt", "first")
            old = (place / "note.txt").read_bytes()
            folder.write_text("note.txt", "second")
        (place / "note.txt").write_bytes(old)
        with BEGIN(place, resume=True) as folder:
            assert folder.damage("note.txt") == "is missing"


class TestLinks:
    def test_the_folder_is_a_link(self, place):
        finished(place.parent / "elsewhere")
        place.symlink_to(place.parent / "elsewhere")
        for options in ({}, {"overwrite": True}, {"resume": True}):
            with pytest.raises(InputError, match=r"output folder '.*out': it is a link; give the folder itself"):
                BEGIN(place, **options).__enter__()

    @pytest.mark.parametrize("name", ["summary", NAMES[1], "note.txt", RUN_FILE, LEDGER])
    @pytest.mark.parametrize("options", [{"resume": True}, {"overwrite": True}])
    def test_a_link_in_the_folder(self, place, name, options):
        away = place.parent / "away"
        (finished(place) / name).rename(away)
        (place / name).symlink_to(away)
        before = contents(place.parent)
        words = rf"'{name}'.*is a link" if "resume" in options else rf"holds '{name}', which is a link"
        with pytest.raises(InputError, match=words):
            BEGIN(place, **options).__enter__()
        assert contents(place.parent) == before

    def test_a_link_that_comes_while_it_is_written(self, place):
        away = place.parent / "away"
        away.mkdir()
        words = r"'summary' in the output folder '.*out' is a link, which bayes-rs does not write through"
        with pytest.raises(InputError, match=words), BEGIN(place) as folder:  # noqa: PT012 - it fails amid its work
            (place / "summary").symlink_to(away)
            fill(folder)
        assert listed(away) == []

    def test_no_half_written_file_is_written_through_a_link(self, place):
        (place.parent / "thesis.txt").write_text("years of work")
        with BEGIN(place) as folder:
            (place / f"{HALF}note.txt").symlink_to(place.parent / "thesis.txt")
            folder.write_text("note.txt", "text")
        assert (place.parent / "thesis.txt").read_text() == "years of work"


class TestInputs:
    @pytest.mark.parametrize("how", ["plain", "relative", "dots", "link to it", "link in it", "folder"])
    def test_an_input_in_the_output(self, place, monkeypatch, how):
        finished(place)
        monkeypatch.chdir(place)
        given = place / "note.txt"
        if how == "relative":
            given = Path("note.txt")
        elif how == "dots":
            given = Path("summary/../../out/note.txt")
        elif how == "link to it":
            given = place.parent / "link.txt"
            given.symlink_to(place / "note.txt")
        elif how == "link in it":
            (place.parent / "data.txt").write_text("data")
            given = place / "data.txt"
            given.symlink_to(place.parent / "data.txt")
        elif how == "folder":
            given = place
        before = contents(place.parent)
        for options in ({"overwrite": True}, {"resume": True}):
            words = re.escape(f"Input {str(given)!r} lies in the output folder {str(place)!r}, which is to be written")
            with pytest.raises(InputError, match=words + ": give a copy that lies elsewhere"):
                BEGIN(place, inputs=[place.parent / "none.nc", given], **options).__enter__()
        with pytest.raises(InputError, match="lies in the output folder"):
            check_output_folder(place, overwrite=True, inputs=[given])
        assert contents(place.parent) == before

    def test_the_output_is_named_by_a_link_in_its_path(self, place):
        finished(place)
        (place.parent / "link").symlink_to(place.parent)
        with pytest.raises(InputError, match="lies in the output folder"):
            BEGIN(place.parent / "link" / "out", overwrite=True, inputs=[place / "note.txt"]).__enter__()

    def test_others_are_not_concerned(self, place):
        (place.parent / "data.txt").write_text("data")
        finished(place)
        finished(place, overwrite=True, inputs=[place.parent / "data.txt", "out2/none.nc"])


class TestKilled:
    """By the system, at every step: the old or the new result is whole, and the next run puts the rest in order."""

    SCRIPT = (
        "import os, signal, sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_result_folder as scene\n"
        "from pathlib import Path\n"
        "steps = iter(range(10**6))\n"
        "def dying(function, last):\n"
        "    def call(*arguments, **options):\n"
        "        if next(steps) == last:\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "        return function(*arguments, **options)\n"
        "    return call\n"
        "for step in map(int, sys.argv[2:]):  # forked before any thread is started\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        "        for name in ('replace', 'unlink', 'rmdir', 'mkdir', 'write_bytes', 'touch'):\n"
        "            setattr(Path, name, dying(getattr(Path, name), step))\n"
        "        for name in ('write', 'fsync'):\n"
        "            setattr(os, name, dying(getattr(os, name), step))\n"
        "        scene.finished(Path(sys.argv[1], str(step), 'out'), scene.OTHER, 'second', overwrite=True)\n"
        "        print(next(steps), flush=True)\n"
        "        os._exit(0)\n"
        "    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)\n"
    )

    def run(self, folder, steps):
        """Replace the result in the folder of each step, and be killed at it; return what was printed."""
        done = subprocess.run(  # noqa: S603 - our own script
            [sys.executable, "-c", self.SCRIPT, str(folder), *map(str, steps)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return [int(word) for word in done.stdout.split()]

    @pytest.mark.slow
    def test_at_every_step(self, tmp_path):
        whole = tmp_path / f"{10**5}" / "out"
        old = contents(finished(whole))
        shutil.copytree(whole, tmp_path / "copy")
        n_step, code = self.run(tmp_path, [10**5])
        assert code == 0
        new = contents(whole)
        for step in range(n_step):
            shutil.copytree(tmp_path / "copy", tmp_path / f"{step}" / "out")
        assert self.run(tmp_path, range(n_step)) == [-signal.SIGKILL] * n_step
        for step in range(n_step):
            place = tmp_path / f"{step}" / "out"
            if place.exists():
                assert contents(place) in (old, new, {**new, f"{HALF}partial": b""})
            else:
                assert contents(replaced_of(place)) == old
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                finished(place, OTHER, "second", resume=True, overwrite=True)
            assert contents(place) == new, step
            assert [name for name in listed(place.parent) if not name.startswith(".out")] == ["out"], step


class TestTwoProcesses:
    def test_the_second_is_told_and_spoils_nothing(self, place):
        finished(place)
        script = (
            "import sys\n"
            f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
            "import test_result_folder as scene\n"
            "with scene.OTHER(sys.argv[1], overwrite=True) as folder:\n"
            "    scene.fill(folder)\n"
            "    print('at work', flush=True)\n"
            "    sys.stdin.read()\n"
            "    folder.finish({})\n"
        )
        other = subprocess.Popen(  # noqa: S603 - our own script
            [sys.executable, "-c", script, str(place)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert other.stdout.readline() == "at work\n"
        for begin in (BEGIN, OTHER):
            for options in ({"resume": True}, {"overwrite": True}, {}):
                with pytest.raises(InputError, match=rf"is being written by another run \(process {other.pid} on "):
                    begin(place, **options).__enter__()
        assert open_result_folder(place).read("note.txt") == b"first"
        other.stdin.close()
        assert other.wait(timeout=60) == 0
        other.stdout.close()
        assert open_result_folder(place).damaged() == {}
        assert listed(place.parent) == ["out"]


class TestPlacesThatCannotBeWritten:
    def test_a_full_disk_while_a_file_is_written(self, place, monkeypatch):
        write = Path.write_bytes

        def writing(path, content):
            write(path, content[:30])
            raise FULL

        with pytest.raises(OSError, match="No space left"), BEGIN(place) as folder:  # noqa: PT012 - it fails amid its work
            fill(folder, NAMES[:2])
            monkeypatch.setattr(Path, "write_bytes", writing)
            fill(folder)
        monkeypatch.undo()
        found = open_result_folder(place)
        assert [name for name in found.names() if found.damage(name)] == []
        assert not list(place.rglob(f"{HALF}*"))
        finished(place, resume=True)

    def test_a_full_disk_while_the_list_is_written(self, place, monkeypatch):
        """Half a line would spoil the next one."""
        write = os.write

        def writing(number, line):
            monkeypatch.setattr(os, "write", failing)
            return write(number, line[:10])

        def failing(_number, _line):
            raise FULL

        with BEGIN(place) as folder:
            fill(folder, NAMES[:1])
            monkeypatch.setattr(os, "write", writing)
            with pytest.raises(OSError, match="No space left"):
                folder.write_text("note.txt", "first")
            monkeypatch.undo()
            assert listed(place) == [LEDGER, RUN_FILE, "summary"]
            folder.write_text("note.txt", "first")
            fill(folder)
            folder.finish({})
        assert open_result_folder(place).damaged() == {}

    def test_a_full_disk_at_the_end_of_overwriting(self, place, monkeypatch):
        old = contents(finished(place))
        with pytest.raises(OSError, match="No space left"), OTHER(place, overwrite=True) as folder:  # noqa: PT012 - it fails at the end
            fill(folder)
            folder.write_text("note.txt", "first")

            def full(_path, _content):
                raise FULL

            monkeypatch.setattr(Path, "write_bytes", full)
            folder.finish({})
        monkeypatch.undo()
        assert contents(place) == old
        finished(place, OTHER, resume=True)
        assert listed(place.parent) == ["out"]

    def test_a_place_that_cannot_be_written_is_named(self, tmp_path):
        (tmp_path / "file").write_text("text")
        with pytest.raises(InputError, match=r"output folder '.*file/out': File exists; give a folder that can be"):
            BEGIN(tmp_path / "file" / "out").__enter__()
        with pytest.raises(InputError, match=r"output folder '.*file': a file of that name exists; give another name"):
            BEGIN(tmp_path / "file", overwrite=True).__enter__()
        with pytest.raises(InputError, match=r"File name too long"):
            BEGIN(tmp_path / ("a" * 300)).__enter__()
        assert listed(tmp_path) == ["file"]

    def test_the_renaming_fails_at_the_end(self, place, monkeypatch):
        old = contents(finished(place))
        replace = Path.replace

        def refusing(path, target):
            if path == partial_of(place):
                raise OSError(errno.EROFS, os.strerror(errno.EROFS))
            return replace(path, target)

        words = "Read-only file system; give another name"
        with pytest.raises(InputError, match=words) as caught, OTHER(place, overwrite=True) as folder:  # noqa: PT012 - it fails at the end
            fill(folder)
            monkeypatch.setattr(Path, "replace", refusing)
            folder.finish({})
        assert "out.partial" in caught.value.__notes__[0]
        monkeypatch.undo()
        assert contents(place) == old
        with OTHER(place, resume=True) as folder:
            folder.finish({})
        assert listed(place.parent) == ["out"]


def test_many_files(place):
    """The list grows by a line a file, and is read once."""
    with BEGIN(place) as folder:
        for number in range(300):
            folder.write_text(f"a/{number}.txt", str(number))
        before = (place / LEDGER).stat().st_size
        folder.write_text("a/1.txt", "again")
        assert (place / LEDGER).stat().st_size - before < 200
        folder.finish({})
    assert len(open_result_folder(place).names("a/")) == 300
