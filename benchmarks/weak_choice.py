"""Where the prior `weak` lies: coverage and bias of candidates over flows and scans, on variances that theory draws.

For each flow (the shipped ones that differ in shape, and isotropic turbulence), scan and candidate: records whose
log-variances are drawn with the moments of their noise, about the variances of the flow's stresses; then the mean
over records of the posterior's means over the truth, and how often the 90 % intervals hold it. The flows are none
that a candidate was fitted to; the candidates are the first edition's `weak`, one whose medians are those of the
sources of `WeakPrior`, and neighbours.

    python benchmarks/weak_choice.py OUTPUT.csv [--records 200]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import bayes_rs as brs

FLOWS = ("fu-2022", "neutral-onshore", "stable-onshore", "unstable-onshore", "isotropic")
SCANS = ("6-beam@opening_angle_deg=45", "6-beam@opening_angle_deg=15", "50-beam")
CANDIDATES = {
    "first edition": "weak:ratio_vv=0.5,log_sd_vv=0.5,ratio_ww=0.27,log_sd_ww=0.6",
    "vv narrower": "weak:ratio_vv=0.64,log_sd_vv=0.4,ratio_ww=0.35,log_sd_ww=0.7",
    "sources": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.35,log_sd_ww=0.7",
    "wider": "weak:ratio_vv=0.64,log_sd_vv=0.6,ratio_ww=0.35,log_sd_ww=0.9",
    "higher": "weak:ratio_vv=0.75,log_sd_vv=0.5,ratio_ww=0.45,log_sd_ww=0.7",
    "ww 0.4, 0.8": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.4,log_sd_ww=0.8",
    "ww 0.35, 0.8": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.35,log_sd_ww=0.8",
    "ww 0.4, 0.9": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.4,log_sd_ww=0.9",
    "ww 0.45, 0.8": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.45,log_sd_ww=0.8",
    "sources, uw -0.4": "weak:ratio_vv=0.64,log_sd_vv=0.5,ratio_ww=0.35,log_sd_ww=0.7,z_uw=-0.4",
}
WIND_SPEED = 10.0


def flow_of(name: str) -> brs.MannTurbulence:
    """Return a flow by name; isotropic is fu-2022 with Γ = 0."""
    if name == "isotropic":
        return replace(brs.load_turbulence("fu-2022"), gamma=0.0)
    return brs.load_turbulence(name)


def records_of(scan: brs.Scan, noise: brs.Noise, truth: np.ndarray, n_record: int) -> xr.Dataset:
    """Draw variances of records: log-normal, with mean n·R n and the relative covariance of the noise."""
    at_record = noise.for_records(np.full(n_record, WIND_SPEED), np.zeros(n_record))
    log_covariance = np.log1p(at_record.covariance[0])
    expected = at_record.gain[0] @ truth
    normal = np.random.default_rng(3).multivariate_normal(
        -0.5 * np.diagonal(log_covariance), log_covariance, n_record, method="eigh"
    )
    return xr.Dataset(
        {
            "variance": (("record", "beam"), expected * np.exp(normal)),
            "flag": (("record", "beam"), np.zeros((n_record, scan.n_beam), dtype=np.int64)),
            "wind_speed": (("record",), np.full(n_record, WIND_SPEED)),
            "yaw": (("record",), np.zeros(n_record)),
        },
        coords={"beam": scan.beam},
        attrs={"duration": noise.duration},
    )


def main() -> None:
    """Measure, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path)
    parser.add_argument("--records", type=int, default=200)
    args = parser.parse_args()
    rows = []
    for scan_name in SCANS:
        scan = brs.load_scan(scan_name)
        for flow_name in FLOWS:
            flow = flow_of(flow_name)
            truth = np.asarray(flow.stresses())
            noise = brs.noise.theory(scan, flow, wind_speed=WIND_SPEED)
            records = records_of(scan, noise, truth, args.records)
            for candidate, prior in CANDIDATES.items():
                fit = brs.fit(
                    records, scan, seed=1, noise=noise, prior=prior, sampler="direct", target_ess=400, draws="float64"
                )
                draws = fit.draws().reshape(args.records, -1, 6)
                low, high = np.quantile(draws, [0.05, 0.95], axis=1)
                for index, stress in ((0, "uu"), (1, "vv"), (2, "ww"), (4, "uw")):
                    held = (low[:, index] <= truth[index]) & (truth[index] <= high[:, index])
                    rows.append(
                        {
                            "scan": scan_name,
                            "flow": flow_name,
                            "candidate": candidate,
                            "stress": stress,
                            "mean over truth": draws[..., index].mean() / truth[index] if truth[index] else np.nan,
                            "held": held.mean(),
                            "width over uu": (high - low)[:, index].mean() / truth[0],
                        }
                    )
            print(scan_name, flow_name, flush=True)
    table = pd.DataFrame(rows)
    table.to_csv(args.output, index=False, float_format="%.3f")
    keys = ["candidate", "stress"]
    spread = table.groupby(keys, sort=False).agg(
        bias=("mean over truth", lambda ratio: float(np.sqrt(np.nanmean(np.log(ratio.abs()) ** 2)))),
        held_least=("held", "min"),
        held_mean=("held", "mean"),
        width=("width over uu", "mean"),
    )
    print(spread.round(3).to_string())


if __name__ == "__main__":
    main()
