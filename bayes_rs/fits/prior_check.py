"""How much the answer depends on the width of the prior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs.errors import InputError
from bayes_rs.fits.fitting import fit
from bayes_rs.fits.result import group
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.registry import Prior, make_prior

COLUMNS = ("factor", "stress", "prior_width", "width", "width_ratio", "shift", "contraction", "decided_by")
_DECIDED = 0.25
"""A stress whose interval follows the prior's width by less than this power is decided by the data."""


def prior_sensitivity(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise: Noise,
    seed: int,
    prior: str | Prior = "weak",
    factors: Sequence[float] = (0.5, 2.0),
    prob: float = 0.9,
    target: str = "record",
    sampler: str = "auto",
    nuisances: Nuisances | None = None,
    instrument_noise: float | str = 0.0,
    show_progress: bool | None = None,
) -> pd.DataFrame:
    """Fit the records again under narrower and wider versions of the prior, and tell what changes.

    Parameters
    ----------
    records, scan, noise, seed, prior
        As in `fit`.
    factors : sequence of float
        All widths of the prior are multiplied by these; 1 is always there.
    prob : float
        Probability of the central intervals.
    target, sampler, nuisances, instrument_noise, show_progress
        As in `fit`; by default direct draws, and emcee where those do not do.

    Returns
    -------
    table : DataFrame
        One row for each factor and stress, medians over the records: ``prior_width`` and ``width``, widths of the
        prior's and the posterior's central interval (m² s⁻²); ``width_ratio`` to that under the prior itself;
        ``shift`` of the posterior median, in standard deviations of the posterior under the prior itself;
        ``contraction`` as in `summary`; ``decided_by``, in words.

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
    >>> scan, flow = brs.load_scan("50-beam"), brs.load_turbulence("fu-2022")
    >>> noise = brs.noise.calibrate(scan, flow, wind_speed=10.0, cache=False)
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=4, seed=1), scan)
    >>> table = brs.prior_sensitivity(records, scan, noise=noise, seed=1)
    >>> table.query("stress == 'uu' and factor == 1")["width_ratio"].item()
    1.0
    """
    chosen = make_prior(prior)
    for factor in factors:
        check_positive(factor, what="factor", unit="", where="the check of the prior")
    if not 0.0 < prob < 1.0:
        raise InputError(f"Invalid prob {prob!r}: it must be between 0 and 1.")
    every = sorted({1.0, *(float(factor) for factor in factors)})
    found = {}
    for factor in every:
        version = chosen if factor == 1.0 else chosen.widened(factor)
        result = fit(
            records,
            scan,
            noise=noise,
            seed=seed,
            prior=version,
            target=target,
            sampler=sampler,
            nuisances=nuisances,
            instrument_noise=instrument_noise,
            show_progress=show_progress,
        )
        found[factor] = _Spread(result, version, prob)
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
                    float(np.median(spread.contraction[:, index])),
                    str(words[index]) if len(every) > 1 else "",
                )
            )
    return pd.DataFrame(rows, columns=list(COLUMNS))


class _Spread:
    """Centre and widths of the fitted records of one result, each of shape (n_record, 6)."""

    def __init__(self, result: xr.DataTree, version: Prior, prob: float) -> None:
        stress = group(result, "posterior")["stress"].transpose("record", "chain", "draw", "component").values
        flat = stress.reshape(len(stress), -1, len(STRESSES))
        flat = flat[np.isfinite(flat).all(axis=(1, 2))]
        levels = [0.5 - 0.5 * prob, 0.5, 0.5 + 0.5 * prob]
        ends = np.quantile(flat, levels, axis=1) if len(flat) else np.empty((3, 0, len(STRESSES)))
        self.median: FloatArray = ends[1]
        self.width: FloatArray = ends[2] - ends[0]
        self.sd: FloatArray = flat.std(axis=1)
        prior = group(result, "prior")["stress"].values.reshape(-1, len(STRESSES))
        self.prior_width: FloatArray = version.interval_widths(prob)
        self.contraction: FloatArray = 1.0 - self.sd**2 / prior.var(axis=0)
