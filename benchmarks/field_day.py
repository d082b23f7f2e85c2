"""A day of a measured pulsed nacelle lidar against two masts: tables and figure.

The data are those of the IEA Wind Task 32 round robin on turbulence from nacelle lidars; they carry no licence, so
they are not part of the project: python benchmarks/field_day.py FOLDER OUTPUT, with the folder that holds
Lidar_*_LOS2_178m.csv, Lidar_*_LOS3_178m.csv and ReferencePulsed.csv.

Nothing is tuned to the masts: all is default, as `bayes-rs fit` does it, with the length scale, the scatter and the
campaign of the records themselves.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.fits.intensity_metrics import intensity_errors
from bayes_rs.geometry.probe import PulsedProbe
from bayes_rs.noise.probe_words import probe_loss
from bayes_rs.pictures import COLOURS, POSTERIOR_COLOUR, TRUTH_COLOUR

MASTS = {"south mast": "TI_South", "north mast": "TI_North", "mean of both masts": "both"}
SPECTRA = "30 m, noise by the spectra"
KEPT = "30 m, no noise taken off"
PROBES = {"30 m": "pulsed-4-beam", "none": "pulsed-4-beam@probe=point"}
BEAMS = {2: "South", 3: "North"}
"""The mast near the point of each beam."""

LIDAR = {"color": POSTERIOR_COLOUR}
SOUTH, NORTH = TRUTH_COLOUR, COLOURS[2]
GATES = (15.0, 20.0, 30.0)
LENGTH_SCALES = (30.0, 61.0, 100.0)
NOISES = (0.03, 0.05)
"""m² s⁻²; the floor of the beams' spectra is 0.05 (docs/spectra.md)."""


