"""How far noise reaches: errors of interval widths when a record is a step away from the state of its noise.

The width of an interval of a log-variance goes as the root of K's diagonal. For each scan and each of wind speed,
direction, L and Γ, the largest relative error of that root over the beams, states and both signs of a step, and the
step at which it is 5 %. `bayes_rs.noise.flow_states.REACH` rests on it.

    python benchmarks/noise_reach.py
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

import bayes_rs as brs

SCANS = ("6-beam", "6-beam@opening_angle_deg=45", "2-beam", "4-beam", "50-beam", "zx-tm")
WIND_SPEEDS, YAWS_DEG = (5.0, 10.0, 20.0), (0.0, 20.0)
STEPS = {"ln U": (0.05, 0.1, 0.15), "yaw, degrees": (2.5, 5.0, 10.0), "ln L": (0.05, 0.1, 0.15), "Γ": (0.1, 0.3, 0.6)}


def spread(scan: brs.Scan, flow: brs.MannTurbulence, point: np.ndarray) -> np.ndarray:
    """Return the root of K's diagonal at (ln U, yaw in degrees, ln L, Γ)."""
    there = replace(flow, length_scale=float(np.exp(point[2])), gamma=float(point[3]))
    noise = brs.noise.theory(scan, there, wind_speed=float(np.exp(point[0])), yaw=float(np.deg2rad(point[1])))
    return noise.relative_error[0]


def main() -> None:
    """Print a table."""
    flow = brs.load_turbulence("fu-2022")
    for name in SCANS:
        scan = brs.load_scan(name)
        if scan.n_beam > 12:
            scan = scan.select(scan.beam[:: scan.n_beam // 6])
        states = [
            np.array([np.log(speed), yaw, np.log(flow.length_scale), flow.gamma])
            for speed, yaw in product(WIND_SPEEDS, YAWS_DEG)
        ]
        own = [spread(scan, flow, state) for state in states]
        for axis, (words, steps) in enumerate(STEPS.items()):
            errors = []
            for step in steps:
                moved = [
                    (spread(scan, flow, state + sign * step * np.eye(4)[axis]), before)
                    for state, before in zip(states, own, strict=True)
                    for sign in (-1.0, 1.0)
                ]
                errors.append(max(float(np.max(np.abs(before / after - 1.0))) for after, before in moved))
            reach = float(np.interp(0.05, [0.0, *errors], [0.0, *steps]))
            shown = ", ".join(f"{step:g}: {100 * error:.1f} %" for step, error in zip(steps, errors, strict=True))
            print(f"{name:28s} {words:13s} {shown}; 5 % at {reach:.2g}{' or more' if errors[-1] < 0.05 else ''}")


if __name__ == "__main__":
    main()
