"""The cache of noise: whatever is in it or happens to it, the numbers are right, or are calculated again."""

import hashlib
import logging
import multiprocessing
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scenes import plain_noise

from bayes_rs import InputError, MannTurbulence, load_scan
from bayes_rs.noise import at_states, store
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.sealed import save_dataset

SCAN = load_scan("2-beam")
FLOW = MannTurbulence(dissipation=0.04, length_scale=40.0, gamma=2.5)


def make(cache):
    return calibrate(SCAN, FLOW, wind_speed=9.0, duration=60.0, cache=cache)


def same(one, other):
    arrays = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("bias", "gain", "covariance"))
    return arrays and one.turbulence == other.turbulence and one.scan_geometry == other.scan_geometry


@pytest.fixture(scope="module")
def right():
    return make(False)


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache")
    make(folder)
    (file,) = folder.iterdir()
    return file


@pytest.fixture
def file(entry, tmp_path):
    return Path(shutil.copy(entry, tmp_path / entry.name))


@pytest.fixture
def counted(monkeypatch):
    """How often noise was calculated."""

    made = []
    original = at_states.theory_at_states
    monkeypatch.setattr(at_states, "theory_at_states", lambda *a, **o: made.append(1) or original(*a, **o))
    return made


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system knows no owners by number")
class TestOfOthers:
    """A fingerprint is no signature: who can write a file can write one that fits."""

    @pytest.mark.parametrize("mode", [0o666, 0o620, 0o602])
    def test_an_entry_that_others_may_write(self, file, right, counted, caplog, mode):
        file.chmod(mode)
        with caplog.at_level(logging.WARNING):
            assert same(make(file.parent), right)
        assert counted == [1]
        assert "is not believed, others may write it, and is calculated again" in caplog.text
        assert same(make(file.parent), right)  # ours is in its place now
        assert counted == [1]

    def test_an_entry_of_another_user(self, file, right, counted, caplog, monkeypatch):
        if os.geteuid() == 0:
            os.chown(file, 54321, -1)
        else:
            monkeypatch.setattr(os, "geteuid", lambda: 54321)
        with caplog.at_level(logging.WARNING):
            assert same(make(file.parent), right)
        assert counted == [1]
        assert "is not believed, it belongs to another user" in caplog.text

    def test_whatever_the_mask_says_our_own_are_believed(self, tmp_path, counted):
        before = os.umask(0)
        try:
            make(tmp_path / "cache")
            make(tmp_path / "cache")
        finally:
            os.umask(before)
        assert counted == [1]

    def test_the_administrator_s_are_believed(self, file, right, counted, monkeypatch):
        monkeypatch.setattr(os, "geteuid", lambda: 54321)
        if os.stat(file).st_uid == 0:  # noqa: PTH116 - the owner that this process could give it
            assert same(make(file.parent), right)
            assert counted == []


