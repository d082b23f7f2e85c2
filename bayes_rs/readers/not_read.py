"""Files that lidars write and that hold nothing to read here: why, and what to give instead."""

from __future__ import annotations

from pathlib import Path

from bayes_rs.readers.compressed import plain_suffix

NOT_READ = {
    ".zph": "a ZephIR or ZX lidar's own binary file, whose layout is not published: convert it to CSV with the "
    "manufacturer's Waltz or ZPH2CSV, with the line-of-sight data, and give that",
    ".sta": "the statistics of a WindCube, which hold no radial velocities of beams: give its .rtd file",
    ".stdsta": "the statistics of a WindCube, which hold no radial velocities of beams: give its .rtd or .stdrtd file",
    ".gyro": "the motion of a WindCube, without radial velocities: give its .rtd file",
}
"""What files with these suffixes are. A folder passes them over; one that is named itself is refused with this."""


def why_not(file: Path) -> str | None:
    """Say in a line why a file is not read; None if its suffix does not tell."""
    what = NOT_READ.get(plain_suffix(file))
    return None if what is None else f"File {str(file)!r} is {what}."
