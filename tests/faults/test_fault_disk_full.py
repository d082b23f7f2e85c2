"""A full disk: what was there stays, nothing half-written takes a name, and one line says why."""

import errno
import gzip
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fault_scenes import CALIBRATE, FIT, RECORDS, WITHOUT_PICTURES, complaint, run
from scenes import TURBULENCE, draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import InputError, load_scan
from bayes_rs.noise.file import load_noise
from bayes_rs.output import output_file, output_folder, write_csv, write_netcdf, write_run
from bayes_rs.priors.ratio import WeakPrior

SCAN = load_scan("2-beam")
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def few_records(n_record=3):
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    stress = WeakPrior(log_sd_uu=0.5).draw(n_record, seed=1)
    return records_of(draw_variances(stress, scan, noise, np.random.default_rng(2)), scan), scan, noise


class FullDisk:
    """Every writing fails after so many bytes, for the whole process: Python's own files are all opened through it."""

    def __init__(self, monkeypatch, room):
        self.room = room
        write_bytes, write_text = Path.write_bytes, Path.write_text

        def writing(path, content, *arguments, **options):
            size = len(content)
            if size > self.room:
                with path.open("wb") as file:
                    file.write(bytes(content)[: self.room] if not isinstance(content, str) else b"half")
                self.room = 0
                raise FULL
            self.room -= size
            write = write_text if isinstance(content, str) else write_bytes
            return write(path, content, *arguments, **options)

        monkeypatch.setattr(Path, "write_bytes", writing)
        monkeypatch.setattr(Path, "write_text", writing)


@pytest.mark.slow
class TestCommands:
    """Real processes with a real limit: HDF5 itself dies of a full disk (a segmentation fault when Python ends)."""

    @pytest.mark.parametrize(("command", "size"), [(RECORDS, 100), (RECORDS, 9000), (CALIBRATE, 5000)])
    def test_a_file(self, tmp_path, command, size):
        (tmp_path / "out.nc").write_bytes(b"what was there")
        code, errors = run(*command, "-o", "out.nc", "--overwrite", folder=tmp_path, size=size)
        assert code == 2, errors
        assert len(complaint(errors)) == 1
        assert "File too large" in errors
        assert (tmp_path / "out.nc").read_bytes() == b"what was there"
        assert {file.name for file in tmp_path.iterdir()} <= {"out.nc", "cache", "matplotlib"}
        assert not list((tmp_path / "cache").glob("**/*.nc"))  # nor half of a cached noise

    def test_a_folder_of_results(self, tmp_path):
        code, errors = run(
            *FIT, "-o", "out", folder=tmp_path, size=400_000, own=WITHOUT_PICTURES
        )  # the part with the draws is larger
        assert code == 2, errors
        reason, note = complaint(errors)
        assert "File too large" in reason
        assert "are finished and kept in 'out': the same call with resume goes on from there" in note
        with pytest.raises(InputError, match=r"The fit in '.*out' has not ended: resume it, or wait for its end"):
            brs.write_report(tmp_path / "out")
        code, errors = run(*FIT, "-o", "out", "--resume", folder=tmp_path, own=WITHOUT_PICTURES)
        assert code == 0, errors
        assert brs.open_fit(tmp_path / "out").n_fitted == 6

    def test_a_cache_that_takes_nothing_stops_nobody(self, tmp_path):
        own = (
            "import bayes_rs as brs\n"
            "scan, flow = brs.load_scan('2-beam'), brs.load_turbulence('fu-2022')\n"
            "noise = brs.noise.calibrate(scan, flow, wind_speed=9.7, duration=60)\n"
            "print(noise.bias[0])"
        )
        code, errors = run(folder=tmp_path, size=5000, own=own)
        assert code == 0, errors
        assert "The noise cannot be cached and will be calculated again next time" in errors
        assert list((tmp_path / "cache").iterdir()) == []


