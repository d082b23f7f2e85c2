"""From draws of the hyperparameters to the prior that a campaign has learnt, and to its table of hyperparameters."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray
from bayes_rs.campaign.cells import Cells, size_correlation
from bayes_rs.campaign.hyperprior import Hyper, draw_hyper, group_root
from bayes_rs.intervals import interval_of
from bayes_rs.posteriors import diagnostics
from bayes_rs.priors.campaign import CampaignPrior, LearntGroup
from bayes_rs.priors.interface import N_COORDINATE, LogRatioPrior

NAMES = ("ln(uu)", "ln(vv/uu)", "ln(ww/uu)", "artanh(rho_uv)", "artanh(rho_uw)", "artanh(rho_vw.u)")
"""What the coordinates are of, in the names of hyperparameters."""
_GRID = np.array([0.25, *np.arange(0.5, 10.0, 0.5), *np.arange(10.0, 30.0), *np.arange(30.0, 62.0, 4.0)])
"""Wind speeds of the table of the size, m/s."""
_N_PRIOR = 4000
_PROB = 0.9


def learnt_prior(base: LogRatioPrior, hyper: Hyper, cells: Cells) -> CampaignPrior:
    """Return the prior that draws of the hyperparameters make: the mean and covariance of their mixture.

    Parameters
    ----------
    base : LogRatioPrior
        The prior whose coordinates these are.
    hyper : Hyper
        Draws of the hyperparameters.
    cells : Cells
        The cells of the campaign's records.

    Returns
    -------
    prior : CampaignPrior
        With the mean E[μ] and the covariance E[Σ] + Cov[μ] of a record to come, by wind speed and group. Between the
        bins and beyond them the size has the mean and variance that its Gaussian process has, given the bins.
    """
    root = hyper.root
    own = root[:, 0, -1]
    levels = hyper.group_levels(cells)  # (n, n_group, 6)
    between = np.linalg.solve(size_correlation(cells.speed, cells.speed), size_correlation(cells.speed, _GRID))
    size = hyper.size_levels(cells) @ between  # (n, n_speed)
    left = np.maximum(1.0 - np.sum(between * size_correlation(cells.speed, _GRID), axis=0), 0.0)
    of_speed = np.sqrt(hyper.speed_share) * own
    free = (hyper.speed_share * own**2)[:, None] * left  # what the bins do not tell of the size
    shrink = np.ones((len(hyper), N_COORDINATE))
    shrink[:, -1] = np.sqrt(1.0 - hyper.speed_share)
    groups = {}
    entries: list[tuple[str, FloatArray, FloatArray, FloatArray]] = []
    weight = cells.both_count / cells.both_count.sum()
    for place, name in enumerate(cells.names):
        entries.append((name, levels[:, place], np.zeros(len(hyper)), cells.both_count[place]))
    if cells.n_group > 1 or cells.names != ("",):
        share = group_root(hyper.group_share, cells.n_group)
        correlation = share @ share.swapaxes(-1, -2)
        pull = (1.0 - hyper.group_share) * np.linalg.solve(correlation, np.ones((len(hyper), cells.n_group, 1)))[
            :, 0, 0
        ]
        new = pull[:, None] * levels.sum(axis=1)
        entries = [one for one in entries if one[0]]
        entries.insert(0, ("", new, 1.0 - pull * cells.n_group * (1.0 - hyper.group_share), weight.sum(axis=0)))
    for name, level, unsure, count in entries:
        mean = ((shrink * level)[:, None, :] @ root.swapaxes(-1, -2))[:, 0]  # (n, 6), the size without wind speed
        scatter = hyper.scatter + unsure[:, None, None] * ((root * shrink[:, None, :] ** 2) @ root.swapaxes(-1, -2))
        at_speed = mean[:, :1] + of_speed[:, None] * size
        size_mean = at_speed.mean(axis=0)
        row = scatter[:, :1].mean(axis=0) + _covariance(at_speed, mean)
        row[:, 0] = scatter[:, 0, 0].mean() + at_speed.var(axis=0) + free.mean(axis=0)
        # without a wind speed: that of the group's own records
        share_of_bin = count / count.sum()
        at_bin = mean[:, :1] + of_speed[:, None] * hyper.size_levels(cells)
        overall = mean.copy()
        overall[:, 0] = at_bin @ share_of_bin
        centre = overall.mean(axis=0)
        covariance = scatter.mean(axis=0) + (overall - centre).T @ (overall - centre) / len(hyper)
        covariance[0, 0] += np.mean((at_bin - overall[:, :1]) ** 2 @ share_of_bin)
        n_record = round(float(cells.both_count[cells.names.index(name)].sum())) if name in cells.names else 0
        groups[name] = LearntGroup(centre, 0.5 * (covariance + covariance.T), size_mean, row, n_record)
    return CampaignPrior(base, _GRID.copy(), groups, cells.n_record)


def _covariance(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return covariances (n_one, n_other) over the draws, which come first."""
    return np.asarray((one - one.mean(axis=0)).T @ (other - other.mean(axis=0)) / len(one))


def hyper_values(base: LogRatioPrior, hyper: Hyper, cells: Cells) -> dict[str, FloatArray]:
    """Return hyperparameters by name, each of shape (n,): means over the records, scatter, correlations, shares.

    The mean of a coordinate is that over the campaign's records, and its standard deviation that about the means of the
    cells, in the units that the name says.
    """
    mean = np.average(hyper.means(cells), axis=1, weights=cells.count)
    sd = np.sqrt(np.einsum("nii->ni", hyper.scatter))
    found = {f"mean {name}": base.centre[i] + base.spread[i] * mean[:, i] for i, name in enumerate(NAMES)}
    found |= {f"sd {name}": base.spread[i] * sd[:, i] for i, name in enumerate(NAMES)}
    found |= {
        f"corr {NAMES[i]}, {NAMES[j]}": hyper.scatter[:, i, j] / (sd[:, i] * sd[:, j])
        for i in range(N_COORDINATE)
        for j in range(i + 1, N_COORDINATE)
    }
    if cells.n_bin > 1:
        found["share of wind speed"] = hyper.speed_share
    if cells.n_group > 1:
        found["share of groups"] = hyper.group_share
    return found


def hyper_table(
    base: LogRatioPrior, draws: dict[str, FloatArray], cells: Cells, rng: np.random.Generator, interval: str
) -> pd.DataFrame:
    """Return the table of hyperparameters of `CampaignPosterior`, from draws (n_chain, n_draw) by name."""
    prior = hyper_values(base, draw_hyper(_N_PRIOR, cells, rng), cells)
    rows = []
    for name, values in draws.items():
        before = prior[name]
        diagnosis = diagnostics.diagnose(values, len(values))
        low, high = interval_of(values.ravel(), _PROB, interval)
        prior_low, prior_high = interval_of(before, _PROB, interval)
        rows.append(
            {
                "name": name,
                "mean": float(values.mean()),
                "low": float(low),
                "high": float(high),
                "prior_mean": float(before.mean()),
                "prior_low": float(prior_low),
                "prior_high": float(prior_high),
                "interval": interval,
                "decided": decided(values, before),
                "ess": float(diagnosis.ess_bulk),
                "r_hat": float(diagnosis.r_hat),
            }
        )
    return pd.DataFrame(rows)


def decided(posterior: FloatArray, prior: FloatArray) -> float:
    """Return the share that the data decided: 1 − variance of the posterior over that of the prior, 0 at least."""
    return float(np.clip(1.0 - np.var(posterior) / np.var(prior), 0.0, 1.0))
