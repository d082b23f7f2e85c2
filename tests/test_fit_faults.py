"""What may befall the folder of a fit: damage is named and made good, and what is not ours stays as it was."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import fit_scene
import folder_scene
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from fit_scene import NOISE, PART, SCAN

from bayes_rs import InputError, LostResultsError, fit, open_fit, save_scan
from bayes_rs.fits import fit_writing, plan
from bayes_rs.result_folder import open_result_folder

pytestmark = pytest.mark.slow
TESTS = Path(__file__).parent
N_RECORD = 11
TABLES = ("summary", "posterior", "draws", "predicted")
KEPT = {"summary.csv", "stresses.csv", "records.nc", "prior.parquet", "fit-key.json"}
OPTIONS = {"noise": NOISE, "seed": 3, "target_ess": 100, "sampler": "direct"}
RECORDS = fit_scene.make_records(N_RECORD)
run = partial(fit, RECORDS, SCAN, **OPTIONS)
KILLED = f"""
import os, sys
import distributed, h5netcdf, pyarrow.dataset, scipy.stats  # here, not in each child
sys.path.insert(0, {str(TESTS)!r})
from itertools import count
from pathlib import Path
import test_fit_faults as faults
from bayes_rs import result_folder
from bayes_rs.fits import plan

plan.PART_RECORDS = faults.PART
steps = count()


def dying(call, last):
    def called(*arguments, **options):
        if next(steps) == last:
            os._exit(9)
        return call(*arguments, **options)

    return called


output, overwrite, *numbers = sys.argv[1:]
for number in map(int, numbers):  # forked before any thread is started: the fits run in the children only
    child = os.fork()
    if child == 0:
        Path.replace = dying(Path.replace, number)
        result_folder.append_to_ledger = dying(result_folder.append_to_ledger, number)
        faults.run(output=f"{{output}}-{{number}}", overwrite=overwrite == "overwrite")
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(autouse=True)
def small_parts(monkeypatch, request):
    monkeypatch.setattr(plan, "PART_RECORDS", PART)
    if "made_with_groups" not in request.fixturenames:
        request.getfixturevalue("no_groups_file")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("made") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PART_RECORDS", PART)
        patch.setattr(fit_writing, "MOST_KEPT", 0)
        run(output=folder)
    return folder


@pytest.fixture(scope="module")
def made_with_groups(tmp_path_factory):
    """The same with `posterior.nc`."""
    folder = tmp_path_factory.mktemp("made-with-groups") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PART_RECORDS", PART)
        run(output=folder)
    return folder


@pytest.fixture
def place(made, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(made, tmp_path / "out"))


def contents(folder):
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def without_times(folder):
    """All files of a folder but the list of fingerprints, and its run without what tells how the work went."""
    files = contents(folder)
    del files["fingerprints.jsonl"]
    about = json.loads(files.pop("run.json"))
    return files, {name: value for name, value in about.items() if name not in ("seconds", "n_resumed")}


def check_whole(folder, made):
    """Check that a folder is that of the uninterrupted run, byte by byte but for the times of the work."""
    assert without_times(folder) == without_times(made)
    assert open_result_folder(folder).damaged() == {}
    assert open_result_folder(folder).finished


def read_everything(folder):
    """Read a fit as a user would."""
    found = open_fit(folder)
    found.summary()
    found.directions()
    found.draws()
    found.predicted_draws()
    _ = found.records, found.prior_draws


def tables_of(folder):
    return sorted(name for name in contents(folder) if name.split("/")[0] in TABLES)


def flip(file, at):
    """Flip a bit of the byte at a place of a file."""
    content = bytearray(file.read_bytes())
    content[at] ^= 16
    file.write_bytes(content)


