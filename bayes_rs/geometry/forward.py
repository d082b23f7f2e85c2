"""The forward model: from stresses to radial variances, and what of the stresses the beams can see."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, as_numbers, check_non_negative
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES, unpack_stress

_LONGEST = 1e6  # entry of a beam vector, which need not be of unit length for its own sake
RANK_TOLERANCE = 1e-9
"""A singular value below this fraction of the largest counts as zero: directions are stored to about 1e-16."""
POINTING_DEG = 0.5
"""How well it is known where a beam points, degrees: between the 0.1° of a scanner and the 1° of north and level."""


def design_matrix(scan: Scan | str | Path | ArrayLike) -> FloatArray:
    """Return the matrix that maps the six stresses to radial variances.

    Parameters
    ----------
    scan : Scan, str, Path or array_like, shape (..., n_beam, 3)
        A scan, its name or file, or beam vectors n in the mean-wind frame.

    Returns
    -------
    matrix : ndarray, shape (..., n_beam, 6)
        Rows n₁², n₂², n₃², 2n₁n₂, 2n₁n₃, 2n₂n₃, for stresses in the order uu, vv, ww, uv, uw, vw.

    Raises
    ------
    InputError
        If the last dimension of the vectors is not 3.

    Notes
    -----
    σ² = n·R n = Σᵢ Σⱼ nᵢ nⱼ Rᵢⱼ, the variance of v_r = n·u. The signs of the cross terms come from n itself;
    Fu et al. (2022), Eq. (4), is this formula with n₁ = −cos φ put in.

    References
    ----------
    Eberhard, Cupp and Healy (1989), J. Atmos. Oceanic Technol. 6, 809–819,
    doi:10.1175/1520-0426(1989)006<0809:DLMOPO>2.0.CO;2.
    Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016.

    Examples
    --------
    >>> design_matrix([[-1.0, 0.0, 0.0], [-0.6, 0.0, 0.8]])
    array([[ 1.  ,  0.  ,  0.  , -0.  , -0.  ,  0.  ],
           [ 0.36,  0.  ,  0.64, -0.  , -0.96,  0.  ]])
    """
    vectors = _lines(scan)
    if vectors.ndim < 1 or vectors.shape[-1] != 3:
        raise InputError(f"Invalid beam vectors of shape {vectors.shape}: the last dimension must be 3.")
    if np.any(np.abs(vectors) > _LONGEST):
        raise InputError(
            f"Invalid beam vectors: an entry is {np.nanmax(np.abs(vectors)):g}, and they are unit vectors."
        )
    first, second, third = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack(
        [first**2, second**2, third**2, 2.0 * first * second, 2.0 * first * third, 2.0 * second * third], axis=-1
    )


def radial_variance(scan: Scan | str | Path | ArrayLike, stress: ArrayLike) -> FloatArray:
    """Return the radial variance n·R n of each beam.

    Parameters
    ----------
    scan : Scan, str, Path or array_like, shape (n_beam, 3)
        A scan, its name or file, or beam vectors n in the mean-wind frame.
    stress : array_like, shape (..., 6)
        Stresses uu, vv, ww, uv, uw, vw, m² s⁻².

    Returns
    -------
    variance : ndarray, shape (..., n_beam)
        Radial variances, m² s⁻².

    Examples
    --------
    >>> float(radial_variance([[-0.6, 0.0, 0.8]], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0])[0])
    1.0
    """
    tensor = as_numbers(stress, what="stress")
    if tensor.ndim == 0 or tensor.shape[-1] != len(STRESSES):
        raise InputError(f"Invalid stress of shape {tensor.shape}: the last dimension must hold {', '.join(STRESSES)}.")
    return tensor @ np.moveaxis(design_matrix(scan), -1, 0)


@dataclass(frozen=True)
class Sight:
    """What the beams of a scan can see of R.

    Parameters
    ----------
    rank : int
        Number of independent directions of R that the radial variances depend on, at most 6.
    condition : float
        Ratio of the largest singular value of the design matrix to the smallest of those that are seen.
    unseen : ndarray, shape (6 − rank, 6)
        Directions of R that change no radial variance, in echelon form: each row leads with a 1. Entries that the
        angles do not tell from zero are zero.
    """

    rank: int
    condition: float
    unseen: FloatArray

    def in_words(self) -> str:
        """Say which stresses are seen alone, together with others, or not at all."""
        if len(self.unseen) == 0:
            return "sees all six stresses"
        parts = []
        touched = np.any(self.unseen != 0.0, axis=0)
        alone = [name for name, mixed in zip(STRESSES, touched, strict=True) if not mixed]
        parts.append(f"sees {', '.join(alone)}" if alone else "sees no stress alone")
        blind = []
        for rows in _connected(self.unseen):
            members = np.flatnonzero(np.any(rows != 0.0, axis=0))
            if len(rows) == len(members):
                blind += [STRESSES[index] for index in members]
            elif len(rows) == 1:
                parts.append(_in_words(rows[0]))
            else:
                count = len(members) - len(rows)
                names = ", ".join(STRESSES[index] for index in members)
                parts.append(f"sees only {count} combination{'s' if count > 1 else ''} of {names}")
        if blind:
            parts.append(f"does not see {', '.join(blind)}")
        return "; ".join(parts)


def sight(scan: Scan | str | Path | ArrayLike, *, pointing_deg: float = POINTING_DEG) -> Sight:
    r"""Work out what the beams can see of R.

    Parameters
    ----------
    scan : Scan, str, Path or array_like, shape (n_beam, 3)
        A scan, its name or file, or beam vectors n in the mean-wind frame.
    pointing_deg : float
        Standard deviation of a beam's direction, degrees; 0 takes the directions as exact.

    Returns
    -------
    sight : Sight
        Rank, condition number, and the directions of R that no beam sees.

    Raises
    ------
    InputError
        If the vectors are no list of finite ones, or the angle is not valid.

    Notes
    -----
    From the singular values :math:`s_k` and vectors :math:`r_k` of the design matrix A. When a beam turns by a small
    angle δ, its gain for a direction r changes by :math:`e_b = 2 δ |P_b R n_b|`, with R the tensor of r and :math:`P_b`
    the projection across the beam. So what the angles do not tell from zero counts as zero: :math:`s_k` up to
    :math:`(Σ_b e_b²)^{1/2}` (or 1e-9 of the largest), and entry j of an unseen direction up to
    :math:`(Σ_b (A^+_{jb} e_b)²)^{1/2}`, which is how far it turns when the beams do, but not more than 2 δ, which is
    how far it turns when the scan does as a whole.

    Examples
    --------
    >>> sight("50-beam").in_words()
    'sees uv, uw, vw; sees uu only together with vv + ww'

    A scan of five beams whose azimuths are a hundredth of a degree off sees as much as one that is exact:

    >>> azimuth, slant = np.deg2rad([0.01, 90.0, 179.98, 270.01]), np.deg2rad(75.0)
    >>> level, up = np.cos(slant), np.full(4, np.sin(slant))
    >>> beams = np.stack([-level * np.cos(azimuth), level * np.sin(azimuth), up], axis=-1)
    >>> sight([*beams, [0.0, 0.0, 1.0]]).in_words()
    'sees uu, vv, ww, uw, vw; does not see uv'
    """
    angle = np.deg2rad(check_non_negative(pointing_deg, what="pointing_deg", unit="degrees"))
    matrix = design_matrix(scan)
    if matrix.ndim != 2 or len(matrix) == 0 or not np.any(matrix) or not np.all(np.isfinite(matrix)):
        raise InputError(
            f"Invalid beam vectors of shape {matrix.shape[:-1]}: give a list of finite ones, not all zero."
        )
    lines = _lines(scan)
    left, singular, basis = np.linalg.svd(matrix, full_matrices=True)
    unsure = np.linalg.norm(_gain_change(lines, basis[: len(singular)]), axis=0) * angle
    rank = max(int(np.count_nonzero(singular > np.maximum(RANK_TOLERANCE * singular[0], unsure))), 1)
    inverse = np.abs(basis[:rank].T / singular[:rank] @ left[:, :rank].T)

    def turned(rows: FloatArray) -> FloatArray:
        """Return how far the entries of unseen directions, (n, 6), turn when the beams do."""
        return np.asarray(angle * np.sqrt(inverse**2 @ _gain_change(lines, rows) ** 2).T)

    unseen = basis[rank:]
    free = np.linalg.norm(unseen, axis=0) > np.minimum(np.linalg.norm(turned(unseen), axis=0), 2.0 * angle)
    unseen = _echelon(np.where(free, unseen, 0.0))
    unseen = np.where(np.abs(unseen) > np.minimum(turned(unseen), 2.0 * angle), unseen, 0.0)
    return Sight(rank, float(singular[0] / singular[rank - 1]), unseen)


def _lines(scan: Scan | str | Path | ArrayLike) -> FloatArray:
    """Return the beam vectors, (n_beam, 3), of what `design_matrix` takes."""
    scan = as_scan(scan) if isinstance(scan, str | Path) else scan
    return scan.line_of_sight if isinstance(scan, Scan) else as_numbers(scan, what="beam vectors")


def _gain_change(lines: FloatArray, directions: FloatArray) -> FloatArray:
    """Return by how much beams' gains for directions of R, (n, 6), change a radian of turning, (n_beam, n)."""
    pull = np.einsum("kij,bj->bki", unpack_stress(directions), lines)
    length = np.linalg.norm(lines, axis=1)[:, np.newaxis, np.newaxis]
    unit = lines[:, np.newaxis, :] / np.where(length > 0.0, length, 1.0)
    across = pull - np.sum(pull * unit, axis=-1, keepdims=True) * unit
    return np.asarray(2.0 * np.linalg.norm(across, axis=-1) * length[..., 0])