def read(folder: Path) -> tuple[xr.Dataset, pd.DataFrame]:
    """Return the records of the day and the masts' turbulence intensities."""
    scan = brs.load_scan("pulsed-4-beam")
    series = brs.read(sorted(folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    reference = pd.read_csv(folder / "ReferencePulsed.csv", parse_dates=["Timestamp"])
    reference["both"] = 0.5 * (reference["TI_North"] + reference["TI_South"])
    return brs.make_records(series, scan), reference


def fitted(
    records: xr.Dataset,
    scan: brs.Scan,
    *,
    length_scale: float | None = None,
    instrument_noise: float | str = "records",
    campaign: str = "off",
) -> brs.Fit:
    """Return the fit of the day; with noise of a length scale, if one is given, in place of the records' own."""
    records, noise = records.assign_attrs(scan=scan.name, scan_key=scan.key), None
    if length_scale is not None:
        flow = replace(brs.load_turbulence("fu-2022"), length_scale=length_scale, name=f"L = {length_scale:g} m")
        noise = brs.noise.calibrate(scan, flow, records=records)
    return brs.fit(
        records,
        scan,
        noise=noise,
        seed=1,
        instrument_noise=instrument_noise,
        campaign=campaign,
        derived=["ti"],
        say=print,
    )


def beside_masts(summary: pd.DataFrame, records: xr.Dataset, reference: pd.DataFrame) -> pd.DataFrame:
    """Return σ_u/U of every record that has a posterior beside the masts."""
    table = summary[summary["stress"] == "ti"].dropna(subset="mean")
    table = table.assign(wind_speed=records["wind_speed"].values[table["record"]])
    return table.merge(reference, left_on="time", right_on="Timestamp")


def intensity(records: xr.Dataset, reference: pd.DataFrame, scan: brs.Scan, **options: Any) -> pd.DataFrame:
    """Return σ_u/U of every record that is fitted beside the masts; options are those of `fitted`."""
    return beside_masts(fitted(records, scan, **options).summary(), records, reference)


def scores(merged: pd.DataFrame, column: str) -> dict[str, float]:
    """Return bias, RMSE, coverage and width of σ_u/U against one reference."""
    relative = merged["mean"] / merged[column] - 1.0
    inside = (merged["low"] <= merged[column]) & (merged[column] <= merged["high"])
    return {
        "bias": (merged["mean"] - merged[column]).mean(),
        "RMSE": np.sqrt(((merged["mean"] - merged[column]) ** 2).mean()),
        "relative bias": relative.mean(),
        "relative RMSE": np.sqrt((relative**2).mean()),
        "correlation": np.corrcoef(merged["mean"], merged[column])[0, 1],
        "share of 90 % intervals that hold it": inside.mean(),
        "median width over mean": ((merged["high"] - merged["low"]) / merged["mean"]).median(),
    }


def fits_of(records: xr.Dataset, campaign: str = "auto") -> dict[str, brs.Fit]:
    """Fit the day with and without the probe, all else by default."""
    return {probe: fitted(records, brs.load_scan(name), campaign=campaign) for probe, name in PROBES.items()}


def compare(
    fits: dict[str, brs.Fit], records: xr.Dataset, reference: pd.DataFrame
) -> tuple[dict[tuple[str, str], pd.DataFrame], pd.DataFrame]:
    """Return σ_u/U of every record by probe and prior, and the table of bias, RMSE and coverage."""
    merged = {}
    for probe, fit in fits.items():
        merged[probe, "weak"] = beside_masts(fit.summary(), records, reference)
        if fit.has_campaign:
            merged[probe, "campaign"] = beside_masts(fit.summary(campaign=True), records, reference)
    lines = [
        {"probe": probe, "prior": prior, "reference": name, "records": f"{what} ({len(part)})", **scores(part, column)}
        for (probe, prior), rows in merged.items()
        for name, column in MASTS.items()
        for what, part in (
            ("all records", rows),
            ("both beams used", rows[~rows["flag"].str.contains("beam_left_out")]),
        )
    ]
    return merged, pd.DataFrame(lines)


def as_quoted(rows: pd.DataFrame, column: str = "both") -> pd.DataFrame:
    """Return the errors of σ_u/U by wind speed as the industry quotes them, of the records' posterior medians."""
    own = (rows[name].to_numpy() for name in ("median", "low", "high", column, "wind_speed"))
    return intensity_errors(*own)


def campaign_beside_masts(fits: dict[str, brs.Fit], merged: dict[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """Return the campaign's intensity, in all and by wind speed, beside that of the masts in the same records."""
    lines = []
    for probe, fit in fits.items():
        rows = merged[probe, "weak"]
        steady = rows[~rows["flag"].str.contains("unsteady")]
        table = fit.campaign()
        for line in table[table["quantity"].isin(("ti", "ti_p90"))].itertuples():
            part = steady
            if line.bin != "all":
                low, high = (float(end) for end in line.bin.removesuffix(" m/s").split("-"))
                part = steady[steady["wind_speed"].between(low, high, inclusive="left")]
            masts, of = part[list(MASTS.values())], np.mean if line.quantity == "ti" else lambda x: np.quantile(x, 0.9)
            lines.append(
                {
                    "probe": probe,
                    "quantity": line.quantity,
                    "bin": line.bin,
                    "records": line.n_record,
                    "of the masts": len(part),
                    "campaign": line.mean,
                    "low": line.low,
                    "high": line.high,
                    "of the records' means": of(part["mean"]),
                    "masts": of(masts["both"]),
                    "south": of(masts["TI_South"]),
                    "north": of(masts["TI_North"]),
                    "decided": line.decided,
                }
            )
    return pd.DataFrame(lines)


def unsteady(fit: brs.Fit) -> pd.DataFrame:
    """Return the records that are flagged as unsteady, and what their change adds."""
    records = fit.records
    names = ["wind_speed", "wind_change", "cross_wind_change", "change_uu", "change_vv", "unsteady_p_value"]
    found = records[[*names, "unsteady", "length_scale"]].to_dataframe().reset_index()
    return found[found["unsteady"] > 0]


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


def assumptions(folder: Path, records: xr.Dataset, reference: pd.DataFrame, only: str = "") -> pd.DataFrame:
    """Return bias, RMSE and coverage against the mean of both masts for other assumptions, those named so."""
    base, points = brs.load_scan("pulsed-4-beam"), brs.load_scan("pulsed-4-beam@probe=point")
    ahead = records.assign(yaw=xr.zeros_like(records["yaw"]))
    gates = {gate: replace(base, probe=PulsedProbe(gate_length=gate)) for gate in GATES}
    masts = as_the_masts_see(records, reference)
    own = as_the_spectra_say(folder, records)
    spectra = "probe of 30 m, each record's own L"
    cases: dict[str, tuple[xr.Dataset, brs.Scan, dict[str, Any]]] = {
        **{f"probe of {gate:g} m": (records, scan, {}) for gate, scan in gates.items()},
        **{f"probe of 30 m, L = {size:g} m": (records, base, {"length_scale": size}) for size in LENGTH_SCALES},
        **{
            f"probe of 30 m, noise of {noise:g} m² s⁻²": (records, base, {"instrument_noise": noise})
            for noise in NOISES
        },
        "probe of 30 m, no noise taken off": (records, base, {"instrument_noise": 0.0}),
        f"{spectra} and the noise, by the spectra": (own, base, {}),
        f"{spectra}, by the spectra, no noise taken off": (own, base, {"instrument_noise": 0.0}),
        "no probe": (records, points, {}),
        **{f"no probe, L = {size:g} m": (records, points, {"length_scale": size}) for size in LENGTH_SCALES},
        "probe of 30 m, wind along the axis": (ahead, base, {}),
        "no probe, wind along the axis": (ahead, points, {}),
        "the masts' variances along the beams, no probe, L = 61 m": (masts, points, {"length_scale": 61.0}),
    }
    rows = {
        case: intensity(made, reference, scan, **options)
        for case, (made, scan, options) in cases.items()
        if only in case
    }
    return pd.DataFrame(
        {"case": case, "records": len(merged), **scores(merged, "both")} for case, merged in rows.items()
    )


def draw(merged: dict[tuple[str, str], pd.DataFrame], campaign: pd.DataFrame) -> Figure:
    """Draw σ_u/U over the day with its credible band, against the masts, and the campaign's by wind speed."""
    probed, points, learnt = merged["30 m", "weak"], merged["none", "weak"], merged["30 m", "campaign"]
    figure = Figure(figsize=(15.0, 4.8), layout="constrained")
    over, against, bins = figure.subplots(1, 3, width_ratios=[2.2, 1.0, 1.0])
    over.fill_between(
        probed["time"], probed["low"], probed["high"], **LIDAR, alpha=0.25, linewidth=0, label="lidar, 90 % interval"
    )
    over.plot(probed["time"], probed["mean"], **LIDAR, linewidth=1.3, label="lidar, posterior mean")
    over.plot(points["time"], points["mean"], color="0.35", linewidth=0.8, linestyle="--", label="the same, no probe")
    over.plot(probed["time"], probed["TI_South"], ".", color=SOUTH, markersize=4, label="south mast")
    over.plot(probed["time"], probed["TI_North"], ".", color=NORTH, markersize=4, label="north mast")
    for flag, marker, words in (("beam_left_out", "|", "one beam only"), ("unsteady", "v", "unsteady")):
        rows = probed[probed["flag"].str.contains(flag)]
        over.plot(rows["time"], np.full(len(rows), 0.01), marker, color="0.3", markersize=6, label=words)
    over.set_ylim(0.0, 0.75)
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
        **LIDAR,
        markersize=3,
        linewidth=0.5,
        alpha=0.5,
        label="prior weak, 90 % interval",
    )
    against.plot(learnt["both"], learnt["mean"], "+", color=COLOURS[1], markersize=5, label="under the campaign")
    ends = [0.05, 0.5]
    against.plot(ends, ends, color="0.3", linewidth=1.0)
    against.set_xlabel("mean of both masts")
    against.set_ylabel("lidar, probe of 30 m")
    against.legend(loc="upper left", fontsize=9)
    rows = campaign[(campaign["quantity"] == "ti") & (campaign["bin"] != "all")]
    for probe, shift, colour in (("30 m", -0.12, COLOURS[0]), (SPECTRA, 0.0, COLOURS[4]), ("none", 0.12, "0.35")):
        part = rows[rows["probe"] == probe]
        speed = part["bin"].str.split("-").str[0].astype(float) + 0.5
        error = [part["campaign"] - part["low"], part["high"] - part["campaign"]]
        words = f"campaign, probe {probe}"
        bins.errorbar(speed + shift, part["campaign"], yerr=error, fmt="o", markersize=4, color=colour, label=words)
    for name, marker, colour in (("masts", "_", "k"), ("south", ".", SOUTH), ("north", ".", NORTH)):
        words = "mean of both masts" if name == "masts" else f"{name} mast"
        bins.plot(
            speed,
            rows.loc[rows["probe"] == "30 m", name],
            marker,
            color=colour,
            markersize=9 if marker == "_" else 5,
            label=words,
        )
    bins.set_ylim(0.1, 0.29)
    bins.set_xlabel("wind speed, bins of 1 m/s")
    bins.set_ylabel("mean turbulence intensity of the steady records")
    bins.legend(loc="upper left", fontsize=8)
    return figure


def main() -> None:
    """Write the tables and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    records, reference = read(arguments.folder)
    fits = fits_of(records)
    own = as_the_spectra_say(arguments.folder, records)
    scan = brs.load_scan("pulsed-4-beam")
    fits[SPECTRA] = fitted(own, scan, campaign="auto")
    fits[KEPT] = fitted(records, scan, instrument_noise=0.0, campaign="auto")
    for probe, fit in fits.items():
        print(f"probe {probe}", *fit.words, *fit.remarks, sep="\n")
        print({flag: number for flag, number in fit.flags.items() if number})
        print("length scales, 5, 50 and 95 %:", fit.records["length_scale"].quantile([0.05, 0.5, 0.95]).values)
        print(fit.summary().groupby("stress", sort=False)["decided"].median().round(2).to_dict(), end="\n\n")
    merged, table = compare(fits, records, reference)
    campaign = campaign_beside_masts(fits, merged)
    draw(merged, campaign).savefig(arguments.output / "field-day.png", dpi=90)
    tables = {
        "field-day": table,
        "field-day-quoted": as_quoted(merged["30 m", "weak"]),
        "field-day-campaign": campaign,
        "field-day-unsteady": unsteady(fits["30 m"]),
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
