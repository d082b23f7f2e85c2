"""What a table holds, before anything is known of it: its headings with what they seem to mean, and what follows."""

from __future__ import annotations

import csv
import io
import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.readers.compressed import UNREADABLE, own_suffix, unreadable
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.table import PARQUET_SUFFIXES

MOST_ROWS = 200_000
"""Rows of a table that are looked at, from its beginning."""
_HEAD_BYTES, _HEAD_LINES = 65_536, 80
_SEPARATORS = (";", "\t", ",", "|")
_UNIT = r"(?:\s*[(\[].*[)\]])?"
_MEANINGS = {
    "time": rf"(?:date|time|utc.*|zeit.*|time[ _]?stamp.*|(?:date|time)[ _]?(?:and )?(?:date|time)){_UNIT}",
    "radial_velocity": rf"(?:v_?r|v_?los|rws|vel|velocity|doppler(?:[ _](?:velocity|speed))?"
    rf"|(?:los|radial)[ _-]?(?:wind[ _-]?)?(?:speed|velocity)|line[ _-]of[ _-]sight.*(?:speed|velocity)){_UNIT}",
    "beam": r"(?:(?:beam|los)(?:[ _]?(?:id|index|no|number))?|position|line[ _-]of[ _-]sight)",
    "phase": rf"(?:(?:scan(?:ner)?|beam|prism)?[ _]?phase(?:[ _]?angle)?|scan(?:ner)?[ _]?angle){_UNIT}",
    "azimuth": rf"azi(?:muth)?(?:[ _]?angle)?{_UNIT}",
    "elevation": rf"ele(?:v|vation)?(?:[ _]?angle)?{_UNIT}",
    "distance": rf"(?:distance|range(?:[ _]?gate)?|focus(?:[ _]?distance)?|gate){_UNIT}",
    "cnr": rf"(?:cnr|snr|carrier.*noise.*){_UNIT}",
    "status": r"(?:rws[ _]?status|(?:quality|status|valid|availability)(?:[ _]?(?:flag|code))?)",
}
_WORDS = {name: re.compile(pattern, re.IGNORECASE) for name, pattern in _MEANINGS.items()}
_EPOCHS = (("unix", 9e8, 2.2e9, "1970-01-01"), ("labview", 3e9, 4.3e9, "1904-01-01"))
"""What numbers of seconds in this century are counted from: our name, the least and the largest, the epoch."""


