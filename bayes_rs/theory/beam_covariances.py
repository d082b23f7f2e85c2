"""What theory expects of the variances of beams and the correlations between them, and how these scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES, pack_stress
from bayes_rs.theory.lag_nodes import LagNodes, lag_nodes
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.turbulence.mann import MannTurbulence
from bayes_rs.turbulence.toeplitz import toeplitz_gram, toeplitz_trace
from bayes_rs.turbulence.two_point import INDEX_PAIRS, velocity_covariance

COHERENCE = ("length_scale", "lateral_scale", "vertical_scale", "gamma")
"""What the coherence between two beams depends on: the size of the eddies, their extent along y and along z, and Γ.

With another Γ the spectra of the same records tell another length scale, which moves with it here."""
_STEP = 0.1  # of the logarithm of a scale or of Γ, for the slopes of the data
_ACROSS = {"lateral_scale": (1.0, 0.0), "vertical_scale": (0.0, 1.0)}  # what it stretches, along y and along z
_FLOW = {"length_scale": (1.0, 0.0), "gamma": (-1.5, 1.0)}  # of ln L and ln Γ: L is what the spectrum of u tells
_TOLERANCE = 1e-3  # of uu: a hundredth of the scatter of a correlation
_GROWTH = 0.25  # of the distances of lags that are calculated; the others lie between


@dataclass(frozen=True, eq=False)
class Views:
    """What is measured, and where: the velocity component that each of some instruments or beams sees.

    Parameters
    ----------
    direction : ndarray, shape (n, 3)
        Unit vectors of the components, and of the probe volumes, in the mean-wind frame.
    place : ndarray, shape (n, 3)
        Where the velocity is measured, in the same frame, m.
    time : ndarray, shape (n,)
        When the first sample is taken, s.
    length : ndarray, shape (n,)
        `Probe.length`, m; 0 for a point.
    probe : Probe
        Kind of the probe volumes.
    interval : float
        Time between two samples, the same for all, s.
    """

    direction: FloatArray
    place: FloatArray
    time: FloatArray
    length: FloatArray
    probe: Probe
    interval: float

    @classmethod
    def of_scan(cls, scan: Scan, yaw: float) -> Views:
        """Return those of a scan's beams in wind from a direction, rad."""
        direction = scan.at_yaw(yaw)
        return cls(
            direction,
            direction * scan.focus_distance[:, np.newaxis],
            scan.beam_time,
            np.broadcast_to(scan.probe_length, scan.beam_time.shape),
            scan.probe,
            scan.scan_duration,
        )

    def with_mast(self, position: FloatArray) -> Views:
        """Return these and u, v and w at a point, shape (3,), m in the mean-wind frame, sampled once a scan."""
        axes = np.eye(3)
        return replace(
            self,
            direction=np.concatenate([self.direction, axes]),
            place=np.concatenate([self.place, np.broadcast_to(position, (3, 3))]),
            time=np.concatenate([self.time, np.zeros(3)]),
            length=np.concatenate([self.length, np.zeros(3)]),
        )

    def as_points(self) -> Views:
        """Return the same without probe volumes."""
        return replace(self, length=np.zeros(len(self)), probe=PointProbe())

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.direction)


class CovarianceMoments(NamedTuple):
    """Moments of a record's data: ln y of each view, and the artanh of the correlation of each pair of them.

    Attributes
    ----------
    tensor : ndarray, shape (n_datum, 6)
        Expected covariances uu, vv, ww, uv, uw, vw between the places and times of two views' samples, the means of the
        record removed, m² s⁻²: first of each view with itself, then of each pair (`view_pairs`).
    record : ndarray, shape (6,)
        The same of one point with itself: the expected stresses of a record.
    ensemble : ndarray, shape (6,)
        Those of an infinite record.
    covariance : ndarray, shape (n_datum, n_datum)
        Covariance of the data.
    bias : ndarray, shape (n_datum,)
        By how much the mean of ln y differs from ln E[y], and that of z from the artanh of the expected covariance over
        the root of the expected variances.
    """

    tensor: FloatArray
    record: FloatArray
    ensemble: FloatArray
    covariance: FloatArray
    bias: FloatArray


