"""Output: whole or not at all, and never over something that was there."""

import errno
import os
import stat
from pathlib import Path

import pytest

from bayes_rs import InputError
from bayes_rs.ledger import LEDGER
from bayes_rs.output import output_file, output_folder, write_run
from bayes_rs.result_folder import RUN_FILE


def partials(folder):
    return sorted(folder.glob("*.partial-*"))


def earlier_run(folder, text="earlier"):
    with output_folder(folder) as part:
        (part / "summary.csv").write_text(text)
        write_run(part, {"seed": 1})
    return folder


@pytest.fixture
def regular_file(tmp_path):
    """A regular file where a folder is wanted: what even root cannot write in."""
    file = tmp_path / "file"
    file.write_text("text")
    return file


def refuse(code):
    def refusing(*_args, **_options):
        raise OSError(code, os.strerror(code))

    return refusing


class TestFolder:
    def test_the_name_appears_only_when_everything_is_written(self, tmp_path):
        final = tmp_path / "out"
        with output_folder(final) as folder:
            (folder / "a.txt").write_text("a")
            assert not final.exists()
            assert folder.parent == tmp_path  # on the same file system: the last step is a renaming
        assert (final / "a.txt").read_text() == "a"
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_parents_are_made(self, tmp_path):
        with output_folder(tmp_path / "a" / "b" / "out") as folder:
            (folder / "a.txt").write_text("a")
        assert (tmp_path / "a" / "b" / "out" / "a.txt").is_file()

    def test_permissions_are_those_of_any_new_folder(self, tmp_path):
        before = os.umask(0o027)
        try:
            with output_folder(tmp_path / "out") as folder:
                (folder / "a.txt").write_text("a")
        finally:
            after = os.umask(before)
        assert after == 0o027  # nothing is left changed
        assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750
        assert stat.S_IMODE((tmp_path / "out" / "a.txt").stat().st_mode) == 0o640

    def test_an_existing_folder_is_refused_and_kept(self, tmp_path):
        final = earlier_run(tmp_path / "out")
        with pytest.raises(InputError, match=r"Output folder '.*out' exists: give another name, or overwrite it"):
            output_folder(final).__enter__()
        assert (final / "summary.csv").read_text() == "earlier"
        assert partials(tmp_path) == []

    def test_an_empty_folder_is_refused_too(self, tmp_path):
        (tmp_path / "out").mkdir()
        with pytest.raises(InputError, match=r"exists: give another name, or overwrite it"):
            output_folder(tmp_path / "out").__enter__()

    def test_overwrite_replaces_an_earlier_run_whole(self, tmp_path):
        final = earlier_run(tmp_path / "out")
        with output_folder(final, overwrite=True) as folder:
            (folder / "new.txt").write_text("new")
            assert (final / "summary.csv").read_text() == "earlier"  # until the new one is complete
        assert sorted(path.name for path in final.iterdir()) == [LEDGER, "new.txt"]
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_overwrite_replaces_an_empty_folder(self, tmp_path):
        (tmp_path / "out").mkdir()
        with output_folder(tmp_path / "out", overwrite=True) as folder:
            (folder / "new.txt").write_text("new")
        assert (tmp_path / "out" / "new.txt").is_file()

    def test_overwrite_never_replaces_a_folder_that_is_not_ours(self, tmp_path):
        final = tmp_path / "thesis"
        final.mkdir()
        (final / "chapter.tex").write_text("years of work")
        message = rf"Output folder '.*thesis' was not made by bayes-rs \(it has no {LEDGER}\), so it is not replaced"
        with pytest.raises(InputError, match=message):
            output_folder(final, overwrite=True).__enter__()
        assert (final / "chapter.tex").read_text() == "years of work"

    def test_a_folder_that_appears_meanwhile_is_not_removed(self, tmp_path):
        """A fit takes minutes: another run of the same name may end first."""
        final = tmp_path / "out"
        with pytest.raises(InputError, match="exists"), output_folder(final) as folder:  # noqa: PT012 - it fails at the end of the block
            (folder / "second.txt").write_text("second")
            earlier_run(final, "first")
        assert (final / "summary.csv").read_text() == "first"
        assert [path.name for path in partials(tmp_path)[0].iterdir()] == ["second.txt"]

    def test_a_file_of_that_name_is_refused(self, regular_file):
        for overwrite in (False, True):
            with pytest.raises(InputError, match=r"output folder '.*file': a file of that name exists; give another"):
                output_folder(regular_file, overwrite=overwrite).__enter__()
        assert regular_file.read_text() == "text"

    @pytest.mark.parametrize("below", ["out", "a/out"])
    def test_a_place_that_cannot_be_written_is_named(self, regular_file, below):
        message = r"Cannot write the output folder '.*file/.*out': .*; give a folder that can be written\."
        with pytest.raises(InputError, match=message):
            output_folder(regular_file / below).__enter__()

    def test_the_system_says_why_it_cannot_be_written(self, tmp_path, monkeypatch):
        monkeypatch.setattr("tempfile.mkdtemp", refuse(errno.EACCES))
        message = r"Cannot write the output folder '.*out': Permission denied; give a folder that can be written\."
        with pytest.raises(InputError, match=message):
            output_folder(tmp_path / "out").__enter__()
        assert list(tmp_path.iterdir()) == []

    def test_a_name_that_is_too_long_is_refused(self, tmp_path):
        with pytest.raises(InputError, match=r"Cannot write the output folder .*: File name too long; give"):
            output_folder(tmp_path / ("a" * 300)).__enter__()
        with pytest.raises(InputError, match=r"Cannot write '.*: File name too long; give"):
            output_file(tmp_path / ("a" * 300)).__enter__()
        assert list(tmp_path.iterdir()) == []


