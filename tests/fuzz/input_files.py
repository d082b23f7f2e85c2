"""Files of radial velocities, damaged: by bytes, and by what they say; every reader gives a series or one line."""

import io
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fuzz.frame import Case, python

sys.path.append(str(Path(__file__).parents[1]))

import test_reader_fuzz as readers
from format_files import long_frame, wide_frame

from bayes_rs.readers import netcdf_guard

CELLS = [
    "today", "now", "tomorrow", "10:30", "Mon", "1e400", "-1e-400", "0x1F", "1_000", "١٢", "−3.1", "1.234,5", "1,5", " ",
    "", "nan", "NaN", "None", "NULL", "#N/A", "inf", "-Infinity", "True", "=1+1", '"', "'", "\\", "a" * 70000, "2020", "20200101",
    "2020-02-30T00:00:00", "2020-01-01T25:00:00", "0000-00-00T00:00:00", "9999-12-31T23:59:59", "1e18", "-1", "99999999999999999999",
    "\N{ZERO WIDTH SPACE}1", "1\N{NO-BREAK SPACE}000", "٣", "½", "1e5000", "--1", "1..2", "+", ".", "1;2", "[1]", "{}", "b'1'",
]  # fmt: skip
ATTRIBUTES = [
    "", "m/s", "deg", "today", "seconds since today", "days since 0000-00-00", "nanoseconds since 1e300", "seconds since",
    np.nan, np.inf, 0.0, 0, -1, np.float32(1e38), np.array([1, 2, 3]), np.array([], dtype=float), "\udc80".encode("utf-8", "surrogatepass"),
    np.array(["a", "b"], dtype=object), b"\xff", 2**63 - 1, "standard", "julian", "360_day", "nonsense", "M8[ns]", "away", "up",
]  # fmt: skip
NAMES = ["units", "calendar", "scale_factor", "add_offset", "_FillValue", "missing_value", "valid_range", "valid_min",
         "valid_max", "dtype", "coordinates", "positive", "status_valid", "Conventions", "kind", "_Unsigned", "bounds"]  # fmt: skip


def _draw(rng: np.random.Generator, entries: list) -> object:
    return entries[int(rng.integers(len(entries)))]


def cell_of_text(raw: bytes, rng: np.random.Generator) -> bytes:
    """Replace one cell, or all of one column, of a table of text."""
    lines = raw.decode("utf-8", "surrogateescape").split("\n")
    separator = max(",;\t ", key=lines[-1].count)
    word, column = str(_draw(rng, CELLS)), int(rng.integers(8))
    some = [int(rng.integers(len(lines)))] if rng.random() < 0.6 else range(int(rng.integers(3)), len(lines))
    for index in some:
        cells = lines[index].split(separator)
        cells[column % len(cells)] = word
        lines[index] = separator.join(cells)
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def lines_of_text(raw: bytes, rng: np.random.Generator) -> bytes:
    """Repeat, move, join, break, comment out or encode lines of a table of text."""
    lines = raw.split(b"\n")
    at = int(rng.integers(len(lines)))
    match int(rng.integers(9)):
        case 0:
            lines.insert(at, lines[0])
        case 1:
            lines = lines[::-1]
        case 2:
            lines[at] = lines[at] * int(rng.integers(2, 50))
        case 3:
            lines[at] = b"# " + lines[at]
        case 4:
            lines.insert(at, b"\0" * int(rng.integers(1, 5000)))
        case 5:
            return raw.decode("utf-8", "replace").encode(
                str(_draw(rng, ["utf-16", "utf-32", "cp037", "utf-8-sig"])), "replace"
            )
        case 6:
            lines.insert(at, b'"' + lines[at])
        case 7:
            return b"\r".join(lines)
        case _:
            lines = [b";".join([line, line]) for line in lines]
    return b"\n".join(lines)


def netcdf_attribute(file: Path, rng: np.random.Generator) -> None:
    """Change an attribute of a NetCDF-4 file as another program might."""
    with h5py.File(file, "a") as opened:
        items = [opened, *(opened[name] for name in opened)]
        item, name = _draw(rng, items), str(_draw(rng, NAMES))
        try:
            if name in item.attrs:
                del item.attrs[name]
            if rng.random() < 0.8:
                item.attrs[name] = _draw(rng, ATTRIBUTES)
        except (TypeError, ValueError, OSError):
            pass  # h5py writes no such attribute


