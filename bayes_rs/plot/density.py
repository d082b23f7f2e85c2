"""Smooth densities of draws, and the levels whose contours hold a stated share of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayes_rs._validation import FloatArray

_Bound = Literal["reflect", "constant"]
LEVELS = (0.68, 0.95)
"""Probability inside the contours of pictures."""
N_GRID = 144
"""Cells of the densities along each axis."""
_MOST_DRAWS = 2000
"""Draws that count for the bandwidth: those of chains are worth fewer than there are."""
_SMOOTHER = 1.25
"""By which factor the bandwidth of pairs exceeds Scott's rule, for outlines that do not tremble."""
_WIDER, _WIDEST = 1.2, 3.0
"""By which factor a bandwidth grows while a contour has islands, and to which multiple at most."""


@dataclass(frozen=True, eq=False)
class Axis:
    """A coordinate on which draws are smoothed: asinh((x − centre)/scale), which long tails do not stretch.

    Parameters
    ----------
    centre, scale : float
        Of the coordinate; of a variance the centre is 0, below which it never is.
    place : ndarray, shape (n,)
        The draws on it.
    spread : float
        Their standard deviation on it; of outliers by the quartiles.
    positive : bool
        Whether it is a variance.
    """

    centre: float
    scale: float
    place: FloatArray
    spread: float
    positive: bool

    @classmethod
    def of(cls, draws: FloatArray, *, positive: bool) -> Axis:
        """Return the coordinate for draws, shape (n,)."""
        low, middle, high = np.quantile(draws, [0.25, 0.5, 0.75])
        centre = 0.0 if positive else float(middle)
        scale = float(middle if positive else high - low) or float(np.ptp(draws)) or 1.0
        place = np.arcsinh((draws - centre) / scale)
        quarters = float(np.arcsinh((high - centre) / scale) - np.arcsinh((low - centre) / scale)) / 1.349
        sd = float(place.std())
        return cls(centre, scale, place, min(sd, quarters) or sd or 1.0, positive)

    def edges(self, width: float, n_grid: int) -> tuple[FloatArray, _Bound]:
        """Return the edges of so many cells for a bandwidth, and how the first edge bounds them."""
        low, high = float(self.place.min()) - 4.0 * width, float(self.place.max()) + 4.0 * width
        bounded = self.positive and low < 0.0
        return np.linspace(0.0 if bounded else low, high, n_grid + 1), "reflect" if bounded else "constant"

    def values(self, place: FloatArray) -> FloatArray:
        """Return x on the coordinate's places."""
        return np.asarray(self.centre + self.scale * np.sinh(place))

    def slope(self, place: FloatArray) -> FloatArray:
        """Return the density of the coordinate's places over x."""
        return np.asarray(1.0 / (self.scale * np.cosh(place)))


def smooth(draws: FloatArray, *, positive: bool, n_grid: int = N_GRID) -> tuple[FloatArray, FloatArray]:
    """Return the smooth density of draws.

    Parameters
    ----------
    draws : ndarray, shape (n,)
        Draws.
    positive : bool
        Whether they are never below zero.
    n_grid : int
        Number of places.

    Returns
    -------
    x, density : ndarray, shape (n_grid,)
        Places and density; its integral is 1.
    """
    axis = Axis.of(draws, positive=positive)
    width = 0.9 * axis.spread * min(len(draws), _MOST_DRAWS) ** -0.2
    edges, bound = axis.edges(width, n_grid)
    count, _ = np.histogram(axis.place, bins=edges)
    step = edges[1] - edges[0]
    density = _filtered(count.astype(np.float64), (width / step,), (bound,)) / (len(draws) * step)
    middle = 0.5 * (edges[1:] + edges[:-1])
    return axis.values(middle), density * axis.slope(middle)


