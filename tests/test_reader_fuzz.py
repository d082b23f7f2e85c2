"""Damaged files: every reader gives a series, or one line that names the file; nothing else, and in finite time.

Readers of text run here. Readers on compiled libraries run in a process of their own, which is killed when it hangs.
"""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from format_files import (
    compress,
    long_frame,
    series_of,
    wide_frame,
    write_hpl,
    write_mini_raw,
    write_spinnerlidar,
    write_zx,
)
from ray_files import arm, cfradial, e_windlidar, rays_of, six_beam, windcube_sweep, write_cfradial2, write_windcube
from ray_text_files import at_heights, gate_frame, ray_frame, write_molas, write_rtd, write_scn, write_windscanner
from test_sonic_series import wind_of, write_toa5

from bayes_rs.errors import InputError
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.readers import netcdf_guard, read, read_sonic, read_statistics
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.readers.netcdf_names import AWAY

SIX = six_beam(45.0, step=1.0)
ZX = load_scan("zx-tm")
SPINNER = load_scan("spinnerlidar")
SHORT = series_of(SIX, n_scan=8)
RAYS = rays_of(SHORT, SIX)
TWO = six_beam(100.0, 150.0, step=1.0)
PLANES = rays_of(series_of(TWO, n_scan=8), TWO, rough=False)
CPU_SECONDS_PER_FILE = 60.0
"""What a file may take of the processor, and not of the clock: reading one takes a tenth of a second."""
FOR_EVER = 3600.0
"""Seconds of the clock after which a process that does not work at all, and waits for something, is given up."""

JUNK = [
    b"1e308", b"-1e999", b"9" * 40, b"nan", b"inf", b"-", b'"', b"\0", b"1e-320", b"2262-04-11T23:47:16.9",
    b"1677-09-21", b"0001-01-01", b"\xff\xfe", b"NaT", b"None", b"True", b"0x10", b"1_000", b"\xef\xbb\xbf", b"\x1a",
]  # fmt: skip
SIGNS = [b",", b";", b"\t", b" ", b".", b"\n", b"\r\n", b'"', b"-", b"1", b"0", b":", b"*"]


def mutate(raw: bytes, seed: int) -> bytes:
    """Damage a file in one to three places: cut, flip, insert, lose, swap separators, overwrite, repeat."""
    rng = np.random.default_rng(seed)
    body = bytearray(raw)
    for _ in range(rng.integers(1, 4)):
        size = max(len(body), 1)
        at = int(rng.integers(0, size if rng.random() < 0.6 else min(size, 400)))
        match int(rng.integers(0, 8)):
            case 0:
                del body[at:]
            case 1 if body:
                body[at] ^= 1 << int(rng.integers(0, 8))
            case 2:
                body[at:at] = rng.bytes(int(rng.integers(1, 20)))
            case 3:
                del body[at : at + int(rng.integers(1, 50))]
            case 4:
                old, new = (SIGNS[int(index)] for index in rng.integers(0, len(SIGNS), 2))
                body = bytearray(bytes(body).replace(old, new, int(rng.integers(1, 400))))
            case 5:
                body[at : at + int(rng.integers(0, 8))] = JUNK[int(rng.integers(0, len(JUNK)))]
            case 6:
                body[at:at] = body[int(rng.integers(0, size)) :][:100]
            case _:
                body[at : at + 8] = rng.bytes(8)
    return bytes(body)


def mutate_in_place(raw: bytes, seed: int) -> bytes:
    """Damage one to three bytes and leave all others where they are; in the heap of references, if there is one."""
    rng = np.random.default_rng(seed)
    body = bytearray(raw)
    heap = body.find(b"GCOL")
    low, high = (heap + 16, heap + 512) if rng.random() < 0.7 and heap >= 0 else (0, len(body))
    for at in rng.integers(low, high, size=int(rng.integers(1, 4))):
        body[at] = 0 if rng.random() < 0.3 else int(rng.integers(0, 256))
    return bytes(body)


def statistics_file(file: Path) -> Path:
    first = "CSV Converter: v1,114;Unit: 317;Time sync: UTC +1,0 hrs"
    headings = "Reference;Time and Date;Tilt (deg);Horizontal Wind Speed (m/s) at 297m;TI at 297m;TI at 38m"
    rows = [f"2198{number};13.12.2016 00:{number}0:00;1;5,0{number}9;0,0959;9999" for number in range(6)]
    file.write_text("\n".join([first, headings, *rows]))
    return file


