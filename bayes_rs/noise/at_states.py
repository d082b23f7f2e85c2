"""The noise at given states of the flow: shipped, cached, or calculated and then cached."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayes_rs.errors import InputError
from bayes_rs.noise.box_noise import DEFAULT_SEED, Boxes, box_ingredients, noise_from_boxes
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.store import cache_folder, find_shipped_noise, from_cache, renamed, to_cache, with_details
from bayes_rs.processor import one_thread, processor_kind
from bayes_rs.progress import progress as progress_bar
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence

NOISE_VERSION = 7
"""Counts the changes of this module that change its numbers: noise that an older one cached is not used again."""

SONIC_VERSION = 1
"""The same for the moments with a sonic."""


def noise_at_states(
    states: Sequence[RecordState],
    turbulence: MannTurbulence,
    *,
    boxes: Boxes | None = None,
    cache: bool | str | Path = True,
    sonic: bool = False,
    progress: bool | None = None,
) -> Noise:
    """Return the noise of several states of one scan: shipped, cached, or calculated and then cached.

    Parameters
    ----------
    states : sequence of RecordState
        Mean winds, wind directions and record lengths, all of one scan.
    turbulence : MannTurbulence
        The turbulence.
    boxes : Boxes, optional
        How to simulate it; by theory if not given.
    cache, sonic, progress
        As for `calibrate`.

    Returns
    -------
    noise : Noise
        Its states are the ones given, in their order.

    Raises
    ------
    InputError
        If boxes are asked for with a sonic.
    MissingExtraError
        If boxes are needed and hipersim is not installed.
    """
    if sonic and boxes is not None:
        raise InputError(
            "Invalid method 'boxes' for noise with a sonic: only method='theory' has the joint moments of the "
            "beams and a sonic."
        )
    by_chance = boxes is not None and isinstance(boxes.seed, np.random.Generator)
    if cache is True and boxes is not None and not by_chance and boxes.seed == DEFAULT_SEED:
        shipped = [
            find_shipped_noise(state.scan, turbulence, state.wind_speed, state.duration, state.yaw, method="boxes")
            for state in states
        ]
        enough = [one for one in shipped if one is not None and one.details.get("n_boxes", 0) >= boxes.n_boxes]
        if len(enough) == len(states):
            return Noise.join(enough)

    def make() -> Noise:
        with one_thread():
            if boxes is None:
                return Noise.join(theory_at_states(states, turbulence, sonic=sonic, progress=progress))
            return Noise.join(noise_from_boxes(states, turbulence, boxes.n_boxes, boxes.seed, progress))

    if cache is False or by_chance:
        return with_details(make(), origin="calculated")
    key = noise_key(states, turbulence, boxes=boxes, sonic=sonic)
    file = cache_folder(cache) / f"{key}.nc"
    found, damage = from_cache(file, key)
    if found is not None:
        return renamed(found, states[0].scan, turbulence)
    noise = with_details(make(), key=key, origin="calculated")
    to_cache(noise, file)
    if damage is None:
        return noise
    return with_details(noise, cache=f"calculated again, because the cached file was damaged: {damage}")


def theory_at_states(
    states: Sequence[RecordState], turbulence: MannTurbulence, *, sonic: bool = False, progress: bool | None = None
) -> list[Noise]:
    """Return the noise of several states by theory; nothing is read from or written to a cache.

    Parameters
    ----------
    states, turbulence, sonic, progress
        As for `noise_at_states`.

    Returns
    -------
    noise : list of Noise
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


def noise_key(
    states: Sequence[RecordState], turbulence: MannTurbulence, *, boxes: Boxes | None = None, sonic: bool = False
) -> str:
    """Return the key of cached noise: 40 hexadecimal digits that change with everything the numbers depend on.

    Parameters
    ----------
    states : sequence of RecordState
        Scans, mean winds and record lengths.
    turbulence : MannTurbulence
        The turbulence; its name does not matter.
    boxes : Boxes, optional
        How it is simulated; by theory if not given.
    sonic : bool
        Whether the noise holds the moments with a sonic.

    Returns
    -------
    key : str
        First 40 digits of the SHA-256 of all of it, of the grid and the generator's version, and of `NOISE_VERSION`.
    """
    everything = {
        "noise_version": NOISE_VERSION,
        "processor": processor_kind(),
        "method": "theory" if boxes is None else "boxes",
        "states": [
            [state.scan.geometry(), round(state.wind_speed, 9), round(state.yaw, 9), round(state.duration, 9)]
            for state in states
        ],
        "turbulence": [turbulence.dissipation, turbulence.length_scale, turbulence.gamma],
        **({} if boxes is None else box_ingredients(states, turbulence, boxes)),
        **({"sonic": SONIC_VERSION} if sonic else {}),
    }
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:40]
