"""Scans from TOML files: the patterns that beams can be written as, and a scan by its name."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator

from bayes_rs._validation import FloatArray, as_numbers, check_count, check_finite, check_switch
from bayes_rs.errors import InputError, in_short
from bayes_rs.file_options import OF_READING, FileOptions
from bayes_rs.geometry.probe import Probe, make_probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_changes import split_changes
from bayes_rs.layouts import first_fault, shown
from bayes_rs.models import find_model
from bayes_rs.options import from_plain, nearest, options_of, to_plain
from bayes_rs.toml_file import Size, Table, Text, invalid_file, read_toml

MOST_BEAMS = 10_000
"""Beams of a scan, all planes together: the covariance of their noise has as many rows, and fills 0.8 GB."""

Distances = Annotated[list[Size], Field(min_length=1, max_length=MOST_BEAMS)]
Angle = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
OpeningAngle = Annotated[float, Field(ge=0.0, le=90.0, allow_inf_nan=False)]
_Whole = Annotated[int, Field(ge=-(10**9), le=10**9)]
_Component = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]


class _ConeBeams(Table):
    """Beams on one cone about the axis, evenly spaced in phase, with or without a beam along the axis."""

    pattern: Literal["cone"]
    count: Annotated[int, Field(ge=0, le=MOST_BEAMS)]
    opening_angle_deg: OpeningAngle
    focus_distance: Distances
    first_phase_deg: Angle = 90.0
    centre: bool = False
    axis: Literal["upwind", "up"] = "upwind"

    def directions(self) -> FloatArray:
        phase = np.deg2rad(self.first_phase_deg) + 2.0 * np.pi * np.arange(self.count) / max(self.count, 1)
        opening = np.full(self.count, np.deg2rad(self.opening_angle_deg))
        if self.centre:
            phase, opening = np.append(phase, 0.0), np.append(opening, 0.0)
        return cone_direction(opening, phase) if self.axis == "upwind" else _upward_direction(opening, phase)


class _RosetteBeams(Table):
    """Beams behind two rotating wedge prisms: the axis is deflected by the sum of two turning deflections."""

    pattern: Literal["rosette"]
    count: Annotated[int, Field(ge=1, le=MOST_BEAMS)]
    opening_angle_deg: OpeningAngle
    turns: Annotated[tuple[_Whole, _Whole], Field(strict=False)]
    focus_distance: Distances

    def directions(self) -> FloatArray:
        angle = 2.0 * np.pi * np.outer(self.turns, np.arange(self.count)) / self.count
        sideways, upwards = (
            0.5 * np.deg2rad(self.opening_angle_deg) * np.array([np.cos(angle), np.sin(angle)]).sum(axis=1)
        )
        return cone_direction(np.hypot(sideways, upwards), np.arctan2(upwards, sideways))


class _Beam(Table):
    """One beam: a number, and a direction in one of three notations."""

    id: _Whole
    opening_angle_deg: OpeningAngle | None = None
    phase_deg: Angle | None = None
    sideways_deg: Angle | None = None
    upwards_deg: Angle | None = None
    vector: Annotated[tuple[_Component, _Component, _Component], Field(strict=False)] | None = None
    focus_distance: Size | None = None
    time: Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)] | None = None

    @field_validator("vector")
    @classmethod
    def _not_zero(cls, vector: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if vector is not None and not np.linalg.norm(vector) > 0.0:
            raise ValueError("the vector of a beam must not be zero; give the direction in which the beam points")
        return vector

    def direction(self) -> FloatArray:
        if self.vector is not None:
            vector = np.asarray(self.vector, dtype=np.float64)
            length = np.linalg.norm(vector)
            # what is of unit length up to rounding stays bit by bit, so that a scan comes back as it was written
            return vector if abs(length - 1.0) <= 4.0 * np.finfo(np.float64).eps else np.asarray(vector / length)
        if self.opening_angle_deg is not None and self.phase_deg is not None:
            return cone_direction(np.deg2rad(self.opening_angle_deg), np.deg2rad(self.phase_deg))
        if self.sideways_deg is not None and self.upwards_deg is not None:
            side, up = np.deg2rad(self.sideways_deg), np.deg2rad(self.upwards_deg)
            return np.array([-np.cos(up) * np.cos(side), np.cos(up) * np.sin(side), np.sin(up)])
        raise InputError(
            f"Beam {self.id} has no direction: give opening_angle_deg and phase_deg, sideways_deg and upwards_deg, "
            "or vector."
        )


class _ListedBeams(Table):
    """Beams written one by one, with the focus distances of all (planes) or of each, and times if not even."""

    pattern: Literal["list"]
    beam: Annotated[list[_Beam], Field(min_length=1, max_length=MOST_BEAMS)]
    focus_distance: Distances | None = None

    def directions(self) -> FloatArray:
        return np.array([beam.direction() for beam in self.beam])


class _Timing(Table):
    """When the beams are sampled."""

    scan_duration: Annotated[float, Field(ge=1e-9, le=1e6, allow_inf_nan=False)]  # time has a resolution of 1e-9 s
    planes: Literal["simultaneous", "sequential"] = "simultaneous"


class _Mounting(Table):
    """How the instrument is mounted."""

    tilt_deg: Annotated[float, Field(ge=-90.0, le=90.0, allow_inf_nan=False)] = 0.0
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0, allow_inf_nan=False)] = 0.0


class _PointProbe(Table):
    """No probe volume."""

    kind: Literal["point"]


class _ContinuousWaveProbe(Table):
    """Lorentzian weighting, by its Rayleigh length or by the optics."""

    kind: Literal["continuous-wave"]
    wavelength: Size | None = None
    aperture_radius: Size | None = None
    rayleigh_length: Size | None = None


class _PulsedProbe(Table):
    """A pulse, convolved with a range gate."""

    kind: Literal["pulsed"]
    gate_length: Size
    pulse: Literal["top-hat", "gaussian"] = "top-hat"
    pulse_length: Size | None = None


class _ScanFile(Table):
    title: Text
    source: Text
    aliases: list[Text] = Field(default_factory=list)  # other names of a preset, see `bayes_rs.models.find_model`
    beams: Annotated[_ConeBeams | _RosetteBeams | _ListedBeams, Field(discriminator="pattern")]
    timing: _Timing
    mounting: _Mounting = _Mounting()
    file: dict[str, Any] = Field(default_factory=dict)
    probe: Annotated[_PointProbe | _ContinuousWaveProbe | _PulsedProbe, Field(discriminator="kind")] = _PointProbe(
        kind="point"
    )


def cone_direction(opening_angle: FloatArray | float, phase: FloatArray | float) -> FloatArray:
    """Return the unit vectors of a forward-looking lidar, n(φ, θ) = (−cos φ, cos θ sin φ, sin θ sin φ).

    Parameters
    ----------
    opening_angle : float or ndarray, shape (...)
        Half-cone opening angle φ from the −x axis, rad.
    phase : float or ndarray, shape (...)
        Angle θ from the y axis of the projection on the y–z plane, rad.

    Returns
    -------
    direction : ndarray, shape (..., 3)
        Unit vectors in the instrument's frame.

    References
    ----------
    Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, Eq. (2).
    """
    sine = np.sin(opening_angle)
    return np.stack(np.broadcast_arrays(-np.cos(opening_angle), np.cos(phase) * sine, np.sin(phase) * sine), axis=-1)


def load_scan_text(text: str, *, name: str, **changes: Any) -> Scan:
    """Load a scan from the text of a scan file; see `load_scan` for the changes.

    Raises
    ------
    InputError
        If the text is not that of a scan file, or a change does not apply.
    """
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "scan.toml"
        file.write_text(text, encoding="utf-8", newline="\n")
        return replace(load_scan(file, **changes), name=name)


def load_scan(
    name: str | Path,
    *,
    opening_angle_deg: float | None = None,
    focus_distance: float | Sequence[float] | None = None,
    tilt_deg: float | None = None,
    yaw_deg: float | None = None,
    probe: str | Probe | None = None,
    n_beams: int | None = None,
    centre: bool | None = None,
) -> Scan:
    """Load a scan by its name in ``models/scans`` or from a TOML file.

    Parameters
    ----------
    name : str or Path
        Name or alias of a preset, as ``"windcube-nacelle"``, or path of a ``.toml`` file; behind an ``@`` it may carry
        the changes below, as in ``"zx-300@focus_distance=49+98,probe=point"``.
    opening_angle_deg : float, optional
        Another half-cone opening angle, degrees; for a rosette its largest one.
    focus_distance : float or sequence of float, optional
        Another focus distance along every beam, m, also where the file gives each beam its own; several for several
        measurement planes.
    tilt_deg, yaw_deg : float, optional
        Another mounting, degrees.
    probe : str or Probe, optional
        ``"point"`` for beams without a probe volume, the name of a scan whose probe it is, or a probe; by default the
        file's own.
    n_beams : int, optional
        Another number of beams of a cone: all of a plane, one along the axis included.
    centre : bool, optional
        Whether one of these beams points along the axis.

    Returns
    -------
    scan : Scan
        The scan. Beams of several planes are numbered plane by plane. Changes behind an ``@`` stay in its name.

    Raises
    ------
    InputError
        If there is no such preset or file, the file is not valid, a change does not apply to the scan's pattern, or is
        given both behind the ``@`` and as an argument.

    Examples
    --------
    >>> load_scan("6-beam", opening_angle_deg=45.0).n_beam
    6
    >>> load_scan("spinnerlidar").probe_length[0].round(2), load_scan("spinnerlidar@probe=point").probe
    (np.float64(1.72), PointProbe())
    """
    for what, angle in (("opening_angle_deg", opening_angle_deg), ("tilt_deg", tilt_deg), ("yaw_deg", yaw_deg)):
        if angle is not None:
            check_finite(angle, what=what, unit="degrees")
    if centre is not None:
        check_switch(centre, what="centre")
    base, changes = split_changes(name)
    if base == "auto":
        raise InputError("Scan auto is found in files of rays, and there are none here: name a scan or its file.")
    if changes:
        given = _given(
            opening_angle_deg=opening_angle_deg,
            focus_distance=focus_distance,
            tilt_deg=tilt_deg,
            yaw_deg=yaw_deg,
            probe=probe,
            n_beams=n_beams,
            centre=centre,
        )
        for key in given:
            if key in changes:
                raise InputError(f"Invalid scan {str(name)!r}: {key} is also given as an option; give it once.")
        scan = load_scan(base, **{**given, **changes})
        return replace(scan, name=f"{scan.name}@{str(name).rpartition('@')[2]}")
    path = find_model(name, "scans")
    table = _read_table(path)
    if opening_angle_deg is not None and table.get("beams", {}).get("pattern") == "list":
        raise InputError(
            f"Scan {path.stem!r} lists its beams one by one, so opening_angle_deg={opening_angle_deg!r} does not "
            "apply: write a TOML file with the beams that you want."
        )
    if focus_distance is not None:
        table = _without_own_distances(table, path, focus_distance)
    new = {
        "beams": _given(opening_angle_deg=opening_angle_deg, focus_distance=_as_list(focus_distance))
        | _other_beams(table, path, n_beams, centre),
        "mounting": _given(tilt_deg=tilt_deg, yaw_deg=yaw_deg),
    }
    spec = _validate(table, path, {part: values for part, values in new.items() if values})
    file_format = _file_format(spec.file, path)
    if focus_distance is not None:
        file_format.pop("range", None)  # who gives the distance does not want all that the files have
    scan = _build(path.stem, spec, file_format)
    return scan if probe is None else replace(scan, probe=as_probe(probe))


def _other_beams(table: dict[str, Any], path: Path, n_beams: int | None, centre: bool | None) -> dict[str, Any]:
    """Return the keys of a cone with another number of beams, or another choice of the one along the axis."""
    if n_beams is None and centre is None:
        return {}
    own = _validate(table, path, {}).beams
    if not isinstance(own, _ConeBeams):
        raise InputError(
            f"The beams of scan {path.stem!r} are a {own.pattern}, so n_beams and centre do not apply: write a TOML "
            "file with the beams that you want."
        )
    held = own.centre if centre is None else centre
    total = own.count + own.centre if n_beams is None else check_count(n_beams, what="n_beams")
    return {"count": total - held, "centre": held}


def _without_own_distances(table: dict[str, Any], path: Path, focus_distance: Any) -> dict[str, Any]:
    """Return a scan file without the focus distance of each beam, for one of all in its place."""
    beams = _validate(table, path, {}).beams
    if not isinstance(beams, _ListedBeams) or beams.focus_distance is not None:
        return table
    if _own_values(path.stem, beams, "focus_distance") is None:
        return table
    direction = beams.directions()
    if len(np.unique(np.round(direction, _SAME_DIRECTION), axis=0)) < len(direction):
        raise InputError(
            f"Scan {path.stem!r} gives each beam its own focus_distance, and several to one direction, so "
            f"focus_distance={in_short(focus_distance)} of all does not apply: write a TOML file with the "
            "distances that you want."
        )
    bare = [{key: value for key, value in beam.items() if key != "focus_distance"} for beam in table["beams"]["beam"]]
    return {**table, "beams": {**table["beams"], "beam": bare}}


def _given(**arguments: Any) -> dict[str, Any]:
    return {name: value for name, value in arguments.items() if value is not None}


def as_probe(probe: str | Probe) -> Probe:
    """Return the probe volume that `probe` means: ``"point"``, the name of a scan that has one, or a probe."""
    if isinstance(probe, Probe):
        return probe
    if not isinstance(probe, (str, Path)):
        raise InputError(
            f"Invalid probe {in_short(probe)}: give 'point', a scan that has one, or what make_probe returns."
        )
    if probe == "point":
        return make_probe(probe)
    try:
        found = load_scan(probe).probe
    except InputError as error:
        raise InputError(
            f"Invalid probe {in_short(probe)}: it must be 'point', a scan that has one, or what make_probe "
            f"returns. {error}"
        ) from error
    if found == make_probe("point"):
        raise InputError(
            f"Invalid probe {in_short(probe)}: that scan has no probe volume; write 'point' if none is meant."
        )
    return found


def _as_list(value: float | Sequence[float] | None) -> list[float] | None:
    if value is None:
        return None
    return [float(item) for item in np.ravel(as_numbers(value, what="focus_distance"))]


def _read_table(path: Path, deeper: int = 0) -> dict[str, Any]:
    table = read_toml(path)
    if "base" not in table:
        return table
    name = table["base"]
    if not isinstance(name, str) or not name.isprintable() or Path(name).name != name or len(name) > _MOST_NAME:
        raise InputError(
            f"Invalid scan file {str(path)!r}: base = {shown(name)}: it must be the name of a scan: of a preset or of "
            "a file beside this one."
        )
    if deeper == _MOST_BASES:
        raise InputError(
            f"Invalid scan file {str(path)!r}: base = {name!r}: more than {_MOST_BASES} files are based on each other; "
            "write one of them out."
        )
    base_path = path.parent / f"{name}.toml"
    base = _read_table(base_path if base_path.is_file() else find_model(name, "scans"), deeper + 1)
    base.pop("aliases", None)
    if isinstance(table.get("probe"), dict) and "kind" in table["probe"]:
        base.pop("probe", None)  # the lengths of one kind mean nothing to another
    return _merge(base, {key: value for key, value in table.items() if key != "base"})


def _merge(base: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in new.items():
        merged[key] = (
            _merge(merged[key], value) if isinstance(value, dict) and isinstance(merged.get(key), dict) else value
        )
    return merged


_MOST_BASES, _MOST_NAME = 8, 200
_SAME_DIRECTION = 6  # decimals of unit vectors
_TAGS = ("cone", "rosette", "list", "point", "continuous-wave", "pulsed")  # pydantic names the kind of table, too


def _validate(table: dict[str, Any], path: Path, changes: dict[str, Any]) -> _ScanFile:
    """Return a file with the values that were given in place of its own; say whose fault it is if it is not valid."""
    can_be_changed = all(isinstance(table.get(part, {}), dict) for part in changes)
    try:
        return _ScanFile.model_validate(_merge(table, changes) if can_be_changed else table)
    except ValidationError as error:
        try:
            _ScanFile.model_validate(table)
        except ValidationError as own:
            raise invalid_file("scan", path, own, leave_out=_TAGS) from own
        fault = first_fault(error, leave_out=_TAGS)
        raise InputError(f"Invalid change of scan {path.stem!r}: {fault}.") from error


def _file_format(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return what the table ``[file]`` says, checked and in one form."""
    known = {entry.name: entry.type for entry in options_of(FileOptions) if entry.name not in OF_READING}
    for name, value in table.items():
        if name not in known:
            hint = nearest(name, known) if len(name) < 100 else "remove it."
            place = name if name.isprintable() and len(name) < 100 else shown(name)
            raise InputError(f"Invalid scan file {str(path)!r}: file.{place} = {shown(value)}: unknown key; {hint}")
    try:
        options = to_plain(from_plain(FileOptions, table, where="file"))
    except InputError as error:
        fault = str(error)
        raise InputError(f"Invalid scan file {str(path)!r}: file: {fault[0].lower()}{fault[1:]}") from error
    return {name: value for name, value in options.items() if name in table}


