"""Records of many files that are kept: what is damaged is read again, what is whole is not, numbers are the same."""

import itertools
import logging
import re

import numpy as np
import pytest
import xarray as xr

from bayes_rs import InputError
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.geometry import load_scan
from bayes_rs.readers import FileOptions, read
from bayes_rs.records import make_records, record_store, store_records
from bayes_rs.result_folder import open_result_folder

SCAN = load_scan("2-beam")
MAKING = {"duration": 60.0, "min_availability": 0.1}
SKIP = FileOptions(on_bad_file="skip")


def kept(tmp_path, key="k"):
    return begin_result_folder(tmp_path / "kept", key=key, key_parts={"key": key}, resume=True)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Three files of two minutes each; every file makes a part of its own."""
    monkeypatch.setattr(record_store, "SAVE_SECONDS", 0.0)
    folder, rng = tmp_path / "files", np.random.default_rng(1)
    folder.mkdir()
    for number in range(3):
        start = np.datetime64("2024-01-01T00:00:00", "ms") + np.timedelta64(120 * number, "s")
        rows = [
            f"{start + np.timedelta64(500 * step, 'ms')},{step % 2},{value:.3f}"
            for step, value in enumerate(rng.normal(-9.0, 1.0, 240))
        ]
        (folder / f"{number}.csv").write_text("time,beam,radial_velocity\n" + "\n".join(rows) + "\n")
    return folder


@pytest.fixture
def store(tmp_path):
    """Return what makes the records again with what the folder keeps, and the lines that it says."""

    def make(files, **options):
        said = []
        with kept(tmp_path) as folder:
            return store_records(files, SCAN, folder, say=said.append, **{**MAKING, **options}), said

    return make


def test_the_records_are_those_of_all_files_together(files, store):
    found, said = store(files)
    whole = make_records(read(files, SCAN), SCAN, **MAKING)
    for name in whole.data_vars:
        np.testing.assert_array_equal(found.records[name], whole[name])
    assert (found.n_file, found.n_resumed, said) == (3, 0, [])


def test_what_is_whole_is_not_read_again(files, store):
    first, _ = store(files)
    again, said = store(files)
    assert (again.n_resumed, said) == (3, [])
    xr.testing.assert_identical(again.records, first.records)


def flip(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(bytes(content))


def cut(file):
    file.write_bytes(file.read_bytes()[:-1])


def foreign(file):
    """Put another part in its place: a sound file, with other numbers."""
    other = next(part for part in sorted(file.parent.glob("part-*.nc")) if part != file)
    file.write_bytes(other.read_bytes())


DAMAGES = {"a bit": flip, "cut": cut, "empty": lambda file: file.write_bytes(b""), "gone": lambda file: file.unlink()}


class TestDamage:
    """Law: whatever befalls what is kept, the records stay the same, and one line says that files are read again."""

    @pytest.mark.parametrize("damage", [*DAMAGES.values(), foreign], ids=[*DAMAGES, "foreign"])
    @pytest.mark.parametrize("index", [0, 1])
    def test_of_a_part(self, files, store, tmp_path, damage, index):
        first, _ = store(files)
        damage(tmp_path / "kept" / "records" / f"part-{index:06d}.nc")
        again, said = store(files)
        xr.testing.assert_identical(again.records, first.records)
        assert again.n_resumed == 0
        (line,) = said
        assert line.startswith("What an earlier run made of the files is not used, and all are read again: File ")
        assert f"part-{index:06d}.nc" in line

    @pytest.mark.parametrize("damage", [flip, cut, lambda file: file.write_bytes(b"")], ids=["a bit", "cut", "empty"])
    def test_of_the_state(self, files, store, tmp_path, damage):
        first, _ = store(files)
        damage(tmp_path / "kept" / "records" / "state.npz")
        again, said = store(files)
        xr.testing.assert_identical(again.records, first.records)
        assert len(said) == 1
        assert re.search(r"state\.npz' (was changed since it was written|has \d+ bytes, and \d+ were written)", said[0])

    def test_any_byte_of_the_state(self, files, store, tmp_path):
        store(files)
        state = tmp_path / "kept" / "records" / "state.npz"
        content = state.read_bytes()
        for place in np.linspace(0, len(content) - 1, 60).astype(int):
            changed = bytearray(content)
            changed[place] ^= 4
            state.write_bytes(bytes(changed))
            said = []
            assert record_store.load_state(open_result_folder(tmp_path / "kept"), said.append).files == {}
            assert "state.npz' was changed since it was written" in said[0]

    def test_while_the_files_are_read(self, files, store, monkeypatch):
        """A part that is damaged after it was written is found at the end, and all is read again."""
        expected = make_records(read(files, SCAN), SCAN, **MAKING)
        save, calls = record_store._save, itertools.count()

        def damaging(folder, *arguments):
            done = save(folder, *arguments)
            if next(calls) == 2:
                flip(folder.path / "records" / "part-000000.nc")
            return done

        monkeypatch.setattr(record_store, "_save", damaging)
        found, said = store(files)
        np.testing.assert_array_equal(found.records["variance"], expected["variance"])
        assert "was damaged meanwhile: all files are read again" in said[0]

    def test_a_disk_that_loses_everything(self, files, store, monkeypatch):
        save = record_store._save

        def damaging(folder, *arguments):
            done = save(folder, *arguments)
            for part in folder.path.glob("records/part-*.nc"):
                flip(part)
            return done

        monkeypatch.setattr(record_store, "_save", damaging)
        with pytest.raises(InputError, match="do not stay as they were written: check the disk"):
            store(files)

    def test_it_is_logged_by_default(self, files, store, tmp_path, caplog):
        store(files)
        flip(tmp_path / "kept" / "records" / "part-000000.nc")
        with caplog.at_level(logging.WARNING), kept(tmp_path) as folder:
            store_records(files, SCAN, folder, **MAKING)
        assert "and all are read again" in caplog.text


def test_what_was_made_with_other_options_is_refused_by_the_folder(files, store, tmp_path):
    """The folder's key holds the options: see `TestInterruptions.test_other_options_are_refused` of test_fit_files."""
    store(files)
    with pytest.raises(InputError, match="is of a run that differs in key"), kept(tmp_path, key="other"):
        pytest.fail("nothing is to be done")


