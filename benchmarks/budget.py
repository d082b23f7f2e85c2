"""The uncertainty budgets of the demo's hour on the page docs/budget.md, and their picture.

python benchmarks/budget.py OUTPUT

Six beams, five of them at 45°, and fifty beams at 15°, in the same simulated wind. What the default counts, and, as
what a user may know of a mounting and an inflow: yaw known to 5°, tilt to 1°, a vertical gradient of 0.3 per 100 m.
"""

import sys
from pathlib import Path

import bayes_rs as brs
from bayes_rs.fits.budget_table import budget_lines
from bayes_rs.pictures import Picture

LIDARS = {
    "six beams, five of them at 45°": ("6-beam@opening_angle_deg=45,focus_distance=52", "6-beam-45"),
    "fifty beams at 15°": ("50-beam", "50-beam"),
}
MORE = {"yaw_sd_deg": 5.0, "tilt_sd_deg": 1.0, "vertical_gradient_sd": 0.3}


def main(output: Path) -> None:
    """Print the budgets and draw those with everything."""
    figure = Picture(figsize=(11.0, 8.4), layout="constrained")
    for axis, (title, (scan, file)) in zip(figure.subplots(2, 1), LIDARS.items(), strict=True):
        records = brs.make_records(brs.read(brs.demo_file(file), scan), scan)
        fit = brs.fit(records, scan, seed=1, sampler="auto", derived=["ti"])
        for words, uncertain in (("by default", {}), ("with yaw, tilt and a gradient", MORE)):
            table = brs.budget(fit, **uncertain)
            print(f"\n{title}, {words}", *budget_lines(table), sep="\n")
        brs.plot.budget(table, ax=axis)
        axis.set_title(f"{title}: mean of {table.attrs['n_record']} records", fontsize=10)
    output.mkdir(parents=True, exist_ok=True)
    figure.savefig(output / "budget.png", dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
