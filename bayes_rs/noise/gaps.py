"""The noise of records with missing samples, by theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.theory.kept_lines import kept_covariance
from bayes_rs.theory.lag_nodes import lag_nodes
from bayes_rs.theory.pairs import FEW
from bayes_rs.theory.probed import shortest_length
from bayes_rs.theory.sampling_times import samples_removed, samples_that_fit
from bayes_rs.turbulence.interpolation import nearest_semidefinite
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.toeplitz import gapped_inner, gapped_trace

_GROWTH = 0.15  # of the lags' distances (`lag_nodes`), for many beams: sums are good to 2e-5
_CHUNK = 500_000  # covariances held at a time: some 100 MiB of working arrays


def gap_noise(
    scan: Scan,
    turbulence: MannTurbulence,
    present: ArrayLike,
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw: float | None = None,
    detrend: str = "mean",
    tolerance: float = 1e-4,
) -> Noise:
    """Return the noise of a record's beam variances when samples are missing, by theory.

    Parameters
    ----------
    scan : Scan
        The scan, with its timing.
    turbulence : MannTurbulence
        The turbulence; its dissipation has no influence.
    present : array_like of bool, shape (n_beam, n_sample)
        Which samples there are: entry i of beam b is the one at beam_time_b + i · scan_duration. n_sample is the number
        of scans that begin in the record; what would be measured after its end does not count.
    wind_speed : float
        Mean wind speed U, m/s.
    duration : float
        Length of the record T, s.
    yaw : float, optional
        Wind direction relative to the lidar axis ψ, rad; the mounting's own if not given.
    detrend : str
        ``"mean"`` or ``"linear"``: what is removed from the samples that there are.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    noise : Noise
        Bias, gain and relative covariance. Its details are those of `theory_noise`, with ``samples``, the least and the
        largest number of samples of a beam, and ``gap_gain``, the smallest and the largest E s² of a beam relative to
        the record without gaps.

    Raises
    ------
    InputError
        If the shape is wrong, or a beam has too few samples.

    Notes
    -----
    As `theory_noise`, with C_ab the covariances between the samples that there are, and P the projection on what is
    left when their mean or line is removed:

        E s_b² = tr(P_b C_bb P_b) / N_b,     Cov[s_a², s_b²] = 2 ‖P_a C_ab P_b‖²_F / (N_a N_b).

    The stresses of a record stay those of the whole record. A beam with gaps expects another variance, since it loses
    other slow eddies with its mean; so its row of the gain is that of `theory_noise` times the ratio of the two E s_b²,
    and the bias is that of the record without gaps.

    C_ab is some rows and columns of a Toeplitz matrix, and `gapped_inner` sums it in N log N; all pairs of beams are
    done. Of 40 pairs and more, covariances are calculated at lags whose distances grow, and interpolated. That gaps may
    depend on the velocity (hard targets in gusts) is left out.

    Examples
    --------
    Every second sample of a beam tells nearly as much as all of them, half of the record does not:

    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> scan, flow = load_scan("staring"), load_turbulence("fu-2022")
    >>> every, second, half = [[True] * 600], [[True, False] * 300], [[True] * 300 + [False] * 300]
    >>> [float(gap_noise(scan, flow, p, wind_speed=10.0).relative_error[0, 0].round(3)) for p in (every, second, half)]
    [0.258, 0.259, 0.334]
    """
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    there = _present(scan, present, duration, detrend)
    whole = theory_noise(
        scan, turbulence, wind_speed=wind_speed, duration=duration, yaw=yaw, detrend=detrend, tolerance=tolerance
    )
    line_of_sight = scan.at_yaw(float(whole.yaw[0]))
    lengths = np.zeros(scan.n_beam) if whole.details.get("probe_as_points") else scan.probe_length
    count, n = np.count_nonzero(there, axis=1), there.shape[1]
    place = line_of_sight * scan.focus_distance[:, np.newaxis]
    place[:, 0] -= wind_speed * scan.beam_time
    row, column = np.triu_indices(scan.n_beam)
    apart = place[column] - place[row]
    lag = wind_speed * scan.scan_duration * np.arange(-(n - 1), n)
    centre = apart[:, 0] / (wind_speed * scan.scan_duration)
    growth = _GROWTH if len(row) >= FEW else 0.0
    nodes = lag_nodes(n, n, (float(np.min(centre)), float(np.max(centre))), growth, detrend=detrend)
    inner, trace = np.empty(len(row)), np.full(scan.n_beam, np.nan)
    for part in np.array_split(np.arange(len(row)), int(np.ceil(len(row) * len(lag) / _CHUNK))):
        first, second = row[part], column[part]
        covariance = kept_covariance(
            line_of_sight[first],
            line_of_sight[second],
            apart[part, 1:],
            apart[part, :1] - lag[nodes.lag + n - 1],
            turbulence,
            probe=scan.probe,
            lengths=np.stack([lengths[first], lengths[second]], axis=-1),
            shortest=shortest_length(lengths),
            tolerance=tolerance,
        )
        if len(nodes.lag) < len(lag):
            covariance = covariance @ nodes.weights
        inner[part] = gapped_inner(covariance, there[first], there[second], detrend=detrend)
        own = first == second
        trace[first[own]] = gapped_trace(covariance[own], there[first[own]], detrend=detrend)
    mean = trace / count
    relative = np.empty((scan.n_beam, scan.n_beam))
    relative[row, column] = 2.0 * inner / (count[row] * count[column] * mean[row] * mean[column])
    relative[column, row] = relative[row, column]
    nearest, negative_part = nearest_semidefinite(relative[np.newaxis])
    ratio = mean / ((1.0 + whole.bias[0]) * (whole.gain[0] @ turbulence.stresses()))
    details = {
        "samples": [int(np.min(count)), int(np.max(count))],
        "gap_gain": [float(np.min(ratio)), float(np.max(ratio))],
        "negative_part": float(negative_part[0]),
    }
    return replace(
        whole,
        gain=whole.gain * ratio[:, np.newaxis],
        covariance=nearest,
        details={**whole.details, **details},
    )


def _present(scan: Scan, present: ArrayLike, duration: float, detrend: str) -> NDArray[np.bool_]:
    """Check which samples there are, and take out those after the record's end."""
    removed = samples_removed(detrend)
    fits = samples_that_fit(duration - scan.beam_time, scan.scan_duration)
    n_sample = max(int(samples_that_fit(duration, scan.scan_duration)), 1)
    given = np.asarray(present)
    if given.dtype != np.bool_ or given.shape != (scan.n_beam, n_sample):
        raise InputError(
            f"Invalid present of shape {given.shape} and type {given.dtype} for scan {scan.name!r}: it must be of "
            f"bools, ({scan.n_beam}, {n_sample}), one for each beam and each scan that begins in {duration:g} s."
        )
    there = given & (np.arange(n_sample) < fits[:, np.newaxis])
    for index in np.flatnonzero(np.count_nonzero(there, axis=1) <= removed):
        raise InputError(
            f"Invalid present for scan {scan.name!r}: beam {scan.beam[index]} has {np.count_nonzero(there[index])} "
            f"samples, and removing the {detrend} leaves nothing of fewer than {removed + 1}; leave the beam out."
        )
    return there
