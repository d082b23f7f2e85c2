"""The picture of the scanning-pattern study in its boxes, after the paper: a row a figure, a column a stress."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import bayes_rs as brs
from bayes_rs.pictures import COLOURS, POSTERIOR_COLOUR, TRUTH_COLOUR

LEAST_SQUARES, POSTERIOR, ISOTROPY, SONIC = TRUTH_COLOUR, POSTERIOR_COLOUR, COLOURS[2], "0.35"
FIGURES = {
    "Fig. 4: one plane": {
        "6-beam": "6 beams",
        "50-beam": "50 beams",
        "51-beam": "51 beams",
        "spinnerlidar": "SpinnerLidar",
    },
    "Fig. 5: one and five planes": {
        "50-beam": "50 beams",
        "50-beam-planes": "50, 5 planes",
        "51-beam": "51 beams",
        "51-beam-planes": "51, 5 planes",
        "spinnerlidar": "SpinnerLidar",
        "spinnerlidar-planes": "Spinner, 5 planes",
    },
    "Fig. 6: least squares with uv = vw = 0": {
        "4-beam": "4 beams",
        "4-beam-planes": "4, 5 planes",
        "5-beam": "5 beams",
        "5-beam-planes": "5, 5 planes",
    },
    "Fig. 7a: 6 beams at 52 m, opening angle": {
        f"6-beam {angle}° 52 m": f"{angle}°" for angle in (15, 20, 25, 30, 35, 40, 45)
    },
    "Fig. 7b: 6 beams at 15°, distance": {f"6-beam 15° {far} m": f"{far} m" for far in (49, 72, 98, 121, 142)},
}
"""The scans of a row by what the axis calls them, beams or what varies."""
LIMITS = {"uu": (0.5, 2.3), "vv": (-1, 2.4), "ww": (-1, 2.2), "uv": (-0.5, 0.5), "uw": (-0.8, 0.2), "vw": (-0.8, 0.8)}
"""Ends of the axes, m² s⁻²: bars that go on have their standard deviation written beside them."""
METHODS = {"lsq": "least squares", "lsp": "projection", "isotropy, table": "isotropy"}


def draw(table: pd.DataFrame, table_1: pd.DataFrame, n_field: int) -> Figure:
    """Draw means and standard deviations of whole fields, the posteriors' widths, and the errors of Table 1."""
    figure = Figure(figsize=(14.0, 17.0), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.06, w_pad=0.04)
    heights = [1.2 + len(names) for names in FIGURES.values()]
    above, below = figure.subfigures(2, 1, height_ratios=[sum(heights), 10.5])
    axes = above.subplots(len(FIGURES), 6, gridspec_kw={"height_ratios": heights}, sharex="col")
    for row, (title, names) in zip(axes, FIGURES.items(), strict=True):
        for axis, stress in zip(row, brs.STRESSES, strict=True):
            _stress(axis, table[table["stress"] == stress], list(names), stress)
            axis.set_yticks(range(len(names) + 1), ["sonic", *names.values()] if axis is row[0] else [], fontsize=10)
        row[0].set_title(title, fontsize=11, loc="left", fontweight="bold")
    for axis, stress in zip(axes[-1], brs.STRESSES, strict=True):
        axis.set_xlabel(f"{stress} [m² s⁻²]", fontsize=11)
    for axis, stress in zip(axes[0][1:], brs.STRESSES[1:], strict=True):
        axis.set_title(stress, fontsize=11)
    figure.suptitle(f"{n_field} boxes of the study: six stresses by instrument", fontsize=14)
    above.legend(
        handles=[
            axes[0][0].errorbar([], [], xerr=[], fmt="o", color=LEAST_SQUARES, capsize=2),
            axes[0][0].errorbar([], [], xerr=[], fmt="s", color=POSTERIOR, capsize=2),
            axes[0][0].errorbar([], [], xerr=[], fmt="D", color=SONIC, capsize=2),
        ],
        labels=[
            "least squares of 1800 s: mean ± standard deviation",
            "posterior of 600 s: mean and half-width of its 90 % interval",
            "sonic of 1800 s: mean ± standard deviation",
        ],
        loc="outside upper center",
        ncols=3,
        fontsize=9.5,
        frameon=False,
    )
    left, right = below.subplots(1, 2)
    _along_wind(left, table, list(table_1["scan"].unique()))
    _errors(right, table_1)
    return figure


