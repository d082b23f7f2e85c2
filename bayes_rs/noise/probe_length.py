"""How the variances of beams change with the length of the probe volume."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.probe import make_probe
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.noise.noise import Noise
from bayes_rs.theory.probed import probe_transfer

_STEP = 0.1
"""Half a step of ln ℓ, for the slope."""
_MOST_LENGTHS = 5
"""Length scales at which the slope is found; between them it is interpolated in ln L."""


def probe_slope(noise: Noise, wind_speed: ArrayLike, yaw: ArrayLike, length_scale: ArrayLike | None) -> FloatArray:
    r"""Return by how much ln E[y] of each beam falls as ln ℓ of its probe volume grows.

    Parameters
    ----------
    noise : Noise
        The noise: its scan, and its turbulence.
    wind_speed, yaw : array_like, shape (n_record,)
        Mean wind speeds, m/s, and wind directions relative to the lidar axis, rad; not finite where unknown.
    length_scale : array_like, shape (n_record,), or None
        Length scales of the records, m; the middle one of the noise where they are None or not finite.

    Returns
    -------
    slope : ndarray, shape (n_record, n_beam)
        :math:`-\partial \ln E[y_b] / \partial \ln \ell`; zero for points.

    Notes
    -----
    The variance of the probed velocity along the beam, :math:`F_b(\ell) = \int n\Phi n\,|H(k \cdot n)|^2 d^3k`, falls
    with ℓ, and what a record loses of it with its mean are eddies so slow that no probe takes of them: so
    :math:`\partial E[y_b] = \partial F_b`. The slope is that of the noise's turbulence, at the median wind of the
    records, over ``2 · 0.1`` in ln ℓ. For a pulse and a gate both are scaled. A record's own shape of R moves it a
    little, which is left out.

    Examples
    --------
    >>> from bayes_rs.noise.by_theory import theory_noise
    >>> noise = theory_noise("zx-tm", wind_speed=10.0)
    >>> float(probe_slope(noise, [10.0], [0.0], None)[0, 0].round(2))  # 10 % longer, 0.6 % less
    0.06
    """
    speed, angle = (np.asarray(values, dtype=np.float64) for values in (wind_speed, yaw))
    geometry = noise.scan_geometry
    known = np.isfinite(speed) & np.isfinite(angle) & (speed > 0.0)
    if not geometry.get("probe") or not known.any():
        return np.zeros((len(speed), noise.n_beam))
    low, high = float(noise.length_scale.min()), float(noise.length_scale.max())
    at = np.geomspace(low, high, _MOST_LENGTHS if high > low else 1)
    middle = float(np.median(speed[known])), float(np.median(angle[known]))
    slope = np.stack([_slope_at(noise, *middle, float(one)) for one in at])
    usual = float(np.median(noise.length_scale))
    own = np.full(len(speed), usual) if length_scale is None else np.asarray(length_scale, dtype=np.float64)
    place = np.log(np.where(np.isfinite(own) & (own > 0.0), own, usual))
    return np.stack([np.interp(place, np.log(at), of_beam) for of_beam in slope.T], axis=-1)


def _slope_at(noise: Noise, wind_speed: float, yaw: float, length_scale: float) -> FloatArray:
    """Return the slope, shape (n_beam,), in one wind and at one length scale."""
    gamma = float(np.median(noise.gamma))
    flow = replace(noise.turbulence, length_scale=length_scale, gamma=gamma)
    geometry = noise.scan_geometry
    probe = make_probe(**geometry["probe"])
    lengths = probe.length(np.asarray(geometry["focus_distance"], dtype=np.float64))
    line_of_sight = np.asarray(geometry["direction"], dtype=np.float64) @ yaw_matrix(np.array(yaw))
    longer, shorter = (
        probe_transfer(line_of_sight, lengths * np.exp(step), probe, flow)[1] for step in (_STEP, -_STEP)
    )
    at = noise.for_records([wind_speed], [yaw], length_scale=[length_scale], gamma=[gamma])
    expected = (1.0 + at.bias[0]) * (at.gain[0] @ flow.stresses())
    rows = design_matrix(line_of_sight)
    return np.asarray(np.sum(rows * (shorter - longer), axis=-1) / (2.0 * _STEP) / expected)
