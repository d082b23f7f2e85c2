"""NetCDF-4 files on which the HDF5 library hangs or dies: refused in one line, by a process that can be killed."""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from folder_scene import N_RECORD, make_series, run, write_file, write_noise
from format_files import compress, series_of
from ray_files import six_beam
from scenes import plain_noise, records_of

from bayes_rs import fit, open_fit
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.store import find_shipped_noise
from bayes_rs.readers import netcdf_guard
from bayes_rs.readers.netcdf_file import glance, load_netcdf, open_netcdf
from bayes_rs.readers.reading import read
from bayes_rs.records.record_files import open_records
from bayes_rs.result_folder import seal_folder
from bayes_rs.turbulence.mann import load_turbulence

SIX = six_beam(45.0, step=1.0)
SIX_BEAM = load_scan("6-beam")
SHORT = series_of(SIX, n_scan=8)
READERS = Path(netcdf_guard.__file__).parent
MISCHIEF = f"""
import os, signal, sys, time
sys.path.append({str(READERS)!r})
import netcdf_process

real = netcdf_process.answer

def answer(request):
    name = os.path.basename(request["file"])
    late = "late" in name
    if name.startswith("hangs") and late == (request["do"] == "read"):
        time.sleep(60.0)
    if name.startswith("dies") and late == (request["do"] == "read"):
        os.kill(os.getpid(), signal.SIGSEGV)
    return real(request)

netcdf_process.answer = answer
netcdf_process.main()
"""
NO_END = "the HDF5 library has no end with it, after 2 s; check that it is complete and not damaged"


def write(file: Path, series: xr.Dataset = SHORT) -> Path:
    series.to_netcdf(file, engine="h5netcdf")
    return file


