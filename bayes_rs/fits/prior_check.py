"""How much the answer depends on the width of the prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray, as_items, check_positive
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fit_options import split_options
from bayes_rs.fits.fitting import fit
from bayes_rs.fits.noise_choice import noise_and_records, with_median_length_scale
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_of
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.registry import Prior
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records

COLUMNS = ("factor", "stress", "prior_width", "width", "width_ratio", "shift", "decided", "decided_by")
_NO_CAMPAIGN = {"campaign": "off", "campaign_group": None, "campaign_unsteady": False}
_DECIDED = 0.25
"""A stress whose interval follows the prior's width by less than this power is decided by the data."""


def prior_sensitivity(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    seed: int,
    noise: Noise | str | Path | None = None,
    factors: Sequence[float] = (0.5, 2.0),
    progress: bool | None = None,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    **options: Any,
) -> pd.DataFrame:
    """Fit the records again under narrower and wider versions of the prior, and tell what changes.

    Parameters
    ----------
    records, scan, seed, noise
        As in `fit`.
    factors : sequence of float
        All widths of the prior are multiplied by these; 1 is always there.
    progress, say
        As in `fit`.
    **options
        As in `fit`: ``prior`` is the prior whose width is varied, ``prob`` the probability of the intervals,
        ``interval`` their kind.

    Returns
    -------
    table : DataFrame
        One row for each factor and stress, medians over the records: ``prior_width`` and ``width``, widths of the
        prior's and the posterior's interval (m² s⁻²); ``width_ratio`` to that under the prior itself;
        ``shift`` of the posterior median, in standard deviations of the posterior under the prior itself;
        ``decided`` as in `Fit.summary`; ``decided_by``, in words.

    Raises
    ------
    InputError
        If a factor is not positive, the prior cannot be widened, or no record can be fitted.

    Notes
    -----
    A stress is ``"the data"`` where the posterior's width grows by less than the power ¼ of the factor between the
    factors next to 1, ``"the prior"`` where by more than the power ¾, else ``"both"``. Farther from 1 the widths need
    not grow with the prior's: a very wide prior on the ratios lets ww go to zero.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("50-beam", "fu-2022", wind_speed=10.0, n_records=4, seed=1)
    >>> table = prior_sensitivity(brs.make_records(series, "50-beam"), "50-beam", seed=1)
    >>> table.query("stress == 'uu' and factor == 1")["width_ratio"].item()
    1.0
    """
    own, choice = split_options({**options, "seed": seed, "draws": "float64", **_NO_CAMPAIGN})
    factors = as_items(factors, what="factors")
    for factor in factors:
        check_positive(factor, what="factor", unit="", where="the check of the prior")
    every = sorted({1.0, *(float(factor) for factor in factors)})
    check_are_records(records)
    records = believed(records)
    used, given = as_scan(scan), given_noise(noise)
    own = with_median_length_scale(own, choice, records, given)
    made, records = noise_and_records(records, used, given, own, choice, say)
    asked = {name: getattr(own, name) for name in own.__dataclass_fields__}
    found = {}
    for factor in every:
        version = own.made_prior if factor == 1.0 else own.made_prior.widened(factor)
        result = fit(records, used, noise=made, progress=progress, **{**asked, "prior": version})
        found[factor] = _Spread(result, version, own.prob, own.interval)
    plain = found[1.0]
    if plain.width.size == 0:
        raise InputError("No record could be fitted, so there is nothing to compare: see the records' flags.")
    # the factors next to 1: far from it the widths need not grow with the prior's
    below = max((factor for factor in every if factor < 1.0), default=1.0)
    above = min((factor for factor in every if factor > 1.0), default=1.0)
    growth = np.log(np.median(found[above].width / found[below].width, axis=0))
    power = growth / np.log(above / below) if above > below else np.full(len(STRESSES), np.nan)
    words = np.where(power < _DECIDED, "the data", np.where(power > 1.0 - _DECIDED, "the prior", "both"))
    rows = []
    for factor, spread in found.items():
        ratio = np.median(spread.width / plain.width, axis=0)
        shift = np.median((spread.median - plain.median) / plain.sd, axis=0)
        for index, name in enumerate(STRESSES):
            rows.append(
                (
                    factor,
                    name,
                    spread.prior_width[index],
                    float(np.median(spread.width[:, index])),
                    float(ratio[index]),
                    float(shift[index]),
                    float(np.median(spread.decided[:, index])),
                    str(words[index]) if len(every) > 1 else "",
                )
            )
    return pd.DataFrame(rows, columns=list(COLUMNS))


class _Spread:
    """Centre and widths of the fitted records of one result, each of shape (n_record, 6)."""

    def __init__(self, result: Fit, version: Prior, prob: float, interval: str) -> None:
        stress = result.draws()[result.fitted]
        flat = stress.reshape(len(stress), stress.shape[1] * stress.shape[2], len(STRESSES))
        self.median: FloatArray = np.median(flat, axis=1) if len(flat) else np.empty((0, len(STRESSES)))
        low, high = interval_of(np.moveaxis(flat, 1, -1), prob, interval) if len(flat) else (self.median, self.median)
        self.width: FloatArray = high - low
        self.sd: FloatArray = flat.std(axis=1)
        self.prior_width: FloatArray = version.interval_widths(prob, interval)
        table = result.summary()
        decided = table[table["stress"].isin(STRESSES)]["decided"].to_numpy(dtype=np.float64)
        self.decided: FloatArray = decided.reshape(-1, len(STRESSES))[result.fitted]


def sensitivity_lines(table: pd.DataFrame) -> list[str]:
    """Lay out the table of `prior_sensitivity` for reading, one line a stress.

    Parameters
    ----------
    table : DataFrame
        From `prior_sensitivity`.

    Returns
    -------
    lines : list of str
        A heading; then for each stress the widths of the prior's and the posterior's interval, m² s⁻², the ratio of the
        posterior's width to that under the prior itself for each other factor, the share that the data decided, and
        what decided it.

    Examples
    --------
    >>> rows = [(0.5, "uu", 2.0, 0.9, 0.9, 0.1, 0.8, "both"), (1.0, "uu", 4.0, 1.0, 1.0, 0.0, 0.9, "both")]
    >>> for line in sensitivity_lines(pd.DataFrame(rows, columns=list(COLUMNS))):
    ...     print(line)
    stress     prior  posterior    x 0.5  decided  by
    uu          4.00       1.00     0.90     0.90  both
    """
    columns = (table[name].tolist() for name in ("factor", "stress", "width_ratio"))
    ratio = {(factor, stress): value for factor, stress, value in zip(*columns, strict=True)}
    others = [factor for factor in table["factor"].unique().tolist() if factor != 1.0]
    heads = "".join(f"{f'x {factor:g}':>9}" for factor in others)
    lines = [f"{'stress':<8}{'prior':>8}{'posterior':>11}{heads}{'decided':>9}  by"]
    for row in table[table["factor"] == 1.0].to_dict("records"):
        ratios = "".join(f"{ratio[factor, row['stress']]:>9.2f}" for factor in others)
        start = f"{row['stress']:<8}{row['prior_width']:>8.2f}{row['width']:>11.2f}{ratios}"
        lines.append(f"{start}{row['decided']:>9.2f}  {row['decided_by']}")
    return lines
