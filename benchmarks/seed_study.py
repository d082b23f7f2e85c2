"""Do the scanning-pattern study again by theory: stresses and uu of its instruments, against a sonic, over 100 fields.

python benchmarks/seed_study.py [--records 2000] [--output benchmarks]

Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016:
Table 1, Figs. 4 to 7.
Means and standard deviations are of records of 1800 s (a field of the study) and 600 s at 10 m/s in the turbulence
`fu-2022`, in an infinite domain, by theory: estimates are linear in the variances, so their moments follow from those
of the variances. Records simulated on lines check some of them. The study's boxes are 128 m wide and periodic: its
flow is another one. Two files: seed-study-stresses.csv and seed-study-table-1.csv. About four minutes.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import bayes_rs as brs
from bayes_rs.theory.sonic_theory import SonicMoments

WIND_SPEED, SEED, N_FIELD = 10.0, 2022, 100
DURATIONS = (1800.0, 600.0)
MOST_BEAMS = 400
"""Scans with more beams have no standard deviations here, where all pairs are calculated: that takes too long."""
SIMULATED = ("2-beam", "4-beam", "5-beam", "6-beam", "50-beam")
TABLE_1 = pd.DataFrame(
    {
        "lsq": [np.nan, np.nan, np.nan, np.nan, 0.00, np.nan, 0.00, 0.17],
        "lsp": [0.0, 4.75, 3.76, 2.92, 3.03, 3.65, 3.56, 6.53],
        "isotropy": [0.0, -2.27, -3.91, -2.52, -2.66, -3.30, -3.23, -6.07],
    },
    index=["staring", "2-beam", "4-beam", "5-beam", "6-beam", "50-beam", "51-beam", "spinnerlidar"],
)
"""Relative error of uu in per cent, as printed; all with five planes."""


def scans() -> dict[str, tuple[brs.Scan, str]]:
    """Return the study's scans by a label, with where in the study they are."""
    names = TABLE_1.index
    found = {name: (brs.load_scan(name, probe="point"), "Fig. 4") for name in names}
    found |= {
        f"{name}-planes": (brs.load_scan(f"{name}-planes", probe="point"), "Figs. 5, 6, 8, Table 1") for name in names
    }
    for angle in (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0):
        scan = brs.load_scan("6-beam", opening_angle_deg=angle, focus_distance=52.0)
        found[f"6-beam {angle:g}° 52 m"] = scan, "Fig. 7"
    for distance in (49.0, 72.0, 98.0, 121.0, 142.0):
        scan = brs.load_scan("6-beam", opening_angle_deg=15.0, focus_distance=distance)
        found[f"6-beam 15° {distance:g} m"] = scan, "Fig. 7"
    return found


def records_of(variance: np.ndarray, scan: brs.Scan) -> xr.Dataset:
    """Return records that hold these variances."""
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=int)),
            "yaw": ("record", np.zeros(len(variance))),
        },
        coords={"beam": scan.beam},
    )


