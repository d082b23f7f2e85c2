"""Rows of a table that cannot be used: refused, or left out, counted, and the first one named."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.errors import InputError

FEW_ROWS = 10
SHARE_OF_ROWS = 0.01
"""Bad rows, and their share, up to which they may be left out: beyond, the file is not what it is read as."""
ADVICE = "or leave such rows out with bad_rows='drop' (--bad-rows drop)"

BoolArray = NDArray[np.bool_]


@dataclass
class BadRows:
    """What of a table is left out.

    Parameters
    ----------
    file : Path
        The file.
    row_word : str
        What a person counts in it: line or row.
    drop : bool
        Whether bad rows are left out; otherwise the first one is refused.
    rows : set of int
        Their numbers, as a person counts.
    first : str
        Why the first one found is bad.
    cut : int or None
        The last row, if the file ends within it.
    """

    file: Path
    row_word: str
    drop: bool
    rows: set[int] = field(default_factory=set)
    first: str = ""
    cut: int | None = None

    def reset(self) -> None:
        """Forget all: the file is read anew."""
        self.rows, self.first, self.cut = set(), "", None

    def refuse(self, rows: NDArray[Any], message: str) -> None:
        """Leave rows out, or refuse the first.

        Parameters
        ----------
        rows : ndarray of int
            Their numbers.
        message : str
            What is wrong with the first one, as a whole sentence without its end.

        Raises
        ------
        InputError
            If rows are not to be left out.
        """
        numbers = [row for row in rows.tolist() if row != self.cut and row not in self.rows]
        if not numbers:
            return
        if not self.drop:
            raise InputError(f"{message}, {ADVICE}.")
        self.first = self.first or message
        self.rows.update(numbers)

    def mask(self, first_row: int, n_row: int) -> BoolArray:
        """Say which of `n_row` rows from `first_row` on are left out."""
        bad = np.zeros(n_row, dtype=bool)
        for row in self.rows if self.cut is None else (*self.rows, self.cut):
            if first_row <= row < first_row + n_row:
                bad[row - first_row] = True
        return bad

    def counts(self, first_row: int, n_row: int) -> dict[str, int]:
        """Count for the report what of these rows is left out: ``rows_bad`` and ``rows_cut``, where there are any."""
        is_cut = self.cut is not None and first_row <= self.cut < first_row + n_row
        n_bad = sum(first_row <= row < first_row + n_row for row in self.rows)
        return {name: count for name, count in (("rows_bad", n_bad), ("rows_cut", int(is_cut))) if count}

    def facts(self) -> dict[str, str]:
        """Name for the report the first bad row, if there is one."""
        return {"first_bad_row": self.first} if self.first else {}

    def check(self, n_row: int) -> None:
        """Refuse a file that has more than a few bad rows.

        Raises
        ------
        InputError
            If there are more than `FEW_ROWS` and `SHARE_OF_ROWS`.
        """
        if len(self.rows) > max(FEW_ROWS, SHARE_OF_ROWS * n_row):
            raise InputError(
                f"File {str(self.file)!r} has {len(self.rows)} bad rows of {n_row}, more than may be left out "
                f"({SHARE_OF_ROWS:.0%} of them, or {FEW_ROWS}); the first: {self.first}."
            )
