"""The options of reading, which `read_radial_velocity` and `stream_radial_velocity` share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from bayes_rs._validation import check_choice
from bayes_rs.geometry.scan import Scan
from bayes_rs.readers.format import resolve_format

ON_BAD_FILE = ("error", "skip")


class ReadOptions(TypedDict, total=False):
    """What each means stands in `bayes_rs.read_radial_velocity`."""

    file_format: str
    columns: Mapping[str, str] | None
    beam_numbers: Mapping[str, int] | None
    positive: str | None
    velocity_unit: str | None
    invalid: float | Sequence[float] | None
    time_zone: str | None
    time_format: str | None
    time_stamp: str | None
    sample_duration: float | None
    separator: str | None
    decimal: str | None
    status_valid: float | None
    angle_tolerance_deg: float | None
    range_tolerance: float | None
    phase_zero_deg: float | None
    phase_turns: str | None
    out_of_order: str
    on_bad_file: str


def split_options(given: Mapping[str, Any], formats: Sequence[str], scan: Scan) -> tuple[str, str, dict[str, Any]]:
    """Return the name of the format, what to do with a bad file, and the options of one file; all checked."""
    options = dict(given)
    kind = check_choice(options.pop("file_format", "auto"), ("auto", *formats), what="file_format")
    on_bad_file = check_choice(options.pop("on_bad_file", "error"), ON_BAD_FILE, what="on_bad_file")
    resolve_format(options, scan)
    return kind, on_bad_file, options
