"""Noise files: the layout of a noise model or bank as a Dataset, and NetCDF files that are whole or not there."""

from __future__ import annotations

import hashlib
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.output import write_netcdf

if TYPE_CHECKING:
    from bayes_rs.noise.bank import NoiseBank

FILE_KIND = "bayes_rs noise"
FILE_VERSION = 1
_SEAL = b"\nbayes_rs sha256 "
"""Begins the last bytes of a noise file, which HDF5 passes over: the fingerprint of all bytes before them."""
_SEAL_BYTES = len(_SEAL) + 64

_ABSENT = object()


def noise_dataset(bank: NoiseBank, *, single_precision: bool = False) -> xr.Dataset:
    """Return a bank as a Dataset with dimension ``state``; see `NoiseBank.save`."""
    first, models = bank.models[0], bank.models
    details = [dict(model.details) for model in models]
    shared = {key: value for key, value in details[0].items() if all(d.get(key, _ABSENT) == value for d in details)}
    own = [json.dumps({k: v for k, v in d.items() if k not in shared}, sort_keys=True) for d in details]
    pair = ("state", "beam", "other_beam")
    variables: dict[str, Any] = {
        "bias": (pair[:2], np.stack([m.bias for m in models]), {"units": "1"}),
        "gain": (("state", "beam", "stress"), np.stack([m.gain for m in models]), {"units": "1"}),
        "covariance": (pair, np.stack([m.covariance for m in models]), {"units": "1"}),
        "n_realizations": ("state", np.array([float(m.n_realizations) for m in models])),
        "method": ("state", np.array([m.method for m in models], dtype=object)),
        "details": ("state", np.array(own, dtype=object)),
    }
    if all(m.standard_error is not None for m in models):
        variables["standard_error"] = (pair, np.stack([np.asarray(m.standard_error) for m in models]))
    if bank.has_sonic:
        for name, last in (("sonic_covariance", "other_stress"), ("sonic_beam_covariance", "beam")):
            stacked = np.stack([np.asarray(getattr(m, name)) for m in models])
            variables[name] = (("state", "stress", last), stacked, {"units": "1"})
    if single_precision:
        row, column = np.triu_indices(bank.n_beam)
        upper = np.stack([m.covariance[row, column] for m in models]).astype(np.float32)
        change = np.round(bank.probe_change(), 8).astype(np.float32)
        variables["bias"] = (pair[:2], variables["bias"][1].astype(np.float32), {"units": "1"})
        variables["covariance_upper"] = (("state", "beam_pair"), upper, {"units": "1"})
        variables["gain_change"] = (("state", "beam", "stress"), change, {"units": "1"})
        for name in ("covariance", "gain", "standard_error"):
            variables.pop(name, None)
    geometry = first.scan_geometry
    coordinates: dict[str, Any] = {
        "beam": first.beam,
        "other_beam": first.beam,
        "stress": np.array(STRESSES, dtype=object),
        "wind_speed": ("state", bank.wind_speed, {"units": "m s-1"}),
        "yaw": ("state", bank.yaw, {"units": "rad"}),
        "direction": (("beam", "axis"), np.array(geometry["direction"], dtype=np.float64)),
        "focus_distance": ("beam", np.array(geometry["focus_distance"], dtype=np.float64), {"units": "m"}),
        "beam_time": ("beam", np.array(geometry["beam_time"], dtype=np.float64), {"units": "s"}),
    }
    if bank.n_turbulence > 1:
        coordinates["length_scale"] = ("state", bank.length_scale, {"units": "m"})
        coordinates["gamma"] = ("state", bank.gamma, {"units": "1"})
    attributes = {
        "kind": FILE_KIND,
        "format_version": FILE_VERSION,
        "scan": first.scan_name,
        "scan_duration": float(geometry["scan_duration"]),
        "duration": float(first.duration),
        "dissipation": first.turbulence.dissipation,
        "length_scale": first.turbulence.length_scale,
        "gamma": first.turbulence.gamma,
        "turbulence": first.turbulence.name,
        "turbulence_source": first.turbulence.source,
        "details": json.dumps(shared, sort_keys=True),
        **({"probe": json.dumps(geometry["probe"], sort_keys=True)} if "probe" in geometry else {}),
    }
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)


def save_dataset(dataset: xr.Dataset, path: str | Path, *, overwrite: bool) -> None:
    """Write a noise Dataset to a new NetCDF file."""
    file = Path(path)
    if file.exists() and not overwrite:
        raise InputError(f"File {str(file)!r} exists: give another name, or overwrite=True to replace it.")
    try:
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name[:40]}-") as folder:
            part = Path(folder) / "part.nc"
            write_netcdf(dataset, part, encoding=_encoding(dataset))
            with part.open("ab") as written:
                written.write(_seal(part.read_bytes()))
            part.replace(file)
    except OSError as error:
        raise InputError(
            f"Cannot write {str(file)!r}: {error.strerror or error}; give a folder that exists and can be written."
        ) from error


def is_sealed(file: Path) -> bool:
    """Say whether a file ends with the fingerprint of its content, as all do that `save_dataset` wrote.

    Raises
    ------
    InputError
        If the content is not what was written. It must not reach the HDF5 library, which can search a damaged file
        for ever, or find other numbers in it.
    """
    content = file.read_bytes()
    if not content[-_SEAL_BYTES:].startswith(_SEAL):
        return False
    if content[-_SEAL_BYTES:] != _seal(content[:-_SEAL_BYTES]):
        raise InputError(f"Noise file {str(file)!r} is damaged: it was changed since it was written; calibrate again.")
    return True


def _seal(content: bytes) -> bytes:
    return _SEAL + hashlib.sha256(content).hexdigest().encode()


def _encoding(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    large = [name for name, item in dataset.variables.items() if item.dtype.kind == "f" and item.nbytes > 4096]
    return {str(name): {"zlib": True, "complevel": 6, "shuffle": True} for name in large}
