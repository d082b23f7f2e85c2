"""What reading many files has done so far, and how that is kept in the folder of their records."""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import xarray as xr
from pydantic import ConfigDict, Field

from bayes_rs.errors import InputError
from bayes_rs.layouts import Count, Entry, Open, check_dataset, read_json
from bayes_rs.output import write_netcdf
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.records.layout import OF_RANGES, REPORT, check_layout
from bayes_rs.records.stream import StreamState
from bayes_rs.result_folder import ResultFolder

STATE_FILE = "records/state.npz"
_SAMPLE = ("sample",)
_AGAIN = "the files are read again"
_OF_PART = ("variance", "mean", "count", "flag", "wind_speed", "yaw", "record_flag", "time", "beam")
"""Variables that every part of the records has."""
_HEAD = 65_536  # bytes
UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    zlib.error,
    lzma.LZMAError,
    zipfile.BadZipFile,
    pa.ArrowException,
)
"""What libraries raise for a file that is not what it should be."""


@dataclass(frozen=True)
class ReadSoFar:
    """What is done: the state of the stream, which files and parts it comes from, and what was read of them."""

    state: StreamState = field(default_factory=StreamState)
    n_part: int = 0
    files: Mapping[str, list[Any]] = field(default_factory=dict)
    bad: Mapping[str, str] = field(default_factory=dict)
    read: Mapping[str, Any] = field(default_factory=dict)
    distance: list[list[float]] = field(default_factory=list)
    """Distance along each beam at each of several ranges; nothing of a scan at its own."""


def in_words(error: BaseException) -> str:
    """Say what is wrong with a file: in the words of our own errors, or with the kind of those of libraries."""
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def with_files(done: ReadSoFar, keys: Mapping[Path, list[Any]], *, bad: Mapping[str, str] | None = None) -> ReadSoFar:
    """Return what is done with these files read, too, or found bad."""
    files = {**done.files, **{name_of(path): key for path, key in keys.items()}}
    return replace(done, files=files, bad={**done.bad, **(bad or {})})


def name_of(path: Path) -> str:
    """Return the name that a file has among those that were read."""
    return str(path.resolve())


def key_of(path: Path) -> list[Any]:
    """Return what tells a file from a changed one: size, time of change, and a fingerprint of its first bytes."""
    try:
        status = path.stat()
        with path.open("rb") as file:
            head = hashlib.sha256(file.read(_HEAD)).hexdigest()
    except OSError:  # reading it says why
        return [0, 0, ""]
    return [status.st_size, status.st_mtime_ns, head]


def check_unchanged(paths: Sequence[Path], done: ReadSoFar) -> None:
    """Refuse to go on if a file that was read is gone from the list, or is not what was read.

    Raises
    ------
    InputError
        With the file, and what to do.
    """
    now = {name_of(path): path for path in paths}
    for name, key in done.files.items():
        if name not in now:
            raise InputError(
                f"File {name!r} was read by the run that is to be resumed, and is not among the files now: give the "
                "same ones, or overwrite to begin anew."
            )
        found = key_of(now[name])
        if found != key:
            what = (
                f"its size was {key[0]} and is {found[0]} bytes"
                if found[0] != key[0]
                else ("its first bytes differ" if found[2] != key[2] else "its time of change differs")
            )
            raise InputError(
                f"File {name!r} was changed since the run that is to be resumed has read it ({what}): restore it, or "
                "overwrite to begin anew."
            )


def part_file(index: int) -> str:
    """Return the name of a part of the records in the folder."""
    return f"records/part-{index:06d}.nc"


def open_part(folder: ResultFolder, index: int) -> xr.Dataset:
    """Return a part of the records, checked."""
    file = folder.checked(part_file(index))
    part, what = load_netcdf(file).drop_encoding(), f"The records in {str(file)!r}"
    check_layout(part, *_OF_PART, what=what, ranges=True)
    if REPORT not in part.attrs and OF_RANGES not in part.attrs:
        raise InputError(f"{what} have no {REPORT}.")
    return part