class TestDamage:
    def test_flipped_bits_are_named_when_they_are_read(self, made, place):
        before = contents(made)
        names = tables_of(made)
        assert len(names) == 3 * len(TABLES)
        random = np.random.default_rng(6)
        for _ in range(100):
            name = names[random.integers(len(names))]
            content = bytearray(before[name])
            content[random.integers(len(content))] ^= 1 << random.integers(8)
            (place / name).write_bytes(content)
            words = f"File {str(place / name)!r} was changed since it was written: resume the fit to make it again."
            with pytest.raises(InputError, match=f"^{re.escape(words)}$"):
                read_everything(place)
            (place / name).write_bytes(before[name])
        read_everything(place)

    @pytest.mark.parametrize("name", [*TABLES, *sorted(KEPT), "run.json", "fingerprints.jsonl"])
    def test_a_flipped_bit_is_made_good_by_resuming(self, made, place, name):
        file = place / name if (place / name).is_file() else next((place / name).rglob("part-000001.parquet"))
        for at in np.random.default_rng(7).integers(file.stat().st_size, size=2).tolist():
            flip(file, at)
            run(output=place, resume=True)
            check_whole(place, made)

    def test_so_is_one_of_the_groups(self, made_with_groups, tmp_path):
        place = Path(shutil.copytree(made_with_groups, tmp_path / "out"))
        flip(place / "posterior.nc", 5000)
        run(output=place, resume=True)
        check_whole(place, made_with_groups)

    @pytest.mark.parametrize("name", TABLES)
    def test_a_valid_part_with_fewer_rows_is_made_again(self, made, place, name):
        (file,) = (place / name).rglob("part-000000.parquet")
        table = pq.read_table(file)
        pq.write_table(table.slice(0, len(table) - 6), file)
        with pytest.raises(InputError, match=r"part-000000.parquet' has \d+ bytes, and \d+ were written: resume the"):
            read_everything(place)
        assert run(output=place, resume=True).run["n_resumed"] == N_RECORD - PART
        check_whole(place, made)

    @pytest.mark.parametrize("name", TABLES)
    def test_a_part_of_another_schema_is_made_again(self, made, place, name):
        (file,) = (place / name).rglob("part-000002.parquet")
        table = pd.read_parquet(file)
        table.rename(columns={table.columns[-1]: "other"}).to_parquet(file, index=False)
        with pytest.raises(InputError, match=r"part-000002.parquet' .*: resume the fit to make it again"):
            read_everything(place)
        run(output=place, resume=True)
        check_whole(place, made)

    def test_a_part_of_another_run_is_no_part_of_this(self, made, place, tmp_path):
        """A sound file with other numbers."""
        run(output=tmp_path / "other", seed=4)
        for name in tables_of(made)[::4]:
            shutil.copy(tmp_path / "other" / name, place / name)
            with pytest.raises(InputError, match="resume the fit to make it again"):
                read_everything(place)
        run(output=place, resume=True)
        check_whole(place, made)


class TestMissing:
    """The end counts what it owes."""

    @contextmanager
    def spoiling(self, spoil):
        def fitting(shared, part):
            if part.index == 2:
                spoil()
            return fit_scene.FIT_PART(shared, part)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fit_writing, "fit_part", fitting)
            yield

    def test_a_part_is_deleted_while_the_run_goes_on(self, made, tmp_path):
        place = tmp_path / "out"
        part = "draws/month=2020-01/part-000000.parquet"
        words = (
            f"Output folder {str(place)!r} is not finished: 1 file that this run wrote cannot be used ({part} is "
            "missing); resume to make them again."
        )
        with self.spoiling((place / part).unlink), pytest.raises(LostResultsError, match=f"^{re.escape(words)}"):
            run(output=place)
        assert json.loads((place / "run.json").read_text())["finished"] is False
        with pytest.raises(InputError, match="has not ended"):
            open_fit(place)
        assert run(output=place, resume=True).run["n_resumed"] == N_RECORD - PART
        check_whole(place, made)

    @pytest.mark.parametrize("name", ["summary", "posterior", "predicted"])
    def test_a_part_of_another_table(self, made, tmp_path, name):
        place = tmp_path / "out"
        emptied = place / name / "month=2020-01" / "part-000001.parquet"
        words = rf"{name}/month=2020-01/part-000001.parquet has 0 bytes, and \d+"
        with self.spoiling(lambda: emptied.write_bytes(b"")), pytest.raises(LostResultsError, match=words):
            run(output=place)
        run(output=place, resume=True)
        check_whole(place, made)

    def test_the_folder_is_renamed_meanwhile(self, made, tmp_path):
        place, moved = tmp_path / "out", tmp_path / "moved"
        words = r"out' was moved or removed while a run was writing it: move it back"
        with self.spoiling(lambda: place.rename(moved)), pytest.raises(LostResultsError, match=words):
            run(output=place)
        assert not place.exists()
        assert json.loads((moved / "run.json").read_text())["finished"] is False
        moved.rename(place)
        assert run(output=place, resume=True).run["n_resumed"] == 2 * PART
        check_whole(place, made)

    def test_the_folder_of_files_is_renamed_meanwhile(self, tmp_path, monkeypatch):
        folder_scene.write_files(tmp_path / "year", folder_scene.make_series(), 2)
        folder_scene.write_noise(tmp_path / "noise.nc")
        monkeypatch.setattr(plan, "PART_RECORDS", 8)
        move = partial((tmp_path / "out").rename, tmp_path / "moved")
        words = "was moved or removed while a run was writing it"
        with self.spoiling(move), pytest.raises(LostResultsError, match=words):
            folder_scene.run(tmp_path / "year", tmp_path / "out", tmp_path / "noise.nc")


