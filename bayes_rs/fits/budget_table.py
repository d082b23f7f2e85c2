"""The table of an uncertainty budget, from moments of posteriors with sources switched off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.budget_moments import ENOUGH, Moments
from bayes_rs.fits.budget_sources import COMBINED, KINDS, PRIOR, REST, SAMPLING
from bayes_rs.fits.derived import INTENSITIES
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE

COLUMNS = (
    "stress", "source", "type", "variance", "u", "relative", "share", "share_mcse", "mean", "low", "high", "expanded",
    "prob", "interval", "decided",
)  # fmt: skip
"""Columns of a budget; before them ``record`` where each record has its own."""
_BETWEEN = {3: (0, 1), 4: (0, 2), 5: (1, 2)}
"""The variances that uv, uw and vw stand between."""


def variances(found: Moments, sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return posterior variances (n_case, n_record, n_quantity) by some of the sets of draws together."""
    weight = found.weight[..., sets] / found.weight[..., sets].sum(axis=-1, keepdims=True)
    mean = np.einsum("crs,crqs->crq", weight, found.mean[..., sets])
    apart = found.variance[..., sets] + (found.mean[..., sets] - mean[..., np.newaxis]) ** 2
    return np.asarray(np.einsum("crs,crqs->crq", weight, apart))


def first_order(moved: FloatArray, sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return sums of squares (n_record, n_quantity) of covariances: mean products of sets have no bias."""
    some = moved[..., sets]
    n = some.shape[-1]
    products = some.sum(axis=-1) ** 2 - (some**2).sum(axis=-1)
    return np.asarray(np.maximum(products.sum(axis=-1) / (n * (n - 1.0)), 0.0))


def parts_of(found: Moments, place: NDArray[np.int64], sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return the variances of sampling, each source, prior, rest and all, (n_row, n_quantity), means over records."""
    variance = variances(found, sets)[:, place]
    data, prior = (first_order(part[place], sets) for part in (found.by_data, found.by_prior))
    of_data = data / np.where(data + prior > 0.0, data + prior, 1.0)
    whole, least = variance[0], variance[-1]
    of_sources = whole - variance[1:-1]
    rest = whole - least - of_sources.sum(axis=0)
    rows = [of_data * least, *of_sources, (1.0 - of_data) * least, rest, whole]
    return np.stack([row.mean(axis=0) for row in rows])


def budget_table(
    found: Moments, place: NDArray[np.int64], sources: Sequence[str], names: Sequence[str], options: FitOptions
) -> pd.DataFrame:
    """Return the budget of some records together."""
    variance = parts_of(found, place, slice(None))
    share = variance / variance[-1]
    sets = np.arange(N_ENSEMBLE)
    left = np.stack([parts_of(found, place, np.delete(sets, one)) for one in sets])
    left = left / left[:, -1:]
    error = np.sqrt((N_ENSEMBLE - 1.0) * np.mean((left - left.mean(axis=0)) ** 2, axis=0))
    weight = found.weight[0] / found.weight[0].sum(axis=-1, keepdims=True)
    mean = np.einsum("rs,rqs->rq", weight, found.mean[0])[place].mean(axis=0)
    low, high = found.low[place].mean(axis=0), found.high[place].mean(axis=0)
    of_stress = found.decided[place].mean(axis=0)
    decided = [*of_stress, *(of_stress[INTENSITIES[name]] if name in INTENSITIES else np.nan for name in names[6:])]
    scale = np.abs(mean)
    for index, (one, other) in _BETWEEN.items():
        scale[index] = np.sqrt(mean[one] * mean[other])
    u = np.sign(variance) * np.sqrt(np.abs(variance))
    rows = []
    for column, name in enumerate(names):
        for row, source in enumerate((SAMPLING, *sources, PRIOR, REST, COMBINED)):
            last = source == COMBINED
            ends = (mean, low, high, 0.5 * (high - low))
            rows.append(
                (
                    name,
                    source,
                    KINDS.get(source, "B"),
                    float(variance[row, column]),
                    float(u[row, column]),
                    float(u[row, column] / scale[column]),
                    float(share[row, column]),
                    float(error[row, column]),
                    *(float(values[column]) if last else np.nan for values in ends),
                    options.prob if last else np.nan,
                    options.interval if last else "",
                    float(decided[column]) if last else np.nan,
                )
            )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def budget_lines(table: pd.DataFrame) -> list[str]:
    """Lay out a budget for reading: a line for each source with its share of each stress's variance.

    Parameters
    ----------
    table : DataFrame
        From `budget`, of all records together.

    Returns
    -------
    lines : list of str
        A heading; shares in per cent by source; the combined standard uncertainty, in the stress's own unit; half of
        the interval's width; the share that the data decided; and which sources do not count.

    Examples
    --------
    >>> row = {"stress": "uu", "type": "", "variance": 0.04, "u": 0.2, "share": 1.0, "expanded": 0.33, "prob": 0.9}
    >>> rows = [{**row, "source": "sampling", "type": "A", "share": 0.7}, {**row, "source": "prior", "share": 0.3}]
    >>> for line in budget_lines(pd.DataFrame([*rows, {**row, "source": "combined", "decided": 0.8}])):
    ...     print(line)
    share of the variance     type       uu
    sampling                  A        70 %
    prior                              30 %
    combined, standard                0.200
    half of the 90 % interval         0.330
    decided by the data                80 %
    """
    names = list(dict.fromkeys(table["stress"]))
    rows = {(row["source"], row["stress"]): row for row in table.to_dict("records")}

    def line(first: str, kind: str, words: Sequence[str]) -> str:
        return f"{first:<26}{kind:<4}" + "".join(f"{word:>9}" for word in words)

    lines = [line("share of the variance", "type", [name[:8] for name in names])]
    for source in dict.fromkeys(table["source"]):
        if source != COMBINED:
            found = [rows[source, name] for name in names]
            lines.append(line(source, found[0]["type"], [_percent(row["share"]) for row in found]))
    last = [rows[COMBINED, name] for name in names]
    half = f"half of the {100.0 * last[0]['prob']:g} % interval"
    lines.append(line("combined, standard", "", [f"{row['u']:#.3g}" for row in last]))
    lines.append(line(half, "", [f"{row['expanded']:#.3g}" for row in last]))
    lines.append(line("decided by the data", "", [_percent(row["decided"]) for row in last]))
    return [*lines, *budget_notes(table)]


def budget_notes(table: pd.DataFrame) -> list[str]:
    """Say which sources do not count in a budget, and whether its draws are few."""
    notes = []
    if left_out := table.attrs.get("left_out"):
        notes.append(f"taken for known: {', '.join(left_out)}")
    if (least := table.attrs.get("least_effective", ENOUGH)) < ENOUGH:
        notes.append(f"few draws: {least:.0f} effective ones in the worst of the records, so its numbers are poor")
    return notes


def _percent(share: float) -> str:
    return f"{100.0 * share:z.0f} %".replace("-", "\N{MINUS SIGN}") if np.isfinite(share) else "–"
