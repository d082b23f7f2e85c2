"""Coverage of the credible intervals, as it should be and off the ideal: python benchmarks/calibration.py OUTPUT.

Truths are drawn from the prior. A record's variances are the expected ones of its truth times relative deviations:
drawn from the noise model itself ("model"), or those of records that the line simulator made of Gaussian turbulence
("lines") or that beams measured in Mann boxes ("boxes"), which know nothing of a log-normal. Every line of the table is
one set of records; the columns are the shares of records whose central 50, 80, 90 and 95 % intervals hold the truth,
of the stress where that is farthest from nominal; the same of uu at 90 %; the largest bias of a posterior mean in
posterior standard deviations; the smallest of the six stresses' probabilities that ranks so uneven come from a uniform
distribution, times six; and the share of records that missed the target of the sampler.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from scipy import stats

import bayes_rs as brs
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.simulation.lines import LineMaker
from bayes_rs.simulation.virtual import RecordState

LEVELS = (0.5, 0.8, 0.9, 0.95)
INSTRUMENTS: dict[str, tuple[str, dict[str, float]]] = {
    "4-beam": ("4-beam", {}),
    "6-beam": ("6-beam", {}),
    "6-beam 45°": ("6-beam", {"opening_angle_deg": 45.0}),
    "50-beam": ("50-beam", {}),
}
FLOWS = ("fu-2022", "stable-onshore", "unstable-onshore")
PRIORS = ("weak", "flat", "mann:tolerance=0.2")
WIND_SPEED = 10.0
BOXES = {"4-beam": "4-beam", "6-beam": "6-beam", "50-beam": "50-beam"}


@dataclass(frozen=True)
class Scene:
    """A scan in a flow, with the relative deviations of simulated records."""

    scan: brs.Scan
    flow: brs.MannTurbulence
    noise: Noise
    deviation: np.ndarray


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--records", type=int, default=2000)
    arguments = parser.parse_args()
    began = time.perf_counter()
    rows = [*ideal(arguments.records), *off_the_ideal(arguments.records)]
    table = pd.DataFrame(rows)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(arguments.output / "calibration.csv", index=False, float_format="%.3f")
    print(table.to_string(index=False))
    print(f"{len(table)} sets of records in {time.perf_counter() - began:.0f} s")


def make_scene(instrument: str, flow_name: str, n_record: int) -> Scene:
    """Return the scan in the flow, with its noise by theory and deviations of simulated records."""
    name, options = INSTRUMENTS[instrument]
    scan, flow = brs.load_scan(name, **options), brs.load_turbulence(flow_name)
    noise = brs.noise.theory(scan, flow, wind_speed=WIND_SPEED)
    return Scene(scan, flow, noise, simulated_deviations(scan, flow, noise, n_record))


def simulated_deviations(
    scan: brs.Scan, flow: brs.MannTurbulence, noise: Noise, n_record: int, seed: int = 2
) -> np.ndarray:
    """Return y/E[y] of records of the line simulator, shape (n_record, n_beam)."""
    state = RecordState(scan, WIND_SPEED, scan.yaw, noise.duration)
    maker = LineMaker(scan, flow, wind_speed=WIND_SPEED, n_sample=state.n_sample, yaw=scan.yaw)
    rng = np.random.default_rng(seed)
    parts = [maker.make(min(100, n_record - done), rng).var(axis=-1) for done in range(0, n_record, 100)]
    expected = (1.0 + noise.bias[0]) * (noise.gain[0] @ flow.stresses())
    return np.concatenate(parts) / expected


def box_deviations(name: str, scan: brs.Scan) -> np.ndarray:
    """Return y/E[y] of records in independent Mann boxes, made by make_box_records.py, shape (n_record, n_beam)."""
    table = pd.read_parquet(Path(__file__).parents[1] / "tests" / "data" / "box_records.parquet")
    return table[[f"{name}/{beam}" for beam in scan.beam]].to_numpy(dtype=np.float64)


def model_deviations(noise: Noise, n_record: int, seed: int = 3) -> np.ndarray:
    """Return log-normal deviations with the noise's moments, shape (n_record, n_beam)."""
    covariance = np.log1p(noise.covariance[0])
    values, vectors = np.linalg.eigh(covariance)
    normal = np.random.default_rng(seed).standard_normal((n_record, len(values)))
    return np.exp(normal @ (vectors * np.sqrt(np.maximum(values, 0.0))).T - 0.5 * np.diag(covariance))


