"""Do the scanning-pattern study again in its own boxes: 100 fields, 128 m wide and high, 30 minutes long.

python benchmarks/seed_study_boxes.py [--fields 100] [--output benchmarks]

Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016:
Figs. 4 to 8, Table 1.
All lidars and the sonic see the same fields, on the study's grid of 8192 x 64 x 64 points. Estimates are of the whole
field (1800 s) and of its first 600 s. Of the 600-s records the posterior is sampled, too, with the noise by theory:
its noise model is that of an infinite domain, the boxes are periodic every 128 m. `seed_study.py` is the same study in
an infinite domain, without Monte-Carlo error. Two tables, seed-study-boxes.csv and seed-study-boxes-table-1.csv, and a
figure in the paper's layout, seed-study-boxes.png. About 15 s a field on one core, and two minutes of posteriors.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from kept_fields import Fields
from matplotlib.figure import Figure
from seed_study import TABLE_1, WIND_SPEED, methods_of, records_of, scans, weights_of

import bayes_rs as brs
from bayes_rs.simulation.boxes import BoxGrid

GRID = BoxGrid((8192, 64, 64), (18000.0 / 8192, 2.0, 2.0))
FIRST_SEED = 1
DURATIONS = (1800.0, 600.0)
SHEAR = 0.0288
"""dU/dz, 1/s."""
MOST_FIT = 60
"""Scans with more beams have no posterior here, but for the SpinnerLidar: the noise of all pairs takes long."""
FIGURES = {
    "one plane (Fig. 4)": ["6-beam", "50-beam", "51-beam", "spinnerlidar"],
    "one and five planes (Fig. 5)": ["50-beam", "50-beam-planes", "51-beam", "51-beam-planes"],
    "uv = vw = 0 (Fig. 6)": ["4-beam", "4-beam-planes", "5-beam", "5-beam-planes"],
    "6-beam, 52 m (Fig. 7)": [f"6-beam {angle}° 52 m" for angle in (15, 20, 25, 30, 35, 40, 45)],
    "6-beam, 15° (Fig. 7)": [f"6-beam 15° {distance} m" for distance in (49, 72, 98, 121, 142)],
}
LIMITS = {
    "uu": (0.6, 2.0),
    "vv": (-0.5, 2.0),
    "ww": (-0.5, 1.5),
    "uv": (-0.4, 0.4),
    "uw": (-0.7, 0.1),
    "vw": (-0.3, 0.3),
}


def sonic_scan() -> brs.Scan:
    """Return a sonic at the rotor's centre, as six beams from there: their variances are R's, in linear combination."""
    direction = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=np.float64)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return brs.Scan("sonic", direction, focus_distance=np.full(6, 1e-6), beam_time=np.zeros(6), scan_duration=1.0)


def kept(study: Fields, folder: Path, n_field: int) -> list[dict[str, np.ndarray]]:
    """Return the fields of the study, and say how far it is."""
    fields = []
    for field in study.keep(folder, range(FIRST_SEED, FIRST_SEED + n_field)):
        fields.append(field)
        print(f"field {len(fields)} of {n_field}", flush=True)
    generator, beams = (sum(float(field[name]) for field in fields) / n_field for name in ("generator", "beams"))
    print(f"CPU a field: {generator:.1f} s to make it, {beams:.1f} s for the {len(study.lines[2])} beams of all scans")
    return fields


def estimates(label: str, scan: brs.Scan, variance: np.ndarray, sonic: np.ndarray, duration: float) -> list[dict]:
    """Return a row for each method and stress: mean, standard deviation, and the error against the sonic's mean."""
    rows = []
    for method in methods_of(scan):
        stress = variance @ weights_of(method, scan).T
        for index, name in enumerate(brs.STRESSES):
            rows.append(row_of(label, method, duration, name, stress[:, index], sonic[:, index]))
    return rows


def row_of(label: str, method: str, duration: float, name: str, value: np.ndarray, sonic: np.ndarray) -> dict:
    """Return mean, standard deviation and, in per cent of the sonic's mean, the error with its standard error."""
    ratio = value.mean() / sonic.mean()
    error = (value - ratio * sonic).std(ddof=1) / np.sqrt(len(value)) / abs(sonic.mean())
    return {
        "scan": label,
        "method": method,
        "duration": duration,
        "stress": name,
        "mean": value.mean(),
        "sd": value.std(ddof=1),
        "error_percent": 100.0 * (ratio - 1.0),
        "se_percent": 100.0 * error,
        "correlation": np.corrcoef(value, sonic)[0, 1],
    }


def posterior(label: str, scan: brs.Scan, variance: np.ndarray, sonic: np.ndarray) -> list[dict]:
    """Return a row for each stress with what the posteriors of the 600-s records say."""
    turbulence = brs.load_turbulence("fu-2022")
    noise = brs.noise.calibrate(scan, turbulence, wind_speed=WIND_SPEED, duration=600.0)
    records = records_of(variance, scan)
    records["wind_speed"] = ("record", np.full(len(variance), WIND_SPEED))
    records.attrs["duration"] = 600.0
    table = brs.fit(records, scan, noise=noise, seed=1, sampler="auto").summary()
    truth = brs.noise.sonic_moments(scan, turbulence, wind_speed=WIND_SPEED, duration=600.0).mean
    rows = []
    for index, name in enumerate(brs.STRESSES):
        of = table[table["stress"] == name]
        row = row_of(label, "posterior", 600.0, name, of["mean"].to_numpy(), sonic[:, index])
        low, high = of["low"].to_numpy(), of["high"].to_numpy()
        row["width_90"] = (high - low).mean()
        row["holds_mean_of_sonic"] = ((low <= sonic[:, index].mean()) & (sonic[:, index].mean() <= high)).mean()
        row["holds_theory"] = ((low <= truth[index]) & (truth[index] <= high)).mean()
        rows.append(row)
    return rows


