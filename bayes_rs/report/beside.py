"""Two fits of the same records beside each other: medians, intervals, differences, and where they do not overlap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS, is_priors
from bayes_rs.records.layout import TURBINE
from bayes_rs.report.figures import bits
from bayes_rs.report.packing import pack, pack_rows
from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import UNIT, figure, folded, key, lines, number, table
from bayes_rs.report.words import when

_ENDS = ("median", "low", "high")
_TOLD = 20
"""Records without an overlap that are named."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Two fits, matched record by record.

    Parameters
    ----------
    names : (str, str)
        What the fits are called.
    found, other : ReportData
        What the report shows of them.
    rows, other_rows : ndarray of int, shape (n_match,)
        The records of the first and of the second that are of one start, and were fitted in both.
    n_start : int
        Starts that both have.
    note : str
        What to say of the two in place of how they were made; empty of two fits.
    """

    names: tuple[str, str]
    found: ReportData
    other: ReportData
    rows: NDArray[np.int64]
    other_rows: NDArray[np.int64]
    n_start: int
    note: str = ""

    @property
    def apart(self) -> NDArray[np.bool_]:
        """Where the intervals do not overlap, shape (n_match, 6)."""
        one, other = self.numbers
        return np.asarray((one["low"] > other["high"]) | (other["low"] > one["high"]))

    @property
    def numbers(self) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Medians and ends of the intervals of both, each of shape (n_match, 6)."""
        return (
            {name: self.found.numbers[name][self.rows] for name in _ENDS},
            {name: self.other.numbers[name][self.other_rows] for name in _ENDS},
        )


def match_fits(found: ReportData, other: ReportData, names: tuple[str, str]) -> Beside:
    """Match the records of two fits by their starts, and by turbine where there are several.

    Raises
    ------
    InputError
        If the intervals are of different probabilities or kinds, or no record of one was fitted in the other.
    """
    if (found.prob, found.interval) != (other.prob, other.interval):
        raise InputError(
            f"The intervals of the two fits differ: {interval_words(found.prob, found.interval)}, and "
            f"{interval_words(other.prob, other.interval)}; give --prob, or fit again with the same."
        )
    place = {key: row for row, key in enumerate(_keys(other)) if key is not None}
    pairs = [(row, place[key]) for row, key in enumerate(_keys(found)) if key is not None and key in place]
    fitted, also = found.fitted, other.fitted
    both = [(one, two) for one, two in pairs if fitted[one] and also[two]]
    if not both:
        raise InputError(
            f"Of the records, {len(pairs)} are in both fits, and none of them was fitted in both: give two fits of the "
            "same records."
        )
    rows, other_rows = (np.array(column, dtype=np.int64) for column in zip(*both, strict=True))
    return Beside(names, found, other, rows, other_rows, len(pairs))


def _keys(found: ReportData) -> list[tuple[str, int] | None]:
    """Return what a record is known by in both fits: turbine and start, or its number where no record has a start."""
    turbine = found.records[TURBINE].values.astype(str) if TURBINE in found.records else np.full(len(found.record), "")
    known = ~np.isnat(found.time)
    if not known.any():
        return [("", int(number)) for number in found.record]
    start = found.time.astype("datetime64[ns]").astype(np.int64)
    return [(str(name), int(at)) if there else None for name, at, there in zip(turbine, start, known, strict=True)]


def beside_data(beside: Beside, picked: NDArray[np.int64]) -> dict[str, Any]:
    """Return what the script draws: the second fit's numbers at the records of the page."""
    there = np.flatnonzero(np.isin(beside.rows, picked))
    place = np.searchsorted(picked, beside.rows[there])
    other = beside.other_rows[there]
    numbers = np.stack([beside.other.numbers[name][other] for name in _ENDS], axis=1)
    return {
        "names": list(beside.names),
        "place": pack(place, "u4"),
        "numbers": pack_rows(numbers),
        "priors": pack(bits(is_priors(beside.other.numbers["decided"][other])), "u1"),
        "apart": pack(bits(beside.apart[there]), "u1"),
    }


def beside_section(beside: Beside) -> str:
    """Return the content of the section."""
    one, other = beside.names
    called = interval_words(beside.found.prob, beside.found.interval)
    ours, theirs = beside.numbers
    apart = beside.apart
    rows = [
        (
            name,
            number(np.median(ours["median"][:, c])),
            number(np.median(theirs["median"][:, c])),
            number(np.median(theirs["median"][:, c] - ours["median"][:, c])),
            number(np.median((theirs["high"] - theirs["low"])[:, c]) / np.median((ours["high"] - ours["low"])[:, c])),
            *(
                number(np.median(data.numbers["decided"][own][:, c]), 2)
                for data, own in ((beside.found, beside.rows), (beside.other, beside.other_rows))
            ),
            f"{int(apart[:, c].sum())}",
            f"{100.0 * apart[:, c].mean():.1f} %",
        )
        for c, name in enumerate(STRESSES)
    ]
    header = (
        "stress", f"{one}, {UNIT}", f"{other}, {UNIT}", "second − first", "width, second over first",
        f"decided: {one}", f"decided: {other}", "no overlap, records", "share",
    )  # fmt: skip
    counted = (
        f"{one} has {len(beside.found.record)} records, {other} {len(beside.other.record)}; {beside.n_start} begin at "
        f"the same time, and {len(beside.rows)} of these were fitted in both."
    )
    made = f"The fits were made with: {_settings(beside.found)}; and {_settings(beside.other)}."
    told = [beside.note] if beside.note else [counted, made]
    said = [*told, _apart_words(beside, apart)]
    caption = (
        key("band", f"{one}: {called}")
        + key("band other", f"{other}: {called}")
        + key("hatch", f"hatched, the second with a coloured edge: {PRIORS}")
        + key("apart", "the intervals do not overlap")
        + "Of more than 600 records, medians over neighbours."
    )
    words = f"Medians over the records, of the differences too; overlap of the {called}"
    content = folded("Table: two fits", table(words, header, rows))
    return lines(said) + figure("beside", caption, content, " data-time")


def _settings(found: ReportData) -> str:
    prior = found.prior.partition(":")[0]
    return f"scan {found.run.get('scan', 'unknown')}, prior {prior}, target {found.target}"


def _apart_words(beside: Beside, apart: NDArray[np.bool_]) -> str:
    some = np.flatnonzero(apart.any(axis=1))
    if not len(some):
        return "The intervals of every stress overlap in every record."
    named = [
        f"{when(beside.found, int(beside.rows[row]))} ({', '.join(np.array(STRESSES)[apart[row]])})"
        for row in some[:_TOLD].tolist()
    ]
    more = f"; and {len(some) - _TOLD} more" if len(some) > _TOLD else ""
    return f"Intervals do not overlap in {len(some)} records: {'; '.join(named)}{more}."
