"""What the covariances between beams add, and what they cost where the air has another coherence.

    python benchmarks/covariances.py [RECORDS [more]]

Records of the second generator (`air.py`) under all defaults, by variances and by covariances: means over the truth,
how often 90 % intervals hold it, widths over those of the variances, and what the program says of the coherence. The
table goes to covariances.csv; ``more`` goes on where that ends.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import air
import numpy as np
import pandas as pd

import bayes_rs as brs

MANN = {
    "fu-2022": air.MannAir(0.05, 61.0, 3.2),
    "unstable": air.MannAir(0.05, 90.0, 2.3),
    "stable": air.MannAir(0.05, 25.0, 2.6),
}
OTHER = {
    "kaimal": (air.KaimalAir(), {}),
    "v, w of a third of L": (air.OtherCoherence(0.05, 61.0, 3.2, across=1.0 / 3.0), {}),
    "large flat eddies": (air.OtherCoherence(0.05, 61.0, 3.2, flat=(0.5, 500.0)), {}),
    "slow vv doubled": (air.OtherCoherence(0.05, 61.0, 3.2, slow_v=1.0), {}),
    "wake, half more": (air.MannAir(0.05, 61.0, 3.2), {"wake": (-20.0, 70.0, 0.5)}),
    "intermittent": (air.MannAir(0.05, 61.0, 3.2), {"modulation": (0.25, 100.0)}),
}
SCANS = (
    "2-beam",
    "4-beam",
    "4-beam@focus_distance=80+120",
    "5-beam",
    "6-beam@opening_angle_deg=15",
    "6-beam@opening_angle_deg=30",
    "6-beam@opening_angle_deg=45",
    "50-beam",
    "wls200s-dbs",
)
OF_OTHER = ("4-beam", "6-beam@opening_angle_deg=15", "6-beam@opening_angle_deg=45")
SPEED = 10.0


def row(name: str, kind: object, scan_name: str, n_record: int, **changes: object) -> list[dict[str, object]]:
    """Return the rows of a scene: one for each information."""
    scan = brs.load_scan(scan_name)
    series, truth = air.make_series(scan, kind, n_record=n_record, wind_speed=SPEED, seed=17, **changes)
    records = brs.make_records(series, scan, correlations=True)
    began = time.process_time()
    fit = brs.fit(records, scan, seed=1, information="covariances", campaign="off", draws="none", sampler="direct")
    spent = time.process_time() - began
    coherence = fit.coherence()
    true, rows = truth["stresses_record"], []
    tables = {which: fit.summary(information=which) for which in ("variances", "covariances")}
    wide = {which: _stresses(table, "high") - _stresses(table, "low") for which, table in tables.items()}
    for which, table in tables.items():
        low, high, mean = (_stresses(table, name) for name in ("low", "high", "mean"))
        holds = ((low <= true) & (true <= high)).mean(axis=0)
        found: dict[str, object] = {"air": name, "scan": scan_name, "n_record": n_record, "information": which}
        for place, stress in enumerate(brs.STRESSES):
            of = true[:, place].mean()
            bias = mean[:, place].mean() / of if place < 3 or abs(of) > 1e-6 else mean[:, place].mean()
            found |= {
                f"mean_{stress}": round(float(bias), 3),
                f"holds_{stress}": round(float(holds[place]), 3),
                f"width_{stress}": round(float(np.median(wide[which][:, place] / wide["variances"][:, place])), 3),
            }
        found |= {
            "misfit": round(coherence.misfit, 3),
            "pattern": round(coherence.pattern, 3),
            "doubted": coherence.doubted,
            "beams_doubted": round(fit.flags["beams_disagree"] / n_record, 3),
            "beams_together": len(fit.run.get("beams", {}).get("together", [])),
            "fit_seconds": round(spent, 1),
        }
        rows.append(found)
    return rows


def _stresses(table: pd.DataFrame, name: str) -> np.ndarray:
    return np.asarray(table[name]).reshape(-1, len(brs.STRESSES))


def main() -> None:
    """Write the table."""
    n_record = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    scenes = [(name, kind, scan, {}) for scan in SCANS for name, kind in MANN.items()]
    scenes += [(name, kind, scan, more) for name, (kind, more) in OTHER.items() for scan in OF_OTHER]
    file = Path(__file__).with_suffix(".csv")
    rows: list[dict[str, object]] = pd.read_csv(file).to_dict("records") if sys.argv[2:] == ["more"] else []
    done = {(one["air"], one["scan"]) for one in rows}
    for name, kind, scan, changes in scenes:
        if (name, scan) in done:
            continue
        rows += row(name, kind, scan, n_record, **changes)
        pd.DataFrame(rows).to_csv(file, index=False, lineterminator="\n")
        print(pd.DataFrame(rows[-2:]).to_string(index=False, header=False), flush=True)


if __name__ == "__main__":
    main()