class TestOverwriting:
    def test_it_replaces_what_we_wrote(self, made, place):
        found = run(output=place, overwrite=True, seed=4, draws="none")
        assert found.settings["fit"]["seed"] == 4
        assert not (place / "draws").exists()
        assert [path.name for path in place.parent.iterdir()] == ["out"]
        run(output=place, overwrite=True)
        check_whole(place, made)

    @pytest.mark.parametrize(
        ("name", "spoil"),
        [
            ("notes.txt", lambda file: file.write_text("mine")),
            ("summary/notes.txt", lambda file: file.write_text("mine")),
            ("draws/month=2020-01/part-000009.parquet", lambda file: file.write_bytes(b"a stranger's")),
            ("summary.csv", lambda file: file.write_text(file.read_text() + "mine\n")),
            ("posterior/month=2020-01/part-000001.parquet", lambda file: file.write_bytes(file.read_bytes()[::-1])),
            ("run.json", lambda file: file.write_text(file.read_text().replace("weak", "mine"))),
        ],
    )
    def test_what_is_not_ours_is_refused_by_name(self, place, name, spoil):
        spoil(place / name)
        before = contents(place)
        with pytest.raises(InputError, match=re.escape(name)):
            run(output=place, overwrite=True, seed=4)
        assert contents(place) == before
        assert [path.name for path in place.parent.iterdir()] == ["out"]

    def test_a_strangers_folder_with_a_run_file_is_refused(self, place):
        (place / "fingerprints.jsonl").unlink()
        before = contents(place)
        with pytest.raises(InputError, match=r"was not made by bayes-rs|fingerprints.jsonl"):
            run(output=place, overwrite=True, seed=4)
        assert contents(place) == before

    def test_the_old_result_stays_until_the_new_one_is_whole(self, place, monkeypatch):
        before = contents(place)

        def interrupted(shared, part):
            if part.index == 2:
                raise KeyboardInterrupt
            return fit_scene.FIT_PART(shared, part)

        with monkeypatch.context() as patch:
            patch.setattr(fit_writing, "fit_part", interrupted)
            with pytest.raises(KeyboardInterrupt) as caught:
                run(output=place, overwrite=True, seed=4)
        assert f"{2 * PART} of {N_RECORD} records are finished and kept in" in caught.value.__notes__[0]
        assert contents(place) == before
        read_everything(place)
        found = run(output=place, resume=True, seed=4)
        assert found.run["n_resumed"] == 2 * PART
        assert found.settings["fit"]["seed"] == 4
        assert [path.name for path in place.parent.iterdir()] == ["out"]

    def test_an_input_in_the_output_folder(self, tmp_path):
        """Refused before anything is touched, for records as for radial velocities."""
        place = tmp_path / "out"
        folder_scene.write_files(place / "raw", folder_scene.make_series(), 2)
        folder_scene.write_noise(tmp_path / "noise.nc")
        before = contents(place)
        for options in ({}, {"overwrite": True}, {"resume": True}):
            with pytest.raises(InputError, match=r"raw|lies in"):
                folder_scene.run(place / "raw", place, tmp_path / "noise.nc", **options)
        assert contents(place) == before

    def test_the_records_of_a_fit_are_no_input_of_its_own_folder(self, place, tmp_path):
        NOISE.save(tmp_path / "noise.nc")
        save_scan(SCAN, tmp_path / "six.toml")
        before = contents(place)
        options = {"scan": str(tmp_path / "six.toml"), "overwrite": True, "duration": 600.0}
        with pytest.raises(InputError, match=r"records\.nc"):
            folder_scene.run(place / "records.nc", place, tmp_path / "noise.nc", **options)
        assert contents(place) == before


