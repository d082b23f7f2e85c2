"""What is wrong with a record, or remarkable: one bit for each, and their words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs.posteriors.sampling.chains import DRIFT_LIMIT, R_HAT_LIMIT

if TYPE_CHECKING:
    from bayes_rs.fits.batch import RecordDraws

FLAGS: dict[str, int] = {
    "no_usable_beam": 1,
    "no_wind": 2,
    "beam_left_out": 4,
    "yaw_not_seen": 8,
    "short_chain": 16,
    "ensembles_differ": 32,
    "weights_uneven": 64,
    "not_stationary": 256,
    "low_wind": 512,
    "likelihood_failed": 1024,
    "excluded": 2048,
    "outside_noise": 4096,
    "cut_off": 65536,
    "noise_above_variance": 131072,
    "beams_disagree": 16384,
    "unsteady": 8192,
    "other_length_scale": 32768,
    "spikes": 262144,
}
"""Bits of a record's flag."""

UNFITTED = (
    FLAGS["no_usable_beam"] | FLAGS["no_wind"] | FLAGS["likelihood_failed"] | FLAGS["excluded"] | FLAGS["cut_off"]
)
"""Flags of a record that was not fitted."""

FLAG_MEANINGS = {
    "no_usable_beam": "every beam is flagged or has no variance; not fitted",
    "no_wind": "no wind speed or direction; not fitted",
    "beam_left_out": "at least one beam is not used",
    "yaw_not_seen": "the beams cannot tell the wind direction; that of the scan is used",
    "short_chain": "some stress has fewer effective draws, or a number a larger Monte-Carlo error, than asked for",
    "ensembles_differ": "R-hat above its limit: the ensembles do not agree",
    "weights_uneven": "Pareto k above its limit, or few proposals accepted: the weights of the draws are too uneven",
    "not_stationary": "the record has a trend, or its parts differ",
    "low_wind": "the mean wind is below the limit of the record checks",
    "excluded": "taken out by a rule of quality; not fitted",
    "likelihood_failed": "the likelihood could not be calculated; not fitted",
    "outside_noise": "the noise is of another wind or turbulence than the record's: its intervals may be too narrow or "
    "too wide",
    "cut_off": "the data begin or end within the record, so that no beam has enough samples; not fitted",
    "noise_above_variance": "the instrument's noise that was given is above the variance of every beam: nothing is "
    "left for the wind",
    "beams_disagree": "beams disagree with each other by more than any flow explains",
    "spikes": "samples far outside the others of their beam, as of low CNR, raise the variances",
    "unsteady": "the wind changes as by a front or a trend, which adds to the stresses",
    "other_length_scale": "the noise was made for another length scale than the record's spectra say: its intervals "
    "may be too narrow or too wide",
}
"""What each flag means, in short; docs/diagnostics.md says what to do."""
FAILURES = (
    FLAGS["no_usable_beam"]
    | FLAGS["no_wind"]
    | FLAGS["short_chain"]
    | FLAGS["ensembles_differ"]
    | FLAGS["weights_uneven"]
    | FLAGS["likelihood_failed"]
)
"""Flags that count as a failure of a record; the others are remarks."""


def flag_words(flag: int) -> str:
    """Return a record's flag in words, joined by semicolons; empty if nothing is wrong.

    Parameters
    ----------
    flag : int
        Bit mask from ``sample_stats/flag`` of a fit.

    Returns
    -------
    words : str
        Names of the bits that are set, as in `FLAGS`.

    Examples
    --------
    >>> flag_words(20)
    'beam_left_out;short_chain'
    """
    return ";".join(word for word, bit in FLAGS.items() if int(flag) & bit)


def flags_before(records: xr.Dataset, usable: NDArray[np.bool_], fitted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what the records themselves say, as one bit mask for each; the bits are in `FLAGS`."""
    flag = np.zeros(len(usable), dtype=np.int64)
    excluded = ~usable.any(axis=1) & _has(records, "record_excluded").any(axis=1)
    cut_off = ~usable.any(axis=1) & ~excluded & _has(records, "cut_off").all(axis=1)
    flag[excluded] |= FLAGS["excluded"]
    flag[cut_off] |= FLAGS["cut_off"]
    flag[~usable.any(axis=1) & ~excluded & ~cut_off] |= FLAGS["no_usable_beam"]
    flag[usable.any(axis=1) & ~usable.all(axis=1)] |= FLAGS["beam_left_out"]
    unfitted = np.setdiff1d(np.flatnonzero(usable.any(axis=1)), fitted)
    flag[unfitted] |= FLAGS["no_wind"]
    if "other_length_scale" in records:
        flag[records["other_length_scale"].values != 0] |= FLAGS["other_length_scale"]
    if "record_flag" in records:
        meanings = str(records["record_flag"].attrs.get("flag_meanings", "")).split()
        masks = np.atleast_1d(records["record_flag"].attrs.get("flag_masks", []))
        for meaning, mask in zip(meanings, masks, strict=True):
            if meaning in ("yaw_not_seen", "not_stationary", "low_wind", "spikes"):
                flag[(records["record_flag"].values & mask) != 0] |= FLAGS[meaning]
    if "unsteady" in records:
        flag[records["unsteady"].values != 0] |= FLAGS["unsteady"]
    return flag


def _has(records: xr.Dataset, meaning: str) -> NDArray[np.bool_]:
    """Say which beams of which records have a flag, (record, beam); none if the records do not know it."""
    if "flag" not in records:
        return np.zeros(records["variance"].shape, dtype=np.bool_)
    meanings = str(records["flag"].attrs.get("flag_meanings", "")).split()
    masks = dict(zip(meanings, np.atleast_1d(records["flag"].attrs.get("flag_masks", [])).tolist(), strict=True))
    return np.asarray((records["flag"].values & masks.get(meaning, 0)) != 0)


def flags_after(draws: RecordDraws, target_ess: int) -> NDArray[np.int64]:
    """Return what the draws of fitted records say, as one bit mask for each."""
    chains = draws.chains
    flag = np.zeros(len(chains.stress), dtype=np.int64)
    flag[~(chains.ess_bulk.min(axis=1) >= target_ess)] |= FLAGS["short_chain"]
    flag[~(chains.r_hat.max(axis=1) <= R_HAT_LIMIT) | (chains.drift > DRIFT_LIMIT)] |= FLAGS["ensembles_differ"]
    flag[chains.uneven()] |= FLAGS["weights_uneven"]
    flag[draws.outside] |= FLAGS["outside_noise"]
    return flag
