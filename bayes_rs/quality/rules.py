"""The rules of quality: one frozen object that says what every filter and every check asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_rs._validation import as_number, check_choice, check_count, check_finite, check_positive
from bayes_rs.errors import InputError, in_short
from bayes_rs.options import described, option
from bayes_rs.quality.sectors import Sector

DESPIKE_RULES = ("median",)
REMARKS = ("not_stationary", "low_wind")
"""Flags of records that the checks set, and that `exclude` can name."""
_REMARKED_BY = {
    "not_stationary": ("trend_level", "sub_variance_limit", "half_ratio_limit"),
    "low_wind": ("min_wind_speed",),
}
"""The rules that set a remark: at least one of them must be given before it can exclude."""
_PART_OF = {
    "hard_target_speed": ("hard_target_cnr",),
    "blade_window": ("blade_threshold",),
    "despike_window": ("despike",),
    "despike_threshold": ("despike",),
    "sub_records": ("trend_level", "sub_variance_limit"),
}
"""The rules that a number is part of; without one of them it does nothing."""

Pair = tuple[float, float]
Window = Pair | Mapping[int, Pair]


@described
@dataclass(frozen=True, kw_only=True)
class QualityRules:
    """Which samples count, and which records are remarked on; every rule is off unless it is given.

    Raises
    ------
    InputError
        If a value is not valid.

    Notes
    -----
    A range of carrier-to-noise ratios, signal-to-noise ratios or velocities is of all beams, or a mapping from the
    numbers of some beams to their ranges. Sectors run upwards from first to last, ends included:
    ``{"rotor_angle": [(350, 10)]}`` is 20 degrees wide. The formulas, and what each rule does to sound data,
    are in ``docs/quality.md``.

    Examples
    --------
    >>> rules = QualityRules(cnr_range=(-23.0, 0.0), despike="median", frozen_run=5)
    >>> rules.needed_columns()
    {'cnr': 'cnr_range (-23.0, 0.0) dB'}
    """

    status_valid: float | Sequence[float] | None = option(
        None, "Statuses of a good sample; by default the one that the series was read with", flag=""
    )
    status_reject_bits: int | None = option(None, "Bits of the status of which a good sample has none", flag="")
    masks: Sequence[str] = option(
        (), "Variables of the series over its samples, as rain: any value but zero marks a bad sample", flag=""
    )
    cnr_range: tuple[float, float] | Mapping[int, tuple[float, float]] | None = option(
        None, "Lowest and highest carrier-to-noise ratio of a good sample", unit="dB", metavar="LOW HIGH"
    )
    snr_range: tuple[float, float] | Mapping[int, tuple[float, float]] | None = option(
        None, "Lowest and highest signal-to-noise ratio of a good sample", unit="dB", flag="", metavar="LOW HIGH"
    )
    velocity_range: tuple[float, float] | Mapping[int, tuple[float, float]] | None = option(
        None, "Lowest and highest radial velocity of a good sample, positive away", unit="m/s", metavar="LOW HIGH"
    )
    hard_target_cnr: float | None = option(
        None, "Carrier-to-noise ratio from which on a sample that hardly moves is taken for a hard target", unit="dB"
    )
    hard_target_speed: float = option(0.5, "Largest radial speed of a hard target", unit="m/s", flag="")
    blocked_sectors: Mapping[str, Sequence[tuple[float, float]]] = option(
        {}, "Sectors without a free sight, of variables of the series as rotor_angle", unit="degrees", flag=""
    )
    frozen_run: int | None = option(None, "Drop runs of at least this many equal values")
    blade_threshold: float | None = option(
        None, "Drop samples that lie this many robust standard deviations towards zero from the running median"
    )
    blade_window: int = option(11, "Samples in that running median, odd", flag="")
    blade_frequency: tuple[float, float] | None = option(
        None,
        "Lowest and highest frequency at which to look for blades among what was dropped, for the report",
        unit="Hz",
        metavar="LOW HIGH",
    )
    despike: str | None = option(
        None, "Rule that drops spikes on both sides; see the Notes of make_records", choices=DESPIKE_RULES
    )
    despike_window: int = option(11, "Samples in its running median, odd", flag="")
    despike_threshold: float = option(
        5.0, "Robust standard deviations from the running median beyond which a sample is a spike", flag=""
    )
    wind_sectors: Mapping[int, Sequence[tuple[float, float]]] = option(
        {},
        "By beam number, the directions of the records' wind (yaw) in which a beam is not used, as in a mast's wake",
        unit="degrees",
        flag="",
    )
    sub_records: int = option(6, "Parts of a record for the checks on stationarity", flag="")
    trend_level: float | None = option(
        None, "Level of the test for a trend, as 0.01; a record that fails it is remarked on"
    )
    sub_variance_limit: float | None = option(
        None, "Largest share of a record's variance that may lie between its parts, as 0.3"
    )
    half_ratio_limit: float | None = option(None, "Largest ratio between the variances of a record's halves, as 4")
    min_wind_speed: float | None = option(None, "Mean wind speed below which a record is remarked on", unit="m/s")
    exclude: Sequence[str] = option(
        (),
        "Remarks that take a record out of the fit; it stays in the records, with all its beams flagged",
        choices=REMARKS,
    )

    def __post_init__(self) -> None:
        """Check the options, and bring them into one form."""

        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        for name in ("blocked_sectors", "wind_sectors"):
            if not isinstance(getattr(self, name), Mapping):
                raise InputError(f"Invalid {name} {in_short(getattr(self, name))}: it must be a mapping.")
        for name, unit in (("cnr_range", "dB"), ("snr_range", "dB"), ("velocity_range", "m/s")):
            put(name, _window(getattr(self, name), what=name, unit=unit))
        if self.blade_frequency is not None:
            low, high = _pair(self.blade_frequency, what="blade_frequency", unit="Hz")
            check_positive(low, what="blade_frequency", unit="Hz", where="its lower end")
            check_finite(high, what="blade_frequency", unit="Hz", where="its upper end")
            put("blade_frequency", (low, high))
        if self.status_valid is not None:
            put("status_valid", _numbers(self.status_valid, what="status_valid"))
        if self.status_reject_bits is not None:
            check_count(self.status_reject_bits, what="status_reject_bits")
        put("masks", _names(self.masks, what="masks"))
        put("exclude", _names(self.exclude, what="exclude"))
        for name in self.exclude:
            check_choice(name, REMARKS, what="remark in exclude")
        put("blocked_sectors", {str(key): _sectors(value) for key, value in dict(self.blocked_sectors).items()})
        put(
            "wind_sectors",
            {_beam(key, what="wind_sectors"): _sectors(value) for key, value in dict(self.wind_sectors).items()},
        )
        if self.despike is not None:
            check_choice(self.despike, DESPIKE_RULES, what="despike")
        for name in ("despike_window", "blade_window"):
            if check_count(getattr(self, name), what=name, minimum=3) % 2 == 0:
                raise InputError(f"Invalid {name} {getattr(self, name)}: it must be an odd number of samples.")
        for name, unit in (
            ("despike_threshold", ""),
            ("blade_threshold", ""),
            ("hard_target_speed", "m/s"),
            ("sub_variance_limit", ""),
            ("min_wind_speed", "m/s"),
        ):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), what=name, unit=unit)
        self._check_more()

    def _check_more(self) -> None:
        if self.hard_target_cnr is not None:
            check_finite(self.hard_target_cnr, what="hard_target_cnr", unit="dB")
        if self.frozen_run is not None:
            check_count(self.frozen_run, what="frozen_run", minimum=2)
        check_count(self.sub_records, what="sub_records", minimum=4)
        if self.trend_level is not None and not 0.0 < check_finite(self.trend_level, what="trend_level", unit="") < 1.0:
            raise InputError(f"Invalid trend_level {self.trend_level!r}: it must be between 0 and 1; 0.01 is usual.")
        if (
            self.half_ratio_limit is not None
            and not check_finite(self.half_ratio_limit, what="half_ratio_limit", unit="") > 1.0
        ):
            raise InputError(f"Invalid half_ratio_limit {self.half_ratio_limit!r}: it must be above 1; 4 is usual.")
        self._check_needed()

    def _check_needed(self) -> None:
        """Refuse what does nothing without a rule that is not given."""
        for remark in self.exclude:
            self._check_one_of(_REMARKED_BY[remark], f"exclude {remark!r}", "remark out of exclude")
        for name, rules in _PART_OF.items():
            if getattr(self, name) != type(self).__dataclass_fields__[name].default:
                self._check_one_of(rules, f"{name} {getattr(self, name)!r}", "number out")

    def _check_one_of(self, rules: Sequence[str], what: str, left: str) -> None:
        if all(getattr(self, name) is None for name in rules):
            words = " or ".join(f"{name} (--{name.replace('_', '-')})" for name in rules)
            raise InputError(f"Invalid {what}: it does nothing without {words}; give that, or leave the {left}.")

    def needed_columns(self) -> dict[str, str]:
        """Return the variables of a series that the rules need, each with the option that needs it, in words."""
        needed = {
            "status": ("status_reject_bits", "status_valid"),
            "cnr": ("hard_target_cnr", "cnr_range"),
            "snr": ("snr_range",),
        }
        units = {"hard_target_cnr": " dB", "cnr_range": " dB", "snr_range": " dB"}
        return {
            column: f"{name} {getattr(self, name)!r}{units.get(name, '')}"
            for column, names in needed.items()
            for name in names
            if getattr(self, name) is not None
        } | {
            column: f"{name} {getattr(self, name)!r}"
            for name in ("masks", "blocked_sectors")
            for column in getattr(self, name)
        }

    def named_beams(self) -> set[int]:
        """Return the beam numbers that the rules name."""
        windows = (self.cnr_range, self.snr_range, self.velocity_range)
        return {number for window in windows if isinstance(window, Mapping) for number in window} | {*self.wind_sectors}


def _pair(value: Any, *, what: str, unit: str) -> Pair:
    try:
        low, high = (as_number(bound) for bound in value)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not low < high:
        raise InputError(f"Invalid {what} {in_short(value)} {unit}: it must be a pair (low, high) with low < high.")
    return low, high


def _beam(key: Any, *, what: str) -> int:
    try:
        return int(key)
    except (OverflowError, TypeError, ValueError) as error:
        raise InputError(f"Invalid beam {in_short(key)} in {what}: it must be a beam number, as 0.") from error


def _window(value: Any, *, what: str, unit: str) -> Window | None:
    if isinstance(value, Mapping):
        return {
            _beam(beam, what=what): _pair(pair, what=f"{what} of beam {beam}", unit=unit)
            for beam, pair in value.items()
        }
    return None if value is None else _pair(value, what=what, unit=unit)


def _numbers(value: Any, *, what: str) -> float | tuple[float, ...]:
    if np.ndim(value) == 0:
        return check_finite(value, what=what, unit="")
    if len(value) == 0:
        raise InputError(f"Invalid {what} {in_short(value)}: it must hold at least one number, or be left out.")
    return tuple(check_finite(one, what=what, unit="") for one in value)


def _names(value: Any, *, what: str) -> tuple[str, ...]:
    if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) for name in value):
        raise InputError(f"Invalid {what} {in_short(value)}: it must be a sequence of names, as ({'rain'!r},).")
    return tuple(value)


def _sectors(value: Any) -> tuple[Sector, ...]:
    try:
        sectors = tuple((float(first), float(last)) for first, last in value)
    except (TypeError, ValueError):
        sectors = ((np.nan, np.nan),)
    if not np.isfinite(np.array(sectors)).all():
        raise InputError(
            f"Invalid sectors {in_short(value)}: each must be a pair (first, last) of degrees, as [(350, 10)]."
        )
    return sectors