class TestFailureInsideTheBlock:
    @pytest.mark.parametrize("error", [ValueError("bad"), OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
    def test_what_was_written_is_kept_and_the_error_says_where(self, tmp_path, error):
        final = tmp_path / "out"
        with pytest.raises(type(error)) as caught, output_folder(final) as folder:  # noqa: PT012 - it fails at the end of the block
            (folder / "posterior.nc").write_text("hours of sampling")
            raise error
        assert caught.value is error
        assert not final.exists()
        (part,) = partials(tmp_path)
        assert (part / "posterior.nc").read_text() == "hours of sampling"
        assert caught.value.__notes__ == [f"What was finished is kept in {str(part)!r}."]

    def test_nothing_is_kept_where_nothing_was_written(self, tmp_path):
        with pytest.raises(ValueError, match="bad") as caught, output_folder(tmp_path / "out"):
            raise ValueError("bad")
        assert list(tmp_path.iterdir()) == []
        assert not hasattr(caught.value, "__notes__")

    def test_the_earlier_run_is_still_there(self, tmp_path):
        final = earlier_run(tmp_path / "out")
        with pytest.raises(ValueError, match="bad"), output_folder(final, overwrite=True) as folder:  # noqa: PT012 - it fails at the end of the block
            (folder / "new.txt").write_text("new")
            raise ValueError("bad")
        assert (final / "summary.csv").read_text() == "earlier"


class TestFile:
    def test_the_name_appears_only_when_it_is_written(self, tmp_path):
        final = tmp_path / "deep" / "a.txt"
        with output_file(final) as part:
            part.write_text("a")
            assert part.suffix == ".txt"  # writers choose the format by it
            assert not final.exists()
        assert final.read_text() == "a"
        assert list(final.parent.iterdir()) == [final]

    def test_permissions_are_those_of_any_new_file(self, tmp_path):
        before = os.umask(0o022)
        try:
            with output_file(tmp_path / "a.txt") as part:
                part.write_text("a")
        finally:
            os.umask(before)
        assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o644

    def test_an_existing_file_is_refused_and_kept(self, regular_file):
        with pytest.raises(InputError, match=r"File '.*file' exists: give another name, or overwrite it"):
            output_file(regular_file).__enter__()
        assert regular_file.read_text() == "text"

    def test_overwrite_replaces_it(self, regular_file):
        with output_file(regular_file, overwrite=True) as part:
            part.write_text("new")
        assert regular_file.read_text() == "new"

    def test_a_folder_of_that_name_is_refused(self, tmp_path):
        for overwrite in (False, True):
            with pytest.raises(InputError, match=r"Cannot write '.*': it is a folder; give the name of a file"):
                output_file(tmp_path, overwrite=overwrite).__enter__()

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
    def test_a_device_or_a_pipe_is_not_replaced(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        with (
            pytest.raises(
                InputError, match=r"^Cannot write '.*pipe': it is a device or a pipe; give the name of a file"
            ),
            output_file(tmp_path / "pipe", overwrite=True),
        ):
            pass
        assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)

    def test_a_failure_leaves_nothing_and_keeps_what_was_there(self, regular_file):
        with pytest.raises(ValueError, match="bad"), output_file(regular_file, overwrite=True) as part:  # noqa: PT012 - it fails at the end of the block
            part.write_text("half")
            raise ValueError("bad")
        assert regular_file.read_text() == "text"
        assert list(regular_file.parent.iterdir()) == [regular_file]

    @pytest.mark.parametrize("writing", [output_file, output_folder])
    def test_a_failure_leaves_no_folder_above_it(self, writing, tmp_path):
        (tmp_path / "there").mkdir()
        with pytest.raises(ValueError, match="bad"), writing(tmp_path / "there" / "new" / "deep" / "x"):
            raise ValueError("bad")
        assert list(tmp_path.iterdir()) == [tmp_path / "there"]
        assert not list((tmp_path / "there").iterdir())

    def test_a_folder_above_it_that_holds_something_stays(self, tmp_path):
        with pytest.raises(ValueError, match="bad"), output_file(tmp_path / "new" / "deep" / "x.txt"):  # noqa: PT012 - it fails at the end of the block
            (tmp_path / "new" / "other.txt").write_text("of someone else")
            raise ValueError("bad")
        assert [path.name for path in (tmp_path / "new").iterdir()] == ["other.txt"]

    def test_a_place_that_cannot_be_written_is_named(self, regular_file):
        message = r"Cannot write '.*file/a.txt': .*; give a place that can be written\."
        with pytest.raises(InputError, match=message):
            output_file(regular_file / "a.txt").__enter__()

    def test_the_system_says_why_it_cannot_be_written(self, tmp_path, monkeypatch):
        monkeypatch.setattr(Path, "replace", refuse(errno.EROFS))
        message = r"Cannot write '.*a.txt': Read-only file system; give a place that can be written\."
        with pytest.raises(InputError, match=message), output_file(tmp_path / "a.txt") as part:
            part.write_text("a")


class TestRunFile:
    def test_it_is_json_that_any_reader_takes(self, tmp_path):
        with pytest.raises(ValueError, match="not JSON compliant"):
            write_run(tmp_path, {"a": float("nan")})

    def test_it_is_replaced_with_the_folder(self, tmp_path):
        with output_folder(tmp_path / "out") as folder:
            write_run(folder, {"seed": 1})
        with output_folder(tmp_path / "out", overwrite=True) as folder:
            write_run(folder, {"seed": 2})
        assert '"seed": 2' in (tmp_path / "out" / RUN_FILE).read_text()
