"""Covariances of the velocities that beams with probe volumes see, and what such a volume leaves of the stresses."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import Probe, Rule, fineness_for, needs_wide
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.stencil import STENCIL, interpolate_rows
from bayes_rs.turbulence.two_point import INDEX_PAIRS, radial_covariance, velocity_covariance

CHUNK = 1_500_000
"""Covariances held at a time: some 100 MiB of working arrays."""
_PARALLEL = 1e-6  # beams at a smaller angle (rad) look along one line
CORE = 0.01
"""Of L: separations below are interpolated as evenly as at it."""
_CORE_OF_PROBE = 0.1  # the same of the probe, added to it
_FARTHEST = 300.0  # L: nodes of a probe farther out are left out, which changes K by 2e-5 of an entry at most
LAG_STEP = 0.3
"""Step of the separations at which covariances of probed beams are calculated, in asinh(separation / core)."""

Rules = Literal["full", "half", "coarse"]


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
    components: tuple[FloatArray, FloatArray] | None = None,
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
    components : tuple of two ndarray, shape (n, 3), optional
        Unit vectors of the velocity components to take in place of those along the beams: what the beams' probe volumes
        would leave of these.

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
        of = (first, second) if components is None else components
        return radial_covariance(*of, across, along, turbulence, tolerance=tolerance)
    core = grid_core(shortest_length(lengths), turbulence)
    half = int(np.ceil(np.arcsinh(np.max(np.abs(along)) / core) / LAG_STEP)) + STENCIL // 2
    if 2 * half + 1 >= along.shape[1]:
        return by_rules(first, second, across, along, turbulence, probe, lengths, tolerance, components=components)
    grid = core * np.sinh(LAG_STEP * np.arange(-half, half + 1))
    everywhere = np.broadcast_to(grid, (len(along), len(grid)))
    lines = by_rules(first, second, across, everywhere, turbulence, probe, lengths, tolerance, components=components)
    return interpolate_rows(lines, np.arcsinh(along / core) / LAG_STEP + half)


def shortest_length(lengths: FloatArray) -> float:
    """Return the shortest of some probe volumes, m, points left out; 0 if all are points.

    Parameters
    ----------
    lengths : ndarray
        `Probe.length` of the beams, m.

    Returns
    -------
    shortest : float
        In metres.
    """
    return float(np.min(lengths[lengths > 0.0], initial=np.inf)) if np.any(lengths > 0.0) else 0.0


def grid_core(shortest: float, turbulence: MannTurbulence) -> float:
    """Return the separation below which those of the grid along the wind are even.

    Parameters
    ----------
    shortest : float
        The shortest probe volume, m.
    turbulence : MannTurbulence
        The turbulence.

    Returns
    -------
    core : float
        In metres.
    """
    return CORE * turbulence.length_scale + _CORE_OF_PROBE * shortest


def by_rules(
    first: FloatArray,
    second: FloatArray,
    across: FloatArray,
    along: FloatArray,
    turbulence: MannTurbulence,
    probe: Probe,
    lengths: FloatArray,
    tolerance: float,
    *,
    shortest: float | None = None,
    rules: Rules = "full",
    components: tuple[FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """Return the covariances of beams with probe volumes by the rules of their kinds of pairs.

    Parameters
    ----------
    first, second, across, along, turbulence, probe, lengths, tolerance, components
        As for `probed_covariance`; each separation is calculated.
    shortest : float, optional
        The shortest probe volume that decides which far nodes are left out, m; by default that of each kind of pairs.
    rules : str
        ``"half"`` takes rules that are half as fine, and ``"coarse"`` those which take the mean of the two positions
        for one that fits it, too: their results are only like those of the others.

    Returns
    -------
    covariance : ndarray, shape (n, n_lag)
        m² s⁻².
    """
    towards, kinds = _rules(first, second, lengths, turbulence, probe, rules)
    n_lag, out = along.shape[1], np.empty(along.shape)
    of_first, of_second = (first, second) if components is None else components
    for index, full_rule in kinds:
        own = shortest_length(lengths[index]) if shortest is None else shortest
        rule = _within(full_rule, own, turbulence.length_scale)
        even = _is_even(first[index], second[index], across[index], along[index], lengths[index])
        rule = _ahead(rule) if even else rule
        n_node = len(rule.weight)
        for part in np.array_split(index, int(np.ceil(len(index) * n_node * n_lag / CHUNK))):
            a, b = lengths[part, :1] * towards[part], lengths[part, 1:] * second[part]
            shift = rule.difference[:, np.newaxis] * (0.5 * (a + b))[:, np.newaxis]
            shift += rule.mean[:, np.newaxis] * (b - a)[:, np.newaxis]
            covariance = radial_covariance(
                of_first[part],
                of_second[part],
                (across[part, np.newaxis] + shift[..., 1:]).reshape(-1, 2),
                (along[part][:, np.newaxis] + shift[..., :1]).reshape(-1, n_lag),
                turbulence,
                tolerance=tolerance,
            )
            total = np.einsum("q,pql->pl", rule.weight, covariance.reshape(len(part), n_node, n_lag))
            out[part] = total + total[:, ::-1] if even else total
    return out


def _is_even(first: FloatArray, second: FloatArray, across: FloatArray, along: FloatArray, lengths: FloatArray) -> bool:
    """Tell whether pairs are of a beam with itself, and their separations those of both signs."""
    own = np.array_equal(first, second) and not np.any(across) and np.array_equal(lengths[:, 0], lengths[:, 1])
    return bool(own and np.array_equal(along, -along[:, ::-1]))


def _ahead(rule: Rule) -> Rule:
    """Leave out the nodes of a rule that are the others with their signs changed."""
    ahead = rule.difference > 0.0
    return Rule(rule.difference[ahead], rule.mean[ahead], rule.weight[ahead])


def count_nodes(
    first: FloatArray,
    second: FloatArray,
    turbulence: MannTurbulence,
    probe: Probe,
    lengths: FloatArray,
    rules: Rules = "full",
) -> int:
    """Count the pairs of points whose covariances the rules of `by_rules` take for one separation of all pairs.

    Parameters
    ----------
    first, second, turbulence, probe, lengths, rules
        As for `by_rules`.

    Returns
    -------
    count : int
        Far nodes, which may be left out, are counted.
    """
    _, kinds = _rules(first, second, lengths, turbulence, probe, rules)
    return sum(len(index) * len(rule.weight) for index, rule in kinds)


def _rules(
    first: FloatArray,
    second: FloatArray,
    lengths: FloatArray,
    turbulence: MannTurbulence,
    probe: Probe,
    rules: Rules,
) -> tuple[FloatArray, list[tuple[NDArray[np.int64], Rule]]]:
    """Return the first directions turned towards the second ones, and the kinds of pairs with the rule of each."""
    facing = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)  # φ is symmetric
    towards = facing * first
    one = np.min(lengths, axis=-1) <= 0.0
    parallel = ~one & (np.linalg.norm(second - towards, axis=-1) < _PARALLEL)
    wide = ~one & ~parallel & needs_wide(towards, second, lengths, turbulence.length_scale)
    wide &= rules != "coarse"
    fineness = fineness_for(probe, lengths, turbulence.length_scale)
    fineness = fineness if rules == "full" else np.maximum(fineness // 2, 1)
    kinds: list[tuple[NDArray[np.bool_], Rule]] = []
    for fine in np.unique(fineness).tolist():
        position, weight = probe.beam_rule(fineness=2 * fine)
        kinds += [
            (one & (fineness == fine), Rule(2.0 * position, np.zeros_like(position), weight)),
            (parallel & (fineness == fine), probe.difference_rule(fineness=fine)),
            (~one & ~parallel & ~wide & (fineness == fine), probe.pair_rule(fineness=fine)),
            (wide & (fineness == fine), probe.pair_rule(wide=True, fineness=fine)),
        ]
    return towards, [(np.flatnonzero(members), rule) for members, rule in kinds if np.any(members)]


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
    fineness = int(np.max(fineness_for(probe, lengths[:, np.newaxis], turbulence.length_scale)))
    rule = _within(probe.difference_rule(fineness=fineness), shortest_length(lengths), turbulence.length_scale)
    rule = _ahead(rule)  # covariances are even
    shift = (lengths[:, np.newaxis] * rule.difference)[..., np.newaxis] * line_of_sight[:, np.newaxis]
    covariance = velocity_covariance(shift, turbulence, tolerance=tolerance)
    left = np.einsum("q,bqij->bij", 2.0 * rule.weight, covariance)
    filtered = np.stack([left[:, i, j] for i, j in INDEX_PAIRS], axis=-1)
    part = np.clip(filtered[:, :3] / turbulence.stresses()[:3], 0.0, 1.0)  # the error of the covariances only
    return np.stack([np.sqrt(part[:, i] * part[:, j]) for i, j in INDEX_PAIRS], axis=-1), filtered


def _within(rule: Rule, length: float, length_scale: float) -> Rule:
    """Leave out the nodes of a rule that are beyond the reach of the covariance for a probe of `length`, m."""
    near = np.hypot(0.5 * rule.difference, rule.mean) * length < _FARTHEST * length_scale
    return Rule(rule.difference[near], rule.mean[near], rule.weight[near])
