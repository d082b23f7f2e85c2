"""How often which alarm fires: for every kind of fault, and in good air of every kind.

Each case has records of the second generator (`air.py`), with shear and a wind that turns from record to record, as
files would give them; noise and everything else are the defaults of `fit`. Writes ``alarms.csv``.

    python benchmarks/alarms.py [--records 200] [--scan NAME ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from air import KaimalAir, MannAir, make_series

import bayes_rs as brs
from bayes_rs.alarms.words import CheckWords
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions
from bayes_rs.fits.noise_choice import noise_and_records
from bayes_rs.fits.prepare import prepare
from bayes_rs.fits.record_beams import look_at_beams
from bayes_rs.geometry.scan import Scan, tilt_matrix
from bayes_rs.records.beam_wind import wind_of_beams

HERE = Path(__file__).parent
SCANS = (
    "6-beam@opening_angle_deg=45,focus_distance=52",
    "6-beam",
    "50-beam",
    "zx-tm",
    "pulsed-4-beam",
    "2-beam",
    "4-beam-planes",
)
HUB = 100.0  # m
FU = MannAir(0.05, 61.0, 3.2)
GOOD = {
    "Mann, L 61 m": {"air": FU},
    "Mann, L 20 m": {"air": MannAir(0.05, 20.0, 3.2)},
    "Mann, L 200 m": {"air": MannAir(0.05, 200.0, 3.2)},
    "isotropic": {"air": MannAir(0.05, 61.0, 0.0)},
    "Mann, Γ 5": {"air": MannAir(0.05, 61.0, 5.0)},
    "Kaimal": {"air": KaimalAir()},
    "kurtosis 5": {"air": FU, "modulation": (0.357, 60.0)},
    "front of 3 m/s": {"air": FU, "front": 3.0},
    "trend of 2 m/s": {"air": FU, "trend": 2.0},
    "noise of 0.3 m/s in all": {"air": FU, "noise": 0.3},
    "tilt 5° more": {"air": FU, "tilt_deg": 5.0},
    "tilt 5° less": {"air": FU, "tilt_deg": -5.0},
}
"""Air in which no beam is at fault; and a wrong tilt, which no single beam is."""


def records_of(scan: Scan, n_record: int, seed: int, *, tilt_deg: float = 0.0, **asked: Any) -> xr.Dataset:
    """Return records with a shear and a direction of their own."""
    speed = np.tile([8.0, 12.0], n_record)[:n_record]
    series, _ = make_series(scan, n_record=n_record, wind_speed=speed, seed=seed, tilt_deg=tilt_deg, **asked)
    return with_wind(brs.make_records(series, scan), scan, speed, seed, tilt_deg)


def with_wind(records: xr.Dataset, scan: Scan, speed: np.ndarray, seed: int, tilt_deg: float) -> xr.Dataset:
    """Return records whose means have shear and a wind direction, too."""
    rng = np.random.default_rng(seed)
    exponent = rng.normal(0.15, 0.08, len(speed))
    across = speed * np.tan(np.deg2rad(rng.normal(0.0, 4.0, len(speed))))
    n = scan.beam_direction @ tilt_matrix(scan.tilt + np.deg2rad(tilt_deg))
    height = n[:, 2] * scan.focus_distance
    more = speed[:, None] * (((HUB + height) / HUB) ** exponent[:, None] - 1.0) * n[:, 0] + across[:, None] * n[:, 1]
    return winded(records.assign(mean=records["mean"] + more), scan)


def winded(records: xr.Dataset, scan: Scan) -> xr.Dataset:
    """Return records with the wind of their means."""
    speed, yaw, flag = wind_of_beams(records["mean"].values, records["flag"].values == 0, scan)
    return records.assign(wind_speed=("record", speed), yaw=("record", yaw), record_flag=("record", flag))


def faults(scan: Scan, good: xr.Dataset, seed: int) -> Iterator[tuple[str, list[int], xr.Dataset]]:
    """Give spoiled records, with the fault and its beams."""
    rng = np.random.default_rng(seed)
    n_beam, n_record = scan.n_beam, good.sizes["record"]
    sector = list(range(12, 18)) if n_beam > 20 else [1]
    where = "sector of six" if n_beam > 20 else "one beam"

    def changed(change: Callable[[np.ndarray, np.ndarray], None]) -> xr.Dataset:
        records = good.copy(deep=True)
        change(records["variance"].values, records["mean"].values)
        return winded(records, scan)

    for name, factor in (("20 % less", 0.8), ("50 % less", 0.5), ("50 % more", 1.5), ("twice", 2.0)):

        def scaled(variance: np.ndarray, _: np.ndarray, factor: float = factor) -> None:
            variance[:, sector] *= factor

        yield f"{where}, variance {name}", sector, changed(scaled)
    one = min(3, n_beam - 1)

    def dead(variance: np.ndarray, mean: np.ndarray) -> None:
        variance[:, one], mean[:, one] = rng.gamma(300.0, 0.0025 / 300.0, n_record), rng.normal(0.0, 0.002, n_record)

    def noisy(variance: np.ndarray, mean: np.ndarray) -> None:
        variance[:, one] = rng.gamma(300.0, 75.0 / 300.0, n_record)  # evenly over 30 m/s
        mean[:, one] = rng.normal(0.0, 0.35, n_record)

    def blocked(variance: np.ndarray, mean: np.ndarray) -> None:
        share = 0.1  # of samples that see a blade, at 0 m/s
        variance[:, one] = (1.0 - share) * (variance[:, one] + share * mean[:, one] ** 2)
        mean[:, one] *= 1.0 - share

    def one_in_four(variance: np.ndarray, _: np.ndarray) -> None:
        variance[::4, sector] *= 0.5

    yield "dead beam", [one], changed(dead)
    yield "beam of noise", [one], changed(noisy)
    yield "10 % of a beam's samples from a blade", [one], changed(blocked)
    yield f"{where}, variance 50 % less in one record of four", sector, changed(one_in_four)
    if n_beam > 2:
        pair = [10, 30] if n_beam > 20 else [0, 2]

        def swapped(variance: np.ndarray, mean: np.ndarray) -> None:
            for values in (variance, mean):
                values[:, pair] = values[:, pair[::-1]]

        yield "two beams exchanged", pair, changed(swapped)


def looked_at(scan: Scan, records: xr.Dataset) -> CheckWords:
    """Look at records with the defaults of a fit."""
    noise, records = noise_and_records(records, scan, None, FitOptions(), NoiseOptions(), lambda _: None)
    scan, noise, batch = prepare(records, scan, noise, FitOptions())
    return look_at_beams(records, scan, noise, batch, FitOptions())


def row(scan: Scan, case: str, beams: list[int], records: xr.Dataset) -> dict[str, Any]:
    """Return how often each alarm fires, and how often it names the beams."""
    began = time.process_time()
    told = looked_at(scan, records)
    seconds = time.process_time() - began
    check = told.check
    each = {
        f"{kind}_{what}": float(np.mean(p < check.level / (2 * len(check.kinds))))
        for kind, found in check.kinds.items()
        for what, p in (("chi2", found.p_square), ("pattern", found.p_pattern))
    }
    named = [names(told, index, beams) for index in range(len(check.misfit))] if beams else [False]
    return {
        "scan": scan.name,
        "case": case,
        "records": len(check.misfit),
        "flagged": round(float(np.mean(check.disagree)), 4),
        **{name: round(share, 4) for name, share in each.items()},
        "exchange": round(float(np.mean(check.exchanged)), 4),
        "named": round(float(np.mean(named)), 4) if beams else None,
        "scatter": None if check.scatter is None else round(check.scatter[0], 2),
        "excess": round(check.kinds["variance"].excess, 2),
        "milliseconds": round(1e3 * seconds / len(check.misfit), 3),
        "words": "; ".join(told.of_all()),
    }


def names(told: CheckWords, index: int, beams: list[int]) -> bool:
    """Say whether what is said of a record names the beams at fault: half of what it names and of what they are."""
    check, words = told.check, told.of_record(index)
    if not words or "no simple" in words:
        return False
    if "exchanged" in words:
        return sorted(int(check.exchange[index, k]) for k in (0, 1)) == sorted(beams)
    kind, _ = told.worst(index)
    found = set(check.patterns.members(int(check.kinds[kind].pattern[index])).tolist())
    return len(found & set(beams)) >= 0.5 * len(found | set(beams))


def measure(name: str, n_record: int, seed: int, airs: list[str] | None) -> Iterator[dict[str, Any]]:
    """Give the rows of a scan."""
    scan = brs.load_scan(name)
    good = None
    for case, asked in GOOD.items():
        if (case.startswith("tilt") and scan.n_beam == 2) or (airs and case not in airs):
            continue
        records = records_of(scan, n_record, seed, **asked)
        good = records if good is None else good
        yield row(scan, case, [], records)
    for case, beams, records in faults(scan, good, seed):
        yield row(scan, case, beams, records)


SHORT = {
    SCANS[0]: "6-beam, 45°",
    "6-beam": "6-beam, 15°",
    "pulsed-4-beam": "pulsed, 4",
    "4-beam-planes": "4-beam, five distances",
}


def as_markdown(table: pd.DataFrame) -> str:
    """Return the table of docs/diagnostics.md: flagged, and where a beam is at fault, named / flagged, %."""
    scans = list(dict.fromkeys(table["scan"]))
    cases: dict[str, dict[str, str]] = {}
    for _, found in table.iterrows():
        case = (
            found["case"].replace("sector of six,", "a beam or sector,").replace("one beam, v", "a beam or sector, v")
        )
        cell = f"{100.0 * found['flagged']:.3g}"
        if np.isfinite(found["named"]):
            cell = f"{100.0 * found['named']:.3g} / {cell}"
        elif np.isfinite(found["scatter"]):
            cell += f" ({found['scatter']:.2f})"
        together = "all records together" in str(found["words"])
        cases.setdefault(case, {})[found["scan"]] = cell + (", all" if together else "")
    lines = [["case", *(SHORT.get(scan, scan) for scan in scans)], ["---"] * (1 + len(scans))]
    lines += [[case, *(of.get(scan, "") for scan in scans)] for case, of in cases.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scan", action="append", help="only these scans; the others' rows stay")
    parser.add_argument("--air", action="append", help="only these kinds of good air; the first is spoiled")
    parser.add_argument("--output", type=Path, default=HERE / "alarms.csv")
    asked = parser.parse_args()
    scans = tuple(asked.scan or SCANS)
    rows = []
    for name in scans:
        for found in measure(name, asked.records, asked.seed, asked.air):
            print(*(f"{key} {value}" for key, value in found.items() if key != "scan"), sep=", ", flush=True)
            rows.append(found)
    table = pd.DataFrame(rows)
    if asked.scan and asked.output.exists():
        before = pd.read_csv(asked.output)
        table = pd.concat([before[~before["scan"].isin(table["scan"])], table], ignore_index=True)
    order = {scan: place for place, scan in enumerate(SCANS)}
    table = table.sort_values("scan", key=lambda names: names.map(order).fillna(len(order)), kind="stable")
    table.to_csv(asked.output, index=False)


if __name__ == "__main__":
    main()
