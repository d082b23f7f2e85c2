"""Measure how well calibrated the posteriors of each likelihood are: coverage, bias, width, score and cost.

python benchmarks/likelihoods.py [--records 1000] [--priors weak flat] [--output benchmarks]

Truths are drawn from the prior. The noise is that of simulated records of turbulence (on lines, and in boxes: the
records of tests/data): the variance of each beam over its expectation, times the beam's expected variance for the drawn
truth. So no likelihood is favoured, and the intervals of one that describes the noise hold the truth as often as they
say. Posteriors are sampled by importance sampling, the same way for all likelihoods. About five minutes with one core.
"""

import argparse
import json
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from other_likelihoods import OTHER_LIKELIHOODS

import bayes_rs as brs
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, Likelihood
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, StudentProposal, laplace_proposal
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.priors.registry import Prior, make_prior

SCENES = {
    "4-beam": ("4-beam", {}),
    "6-beam": ("6-beam", {}),
    "6-beam-45": ("6-beam", {"opening_angle_deg": 45.0, "focus_distance": 52.0}),
    "50-beam": ("50-beam", {}),
}
LEVELS = (0.5, 0.8, 0.9, 0.95)
WIND_SPEED, DURATION = 10.0, 600.0
SEED = 2026
N_DRAW = 2000
CHUNK = 200
SIMULATED_TOGETHER = 400
ENOUGH = 0.25
"""A record whose effective share of draws is below this gets its proposal fitted again, up to three times."""
REFERENCE = "log-normal"
MAKERS = {**LIKELIHOODS, **OTHER_LIKELIHOODS}
box_records = Path(__file__).resolve().parents[1] / "tests" / "data" / "box_records.parquet"


class Intervals(NamedTuple):
    """What is kept of posteriors; arrays (n_record, 6), the last (n_record,)."""

    rank: np.ndarray
    median: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sd: np.ndarray
    pareto: np.ndarray


def relative_variances(name: str, scan: brs.Scan, source: str, n_record: int) -> np.ndarray:
    """Return variances of simulated records over their expectations, shape (n_record, n_beam)."""
    if source == "boxes":
        table = pd.read_parquet(box_records)
        return table[[f"{name}/{beam}" for beam in scan.beam]].to_numpy(dtype=np.float64)
    turbulence = brs.load_turbulence("fu-2022")
    parts = []
    for part, start in enumerate(range(0, n_record, SIMULATED_TOGETHER)):
        series = brs.simulate(
            scan,
            turbulence,
            wind_speed=WIND_SPEED,
            duration=DURATION,
            n_records=min(SIMULATED_TOGETHER, n_record - start),
            seed=np.random.default_rng([SEED, part]),
        )
        truth = json.loads(series.attrs["truth"])["stresses_record"]
        parts.append(brs.make_records(series, scan)["variance"].values / brs.geometry.radial_variance(scan, truth))
    return np.concatenate(parts)


def sample(posterior: Posterior, proposal: StudentProposal, truth: np.ndarray, rng: np.random.Generator) -> Intervals:
    """Sample the posteriors of some records by importance sampling, with a proposal that learns from its own draws."""
    coordinate, log_weight = draw(posterior, proposal, rng)
    for _ in range(3):
        share = 1.0 / np.sum(normalized(log_weight) ** 2, axis=1) / N_DRAW
        poor = np.flatnonzero(share < ENOUGH)
        if len(poor) == 0:
            break
        # where a few draws hold all the weight, half the log-weight: the next proposal is then too wide, not too narrow
        weight = normalized(np.where(share < 0.02, 0.5, 1.0)[:, None] * log_weight)
        mean = np.einsum("rd,rdk->rk", weight[poor], coordinate[poor])
        off = coordinate[poor] - mean[:, None, :]
        covariance = (weight[poor, :, None] * off).swapaxes(-1, -2) @ off
        proposal = proposal.refitted(poor, mean, 1.1 * covariance)
        coordinate[poor], log_weight[poor] = draw(posterior.take(poor), proposal.take(poor), rng)
    weight = normalized(log_weight)
    with np.errstate(all="ignore"):
        stress = posterior.stress(coordinate)
    stress = np.where(np.isfinite(log_weight)[:, :, None], stress, 0.0)
    rank = np.sum(weight[:, :, None] * (stress < truth[:, None, :]), axis=1)
    mean = np.einsum("rd,rdk->rk", weight, stress)
    sd = np.sqrt(np.einsum("rd,rdk->rk", weight, (stress - mean[:, None, :]) ** 2))
    low, median, high = quantiles(stress, weight, (0.05, 0.5, 0.95))
    return Intervals(rank, median, low, high, sd, pareto_k(log_weight))


