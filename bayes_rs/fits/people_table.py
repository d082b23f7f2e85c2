"""The table for people: a row for each record, with numbers as exact as the draws tell them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.fit_data import FitData
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.output import plain_cell
from bayes_rs.posteriors.decided import is_priors
from bayes_rs.records.layout import TURBINE

PEOPLE_FILE = "stresses.csv"
"""Name of the table in a folder of results."""
_QUANTITIES = ("ti", *STRESSES)
_PLACES = ("median", "low", "high")
_ERRORS = tuple(f"mcse_{place}" for place in _PLACES)
_READ = ("record", "time", *_PLACES, *_ERRORS, "decided", "flag")
_EXACT = 6
"""Digits of a number whose Monte-Carlo error is not known."""
_MOST_DECIMALS = 12
_WIND = 2
"""Decimals of a wind speed, m/s; a direction, degrees, has one less."""


@dataclass(frozen=True)
class PeopleRows:
    """Where rows of the table come from.

    Parameters
    ----------
    fit : FitData
        A fit at one range.
    records : Dataset
        Its records.
    where : mapping of str to float
        Columns before the others that all rows have: range and height, m.
    """

    fit: FitData
    records: xr.Dataset
    where: dict[str, float]


def write_people_table(parts: Sequence[PeopleRows], file: Path) -> None:
    """Write the table for people, record after record, with memory that does not grow.

    Parameters
    ----------
    parts : sequence of PeopleRows
        Fits, one after the other; of a fit at several ranges one for each.
    file : Path
        The file, which is replaced.

    Notes
    -----
    A number is written to the first digit of its Monte-Carlo standard error (`decimals_of`): rounding moves it by half
    of that error at the most.
    """
    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        for index, part in enumerate(parts):
            for first, (header, rows) in enumerate(_pieces(part)):
                if index == first == 0:
                    writer.writerow(header)
                writer.writerows(rows)


def decimals_of(error: FloatArray) -> NDArray[np.int64]:
    """Return to how many decimals a number is written: to the first digit of its Monte-Carlo standard error.

    Parameters
    ----------
    error : ndarray
        Standard errors.

    Returns
    -------
    decimals : ndarray of int
        Negative for whole tens; −99 where no error is known.

    Examples
    --------
    >>> decimals_of(np.array([0.013, 0.2, 30.0])).tolist()
    [2, 1, -1]
    """
    known = np.isfinite(error) & (error > 0.0)
    exponent = np.floor(np.log10(np.where(known, error, 1.0))).astype(np.int64)
    return np.where(known, np.minimum(-exponent, _MOST_DECIMALS), -99)


def _pieces(part: PeopleRows) -> Iterator[tuple[list[str], Iterable[list[str]]]]:
    """Give header and rows, some records at a time."""
    own = part.fit.settings["fit"]
    interval = f"{100.0 * float(own['prob']):g} % equal tails"
    n_row = len(STRESSES) + len(own["derived"])
    first = 0
    for piece in part.fit.source.pieces("summary", _READ):
        record = piece["record"].to_numpy()[::n_row]
        rows = slice(first, first + len(record))
        first += len(record)
        wind, yaw = (np.asarray(part.records[name].values[rows], dtype=np.float64) for name in ("wind_speed", "yaw"))
        numbers = _numbers(piece, n_row, wind)
        priors = is_priors(piece["decided"].to_numpy(dtype=np.float64).reshape(-1, n_row)[:, : len(STRESSES)])
        fitted = np.isfinite(numbers[0][:, 0, 0])
        start = piece["time"].to_numpy().astype("datetime64[s]")[::n_row]
        columns: dict[str, list[str]] = {
            "time_utc": ["" if np.isnat(one) else f"{one}" for one in start],
            "record": [f"{number}" for number in record.tolist()],
        }
        if TURBINE in part.records:
            columns["turbine"] = [plain_cell(f"{name}") for name in part.records[TURBINE].values[rows].tolist()]
        columns |= {name: [f"{value:g}"] * len(record) for name, value in part.where.items()}
        columns["wind_speed_m_s"] = [_fixed(value, _WIND) for value in wind.tolist()]
        columns["direction_to_axis_deg"] = [_fixed(value, _WIND - 1) for value in yaw.tolist()]
        texts = _texts(*numbers)
        for index, name in enumerate(_QUANTITIES):
            unit = "" if name == "ti" else "_m2_s2"
            for place, words in enumerate(("", "_low", "_high")):
                columns[f"{name}{words}{unit}"] = texts[index][place]
        columns["interval"] = [interval if one else "" for one in fitted.tolist()]
        columns["mostly_prior"] = [
            " ".join(name for name, prior in zip(STRESSES, own_, strict=True) if prior) if one else ""
            for own_, one in zip(priors.tolist(), fitted.tolist(), strict=True)
        ]
        columns["flag"] = [f"{words}" for words in piece["flag"].to_numpy()[::n_row].tolist()]
        yield list(columns), (list(row) for row in zip(*columns.values(), strict=True))


def _numbers(piece: pd.DataFrame, n_row: int, wind: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return median and ends of turbulence intensity and stresses, and their errors, each (n_record, 7, 3)."""
    values, errors = (
        piece[list(names)].to_numpy(dtype=np.float64).reshape(-1, n_row, len(names))[:, : len(STRESSES)]
        for names in (_PLACES, _ERRORS)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(values[:, :1])
        intensity = root / wind[:, None, None]
        of_intensity = errors[:, :1] / (2.0 * root * wind[:, None, None])  # d√x = dx / 2√x
    return np.concatenate([intensity, values], axis=1), np.concatenate([of_intensity, errors], axis=1)


def _texts(values: FloatArray, errors: FloatArray) -> list[list[list[str]]]:
    """Return the numbers as texts, by quantity and place."""
    decimals = decimals_of(errors)
    return [
        [
            [_fixed(value, digits) for value, digits in zip(values[:, i, j], decimals[:, i, j].tolist(), strict=True)]
            for j in range(len(_PLACES))
        ]
        for i in range(len(_QUANTITIES))
    ]


def _fixed(value: float, decimals: int) -> str:
    """Write a number with so many decimals; nothing where there is none."""
    if not np.isfinite(value):
        return ""
    if decimals == -99:
        return f"{value:.{_EXACT}g}"
    text = f"{value:.{decimals}f}" if decimals >= 0 else f"{round(value, decimals):.0f}"
    return text.removeprefix("-") if float(text) == 0.0 else text
