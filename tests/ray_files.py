"""Files of rays as instruments and converters write them, for the tests of readers and of the survey."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr

from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.rays import angles_of, direction_of

SLANT, UP = 75.0, 90.0
AZIMUTH = np.array([0.0, 72.0, 144.0, 216.0, 288.0, 0.0])
ELEVATION = np.array([SLANT] * 5 + [UP])


def six_beam(*heights: float, step: float = 5.0) -> Scan:
    """Return the six-beam scan of a ground-based lidar, with a plane for each height."""
    direction = direction_of(AZIMUTH, ELEVATION)
    n_plane = len(heights)
    return Scan(
        "six",
        beam_direction=np.tile(direction, (n_plane, 1)),
        focus_distance=np.concatenate([height / direction[:, 2] for height in heights]),
        beam_time=np.tile(step * np.arange(6), n_plane),
        scan_duration=6 * step,
    )


@dataclass(frozen=True)
class RayTable:
    """Rays as a file holds them: seconds since 2000, degrees, metres, m/s."""

    seconds: np.ndarray
    azimuth: np.ndarray
    elevation: np.ndarray
    distance: np.ndarray
    velocity: np.ndarray

    @property
    def cnr(self) -> np.ndarray:
        return np.full(self.velocity.shape, -12.5)

    @property
    def status(self) -> np.ndarray:
        return np.isfinite(self.velocity).astype(np.int8)

    def take(self, index) -> RayTable:
        return replace(self, **{name: getattr(self, name)[index] for name in self.__dataclass_fields__})


def rays_of(series: xr.Dataset, scan: Scan, *, rough: bool = True) -> RayTable:
    """Return simulated samples as rays with a gate for each plane, and one before and one behind them.

    `rough` gives them the angles of real files: 0 as 360 or a thousandth beside it, and a zenith at 89.99 with any
    azimuth.
    """
    n_plane = len(np.unique(np.round(scan.beam_direction, 9), axis=0, return_inverse=True)[1]) // 6
    order = np.lexsort((series["beam"].values, series["time"].values))
    number = series["beam"].values[order].reshape(-1, n_plane)
    first = number[:, 0]
    azimuth, elevation = (angle[first] for angle in angles_of(scan.beam_direction))
    near = scan.focus_distance.reshape(n_plane, 6).T[first % 6]
    rng = np.random.default_rng(3)
    if rough:
        azimuth = azimuth + rng.normal(0.0, 0.001, len(first))
        azimuth = np.where(elevation > 89.0, rng.uniform(0.0, 360.0, len(first)), azimuth)
        azimuth = np.where(rng.random(len(first)) < 0.3, azimuth % 360.0, azimuth)
        elevation = elevation - np.where(elevation > 89.0, 0.01, 0.0) + rng.normal(0.0, 0.002, len(first))
    velocity = series["radial_velocity"].values[order].reshape(-1, n_plane)
    other = rng.normal(30.0, 1.0, (len(first), 2))
    return RayTable(
        seconds=(series["time"].values[order][::n_plane] - np.datetime64("2000-01-01")) / np.timedelta64(1, "s"),
        azimuth=azimuth,
        elevation=elevation,
        distance=np.concatenate([near[:, :1] - 50.0, near, near[:, -1:] + 50.0], axis=1),
        velocity=np.concatenate([other[:, :1], velocity, other[:, 1:]], axis=1),
    )


def windcube_sweep(rays: RayTable, *, epoch: str = "2000-01-01T00:00:00Z", accumulation: float = 0.0) -> xr.Dataset:
    """Return one sweep as a WindCube writes it; times are those of the end of the accumulation, s."""
    dims = ("time", "gate_index")
    end = rays.seconds + accumulation
    named = epoch == "time_reference"
    variables = {
        "radial_wind_speed": (dims, rays.velocity, {"units": "m s-1"}),
        "cnr": (dims, rays.cnr, {"units": "dB"}),
        "radial_wind_speed_status": (dims, rays.status),
        "range": (dims, rays.distance, {"units": "m"}),
        "azimuth": ("time", rays.azimuth, {"units": "degrees"}),
        "elevation": ("time", rays.elevation, {"units": "degrees"}),
    }
    if accumulation:
        variables["ray_accumulation_time"] = ((), np.int32(1000 * accumulation), {"units": "ms"})
    if named:
        variables["time_reference"] = ((), "2000-01-01T00:00:00Z")
    return xr.Dataset(variables, coords={"time": ("time", end, {"units": f"seconds since {epoch}"})})


def write_windcube(file: Path, *sweeps: xr.Dataset) -> Path:
    """Write sweeps into groups that the root lists, as the instrument does."""
    names = [f"Sweep_{15 + number}" for number in range(len(sweeps))]
    root = xr.Dataset(
        {
            "sweep_group_name": ("sweep", np.array(names, dtype=object)),
            "sweep_fixed_angle": ("sweep", np.full(len(sweeps), SLANT)),
        },
        attrs={"Conventions": "CF/Radial 2.0 , CF-1.7", "title": "WindCube data"},
    )
    root.to_netcdf(file, engine="h5netcdf")
    for name, sweep in zip(names, sweeps, strict=True):
        sweep.to_netcdf(file, group=name, mode="a", engine="h5netcdf")
    return file


def e_windlidar(rays: RayTable, *, time: str = "comment", accumulation: float | None = None) -> xr.Dataset:
    """Return rays as Lidaco writes them, with the epoch in the comment, the long name or the units, or as text."""
    dims = ("time", "range")
    attributes = {
        "comment": {"units": "s", "comment": "seconds since campaign start at 2000-01-01T00:00:00.00Z"},
        "long_name": {"units": "s", "long_name": "seconds since 2000/01/01 00:00:00"},
        "units": {"units": "seconds since 2000-01-01"},
        "text": {"units": "s", "long_name": "Time UTC in ISO 8601 format yyyy-mm-ddThh:mm:ssZ"},
    }
    stamps = rays.seconds
    if time == "text":
        at = np.datetime64("2000-01-01", "ns") + np.round(rays.seconds * 1e9).astype("timedelta64[ns]")
        stamps = np.array([f"{stamp}Z" for stamp in at], dtype=object)
    variables = {
        "time": ("time", stamps, attributes[time]),
        "range": (dims, rays.distance, {"units": "m"}),
        "azimuth_angle": ("time", rays.azimuth, {"units": "degrees"}),
        "elevation_angle": ("time", rays.elevation, {"units": "degrees"}),
        "VEL": (dims, rays.velocity, {"units": "m.s-1"}),
        "CNR": (dims, rays.cnr, {"units": "dB"}),
        "scan_type": ((), np.int32(5), {"units": "none"}),
        "yaw": ((), 0.0, {"units": "degrees"}),
    }
    if accumulation is not None:
        variables["accumulation_time"] = ((), accumulation, {"units": "seconds"})
    return xr.Dataset(variables)


def cfradial(rays: RayTable, *, velocity: str = "VEL", standard_name: str | None = None) -> xr.Dataset:
    """Return rays as one sweep of a CfRadial file: singles for angles, the velocity with a fill value."""
    dims = ("time", "range")
    one_elevation = np.ptp(rays.distance, axis=0).max() == 0.0
    attributes = {"units": "m/s", "long_name": "Doppler velocity"}
    variables = {
        "azimuth": ("time", rays.azimuth.astype(np.float32), {"units": "degrees", "_FillValue": np.float32(-9999.0)}),
        "elevation": ("time", rays.elevation.astype(np.float32), {"units": "degrees", "positive": "up"}),
        velocity: (dims, rays.velocity, attributes | ({"standard_name": standard_name} if standard_name else {})),
        "SNR": (dims, rays.cnr, {"units": "dB"}),
        "WIDTH": (dims, np.ones_like(rays.velocity), {"units": "m/s"}),
        "sweep_mode": ("sweep", np.array([b"azimuth_surveillance"])),
        "fixed_angle": ("sweep", [75.0], {"units": "degrees"}),
    }
    made = xr.Dataset(
        variables,
        coords={"time": ("time", rays.seconds, {"units": "seconds since 2000-01-01T00:00:00Z"})},
        attrs={"Conventions": "CF/Radial instrument_parameters", "version": "1.3"},
    )
    attributes = {"units": "meters", "standard_name": "projection_range_coordinate"}
    if one_elevation:
        return made.assign_coords(range=("range", rays.distance[0], attributes))
    return made.rename_dims(range="gate").assign(range=(("time", "gate"), rays.distance, attributes))


def write_cfradial2(file: Path, *sweeps: xr.Dataset) -> Path:
    """Write sweeps into groups, as version 2 has them."""
    names = [f"sweep_{number}" for number in range(len(sweeps))]
    root = xr.Dataset({"sweep_group_name": ("sweep", np.array(names, dtype=object))}, attrs={"version": "2.0"})
    root.to_netcdf(file, engine="h5netcdf")
    for name, sweep in zip(names, sweeps, strict=True):
        sweep.drop_vars("sweep_mode").to_netcdf(file, group=name, mode="a", engine="h5netcdf")
    return file


def arm(rays: RayTable) -> xr.Dataset:
    """Return rays as an ARM Doppler lidar's b1 file: singles, times since midnight with an offset of 0:00."""
    dims, since = ("time", "range"), "seconds since 2000-01-01 00:00:00 0:00"
    snr = 10.0 ** (0.1 * rays.cnr)
    return xr.Dataset(
        {
            "base_time": ((), np.int32(946684800), {"units": "seconds since 1970-1-1 0:00:00 0:00"}),
            "time_offset": ("time", rays.seconds, {"units": since}),
            "azimuth": ("time", rays.azimuth.astype(np.float32), {"units": "degrees"}),
            "elevation": ("time", rays.elevation.astype(np.float32), {"units": "degrees"}),
            "radial_velocity": (
                dims,
                rays.velocity.astype(np.float32),
                {"units": "m/s", "valid_min": np.float32(-20.0), "valid_max": np.float32(20.0)},
            ),
            "qc_radial_velocity": (dims, np.zeros(rays.velocity.shape, dtype=np.int32), {"units": "unitless"}),
            "intensity": (dims, (snr + 1.0).astype(np.float32), {"units": "unitless"}),
            "range": (dims, rays.distance.astype(np.float32), {"units": "m"}),
        },
        coords={"time": ("time", rays.seconds, {"units": since, "long_name": "Time offset from midnight"})},
        attrs={"datastream": "sgpdlppiC1.b1", "dod_version": "dlppi-b1-1.1"},
    )


