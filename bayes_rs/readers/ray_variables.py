"""Rays from the variables of a NetCDF file or group: times, angles, gates and velocities, whatever they are called."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.netcdf_missing import without_missing
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.stated_time import says_since

_ANGLE_LIMIT = 720.0  # degrees; scanners count on beyond a turn, fill values are far away
_OTHER_UNITS = {
    "azimuth": ("rad", "radian", "radians"),
    "elevation": ("rad", "radian", "radians"),
    "distance": ("km", "kilometer", "kilometers", "kilometre", "kilometres", "ft", "feet"),
    "radial_velocity": ("km/h", "km h-1", "km h^-1", "knot", "knots", "kt", "cm/s", "cm s-1"),
}
"""Units that this reader would misread; the names of the right ones are too many to list."""


def own_names(names: Mapping[str, str], file_format: FileFormat) -> dict[str, str]:
    """Return what a file calls things: the names of its format, but for those that the caller mapped."""
    return {**names, **{name: file_format.column(name) for name in file_format.required}}


def rays_from(
    dataset: xr.Dataset,
    file: Path,
    file_format: FileFormat,
    *,
    kind: str,
    names: Mapping[str, str],
    time: NDArray[np.datetime64],
    accumulation_time: FloatArray | None = None,
    first_row: int = 1,
) -> Rays:
    """Return the rays that one dataset holds.

    Parameters
    ----------
    dataset : xarray.Dataset
        The variables, times as numbers.
    file, file_format, kind
        As in `Rays`.
    names : mapping of str to str
        What the dataset calls ``radial_velocity, time, azimuth, elevation, distance`` and, if it has them, ``cnr`` and
        ``status``. The dimensions of the time are those of the rays; the velocity may have one more, the gates.
    time : ndarray of datetime64[ns]
        The times, in the shape of that variable.
    accumulation_time : ndarray, optional
        In s; a number or in the shape of the time. By it, times go to the start of the ray if the options ask so.
    first_row : int
        Number of the first ray, as a person would count.

    Raises
    ------
    InputError
        If a variable is missing, has other dimensions or another unit, or holds something else than numbers.
    """
    size, ray_dims = _layout(dataset, file, names)
    n_ray = int(np.prod([size[dim] for dim in ray_dims]))
    spread, invalid = _values(dataset, file, file_format, names, size, ray_dims)
    for name in ("azimuth", "elevation"):
        far = np.abs(spread[name]) > _ANGLE_LIMIT
        if far.any():
            index = int(np.argmax(far))
            raise InputError(
                f"Invalid {name} {spread[name][index]:g} in ray {first_row + index} of file {str(file)!r}: it must be "
                f"from {-_ANGLE_LIMIT:g} to {_ANGLE_LIMIT:g} degrees; if the number marks a missing entry, "
                f"give it as the option invalid ({spread[name][index]:g})."
            )
    duration = None
    if accumulation_time is not None and accumulation_time.size in (1, n_ray):
        duration = np.broadcast_to(np.ravel(accumulation_time), (n_ray,)).astype(np.float64)
    return Rays(
        file=file,
        kind=kind,
        file_format=file_format,
        time=file_format.to_start(time.reshape(n_ray), duration),
        direction=direction_of(spread["azimuth"], spread["elevation"]),
        distance=np.where(spread["distance"] > 0.0, spread["distance"], np.nan),
        radial_velocity=file_format.to_away(spread["radial_velocity"]),
        cnr=spread.get("cnr"),
        status=spread.get("status"),
        row=first_row + np.arange(n_ray, dtype=np.int64),
        row_word="ray",
        counts={
            "rows": n_ray,
            "rows_invalid_value": invalid,
            "rows_dropped": 0,
            "rows_without_time": 0,
            "rows_without_beam": 0,
        },
        accumulation_time=duration,
    )


def _layout(
    dataset: xr.Dataset, file: Path, names: Mapping[str, str]
) -> tuple[dict[Hashable, int], tuple[Hashable, ...]]:
    """Return the sizes of the dimensions of rays and gates, in this order, and which dimensions are those of rays."""
    for name in ("radial_velocity", "time", "azimuth", "elevation", "distance"):
        if names[name] not in dataset.variables:
            found = ", ".join(repr(str(variable)) for variable in dataset.variables)
            raise InputError(
                f"File {str(file)!r} has no variable {names[name]!r} for the {name.replace('_', ' ')} of its rays: its "
                f"variables are {found}; say what the file calls it with the option columns={{{name!r}: 'name in the "
                "file'}, or give another file_format."
            )
    velocity = dataset.variables[names["radial_velocity"]]
    ray_dims = dataset.variables[names["time"]].dims
    gate_dims = [dim for dim in velocity.dims if dim not in ray_dims]
    if not ray_dims or not set(ray_dims) <= set(velocity.dims) or len(gate_dims) > 1:
        raise InputError(
            f"Variable {names['radial_velocity']!r} in file {str(file)!r} has the dimensions {velocity.dims}: it must "
            f"have those of the time, {ray_dims}, and at most one more, the gates."
        )
    return {dim: dataset.sizes[dim] for dim in (*ray_dims, *gate_dims)}, ray_dims


def _values(
    dataset: xr.Dataset,
    file: Path,
    file_format: FileFormat,
    names: Mapping[str, str],
    size: Mapping[Hashable, int],
    ray_dims: tuple[Hashable, ...],
) -> tuple[dict[str, FloatArray], int]:
    """Return the variables by ray, and by gate where they have gates; and how many rays hold an invalid value."""
    n_ray = int(np.prod([size[dim] for dim in ray_dims]))
    n_gate = int(np.prod([size[dim] for dim in size if dim not in ray_dims]))
    spread = {}
    invalid = np.zeros(n_ray, dtype=bool)
    for name in ("radial_velocity", "azimuth", "elevation", "distance", "cnr", "status"):
        if names.get(name) in dataset.variables:
            per_ray = name in ("azimuth", "elevation")
            dims = {dim: size[dim] for dim in ray_dims} if per_ray else size
            values = _numbers(dataset.variables[names[name]], name, names[name], file, dims)
            values = values.reshape(n_ray) if per_ray else values.reshape(n_ray, n_gate)
            is_invalid = file_format.is_invalid(values)
            invalid |= is_invalid if per_ray else is_invalid.any(axis=1)
            spread[name] = np.where(is_invalid | ~np.isfinite(values), np.nan, values)
    return spread, int(invalid.sum())


def join_rays(parts: Sequence[Rays]) -> Rays:
    """Return the rays of several groups of one file as one; rays with fewer gates are filled with NaN."""
    first = parts[0]
    if len(parts) == 1:
        return first
    n_gate = max(part.distance.shape[1] for part in parts)
    n_ray = [len(part.time) for part in parts]

    def gates(name: str) -> FloatArray | None:
        arrays = [getattr(part, name) for part in parts]
        if all(array is None for array in arrays):
            return None
        filled = np.full((sum(n_ray), n_gate), np.nan)
        for start, array in zip(np.cumsum([0, *n_ray[:-1]]), arrays, strict=True):
            if array is not None:
                filled[start : start + len(array), : array.shape[1]] = array
        return filled

    durations = [
        np.full(rows, np.nan) if part.accumulation_time is None else part.accumulation_time
        for part, rows in zip(parts, n_ray, strict=True)
    ]
    distance, velocity = gates("distance"), gates("radial_velocity")
    if distance is None or velocity is None:  # every part has both; this tells the type checker
        raise InputError(f"File {str(first.file)!r} has no gates.")
    return Rays(
        file=first.file,
        kind=first.kind,
        file_format=first.file_format,
        time=np.concatenate([part.time for part in parts]),
        direction=np.concatenate([part.direction for part in parts]),
        distance=distance,
        radial_velocity=velocity,
        cnr=gates("cnr"),
        status=gates("status"),
        row=np.concatenate([part.row for part in parts]),
        row_word=first.row_word,
        counts={key: sum(part.counts[key] for part in parts) for key in first.counts},
        accumulation_time=np.concatenate(durations),
    )


def decode_times(variable: xr.Variable, units: str, name: str, file: Path) -> NDArray[np.datetime64]:
    """Return times that a file counts in `units` (such as ``seconds since 1970-01-01``), NaT where missing.

    Raises
    ------
    InputError
        If the units or the calendar cannot be used, or the times are no numbers.
    """
    attributes = {"units": units, **{key: variable.attrs[key] for key in ("calendar",) if key in variable.attrs}}
    try:
        if not says_since(units):
            raise ValueError("they do not say the date that they count from")
        raw = np.asarray(without_missing(variable).values, dtype=np.float64)
        counted = xr.Variable(variable.dims, np.where(np.isfinite(raw), raw, np.nan), attributes)
        decoded = xr.decode_cf(xr.Dataset({"t": counted}), decode_timedelta=False)["t"].values
        if not np.issubdtype(decoded.dtype, np.datetime64):
            raise ValueError("they are no dates of the Gregorian calendar")
        return decoded.astype("datetime64[ns]")
    except UNREADABLE as error:
        raise InputError(
            f"Variable {name!r} of file {str(file)!r} cannot be read as times in {units!r}: {_first_line(error)}; "
            "give a file whose times are counted by the CF conventions, such as 'seconds since 1970-01-01'."
        ) from error


def text_of(variable: xr.Variable) -> str:
    """Return the text that a variable holds as a string, bytes or characters."""
    raw = variable.values
    if raw.dtype.kind == "S" and raw.ndim:
        return b"".join(raw.ravel().tolist()).decode("utf-8", errors="replace").strip("\0 ")
    value = raw.ravel()[0] if raw.size else ""
    return (value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)).strip("\0 ")


def _numbers(variable: xr.Variable, name: str, own: str, file: Path, size: Mapping[Hashable, int]) -> FloatArray:
    """Return a variable as numbers in the shape `size`."""
    if not set(variable.dims) <= set(size):
        raise InputError(
            f"Variable {own!r} in file {str(file)!r} has the dimensions {variable.dims}: they must be among "
            f"{tuple(size)}, those of the radial velocity{'' if len(size) > 1 else ' without its gates'}."
        )
    unit = str(variable.attrs.get("units", "")).strip().lower()
    if unit in _OTHER_UNITS.get(name, ()):
        raise InputError(
            f"Variable {own!r} in file {str(file)!r} has the units {unit!r}: this format counts in degrees, m and m/s; "
            "convert the file."
        )
    values = without_missing(variable).transpose(*(dim for dim in size if dim in variable.dims)).values
    shape = [length if dim in variable.dims else 1 for dim, length in size.items()]
    try:
        if np.iscomplexobj(values):
            raise TypeError("they are complex")  # noqa: TRY301 - caught below with the others
        return np.broadcast_to(np.asarray(values, dtype=np.float64).reshape(shape), tuple(size.values()))
    except (ValueError, TypeError) as error:
        raise InputError(
            f"Variable {own!r} in file {str(file)!r} must hold numbers: {_first_line(error)}; correct the file."
        ) from error


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
