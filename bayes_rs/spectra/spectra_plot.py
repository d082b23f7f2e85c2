"""The picture of averaged spectra, with their confidence bands and the fitted Mann spectra."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError
from bayes_rs.pictures import OTHER_COLOUR, POSTERIOR_COLOUR, PRIOR_COLOUR, Picture, new_or_given
from bayes_rs.spectra.radial_spectrum import average_spectra, check_spectra

_MEASURED, _FITTED, _NOISE = POSTERIOR_COLOUR, OTHER_COLOUR, PRIOR_COLOUR
_Given = TypeVar("_Given", bound=FigureBase)
_MOST_COLUMNS = 3


def spectra(
    spectra: xr.Dataset,
    fit: xr.Dataset | None = None,
    *,
    bins_per_decade: int = 10,
    prob: float = 0.9,
    max_beams: int = 6,
    figure: _Given | None = None,
) -> _Given | Picture:
    """Draw the spectra of the radial velocities, averaged over records, one panel for each beam.

    Parameters
    ----------
    spectra : xarray.Dataset
        From `radial_spectra`; select records first, ``spectra.isel(record=...)``, to draw some of them.
    fit : xarray.Dataset, optional
        From `fit_spectra` of these spectra.
    bins_per_decade : int
        Bins of a factor of ten in frequency.
    prob : float
        Probability of the confidence band.
    max_beams : int
        Number of panels; of more beams, so many are drawn, evenly chosen.
    figure : Figure or SubFigure, optional
        Where to draw.

    Returns
    -------
    figure : Figure or SubFigure
        What was given, or a new figure. Frequency times spectral density, m² s⁻², against frequency, on logarithmic
        axes: equal heights are equal shares of the variance for equal factors in frequency. The fitted curve is
        averaged over the same records and bins, and is what their finite, sampled, noisy records should show; the
        broken line is the noise in it, where it is above zero. In the title of a panel: the beam, and what the fit
        found, median and 90 % range over the records.

    Raises
    ------
    InputError
        If the spectra are not from `radial_spectra`, or the fit is of other records.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> figure = spectra(brs.spectra.radial_spectra(series, scan, brs.make_records(series, scan)))
    >>> len(figure.axes)
    1
    """
    check_spectra(spectra)
    check_count(max_beams, what="max_beams")
    if fit is not None and (
        "expected" not in fit
        or not np.array_equal(fit["time"].values, spectra["time"].values)
        or not np.array_equal(fit["beam"].values, spectra["beam"].values)
    ):
        raise InputError("The fit is not of these spectra: give that which fit_spectra made of them.")
    averages = average_spectra(spectra, bins_per_decade=bins_per_decade, prob=prob)
    known = np.flatnonzero(averages["n_record"].values > 0)
    if len(known) == 0:
        raise InputError("No record has a spectrum, so there is nothing to draw: check the flags.")
    shown = known[np.unique(np.round(np.linspace(0, len(known) - 1, min(max_beams, len(known)))).astype(int))]
    modelled = None if fit is None else _binned(spectra, fit["expected"].values, bins_per_decade)
    n_column = 2 if len(shown) == 4 else min(_MOST_COLUMNS, len(shown))
    n_row = int(np.ceil(len(shown) / n_column))
    target = new_or_given(figure, (max(4.2 * n_column, 5.6), 3.3 * n_row + 0.9))
    panels = target.subplots(n_row, n_column, sharex=True, sharey=True, squeeze=False)
    for panel, b in zip(panels.ravel(), shown.tolist(), strict=False):
        _draw(panel, averages, b)
        words = f"beam {averages['beam'].values[b]}"
        if fit is not None and modelled is not None:
            _draw_fit(panel, averages, fit, modelled[b], b)
            if "beam" in fit["length_scale"].dims:
                words += f": {_found(fit['length_scale'].values[:, b])}"
        panel.set_title(words, fontsize=10)
        panel.grid(alpha=0.3, which="major")
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_locator(NullLocator())
    seen = [
        averages["low"].values[shown],
        averages["high"].values[shown],
        *([] if modelled is None else [modelled[shown]]),
    ]
    heights = np.concatenate([(part * averages["frequency"].values).ravel() for part in seen])
    # the noise falls without end towards low frequencies: it is cut, the rest is not
    panels[0, 0].set_ylim(0.4 * float(np.nanmin(heights)), 1.15 * float(np.nanmax(heights)))
    for panel in panels.ravel()[len(shown) :]:
        panel.set_visible(False)
    for column in range(n_column):
        lowest = panels[(len(shown) - 1 - column) // n_column, column]
        lowest.set_xlabel("frequency [Hz]")
        lowest.tick_params(labelbottom=True)
    for panel in panels[:, 0]:
        panel.set_ylabel("f S(f) [m² s⁻²]")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_MEASURED, marker="o", markersize=3.5, linewidth=1.2, label="measured"),
        Patch(color=_MEASURED, alpha=0.2, linewidth=0, label=f"{100.0 * prob:g} % confidence"),
    ]
    if fit is not None:
        handles += [
            Line2D([], [], color=_FITTED, linewidth=1.8, label="Mann spectrum, as these records show it"),
            Line2D([], [], color=_NOISE, linewidth=1.2, linestyle="--", label="instrument noise in it"),
        ]
    target.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    count = int(averages["n_record"].values.max())
    head = f"{spectra.attrs.get('scan', '')}: {count} record{'s' * (count > 1)} of {spectra.attrs['duration']:g} s"
    if fit is not None and "beam" not in fit["length_scale"].dims:
        head += f"; {_found(fit['length_scale'].values)}"
    target.suptitle(head, fontsize=11, parse_math=False)
    return target  # type: ignore[return-value] # what was given, or new


def _draw(panel: Axes, averages: xr.Dataset, b: int) -> None:
    """Draw the measured spectrum of a beam, and its band."""
    frequency = averages["frequency"].values
    low, middle, high = (frequency * averages[name].values[b] for name in ("low", "spectrum", "high"))
    panel.fill_between(frequency, low, high, color=_MEASURED, alpha=0.2, linewidth=0)
    panel.plot(frequency, middle, "-o", color=_MEASURED, markersize=3.5, linewidth=1.2)
    panel.set_xscale("log")
    panel.set_yscale("log")


def _draw_fit(panel: Axes, averages: xr.Dataset, fit: xr.Dataset, modelled: np.ndarray, b: int) -> None:
    """Draw the fitted spectrum of a beam, and the noise in it."""
    frequency = averages["frequency"].values
    panel.plot(frequency, frequency * modelled, color=_FITTED, linewidth=1.8)
    noise = fit["instrument_noise"].values
    mean = float(np.nanmean(noise[:, b] if noise.ndim == 2 else noise)) if np.isfinite(noise).any() else 0.0
    if mean > 0.0:
        floor = frequency * 2.0 * mean * float(averages.attrs["interval"])
        panel.plot(frequency, floor, "--", color=_NOISE, linewidth=1.2)


def _binned(spectra: xr.Dataset, expected: np.ndarray, bins_per_decade: int) -> np.ndarray:
    """Return fitted spectra averaged as the measured ones are, shape (n_beam, n_bin)."""
    both = spectra.assign(spectrum=(("record", "beam", "frequency"), expected))
    return np.asarray(average_spectra(both, bins_per_decade=bins_per_decade)["spectrum"].values)


def _found(length_scale: np.ndarray) -> str:
    """Say which length scales were found."""
    known = length_scale[np.isfinite(length_scale)]
    if len(known) == 0:
        return "no fit"
    low, middle, high = np.quantile(known, [0.05, 0.5, 0.95])
    return f"L = {middle:.3g} m" if len(known) == 1 else f"L = {middle:.3g} m ({low:.3g} to {high:.3g})"
