"""The noise of a record by theory: mean and covariance of the beam variances of finite records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.forward import design_matrix
from bayes_rs.mann import MannTurbulence
from bayes_rs.noise import NoiseModel
from bayes_rs.scan import Scan
from bayes_rs.stress import STRESSES
from bayes_rs.toeplitz import DETRENDING, toeplitz_inner, toeplitz_trace
from bayes_rs.two_point import radial_covariance, resolution_for

_INDEX_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the two indices of each of the six stresses
_CHUNK = 1_500_000  # covariances held at a time: some 100 MiB of working arrays
_SAME = 1e-9  # pairs whose separations (m) and directions agree to this are computed once
_ROUNDING = 1e-9  # of a sampling interval: whether the last sample is still inside the record


def theory_noise(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw: float | None = None,
    detrend: str = "mean",
    tolerance: float = 1e-4,
) -> NoiseModel:
    """Return the noise of a record's beam variances for Gaussian, frozen Mann turbulence and beams that see points.

    Parameters
    ----------
    scan : Scan
        The scan, with its timing: beam b is sampled at beam_time_b + i · scan_duration while that is in the record.
    turbulence : MannTurbulence
        The turbulence; its dissipation has no influence.
    wind_speed : float
        Mean wind speed U, m/s.
    duration : float
        Length of the record T, s.
    yaw : float, optional
        Wind direction relative to the lidar axis ψ, rad; the mounting's own if not given.
    detrend : str
        ``"mean"`` or ``"linear"``: what is removed from each beam's record first.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    noise : NoiseModel
        Bias, gain and relative covariance. Its details hold ``covariance_error``, a bound on the error of every entry
        of K that follows from `tolerance`, and ``negative_part``: where the true K is singular, the error can leave
        eigenvalues just below zero; they are set to zero, which moves K towards the truth (to the nearest point of
        a convex set that holds it), and this is the size of the lowest of them over the largest eigenvalue.

    Raises
    ------
    InputError
        If an argument is not valid, or a beam has fewer than two samples (three for linear detrending).
    NotPositiveDefiniteError
        If the negative part is larger than the error bound explains.

    Notes
    -----
    With C_ab the matrix of covariances between the samples of beams a and b, P the projection that removes the mean or
    the line, and s² = ‖P v‖²/N, Isserlis' theorem gives

        E s_b² = tr(P C_bb P) / N_b,     Cov[s_a², s_b²] = 2 ‖P C_ab P‖²_F / (N_a N_b),

    bias_b = E s_b² / n·Rn − 1 and K_ab = Cov[s_a², s_b²] / (E s_a² E s_b²). C_ab is a Toeplitz matrix, so
    `toeplitz_inner` needs its N_a + N_b − 1 numbers only. A lag τ is a separation −Uτ along the wind.

    Examples
    --------
    >>> from bayes_rs.mann import load_turbulence
    >>> from bayes_rs.scan_file import load_scan
    >>> noise = theory_noise(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0)
    >>> float(noise.bias[0].round(3)), float(noise.relative_error[0].round(3))
    (-0.125, 0.258)
    """
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    promised, resolution = resolution_for(tolerance, turbulence.gamma)
    angle = scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad")
    line_of_sight = scan.at_yaw(angle)
    count = sample_counts(scan, duration, detrend)
    pairs = _distinct_pairs(scan, line_of_sight, count, wind_speed)
    inner, trace = np.empty(len(pairs.across)), np.empty(len(pairs.across))
    for samples in np.unique(pairs.samples, axis=0):
        members = np.flatnonzero(np.all(pairs.samples == samples, axis=1))
        n_a, n_b = int(samples[0]), int(samples[1])
        lag = wind_speed * scan.scan_duration * np.arange(-(n_a - 1), n_b)
        for part in np.array_split(members, int(np.ceil(len(members) * len(lag) / _CHUNK))):
            covariance = radial_covariance(
                pairs.first[part],
                pairs.second[part],
                pairs.across[part],
                pairs.along[part, np.newaxis] - lag,
                turbulence,
                tolerance=tolerance,
            )
            inner[part] = toeplitz_inner(covariance, covariance, n_a, n_b, detrend=detrend) / (n_a * n_b)
            own = pairs.own[part]
            if np.any(own):  # then n_a = n_b
                trace[part[own]] = toeplitz_trace(covariance[own], n_a, detrend=detrend) / n_a
    mean = trace[pairs.distinct[pairs.row == pairs.column]]
    expected = design_matrix(line_of_sight) @ turbulence.stresses()
    relative = np.zeros((scan.n_beam, scan.n_beam))
    relative[pairs.row, pairs.column] = 2.0 * inner[pairs.distinct] / (mean[pairs.row] * mean[pairs.column])
    relative[pairs.column, pairs.row] = relative[pairs.row, pairs.column]
    error = _covariance_error(relative, mean, promised * float(turbulence.stresses()[0]))
    relative, negative_part = _nearest_covariance(relative, error)
    return NoiseModel(
        bias=mean / expected - 1.0,
        gain=design_matrix(line_of_sight),
        covariance=relative,
        beam=scan.beam,
        scan_name=scan.name,
        scan_geometry=scan.geometry(),
        wind_speed=wind_speed,
        yaw=angle,
        duration=duration,
        turbulence=turbulence,
        method="theory",
        n_realizations=np.inf,
        details={
            "detrend": detrend,
            "velocity_covariance_error": promised,
            "covariance_error": error,
            "negative_part": negative_part,
            "n_pairs": len(pairs.row),
            "n_unique_pairs": len(pairs.across),
            "samples": [int(np.min(count)), int(np.max(count))],
            "quadrature_step": resolution.step,
            "n_harmonic": resolution.n_harmonic,
        },
    )


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
    scan: Scan,
    turbulence: MannTurbulence,
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
        As in `theory_noise`.
    position : array_like, shape (3,)
        Where the sonic is, m from the lidar in the mean-wind frame; at the lidar, the rotor's centre, if not given.
    detrend, tolerance
        As in `theory_noise`.

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

    The sonic is sampled once a scan, at the scan's beginning, and sees a point. Its position along the wind counts,
    since a record of frozen turbulence at another place holds other eddies.

    Examples
    --------
    A beam along the wind that measures where the sonic stands measures the sonic's uu:

    >>> from bayes_rs.mann import load_turbulence
    >>> from bayes_rs.scan_file import load_scan
    >>> moments = sonic_moments(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0, position=(-98, 0, 0))
    >>> bool(np.isclose(moments.cross_covariance[0, 0], moments.covariance[0, 0]))
    True
    """
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    place = check_array(position, (3,), what="position")
    line_of_sight = scan.at_yaw(scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad"))
    count = sample_counts(scan, duration, detrend)
    n = int(np.ceil(duration / scan.scan_duration - _ROUNDING))
    apart = place - line_of_sight * scan.focus_distance[:, np.newaxis]
    apart[:, 0] += wind_speed * scan.beam_time
    axes = np.eye(3)

    def covariances(vectors: FloatArray, separation: FloatArray, n_own: int) -> FloatArray:
        """Covariances of radial velocities with u, v and w of the sonic, shape (n_vector, 3, n_lag)."""
        lag = wind_speed * scan.scan_duration * np.arange(-(n_own - 1), n)
        rows = np.repeat(np.arange(len(vectors)), 3)
        flat = radial_covariance(
            vectors[rows],
            np.tile(axes, (len(vectors), 1)),
            separation[rows, 1:],
            separation[rows, :1] - lag,
            turbulence,
            tolerance=tolerance,
        )
        return flat.reshape(len(vectors), 3, -1)

    own = covariances(axes, np.zeros((3, 3)), n)
    mean = np.array([toeplitz_trace(own[i, j], n, detrend=detrend) / n for i, j in _INDEX_PAIRS])
    covariance = np.empty((len(STRESSES), len(STRESSES)))
    for row, (i, j) in enumerate(_INDEX_PAIRS):
        for column, (k, m) in enumerate(_INDEX_PAIRS):
            terms = toeplitz_inner(own[i, k], own[j, m], n, n, detrend=detrend)
            terms = terms + toeplitz_inner(own[i, m], own[j, k], n, n, detrend=detrend)
            covariance[row, column] = float(terms) / n**2
    cross = np.empty((scan.n_beam, len(STRESSES)))
    for size in np.unique(count):
        members = np.flatnonzero(count == size)
        for part in np.array_split(members, int(np.ceil(3 * len(members) * (n + int(size)) / _CHUNK))):
            with_beam = covariances(line_of_sight[part], apart[part], int(size))
            for column, (i, j) in enumerate(_INDEX_PAIRS):
                inner = toeplitz_inner(with_beam[:, i], with_beam[:, j], int(size), n, detrend=detrend)
                cross[part, column] = 2.0 * inner / (n * int(size))
    return SonicMoments(mean=mean, covariance=0.5 * (covariance + covariance.T), cross_covariance=cross)


def sample_counts(scan: Scan, duration: float, detrend: str = "mean") -> NDArray[np.int64]:
    """Return how many samples of each beam a record holds, shape (n_beam,).

    Parameters
    ----------
    scan : Scan
        The scan.
    duration : float
        Length of the record, s; it begins with the first beam of a scan.
    detrend : str
        ``"mean"`` or ``"linear"``: what is removed, and so how many samples are needed.

    Returns
    -------
    count : ndarray of int, shape (n_beam,)
        Samples at beam_time + i · scan_duration before the end of the record.

    Raises
    ------
    InputError
        If a beam has no more samples than the detrending takes out.
    """
    removed = 1 + DETRENDING.index(check_choice(detrend, DETRENDING, what="detrend"))
    count = np.ceil((duration - scan.beam_time) / scan.scan_duration - _ROUNDING).astype(np.int64)
    for index in np.flatnonzero(count <= removed):
        raise InputError(
            f"Invalid duration {duration:g} s for scan {scan.name!r}: beam {scan.beam[index]} has "
            f"{max(int(count[index]), 0)} samples in a record, and removing the {detrend} leaves nothing of fewer than "
            f"{removed + 1}; make the record longer than {removed + 1} scans of {scan.scan_duration:g} s."
        )
    return count


class _Pairs(NamedTuple):
    """All pairs of beams, row ≤ column, and the distinct ones among them."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    distinct: NDArray[np.int64]  # which distinct pair each pair is
    first: FloatArray
    second: FloatArray
    across: FloatArray
    along: FloatArray  # separation of the sampled parcels at the first scan, along the wind
    samples: NDArray[np.int64]  # of the first and of the second beam
    own: NDArray[np.bool_]  # a beam with itself


def _distinct_pairs(scan: Scan, line_of_sight: FloatArray, count: NDArray[np.int64], wind_speed: float) -> _Pairs:
    """Find the distinct pairs: mirror images in the x–z plane are one, and so are shifted copies."""
    row, column = np.triu_indices(scan.n_beam)
    place = line_of_sight * scan.focus_distance[:, np.newaxis]
    place[:, 0] -= wind_speed * scan.beam_time
    apart = place[column] - place[row]
    first, second = line_of_sight[row], line_of_sight[column]
    samples = np.stack([count[row], count[column]], axis=-1)
    mirror = np.where(apart[:, 1] < 0.0, -1.0, 1.0)[:, np.newaxis] * [0.0, 1.0, 0.0] + [1.0, 0.0, 1.0]
    table = np.concatenate([mirror * apart, mirror * first, mirror * second, samples, (row == column)[:, None]], axis=1)
    _, index, distinct = np.unique(np.round(table / _SAME) + 0.0, axis=0, return_index=True, return_inverse=True)
    return _Pairs(
        row=row,
        column=column,
        distinct=distinct.reshape(-1),
        first=table[index, 3:6],
        second=table[index, 6:9],
        across=table[index, 1:3],
        along=table[index, 0],
        samples=samples[index],
        own=(row == column)[index],
    )


def _covariance_error(relative: FloatArray, mean: FloatArray, velocity_error: float) -> float:
    """Bound the error of K by Cauchy and Schwarz: |δ‖PCP‖²| ≤ 2 ‖PCP‖ ‖δC‖ to first order, with ‖δC‖ ≤ N · error."""
    return float(2.0 * np.sqrt(2.0 * np.max(relative)) * velocity_error / np.min(mean))


def _nearest_covariance(relative: FloatArray, error: float) -> tuple[FloatArray, float]:
    """Return the nearest positive semi-definite matrix (Higham 1988), and how far below zero it was, relatively."""
    values, vectors = np.linalg.eigh(relative)
    if values[0] < -error * len(relative):
        raise NotPositiveDefiniteError(
            f"The covariance by theory has the eigenvalue {values[0]:g}, more below zero than its error {error:g} "
            "allows; ask for a smaller tolerance.",
            smallest_eigenvalue=float(values[0]),
        )
    kept = np.maximum(values, 0.0)
    nearest = (vectors * kept) @ vectors.T
    return 0.5 * (nearest + nearest.T), float(max(-values[0], 0.0) / values[-1])