@dataclass(frozen=True)
class LookedTable:
    """The first rows of a table, and what its columns seem to be.

    Parameters
    ----------
    headings : tuple of str
        Its headings; numbers from 1 where it has none.
    meaning : dict of str to str
        Our name by heading, of those that one is guessed for.
    frame : DataFrame
        The rows that were looked at.
    options : dict
        Options of reading that the table itself tells: separator and decimal.
    whole : bool
        Whether these are all rows.
    above : int
        Lines above the headings.
    """

    headings: tuple[str, ...]
    meaning: dict[str, str]
    frame: pd.DataFrame
    options: dict[str, str] = field(default_factory=dict)
    whole: bool = True
    above: int = 0

    def column(self, name: str) -> str | None:
        """Return the heading that seems to be `name`."""
        return next((heading for heading, meaning in self.meaning.items() if meaning == name), None)

    def numbers(self, name: str) -> FloatArray | None:
        """Return the numbers of a column; NaN where an entry is none."""
        heading = self.column(name)
        return None if heading is None else as_numbers(self.frame[heading], self.options.get("decimal", "."))

    def odd_value(self) -> float:
        """Return the most frequent velocity that no wind has, which marks missing entries; NaN if there is none."""
        velocity = self.numbers("radial_velocity")
        if velocity is None:
            return np.nan
        odd = velocity[np.isfinite(velocity) & (np.abs(velocity) > VELOCITY_LIMIT)]
        return most_frequent(odd) if len(odd) else np.nan

    def times(self) -> tuple[NDArray[np.datetime64], str]:
        """Return the times, NaT where there is none, and the option ``time_format`` that they need, if any."""
        heading = self.column("time")
        if heading is None:
            return np.full(len(self.frame), np.datetime64("NaT"), dtype="datetime64[ns]"), ""
        entries = self.frame[heading]
        number = as_numbers(entries, self.options.get("decimal", "."))
        middle = float(np.nanmedian(number)) if np.isfinite(number).any() else np.nan
        for name, low, high, epoch in _EPOCHS:
            if low <= middle <= high:
                whole = np.where(np.isfinite(number), np.round(number * 1e9), 0.0).astype("timedelta64[ns]")
                return np.where(np.isfinite(number), np.datetime64(epoch, "ns") + whole, np.datetime64("NaT")), name
        if np.isfinite(middle):
            return np.full(len(entries), np.datetime64("NaT"), dtype="datetime64[ns]"), ""
        found = pd.to_datetime(entries.astype(str), errors="coerce", format="ISO8601", utc=True)
        return found.dt.tz_localize(None).to_numpy("datetime64[ns]"), ""

    def lines(self) -> list[str]:
        """Return a line for each column: its heading, what it seems to be, and what its entries are."""
        rows = []
        decimal = self.options.get("decimal", ".")
        for heading in self.headings:
            entries = self.frame[heading]
            number = as_numbers(entries, decimal)
            known = number[np.isfinite(number)]
            empty = float(entries.isna().mean())
            if len(known) > 0.5 * max(int((~entries.isna()).sum()), 1):
                distinct = len(np.unique(known))
                what = f"{known.min():.6g} to {known.max():.6g}" + (f", {distinct} values" if distinct <= 64 else "")
            else:
                what = f"as {next((str(one) for one in entries.dropna().head(1)), 'nothing')!r}"[:44]
            missing = f", {100.0 * empty:.1f} % empty" if empty > 0.0 else ""
            rows.append((heading[:36], self.meaning.get(heading, "?"), what + missing))
        wide = [max(len(row[index]) for row in [*rows, ("heading", "seems to be", "")]) for index in range(2)]
        head = f"{'heading':<{wide[0]}}  {'seems to be':<{wide[1]}}  entries"
        return [head, *(f"{one:<{wide[0]}}  {two:<{wide[1]}}  {three}" for one, two, three in rows)]