def old_hdf5(file: Path) -> Path:
    """A NetCDF-4 file without checksums, as libraries wrote them for long."""
    with h5py.File(file, "w", libver=("earliest", "v108")) as opened:
        opened.create_dataset("sample", data=np.arange(SHORT.sizes["sample"])).make_scale("sample")
        for name in ("time", "beam", "radial_velocity"):
            values = SHORT[name].values
            variable = opened.create_dataset(name, data=values.astype("i8") if name == "time" else values)
            variable.dims[0].attach_scale(opened["sample"])
        opened["time"].attrs["units"] = "nanoseconds since 1970-01-01"
    return file


def table(file: Path, frame=long_frame, **options) -> Path:
    frame(SHORT).to_csv(file, index=False, **options)
    return file


def framed(file: Path, frame: pd.DataFrame) -> Path:
    frame.rename(columns={"velocity": "radial velocity [m/s]"}).to_csv(file, index=False)
    return file


def packed(file: Path, suffix: str) -> Path:
    plain = table(file)
    result = compress(plain, suffix)
    plain.unlink()
    return result


def netcdf(file: Path, dataset: xr.Dataset, **options) -> Path:
    dataset.to_netcdf(file, **options)
    return file


def of_ranges(file: Path) -> Path:
    frame = long_frame(SHORT)
    pd.concat([frame.assign(Distance=distance) for distance in (100.0, 46.0, 150.0)]).to_csv(file, index=False)
    return file


def crooked(file: Path, encoding: str) -> Path:
    lines = long_frame(SHORT).to_csv(index=False).splitlines()
    lines[5:5] = ["Höhe,-,m/s,dB", lines[0], "# a note" if encoding == "utf-8" else "a note"]
    above = ["Gerät 7"] if encoding == "cp1252" else []
    file.write_bytes("\n".join([*above, *lines, "end"]).encode(encoding))
    return file


TEXT: dict[str, tuple[Callable[[Path], Path], dict]] = {
    "long": (lambda folder: table(folder / "a.csv"), {}),
    "wide": (lambda folder: table(folder / "a.csv", wide_frame), {}),
    "decimal commas": (
        lambda folder: table(folder / "a.csv", sep=";", decimal=","),
        {"separator": ";", "decimal": ","},
    ),
    "halo": (lambda folder: write_hpl(folder / "a.hpl", SHORT, SIX), {}),
    "spinnerlidar": (
        lambda folder: write_spinnerlidar(folder / "a.txt", series_of(SPINNER, n_scan=1), SPINNER),
        {"scan": SPINNER},
    ),
    "zx": (
        lambda folder: write_zx(folder / "a.csv", series_of(ZX, n_scan=2), ZX),
        {
            "scan": ZX,
            "columns": {"time": "When", "phase": "Scan angle", "radial_velocity": "LOS"},
            "time_format": "%d/%m/%Y %H:%M:%S.%f",
            "phase_zero_deg": 90.0,
            "phase_turns": "down",
        },
    ),
    "zx by headings": (
        lambda folder: write_mini_raw(folder / "a.csv", series_of(ZX, n_scan=2), ZX),
        {"scan": ZX, "phase_zero_deg": 0.0, "phase_turns": "up"},
    ),
    "windscanner": (lambda folder: write_windscanner(folder / "a.txt", PLANES), {"scan": TWO}),
    "galion": (lambda folder: write_scn(folder / "a.scn", PLANES), {"scan": TWO, "gate_length": 45.0}),
    "rtd": (lambda folder: write_rtd(folder / "a.rtd", at_heights(PLANES)), {"scan": TWO}),
    "rtd of version 1": (
        lambda folder: write_rtd(folder / "a.rtd", at_heights(PLANES), version=1),
        {"scan": TWO},
    ),
    "molas": (lambda folder: write_molas(folder / "a.csv", PLANES), {"scan": TWO}),
    "table of rays": (lambda folder: framed(folder / "a.csv", ray_frame(PLANES)), {"scan": TWO, "positive": "away"}),
    "columns for gates": (
        lambda folder: framed(folder / "a.csv", gate_frame(PLANES, velocity="rws_{}", distance="range_{}")),
        {"scan": TWO, "positive": "away"},
    ),
    "gzip": (lambda folder: packed(folder / "a.csv", ".gz"), {}),
    "zip": (lambda folder: packed(folder / "a.csv", ".zip"), {}),
    "ranges": (lambda folder: of_ranges(folder / "a.csv"), {"columns": {"range": "Distance"}}),
    "bad rows left out": (lambda folder: crooked(folder / "a.csv", "utf-8"), {"bad_rows": "drop", "comment": "#"}),
    "utf-16": (lambda folder: crooked(folder / "a.csv", "utf-16"), {"bad_rows": "drop"}),
    "cp1252": (
        lambda folder: crooked(folder / "a.csv", "cp1252"),
        {"bad_rows": "drop", "encoding": "cp1252", "skip_rows": 1},
    ),
    "sonic": (lambda folder: write_toa5(folder / "a.dat", wind_of(60)), {"sonic": True}),
    "statistics": (lambda folder: statistics_file(folder / "Wind10.csv"), {"statistics": True}),
}
COMPILED: dict[str, Callable[[Path], Path]] = {
    "netcdf": lambda folder: netcdf(folder / "a.nc", SHORT, engine="h5netcdf"),
    "classic": lambda folder: netcdf(folder / "a.nc", SHORT, format="NETCDF3_64BIT", engine="scipy"),
    "windcube": lambda folder: write_windcube(folder / "a.nc", windcube_sweep(RAYS, accumulation=1.0)),
    "e-windlidar": lambda folder: netcdf(folder / "a.nc", e_windlidar(RAYS), engine="h5netcdf"),
    "cfradial": lambda folder: netcdf(folder / "a.nc", cfradial(RAYS), engine="h5netcdf"),
    "cfradial 2": lambda folder: write_cfradial2(folder / "a.nc", cfradial(RAYS, velocity="v", standard_name=AWAY)),
    "arm": lambda folder: netcdf(folder / "a.cdf", arm(RAYS), format="NETCDF3_CLASSIC", engine="scipy"),
    "old": lambda folder: old_hdf5(folder / "a.nc"),
    "zst": lambda folder: packed(folder / "a.csv", ".zst"),
}