def save_state(folder: ResultFolder, done: ReadSoFar, part: xr.Dataset | None) -> ReadSoFar:
    """Write new records as one part, then the state that counts it: a part without it is written again."""
    if part is not None:
        folder.write(part_file(done.n_part), lambda file: write_netcdf(part, file))
        done = replace(done, n_part=done.n_part + 1)
    arrays = ("time", "beam", "columns")
    state = {name: getattr(done.state, name) for name in StreamState.__dataclass_fields__ if name not in arrays}
    meta: dict[str, Any] = {"state": {**state, "latest_of_beam": list(done.state.latest_of_beam.items())}}
    meta.update({name: getattr(done, name) for name in ("n_part", "files", "bad", "read", "distance")})
    columns = {f"column {name}": values for name, values in done.state.columns.items()}
    text = np.array(json.dumps(meta, default=lambda value: value.tolist()).encode("ascii"))  # as text, four times that
    entries: dict[str, Any] = {"meta": text, "time": done.state.time, "beam": done.state.beam, **columns}
    folder.write(STATE_FILE, lambda file: np.savez(file, **entries))
    return done


class _StateOfStream(Open):
    attributes: dict[str, Any]
    latest: int | None
    latest_of_beam: list[Annotated[list[int], Field(min_length=2, max_length=2)]]
    samples: Count
    out_of_order: Count
    late: Count
    first_late: str
    source_files: list[str]

    model_config = ConfigDict(extra="forbid", strict=True)


class _WasRead(Open):
    counts: dict[str, Count]
    beams: list[int]
    files: dict[str, dict[str, Any]]
    out_of_order: str


class _Meta(Open):
    """What the state of reading holds beside its arrays."""

    state: _StateOfStream
    n_part: Count
    files: dict[str, Annotated[list[int | str], Field(min_length=3, max_length=3)]]
    bad: dict[str, str]
    distance: list[list[float]]
    read: _WasRead | Annotated[dict[str, Any], Field(max_length=0)]

    model_config = ConfigDict(extra="forbid", strict=True)


def load_state(folder: ResultFolder, say: Callable[[str], None]) -> ReadSoFar:
    """Return what an interrupted run had done; nothing, if a file of it is gone or was changed."""
    if STATE_FILE not in folder.names("records/"):
        return ReadSoFar()
    try:
        done = _progress(folder.read(STATE_FILE))
        for index in range(done.n_part):
            folder.checked(part_file(index))
    except UNREADABLE as error:
        say(f"What an earlier run made of the files is not used, and all are read again: {in_words(error)}")
        return ReadSoFar()
    return done


def _progress(content: bytes) -> ReadSoFar:
    """Return what a state file holds."""
    with np.load(io.BytesIO(content)) as found:
        text = found["meta"]
        plain = text.item().decode("ascii", "replace") if text.dtype.kind == "S" and text.ndim == 0 else str(text)
        meta = read_json(_Meta, plain, what=f"File {STATE_FILE}", advice=_AGAIN)
        columns = {name.removeprefix("column "): found[name] for name in found if name.startswith("column ")}
        beam_time = {"time": found["time"], "beam": found["beam"]}
    layout = {"time": Entry(_SAMPLE, "whole"), "beam": Entry(_SAMPLE, "whole")}
    layout |= {name: Entry(_SAMPLE) for name in columns}
    entries = {name: (_SAMPLE, values) for name, values in {**columns, **beam_time}.items()}
    check_dataset(xr.Dataset(entries), layout, what=f"The arrays of {STATE_FILE}", advice=_AGAIN)
    state = meta.pop("state")
    state["latest_of_beam"] = {int(beam): int(latest) for beam, latest in state["latest_of_beam"]}
    state["source_files"] = tuple(state["source_files"])
    return ReadSoFar(state=StreamState(**beam_time, columns=columns, **state), **meta)
