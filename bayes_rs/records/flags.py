"""Flags of beams and records: bits, with their names, and how they are counted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.quality.samples import IntArray

BEAM_FLAGS = {
    "too_few_samples": 1,
    "constant": 2,
    "all_missing": 4,
    "no_samples": 8,
    "wind_sector": 16,
    "record_excluded": 32,
    "impossible": 64,
    "cut_off": 128,
}
RECORD_FLAGS = {"yaw_not_seen": 1, "wind_not_seen": 2, "beam_flagged": 4, "no_usable_beam": 8}
"""Flags of a record that the wind and its beams decide."""
REMARK_FLAGS = {"not_stationary": 16, "low_wind": 32, "spikes": 64}
"""Flags of a record that are remarks: it is fitted, unless the rules exclude it."""


def flag_attributes(flags: Mapping[str, int]) -> dict[str, Any]:
    """Return the attributes, by the CF conventions, of a variable that holds flags."""
    return {"flag_masks": np.array(list(flags.values()), dtype=np.uint8), "flag_meanings": " ".join(flags)}


def count_flags(
    flag: NDArray[np.uint8], meanings: Mapping[str, int], start: NDArray[np.datetime64], numbers: IntArray | None
) -> dict[str, dict[str, Any]]:
    """Count each flag, and say where it first stands."""
    counted: dict[str, dict[str, Any]] = {}
    for name, mask in meanings.items():
        where = np.argwhere(flag & mask)
        counted[name] = {"count": len(where), "of": int(flag.size)}
        if len(where):
            counted[name]["first_time"] = str(start[where[0][0]].astype("datetime64[s]")) + "Z"
            if numbers is not None:
                counted[name]["first_beam"] = int(numbers[where[0][1]])
    return counted