def netcdf_variable(file: Path, rng: np.random.Generator) -> None:
    """Take a variable out of a NetCDF-4 file, or put another in its place: of another type, length, rank or values."""
    with h5py.File(file, "a") as opened:
        name = str(_draw(rng, list(opened)))
        if not isinstance(opened[name], h5py.Dataset):
            del opened[name]
            return
        values, attributes = opened[name][()], dict(opened[name].attrs)
        del opened[name]
        if rng.random() < 0.2:
            return
        number = np.asarray(values, dtype=float) if np.asarray(values).dtype.kind in "iuf" else np.arange(3.0)
        made = [
            lambda: number[..., None], lambda: number[:-1] if number.ndim else 0.0, lambda: np.full(number.shape, np.nan),
            lambda: number * 1e300, lambda: np.array([b"a"] * max(number.size, 1)), lambda: number.astype(complex),
            lambda: number.astype(bool), lambda: number.astype("f2"), lambda: np.empty((0, *number.shape[1:])),
            lambda: h5py.Empty("f8"), lambda: np.zeros(number.shape, dtype=[("a", "f8"), ("b", "i4")]), lambda: number.ravel()[:1],
            lambda: np.repeat(number, 3), lambda: -number, lambda: number.astype("u1"), lambda: np.broadcast_to(number[..., None], (*number.shape, 2)),
        ]  # fmt: skip
        with np.errstate(all="ignore"):
            opened[name] = made[int(rng.integers(len(made)))]()
        if rng.random() < 0.5:
            for key, value in attributes.items():
                if key not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
                    opened[name].attrs[key] = value


def netcdf_scales(file: Path, rng: np.random.Generator) -> None:
    """Let a dimension scale of a NetCDF-4 file be gone, point to what is gone, or to itself."""
    with h5py.File(file, "a") as opened:
        scales = [name for name in opened if "CLASS" in opened[name].attrs]
        others = [name for name in opened if "DIMENSION_LIST" in opened[name].attrs]
        if not scales or not others:
            return
        scale, other = str(_draw(rng, scales)), str(_draw(rng, others))
        opened.create_dataset("gone", data=np.arange(3.0))
        target = _draw(rng, [opened["gone"].ref, opened[other].ref, opened[scale].ref, opened.ref, h5py.Reference()])
        kind = int(rng.integers(4))
        if kind == 0:
            del opened[scale]
        elif kind == 1:
            reference = np.dtype([("dataset", h5py.ref_dtype), ("dimension", "i4")])
            opened[scale].attrs.create("REFERENCE_LIST", np.array([(target, 7)], dtype=reference))
        elif kind == 2:
            entries = np.empty(int(rng.integers(1, 4)), dtype=object)
            for index in range(len(entries)):
                entries[index] = np.array([target] * int(rng.integers(3)), dtype=h5py.ref_dtype)
            del opened[other].attrs["DIMENSION_LIST"]
            opened[other].attrs.create("DIMENSION_LIST", entries, dtype=h5py.vlen_dtype(h5py.ref_dtype))
        else:
            opened[scale].attrs[str(_draw(rng, ["CLASS", "NAME", "_Netcdf4Dimid"]))] = _draw(
                rng, [b"x", 99, -5, b"This is a netCDF dimension but not a netCDF variable.         9"]
            )
        del opened["gone"]


def parquet_column(file: Path, rng: np.random.Generator) -> None:
    """Give a column of a Parquet file another type or name."""
    table = pq.read_table(file)
    index = int(rng.integers(table.num_columns))
    name, n = table.column_names[index], table.num_rows
    made: list[Callable[[], pa.Array]] = [
        lambda: pa.array([[1.0, 2.0]] * n), lambda: pa.array([{"a": 1}] * n), lambda: pa.array([b"\xff"] * n),
        lambda: pa.array([None] * n), lambda: pa.array(["a"] * n).dictionary_encode(), lambda: pa.array([True] * n),
        lambda: pa.array(range(n), pa.time64("ns")), lambda: pa.array(range(n), pa.date32()), lambda: pa.array(range(n), pa.duration("s")),
        lambda: pa.array(range(n), pa.timestamp("us", "Europe/Paris")), lambda: pa.array([1.5] * n, pa.float16()), lambda: pa.nulls(n, pa.float64()),
        lambda: pa.array(["2020-01-01T00:00:00"] * n, pa.large_string()), lambda: pa.array([2**63] * n, pa.uint64()),
        lambda: pa.array(["today"] * n),
    ]  # fmt: skip
    column = made[int(rng.integers(len(made)))]()
    table = table.set_column(index, str(_draw(rng, [name, name, name, "", table.column_names[0], "a.b"])), column)
    pq.write_table(table, file)


