"""Entries of a NetCDF variable that its file itself calls missing, beyond what xarray decodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

_DEFAULT = {
    "i2": -32767,
    "u2": 65535,
    "i4": -2147483647,
    "u4": 4294967295,
    "i8": -9223372036854775806,
    "u8": 18446744073709551614,
}
"""What the library fills variables of integers with that say no value of their own; bytes have none."""
_DEFAULT_FLOAT = 9.969209968386869e36


def without_missing(variable: xr.Variable) -> xr.Variable:
    """Return a decoded variable whose entries that its file calls missing are NaN.

    Parameters
    ----------
    variable : xarray.Variable
        As `xarray.open_dataset` decodes it: ``_FillValue`` and ``missing_value`` are NaN by then.

    Returns
    -------
    variable : xarray.Variable
        The same object if no other entry is missing.

    Notes
    -----
    Missing is what lies outside ``valid_range``, or ``valid_min`` and ``valid_max``; and the default fill value of its
    type, if the variable has no ``_FillValue``. By the NetCDF conventions the limits of a packed variable are packed,
    too, if they are integers. Limits of times that are decoded already are not looked at.

    References
    ----------
    NetCDF Users Guide, Appendix A, "Attribute conventions"; ``netcdf.h`` for the default fill values.
    """
    if variable.dtype.kind not in "iuf" or variable.size == 0:
        return variable
    values = np.asarray(variable.values)
    with np.errstate(invalid="ignore", over="ignore"):
        missing = _is_default_fill(values, variable) | _is_outside(values, variable)
    if not missing.any():
        return variable
    return variable.copy(data=np.where(missing, np.nan, values.astype(np.float64)))


def _is_default_fill(values: NDArray[Any], variable: xr.Variable) -> NDArray[np.bool_]:
    encoding = variable.encoding
    if any(name in encoding or name in variable.attrs for name in ("_FillValue", "missing_value")):
        return np.zeros(values.shape, dtype=bool)
    stored = np.dtype(encoding.get("dtype", values.dtype))
    scale, offset = _packing(variable)
    if stored.kind == "f":
        return np.asarray(np.isclose(values, _DEFAULT_FLOAT * scale, rtol=1e-6, atol=0.0))
    fill = _DEFAULT.get(f"{stored.kind}{stored.itemsize}")
    if fill is None:
        return np.zeros(values.shape, dtype=bool)
    if (scale, offset) == (1.0, 0.0):
        return np.asarray(values == fill)
    return np.asarray(np.abs(values - (fill * scale + offset)) < 0.25 * abs(scale))


def _is_outside(values: NDArray[Any], variable: xr.Variable) -> NDArray[np.bool_]:
    limits = np.ravel(variable.attrs.get("valid_range", []))
    low, high = limits if len(limits) == 2 else (variable.attrs.get("valid_min"), variable.attrs.get("valid_max"))
    scale, offset = _packing(variable)
    is_packed = (scale, offset) != (1.0, 0.0)
    spare = 0.25 * abs(scale) if is_packed else 0.0
    digits = float(np.finfo(values.dtype).eps) if values.dtype.kind == "f" else 0.0
    outside = np.zeros(values.shape, dtype=bool)
    for limit, sign in ((low, -1.0), (high, 1.0)):
        number = np.empty(0) if limit is None else np.ravel(limit)[:1]
        if number.size == 0 or number.dtype.kind not in "iuf" or not np.isfinite(number[0]):
            continue
        packed = is_packed and number.dtype.kind in "iu"
        bound = float(number[0]) * scale + offset if packed else float(number[0])
        side = -sign if packed and scale < 0.0 else sign
        outside |= side * (values - bound) > spare + 4.0 * digits * abs(bound)
    return outside


def _packing(variable: xr.Variable) -> tuple[float, float]:
    return float(variable.encoding.get("scale_factor", 1.0)), float(variable.encoding.get("add_offset", 0.0))
