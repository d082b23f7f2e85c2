"""The layout of noise as a Dataset: the fields of `Noise` to variables and attributes, and back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from pydantic import Json

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import yaw_matrix
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import Entry, Finite, Open, Positive, check_dataset, read_json
from bayes_rs.turbulence.interpolation import nearest_semidefinite
from bayes_rs.turbulence.mann import MannTurbulence

FILE_KIND = "bayes_rs noise"
FILE_VERSION = 1

_PAIR = ("state", "beam", "other_beam")
_ARRAYS = {
    "bias": ("state", "beam"),
    "gain": ("state", "beam", "stress"),
    "covariance": _PAIR,
    "standard_error": _PAIR,
    "sonic_covariance": ("state", "stress", "other_stress"),
    "sonic_beam_covariance": ("state", "stress", "beam"),
}
_UNITS = {"units": "1"}
_MOST = 1e6  # of relative numbers, which in any air are about 1
_LAYOUT = {
    **{name: Entry(dims, unit="1", most=_MOST) for name, dims in _ARRAYS.items()},
    "covariance_upper": Entry(("state", "beam_pair"), unit="1", most=_MOST),
    "gain_change": Entry(_ARRAYS["gain"], unit="1", most=_MOST),
    "n_realizations": Entry(("state",), most=float("inf")),
    "method": Entry(("state",), "text"),
    "details": Entry(("state",), "text"),
    "beam": Entry(("beam",), "whole"),
    "other_beam": Entry(("other_beam",), "whole"),
    "stress": Entry(("stress",), "text", values=STRESSES),
    "other_stress": Entry(("other_stress",), "text", values=STRESSES),
    "wind_speed": Entry(("state",), unit="m s-1", positive=True),
    "yaw": Entry(("state",), unit="rad"),
    "length_scale": Entry(("state",), unit="m", positive=True),
    "gamma": Entry(("state",), unit="1"),
    "direction": Entry(("beam", "axis")),
    "focus_distance": Entry(("beam",), unit="m"),
    "beam_time": Entry(("beam",), unit="s"),
}
"""What a file of noise holds; variables of one state may lack its dimension, and those of the scan may have it."""
_NEEDS = ("beam", "direction", "focus_distance", "beam_time", "wind_speed", "yaw", "bias", "method", "details")
_ADVICE = "calibrate again"


class _Attributes(Open):
    scan: str
    scan_duration: Positive
    duration: Positive
    dissipation: Positive
    length_scale: Positive
    gamma: Finite
    turbulence: str
    turbulence_source: str
    details: Json[dict[str, Any]]
    probe: Json[dict[str, Any]] | None = None


def noise_dataset(noise: Mapping[str, Any], *, probe_change: FloatArray | None = None) -> xr.Dataset:
    """Return the fields of a noise as a Dataset with dimension ``state``.

    Parameters
    ----------
    noise : mapping
        Fields of `Noise`.
    probe_change : ndarray, shape (n_state, n_beam, 6), optional
        What the probe volume adds to the design matrix; with it, bias, gain and half of each covariance are written in
        single precision, without standard errors.

    Returns
    -------
    dataset : xarray.Dataset
        What `noise_fields` takes.
    """
    n_state, geometry, flow = len(noise["wind_speed"]), noise["scan_geometry"], noise["turbulence"]
    own: Sequence[Mapping[str, Any]] = noise["state_details"] or ({},) * n_state
    variables: dict[str, Any] = {
        name: (dims, noise[name], _UNITS) for name, dims in _ARRAYS.items() if noise[name] is not None
    }
    variables |= {
        "n_realizations": ("state", noise["n_realizations"]),
        "method": ("state", np.array([noise["method"]] * n_state, dtype=object)),
        "details": ("state", np.array([json.dumps(one, sort_keys=True) for one in own], dtype=object)),
    }
    if probe_change is not None:
        row, column = np.triu_indices(len(noise["beam"]))
        upper = noise["covariance"][:, row, column].astype(np.float32)
        change = np.round(probe_change, 8).astype(np.float32)
        for name in ("covariance", "gain", "standard_error"):
            variables.pop(name, None)
        variables["bias"] = (_ARRAYS["bias"], noise["bias"].astype(np.float32), _UNITS)
        variables["covariance_upper"] = (("state", "beam_pair"), upper, _UNITS)
        variables["gain_change"] = (_ARRAYS["gain"], change, _UNITS)
    coordinates: dict[str, Any] = {
        "beam": noise["beam"],
        "other_beam": noise["beam"],
        "stress": np.array(STRESSES, dtype=object),
        "wind_speed": ("state", noise["wind_speed"], {"units": "m s-1"}),
        "yaw": ("state", noise["yaw"], {"units": "rad"}),
        "length_scale": ("state", noise["length_scale"], {"units": "m"}),
        "gamma": ("state", noise["gamma"], _UNITS),
        "direction": (("beam", "axis"), np.array(geometry["direction"], dtype=np.float64)),
        "focus_distance": ("beam", np.array(geometry["focus_distance"], dtype=np.float64), {"units": "m"}),
        "beam_time": ("beam", np.array(geometry["beam_time"], dtype=np.float64), {"units": "s"}),
    }
    attributes = {
        "kind": FILE_KIND,
        "format_version": FILE_VERSION,
        "scan": noise["scan_name"],
        "scan_duration": float(geometry["scan_duration"]),
        "duration": float(noise["duration"]),
        "dissipation": flow.dissipation,
        "length_scale": flow.length_scale,
        "gamma": flow.gamma,
        "turbulence": flow.name,
        "turbulence_source": flow.source,
        "details": json.dumps(noise["details"], sort_keys=True),
        **({"probe": json.dumps(geometry["probe"], sort_keys=True)} if "probe" in geometry else {}),
    }
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)


def noise_fields(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the fields of a noise from its Dataset; also from one without ``state``, whose state is one.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `noise_dataset`, or read from a file.

    Returns
    -------
    fields : dict
        Arguments of `Noise`.

    Raises
    ------
    InputError
        If a number is not valid, or the methods of the states differ.
    KeyError
        If something is missing.
    """
    check_dataset(
        dataset,
        _LAYOUT,
        what="Its arrays",
        needs=(
            *_NEEDS,
            *(("covariance_upper", "gain_change") if "covariance_upper" in dataset else ("covariance", "gain")),
        ),
        attributes=_Attributes,
        optional_dim="state",
        advice=_ADVICE,
    )
    for name, own in (("other_beam", "beam"), ("other_stress", "stress")):
        if name in dataset.coords and dataset[name].values.tolist() != dataset[own].values.tolist():
            raise InputError(f"its {name} is not the same as its {own}: {_ADVICE}.")
    states = dataset if "state" in dataset.dims else dataset.expand_dims("state")
    attributes = states.attrs
    methods = {str(method) for method in states["method"].values}
    if len(methods) != 1:
        raise InputError(f"its states are by different methods, {', '.join(sorted(methods))}.")
    gain, covariance = _matrices(states)
    arrays = {"gain": gain, "covariance": covariance}
    arrays |= {name: states[name].values for name in _ARRAYS if name in states and name not in arrays}
    coordinates = {name: states[name].values for name in ("length_scale", "gamma") if name in states.coords}
    return {
        **arrays,
        **coordinates,
        "beam": states["beam"].values,
        "scan_name": str(attributes["scan"]),
        "scan_geometry": {
            "beam": states["beam"].values.tolist(),
            "direction": _per_beam(states["direction"]).tolist(),
            "focus_distance": _per_beam(states["focus_distance"]).tolist(),
            "beam_time": _per_beam(states["beam_time"]).tolist(),
            "scan_duration": float(attributes["scan_duration"]),
            **({"probe": json.loads(attributes["probe"])} if "probe" in attributes else {}),
        },
        "wind_speed": states["wind_speed"].values,
        "yaw": states["yaw"].values,
        "duration": float(attributes["duration"]),
        "turbulence": MannTurbulence(
            dissipation=float(attributes["dissipation"]),
            length_scale=float(attributes["length_scale"]),
            gamma=float(attributes["gamma"]),
            name=str(attributes["turbulence"]),
            source=str(attributes["turbulence_source"]),
        ),
        "method": methods.pop(),
        "n_realizations": states["n_realizations"].values,
        "details": _mapping(str(attributes["details"])),
        "state_details": [_mapping(str(states["details"].values[index])) for index in range(states.sizes["state"])],
    }


def _mapping(text: str) -> dict[str, Any]:
    """Return details from JSON; anything but a mapping is damage."""
    found: dict[str, Any] = read_json(dict[str, Any], text, what="Its details", advice=_ADVICE)
    return found


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
