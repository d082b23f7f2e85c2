"""An hour of a measured six-beam scan: posteriors beside the plain inversion of six variances; tables and figure.

The data are one hour of a WindCube 200S, BSD 3-clause, (c) 2022 Jose Dias Neto, merged from the sample files of
lidarwind (doi:10.21105/joss.04852); they are not part of the project: python benchmarks/six_beam_hour.py FOLDER OUTPUT,
with the folder that holds wls200s_sixbeam_20210513T12.nc.

Nothing is tuned and nothing chosen: the scan is found from the file, all else is default.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import bayes_rs as brs
from bayes_rs.pictures import COLOURS, DATA_MARK, POSTERIOR_COLOUR, PRIOR_COLOUR, PRIOR_MARK, TRUTH_COLOUR
from bayes_rs.posteriors.decided import is_priors

FILE = "wls200s_sixbeam_20210513T12.nc"
HEIGHTS = (100.0, 150.0, 200.0, 250.0, 300.0, 350.0)
DURATIONS = (600.0, 3600.0)


def compare(
    folder: Path,
    *,
    heights: tuple[float, ...] = HEIGHTS,
    turbulence: str | None = None,
    instrument_noise: float = 0.0,
) -> pd.DataFrame:
    """Return the posterior and the plain inversion of every record, and of the hour, at every height.

    The noise is for the records' own length scales, or for a turbulence that is given.
    """
    tables = []
    for height in heights:
        scan = brs.find_scan(folder / FILE, height=height)
        series = brs.read(folder / FILE, scan)
        for duration in DURATIONS:
            records = brs.make_records(series, scan, duration=duration)
            noise = None if turbulence is None else brs.noise.calibrate(scan, turbulence, records=records)
            result = brs.fit(records, scan, noise=noise, seed=1, instrument_noise=instrument_noise)
            own = result.records
            known = pd.DataFrame(
                {
                    "record": np.arange(own.sizes["record"]),
                    "length_scale": own["length_scale"].values if "length_scale" in own else np.nan,
                    "log_sd": own["length_scale_log_sd"].values if "length_scale_log_sd" in own else np.nan,
                    "scatter": own["variance_scatter"].values if "variance_scatter" in own else np.nan,
                    "p_value": own["unsteady_p_value"].values if "unsteady_p_value" in own else np.nan,
                    "learnt": result.source.read("posterior", ["stresses_learnt"])["stresses_learnt"],
                }
            )
            for frame in ("wind", "lidar"):
                table = result.summary(derived=["tke"] if frame == "wind" else [], frame=frame)
                table = table.merge(plain_inversion(records, scan, frame), on=["record", "stress"], how="left")
                table = table.merge(known, on="record")
                tables.append(table.assign(height=height, duration=duration, frame=frame))
    return pd.concat(tables, ignore_index=True)


def plain_inversion(records: xr.Dataset, scan: brs.Scan, frame: str) -> pd.DataFrame:
    """Return the six stresses that solve the six variances exactly, and whether they are realizable."""
    if frame == "lidar":
        records = records.assign(yaw=records["yaw"] * 0.0)
    found = brs.estimate(records, scan)
    n_record = records.sizes["record"]
    return pd.DataFrame(
        {
            "record": np.repeat(np.arange(n_record), len(brs.STRESSES)),
            "stress": np.tile(list(brs.STRESSES), n_record),
            "plain": found["stress"].values.ravel(),
            "plain_realizable": np.repeat(found["realizable"].values, len(brs.STRESSES)),
            "wind_speed": np.repeat(records["wind_speed"].values, len(brs.STRESSES)),
            "yaw": np.repeat(records["yaw"].values, len(brs.STRESSES)),
        }
    )


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """Return, for each height, how many plain inversions are not realizable, and what they miss."""
    rows = table[(table["frame"] == "wind") & table["stress"].isin(brs.STRESSES)]
    lines = []
    for height, part in rows.groupby("height"):
        short, hour = (part[part["duration"] == duration] for duration in DURATIONS)
        one = short[short["stress"] == "uu"]
        outside = ~short["plain"].between(short["low"], short["high"])
        lines.append(
            {
                "height": height,
                "wind speed": one["wind_speed"].mean(),
                "not realizable, of 6 records": int((~one["plain_realizable"].astype(bool)).sum()),
                "hour realizable": bool(hour["plain_realizable"].iloc[0]),
                "plain outside the 90 % interval, of 36": int(outside.sum()),
                "unsteady": int(one["flag"].str.contains("unsteady").sum()),
                "median length scale": one["length_scale"].median(),
                "of the hour": hour["length_scale"].iloc[0],
                "stresses learnt": one["learnt"].median(),
                "scatter": one["scatter"].median(),
            }
        )
    return pd.DataFrame(lines)


def hour_and_records(table: pd.DataFrame) -> pd.DataFrame:
    """Return, in the lidar's frame, the hour's posterior beside the mean of those of its six records."""
    rows = table[((table["frame"] == "lidar") & table["stress"].isin(brs.STRESSES)) | (table["stress"] == "tke")]
    lines = []
    for (height, stress), part in rows.groupby(["height", "stress"], sort=False):
        short, hour = (part[part["duration"] == duration] for duration in DURATIONS)
        lines.append(
            {
                "height": height,
                "stress": stress,
                "mean of six records": short["mean"].mean(),
                "mean width of their 90 % intervals": (short["high"] - short["low"]).mean(),
                "hour": hour["mean"].iloc[0],
                "low": hour["low"].iloc[0],
                "high": hour["high"].iloc[0],
                "width": (hour["high"] - hour["low"]).iloc[0],
            }
        )
    return pd.DataFrame(lines)


def velocity_noise(folder: Path) -> pd.DataFrame:
    """Return an upper bound for the variance of the instrument's noise: second differences over neighbouring gates.

    Noise that is independent from gate to gate gives v₋ − 2v + v₊ six times its variance; the wind adds to it.
    """
    with xr.open_dataset(folder / FILE) as data:
        velocity, cnr = data["radial_wind_speed"].values[:, :7], data["cnr"].values[:, :7]
    second = velocity[:, :-2] - 2.0 * velocity[:, 1:-1] + velocity[:, 2:]
    return pd.DataFrame(
        {
            "gate": np.arange(1, 6),
            "bound of the noise variance": np.nanmedian(second**2, axis=0) / 0.4549 / 6.0,  # median of chi-squared
            "median CNR": np.nanmedian(cnr[:, 1:-1], axis=0),
        }
    )


def draw(table: pd.DataFrame) -> Figure:
    """Draw three stresses over the hour at each height: intervals, plain inversion, and the hour's posterior."""
    rows = table[(table["frame"] == "lidar") | (table["stress"] == "tke")]
    heights = sorted(rows["height"].unique())
    figure = Figure(figsize=(13.0, 2.1 * len(heights)), layout="constrained")
    axes = figure.subplots(len(heights), 3, sharex=True, squeeze=False)
    words = {"uu": "northward variance", "vv": "eastward variance", "ww": "vertical variance"}
    for row, height in enumerate(reversed(heights)):
        for column, stress in enumerate(words):
            axis = axes[row, column]
            part = rows[(rows["height"] == height) & (rows["stress"] == stress)]
            short, hour = (part[part["duration"] == duration] for duration in DURATIONS)
            centre = 5.0 + 10.0 * short["record"]
            low, middle, high, share = hour[["low", "mean", "high", "decided"]].iloc[0]
            colour = PRIOR_COLOUR if is_priors(share) else POSTERIOR_COLOUR
            axis.axhspan(low, high, color=colour, alpha=0.2, linewidth=0)
            axis.axhline(middle, color=colour, linewidth=1.0)
            priors = is_priors(short["decided"].to_numpy())
            for some, look in ((~priors, DATA_MARK), (priors, PRIOR_MARK)):
                few = short[some]
                error = [few["mean"] - few["low"], few["high"] - few["mean"]]
                axis.errorbar(centre[some], few["mean"], yerr=error, fmt="o", markersize=4, **look)
            fine = short["plain_realizable"].astype(bool)
            axis.plot(
                centre[fine], short["plain"][fine], "_", markersize=12, color=COLOURS[2], label="plain, realizable"
            )
            axis.plot(centre[~fine], short["plain"][~fine], "x", color=TRUTH_COLOUR, label="plain, not realizable")
            axis.axhline(0.0, color="0.6", linewidth=0.6)
            axis.set_title(f"{words[stress]} at {height:g} m, m² s⁻²", fontsize=9)
    plain, _ = axes[0, 0].get_legend_handles_labels()
    marks = [
        Line2D([], [], marker="o", markersize=4, **DATA_MARK, label="10 minutes, 90 % interval"),
        Patch(color=POSTERIOR_COLOUR, alpha=0.2, label="hour, 90 % interval"),
        Line2D([], [], marker="o", markersize=4, **PRIOR_MARK, label="grey: mostly the prior's"),
        *plain,
    ]
    figure.legend(handles=marks, loc="outside upper center", fontsize=9, ncols=5)
    for axis in axes[-1]:
        axis.set_xlabel("minutes after 2021-05-13 12:00 UTC")
    return figure


def main() -> None:
    """Write the tables and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    table = compare(arguments.folder)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "six-beam-hour.csv", index=False, float_format="%.5f")
    draw(table).savefig(arguments.output / "six-beam-hour.png", dpi=80)
    for part in (counts(table), hour_and_records(table), velocity_noise(arguments.folder)):
        print(part.to_string(index=False, float_format=lambda value: f"{value:.3f}"), end="\n\n")


if __name__ == "__main__":
    main()