def draw(posterior: Posterior, proposal: StudentProposal, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return draws (n_record, N_DRAW, 6) of the proposal and their log-weights."""
    shape = (posterior.n_record, N_DRAW)
    normal = rng.standard_normal((*shape, 6))
    coordinate = proposal.transform(normal, rng.chisquare(DEGREES_OF_FREEDOM, shape))
    with np.errstate(all="ignore"):  # far out, where numbers overflow, the weight is zero
        log_weight = posterior.log_density(coordinate) - proposal.log_density(coordinate)
    return coordinate, np.where(np.isfinite(log_weight), log_weight, -np.inf)


def normalized(log_weight: np.ndarray) -> np.ndarray:
    """Return weights that sum to 1."""
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


def quantiles(stress: np.ndarray, weight: np.ndarray, levels: tuple[float, ...]) -> list[np.ndarray]:
    """Return weighted quantiles, each (n_record, 6): the first draw whose cumulated weight reaches the level."""
    order = np.argsort(stress, axis=1)
    sorted_stress = np.take_along_axis(stress, order, axis=1)
    cumulated = np.cumsum(weight[np.arange(len(weight))[:, None, None], order], axis=1)
    last = stress.shape[1] - 1
    return [
        np.take_along_axis(sorted_stress, np.minimum((cumulated < level).sum(axis=1), last)[:, None], axis=1)[:, 0]
        for level in levels
    ]


def posteriors(
    likelihood: str, prior: Prior, scan: brs.Scan, covariance: np.ndarray, variance: np.ndarray, truth: np.ndarray
) -> Intervals:
    """Sample the posteriors of all records."""
    rng = np.random.default_rng([SEED, 2])
    parts = []
    for start in range(0, len(variance), CHUNK):
        part = slice(start, start + CHUNK)
        made = prepared(likelihood, scan, covariance, variance[part])
        start_at = laplace_proposal(Posterior(prepared(REFERENCE, scan, covariance, variance[part]), prior))
        parts.append(sample(Posterior(made, prior), start_at, truth[part], rng))
    return Intervals(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def prepared(name: str, scan: brs.Scan, covariance: np.ndarray, variance: np.ndarray) -> Likelihood:
    """Make a likelihood that uses all beams."""
    gain = np.broadcast_to(brs.geometry.design_matrix(scan), (*variance.shape, 6))
    every = np.broadcast_to(covariance, (len(variance), *covariance.shape))
    return MAKERS[name](variance, np.ones_like(variance, dtype=bool), gain, every)


def cost(name: str, prior: Prior, scan: brs.Scan, covariance: np.ndarray, variance: np.ndarray) -> float:
    """Return microseconds of one core for a draw's density, up to 50 records of 1000 draws; the best of three."""
    made = prepared(name, scan, covariance, variance[:50])
    stress = np.broadcast_to(prior.draw(1000, SEED), (made.n_record, 1000, 6))
    times = []
    for _ in range(3):
        start = time.process_time()
        made.log_density(stress)
        times.append(time.process_time() - start)
    return min(times) / (1000 * made.n_record) * 1e6


def rows_of(found: dict[str, Intervals], truth: np.ndarray) -> list[dict[str, object]]:
    """Return one row for each likelihood and stress.

    Coverage of central intervals; ``below``, the share of records whose truth is below the median; ``bias``, the mean
    of (median − truth)/sd; ``width``, the median of the 90 % interval's width over the reference's; ``score``, the mean
    interval score of the 90 % interval (width, plus 20 times what the truth is outside) over the reference's width;
    ``poor``, the share of records whose importance weights have a Pareto k above 0.7. Records that are poor for any
    likelihood are left out for all: the choice depends on data, not on truths, so that it changes no right coverage.
    """
    trusted = np.all([have.pareto <= 0.7 for have in found.values()], axis=0)
    usual = (found[REFERENCE].high - found[REFERENCE].low)[trusted]
    rows: list[dict[str, object]] = []
    for name, have in found.items():
        low, high, true = have.low[trusted], have.high[trusted], truth[trusted]
        outside = np.maximum(low - true, 0.0) + np.maximum(true - high, 0.0)
        score = np.mean((high - low + 20.0 * outside) / usual, axis=0)
        bias = np.mean((have.median[trusted] - true) / have.sd[trusted], axis=0)
        for index, stress in enumerate(STRESSES):
            rank = have.rank[trusted, index]
            row: dict[str, object] = {"trusted": len(rank), "likelihood": name, "stress": stress}
            for level in LEVELS:
                row[f"cover_{100 * level:.0f}"] = np.mean(np.abs(rank - 0.5) < 0.5 * level)
            row["below"] = np.mean(rank < 0.5)
            row["bias"] = bias[index]
            row["width"] = np.median((high - low)[:, index] / usual[:, index])
            row["score"] = score[index]
            row["poor"] = np.mean(have.pareto > 0.7)
            rows.append(row)
    return rows


def measure(n_record: int, priors: list[str]) -> pd.DataFrame:
    """Measure all likelihoods on all scenes."""
    tables = []
    turbulence = brs.load_turbulence("fu-2022")
    for name, (preset, options) in SCENES.items():
        scan = brs.load_scan(preset, **options)
        covariance = brs.noise.calibrate(scan, turbulence, wind_speed=WIND_SPEED, duration=DURATION).covariance[0]
        for source in ("lines", "boxes"):
            relative = relative_variances(name, scan, source, n_record)
            for prior_name in priors:
                prior = make_prior(prior_name)
                truth = prior.draw(len(relative), np.random.default_rng([SEED, 1]))
                variance = relative * brs.geometry.radial_variance(scan, truth)
                found = {
                    likelihood: posteriors(likelihood, prior, scan, covariance, variance, truth)
                    for likelihood in MAKERS
                }
                table = pd.DataFrame(rows_of(found, truth))
                micro = {key: cost(key, prior, scan, covariance, variance) for key in MAKERS}
                table["microseconds"] = table["likelihood"].map(micro)
                for column, value in (("records", len(relative)), ("prior", prior_name), ("source", source)):
                    table.insert(0, column, value)
                table.insert(0, "scan", name)
                tables.append(table)
                print(f"{name}, {source}, {prior_name}: done", flush=True)
    return pd.concat(tables, ignore_index=True)


def summary(table: pd.DataFrame) -> list[str]:
    """Return the rows of docs/likelihood.md: means over scans and stresses, and the largest error of a coverage."""
    rows = []
    for (prior, source, name), part in table.groupby(["prior", "source", "likelihood"], sort=False):
        cover = [f"{100.0 * part[f'cover_{100 * level:.0f}'].mean():.1f}" for level in LEVELS]
        worst = 100.0 * (part["cover_90"] - 0.9).abs().max()
        cells = [prior, source, name, *cover, f"{worst:.1f}", f"{100.0 * part['below'].mean():.1f}"]
        cells += [f"{part[column].mean():.3f}" for column in ("bias", "width", "score")]
        rows.append("| " + " | ".join(cells) + " |")
    return rows


def costs(table: pd.DataFrame) -> list[str]:
    """Return the rows of costs of docs/likelihood.md: microseconds a draw, for each scan."""
    cost = table.groupby(["likelihood", "scan"], sort=False)["microseconds"].min().unstack()
    return [
        "| " + " | ".join([name, *(f"{cost.loc[name, scan]:.2g}" for scan in SCENES)]) + " |"
        for name in table["likelihood"].unique()
    ]


def main() -> None:
    """Measure, write the table, and print its summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=1000, help="simulated records on lines, for each scan")
    parser.add_argument("--priors", nargs="+", default=["weak", "flat"])
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent)
    arguments = parser.parse_args()
    table = measure(arguments.records, arguments.priors)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "likelihoods.csv", index=False, float_format="%.4g")
    table = pd.read_csv(arguments.output / "likelihoods.csv")  # rounded, as the page has it
    print("\n".join(table.summary() + costs(table)))


if __name__ == "__main__":
    main()