def plant_endless_heap(file: Path) -> Path:
    """Say that the free space at the end of the heap of references has no length: the library adds it up for ever."""
    raw = bytearray(file.read_bytes())
    at = raw.index(b"GCOL") + 16  # HDF5 File Format Specification, III.E, Global Heap: objects follow its header
    while int.from_bytes(raw[at : at + 2], "little"):  # the free space is object 0
        at += 16 + -(-int.from_bytes(raw[at + 8 : at + 16], "little") // 8) * 8
    assert int.from_bytes(raw[at + 8 : at + 16], "little") > 16
    raw[at + 8 : at + 16] = bytes(8)
    file.write_bytes(raw)
    return file


@pytest.fixture
def guard(monkeypatch):
    """A guard of its own, with a short limit."""
    own = netcdf_guard._Guard()
    monkeypatch.setattr(netcdf_guard, "_guard", own)
    monkeypatch.setattr(netcdf_guard, "SECONDS", 2.0)
    yield own
    own.end()


@pytest.fixture
def mischief(guard, monkeypatch, tmp_path_factory):
    """Its process hangs or dies on files with certain names."""
    script = tmp_path_factory.mktemp("script") / "walk.py"
    script.write_text(MISCHIEF)
    monkeypatch.setattr(netcdf_guard, "_SCRIPT", script)
    return guard


def is_gone(pid: int, *, seconds: float = 600.0) -> bool:
    """Whether a process ends soon; one that nobody waited for counts as gone only where it is not ours."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z" and f"\nPPid:\t{os.getpid()}\n" not in Path(f"/proc/{pid}/status").read_text():
            return True
        time.sleep(0.02)
    return False


class TestDamagedFiles:
    @pytest.mark.usefixtures("guard")
    def test_an_endless_heap_is_refused_in_time(self, tmp_path):
        file = plant_endless_heap(write(tmp_path / "a.nc"))
        start = time.process_time()
        with pytest.raises(InputError, match=r"a\.nc' cannot be read as NetCDF: .*; check that it is complete") as info:
            read(file, SIX)
        assert time.process_time() - start < 20.0  # this process waits, or would not come back
        assert "\n" not in str(info.value)

    @pytest.mark.parametrize("name", ["hangs.nc", "hangs-late.nc"])
    def test_one_that_hangs(self, mischief, tmp_path, name):
        file = write(tmp_path / name)
        with pytest.raises(InputError) as info:
            read(file, SIX)
        assert str(info.value) == f"File {str(file)!r} cannot be read as NetCDF: {NO_END}."
        assert mischief.process is None

    @pytest.mark.usefixtures("mischief")
    def test_one_that_hangs_is_not_tried_again(self, tmp_path):
        file = write(tmp_path / "hangs.nc")
        for limit in (2.0, 1000.0):
            netcdf_guard.SECONDS = limit
            with pytest.raises(InputError, match=NO_END):
                load_netcdf(file)

    @pytest.mark.usefixtures("mischief")
    @pytest.mark.parametrize("name", ["dies.nc", "dies-late.nc"])
    def test_one_that_kills(self, tmp_path, name):
        file = write(tmp_path / name)
        with pytest.raises(InputError) as info:
            read(file, SIX)
        assert str(info.value) == (
            f"File {str(file)!r} cannot be read as NetCDF: the HDF5 library crashes on it; "
            "check that it is complete and not damaged."
        )

    @pytest.mark.usefixtures("mischief")
    def test_records(self, tmp_path):
        """The reader of radial velocities, which comes next, says what is wrong."""
        assert open_records(write(tmp_path / "hangs.nc"), SIX) is None
        assert open_records(write(tmp_path / "dies.nc"), SIX) is None

    @pytest.mark.usefixtures("mischief")
    def test_noise_that_another_program_wrote(self, tmp_path):
        file = write(tmp_path / "hangs.nc")
        with pytest.raises(InputError) as info:
            load_noise(file)
        assert f"File {str(file)!r} cannot be read as NetCDF" in str(info.value)
        assert NO_END in str(info.value)

    def test_noise_whose_fingerprint_fits(self, mischief, tmp_path):
        """Anybody can make one: it is no signature."""
        file = tmp_path / "hangs.nc"
        plain_noise(SIX).save(file)
        with pytest.raises(InputError, match=NO_END):
            load_noise(file)
        plain_noise(SIX).save(tmp_path / "a.nc")
        assert load_noise(tmp_path / "a.nc").scan_name == SIX.name
        assert mischief.process is not None

    @pytest.mark.usefixtures("guard")
    def test_a_scale_that_points_to_what_is_gone(self, tmp_path):
        """The netCDF4 library dies on it, where that is installed; the library that looks through files reads it."""
        file = write(tmp_path / "a.nc")
        with h5py.File(file, "a") as opened:
            del opened["radial_velocity"].attrs["DIMENSION_LIST"]
            opened.create_dataset("gone", data=np.arange(3.0))
            dangling = np.empty(1, dtype=h5py.vlen_dtype(h5py.ref_dtype))
            dangling[0] = np.array([opened["gone"].ref], dtype=h5py.ref_dtype)
            opened["radial_velocity"].attrs.create("DIMENSION_LIST", dangling, dtype=h5py.vlen_dtype(h5py.ref_dtype))
            del opened["gone"]
        done = subprocess.run(  # noqa: S603 - our own program
            [sys.executable, "-m", "bayes_rs", "records", str(file), "--scan", "6-beam", "-o", str(tmp_path / "r.nc")],
            capture_output=True, text=True, check=False, cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 2, (done.returncode, done.stderr)
        assert re.search(r"File '.*a\.nc' cannot be read as NetCDF: .*check that it is complete", done.stderr)
        assert done.stderr.count("\n") == 1

    @pytest.mark.usefixtures("guard")
    def test_records_of_a_fit(self, tmp_path):
        """Another program wrote them, and a list of files that fits."""
        records = records_of(np.ones((2, SIX.n_beam)), SIX)
        fit(records, SIX, output=tmp_path / "out", seed=1, noise=plain_noise(SIX), target_ess=50, draws="none")
        (tmp_path / "out" / "records.nc").unlink()
        plant_endless_heap(write(tmp_path / "out" / "records.nc"))
        seal_folder(tmp_path / "out")
        with pytest.raises(InputError, match=r"records\.nc' cannot be read as NetCDF: .*; check that it is complete"):
            _ = open_fit(tmp_path / "out").records

    @pytest.mark.usefixtures("mischief")
    def test_a_compressed_file_is_named_as_the_user_knows_it(self, tmp_path):
        file = compress(write(tmp_path / "hangs.nc"), ".gz")
        with pytest.raises(InputError) as info:
            read(file, SIX)
        assert str(info.value) == f"File {str(file)!r} cannot be read as NetCDF: {NO_END}."

    @pytest.mark.usefixtures("mischief")
    def test_others_go_on(self, tmp_path):
        half = SHORT.sizes["sample"] // 2
        write(tmp_path / "a.nc", SHORT.isel(sample=slice(half)))
        write(tmp_path / "dies.nc")
        write(tmp_path / "hangs.nc")
        write(tmp_path / "z.nc", SHORT.isel(sample=slice(half, None)))
        series = read(tmp_path, SIX, on_bad_file="skip")
        np.testing.assert_array_equal(series["radial_velocity"], SHORT["radial_velocity"])
        skipped = json.loads(series.attrs["read_report"])["files_skipped"]
        assert [entry["name"] for entry in skipped] == ["dies.nc", "hangs.nc"]

    @pytest.mark.usefixtures("mischief")
    @pytest.mark.slow
    def test_a_fit_of_a_folder_goes_on(self, tmp_path):
        folder = tmp_path / "year"
        folder.mkdir()
        write_noise(tmp_path / "noise.nc")
        series = make_series()
        write_file(folder / "a.csv", series)
        for name in ("dies.nc", "hangs.nc"):
            series.to_netcdf(folder / name, engine="h5netcdf")
        plant_endless_heap(write(folder / "b.nc"))
        found = run(folder, tmp_path / "out", tmp_path / "noise.nc")
        bad = found.run["bad_files"]
        assert sorted(Path(name).name for name in bad) == ["b.nc", "dies.nc", "hangs.nc"]
        assert NO_END in bad[str(folder / "hangs.nc")]
        assert found.n_record == N_RECORD

    @pytest.mark.parametrize("look", [load_netcdf, glance])
    def test_a_reference_that_leads_nowhere(self, guard, tmp_path, look):
        """The library can take gigabytes before it says so: the next file has a new process."""
        good, file = write(tmp_path / "good.nc"), write(tmp_path / "a.nc")
        load_netcdf(good)
        first = guard.process.pid
        file.write_bytes(file.read_bytes().replace(b"GCOL", b"GCOK"))
        with pytest.raises(InputError, match=r"a\.nc' cannot be read as NetCDF: .*; check that it is complete"):
            look(file)
        load_netcdf(write(tmp_path / "another.nc"))
        assert guard.process.pid != first

    def test_a_wrong_checksum_costs_no_new_process(self, guard, tmp_path):
        good, file = write(tmp_path / "good.nc"), write(tmp_path / "a.nc")
        load_netcdf(good)
        first = guard.process.pid
        raw = bytearray(file.read_bytes())
        raw[raw.find(b"radial_velocity") + 3] ^= 1
        file.write_bytes(raw)
        with pytest.raises(InputError, match=r"a\.nc' cannot be read as NetCDF: .*checksum.*; check that it"):
            load_netcdf(file)
        load_netcdf(write(tmp_path / "another.nc"))
        assert guard.process.pid == first

    @pytest.mark.parametrize("usable", [True, False])
    def test_the_words_are_the_same_without_it(self, guard, tmp_path, usable):
        guard.usable = usable
        file = write(tmp_path / "a.nc")
        file.write_bytes(file.read_bytes()[:-100])
        with pytest.raises(InputError, match=r"a.nc' cannot be read as NetCDF: Unable to .*truncated file.*; check"):
            load_netcdf(file)


class TestOneDoor:
    def test_nothing_else_opens_a_netcdf_file(self):
        """What opens one elsewhere opens it in this process, which may then die of it."""
        opening = re.compile(r"xr\.(open|load)_|netCDF4|h5py\.File\(")
        package = READERS.parent
        found = {
            file.relative_to(package).as_posix() for file in package.rglob("*.py") if opening.search(file.read_text())
        }
        assert found == {"readers/netcdf_file.py", "readers/netcdf_process.py"}

    @pytest.mark.usefixtures("guard")
    @pytest.mark.parametrize("decode_times", [True, False])
    def test_it_gives_what_the_library_gives(self, tmp_path, decode_times):
        """Numbers of all types, packed ones, texts, missing values, attributes of all types, times, no dimension."""
        values = np.arange(6.0).reshape(2, 3)
        made = xr.Dataset(
            {
                "packed": (("a", "b"), values, {"units": "m/s", "valid_range": np.array([-3, 99], dtype=np.int16)}),
                "single": (("a", "b"), values.astype(np.float32), {"note": "\N{GREEK SMALL LETTER GAMMA}", "n": 3}),
                "missing": ("b", [1.0, np.nan, 3.0]),
                "text": ("b", np.array(["a", "\u98a8", ""], dtype=object)),
                "letters": ("b", np.array([b"x", b"y", b"z"])),
                "one": ((), 5, {"list": ["a", "b"], "empty": "", "many": np.arange(3.0)}),
                "flag": ("a", [True, False]),
                "big": ("b", np.array([2**63, 0, 1], dtype=np.uint64)),
                "none": (("none", "b"), np.empty((0, 3))),
            },
            coords={"a": np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[ns]"), "b": [5, 6, 7]},
            attrs={"title": "a title", "version": np.int8(2)},
        )
        packed = {"dtype": "int16", "scale_factor": np.float32(0.5), "add_offset": 1.0, "_FillValue": np.int16(-99)}
        made.to_netcdf(tmp_path / "a.nc", engine="h5netcdf", encoding={"packed": packed})
        right = xr.load_dataset(tmp_path / "a.nc", engine="h5netcdf", decode_times=decode_times)
        for trusted in (False, True):
            with open_netcdf(tmp_path / "a.nc", decode_times=decode_times, trusted=trusted) as found:
                found.load()
            xr.testing.assert_identical(found, right)
            assert {name: item.dtype for name, item in found.variables.items()} == {
                name: item.dtype for name, item in right.variables.items()
            }
            for name in ("dtype", "scale_factor", "add_offset", "_FillValue"):
                assert found["packed"].encoding[name] == right["packed"].encoding[name]

    @pytest.mark.usefixtures("guard")
    def test_one_that_says_nonsense_of_its_sign(self, tmp_path):
        series = SHORT.copy()
        series["radial_velocity"].attrs["positive"] = "sideways"
        words = r"a\.nc' says of itself what cannot be used: .*'sideways'"
        with pytest.raises(InputError, match=words):
            read(write(tmp_path / "a.nc", series), SIX)

    @pytest.mark.usefixtures("guard")
    @pytest.mark.parametrize("kind", [complex, bool])
    def test_velocities_that_are_no_real_numbers(self, tmp_path, kind):
        """Their real parts, or ones and zeros, were read in silence."""
        file = write(tmp_path / "a.nc")
        with h5py.File(file, "a") as opened:
            values = opened["radial_velocity"][()]
            del opened["radial_velocity"]
            opened["radial_velocity"] = values.astype(kind)
            opened["radial_velocity"].dims[0].attach_scale(opened["sample"])
        with pytest.raises(InputError, match=r"Invalid radial_velocity in .*must be real numbers; give another column"):
            read(file, SIX)

    @pytest.mark.usefixtures("guard")
    def test_a_dimension_that_a_variable_has_twice(self, tmp_path):
        with h5py.File(write(tmp_path / "a.nc"), "a") as opened:
            opened["twice"] = np.zeros((48, 48))
            opened["twice"].dims[0].attach_scale(opened["sample"])
            opened["twice"].dims[1].attach_scale(opened["sample"])
        assert load_netcdf(tmp_path / "a.nc")["twice"].dims == ("sample", "sample (2)")

    @pytest.mark.usefixtures("guard")
    def test_groups(self, tmp_path):
        with h5py.File(tmp_path / "a.nc", "w") as opened:
            opened["one/two/range"] = np.arange(3.0)
            opened["one/two/azimuth"] = np.arange(3.0)
            opened["one/two/other"] = np.arange(3.0)
            opened["time"] = 1.0
        found = glance(tmp_path / "a.nc")
        assert list(found) == ["/", "/one", "/one/two"]
        assert sorted(found["/one/two"].names) == ["azimuth", "other", "range"]
        assert sorted(found["/one/two"].variables) == ["azimuth", "range"]
        assert not found["/"].variables  # no rays in it
        np.testing.assert_array_equal(found["/one/two"].variables["range"], np.arange(3.0))
        SHORT.assign_coords(beam=SHORT["beam"].astype(np.int32)).to_netcdf(tmp_path / "b.nc", engine="scipy")
        assert "radial_velocity" in glance(tmp_path / "b.nc")["/"].attributes

    @pytest.mark.usefixtures("guard")
    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"CDF\5" + bytes(40), "it is of the kind CDF-5; convert it with 'nccopy -k netCDF-4'"),
            (b"CDF", "its version 0 is unknown"),
            (b"CDF\7" + bytes(40), "its version 7 is unknown"),
            (b"time,beam\n", "it has no header of such a file"),
            (b"", "it has no header of such a file"),
        ],
    )
    def test_what_has_none(self, tmp_path, content, words):
        file = tmp_path / "a.nc"
        file.write_bytes(content)
        with pytest.raises(InputError) as info:
            read(file, SIX)
        words = f"File {str(file)!r} cannot be read as NetCDF: {words}; check that it is complete and not damaged."
        assert str(info.value) == words


class TestGoodFiles:
    def test_many_use_one_process(self, guard, tmp_path):
        used = set()
        for number in range(5):
            read(write(tmp_path / f"{number}.nc"), SIX)
            used.add(guard.process.pid)
        assert len(used) == 1

    @pytest.mark.parametrize("name", ["two\nlines.nc", "Göttingen 風.nc", os.fsdecode(b"\xff\xfe.nc"), ' "\\.nc'])
    def test_any_name(self, guard, tmp_path, name):
        file = write(tmp_path / "a.nc").rename(tmp_path / name)
        load_netcdf(file)
        assert guard.process is not None

    @pytest.mark.usefixtures("guard")
    def test_a_relative_name_after_a_change_of_folder(self, tmp_path, monkeypatch):
        write(tmp_path / "a.nc")
        load_netcdf(tmp_path / "a.nc")
        monkeypatch.chdir(tmp_path)
        load_netcdf(Path("a.nc"))

    @pytest.mark.usefixtures("guard")
    def test_whatever_hdf5_can_hold(self, tmp_path):
        file = tmp_path / "a.nc"
        with h5py.File(file, "w") as opened:
            words = opened.create_dataset("words", data=["a", "b"] * 6000, dtype=h5py.string_dtype(), chunks=(500,))
            opened.create_dataset("word", data="a", dtype=h5py.string_dtype())
            opened.create_dataset("no rows", shape=(0, 3), maxshape=(None, 3), chunks=(5, 3), dtype=h5py.string_dtype())
            opened.create_dataset("unwritten", shape=(100, 100), dtype="f4", chunks=(10, 10), compression="gzip")
            opened["soft"] = h5py.SoftLink("/words")
            opened["again"] = opened["words"]
            opened.create_dataset("gone", data=1.0)
            opened["group/inner"] = 2.0
            words.attrs["all"] = np.array([opened["gone"].ref, h5py.Reference(), words.ref], dtype=h5py.ref_dtype)
            words.attrs["empty"] = h5py.Empty("S1")
            words.attrs["latin"] = np.bytes_(b"\xe9")
            del opened["gone"]
        assert load_netcdf(file)["words"].values[:2].tolist() == ["a", "b"]

    @pytest.mark.usefixtures("guard")
    def test_a_file_is_recognised_without_its_values(self, guard, tmp_path, monkeypatch):
        """Each value comes over once: the time is that of a sample, and is asked for by every reader that looks."""
        asked = []
        real = guard.ask
        monkeypatch.setattr(guard, "ask", lambda file, request: (asked.append(request), real(file, request))[1])
        read(write(tmp_path / "a.nc"), SIX)
        names = [request["name"] for request in asked if request["do"] == "read"]
        assert "time" in names
        assert len(names) == len(set(names))

    @pytest.mark.usefixtures("guard")
    def test_a_status_that_is_no_number(self, tmp_path):
        velocity = SHORT["radial_velocity"].assign_attrs(positive="away")
        file = write(tmp_path / "a.nc", SHORT.assign(radial_velocity=velocity).assign_attrs(status_valid="good"))
        with pytest.raises(InputError, match=r"^Invalid status_valid 'good' in file '.*a\.nc': it must be a number"):
            read(file, SIX)

    def test_texts_that_end_before_their_dimension(self, tmp_path):
        file = tmp_path / "a.nc"
        compound = np.dtype([("kind", "i4"), ("value", "f8")])
        with h5py.File(file, "w") as opened:
            opened.create_dataset("time", data=np.arange(5.0)).make_scale("time")
            for name, kind in (("text", h5py.string_dtype()), ("letter", "S1"), ("compound", compound)):
                opened.create_dataset(name, (5,), kind, maxshape=(None,), chunks=(5,)).dims[0].attach_scale(
                    opened["time"]
                )
            opened["text"][:2] = ["a", "b"]
            opened["letter"][:2] = [b"a", b"b"]
            for name in ("text", "letter", "compound"):  # as the C library leaves what was not written
                opened[name].resize((0 if name == "compound" else 2,))
        found = load_netcdf(file)
        assert found["text"].values.tolist() == ["a", "b", "", "", ""]
        assert found["letter"].values.tolist() == [b"a", b"b", b"", b"", b""]
        assert found["compound"].shape == (5,)

    def test_a_python_that_prints_when_it_starts(self, guard, tmp_path, monkeypatch):
        (tmp_path / "sitecustomize.py").write_text("print('welcome', flush=True)\nprint('>', end='', flush=True)\n")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        assert read(write(tmp_path / "a.nc"), SIX).sizes["sample"] == SHORT.sizes["sample"]
        assert guard.process is not None

    def test_threads(self, tmp_path):
        files = [write(tmp_path / f"{number}.nc") for number in range(4)]
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(load_netcdf, files * 10))

    @pytest.mark.usefixtures("guard")
    def test_threads_that_read_what_is_ours_at_once(self, tmp_path):
        """As when fits in threads look for the same noise: none closes the file while another one reads it."""
        file = write(tmp_path / "a.nc")
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda _: load_netcdf(file, trusted=True).sizes["sample"], range(60)))
        assert set(found) == {SHORT.sizes["sample"]}

    def test_a_process_that_was_killed_in_between(self, guard, tmp_path):
        """It is not the next file's fault, whether that is noticed before the request or after."""
        files = iter([write(tmp_path / f"{number}.nc") for number in range(3)])
        load_netcdf(next(files))
        os.kill(guard.process.pid, signal.SIGKILL)
        load_netcdf(next(files))
        killed = guard.process
        os.kill(killed.pid, signal.SIGKILL)
        killed.wait()
        load_netcdf(next(files))
        assert guard.process.pid != killed.pid

    def test_an_interrupt(self, mischief, tmp_path):
        """What was asked before it is not taken for the next answer."""
        file, this = write(tmp_path / "hangs.nc"), threading.get_ident()
        threading.Timer(1.0, lambda: signal.pthread_kill(this, signal.SIGINT)).start()
        netcdf_guard.SECONDS = 30.0
        before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
        try:
            with pytest.raises(KeyboardInterrupt):
                load_netcdf(file)
        finally:
            signal.signal(signal.SIGINT, before)
        assert mischief.process is None
        load_netcdf(write(tmp_path / "a.nc"))


class TestWithoutAProcess:
    @pytest.mark.parametrize("python", ["", "/nowhere/python", "/bin/false", None])
    def test_files_are_read_and_a_warning_is_logged_once(self, guard, tmp_path, monkeypatch, caplog, python):
        monkeypatch.setattr(sys, "executable", python)
        file = write(tmp_path / "a.nc")
        with caplog.at_level(logging.WARNING):
            for _ in range(3):
                assert read(file, SIX).sizes == SHORT.sizes
        assert len(caplog.messages) == 1
        assert "without a process that protects from damaged ones" in caplog.messages[0]
        assert guard.process is None

    def test_what_is_shipped_needs_none(self, guard):
        find_shipped_noise.__globals__["_load"].cache_clear()
        assert find_shipped_noise(SIX_BEAM, load_turbulence("fu-2022")) is not None
        assert guard.process is None


ASK = (
    "import sys\n"
    "from pathlib import Path\n"
    "from bayes_rs.readers import netcdf_guard\n"
    "from bayes_rs.readers.netcdf_file import glance, load_netcdf, open_netcdf\n"
    "assert netcdf_guard._guard.process is None\n"
    "load_netcdf(Path(sys.argv[1]))\n"
    "print(netcdf_guard._guard.process.pid, flush=True)\n"
)


def ask(script: str, file: Path) -> tuple[subprocess.Popen, int]:
    """Start a process that checks a file; return it, and the number of the process that it started."""
    process = subprocess.Popen(  # noqa: S603 - our own script
        [sys.executable, "-X", "dev", "-W", "error::ResourceWarning", "-c", script, str(file)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    return process, int(process.stdout.readline())


class TestItsEnd:
    def test_with_the_process_that_asks(self, tmp_path):
        process, pid = ask(ASK, write(tmp_path / "a.nc"))
        said, complaints = process.communicate()
        assert (process.returncode, said, complaints) == (0, b"", b"")
        assert is_gone(pid)

    def test_where_that_is_killed(self, tmp_path):
        process, pid = ask(ASK + "sys.stdin.read()\n", write(tmp_path / "a.nc"))
        assert not is_gone(pid, seconds=0.3)
        process.kill()
        process.communicate()
        assert is_gone(pid)

    def test_where_that_is_killed_while_the_library_hangs(self, tmp_path):
        write(tmp_path / "hangs.nc")
        script = tmp_path / "walk.py"
        script.write_text(MISCHIEF)
        hang = (
            f"netcdf_guard._guard.end()\nnetcdf_guard._SCRIPT = {str(script)!r}\nnetcdf_guard.SECONDS = 1.5\n"
            "import threading\n"
            "file = Path(sys.argv[1]).with_name('hangs.nc')\n"
            "threading.Thread(target=netcdf_guard.ask, args=(file, 'look')).start()\n"
            "while not (netcdf_guard._guard.process and netcdf_guard._guard.process.pid): pass\n"
            "import time; time.sleep(1.0)\n"
            "print(netcdf_guard._guard.process.pid, flush=True)\n"
            "sys.stdin.read()\n"
        )
        process, _ = ask(ASK + hang, write(tmp_path / "a.nc"))
        pid = int(process.stdout.readline())
        process.kill()
        process.communicate()
        assert is_gone(pid)

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
    def test_a_fork_has_its_own(self, tmp_path):
        fork = (
            "import os, warnings\n"
            "warnings.simplefilter('ignore', DeprecationWarning)\n"
            "first = netcdf_guard._guard.process.pid\n"
            "child = os.fork()\n"
            "load_netcdf(Path(sys.argv[1]))\n"
            "same = netcdf_guard._guard.process.pid == first\n"
            "if child == 0:\n"
            "    netcdf_guard._guard.end()\n"
            "    os._exit(0 if not same else 1)\n"
            "assert os.waitpid(child, 0)[1] == 0\n"
            "assert same\n"
            "load_netcdf(Path(sys.argv[1]))\n"
        )
        process, pid = ask(ASK + fork, write(tmp_path / "a.nc"))
        assert process.communicate() == (b"", b"")
        assert process.returncode == 0
        assert is_gone(pid)

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
    def test_a_fork_while_another_thread_reads(self, tmp_path):
        """No lock of the other thread is left behind in it: `functools.cached_property` had one before Python 3.12."""
        fork = (
            "import os, signal, threading, warnings\n"
            "warnings.simplefilter('ignore', DeprecationWarning)\n"
            "file, reading = Path(sys.argv[1]), threading.Event()\n"
            "real = netcdf_guard._guard.ask\n"
            "def ask(file, request):\n"
            "    if request['do'] == 'read' and threading.current_thread() is not threading.main_thread():\n"
            "        reading.set()\n"
            "        go_on.wait()\n"
            "    return real(file, request)\n"
            "go_on, netcdf_guard._guard.ask = threading.Event(), ask\n"
            "thread = threading.Thread(target=load_netcdf, args=(file,))\n"
            "thread.start()\n"
            "reading.wait()\n"
            "child = os.fork()\n"
            "if child == 0:\n"
            "    signal.alarm(60)\n"
            "    load_netcdf(file)\n"
            "    netcdf_guard._guard.end()\n"
            "    os._exit(0)\n"
            "assert os.waitpid(child, 0)[1] == 0\n"
            "go_on.set()\n"
            "thread.join()\n"
        )
        process, _ = ask(ASK + fork, write(tmp_path / "a.nc"))
        assert process.communicate() == (b"", b"")
        assert process.returncode == 0

    def test_nothing_starts_with_the_package(self):
        """Help does not wait for it."""
        done = subprocess.run(
            [sys.executable, "-c", "import sys, bayes_rs.cli; print('bayes_rs.readers' in sys.modules)"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stdout == "False\n"
