"""Rays from the variables of a NetCDF file or group: times, angles, gates and velocities, whatever they are called."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.readers.contradictions import agree, distance_by_height
from bayes_rs.readers.format import FileFormat
from bayes_rs.readers.netcdf_group import Group
from bayes_rs.readers.netcdf_missing import without_missing
from bayes_rs.readers.rays import Rays, direction_of
from bayes_rs.readers.units import factor_to_degrees, factor_to_metres, with_velocity_unit

_ANGLE_LIMIT = 720.0  # degrees; scanners count on beyond a turn, fill values are far away


def own_names(names: Mapping[str, str], file_format: FileFormat) -> dict[str, str]:
    """Return what a file calls things: the names of its format, but for those that the caller mapped."""
    return {**names, **{name: file_format.column(name) for name in file_format.required}}


def rays_from(
    group: Group,
    file: Path,
    file_format: FileFormat,
    *,
    kind: str,
    names: Mapping[str, str],
    time: NDArray[np.datetime64],
    accumulation_time: FloatArray | None = None,
    first_row: int = 1,
) -> Rays:
    """Return the rays that one group holds.

    Parameters
    ----------
    group : Group
        Its variables.
    file, file_format, kind
        As in `Rays`.
    names : mapping of str to str
        What it calls ``radial_velocity, time, azimuth, elevation, distance`` and, if it has them, ``cnr`` or
        ``intensity`` (the signal-to-noise ratio plus one), ``status``, and the ``height`` of the gates. The dimensions
        of the time are those of the rays; the velocity may have one more, the gates.
    time : ndarray of datetime64[ns]
        The times, in the shape of that variable.
    accumulation_time : ndarray, optional
        In s; a number or in the shape of the time. By it, times go to the start of the ray if the options ask so.
    first_row : int
        Number of the first ray, as a person would count.

    Raises
    ------
    InputError
        If a variable is missing, has other dimensions or a unit that is not known, or holds something else than
        numbers; or distances and heights contradict each other.
    """
    size, ray_dims = _layout(group, file, names)
    n_ray = int(np.prod([size[dim] for dim in ray_dims]))
    velocity = names["radial_velocity"]
    file_format = with_velocity_unit(
        file_format, group.variables[velocity].attrs.get("units"), name=velocity, file=file
    )
    spread, invalid = _values(group, file, file_format, names, size, ray_dims)
    for name in ("azimuth", "elevation"):
        far = np.abs(spread[name]) > _ANGLE_LIMIT
        if far.any():
            index = int(np.argmax(far))
            raise InputError(
                f"Invalid {name} {spread[name][index]:g} in ray {first_row + index} of file {str(file)!r}: it must be "
                f"from {-_ANGLE_LIMIT:g} to {_ANGLE_LIMIT:g} degrees; if the number marks a missing entry, "
                f"give it as the option invalid ({spread[name][index]:g})."
            )
    distance = np.where(spread["distance"] > 0.0, spread["distance"], np.nan)
    distance, facts = _gates(distance, spread, file, file_format, names, first_row)
    duration = None
    if accumulation_time is not None and accumulation_time.size in (1, n_ray):
        duration = np.broadcast_to(np.ravel(accumulation_time), (n_ray,)).astype(np.float64)
    return Rays(
        file=file,
        kind=kind,
        file_format=file_format,
        time=file_format.to_start(time.reshape(n_ray), duration),
        direction=direction_of(spread["azimuth"], spread["elevation"]),
        distance=distance,
        radial_velocity=file_format.to_away(spread["radial_velocity"]),
        cnr=spread["cnr"] if "cnr" in spread else _as_cnr(spread.get("intensity")),
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
        facts=facts,
    )


def _as_cnr(intensity: FloatArray | None) -> FloatArray | None:
    """Return the ratio of carrier to noise, dB, of an intensity, which is that plus one; None of none."""
    if intensity is None:
        return None
    ratio = intensity - 1.0
    return 10.0 * np.log10(np.where(ratio > 0.0, ratio, np.nan))


def _gates(
    distance: FloatArray,
    spread: Mapping[str, FloatArray],
    file: Path,
    file_format: FileFormat,
    names: Mapping[str, str],
    first_row: int,
) -> tuple[FloatArray, dict[str, Any]]:
    """Return the distances that are believed, and what the report says of it, where a file says heights, too."""
    height, elevation = spread.get("height"), spread["elevation"]
    if height is None or file_format.gates_by == "distance":
        return distance, {}
    if file_format.gates_by == "height":
        return distance_by_height(height, elevation), {}
    agreed = agree(distance, elevation, height)
    if agreed.distance is None:
        ray, gate = agreed.worst
        raise InputError(
            f"Distances and heights of the gates in file {str(file)!r} contradict each other: in ray "
            f"{first_row + ray}, at an elevation of {elevation[ray]:g} degrees, gate {gate + 1} has the distance "
            f"{distance[ray, gate]:g} m in {names['distance']!r} and the height {height[ray, gate]:g} m in "
            f"{names['height']!r}, and no other order of the rows agrees; say which to believe with "
            "gates_by='distance' or gates_by='height' (--gates-by)."
        )
    return agreed.distance, {"range_rows_reordered": True} if agreed.reordered else {}


def _layout(group: Group, file: Path, names: Mapping[str, str]) -> tuple[dict[Hashable, int], tuple[Hashable, ...]]:
    """Return the sizes of the dimensions of rays and gates, in this order, and which dimensions are those of rays."""
    for name in ("radial_velocity", "time", "azimuth", "elevation", "distance"):
        if names[name] not in group.variables:
            found = ", ".join(repr(variable) for variable in group.names)
            raise InputError(
                f"File {str(file)!r} has no variable {names[name]!r} for the {name.replace('_', ' ')} of its rays: its "
                f"variables are {found}; say what the file calls it with the option columns={{{name!r}: 'name in the "
                "file'}, or give another file_format."
            )
    velocity = group.variables[names["radial_velocity"]]
    ray_dims = group.variables[names["time"]].dims
    gate_dims = [dim for dim in velocity.dims if dim not in ray_dims]
    if not ray_dims or not set(ray_dims) <= set(velocity.dims) or len(gate_dims) > 1:
        raise InputError(
            f"Variable {names['radial_velocity']!r} in file {str(file)!r} has the dimensions {velocity.dims}: it must "
            f"have those of the time, {ray_dims}, and at most one more, the gates."
        )
    return {dim: group.sizes[str(dim)] for dim in (*ray_dims, *gate_dims)}, ray_dims


def _values(
    group: Group,
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
    for name in ("radial_velocity", "azimuth", "elevation", "distance", "cnr", "intensity", "status", "height"):
        own = names.get(name, "")
        if own in group.variables:
            variable = group.variables[own]
            factor = _factor(name, variable.attrs.get("units"), own, file)
            per_ray = name in ("azimuth", "elevation")
            dims = {dim: size[dim] for dim in ray_dims} if per_ray else size
            values = _numbers(variable, own, file, dims)
            values = values.reshape(n_ray) if per_ray else values.reshape(n_ray, n_gate)
            bad = ~np.isfinite(values)
            if file_format.invalid and name not in ("intensity", "height"):
                is_invalid = file_format.is_invalid(values, name)
                invalid |= is_invalid if per_ray else is_invalid.any(axis=1)
                bad |= is_invalid
            values = values if factor == 1.0 else factor * values
            spread[name] = np.where(bad, np.nan, values)
    return spread, int(invalid.sum())


def _factor(name: str, stated: object, own: str, file: Path) -> float:
    """Return by what values in the unit that the file states must be multiplied to be in ours."""
    if name in ("azimuth", "elevation"):
        return factor_to_degrees(stated, name=own, file=file)
    return factor_to_metres(stated, name=own, file=file) if name in ("distance", "height") else 1.0


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
        facts={key: value for part in parts for key, value in part.facts.items()},
    )


def _numbers(variable: xr.Variable, own: str, file: Path, size: Mapping[Hashable, int]) -> FloatArray:
    """Return a variable as numbers in the shape `size`."""
    if not set(variable.dims) <= set(size):
        raise InputError(
            f"Variable {own!r} in file {str(file)!r} has the dimensions {variable.dims}: they must be among "
            f"{tuple(size)}, those of the radial velocity{'' if len(size) > 1 else ' without its gates'}."
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