def look_at_table(file: Path, options: FileFormat) -> LookedTable:
    """Look at the first rows of a CSV or Parquet table.

    Parameters
    ----------
    file : Path
        The table, unpacked.
    options : FileFormat
        What is known of it: columns that are mapped count before a guess, and so do separator and decimal.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    own = {theirs: ours for ours, theirs in options.columns.items()}
    if own_suffix(file) in PARQUET_SUFFIXES:
        try:
            parquet = pq.ParquetFile(file)
            batch = next(parquet.iter_batches(batch_size=MOST_ROWS), None)
            frame = (parquet.schema_arrow.empty_table() if batch is None else batch).to_pandas()
            n_row = parquet.metadata.num_rows
        except (*UNREADABLE, pa.ArrowException) as error:
            raise unreadable(file, error) from error
        frame = frame.reset_index() if frame.index.name else frame
        frame.columns = [str(name) for name in frame.columns]
        return LookedTable(tuple(frame.columns), _guess(list(frame.columns), own), frame, {}, n_row <= len(frame))
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    text, encoding = _decoded(head, file)
    lines = text.splitlines()[:-1] if len(head) == _HEAD_BYTES else text.splitlines()
    separator, above, headed = _shape(lines[:_HEAD_LINES], options.separator if options.separator != "," else None)
    if separator is None:
        raise InputError(
            f"File {str(file)!r} is no table: none of its first {len(lines[:_HEAD_LINES])} lines has as many entries "
            "as the next; give another file."
        )
    try:
        frame = pd.read_csv(
            file,
            sep=separator,
            skiprows=above,
            header=0 if headed else None,
            nrows=MOST_ROWS,
            dtype=str,
            encoding=encoding,
            encoding_errors="replace",
            on_bad_lines="skip",
            engine="c",
            index_col=False,
            low_memory=False,
        )
    except UNREADABLE as error:
        raise unreadable(file, error) from error
    frame.columns = [str(name).strip() if headed else str(int(name) + 1) for name in frame.columns]
    decimal = "," if separator != "," and _has_decimal_commas(frame) else "."
    told = {"separator": "tab" if separator == "\t" else separator} if separator != "," else {}
    told |= {"decimal": ","} if decimal == "," else {}
    whole = len(frame) < MOST_ROWS
    return LookedTable(tuple(frame.columns), _guess(list(frame.columns), own), frame, told, whole, above)


def as_numbers(entries: pd.Series[Any], decimal: str) -> FloatArray:
    """Return entries as numbers, NaN where they are none."""
    if entries.dtype == object or str(entries.dtype).startswith(("str", "string")):
        entries = entries.str.replace(decimal, ".", regex=False) if decimal != "." else entries
    if str(entries.dtype).startswith("datetime"):
        return np.full(len(entries), np.nan)
    return np.asarray(pd.to_numeric(entries, errors="coerce"), dtype=np.float64)


def most_frequent(values: FloatArray) -> float:
    """Return the number that occurs most often."""
    number, count = np.unique(values, return_counts=True)
    return float(number[count.argmax()])


def over_phase(phase_deg: FloatArray, velocity: FloatArray, n_bin: int = 36) -> FloatArray:
    """Return mean velocities over the phase, shape (n_bin,), in bins about 0, 10, ... degrees; NaN for an empty one."""
    known = np.isfinite(phase_deg) & np.isfinite(velocity)
    at = np.round(phase_deg[known] / (360.0 / n_bin)).astype(int) % n_bin
    count = np.bincount(at, minlength=n_bin)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(at, weights=velocity[known], minlength=n_bin) / count)


def _guess(headings: list[str], own: dict[str, str]) -> dict[str, str]:
    """Return what headings seem to be: what the user says, then our own names, then words that others use."""
    found = {heading: own[heading] for heading in headings if heading in own}
    for exact, name in itertools.product((True, False), _WORDS):
        if name in found.values():
            continue
        fits = [
            heading
            for heading in headings
            if heading not in found and (heading == name if exact else _WORDS[name].fullmatch(heading))
        ]
        if fits:
            found[fits[0]] = name
    return found


def _decoded(head: bytes, file: Path) -> tuple[str, str]:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return head[: len(head) // 2 * 2].decode("utf-16", errors="replace"), "utf-16"
    if b"\0" in head[:1000]:
        raise InputError(f"File {str(file)!r} is no text: it holds zero bytes; give another file.")
    try:
        return head.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError as error:
        if error.start > len(head) - 4:  # a character that was cut
            return head.decode("utf-8-sig", errors="ignore"), "utf-8-sig"
    return head.decode("latin-1"), "latin-1"


def _shape(lines: list[str], separator: str | None) -> tuple[str | None, int, bool]:
    """Return the separator, the number of lines above the table, and whether the first line of it has headings."""
    best: tuple[int, str | None, int] = (1, None, 0)
    for sign in (separator,) if separator else _SEPARATORS:
        counts = [len(row) for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=sign)]
        for index in range(max(len(counts) - 1, 0)):
            if counts[index] > best[0] and counts[index + 1] == counts[index]:
                best = (counts[index], sign, index)
                break
    _, found, above = best
    if found is None:
        return None, 0, False
    first = next(csv.reader([lines[above]], delimiter=found))
    numeric = sum(bool(re.fullmatch(r"\s*[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*", entry)) for entry in first)
    dated = sum(bool(re.match(r"\s*\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", entry)) for entry in first)
    return found, above, 2 * (numeric + dated) < len(first)


def _has_decimal_commas(frame: pd.DataFrame) -> bool:
    entries = frame.head(50).fillna("").astype(str).to_numpy().ravel()
    return sum(bool(re.fullmatch(r"\s*[-+]?\d+,\d+\s*", entry)) for entry in entries) > len(entries) // 10
