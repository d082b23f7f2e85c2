"""What a result learned along each direction of R: those that the beams see, and those that they cannot see."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.result import check_result, group
from bayes_rs.geometry.forward import RANK_TOLERANCE, design_matrix
from bayes_rs.geometry.scan import Scan, yaw_matrix
from bayes_rs.geometry.stress import STRESSES, rotate_stress

COLUMNS = ("record", "direction", "weight", "seen", "contraction", "contraction_shape", *STRESSES)


def directions(result: xr.DataTree, scan: Scan) -> pd.DataFrame:
    """Tell for every record how much the posterior contracted along each direction of R.

    Parameters
    ----------
    result : DataTree
        From `fit`.
    scan : Scan
        The scan of the records.

    Returns
    -------
    table : DataFrame
        Six rows a record, best seen direction first: ``weight``, the singular value over the largest; ``seen``, false
        where no beam's variance changes along the direction; ``contraction`` and ``contraction_shape`` as in `summary`,
        of the direction's component; and the direction itself, a unit vector over the six stresses in the lidar's
        frame (x against the lidar's axis, level).

    Raises
    ------
    InputError
        If the tree is not a result of `fit`, or the scan has other beams.

    Notes
    -----
    The directions are the right singular vectors d of the design matrix A of the level frame at yaw 0, in which they do
    not change from record to record; the posterior and prior covariances of the stresses are turned into it by each
    record's yaw. contraction = 1 − d·Σ d / d·Σ₀ d, with the covariances of R (or of R over its trace, for the shape)
    under posterior and prior. A direction that is not seen may contract none the less: what is learned of the others
    limits it, through the prior's correlations and because R is realizable. Of the shape, seen and unseen directions
    that share the diagonal mirror each other, because its trace is 1: the contraction of R itself tells them apart.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("4-beam"), brs.load_turbulence("fu-2022")
    >>> noise = brs.noise.calibrate(scan, flow, wind_speed=10.0, cache=False)
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1), scan)
    >>> table = directions(brs.fit(records, scan, noise=noise, seed=1, sampler="direct"), scan)
    >>> table["seen"].tolist()
    [True, True, True, True, False, False]
    """
    check_result(result)
    observed = group(result, "observed_data")
    beams = observed["beam"].values
    if not np.all(np.isin(beams, scan.beam)):
        raise InputError(f"The result's beams {beams.tolist()} are not all in scan {scan.name!r}: give its own scan.")
    weight, vectors = scan_directions(scan.select(beams))
    prior = group(result, "prior")["stress"].values.reshape(-1, len(STRESSES))
    posterior = group(result, "posterior")["stress"].transpose("record", "chain", "draw", "component").values
    posterior = posterior.reshape(len(posterior), -1, len(STRESSES))
    yaw = np.deg2rad(observed["yaw"].values)
    contraction, of_shape = contraction_along(vectors, posterior, yaw, prior_covariances(prior))
    return direction_rows(observed["record"].values, weight, vectors, contraction, of_shape)


def scan_directions(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Return the weights, shape (6,), and the directions of R, shape (6, 6), one a row, of a scan's beams."""
    _, singular, vectors = np.linalg.svd(design_matrix(scan.at_yaw(0.0)), full_matrices=True)
    weight = np.zeros(len(STRESSES))
    weight[: len(singular)] = singular / singular[0]
    weight[weight <= RANK_TOLERANCE] = 0.0
    # the sign of a singular vector means nothing: the largest entry is made positive
    return weight, vectors * np.sign(np.take_along_axis(vectors, np.abs(vectors).argmax(axis=1)[:, None], axis=1))


def direction_rows(
    record: NDArray[Any], weight: FloatArray, vectors: FloatArray, contraction: FloatArray, of_shape: FloatArray
) -> pd.DataFrame:
    """Lay contractions (n_record, 6) along the directions of R out as the table of `directions`."""
    n_record = len(record)
    return pd.DataFrame(
        {
            "record": np.repeat(record, len(STRESSES)),
            "direction": np.tile(np.arange(len(STRESSES)), n_record),
            "weight": np.tile(weight, n_record),
            "seen": np.tile(weight > 0.0, n_record),
            "contraction": contraction.ravel(),
            "contraction_shape": of_shape.ravel(),
            **{name: np.tile(vectors[:, index], n_record) for index, name in enumerate(STRESSES)},
        }
    )


def prior_covariances(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances, each (6, 6), of draws of a prior (n, 6) and of their shape."""
    return np.cov(draws, rowvar=False, bias=True), np.cov(_shape(draws), rowvar=False, bias=True)


def contraction_along(
    vectors: FloatArray, posterior: FloatArray, yaw: FloatArray, of_prior: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the contractions of R and of its shape along directions of R.

    Parameters
    ----------
    vectors : ndarray, shape (6, 6)
        The directions, one a row, in the lidar's frame.
    posterior : ndarray, shape (n_record, n_draw, 6)
        Draws, in the frame of each record's wind.
    yaw : ndarray, shape (n_record,)
        Wind directions relative to the lidar's axis, rad.
    of_prior : tuple of ndarray, shape (6, 6)
        From `prior_covariances`.

    Returns
    -------
    contraction, of_shape : ndarray, shape (n_record, 6)
        As in `directions`.
    """
    back = rotate_stress(np.eye(len(STRESSES)), yaw_matrix(-np.where(np.isfinite(yaw), yaw, 0.0))[:, None])
    along = vectors @ back.swapaxes(-1, -2)  # d in the mean-wind frame: (record, direction, 6)
    found = []
    for draws, prior in zip((posterior, _shape(posterior)), of_prior, strict=True):
        centred = draws - draws.mean(axis=1, keepdims=True)
        covariance = centred.swapaxes(-1, -2) @ centred / draws.shape[1]
        spread = [((along @ matrix) * along).sum(axis=-1) for matrix in (covariance, prior)]
        found.append(np.asarray(1.0 - spread[0] / spread[1]))
    return found[0], found[1]


def direction_words(direction: FloatArray) -> str:
    """Write a direction as a sum of stresses, entries below a twentieth of the largest left out.

    Parameters
    ----------
    direction : ndarray, shape (6,)
        Coefficients.

    Returns
    -------
    words : str
        Such as ``"0.98 uu − 0.12 vv"``.

    Examples
    --------
    >>> direction_words(np.array([0.9, -0.4, 0.01, 0.0, 0.0, 0.0]))
    '0.90 uu − 0.40 vv'
    """
    terms: list[str] = []
    for value, name in zip(direction, STRESSES, strict=True):
        if abs(value) >= 0.05 * np.abs(direction).max():
            sign = "− " if value < 0.0 else "+ " if terms else ""
            terms.append(f"{sign}{abs(value):.2f} {name}")
    return " ".join(terms)


def _shape(stress: FloatArray) -> FloatArray:
    return np.asarray(stress / stress[..., :3].sum(axis=-1, keepdims=True))
