"""The noise of a record by theory: mean and covariance of the beam variances of finite records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_finite, check_non_negative, check_positive, check_switch
from bayes_rs.errors import NotPositiveDefiniteError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import PROBE_ERROR, PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.processor import one_thread
from bayes_rs.theory.pair_moments import PAIR_TOLERANCE, pair_moments
from bayes_rs.theory.pairs import distinct_pairs
from bayes_rs.theory.probed import probe_transfer
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.theory.sonic_theory import SonicMoments, sonic_moments, whitened_moments
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence
from bayes_rs.turbulence.toeplitz import toeplitz_trace
from bayes_rs.turbulence.two_point import INDEX_PAIRS, radial_covariance, resolution_for

__all__ = ["SonicMoments", "sonic_moments", "theory", "theory_noise"]


def theory_noise(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path = "fu-2022",
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw: float | None = None,
    detrend: str = "mean",
    tolerance: float = 1e-4,
    probe_tolerance: float = 1e-3,
    pair_tolerance: float = PAIR_TOLERANCE,
    sonic: bool = False,
    sonic_position: ArrayLike = (0.0, 0.0, 0.0),
) -> Noise:
    """Return the noise of a record's beam variances for Gaussian, frozen Mann turbulence, with the scan's probe volume.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, its name or file: beam b is sampled at beam_time_b + i · scan_duration while that is in the record.
    turbulence : MannTurbulence, str or Path
        The turbulence, its name or its file; its dissipation has no influence.
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
    probe_tolerance : float
        Beams are taken for points if the probe volume takes no more than this part of any beam's variance.
    pair_tolerance : float
        Largest relative error of K (Frobenius) that the shortcuts for many beams may make: at 0.003 the width that
        changed most did so by 0.08 % in the median of 80 random states, by 0.81 % at most (docs/noise.md). 0 for no
        shortcut: every pair of beams, with all its lags (`pair_moments`).
    sonic : bool
        Add the joint moments with the stresses of a sonic (`sonic_moments`), for the target ``"sonic"``.
    sonic_position : array_like, shape (3,)
        Where the sonic is, m from the lidar in the mean-wind frame; at the lidar, the rotor's centre, if not given.

    Returns
    -------
    noise : Noise
        Bias, gain and relative covariance. Its details hold ``covariance_error``, a bound on the error of every entry
        of K that follows from `tolerance`, and ``negative_part``: where the true K is singular, the error can leave
        eigenvalues just below zero; they are set to zero, which moves K towards the truth (to the nearest point of
        a convex set that holds it), and this is the size of the lowest of them over the largest eigenvalue. For a scan
        with a probe volume, they also hold ``probe``, ``probe_loss``, the largest part of a beam's variance that it
        takes, ``probe_as_points``, and ``probe_error``, a bound on the error that this leaves in K, relative to its
        largest entry, which is part of ``covariance_error``.

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

    With a probe volume, C_ab is that of the probed velocities, `probed_covariance`. The gain of beam b is its row of
    the design matrix with the factors √(G_ii G_jj), scaled so that gain_b times the model's expected stresses of a
    record, sampled as beam b is, is E s_b²; bias_b = E s_b² / (gain_b · R) − 1. G_ii is the part that the probe along
    n_b leaves of the variance of component i, see `probe_transfer`.

    Examples
    --------
    >>> noise = theory_noise("staring", wind_speed=10.0)
    >>> float(noise.bias[0, 0].round(3)), float(noise.relative_error[0, 0].round(3))
    (-0.125, 0.258)
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    check_switch(sonic, what="sonic")
    promised, resolution = resolution_for(tolerance, turbulence.gamma)
    angle = scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad", quantity="wind_yaw")
    line_of_sight, geometry = scan.at_yaw(angle), scan.geometry()
    count = sample_counts(scan, duration, detrend)
    scan, about_probe, rows = _apply_probe(scan, line_of_sight, turbulence, tolerance, probe_tolerance)
    pairs = distinct_pairs(scan, line_of_sight, count, wind_speed)
    check_non_negative(pair_tolerance, what="pair_tolerance", unit="")
    inner, trace, pair_error, about_pairs = pair_moments(
        pairs,
        scan,
        turbulence,
        wind_speed=wind_speed,
        detrend=detrend,
        tolerance=tolerance,
        design=rows,
        pair_tolerance=pair_tolerance,
    )
    mean = trace[pairs.distinct[pairs.row == pairs.column]]
    gain = rows
    if not isinstance(scan.probe, PointProbe):
        record = _record_stresses(scan, turbulence, count, wind_speed, detrend, tolerance)
        gain = rows * (mean / np.sum(rows * record, axis=-1))[:, np.newaxis]
    expected = gain @ turbulence.stresses()
    relative = np.zeros((scan.n_beam, scan.n_beam))
    relative[pairs.row, pairs.column] = 2.0 * inner[pairs.distinct] / (mean[pairs.row] * mean[pairs.column])
    relative[pairs.column, pairs.row] = relative[pairs.row, pairs.column]
    error = _covariance_error(relative, mean, promised * float(turbulence.stresses()[0]))
    error += pair_error * float(np.max(relative))
    if about_probe:
        about_probe["probe_error"] = _probe_error(about_probe, relative, mean, float(np.max(expected)))
        error += about_probe["probe_error"] * float(np.max(relative))
    relative, negative_part = _nearest_covariance(relative, error)
    about_sonic: dict[str, Any] = {}
    with_sonic: dict[str, Any] = {}
    if sonic:
        about_sonic = {"sonic_position": [float(value) for value in np.asarray(sonic_position)]}
        common: dict[str, Any] = {"wind_speed": wind_speed, "duration": duration, "yaw": angle, "detrend": detrend}
        moments = sonic_moments(scan, turbulence, position=sonic_position, tolerance=tolerance, **common)
        own, across = whitened_moments(moments, mean)
        with_sonic = {"sonic_covariance": own, "sonic_beam_covariance": across}
    return Noise(
        bias=mean / expected - 1.0,
        gain=gain,
        covariance=relative,
        beam=scan.beam,
        scan_name=scan.name,
        scan_geometry=geometry,
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
            **about_pairs,
            "samples": [int(np.min(count)), int(np.max(count))],
            "quadrature_step": resolution.step,
            "n_harmonic": resolution.n_harmonic,
            **about_probe,
            **about_sonic,
        },
        **with_sonic,
    )


