"""Headers of classic NetCDF files, checked before a library that trusts them reads them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from bayes_rs.errors import InputError

_TYPE_SIZE = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8}
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_MOST_HEADER = 64 * 1024**2


@dataclass
class _Header:
    """The bytes of a header, and how far they were read."""

    raw: bytes
    size: int
    version: int
    at: int = 4

    def __post_init__(self) -> None:
        if self.version == 5:
            raise _DamagedError("it is of the kind CDF-5; convert it with 'nccopy -k netCDF-4'")
        if self.version not in (1, 2):
            raise _DamagedError(f"its version {self.version} is unknown")

    def count(self) -> int:
        return self._integer(4)

    def offset(self) -> int:
        return self._integer(4 if self.version == 1 else 8)

    def skip(self, n_byte: int) -> None:
        self.at += -(-n_byte // 4) * 4
        if self.at > len(self.raw):
            raise _DamagedError("its header is cut off")

    def elements(self, kind: int) -> int:
        """Return the length of a list of dimensions, variables or attributes."""
        tag, count = self.count(), self.count()
        if tag not in (0, kind) or (tag == 0 and count != 0):
            raise _DamagedError(f"its header has the tag {tag} where {kind} or 0 must stand")
        if 8 * count > len(self.raw) - self.at:
            raise _DamagedError(f"its header announces {count} entries, more than it can hold")
        return count

    def attributes(self) -> None:
        for _ in range(self.elements(_ATTRIBUTE)):
            self.skip(self.count())
            kind = self.count()
            if kind not in _TYPE_SIZE:
                raise _DamagedError(f"an attribute has the unknown type {kind}")
            self.skip(self.count() * _TYPE_SIZE[kind])

    def _integer(self, n_byte: int) -> int:
        if self.at + n_byte > len(self.raw):
            raise _DamagedError("its header is cut off")
        value: int = struct.unpack_from(">I" if n_byte == 4 else ">Q", self.raw, self.at)[0]
        self.at += n_byte
        return value


class _DamagedError(Exception):
    """What is wrong with a header."""


def check_classic_header(file: Path) -> None:
    """Refuse a classic NetCDF file whose header is damaged, or which is shorter than its header says.

    The libraries take the counts in a header as they are: a flipped bit makes them read for hours, and data that are
    cut off come back as zeros.

    Raises
    ------
    InputError
        If the header or the length of the file is wrong.

    References
    ----------
    The classic format specification of Unidata's NetCDF documentation (CDF-1, CDF-2).
    """
    with file.open("rb") as opened:
        raw = opened.read(_MOST_HEADER)
    try:
        _check(_Header(raw, file.stat().st_size, raw[3] if len(raw) > 3 else 0))
    except _DamagedError as error:
        raise InputError(
            f"File {str(file)!r} cannot be read as NetCDF: {error}; check that it is complete and not damaged."
        ) from error


def _check(header: _Header) -> None:
    n_record = header.count()
    if n_record == 2**32 - 1:
        n_record = 0  # written as a stream: the length tells
    lengths = []
    for _ in range(header.elements(_DIMENSION)):
        header.skip(header.count())
        lengths.append(header.count())
    header.attributes()
    records = []  # begin and size of each variable of records
    for _ in range(header.elements(_VARIABLE)):
        header.skip(header.count())
        n_dimension = header.count()
        if n_dimension > len(lengths):
            raise _DamagedError(f"a variable has {n_dimension} dimensions, the file has {len(lengths)}")
        ids = [header.count() for _ in range(n_dimension)]
        if any(index >= len(lengths) for index in ids):
            raise _DamagedError("a variable has a dimension that the file does not have")
        header.attributes()
        kind = header.count()
        if kind not in _TYPE_SIZE:
            raise _DamagedError(f"a variable has the unknown type {kind}")
        header.count()  # its size, which large variables overflow
        begin, size = header.offset(), _TYPE_SIZE[kind]
        for index in ids:
            size *= lengths[index] or 1
        if ids and lengths[ids[0]] == 0:
            records.append((begin, size))
        elif size and begin + size > header.size:
            raise _DamagedError(f"it has {header.size} bytes, and a variable ends at {begin + size}")
    if records and n_record:
        step = records[0][1] if len(records) == 1 else sum(-(-size // 4) * 4 for _, size in records)
        end = max(begin + (n_record - 1) * step + size for begin, size in records)
        if end > header.size:
            raise _DamagedError(f"it has {header.size} bytes, and its records end at {end}")
