"""Fields of turbulence seen by many scans, each kept in a file of its own: what is made once is not made again.

`seed_study_boxes.py` makes its hundred boxes through this module. A box of 8192 x 64 x 64 points is 400 MB and is not
kept; what is kept are the variances of all beams of all scans in it.
"""

import dataclasses
import hashlib
import json
import os
import time
import zipfile
import zlib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.processor import one_thread
from bayes_rs.simulation.boxes import BoxGrid, BoxMaker, generator_name
from bayes_rs.simulation.virtual import RecordState, beam_lines, sample_records


@dataclasses.dataclass(frozen=True, eq=False)
class Fields:
    """What fixes the fields of a study: all of it is in the key of a kept field.

    Parameters
    ----------
    scans : dict of Scan
        Who looks into the fields, by a label; the lidars stand at the same place and look along the wind.
    turbulence : str
        A preset.
    grid : BoxGrid
        The grid of the boxes; one record of `durations[0]` must be within its length.
    wind_speed : float
        Mean wind speed at the lidar's height, m/s: the boxes go by with it.
    shear : float
        dU/dz, 1/s: the mean wind is wind_speed + shear z. It does not change a variance.
    durations : tuple of float
        Lengths of records, s: all begin with the field, none is longer than the first.
    """

    scans: dict[str, brs.Scan]
    turbulence: str
    grid: BoxGrid
    wind_speed: float
    shear: float
    durations: tuple[float, ...]

    def key(self, seed: int) -> dict[str, object]:
        """Return what tells a field of these from any other, as JSON holds it."""
        return {
            "generator": generator_name(),
            "turbulence": dataclasses.asdict(brs.load_turbulence(self.turbulence)),
            "grid": [list(self.grid.shape), list(self.grid.spacing)],
            "wind": [self.wind_speed, self.shear],
            "durations": list(self.durations),
            "seed": seed,
            "scans": {label: digest(scan) for label, scan in self.scans.items()},
        }

    @cached_property
    def maker(self) -> BoxMaker:
        """The generator of the boxes."""
        return BoxMaker(brs.load_turbulence(self.turbulence), self.grid)

    @cached_property
    def states(self) -> dict[str, RecordState]:
        """Each scan with its mean wind and the longest record."""
        return {label: RecordState(scan, self.wind_speed, 0.0, self.durations[0]) for label, scan in self.scans.items()}

    @cached_property
    def lines(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the beams' points move through a box, each line once, and which is whose.

        Scans share many of their beams: the 50 of a cone are among the 51 with its axis and, at each distance, among
        those of several planes.
        """
        focus = np.concatenate([state.focus for state in self.states.values()])
        direction = np.concatenate([state.line_of_sight for state in self.states.values()])
        kinds = np.round(np.column_stack([focus[:, 1:], direction]), 9)
        _, first, of_beam = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        return focus[first], direction[first], of_beam.ravel()

    @cached_property
    def own(self) -> dict[str, slice]:
        """Which beams of all are a scan's."""
        ends = np.cumsum([0, *(scan.n_beam for scan in self.scans.values())])
        return {label: slice(*ends[index : index + 2]) for index, label in enumerate(self.scans)}

    def make(self, seed: int) -> dict[str, np.ndarray]:
        """Make a field, and return what all scans measure in it.

        Returns
        -------
        field : dict of ndarray
            `variance`, shape (n_duration, all beams), m² s⁻², and the seconds of CPU of `generator` and `beams`.
        """
        began = time.process_time()
        box = self.maker.make(seed)
        made = time.process_time()
        focus, direction, of_beam = self.lines
        lines = beam_lines(box, focus, direction)
        variance = np.empty((len(self.durations), len(of_beam)))
        for label, state in self.states.items():
            mean = state.line_of_sight[:, 0] * (self.wind_speed + self.shear * state.focus[:, 2])
            velocity = sample_records(lines[of_beam[self.own[label]]], state, self.grid)[0] + mean[:, None]
            for index, duration in enumerate(self.durations):
                count = round(duration / state.scan.scan_duration)
                variance[index, self.own[label]] = velocity[:, :count].var(axis=1)
        seconds = {"generator": made - began, "beams": time.process_time() - made}
        return {"variance": variance, **{name: np.array(value) for name, value in seconds.items()}}

    def keep(self, folder: Path, seeds: range) -> Iterator[dict[str, np.ndarray]]:
        """Give the fields of some seeds in turn: those of the folder, and, made and kept there, the others.

        Raises
        ------
        InputError
            If a file of the folder is damaged, or is a field of other scans, turbulence, grid, wind or seed.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for seed in seeds:
            path = folder / f"field-{seed:04d}.npz"
            if not path.exists():
                with one_thread():
                    write(path, self.key(seed), self.make(seed))
            yield read(path, self.key(seed))

    def variances(self, fields: list[dict[str, np.ndarray]]) -> dict[str, dict[float, np.ndarray]]:
        """Return the beams' variances of each scan and duration, shape (n_field, n_beam), m² s⁻²."""
        of_all = np.array([field["variance"] for field in fields])
        return {
            label: {duration: of_all[:, index, beams] for index, duration in enumerate(self.durations)}
            for label, beams in self.own.items()
        }


def digest(scan: brs.Scan) -> str:
    """Return a fingerprint of where a scan looks, and when; not of its name. Rounded: the last bits are a machine's."""
    columns = [scan.line_of_sight, scan.focus_distance[:, None], scan.beam_time[:, None]]
    numbers = np.round(np.concatenate(columns, axis=1), 9) + 0.0
    return hashlib.sha256(numbers.tobytes() + f"{scan.scan_duration:.9g}".encode()).hexdigest()


def write(path: Path, key: dict[str, object], field: dict[str, np.ndarray]) -> None:
    """Write a field: whole, or not at all."""
    half = path.with_suffix(".part")
    with half.open("wb") as file:
        np.savez(file, key=np.array(json.dumps(key)), **field)
        file.flush()
        os.fsync(file.fileno())
    half.replace(path)


def read(path: Path, key: dict[str, object]) -> dict[str, np.ndarray]:
    """Read a field, if it is the one of a key.

    Raises
    ------
    InputError
        If the file is damaged, or has another key.
    """
    advice = "Delete it to have the field made again, or name another folder."
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as parts:  # each has its checksum
            found = json.loads(str(parts["key"]))
            field = {name: parts[name] for name in ("variance", "generator", "beams")}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, AttributeError) as error:
        raise InputError(f"Invalid field {path}: it is damaged, or was not written by this study. {advice}") from error
    if not isinstance(found, dict) or found != key:
        other = [name for name in key if not isinstance(found, dict) or found.get(name) != key[name]]
        raise InputError(f"Invalid field {path}: it was made with another {' and '.join(other) or 'key'}. {advice}")
    return field
