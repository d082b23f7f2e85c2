"""The tables in docs/calibration.md are those that the benchmark wrote."""

from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[1]
LEVELS = ("50 %", "80 %", "90 %", "95 %")


def measured() -> pd.DataFrame:
    return pd.read_csv(ROOT / "benchmarks" / "calibration.csv")


def ideal_lines() -> list[str]:
    table = measured()
    rows = table[table["case"] == "right noise"].groupby(["data", "prior"], sort=False)
    lines = ["| data | prior | " + " | ".join(LEVELS) + " | uu at 90 % |", "|---|---|" + "---|" * (len(LEVELS) + 1)]
    for (data, prior), some in rows:
        cells = [f"{100 * some[name].min():.1f}–{100 * some[name].max():.1f}" for name in (*LEVELS, "uu 90 %")]
        lines.append(f"| {data} | {prior} | " + " | ".join(cells) + " |")
    return lines


def other_lines() -> list[str]:
    table = measured()
    table = table[table["case"] != "right noise"]
    lines = [
        "| case | instrument | data | " + " | ".join(LEVELS) + " | largest bias, posterior sd |",
        "|---|---|---|" + "---|" * (len(LEVELS) + 1),
    ]
    for case, some in table.groupby("case", sort=False):
        for _, row in some.iterrows():
            cells = [f"{100 * row[name]:.1f}" for name in LEVELS]
            lines.append(
                f"| {case} | {row['instrument']} | {row['data']} | {' | '.join(cells)} | {row['largest bias']:.2f} |"
            )
    return lines


def test_the_tables_in_the_docs_are_those_of_the_benchmark():
    text = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    for line in [*ideal_lines(), *other_lines()]:
        assert line in text


def test_every_case_is_there_and_the_ideal_ones_are_nominal():
    """Coverage under the model, 2000 records: the worst of 864 shares is within 4.5 standard errors."""
    table = measured()
    ideal = table[(table["case"] == "right noise") & (table["data"] == "model")]
    assert len(ideal) == 4 * 3 * 3
    for name in LEVELS:
        level = float(name[:-2]) / 100.0
        assert ((ideal[name] - level).abs() < 4.5 * (level * (1.0 - level) / 2000.0) ** 0.5).all()
    assert (ideal["flagged"] < 0.01).all()
