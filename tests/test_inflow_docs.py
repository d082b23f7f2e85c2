"""The tables in docs/inhomogeneous-inflow.md: the benchmark's, and what `inflow_confounding` says."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayes_rs import inflow_confounding, load_scan, load_turbulence
from bayes_rs.noise.by_theory import theory_noise

ROOT = Path(__file__).parents[1]
SCANS = {
    "four beams, 15°, 98 m": ("4-beam", {}),
    "pulsed, four beams": ("pulsed-4-beam@probe=point", {}),
    "six beams, 15°, 98 m": ("6-beam", {}),
    "six beams, 45°, 126 m": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 126.0}),
    "50 beams, 15°, 98 m": ("50-beam", {}),
    "six beams, five planes, 49 to 142 m": ("6-beam-planes", {}),
    "51 beams, five planes": ("51-beam-planes", {}),
}


def text():
    return (ROOT / "docs" / "inhomogeneous-inflow.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("label", list(SCANS))
def test_what_a_scan_confounds(label):
    name, changes = SCANS[label]
    scan, flow = load_scan(name, tilt_deg=0.0, **changes), load_turbulence("fu-2022")
    noise = theory_noise(scan, flow, wind_speed=10.0)
    rows = [
        table.query("gradient == 'vertical_gradient' and stress == 'uw'").iloc[0]
        for table in (
            inflow_confounding(scan, flow.stresses()),
            inflow_confounding(scan, flow.stresses(), noise=noise),
        )
    ]
    line = next(line for line in text().splitlines() if line.startswith(f"| {label} |"))
    fake, alike, weighted, sd = (cell.strip().replace("−", "-") for cell in line.strip("|").split("|")[1:])
    assert f"{rows[0]['over_uu']:.2f}" == fake
    for cell, found in ((alike, rows[0]["hidden"]), (weighted, rows[1]["hidden"])):
        if cell == "1":
            assert found > 1.0 - 1e-9
        else:
            assert float(cell) == pytest.approx(found, abs=0.51 * 10.0 ** -len(cell.split(".")[1]))
    if sd == "∞":
        assert np.isinf(rows[1]["sd"])
    else:
        assert float(sd) == pytest.approx(rows[1]["sd"], rel=0.05)


def test_the_table_of_biases_is_that_of_the_benchmark():
    table = pd.read_csv(ROOT / "benchmarks" / "inhomogeneous-inflow.csv")
    assert len(table.groupby(["scan", "flow"])) == 20
    for (scan, flow), part in table.groupby(["scan", "flow"]):
        stress = "uv" if flow.startswith("wake") else "uw"
        row = part[part["stress"] == stress].set_index("fit")
        cells = [scan, flow, stress, f"{row['exact_bias'].iloc[0]:.2f}"]
        for fit in ("homogeneous", "gradients"):
            one = row.loc[fit]
            cells += [f"{one['bias']:.2f} ± {one['sd']:.2f}", f"{100.0 * one['coverage']:.0f} %"]
        cells.append(f"{row['log_bayes_factor'].iloc[0]:.2f}")
        assert f"| {' | '.join(cells)} |".replace("-0.00", "0.00").replace(" -", " −") in text()
