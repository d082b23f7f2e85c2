"""What a default user gets: files in, tables out, in air that the package did not make (`air.py`).

Every case is an air seen by a scan: its records are written as files, and fitted as ``bayes-rs fit FILES --scan NAME``
fits them, with nothing else said. What came out is held against the truth, and goes to `real_air.csv`, six rows a case.

    python benchmarks/real_air.py --edition after                     # all cases that are not in the table yet
    python benchmarks/real_air.py --edition after --cases neutral:6-beam isotropic:zx-tm --records 200 --seeds 1 2
    python benchmarks/real_air.py --list
    python benchmarks/real_air.py --page                              # writes the tables into docs/default-user.md

A case takes 10 to 45 s of CPU; up to two minutes where a scan's nets of noise are made first. The run
can be stopped and started again at any case.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from air import Air, KaimalAir, MannAir, make_files

import bayes_rs as brs
from bayes_rs import STRESSES

HERE = Path(__file__).resolve().parent
TABLE = HERE / "real_air.csv"
PAGE = HERE.parent / "docs" / "default-user.md"
MARK = "<!-- {} of the tables made by benchmarks/real_air.py -->"
SHOWN = ("uu", "vv", "ww", "uw")
LEAST_SEEN_UW = 0.03
"""Share of uu below which a truth of uw is none, and a ratio to it says nothing."""

HEAD = (
    "air",
    "edition",
    "campaign over truth: uu",
    "vv",
    "ww",
    "uw",
    "records hold uu, vv, ww, uw, %",
    "under the campaign, %",
    "widths of uu, ww over the ideal's",
    "decided by the data of the campaign, %",
    "said of records",
)
AIMS = (
    "edition",
    "cases",
    "mean of uu within 3 %, of vv, ww, uw within 8 %, in Gaussian air and where seen",
    "interval of the mean holds",
    "90 % intervals of records hold 82 % or more",
)
SCANS = {
    "6-beam-45": "6-beam@opening_angle_deg=45",
    "6-beam": "6-beam",
    "50-beam": "50-beam",
    "zx-tm": "zx-tm",
    "pulsed-4-beam": "pulsed-4-beam",
    "2-beam": "2-beam",
}
SEES = {"6-beam-45": SHOWN, "6-beam": ("uu",), "50-beam": ("uu",), "zx-tm": ("uu",), "pulsed-4-beam": ("uu",)}
"""Stresses that a scan's variances tell by themselves, or nearly so (uu in a narrow cone): the aims are for these."""


@dataclass(frozen=True)
class Case:
    """An air or a fault, with what it is called in the tables."""

    title: str
    air: Air
    options: dict[str, Any] = field(default_factory=dict)
    scans: tuple[str, ...] = tuple(SCANS)
    wind: str = "steady"

    @property
    def is_fault(self) -> bool:
        """Whether something is in it that is no turbulence: the aims do not count there, what is said does."""
        return not self.options.keys() <= {"modulation", "spread"}


_NEUTRAL = MannAir(0.05, 61.0, 3.2)
_MANY = ("6-beam-45", "6-beam", "50-beam", "zx-tm")
AIRS = {
    "neutral": Case("neutral: L 61 m, Γ 3.2", _NEUTRAL),
    "unstable": Case("unstable: L 108 m, Γ 2.1", MannAir(0.06499, 107.8, 2.08)),
    "stable": Case("stable: L 16 m, Γ 3.4", MannAir(0.07255, 16.3, 3.38)),
    "isotropic": Case("isotropic: L 61 m, Γ 0", MannAir(0.05, 61.0, 0.0)),
    "gamma-5": Case("very anisotropic: L 61 m, Γ 5", MannAir(0.03, 61.0, 5.0)),
    "L-15": Case("small eddies: L 15 m, Γ 3.2", MannAir(0.1, 15.0, 3.2)),
    "L-200": Case("large eddies: L 200 m, Γ 3.2", MannAir(0.03, 200.0, 3.2)),
    "L-250": Case("larger eddies: L 250 m, Γ 3.2", MannAir(0.03, 250.0, 3.2)),
    "kaimal": Case("Kaimal, exponential coherence", KaimalAir()),
    "kurtosis-3.8": Case("intermittent, kurtosis 3.8 (100 s)", _NEUTRAL, {"modulation": (0.25, 100.0)}),
    "kurtosis-5.7-fast": Case("intermittent, kurtosis 5.7 (20 s)", _NEUTRAL, {"modulation": (0.4, 20.0)}),
    "kurtosis-5.7": Case("intermittent, kurtosis 5.7 (100 s)", _NEUTRAL, {"modulation": (0.4, 100.0)}),
    "kurtosis-5.7-slow": Case("intermittent, kurtosis 5.7 (300 s)", _NEUTRAL, {"modulation": (0.4, 300.0)}),
    "front": Case("a front of 3 m/s in every record", _NEUTRAL, {"front": 3.0}),
    "trend": Case("a trend of 2 m/s in every record", _NEUTRAL, {"trend": 2.0}),
    "front-some": Case("a front of 3 m/s in every fifth record", _NEUTRAL, {"front": 3.0, "changed_every": 5}),
    "trend-some": Case("a trend of 2 m/s in every fifth record", _NEUTRAL, {"trend": 2.0, "changed_every": 5}),
    "noise": Case("undeclared noise of 0.3 m/s", _NEUTRAL, {"noise": 0.3}),
    "day": Case("a day: 6 to 14 m/s, TI alike, R scattered by 0.3", _NEUTRAL, {"spread": 0.3}, wind="day"),
    "wake": Case("a wake: +50 % in a sector of 60°", _NEUTRAL, {"wake": (60.0, 120.0, 0.5)}, _MANY),
    "dead": Case("a dead beam", _NEUTRAL, {"dead": (1,)}, _MANY),
    "swapped": Case("two far beams exchanged", _NEUTRAL, {"swapped": "far"}, _MANY),
    "tilt": Case("tilt 5° more than declared", _NEUTRAL, {"tilt_deg": 5.0}, _MANY),
}


