"""What the fields of a noise must be: shapes along states and beams, finite numbers, covariances that are some."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array, check_choice, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise_geometry import check_geometry

NOISE_METHODS: tuple[str, ...] = ("boxes", "theory", "given")
"""Where the numbers of a noise can come from."""

_N_STRESS = len(STRESSES)
_CAN_BE = (("bias", -1.0, 10.0), ("gain", -10.0, 10.0))
"""What holds of any lidar, with room: a variance is not below zero, and a beam's direction is a unit vector."""
_MOST_VARIANCE = 100.0
"""Relative variance of an estimated variance, likewise: one independent Gaussian value has 2."""


def checked_fields(noise: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a noise, checked: read-only arrays with the states as first axis, and plain JSON values.

    Parameters
    ----------
    noise : mapping
        What `Noise` was given; arrays of one state may lack the axis of the states.

    Returns
    -------
    fields : dict
        All but those that are taken as they are.

    Raises
    ------
    InputError
        If one is not valid.
    NotPositiveDefiniteError
        If a covariance has an eigenvalue that is negative by more than rounding.
    """
    where = f"noise of scan {noise['scan_name']!r}"
    beam = np.array(noise["beam"], dtype=np.int64)
    if beam.ndim != 1 or len(beam) == 0:
        raise InputError(f"Invalid beam of shape {beam.shape} in {where}: one number for each beam, at least one.")
    geometry = check_geometry(noise["scan_geometry"], beam, where)
    check_choice(noise["method"], NOISE_METHODS, what="method of a noise")
    check_positive(noise["duration"], what="duration", unit="s", where=where)
    coordinates = _coordinates(noise, where)
    n_state = len(coordinates["wind_speed"])
    arrays = {**_arrays(noise, n_state, len(beam), where), **coordinates, "beam": beam}
    own = tuple(_plain(one, where) for one in noise["state_details"])
    if len(own) not in (0, n_state):
        raise InputError(
            f"Invalid state_details in {where}: {len(own)} for {n_state} states; give one for each, or none."
        )
    return {
        **{name: _frozen(array) for name, array in arrays.items()},
        "scan_geometry": geometry,
        "details": _plain(noise["details"], where),
        "state_details": own if any(own) else (),
    }


def _arrays(noise: Mapping[str, Any], n_state: int, n_beam: int, where: str) -> dict[str, FloatArray]:
    """Return the arrays along the states."""
    shapes = {
        "bias": (n_beam,),
        "gain": (n_beam, _N_STRESS),
        "covariance": (n_beam, n_beam),
        "standard_error": (n_beam, n_beam),
        "sonic_covariance": (_N_STRESS, _N_STRESS),
        "sonic_beam_covariance": (_N_STRESS, n_beam),
    }
    given = {name: noise[name] for name in shapes if noise[name] is not None}
    if ("sonic_covariance" in given) != ("sonic_beam_covariance" in given):
        raise InputError(
            f"Invalid moments with a sonic in {where}: give both, sonic_covariance and sonic_beam_covariance, or none."
        )
    arrays = {
        name: _with_states(values, n_state, shapes[name], what=f"{name} in {where}") for name, values in given.items()
    }
    for name, least, most in _CAN_BE:
        _check_range(arrays[name], least, most, what=f"{name} in {where}")
    for matrix in arrays["covariance"]:
        _check_covariance(matrix, where)
    variance = np.einsum("saa->sa", arrays["covariance"])
    _check_range(variance, 0.0, _MOST_VARIANCE, what=f"variance on the diagonal of the covariance in {where}")
    for matrix in arrays.get("sonic_covariance", ()):
        _check_covariance(matrix, f"sonic_covariance in {where}")
    return arrays


def _check_range(values: FloatArray, least: float, most: float, *, what: str) -> None:
    outside = (values < least) | (values > most)
    if outside.any():
        raise InputError(
            f"Invalid {what}: {values[outside][0]:g}, and it must be between {least:g} and {most:g}; check the numbers "
            "given."
        )


def _coordinates(noise: Mapping[str, Any], where: str) -> dict[str, FloatArray]:
    """Return wind speed, yaw, L, Γ and the number of realizations of each state."""
    n_state = len(np.atleast_1d(noise["wind_speed"]))
    if n_state == 0:
        raise InputError(f"Invalid wind_speed in {where}: it needs at least one state.")
    found = {name: noise[name] for name in ("wind_speed", "yaw")}
    for name in ("length_scale", "gamma"):
        found[name] = getattr(noise["turbulence"], name) if noise[name] is None else noise[name]
    found = {
        name: check_array(_for_each(values, n_state), (n_state,), what=f"{name} in {where}")
        for name, values in found.items()
    }
    check_positive(float(np.min(found["wind_speed"])), what="wind_speed", unit="m/s", where=where)
    check_positive(float(np.min(found["length_scale"])), what="length_scale", unit="m", where=where)
    for name in ("length_scale", "gamma"):
        own, first = getattr(noise["turbulence"], name), found[name][0]
        if own != first:
            raise InputError(
                f"Invalid turbulence in {where}: its {name} is {own:g} and that of the first state is {first:g}."
            )
    realizations = np.array(_for_each(noise["n_realizations"], n_state), dtype=np.float64)
    if realizations.shape != (n_state,) or not np.all(realizations > 0.0):
        raise InputError(f"Invalid n_realizations {noise['n_realizations']!r} in {where}: it must be above zero.")
    return {**found, "n_realizations": realizations}


def _frozen(array: Any) -> Any:
    frozen = array.copy()
    frozen.flags.writeable = False
    return frozen


def _with_states(values: ArrayLike, n_state: int, shape: tuple[int, ...], *, what: str) -> FloatArray:
    """Check an array with one entry for each state; that of one state may be without the axis."""
    array = np.asarray(values, dtype=np.float64)
    if n_state == 1 and array.ndim == len(shape):
        array = check_array(array, shape, what=what)[np.newaxis]
    return check_array(array, (n_state, *shape), what=what)


def _for_each(values: ArrayLike, n_state: int) -> Any:
    return np.full(n_state, values) if np.ndim(values) == 0 else values


def _plain(details: Mapping[str, Any], where: str) -> dict[str, Any]:
    try:
        return dict(json.loads(json.dumps(dict(details))))
    except TypeError as error:
        raise InputError(f"Invalid details in {where}: {error}, and they must be plain JSON values.") from error


def _check_covariance(covariance: FloatArray, where: str) -> None:
    size = float(np.max(np.abs(covariance)))
    asymmetry = np.abs(covariance - covariance.T)
    if np.any(asymmetry > 1e-12 * size):
        first = tuple(int(i) for i in np.argwhere(asymmetry > 1e-12 * size)[0])
        raise InputError(
            f"Invalid covariance in {where}: the entry at {first} is {covariance[first]:g} and its mirror image is "
            f"{covariance.T[first]:g}, and the matrix must be symmetric."
        )
    eigenvalues = np.linalg.eigvalsh(covariance)
    if eigenvalues[0] < -64.0 * len(covariance) * np.finfo(np.float64).eps * size:
        raise NotPositiveDefiniteError(
            f"Invalid covariance in {where}: its smallest eigenvalue is {eigenvalues[0]:g}, and a covariance has none "
            "below zero; check the numbers given.",
            smallest_eigenvalue=float(eigenvalues[0]),
        )
