"""Homogeneous inflow or one with gradients: what the data say, and what it does to the stresses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_count
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, make_posterior
from bayes_rs.fits.fit_options import FitOptions, split_options
from bayes_rs.fits.noise_choice import noise_and_records
from bayes_rs.fits.prepare import can_be_fitted, prepare
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.likelihoods.log_normal import LogNormalLikelihood
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.posterior import Posterior
from bayes_rs.posteriors.proposal import DEGREES_OF_FREEDOM, laplace_proposal
from bayes_rs.posteriors.sampling.chains import PARETO_K_LIMIT
from bayes_rs.posteriors.sampling.pareto import pareto_k
from bayes_rs.posteriors.sampling.streams import RecordStreams
from bayes_rs.progress import progress as progress_bar
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records

TARGETS = ("record", "ensemble")
_GRADES = ((5.0, "very strong for"), (3.0, "strong for"), (1.0, "positive for"))
"""Grades of Kass and Raftery (1995) on the natural logarithm of a Bayes factor."""
_NUMBERS = 4_000_000
"""Expected variances, of records × draws × beams, that are held at once: 32 MB. No result depends on it."""


@dataclass(frozen=True)
class _Weighted:
    """Weighted draws of the posteriors of some records.

    Parameters
    ----------
    coordinate : ndarray, shape (n_record, n_draw, n)
        The draws.
    log_weight : ndarray, shape (n_record, n_draw)
        Logarithms of their weights, which sum to 1.
    log_evidence, error : ndarray, shape (n_record,)
        ln p(data), and its Monte-Carlo standard error.
    pareto_k : ndarray, shape (n_record,)
        Tail shape of the weights.
    """

    coordinate: FloatArray
    log_weight: FloatArray
    log_evidence: FloatArray
    error: FloatArray
    pareto_k: FloatArray

    @property
    def weight(self) -> FloatArray:
        """The weights."""
        return np.exp(self.log_weight)


def compare_inflow(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    seed: int,
    noise: Noise | str | Path | None = None,
    n_draw: int = 4096,
    leave_one_out: bool = True,
    progress: bool | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Compare, record by record, a homogeneous inflow with one whose stresses have gradients.

    Parameters
    ----------
    records, scan
        As in `fit`.
    seed : int
        Seed; a record's numbers do not depend on the records beside it.
    noise : Noise, str or Path, optional
        As in `fit`.
    n_draw : int
        Weighted draws of a posterior; the Monte-Carlo errors fall with its root.
    leave_one_out : bool
        Predict each beam from the others, too: fits every record once more for each beam.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.
    **options
        As in `fit`: ``nuisances`` with a ``vertical_gradient_sd``, a ``lateral_gradient_sd`` or both, of which the
        homogeneous inflow is the same without; ``prior``, ``instrument_noise``; and ``target``, ``"record"`` or
        ``"ensemble"``.

    Returns
    -------
    table : DataFrame
        A row for each record, NaN where it cannot be fitted:

        - ``record``, ``time``;
        - ``log_bayes_factor``, ln p(data | gradients) − ln p(data | homogeneous), and ``log_bayes_factor_error``, its
          Monte-Carlo standard error;
        - ``elpd_difference``, the same for Σ_b ln p(y_b | other beams), and ``elpd_difference_error``; with
          `leave_one_out`, and over the beams that a record uses if these are two at least;
        - ``lateral_gradient`` and ``vertical_gradient`` where they are on: posterior mean, per 100 m, and standard
          deviation (``…_sd``);
        - for each stress, ``change_uu`` and so on: what the gradients change in its posterior mean, m² s⁻²; and
          ``wider_uu`` and so on: the ratio of its posterior standard deviations, with gradients over without;
        - ``pareto_k``: the largest tail shape of the weights of the two evidences; above 0.7 they cannot be trusted;
        - ``verdict``: the Bayes factor in words.

    Raises
    ------
    InputError
        If no gradient is on, the length scale is uncertain, or as in `fit`.
    NoiseMismatchError
        If the noise was made for another scan.

    Notes
    -----
    Evidence: p(data) = ∫ p(data | θ) p(θ) dθ by importance sampling from a Student-t fitted to the posterior,
    ln Z = ln mean w with the error √(n Σw²/(Σw)² − 1)/√n. Both inflows have the same data: those that stresses *and*
    gradients can move (`LogNormalLikelihood`).

    One beam out: with z the reduced log-variances of the other beams and r their whitened residuals at θ, ln y_b is
    normal with the mean ln m_b − ½ C_bb + k·r and the variance C_bb − k·k, k = Cov[ln y_b, W ln y] (for Student-t noise
    of ν degrees of freedom and n data, a Student-t of ν + n with the variance times (ν + r·r)/(ν + n)). Beams are
    correlated, so that this is not the product of their own densities. The density of ln y_b is averaged over the
    posterior of θ given z, which is sampled anew without the beam: no importance weights from one fit to the other.

    The Bayes factor is between two priors, and depends on the gradients' standard deviation. Where a scan cannot tell a
    gradient from stresses (`inflow_confounding`), it says no more than which prior expected the data more, and is near
    one: that is no evidence for homogeneous flow. Every record has gradients of its own: sums over records
    (`inflow_in_words`) compare homogeneous flow in all with gradients in all.

    References
    ----------
    Kass and Raftery (1995), J. Am. Stat. Assoc. 90, 773–795, doi:10.1080/01621459.1995.10476572 (Bayes factors in
    words).
    Bürkner, Gabry and Vehtari (2021), Comput. Stat. 36, 1243–1261, doi:10.1007/s00180-020-01045-4 (one out of
    correlated data).

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("6-beam-planes"), brs.load_turbulence("fu-2022")
    >>> noise = brs.noise.theory(scan, flow, wind_speed=10.0)
    >>> records = brs.make_records(brs.simulate(scan, flow, wind_speed=10.0, n_records=1, seed=1), scan)
    >>> table = compare_inflow(
    ...     records, scan, noise=noise, nuisances=brs.Nuisances(vertical_gradient_sd=0.5), seed=1, leave_one_out=False
    ... )
    >>> bool(table["wider_uw"][0] > 1.0)
    True
    """
    check_count(n_draw, what="n_draw", minimum=100)
    given = {**options, "seed": seed, "sampler": "direct", "target_ess": n_draw, "max_extension": 0}
    asked, choice = split_options(given)
    check_choice(asked.target, TARGETS, what="target of a comparison")
    nuisances = asked.nuisances
    if not nuisances.gradient_names:
        raise InputError(
            "The nuisances have no gradient, so there is nothing to compare: give Nuisances a vertical_gradient_sd or "
            "a lateral_gradient_sd, such as 0.5."
        )
    if nuisances.length_scale_sd > 0.0:
        raise InputError(
            "Inflows cannot be compared while the length scale is uncertain: set length_scale_log_sd to 0."
        )
    check_are_records(records)
    records = believed(records)
    used = as_scan(scan)
    made, records = noise_and_records(records, used, given_noise(noise), asked, choice, lambda _: None)
    used, made, batch = prepare(records, used, made, asked)
    fitted = can_be_fitted(batch)
    size = max(1, _NUMBERS // (n_draw * used.n_beam))
    chunks = [fitted[start : start + size] for start in range(0, len(fitted), size)]
    silent = None if progress is None else not progress
    found: dict[str, FloatArray] = {}
    for chunk in progress_bar(chunks, len(chunks), "comparing inflows", disable=silent):
        for name, values in _compare(batch.take(chunk), made, asked, leave_one_out).items():
            found.setdefault(name, np.full(len(batch), np.nan))[chunk] = values
    start = records["time"].values if "time" in records.coords else np.full(len(batch), np.datetime64("NaT", "ns"))
    table = pd.DataFrame({"record": np.arange(len(batch)), "time": start, **found})
    verdict = np.full(len(batch), "not fitted", dtype=object)
    for row in fitted:
        heavy = found["pareto_k"][row] > PARETO_K_LIMIT
        verdict[row] = "weights uneven: not to be trusted" if heavy else _grade(found["log_bayes_factor"][row])
    return table.assign(verdict=verdict)


def inflow_in_words(table: pd.DataFrame) -> str:
    """Say what a table of `compare_inflow` says of all its records together.

    Parameters
    ----------
    table : DataFrame
        From `compare_inflow`.

    Returns
    -------
    words : str
        The sums of log Bayes factors and of elpd differences. The errors are those of the sums: Monte-Carlo for the
        Bayes factor; for the elpd, √n times the standard deviation from record to record.

    Raises
    ------
    InputError
        If no record could be compared.

    Examples
    --------
    >>> import pandas as pd
    >>> inflow_in_words(pd.DataFrame({"log_bayes_factor": [2.0, 1.5], "log_bayes_factor_error": [0.03, 0.04]}))
    '2 records: strong for gradients (log Bayes factor 3.50 ± 0.05)'
    """
    kept = table[np.isfinite(table["log_bayes_factor"])]
    if kept.empty:
        raise InputError("No record of the table could be compared: check the records' flags.")
    total, error = float(kept["log_bayes_factor"].sum()), float(np.hypot.reduce(kept["log_bayes_factor_error"]))
    n_record = len(kept)
    words = f"{n_record} record{'s' * (n_record > 1)}: {_grade(total)} (log Bayes factor {total:.2f} ± {error:.2f})"
    if "elpd_difference" not in kept or kept["elpd_difference"].count() < 2:
        return words
    elpd = kept["elpd_difference"].dropna()
    return f"{words}; one beam out, elpd difference {elpd.sum():.2f} ± {len(elpd) ** 0.5 * elpd.std():.2f}"


def _grade(log_bayes_factor: float) -> str:
    for least, words in _GRADES:
        if abs(log_bayes_factor) >= least:
            return f"{words} {'gradients' if log_bayes_factor > 0.0 else 'homogeneous flow'}"
    return "cannot tell"


def _compare(batch: Batch, noise: Noise, options: FitOptions, leave_one_out: bool) -> dict[str, FloatArray]:
    """Return the columns of the table for records that can be fitted."""
    sheared, at_record = make_posterior(batch, noise, options)
    models = (_homogeneous(sheared), sheared)
    without, withal = (_weigh(model, batch.key, options) for model in models)
    table = {
        "log_bayes_factor": withal.log_evidence - without.log_evidence,
        "log_bayes_factor_error": np.hypot(withal.error, without.error),
    }
    if leave_one_out:
        covariance = options.nuisances.inflation * np.log1p(at_record.covariance)
        table |= _one_out(batch, noise, options, sheared, covariance)
    values = sheared.nuisance_values(withal.coordinate)
    for name in options.nuisances.gradient_names:
        table[name], table[f"{name}_sd"] = _moments(values[name][..., None], withal.weight)[:, :, 0]
    moments = [
        _moments(model.stress(drawn.coordinate), drawn.weight)
        for model, drawn in zip(models, (without, withal), strict=True)
    ]
    for column, name in enumerate(STRESSES):
        table[f"change_{name}"] = moments[1][0][:, column] - moments[0][0][:, column]
        table[f"wider_{name}"] = moments[1][1][:, column] / moments[0][1][:, column]
    return {**table, "pareto_k": np.maximum(without.pareto_k, withal.pareto_k)}


def _homogeneous(posterior: Posterior) -> Posterior:
    """Return the posterior of the same data with all gradients zero."""
    nuisances = posterior.nuisances
    return replace(posterior, nuisances=replace(nuisances, choice=nuisances.choice.without_gradients()))


def _weigh(posterior: Posterior, keys: NDArray[np.int64], options: FitOptions, salt: int = 0) -> _Weighted:
    """Draw from a Student-t about each mode, fit another to these draws, draw from it, and weigh."""
    streams = RecordStreams(int(np.random.SeedSequence([options.seed, salt]).generate_state(1)[0]), keys)
    every = np.arange(posterior.n_record)
    proposal = laplace_proposal(posterior)
    for again in (True, False):
        normal = streams.normal(every, (options.target_ess, posterior.n_coordinate))
        chi_square = streams.chi_square(every, (options.target_ess,), DEGREES_OF_FREEDOM)
        coordinate = proposal.transform(normal, chi_square)
        log_weight = posterior.log_density(coordinate) - proposal.log_density_of(normal, chi_square)
        total = np.asarray(scipy.special.logsumexp(log_weight, axis=1))
        weight = np.exp(log_weight - total[:, None])
        if again:
            mean = np.einsum("rd,rdk->rk", weight, coordinate)
            centred = coordinate - mean[:, None, :]
            covariance = (centred * weight[..., None]).swapaxes(-1, -2) @ centred
            proposal = proposal.refitted(every, mean, covariance)
    n_draw = options.target_ess
    uneven = n_draw * np.sum(weight**2, axis=1) - 1.0
    return _Weighted(
        coordinate,
        log_weight - total[:, None],
        total - np.log(n_draw),
        np.sqrt(np.maximum(uneven, 0.0) / n_draw),
        pareto_k(log_weight),
    )


def _moments(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return mean and standard deviation, shape (2, n_record, n), of values (n_record, n_draw, n)."""
    mean = np.einsum("rd,rdn->rn", weight, values)
    return np.stack([mean, np.sqrt(np.einsum("rd,rdn->rn", weight, (values - mean[:, None, :]) ** 2))])


def _one_out(
    batch: Batch, noise: Noise, options: FitOptions, whole: Posterior, covariance: FloatArray
) -> dict[str, FloatArray]:
    """Return Σ_b ln p(y_b | other beams) with gradients less that without, and its Monte-Carlo error."""
    n_record, n_beam = batch.variance.shape
    difference, square = np.zeros(n_record), np.zeros(n_record)
    enough = batch.used.sum(axis=1) > 1
    for beam in range(n_beam):
        rows = np.flatnonzero(batch.used[:, beam] & enough)
        if len(rows) == 0:
            continue
        some = batch.take(rows)
        used = some.used.copy()
        used[:, beam] = False
        others, _ = make_posterior(replace(some, used=used), noise, options)
        for sign, model, full in (
            (1.0, others, whole),
            (-1.0, _homogeneous(others), _homogeneous(whole)),
        ):
            drawn = _weigh(model, some.key, options, salt=beam + 1)
            density = _beam_density(
                model, full.take(rows), covariance[rows], drawn.coordinate, np.log(some.variance[:, beam]), beam
            )
            with_weight = density + drawn.log_weight
            predicted = np.asarray(scipy.special.logsumexp(with_weight, axis=1))
            difference[rows] += sign * predicted
            square[rows] += np.sum((drawn.weight * np.expm1(density - predicted[:, None])) ** 2, axis=1)
    return {
        "elpd_difference": np.where(enough, difference, np.nan),
        "elpd_difference_error": np.where(enough, np.sqrt(square), np.nan),
    }


def _beam_density(
    others: Posterior,
    whole: Posterior,
    covariance: FloatArray,
    coordinate: FloatArray,
    log_variance: FloatArray,
    beam: int,
) -> FloatArray:
    """Return ln p(ln y_b | z, θ), shape (n_record, n_draw): see the notes of `compare_inflow`."""
    likelihood = others.likelihood
    if not isinstance(likelihood, LogNormalLikelihood):
        raise TypeError(f"one beam out needs the log-normal likelihood, not {type(likelihood).__name__}")
    residual = replace(likelihood, dof=np.inf).whitened_residual(*others.seen(coordinate))
    across = np.einsum("rb,rsb->rs", covariance[:, beam], likelihood.whitening)
    own = covariance[:, beam, beam]
    variance = (own - np.sum(across**2, axis=1))[:, None]
    log_mean = np.log(whole.likelihood.expected(*whole.seen(coordinate))[..., beam])
    distance = log_variance[:, None] - log_mean + 0.5 * own[:, None] - np.einsum("rds,rs->rd", residual, across)
    dof = likelihood.dof
    if np.isinf(dof):
        return np.asarray(-0.5 * (np.log(2.0 * np.pi * variance) + distance**2 / variance))
    more = dof + likelihood.n_datum[:, None]
    variance = variance * (dof + np.einsum("rds,rds->rd", residual, residual)) / more
    constant = (
        scipy.special.gammaln(0.5 * (more + 1.0))
        - scipy.special.gammaln(0.5 * more)
        - 0.5 * np.log(more * np.pi * variance)
    )
    return np.asarray(constant - 0.5 * (more + 1.0) * np.log1p(distance**2 / (more * variance)))
