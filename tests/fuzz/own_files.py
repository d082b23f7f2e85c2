"""Files of our own that come back in changed: what a tool, a disk or a hand may have made of them.

One folder of files is made, once; each case copies what it needs, changes one file by its meaning or by its bytes, in
half of the cases with fingerprints that are made anew to fit, and runs what reads it.
"""

import io
import json
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr

import bayes_rs as brs
from bayes_rs.campaign import sampling
from bayes_rs.cli import fit_commands
from bayes_rs.ledger import LEDGER, fingerprint_of_file, read_ledger, write_ledger
from bayes_rs.noise.sealed import _seal
from bayes_rs.output import write_netcdf
from fuzz.frame import Case, command, python

SCAN = "6-beam@opening_angle_deg=45,focus_distance=52"
EFFORT = {"target_ess": 100, "sampler": "direct", "seed": 1, "campaign": "on"}
RUN_TOO = ("run.json", LEDGER)
"""Files of a fit that hold the time that it took."""
PICTURES = ("report.html", "summary.csv", "stresses.csv", "stresses.png", "corner.png", "campaign.png")


@dataclass(frozen=True)
class Scene:
    """What all cases begin with: files in one folder, and what is in the fit when nothing was changed."""

    place: Path
    summary: pd.DataFrame
    draws: np.ndarray

    @property
    def data(self) -> Path:
        """Radial velocities."""
        return self.place / "data.parquet"


@cache
def scene() -> Scene:
    """Make the files."""
    place = Path(tempfile.mkdtemp(prefix="fuzz-own-"))
    os.environ["BAYES_RS_CACHE"] = str(place / "cache")
    sampling._BURN_IN, sampling._BLOCK = (10, 10), 40
    sampling._Run.effective = lambda self, target_ess: (100.0, 1.0, True)  # noqa: ARG005 - what it finds does not matter
    fit_commands.draw_pictures = lambda found, folder: None  # noqa: ARG005 - some cases draw, others need not wait
    shutil.copy(brs.demo_file("6-beam-45"), place / "data.parquet")
    records = brs.make_records(brs.read(place / "data.parquet", SCAN), SCAN)
    write_netcdf(records, place / "records.nc")
    brs.noise.calibrate(SCAN, wind_speed=10.0, cache=False).save(place / "noise.nc")
    settings = brs.Settings().changed(
        scan=SCAN,
        files=[str(place / "data.parquet")],
        noise=str(place / "noise.nc"),
        output=str(place / "fit"),
        derived=("ti", "tke"),
        **EFFORT,
    )
    found = brs.fit_files(settings, progress=False)
    shutil.copytree(place / "fit", place / "begun")
    settings.save(place / "settings.toml")
    begun = place / "begun"
    ledger = read_ledger(begun)
    for name in [
        name for name in ledger.files if name.startswith(("campaign", "posterior.nc", "summary.csv", "stresses.csv"))
    ]:
        (begun / name).unlink()
        ledger.put(name, None)
    write_ledger(begun, ledger, finished=False)
    _load_all(place)
    return Scene(place, found.summary(), found.draws())


def _load_all(place: Path) -> None:
    """Load what the commands load when they are called, once and not in every process."""
    here = Path.cwd()
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        for arguments in (
            ("report", "fit", "-o", "report.html"),
            ("corner", "fit", "-o", "corner.png"),
            ("records", "data.parquet", "--scan", SCAN, "-o", "again.nc"),
            ("spectra", "data.parquet", "--scan", SCAN, "-o", "spectra"),
        ):
            command(*arguments)(place)
        _everything(place, "fit", None)
    os.chdir(here)


# ---- changes of a file by its meaning -------------------------------------------------------------------------------


def change_bytes(file: Path, rng: np.random.Generator) -> None:
    """Change a file at the level of its bytes."""
    content = bytearray(file.read_bytes())
    how = rng.integers(6)
    if how == 0:
        content = content[: rng.integers(len(content) + 1)]
    elif how == 1:
        for _ in range(int(rng.integers(1, 8))):
            content[rng.integers(len(content))] = rng.integers(256)
    elif how == 2:
        at = rng.integers(len(content))
        content[at : at + int(rng.integers(1, 200))] = b""
    elif how == 3:
        at = rng.integers(len(content))
        content[at:at] = rng.bytes(int(rng.integers(1, 60)))
    elif how == 4:
        content = bytearray([b"", b"\x00", b"\xff\xfe\x00", b"null", b"[]", b"{}", b"\n"][rng.integers(7)])
    else:
        at = rng.integers(len(content))
        content[at : at + 64] = bytes(min(64, len(content) - at))
    file.write_bytes(bytes(content))


