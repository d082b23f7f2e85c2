"""How much less a sum of Whittle likelihoods knows than it claims: beams and estimates that are not independent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.lag_window import fourier_rows, lag_windows, ordinates
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.mann import MannTurbulence

_STEP = 0.05  # of ln L, for the derivative by differences


def information_ratio(
    scan: Scan | str | Path,
    *,
    wind_speed: float,
    yaw: float,
    length_scale: float,
    gamma: float,
    interval: float,
    n_slot: int,
    tapers: int,
    floor: float,
    floor_sd: float,
) -> FloatArray:
    """Return by what the likelihood of `fit_spectra` is to be multiplied, for ln A, ln L and the floor.

    Parameters
    ----------
    scan : Scan
        The beams whose spectra are fitted together.
    wind_speed, yaw : float
        Mean wind speed, m/s, and direction relative to the lidar, rad.
    length_scale, gamma : float
        L, m, and Γ.
    interval : float
        Sampling interval, s.
    n_slot, tapers : int
        Samples of a beam in a record, and tapers.
    floor, floor_sd : float
        The floor and the standard deviation of its prior, over A = αε^(2/3) L^(2/3).

    Returns
    -------
    ratio : ndarray, shape (3,)
        Variance of each estimate as the likelihood claims over what it is: 1 if all estimates were independent. Those
        of ln A and of the floor are at known L.

    Notes
    -----
    For estimates I_k of expectation S_k, with D = ∂ ln S/∂(ln A, ln L, s) and weights w,

        H = Σ w_k D_k D_kᵀ + V⁻¹,   J = Σ_kl w_k w_l D_k D_lᵀ Cov[I_k, I_l] / (S_k S_l) + V⁻¹,

    V⁻¹ the precision of the floor's prior; the claim is H⁻¹, the truth H⁻¹ J H⁻¹ (Huber's sandwich; Varin, Reid and
    Firth 2011). For Gaussian radial velocities the covariance of the estimates of the beams a and b is (Δ² s_k s_l/K²)
    Σ (|w_k* C_ab w_l|² + |w_kᵀ C_ab w_l|²) over the tapers, with C_ab by theory and w of `fourier_rows`: no
    approximation but the linearisation.

    References
    ----------
    Varin, Reid and Firth (2011), Statistica Sinica 21, 5–42.
    """
    scan = as_scan(scan)
    present = np.ones(n_slot, dtype=np.bool_)
    rows, windows = fourier_rows(present, tapers), lag_windows(present, interval, tapers)
    n_taper, n_frequency = rows.shape[:2]
    _, sides = ordinates(n_slot)
    flat = rows.reshape(-1, n_slot)
    line_of_sight = scan.at_yaw(yaw)
    slope, expected = [], []
    scales = length_scale * np.exp(np.linspace(-_STEP, _STEP, 3))
    for b in range(scan.n_beam):
        near = scaled_autocovariance(
            line_of_sight[b],
            wind_speed * interval * np.arange(n_slot, dtype=np.float64),
            scales,
            gamma=gamma,
            probe=scan.probe,
            probe_length=float(scan.probe_length[b]),
        )
        below, signal, above = near @ windows.T
        total = signal + floor * windows[:, 0]
        slope.append(np.stack([signal, (above - below) / (2.0 * _STEP), windows[:, 0]], axis=-1) / total[:, np.newaxis])
        expected.append(total)
    weight = 0.5 * n_taper * sides
    claimed, true = np.zeros((3, 3)), np.zeros((3, 3))
    place = line_of_sight * scan.focus_distance[:, np.newaxis]
    place[:, 0] -= wind_speed * scan.beam_time
    lag = wind_speed * interval * np.arange(-(n_slot - 1), n_slot)
    unit = MannTurbulence(dissipation=length_scale ** (-2.0 / 3.0), length_scale=length_scale, gamma=gamma)
    for a in range(scan.n_beam):
        claimed += (weight[:, np.newaxis] * slope[a]).T @ slope[a]
        for b in range(a, scan.n_beam):
            apart = place[b] - place[a]
            diagonals = probed_covariance(
                line_of_sight[a : a + 1],
                line_of_sight[b : b + 1],
                apart[np.newaxis, 1:],
                apart[0] - lag[np.newaxis],
                unit,
                probe=scan.probe,
                lengths=scan.probe_length[[a, b]][np.newaxis],
            )[0]
            if a == b:
                diagonals[n_slot - 1] += floor
            matrix = scipy.linalg.toeplitz(diagonals[n_slot - 1 :: -1], diagonals[n_slot - 1 :])
            half = flat.conj() @ matrix
            power = np.abs(half @ flat.T) ** 2 + np.abs(half.conj() @ flat.T) ** 2
            mean = power.reshape(n_taper, n_frequency, n_taper, n_frequency).mean(axis=(0, 2))
            relative = interval**2 * np.outer(sides, sides) * mean / np.outer(expected[a], expected[b])
            part = (weight[:, np.newaxis] * slope[a]).T @ relative @ (weight[:, np.newaxis] * slope[b])
            true += part if a == b else part + part.T
    noisy = floor_sd > 0.0
    prior = np.diag([0.0, 0.0, 1.0 / floor_sd**2 if noisy else 0.0])
    ratio = np.ones(3)
    for names, wanted in (([0, 1, 2], [1]), ([0, 2], [0, 2])):
        block = [name for name in names if noisy or name != 2]
        inverse = np.linalg.inv((claimed + prior)[np.ix_(block, block)])
        sandwich = inverse @ (true + prior)[np.ix_(block, block)] @ inverse
        for name in wanted:
            if name in block:
                place_of = block.index(name)
                ratio[name] = inverse[place_of, place_of] / sandwich[place_of, place_of]
    return ratio
