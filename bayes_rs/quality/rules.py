"""The rules of quality: one frozen object that says what every filter and every check asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_rs._validation import check_choice, check_count, check_finite, check_positive
from bayes_rs.errors import InputError
from bayes_rs.quality.sectors import Sector

DESPIKE_RULES = ("median",)
REMARKS = ("not_stationary", "low_wind")
"""Flags of records that the checks set, and that `exclude` can name."""

Pair = tuple[float, float]
Window = Pair | Mapping[int, Pair]


@dataclass(frozen=True, kw_only=True)
class QualityRules:
    """Which samples count, and which records are remarked on; every rule is off unless it is given.

    Parameters
    ----------
    status_valid : float or sequence of float, optional
        Statuses of a good sample; by default the one that the series was read with.
    status_reject_bits : int, optional
        Bits of the status of which a good sample has none.
    masks : sequence of str
        Variables of the series over its samples, as ``rain``: any value but zero marks a bad sample.
    cnr_range, snr_range : tuple of float, or mapping of int to tuple, optional
        Lowest and highest carrier-to-noise or signal-to-noise ratio of a good sample, dB; for all beams, or by the
        numbers of some.
    velocity_range : tuple of float, or mapping of int to tuple, optional
        Lowest and highest radial velocity of a good sample, m/s, positive away; for all beams, or by number.
    hard_target_cnr : float, optional
        Carrier-to-noise ratio, dB, from which on a sample that hardly moves is taken for a hard target.
    hard_target_speed : float
        Largest |radial velocity| of a hard target, m/s.
    blocked_sectors : mapping of str to sequence of (first, last)
        Sectors without a free sight, degrees, of variables of the series: ``{"rotor_angle": [(350, 10)]}``. They run
        upwards from first to last, ends included.
    frozen_run : int, optional
        Number of equal values in a row from which on a beam is taken to be frozen; all of them are dropped.
    blade_threshold : float, optional
        Robust standard deviations towards zero from the running median beyond which a sample is a blade's.
    blade_window : int
        Samples in that running median, odd.
    blade_frequency : tuple of float, optional
        Lowest and highest frequency, Hz, at which to look for blades among what was dropped; for the report.
    despike : {"median"}, optional
        Rule that drops spikes on both sides; see `make_records`.
    despike_window : int
        Samples in its running median, odd.
    despike_threshold : float
        Robust standard deviations from the running median beyond which a sample is a spike.
    wind_sectors : mapping of int to sequence of (first, last)
        By beam number, the wind directions (the records' ``yaw``, degrees) in which the beam is not used, as in the
        wake of a mast.
    sub_records : int
        Parts of a record M for the checks on stationarity.
    trend_level : float, optional
        Level of the test for a trend, as 0.01.
    sub_variance_limit : float, optional
        Largest share of a record's variance that may lie between its parts, as 0.3.
    half_ratio_limit : float, optional
        Largest ratio between the variances of a record's halves, as 4.
    min_wind_speed : float, optional
        Mean wind speed, m/s, below which a record is remarked on.
    exclude : sequence of {"not_stationary", "low_wind"}
        Remarks that take a record out of the fit; it stays in the records, with all its beams flagged.

    Raises
    ------
    InputError
        If a value is not valid.

    Notes
    -----
    The formulas, and what each rule does to sound data, are in ``docs/quality.md``.

    Examples
    --------
    >>> rules = QualityRules(cnr_range=(-23.0, 0.0), despike="median", frozen_run=5)
    >>> rules.needed_columns()
    {'cnr': 'cnr_range (-23.0, 0.0) dB'}
    """

    status_valid: float | Sequence[float] | None = None
    status_reject_bits: int | None = None
    masks: Sequence[str] = ()
    cnr_range: Window | None = None
    snr_range: Window | None = None
    velocity_range: Window | None = None
    hard_target_cnr: float | None = None
    hard_target_speed: float = 0.5
    blocked_sectors: Mapping[str, Sequence[Sector]] = field(default_factory=dict)
    frozen_run: int | None = None
    blade_threshold: float | None = None
    blade_window: int = 11
    blade_frequency: Pair | None = None
    despike: str | None = None
    despike_window: int = 11
    despike_threshold: float = 5.0
    wind_sectors: Mapping[int, Sequence[Sector]] = field(default_factory=dict)
    sub_records: int = 6
    trend_level: float | None = None
    sub_variance_limit: float | None = None
    half_ratio_limit: float | None = None
    min_wind_speed: float | None = None
    exclude: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check the options, and bring them into one form."""

        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

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
        put("wind_sectors", {int(key): _sectors(value) for key, value in dict(self.wind_sectors).items()})
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
        low, high = (float(bound) for bound in value)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not low < high:
        raise InputError(f"Invalid {what} {value!r} {unit}: it must be a pair (low, high) with low < high.")
    return low, high


def _window(value: Any, *, what: str, unit: str) -> Window | None:
    if isinstance(value, Mapping):
        return {int(beam): _pair(pair, what=f"{what} of beam {beam}", unit=unit) for beam, pair in value.items()}
    return None if value is None else _pair(value, what=what, unit=unit)


def _numbers(value: Any, *, what: str) -> float | tuple[float, ...]:
    if np.ndim(value) == 0:
        return check_finite(value, what=what, unit="")
    if len(value) == 0:
        raise InputError(f"Invalid {what} {value!r}: it must hold at least one number, or be left out.")
    return tuple(check_finite(one, what=what, unit="") for one in value)


def _names(value: Any, *, what: str) -> tuple[str, ...]:
    if isinstance(value, str) or not all(isinstance(name, str) for name in value):
        raise InputError(f"Invalid {what} {value!r}: it must be a sequence of names, as ({'rain'!r},).")
    return tuple(value)


def _sectors(value: Any) -> tuple[Sector, ...]:
    try:
        sectors = tuple((float(first), float(last)) for first, last in value)
    except (TypeError, ValueError):
        sectors = ((np.nan, np.nan),)
    if not np.isfinite(np.array(sectors)).all():
        raise InputError(f"Invalid sectors {value!r}: each must be a pair (first, last) of degrees, as [(350, 10)].")
    return sectors
