"""A day of a measured pulsed nacelle lidar against two masts: table and figure.

The data are those of the IEA Wind Task 32 round robin on turbulence from nacelle lidars; they carry no licence, so
they are not part of the project: python benchmarks/field_day.py FOLDER OUTPUT, with the folder that holds
Lidar_*_LOS2_178m.csv, Lidar_*_LOS3_178m.csv and ReferencePulsed.csv.

Nothing is tuned to the masts: the turbulence of the noise is the preset fu-2022, the prior is the default one.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.calibration.choice import noise_for_records

MASTS = {"south mast": "TI_South", "north mast": "TI_North", "mean of both masts": "both"}


def compare(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return σ_u/U of every record beside the masts, and the table of bias, RMSE and coverage."""
    scan = brs.load_scan("pulsed-4-beam")
    series = brs.read_radial_velocity(sorted(folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    records = brs.make_records(series, scan)
    seen = scan.select(records["beam"].values)
    noise, words = noise_for_records(records, seen, brs.load_turbulence("fu-2022"))
    print(words)
    result = brs.fit(records, scan, noise=noise, seed=1)
    table = brs.summary(result, derived=["ti"])
    rows = table[table["stress"] == "ti"]
    reference = pd.read_csv(folder / "ReferencePulsed.csv", parse_dates=["Timestamp"])
    reference["both"] = 0.5 * (reference["TI_North"] + reference["TI_South"])
    merged = rows.merge(reference, left_on="time", right_on="Timestamp")
    lines = []
    for name, column in MASTS.items():
        for what, part in (("all records", merged), ("both beams used", merged[merged["flag"] == ""])):
            relative = part["mean"] / part[column] - 1.0
            inside = (part["hdi_low"] <= part[column]) & (part[column] <= part["hdi_high"])
            lines.append(
                {
                    "reference": name,
                    "records": f"{what} ({len(part)})",
                    "bias": (part["mean"] - part[column]).mean(),
                    "RMSE": np.sqrt(((part["mean"] - part[column]) ** 2).mean()),
                    "relative bias": relative.mean(),
                    "relative RMSE": np.sqrt((relative**2).mean()),
                    "correlation": np.corrcoef(part["mean"], part[column])[0, 1],
                    "share of 90 % intervals that hold it": inside.mean(),
                }
            )
    return merged, pd.DataFrame(lines)


def draw(merged: pd.DataFrame) -> Figure:
    """Draw σ_u/U over the day with its credible band, and against the masts."""
    figure = Figure(figsize=(13.0, 5.0), layout="constrained")
    over, against = figure.subplots(1, 2, width_ratios=[2.2, 1.0])
    over.fill_between(merged["time"], merged["hdi_low"], merged["hdi_high"], alpha=0.25, label="lidar, 90 % interval")
    over.plot(merged["time"], merged["mean"], linewidth=1.3, label="lidar, posterior mean")
    over.plot(merged["time"], merged["TI_South"], ".", color="#c26a16", markersize=4, label="south mast")
    over.plot(merged["time"], merged["TI_North"], ".", color="#1b7837", markersize=4, label="north mast")
    flagged = merged[merged["flag"] != ""]
    over.plot(flagged["time"], np.zeros(len(flagged)), "|", color="0.3", label="one beam only")
    over.set_ylim(0.0, 0.55)
    over.set_ylabel("turbulence intensity σ_u/U")
    over.set_xlabel("start of the record (UTC), 2020-09-03 and 04")
    over.legend(loc="upper right", fontsize=9, ncols=2)
    over.tick_params(axis="x", rotation=20)
    error = [merged["mean"] - merged["hdi_low"], merged["hdi_high"] - merged["mean"]]
    against.errorbar(merged["both"], merged["mean"], yerr=error, fmt="o", markersize=3, linewidth=0.5, alpha=0.6)
    ends = [0.05, 0.5]
    against.plot(ends, ends, color="0.3", linewidth=1.0)
    against.set_xlabel("mean of both masts")
    against.set_ylabel("lidar: posterior mean and 90 % interval")
    return figure


def main() -> None:
    """Write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    merged, table = compare(arguments.folder)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "field-day.csv", index=False, float_format="%.4f")
    draw(merged).savefig(arguments.output / "field-day.png", dpi=90)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3f}"))


if __name__ == "__main__":
    main()