def _probe_error(about_probe: Mapping[str, Any], relative: FloatArray, mean: FloatArray, largest: float) -> float:
    """Bound the error that the probe's treatment leaves in K, relative to its largest entry."""
    if not about_probe["probe_as_points"]:
        return PROBE_ERROR
    lost = max(about_probe["probe_loss"], 0.0)  # it changes every covariance by that part of a variance, and E twice
    return float(2.0 * lost + _covariance_error(relative, mean, lost * largest) / float(np.max(relative)))


def _apply_probe(
    scan: Scan, line_of_sight: FloatArray, turbulence: MannTurbulence, tolerance: float, probe_tolerance: float
) -> tuple[Scan, dict[str, Any], FloatArray]:
    """Return the scan, what to report of its probe, and gains up to a factor; beams that need no probe see points."""
    check_non_negative(probe_tolerance, what="probe_tolerance", unit="")
    rows = design_matrix(line_of_sight)
    if isinstance(scan.probe, PointProbe):
        return scan, {}, rows
    flow = (turbulence.dissipation, turbulence.length_scale, turbulence.gamma)
    transfer, filtered = _transfer(line_of_sight.tobytes(), scan.probe_length.tobytes(), scan.probe, flow, tolerance)
    loss = float(np.max(1.0 - np.sum(rows * filtered, axis=-1) / (rows @ turbulence.stresses())))
    about = {"probe": scan.probe.kind, "probe_loss": loss}
    if loss <= probe_tolerance:
        return replace(scan, probe=PointProbe()), {**about, "probe_as_points": True}, rows
    return scan, {**about, "probe_as_points": False}, rows * transfer


@lru_cache(maxsize=16)  # of one direction and flow: they are those of all wind speeds
@one_thread()
def _transfer(
    line_of_sight: bytes, lengths: bytes, probe: Probe, flow: tuple[float, float, float], tolerance: float
) -> tuple[FloatArray, FloatArray]:
    found = probe_transfer(
        np.frombuffer(line_of_sight).reshape(-1, 3), np.frombuffer(lengths), probe, MannTurbulence(*flow),
        tolerance=tolerance,
    )  # fmt: skip
    for part in found:
        part.flags.writeable = False
    return found


def _record_stresses(
    scan: Scan,
    turbulence: MannTurbulence,
    count: NDArray[np.int64],
    wind_speed: float,
    detrend: str,
    tolerance: float,
) -> FloatArray:
    """Return the expected stresses of a record at one point, sampled as each beam is, shape (n_beam, 6), m² s⁻²."""
    record = np.empty((scan.n_beam, len(STRESSES)))
    flow = (turbulence.dissipation, turbulence.length_scale, turbulence.gamma)
    for size in np.unique(count).tolist():
        record[count == size] = _sampled_stresses(flow, size, wind_speed * scan.scan_duration, detrend, tolerance)
    return record


@lru_cache(maxsize=4096)  # they are those of all directions
@one_thread()
def _sampled_stresses(
    flow: tuple[float, float, float], size: int, step: float, detrend: str, tolerance: float
) -> FloatArray:
    axes, pair = np.eye(3), np.array(INDEX_PAIRS)
    own = radial_covariance(
        axes[pair[:, 0]],
        axes[pair[:, 1]],
        np.zeros((len(pair), 2)),
        np.broadcast_to(step * np.arange(-(size - 1), size), (len(pair), 2 * size - 1)),
        MannTurbulence(*flow),
        tolerance=tolerance,
    )
    stresses = np.asarray(toeplitz_trace(own, size, detrend=detrend) / size)
    stresses.flags.writeable = False
    return stresses


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


theory = theory_noise
"""Its name in `bayes_rs.noise`."""
