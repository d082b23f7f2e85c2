"""What a sonic measures in the same record as the beams, by theory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array, check_finite, check_positive
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES, rotate_stress, unpack_stress
from bayes_rs.theory.kept_lines import kept_covariance
from bayes_rs.theory.probed import CHUNK, shortest_length
from bayes_rs.theory.sampling_times import sample_counts, samples_that_fit
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace
from bayes_rs.turbulence.two_point import INDEX_PAIRS


@dataclass(frozen=True, eq=False)
class SonicMoments:
    """What a sonic measures in the same record as the beams: expected stresses and their covariance with the beams.

    Attributes
    ----------
    mean : ndarray, shape (6,)
        Expected stresses of a record, uu, vv, ww, uv, uw, vw, m² s⁻²; proportional to the dissipation.
    covariance : ndarray, shape (6, 6)
        Covariance of the six stresses of a record, m⁴ s⁻⁴; proportional to the dissipation squared.
    cross_covariance : ndarray, shape (n_beam, 6)
        Covariance of each beam's variance with the six stresses, m⁴ s⁻⁴.
    """

    mean: FloatArray
    covariance: FloatArray
    cross_covariance: FloatArray


def sonic_moments(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path = "fu-2022",
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw: float | None = None,
    position: ArrayLike = (0.0, 0.0, 0.0),
    detrend: str = "mean",
    tolerance: float = 1e-4,
) -> SonicMoments:
    """Return the joint moments of the beam variances and the six stresses that a sonic measures in the same record.

    Parameters
    ----------
    scan, turbulence, wind_speed, duration, yaw
        As in `bayes_rs.noise.theory`.
    position : array_like, shape (3,)
        Where the sonic is, m from the lidar in the mean-wind frame; at the lidar, the rotor's centre, if not given.
    detrend, tolerance
        As in `bayes_rs.noise.theory`.

    Returns
    -------
    moments : SonicMoments
        Mean and covariance of the sonic's stresses, and their covariance with the beams' variances.

    Raises
    ------
    InputError
        If an argument is not valid, or a beam has too few samples.

    Notes
    -----
    With r_ij = u_i · P u_j / N for the sonic's components and s_a² for a beam, Isserlis' theorem gives

        Cov[s_a², r_ij]  = 2 ⟨P C_ai P, P C_aj P⟩ / (N_a N),
        Cov[r_ij, r_kl] = (⟨P C_ik P, P C_jl P⟩ + ⟨P C_il P, P C_jk P⟩) / N².

    The sonic is sampled once a scan, at the scan's beginning, and sees a point; the beams see their probe volumes. Its
    position along the wind counts, since a record of frozen turbulence at another place holds other eddies.

    Examples
    --------
    A beam along the wind that measures where the sonic stands measures the sonic's uu:

    >>> moments = sonic_moments("staring", wind_speed=10.0, position=(-98, 0, 0))
    >>> bool(np.isclose(moments.cross_covariance[0, 0], moments.covariance[0, 0]))
    True
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    place = check_array(position, (3,), what="position")
    line_of_sight = scan.at_yaw(
        scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad", quantity="wind_yaw")
    )
    count = sample_counts(scan, duration, detrend)
    n = int(samples_that_fit(duration, scan.scan_duration))
    apart = place - line_of_sight * scan.focus_distance[:, np.newaxis]
    apart[:, 0] += wind_speed * scan.beam_time
    axes, shortest = np.eye(3), shortest_length(scan.probe_length)

    def covariances(vectors: FloatArray, separation: FloatArray, lengths: FloatArray, n_own: int) -> FloatArray:
        """Covariances of radial velocities with u, v and w of the sonic, shape (n_vector, 3, n_lag)."""
        lag = wind_speed * scan.scan_duration * np.arange(-(n_own - 1), n)
        rows = np.repeat(np.arange(len(vectors)), 3)
        flat = kept_covariance(
            vectors[rows],
            np.tile(axes, (len(vectors), 1)),
            separation[rows, 1:],
            separation[rows, :1] - lag,
            turbulence,
            probe=scan.probe,
            lengths=np.stack([lengths[rows], np.zeros(len(rows))], axis=-1),
            shortest=shortest,
            tolerance=tolerance,
        )
        return flat.reshape(len(vectors), 3, -1)

    own = covariances(axes, np.zeros((3, 3)), np.zeros(3), n)
    mean = np.array([toeplitz_trace(own[i, j], n, detrend=detrend) / n for i, j in INDEX_PAIRS])
    covariance = np.empty((len(STRESSES), len(STRESSES)))
    for row, (i, j) in enumerate(INDEX_PAIRS):
        for column, (k, m) in enumerate(INDEX_PAIRS):
            terms = toeplitz_inner(own[i, k], own[j, m], n, n, detrend=detrend)
            terms = terms + toeplitz_inner(own[i, m], own[j, k], n, n, detrend=detrend)
            covariance[row, column] = float(terms) / n**2
    cross = np.empty((scan.n_beam, len(STRESSES)))
    for size in np.unique(count):
        members = np.flatnonzero(count == size)
        for part in np.array_split(members, int(np.ceil(3 * len(members) * (n + int(size)) / CHUNK))):
            with_beam = covariances(line_of_sight[part], apart[part], scan.probe_length[part], int(size))
            for column, (i, j) in enumerate(INDEX_PAIRS):
                inner = toeplitz_inner(with_beam[:, i], with_beam[:, j], int(size), n, detrend=detrend)
                cross[part, column] = 2.0 * inner / (n * int(size))
    return SonicMoments(mean=mean, covariance=0.5 * (covariance + covariance.T), cross_covariance=cross)


def whitened_moments(moments: SonicMoments, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the moments of T = L⁻¹ S L⁻ᵀ and of relative beam variances, from which the size of the flow is gone.

    Parameters
    ----------
    moments : SonicMoments
        Joint moments of the beams' variances and the sonic's stresses S.
    expected : ndarray, shape (n_beam,)
        Expected variances E[y] of the beams, m² s⁻².

    Returns
    -------
    covariance : ndarray, shape (6, 6)
        Cov[T], with L Lᵀ = E[S] and L lower triangular.
    beam_covariance : ndarray, shape (6, n_beam)
        Cov[T, y / E[y]].
    """
    root = np.linalg.inv(np.linalg.cholesky(unpack_stress(moments.mean)))
    whiten = rotate_stress(np.eye(len(STRESSES)), root.T).T  # T = root S rootᵀ, as a matrix on the six stresses
    covariance = whiten @ moments.covariance @ whiten.T
    return 0.5 * (covariance + covariance.T), whiten @ moments.cross_covariance.T / expected
