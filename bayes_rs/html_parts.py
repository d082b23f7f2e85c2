"""Small pieces of HTML for notebooks: a card with a few lines and a drawing, drawn by hand as SVG.

Nothing here loads a plotting library. All texts are escaped; lines and letters have the colour of the page around them,
so that cards are legible on light and dark ones.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

DATA = "#0f7fc4"
"""Colour of what the data say, and of positive correlations: told from the next by the colour-blind, too."""
OTHER = "#d9730d"
"""Colour of negative correlations."""
PRIORS = "#8a8a8a"
"""Grey of what is the prior's."""
_MOST_POINTS = 80
"""Points of a drawing; of more every second, third … is drawn."""
_MOST_CELLS = 12
"""Rows of a matrix that is drawn; of more, as many of them at equal steps."""
_DATAS = f'fill="{DATA}" fill-opacity=".45"'
_TEXT = "font-size:11px;fill:currentColor"


def card(title: str, rows: Iterable[tuple[str, str]], picture: str = "") -> str:
    """Return a title, names with their values, and a drawing beside them.

    Parameters
    ----------
    title : str
        What it is.
    rows : iterable of (str, str)
        Names and values.
    picture : str
        HTML of a drawing, from one of the functions of this module.

    Examples
    --------
    >>> "&lt;b&gt;" in card("<b>", [("beams", "6")])
    True
    """
    cells = "".join(
        f'<tr><th style="text-align:left;padding:0 1em 0 0;font-weight:normal;opacity:.75">{escape(name)}</th>'
        f'<td style="text-align:left;padding:0">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start;'
        'font-family:sans-serif;color:inherit">'
        f'<div style="max-width:34em"><strong>{escape(title)}</strong>'
        f'<table style="border:0;background:none;color:inherit;font-size:90%">{cells}</table></div>{picture}</div>'
    )