_VALUES: list[Any] = [
    None, True, -1, 0, 7, 10**30, 1e300, -1e300, float("nan"), float("inf"), "", "text", "ü\u0000\n<b>", "nan", "inf",
    [], [1, "a", None], {}, {"a": {"b": [1]}}, [[[[]]]], 10**400, 0.5, "1",
]  # fmt: skip


def change_plain(content: Any, rng: np.random.Generator) -> Any:
    """Change one place of what JSON holds."""
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, value in items:
            places.append((node, key))
            walk(value)

    walk(content)
    if not places or rng.random() < 0.03:
        return _VALUES[rng.integers(len(_VALUES))]
    depth: dict[int, int] = {id(content): 0}
    for node, key in places:
        depth[id(node[key])] = depth[id(node)] + 1
    near = [one for one in places if depth.get(id(one[0]), 9) < 1]
    chosen = near if near and rng.random() < 0.6 else places
    node, key = chosen[rng.integers(len(chosen))]
    how = rng.integers(5)
    if how == 0:
        del node[key]
    elif how == 1 and isinstance(node, dict):
        node[f"{key}x"] = node.pop(key)
    elif how == 2 and isinstance(node[key], (list, dict)) and node[key]:
        if isinstance(node[key], list):
            node[key] = node[key] * 2 if rng.random() < 0.5 else node[key][1:]
        else:
            node[key] = list(node[key])
    else:
        node[key] = _VALUES[rng.integers(len(_VALUES))]
    return content


def change_json(file: Path, rng: np.random.Generator) -> None:
    """Change a JSON file by its meaning, or how it is written."""
    how = rng.integers(12)
    text = file.read_text(encoding="utf-8")
    if how == 0:
        file.write_bytes(text.encode("utf-16"))
    elif how == 1:
        file.write_bytes(text.replace("e", "\xe9", 3).encode("latin-1"))
    elif how == 2:
        depth = int(rng.choice([10, 5_000, 200_000]))
        file.write_text("[" * depth + "]" * depth, encoding="utf-8")
    elif how == 3:
        file.write_text(text.rstrip()[:-1], encoding="utf-8")
    elif how == 4:
        file.write_text("9" * 6000, encoding="utf-8")
    else:
        changed = json.loads(text)
        for _ in range(int(rng.integers(1, 3))):
            changed = change_plain(changed, rng)
        file.write_text(json.dumps(changed), encoding="utf-8")


_UNITS = ("km h-1", "knots", "rad", "degree", "m", "1", "", "no unit", "m2 s-2", 3.0)


def change_dataset(file: Path, rng: np.random.Generator) -> None:
    """Change a NetCDF file by its meaning."""
    dataset = xr.load_dataset(file, engine="h5netcdf", decode_times=False)
    write_netcdf(_changed(dataset, rng), file)


Item = tuple[tuple[Any, ...], np.ndarray, dict[Any, Any]]
"""Dimensions, values and attributes of a variable."""


def _as_numbers(item: Item, rng: np.random.Generator) -> Item:
    dims, values, attributes = item
    values = values.astype(np.float64)
    values[rng.random(values.shape) < rng.choice([0.1, 1.0])] = rng.choice(
        [np.nan, np.inf, -np.inf, 1e300, -1.0, 0.0, 1e-300]
    )
    return dims, values, attributes


def _of_another_type(item: Item, rng: np.random.Generator) -> Item:
    kind = [np.int8, np.uint64, np.float32, np.int64, np.bool_][rng.integers(5)]
    with np.errstate(all="ignore"):
        return item[0], item[1].astype(kind), item[2]


def _with_attribute(item: Item, rng: np.random.Generator) -> Item:
    attributes = dict(item[2])
    if attributes and rng.random() < 0.5:
        attributes.pop(str(list(attributes)[rng.integers(len(attributes))]))
    else:
        attributes["flag_masks"] = [np.array([1, 2]), "1 2", 3.5][rng.integers(3)]
    return item[0], item[1], attributes


