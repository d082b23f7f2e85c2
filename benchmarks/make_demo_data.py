"""Make the radial velocities that `bayes-rs demo` reads: one hour of one wind, seen by three lidars.

Run in the project's environment with the extra `boxes`: python benchmarks/make_demo_data.py
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd

import bayes_rs as brs
from bayes_rs.cli.demo_job import SCENES, WIND_SPEED
from bayes_rs.geometry.scan import Scan

N_RECORD = 6
SEED = 20
RESOLUTION = 0.01  # m/s, as in files of real lidars

folder = Path(__file__).resolve().parents[1] / "models" / "demo"


def main() -> None:
    """Simulate all scans as one, so that they see the same air, and write a file for each."""
    scans = {name: brs.load_scan(base, **options) for name, (base, options) in SCENES.items()}
    together = Scan(
        "all",
        np.concatenate([scan.line_of_sight for scan in scans.values()]),
        focus_distance=np.concatenate([scan.focus_distance for scan in scans.values()]),
        beam_time=np.concatenate([scan.beam_time for scan in scans.values()]),
        scan_duration=1.0,
    )
    series = brs.simulate(
        together, brs.load_turbulence("fu-2022"), wind_speed=WIND_SPEED, n_records=N_RECORD, seed=SEED, method="boxes"
    )
    folder.mkdir(exist_ok=True)
    first = 0
    for name, scan in scans.items():
        inside = (series["beam"].values >= first) & (series["beam"].values < first + scan.n_beam)
        velocity = np.round(series["radial_velocity"].values[inside] / RESOLUTION) * RESOLUTION
        pd.DataFrame(
            {
                "time": series["time"].values[inside].astype("datetime64[ms]"),
                "beam": (series["beam"].values[inside] - first).astype(np.int16),
                "radial_velocity": velocity.astype(np.float32),
            }
        ).to_parquet(folder / f"{name}.parquet", compression="zstd", compression_level=19, index=False)
        first += scan.n_beam
    truth = json.loads(series.attrs["truth"])
    (folder / "truth.json").write_text(json.dumps(truth, indent=2, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