def mixed_hour(folder: Path, *, n_gate: int = 60, bursts: int = 6) -> Path:
    """Write 118 files of one lidar's hour: DBS cycles, stares at the zenith, and sweeps of both kinds.

    90 files of a DBS cycle each in six bursts of fifteen, 12 stares, 10 PPIs at two elevations, 6 RHIs; angles are as
    rough as those of real files. With fewer bursts a part of it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(4)

    def save(name: str, begin: float, step: float, azimuth, elevation) -> None:
        azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, dtype=float), elevation)
        n_ray = len(azimuth)
        distance = np.tile(100.0 + 25.0 * np.arange(n_gate), (n_ray, 1))
        rays = RayTable(
            seconds=6.75e8 + begin + step * np.arange(n_ray),
            azimuth=(azimuth + rng.normal(0.0, 0.01, n_ray)) % 360.0,
            elevation=elevation + rng.normal(0.0, 0.005, n_ray),
            distance=distance,
            velocity=rng.normal(0.0, 1.0, distance.shape),
        )
        stamp = np.datetime64("2000-01-01") + np.timedelta64(round(rays.seconds[0]), "s")
        windcube_sweep(rays).to_netcdf(folder / f"{str(stamp).replace(':', '-')}_{name}.nc", engine="h5netcdf")

    for burst in range(bursts):
        begin = 600.0 * burst
        for cycle in range(15):
            save("dbs", begin + 20.0 * cycle, 4.0, [0.0, 0.0, 180.0, 270.0, 90.0], [75.0, 90.0, 75.0, 75.0, 75.0])
        for number in range(2):
            save("fixed", begin + 300.0 + 60.0 * number, 1.0, np.zeros(60), 90.0)
        if burst < 5:
            save("ppi", begin + 420.0, 0.5, np.arange(0.0, 90.0, 1.0) - 20.0, 4.0)
            save("ppi", begin + 465.0, 0.5, np.arange(0.0, 180.0, 2.0) + 100.0, 10.0)
        save("rhi", begin + 510.0, 0.5, np.full(88, 30.0), np.arange(2.0, 90.0, 1.0))
    return folder
