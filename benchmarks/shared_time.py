"""Records of a scan that shares its lidar's time: what the intervals hold, by what of a record was measured.

    python benchmarks/shared_time.py

300 records of the DBS scan `wls200s-dbs` as points (30 samples of a beam in 600 s), Mann air (fu-2022) at 10 m/s, of
which a part is kept; about two minutes.
"""

from __future__ import annotations

import numpy as np

import bayes_rs as brs
from bayes_rs.design.scene import truth_of

SCAN, WIND, N_RECORD = "wls200s-dbs@probe=point", 10.0, 300
KEPT = {
    "all": lambda time: time >= 0.0,
    "200 s of every 400 s": lambda time: time % 400.0 < 200.0,
    "200 s, 200 s of none, 200 s": lambda time: (time % 600.0 < 200.0) | (time % 600.0 >= 400.0),
    "200 s of 600 s": lambda time: time % 600.0 < 200.0,
}


def main() -> None:
    """Print, for each way to share the time, coverage and median width of 90 % intervals."""
    scan, flow = brs.load_scan(SCAN), brs.load_turbulence("fu-2022")
    truth = truth_of(scan, flow, WIND, 600.0, "record")
    series = brs.simulate(scan, flow, wind_speed=WIND, n_records=N_RECORD, seed=5)
    time = (series["time"].values - series["time"].values.min()) / np.timedelta64(1, "s")
    print(f"{'kept':<30}{'fitted':>7}  " + "".join(f"{stress:>14}" for stress in brs.STRESSES))
    for name, keep in KEPT.items():
        part = series.isel(sample=np.flatnonzero(keep(time)))
        records = brs.make_records(part, scan, min_availability=0.3)
        fit = brs.fit(
            records,
            scan,
            turbulence="fu-2022",
            scatter="theory",
            instrument_noise=0.0,
            campaign="off",
            sampler="auto",
            target_ess=400,
            draws="float32",
            seed=1,
            progress=False,
        )
        table = fit.summary(prob=0.9).dropna(subset=["low", "high"])
        cells = []
        for index, stress in enumerate(brs.STRESSES):
            own = table[table["stress"] == stress]
            held = np.mean((own["low"] <= truth[index]) & (truth[index] <= own["high"]))
            cells.append(f"{100.0 * held:8.0f} %{np.median(own['high'] - own['low']):4.2f}")
        print(f"{name:<30}{fit.n_fitted:>7}  " + "".join(f"{cell:>14}" for cell in cells))


if __name__ == "__main__":
    main()
