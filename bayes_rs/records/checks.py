"""Checks of whole records: which of them are remarked on, and the numbers behind it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.quality.filtering import Filtered
from bayes_rs.quality.periodicity import find_periodicity
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import BeamSamples, BoolArray
from bayes_rs.quality.sectors import in_sectors
from bayes_rs.quality.stationarity import beam_median, half_ratio, parts_of_records, share_between_parts, trend

BLADE_EVENTS = ("missing", "status", "cnr", "snr", "velocity", "hard_target", "blade")
"""Filters whose drops may be blades: what they have in common is a sample that is blocked, slow or too bright."""

_BOTH = ("record", "beam")


@dataclass(frozen=True)
class Remarks:
    """What the checks found.

    Parameters
    ----------
    records : dict of str to ndarray of bool, shape (n_record,)
        The records that each remark is about.
    variables : dict
        The numbers behind them, as variables of an xarray.Dataset.
    """

    records: dict[str, BoolArray] = field(default_factory=dict)
    variables: dict[str, Any] = field(default_factory=dict)


def check_records(
    samples: BeamSamples,
    keep: BoolArray,
    rules: QualityRules,
    *,
    window: int,
    used: BoolArray,
    wind_speed: FloatArray,
) -> Remarks:
    """Check records for stationarity and wind speed, as far as the rules ask for it.

    Parameters
    ----------
    samples : BeamSamples
        All samples.
    keep : ndarray of bool, shape (n_sample,)
        Which of them count.
    rules : QualityRules
        What to check.
    window : int
        Length of a record, ns.
    used : ndarray of bool, shape (n_record, n_beam)
        The beams without a flag.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed, m/s.

    Returns
    -------
    remarks : Remarks
        A record is remarked on by the median of its used beams, so that neither one bad beam nor the number of beams
        decides; a number that is not known says nothing.
    """
    not_stationary = np.zeros(samples.n_record, dtype=bool)
    variables: dict[str, Any] = {}
    if rules.trend_level is not None or rules.sub_variance_limit is not None:
        parts = parts_of_records(samples, keep, window=window, number=rules.sub_records)
        if rules.trend_level is not None:
            change, p_value = trend(parts)
            words = "change of the mean radial velocity over the record, by the line through the means of its parts"
            variables["trend"] = (_BOTH, change, {"units": "m s-1", "long_name": words})
            variables["trend_p_value"] = (_BOTH, p_value, {"long_name": "p-value of the trend"})
            not_stationary |= beam_median(p_value, used) < rules.trend_level
        if rules.sub_variance_limit is not None:
            share = share_between_parts(parts)
            variables["sub_variance"] = (
                _BOTH,
                share,
                {"long_name": "share of the variance between parts of the record"},
            )
            not_stationary |= beam_median(share, used) > rules.sub_variance_limit
    if rules.half_ratio_limit is not None:
        ratio = half_ratio(parts_of_records(samples, keep, window=window, number=2))
        variables["half_ratio"] = (_BOTH, ratio, {"long_name": "variance of the second half over that of the first"})
        with np.errstate(divide="ignore", invalid="ignore"):
            typical = np.abs(beam_median(np.log(ratio), used))
        not_stationary |= typical > np.log(rules.half_ratio_limit)
    remarks = {"not_stationary": not_stationary} if variables else {}
    if rules.min_wind_speed is not None:
        remarks["low_wind"] = wind_speed < rules.min_wind_speed
    return Remarks(remarks, variables)


def in_wind_sectors(yaw_deg: FloatArray, numbers: Any, rules: QualityRules) -> BoolArray:
    """Say which beams stand in a blocked wind sector, shape (n_record, n_beam)."""
    blocked = np.zeros((len(yaw_deg), len(numbers)), dtype=bool)
    for column, number in enumerate(np.asarray(numbers).tolist()):
        if number in rules.wind_sectors:
            blocked[:, column] = in_sectors(yaw_deg, rules.wind_sectors[number])
    return blocked


def blades_in(samples: BeamSamples, filtered: Filtered, rules: QualityRules) -> list[dict[str, Any]]:
    """Test beam by beam whether samples were dropped at the frequency of blades; empty if that is not asked for."""
    if rules.blade_frequency is None:
        return []
    event = np.zeros(len(samples.time), dtype=bool)
    for name in BLADE_EVENTS:
        event |= filtered.dropped_by(name)
    found = []
    for index, number in enumerate(samples.numbers.tolist()):
        own = samples.beam == index
        seconds = (samples.time[own] - samples.time[own][0]) * 1e-9
        result = find_periodicity(seconds, event[own], frequency_range=rules.blade_frequency)
        known = np.isfinite(result.p_value)
        found.append(
            {
                "beam": number,
                "events": result.n_event,
                "frequency": result.frequency if known else None,
                "p_value": result.p_value if known else None,
            }
        )
    return found
