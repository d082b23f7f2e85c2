"""What a homogeneous fit makes of stresses that change over the scanned area: tall rotors, and a wake in one sector.

python benchmarks/inhomogeneous_inflow.py OUTPUT [--records N]

The true stresses at the rotor's centre are those of the preset fu-2022. Over the area they change by a factor that is
the same for all six: with height as (1 − z/h)^p, the local scaling of a boundary layer of depth h, or by a constant in
the beams of one sector. Records are drawn from the noise model (theory, 10 m/s, 600 s) about these variances, and
fitted without and with gradients (0.5 per 100 m, one standard deviation, vertical and lateral), prior weak. The columns
of the table are in COLUMNS.
"""

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.pictures import COLOURS

HUB = 119.0
"""Height of the rotor's centre, m."""
SCANS = {
    "6-beam, 15°, 98 m": ("6-beam", {}),
    "6-beam, 45°, 126 m": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 126.0}),
    "50-beam, 15°, 98 m": ("50-beam", {}),
    "6-beam, 15°, five planes": ("6-beam-planes", {}),
    "SpinnerLidar, 178 m": ("spinnerlidar@probe=point", {"focus_distance": 178.0}),
}
FLOWS = ("homogeneous", "neutral, 500 m deep", "stable, 300 m deep", "wake, twice the variance")
NUISANCES = brs.Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.5)
FITS = {"homogeneous": None, "gradients": NUISANCES}
COLUMNS = {
    "exact_bias": "noise-free generalized least squares with homogeneous stresses, less the truth, over uu",
    "bias": "mean of the posterior means less the truth, over uu",
    "sd": "mean of the posterior standard deviations, over uu",
    "coverage": "share of records whose 90 % interval holds the truth",
    "log_bayes_factor": "mean per record, gradients over homogeneous",
}


def sector_factor(scan: brs.Scan, flow: str) -> np.ndarray:
    """Return what the flow multiplies each beam's variance by, shape (n_beam,)."""
    point = scan.focus_distance[:, None] * scan.line_of_sight
    if flow.startswith("wake"):
        across = np.hypot(point[:, 1], point[:, 2])
        return np.where((point[:, 1] > np.cos(np.pi / 4.0) * across) & (across > 1.0), 2.0, 1.0)
    depth, power = {"h": (np.inf, 1.0), "n": (500.0, 1.0), "s": (300.0, 1.5)}[flow[0]]
    return ((1.0 - (HUB + point[:, 2]) / depth) / (1.0 - HUB / depth)) ** power


