"""Reading noise files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.noise.file import FILE_KIND, FILE_VERSION, is_sealed
from bayes_rs.noise.model import Noise, NoiseBank, NoiseModel
from bayes_rs.readers.compressed import UNREADABLE
from bayes_rs.readers.netcdf_check import check_netcdf
from bayes_rs.turbulence.interpolation import nearest_semidefinite
from bayes_rs.turbulence.mann import MannTurbulence


def load_noise(path: str | Path) -> Noise:
    """Read a noise model or a noise bank from the NetCDF file that `save` wrote.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    noise : NoiseModel or NoiseBank
        Whichever the file holds.

    Raises
    ------
    InputError
        If there is no such file, or it is not a noise file that this version can read.

    Examples
    --------
    >>> from bayes_rs.models import models_folder
    >>> load_noise(models_folder("noise") / "6-beam.nc").scan_name
    '6-beam'
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"No noise file {str(file)!r}: make one with calibrate, or give the path of another.")
    sealed = is_sealed(file)
    try:
        check_netcdf(file, guarded=not sealed)
        dataset = xr.load_dataset(file, engine="h5netcdf")
    except UNREADABLE as error:
        reason = error.__cause__ or error
        raise InputError(
            f"File {str(file)!r} cannot be read as NetCDF, it is damaged or of another kind: {reason}."
        ) from error
    if str(dataset.attrs.get("kind")) != FILE_KIND:
        raise InputError(f"File {str(file)!r} is not a noise file of bayes_rs: make one with calibrate.")
    version = dataset.attrs.get("format_version", 0)
    if np.ndim(version) or isinstance(version, str) or version != FILE_VERSION:
        raise InputError(
            f"Noise file {str(file)!r} has format version {version} and this program reads {FILE_VERSION}: "
            "calibrate again."
        )
    try:
        return _from_dataset(dataset)
    except InputError as error:
        raise InputError(f"Noise file {str(file)!r} is damaged: {error}") from error
    except UNREADABLE as error:
        raise InputError(f"Noise file {str(file)!r} is damaged, {error} cannot be read: calibrate again.") from error


def _from_dataset(dataset: xr.Dataset) -> Noise:
    one = "state" not in dataset.dims
    states = dataset.expand_dims("state") if one else dataset
    attributes = states.attrs
    geometry = {
        "beam": states["beam"].values.tolist(),
        "direction": _per_beam(states["direction"]).tolist(),
        "focus_distance": _per_beam(states["focus_distance"]).tolist(),
        "beam_time": _per_beam(states["beam_time"]).tolist(),
        "scan_duration": check_positive(attributes["scan_duration"], what="scan_duration", unit="s"),
        **({"probe": json.loads(attributes["probe"])} if "probe" in attributes else {}),
    }
    turbulence = MannTurbulence(
        dissipation=float(attributes["dissipation"]),
        length_scale=float(attributes["length_scale"]),
        gamma=float(attributes["gamma"]),
        name=str(attributes["turbulence"]),
        source=str(attributes["turbulence_source"]),
    )
    shared = json.loads(attributes["details"])
    gain, covariance = _matrices(states)
    models = []
    for index in range(states.sizes["state"]):
        state = states.isel(state=index)
        own_scale = float(state["length_scale"]) if "length_scale" in state.coords else turbulence.length_scale
        own_gamma = float(state["gamma"]) if "gamma" in state.coords else turbulence.gamma
        models.append(
            NoiseModel(
                bias=state["bias"].values,
                gain=gain[index],
                covariance=covariance[index],
                beam=state["beam"].values,
                scan_name=str(attributes["scan"]),
                scan_geometry=geometry,
                wind_speed=float(state["wind_speed"]),
                yaw=float(state["yaw"]),
                duration=float(attributes["duration"]),
                turbulence=replace(turbulence, length_scale=own_scale, gamma=own_gamma),
                method=str(state["method"].item()),
                n_realizations=float(state["n_realizations"]),
                standard_error=state["standard_error"].values if "standard_error" in state else None,
                details={**shared, **json.loads(str(state["details"].item()))},
                **{name: state[name].values for name in ("sonic_covariance", "sonic_beam_covariance") if name in state},
            )
        )
    return models[0] if one else NoiseBank(tuple(models))


def _matrices(states: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """Return gain and covariance of each state, whether written in full or in single precision."""
    if "covariance_upper" not in states:
        return states["gain"].values, states["covariance"].values
    n_beam = states.sizes["beam"]
    row, column = np.triu_indices(n_beam)
    covariance = np.empty((states.sizes["state"], n_beam, n_beam))
    covariance[:, row, column] = covariance[:, column, row] = states["covariance_upper"].values
    direction, yaw = _per_beam(states["direction"]), np.asarray(states["yaw"].values, dtype=np.float64)
    gain = design_matrix(direction @ yaw_matrix(yaw)) + states["gain_change"].values
    return np.asarray(gain, dtype=np.float64), nearest_semidefinite(covariance)[0]


def _per_beam(variable: xr.DataArray) -> FloatArray:
    values = variable.isel(state=0) if "state" in variable.dims else variable
    return np.asarray(values.values, dtype=np.float64)
