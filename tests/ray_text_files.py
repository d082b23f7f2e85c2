"""Text files of rays as instruments write them, from a table of rays; made here, not measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from ray_files import SLANT, RayTable

HEIGHTS = (60, 100, 150, 200)
"""m; those of the beams of a scan with planes at 100 and 150 m, and one before and behind."""
MILLENNIUM = np.datetime64("2000-01-01", "ns")


def times_of(rays: RayTable) -> pd.DatetimeIndex:
    return pd.DatetimeIndex(MILLENNIUM + np.round(rays.seconds * 1e9).astype("timedelta64[ns]"))


def at_heights(rays: RayTable) -> RayTable:
    """The same rays with gates at heights that all beams have in common."""
    rise = np.sin(np.deg2rad(rays.elevation))[:, np.newaxis]
    return RayTable(rays.seconds, rays.azimuth, rays.elevation, np.array(HEIGHTS) / rise, rays.velocity)


def number(value: float, digits: int = 4) -> str:
    return "NaN" if np.isnan(value) else f"{value:.{digits}f}"


def write_windscanner(file: Path, rays: RayTable, *, n_before: int = 4, duration: float = 0.5) -> Path:
    """Write `n_before` numbers of the instrument's own, start, stop, azimuth, elevation, and four for each gate."""
    start = (times_of(rays) - np.datetime64("1904-01-01")) / np.timedelta64(1, "s")
    lines = []
    for index in range(len(rays.seconds)):
        words = [str(100 + index)] * n_before + [f"{start[index]:.3f}", f"{start[index] + duration:.3f}"]
        words += [f"{720.0 + rays.azimuth[index]:.6f}", f"{rays.elevation[index]:.6f}"]
        for distance, velocity in zip(rays.distance[index], rays.velocity[index], strict=True):
            words += [f"{distance:.6f}", number(velocity), "-12.500", "0.631"]
        lines.append(";".join(words))
    file.write_text("\n".join(lines) + "\n")
    return file


def write_scn(file: Path, rays: RayTable) -> Path:
    """Write a Galion's six lines of header, its headings, and a line for each gate; no newline at the end."""
    when = times_of(rays)
    lines = [
        "Filename:\tC:\\Lidar\\Data\\2000\\a.scn",
        "Campaign code:\ttest",
        "Campaign number:\t1",
        f"Rays in scan:\t{len(when)}",
        f"Start time:\t{when[0]:%Y-%m-%d %H:%M:%S.%f}"[:-3],
        "Range gate\tDoppler\tIntensity\tRay time\tAz\tEl\tPitch\tRoll",
    ]
    for index, time in enumerate(when):
        stamp = f"{time:%Y-%m-%d %H:%M:%S.%f}"[:-3]
        for gate, velocity in enumerate(rays.velocity[index]):
            angles = f"{rays.azimuth[index]:.6f}\t{rays.elevation[index]:.6f}\t-0.093\t0.297"
            lines.append(f"{gate}\t{number(velocity)}\t1.1\t{stamp}\t{angles}")
    file.write_text("\n".join(lines))
    return file


