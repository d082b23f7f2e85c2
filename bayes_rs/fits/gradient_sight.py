"""What of a gradient of the stresses looks like homogeneous stresses, and what of it a scan can see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from bayes_rs._validation import check_array
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.inflow import GRADIENT_LENGTH, GRADIENTS, gradient_columns
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES, is_realizable
from bayes_rs.likelihoods.base import seen_directions
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise

_NOTHING = 1e-10
"""Share of a gradient's information that is rounding."""


def inflow_confounding(
    scan: Scan | str | Path, stress: ArrayLike, *, noise: Noise | str | Path | None = None
) -> pd.DataFrame:
    """Tell what a homogeneous fit makes of a gradient of the stresses, and whether data could tell the two apart.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, at its own yaw, its name or its file.
    stress : array_like, shape (6,)
        The stresses at the middle of the scan, m² s⁻².
    noise : Noise, str or Path, optional
        Noise of the scan's variances, or its file: the fit is weighted by it, and ``sd`` is known. By default all
        beams weigh the same.

    Returns
    -------
    table : DataFrame
        A row for each gradient and stress: ``change``, what is added to the stress for each unit of the gradient (a
        change of ln R by 1 over 100 m), m² s⁻²; ``over_uu``, the same over uu. The same for all stresses of a gradient:
        ``hidden``, the share of its effect on the beams' variances that stresses can mimic (1: no data of this
        scan can tell it from stresses, priors decide; 0: the stresses cannot take the blame), and ``sd``, the standard
        deviation of the gradient that one record alone would give, with nothing known of the stresses; infinite where
        all is hidden, NaN without `noise`.

    Raises
    ------
    InputError
        If the tensor is not realizable, or gives a beam no variance.
    NoiseMismatchError
        If the noise was made for another scan.

    Notes
    -----
    A small gradient γ along x changes the variance of beam b by γ x_b m_b, m_b = n·R n. With A the rows
    (∂m_b/∂R)/m_b, ``change`` minimizes ‖A δR − x‖² (the smallest δR, where the scan does not see all of R) and
    ``hidden`` is 1 − ‖A δR − x‖²/‖x‖². With noise, the norm is that of the likelihood: xᵀ W x with
    W = U (Uᵀ ln(1 + K) U)⁻¹ Uᵀ on the column space U of A and both gradients; the information on γ is ‖A δR − x‖²
    itself, and ``sd`` its root, inverted.

    For one opening angle φ and one focus distance f, z = f n₃ and n₁ = −cos φ for all beams, so that a gradient of uu
    is *exactly* a change of uw, n₁² z ∂uu/∂z = 2 n₁ n₃ δuw with δuw = −½ f cos φ ∂uu/∂z; a lateral one is one of uv.
    What the gradients of the other stresses add is a third harmonic in the beams' azimuth, by tan² φ smaller, which
    five beams on a circle cannot tell from lower ones.

    Examples
    --------
    >>> table = inflow_confounding("6-beam", [1.0, 0.5, 0.27, 0.0, -0.15, 0.0])
    >>> table.query("gradient == 'vertical_gradient' and stress == 'uw'").round(2)[["change", "hidden"]].values.tolist()
    [[-0.48, 1.0]]
    """
    scan = as_scan(scan)
    own = given_noise(noise)
    tensor = check_array(stress, (len(STRESSES),), what="stress")
    if not bool(is_realizable(tensor)):
        raise InputError(f"Invalid stress {tensor.tolist()}: the tensor must be realizable.")
    matrix = design_matrix(scan)
    if own is not None:
        own.check_scan(scan)
        matrix = own.gain[0] if own.yaw[0] == scan.yaw else matrix
    level = matrix @ tensor
    if not np.all(level > 0.0):
        raise InputError(f"Invalid stress {tensor.tolist()}: it gives beam {int(np.argmin(level))} no variance.")
    place = gradient_columns(scan.geometry()) / GRADIENT_LENGTH
    relative = matrix / level[:, None]
    if own is not None:
        left, seen = seen_directions(np.concatenate([relative, place], axis=1)[None])
        basis = left[0][:, seen[0]]
        root = np.linalg.cholesky(basis.T @ np.log1p(own.covariance[0]) @ basis)
        relative, place = (np.linalg.solve(root, basis.T @ columns) for columns in (relative, place))
    inverse = np.linalg.pinv(relative, rcond=_NOTHING)
    rows = []
    for name, column in zip(GRADIENTS, place.T, strict=True):
        change = inverse @ column
        size, left_over = float(column @ column), float(np.sum((relative @ change - column) ** 2))
        # a scan without extent shows nothing of a gradient
        share = left_over / size if size > 0.0 else 0.0
        information = left_over if share > _NOTHING else 0.0
        rows += [
            {
                "gradient": name,
                "stress": stress_name,
                "change": value,
                "over_uu": value / float(tensor[0]),
                "hidden": 1.0 - share,
                "sd": np.nan if noise is None else information**-0.5 if information else np.inf,
            }
            for stress_name, value in zip(STRESSES, change.tolist(), strict=True)
        ]
    return pd.DataFrame(rows)
