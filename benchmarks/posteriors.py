"""Run time against error of the posteriors: python benchmarks/posteriors.py OUTPUT [--peers].

Error: root mean square, over records, six stresses and four numbers (mean, 5, 50 and 95 % points), of the distance from
a reference in posterior standard deviations. The reference of a record is a direct sample with an effective size of a
quarter of a million, whose own error is below 0.5 %. Time: processor seconds a record on one core, from variances to
draws, after imports and a first small run, median of three runs of ours; each method at several lengths. Effective
size: the least of six stresses, as `Chains.ess_bulk` for ours, by the autocorrelation time of emcee for plain emcee.
"emcee, one record" is what most people would write: one record at a time, a log-probability in Python for one walker,
32 walkers, a third of the chain thrown away. Peers are other samplers on the same density, one record at a time, as
installed: dynesty, nautilus, zeus, NumPyro's NUTS; their times are by the clock.
"""

import argparse
import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import emcee
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.special import ndtri

import bayes_rs as brs
from bayes_rs.fits.batch import Batch, FitOptions, make_posterior
from bayes_rs.pictures import COLOURS
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.sampling import sample
from bayes_rs.posteriors.sampling.effort import Effort
from bayes_rs.priors.registry import WeakPrior

SCANS: dict[str, tuple[str, dict[str, float]]] = {
    "6-beam": ("6-beam", {}),
    "6-beam 45°": ("6-beam", {"opening_angle_deg": 45.0}),
    "50-beam": ("50-beam", {}),
}
N_RECORD = 256
N_SLOW = 4
"""Records that the methods that take one at a time are given."""
N_RUN = 3
"""Runs of our own samplers, of which the median counts."""
Method = Callable[[Posterior, np.ndarray], Iterator[tuple[str, float, float, np.ndarray]]]


def main() -> None:
    """Measure, and write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--peers", action="store_true")
    arguments = parser.parse_args()
    rows = []
    for scan_name in SCANS:
        posterior = scene(scan_name)
        keys = np.arange(N_RECORD)
        exact = statistics(draws_of("direct", posterior.take(keys[:32]), keys[:32], 250_000)[1])
        methods = [ours, plain, *((PEERS[name] for name in PEERS) if arguments.peers else ())]
        for method in methods:
            for name, size, seconds, found in method(posterior, keys):
                known = exact[:, : found.shape[1]]
                error = np.sqrt(np.mean(((found[:, : known.shape[1]] - known) / known[4]) ** 2, axis=(1, 2))[:4])
                row = {
                    "scan": scan_name,
                    "method": name,
                    "effective size": size,
                    "ms a record": 1e3 * seconds,
                    "error": float(np.sqrt(np.mean(error**2))),
                    "error of the mean": float(error[0]),
                }
                rows.append(row)
                print(row, flush=True)
    table = pd.DataFrame(rows)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "posteriors.csv", index=False, float_format="%.4g")
    draw(table).savefig(arguments.output / "posteriors.png", dpi=130)
    print(speed_up(table).to_string(index=False))


def scene(scan_name: str) -> Posterior:
    """Return posteriors of records of the seed's flow, under the weak prior, with noise by theory."""
    name, options = SCANS[scan_name]
    scan, flow = brs.load_scan(name, **options), brs.load_turbulence("fu-2022")
    noise = brs.noise.theory(scan, flow, wind_speed=10.0)
    log_covariance = np.log1p(noise.covariance[0])
    values, vectors = np.linalg.eigh(log_covariance)
    normal = np.random.default_rng(1).standard_normal((N_RECORD, scan.n_beam))
    scatter = normal @ (vectors * np.sqrt(np.maximum(values, 0.0))).T - 0.5 * np.diag(log_covariance)
    variance = (noise.gain[0] @ ((1.0 + noise.bias[0].mean()) * flow.stresses())) * np.exp(scatter)
    batch = Batch(
        variance,
        np.ones(variance.shape, dtype=np.bool_),
        np.full(N_RECORD, 10.0),
        np.zeros(N_RECORD),
        np.arange(N_RECORD),
    )
    options_of_fit = FitOptions(
        prior=WeakPrior(),
        target="record",
        sampler="emcee",
        likelihood="log-normal",
        nuisances=Nuisances(),
        instrument_noise=0.0,
        target_ess=1000,
        max_extension=0,
        seed=1,
    )
    return make_posterior(batch, noise, options_of_fit)[0]


