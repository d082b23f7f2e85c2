"""Least squares for many records: linear combinations of unknowns, and whether the data determine them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import RANK_TOLERANCE

_ROW_TOLERANCE = 1e-7
"""Singular vectors are exact to rounding over the smallest singular value that counts, 1e-16 / 1e-9."""


@dataclass(frozen=True)
class Solved:
    """Estimates of linear combinations, shape (n_record, n_row): NaN where they are not identified."""

    value: FloatArray
    error: FloatArray
    identified: NDArray[np.bool_]

    @classmethod
    def empty(cls, n_record: int, n_row: int) -> Solved:
        """Return room for the estimates."""
        shape = (n_record, n_row)
        return cls(np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=np.bool_))

    def take(self, columns: slice, shown: NDArray[np.bool_] | bool) -> Solved:
        """Return some of the combinations, NaN and not identified where they are not shown."""
        return Solved(
            np.where(shown, self.value[:, columns], np.nan),
            np.where(shown, self.error[:, columns], np.nan),
            self.identified[:, columns] & shown,
        )

    def put(
        self,
        part: slice,
        rows: FloatArray,
        inverse: FloatArray,
        seen: FloatArray,
        data: FloatArray,
        covariance: FloatArray | None,
    ) -> None:
        """Fill in some records: `rows` of the unknowns (n_row, n_unknown), the inverse of their design, the data."""
        unseen = np.abs(rows - rows @ seen).max(axis=-1)
        size = np.abs(rows).max(axis=-1)
        # a row of zeros is what the method assumes: data have no part in it
        identified = (unseen <= _ROW_TOLERANCE * size) & (size > 0.0)
        weight = rows @ inverse
        self.identified[part] = identified
        self.value[part] = np.where(identified, np.einsum("rqb,rb->rq", weight, data), np.nan)
        if covariance is not None:
            square = np.einsum("rqb,rqb->rq", weight @ covariance, weight)
            # rounding can leave a square of zero error a little below zero
            self.error[part] = np.where(identified, np.sqrt(np.maximum(square, 0.0)), np.nan)


def pseudo_inverse(design: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pseudo-inverses of matrices (..., n_beam, n_unknown), and the projectors on their row spaces."""
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    counts = (singular > RANK_TOLERANCE * singular[..., :1]) & (singular > 0.0)
    reciprocal = np.where(counts, 1.0 / np.where(counts, singular, 1.0), 0.0)
    rows = np.where(counts[..., None], right, 0.0)
    inverse = (rows.swapaxes(-1, -2) * reciprocal[..., None, :]) @ left.swapaxes(-1, -2)
    return np.asarray(inverse), np.asarray(rows.swapaxes(-1, -2) @ rows)
