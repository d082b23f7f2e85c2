"""A group of a NetCDF file in memory: the variables in use, decoded as the CF conventions say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from xarray.conventions import decode_cf_variable

_PACKING = ("scale_factor", "add_offset", "_Unsigned", "dtype")
_FILLS = ("_FillValue", "missing_value")


@dataclass(frozen=True)
class Group:
    """What is in use of a group.

    Parameters
    ----------
    path : str
        Its place in the file; ``/`` is the root.
    names : tuple of str
        The names of all variables in it, and of dimensions without one.
    variables : dict of str to xarray.Variable
        Those in use, if the group holds rays; times are numbers.
    attributes : dict of str to dict
        The attributes of those in use, as they stand in the file.
    attrs : dict
        Some attributes of the group.
    """

    path: str
    names: tuple[str, ...]
    variables: Mapping[str, xr.Variable]
    attributes: Mapping[str, Mapping[str, Any]]
    attrs: Mapping[str, Any]

    @cached_property
    def sizes(self) -> dict[str, int]:
        """The lengths of the dimensions."""
        return {str(dim): size for variable in self.variables.values() for dim, size in variable.sizes.items()}


def decoded(name: str, raw: xr.Variable) -> xr.Variable:
    """Return a variable as `xarray.open_dataset` decodes it without its times.

    Raises
    ------
    ValueError, TypeError
        If its attributes cannot be followed.

    Notes
    -----
    Decoding by xarray takes longer than reading a short file; what has no packing is decoded here. Integers with a fill
    value become doubles, where xarray may take singles: both hold them.
    """
    if raw.dtype.kind in "OU":
        return raw
    fills = [raw.attrs[key] for key in _FILLS if key in raw.attrs]
    plain = raw.dtype.kind in "iuf" and all(isinstance(fill, (np.number, int, float)) for fill in fills)
    if not plain or any(key in raw.attrs for key in _PACKING):
        return decode_cf_variable(name, raw, decode_times=False).load()
    if not fills:
        return xr.Variable(raw.dims, raw.values, raw.attrs, {"dtype": raw.dtype})
    values = raw.values
    missing = np.zeros(values.shape, dtype=bool)
    for fill in fills:
        missing |= values == fill
    if raw.dtype.kind != "f":
        values = values.astype(np.float64)
    if missing.any():
        values = np.where(missing, np.array(np.nan, dtype=values.dtype), values)
    attrs = {key: value for key, value in raw.attrs.items() if key not in _FILLS}
    kept = {key: raw.attrs[key] for key in _FILLS if key in raw.attrs}
    return xr.Variable(raw.dims, values, attrs, {"dtype": raw.dtype, **kept})