def _stress(axis: Axes, table: pd.DataFrame, scans: list[str], stress: str) -> None:
    """Draw the sonic and some scans, one line each, from above."""
    low, high = LIMITS[stress]
    axis.set_xlim(low, high)
    sonic = table[(table["scan"] == "sonic") & (table["duration"] == 1800.0)].iloc[0]
    axis.errorbar(sonic["mean"], 0, xerr=sonic["sd"], fmt="D", color=SONIC, ms=4, capsize=2)
    axis.axvline(sonic["mean"], color=SONIC, linewidth=0.8, linestyle=":")
    for place, scan in enumerate(scans, start=1):
        of = table[table["scan"] == scan]
        whole = of[(of["duration"] == 1800.0) & of["method"].isin(["lsq", "lsq-no-cross"])].iloc[0]
        if np.isnan(whole["mean"]):
            word = "taken as 0" if scan.startswith(("4-", "5-")) and stress in ("uv", "vw") else "not determined"
            axis.text(low + 0.03 * (high - low), place - 0.17, word, fontsize=8, color=LEAST_SQUARES, va="center")
        else:
            _bar(axis, whole["mean"], whole["sd"], place - 0.17, "o", LEAST_SQUARES)
        posterior = of[of["method"] == "posterior"]
        if len(posterior):
            _bar(axis, posterior.iloc[0]["mean"], 0.5 * posterior.iloc[0]["width_90"], place + 0.17, "s", POSTERIOR)
    axis.set_ylim(len(scans) + 0.6, -0.6)
    axis.grid(axis="x", linewidth=0.3)
    axis.tick_params(labelsize=9)


def _bar(axis: Axes, mean: float, size: float, place: float, mark: str, colour: str) -> None:
    """Draw a bar; where it does not fit between the ends of the axis, its size is written there."""
    low, high = axis.get_xlim()
    axis.errorbar(mean, place, xerr=size, fmt=mark, color=colour, ms=4, capsize=2, lw=1.3)
    if mean - size < low or mean + size > high:
        end = high - 0.02 * (high - low)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
        axis.text(end, place, f"±{size:.2g}", fontsize=8, color=colour, ha="right", va="center", bbox=box)


def _along_wind(axis: Axes, table: pd.DataFrame, scans: list[str]) -> None:
    """Draw uu by projection and by isotropy, all scans with five planes."""
    uu = table[(table["stress"] == "uu") & (table["duration"] == 1800.0)]
    sonic = uu[uu["method"] == "sonic"].iloc[0]
    for method, colour, mark, shift in (("lsp", LEAST_SQUARES, "o-", -0.1), ("isotropy, table", ISOTROPY, "s--", 0.1)):
        of = uu[uu["method"] == method].set_index("scan").reindex([f"{name}-planes" for name in scans])
        at = np.arange(len(of)) + shift
        axis.errorbar(at, of["mean"], yerr=of["sd"], fmt=mark, color=colour, capsize=2, ms=4, label=METHODS[method])
    axis.axhline(sonic["mean"], color=SONIC, linewidth=1.0, label="sonic, mean")
    axis.set_xticks(range(len(scans)), scans, rotation=30, ha="right", fontsize=10)
    axis.set_ylabel("uu [m² s⁻²]", fontsize=11)
    axis.set_ylim(0.9, 1.95)
    axis.set_title(
        "Fig. 8: uu of 1800 s, five planes, ± one standard deviation", fontsize=11, loc="left", fontweight="bold"
    )
    axis.legend(fontsize=10, ncols=3, loc="upper center", frameon=False)
    axis.grid(axis="y", linewidth=0.3)


def _errors(axis: Axes, table_1: pd.DataFrame) -> None:
    """Draw the relative errors of uu, as printed and in the boxes."""
    scans = list(table_1["scan"].unique())
    for method, colour in (("lsq", "0.2"), ("lsp", LEAST_SQUARES), ("isotropy", ISOTROPY)):
        of = table_1[table_1["method"] == method]
        at = np.array([scans.index(name) for name in of["scan"]])
        name = METHODS["isotropy, table" if method == "isotropy" else method]
        axis.errorbar(
            at - 0.12,
            of["boxes_1800"],
            yerr=of["se_1800"],
            fmt="o",
            color=colour,
            capsize=2,
            ms=4,
            label=f"{name}, here",
        )
        axis.plot(at + 0.12, of["printed"], "x", color=colour, ms=7, mew=1.8, label=f"{name}, printed")
    axis.axhline(0.0, color="0.4", linewidth=0.8)
    axis.set_xticks(range(len(scans)), scans, rotation=30, ha="right", fontsize=10)
    axis.set_ylabel("error of uu [%]", fontsize=11)
    axis.set_ylim(-9.0, 13.0)
    axis.set_title("Table 1: error of the mean uu, ± one standard error", fontsize=11, loc="left", fontweight="bold")
    axis.legend(fontsize=9.5, ncols=3, loc="upper center", frameon=False)
    axis.grid(axis="y", linewidth=0.3)
