"""The check of the prior as a job: records in, a table of widths out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd
import xarray as xr

from bayes_rs.fits.job_noise import noise_of_job
from bayes_rs.fits.prior_check import prior_sensitivity
from bayes_rs.fits.record_yaw import with_yaw_sd
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.file import load_noise
from bayes_rs.posteriors.nuisance import Nuisances


def run_sensitivity(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise_file: str | Path | None = None,
    turbulence: str = "fu-2022",
    noise_method: str = "theory",
    prior: str = "weak",
    factors: Sequence[float] = (0.5, 2.0),
    prob: float = 0.9,
    target: str = "record",
    sampler: str = "auto",
    nuisances: Nuisances | None = None,
    instrument_noise: float | str = 0.0,
    seed: int = 1,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
) -> pd.DataFrame:
    """Read or make the noise as for a fit, and fit the records under narrower and wider versions of the prior.

    Parameters
    ----------
    records : Dataset
        From `make_records`.
    scan : Scan
        The scan that measured them.
    noise_file, turbulence, noise_method
        As for `run_fit`.
    prior, factors, prob, target, sampler, nuisances, instrument_noise, seed
        As for `prior_sensitivity`.
    say : callable
        Takes lines that tell what is being done.

    Returns
    -------
    table : DataFrame
        As from `prior_sensitivity`.

    Raises
    ------
    InputError
        If input does not belong together, a factor is not positive, or no record can be fitted.
    """
    noise = noise_of_job(
        records,
        scan,
        given=None if noise_file is None else load_noise(noise_file),
        turbulence=turbulence,
        method=noise_method,
        sonic=target == "sonic",
        nuisances=nuisances,
        say=say,
    )
    return prior_sensitivity(
        with_yaw_sd(records, scan, noise, nuisances, say),
        scan,
        noise=noise,
        seed=seed,
        prior=prior,
        factors=factors,
        prob=prob,
        target=target,
        sampler=sampler,
        nuisances=nuisances,
        instrument_noise=instrument_noise,
    )


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
        posterior's width to that under the prior itself for each other factor, and what decided it.

    Examples
    --------
    >>> rows = [(0.5, "uu", 2.0, 0.9, 0.9, 0.1, 0.8, "both"), (1.0, "uu", 4.0, 1.0, 1.0, 0.0, 0.9, "both")]
    >>> from bayes_rs.fits.prior_check import COLUMNS
    >>> for line in sensitivity_lines(pd.DataFrame(rows, columns=list(COLUMNS))):
    ...     print(line)
    stress     prior  posterior    x 0.5  decided by
    uu          4.00       1.00     0.90  both
    """
    columns = (table[name].tolist() for name in ("factor", "stress", "width_ratio"))
    ratio = {(factor, stress): value for factor, stress, value in zip(*columns, strict=True)}
    others = [factor for factor in table["factor"].unique().tolist() if factor != 1.0]
    heads = "".join(f"{f'x {factor:g}':>9}" for factor in others)
    lines = [f"{'stress':<8}{'prior':>8}{'posterior':>11}{heads}  decided by"]
    for row in table[table["factor"] == 1.0].to_dict("records"):
        ratios = "".join(f"{ratio[factor, row['stress']]:>9.2f}" for factor in others)
        lines.append(f"{row['stress']:<8}{row['prior_width']:>8.2f}{row['width']:>11.2f}{ratios}  {row['decided_by']}")
    return lines