def _echelon(rows: FloatArray) -> FloatArray:
    """Bring rows to reduced echelon form, entries of rounding set to exactly zero."""
    matrix = rows.copy()
    row = 0
    for column in range(matrix.shape[1]):
        if row == len(matrix):
            break
        pivot = row + int(np.argmax(np.abs(matrix[row:, column])))
        if abs(matrix[pivot, column]) < 1e-7:
            continue
        matrix[[row, pivot]] = matrix[[pivot, row]]
        matrix[row] /= matrix[row, column]
        others = np.arange(len(matrix)) != row
        matrix[others] -= np.outer(matrix[others, column], matrix[row])
        row += 1
    return np.where(np.abs(matrix) < 1e-7, 0.0, matrix)


def _connected(rows: FloatArray) -> list[FloatArray]:
    """Group the rows that share a stress, directly or through other rows."""
    groups: list[list[int]] = []
    for index, row in enumerate(rows):
        joined = [group for group in groups if any(np.any((rows[member] != 0.0) & (row != 0.0)) for member in group)]
        groups = [group for group in groups if group not in joined] + [[*(m for group in joined for m in group), index]]
    return [rows[sorted(group)] for group in groups]


def _in_words(direction: FloatArray) -> str:
    """Say which stresses move together along an unseen direction: adding to one is undone by the others."""
    lead, *others = np.flatnonzero(direction)
    reference = direction[others[0]]
    terms: list[str] = []
    for index in others:
        ratio = direction[index] / reference
        size = "" if np.isclose(abs(ratio), 1.0, rtol=1e-6) else f"{abs(ratio):.3g} "
        sign = " + " if ratio > 0 else " − "
        terms.append((sign if terms else "") + size + STRESSES[index])
    return f"sees {STRESSES[lead]} only together with {''.join(terms)}"
