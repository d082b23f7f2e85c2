"""The tables in docs/quality.md are those that the benchmark wrote."""

from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[1]


def percent(share: float, digits: int) -> str:
    return f"{100.0 * share:.{digits}f}".replace("-", "−")


def false_alarm_lines() -> list[str]:
    table = pd.read_csv(ROOT / "benchmarks" / "quality-false-alarms.csv")
    heads = [
        "scan",
        "U m/s",
        "turbulence",
        "L/(UT)",
        "spikes",
        "blades",
        "frozen 5",
        "trend 0.01",
        "sub-variance 0.3",
        "half ratio 4",
    ]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for _, row in table.iterrows():
        cells = [
            row["scan"],
            f"{row['U']:g}",
            row["turbulence"],
            f"{row['L/(UT)']:.4f}",
            f"{percent(row['despike'], 3)}, {percent(row['despike, variance'], 2)}",
            f"{percent(row['blade'], 3)}, {percent(row['blade, variance'], 2)}",
            percent(row["frozen 5, 0.1 m/s"], 3),
            *(percent(row[name], 1) for name in ("trend 0.01", "sub-variance 0.3", "half ratio 4")),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def hit_lines() -> list[str]:
    table = pd.read_csv(ROOT / "benchmarks" / "quality-hits.csv")
    lines = [
        "| fault | filter | planted | dropped | dropped of the rest | variance before | variance after |",
        "|---|---|---|---|---|---|---|",
    ]
    for _, row in table.iterrows():
        shares = [percent(row[name], 2) for name in ("planted", "dropped", "dropped without the fault")]
        shares += [percent(row["variance before"], 1), percent(row["variance after"], 2)]
        lines.append(f"| {row['fault']} | `{row['rule']}` | {' | '.join(shares)} |")
    return lines


def remark_lines() -> list[str]:
    table = pd.read_csv(ROOT / "benchmarks" / "quality-remarks.csv")
    names = ["trend 0.01", "sub-variance 0.3", "sub-variance 0.6", "half ratio 4"]
    lines = [f"| fault | variance | {' | '.join(names)} |", "|---|---|---|---|---|---|"]
    for _, row in table.iterrows():
        cells = [f"{100.0 * row['variance']:+.0f}", *(percent(row[name], 1) for name in names)]
        lines.append(f"| {row['fault']} | {' | '.join(cells)} |")
    return lines


def test_the_tables_in_the_docs_are_those_of_the_benchmark():
    text = (ROOT / "docs" / "quality.md").read_text(encoding="utf-8").splitlines()
    for line in [*false_alarm_lines(), *hit_lines(), *remark_lines()]:
        assert line in text


def test_sound_data_lose_next_to_nothing():
    """What the page says of the filters: under 0.05 % of the samples, under 0.2 % of the variance."""
    table = pd.read_csv(ROOT / "benchmarks" / "quality-false-alarms.csv")
    assert (table[["despike", "blade", "frozen 5, 0.1 m/s"]].to_numpy() < 5e-4).all()
    assert (table[["despike, variance", "blade, variance"]].abs().to_numpy() < 2e-3).all()
    assert (table["blades reported"] == 0.0).all()
    assert table["trend 0.01"].max() < 0.025