def smooth_pair(
    first: FloatArray,
    second: FloatArray,
    *,
    positive: tuple[bool, bool],
    levels: tuple[float, ...] = LEVELS,
    n_grid: int = N_GRID,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the smooth density of pairs of draws, and its values on the contours that hold shares of them.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
        Draws.
    positive : (bool, bool)
        Which are never below zero.
    levels : tuple of float
        Shares of the draws inside the contours.
    n_grid : int
        Number of cells along each axis.

    Returns
    -------
    x, y : ndarray, shape (n_grid + 2,)
        Places of the first and second.
    density : ndarray, shape (n_grid + 2, n_grid + 2)
        Density at y and x; zero at the ends, so that every contour closes.
    value : ndarray, shape (n_level,)
        Density on the contour of each level.

    Notes
    -----
    A Gaussian kernel on the coordinates of `Axis`, its width `_SMOOTHER` times that of Scott's rule for the spread of
    one coordinate where the other is known; wider, up to three times, while a contour has islands. The region above the
    1 − p quantile of the density at the draws holds the share p of them, whatever the width: it is the estimate of the
    region of highest density by Hyndman (1996), The American Statistician 50, 120–126,
    doi:10.1080/00031305.1996.10474359.
    """
    axes = [Axis.of(draws, positive=bound) for draws, bound in zip((first, second), positive, strict=True)]
    with np.errstate(invalid="ignore", divide="ignore"):  # draws that are all equal
        alone = np.sqrt(max(1.0 - np.nan_to_num(np.corrcoef(axes[0].place, axes[1].place)[0, 1]) ** 2, 0.05))
    factor = _SMOOTHER * alone * min(len(first), _MOST_DRAWS) ** (-1.0 / 6.0)
    widest = _WIDEST * factor
    while True:
        found = _pair_at(axes, factor, levels, n_grid)
        if factor * _WIDER > widest or not _has_islands(found[2], found[3]):
            return found
        factor *= _WIDER


def outlines(
    first: FloatArray, second: FloatArray, *, positive: tuple[bool, bool], n_grid: int = N_GRID
) -> list[list[FloatArray]]:
    """Return the closed lines, each (n_point, 2), around what holds each of `LEVELS` of pairs of draws.

    Parameters
    ----------
    first, second, positive, n_grid
        As for `smooth_pair`.
    """
    import contourpy  # noqa: PLC0415 - only where densities are drawn

    x, y, density, value = smooth_pair(first, second, positive=positive, n_grid=n_grid)
    lines = contourpy.contour_generator(x=x, y=y, z=density)
    return [[np.asarray(line) for line in lines.lines(float(height))] for height in value]


def _pair_at(
    axes: list[Axis], factor: float, levels: tuple[float, ...], n_grid: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what `smooth_pair` returns, for a width of so many spreads."""
    widths = [factor * axis.spread for axis in axes]
    (across, left), (along, below) = (axis.edges(width, n_grid) for axis, width in zip(axes, widths, strict=True))
    count, _, _ = np.histogram2d(axes[1].place, axes[0].place, bins=[along, across])
    steps = [edges[1] - edges[0] for edges in (along, across)]
    sigma = (widths[1] / steps[0], widths[0] / steps[1])
    density = _filtered(count, sigma, (below, left)) / (count.sum() * steps[0] * steps[1])
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (across, along)]
    density = density * axes[0].slope(middles[0]) * axes[1].slope(middles[1])[:, np.newaxis]
    cell = [
        np.clip(((axis.place - edges[0]) / (edges[1] - edges[0])).astype(np.int64), 0, n_grid - 1)
        for axis, edges in zip(axes, (across, along), strict=True)
    ]
    value = np.quantile(density[cell[1], cell[0]], [1.0 - level for level in levels])
    x, y = (axis.values(_padded(places)) for axis, places in zip(axes, middles, strict=True))
    return x, y, np.pad(density, 1), value


def _padded(places: FloatArray) -> FloatArray:
    """Return evenly spaced places with one more at either end."""
    step = places[1] - places[0]
    return np.array([places[0] - step, *places, places[-1] + step])


def _filtered(count: FloatArray, sigma: tuple[float, ...], bounds: tuple[_Bound, ...]) -> FloatArray:
    import scipy  # noqa: PLC0415 - only where densities are drawn

    return np.asarray(scipy.ndimage.gaussian_filter(count, sigma, mode=list(bounds), truncate=5.0))


def _has_islands(density: FloatArray, value: FloatArray) -> bool:
    import scipy  # noqa: PLC0415 - only where densities are drawn

    return any(scipy.ndimage.label(density >= one)[1] > 1 for one in value)
