"""Files as instruments write them, from a series of radial velocities: the writers that the readers' tests read."""

from __future__ import annotations

import bz2
import gzip
import lzma
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import xarray as xr

from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.rays import angles_of

UNIX = np.datetime64("1970-01-01", "ns")


def series_of(scan: Scan, *, n_scan: int = 600, seed: int = 1, start: str = "2024-03-01T09:50:00") -> xr.Dataset:
    """Return velocities of all beams of a scan in the order that it visits them, with whole microseconds."""
    rng = np.random.default_rng(seed)
    order = np.lexsort((scan.beam, scan.beam_time))
    offset = np.round(1e6 * scan.beam_time[order]).astype("timedelta64[us]")
    step = np.round(1e6 * scan.scan_duration * np.arange(n_scan)).astype("timedelta64[us]")
    time = (np.datetime64(start, "us") + step[:, np.newaxis] + offset[np.newaxis, :]).astype("datetime64[ns]")
    mean = scan.line_of_sight[order] @ np.array([9.0, 0.5, 0.0])
    velocity = np.round(mean + rng.normal(0.0, 1.0, (n_scan, len(order))), 4)
    velocity[rng.random(velocity.shape) < 0.01] = np.nan
    cnr = np.round(rng.normal(-12.0, 2.0, velocity.shape), 3)
    return xr.Dataset(
        {"radial_velocity": ("sample", velocity.ravel()), "cnr": ("sample", cnr.ravel())},
        coords={"time": ("sample", time.ravel()), "beam": ("sample", np.tile(scan.beam[order], n_scan))},
    )


def long_frame(series: xr.Dataset) -> pd.DataFrame:
    """Return a series as a long table."""
    return pd.DataFrame({name: series[name].values for name in ("time", "beam", "radial_velocity", "cnr")})


def wide_frame(series: xr.Dataset) -> pd.DataFrame:
    """Return a series as a wide table; its beams must be sampled at the same times."""
    wide = long_frame(series).pivot_table(index="time", columns="beam", values=["radial_velocity", "cnr"], dropna=False)
    prefix = {"radial_velocity": "vr_{}", "cnr": "cnr_{}"}
    wide.columns = [prefix[name].format(beam) for name, beam in wide.columns]
    return wide.reset_index()


def write_hpl(
    file: Path,
    series: xr.Dataset,
    scan: Scan,
    *,
    gate_length: float = 10.0,
    n_gate: int = 5,
    overlap: float | None = None,
    decimal: str = ".",
    spectral_width: bool = False,
) -> Path:
    """Write samples of beams with one focus distance each as a StreamLine's text; other gates hold rubbish."""
    start = series["time"].values.min()
    day = start.astype("datetime64[D]")
    formula = "(range gate + 0.5) * Gate length"
    step = gate_length
    if overlap is not None:
        formula, step = f"Gate length / 2 + (range gate x {overlap:g})", overlap
    stamp = pd.Timestamp(start).strftime("%Y%m%d %H:%M:%S.%f")[:-4]
    head = [
        f"Filename:\t{file.name}",
        "System ID:\t91",
        f"Number of gates:\t{n_gate}",
        f"Range gate length (m):\t{gate_length:.1f}",
        "Gate length (pts):\t16",
        "Pulses/ray:\t20000",
        f"No. of rays in file:\t{len(scan.beam)}",
        "Scan type:\tUser file 1 - stepped",
        "Focus range:\t65535",
        f"Start time:\t{stamp}",
        "Resolution (m/s):\t0.0382",
        f"Range of measurement (center of gate) = {formula}",
        "Data line 1: Decimal time (hours)  Azimuth (degrees)  Elevation (degrees) Pitch (degrees) Roll (degrees)",
        "f9.6,1x,f6.2,1x,f6.2",
        "Data line 2: Range Gate  Doppler (m/s)  Intensity (SNR + 1)  Beta (m-1 sr-1)",
        "i3,1x,f6.4,1x,f8.6,1x,e12.6 - repeat for no. gates",
        "****" + (" Instrument spectral width = 7.796967" if spectral_width else ""),
    ]
    azimuth, elevation = angles_of(scan.beam_direction)
    lines = [line.replace(".", decimal) if line.startswith(("Range gate", "Start", "Resol")) else line for line in head]
    index_of = {int(beam): index for index, beam in enumerate(scan.beam)}
    for time, beam, velocity, cnr in zip(
        series["time"].values,
        series["beam"].values,
        series["radial_velocity"].values,
        series["cnr"].values,
        strict=True,
    ):
        index = index_of[int(beam)]
        hour = (time - day) / np.timedelta64(1, "h") % 24.0
        lines.append(f"{hour:.11f} {azimuth[index]:6.2f} {elevation[index]:6.2f} -0.01 0.20")
        gate = round((scan.focus_distance[index] - 0.5 * gate_length) / step)
        for number in range(n_gate):
            value = (velocity, 1.0 + 10.0 ** (cnr / 10.0)) if number == gate else (-19.4, 0.99)
            width = " 0.0382" if spectral_width else ""
            lines.append(f"{number:3d} {value[0]:.4f} {value[1]:.9f} -1.216295E-6{width}")
    file.write_text("\n".join(lines) + "\n")
    return file


