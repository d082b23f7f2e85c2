"""The best scan that a search has found, and how well the search converged."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan

SAME_OPTIMUM = 1e-3
"""Starts whose criterion is above the best by no more than this part of it have found the same optimum."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanOptimum:
    """The best scan that was found, and how well the search converged.

    Parameters
    ----------
    scan : Scan
        The scan; `save_scan` writes it to a file.
    criterion : str
        Name of the criterion.
    meaning : str
        The criterion in words.
    value : float
        Criterion of the scan.
    by_state : dict of str to float
        Its value in each turbulence; the criterion is the largest.
    starts : ndarray, shape (n_start,)
        What each start has reached, increasing.
    references : dict of str to float
        Criterion of well-known scans with as many beams, the same focus distances and timing.
    outside : tuple of str
        Those of the references that break a limit.
    n_evaluations : int
        How often the criterion was evaluated.
    seconds : float
        How long it took.
    widths : dict of str to float
        Expected widths of the stresses' 90 % intervals over uu, the largest over the states; none for ``"trace"``.
    by_number : dict of int to float
        Criterion of the best scan of each number of beams, where several were tried.
    details : dict
        What was asked for.
    """

    scan: Scan
    criterion: str
    meaning: str
    value: float
    by_state: dict[str, float]
    starts: FloatArray
    references: dict[str, float]
    outside: tuple[str, ...]
    n_evaluations: int
    seconds: float
    widths: dict[str, float] = field(default_factory=dict)
    by_number: dict[int, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def n_agree(self) -> int:
        """Number of starts that reached the best one's value to 0.1 %."""
        return int(np.count_nonzero(self.starts <= self.starts[0] * (1.0 + SAME_OPTIMUM)))

    @property
    def spread(self) -> float:
        """How far the median start stayed above the best, relative to it."""
        return float(np.median(self.starts) / self.starts[0] - 1.0)

    @property
    def angles_deg(self) -> FloatArray:
        """Opening angle φ and θ of each beam of the first plane, shape (n_beams, 2), degrees."""
        return beam_angles_deg(self.scan, int(self.details["n_beams"]), str(self.details["axis"]))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for a JSON file."""
        return {
            "criterion": self.criterion,
            "meaning": self.meaning,
            "value": self.value,
            "by_state": self.by_state,
            "widths_over_uu": self.widths,
            "by_number": {str(number): value for number, value in self.by_number.items()},
            "beams": [
                {"opening_angle_deg": opening, "phase_deg": phase} for opening, phase in self.angles_deg.tolist()
            ],
            "starts": self.starts.tolist(),
            "starts_at_the_best": self.n_agree,
            "spread": self.spread,
            "references": self.references,
            "references_outside_the_limits": list(self.outside),
            "n_evaluations": self.n_evaluations,
            "seconds": self.seconds,
            "asked_for": self.details,
        }


def beam_angles_deg(scan: Scan, n_beams: int, axis: str) -> FloatArray:
    """Return φ and θ of the first beams, degrees; θ is 0 for a beam along the axis."""
    vector = scan.beam_direction[:n_beams]
    ahead, side, up = -vector[:, 0], vector[:, 1], vector[:, 2]
    if axis == "up":
        ahead, side, up = vector[:, 2], vector[:, 0], vector[:, 1]
    across = np.hypot(side, up)
    phase = np.where(across > 1e-9, np.mod(np.arctan2(up, side), 2.0 * np.pi), 0.0)
    return np.asarray(np.rad2deg(np.stack([np.arctan2(across, ahead), phase], axis=-1)))