def parquet(folder: Path) -> Path:
    long_frame(SHORT).to_parquet(folder / "a.parquet")
    return folder / "a.parquet"


COMPILED["parquet"] = parquet
COMPILED["heap"] = COMPILED["netcdf"]


def check(file: Path, *, scan=SIX, statistics: bool = False, sonic: bool = False, **options) -> bool:
    """Read a damaged file; whether it gave a series. Any other error than ours goes up."""
    try:
        if statistics:
            return bool(read_statistics(file).sizes["time"] >= 0)
        if sonic:
            wind = read_sonic(file)
            assert (np.diff(wind["time"].values) > np.timedelta64(0, "ns")).all()
            assert not np.isinf(wind["u"].values).any()
            return wind.sizes["time"] >= 0
        series = read(file, scan, **options)
    except InputError as error:
        message = str(error)
    else:
        message = ""
    if message:
        assert str(file) in message
        assert "\n" not in message
        return False
    assert series.sizes["sample"] > 0
    assert not np.isnat(series["time"].values).any()
    assert (np.diff(series["time"].values) >= np.timedelta64(0, "ns")).all()
    assert np.isin(series["beam"].values, scan.beam).all()
    assert not np.isinf(series["radial_velocity"].values).any()
    return True


@pytest.mark.parametrize("kind", TEXT)
class TestText:
    def damaged(self, folder: Path, kind: str, seeds: range) -> None:
        write, options = TEXT[kind]
        file = write(folder)
        raw = file.read_bytes()
        assert check(file, **options)
        n_read = 0
        for seed in seeds:
            file.write_bytes(mutate(raw, seed))
            try:
                n_read += check(file, **options)
            except Exception as error:
                error.add_note(f"seed {seed} of {kind}")
                raise
        assert n_read < len(seeds)

    def test_some(self, tmp_path, kind):
        self.damaged(tmp_path, kind, range(60))

    @pytest.mark.long
    def test_many(self, tmp_path, kind):
        self.damaged(tmp_path, kind, range(1000, 2500))

    def test_binary_junk(self, tmp_path, kind):
        write, options = TEXT[kind]
        file = write(tmp_path)
        rng = np.random.default_rng(5)
        for size in (0, 1, 100, 5000):
            file.write_bytes(rng.bytes(size))
            assert not check(file, **options)


