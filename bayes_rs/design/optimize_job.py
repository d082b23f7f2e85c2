"""Choosing the beams of a scan as a job: limits in, a scan file, numbers and a picture out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from bayes_rs._validation import FloatArray
from bayes_rs._version import __version__
from bayes_rs.design.optimizing import ScanOptimum, optimize_scan
from bayes_rs.geometry.scan_writing import save_scan
from bayes_rs.output import check_output_folder, output_folder, write_run
from bayes_rs.pictures import COLOURS, POSTERIOR_COLOUR, Picture

_PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # behind numbers that stand on a line
_MOST_MARKED = 30  # beams that get their number in the picture


def run_optimize(
    n_beams: int | Sequence[int],
    output: str | Path,
    *,
    options: Mapping[str, Any],
    n_starts: int = 24,
    seed: int = 1,
    overwrite: bool = False,
) -> tuple[ScanOptimum, list[str]]:
    """Choose the beams of a scan, and write it with the numbers of the search and a picture.

    Parameters
    ----------
    n_beams, n_starts, seed
        As for `optimize_scan`.
    output : str or Path
        Folder to make: ``scan.toml``, ``optimum.json``, ``beams.png`` and ``run.json``.
    options : mapping
        Fields of `ScanLimits` and `CriterionOptions`.
    overwrite : bool
        Replace the folder of an earlier run.

    Returns
    -------
    best : ScanOptimum
        The best scan.
    words : list of str
        Lines to print.

    Raises
    ------
    InputError
        If the folder exists, or an option is not valid.
    """
    check_output_folder(output, overwrite=overwrite)
    best = optimize_scan(n_beams, n_starts=n_starts, seed=seed, **options)
    lines = summary_lines(best)
    with output_folder(output, overwrite=overwrite) as folder:
        save_scan(best.scan, folder / "scan.toml")
        # JSON has no infinity: the criterion of a scan that does not see all stresses is null
        text = json.dumps(_plain(best.to_dict()), indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "optimum.json").write_text(text + "\n", encoding="utf-8", newline="\n")
        plot_optimum(best).savefig(folder / "beams.png", dpi=130)
        write_run(folder, {"bayes_rs": __version__, "command": "optimize", "asked_for": _plain(best.details)})
    return best, lines


def summary_lines(best: ScanOptimum) -> list[str]:
    """Lay out an optimum for reading.

    Parameters
    ----------
    best : ScanOptimum
        From `optimize_scan`.

    Returns
    -------
    lines : list of str
        The beams, the criterion, how the search went, and the well-known scans beside it.

    Examples
    --------
    >>> best = optimize_scan(6, max_angle_deg=45.0, criterion="trace", n_starts=2)
    >>> summary_lines(best)[0]
    'trace: total variance of the nine elements of R by least squares, for equal and independent noise of the beams, over the variance of that noise'
    """  # noqa: E501 - what is printed is one line
    lines = [best.meaning, f"  {best.value:.5g}  the best scan"]
    for name, value in sorted(best.references.items(), key=lambda item: item[1]):
        more = f", {100.0 * (value / best.value - 1.0):+.1f} %" if np.isfinite(value) else ""
        outside = " (outside the limits)" if name in best.outside else ""
        words = f"{value:.5g}" if np.isfinite(value) else "inf"
        lines.append(f"  {words:<7}  {name}{more}{outside}")
    if len(best.by_number) > 1:
        lines.append("beams: " + ", ".join(f"{number} {value:.5g}" for number, value in best.by_number.items()))
    if len(best.by_state) > 1:
        lines.append("in each state: " + ", ".join(f"{name} {value:.5g}" for name, value in best.by_state.items()))
    if best.widths:
        lines.append("90 % widths over uu: " + ", ".join(f"{name} {value:.3g}" for name, value in best.widths.items()))
    lines.append(f"{'beam':<6}{'opening angle':>14}{'theta':>9}{'time':>9}")
    for number, (opening, phase) in enumerate(best.angles_deg.tolist()):
        lines.append(f"{number:<6}{opening:>13.2f}°{phase:>8.2f}°{best.scan.beam_time[number]:>7.3g} s")
    lines.append(
        f"{best.n_agree} of {len(best.starts)} starts reached the best value to 0.1 %; the median start is "
        f"{100.0 * best.spread:.2g} % above it, the worst {100.0 * (best.starts[-1] / best.starts[0] - 1.0):.2g} %"
    )
    lines.append(f"{best.n_evaluations} evaluations in {best.seconds:.1f} s")
    return lines


def plot_optimum(best: ScanOptimum) -> Picture:
    """Draw the beams of an optimum on the plane across the axis, and what the starts have reached.

    Parameters
    ----------
    best : ScanOptimum
        From `optimize_scan`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Left: where the beams cross the plane at the largest focus distance, with rings of equal opening angle and the
        limit; blocked sectors are shaded. Right: the criterion of each start, increasing, and of the well-known scans.
    """
    figure = Picture(figsize=(10.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_beams(left, best)
    _draw_starts(right, best)
    return figure


def _draw_beams(panel: Axes, best: ScanOptimum) -> None:
    angles = np.deg2rad(best.angles_deg)
    limit = float(best.details["largest_angle_deg"])
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    free = _widest_gap(angles[angles[:, 0] > 0.0, 1])
    for ring in np.linspace(limit / 3.0, limit, 3):
        edge: dict[str, Any] = (
            {"color": "0.3", "linewidth": 1.2} if ring == limit else {"color": "0.75", "linewidth": 0.8}
        )
        panel.plot(ring * np.cos(turn), ring * np.sin(turn), **edge)
        place = (ring * np.cos(free), ring * np.sin(free))
        panel.annotate(f"{ring:.3g}°", place, color="0.4", fontsize=8, ha="center", va="center").set_bbox(_PAPER)
    for start, end in best.details["blocked_deg"]:
        sector = np.deg2rad(start + np.mod(end - start, 360.0) * np.linspace(0.0, 1.0, 91))
        edges = limit * np.stack([np.cos(sector), np.sin(sector)])
        panel.fill(np.append(edges[0], 0.0), np.append(edges[1], 0.0), color="0.88", linewidth=0.0)
    across = np.rad2deg(angles[:, 0]) * np.stack([np.cos(angles[:, 1]), np.sin(angles[:, 1])])
    panel.plot(*across, "o", color=POSTERIOR_COLOUR, markersize=8, clip_on=False, zorder=3)
    for number, (side, up) in enumerate(across.T[:_MOST_MARKED].tolist()):
        panel.annotate(str(number), (side, up), xytext=(6, 6), textcoords="offset points", fontsize=9)
    panel.set_aspect("equal")
    names = ("y", "z") if best.details["axis"] == "upwind" else ("x", "y")
    panel.set_xlabel(f"opening angle towards {names[0]} [°]")
    panel.set_ylabel(f"opening angle towards {names[1]} [°]")
    panel.set_title(f"{len(angles)} beams, numbered in the order of the scan", fontsize=10)


def _widest_gap(theta: FloatArray) -> float:
    """Return the middle of the widest gap between directions θ, rad: what stands there lies on no beam."""
    if not len(theta):
        return -0.5 * np.pi
    ordered = np.sort(np.mod(theta, 2.0 * np.pi))
    gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    return float(ordered[widest] + 0.5 * gaps[widest])


def _draw_starts(panel: Axes, best: ScanOptimum) -> None:
    panel.plot(
        np.arange(1, len(best.starts) + 1), best.starts, "o-", color=POSTERIOR_COLOUR, label="starts of the search"
    )
    ceiling = 1.5 * max(best.starts[-1], best.value)
    for index, (name, value) in enumerate(best.references.items()):
        if value <= ceiling:
            style = (":", "--", "-.", (0, (1, 3)))[index % 4]
            panel.axhline(
                value, color=COLOURS[1 + index % (len(COLOURS) - 1)], linestyle=style, linewidth=1.2, label=name
            )
    panel.axhline(best.value, color="0.2", linewidth=1.0, label="the best scan")
    panel.set_xlabel("start, from best to worst [1]")
    panel.set_title("What the starts reached, beside well-known scans", fontsize=10)
    panel.grid(alpha=0.3)
    panel.set_ylabel(f"criterion {best.criterion!r} (less is better) [1]")
    low, high = panel.get_ylim()
    if high - low < 1e-3 * abs(best.value):  # starts that agree to rounding must not look like a slope
        panel.set_ylim(best.value - 5e-3 * abs(best.value), best.value + 5e-3 * abs(best.value))
    panel.ticklabel_format(axis="y", useOffset=False)
    panel.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)


def _plain(value: Any) -> Any:
    """Return plain values for JSON, None for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