class TestWriters:
    @pytest.mark.parametrize("room", np.random.default_rng(7).integers(9000, size=8).tolist())
    def test_noise(self, tmp_path, monkeypatch, room):
        plain_noise(SCAN).save(tmp_path / "noise.nc")
        before = (tmp_path / "noise.nc").read_bytes()
        FullDisk(monkeypatch, min(room, len(before) - 200))
        with pytest.raises(InputError, match=r"Cannot write '.*noise\.nc': No space left on device"):
            plain_noise(SCAN, bias=-0.2).save(tmp_path / "noise.nc", overwrite=True)
        assert (tmp_path / "noise.nc").read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["noise.nc"]

    def test_scan(self, tmp_path, monkeypatch):
        brs.save_scan(SCAN, tmp_path / "mine.toml")
        before = (tmp_path / "mine.toml").read_bytes()
        FullDisk(monkeypatch, 30)
        with pytest.raises(OSError, match="No space left on device"):
            brs.save_scan(SCAN, tmp_path / "mine.toml", overwrite=True)
        assert (tmp_path / "mine.toml").read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["mine.toml"]

    def test_run_file_of_a_folder_in_use(self, tmp_path, monkeypatch):
        """It is written anew at the end: a half one would make the whole folder unreadable."""
        write_run(tmp_path, {"key": "a", "finished": False})
        before = (tmp_path / "run.json").read_text()
        FullDisk(monkeypatch, 10)
        with pytest.raises(OSError, match="No space left on device"):
            write_run(tmp_path, {"key": "a", "finished": True})
        assert (tmp_path / "run.json").read_text() == before
        assert [file.name for file in tmp_path.iterdir()] == ["run.json"]

    def test_the_netcdf_library_writes_no_file(self, tmp_path, monkeypatch):
        """So none of it can be open when the disk is full."""
        FullDisk(monkeypatch, 3)
        with pytest.raises(OSError, match="No space left on device"):
            write_netcdf(xr.Dataset({"a": ("x", np.arange(100.0))}), tmp_path / "a.nc")
        assert (tmp_path / "a.nc").stat().st_size == 3

    def test_table(self, tmp_path):
        table = pd.DataFrame({"a": np.arange(3)})
        with pytest.raises(OSError, match="No space left on device"), output_file(tmp_path / "a.csv") as part:
            write_csv(table, Path("/dev/full"))
        assert part.name == "a.csv"
        assert list(tmp_path.iterdir()) == []

    def test_parquet_parts_of_a_long_fit(self, tmp_path, monkeypatch):
        """The writing of the second part fails; what was there goes on being read, and resuming ends it."""
        records, scan, noise = few_records(6)
        monkeypatch.setattr("bayes_rs.fits.plan.PART_RECORDS", 2)
        options = {"noise": noise, "seed": 3, "target_ess": 100, "draws": "none"}
        whole = brs.fit(records, scan, output=tmp_path / "whole", **options).summary()
        write, count = Path.write_bytes, iter(range(100))

        def writing(path, content):
            is_part = path.name.startswith(".half.part-")
            write(path, content)
            if is_part and next(count) == 2:
                write(path, content[:100])
                raise FULL
            return len(content)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", writing)
            with pytest.raises(OSError, match="No space left on device") as caught:
                brs.fit(records, scan, output=tmp_path / "out", **options)
        assert "2 of 6 records are finished and kept" in caught.value.__notes__[0]
        with pytest.raises(InputError, match="has not ended"):
            brs.open_fit(tmp_path / "out")
        part = pd.read_parquet(tmp_path / "out" / "summary" / "month=2020-01")
        pd.testing.assert_frame_equal(part[part["record"] < 2], whole[whole["record"] < 2])
        again = brs.fit(records, scan, output=tmp_path / "out", **options, resume=True)
        assert again.run["n_resumed"] == 2
        pd.testing.assert_frame_equal(again.summary(), whole)
        assert not list((tmp_path / "out").glob("**/.half*"))

    def test_the_page(self, tmp_path, monkeypatch):
        records, scan, noise = few_records()
        folder = tmp_path / "fit"
        brs.fit(records, scan, output=folder, noise=noise, seed=3, target_ess=100)
        page = brs.write_report(folder)
        before = page.read_bytes()
        FullDisk(monkeypatch, 1000)
        with pytest.raises(OSError, match="No space left on device"):
            brs.write_report(folder, overwrite=True)
        assert page.read_bytes() == before
        assert not list(folder.glob(".report*"))


class TestReading:
    def test_a_full_temporary_folder_is_not_a_damaged_file(self, tmp_path, monkeypatch):
        """Unpacking needs room: a resumable run would count the file as bad for ever."""
        file = tmp_path / "a.csv.gz"
        with gzip.open(file, "wt") as packed:
            packed.write("time,beam,radial_velocity\n2020-01-01T00:00:00,0,1.0\n")
        opened = Path.open

        def opening(path, mode="r", *arguments, **options):
            if "w" in mode:
                raise FULL
            return opened(path, mode, *arguments, **options)

        monkeypatch.setattr(Path, "open", opening)
        with pytest.raises(OSError, match="No space left on device") as caught:
            brs.read(file, SCAN)
        assert not isinstance(caught.value, InputError)


def test_overwriting_a_folder_fails_before_the_old_one_is_touched(tmp_path):
    final = tmp_path / "out"
    with output_folder(final) as folder:
        write_run(folder, {"n": 1})
    with pytest.raises(OSError, match="No space"), output_folder(final, overwrite=True) as folder:  # noqa: PT012 - it fails at the end of the block
        (folder / "posterior.nc").write_bytes(b"half")
        raise FULL
    assert sorted(file.name for file in final.iterdir()) == ["fingerprints.jsonl", "run.json"]


def test_noise_that_was_written_is_read(tmp_path):
    plain_noise(SCAN).save(tmp_path / "noise.nc")
    assert load_noise(tmp_path / "noise.nc").turbulence == TURBULENCE