class TestDamage:
    def test_a_whole_entry_is_used(self, file, right, counted):
        assert same(make(file.parent), right)
        assert counted == []

    @pytest.mark.parametrize("seed", range(4))
    def test_a_flipped_bit(self, file, right, counted, seed):
        """HDF5 has no fingerprint of small data: such a bit gives other numbers, or a search without an end."""
        content, rng = bytearray(file.read_bytes()), np.random.default_rng(seed)
        content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
        assert same(make(file.parent), right)
        assert counted == [1]
        assert same(make(file.parent), right)  # and the entry is mended
        assert counted == [1]

    def test_every_flipped_bit_is_seen_before_hdf5_reads_it(self, file, monkeypatch):
        monkeypatch.setattr(store, "read_noise", None)
        content, rng = file.read_bytes(), np.random.default_rng(5)
        for _ in range(300):
            changed = bytearray(content)
            changed[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(changed)
            assert store.from_cache(file, file.stem)[0] is None

    @pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99, 0.999])
    def test_a_truncated_entry(self, file, right, counted, caplog, share):
        content = file.read_bytes()
        file.write_bytes(content[: int(share * len(content))])
        with caplog.at_level(logging.WARNING):
            assert same(make(file.parent), right)
        assert counted == [1]
        assert "is damaged and is calculated again: it is not whole, or of an older version" in caplog.text

    def test_an_impossible_noise_whose_fingerprint_fits(self, file, right, counted, caplog):
        dataset = load_noise(file).to_dataset()
        dataset["covariance"] = dataset["covariance"] * 1e6
        save_dataset(dataset, file, overwrite=True)
        file.chmod(0o600)
        with caplog.at_level(logging.WARNING):
            assert same(make(file.parent), right)
        assert counted == [1]
        assert "it must be between 0 and 100" in caplog.text

    def test_an_entry_of_an_older_version(self, file, right, counted):
        """Entries once had no fingerprint at their end."""
        content = file.read_bytes()
        file.write_bytes(content[: content.rindex(b"\nbayes_rs sha256 ")])
        assert same(make(file.parent), right)
        assert counted == [1]

    def test_an_entry_of_another_format_version(self, file, right, counted, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr("bayes_rs.noise.layout.FILE_VERSION", 0)
            load_noise(file).save(file, overwrite=True)
        with pytest.raises(InputError, match="has format version 0 and this program reads 1: calibrate again"):
            load_noise(file)
        assert same(make(file.parent), right)
        assert counted == [1]

    def test_numbers_of_an_older_version_have_another_name(self, right, tmp_path, monkeypatch, counted):
        with monkeypatch.context() as patch:
            patch.setattr("bayes_rs.noise.at_states.NOISE_VERSION", -1)
            make(tmp_path)
        assert same(make(tmp_path), right)
        assert counted == [1, 1]
        assert len(list(tmp_path.iterdir())) == 2

    def test_an_entry_with_the_name_of_another(self, file, right, counted, caplog):
        plain_noise(SCAN).save(file, overwrite=True)
        assert same(make(file.parent), right)
        assert counted == [1]
        assert "belongs to another key" in caplog.text

    def test_a_folder_with_the_name_of_an_entry(self, file, right):
        file.unlink()
        file.mkdir()
        assert same(make(file.parent), right)

    def test_a_sealed_file_that_is_not_netcdf(self, file, right, counted):
        content = b"not NetCDF"
        file.write_bytes(content + b"\nbayes_rs sha256 " + hashlib.sha256(content).hexdigest().encode())
        assert same(make(file.parent), right)
        assert counted == [1]


class TestUsersFiles:
    def test_a_changed_noise_file_is_refused(self, file):
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        with pytest.raises(InputError, match="is damaged: it was changed since it was written; calibrate again"):
            load_noise(file)

    def test_other_programs_read_the_file(self, file):
        assert xr.load_dataset(file, engine="h5netcdf").attrs["kind"] == "bayes_rs noise"


class TestPlaces:
    def test_the_cache_is_a_file(self, tmp_path, right, caplog):
        (tmp_path / "cache").write_text("text")
        assert same(make(tmp_path / "cache"), right)
        assert "The noise cannot be cached" in caplog.text
        assert (tmp_path / "cache").read_text() == "text"

    def test_the_cache_cannot_be_written_nor_searched(self, tmp_path, right):
        """Root may do all: the test goes on as somebody else."""
        (tmp_path / "cache").mkdir(mode=0o000)
        for above in (tmp_path, *tmp_path.parents[:3]):
            if above.stat().st_uid == os.getuid() and above != Path("/tmp"):  # noqa: S108 - a name to compare with
                above.chmod(above.stat().st_mode | 0o055)
        child = os.fork()
        if child == 0:
            code = 1
            try:
                if os.getuid() == 0:
                    os.setuid(65534)
                code = 0 if same(make(tmp_path / "cache"), right) else 2
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        (tmp_path / "cache").chmod(0o755)
        assert list((tmp_path / "cache").iterdir()) == []


def _make_many(cache, queue):
    found = []
    for _ in range(4):
        noise = make(cache)
        found.append(noise.covariance[0].tobytes() + noise.bias[0].tobytes())
        for file in Path(cache).glob("*.nc"):
            try:
                load_noise(file)  # whole at any moment
            except InputError as error:  # unless another process has taken it away
                cause: BaseException = error
                while cause.__cause__ is not None:
                    cause = cause.__cause__
                if not isinstance(cause, FileNotFoundError):
                    raise
            file.unlink(missing_ok=True)
    queue.put(found)


def test_processes_that_write_one_entry_at_once(tmp_path, right):
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    others = [context.Process(target=_make_many, args=(tmp_path, queue)) for _ in range(3)]
    for other in others:
        other.start()
    found = [queue.get(timeout=100) for _ in others]
    for other in others:
        other.join()
        assert other.exitcode == 0
    assert {one for many in found for one in many} == {right.covariance[0].tobytes() + right.bias[0].tobytes()}
    assert [file for file in tmp_path.iterdir() if file.suffix != ".nc"] == []
