"""Limits of the scans that `optimize_scan` searches: the keywords of the function, and those of the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_rs._validation import (
    FloatArray,
    check_array,
    check_choice,
    check_count,
    check_finite,
    check_non_negative,
    check_positive,
)
from bayes_rs.design.beam_space import BeamSpace, free_arcs
from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_probe
from bayes_rs.options import described, option

AXES = ("upwind", "up")
PLANES = ("simultaneous", "sequential")


@described
@dataclass(frozen=True, kw_only=True)
class ScanLimits:
    """What a scan may be: where its beams may point, and when and where they measure.

    Raises
    ------
    InputError
        If a value is not valid, or neither ``max_angle_deg`` nor ``rotor_radius`` is given.
    """

    max_angle_deg: float | None = option(
        None, "Largest opening angle from the instrument's axis", unit="degrees", flag="--max-angle"
    )
    rotor_radius: float | None = option(
        None, "Largest distance of a measured point from the axis; this or the largest angle must be given", unit="m"
    )
    focus_distance: float | Sequence[float] = option(
        98.0, "Focus distance; at several, all beams measure at each", unit="m"
    )
    cones: int | None = option(
        None, "How many opening angles the beams off the axis share; each has its own if not given"
    )
    centre: bool | None = option(
        None,
        "Whether one beam points along the axis; if not given, both are tried where cones are shared",
    )
    blocked_deg: Sequence[str | Sequence[float]] = option(
        (),
        "Ranges of θ, from y towards z, in which no beam may point, as 200:340 or (200, 340); 350:10 goes through 0",
        unit="degrees",
        flag="--blocked",
        metavar="FROM:TO",
    )
    min_elevation_deg: float | None = option(
        None, "Least angle of every beam above the horizontal", unit="degrees", flag="--min-elevation"
    )
    min_spread_deg: float = option(
        0.0, "Least angle between the two beams that are farthest apart", unit="degrees", flag="--min-spread"
    )
    axis: str = option("upwind", "Axis of the lidar: upwind on a nacelle, up on the ground", choices=AXES)
    tilt_deg: float = option(
        0.0, "Tilt of the lidar; a positive one raises the beams that point upwind", unit="degrees", flag="--tilt"
    )
    planes: str = option("simultaneous", "How several focus distances are measured", choices=PLANES)
    scan_duration: float | None = option(
        None, "Time for all beams and planes once, which they share equally: 1 s unless dwell says another", unit="s"
    )
    dwell: float | None = option(
        None, "Time for one beam, in place of the scan duration: with more beams each is visited less often", unit="s"
    )
    probe: str | Probe = option(
        "point", "Probe volume of the beams: point, or a scan whose probe volume they have", metavar="SCAN"
    )

    def __post_init__(self) -> None:
        check_choice(self.axis, AXES, what="axis")
        check_choice(self.planes, PLANES, what="planes")
        for distance in self.distances.tolist():
            check_positive(distance, what="focus_distance", unit="m")
        if self.max_angle_deg is not None:
            angle = check_finite(self.max_angle_deg, what="max_angle_deg", unit="degrees")
            if not 0.0 < angle <= 90.0:
                raise InputError(f"Invalid max_angle_deg {angle!r}: it must be above 0 and at most 90 degrees.")
        if self.rotor_radius is not None:
            check_positive(self.rotor_radius, what="rotor_radius", unit="m")
        elif self.max_angle_deg is None:
            raise InputError(
                "The beams have no limit: give max_angle_deg, the largest opening angle, or rotor_radius, m."
            )
        if self.cones is not None:
            check_count(self.cones, what="cones")
        if self.min_elevation_deg is not None:
            check_finite(self.min_elevation_deg, what="min_elevation_deg", unit="degrees")
        check_non_negative(self.min_spread_deg, what="min_spread_deg", unit="degrees")
        check_finite(self.tilt_deg, what="tilt_deg", unit="degrees")
        for name in ("scan_duration", "dwell"):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), what=name, unit="s")
        if self.dwell is not None and self.scan_duration is not None:
            raise InputError(
                f"Invalid dwell {self.dwell:g} s with scan_duration {self.scan_duration:g} s: one follows from the "
                "other and the number of beams; give one of them."
            )
        free_arcs(self.blocked)

    @property
    def distances(self) -> FloatArray:
        """The focus distances, m, shape (n_plane,)."""
        return check_array(np.atleast_1d(np.asarray(self.focus_distance)), (None,), what="focus_distance")

    @property
    def blocked(self) -> list[Sequence[float]]:
        """The blocked ranges as pairs of numbers, degrees."""
        return [_range(text) if isinstance(text, str) else text for text in self.blocked_deg]

    @property
    def max_angle(self) -> float:
        """The largest opening angle, rad, that cone and rotor disc allow at the largest focus distance."""
        limits = [] if self.max_angle_deg is None else [float(np.deg2rad(self.max_angle_deg))]
        if self.rotor_radius is not None:
            limits.append(float(np.arcsin(min(self.rotor_radius / float(np.max(self.distances)), 1.0))))
        return min(limits)

    def spaces(self, n_beams: int) -> list[BeamSpace]:
        """Return the kinds of scans to search: with and without a beam along the axis where both are to be tried.

        Raises
        ------
        InputError
            If so many beams have no room within the limits.
        """
        space = BeamSpace(
            n_beams=n_beams,
            max_angle=self.max_angle,
            arcs=free_arcs(self.blocked),
            min_elevation=None if self.min_elevation_deg is None else float(np.deg2rad(self.min_elevation_deg)),
            min_spread=float(np.deg2rad(self.min_spread_deg)),
            upward=self.axis == "up",
            tilt=float(np.deg2rad(self.tilt_deg)),
        )
        if space.min_spread > 2.0 * space.max_angle or (space.min_spread > 0.0 and n_beams == 1):
            raise InputError(
                f"Invalid min_spread_deg {self.min_spread_deg!r}: {n_beams} beams that are no more than "
                f"{np.rad2deg(space.max_angle):.4g} degrees off the axis cannot be so far apart; give a smaller one."
            )
        if self.cones is not None and self.cones > n_beams:
            raise InputError(f"Invalid cones {self.cones}: there are {n_beams} beams; give at most as many cones.")
        held = [self.centre] if self.centre is not None else [False] if self.cones is None else [True, False]
        least = 1 if self.cones is None else self.cones
        spaces = [replace(space, cones=self.cones, centre=bool(one)) for one in held if n_beams - bool(one) >= least]
        if not spaces:
            raise InputError(
                f"Invalid cones {self.cones}: with a beam along the axis, {n_beams - 1} beams are left; give fewer "
                "cones."
            )
        return spaces

    def duration(self, n_beams: int) -> float:
        """Return the time for all beams and planes once, s."""
        if self.dwell is None:
            return 1.0 if self.scan_duration is None else float(self.scan_duration)
        return n_beams * (len(self.distances) if self.planes == "sequential" else 1) * self.dwell

    def frame(self, n_beams: int) -> Scan:
        """Return a scan with the right distances, times and mounting, all beams along the axis."""
        n_plane, total = len(self.distances), self.duration(n_beams)
        if self.planes == "sequential":
            times = total * np.arange(n_beams * n_plane) / (n_beams * n_plane)
        else:
            times = np.tile(total * np.arange(n_beams) / n_beams, n_plane)
        ahead = [0.0, 0.0, 1.0] if self.axis == "up" else [-1.0, 0.0, 0.0]
        return Scan(
            name=f"optimized-{n_beams}-beam",
            beam_direction=np.tile([ahead], (n_beams * n_plane, 1)),
            focus_distance=np.repeat(self.distances, n_beams),
            beam_time=times,
            scan_duration=total,
            tilt=float(np.deg2rad(self.tilt_deg)),
            probe=PointProbe() if self.probe == "point" else as_probe(self.probe),
        )


def _range(text: str) -> tuple[float, float]:
    try:
        start, end = (float(part) for part in text.split(":"))
    except ValueError as error:
        raise InputError(f"Invalid blocked range {text!r}: write it as FROM:TO in degrees, such as 200:340.") from error
    return start, end