def draws_of(
    sampler: str, posterior: Posterior, keys: np.ndarray, target_ess: int, *, max_extension: int = 0
) -> tuple[float, np.ndarray, float]:
    """Return the seconds, draws of stresses, shape (n_record, n_draw, 6), and the median of least effective sizes."""
    began = time.process_time()
    chains, _ = sample(sampler, posterior, keys=keys, effort=Effort(1, target_ess, max_extension))
    seconds = time.process_time() - began
    return seconds, chains.stress.reshape(len(keys), -1, 6), float(np.median(chains.ess_bulk.min(axis=1)))


def statistics(stress: np.ndarray) -> np.ndarray:
    """Return mean, 5, 50, 95 % points and sd, shape (5, n_record, 6)."""
    quantiles = np.quantile(stress, [0.05, 0.5, 0.95], axis=1)
    return np.concatenate([stress.mean(axis=1)[None], quantiles, stress.std(axis=1)[None]])


def ours(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:
    """The package's samplers, all records together, with their default effort."""
    for sampler in ("direct", "emcee"):
        draws_of(sampler, posterior.take(keys[:8]), keys[:8], 100)
        for target_ess in (1000, 4000, 16_000):
            runs = [draws_of(sampler, posterior, keys, target_ess, max_extension=5) for _ in range(N_RUN)]
            seconds = float(np.median([run[0] for run in runs]))
            yield f"bayes_rs, {sampler}", runs[0][2], seconds / len(keys), statistics(runs[0][1][:32])


def plain(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:  # noqa: ARG001
    """Run emcee as most people would write it, with stretch moves and with differential evolution."""
    for name, move in (("stretch", emcee.moves.StretchMove()), ("differential evolution", emcee.moves.DEMove())):
        for n_step in (300, 1000, 3000):
            began = time.process_time()
            found = [_plain_chain(posterior.take(np.array([record])), move, n_step, record) for record in range(N_SLOW)]
            seconds = (time.process_time() - began) / N_SLOW
            flat = np.stack([chain.reshape(-1, 6) for chain in found])
            # (step, walker, stress); a chain too short to know its time has an optimistic one
            sizes = [
                chain[..., 0].size / emcee.autocorr.integrated_time(chain, quiet=True, has_walkers=True).max()
                for chain in found
            ]
            yield f"emcee, one record, {name}", float(np.median(sizes)), seconds, statistics(flat)


def _plain_chain(posterior: Posterior, move: emcee.moves.Move, n_step: int, seed: int) -> np.ndarray:
    """Return stresses, shape (n_step, 32, 6)."""
    gain, whitening = posterior.likelihood.gain[0], posterior.likelihood.whitening[0]
    datum, prior = posterior.likelihood.datum[0], posterior.prior

    def log_probability(coordinate: np.ndarray) -> float:
        residual = datum - whitening @ np.log(gain @ prior.stress(coordinate))
        return float(-0.5 * residual @ residual - 0.5 * coordinate @ coordinate)

    sampler = emcee.EnsembleSampler(32, 6, log_probability, moves=move)
    sampler.random_state = np.random.RandomState(seed).get_state()
    start = 0.1 * np.random.default_rng(seed).standard_normal((32, 6))
    sampler.run_mcmc(start, n_step)
    return prior.stress(sampler.get_chain(discard=n_step // 3))


def _one_density(posterior: Posterior, record: int) -> Callable[[np.ndarray], np.ndarray]:
    one = posterior.take(np.array([record]))
    return lambda coordinate: one.log_density(np.atleast_2d(coordinate)[None])[0]


def _dynesty(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:
    import dynesty  # noqa: PLC0415 - a peer, as installed

    for n_live in (100, 400):
        began, found = time.perf_counter(), []
        for record in keys[:N_SLOW]:
            one = posterior.take(np.array([record]))

            def log_likelihood(coordinate: np.ndarray, one: Posterior = one) -> float:
                return float(one.likelihood.log_density(one.stress(coordinate[None, None]))[0, 0])

            sampler = dynesty.NestedSampler(log_likelihood, ndtri, 6, nlive=n_live, rstate=np.random.default_rng(1))
            sampler.run_nested(print_progress=False)
            equal = sampler.results.samples_equal(rstate=np.random.default_rng(2))
            found.append(statistics(posterior.stress(equal)[None])[:, 0])
        yield "dynesty", np.nan, (time.perf_counter() - began) / N_SLOW, np.stack(found, axis=1)


def _nautilus(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:
    import nautilus  # noqa: PLC0415 - only if it is there

    began, found = time.perf_counter(), []
    for record in keys[:N_SLOW]:
        one = posterior.take(np.array([record]))

        def log_likelihood(coordinate: np.ndarray, one: Posterior = one) -> np.ndarray:
            return one.likelihood.log_density(one.stress(coordinate[None]))[0]

        sampler = nautilus.Sampler(ndtri, log_likelihood, 6, n_live=500, vectorized=True, pass_dict=False, seed=1)
        sampler.run(n_eff=1000, verbose=False)
        points, log_weight, _ = sampler.posterior()
        weight = np.exp(log_weight - log_weight.max())
        rng = np.random.default_rng(2)
        equal = points[rng.choice(len(points), 10_000, p=weight / weight.sum())]
        found.append(statistics(posterior.stress(equal)[None])[:, 0])
    yield "nautilus", np.nan, (time.perf_counter() - began) / N_SLOW, np.stack(found, axis=1)


def _zeus(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:
    import zeus  # noqa: PLC0415 - only if it is there

    for n_step in (300, 1000):
        began, found = time.perf_counter(), []
        for record in keys[:N_SLOW]:
            np.random.seed(int(record))  # noqa: NPY002 - zeus draws from NumPy's global state
            sampler = zeus.EnsembleSampler(
                32, 6, _one_density(posterior, int(record)), vectorize=True, verbose=False, light_mode=False
            )
            sampler.run_mcmc(0.1 * np.random.default_rng(1).standard_normal((32, 6)), n_step, progress=False)
            chain = sampler.get_chain(discard=n_step // 3, flat=True)
            found.append(statistics(posterior.stress(chain)[None])[:, 0])
        yield "zeus", np.nan, (time.perf_counter() - began) / N_SLOW, np.stack(found, axis=1)


def _numpyro(posterior: Posterior, keys: np.ndarray) -> Iterator[tuple[str, float, float, np.ndarray]]:
    import jax  # noqa: PLC0415 - only if it is there
    import jax.numpy as jnp  # noqa: PLC0415 - only if it is there
    from numpyro.infer import MCMC, NUTS  # noqa: PLC0415 - only if it is there

    jax.config.update("jax_enable_x64", True)
    prior: Any = posterior.prior

    def stress(z: jax.Array) -> jax.Array:
        log_uu = jnp.log(prior.median_uu) + prior.log_sd_uu * z[0]
        log_vv = log_uu + jnp.log(prior.ratio_vv) + prior.log_sd_vv * z[1]
        log_ww = log_uu + jnp.log(prior.ratio_ww) + prior.log_sd_ww * z[2]
        rho = jnp.tanh(prior.z_sd * z[3:] + jnp.array([0.0, prior.z_uw, 0.0]))
        vw = rho[0] * rho[1] + rho[2] * jnp.sqrt((1.0 - rho[0] ** 2) * (1.0 - rho[1] ** 2))
        return jnp.array(
            [
                jnp.exp(log_uu),
                jnp.exp(log_vv),
                jnp.exp(log_ww),
                rho[0] * jnp.exp(0.5 * (log_uu + log_vv)),
                rho[1] * jnp.exp(0.5 * (log_uu + log_ww)),
                vw * jnp.exp(0.5 * (log_vv + log_ww)),
            ]
        )

    for n_sample in (300, 1000):
        began, found = time.perf_counter(), []
        for record in keys[:N_SLOW]:
            gain = jnp.asarray(posterior.likelihood.gain[record])
            whitening, datum = (jnp.asarray(getattr(posterior.likelihood, n)[record]) for n in ("whitening", "datum"))

            def energy(z: jax.Array, gain=gain, whitening=whitening, datum=datum) -> jax.Array:
                residual = datum - whitening @ jnp.log(gain @ stress(z))
                return 0.5 * residual @ residual + 0.5 * z @ z

            kernel = NUTS(potential_fn=energy)
            mcmc = MCMC(kernel, num_warmup=300, num_samples=n_sample, progress_bar=False)
            mcmc.run(jax.random.PRNGKey(int(record)), init_params=jnp.zeros(6))
            found.append(statistics(posterior.stress(np.asarray(mcmc.get_samples()))[None])[:, 0])
        yield "NumPyro NUTS", np.nan, (time.perf_counter() - began) / N_SLOW, np.stack(found, axis=1)


PEERS: dict[str, Method] = {
    name: method
    for name, package, method in (
        ("dynesty", "dynesty", _dynesty),
        ("nautilus", "nautilus", _nautilus),
        ("zeus", "zeus", _zeus),
        ("NumPyro NUTS", "numpyro", _numpyro),
    )
    if importlib.util.find_spec(package) is not None
}


def speed_up(table: pd.DataFrame) -> pd.DataFrame:
    """Return how much longer each method takes than ours to the same error, by error ∝ time^(−½), and the same size."""
    table = table.assign(
        to_error=table["ms a record"] * table["error"] ** 2, to_size=table["ms a record"] / table["effective size"]
    )
    lines = []
    for (scan, method), rows in table.groupby(["scan", "method"], sort=False):
        line = {"scan": scan, "method": method}
        for reference in ("direct", "emcee"):
            ours_of = table[(table["scan"] == scan) & (table["method"] == f"bayes_rs, {reference}")]
            for what, column in (("error", "to_error"), ("size", "to_size")):
                line[f"time to the same {what} over {reference}"] = np.median(rows[column]) / np.median(ours_of[column])
        lines.append(line)
    return pd.DataFrame(lines).round(2)


def draw(table: pd.DataFrame) -> Figure:
    """Draw error against time, one panel a scan."""
    scans = list(dict.fromkeys(table["scan"]))
    figure = Figure(figsize=(4.6 * len(scans), 4.6), layout="constrained")
    panels = figure.subplots(1, len(scans), sharex=True, sharey=True, squeeze=False)[0]
    for panel, scan in zip(panels, scans, strict=True):
        methods = table[table["scan"] == scan].groupby("method", sort=False)
        for (name, rows), colour in zip(methods, cycle(COLOURS), strict=False):
            strong = str(name).startswith("bayes_rs")
            panel.loglog(
                rows["ms a record"],
                rows["error"],
                "o-" if strong else "s--",
                label=name,
                color=colour,
                linewidth=1.8 if strong else 1.0,
                markersize=4,
            )
        panel.set_title(scan)
        panel.set_xlabel("time a record, ms")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("error of mean and quantiles, posterior sd")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # peers announce changes of their own
        main()
