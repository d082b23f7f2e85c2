"""Places where nothing can be written, and names that nobody expects."""

import os
import tempfile
import traceback
from pathlib import Path

import pytest
from fault_scenes import RECORDS, complaint, run
from scenes import plain_noise

from bayes_rs import InputError, load_scan, save_scan
from bayes_rs.noise.file import load_noise
from bayes_rs.output import output_file, output_folder, write_run

SCAN = load_scan("2-beam")
NAMES = ["two\nlines", "quote ' and \"", "-o", "=1+1", "ä" * 120, "x" * 250, "$\\frac{$", "%s {0}", " blank ", "\udcff"]


@pytest.mark.parametrize("name", NAMES)
def test_names(tmp_path, name):
    with output_file(tmp_path / name) as part:
        part.write_text("whole")
    assert (tmp_path / name).read_text() == "whole"
    with output_folder(tmp_path / "folder" / name) as folder:
        write_run(folder, {"name": name})
    with output_folder(tmp_path / "folder" / name, overwrite=True) as folder:
        write_run(folder, {"name": name})
    assert [place.name for place in (tmp_path / "folder").iterdir()] == [name]


def test_a_name_with_nul(tmp_path):
    with pytest.raises(ValueError, match=r"null (byte|character)"):
        output_file(tmp_path / "a\0b").__enter__()
    assert list(tmp_path.iterdir()) == []


def test_a_link_to_a_file_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "thesis.nc").write_text("years of work")
    (tmp_path / "noise.nc").symlink_to(tmp_path / "thesis.nc")
    plain_noise(SCAN).save(tmp_path / "noise.nc", overwrite=True)
    assert (tmp_path / "thesis.nc").read_text() == "years of work"
    assert load_noise(tmp_path / "noise.nc").n_beam == 2


def test_a_link_to_a_folder_is_refused(tmp_path):
    with output_folder(tmp_path / "run") as folder:
        write_run(folder, {})
    (tmp_path / "out").symlink_to(tmp_path / "run")
    with pytest.raises(InputError, match="it is a link; give the folder itself"):
        output_folder(tmp_path / "out", overwrite=True).__enter__()
    assert (tmp_path / "run" / "run.json").is_file()


def as_somebody_else(work):
    """Do it as a user who is not root, for whom permissions count; the exit code of the process that did it."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            if os.getuid() == 0:
                os.setuid(65534)
            code = work()
        except BaseException:  # noqa: BLE001 - the parent sees only the code
            traceback.print_exc()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize(
    "write",
    [
        lambda place: plain_noise(SCAN).save(place / "noise.nc"),
        lambda place: save_scan(SCAN, place / "mine.toml"),
        lambda place: output_folder(place / "out").__enter__(),
    ],
)
def test_a_folder_that_is_read_only(tmp_path, write):
    (tmp_path / "first").mkdir()
    write(tmp_path / "first")  # loads what it needs, which the other user may not be able to
    place = tmp_path / "place"
    place.mkdir()
    place.chmod(0o555)
    top = Path(tempfile.gettempdir())
    for above in (tmp_path, *(one for one in tmp_path.parents if one != top and one.is_relative_to(top))):
        above.chmod(above.stat().st_mode | 0o055)

    def work():
        try:
            write(place)
        except InputError as error:
            return 0 if "Cannot write" in str(error) and "Permission denied" in str(error) else 3
        return 2

    assert as_somebody_else(work) == 0
    assert list(place.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("file/out.nc", "Cannot write 'file/out.nc': File exists"),
        ("/proc/out.nc", "Cannot write '/proc/out.nc'"),
        ("cache", "it is a folder"),
    ],
)
def test_commands_say_it_in_one_line(tmp_path, output, words):
    (tmp_path / "file").write_text("text")
    (tmp_path / "cache").mkdir()
    code, errors = run(*RECORDS, "-o", output, folder=tmp_path)
    assert code == 2
    (line,) = complaint(errors)
    assert words in line
    assert (tmp_path / "file").read_text() == "text"