def _build(name: str, spec: _ScanFile, file_format: dict[str, Any]) -> Scan:
    directions = spec.beams.directions()
    distances, own_times = _distances(name, spec.beams), _own_values(name, spec.beams, "time")
    n_beam, n_plane = len(directions), len(distances)
    if n_beam * n_plane > MOST_BEAMS:
        raise InputError(
            f"Scan {name!r} has {n_beam} beams on {n_plane} planes: all together may be {MOST_BEAMS}; give fewer."
        )
    if n_beam == 0:
        raise InputError(f"Scan {name!r} has no beam: beams.count is 0 and beams.centre is false.")
    step = spec.timing.scan_duration / n_beam
    times = step * np.arange(n_beam) if own_times is None else own_times
    if spec.timing.planes == "sequential":  # a plane is scanned before the next one is focused
        duration = spec.timing.scan_duration * n_plane
        all_times = np.concatenate([times + plane * spec.timing.scan_duration for plane in range(n_plane)])
    else:
        duration = spec.timing.scan_duration
        all_times = np.tile(times, n_plane)
    if isinstance(spec.beams, _ListedBeams) and n_plane == 1:
        numbers = np.array([beam.id for beam in spec.beams.beam])
    else:
        numbers = np.arange(n_beam * n_plane)
    return Scan(
        name=name,
        beam_direction=np.tile(directions, (n_plane, 1)),
        focus_distance=np.concatenate([np.broadcast_to(plane, n_beam) for plane in distances]),
        beam_time=all_times,
        scan_duration=duration,
        beam=numbers,
        tilt=float(np.deg2rad(spec.mounting.tilt_deg)),
        yaw=float(np.deg2rad(spec.mounting.yaw_deg)),
        title=spec.title,
        source=spec.source,
        file_format=file_format,
        probe=make_probe(**spec.probe.model_dump()),
    )


