"""Outlines of draws: what holds so much of their probability in two dimensions, and their density in one."""

from __future__ import annotations

import contourpy
import numpy as np
import scipy

from bayes_rs._validation import FloatArray

LEVELS = (0.95, 0.68)
"""Probability inside the outlines."""
_CELLS = 32
_MARGIN = 4  # empty cells about the grid, so that every outline closes
_BANDWIDTH = 1.3
"""In Scott's rule: outlines of 2000 draws are smooth, and wider than those of all draws by less than a line of them."""


def outlines(first: FloatArray, second: FloatArray) -> list[list[FloatArray]]:
    """Return lines around the smallest areas that hold `LEVELS` of pairs of draws.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
        Draws of two numbers.

    Returns
    -------
    lines : list of list of ndarray, shape (n_point, 2)
        For each level its closed lines; none where a number does not vary.

    Notes
    -----
    The density is a histogram, smoothed by a normal kernel of Scott's width along both axes.
    """
    ends = [_ends(values) for values in (first, second)]
    if any(high <= low for low, high in ends):
        return [[] for _ in LEVELS]
    counts, *edges = np.histogram2d(first, second, bins=_CELLS, range=ends)
    padded = np.pad(counts, _MARGIN)
    sigma = [_cells(values, low, high, 1.0 / 6.0) for values, (low, high) in zip((first, second), ends, strict=True)]
    density = scipy.ndimage.gaussian_filter(padded, sigma)
    middles = [_middles(edge) for edge in edges]
    lines = contourpy.contour_generator(x=middles[0], y=middles[1], z=density.T)
    order = np.sort(density.ravel())[::-1]
    held = np.cumsum(order) / order.sum()
    heights = [float(order[min(int(np.searchsorted(held, level)), len(order) - 1)]) for level in LEVELS]
    return [[np.asarray(line) for line in lines.lines(height)] for height in heights]


def density(values: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Return the smoothed density of draws within two ends, 1 at most: places, shape (n,), and heights, shape (n,)."""
    counts, edges = np.histogram(values, bins=_CELLS, range=(low, high))
    smooth = scipy.ndimage.gaussian_filter1d(counts.astype(float), _cells(values, low, high, 1.0 / 5.0), mode="nearest")
    return 0.5 * (edges[1:] + edges[:-1]), smooth / max(float(smooth.max()), 1.0)


def _ends(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.001, 0.999])
    return float(low), float(high)


def _cells(values: FloatArray, low: float, high: float, power: float) -> float:
    """Return the width of the kernel in cells."""
    inner = values[(values >= low) & (values <= high)]
    spread = float(inner.std()) if len(inner) > 1 else 0.0
    return float(_BANDWIDTH * spread / ((high - low) / _CELLS) * max(len(inner), 1) ** -power)


def _middles(edges: FloatArray) -> FloatArray:
    step = edges[1] - edges[0]
    return np.asarray(edges[0] + step * (np.arange(-_MARGIN, _CELLS + _MARGIN) + 0.5))
