"""What a fit found, in lines: what the scan sees, which prior it was, what the data said, what failed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.direction_table import direction_name, direction_words, median_of_known
from bayes_rs.fits.flags import FAILURES, FLAGS, flag_words
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words

_LISTED = 20
"""Failures that are listed one by one."""


def record_name(number: int, time: np.datetime64) -> str:
    """Return what to call a record: its number, and its start where that is known."""
    return f"record {number}" if np.isnat(time) else f"record {number} ({np.datetime_as_string(time, unit='m')})"


def flag_lines(flags: NDArray[np.int64], time: NDArray[np.datetime64]) -> list[str]:
    """Say how many records have each flag, and which is the first of them.

    Parameters
    ----------
    flags : ndarray of int, shape (n_record,)
        Bit masks, as in `FLAGS`.
    time : ndarray, shape (n_record,)
        Starts of the records; NaT where there is no time.

    Returns
    -------
    lines : list of str
        One for each flag that some record has.
    """
    lines = []
    for word, bit in FLAGS.items():
        has = (flags & bit) != 0
        if has.any():
            first = int(np.argmax(has))
            of_all = f"{np.count_nonzero(has)} of {len(flags)} records"
            lines.append(f"flag {word}: {of_all}, first {record_name(first, time[first])}")
    return lines


def failure_lines(flags: NDArray[np.int64], time: NDArray[np.datetime64]) -> list[str]:
    """Return one line for each record that was not fitted or whose chain fell short; of many, the first ones."""
    failed = np.flatnonzero((flags & FAILURES) != 0)
    lines = [
        f"{record_name(index, time[index])}: {flag_words(int(flags[index]))}" for index in failed[:_LISTED].tolist()
    ]
    if len(failed) > _LISTED:
        lines.append(f"and {len(failed) - _LISTED} more records: see the column flag of the summary")
    return lines


def least_seen(table: pd.DataFrame) -> list[str]:
    """Say along which direction of R the scan sees least, and how far the posterior contracted there.

    Parameters
    ----------
    table : DataFrame
        From `direction_medians`.

    Returns
    -------
    lines : list of str
        One line; none if no record was fitted.
    """
    along = table.dropna()
    if along.empty:
        return []
    unseen = int((along["weight"] == 0.0).sum())
    last = along.sort_values(["weight", "contraction_shape"]).iloc[0]
    direction = last[list(STRESSES)].to_numpy(dtype=np.float64)
    which = f"{direction_name(direction)} ({direction_words(direction)})"
    how = {0: "hardly see", 1: "do not see"}.get(unseen, f"do not see (one of {unseen} such directions)")
    prior = 100.0 * min(max(1.0 - last["contraction_shape"], 0.0), 1.0)
    return [f"the beams {how} {which}: {prior:.0f} % of its share of the whole comes from the prior"]


DESCRIBED = ("median", "decided", "least_squares", "low", "high")
"""Columns of the summary that `describe` tells of."""


def describe(
    scan: str,
    sight: str,
    prior: str,
    prior_widths: list[float],
    prob: float,
    interval: str,
    summary: dict[str, FloatArray],
    learnt: FloatArray,
) -> list[str]:
    """Say what the scan sees, which prior it was, and what the data said beyond the prior.

    Parameters
    ----------
    scan, sight, prior : str
        Name of the scan, what it sees, and the prior, in words.
    prior_widths : list of float
        Widths of the prior's intervals of the stresses, m² s⁻².
    prob : float
        Probability of the intervals.
    interval : str
        Which intervals they are.
    summary : dict of str to ndarray, shape (n_record, 6)
        `DESCRIBED` of the stresses; NaN where a record was not fitted.
    learnt : ndarray, shape (n_record,)
        Stresses learnt of each record; NaN where it was not fitted.

    Returns
    -------
    lines : list of str
        Numbers are medians over the records.
    """
    lines = [f"scan {scan}: {sight}", f"prior {prior}"]
    if not np.isfinite(summary["median"]).any():
        return lines
    middle = {name: median_of_known(summary[name]) for name in ("median", "decided", "least_squares")}
    posterior = median_of_known(summary["high"] - summary["low"])
    for whose, widths in (("the prior", prior_widths), ("the posterior (median record)", posterior)):
        lines.append(
            f"width of the {interval_words(prob, interval)}, under {whose}, m² s⁻²: {_of_stresses(widths, '.3g')}"
        )
    lines.append(f"posterior medians (median record), m² s⁻²: {_of_stresses(middle['median'], '.3g')}")
    plain = _of_stresses(middle["least_squares"], ".3g")
    lines.append(f"least squares, no prior (median record; –: the beams do not tell it), m² s⁻²: {plain}")
    lines.append(f"stresses learnt from the data (median record): {np.nanmedian(learnt):.1f} of 6")
    decided = _of_stresses(middle["decided"].round(2) + 0.0, ".2f")
    lines.append(f"decided by the data (1: the data's, 0: the prior's): {decided}")
    return lines


def _of_stresses(values: Iterable[float], form: str) -> str:
    """Write a number for each stress, and a dash for one that is not there."""
    return ", ".join(
        f"{name} {format(value, form) if np.isfinite(value) else '–'}"
        for name, value in zip(STRESSES, values, strict=True)
    )