def view_pairs(n_view: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first and second view of each datum: every view with itself, then all pairs, row by row.

    Examples
    --------
    >>> [of.tolist() for of in view_pairs(3)]
    [[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    """
    first, second = np.triu_indices(n_view, 1)
    own = np.arange(n_view)
    return np.concatenate([own, first]), np.concatenate([own, second])


def covariance_moments(
    views: Views, turbulence: MannTurbulence, *, wind_speed: float, n_sample: int, tolerance: float = _TOLERANCE
) -> CovarianceMoments:
    r"""Return the moments of a record's variances and correlations in Gaussian, frozen Mann turbulence.

    Parameters
    ----------
    views : Views
        What is measured; a dozen beams take a second.
    turbulence : MannTurbulence
        The turbulence; its dissipation only scales `tensor` and `record`.
    wind_speed : float
        Mean wind speed U, m/s.
    n_sample : int
        Samples N of each view in a record.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.

    Returns
    -------
    moments : CovarianceMoments
        See there.

    Notes
    -----
    A scan samples its beams one after the other. The i-th samples of beams a and b are apart by their places, and by
    the time from one beam to the other, which is a separation :math:`-U (t_b - t_a)` along the wind; nothing is
    interpolated. With the matrix :math:`C_{ab}` of the covariances between all samples of a and b, and P, which takes
    the mean of the record away,

    .. math::
        \mathrm E\, y_{ab} = \mathrm{tr}(P C_{ab} P) / N, \qquad
        \mathrm{Cov}[y_{ab}, y_{cd}] = \big( \langle P C_{ac} P, P C_{bd} P \rangle
        + \langle P C_{ad} P, P C_{bc} P \rangle \big) / N^2

    by Isserlis' theorem, exact for the finite record. The moments of :math:`\ln y_{aa}` and of Fisher's
    :math:`z_{ab} = \mathrm{artanh}(y_{ab} / \sqrt{y_{aa} y_{bb}})` follow to first order, but for the variance of
    :math:`\ln y_{aa}`, which is ln(1 + K). Of independent samples z has the variance 1/(N − 3), whatever the
    correlation is; hence z is the datum, and its scatter is taken to be that of the model for all stresses.

    References
    ----------
    Fisher (1921), Metron 1, 3–32. Isserlis (1918), Biometrika 12, 134–139, doi:10.1093/biomet/12.1-2.134.
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886, Eq. (2.4).

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> views = Views.of_scan(load_scan("2-beam"), 0.0)
    >>> moments = covariance_moments(views, load_turbulence("fu-2022"), wind_speed=10.0, n_sample=600)
    >>> np.sqrt(moments.covariance.diagonal()).round(1)
    array([0.2, 0.2, 0.2])
    """
    setting = _Setting(views, wind_speed, n_sample, tolerance)
    lines = setting.lines(turbulence)
    tensor = lines @ setting.nodes.trace / n_sample
    record = setting.at_a_point(turbulence)
    covariance, bias = _data_moments(views, lines @ setting.nodes.weights, n_sample)
    return CovarianceMoments(tensor, record, turbulence.stresses(), covariance, bias)


def coherence_slopes(
    views: Views, turbulence: MannTurbulence, *, wind_speed: float, n_sample: int, tolerance: float = _TOLERANCE
) -> FloatArray:
    """Return by how much the means of a record's data change with the logarithms of `COHERENCE`, the stresses the same.

    Parameters
    ----------
    views, turbulence, wind_speed, n_sample, tolerance
        As for `covariance_moments`.

    Returns
    -------
    slope : ndarray, shape (n_datum, 4)
        Forward differences over 0.1. With Γ the length scale goes as Γ^(−3/2), so that the spectrum of u stays where it
        is. They are those of points: a probe volume changes the data, but hardly by how much they change with a scale.
    """
    setting = _Setting(views.as_points(), wind_speed, n_sample, tolerance)
    trace = setting.nodes.trace / n_sample
    record = setting.at_a_point(turbulence)
    here = _means(views, setting.lines(turbulence) @ trace, record)
    slope = np.empty((len(here), len(COHERENCE)))
    for column, name in enumerate(COHERENCE):
        if name in _ACROSS:  # eddies that reach farther across are beams that are closer
            moved, own = setting.lines(turbulence, np.exp(-_STEP * np.array(_ACROSS[name]))), record
        else:
            by_length, by_gamma = np.exp(_STEP * np.array(_FLOW[name]))
            flow = replace(
                turbulence, length_scale=turbulence.length_scale * by_length, gamma=turbulence.gamma * by_gamma
            )
            moved, own = setting.lines(flow), setting.at_a_point(flow)
        slope[:, column] = (_means(views, moved @ trace, own) - here) / _STEP
    return slope


class _Setting:
    """Whose covariances are calculated, at which lags."""

    def __init__(self, views: Views, wind_speed: float, n_sample: int, tolerance: float) -> None:
        self.views, self.wind_speed, self.n_sample, self.tolerance = views, wind_speed, n_sample, tolerance
        self.first, self.second = view_pairs(len(views))
        parcel = views.place.copy()
        parcel[:, 0] -= wind_speed * views.time
        self.apart = parcel[self.second] - parcel[self.first]
        self.step = wind_speed * views.interval
        centre = self.apart[:, 0] / self.step
        centres = float(np.floor(np.min(centre))), float(np.ceil(np.max(centre)))
        self.nodes = _nodes(n_sample, centres)

    def lines(self, turbulence: MannTurbulence, extent: FloatArray | float = 1.0) -> FloatArray:
        """Return the covariances of components at the nodes of the lags, shape (n_datum, 6, n_node), m² s⁻²."""
        views, first, second = self.views, self.first, self.second
        rows = np.repeat(np.arange(len(first)), len(STRESSES))
        axes, pair = np.eye(3), np.tile(np.array(INDEX_PAIRS), (len(first), 1))
        found = probed_covariance(
            views.direction[first[rows]],
            views.direction[second[rows]],
            self.apart[rows, 1:] * extent,
            self.apart[rows, :1] - self.step * self.nodes.lag,
            turbulence,
            probe=views.probe,
            lengths=np.stack([views.length[first[rows]], views.length[second[rows]]], axis=-1),
            tolerance=self.tolerance,
            components=(axes[pair[:, 0]], axes[pair[:, 1]]),
        )
        return found.reshape(len(first), len(STRESSES), -1)

    def at_a_point(self, turbulence: MannTurbulence) -> FloatArray:
        """Return the expected stresses of a record at one point, shape (6,), m² s⁻²."""
        nodes = _nodes(self.n_sample, (0.0, 0.0))
        apart = np.zeros((len(nodes.lag), 3))
        apart[:, 0] = self.step * nodes.lag
        covariance = pack_stress(velocity_covariance(apart, turbulence, tolerance=self.tolerance))
        return np.asarray(nodes.trace @ covariance / self.n_sample)


@lru_cache(maxsize=256)
def _nodes(n_sample: int, centres: tuple[float, float]) -> LagNodes:
    return lag_nodes(n_sample, n_sample, centres, _GROWTH, detrend="mean")


def component_weights(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return what a symmetric tensor's six numbers are multiplied by for n_a · C n_b, shape (..., 6)."""
    return np.stack(
        [first[..., i] * second[..., j] + (first[..., j] * second[..., i] if i != j else 0.0) for i, j in INDEX_PAIRS],
        axis=-1,
    )


def _means(views: Views, tensor: FloatArray, record: FloatArray) -> FloatArray:
    """Return ln of the variances over those of a point, and artanh of the correlations, shape (n_datum,)."""
    n_view = len(views)
    first, second = view_pairs(n_view)
    weights = component_weights(views.direction[first], views.direction[second])
    expected = np.sum(weights * tensor, axis=-1)
    own = expected[:n_view]
    correlation = expected[n_view:] / np.sqrt(own[first[n_view:]] * own[second[n_view:]])
    return np.concatenate([np.log(own / (weights[:n_view] @ record)), np.arctanh(correlation)])


def _data_moments(views: Views, lines: FloatArray, n_sample: int) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of ln y and z, shape (n_datum, n_datum), and their bias, shape (n_datum,)."""
    n_view = len(views)
    first, second = view_pairs(n_view)
    weights = component_weights(views.direction[first], views.direction[second])
    radial = np.einsum("di,dil->dl", weights, lines)
    whole = np.empty((n_view, n_view, radial.shape[-1]))
    whole[second, first], whole[first, second] = radial[:, ::-1], radial
    gram = toeplitz_gram(whole.reshape(n_view**2, -1), n_sample, n_sample).reshape((n_view,) * 4)
    a, b = first[:, np.newaxis], second[:, np.newaxis]
    product = (gram[a, first, b, second] + gram[a, second, b, first]) / n_sample**2
    mean = toeplitz_trace(radial, n_sample) / n_sample
    size = np.sqrt(mean[first] * mean[second])
    relative = product / np.outer(size, size)
    pair, of_a, of_b = np.arange(n_view, len(first)), first[n_view:], second[n_view:]
    rho = (mean / size)[n_view:]
    open_ = 1.0 - rho**2
    jacobian = np.eye(len(first))
    jacobian[pair, pair] = 1.0 / open_
    jacobian[pair, of_a] = jacobian[pair, of_b] = -0.5 * rho / open_
    own = relative.diagonal()[:n_view]
    jacobian[np.arange(n_view), np.arange(n_view)] = np.sqrt(np.log1p(own) / own)
    covariance = jacobian @ relative @ jacobian.T
    # the second-order terms of r = q_ab / sqrt(q_aa q_bb), and of artanh r
    of_ratio = rho * (0.375 * (own[of_a] + own[of_b]) + 0.25 * relative[of_a, of_b])
    of_ratio -= 0.5 * (relative[pair, of_a] + relative[pair, of_b])
    spread = np.zeros((len(pair), len(first)))
    spread[np.arange(len(pair)), pair] = 1.0
    spread[np.arange(len(pair)), of_a] = spread[np.arange(len(pair)), of_b] = -0.5 * rho
    of_correlation = np.sum((spread @ relative) * spread, axis=-1)
    bias = np.concatenate([-0.5 * np.log1p(own), of_ratio / open_ + rho * of_correlation / open_**2])
    return 0.5 * (covariance + covariance.T), bias