def exact_bias(scan: brs.Scan, noise: brs.Noise, truth: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the bias of least squares on exact variances, weighted as the posterior is, shape (6,)."""
    relative = design_matrix(scan) / (design_matrix(scan) @ truth)[:, None]
    left, singular, _ = np.linalg.svd(relative, full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]]
    root = np.linalg.cholesky(basis.T @ np.log1p(noise.covariance[0]) @ basis)
    return np.linalg.pinv(np.linalg.solve(root, basis.T @ relative), rcond=1e-10) @ np.linalg.solve(
        root, basis.T @ (factor - 1.0)
    )


def drawn_records(
    scan: brs.Scan, noise: brs.Noise, mean: np.ndarray, n_record: int, rng: np.random.Generator
) -> xr.Dataset:
    """Return records whose variances scatter about `mean` as the noise model says."""
    covariance = np.log1p(noise.covariance[0])
    scatter = rng.multivariate_normal(-0.5 * np.diag(covariance), covariance, n_record, method="eigh")
    variance = mean * np.exp(scatter)
    start = np.datetime64("2020-01-01", "ns") + np.arange(n_record) * np.timedelta64(600, "s")
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(n_record, 10.0)),
            "yaw": ("record", np.zeros(n_record)),
        },
        coords={"beam": scan.beam, "time": ("record", start)},
        attrs={"duration": 600.0},
    )


def study(n_record: int) -> pd.DataFrame:
    """Return one row for each scan, flow, fit and stress."""
    flow_model = brs.load_turbulence("fu-2022")
    truth = flow_model.stresses()
    rows = []
    for label, (name, changes) in SCANS.items():
        scan = brs.load_scan(name, tilt_deg=0.0, **changes)
        noise = brs.noise.theory(scan, flow_model, wind_speed=10.0)
        some = n_record if scan.n_beam < 100 else max(n_record // 8, 2)
        for flow in FLOWS:
            began = time.perf_counter()
            factor = sector_factor(scan, flow)
            records = drawn_records(
                scan, noise, factor * brs.geometry.radial_variance(scan, truth), some, np.random.default_rng(1)
            )
            options = {"noise": noise, "seed": 1, "progress": False}
            table = brs.compare_inflow(records, scan, nuisances=NUISANCES, leave_one_out=False, **options)
            exact = exact_bias(scan, noise, truth, factor)
            left_out = records.copy(deep=True)
            left_out["flag"].values[:, factor > 1.5] = 1  # of the wake's beams
            fits = [(fit, records, nuisances) for fit, nuisances in FITS.items()]
            if flow.startswith("wake"):
                fits.append(("sector left out", left_out, None))
            for fit, data, nuisances in fits:
                result = brs.fit(data, scan, sampler="auto", nuisances=nuisances, **options)
                summary = result.summary()
                for index, stress in enumerate(brs.STRESSES):
                    part = summary[summary["stress"] == stress]
                    held = (part["low"] <= truth[index]) & (truth[index] <= part["high"])
                    rows.append(
                        {
                            "scan": label,
                            "flow": flow,
                            "fit": fit,
                            "stress": stress,
                            "exact_bias": exact[index] / truth[0],
                            "bias": (part["mean"].mean() - truth[index]) / truth[0],
                            "sd": part["sd"].mean() / truth[0],
                            "coverage": held.mean(),
                            "log_bayes_factor": table["log_bayes_factor"].mean(),
                            "n_record": some,
                        }
                    )
            print(f"{label}; {flow}: {time.perf_counter() - began:.1f} s", flush=True)
    return pd.DataFrame(rows)


def figure(table: pd.DataFrame, file: Path) -> None:
    """Draw the bias of the stress that each flow fakes, with the posterior's standard deviation as a bar."""
    drawing = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = drawing.subplots(3, 1, sharex=True)
    scans = list(dict.fromkeys(table["scan"]))
    for axis, flow in zip(axes, FLOWS[1:], strict=True):
        stress = "uv" if flow.startswith("wake") else "uw"
        for shift, (fit, marker) in enumerate((("homogeneous", "o"), ("gradients", "s"))):
            part = table.query("flow == @flow and fit == @fit and stress == @stress").set_index("scan").loc[scans]
            place = np.arange(len(scans)) + 0.15 * (shift - 0.5)
            axis.errorbar(
                place, part["bias"], part["sd"], fmt=marker, color=COLOURS[shift], capsize=3, label=f"posterior, {fit}"
            )
        axis.plot(np.arange(len(scans)), part["exact_bias"], "k_", markersize=24, label="least squares, no noise")
        axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.set_ylabel(f"bias of {stress} / uu")
        axis.set_title(flow, fontsize=10)
    axes[-1].set_xticks(np.arange(len(scans)), scans)
    drawing.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=3, loc="outside upper center")
    drawing.savefig(file, dpi=130)


def markdown(table: pd.DataFrame) -> str:
    """Return the table of the stress that each flow fakes, as the documentation prints it."""
    lines = [
        "| scan | inflow | stress | least squares | homogeneous fit | holds | gradients | holds | ln Bayes factor |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for scan in dict.fromkeys(table["scan"]):
        for flow in FLOWS:
            stress = "uv" if flow.startswith("wake") else "uw"
            part = table.query("scan == @scan and flow == @flow and stress == @stress").set_index("fit")
            cells = [scan, flow, stress, f"{part['exact_bias'].iloc[0]:.2f}"]
            for fit in FITS:
                one = part.loc[fit]
                cells += [f"{one['bias']:.2f} ± {one['sd']:.2f}", f"{100.0 * one['coverage']:.0f} %"]
            cells.append(f"{part['log_bayes_factor'].iloc[0]:.2f}")
            lines.append(f"| {' | '.join(cells)} |".replace("-0.00", "0.00").replace(" -", " −"))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the study and write its table and figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--records", type=int, default=200)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    table = study(arguments.records)
    table.round(4).to_csv(arguments.output / "inhomogeneous-inflow.csv", index=False)
    figure(table, arguments.output / "inhomogeneous-inflow.png")
    print(markdown(table.round(4)))


if __name__ == "__main__":
    main()
