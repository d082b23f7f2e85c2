"""The list of what we wrote in a folder: one line a file, with the fingerprint of its bytes."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, TypeAdapter

from bayes_rs.errors import InputError
from bayes_rs.layouts import Count, Open, read_json

LEDGER = "fingerprints.jsonl"
"""Name of the list, at the top of its folder."""
HALF = ".half."
"""Begins the name of a file of ours that is being written; what a writer chooses by the end of a name stays."""
_CHECK = 16
"""Characters of the checksum that ends a line."""


class Fingerprint(NamedTuple):
    """The length of a file in bytes, and the SHA-256 of its bytes."""

    n_byte: int
    sha256: str


@dataclass
class Ledger:
    """What the list of a folder says.

    Parameters
    ----------
    key : str or None
        Key of the run that writes the folder; None if the line that holds it is not there.
    key_parts : dict
        The fingerprints that the key is made of, by what they are of.
    files : dict of str to Fingerprint
        What each file should be, by its path from the folder on, with slashes.
    beside : set of str
        Those of them that belong to the folder, but not to its results, as a report does.
    earlier : dict of str to set of Fingerprint
        What files were before we wrote them again.
    finished : bool
        Whether the list ends with the line that closes it, and holds as many files as that line says.
    damaged : bool
        Whether a line that was written whole cannot be trusted any more.
    """

    key: str | None = None
    key_parts: dict[str, Any] = field(default_factory=dict)
    files: dict[str, Fingerprint] = field(default_factory=dict)
    beside: set[str] = field(default_factory=set)
    earlier: dict[str, set[Fingerprint]] = field(default_factory=dict)
    finished: bool = False
    damaged: bool = False

    def put(self, name: str, found: Fingerprint | None, *, beside: bool = False) -> None:
        """Note what a file is from now on; None if it is removed."""
        before = self.files.pop(name, None)
        self.beside.discard(name)
        if before is not None and before != found:
            self.earlier.setdefault(name, set()).add(before)
        if found is not None:
            self.files[name] = found
            if beside:
                self.beside.add(name)

    def wrote(self, name: str, found: Fingerprint) -> bool:
        """Tell whether we wrote a file of this name with these bytes, now or earlier."""
        return self.files.get(name) == found or found in self.earlier.get(name, ())


def fingerprint_of(content: bytes) -> Fingerprint:
    """Return the fingerprint of some bytes."""
    return Fingerprint(len(content), hashlib.sha256(content).hexdigest())


def fingerprint_of_file(file: Path, *, to_disk: bool = False) -> Fingerprint:
    """Return the fingerprint of a file; with `to_disk` its bytes are on the disk when this returns."""
    with file.open("rb") as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
        n_byte = opened.tell()
        if to_disk and sys.platform != "win32":
            os.fsync(opened.fileno())  # a power cut leaves no file that has its name and not its bytes
    if to_disk and sys.platform == "win32":  # which flushes only what may be written
        with file.open("r+b") as opened:
            os.fsync(opened.fileno())
    return Fingerprint(n_byte, digest)


def _check_path(path: str) -> str:
    """Refuse a path that leads out of the folder: what is listed may be removed."""
    if "\0" in path or any(part in ("", ".", "..") for part in path.split("/")):
        raise ValueError("it must be a path inside the folder")
    return path


class KeyLine(Open):
    """The line with the key of the run; `run.json` has it, too."""

    key: str
    key_parts: dict[str, str]


class _FileLine(Open):
    path: Annotated[str, AfterValidator(_check_path)]
    check: str
    n_byte: Count = 0
    sha256: str = ""


class _EndLine(Open):
    n_file: Count
    check: str


class _KeyLine(KeyLine):
    check: str


_LINE = TypeAdapter(_FileLine | _EndLine | _KeyLine)


def read_ledger(folder: Path) -> Ledger | None:
    """Read the list of a folder; None if it has none.

    Notes
    -----
    A line counts only if it is, character by character, the one that we write for what it says. A last line without
    an end is one that was being written when its process was killed: it says nothing, and is no damage.
    """
    try:
        lines = (folder / LEDGER).read_bytes().split(b"\n")
    except (FileNotFoundError, NotADirectoryError):
        return None
    ledger = Ledger()
    for line in lines[:-1]:
        entry = _entry(line)
        ledger.finished = False  # a line after the last one: somebody goes on
        if entry is None:
            ledger.damaged = True
        elif "key" in entry:
            ledger.key, ledger.key_parts = entry["key"], entry["key_parts"]
        elif "n_file" in entry:
            ledger.finished = entry["n_file"] == len(ledger.files)
            ledger.damaged |= not ledger.finished
        elif "path" not in entry or ("sha256" in entry) != ("n_byte" in entry):
            ledger.damaged = True
        else:
            found = Fingerprint(entry["n_byte"], entry["sha256"]) if "sha256" in entry else None
            ledger.put(entry["path"], found, beside="beside" in entry)
    return ledger


def _entry(line: bytes) -> dict[str, Any] | None:
    """Return what a line says; None if it is not as we wrote it."""
    try:
        entry = read_json(_LINE, line, what="line", advice="")
    except InputError:
        return None
    del entry["check"]
    return entry if _line(entry) == line + b"\n" else None


def _line(entry: Mapping[str, Any]) -> bytes:
    text = json.dumps(entry, sort_keys=True)
    check = hashlib.sha256(text.encode("ascii")).hexdigest()[:_CHECK]
    return json.dumps({**entry, "check": check}, sort_keys=True).encode("ascii") + b"\n"


def _file_line(name: str, found: Fingerprint | None, *, beside: bool) -> bytes:
    what: dict[str, Any] = {} if found is None else found._asdict()
    return _line({"path": name, **what, **({"beside": True} if beside else {})})


def append_to_ledger(folder: Path, name: str, found: Fingerprint | None, *, beside: bool = False) -> None:
    """Add a line to the list of a folder; it is on the disk when this returns.

    Raises
    ------
    OSError
        If it cannot be written, as on a full disk; the list is then what it was.
    """
    line = _file_line(name, found, beside=beside)
    number = os.open(folder / LEDGER, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
    try:
        n_byte = os.fstat(number).st_size
        try:
            while line:
                line = line[os.write(number, line) :]
            os.fsync(number)
        except OSError:
            os.ftruncate(number, n_byte)  # half a line would spoil the next one
            raise
    finally:
        os.close(number)


def write_ledger(folder: Path, ledger: Ledger, *, finished: bool) -> None:
    """Write the list of a folder anew: sorted, one line a file, the same bytes however the folder came about.

    Raises
    ------
    OSError
        If it cannot be written, as on a full disk; the list is then what it was.
    """
    part = folder / f"{HALF}{LEDGER}"
    try:
        part.write_bytes(b"".join(_lines(ledger, finished=finished)))
        fingerprint_of_file(part, to_disk=True)
        part.replace(folder / LEDGER)
    finally:
        part.unlink(missing_ok=True)
    ledger.finished, ledger.damaged, ledger.earlier = finished, False, {}


def _lines(ledger: Ledger, *, finished: bool) -> Iterator[bytes]:
    if ledger.key is not None:
        yield _line({"key": ledger.key, "key_parts": ledger.key_parts})
    for name in sorted(ledger.files):
        yield _file_line(name, ledger.files[name], beside=name in ledger.beside)
    if finished:
        yield _line({"n_file": len(ledger.files)})
