"""The options of records: what a record is, and when a beam of it can be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_rs._validation import check_array, check_count, check_finite, check_positive, check_switch
from bayes_rs.errors import InputError, in_short
from bayes_rs.options import described, from_plain, option, to_plain

if TYPE_CHECKING:
    from bayes_rs.geometry.scan import Scan

_DAY = 86_400_000_000_000  # ns
ADDED = ("motion", "motion_columns", "mast", "mast_position")
"""Options about what is added to finished records."""
OF_MOTION = ("time_zone", "time_format", "separator", "decimal", "invalid")
"""What files of motion have in common with those of radial velocities."""
OF_MAST = ("invalid",)
"""What files of a mast have in common with them."""
_WHO_ADDS = {
    "motion": "give it and the records to bayes_rs.wind.add_motion",
    "mast": "give its files and the records to bayes_rs.wind.with_mast",
}


@described
@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """How records are made of radial velocities.

    Raises
    ------
    InputError
        If a value is not valid.

    Notes
    -----
    Records start on the clock, at whole multiples of the duration since 1970-01-01 00:00 UTC, so it must divide a day
    or be whole days. A beam is flagged if it has fewer samples than either limit asks for. Motion and a mast are added
    to finished records, by `bayes_rs.wind.add_motion` and `bayes_rs.wind.with_mast`, and `make_records` refuses them.

    Examples
    --------
    >>> RecordOptions(duration=1800.0).window
    1800000000000
    """

    duration: float = option(600.0, "Averaging period", unit="s")
    min_availability: float = option(
        0.8, "Smallest share of the expected samples, 0 to 1, below which a beam is flagged"
    )
    expected_count: float | None = option(
        None, "Samples of a beam in a full record; by default the duration over that of the scan", flag=""
    )
    min_count: int = option(
        10, "Smallest number of samples below which a beam is flagged, whatever was expected", flag=""
    )
    correlations: bool = option(
        False, "Keep the correlations between beams, too; a fit of files with information covariances does so by itself"
    )
    motion: Sequence[str | Path] = option(
        (), "Files with the lidar's own tilt and roll over time, for each record's own attitude", metavar="FILE"
    )
    motion_columns: Mapping[str, str] = option(
        {},
        "Headings of the columns of those files, as time=Timestamp or tilt_deg=Tilt",
        flag="--motion-column",
        metavar="OURS=THEIRS",
    )
    mast: Sequence[str | Path] = option(
        (),
        "Files of what a mast beside measured in the same records, which is data of the fit, too: tables with time "
        "(start of the record), uu and others of the stresses, or a sonic's series (TOA5); times that state no offset "
        "are UTC",
        metavar="FILE",
    )
    mast_position: tuple[float, float, float] | None = option(
        None,
        "Where the mast measures, from the lidar in its levelled frame: against its view, to the right of one who "
        "looks out, and up; -200 0 0 is 200 m in front of it",
        unit="m",
        metavar="X Y Z",
    )

    def __post_init__(self) -> None:
        """Check the options, and bring them into one form."""

        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        window = round(check_positive(self.duration, what="duration", unit="s") * 1e9)
        if window == 0 or (_DAY % window and window % _DAY):
            raise InputError(
                f"Invalid duration {self.duration!r} s: it must divide a day (86400 s) or be whole days, "
                "so that records start on the clock; 600 is usual."
            )
        put("duration", float(self.duration))
        share = check_finite(self.min_availability, what="min_availability", unit="")
        if not 0.0 <= share <= 1.0:
            raise InputError(f"Invalid min_availability {self.min_availability!r}: it must be from 0 to 1.")
        put("min_availability", share)
        if self.expected_count is not None:
            put("expected_count", check_positive(self.expected_count, what="expected_count", unit=""))
        put("min_count", check_count(self.min_count, what="min_count"))
        put("correlations", check_switch(self.correlations, what="correlations"))
        put("motion", (self.motion,) if isinstance(self.motion, (str, Path)) else tuple(self.motion))
        if not isinstance(self.motion_columns, Mapping):
            raise InputError(
                f"Invalid motion_columns {in_short(self.motion_columns)}: it must be a mapping, as "
                "{'tilt_deg': 'Tilt'}."
            )
        put("motion_columns", dict(self.motion_columns))
        if self.motion_columns and not self.motion:
            raise InputError("The option motion_columns is only used with motion: give the files, or leave it out.")
        put("mast", (self.mast,) if isinstance(self.mast, (str, Path)) else tuple(self.mast))
        if self.mast_position is not None:
            place = check_array(self.mast_position, (3,), what="mast_position")
            put("mast_position", tuple(float(number) for number in place))
            if not self.mast:
                raise InputError("The option mast_position is only used with mast: give its files, or leave it out.")
        elif self.mast:
            raise InputError(
                "The option mast needs mast_position (--mast-position X Y Z): say where the mast measures, three "
                "numbers in m from the lidar; -200 0 0 is 200 m in front of a nacelle lidar."
            )

    @property
    def window(self) -> int:
        """Length of a record, ns."""
        return round(self.duration * 1e9)

    def expected(self, scan: Scan) -> float:
        """Return how many samples of a beam a full record holds."""
        return self.duration / scan.scan_duration if self.expected_count is None else self.expected_count

    def needed(self, scan: Scan) -> float:
        """Return how many samples a beam needs, not to be flagged."""
        return max(self.min_count, self.min_availability * self.expected(scan))


def record_options(options: Mapping[str, Any]) -> RecordOptions:
    """Return the options of records that are made of a series alone, checked.

    Raises
    ------
    InputError
        If one is not known, not valid, or about what is added to finished records.
    """
    chosen = from_plain(RecordOptions, options, where="the options of records")
    for name, who in _WHO_ADDS.items():
        if getattr(chosen, name):
            raise InputError(f"The option {name} is not used where records are made: {who}.")
    return chosen


def options_beside(options: RecordOptions) -> frozenset[str]:
    """Return the options of files that are also those of the files of motion, or of a mast, which are named.

    Examples
    --------
    >>> sorted(options_beside(RecordOptions(mast="mast.csv", mast_position=(-200.0, 0.0, 0.0))))
    ['invalid']
    """
    return frozenset((*(OF_MOTION if options.motion else ()), *(OF_MAST if options.mast else ())))


def options_of_series(options: RecordOptions) -> dict[str, Any]:
    """Return those options that say how records are made of a series, as keywords of `make_records`."""
    return {name: value for name, value in to_plain(options).items() if name not in ADDED}
