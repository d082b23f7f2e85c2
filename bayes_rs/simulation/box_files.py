"""Files of boxes of turbulence for simulators of loads: HAWC2, Bladed, TurbSim and NetCDF."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.output import write_netcdf
from bayes_rs.simulation.boxes import BoxGrid

_TURBSIM = struct.Struct("<h4i12fi")  # identifier, points, steps, speeds and heights, scales, length of the description
_PERIODIC = 8
_INT16 = np.iinfo(np.int16)


@dataclass(frozen=True, eq=False)
class BoxToWrite:
    """A box, and what files of it say beside the velocities.

    Parameters
    ----------
    field : hipersim.MannTurbulenceField
        The fluctuations u, v, w, m/s, shape (3, n_x, n_y, n_z), float32: x along the wind, y to the left, z up.
    grid : BoxGrid
        Its grid.
    wind_speed : float
        Mean wind speed U at the hub, m/s.
    hub_height : float
        Height of the grid's centre, m.
    shear_exponent : float
        α of the mean wind U (z / hub height)^α in files that hold the mean wind.
    about : dict
        What NetCDF files say of the box.
    """

    field: Any
    grid: BoxGrid
    wind_speed: float
    hub_height: float
    shear_exponent: float
    about: dict[str, Any]

    @property
    def arriving(self) -> NDArray[np.float32]:
        """The fluctuations with the planes in the order in which they arrive: the farthest along the wind first."""
        return np.asarray(self.field.uvw[:, ::-1])

    @property
    def height(self) -> NDArray[np.float64]:
        """Heights of the grid's points, m."""
        count, step = self.grid.shape[2], self.grid.spacing[2]
        return np.asarray(self.hub_height + step * (np.arange(count) - 0.5 * (count - 1)))


def _write_hawc2(box: BoxToWrite, stem: Path) -> list[Path]:
    """Three files of float32, u, v and w, z fastest and x slowest, as generators of Mann boxes write them."""
    box.field.to_hawc2(folder=str(stem.parent), basename=stem.name)
    files = [stem.with_name(f"{stem.name}{component}.turb") for component in "uvw"]
    lines = ["begin mann;", *(f"  filename_{file.stem[-1]} {file.name};" for file in files)]
    for component, count, step in zip("uvw", box.grid.shape, box.grid.spacing, strict=True):
        lines.append(f"  box_dim_{component} {count} {step:.9g};")
    section = stem.with_name(f"{stem.name}.htc")
    section.write_text("\n".join([*lines, "  dont_scale 1;", "end mann;", ""]), encoding="ascii")
    return [*files, section]


def _write_bladed(box: BoxToWrite, stem: Path) -> list[Path]:
    """A file of int16 in thousandths of the standard deviations, v to the right, and a summary for OpenFAST."""
    size = np.std(box.arriving.astype(np.float64), axis=(1, 2, 3))
    field = _like(box.field, box.arriving * np.array([1.0, -1.0, 1.0], dtype=np.float32)[:, None, None, None])
    # hipersim cuts the thousandths off: half a one more, and they are rounded
    field.uvw = field.uvw + 5e-4 * size[:, None, None, None] * np.sign(field.uvw)
    intensity = np.std(field.uvw, axis=(1, 2, 3)) / box.wind_speed
    field.to_bladed(
        box.wind_speed,
        zhub=box.hub_height,
        folder=str(stem.parent),
        basename=stem.name,
        TurbOptions={f"TI_{name}": float(value) for name, value in zip("uvw", intensity, strict=True)},
    )
    file, summary = stem.with_name(f"{stem.name}.wnd"), stem.with_name(f"{stem.name}.sum")
    stem.with_name(f"{stem.name}_1.wnd").replace(file)
    percent = [f"  TI({name}, %) = {100.0 * value:.6f} %" for name, value in zip("uvw", intensity, strict=True)]
    lines = [
        "F  CLOCKWISE",
        f"{box.hub_height:.4f}  HUB HEIGHT (m)",
        f"  UBAR = {box.wind_speed:.6f} m/s",
        *percent,
        "  HEIGHT OFFSET = 0.0 m",
        "  PERIODIC",
        "  BLADED LEFT-HAND RULE",
        "",
    ]
    summary.write_text("\n".join(lines), encoding="ascii")
    return [file, summary]


def _write_turbsim(box: BoxToWrite, stem: Path) -> list[Path]:
    """A file of int16 on a scale for each component, with the mean wind, v to the left."""
    n_x, n_y, n_z = box.grid.shape
    velocity = box.arriving.astype(np.float64)
    velocity[0] += box.wind_speed * (box.height / box.hub_height) ** box.shear_exponent
    low, high = velocity.min(axis=(1, 2, 3)), velocity.max(axis=(1, 2, 3))
    slope = (_INT16.max - _INT16.min) / np.where(high > low, high - low, 1.0)
    slope = slope.astype(np.float32).astype(np.float64)
    offset = (_INT16.min - slope * low).astype(np.float32).astype(np.float64)
    whole = np.rint(slope[:, None, None, None] * velocity + offset[:, None, None, None])
    values = np.clip(whole, _INT16.min, _INT16.max).astype("<i2")
    words = b"A box of Mann turbulence with given stresses, by bayes_rs and hipersim"
    head = _TURBSIM.pack(
        _PERIODIC,
        n_z,
        n_y,
        0,
        n_x,
        box.grid.spacing[2],
        box.grid.spacing[1],
        box.grid.spacing[0] / box.wind_speed,
        box.wind_speed,
        box.hub_height,
        box.height[0],
        *np.column_stack([slope, offset]).ravel(),
        len(words),
    )
    file = stem.with_name(f"{stem.name}.bts")
    with file.open("wb") as out:
        out.write(head + words)
        out.write(np.ascontiguousarray(values.transpose(1, 3, 2, 0)).tobytes())  # step, z, y, component
    return [file]


def _write_netcdf(box: BoxToWrite, stem: Path) -> list[Path]:
    """The fluctuations over x, y and z with coordinates, as hipersim lays them out, and what they were made of."""
    file = stem.with_name(f"{stem.name}.nc")
    array = box.field.to_xarray()
    array.attrs.update(units="m s-1", **box.about)
    for name in "xyz":
        array[name].attrs["units"] = "m"
    write_netcdf(array.to_dataset(name="velocity"), file)
    return [file]


FORMATS: dict[str, Callable[[BoxToWrite, Path], list[Path]]] = {
    "hawc2": _write_hawc2,
    "bladed": _write_bladed,
    "turbsim": _write_turbsim,
    "netcdf": _write_netcdf,
}
"""Formats of boxes by name: (box, path without its ending) → the files that were written."""
WITH_MEAN = ("turbsim",)
"""Formats whose velocities hold the mean wind, and its shear."""


def _like(field: Any, velocity: NDArray[np.float32]) -> Any:
    """Return a field of other velocities on the same grid."""
    from hipersim import MannTurbulenceField  # noqa: PLC0415 - an optional package, which is there

    names = ("alphaepsilon", "L", "Gamma", "Nxyz", "dxyz", "seed", "HighFreqComp", "double_xyz")
    return MannTurbulenceField(velocity, **{name: getattr(field, name) for name in names}, generator=field.generator)
