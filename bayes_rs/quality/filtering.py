"""The filters on samples in their order, each of which says how many it dropped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.quality.belief import is_impossible
from bayes_rs.quality.blades import is_blade_passage
from bayes_rs.quality.frozen import is_frozen
from bayes_rs.quality.rules import QualityRules, Window
from bayes_rs.quality.samples import BeamSamples, BoolArray
from bayes_rs.quality.sectors import in_sectors
from bayes_rs.quality.spikes import is_spike

ALWAYS_LISTED = ("missing", "status", "cnr", "despike")
"""Filters that reports name even when they are off."""

_ONLY_IF_SOME = "impossible"
"""The filter that is always on, and is named only where it drops something."""

Filter = Callable[[BoolArray], BoolArray]
"""From the samples that are still there to those that pass; what it says of the others does not count."""


@dataclass(frozen=True)
class Filtered:
    """What became of each sample.

    Parameters
    ----------
    names : tuple of str
        The filters that were on, in their order.
    cause : ndarray of int, shape (n_sample,)
        Place in `names` of the first filter that dropped the sample; −1 if none did.
    """

    names: tuple[str, ...]
    cause: NDArray[np.int8]

    @property
    def keep(self) -> BoolArray:
        """Which samples count."""
        return np.asarray(self.cause < 0)

    def dropped_by(self, name: str) -> BoolArray:
        """Say which samples the filter dropped: none if it was off."""
        if name not in self.names:
            return np.zeros(len(self.cause), dtype=bool)
        return np.asarray(self.cause == self.names.index(name))

    def counts(self) -> dict[str, int]:
        """Return how many samples each filter dropped: those that were on, and `ALWAYS_LISTED`."""
        listed = (*self.names, *(name for name in ALWAYS_LISTED if name not in self.names))
        number = {name: int(np.count_nonzero(self.dropped_by(name))) for name in listed}
        return {name: count for name, count in number.items() if count or name != _ONLY_IF_SOME}


def apply_filters(samples: BeamSamples, rules: QualityRules) -> Filtered:
    """Apply all filters that the rules switch on; a sample counts for the first that drops it.

    Parameters
    ----------
    samples : BeamSamples
        The samples, with the columns that the rules need (`QualityRules.needed_columns`).
    rules : QualityRules
        What the filters ask for.

    Returns
    -------
    filtered : Filtered
        What became of each sample.
    """
    chosen = _filters(samples, rules)
    cause = np.full(len(samples.velocity), -1, dtype=np.int8)
    for index, (_, passes) in enumerate(chosen):
        there = cause < 0
        cause[there & ~passes(there)] = index
    return Filtered(tuple(name for name, _ in chosen), cause)


def _filters(samples: BeamSamples, rules: QualityRules) -> list[tuple[str, Filter]]:
    """Return the filters that are on, by name, in their order: what the instrument says, then what its data say."""
    column = samples.columns
    chosen: list[tuple[str, Filter]] = [("missing", lambda _: np.isfinite(samples.velocity))]
    if "status" in column and (rules.status_valid is not None or rules.status_reject_bits is not None):
        chosen.append(("status", lambda _: _status_passes(column["status"], rules)))
    chosen += [(f"mask_{name}", partial(_mask_passes, column[name])) for name in rules.masks]
    for name, values, window in (
        ("cnr", column.get("cnr"), rules.cnr_range),
        ("snr", column.get("snr"), rules.snr_range),
        ("velocity", samples.velocity, rules.velocity_range),
    ):
        if window is not None and values is not None:
            chosen.append((name, partial(_window_passes, values, samples, window)))
    impossible = is_impossible(samples.velocity, samples.velocity_limit)
    if impossible.any():
        chosen.append(("impossible", lambda _: ~impossible))
    if rules.hard_target_cnr is not None:
        low, slow = rules.hard_target_cnr, rules.hard_target_speed
        chosen.append(("hard_target", lambda _: ~((column["cnr"] >= low) & (np.abs(samples.velocity) <= slow))))
    chosen += [
        (f"sector_{name}", partial(_sector_passes, column[name], sectors))
        for name, sectors in rules.blocked_sectors.items()
    ]
    if rules.frozen_run is not None:
        run = rules.frozen_run
        chosen.append(("frozen", lambda there: ~is_frozen(samples.velocity, samples.group, there, run=run)))
    if rules.blade_threshold is not None:
        options = {"window": rules.blade_window, "threshold": rules.blade_threshold}
        chosen.append(("blade", partial(_sequence_passes, samples, is_blade_passage, options)))
    if rules.despike == "median":
        options = {"window": rules.despike_window, "threshold": rules.despike_threshold}
        chosen.append(("despike", partial(_sequence_passes, samples, is_spike, options)))
    return chosen


def _status_passes(status: FloatArray, rules: QualityRules) -> BoolArray:
    passes = np.isfinite(status)  # an unknown status does not pass
    if rules.status_valid is not None:
        passes &= np.isin(status, np.atleast_1d(rules.status_valid))
    if rules.status_reject_bits is not None:
        passes &= (np.where(passes, status, 0.0).astype(np.int64) & rules.status_reject_bits) == 0
    return np.asarray(passes)


def _mask_passes(mask: FloatArray, _: BoolArray) -> BoolArray:
    return np.asarray(mask == 0.0)  # an unknown mask does not pass


def _window_passes(values: FloatArray, samples: BeamSamples, window: Window, _: BoolArray) -> BoolArray:
    if isinstance(window, tuple):
        return np.asarray((values >= window[0]) & (values <= window[1]))  # an unknown value does not pass
    pairs = [window.get(number, (-np.inf, np.inf)) for number in samples.numbers.tolist()]
    low, high = np.array(pairs).T
    named = np.isin(samples.numbers, list(window))[samples.beam]
    return np.asarray(~named | ((values >= low[samples.beam]) & (values <= high[samples.beam])))


def _sector_passes(angle_deg: FloatArray, sectors: Any, _: BoolArray) -> BoolArray:
    return np.asarray(np.isfinite(angle_deg) & ~in_sectors(angle_deg, sectors))  # an unknown angle does not pass


def _sequence_passes(
    samples: BeamSamples, is_bad: Callable[..., BoolArray], options: dict[str, Any], there: BoolArray
) -> BoolArray:
    """Apply a rule on the sequence of the samples that are still there."""
    passes = there.copy()
    passes[there] = ~is_bad(samples.velocity[there], samples.group[there], **options)
    return passes