def some(n: int, most: int = _MOST_POINTS) -> NDArray[np.int64]:
    """Return the numbers of what is drawn of n things: all, or every second, third … of them.

    Examples
    --------
    >>> some(5, most=2).tolist()
    [0, 3]
    """
    return np.arange(0, n, max(1, -(-n // most)), dtype=np.int64)


def beams(across: ArrayLike, up: ArrayLike, names: Sequence[str], what: str) -> str:
    """Return points around a cross, as an observer at the lidar sees them.

    Parameters
    ----------
    across, up : array_like, shape (n,)
        Places to the right and upwards, in one unit.
    names : sequence of str
        Names of the points; written beside them if there are up to twelve.
    what : str
        What it shows, for those who do not see it.
    """
    right, top = np.asarray(across, dtype=np.float64), np.asarray(up, dtype=np.float64)
    scale = 58.0 / max(float(np.abs([right, top]).max()), 1e-9)
    parts = ['<path d="M10 80H150M80 10V150" stroke="currentColor" opacity=".25"/>']
    for index in some(len(right)).tolist():
        x, y = 80.0 + scale * right[index], 80.0 - scale * top[index]
        name = escape(names[index], quote=True)
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{DATA}"><title>{name}</title></circle>')
        if len(right) <= _MOST_CELLS:
            parts.append(f'<text x="{x + 6.0:.1f}" y="{y - 4.0:.1f}" style="{_TEXT}">{name}</text>')
    return _svg(160, 160, "".join(parts), what)


def heat_map(matrix: ArrayLike, names: Sequence[str], what: str) -> str:
    """Return a matrix of numbers from −1 to 1 as squares: the fuller, the farther from 0; blue above it, orange below.

    Parameters
    ----------
    matrix : array_like, shape (n, n)
        The numbers.
    names : sequence of str
        Names of the rows.
    what : str
        What it shows.
    """
    values = np.asarray(matrix, dtype=np.float64)
    shown = some(len(values), _MOST_CELLS).tolist()
    side = min(18.0, 144.0 / len(shown))
    parts = []
    for down, row in enumerate(shown):
        label = f'<text x="20" y="{22.0 + side * (down + 0.5) + 4.0:.1f}" text-anchor="end" style="{_TEXT}">'
        parts.append(f"{label}{escape(names[row])}</text>")
        for across, column in enumerate(shown):
            value = float(values[row, column])
            colour = DATA if value >= 0.0 else OTHER
            x, y = 24.0 + side * across, 22.0 + side * down
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{side - 1.0:.1f}" height="{side - 1.0:.1f}" fill="{colour}" '
                f'fill-opacity="{min(abs(value), 1.0):.2f}"><title>{value:.2f}</title></rect>'
            )
    size = side * len(shown)
    parts.append(f'<rect x="23.5" y="21.5" width="{size:.1f}" height="{size:.1f}" fill="none" stroke="currentColor" ')
    parts.append(f'opacity=".4"/><text x="24" y="14" style="{_TEXT}">{escape(what)}</text>')
    return _svg(max(int(size) + 30, 300), int(size) + 30, "".join(parts), what)


def intervals(
    middle: ArrayLike, low: ArrayLike, high: ArrayLike, priors: ArrayLike, names: Sequence[str], what: str, unit: str
) -> str:
    """Return a row of intervals with their middles; those that are the prior's are hatched grey.

    Parameters
    ----------
    middle, low, high : array_like, shape (n,)
        The numbers; what is NaN is left out.
    priors : array_like of bool, shape (n,)
        Which of them are the prior's more than the data's.
    names : sequence of str
        What each is, for who points at it.
    what, unit : str
        What it shows, and in which unit.
    """
    numbers = [np.asarray(values, dtype=np.float64) for values in (middle, low, high)]
    chosen = some(len(numbers[0]))
    place = chosen[np.all([np.isfinite(values[chosen]) for values in numbers], axis=0)]
    grey = np.asarray(priors, dtype=np.bool_)
    floor, top = (0.0, 1.0) if not len(place) else _range(numbers[1][place], numbers[2][place])
    step = 250.0 / len(chosen) if len(chosen) else 250.0
    wide = min(max(0.7 * step, 1.0), 14.0)
    parts = [f'<text x="2" y="12" style="{_TEXT}">{escape(what)}, {escape(unit)}</text>']
    for value in (floor, top):
        y = _height(value, floor, top)
        parts.append(f'<path d="M44 {y:.1f}H298" stroke="currentColor" opacity=".25"/>')
        parts.append(f'<text x="40" y="{y + 4.0:.1f}" text-anchor="end" style="{_TEXT}">{value:.2g}</text>')
    hatch, pattern = _hatch(what, *numbers)
    parts.append(pattern)
    for index in place.tolist():
        x = 46.0 + step * (np.searchsorted(chosen, index) + 0.5)
        y, y_low, y_high = (_height(values[index], floor, top) for values in numbers)
        fill = hatch if grey[index] else _DATAS
        line = PRIORS if grey[index] else DATA
        parts.append(
            f'<g><title>{escape(names[index])}</title><rect x="{x - 0.5 * wide:.1f}" y="{y_high:.1f}" '
            f'width="{wide:.1f}" height="{max(y_low - y_high, 1.0):.1f}" {fill}/>'
            f'<path d="M{x - 0.5 * wide:.1f} {y:.1f}h{wide:.1f}" stroke="{line}" stroke-width="2"/></g>'
        )
    return _svg(330, 150, "".join(parts), f"{what}, {unit}")


def bars(
    middle: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    names: Sequence[str],
    what: str,
    ends: tuple[float, float],
    *,
    priors: ArrayLike = True,
) -> str:
    """Return lying intervals with their middles on a scale between two ends, beyond which they are cut.

    Parameters
    ----------
    middle, low, high : array_like, shape (n,)
        The numbers.
    names : sequence of str
        What each is, written before it.
    what : str
        What it shows.
    ends : tuple of float
        Of the scale; 0 lies between them.
    priors : array_like of bool, shape (n,), or bool
        Which of them are the prior's more than the data's: they are hatched grey.
    """
    first, last = ends
    grey = np.broadcast_to(np.asarray(priors, dtype=np.bool_), len(names))
    hatch, pattern = _hatch(what, middle, low, high)

    def at(value: float) -> float:
        return 50.0 + 180.0 * (min(max(value, first), last) - first) / (last - first)

    bottom = 24.0 + 20.0 * len(names)
    parts = [pattern, f'<text x="2" y="12" style="{_TEXT}">{escape(what)}</text>']
    for value in (first, 0.0, last):
        parts.append(f'<path d="M{at(value):.1f} 20V{bottom:.1f}" stroke="currentColor" opacity=".3"/>')
        label = f'<text x="{at(value):.1f}" y="{bottom + 12.0:.1f}" text-anchor="middle" style="{_TEXT}">'
        parts.append(f"{label}{value:.2g}</text>")
    for row, name in enumerate(names):
        y = 22.0 + 20.0 * row
        x, x_low, x_high = (at(float(np.asarray(values)[row])) for values in (middle, low, high))
        parts.append(
            f'<text x="44" y="{y + 12.0:.1f}" text-anchor="end" style="{_TEXT}">{escape(name)}</text>'
            f'<rect x="{x_low:.1f}" y="{y + 2.0:.1f}" width="{max(x_high - x_low, 1.0):.1f}" height="12" '
            f"{hatch if grey[row] else _DATAS}/>"
            f'<path d="M{x:.1f} {y + 2.0:.1f}v12" stroke="currentColor" stroke-width="2"/>'
        )
    return _svg(330, int(bottom) + 18, "".join(parts), what)


def _hatch(what: str, *numbers: ArrayLike) -> tuple[str, str]:
    """Return the attributes of what is hatched, and the pattern, whose name no other drawing on the page has."""
    name = f"hatch-{hashlib.sha256(repr((what, *numbers)).encode()).hexdigest()[:8]}"
    pattern = (
        f'<defs><pattern id="{name}" width="4" height="4" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
        f'<path d="M0 0V4" stroke="{PRIORS}" stroke-width="2"/></pattern></defs>'
    )
    return f'fill="url(#{name})" stroke="{PRIORS}" stroke-width=".5"', pattern


def _range(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[float, float]:
    """Return ends of a scale that hold nearly all intervals: one that has no end must not press the others flat."""
    least, most = min(float(np.quantile(low, 0.02)), 0.0), float(np.quantile(high, 0.98))
    return (least, most) if most > least else (least, least + 1.0)


def _height(value: float, floor: float, top: float) -> float:
    share = (min(max(value, floor), top) - floor) / (top - floor)
    return 136.0 - 112.0 * float(share)


def _svg(width: int, height: int, content: str, what: str) -> str:
    label = escape(what, quote=True)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        f'role="img" aria-label="{label}" style="font-family:sans-serif;color:inherit">{content}</svg>'
    )
