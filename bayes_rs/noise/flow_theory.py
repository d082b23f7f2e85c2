"""The noise of a scan by theory at any states of the flow, each calculated once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_rs._validation import FloatArray
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.at_states import theory_at_states
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.turned import Turn
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence


class FlowTheory:
    """The noise by theory at points (ln U, yaw in degrees, ln L, Γ), each computed once.

    Parameters
    ----------
    scan : Scan
        The scan.
    turbulence : MannTurbulence
        The turbulence, but for L and Γ.
    duration : float
        Length of a record, s.
    progress : bool or None
        Show a progress bar; by default if stderr is a terminal.
    sonic : bool
        Add the joint moments with a sonic.
    turn : Turn, optional
        That turns the scan into itself.
    """

    def __init__(
        self,
        scan: Scan,
        turbulence: MannTurbulence,
        duration: float,
        progress: bool | None,
        *,
        sonic: bool = False,
        turn: Turn | None = None,
    ) -> None:
        self.scan, self.turbulence, self.duration, self.progress = scan, turbulence, duration, progress
        self.sonic, self.turn = sonic, turn
        self.known: dict[tuple[float, ...], Noise] = {}
        self.turned: dict[tuple[float, ...], Noise] = {}

    def states(self, points: FloatArray) -> list[Noise]:
        """Return the noise at points, shape (n, 4)."""
        if self.turn is None:
            return self._direct(points)
        names = [tuple(float(value) for value in np.round(point, 9)) for point in points]
        missing = {name: point for name, point in zip(names, points, strict=True) if name not in self.turned}
        split = [self.turn.split(float(point[1])) for point in missing.values()]
        from_zero = [[point[0], rest, *point[2:]] for point, (rest, _) in zip(missing.values(), split, strict=True)]
        for name, (_, steps), noise in zip(missing, split, self._direct(np.array(from_zero)), strict=True):
            self.turned[name] = self.turn.apply(noise, steps, name[1])
        return [self.turned[name] for name in names]

    def _direct(self, points: FloatArray) -> list[Noise]:
        names = [tuple(float(value) for value in np.round(point, 9)) for point in points]
        missing = {name: point for name, point in zip(names, points, strict=True) if name not in self.known}
        for flow in sorted({name[2:] for name in missing}):
            # direction by direction: covariances are calculated once for all wind speeds
            group = {name: missing[name] for name in sorted(missing, key=lambda name: name[1]) if name[2:] == flow}
            states = [self._state(point) for point in group.values()]
            made = theory_at_states(states, self._flow(flow), sonic=self.sonic, progress=self.progress)
            self.known.update(zip(group, made, strict=True))
        return [self.known[name] for name in names]

    def covariances(self, points: FloatArray) -> FloatArray:
        """Return K at points, shape (n, n_beam, n_beam); with a sonic the joint covariance, six rows larger."""
        return np.concatenate([n.joint_covariance if self.sonic else n.covariance for n in self.states(points)])

    def _state(self, point: FloatArray) -> RecordState:
        return RecordState(
            self.scan, round(float(np.exp(point[0])), 9), float(np.deg2rad(round(float(point[1]), 9))), self.duration
        )

    def _flow(self, flow: tuple[float, ...]) -> MannTurbulence:
        length_scale, gamma = float(np.exp(flow[0])), flow[1]
        if abs(length_scale - self.turbulence.length_scale) <= 1e-6 and abs(gamma - self.turbulence.gamma) <= 1e-9:
            return self.turbulence
        return replace(self.turbulence, length_scale=round(length_scale, 6), gamma=gamma)
