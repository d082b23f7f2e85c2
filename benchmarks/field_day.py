"""A day of a measured pulsed nacelle lidar against two masts: tables and figure.

The data are those of the IEA Wind Task 32 round robin on turbulence from nacelle lidars; they carry no licence, so
they are not part of the project: python benchmarks/field_day.py FOLDER OUTPUT, with the folder that holds
Lidar_*_LOS2_178m.csv, Lidar_*_LOS3_178m.csv and ReferencePulsed.csv.

Nothing is tuned to the masts: the turbulence of the noise is the preset fu-2022, the prior is the default one.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.geometry.probe import PulsedProbe
from bayes_rs.noise.probe_words import probe_loss

MASTS = {"south mast": "TI_South", "north mast": "TI_North", "mean of both masts": "both"}
PROBES = {"30 m": "pulsed-4-beam", "none": "pulsed-4-beam@probe=point"}
BEAMS = {2: "South", 3: "North"}
"""The mast near the point of each beam."""

GATES = (15.0, 20.0, 30.0)
LENGTH_SCALES = (30.0, 61.0, 100.0)
INSTRUMENT_NOISE = (0.03, 0.05)
"""m² s⁻²; the floor of the beams' spectra is 0.05 (docs/spectra.md)."""


def read(folder: Path) -> tuple[xr.Dataset, pd.DataFrame]:
    """Return the records of the day and the masts' turbulence intensities."""
    scan = brs.load_scan("pulsed-4-beam")
    series = brs.read(sorted(folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    reference = pd.read_csv(folder / "ReferencePulsed.csv", parse_dates=["Timestamp"])
    reference["both"] = 0.5 * (reference["TI_North"] + reference["TI_South"])
    return brs.make_records(series, scan), reference


def intensity(
    records: xr.Dataset,
    reference: pd.DataFrame,
    scan: brs.Scan,
    *,
    length_scale: float | None = None,
    instrument_noise: float | str = 0.0,
) -> pd.DataFrame:
    """Return σ_u/U of every record that is fitted beside the masts."""
    flow = brs.load_turbulence("fu-2022")
    if length_scale is not None and length_scale != flow.length_scale:
        flow = replace(flow, length_scale=length_scale, name=f"fu-2022, L = {length_scale:g} m")
    records = records.assign_attrs(scan=scan.name, scan_key=scan.key)
    own = [float(end(records["length_scale"])) for end in (np.min, np.max)] if "length_scale" in records else None
    noise = brs.noise.calibrate(scan, flow, records=records, length_scale=own)
    words = noise.in_words(records["wind_speed"].values, np.deg2rad(records["yaw"].values))
    print(words)
    table = brs.fit(records, scan, noise=noise, seed=1, instrument_noise=instrument_noise).summary(derived=["ti"])
    return table[table["stress"] == "ti"].dropna(subset="mean").merge(reference, left_on="time", right_on="Timestamp")


def scores(merged: pd.DataFrame, column: str) -> dict[str, float]:
    """Return bias, RMSE and coverage of σ_u/U against one reference."""
    relative = merged["mean"] / merged[column] - 1.0
    inside = (merged["low"] <= merged[column]) & (merged[column] <= merged["high"])
    return {
        "bias": (merged["mean"] - merged[column]).mean(),
        "RMSE": np.sqrt(((merged["mean"] - merged[column]) ** 2).mean()),
        "relative bias": relative.mean(),
        "relative RMSE": np.sqrt((relative**2).mean()),
        "correlation": np.corrcoef(merged["mean"], merged[column])[0, 1],
        "share of 90 % intervals that hold it": inside.mean(),
    }


def compare(records: xr.Dataset, reference: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], pd.DataFrame]:
    """Return σ_u/U of every record with and without the probe, and the table of bias, RMSE and coverage."""
    merged = {probe: intensity(records, reference, brs.load_scan(name)) for probe, name in PROBES.items()}
    lines = [
        {"probe": probe, "reference": name, "records": f"{what} ({len(part)})", **scores(part, column)}
        for probe, rows in merged.items()
        for name, column in MASTS.items()
        for what, part in (("all records", rows), ("both beams used", rows[rows["flag"] == ""]))
    ]
    return merged, pd.DataFrame(lines)


def along_beams(records: xr.Dataset, reference: pd.DataFrame) -> pd.DataFrame:
    """Return which part of the masts' variances along the beams the lidar sees, and what probes would leave of them."""
    both = np.all(records["flag"].values == 0, axis=1)
    speed, yaw = records["wind_speed"].values[both], np.deg2rad(records["yaw"].values[both])
    flow, rng = brs.load_turbulence("fu-2022"), np.random.default_rng(1)
    lines = []
    for index, beam in enumerate(records["beam"].values.tolist()):
        mean, variance = records["mean"].values[both, index], records["variance"].values[both, index]
        mast = reference[f"LOS_TI_{BEAMS[beam]}"].to_numpy()[both] ** 2 * mean**2
        again = rng.integers(0, len(mast), size=(2000, len(mast)))
        left = variance.sum() / mast.sum()
        error = float(np.std(variance[again].sum(axis=1) / mast[again].sum(axis=1)))
        lines.append({"beam": beam, "what": "measured", "length_scale": np.nan, "left": left, "error": error})
    for gate in GATES:
        scan = replace(brs.load_scan("pulsed-4-beam"), probe=PulsedProbe(gate_length=gate))
        for length_scale in LENGTH_SCALES:
            turbulence = replace(flow, length_scale=length_scale)
            noise = brs.noise.calibrate(scan, turbulence, records=records)
            left = 1.0 - probe_loss(noise, speed, yaw)
            weight = records["variance"].values[both]
            for index, beam in enumerate(records["beam"].values.tolist()):
                share = weight[:, index].sum() / (weight[:, index] / left[:, index]).sum()
                mast = (
                    reference[f"LOS_TI_{BEAMS[beam]}"].to_numpy()[both] ** 2 * records["mean"].values[both, index] ** 2
                )
                more = float(np.mean(weight[:, index]) - share * np.mean(mast))
                line = {"beam": beam, "what": f"{gate:g} m", "length_scale": length_scale, "left": share}
                lines.append({**line, "lidar_has_more": more})
    return pd.DataFrame(lines)


def as_the_masts_see(records: xr.Dataset, reference: pd.DataFrame) -> xr.Dataset:
    """Return the records with the variances of the masts' wind along the beams, where both beams are used."""
    both = np.all(records["flag"].values == 0, axis=1)
    intensity = np.stack([reference[f"LOS_TI_{BEAMS[beam]}"] for beam in records["beam"].values.tolist()], axis=1)
    variance = np.where(both[:, np.newaxis], (intensity * records["mean"].values) ** 2, records["variance"].values)
    return records.assign(variance=(records["variance"].dims, variance))


def as_the_spectra_say(folder: Path, records: xr.Dataset) -> xr.Dataset:
    """Return the records with the length scales and the instrument's noise of their own spectra."""
    scan, flow = brs.load_scan("pulsed-4-beam"), brs.load_turbulence("fu-2022")
    series = brs.read(sorted(folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    spectra = brs.spectra.radial_spectra(series, scan, records)
    fitted = brs.spectra.fit_spectra(spectra, scan, gamma=flow.gamma)
    estimate = brs.spectra.estimate_instrument_noise(spectra.assign(length_scale=fitted["length_scale"]), scan, flow)
    return brs.spectra.with_instrument_noise(brs.spectra.with_length_scale(records, fitted), estimate)


def assumptions(folder: Path, records: xr.Dataset, reference: pd.DataFrame) -> pd.DataFrame:
    """Return bias, RMSE and coverage against the mean of both masts for other assumptions."""
    base, points = brs.load_scan("pulsed-4-beam"), brs.load_scan("pulsed-4-beam@probe=point")
    ahead = records.assign(yaw=xr.zeros_like(records["yaw"]))
    cases: dict[str, tuple[xr.Dataset, brs.Scan, float | None]] = {
        f"probe of {gate:g} m": (records, replace(base, probe=PulsedProbe(gate_length=gate)), None) for gate in GATES
    }
    for length_scale in (30.0, 100.0):
        cases[f"probe of 30 m, L = {length_scale:g} m"] = (records, base, length_scale)
        cases[f"no probe, L = {length_scale:g} m"] = (records, points, length_scale)
    cases["no probe"] = (records, points, None)
    cases["probe of 30 m, wind along the axis"] = (ahead, base, None)
    cases["no probe, wind along the axis"] = (ahead, points, None)
    cases["the masts' variances along the beams"] = (as_the_masts_see(records, reference), points, None)
    rows = {
        case: intensity(made, reference, scan, length_scale=length_scale)
        for case, (made, scan, length_scale) in cases.items()
    }
    for noise in INSTRUMENT_NOISE:
        case = f"probe of 30 m, instrument's noise of {noise:g} m² s⁻²"
        rows[case] = intensity(records, reference, base, instrument_noise=noise)
    own = as_the_spectra_say(folder, records)
    for option in ("records", 0.0):
        case = "probe of 30 m, each record's own L" + (" and the noise, by the spectra" if option else "")
        rows[case] = intensity(own, reference, base, instrument_noise=option)
    return pd.DataFrame({"case": case, **scores(merged, "both")} for case, merged in rows.items())


def draw(merged: dict[str, pd.DataFrame]) -> Figure:
    """Draw σ_u/U over the day with its credible band, and against the masts, with and without the probe."""
    probed, points = merged["30 m"], merged["none"]
    figure = Figure(figsize=(13.0, 5.0), layout="constrained")
    over, against = figure.subplots(1, 2, width_ratios=[2.2, 1.0])
    over.fill_between(probed["time"], probed["low"], probed["high"], alpha=0.25, label="lidar, 90 % interval")
    over.plot(probed["time"], probed["mean"], linewidth=1.3, label="lidar, posterior mean")
    over.plot(points["time"], points["mean"], color="0.35", linewidth=0.8, linestyle="--", label="the same, no probe")
    over.plot(probed["time"], probed["TI_South"], ".", color="#c26a16", markersize=4, label="south mast")
    over.plot(probed["time"], probed["TI_North"], ".", color="#1b7837", markersize=4, label="north mast")
    flagged = probed[probed["flag"] != ""]
    over.plot(flagged["time"], np.zeros(len(flagged)), "|", color="0.3", label="one beam only")
    over.set_ylim(0.0, 0.65)
    over.set_ylabel("turbulence intensity σ_u/U")
    over.set_xlabel("start of the record (UTC), 2020-09-03 and 04")
    over.legend(loc="upper right", fontsize=9, ncols=2)
    over.tick_params(axis="x", rotation=20)
    error = [probed["mean"] - probed["low"], probed["high"] - probed["mean"]]
    against.errorbar(
        probed["both"],
        probed["mean"],
        yerr=error,
        fmt="o",
        markersize=3,
        linewidth=0.5,
        alpha=0.6,
        label="probe of 30 m",
    )
    against.plot(points["both"], points["mean"], "+", color="0.35", markersize=5, label="no probe")
    ends = [0.05, 0.5]
    against.plot(ends, ends, color="0.3", linewidth=1.0)
    against.set_xlabel("mean of both masts")
    against.set_ylabel("lidar: posterior mean and 90 % interval")
    against.legend(loc="upper left", fontsize=9)
    return figure


def main() -> None:
    """Write the tables and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    records, reference = read(arguments.folder)
    merged, table = compare(records, reference)
    draw(merged).savefig(arguments.output / "field-day.png", dpi=90)
    tables = {
        "field-day": table,
        "field-day-beams": along_beams(records, reference),
        "field-day-assumptions": assumptions(arguments.folder, records, reference),
    }
    for name, made in tables.items():
        made.to_csv(arguments.output / f"{name}.csv", index=False, float_format="%.4f")
        print(made.to_string(index=False, float_format=lambda value: f"{value:.3f}"), end="\n\n")
    apart = reference["TI_North"] - reference["TI_South"]
    print(f"north mast less south mast: bias {apart.mean():.4f}, RMSE {np.sqrt((apart**2).mean()):.4f}")


if __name__ == "__main__":
    main()
