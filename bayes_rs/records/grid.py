"""Records put on a common grid of windows and beams; what none of them holds is that of a record without a sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def on_grid(
    blocks: Sequence[xr.Dataset],
    empty: xr.Dataset,
    *,
    windows: NDArray[np.int64],
    beams: NDArray[np.int64],
    window: int,
) -> xr.Dataset:
    """Return the records of several blocks on one grid.

    Parameters
    ----------
    blocks : sequence of Dataset
        Records, no window and beam in two of them.
    empty : Dataset
        A record and beam without a sample, as `empty_record` makes it.
    windows : ndarray of int, shape (n_record,)
        Numbers of all windows since 1970, rising.
    beams : ndarray of int, shape (n_beam,)
        Numbers of all beams, in the scan's order.
    window : int
        Length of a record, ns.
    """
    number = [block["time"].values.astype("datetime64[ns]").astype(np.int64) // window for block in blocks]
    rows = [np.searchsorted(windows, of) for of in number]
    order = np.argsort(beams)
    columns = [order[np.searchsorted(beams, block["beam"].values, sorter=order)] for block in blocks]
    cells = [np.ix_(row, column) for row, column in zip(rows, columns, strict=True)]
    held, unsampled = [block.variables for block in blocks], empty.variables
    variables: dict[str, Any] = {}
    for name in blocks[0].data_vars:
        template = held[0][name]
        both = template.dims[:2] == ("record", "beam")
        shape = (len(windows), len(beams), *template.shape[2:]) if both else (len(windows), *template.shape[1:])
        values = np.full(shape, unsampled[name].values.ravel()[0], dtype=template.dtype)
        places: Sequence[Any] = cells if both else rows
        for of, place in zip(held, places, strict=True):
            values[place] = of[name].values
        variables[str(name)] = (template.dims, values, template.attrs)
    start = (windows * window).astype("datetime64[ns]")
    return xr.Dataset(
        variables,
        coords={"time": ("record", start, blocks[0]["time"].attrs), "beam": ("beam", beams)},
        attrs=blocks[0].attrs,
    )