def cases() -> list[str]:
    """Return the names of all cases."""
    return [f"{air}:{scan}" for air, case in AIRS.items() for scan in case.scans]


def run_case(name: str, *, n_record: int, seed: int) -> pd.DataFrame:
    """Make files, fit them with all defaults and return a row for each stress."""
    air, scan_name = name.split(":")
    case, scan = AIRS[air], SCANS[scan_name]
    folder = Path(tempfile.mkdtemp(prefix="real-air-"))
    try:
        wind = _wind(case.wind, n_record)
        options: dict[str, Any] = {"wind_speed": wind, "size": (wind / 10.0) ** 2, "seed": seed, **case.options}
        made_for = brs.load_scan(scan)
        if options.get("swapped") == "far":
            options["swapped"] = ((1, made_for.n_beam // 2),)
        files, truth = make_files(folder / "files", made_for, case.air, n_record=n_record, **options)
        began = time.process_time()
        settings = brs.Settings().changed(scan=scan, files=[str(file) for file in files], output=str(folder / "out"))
        fit = brs.fit_files(settings)
        seconds = time.process_time() - began
        return compare(fit, folder / "out", truth).assign(
            air=air, scan=scan_name, n_record=n_record, seed=seed, cpu=round(seconds, 1)
        )
    finally:
        shutil.rmtree(folder)


def _wind(kind: str, n_record: int) -> np.ndarray:
    if kind == "steady":
        return np.full(n_record, 10.0)
    return 10.0 + 0.5 * np.round(8.0 * np.sin(2.0 * np.pi * np.arange(n_record) / 144.0))


def compare(fit: brs.Fit, folder: Path, truth: dict[str, Any]) -> pd.DataFrame:
    """Hold a fit's tables against the truth: a row for each stress; everything relative to it where it is not none."""
    table = pd.read_csv(folder / "summary.csv")
    low, high = "low", "high"
    campaign = _campaign(folder)
    plain = brs.estimate(fit.records, fit.scan)["stress"].values
    said = _said(fit)
    rows = []
    for index, stress in enumerate(STRESSES):
        some = table[table["stress"] == stress].set_index("record")
        some = some[some["mean"].notna()]
        true = truth["stresses_record"][some.index.to_numpy(), index]
        size = float(truth["stresses_record"][:, 0].mean())
        mean = float(truth["stresses_record"][:, index].mean())
        row: dict[str, Any] = {"stress": stress, "truth": mean, "fitted": len(some)}
        if campaign is not None and stress in campaign.index:
            found, row["campaign_from"] = campaign.loc[stress], "campaign.csv"
            row["campaign"], row["campaign_low"], row["campaign_high"] = found["mean"], found["low"], found["high"]
            row["campaign_decided"] = found.get("decided", np.nan)
        else:  # what users do who have no more than records: the mean, and its standard error
            error = 1.645 * float(some["mean"].std()) / np.sqrt(max(len(some), 1))
            row["campaign_from"], row["campaign"] = "mean of records", float(some["mean"].mean())
            row["campaign_low"], row["campaign_high"] = row["campaign"] - error, row["campaign"] + error
        row["campaign_holds"] = bool(row["campaign_low"] <= mean <= row["campaign_high"])
        row["median"] = float(some["median"].mean())
        row["least_squares"] = float(pd.Series(plain[:, index]).mean())
        row["hold"] = float(((some[low] <= true) & (true <= some[high])).mean())
        row["width"] = float((some[high] - some[low]).median()) / size
        if "campaign_low" in some and some["campaign_low"].notna().any():
            inside = (some["campaign_low"] <= true) & (true <= some["campaign_high"])
            row["hold_campaign"] = float(inside[some["campaign_low"].notna()].mean())
            row["width_campaign"] = float((some["campaign_high"] - some["campaign_low"]).median()) / size
        row["decided"] = float(some["decided"].mean()) if "decided" in some else np.nan
        rows.append({**row, "said": said})
    return pd.DataFrame(rows)


def _campaign(folder: Path) -> pd.DataFrame | None:
    if not (folder / "campaign.csv").exists():
        return None
    table = pd.read_csv(folder / "campaign.csv")
    return table[table["bin"].astype(str) == "all"].set_index("quantity")


def _said(fit: brs.Fit) -> str:
    """Return the share of records that each flag is of, as 'unsteady 97 %; beams_disagree 2 %'."""
    flag = np.asarray(fit.flag)
    from bayes_rs.fits.flags import FLAGS  # noqa: PLC0415 - one place that may move

    shares = {name: float(np.mean((flag & bit) != 0)) for name, bit in FLAGS.items()}
    return "; ".join(f"{name} {100.0 * share:.0f} %" for name, share in shares.items() if share > 0.0)


def missing(edition: str, wanted: list[str], seeds: list[int]) -> Iterator[tuple[str, int]]:
    """Yield the cases that the table does not have yet."""
    table = read_table()
    of = table[table["edition"] == edition]
    done = set(zip(of["air"] + ":" + of["scan"], of["seed"], strict=True))
    for seed in seeds:
        yield from ((name, seed) for name in wanted if (name, seed) not in done)


def read_table() -> pd.DataFrame:
    """Return what has been measured."""
    if not TABLE.exists():
        return pd.DataFrame({name: pd.Series(dtype=str) for name in ("edition", "air", "scan", "seed", "stress")})
    return pd.read_csv(TABLE, keep_default_na=True)


def page_tables(table: pd.DataFrame) -> str:
    """Return the tables of the page: for each scan, and each air with all editions one below the other."""
    parts = []
    for scan in (name for name in SCANS if (table["scan"] == name).any()):
        lines = [
            f"### {SCANS[scan]}\n",
            f"| {' | '.join(HEAD)} |",
            "|---" * len(HEAD) + "|",
        ]
        for air, case in AIRS.items():
            some = table[(table["scan"] == scan) & (table["air"] == air)]
            for edition in ("before", "after"):
                of = some[some["edition"] == edition]
                if len(of):
                    lines.append(_line(case.title, edition, of, _ideal(table, scan)))
        parts.append("\n".join(lines))
    return "\n\n".join([aims_table(table), *parts])


def _ideal(table: pd.DataFrame, scan: str) -> pd.DataFrame:
    """Return the rows of the ideal case before: Gaussian, neutral, with the length scale that was the default."""
    return table[(table["scan"] == scan) & (table["air"] == "neutral") & (table["edition"] == "before")]


def _widths(by: dict[str, pd.DataFrame], ideal: pd.DataFrame, column: str) -> str:
    """Return the widths of uu and ww, each over the truth of uu, relative to those of the ideal case."""
    if not len(ideal) or column not in by["uu"] or by["uu"][column].isna().all():
        return ""
    of = {stress: float(ideal[ideal["stress"] == stress]["width"].mean()) for stress in ("uu", "ww")}
    return ", ".join(f"{by[stress][column].mean() / of[stress]:.2f}" for stress in of)


def _line(title: str, edition: str, of: pd.DataFrame, ideal: pd.DataFrame) -> str:
    by = {stress: of[of["stress"] == stress] for stress in STRESSES}
    size = float(by["uu"]["truth"].mean())
    cells = [title, edition]
    for stress in SHOWN:
        some = by[stress]
        true = float(some["truth"].mean())
        if abs(true) < LEAST_SEEN_UW * size:
            cells.append(f"{some['campaign'].mean():.2f} for 0")
            continue
        ends = sorted(
            [
                float((some["campaign_low"] / some["truth"]).mean()),
                float((some["campaign_high"] / some["truth"]).mean()),
            ]
        )
        mark = "" if some["campaign_holds"].all() else " ✗"
        cells.append(f"{float((some['campaign'] / some['truth']).mean()):.2f} ({ends[0]:.2f}–{ends[1]:.2f}){mark}")
    cells.append(_percents(by, "hold"))
    cells.append(_percents(by, "hold_campaign"))
    own, campaign = _widths(by, ideal, "width"), _widths(by, ideal, "width_campaign")
    cells.append(f"{own}; campaign {campaign}" if campaign else own or "–")
    cells.append(_percents(by, "campaign_decided"))
    cells.append(str(by["uu"]["said"].fillna("nothing").iloc[0]))
    return f"| {' | '.join(cells)} |"


def _percents(by: dict[str, pd.DataFrame], column: str) -> str:
    if column not in by["uu"] or by["uu"][column].isna().all():
        return "–"
    return ", ".join(f"{100.0 * by[stress][column].mean():.0f}" for stress in SHOWN)


def aims_table(table: pd.DataFrame) -> str:
    """Return how many of the cases without a fault meet the aims, for each edition; means in Gaussian air only."""
    turbulent = {air for air, case in AIRS.items() if not case.is_fault}
    gaussian = {air for air in turbulent if "modulation" not in AIRS[air].options}
    lines = [
        f"| {' | '.join(AIMS)} |",
        "|---" * len(AIMS) + "|",
    ]
    for edition in ("before", "after"):
        of = table[(table["edition"] == edition) & table["stress"].isin(SHOWN) & table["air"].isin(turbulent)]
        if not len(of):
            continue
        size = of.merge(
            of[of["stress"] == "uu"][["air", "scan", "seed", "truth"]], on=["air", "scan", "seed"], suffixes=("", "_uu")
        )
        seen = np.array([s in SEES.get(scan, ()) for scan, s in zip(size["scan"], size["stress"], strict=True)])
        told = (
            seen
            & size["air"].isin(gaussian).to_numpy()
            & (size["truth"].abs() > LEAST_SEEN_UW * size["truth_uu"]).to_numpy()
        )
        off = (size["campaign"] / size["truth"] - 1.0).abs()
        near = off <= np.where(size["stress"] == "uu", 0.03, 0.08)
        best = size["hold_campaign"].fillna(size["hold"]) if "hold_campaign" in size else size["hold"]
        n_case = len(of[["air", "scan", "seed"]].drop_duplicates())
        cells = [
            edition,
            f"{n_case}",
            _share(near[told]),
            _share(size["campaign_holds"].astype(bool)),
            _share(best >= 0.82),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _share(of: pd.Series) -> str:
    return f"{int(of.sum())} of {len(of)}"


def page_with(text: str, tables: str) -> str:
    """Return the page with these tables between its marks."""
    begin, end = MARK.format("begin"), MARK.format("end")
    head, rest = text.split(begin)
    return f"{head}{begin}\n\n{tables}\n\n{end}{rest.split(end)[1]}"


def main() -> None:
    """Measure what is missing, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edition", default="after", choices=("before", "after"))
    parser.add_argument("--cases", nargs="*", default=cases(), metavar="AIR:SCAN")
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1])
    parser.add_argument("--list", action="store_true", help="name the cases, and end")
    parser.add_argument("--page", action="store_true", help="write the tables into docs/default-user.md, and end")
    options = parser.parse_args()
    if options.list:
        print("\n".join(cases()))
        return
    if options.page:
        PAGE.write_text(page_with(PAGE.read_text(encoding="utf-8"), page_tables(read_table())), encoding="utf-8")
        return
    unknown = sorted(set(options.cases) - set(cases()))
    if unknown:
        sys.exit(f"Unknown cases {', '.join(unknown)}: --list names them.")
    for name, seed in missing(options.edition, options.cases, options.seeds):
        found = run_case(name, n_record=options.records, seed=seed)
        found = found.assign(edition=options.edition)
        pd.concat([read_table(), found]).to_csv(TABLE, index=False, float_format="%.5g")
        shown = found.set_index("stress").loc[list(SHOWN)]
        size = float(shown.loc["uu", "truth"])
        told = [stress for stress in SHOWN if abs(shown.loc[stress, "truth"]) > LEAST_SEEN_UW * size]
        ratios = ", ".join(f"{s} {shown.loc[s, 'campaign'] / shown.loc[s, 'truth']:.3f}" for s in told)
        held = ", ".join(f"{100.0 * value:.0f}" for value in shown["hold"])
        print(
            f"{name}, seed {seed}: campaign over truth {ratios}; records hold {held}; {found['cpu'].iloc[0]} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