def run_compiled(kind: str, first: int, last: int) -> tuple[int, list[str]]:
    """Read damaged files in another process; return how many, and what went wrong there."""
    command = [sys.executable, "-W", "ignore", __file__, kind, str(first), str(last)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=FOR_EVER, check=False)  # noqa: S603 - our own
    said = done.stdout.splitlines()
    if done.returncode == -signal.SIGXCPU:
        return len(said), [f"hangs at {said[-1]}"]
    wrong = [f"ends with {done.returncode} after {said[-1:]}: {done.stderr[-500:]}"] if done.returncode else []
    return len(said), wrong


WITH_CHECKSUMS = [kind for kind in COMPILED if kind not in ("heap", "old")]


class TestCompiled:
    def test_some(self):
        assert run_compiled(",".join(WITH_CHECKSUMS), 0, 6) == (6 * len(WITH_CHECKSUMS), [])

    @pytest.mark.long
    @pytest.mark.parametrize("kind", WITH_CHECKSUMS)
    def test_many(self, kind):
        assert run_compiled(kind, 1000, 2500) == (1500, [])

    def test_bytes_without_checksums(self):
        """The heap of references of a NetCDF-4 file, and nearly all of an old one: the library hangs, or dies."""
        assert run_compiled("heap,old", 0, 10) == (20, [])

    @pytest.mark.long
    @pytest.mark.parametrize("kind", ["heap", "old"])
    def test_many_bytes_without_checksums(self, kind):
        assert run_compiled(kind, 1000, 2000) == (1000, [])


class TestNetcdfCheck:
    def write(self, folder: Path, **options) -> Path:
        return netcdf(folder / "a.nc", SHORT, **options)

    @pytest.mark.parametrize("version", ["NETCDF3_CLASSIC", "NETCDF3_64BIT"])
    def test_a_good_file_passes(self, tmp_path, version):
        series = SHORT.assign_coords(beam=SHORT["beam"].astype(np.int32))
        file = netcdf(tmp_path / "a.nc", series, format=version, engine="scipy", unlimited_dims=["sample"])
        load_netcdf(file)
        assert read(file, SIX).sizes["sample"] == SHORT.sizes["sample"]

    def test_a_cut_classic_file(self, tmp_path):
        """The library would give zeros."""
        file = self.write(tmp_path, format="NETCDF3_64BIT", engine="scipy")
        file.write_bytes(file.read_bytes()[:-100])
        with pytest.raises(InputError, match=r"a.nc' cannot be read as NetCDF: it has \d+ bytes, and a variable ends"):
            read(file, SIX)

    def test_a_count_that_would_keep_the_library_busy(self, tmp_path):
        file = self.write(tmp_path, format="NETCDF3_64BIT", engine="scipy")
        raw = bytearray(file.read_bytes())
        raw[12:16] = b"\x7f\xff\xff\xff"  # the number of dimensions
        file.write_bytes(raw)
        with pytest.raises(InputError, match="its header announces 2147483647 entries, more than it can hold"):
            read(file, SIX)

    def test_a_variable_that_would_fill_the_memory(self, tmp_path):
        with h5py.File(tmp_path / "a.nc", "w") as opened:
            opened.create_dataset("radial_velocity", shape=(10**12,), chunks=(1000,), dtype="f8")
        with pytest.raises(InputError, match=r"its variable 'radial_velocity' announces 8000000000000 bytes"):
            read(tmp_path / "a.nc", SIX)

    def test_a_flipped_bit_in_checked_metadata(self, tmp_path):
        file = self.write(tmp_path, engine="h5netcdf")
        raw = bytearray(file.read_bytes())
        raw[raw.find(b"radial_velocity") + 3] ^= 1
        file.write_bytes(raw)
        with pytest.raises(InputError, match=r"a.nc' cannot be read as NetCDF: .*; check that it is complete"):
            read(file, SIX)


def _main(kind: str, first: int, last: int) -> None:
    damage = mutate_in_place if kind in ("heap", "old") else mutate
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    with tempfile.TemporaryDirectory() as folder:
        file = COMPILED[kind](Path(folder))
        raw = file.read_bytes()
        assert check(file)
        netcdf_guard.SECONDS = 3.0  # a damaged file may be refused for any reason
        for seed in range(first, last):
            file.write_bytes(damage(raw, seed))
            used = resource.getrusage(resource.RUSAGE_SELF)
            limit = used.ru_utime + used.ru_stime + CPU_SECONDS_PER_FILE
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit), most))
            check(file)
            sys.stdout.write(f"{kind}:{seed}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    for named in sys.argv[1].split(","):
        _main(named, int(sys.argv[2]), int(sys.argv[3]))
