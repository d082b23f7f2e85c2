"""Do the scanning-pattern study again in its own boxes: 100 fields, 128 m wide and high, 30 minutes long.

python benchmarks/seed_study_boxes.py FOLDER [--fields 100] [--output benchmarks]

Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016:
Figs. 4 to 8, Table 1.
All eight lidars, with one plane and with five, and the sonic see the same fields, on the study's grid of 8192 x 64 x 64
points with its shear. What the beams measure in a field is kept in a file of FOLDER: after Ctrl-C the same command goes
on, and a file that is damaged or another study's is refused. Estimates are of the whole field (1800 s) and of its first
600 s. Of the 600-s records the posterior is sampled, too, with the noise by theory: its noise model is that of an
infinite domain, the boxes are periodic every 128 m. `seed_study.py` is the same study in an infinite domain, without
Monte-Carlo error. Two tables, seed-study-boxes.csv and seed-study-boxes-table-1.csv, and a figure in the paper's
layout, seed-study-boxes.png. Ten to twenty seconds of CPU a field, and some ten minutes of posteriors, most of
it for the 2000 beams of the SpinnerLidar with five planes.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from kept_fields import Fields
from seed_study import TABLE_1, WIND_SPEED, methods_of, records_of, scans, weights_of
from seed_study_picture import draw

import bayes_rs as brs
from bayes_rs.simulation.boxes import BoxGrid

GRID = BoxGrid((8192, 64, 64), (18000.0 / 8192, 2.0, 2.0))
FIRST_SEED = 1
DURATIONS = (1800.0, 600.0)
SHEAR = 0.0288
"""dU/dz, 1/s."""


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


def intervals(scan: brs.Scan, variance: np.ndarray) -> np.ndarray:
    """Return mean, low and high end of the 90 % intervals of the 600-s records, shape (3, n_field, 6), m² s⁻²."""
    noise = brs.noise.calibrate(scan, brs.load_turbulence("fu-2022"), wind_speed=WIND_SPEED, duration=600.0)
    records = records_of(variance, scan)
    records["wind_speed"] = ("record", np.full(len(variance), WIND_SPEED))
    records.attrs["duration"] = 600.0
    table = brs.fit(records, scan, noise=noise, seed=1, sampler="auto", campaign="off").summary()
    by_stress = [table[table["stress"] == name] for name in brs.STRESSES]
    return np.stack([[of[kind].to_numpy() for of in by_stress] for kind in ("mean", "low", "high")]).swapaxes(1, 2)


def posterior(label: str, scan: brs.Scan, found: np.ndarray, sonic: np.ndarray) -> list[dict]:
    """Return a row for each stress with what the posteriors of the 600-s records say."""
    some = scan.select(scan.beam[:1])  # the truth at a point is no scan's
    flow = brs.load_turbulence("fu-2022")
    truth = brs.noise.sonic_moments(some, flow, wind_speed=WIND_SPEED, duration=600.0).mean
    rows = []
    for index, name in enumerate(brs.STRESSES):
        mean, low, high = found[:, :, index]
        row = row_of(label, "posterior", 600.0, name, mean, sonic[:, index])
        row["width_90"] = (high - low).mean()
        row["holds_mean_of_sonic"] = ((low <= sonic[:, index].mean()) & (sonic[:, index].mean() <= high)).mean()
        row["holds_theory"] = ((low <= truth[index]) & (truth[index] <= high)).mean()
        rows.append(row)
    return rows


def errors_of_uu(table: pd.DataFrame) -> pd.DataFrame:
    """Set each entry of Table 1 beside that of the boxes, with its standard error."""
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
    return pd.DataFrame(compared)


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
            if duration == 600.0:
                print("posterior", label, flush=True)
                rows += posterior(label, scan, intervals(scan, of_scan[label][duration]), sonic)
    table = pd.DataFrame(rows)
    table.round(5).to_csv(options.output / "seed-study-boxes.csv", index=False)
    compared = errors_of_uu(table)
    compared.round(3).to_csv(options.output / "seed-study-boxes-table-1.csv", index=False)
    print(compared.round(2).to_string())
    draw(table, compared, options.fields).savefig(options.output / "seed-study-boxes.png", dpi=100)


if __name__ == "__main__":
    main()
