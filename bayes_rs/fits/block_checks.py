"""What the parts of records say, beside theory: entered into the records before they are fitted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.fits.block_states import block_states
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.fits.steadiness import Changes, Modulation, find_changes
from bayes_rs.fits.variance_scatter import VarianceScatter, learn_scatter
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.noise import Noise
from bayes_rs.quality.samples import BoolArray
from bayes_rs.turbulence.mann import MannTurbulence

CHANGES = {
    "wind_change": ("m s-1", "clear change of the wind along its mean direction, from the start to the end"),
    "cross_wind_change": ("m s-1", "clear change of the wind across its mean direction, from the start to the end"),
    "change_uu": ("m2 s-2", "what clear changes of the wind add to uu"),
    "change_vv": ("m2 s-2", "what clear changes of the wind add to vv"),
    "change_uv": ("m2 s-2", "what clear changes of the wind add to uv"),
}
"""What records get of their changes: unit and meaning; 0 where none is clear, NaN where nothing was compared."""
_ROUNDED = 5e-3  # depths below are none
_LEVEL = 0.02  # at which unsteady records do not tell how much variances scatter, where no one asks for them


def with_block_checks(
    records: xr.Dataset, scan: Scan, noise: Noise, options: FitOptions, say: Callable[[str], None]
) -> xr.Dataset:
    """Return records that say how much their variances scatter beyond theory, and which of them are unsteady.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    scan : Scan
        The scan that measured them.
    noise : Noise
        Its turbulence is compared with, at the records' own length scales where they have some.
    options : FitOptions
        ``scatter`` and ``unsteady_level`` say what to do.
    say : callable
        Takes lines that tell what was found.

    Returns
    -------
    records : Dataset
        With ``variance_scatter`` and ``variance_scatter_of_beams`` (record), relative variances; ``unsteady`` (record),
        ``unsteady_p_value`` and `CHANGES`. Records without statistics of their parts stay as they are.

    Notes
    -----
    Changes are looked for twice: as in Gaussian air, so that the scatter is learnt from records without any; and then
    against air that is as intermittent as the records say.
    """
    if options.scatter == "theory" and options.unsteady_level == 0.0:
        return records
    states = block_states(records, scan, noise)
    if states is None or not states.compared.any():
        return records
    level = options.unsteady_level if options.unsteady_level > 0.0 else _LEVEL
    changes, more = find_changes(records, states), dict[str, Any]()
    scatter = learn_scatter(records, states, leave_out=np.asarray(changes.clear(level).any(axis=1)))
    if options.scatter == "records":
        more |= _of_scatter(scatter)
        say(_scatter_words(scatter))
    if options.unsteady_level > 0.0:
        if scatter.depth > _ROUNDED:
            modulation = Modulation(float(np.round(scatter.depth, 2)), float(np.round(scatter.time_scale)))
            changes = find_changes(records, states, modulation)
        of_changes = _of_changes(changes, level)
        say(_change_words(of_changes, changes, level))
        more |= of_changes
    return records.assign(more)


def unsteady_records(records: xr.Dataset, scan: Scan, turbulence: MannTurbulence, level: float) -> BoolArray:
    """Return which records change as by a front or a trend, against Gaussian air of their own length scales.

    Parameters
    ----------
    records : Dataset
        From `make_records`, with ``length_scale``.
    scan : Scan
        The scan that measured them.
    turbulence : MannTurbulence
        Has Γ.
    level : float
        Share of steady records that may seem unsteady.

    Returns
    -------
    unsteady : ndarray of bool, shape (n_record,)
        False for records that are not compared.
    """
    states = block_states(records, scan, turbulence)
    if states is None or not states.compared.any():
        return np.zeros(records.sizes["record"], dtype=bool)
    return np.asarray(find_changes(records, states).clear(level).any(axis=1))


def _of_scatter(scatter: VarianceScatter) -> dict[str, Any]:
    words = "relative variance of the variances beyond theory"
    return {
        "variance_scatter": ("record", scatter.common, {"long_name": f"{words}, that all beams share"}),
        "variance_scatter_of_beams": ("record", scatter.own, {"long_name": f"{words}, of each beam by itself"}),
    }


def _of_changes(changes: Changes, level: float) -> dict[str, Any]:
    size, added = changes.size(level), changes.added(level)
    values: list[FloatArray] = [size[:, 0], size[:, 1], added[:, 0], added[:, 1], added[:, 2]]
    p_value = np.full(len(size), np.nan)
    known = np.isfinite(changes.p_value).any(axis=1)
    p_value[known] = np.nanmin(changes.p_value[known], axis=1)
    return {
        "unsteady": (
            "record",
            changes.clear(level).any(axis=1).astype(np.int8),
            {"long_name": "whether the wind changes as by a front or a trend"},
        ),
        "unsteady_p_value": ("record", p_value, {"long_name": "p-value of the clearest change of the wind"}),
        **{
            name: ("record", value, {"units": unit, "long_name": words})
            for (name, (unit, words)), value in zip(CHANGES.items(), values, strict=True)
        },
    }


def _scatter_words(scatter: VarianceScatter) -> str:
    """Say how much the variances scatter beyond theory."""
    if scatter.n_record == 0:
        return "scatter of the variances: that of theory, since no record tells its own"
    middle = np.median(scatter.common + scatter.own)
    return (
        f"scatter of the variances beyond Gaussian air, from the blocks of {scatter.n_record} records: relative "
        f"variance {middle:.2g} (median), time scale {scatter.time_scale:.0f} s, "
        f"{100.0 * scatter.shared:.0f} % of it shared by the beams"
    )


def _change_words(found: dict[str, Any], changes: Changes, level: float) -> str:
    """Say how many records are unsteady, and by how much at most."""
    known = np.isfinite(changes.p_value).any(axis=1)
    unsteady, change, added = (found[name][1] for name in ("unsteady", "wind_change", "change_uu"))
    unsteady = np.flatnonzero(unsteady)
    line = f"steadiness: {len(unsteady)} of {np.count_nonzero(known)} records with a front or a trend"
    line += f" ({100.0 * level:g} % of steady ones are expected to seem so)"
    if len(unsteady) == 0:
        return line
    worst = unsteady[np.argmax(np.abs(change[unsteady]))]
    return (
        f"{line}; largest change of the wind {change[worst]:+.1f} m/s in record {worst}, which "
        f"adds {added[worst]:.2g} m² s⁻² to uu"
    )