def measure(
    labels: dict[str, str],
    scan: brs.Scan,
    noise: Noise,
    prior: Prior,
    deviation: np.ndarray,
    *,
    truth_gain: np.ndarray | None = None,
    observed: Callable[[np.ndarray], np.ndarray] = lambda stress: stress,
    nuisances: Nuisances | None = None,
    seed: int = 4,
) -> dict[str, object]:
    """Fit records of truths from the prior, and count how often the intervals hold them."""
    n_record = len(deviation)
    stress = prior.draw(n_record, seed)
    gain = noise.gain[0]
    variance = (stress @ (gain if truth_gain is None else truth_gain).T) * deviation
    records = xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(n_record, WIND_SPEED)),
            "yaw": ("record", np.zeros(n_record)),
        },
        coords={"beam": scan.beam},
        attrs={"duration": 600.0},
    )
    options = {"sampler": "auto", "target_ess": 500, "nuisances": nuisances, "campaign": "off"}
    result = brs.fit(records, scan, noise=noise, prior=prior, seed=5, **options)
    draws = result["posterior/stress"].transpose("record", "component", "chain", "draw").values
    flat = draws.reshape(n_record, 6, -1)
    rank = (flat < observed(stress)[:, :, None]).mean(axis=-1)
    distance = np.abs(rank - 0.5)
    shares = {level: np.mean(distance < 0.5 * level, axis=0) for level in LEVELS}
    worst = {level: share[np.argmax(np.abs(share - level))] for level, share in shares.items()}
    bias = np.mean((flat.mean(axis=-1) - observed(stress)) / flat.std(axis=-1), axis=0)
    stats_group = result["sample_stats"]
    return {
        **labels,
        "records": n_record,
        **{f"{100.0 * level:.0f} %": value for level, value in worst.items()},
        "uu 90 %": shares[0.9][0],
        "largest bias": bias[np.argmax(np.abs(bias))],
        "p": min(1.0, 6.0 * min(stats.kstest(column, "uniform").pvalue for column in rank.T)),
        "flagged": float(np.mean((stats_group["flag"].values & 16) != 0)),
    }


def ideal(n_record: int) -> list[dict[str, object]]:
    """The right noise: every instrument, flow and prior."""
    rows = []
    for instrument in INSTRUMENTS:
        for flow in FLOWS:
            scene = make_scene(instrument, flow, n_record)
            for prior in PRIORS:
                for data in ("model", "lines"):
                    deviation = scene.deviation if data == "lines" else model_deviations(scene.noise, n_record)
                    labels = {
                        "case": "right noise",
                        "instrument": instrument,
                        "flow": flow,
                        "prior": prior,
                        "data": data,
                    }
                    rows.append(measure(labels, scene.scan, scene.noise, make_prior(prior), deviation))
                    print(rows[-1], flush=True)
    return rows


def off_the_ideal(n_record: int) -> list[dict[str, object]]:
    """Wrong noise, wrong flow, a probe that is not known of; and what helps."""
    rows: list[dict[str, object]] = []
    prior = make_prior("weak")
    for instrument in INSTRUMENTS:
        scene = make_scene(instrument, "fu-2022", n_record)
        labels = {"instrument": instrument, "flow": "fu-2022", "prior": "weak"}

        def add(
            case: str,
            noise: Noise,
            deviation: np.ndarray = scene.deviation,
            scene: Scene = scene,
            labels: dict[str, str] = labels,
            data: str = "lines",
            **options: object,
        ) -> None:
            row = measure({"case": case, **labels, "data": data}, scene.scan, noise, prior, deviation, **options)  # type: ignore[arg-type]  # options of any kind
            rows.append(row)
            print(row, flush=True)

        for factor, words in ((2.0, "L twice too long"), (0.5, "L twice too short")):
            wrong = replace(scene.flow, length_scale=factor * scene.flow.length_scale)
            add(f"noise with {words}", brs.noise.theory(scene.scan, wrong, wind_speed=WIND_SPEED))
        for gamma in (0.0, 5.0):
            wrong = replace(scene.flow, gamma=gamma)
            add(f"noise with Γ = {gamma:g} for 3.2", brs.noise.theory(scene.scan, wrong, wind_speed=WIND_SPEED))
        short = replace(scene.flow, length_scale=0.5 * scene.flow.length_scale)
        short_noise = brs.noise.theory(scene.scan, short, wind_speed=WIND_SPEED)
        add("L twice too short, inflation 1.7", short_noise, nuisances=Nuisances(inflation=1.7))
        add("L twice too short, inflation uncertain", short_noise, nuisances=Nuisances(inflation_dof=4.0))
        if instrument in BOXES:
            add("Mann boxes", scene.noise, box_deviations(BOXES[instrument], scene.scan), data="boxes")
        if scene.scan.n_beam <= 6:
            probed = replace(scene.scan, probe=brs.geometry.ContinuousWaveProbe(rayleigh_length=6.0))
            with_probe = brs.noise.theory(probed, scene.flow, wind_speed=WIND_SPEED)
            add("probe of z_R = 6 m ignored", scene.noise, truth_gain=with_probe.gain[0])
        net = brs.noise.calibrate(
            scene.scan,
            short,
            tolerance=0.01,
            wind_speed=[WIND_SPEED],
            length_scale=[0.2 * short.length_scale, 6.0 * short.length_scale],
            cache=False,
        )
        uncertain = Nuisances(length_scale_log_sd=0.7, length_scale=short.length_scale)
        add("L twice too short, averaged over", net, nuisances=uncertain)
    return rows


if __name__ == "__main__":
    main()