def weights_of(method: str, scan: brs.Scan) -> np.ndarray:
    """Return M of stress = M @ variances, shape (6, n_beam), from what the estimator makes of one more variance."""
    if scan.n_beam > MOST_BEAMS:  # the planes are of the same beams: each has its share
        one = weights_of(method, scan.select(scan.beam[:MOST_BEAMS]))
        return np.tile(one, scan.n_beam // MOST_BEAMS) * MOST_BEAMS / scan.n_beam
    n_1 = scan.line_of_sight[:, 0]
    if method == "isotropy, table":  # the first of Eqs. (7) for isotropic stresses
        weights = np.full((6, scan.n_beam), np.nan)
        weights[0] = n_1**2 / (n_1**2).sum()
        return weights
    ones = np.ones((1, scan.n_beam))
    found = brs.estimate(records_of(np.concatenate([ones, ones + np.eye(scan.n_beam)]), scan), scan, method=method)
    stress = found["stress"].values
    return (stress[1:] - stress[0]).T


def methods_of(scan: brs.Scan) -> list[str]:
    """Return the estimators that the study uses for a scan."""
    whole = ["lsq-no-cross"] if scan.name.startswith(("4-beam", "5-beam")) else ["lsq", "lsq-reduced"]
    return [*whole, "lsp", "isotropy", "isotropy, table"]


def moments(scan: brs.Scan, duration: float) -> tuple[np.ndarray, np.ndarray | None, SonicMoments]:
    """Return means and covariance of the beams' variances, and the moments with a sonic.

    The sonic stands where the axis of the last beam's range is, so that it sees the air that the beams see.
    """
    turbulence = brs.load_turbulence("fu-2022")
    place = (-float(np.median(scan.focus_distance)), 0.0, 0.0)
    options = {"wind_speed": WIND_SPEED, "duration": duration}
    some = scan if scan.n_beam <= MOST_BEAMS else scan.select(scan.beam[:1])
    sonic = brs.noise.sonic_moments(some, turbulence, position=place, **options)
    mean = brs.geometry.radial_variance(scan, sonic.mean)
    if some is not scan:
        return mean, None, sonic
    noise = brs.noise.theory(scan, turbulence, **options)
    return mean, noise.covariance[0] * np.outer(mean, mean), sonic


def study(label: str, scan: brs.Scan, where: str, duration: float) -> list[dict[str, object]]:
    """Return one row for each method of a scan."""
    mean, covariance, sonic = moments(scan, duration)
    truth = sonic.mean[0]
    rows = []
    for method in methods_of(scan):
        weights = weights_of(method, scan)
        expected = weights @ mean
        row: dict[str, object] = {"scan": label, "where": where, "duration": duration, "method": method}
        row |= {f"mean_{name}": value for name, value in zip(brs.STRESSES, expected, strict=True)}
        row["error_uu_percent"] = 100.0 * (expected[0] / truth - 1.0)
        if covariance is not None:
            spread = np.sqrt(np.einsum("qb,bc,qc->q", weights, covariance, weights))
            row |= {f"sd_{name}": value for name, value in zip(brs.STRESSES, spread, strict=True)}
            # the ratio of two means over the same fields, to first order
            ratio = expected[0] / truth
            square = spread[0] ** 2 - 2.0 * ratio * weights[0] @ sonic.cross_covariance[:, 0]
            square += ratio**2 * sonic.covariance[0, 0]
            row["se_percent_of_100_fields"] = 100.0 * np.sqrt(max(square, 0.0) / N_FIELD) / truth
        rows.append(row)
    spread = np.sqrt(np.diag(sonic.covariance))
    rows.append(
        {"scan": label, "where": where, "duration": duration, "method": "sonic"}
        | {f"mean_{name}": value for name, value in zip(brs.STRESSES, sonic.mean, strict=True)}
        | {f"sd_{name}": value for name, value in zip(brs.STRESSES, spread, strict=True)}
    )
    return rows


def simulated(label: str, scan: brs.Scan, n_record: int) -> list[dict[str, object]]:
    """Return means and standard deviations of simulated records of 600 s, one row for each method."""
    turbulence = brs.load_turbulence("fu-2022")
    series = brs.simulate(scan, turbulence, wind_speed=WIND_SPEED, duration=600.0, n_records=n_record, seed=SEED)
    records = brs.make_records(series, scan)
    records["yaw"][:] = 0.0
    rows = []
    for method in methods_of(scan)[:-1]:
        stress = brs.estimate(records, scan, method=method)["stress"]
        row: dict[str, object] = {"scan": label, "where": f"{n_record} simulated", "duration": 600.0, "method": method}
        row |= {f"mean_{name}": value for name, value in zip(brs.STRESSES, stress.mean("record").values, strict=True)}
        row |= {f"sd_{name}": value for name, value in zip(brs.STRESSES, stress.std("record").values, strict=True)}
        rows.append(row)
    return rows


def against_the_table(table: pd.DataFrame) -> pd.DataFrame:
    """Set each entry of Table 1 beside theory, and beside what its neighbour in the column implies exactly."""
    rows = []
    for name, printed in TABLE_1.iterrows():
        n_1 = brs.load_scan(str(name)).line_of_sight[:, 0]
        link = (n_1**4).sum() / (n_1**2).sum()  # (1 + isotropy) / (1 + LSP) of the first of Eqs. (7): cos²φ on a cone
        for method, value in printed.dropna().items():
            kind = "isotropy, table" if method == "isotropy" else method
            row: dict[str, object] = {"scan": name, "method": method, "printed": value}
            for duration in DURATIONS:
                chosen = (table["method"] == kind) & (table["duration"] == duration)
                of_theory = table[chosen & (table["scan"] == f"{name}-planes")].iloc[0]
                error = of_theory["se_percent_of_100_fields"]
                row[f"theory_{duration:g}"] = of_theory["error_uu_percent"]
                if np.isnan(error):  # too many beams: that of one plane
                    error = table[chosen & (table["scan"] == name)].iloc[0]["se_percent_of_100_fields"]
                row[f"se_{duration:g}"] = error
            if method == "isotropy" and name != "spinnerlidar":  # whose exact directions the study does not print
                implied = [100.0 * ((1.0 + (printed["lsp"] + end) / 100.0) * link - 1.0) for end in (-0.005, 0.005)]
                row |= {"implied_low": implied[0], "implied_high": implied[1]}
                row["contradicts"] = not implied[0] - 0.005 <= value <= implied[1] + 0.005
            rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=2000, help="simulated records for each checked scan")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    rows = []
    for label, (scan, where) in scans().items():
        print(label, flush=True)
        for duration in DURATIONS:
            rows += study(label, scan, where, duration)
        if label in SIMULATED:
            rows += simulated(label, scan, options.records)
    table = pd.DataFrame(rows)
    table.round(5).to_csv(options.output / "seed-study-stresses.csv", index=False)
    compared = against_the_table(table)
    compared.round(4).to_csv(options.output / "seed-study-table-1.csv", index=False)
    print(compared.round(3).to_string())


if __name__ == "__main__":
    main()
