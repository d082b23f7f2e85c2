"""Times of a table that repeats each of them for every gate of a ray: read once, and spread over the rows."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs.readers.entries import times
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.table import Column
from bayes_rs.readers.text_lines import PlacedColumn

_WORTH_IT = 0.5  # share of distinct texts above which each is read


def times_of_rays(column: Column, file_format: FileFormat) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    """Return a column as UTC times, and which entries held an invalid value, as `times` does.

    Raises
    ------
    InputError
        If an entry is not a date and time. The message names its line.
    """
    if column.bad is not None and column.bad.drop:
        return times(column, file_format)  # which says of every row that it is bad
    if not (pd.api.types.is_object_dtype(column.values.dtype) or pd.api.types.is_string_dtype(column.values.dtype)):
        return times(column, file_format)
    code, texts = pd.factorize(column.values)
    if len(texts) == 0 or len(texts) > _WORTH_IT * len(code):
        return times(column, file_format)
    first = np.full(len(texts), -1)
    known = np.flatnonzero(code >= 0)
    first[code[known][::-1]] = known[::-1]
    rows = column.rows if isinstance(column, PlacedColumn) else column.first_row + np.arange(len(code), dtype=np.int64)
    distinct = PlacedColumn(
        column.name, column.heading, pd.Series(texts), column.file, column.row_word, 1, column.bad, rows[first]
    )
    time, invalid = times(distinct, file_format)
    return np.where(code < 0, np.datetime64("NaT", "ns"), time[code]), np.where(code < 0, False, invalid[code])
