"""The plan of a scene: what is computed, what is skipped and why, and what bounds the error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_rs._validation import check_count, check_positive
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_words import probe_words
from bayes_rs.noise.store import find_shipped_noise
from bayes_rs.posteriors.sampling.chains import N_CHAIN, kept_draws
from bayes_rs.posteriors.sampling.walkers import N_KEPT
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.sizes import MOMENT, in_time
from bayes_rs.theory.pairs import seconds_of_pairs
from bayes_rs.theory.sampling_times import sample_counts
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence


@dataclass(frozen=True)
class Step:
    """One thing that a scene needs, or lets us skip.

    Parameters
    ----------
    what : str
        The computation.
    decision : str
        What is done, in a few words.
    why : str
        The reason.
    bound : str
        What bounds the error that the decision makes.
    """

    what: str
    decision: str
    why: str
    bound: str


@dataclass(frozen=True)
class Plan:
    """The plan of a scene.

    Parameters
    ----------
    title : str
        The scene in one line.
    steps : tuple of Step
        In the order in which the fit takes them.
    noise : Noise or None
        The noise of the scene, which says its bounds; None where it takes more than a moment and is only announced.
    """

    title: str
    steps: tuple[Step, ...]
    noise: Noise | None

    def lines(self) -> list[str]:
        """Return the plan as lines to print."""
        text = [self.title]
        for step in self.steps:
            text += ["", f"{step.what}: {step.decision}", f"  why    {step.why}", f"  error  {step.bound}"]
        return text


def plan(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path = "fu-2022",
    *,
    wind_speed: float,
    duration: float = 600.0,
    prior: str | Prior = "weak",
    target_ess: int = 1000,
) -> Plan:
    """Work out what a scene needs computed and what it lets us skip.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, or its name or file.
    turbulence : MannTurbulence, str or Path
        The turbulence of the noise, or its name or file.
    wind_speed : float
        Mean wind speed, m/s.
    duration : float
        Length of a record, s.
    prior : str or Prior
        The prior.
    target_ess : int
        Effective sample size to reach for every stress.

    Returns
    -------
    plan : Plan
        Decisions with their reasons and bounds; nothing is sampled, and no noise is made that takes more than a moment.

    Raises
    ------
    InputError
        If an argument is not valid, or the scene is too large to be computed at all.

    Examples
    --------
    >>> made = plan("50-beam", wind_speed=10.0)
    >>> made.steps[5].decision
    '50 variances a record are reduced to 5 numbers'
    """
    chosen, scan, turbulence = make_prior(prior), as_scan(scan), as_turbulence(turbulence)
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_positive(duration, what="duration", unit="s")
    check_count(target_ess, what="target_ess")
    n_sample = int(np.max(sample_counts(scan, duration)))
    seconds = seconds_of_pairs(scan, n_sample)
    noise = None
    if seconds <= MOMENT:
        noise = theory_noise(scan, turbulence, wind_speed=wind_speed, duration=duration)
    of_noise = _announced(scan, n_sample, seconds) if noise is None else _noise_steps(noise)
    seen = sight(scan)
    title = (
        f"{scan.name} ({scan.n_beam} beams), {duration:g} s at {wind_speed:g} m/s, turbulence {turbulence.name}, "
        f"prior {chosen.name}"
    )
    shipped = find_shipped_noise(scan, turbulence, duration=duration)
    return Plan(
        title,
        (*of_noise, _bank(shipped), *_data_steps(scan, noise, seen.rank), _sampling(target_ess)),
        noise,
    )


def _announced(scan: Scan, n_sample: int, seconds: float) -> list[Step]:
    """Say what noise would be computed, and about how long that takes."""
    n_pair = scan.n_beam * (scan.n_beam + 1) // 2
    return [
        Step(
            "noise of the variances",
            f"by theory, about {in_time(seconds)} of one processor for each state of the wind: not computed here",
            f"{n_pair} pairs of beams with {n_sample} samples each; pairs that repeat others cost nothing",
            "known once it is made; calibrate makes it, and keeps it in the cache",
        )
    ]


def _shortcuts(noise: Noise) -> list[Step]:
    error = noise.details.get("pair_error")
    if error is None:
        return []
    return [
        Step(
            "shortcuts for many beams",
            f"calculated: {noise.details['pairs_calculated']}",
            "covariances are smooth in the lag, and those of probe volumes in where two beams are and look",
            f"{100.0 * error:.1g} % of K, {50.0 * error:.1g} % of a width, as pairs tell that did not serve for it",
        )
    ]


def _noise_steps(noise: Noise) -> list[Step]:
    pairs, unique = noise.details["n_pairs"], noise.details["n_unique_pairs"]
    skipped = f"; {pairs - unique} repeat another pair's separation and directions" if pairs > unique else ""
    if "probe" not in noise.details:
        probe = Step("probe volume", "no probe integral", "the scan's beams see points", "none")
    elif noise.details["probe_as_points"]:
        probe = Step(
            "probe volume",
            "beams are treated as points",
            f"the probe takes at most {100.0 * noise.details['probe_loss']:.2g} % of a variance",
            f"{noise.details['probe_error']:.1g} of the largest entry of K",
        )
    else:
        probe = Step(
            "probe volume",
            "integrated along every beam",
            probe_words(noise, noise.wind_speed, noise.yaw).removeprefix("probe volume: "),
            f"{noise.details['probe_error']:.1g} of the largest entry of K",
        )
    return [
        Step(
            "noise of the variances",
            "by theory: no box and no line is simulated",
            "frozen Gaussian turbulence has a covariance of variances in closed form (Isserlis), for the record's own "
            "samples",
            f"every entry of K within {noise.details['covariance_error']:.1g} "
            f"(K is {noise.covariance.max():.2g} at most)",
        ),
        Step(
            "pairs of beams",
            f"{unique} of {pairs} computed{skipped}",
            "pairs with the same separation and the same two directions have the same covariance",
            "equal to the long way, to rounding",
        ),
        probe,
        *_shortcuts(noise),
    ]


def _bank(shipped: Noise | None) -> Step:
    """Say where the noise of records at other wind speeds and directions comes from."""
    what = "noise of records at other wind speeds and directions"
    if shipped is not None and shipped.interpolation_error is not None:
        return Step(
            what,
            f"interpolated between {len(shipped)} shipped states",
            "the noise is smooth in the wind speed and the direction",
            f"{100.0 * shipped.interpolation_error:.1f} % of K, measured between the states",
        )
    return Step(
        what,
        "a net of states is computed where the records are, and kept in the cache",
        "none is shipped for this scan, turbulence and record length",
        "1 % of K between the states, measured when the net is made",
    )


def _data_steps(scan: Scan, noise: Noise | None, rank: int) -> list[Step]:
    if scan.n_beam > rank:
        reduction = Step(
            "data",
            f"{scan.n_beam} variances a record are reduced to {rank} number{'s' * (rank > 1)}",
            "the stresses move the variances in no more independent ways; the rest is noise",
            "the density of the reduced data is exact; what the noise shares with the rest is given up",
        )
    else:
        reduction = Step(
            "data", "all variances are used as they are", "no more beams than directions of R that they see", "none"
        )
    if rank < 6:
        unseen = Step(
            "unseen directions",
            f"{6 - rank} of 6 directions of R are left to the prior: the scan {sight(scan).in_words()}",
            "no radial variance changes along them",
            "they are sampled with the rest, so none; ``decided`` near zero shows them in the result",
        )
    else:
        unseen = Step("unseen directions", "none: the scan sees all six stresses", "rank 6", "none")
    if noise is None:
        return [reduction, unseen]
    worst = float(np.max(noise.relative_error))
    weight = Step(
        "weight of a record",
        f"a variance is known to {100 * worst:.0f} % at worst",
        "finite record with its own mean removed, which takes "
        f"{-100 * float(np.min(noise.bias)):.0f} % of the variance at most",
        "of the noise, as above",
    )
    return [reduction, unseen, weight]


def _sampling(target_ess: int) -> Step:
    return Step(
        "sampling",
        f"records in emcee ensembles, {kept_draws(target_ess) * N_CHAIN // N_KEPT} walkers each; {N_KEPT} steps",
        "walkers start at weighted draws of proposals fitted to each record, resampled to the posterior",
        f"steps are doubled until every stress has {target_ess} effective draws, or flagged",
    )
