"""The noise of a record by theory: mean and covariance of the beam variances of finite records."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_non_negative, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import PROBE_ERROR, PointProbe, Probe, Rule, fineness_for, needs_wide
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES, rotate_stress, unpack_stress
from bayes_rs.noise.model import NoiseModel
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.toeplitz import DETRENDING, toeplitz_inner, toeplitz_trace
from bayes_rs.turbulence.two_point import (
    _STENCIL,
    _stencil_weights,
    radial_covariance,
    resolution_for,
    velocity_covariance,
)

_INDEX_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the two indices of each of the six stresses
_CHUNK = 1_500_000  # covariances held at a time: some 100 MiB of working arrays
_SAME = 1e-9  # pairs whose separations (m) and directions agree to this are computed once
_ROUNDING = 1e-9  # of a sampling interval: whether the last sample is still inside the record
_PARALLEL = 1e-6  # beams at a smaller angle (rad) look along one line
_CORE, _CORE_OF_PROBE = 0.01, 0.1  # of L and of the probe: separations below are interpolated as evenly as at it
_FARTHEST = 50.0  # L: nodes of a probe farther out may be left out, since covariances are below 1 % of uu there ...
_LEAST_WEIGHT = 2e-3  # ... if all of them together weigh less than this
_LAG_STEP = 0.2  # of the separations at which covariances of probed beams are calculated, in asinh(separation / core)


def theory_noise(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw: float | None = None,
    detrend: str = "mean",
    tolerance: float = 1e-4,
    probe_tolerance: float = 1e-3,
    sonic: bool = False,
    sonic_position: ArrayLike = (0.0, 0.0, 0.0),
) -> NoiseModel:
    """Return the noise of a record's beam variances for Gaussian, frozen Mann turbulence, with the scan's probe volume.

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
    probe_tolerance : float
        Beams are taken for points if the probe volume takes no more than this part of any beam's variance.
    sonic : bool
        Add the joint moments with the stresses of a sonic (`sonic_moments`), for the target ``"sonic"``.
    sonic_position : array_like, shape (3,)
        Where the sonic is, m from the lidar in the mean-wind frame; at the lidar, the rotor's centre, if not given.

    Returns
    -------
    noise : NoiseModel
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
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> noise = theory_noise(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0)
    >>> float(noise.bias[0].round(3)), float(noise.relative_error[0].round(3))
    (-0.125, 0.258)
    """
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    promised, resolution = resolution_for(tolerance, turbulence.gamma)
    angle = scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad")
    line_of_sight, geometry = scan.at_yaw(angle), scan.geometry()
    count = sample_counts(scan, duration, detrend)
    scan, about_probe, rows = _apply_probe(scan, line_of_sight, turbulence, tolerance, probe_tolerance)
    pairs = _distinct_pairs(scan, line_of_sight, count, wind_speed)
    inner, trace = np.empty(len(pairs.across)), np.empty(len(pairs.across))
    for samples in np.unique(pairs.samples, axis=0):
        members = np.flatnonzero(np.all(pairs.samples == samples, axis=1))
        n_a, n_b = int(samples[0]), int(samples[1])
        lag = wind_speed * scan.scan_duration * np.arange(-(n_a - 1), n_b)
        for part in np.array_split(members, int(np.ceil(len(members) * len(lag) / _CHUNK))):
            covariance = probed_covariance(
                pairs.first[part],
                pairs.second[part],
                pairs.across[part],
                pairs.along[part, np.newaxis] - lag,
                turbulence,
                probe=scan.probe,
                lengths=pairs.lengths[part],
                tolerance=tolerance,
            )
            inner[part] = toeplitz_inner(covariance, covariance, n_a, n_b, detrend=detrend) / (n_a * n_b)
            own = pairs.own[part]
            if np.any(own):  # then n_a = n_b
                trace[part[own]] = toeplitz_trace(covariance[own], n_a, detrend=detrend) / n_a
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
    if about_probe:
        probe_error = PROBE_ERROR
        if about_probe["probe_as_points"]:  # the loss changes every covariance by that part of a variance, and E twice
            lost = max(about_probe["probe_loss"], 0.0)
            lost_covariance = _covariance_error(relative, mean, lost * float(np.max(expected)))
            probe_error = 2.0 * lost + lost_covariance / float(np.max(relative))
        about_probe["probe_error"] = probe_error
        error += probe_error * float(np.max(relative))
    relative, negative_part = _nearest_covariance(relative, error)
    about_sonic: dict[str, Any] = {}
    sonic_covariance = sonic_beam_covariance = None
    if sonic:
        moments = sonic_moments(
            scan,
            turbulence,
            wind_speed=wind_speed,
            duration=duration,
            yaw=angle,
            position=sonic_position,
            detrend=detrend,
            tolerance=tolerance,
        )
        sonic_covariance, sonic_beam_covariance = whitened_moments(moments, mean)
        about_sonic = {"sonic_position": [float(value) for value in np.asarray(sonic_position)]}
    return NoiseModel(
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
            "samples": [int(np.min(count)), int(np.max(count))],
            "quadrature_step": resolution.step,
            "n_harmonic": resolution.n_harmonic,
            **about_probe,
            **about_sonic,
        },
        sonic_covariance=sonic_covariance,
        sonic_beam_covariance=sonic_beam_covariance,
    )


def probed_covariance(
    first: FloatArray,
    second: FloatArray,
    across: FloatArray,
    along: FloatArray,
    turbulence: MannTurbulence,
    *,
    probe: Probe,
    lengths: FloatArray,
    tolerance: float = 1e-4,
) -> FloatArray:
    """Return the covariances of the radial velocities of pairs of beams with probe volumes; as `radial_covariance`.

    Parameters
    ----------
    first, second : ndarray, shape (n, 3)
        Unit vectors n_a and n_b of the two beams of each pair, in the mean-wind frame.
    across : ndarray, shape (n, 2)
        Separation of the two foci along y and z, m.
    along : ndarray, shape (n, n_lag)
        Separations along x, m.
    turbulence : MannTurbulence
        The turbulence.
    probe : Probe
        The probe volume of both beams.
    lengths : ndarray, shape (n, 2)
        `Probe.length` of the two beams, m; 0 for one that sees a point.
    tolerance : float
        Largest error of a velocity covariance at two points, relative to the variance of u.

    Returns
    -------
    covariance : ndarray, shape (n, n_lag)
        m² s⁻².

    Notes
    -----
    With positions ℓ_b ρ on beam b and ℓ_a σ on beam a, D = ρ − σ and M = (ρ + σ)/2,

        C_ab(Δ) = ∫∫φ(s; f_a) φ(r; f_b) n_a · C(Δ + r n_b − s n_a) n_b ds dr,
        r n_b − s n_a = D (ℓ_a n_a + ℓ_b n_b)/2 + M (ℓ_b n_b − ℓ_a n_a).

    D has the distribution of differences of two positions, which is the autocorrelation of the weighting: for parallel
    beams nothing else counts. For others M matters little, and needs a few nodes at each D (`Probe.pair_rule`). Where
    a record has more lags than that, the covariance is calculated at separations along x that are even in
    asinh(x/core), and interpolated to fifth order: a probed covariance is smooth.

    Examples
    --------
    A Rayleigh length of 6.1 m along the wind leaves 83 % of the variance of u:

    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> from bayes_rs.geometry.probe import ContinuousWaveProbe
    >>> probe, ahead, here = ContinuousWaveProbe(rayleigh_length=6.1), np.array([[-1.0, 0.0, 0.0]]), np.zeros((1, 2))
    >>> seed = load_turbulence("fu-2022")
    >>> left = probed_covariance(ahead, ahead, here, here[:, :1], seed, probe=probe, lengths=np.array([[6.1, 6.1]]))
    >>> float(np.round(left[0, 0] / seed.stresses()[0], 2))
    0.83
    """
    if not np.any(lengths > 0.0):
        return radial_covariance(first, second, across, along, turbulence, tolerance=tolerance)
    facing = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)  # φ is symmetric
    towards = facing * first
    one = np.min(lengths, axis=-1) <= 0.0
    parallel = ~one & (np.linalg.norm(second - towards, axis=-1) < _PARALLEL)
    wide = ~one & ~parallel & needs_wide(towards, second, lengths, turbulence.length_scale)
    fineness = fineness_for(lengths, turbulence.length_scale)
    kinds: list[tuple[NDArray[np.bool_], Rule]] = []
    for fine in np.unique(fineness).tolist():
        position, weight = probe.beam_rule(fineness=2 * fine)
        kinds += [
            (one & (fineness == fine), Rule(2.0 * position, np.zeros_like(position), weight)),
            (parallel & (fineness == fine), probe.difference_rule(fineness=fine)),
            (~one & ~parallel & ~wide & (fineness == fine), probe.pair_rule(fineness=fine)),
            (wide & (fineness == fine), probe.pair_rule(wide=True, fineness=fine)),
        ]
    core = _CORE * turbulence.length_scale + _CORE_OF_PROBE * float(np.min(lengths[lengths > 0.0]))
    half = int(np.ceil(np.arcsinh(np.max(np.abs(along)) / core) / _LAG_STEP)) + _STENCIL // 2
    sparse = 2 * half + 1 < along.shape[1]
    grid = core * np.sinh(_LAG_STEP * np.arange(-half, half + 1))
    out = np.empty(along.shape)
    for members, full_rule in kinds:
        index = np.flatnonzero(members)
        if len(index) == 0:
            continue
        rule = _within(full_rule, lengths[index], turbulence.length_scale)
        n_lag, n_node = len(grid) if sparse else along.shape[1], len(rule.weight)
        for part in np.array_split(index, int(np.ceil(len(index) * n_node * n_lag / _CHUNK))):
            a, b = lengths[part, :1] * towards[part], lengths[part, 1:] * second[part]
            shift = rule.difference[:, np.newaxis] * (0.5 * (a + b))[:, np.newaxis]
            shift += rule.mean[:, np.newaxis] * (b - a)[:, np.newaxis]
            rows = np.repeat(part, n_node)
            x = np.broadcast_to(grid, (len(part), n_lag)) if sparse else along[part]
            covariance = radial_covariance(
                first[rows],
                second[rows],
                (across[part, np.newaxis] + shift[..., 1:]).reshape(-1, 2),
                (x[:, np.newaxis] + shift[..., :1]).reshape(-1, n_lag),
                turbulence,
                tolerance=tolerance,
            )
            summed = np.einsum("q,pql->pl", rule.weight, covariance.reshape(len(part), n_node, n_lag))
            out[part] = _interpolated(summed, np.arcsinh(along[part] / core) / _LAG_STEP + half) if sparse else summed
    return out


def probe_transfer(
    line_of_sight: FloatArray,
    lengths: FloatArray,
    probe: Probe,
    turbulence: MannTurbulence,
    *,
    tolerance: float = 1e-4,
) -> tuple[FloatArray, FloatArray]:
    """Return what a probe volume along each beam leaves of the stresses of the turbulence.

    Parameters
    ----------
    line_of_sight : ndarray, shape (n_beam, 3)
        Unit vectors in the mean-wind frame.
    lengths : ndarray, shape (n_beam,)
        `Probe.length`, m.
    probe : Probe
        The probe volume.
    turbulence : MannTurbulence
        The turbulence.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    transfer : ndarray, shape (n_beam, 6)
        √(G_ii G_jj) for uu, vv, ww, uv, uw, vw, between 0 and 1.
    filtered : ndarray, shape (n_beam, 6)
        F_ij = ∫Φ_ij(k) |H(k·n)|² d³k, m² s⁻²: what is left of each stress.

    Notes
    -----
    G_ii = F_ii / R_ii. Off the diagonal F_ij / R_ij would not do for a gain: probes along inclined beams leave some
    F_ij where R_ij is zero (all three in isotropic turbulence, uv and vw always), since they do not take equal parts of
    the components along and across the beam. √(G_ii G_jj) is continuous there, and keeps what it is applied to
    realizable.

    Examples
    --------
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> from bayes_rs.geometry.probe import ContinuousWaveProbe
    >>> probe = ContinuousWaveProbe(rayleigh_length=6.1)
    >>> ahead = np.array([[-1.0, 0.0, 0.0]])
    >>> probe_transfer(ahead, np.array([6.1]), probe, load_turbulence("fu-2022"))[0].round(2)
    array([[0.83, 0.66, 0.56, 0.74, 0.68, 0.61]])
    """
    fineness = int(np.max(fineness_for(lengths[:, np.newaxis], turbulence.length_scale)))
    rule = probe.difference_rule(fineness=fineness)
    ahead = rule.difference > 0.0  # covariances are even
    shift = (lengths[:, np.newaxis] * rule.difference[ahead])[..., np.newaxis] * line_of_sight[:, np.newaxis]
    covariance = velocity_covariance(shift, turbulence, tolerance=tolerance)
    left = np.einsum("q,bqij->bij", 2.0 * rule.weight[ahead], covariance)
    filtered = np.stack([left[:, i, j] for i, j in _INDEX_PAIRS], axis=-1)
    part = np.clip(filtered[:, :3] / turbulence.stresses()[:3], 0.0, 1.0)  # the error of the covariances only
    return np.stack([np.sqrt(part[:, i] * part[:, j]) for i, j in _INDEX_PAIRS], axis=-1), filtered


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

    The sonic is sampled once a scan, at the scan's beginning, and sees a point; the beams see their probe volumes. Its
    position along the wind counts, since a record of frozen turbulence at another place holds other eddies.

    Examples
    --------
    A beam along the wind that measures where the sonic stands measures the sonic's uu:

    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> from bayes_rs.geometry.scan_file import load_scan
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

    def covariances(vectors: FloatArray, separation: FloatArray, lengths: FloatArray, n_own: int) -> FloatArray:
        """Covariances of radial velocities with u, v and w of the sonic, shape (n_vector, 3, n_lag)."""
        lag = wind_speed * scan.scan_duration * np.arange(-(n_own - 1), n)
        rows = np.repeat(np.arange(len(vectors)), 3)
        flat = probed_covariance(
            vectors[rows],
            np.tile(axes, (len(vectors), 1)),
            separation[rows, 1:],
            separation[rows, :1] - lag,
            turbulence,
            probe=scan.probe,
            lengths=np.stack([lengths[rows], np.zeros(len(rows))], axis=-1),
            tolerance=tolerance,
        )
        return flat.reshape(len(vectors), 3, -1)

    own = covariances(axes, np.zeros((3, 3)), np.zeros(3), n)
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
            with_beam = covariances(line_of_sight[part], apart[part], scan.probe_length[part], int(size))
            for column, (i, j) in enumerate(_INDEX_PAIRS):
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
    lengths: FloatArray  # of the two beams' probe volumes, m
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
    lengths = np.stack([scan.probe_length[row], scan.probe_length[column]], axis=-1)
    own = (row == column)[:, np.newaxis]
    table = np.concatenate([mirror * apart, mirror * first, mirror * second, samples, own, lengths], axis=1)
    _, index, distinct = np.unique(np.round(table / _SAME) + 0.0, axis=0, return_index=True, return_inverse=True)
    return _Pairs(
        row=row,
        column=column,
        distinct=distinct.reshape(-1),
        first=table[index, 3:6],
        second=table[index, 6:9],
        across=table[index, 1:3],
        along=table[index, 0],
        lengths=lengths[index],
        samples=samples[index],
        own=(row == column)[index],
    )


def _apply_probe(
    scan: Scan, line_of_sight: FloatArray, turbulence: MannTurbulence, tolerance: float, probe_tolerance: float
) -> tuple[Scan, dict[str, Any], FloatArray]:
    """Return the scan, what to report of its probe, and gains up to a factor; beams that need no probe see points."""
    check_non_negative(probe_tolerance, what="probe_tolerance", unit="")
    rows = design_matrix(line_of_sight)
    if isinstance(scan.probe, PointProbe):
        return scan, {}, rows
    transfer, filtered = probe_transfer(line_of_sight, scan.probe_length, scan.probe, turbulence, tolerance=tolerance)
    loss = float(np.max(1.0 - np.sum(rows * filtered, axis=-1) / (rows @ turbulence.stresses())))
    about = {"probe": scan.probe.kind, "probe_loss": loss}
    if loss <= probe_tolerance:
        return replace(scan, probe=PointProbe()), {**about, "probe_as_points": True}, rows
    return scan, {**about, "probe_as_points": False}, rows * transfer


def _record_stresses(
    scan: Scan,
    turbulence: MannTurbulence,
    count: NDArray[np.int64],
    wind_speed: float,
    detrend: str,
    tolerance: float,
) -> FloatArray:
    """Return the expected stresses of a record at one point, sampled as each beam is, shape (n_beam, 6), m² s⁻²."""
    axes, pair = np.eye(3), np.array(_INDEX_PAIRS)
    record = np.empty((scan.n_beam, len(STRESSES)))
    for size in np.unique(count).tolist():
        lag = wind_speed * scan.scan_duration * np.arange(-(size - 1), size)
        own = radial_covariance(
            axes[pair[:, 0]],
            axes[pair[:, 1]],
            np.zeros((len(pair), 2)),
            np.broadcast_to(lag, (len(pair), len(lag))),
            turbulence,
            tolerance=tolerance,
        )
        record[count == size] = toeplitz_trace(own, size, detrend=detrend) / size
    return record


def _within(rule: Rule, lengths: FloatArray, length_scale: float) -> Rule:
    """Leave out the nodes of a rule that are beyond the reach of the covariance for all pairs of `lengths`."""
    shortest = float(np.min(np.where(lengths > 0.0, lengths, np.inf)))
    near = 0.5 * np.abs(rule.difference) * shortest < _FARTHEST * length_scale
    if np.sum(rule.weight[~near]) > _LEAST_WEIGHT:
        return rule
    return Rule(rule.difference[near], rule.mean[near], rule.weight[near])


def _interpolated(values: FloatArray, position: FloatArray) -> FloatArray:
    """Return rows of `values` at fractional positions of each row, to fifth order."""
    first, weights = _stencil_weights(position, values.shape[1])
    offset = first + (values.shape[1] * np.arange(len(values)))[:, np.newaxis]
    flat, total = values.ravel(), np.zeros_like(position)
    for point, weight in enumerate(weights):
        total += weight * flat[offset + point]
    return total


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