def write_rtd(file: Path, rays: RayTable, *, version: int = 2, zone: str = "UTC+0", angle: str | None = None) -> Path:
    """Write rays at `HEIGHTS` as a WindCube's text, version 1 (and WLS70) or 2; the velocity is positive towards."""
    when = times_of(rays)
    angle = f"{90.0 - SLANT:.3f}" if angle is None else angle
    heights = "\t".join(str(height) for height in HEIGHTS)
    if version == 2:
        fields = [
            "Version=1.1.13", "ID System=WLS7-1", f"timezone={zone}", "*" * 20, "Pulses / Line of Sight=20000",
            "Pulse Repetition Rate (Hz)=25000.000", f"ScanAngle (°)={angle}", "DirectionOffset (°)=-84.000",
            f"Altitudes (m)=\t{heights}", "*" * 20,
        ]  # fmt: skip
        headings = ["Timestamp", "Position", "Temperature", "Wiper Count"]
        for height in HEIGHTS:
            names = ("CNR (dB)", "Radial Wind Speed (m/s)", "Radial Wind Speed Dispersion (m/s)", "Wind Speed (m/s)",
                     "Wind Direction (°)", "X-wind (m/s)", "Y-wind (m/s)", "Z-wind (m/s)")  # fmt: skip
            headings += [*(f"{height}m {name}" for name in names), ""]
        headings.pop()
    else:
        fields = ["Version=3.1.66", f"ScanAngle(°)={angle}", f"Altitudes(m)=\t{heights}", "Gain=32.797000"]
        headings = ["Date", "Position", "Temperature", "Wiper"]
        for place in range(1, len(HEIGHTS) + 1):
            headings += [f"{name}-{place}" for name in ("CNR", "RWS", "RWSD", "Vh", "Direction", "u", "v", "w")]
    size = "HeaderSize" if version == 2 else "HeaderLength"
    lines = [f"{size}={len(fields) + 1}", *fields, "\t".join(headings)]
    for index, time in enumerate(when):
        stamp = f"{time:%Y/%m/%d %H:%M:%S.%f}"[:-4] if version == 2 else f"{time:%d/%m/%Y %H:%M:%S.%f}"[:-4]
        position = "V" if rays.elevation[index] > 89.0 else f"{rays.azimuth[index]:.6f}"
        words = [stamp, position, "14.5", "0" if version == 2 else "Off"]
        for velocity in rays.velocity[index]:
            words += ["-12.5", number(-velocity), "0.3", "8.1", "270", "7.9", "0.1", "0.05", *[""] * (version == 2)]
        lines.append("\t".join(words))
    file.write_bytes(("\r\n".join(lines) + "\r\n").encode("latin-1"))
    return file


def ray_frame(rays: RayTable, **names: str) -> pd.DataFrame:
    """Return rays as a table with a row for each ray and gate, under names of ours or others."""
    n_ray, n_gate = rays.distance.shape
    frame = pd.DataFrame(
        {
            "time": np.repeat(times_of(rays), n_gate),
            "azimuth": np.repeat(rays.azimuth, n_gate),
            "elevation": np.repeat(rays.elevation, n_gate),
            "distance": rays.distance.ravel(),
            "velocity": rays.velocity.ravel(),
            "cnr": rays.cnr.ravel(),
            "status": rays.status.ravel(),
        }
    )
    assert len(frame) == n_ray * n_gate
    return frame.rename(columns=names)


def gate_frame(rays: RayTable, *, velocity: str, distance: str | None = None, cnr: str | None = None) -> pd.DataFrame:
    """Return rays as a table with a row for each ray; the names have {} for the gate, from 0, or [] for its metres."""
    columns = {"Timestamp": times_of(rays), "Azimuth [°]": rays.azimuth, "Elevation [°]": rays.elevation}
    blocks = ((velocity, rays.velocity), (distance, rays.distance), (cnr, rays.cnr))
    for gate in range(rays.distance.shape[1]):
        for name, values in blocks:
            if name is not None:
                metres = f"{rays.distance[0, gate]:g}"
                columns[name.replace("{}", str(gate)).replace("[]", metres)] = values[:, gate]
    return pd.DataFrame(columns)


def write_molas(file: Path, rays: RayTable) -> Path:
    """Write rays under the headings of a Molas 3D's real-time file."""
    frame = ray_frame(
        rays, time="Timestamp", azimuth="Azimuth(deg)", elevation="Elevation(deg)", distance="Distance(m)",
        velocity="RWS(m/s)", cnr="CNR(dB)",
    ).drop(columns="status")  # fmt: skip
    frame["Timestamp"] = frame["Timestamp"].dt.strftime("%Y/%m/%d %H:%M:%S.%f").str[:-3]
    frame.insert(1, "Mode", 0.0)
    frame["Wind Speed(m/s)"] = 0.0
    frame["Craft RWS(m/s)"] = frame["RWS(m/s)"]
    frame["Cloud Height(m)"] = np.nan
    frame.to_csv(file, index=False)
    return file