def _distances(name: str, beams: _ConeBeams | _RosetteBeams | _ListedBeams) -> list[FloatArray]:
    """Return the focus distance of each plane, one for all of its beams or one each."""
    own, common = _own_values(name, beams, "focus_distance"), beams.focus_distance
    if own is not None and common is not None:
        raise InputError(
            f"Scan {name!r} gives focus_distance both for all beams and for each of them: give one of the two."
        )
    if own is not None:
        return [own]
    if common is None:
        raise InputError(
            f"Scan {name!r} has no focus_distance: give beams.focus_distance, or one in each of beams.beam."
        )
    return [np.asarray(distance) for distance in common]


def _own_values(
    name: str, beams: _ConeBeams | _RosetteBeams | _ListedBeams, key: Literal["focus_distance", "time"]
) -> FloatArray | None:
    """Return what each beam of a list gives for itself; None if none does."""
    if not isinstance(beams, _ListedBeams):
        return None
    values = [getattr(beam, key) for beam in beams.beam]
    given = [value is not None for value in values]
    if not any(given):
        return None
    if not all(given):
        raise InputError(
            f"Beam {beams.beam[given.index(False)].id} of scan {name!r} has no {key}, and others have: "
            "give it to all of them or to none."
        )
    return np.array(values, dtype=np.float64)


def _upward_direction(opening_angle: FloatArray, phase: FloatArray) -> FloatArray:
    sine = np.sin(opening_angle)
    return np.stack([np.cos(phase) * sine, np.sin(phase) * sine, np.cos(opening_angle)], axis=-1)


def as_scan(scan: Scan | str | Path) -> Scan:
    """Return the scan itself, or that of a name or file; see `load_scan`.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, its name in ``models/scans`` (with changes, as ``"6-beam@yaw_deg=10"``), or a TOML file.

    Returns
    -------
    scan : Scan
        The scan.

    Raises
    ------
    InputError
        If it is anything else, such as records, or names no scan.

    Examples
    --------
    >>> as_scan("6-beam").n_beam
    6
    """
    return scan if isinstance(scan, Scan) else load_scan(scan)
