"""The layout of records: what each variable and attribute is, for who writes them and who reads them again."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, Json, model_validator

from bayes_rs.errors import InputError
from bayes_rs.file_options import VELOCITY_LIMIT
from bayes_rs.geometry.ranged_scan import short
from bayes_rs.geometry.stress import STRESSES, first_impossible
from bayes_rs.layouts import Count, Entry, Finite, Open, Positive, check_dataset

_RECORD = ("record",)
_BOTH = ("record", "beam")
_VARIANCE, _SPEED, _ANGLE = "m2 s-2", "m s-1", "degree"
_ANY = float("inf")  # what is too large is not believed, or has a message of its own, and need not be refused
REPORT = "records_report"
"""Attribute of records that only they have."""
OF_RANGES = "of_ranges"
"""Attribute of records at several ranges: in JSON, the attributes that each range has for itself."""
TURBINE = "turbine"
"""Variable of records with the name of the turbine, or of the lidar: the same start is then another record."""
MAST, MAST_POSITION = "mast_stress", "mast_position"
"""Variable of records with the stresses of a mast beside, and attribute with its place, m, in JSON."""
_ADVICE = "make them with bayes_rs.make_records"

RECORDS: dict[str, Entry] = {
    "beam": Entry(("beam",), "whole"),
    "range": Entry(("range",), unit="m", positive=True),
    "height": Entry((), unit="m"),
    "focus_distance": Entry(("beam",), unit="m", positive=True),
    "time": Entry(_RECORD, "time"),
    TURBINE: Entry(_RECORD, "text"),
    "variance": Entry(_BOTH, unit=_VARIANCE, most=_ANY),
    "mean": Entry(_BOTH, unit=_SPEED, most=_ANY),
    "count": Entry(_BOTH, least=0.0),
    "flag": Entry(_BOTH, "whole", flags=True),
    "wind_speed": Entry(_RECORD, unit=_SPEED, most=_ANY),
    "yaw": Entry(_RECORD, unit=_ANGLE, most=_ANY),
    "record_flag": Entry(_RECORD, "whole", flags=True),
    **{
        name: Entry(_RECORD, unit=_ANGLE, most=_ANY)
        for name in ("tilt", "roll", "tilt_sd", "roll_sd", "heading", "yaw_sd")
    },
    "wind_direction": Entry(_RECORD, unit=_ANGLE),
    "wind_speed_sd": Entry(_RECORD, unit=_SPEED),
    "motion_count": Entry(_RECORD, least=0.0),
    "first_sample": Entry(_RECORD, unit="s"),
    "last_sample": Entry(_RECORD, unit="s"),
    "part_beams": Entry(_RECORD, "whole"),
    "part_wind": Entry(("record", "part"), unit=_SPEED),
    "part_wind_across": Entry(("record", "part"), unit=_SPEED),
    "block_scatter": Entry(("record", "blocks")),
    "block_scatter_of_beams": Entry(("record", "blocks")),
    "beam_correlation": Entry(("record", "beam_pair"), most=1.0),
    MAST: Entry(("record", "stress"), unit=_VARIANCE, most=_ANY),
    "octave_variance": Entry(("record", "beam", "octave"), unit=_VARIANCE),
    "sample_interval": Entry(_RECORD, unit="s", least=0.0),
    "spike_count": Entry(_BOTH, least=0.0),
    "spike_variance": Entry(_BOTH, unit=_VARIANCE, least=-_ANY, most=_ANY),
    "trend": Entry(_BOTH),
    "trend_p_value": Entry(_BOTH),
    "sub_variance": Entry(_BOTH),
    "half_ratio": Entry(_BOTH),
    "length_scale": Entry(_RECORD, unit="m", positive=True),
    "spectral_length_scale": Entry(_RECORD, unit="m", positive=True),
    "length_scale_log_sd": Entry(_RECORD),
    "spectral_length_scale_log_sd": Entry(_RECORD),
    "gamma": Entry(_RECORD),
    "other_length_scale": Entry(_RECORD, "whole"),
    "instrument_noise": Entry(_BOTH, unit=_VARIANCE, most=_ANY),
    "instrument_noise_sd": Entry(_BOTH, unit=_VARIANCE, most=_ANY),
    "instrument_noise_common_sd": Entry(_BOTH, unit=_VARIANCE),
    "variance_scatter": Entry(_RECORD),
    "variance_scatter_of_beams": Entry(_RECORD),
    "unsteady": Entry(_RECORD, "whole"),
    "unsteady_p_value": Entry(_RECORD),
    "wind_change": Entry(_RECORD, unit=_SPEED),
    "cross_wind_change": Entry(_RECORD, unit=_SPEED),
    **{f"change_{name}": Entry(_RECORD, unit=_VARIANCE) for name in ("uu", "vv", "uv")},
}
"""The variables of records, where they are there."""


class _ReadFile(Open):
    name: str
    rows: Count
    format: str
    positive: str
    velocity_unit: str
    time_zone: str
    time_stamp: str | None = None
    options_of_format: list[str] = Field(default_factory=list)
    columns: dict[str, str] = Field(default_factory=dict)
    rows_invalid_value: Count = 0
    rows_dropped: Count = 0
    rows_unset_clock: Count = 0
    rows_of_other_ranges: Count = 0
    rows_without_range: Count = 0
    rows_bad: Count = 0
    rows_cut: Count = 0
    first_bad_row: str = ""
    ranges: list[Finite] = Field(default_factory=list)
    ranges_used: list[Finite] = Field(default_factory=list)
    gates_off: Positive | None = None
    velocities_impossible: Count = 0
    samples_out_of_order: Count = 0
    impossible_values: dict[str, Count] = Field(default_factory=dict)
    velocity_limit: Positive = 1.0


class _SkippedFile(Open):
    name: str
    reason: str


class ReadReport(Open):
    """What was read of files."""

    files: list[_ReadFile]
    files_skipped: list[_SkippedFile] = Field(default_factory=list)
    files_passed_over: dict[str, Count] = Field(default_factory=dict)
    beams_present: list[int]
    beams_absent: list[int]
    samples: Count
    samples_without_velocity: Count
    duplicates_dropped: Count
    duplicates_that_differ: Count


class _Counted(Open):
    count: Count
    of: Count = 0
    first_time: str = ""
    first_beam: int = 0

    @model_validator(mode="after")
    def _says_first(self) -> _Counted:
        if self.count and "first_time" not in self.model_fields_set:
            raise ValueError("it counts something, and has no first_time")
        return self


class _CountedOfBeams(_Counted):
    @model_validator(mode="after")
    def _says_beam(self) -> _CountedOfBeams:
        if self.count and "first_beam" not in self.model_fields_set:
            raise ValueError("it counts something, and has no first_beam")
        return self


class _Blades(Open):
    beam: int
    events: Count
    frequency: Finite | None
    p_value: Finite | None


class _Spikes(Open):
    samples: Count
    of: Count
    records: Count
    raised: Finite
    worst_beam: int
    worst_samples: Count
    worst_of: Count
    worst_raised: Finite


class _Cycle(Open):
    interval: Positive
    scan_duration: Positive
    records: Count
    of: Count


class RecordsReport(Open):
    """What records were made of."""

    samples: Count
    samples_used: Count
    duplicates_dropped: Count
    dropped: dict[str, Count]
    duration: Positive
    records: Count
    records_without_samples: Count
    records_with_wind_from_behind: Count = 0
    beams_never_usable: list[int]
    beams_rarely_usable: list[int] = Field(default_factory=list)
    few_samples: dict[str, Finite] = Field(default_factory=dict)
    by_beam: dict[str, list[Count | int]] = Field(default_factory=dict)
    blades: list[_Blades] = Field(default_factory=list)
    long_gaps: list[Annotated[list[str], Field(min_length=2, max_length=2)]] = Field(default_factory=list)
    records_of_unset_clock: _Counted = _Counted(count=0)
    spikes: _Spikes | None = None
    cycle: _Cycle | None = None
    beam_flags: dict[str, _CountedOfBeams]
    record_flags: dict[str, _Counted]
    samples_needed: Finite
    samples_expected: Finite
    min_count: Count | None = None
    quality: dict[str, Any] = Field(default_factory=dict)
    impossible_values: dict[str, Count] = Field(default_factory=dict)
    velocity_limit: Positive = 1.0
    samples_late: Count = 0
    first_late: str = ""

    @model_validator(mode="after")
    def _of_the_same_beams(self) -> RecordsReport:
        if self.by_beam and ("beam" not in self.by_beam or "samples" not in self.by_beam):
            raise ValueError("by_beam must have beam and samples")
        if len({len(values) for values in self.by_beam.values()}) > 1:
            raise ValueError("the lists of by_beam must be of the same length")
        if self.dropped.get("impossible") and not self.impossible_values:
            raise ValueError("impossible samples were dropped, and impossible_values does not say which")
        return self


class _NotBelieved(Open):
    count: Count
    of: Count
    limit: Positive
    values: Annotated[dict[str, Count], Field(min_length=1)]


class _Told(Open):
    words: str


class _LengthTold(_Told):
    instrument_noise: Finite | str = 0.0
    wind_speed: Positive | None = None
    length_scale: Positive | None = None
    log_sd: Finite = 0.0
    spread: Finite = 0.0
    slope: Finite = 0.0
    n_told: Count = 0


class _OfRange(Open):
    scan_key: str = ""
    beams_absent: Json[list[int]] = Field(default_factory=list)
    records_report: Json[RecordsReport] | None = None
    not_believed: Json[dict[str, _NotBelieved]] | None = None
    length_scale_report: Json[_LengthTold] | None = None
    instrument_noise_report: Json[_Told] | None = None


class RecordsAttributes(Open):
    """Attributes of records, where they are there."""

    scan: str = ""
    scan_key: str = ""
    duration: Positive = 600.0
    velocity_limit: Positive = VELOCITY_LIMIT
    source_files: Json[list[str]] = Field(default_factory=list)
    beams_absent: Json[list[int]] = Field(default_factory=list)
    read_report: Json[ReadReport] | None = None
    records_report: Json[RecordsReport] | None = None
    not_believed: Json[dict[str, _NotBelieved]] | None = None
    length_scale_report: Json[_LengthTold] | None = None
    instrument_noise_report: Json[_Told] | None = None
    of_ranges: Json[list[_OfRange]] | None = None
    mast_position: Json[tuple[Finite, Finite, Finite]] | None = None


def check_layout(
    records: xr.Dataset, *needs: str, what: str = "The records", advice: str = _ADVICE, ranges: bool = False
) -> None:
    """Check that records are laid out as `make_records` lays them out, and hold what is needed.

    Parameters
    ----------
    records : Dataset
        Records, also a user's own: they may have other variables, too.
    *needs : str
        Variables that must be there.
    what, advice : str
        What they are, and what to do, for messages.
    ranges : bool
        Whether they may be at several ranges.

    Raises
    ------
    InputError
        For the first entry that is not as it should be.
    """
    if "range" in records.dims and not ranges:
        known = ", ".join(short(records["range"].values[:12])) if "range" in records.coords else "unknown"
        raise InputError(
            f"{what} are at {records.sizes['range']} range{'s' if records.sizes['range'] > 1 else ''} ({known} m), and "
            "those of one, without the dimension 'range', are wanted here: take one with "
            "bayes_rs.records.at_range(records, distance), or read the files of radial velocities at one "
            "(--focus-distance DISTANCE, in place of --range)."
        )
    check_dataset(
        records,
        RECORDS,
        what=what,
        needs=needs,
        attributes=RecordsAttributes,
        optional_dim="range",
        advice=advice,
    )
    if MAST in records:
        _check_mast(records, what)


def _check_mast(records: xr.Dataset, what: str) -> None:
    """Refuse a mast that has no place, or that measured what no wind has."""
    anew = "give the mast anew with bayes_rs.wind.with_mast, or leave the variable out"
    if records.attrs.get(MAST_POSITION) is None:
        raise InputError(
            f"{what} cannot be used: they have {MAST}, and no attribute {MAST_POSITION}, which xarray drops in "
            f"steps that keep no attributes; {anew}."
        )
    values = np.asarray(records[MAST].values, dtype=np.float64)
    if values.shape[-1] != len(STRESSES):
        raise InputError(
            f"{what} cannot be used: {MAST} holds {values.shape[-1]} numbers of a record, and must hold "
            f"{', '.join(STRESSES)}; {anew}."
        )
    impossible = first_impossible(values.reshape(-1, len(STRESSES)))
    if impossible is not None:
        row, words = impossible
        raise InputError(f"{what} cannot be used: {MAST} of record {row % values.shape[-2]} {words}; {anew}.")


def mast_there(records: xr.Dataset) -> NDArray[np.bool_]:
    """Return in which records a mast beside measured anything that a fit uses, shape (n_record,): a variance."""
    if MAST not in records:
        return np.zeros(records.sizes["record"], dtype=np.bool_)
    return np.asarray(np.isfinite(records[MAST].values[:, :3]).any(axis=1))


def with_turbine(records: xr.Dataset, name: str) -> xr.Dataset:
    """Return records of which each says the name of its turbine, which `check_turbine` has let pass."""
    return records.assign({TURBINE: ("record", np.full(records.sizes["record"], name, dtype=object))})


def check_turbine(name: str) -> str:
    """Return the name of a turbine.

    Raises
    ------
    InputError
        If it is blank, or holds what cannot be printed: it goes into files, tables and messages.
    """
    if not name.strip() or not name.isprintable():
        raise InputError(
            f"Invalid turbine {name!r}: it must have letters or digits, and nothing that cannot be printed."
        )
    return name
