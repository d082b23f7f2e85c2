"""Fronts, trends and the scatter of variances: how often they are found, and what intervals then hold.

Records by the line simulator, whose level at every L is that of the shipped flow fu-2022 (uu = 1.37 m² s⁻², 10 m/s).
Fronts are steps of 3 m/s, smoothed over 10 s, of either sign and at any time in the middle 80 % of a record; trends
2 m/s over the record. Beside the power stands that of the best possible test, which knows shape, place, sign, L and
level. Wandering strength is exp(s g − s²), g an Ornstein–Uhlenbeck process; intervals are those of 90 % for uu.

    python benchmarks/block_checks.py [steadiness|scatter]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.stats
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.block_checks import with_block_checks
from bayes_rs.fits.block_states import block_states
from bayes_rs.fits.steadiness import whitening_of
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.records.block_statistics import chosen_beams

SCANS = ("6-beam@opening_angle_deg=45", "zx-tm", "pulsed-4-beam", "2-beam")
LENGTH_SCALES = (15.0, 61.0, 200.0)
STRENGTHS = (None, (0.25, 100.0), (0.4, 100.0))
LEVEL, DURATION, N_RECORD = 0.02, 600.0, 300
Change = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def front(since: np.ndarray, moment: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """A smoothed step of 3 m/s."""
    return 3.0 * sign * np.clip((since - moment) / 10.0 + 0.5, 0.0, 1.0)


def trend(since: np.ndarray, moment: np.ndarray, sign: np.ndarray) -> np.ndarray:  # noqa: ARG001 - as front
    """A line of 2 m/s over the record."""
    return 2.0 * sign * since / DURATION


def with_change(series: xr.Dataset, scan: Scan, change: Change, rng: np.random.Generator) -> xr.Dataset:
    """Add a change of the wind to each record."""
    nanoseconds = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    since = (nanoseconds % round(DURATION * 1e9)) * 1e-9
    record = nanoseconds // round(DURATION * 1e9)
    record -= record.min()
    n_record = int(record.max()) + 1
    moment, sign = DURATION * rng.uniform(0.1, 0.9, n_record), rng.choice([-1.0, 1.0], n_record)
    along = dict(zip(scan.beam.tolist(), scan.level_direction[:, 0].tolist(), strict=True))
    added = np.array([along[beam] for beam in series["beam"].values.tolist()])
    return series.assign(
        radial_velocity=series["radial_velocity"] + added * change(since, moment[record], sign[record])
    )


def best_power(covariance: np.ndarray, change: Change, rng: np.random.Generator) -> float:
    """Return the power of the test that knows all, the mean over moments."""
    whitening, number = whitening_of(covariance), len(covariance)
    since = (np.arange(number * 20) + 0.5) / (number * 20) * DURATION
    found = []
    for moment in DURATION * rng.uniform(0.1, 0.9, 200):
        shape = change(since, np.array(moment), np.array(1.0)).reshape(number, 20).mean(axis=1)
        found.append(scipy.stats.norm.sf(scipy.stats.norm.isf(LEVEL) - np.linalg.norm(whitening @ shape)))
    return float(np.mean(found))


def steadiness() -> None:
    """Print false alarms and power."""
    flow = brs.load_turbulence("fu-2022")
    print("scan, L, false alarms %, fronts found % (best possible), trends found % (best possible)")
    for name in SCANS:
        scan = chosen_beams(brs.load_scan(name))
        for length_scale in LENGTH_SCALES:
            own = replace(
                flow,
                length_scale=length_scale,
                dissipation=flow.dissipation * (flow.length_scale / length_scale) ** (2.0 / 3.0),
            )
            noise = theory_noise(scan, own, wind_speed=10.0)
            series = brs.simulate(scan, own, wind_speed=10.0, n_records=N_RECORD, seed=17)
            shares = []
            for change in (None, front, trend):
                rng = np.random.default_rng(18)
                changed = series if change is None else with_change(series, scan, change, rng)
                records = brs.make_records(changed, scan)
                checked = with_block_checks(records, scan, noise, brs.FitOptions(), lambda _: None)
                shares.append(100.0 * float(checked["unsteady"].values.mean()))
                states = block_states(records, scan, noise)
            if states is None:
                raise RuntimeError(f"scan {name} has too few samples for parts")
            state = max(states.groups(), key=lambda group: group[2].sum())[0]
            covariance = states.theory(state).wind[0]
            best = [100.0 * best_power(covariance, change, rng) for change in (front, trend)]
            print(
                f"{name}, {length_scale:g} m: {shares[0]:.1f}; {shares[1]:.0f} ({best[0]:.0f}); "
                f"{shares[2]:.0f} ({best[1]:.0f})",
                flush=True,
            )


def wandering(series: xr.Dataset, scan: Scan, depth: float, time_scale: float, rng: np.random.Generator) -> xr.Dataset:
    """Multiply the fluctuations by exp(s g − s²), the same for all beams."""
    nanoseconds = series["time"].values.astype("datetime64[ns]").astype(np.int64)
    step = (nanoseconds - nanoseconds.min()) // 1_000_000_000
    keep = np.exp(-1.0 / time_scale)
    shock = rng.standard_normal(int(step.max()) + 1)
    process = shock.copy()
    for index in range(1, len(shock)):
        process[index] = keep * process[index - 1] + np.sqrt(1.0 - keep**2) * shock[index]
    along = dict(zip(scan.beam.tolist(), scan.level_direction[:, 0].tolist(), strict=True))
    mean = 10.0 * np.array([along[beam] for beam in series["beam"].values.tolist()])
    factor = np.exp(depth * process - depth**2)[step]
    return series.assign(radial_velocity=mean + (series["radial_velocity"] - mean) * factor)


def scatter() -> None:
    """Print what 90 % intervals of uu hold, and their widths, with and without the records' own scatter."""
    flow = brs.load_turbulence("fu-2022")
    print("scan, s: v (median); 90 % of uu hold %, median width over uu, with the records' scatter and with theory's")
    for name in SCANS:
        scan = brs.load_scan(name)
        noise = theory_noise(scan, flow, wind_speed=10.0)
        truth = float(flow.stresses()[0])
        series = brs.simulate(scan, flow, wind_speed=10.0, n_records=150, seed=19)
        for strength in STRENGTHS:
            rng = np.random.default_rng(20)
            some = series if strength is None else wandering(series, scan, *strength, rng)
            records = brs.make_records(some, scan)
            told = []
            middle = 0.0
            for way in ("records", "theory"):
                found = brs.fit(
                    records, scan, noise=noise, seed=1, target="ensemble", target_ess=400, draws="none", scatter=way
                )
                uu = found.summary().query("stress == 'uu'")
                low, high = uu["low"].to_numpy(), uu["high"].to_numpy()
                told.append((100.0 * np.mean((low <= truth) & (truth <= high)), np.median(high - low) / truth))
                if way == "records":
                    middle = float(np.median(found.records["variance_scatter"].values))
            words = "; ".join(f"{share:.0f}, {width:.2f}" for share, width in told)
            print(f"{name}, {0.0 if strength is None else strength[0]:g}: v {middle:.3f}; {words}", flush=True)


if __name__ == "__main__":
    wanted = sys.argv[1:] or ["steadiness", "scatter"]
    for name in wanted:
        {"steadiness": steadiness, "scatter": scatter}[name]()
