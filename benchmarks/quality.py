"""False alarms and hits of the quality rules: on sound simulated turbulence, and on faults that are planted in it.

python benchmarks/quality.py OUTPUT writes quality-false-alarms.csv, quality-hits.csv and quality-remarks.csv, which
docs/quality.md shows.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import bayes_rs as brs
from bayes_rs.records.flags import REMARK_FLAGS

TURBULENCE = ("fu-2022", "iec-a", "neutral-onshore", "stable-onshore", "unstable-onshore")
CASES = (("6-beam", 10.0), ("6-beam", 6.0), ("pulsed-4-beam", 10.0))
N_RECORD = 300
BLADES = (0.3, 1.2)
ROTOR = 0.2  # turns a second, of three blades


def remarked(records: xr.Dataset) -> float:
    """Return the share of records that are not stationary by the rules."""
    return float(((records["record_flag"].values & REMARK_FLAGS["not_stationary"]) > 0).mean())


def report_of(records: xr.Dataset) -> dict:
    """Return what the making of the records found."""
    return json.loads(records.attrs["records_report"])


def dropped(records: xr.Dataset, name: str) -> float:
    """Return the share of samples that a filter dropped."""
    report = report_of(records)
    return report["dropped"][name] / report["samples"]


def variance_change(records: xr.Dataset, sound: xr.Dataset) -> float:
    """Return the relative change of the mean beam variance."""
    return float(records["variance"].mean() / sound["variance"].mean()) - 1.0


def false_alarms() -> pd.DataFrame:
    """Measure what each rule does to stationary Mann turbulence, which has no fault."""
    rows = []
    for scan_name, wind_speed in CASES:
        scan = brs.load_scan(scan_name, probe="point")
        for name in TURBULENCE:
            flow = brs.load_turbulence(name)
            series = brs.simulate(scan, flow, wind_speed=wind_speed, n_records=N_RECORD, seed=1)
            rounded = series.assign(radial_velocity=series["radial_velocity"].round(1))

            def records(data: xr.Dataset, scan: brs.Scan = scan, **rules: object) -> xr.Dataset:
                return brs.make_records(data, scan, quality=brs.QualityRules(**rules))

            sound = records(series)
            spikes, blades = records(series, despike="median"), records(series, blade_threshold=5.0)
            some_blades = [
                report_of(records(part, blade_threshold=3.0, blade_frequency=BLADES))["blades"]
                for _, part in series.groupby(series["time"].dt.floor("5h"))
            ]
            p_values = [beam["p_value"] for hours in some_blades for beam in hours if beam["p_value"] is not None]
            rows.append(
                {
                    "scan": scan_name,
                    "U": wind_speed,
                    "turbulence": name,
                    "L/(UT)": flow.length_scale / (600.0 * wind_speed),
                    "despike": dropped(spikes, "despike"),
                    "despike, variance": variance_change(spikes, sound),
                    "blade": dropped(blades, "blade"),
                    "blade, variance": variance_change(blades, sound),
                    "frozen 5, 0.1 m/s": dropped(records(rounded, frozen_run=5), "frozen"),
                    "blades, p < 0.05": float(np.mean(np.array(p_values) < 0.05)),
                    "blades reported": float(np.mean(np.array(p_values) < 1e-3)),
                    "trend 0.01": remarked(records(series, trend_level=0.01)),
                    "sub-variance 0.3": remarked(records(series, sub_variance_limit=0.3)),
                    "half ratio 4": remarked(records(series, half_ratio_limit=4.0)),
                }
            )
            print(rows[-1])
    return pd.DataFrame(rows)


def hits() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measure how much of each planted fault is found, and what else goes, in the turbulence fu-2022."""
    scan, flow = brs.load_scan("6-beam"), brs.load_turbulence("fu-2022")
    series = brs.simulate(scan, flow, wind_speed=10.0, n_records=N_RECORD, seed=2)
    velocity, rng = series["radial_velocity"].values, np.random.default_rng(3)
    seconds = (series["time"].values - series["time"].values[0]) / np.timedelta64(1, "ns") * 1e-9
    within = seconds % 600.0 / 600.0
    sigma = np.sqrt(brs.make_records(series, scan)["variance"].mean().item())
    rows = []

    def samples(fault: str, spoilt: np.ndarray, bad: np.ndarray, rules: brs.QualityRules, name: str) -> xr.Dataset:
        spoilt_series = series.assign(radial_velocity=("sample", spoilt))
        records = brs.make_records(spoilt_series, scan, quality=rules)
        kept = brs.make_records(spoilt_series.isel(sample=~bad), scan)
        alone = brs.make_records(spoilt_series, scan)
        gone = report_of(records)["dropped"][name] / len(bad)
        # which of them were bad: the bad ones once more, as missing, leave what else is dropped
        marked = spoilt_series.assign(radial_velocity=("sample", np.where(bad, np.nan, spoilt)))
        else_gone = report_of(brs.make_records(marked, scan, quality=rules))["dropped"][name] / len(bad)
        rows.append(
            {
                "fault": fault,
                "rule": name,
                "planted": bad.mean(),
                "dropped": gone,
                "dropped without the fault": else_gone,
                "variance before": variance_change(alone, kept),
                "variance after": variance_change(records, kept),
            }
        )
        return records

    for size in (4.0, 6.0, 10.0):
        bad = rng.random(len(velocity)) < 0.01
        spoilt = velocity + np.where(bad, size * sigma * rng.choice([-1.0, 1.0], len(velocity)), 0.0)
        samples(f"1 % spikes of {size:g} σ", spoilt, bad, brs.QualityRules(despike="median"), "despike")
    phase = rng.random(scan.n_beam)[series["beam"].values]
    for wander in (0.0, 0.02):
        turns = ROTOR * (seconds + wander * np.cumsum(np.random.default_rng(4).normal(size=len(seconds))))
        bad = (3.0 * turns + phase) % 1.0 < 0.15
        spoilt = np.where(bad, rng.normal(0.0, 0.3, len(velocity)), velocity)
        rules = brs.QualityRules(blade_threshold=5.0, blade_frequency=BLADES)
        records = samples(f"blades, phase wanders {wander:g}", spoilt, bad, rules, "blade")
        print([(beam["frequency"], beam["p_value"]) for beam in report_of(records)["blades"]])
    start = rng.random(len(velocity)) < 0.001
    spoilt, bad = velocity.copy(), np.zeros(len(velocity), dtype=bool)
    for index in np.flatnonzero(start):
        run = index + scan.n_beam * np.arange(10)
        run = run[run < len(velocity)]
        spoilt[run], bad[run] = velocity[index], True
    samples("runs of 10 equal values", spoilt, bad, brs.QualityRules(frozen_run=5), "frozen")

    checks = {
        "trend 0.01": brs.QualityRules(trend_level=0.01),
        "sub-variance 0.3": brs.QualityRules(sub_variance_limit=0.3),
        "sub-variance 0.6": brs.QualityRules(sub_variance_limit=0.6),
        "half ratio 4": brs.QualityRules(half_ratio_limit=4.0),
    }
    along = scan.line_of_sight[:, 0][series["beam"].values]
    fluctuation = velocity - 10.0 * along
    faults = {"none": velocity}
    faults |= {f"ramp of {change:g} m/s": velocity + change * (within - 0.5) * along for change in (1.0, 2.0, 4.0, 6.0)}
    faults |= {
        f"variance × {factor:g} in the second half": velocity + (np.sqrt(factor) - 1.0) * fluctuation * (within >= 0.5)
        for factor in (2.0, 4.0, 8.0)
    }
    more = []
    sound = brs.make_records(series, scan)
    for fault, spoilt in faults.items():
        data = series.assign(radial_velocity=("sample", spoilt))
        change = variance_change(brs.make_records(data, scan), sound)
        found = {name: remarked(brs.make_records(data, scan, quality=rules)) for name, rules in checks.items()}
        more.append({"fault": fault, "variance": change, **found})
    return pd.DataFrame(rows), pd.DataFrame(more)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    output = parser.parse_args().output
    found, remarks = hits()
    print(found.to_string(), remarks.to_string(), sep="\n")
    found.to_csv(output / "quality-hits.csv", index=False, float_format="%.5f")
    remarks.to_csv(output / "quality-remarks.csv", index=False, float_format="%.5f")
    false_alarms().to_csv(output / "quality-false-alarms.csv", index=False, float_format="%.5f")
