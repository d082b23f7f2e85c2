"""Calibration: the noise model of a scan, a record length, a mean wind and a turbulence; computed once, then cached."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, overload

import numpy as np

from bayes_rs._validation import check_count, check_finite
from bayes_rs.calibration.box_noise import box_ingredients, noise_from_boxes
from bayes_rs.calibration.store import cache_folder, find_shipped_noise, from_cache, renamed, to_cache
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.model import Noise, NoiseBank, NoiseModel
from bayes_rs.noise.theory import theory_noise
from bayes_rs.progress import progress as progress_bar
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence

NOISE_VERSION = 1
"""Counts the changes of this module that change its numbers: noise that an older one cached is not used again."""

SONIC_VERSION = 1
"""The same for the moments with a sonic."""

DEFAULT_SEED = 1
"""Seed of the shipped noise, and the default of `calibrate`."""


@overload
def calibrate(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float,
    duration: float = 600.0,
    yaw_deg: float | None = None,
    method: str = "theory",
    n_boxes: int = 100,
    seed: int | np.random.Generator = DEFAULT_SEED,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> NoiseModel: ...


@overload
def calibrate(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: Sequence[float],
    duration: float = 600.0,
    yaw_deg: float | Sequence[float] | None = None,
    method: str = "theory",
    n_boxes: int = 100,
    seed: int | np.random.Generator = DEFAULT_SEED,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> NoiseBank: ...


@overload
def calibrate(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float | Sequence[float],
    duration: float = 600.0,
    yaw_deg: Sequence[float],
    method: str = "theory",
    n_boxes: int = 100,
    seed: int | np.random.Generator = DEFAULT_SEED,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> NoiseBank: ...


def calibrate(
    scan: Scan,
    turbulence: MannTurbulence,
    *,
    wind_speed: float | Sequence[float],
    duration: float = 600.0,
    yaw_deg: float | Sequence[float] | None = None,
    method: str = "theory",
    n_boxes: int = 100,
    seed: int | np.random.Generator = DEFAULT_SEED,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> Noise:
    """Calibrate the noise of a scan's beam variances.

    Parameters
    ----------
    scan : Scan
        The scan.
    turbulence : MannTurbulence
        The turbulence.
    wind_speed : float or sequence of float
        Mean wind speed, m/s; several make a bank.
    duration : float
        Length of a record, s.
    yaw_deg : float or sequence of float, optional
        Wind direction relative to the lidar axis, degrees; several make a bank. By default the scan's own yaw.
    method : str
        ``"theory"``: `theory_noise`, exact for frozen Gaussian turbulence in an infinite domain. ``"boxes"``: a virtual
        lidar in boxes of Mann turbulence, which needs the extra ``boxes`` unless the noise is shipped or cached.
    n_boxes : int
        Number of boxes.
    seed : int or numpy.random.Generator
        Same seed, same numbers. Nothing is cached with a Generator.
    cache : bool, str or Path
        True to use the shipped noise and the user's cache folder, False for neither, or another folder for the cache.
    sonic : bool
        Add the joint moments with the stresses of a sonic at the rotor's centre, which the target ``"sonic"`` of `fit`
        needs; by theory only.
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.

    Returns
    -------
    noise : NoiseModel or NoiseBank
        One model for one state; a bank, wind speeds first, if `wind_speed` or `yaw_deg` is a sequence.

    Raises
    ------
    InputError
        If a number is not valid, or the method is unknown.
    MissingExtraError
        If boxes are needed and hipersim is not installed.

    Notes
    -----
    From boxes, K_ab = ⟨(y_a/E_a − 1)(y_b/E_b − 1)⟩ over all records of all boxes, with the expectations E of the boxes
    known exactly from their spectrum; the mean is therefore not estimated, and nothing has to be subtracted for it. The
    records of a box are not independent, so the standard error comes from the scatter between boxes, and
    ``n_realizations`` is the number of independent records that would give that standard error.

    ``bias`` refers to the boxes' own tensor (`BoxMaker.tensor`, about zero, no mean removed), which lacks the eddies
    longer than the box: at the seed's flow and 600 s it is −0.10 for u where an infinite domain gives −0.12.

    Shipped noise is used with ``cache=True`` and the default seed, if it was made with at least `n_boxes` boxes. The
    cache is in the folder that the environment variable ``BAYES_RS_CACHE`` names, or in ``bayes_rs`` under
    ``XDG_CACHE_HOME`` or under ``~/.cache``. Its key contains everything that the numbers depend on; a damaged file is
    computed again.

    What a box leaves out: eddies longer than the box or smaller than its grid, and the fine structure of the spectrum
    at wave lengths of its width. At the seed's flow, the relative standard deviation of the along-wind variance is
    0.266 in the boxes and 0.2585 in an infinite domain.

    Examples
    --------
    >>> from bayes_rs import load_scan, load_turbulence
    >>> noise = calibrate(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0)
    >>> bool(0.2 < noise.relative_error[0] < 0.3)
    True
    """
    states = _states(scan, wind_speed, yaw_deg, duration)
    models = noise_at_states(
        states, turbulence, method=method, n_boxes=n_boxes, seed=seed, cache=cache, sonic=sonic, progress=progress
    )
    is_bank = any(np.ndim(value) > 0 for value in (wind_speed, yaw_deg) if value is not None)
    return NoiseBank(tuple(models)) if is_bank else models[0]


def noise_at_states(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    *,
    method: str = "theory",
    n_boxes: int = 100,
    seed: int | np.random.Generator = DEFAULT_SEED,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> list[NoiseModel]:
    """Return the noise of several states of one scan: shipped, cached, or calculated and then cached.

    Parameters
    ----------
    states : sequence of RecordState
        Mean winds, wind directions and record lengths, all of one scan.
    turbulence, method, n_boxes, seed, cache, sonic, progress
        As for `calibrate`.

    Returns
    -------
    models : list of NoiseModel
        One for each state, in their order.

    Raises
    ------
    InputError
        If the method is unknown or a number is not valid, or boxes are asked for with a sonic.
    MissingExtraError
        If boxes are needed and hipersim is not installed.
    """
    if method not in METHODS:
        raise InputError(f"Unknown method of calibration {method!r}: it must be one of {', '.join(METHODS)}.")
    if sonic and method != "theory":
        raise InputError(
            f"Invalid method {method!r} for noise with a sonic: only method='theory' has the joint moments of the "
            "beams and a sonic."
        )
    check_count(n_boxes, what="n_boxes", minimum=2)
    if cache is True and method == "boxes" and not isinstance(seed, np.random.Generator) and seed == DEFAULT_SEED:
        shipped = [
            find_shipped_noise(state.scan, turbulence, state.wind_speed, state.duration, state.yaw, method="boxes")
            for state in states
        ]
        enough = [
            model for model in shipped if isinstance(model, NoiseModel) and model.details.get("n_boxes", 0) >= n_boxes
        ]
        if len(enough) == len(states):
            return enough

    def make() -> list[NoiseModel]:
        if sonic:
            return theory_at_states(states, turbulence, sonic=True, progress=progress)
        return METHODS[method].make(states, turbulence, n_boxes, seed, progress)

    if cache is False or isinstance(seed, np.random.Generator):
        return make()
    key = noise_key(states, turbulence, method=method, n_boxes=n_boxes, seed=seed, sonic=sonic)
    file = cache_folder(cache) / f"{key}.nc"
    found, damage = from_cache(file, key)
    if found is not None:
        found = renamed(found, states[0].scan, turbulence)
        return list(found.models) if isinstance(found, NoiseBank) else [found]
    made = make()
    made = [replace(model, details={**model.details, "key": key}) for model in made]
    to_cache(NoiseBank(tuple(made)), file)
    if damage is not None:
        note = f"calculated again, because the cached file was damaged: {damage}"
        made = [replace(model, details={**model.details, "cache": note}) for model in made]
    return made


@dataclass(frozen=True)
class Method:
    """One way to calibrate.

    Parameters
    ----------
    make : callable
        (states, turbulence, n_boxes, seed, progress) → list of NoiseModel, one for each state.
    ingredients : callable
        (states, turbulence, n_boxes, seed) → mapping of plain JSON values: what the numbers depend on beside the states
        and the turbulence.
    """

    make: Callable[
        [Sequence[RecordState], MannTurbulence, int, int | np.random.Generator, bool | None], list[NoiseModel]
    ]
    ingredients: Callable[[Sequence[RecordState], MannTurbulence, int, int], Mapping[str, Any]]


def theory_at_states(
    states: Sequence[RecordState], turbulence: MannTurbulence, *, sonic: bool = False, progress: bool | None = None
) -> list[NoiseModel]:
    """Return the noise of several states by theory; nothing is read from or written to a cache.

    Parameters
    ----------
    states, turbulence, sonic, progress
        As for `noise_at_states`.

    Returns
    -------
    models : list of NoiseModel
        One for each state, in their order.
    """
    bar = progress_bar(states, len(states), "noise", disable=None if progress is None else not progress)
    return [
        theory_noise(
            state.scan,
            turbulence,
            wind_speed=state.wind_speed,
            duration=state.duration,
            yaw=state.yaw,
            sonic=sonic,
        )
        for state in bar
    ]


def _from_theory(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    n_boxes: int,  # noqa: ARG001 - theory has neither boxes nor chance
    seed: int | np.random.Generator,  # noqa: ARG001 - as above
    progress: bool | None,
) -> list[NoiseModel]:
    return theory_at_states(states, turbulence, progress=progress)


METHODS: dict[str, Method] = {
    "theory": Method(_from_theory, lambda *_: {}),
    "boxes": Method(noise_from_boxes, box_ingredients),
}
"""Ways to calibrate, by name."""


def noise_key(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    *,
    method: str,
    n_boxes: int,
    seed: int,
    sonic: bool = False,
) -> str:
    """Return the key of cached noise: 40 hexadecimal digits that change with everything the numbers depend on.

    Parameters
    ----------
    states : sequence of RecordState
        Scans, mean winds and record lengths.
    turbulence : MannTurbulence
        The turbulence; its name does not matter.
    method : str
        Name of the method.
    n_boxes : int
        Number of boxes.
    seed : int
        Seed.
    sonic : bool
        Whether the noise holds the moments with a sonic.

    Returns
    -------
    key : str
        First 40 digits of the SHA-256 of all of it, of the grid and the generator's version, and of `NOISE_VERSION`.
    """
    everything = {
        "noise_version": NOISE_VERSION,
        "method": method,
        "states": [
            [state.scan.geometry(), round(state.wind_speed, 9), round(state.yaw, 9), round(state.duration, 9)]
            for state in states
        ],
        "turbulence": [turbulence.dissipation, turbulence.length_scale, turbulence.gamma],
        **METHODS[method].ingredients(states, turbulence, n_boxes, seed),
        **({"sonic": SONIC_VERSION} if sonic else {}),
    }
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:40]


def _states(
    scan: Scan, wind_speed: float | Sequence[float], yaw_deg: float | Sequence[float] | None, duration: float
) -> list[RecordState]:
    speeds = np.atleast_1d(np.asarray(wind_speed, dtype=np.float64))
    yaws = np.array([scan.yaw]) if yaw_deg is None else np.deg2rad(np.atleast_1d(np.asarray(yaw_deg, dtype=np.float64)))
    if speeds.ndim != 1 or yaws.ndim != 1 or len(speeds) == 0 or len(yaws) == 0:
        raise InputError(
            f"Invalid wind_speed {wind_speed!r} or yaw_deg {yaw_deg!r}: give a number or a sequence of numbers."
        )
    for yaw in yaws:
        check_finite(yaw, what="yaw", unit="rad", where="calibrate")
    return [RecordState(scan, float(speed), float(yaw), float(duration)) for speed, yaw in product(speeds, yaws)]