class TestLinks:
    @pytest.mark.parametrize("options", [{}, {"overwrite": True}, {"resume": True}])
    def test_the_folder_is_a_link(self, place, tmp_path, options):
        (tmp_path / "link").symlink_to(place)
        before = contents(place)
        with pytest.raises(InputError, match=r"it is a link; give the folder itself|link"):
            run(output=tmp_path / "link", **options)
        assert contents(place) == before

    @pytest.mark.parametrize("name", ["summary.csv", "posterior/month=2020-01/part-000001.parquet", "draws"])
    @pytest.mark.parametrize("options", [{"overwrite": True}, {"resume": True}])
    def test_a_link_in_the_folder_is_not_written_through(self, place, tmp_path, name, options):
        outside = tmp_path / "outside"
        (place / name).rename(outside)
        (place / name).symlink_to(outside)
        before = contents(outside) if outside.is_dir() else outside.read_bytes()
        with pytest.raises(InputError, match=f"{name}.* link|link.*{name}"):
            run(output=place, **options)
        assert (contents(outside) if outside.is_dir() else outside.read_bytes()) == before


def killed(output, *numbers, overwrite=False):
    """Run the fit once for each number, killed before so many steps of writing; return the exit codes."""
    words = [str(output), "overwrite" if overwrite else "", *map(str, numbers)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(  # noqa: S603 - our own script
        [sys.executable, "-c", KILLED, *words],
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
        env=environment,
    )
    codes = [int(code) for code in done.stdout.split()]
    assert len(codes) == len(numbers), done.stderr
    return codes


class TestKilled:
    """Each file is a line in the list and a name: some 50 steps of writing in all."""

    @pytest.mark.parametrize(
        "numbers",
        [[0, 2, 13, 34, 40, 42], pytest.param([1, 3, 5, 8, 14, 21, 28, 36, 38, 41], marks=pytest.mark.long)],
    )
    def test_at_any_step_of_writing(self, made_with_groups, tmp_path, numbers):
        codes = killed(tmp_path / "out", *numbers)
        assert codes.count(9) >= len(numbers) - 2
        for number in numbers:
            place = tmp_path / f"out-{number}"
            if place.exists() and not open_result_folder(place).finished:
                with pytest.raises(InputError, match="has not ended"):
                    open_fit(place)
            run(output=place, resume=True)
            check_whole(place, made_with_groups)

    @pytest.mark.parametrize("numbers", [[1, 33], pytest.param([4, 17, 39], marks=pytest.mark.long)])
    def test_while_an_older_result_is_replaced(self, made_with_groups, tmp_path, numbers):
        older = run(output=tmp_path / "older", seed=4).summary()
        for number in numbers:
            shutil.copytree(tmp_path / "older", tmp_path / f"out-{number}")
        assert set(killed(tmp_path / "out", *numbers, overwrite=True)) == {9}
        for number in numbers:
            place = tmp_path / f"out-{number}"
            pd.testing.assert_frame_equal(open_fit(place).summary(), older, check_exact=True)
            run(output=place, overwrite=True)
            check_whole(place, made_with_groups)


def test_signals_are_interrupts_too(made, tmp_path, monkeypatch):
    """Ctrl-C in the middle of a part: what was finished is kept, and resuming gives the same bytes."""

    def fitting(shared, part):
        if part.index == 1:
            signal.raise_signal(signal.SIGINT)
        return fit_scene.FIT_PART(shared, part)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it
    try:
        with monkeypatch.context() as patch:
            patch.setattr(fit_writing, "fit_part", fitting)
            with pytest.raises(KeyboardInterrupt) as caught:
                run(output=tmp_path / "out")
    finally:
        signal.signal(signal.SIGINT, handler)
    assert f"{PART} of {N_RECORD} records are finished and kept in" in caught.value.__notes__[0]
    assert run(output=tmp_path / "out", resume=True).run["n_resumed"] == PART
    check_whole(tmp_path / "out", made)