def draw(table: pd.DataFrame, n_field: int) -> Figure:
    """Draw means and standard deviations in the paper's layout, a column a stress, with the posteriors' widths."""
    figure = Figure(figsize=(17.0, 15.0), layout="constrained")
    axes = figure.subplots(len(FIGURES) + 1, 6)
    one = table[table["duration"] == 600.0]
    for row, (title, labels) in zip(axes, FIGURES.items(), strict=False):
        for axis, name in zip(row, brs.STRESSES, strict=True):
            of = one[one["stress"] == name]
            entries = [("sonic", of[of["method"] == "sonic"])]
            entries += [(label, of[of["scan"] == label]) for label in labels]
            for place, (_, lines) in enumerate(entries):
                for method, colour, shift in (("fit", "#1f4e79", -0.12), ("posterior", "#c26a16", 0.15)):
                    kind = ("sonic", "lsq", "lsq-no-cross") if method == "fit" else ("posterior",)
                    chosen = lines[lines["method"].isin(kind)]
                    if len(chosen):
                        value = chosen.iloc[0]
                        size = value["sd"] if method == "fit" else 0.5 * value["width_90"]
                        axis.errorbar(place + shift, value["mean"], yerr=size, fmt="o", color=colour, ms=4, capsize=2)
            axis.set_ylim(*LIMITS[name])
            axis.set_xticks(range(len(entries)), [short(label) for label, _ in entries], rotation=60, fontsize=7)
            axis.set_title(f"{name}, m² s⁻²: {title}" if name == "uu" else name, fontsize=9)
            axis.grid(axis="y", linewidth=0.3)
    last = axes[-1]
    for axis in last[1:]:
        axis.axis("off")
    place = figure.add_subplot(last[0].get_subplotspec())
    last[0].axis("off")
    uu = table[(table["stress"] == "uu") & (table["duration"] == 1800.0)]
    for method, colour, style in (("lsp", "#1f4e79", "-"), ("isotropy, table", "#c26a16", "--")):
        labels = [f"{name}-planes" for name in TABLE_1.index]
        of = uu[uu["method"] == method].set_index("scan").reindex(labels)
        place.errorbar(
            np.arange(len(of)), of["mean"], yerr=of["sd"], color=colour, linestyle=style, capsize=2, label=method
        )
    sonic = uu[uu["method"] == "sonic"].iloc[0]
    place.axhline(sonic["mean"], color="0.4", linewidth=0.8, label="sonic")
    place.set_xticks(range(len(TABLE_1)), TABLE_1.index, rotation=60, fontsize=7)
    place.set_title("uu, 1800 s, five planes (Fig. 8)", fontsize=9)
    place.legend(fontsize=7)
    figure.suptitle(
        f"{n_field} boxes of the study, 600 s: mean ± one standard deviation of least squares (blue); "
        "mean and half-width of the 90 % credible interval (orange)"
    )
    return figure


def short(label: str) -> str:
    """Return a label that fits under an axis."""
    return label.replace("-planes", ", 5 planes").replace("6-beam ", "").replace(" 52 m", "").replace("15° ", "")


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where each finished field is kept")
    parser.add_argument("--fields", type=int, default=100)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    chosen = {label: scan for label, (scan, _) in scans().items()}
    study = Fields({"sonic": sonic_scan(), **chosen}, "fu-2022", GRID, WIND_SPEED, SHEAR, DURATIONS)
    try:
        of_scan = study.variances(kept(study, options.folder, options.fields))
    except brs.InputError as error:
        parser.exit(2, f"{error}\n")
    except KeyboardInterrupt:
        parser.exit(130, f"\nInterrupted: finished fields are in {options.folder}; the same command goes on.\n")
    back = np.linalg.inv(brs.geometry.design_matrix(sonic_scan()))
    rows = []
    for duration in DURATIONS:
        sonic = of_scan["sonic"][duration] @ back.T
        rows += [
            row_of("sonic", "sonic", duration, name, sonic[:, index], sonic[:, index])
            for index, name in enumerate(brs.STRESSES)
        ]
        for label, scan in chosen.items():
            rows += estimates(label, scan, of_scan[label][duration], sonic, duration)
            if duration == 600.0 and (scan.n_beam <= MOST_FIT or label == "spinnerlidar"):
                print("posterior", label, flush=True)
                rows += posterior(label, scan, of_scan[label][duration], sonic)
    table = pd.DataFrame(rows)
    table.round(5).to_csv(options.output / "seed-study-boxes.csv", index=False)
    compared = []
    for name, printed in TABLE_1.iterrows():
        for method, value in printed.dropna().items():
            kind = "isotropy, table" if method == "isotropy" else method
            row = {"scan": name, "method": method, "printed": value}
            for duration in DURATIONS:
                of = table[(table["duration"] == duration) & (table["stress"] == "uu") & (table["method"] == kind)]
                of = of[of["scan"] == f"{name}-planes"].iloc[0]
                row |= {f"boxes_{duration:g}": of["error_percent"], f"se_{duration:g}": of["se_percent"]}
            compared.append(row)
    pd.DataFrame(compared).round(3).to_csv(options.output / "seed-study-boxes-table-1.csv", index=False)
    print(pd.DataFrame(compared).round(2).to_string())
    draw(table, options.fields).savefig(options.output / "seed-study-boxes.png", dpi=100)


if __name__ == "__main__":
    main()
