"""How one file is read: the options of the caller, the scan and the format, put together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import tzinfo
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.file_options import TIME_STAMPS, VELOCITY_LIMIT, VELOCITY_UNITS, FileOptions, as_zone
from bayes_rs.geometry.scan import Scan

_NO_MARKS = {
    "status": (0.0, 255.0),
    "gate": (0.0, 1000.0),
    "azimuth": (-360.0, 360.0),
    "elevation": (-90.0, 90.0),
    "phase": (-360.0, 360.0),
    "sx": (-1.0, 1.0),
    "sy": (-1.0, 1.0),
    "tilt_deg": (-90.0, 90.0),
    "roll_deg": (-90.0, 90.0),
    "heading_deg": (-360.0, 360.0),
    **dict.fromkeys(("u", "v", "w", "temperature", "uv", "uw", "vw"), (0.0, 0.0)),
}
"""Lowest and highest number of columns that marks nothing, by name: 0 may mark a velocity, and be north here."""


@dataclass(frozen=True, kw_only=True)
class FileFormat(FileOptions):
    """How to read one file: `FileOptions`, with the general default of what nobody said."""

    positive: str = "away"
    velocity_unit: str = "m/s"
    invalid: tuple[float, ...] = ()
    velocity_limit: float = VELOCITY_LIMIT
    time_zone: str = "UTC"
    separator: str = ","
    decimal: str = "."
    skip_rows: int = 0
    angle_tolerance_deg: float = 1.0
    phase_zero_deg: float = 0.0
    phase_turns: str = "up"
    required: frozenset[str] = frozenset()
    """Names that the caller mapped to a column, so that the column must be there."""
    said: frozenset[str] = frozenset()
    """Options that the caller or the scan gave: what a file says of itself counts after them."""
    from_format: frozenset[str] = frozenset()
    """Options that neither the caller nor the scan gave, so that the format's own default counts."""

    @property
    def zone(self) -> tzinfo:
        """The zone of times that carry none."""
        return as_zone(self.time_zone)

    def column(self, name: str) -> str:
        """Return what the file calls `name`."""
        return self.columns.get(name, name)

    def to_away(self, velocity: FloatArray) -> FloatArray:
        """Convert radial velocities as in the file to m/s, positive away from the lidar."""
        sign = -1.0 if self.positive == "towards" else 1.0
        return sign * VELOCITY_UNITS[self.velocity_unit] * velocity

    def as_written(self, velocity: FloatArray) -> FloatArray:
        """Return radial velocities, m/s and positive away, as they stand in the file: the inverse of `to_away`."""
        factor = float(self.to_away(np.ones(1))[0])
        exact = velocity / factor
        with np.errstate(over="ignore"):
            plain = np.array([float(f"{number:.12g}") for number in exact.tolist()])
            return np.where(plain * factor == velocity, plain, exact)  # what the division has lost at the last digit

    def to_start(self, time: NDArray[np.datetime64], duration: ArrayLike | None = None) -> NDArray[np.datetime64]:
        """Move times of samples to the start of their accumulation.

        Parameters
        ----------
        time : ndarray of datetime64[ns], shape (n,)
            As in the file.
        duration : array_like, shape () or (n,), optional
            How long a sample took, s, if the file says; the option ``sample_duration`` counts before it.

        Raises
        ------
        InputError
            If times stand at the middle or end of samples of unknown duration.
        """
        share = TIME_STAMPS[self.time_stamp or "start"]
        if share == 0.0:
            return time
        length = self.sample_duration if self.sample_duration is not None else duration
        if length is None and "time_stamp" in self.from_format:
            return time  # the format's own default must not make a file unreadable
        if length is None:
            raise InputError(
                f"Times that stand at the {self.time_stamp} of a sample need its duration, and the file does not say "
                "it: give sample_duration in seconds (--sample-duration)."
            )
        shift = np.round(share * 1e9 * np.asarray(length, dtype=np.float64))
        moved: NDArray[np.datetime64] = time - np.where(np.isfinite(shift), shift, 0.0).astype("timedelta64[ns]")
        return moved

    def is_invalid(self, values: FloatArray, name: str = "") -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Say which values of a column mark a missing entry: none that is a status, or a place, as 0 can be."""
        marked = np.isin(values, np.asarray(self.invalid, dtype=np.float64))
        if name not in _NO_MARKS:
            return marked
        low, high = _NO_MARKS[name]
        return marked & ~((values >= low) & (values <= high))


def resolve_format(options: FileOptions, scan: Scan | None, *, defaults: Mapping[str, Any] | None = None) -> FileFormat:
    """Combine the caller's options, the scan's own file format and the defaults, in this order of precedence.

    Parameters
    ----------
    options : FileOptions
        The caller's.
    scan : Scan, optional
        The scan whose `file_format` stands in for options not given; None for a file that describes itself.
    defaults : mapping, optional
        What the format of the file sets where neither the caller nor the scan does.

    Returns
    -------
    file_format : FileFormat
        The checked options.

    Raises
    ------
    InputError
        If an option is not valid.
    """
    given = options.given()
    of_format = dict(defaults or {})
    of_scan = {} if scan is None else {key: value for key, value in scan.file_format.items() if value != {}}
    chosen: dict[str, Any] = {**of_format, **of_scan, **given}
    asked = given.get("columns", {})
    chosen["columns"] = {**of_format.get("columns", {}), **of_scan.get("columns", {}), **asked}
    file_format = FileFormat(
        **chosen,
        required=frozenset(asked),
        said=frozenset(of_scan) | frozenset(given),
        from_format=frozenset(of_format) - set(of_scan) - set(given),
    )
    if file_format.separator == file_format.decimal and "separator" in chosen:
        raise InputError(
            f"Invalid separator {file_format.separator!r}: it is also the decimal sign; files with decimal commas "
            "are separated by ';' or tab as a rule."
        )
    return file_format
