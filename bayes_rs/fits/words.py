"""What a job says at its end: what the scan sees, which prior it was, and what the data said beyond the prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs.fits.direction_table import direction_words
from bayes_rs.fits.result import FLAGS
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.priors.registry import Prior

FAILURES = (
    FLAGS["no_usable_beam"]
    | FLAGS["no_wind"]
    | FLAGS["short_chain"]
    | FLAGS["ensembles_differ"]
    | FLAGS["weights_uneven"]
    | FLAGS["likelihood_failed"]
)
"""Flags that count as a failure of a record; the others are remarks."""


def flag_lines(flags: NDArray[np.int64], name: Callable[[int], str]) -> list[str]:
    """Say how many records have each flag, and which is the first of them.

    Parameters
    ----------
    flags : ndarray of int, shape (n_record,)
        Bit masks, as in `FLAGS`.
    name : callable
        What to call a record, by its place in `flags`.

    Returns
    -------
    lines : list of str
        One for each flag that some record has.
    """
    return [
        f"flag {word}: {np.count_nonzero(has)} of {len(flags)} records, first {name(int(np.argmax(has)))}"
        for word, has in ((word, (flags & bit) != 0) for word, bit in FLAGS.items())
        if has.any()
    ]


def least_seen(table: pd.DataFrame) -> list[str]:
    """Say along which direction of R the scan sees least, and how far the posterior contracted there.

    Parameters
    ----------
    table : DataFrame
        From `directions`.

    Returns
    -------
    lines : list of str
        One line; none if no record was fitted.
    """
    columns = ["weight", "contraction", "contraction_shape", *STRESSES]
    along = table.groupby("direction")[columns].median().dropna()
    if along.empty:
        return []
    unseen = int((along["weight"] == 0.0).sum())
    last = along.sort_values(["weight", "contraction_shape"]).iloc[0]
    which = direction_words(last[list(STRESSES)].to_numpy(dtype=np.float64))
    how = {0: "", 1: " (not at all)"}.get(unseen, f" (one of {unseen} that it does not see)")
    numbers = f"{last['contraction']:.2f}, of the shape {last['contraction_shape']:.2f}"
    return [f"contraction along what the scan sees least, {which}{how}: {numbers}"]


def describe(scan: str, sight: str, prior: Prior, table: pd.DataFrame) -> list[str]:
    """Say what the scan sees, which prior it was, and how much narrower the posterior is than the prior."""
    lines = [f"scan {scan}: {sight}", f"prior {prior.in_words()}"]
    rows = table[table["stress"].isin(STRESSES) & table["mean"].notna()]
    if len(rows):
        prob = float(rows["prob"].iloc[0])
        posterior = (rows["hdi_high"] - rows["hdi_low"]).groupby(rows["stress"]).median().loc[list(STRESSES)]
        for whose, widths in (("the prior", prior.interval_widths(prob)), ("the posterior (median record)", posterior)):
            numbers = ", ".join(f"{name} {width:.3g}" for name, width in zip(STRESSES, widths, strict=True))
            lines.append(f"width of the {100.0 * prob:g} % interval under {whose}, m² s⁻²: {numbers}")
        middle = rows.groupby("stress")[["contraction", "contraction_shape"]].median().loc[list(STRESSES)]
        for column, meaning in (
            ("contraction", "of the stresses"),
            ("contraction_shape", "of their shape, size taken out"),
        ):
            numbers = ", ".join(f"{name} {value:.2f}" for name, value in middle[column].items())
            lines.append(f"contraction against the prior (1: the data decided, 0: the prior did) {meaning}: {numbers}")
    return lines
