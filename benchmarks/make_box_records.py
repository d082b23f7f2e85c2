"""Make the variances of simulated lidars in turbulence boxes that tests/test_coverage_in_boxes.py reads.

The boxes are others than those of models/noise (another seed). Run with the extra `boxes`; takes about ten minutes:
python benchmarks/make_box_records.py
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd

import bayes_rs as brs
from bayes_rs.geometry.scan import Scan

SCENES = {
    "4-beam": ("4-beam", {}),
    "6-beam": ("6-beam", {}),
    "6-beam-45": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 52.0}),
    "50-beam": ("50-beam", {}),
}
N_RECORD = 300
SEED = 4242
WIND_SPEED = 10.0

folder = Path(__file__).resolve().parents[1] / "tests" / "data"


def main() -> None:
    """Simulate all scans in the same boxes; keep each beam's variance over n·R n of the boxes' record stresses."""
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
    truth = json.loads(series.attrs["truth"])
    records = brs.make_records(series, together)
    relative = records["variance"].values / brs.geometry.radial_variance(together, truth["stresses_record"])
    names = [f"{name}/{beam}" for name, scan in scans.items() for beam in scan.beam]
    folder.mkdir(exist_ok=True)
    pd.DataFrame(relative.astype(np.float32), columns=names).to_parquet(folder / "box_records.parquet", index=False)


if __name__ == "__main__":
    main()