def write_spinnerlidar(file: Path, series: xr.Dataset, scan: Scan) -> Path:
    """Write samples as the SpinnerLidar's eleven columns, magnitudes only."""
    number = np.searchsorted(scan.beam, series["beam"].values)
    direction = scan.beam_direction[number]
    seconds = (series["time"].values - UNIX) / np.timedelta64(1, "s")
    zero = np.zeros(len(number))
    columns = [
        np.arange(len(number)),
        seconds,
        -series["radial_velocity"].values,
        zero + 0.9,
        zero + 123.0,
        zero,
        direction[:, 2],
        direction[:, 1],
        scan.focus_distance[number],
        zero,
        zero,
    ]
    frame = pd.DataFrame(dict(enumerate(columns)))
    frame.to_csv(file, sep="\t", header=False, index=False, float_format="%.9f")
    return file


def write_zx(file: Path, series: xr.Dataset, scan: Scan, *, converter: bool = True, zero_deg: float = 90.0) -> Path:
    """Write samples as magnitudes with a phase that counts downwards from `zero_deg`; 9999 where missing."""
    number = np.searchsorted(scan.beam, series["beam"].values)
    theta = np.degrees(np.arctan2(scan.beam_direction[number, 2], scan.beam_direction[number, 1]))
    frame = pd.DataFrame(
        {
            "When": pd.to_datetime(series["time"].values).strftime("%d/%m/%Y %H:%M:%S.%f"),
            "Scan angle": np.round((zero_deg - theta) % 360.0, 6),
            "LOS": np.where(np.isnan(series["radial_velocity"]), 9999.0, -series["radial_velocity"]),
        }
    )
    first = "CSV Converter: v1.114,Time sync: UTC +0.0 hrs\n" if converter else ""
    file.write_text(first + frame.to_csv(index=False))
    return file


def write_mini_raw(file: Path, series: xr.Dataset, scan: Scan, *, radian: bool = False, **names: str) -> Path:
    """Write samples as ZX's converter might: its time, a phase upwards from y, magnitudes, and marks of bad values."""
    number = np.searchsorted(scan.beam, series["beam"].values)
    theta = np.arctan2(scan.beam_direction[number, 2], scan.beam_direction[number, 1]) % (2.0 * np.pi)
    bad = 9987 + np.cumsum(np.isnan(series["radial_velocity"].values)) % 13
    frame = pd.DataFrame(
        {
            "Timestamp (ISO 8601)": pd.to_datetime(series["time"].values).strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
            "Range (m)": scan.focus_distance[number],
            "Phase (rad)" if radian else "Phase (deg)": np.round(theta if radian else np.degrees(theta), 6),
            "LOS Velocity (m/s)": np.where(np.isnan(series["radial_velocity"]), bad, -series["radial_velocity"]),
            "Backscatter": 0.5,
            "Status Flags": 0,
        }
    )
    frame.rename(columns=names).to_csv(file, index=False)
    return file


def compress(file: Path, suffix: str) -> Path:
    """Return a compressed copy of a file."""
    packed = file.with_name(file.name + suffix)
    raw = file.read_bytes()
    if suffix == ".zip":
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(file.name, raw)
    elif suffix == ".zst":
        packed.write_bytes(pa.compress(raw, codec="zstd", asbytes=True))
    else:
        packed.write_bytes({".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}[suffix](raw))
    return packed