_OF_ITEM: list[Callable[[Item, np.random.Generator], Item]] = [
    lambda item, rng: (item[0], item[1].astype(str).astype(object), item[2]),  # noqa: ARG005 - as all
    lambda item, rng: (item[0], np.full(item[1].shape, np.datetime64("2020-01-01", "ns")), item[2]),  # noqa: ARG005
    lambda item, rng: (item[0][::-1], item[1].T, item[2]),  # noqa: ARG005
    lambda item, rng: (item[0][:-1], item[1][..., 0], item[2]),  # noqa: ARG005
    lambda item, rng: (item[0], item[1], {**item[2], "units": _UNITS[rng.integers(len(_UNITS))]}),
    lambda item, rng: (tuple(f"{dim}_x" for dim in item[0]), item[1], item[2]),  # noqa: ARG005
    lambda item, rng: (item[0], item[1].astype(np.float64) * rng.choice([-1.0, 1e3, 1e-3, 1e12]), item[2]),
    _as_numbers,
    _of_another_type,
    _with_attribute,
]
_FIRST = ("variance", "flag", "wind_speed", "yaw", "beam", "time", "gain", "covariance")
"""Variables that everything depends on."""


def _changed(dataset: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
    names = [str(name) for name in dataset.variables]
    first = [name for name in _FIRST if name in names]
    name = str(rng.choice(first if rng.random() < 0.4 else names))
    how = int(rng.integers(len(_OF_ITEM) + 5))
    if how == 0:
        return dataset.drop_vars(name)
    if how == 1:
        return dataset.rename({name: f"{name}_x"})
    if how == 2:
        which = list(dataset.sizes)[int(rng.integers(len(dataset.sizes)))]
        return dataset.isel({which: slice(int(rng.integers(2)), int(rng.integers(0, 5)))})
    if how in (3, 4):
        return _changed_attribute(dataset, rng)
    found = dataset[name].variable
    dims, values, attributes = _OF_ITEM[how - 5]((found.dims, np.asarray(found.values), dict(found.attrs)), rng)
    rest = dataset.drop_vars(name)
    if any(rest.sizes.get(dim, size) != size for dim, size in zip(dims, values.shape, strict=True)):
        dims = tuple(f"{dim}_y" for dim in dims)
    changed = xr.Variable(dims, values, attributes)
    return rest.assign_coords({name: changed}) if name in dataset.coords else rest.assign({name: changed})


def _changed_attribute(dataset: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
    attributes = dict(dataset.attrs)
    key = str(list(attributes)[rng.integers(len(attributes))])
    if rng.random() < 0.6 and isinstance(attributes[key], str) and attributes[key][:1] in "{[":
        attributes[key] = json.dumps(change_plain(json.loads(attributes[key]), rng))
    elif rng.random() < 0.3:
        del attributes[key]
    else:
        odd: list[Any] = ["", "text", 0.0, -5.0, 1e300, np.nan, np.array([1.0, 2.0]), 3, "{}", "[]", "null", "1e400"]
        attributes[key] = odd[rng.integers(len(odd))]
    changed = dataset.copy()
    changed.attrs = attributes
    return changed


def _some_numbers(column: Any, rng: np.random.Generator) -> pa.Array:
    kind, odd = (np.int64, [-1, 0, 10**9, 2**62, -(2**63)])
    if pa.types.is_floating(column.type):
        kind, odd = (np.float64, [np.nan, np.inf, 1e300, -1e300, -1.0])
    values = column.to_numpy(zero_copy_only=False).astype(kind)
    values[rng.random(len(values)) < rng.choice([0.02, 1.0])] = odd[rng.integers(len(odd))]
    return pa.array(values)


_OF_COLUMN: list[Callable[[Any, np.random.Generator], pa.Array]] = [
    lambda column, rng: pa.array([str(value) for value in column.to_pylist()]),  # noqa: ARG005 - as all
    lambda column, rng: pa.array([str(value).encode() + b"\xff" for value in column.to_pylist()]),  # noqa: ARG005
    lambda column, rng: pa.array([[value] for value in column.to_pylist()]),  # noqa: ARG005
    lambda column, rng: pa.array([{"a": value} for value in column.to_pylist()]),  # noqa: ARG005
    lambda column, rng: pa.nulls(len(column), column.type if rng.random() < 0.5 else None),
    lambda column, rng: pa.array([True] * len(column)),  # noqa: ARG005
    _some_numbers,
    _some_numbers,
]
_OF_TABLE: list[Callable[[pa.Table, str, np.random.Generator], pa.Table]] = [
    lambda table, name, rng: table.drop_columns([name]),  # noqa: ARG005
    lambda table, name, rng: table.rename_columns([f"{one}x" if one == name else one for one in table.column_names]),  # noqa: ARG005
    lambda table, name, rng: table.slice(0, int(rng.integers(table.num_rows))),  # noqa: ARG005
    lambda table, name, rng: table.slice(int(rng.integers(1, 3))),  # noqa: ARG005
    lambda table, name, rng: pa.concat_tables([table, table.slice(0, int(rng.integers(1, 4)))]),  # noqa: ARG005
    lambda table, name, rng: table.take(pa.array(rng.permutation(table.num_rows))),  # noqa: ARG005
    lambda table, name, rng: table.append_column(name, table.column(name)),  # noqa: ARG005
]


def change_parquet(file: Path, rng: np.random.Generator) -> None:
    """Change a Parquet file by its meaning."""
    table = pq.ParquetFile(file).read()
    first = [one for one in table.column_names if one in ("record", "time", "stress", "flag_bits", "uu", "mean")]
    name = str(rng.choice(first if first and rng.random() < 0.3 else table.column_names))
    how = int(rng.integers(len(_OF_COLUMN) + len(_OF_TABLE)))
    if how < len(_OF_COLUMN):
        column = table.column(name).combine_chunks()
        table = table.set_column(table.column_names.index(name), name, _OF_COLUMN[how](column, rng))
    else:
        table = _OF_TABLE[how - len(_OF_COLUMN)](table, name, rng)
    sink = io.BytesIO()
    pq.write_table(table, sink)
    file.write_bytes(sink.getvalue())


def change_npz(file: Path, rng: np.random.Generator) -> None:
    """Change the state of reading by its meaning."""
    with np.load(file) as found:
        entries = {name: found[name] for name in found}
    name = str(list(entries)[rng.integers(len(entries))])
    if name == "meta" or rng.random() < 0.5:
        entries["meta"] = np.array(json.dumps(change_plain(json.loads(entries["meta"].item()), rng)))
        if rng.random() < 0.2:
            odd = [np.array(3), np.array(["a", "b"]), np.array("{"), np.array(["x"], dtype=object), np.array("[]")]
            entries["meta"] = odd[rng.integers(len(odd))]
    else:
        values = entries.pop(name)
        how = rng.integers(6)
        if how == 1:
            entries[name] = values.astype(str)
        elif how == 2:
            entries[name] = values[:-3]
        elif how == 3:
            entries[name] = np.stack([values, values])
        elif how == 4:
            entries[name] = np.array(5)
        elif how == 5:
            entries[name] = values.astype(object)
    with file.open("wb") as opened:
        np.savez(opened, **entries)


def change_text(file: Path, rng: np.random.Generator) -> None:
    """Change a table or a settings file of text: lines, entries and numbers."""
    lines = file.read_text(encoding="utf-8").splitlines()
    at = int(rng.integers(len(lines)))
    how = rng.integers(7)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(at, lines[at])
    elif how == 2:
        lines[0] = lines[0].replace("mean", "meanx", 1) if rng.random() < 0.5 else lines[0][: len(lines[0]) // 2]
    elif how == 3:
        mark = "," if "," in lines[at] else "="
        cells = lines[at].split(mark)
        cells[rng.integers(len(cells))] = str(rng.choice(["", "nan", "inf", "1e400", "text", "-1", "1e300", "[]", '"']))
        lines[at] = mark.join(cells)
    elif how == 4:
        lines[at] = lines[at][: len(lines[at]) // 2]
    elif how == 5:
        lines = lines[:at]
    else:
        lines[at] = lines[at].replace("0", "\x00", 1)
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def change_ledger(file: Path, rng: np.random.Generator) -> None:
    """Change the list of a folder: lines lost, doubled, exchanged; or changed, with a checksum that fits."""
    from bayes_rs.ledger import _line  # noqa: PLC0415 - the form of a line, which is ours alone

    lines = file.read_bytes().splitlines(keepends=True)
    at = int(rng.integers(len(lines)))
    how = rng.integers(6)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(at, lines[at])
    elif how == 2:
        other = int(rng.integers(len(lines)))
        lines[at], lines[other] = lines[other], lines[at]
    elif how == 3:
        lines = lines[: at + 1]
        lines[-1] = lines[-1][: rng.integers(len(lines[-1]))]
    else:
        entry = change_plain(json.loads(lines[at]), rng)
        if isinstance(entry, dict):
            entry.pop("check", None)
            lines[at] = _line(entry)
        else:
            lines[at] = json.dumps(entry).encode() + b"\n"
    file.write_bytes(b"".join(lines))


_BY_SUFFIX: dict[str, Callable[[Path, np.random.Generator], None]] = {
    ".json": change_json,
    ".nc": change_dataset,
    ".parquet": change_parquet,
    ".npz": change_npz,
    ".csv": change_text,
    ".toml": change_text,
    ".jsonl": change_ledger,
}


def reseal(folder: Path) -> None:
    """Make the list of a folder fit what is in it."""
    ledger = read_ledger(folder)
    if ledger is None or ledger.damaged:
        return
    for name in list(ledger.files):
        if (folder / name).is_file():
            ledger.put(name, fingerprint_of_file(folder / name))
    write_ledger(folder, ledger, finished=ledger.finished)


# ---- what reads them ------------------------------------------------------------------------------------------------


def _everything(folder: Path, name: str, expected: Scene | None, rng: np.random.Generator | None = None) -> None:
    """Open a fit and ask for everything, or for some; if nothing was sealed anew, numbers are those of before."""
    found = brs.open_fit(folder / name)
    asked: list[Callable[[], Any]] = [
        found.summary,
        lambda: found.summary(prob=0.5),
        lambda: found.summary(frame="lidar"),
        lambda: found.summary(derived=("ti", "anisotropy_2")),
        found.directions,
        found.campaign,
        found.campaign_hyper,
        found.campaign_prior,
        lambda: found.summary(campaign=True),
        found.covariance,
        found.draws,
        lambda: found.draws(1),
        lambda: found.draws("2000-01-01T00:10"),
        found.predicted_draws,
        found.lidar_frame,
        found.to_arviz,
        lambda: (found.words, found.failures, found.remarks, found.flags, found.n_fitted, repr(found), found.attrs),
        lambda: found.records,
        lambda: found.prior_draws,
        lambda: brs.plot.stresses(found),
        lambda: brs.plot.corner(found, 0),
    ]
    for one in asked if rng is None else [asked[index] for index in rng.permutation(len(asked))[:8]]:
        try:
            one()
        except brs.InputError as error:
            text = str(error)
            if not text.strip() or "\n" in text or len(text) > 2000:
                raise AssertionError(f"not one line: {text[:300]!r}") from error
    if expected is not None:
        pd.testing.assert_frame_equal(found.summary(), expected.summary)
        np.testing.assert_array_equal(found.draws(), expected.draws)


def _whole(folder: Path, name: str) -> Callable[[int | None, str], str]:
    """Compare a folder that was resumed with the one that was never damaged."""

    def check(code: int | None, output: str) -> str:  # noqa: ARG001 - as every check
        if code not in (0, 1):
            return ""
        before = scene().place / "fit"
        for file in sorted(before.rglob("*")):
            own = file.relative_to(before)
            if file.is_file() and file.name not in RUN_TOO and (folder / name / own).read_bytes() != file.read_bytes():
                return f"{own} is not what an undamaged run writes"
        return ""

    return check


def _refused(code: int | None, output: str) -> str:  # noqa: ARG001 - as every check
    return "" if code == 2 else f"not refused, but exit code {code}"


def _fit_case(rng: np.random.Generator, name: str, seed: int) -> Case:
    """Change a file of a fit, finished or begun."""
    made = scene()
    which = "begun" if rng.random() < 0.3 else "fit"
    files = sorted(
        file.relative_to(made.place / which).as_posix() for file in (made.place / which).rglob("*") if file.is_file()
    )
    files = [
        file for file in files if not file.endswith((".png", ".html", "posterior.nc", "summary.csv", "stresses.csv"))
    ]
    file = files[rng.integers(len(files))]
    by_bytes, sealed = rng.random() < 0.25, rng.random() < 0.6
    how = int(rng.integers(6)) if which == "fit" else int(rng.integers(4))
    resume = ("fit", made.place / "settings.toml", "-o", which, "--resume")

    def prepare(folder: Path) -> None:
        shutil.copytree(made.place / which, folder / which)
        own = np.random.default_rng(seed)
        _change(folder / which / file, own, by_bytes=by_bytes)
        if sealed and file != LEDGER:
            reseal(folder / which)

    intact = not sealed and file != LEDGER
    if how == 0:
        run = command("report", which, "--overwrite")
    elif how == 1:
        run = command("corner", which, "--overwrite")
    elif how in (2, 3):
        run = python(lambda folder: _everything(folder, which, made if intact else None, rng))
    elif how == 4:
        run = command("fit", f"{which}/run.json", "-o", "again")
    else:
        run = command(*resume)
    if which == "begun" and how != 0:
        run = command(*resume)
    label = f"{name} {which}/{file}{' bytes' if by_bytes else ''}{' sealed' if sealed else ''} how={how}"

    def whole(folder: Path) -> int | None:
        prepare(folder)
        code = run(folder)
        if intact and run_is_resume:
            complaint = _whole(folder, which)(code, "")
            if complaint:
                sys.stderr.write(f"\nCOMPLAINT: {complaint}\n")
        return code

    run_is_resume = how == 5 or (which == "begun" and how != 0)
    return Case(label, whole)


def _change(file: Path, rng: np.random.Generator, *, by_bytes: bool) -> None:
    """Change a file; by its bytes if what comes of a change by its meaning cannot be written."""
    before = file.read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            (change_bytes if by_bytes else _BY_SUFFIX[file.suffix])(file, rng)
    except Exception:  # noqa: BLE001 - what no writer writes is no input
        file.write_bytes(before)
        change_bytes(file, rng)


def _single_case(rng: np.random.Generator, name: str, seed: int) -> Case:
    """Change records, noise or radial velocities that are given to a command."""
    made = scene()
    kind = ("records.nc", "records.nc", "noise.nc", "noise.nc", "data.parquet", "settings.toml")[rng.integers(6)]
    by_bytes = rng.random() < 0.2
    sealed = rng.random() < 0.7
    how = int(rng.integers(3))
    scan = ("--scan", SCAN)
    effort = ("--ess", "100", "--sampler", "direct", "--seed", "1")
    if kind == "records.nc":
        run = [
            command("fit", "records.nc", *scan, *effort, "-o", "out", "--noise", made.place / "noise.nc"),
            command("fit", "records.nc", *scan, *effort, "-o", "out", "--yaw-sd", "records"),
            command("sensitivity", "records.nc", *scan, *effort, "--noise", made.place / "noise.nc"),
        ][how]
    elif kind == "noise.nc":
        run = [
            command("fit", made.place / "records.nc", *scan, *effort, "-o", "out", "--noise", "noise.nc"),
            python(lambda folder: repr(brs.noise.load(folder / "noise.nc").in_words())),
            command(
                "fit",
                made.place / "records.nc",
                *scan,
                *effort,
                "-o",
                "out",
                "--noise",
                "noise.nc",
                "--target",
                "ensemble",
            ),
        ][how]
    elif kind == "data.parquet":
        run = [
            command("records", "data.parquet", *scan, "-o", "out.nc"),
            command("fit", "data.parquet", *scan, *effort, "-o", "out", "--noise", made.place / "noise.nc"),
            command("spectra", "data.parquet", *scan, "-o", "out"),
        ][how]
    else:
        run = command("fit", "settings.toml", "-o", "out")

    def whole(folder: Path) -> int | None:
        file = folder / kind
        shutil.copy(made.place / kind, file)
        _change(file, np.random.default_rng(seed), by_bytes=by_bytes)
        if kind == "noise.nc" and sealed and not by_bytes:
            file.write_bytes(file.read_bytes() + _seal(file.read_bytes()))
        return run(folder)

    return Case(f"{name} {kind}{' bytes' if by_bytes else ''}{' sealed' if sealed else ''} how={how}", whole)


def cases(seed: int, n: int) -> Iterator[Case]:
    """Give so many cases; the same ones for the same seed."""
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        own = int(rng.integers(2**31))
        case = (_fit_case if rng.random() < 0.6 else _single_case)(rng, f"own {seed}/{number}", own)
        yield replace(case)