def test_what_no_number_depends_on_may_differ(files, store):
    store(files)
    found, said = store(files, chunk_rows=17, reading=SKIP)
    assert (found.n_resumed, said) == (3, [])


class TestBadFiles:
    @pytest.fixture
    def bad(self, files):
        file = files / "1.csv"
        file.write_text(file.read_text() + "2024-01-01T01:00:00,0,fast\n")
        return files

    def test_error(self, bad, store):
        with pytest.raises(InputError, match=r"Invalid radial_velocity 'fast' in .* of file '.*1.csv'"):
            store(bad)

    def test_skip(self, bad, store):
        found, _ = store(bad, reading=SKIP)
        assert [file.rpartition("/")[2] for file in found.bad_files] == ["1.csv"]
        whole = make_records(read([bad / "0.csv", bad / "2.csv"], SCAN), SCAN, **MAKING)
        np.testing.assert_array_equal(found.records["variance"], whole["variance"])

    def test_error_after_a_run_that_skipped(self, bad, store):
        store(bad, reading=SKIP)
        with pytest.raises(InputError, match="Invalid radial_velocity 'fast'"):
            store(bad)

    def test_a_library_error(self, files, store, monkeypatch):
        """What a library raises for a file that is not what it should be names the file, too."""

        def failing(*_arguments, **_options):
            raise ValueError("no such thing")
            yield

        monkeypatch.setattr(record_store, "stream_files", failing)
        with pytest.raises(InputError, match=r"File '.*0.csv' cannot be used: ValueError: no such thing"):
            store(files)