def classic(folder: Path, rng: np.random.Generator) -> Path:
    """A classic NetCDF file with another attribute."""
    series = readers.SHORT.assign_coords(beam=readers.SHORT["beam"].astype(np.int32))
    value = _draw(rng, [entry for entry in ATTRIBUTES if isinstance(entry, (str, float, int))])
    variable = str(_draw(rng, [str(name) for name in series.variables if name != "time"]))
    try:
        series[variable].attrs[str(_draw(rng, [name for name in NAMES if name != "_FillValue"]))] = value
        series.to_netcdf(folder / "a.nc", format="NETCDF3_64BIT", engine="scipy")
    except (AttributeError, TypeError, ValueError, OverflowError):
        readers.SHORT.to_netcdf(folder / "a.nc", format="NETCDF3_64BIT", engine="scipy")
    return folder / "a.nc"


def _table(kind: str) -> bytes:
    frame = long_frame(readers.SHORT) if kind == "long" else wide_frame(readers.SHORT)
    text = io.StringIO()
    frame.to_csv(text, index=False)
    return text.getvalue().encode()


def _read(file: Path, **options: object) -> None:
    netcdf_guard.SECONDS = 3.0  # a damaged file may be refused for any reason
    readers.check(file, **options)


def _case(name: str, seed: int, source: Path, damage: Callable[[Path], None], options: dict) -> Case:
    def call(folder: Path) -> None:
        file = Path(shutil.copy(source, folder / source.name))
        damage(file)
        _read(file, **options)

    return Case(f"{name}:{seed}", python(call))


def _bytes(change: Callable[[bytes, object], bytes], with_seed: object, file: Path) -> None:
    file.write_bytes(change(file.read_bytes(), with_seed))


def cases(seed: int, n: int) -> Iterator[Case]:
    """Give `n` damaged files, of all formats in turn."""
    with tempfile.TemporaryDirectory(prefix="fuzz-inputs-") as place:
        text: dict[str, tuple[Path, dict]] = {}
        compiled: dict[str, Path] = {}
        for name, (write, options) in readers.TEXT.items():
            folder = Path(place) / f"t-{name.replace(' ', '-')}"
            folder.mkdir()
            text[name] = (write(folder), options)
        for name, make in readers.COMPILED.items():
            folder = Path(place) / f"c-{name}"
            folder.mkdir()
            compiled[name] = make(folder)
        hdf5 = [name for name in compiled if name not in ("arm", "classic", "parquet", "zst")]
        for index in range(n):
            one = seed * 1_000_000 + index
            rng = np.random.default_rng(one)
            kind = index % 8
            if kind < 3:
                name = str(_draw(rng, list(text)))
                source, options = text[name]
                change, given = [(readers.mutate, one), (cell_of_text, rng), (lines_of_text, rng)][kind]
                yield _case(f"{change.__name__} {name}", one, source, partial(_bytes, change, given), options)
            elif kind == 3:
                name = str(_draw(rng, list(compiled)))
                change = readers.mutate_in_place if name in ("heap", "old") else readers.mutate
                yield _case(f"bytes {name}", one, compiled[name], partial(_bytes, change, one), {})
            elif kind == 4:
                source = compiled["parquet"]
                yield _case("parquet", one, source, lambda file, rng=rng: parquet_column(file, rng), {})
            elif kind == 5 and rng.random() < 0.25:
                yield Case(f"classic:{one}", python(lambda folder, rng=rng: _read(classic(folder, rng))))
            else:
                name = str(_draw(rng, hdf5))
                change = [netcdf_attribute, netcdf_variable, netcdf_scales][kind - 5]
                damage = lambda file, change=change, rng=rng: change(file, rng)  # noqa: E731 - one case's own
                yield _case(f"{change.__name__} {name}", one, compiled[name], damage, {})
