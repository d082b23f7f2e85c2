"""The fit: from records and a noise model to the posterior of R for every record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_generator, check_choice, check_count, check_non_negative
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, FitOptions, RecordDraws, fit_batch, join_draws
from bayes_rs.fits.result import FLAGS, assemble
from bayes_rs.geometry.attitude import gain_turn
from bayes_rs.geometry.scan import Scan
from bayes_rs.likelihoods.log_normal import LIKELIHOODS
from bayes_rs.noise.model import Noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.sampling import SAMPLERS
from bayes_rs.posteriors.sampling.chains import PARETO_K_LIMIT, R_HAT_LIMIT
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.progress import progress

TARGETS = ("record", "ensemble", "sonic")
MISFIT_LIMIT = 3.0
"""A beam whose log-variance is so many standard deviations from what the posterior predicts contradicts the model."""
_SAME_FLOW = 0.01
"""Relative difference of L or Γ that counts as none: it changes K by about as much as a bank's interpolation."""
_CHUNK = 256
"""Records that are sampled together; memory, not the result, depends on it."""
_CHUNK_NUMBERS = 4_000_000
"""Entries of the covariances of records that are sampled together: 32 MB an array."""


def fit(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise: Noise,
    seed: int,
    prior: str | Prior = "weak",
    target: str = "record",
    sampler: str = "emcee",
    likelihood: str = "log-normal",
    nuisances: Nuisances | None = None,
    target_ess: int = 1000,
    max_extension: int = 5,
    instrument_noise: float | str = 0.0,
    show_progress: bool | None = None,
) -> xr.DataTree:
    """Sample the posterior of the Reynolds stress tensor of every record.

    Parameters
    ----------
    records : Dataset, dims (record, beam)
        From `make_records`: ``variance`` (m² s⁻²), ``flag``, and per record ``wind_speed`` (m/s) and ``yaw`` (degree).
        Where `with_motion` gave them a tilt and roll of their own, the beams point as these say. Where nuisances
        ask for it, also ``yaw_sd`` (degree), as from `mean_wind`.
    scan : Scan
        The scan that measured them.
    noise : NoiseModel or NoiseBank
        From `calibrate`, `theory_bank` or `load_noise`, made for this scan and record length. Each record gets the
        noise of its own wind speed and direction if the states of a bank form a net, and of its own ``length_scale``
        (m) and ``gamma`` if they hold them: then the bank must span several, unless that which it knows is theirs,
        to a per cent. The attribute ``n_outside_noise`` of the result counts the records outside the bank, which use
        its edge.
    seed : int
        Seed. A record's draws depend on the seed and the record's start, not on the records beside it.
    prior : str or Prior
        ``"weak"``, ``"flat"``, or a prior with other parameters.
    target : str
        Which R: ``"record"``, the expected tensor of one averaging period with its own mean removed; ``"ensemble"``,
        the tensor of an infinite record; or ``"sonic"``, the tensor that a sonic at the rotor's centre (at the lidar)
        would have measured in this very record, its own mean removed. The last needs noise made with ``sonic=True`` and
        the log-normal likelihood; the attribute ``sonic_clipped`` of the result is the largest share of a covariance
        that was clipped for it (`bayes_rs.posteriors.sonic.CLIP_LIMIT`).
    sampler : str
        ``"emcee"``: one emcee ensemble for many records, driven by proposals fitted to each. ``"direct"``: independent
        draws of such proposals, weighted and resampled; the quickest. ``"auto"``: direct, and emcee for the records
        whose weights are too uneven for that. All give the same posterior. Or the name of a sampler of your own in
        `bayes_rs.posteriors.sampling.SAMPLERS`.
    likelihood : str
        ``"log-normal"``, the distribution of the variances, or the name of one of your own in
        `bayes_rs.likelihoods.log_normal.LIKELIHOODS`.
    nuisances : Nuisances, optional
        What is uncertain beside R: yaw, tilt, instrument noise, gradients of R over the scanned area, length scale,
        inflation of the noise.
    target_ess : int
        Bulk effective sample size that every stress of every record should reach.
    max_extension : int
        How often a chain that is too short may be doubled. One that still misses the target is flagged.
    instrument_noise : float or str
        Variance that the instrument adds to each radial variance, m² s⁻²; or ``"records"``, the ``instrument_noise``
        (record, beam) of the records, as from `with_instrument_noise`. Beams whose variance is not above it are left
        out and flagged.
    show_progress : bool, optional
        Progress bar on stderr; by default only on a terminal.

    Returns
    -------
    result : DataTree
        Groups ``posterior`` (``stress`` with dims chain, draw, record, component), ``prior``,
        ``posterior_predictive``, ``observed_data`` and ``sample_stats``; `xarray` and ArviZ read it as it is. Records
        that could not be fitted stay in it, as NaN and flagged.

    Raises
    ------
    InputError
        If records and scan do not belong together, the noise is for another record length or knows another length
        scale than the records', or an argument is invalid.
    NoiseMismatchError
        If the noise was made for another scan.

    Notes
    -----
    E[y_b] = g_b·R (+ instrument noise), where g_b·R = n·R n for points, times 1 + bias_b for the ensemble target. By
    default the noise of y is log-normal, with the noise model's relative covariance. See `LogNormalLikelihood`,
    `WeakPrior` and `RecordSampler`.

    For the target ``"sonic"``, R of the record is sampled first; the prior, and the contraction against it, are those
    of R. Then each draw of R gets one tensor S of the sonic, which scatters about R and together with the beams
    (`SonicFactor`). S is what the group ``posterior`` holds, and what ESS and R-hat are of (`draw_sonic`).
    """
    options = fit_options(
        prior, target, sampler, likelihood, nuisances, instrument_noise, target_ess, max_extension, seed
    )
    scan, noise, batch = prepare(records, scan, noise, instrument_noise=instrument_noise, nuisances=options.nuisances)
    fitted = can_be_fitted(batch)
    flag = flags_before(records, batch.used, fitted)
    size = batch_size(scan.n_beam)
    chunks = [fitted[start : start + size] for start in range(0, len(fitted), size)]
    draws = [
        fit_batch(batch.take(chunk), noise, options)
        for chunk in progress(chunks, len(chunks), "sampling", disable=_disable(show_progress))
    ]
    joined = join_draws(draws) if draws else None
    if joined is not None:
        flag[fitted] |= flags_after(joined, target_ess)
    return assemble(
        records,
        scan,
        noise,
        options.prior,
        fitted=fitted,
        usable=batch.used,
        draws=joined,
        flag=flag,
        yaw_sd=batch.yaw_sd,
        attributes={
            "target": target,
            "sampler": sampler,
            "likelihood": likelihood,
            "nuisances": options.nuisances.in_words(),
            "instrument_noise": instrument_noise if isinstance(instrument_noise, str) else float(instrument_noise),
            "seed": int(seed),
            "target_ess": target_ess,
            "n_outside_noise": 0 if joined is None else int(np.count_nonzero(joined.outside)),
            **({"sonic_clipped": 0.0 if joined is None else float(joined.clipped.max())} if target == "sonic" else {}),
        },
    )


def can_be_fitted(batch: Batch) -> NDArray[np.int64]:
    """Return the numbers of the records that have a usable beam, a wind speed and a direction."""
    return np.flatnonzero(batch.used.any(axis=1) & (batch.wind_speed > 0.0) & np.isfinite(batch.yaw))


def batch_size(n_beam: int) -> int:
    """Return how many records are sampled together."""
    return int(np.clip(_CHUNK_NUMBERS // n_beam**2, 1, _CHUNK))


def prepare(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    *,
    instrument_noise: float | str = 0.0,
    nuisances: Nuisances | None = None,
) -> tuple[Scan, Noise, Batch]:
    """Check that records, scan and noise belong together; return scan and noise of the records' beams, and the data.

    Raises
    ------
    InputError
        If they do not belong together.
    NoiseMismatchError
        If the noise was made for another scan.
    """
    scan = _checked_scan(records, scan)
    noise = noise.select(scan.beam)
    noise.check_scan(scan)
    _check_duration(records, noise)
    uncertain = Nuisances() if nuisances is None else nuisances
    _check_flow(records, noise, uncertain)
    variance = np.asarray(records["variance"].values, dtype=np.float64)
    used = (records["flag"].values == 0) & (variance > 0.0) & np.isfinite(variance)
    own_noise = _own_noise(records, used) if isinstance(instrument_noise, str) else None
    batch = Batch(
        variance,
        used if own_noise is None else used & (variance > own_noise),
        np.asarray(records["wind_speed"].values, dtype=np.float64),
        np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64)),
        _stream_keys(records),
        {name: np.asarray(records[name].values) for name in ("length_scale", "gamma") if name in records},
        gain_turn(records, scan),
        own_noise,
    )
    if uncertain.yaw_sd_of_records:
        batch = replace(batch, yaw_sd=_own_yaw_sd(records, can_be_fitted(batch), uncertain.yaw_sd_missing_deg))
    return scan, noise, batch


def fit_options(
    prior: str | Prior,
    target: str,
    sampler: str,
    likelihood: str,
    nuisances: Nuisances | None,
    instrument_noise: float | str,
    target_ess: int,
    max_extension: int,
    seed: int,
) -> FitOptions:
    """Check the options of a fit."""
    chosen = make_prior(prior)
    check_choice(target, TARGETS, what="target")
    check_choice(sampler, tuple(SAMPLERS), what="sampler")
    check_choice(likelihood, tuple(LIKELIHOODS), what="likelihood")
    if target == "sonic" and likelihood != "log-normal":
        raise InputError(
            f"Invalid likelihood {likelihood!r} for the target 'sonic': only for 'log-normal' is it known how the "
            "sonic and the beams scatter together."
        )
    check_count(target_ess, what="target_ess")
    check_count(max_extension, what="max_extension", minimum=0)
    if isinstance(instrument_noise, str):
        check_choice(instrument_noise, ("records",), what="instrument_noise")
    else:
        check_non_negative(instrument_noise, what="instrument_noise", unit="m² s⁻²")
    as_generator(seed)
    uncertain = Nuisances() if nuisances is None else nuisances
    if uncertain.instrument_noise_log_sd > 0.0 and instrument_noise == 0.0:
        raise InputError(
            "Invalid instrument_noise 0: its logarithm is to be uncertain, so its median must be above 0 m² s⁻²."
        )
    return FitOptions(
        prior=chosen,
        target=target,
        sampler=sampler,
        likelihood=likelihood,
        nuisances=uncertain,
        instrument_noise=0.0 if isinstance(instrument_noise, str) else float(instrument_noise),
        target_ess=target_ess,
        max_extension=max_extension,
        seed=int(seed),
    )


def _disable(show_progress: bool | None) -> bool | None:
    return None if show_progress is None else not show_progress


def _checked_scan(records: xr.Dataset, scan: Scan) -> Scan:
    """Check the records and return the scan with only the beams that they hold."""
    for name, dims in (
        ("variance", ("record", "beam")),
        ("flag", ("record", "beam")),
        ("wind_speed", ("record",)),
        ("yaw", ("record",)),
    ):
        if name not in records or records[name].dims != dims:
            raise InputError(f"The records have no {name} with dims {dims}: make them with bayes_rs.make_records.")
    if records.sizes["record"] == 0:
        raise InputError("There is no record: the series is shorter than one averaging period.")
    return scan.select(records["beam"].values)


def _own_noise(records: xr.Dataset, used: NDArray[np.bool_]) -> FloatArray:
    """Return the instrument's noise that the records hold, shape (n_record, n_beam), m² s⁻²."""
    if "instrument_noise" not in records or records["instrument_noise"].dims != ("record", "beam"):
        raise InputError(
            "The records have no instrument_noise with dims ('record', 'beam'): add it with with_instrument_noise, or "
            "give a number as instrument_noise."
        )
    own = np.asarray(records["instrument_noise"].values, dtype=np.float64)
    bad = np.argwhere(used & ~(np.isfinite(own) & (own >= 0.0)))
    if len(bad):
        record, beam = (int(i) for i in bad[0])
        raise InputError(
            f"Invalid instrument_noise {own[record, beam]} m² s⁻² of record {record}, beam "
            f"{records['beam'].values[beam]}: it must be finite, zero or above; with_instrument_noise makes it so."
        )
    return np.where(used, own, 0.0)


def _own_yaw_sd(records: xr.Dataset, fitted: NDArray[np.int64], missing_deg: float | None) -> FloatArray:
    """Return how uncertain the records say that their directions are, shape (n_record,), degrees."""
    if "yaw_sd" not in records or records["yaw_sd"].dims != ("record",):
        raise InputError(
            "The records have no yaw_sd with dims ('record',): add it with mean_wind(records, scan, turbulence=...), "
            "or give a number as yaw_sd_deg."
        )
    own = np.asarray(records["yaw_sd"].values, dtype=np.float64)
    if missing_deg is not None:
        own = np.where(np.isnan(own), missing_deg, own)
    bad = fitted[~(np.isfinite(own[fitted]) & (own[fitted] >= 0.0))]
    if len(bad):
        start = f" ({str(records['time'].values[bad[0]])[:16]})" if "time" in records.coords else ""
        raise InputError(
            f"Invalid yaw_sd {own[bad[0]]} degrees of record {bad[0]}{start}, one of {len(bad)}: it must be finite, "
            "zero or above; give yaw_sd_missing_deg (--yaw-sd-missing) for these, or one yaw_sd_deg (--yaw-sd) for all."
        )
    return own


def _check_flow(records: xr.Dataset, noise: Noise, nuisances: Nuisances) -> None:
    """Refuse records with a turbulence of their own that the noise would leave aside."""
    averaged = nuisances.length_scale_log_sd > 0.0
    for name, unit, remedy in (
        ("length_scale", " m", "noise_for_records(..., length_scale=[shortest, longest])"),
        ("gamma", "", "theory_bank(..., gamma=[lowest, highest])"),
    ):
        known = np.array([getattr(model.turbulence, name) for model in noise.models])
        if name not in records or np.ptp(known) > 0.0 or (averaged and name == "length_scale"):
            continue
        own = np.asarray(records[name].values, dtype=np.float64)
        other = np.flatnonzero(np.abs(own - known[0]) > _SAME_FLOW * known[0])
        if len(other):
            raise InputError(
                f"Record {other[0]} has a {name} of its own, {own[other[0]]:.3g}{unit}, and the noise knows only "
                f"{known[0]:.3g}{unit}: make it with {remedy}, or leave it out with records.drop_vars({name!r})."
            )


def _check_duration(records: xr.Dataset, noise: Noise) -> None:
    duration = float(records.attrs.get("duration", noise.duration))
    if not np.isclose(duration, noise.duration):
        raise InputError(
            f"The records last {duration:g} s and the noise is for records of {noise.duration:g} s: "
            "calibrate the noise for the records' duration."
        )


def _stream_keys(records: xr.Dataset) -> NDArray[np.int64]:
    """Return what makes each record's random stream its own: its start, or its number where there is no time."""
    if "time" in records.coords and np.issubdtype(records["time"].dtype, np.datetime64):
        starts = records["time"].values.astype("datetime64[ns]").astype(np.int64)
        if len(np.unique(starts)) == len(starts):
            return starts
    return np.arange(records.sizes["record"], dtype=np.int64)


def flags_before(records: xr.Dataset, usable: NDArray[np.bool_], fitted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what the records themselves say, as one bit mask for each; the bits are in `FLAGS`."""
    flag = np.zeros(len(usable), dtype=np.int64)
    excluded = ~usable.any(axis=1) & _is_excluded(records)
    flag[excluded] |= FLAGS["excluded"]
    flag[~usable.any(axis=1) & ~excluded] |= FLAGS["no_usable_beam"]
    flag[usable.any(axis=1) & ~usable.all(axis=1)] |= FLAGS["beam_left_out"]
    unfitted = np.setdiff1d(np.flatnonzero(usable.any(axis=1)), fitted)
    flag[unfitted] |= FLAGS["no_wind"]
    if "record_flag" in records:
        meanings = str(records["record_flag"].attrs.get("flag_meanings", "")).split()
        masks = np.atleast_1d(records["record_flag"].attrs.get("flag_masks", []))
        for meaning, mask in zip(meanings, masks, strict=True):
            if meaning in ("yaw_not_seen", "not_stationary", "low_wind"):
                flag[(records["record_flag"].values & mask) != 0] |= FLAGS[meaning]
    return flag


def _is_excluded(records: xr.Dataset) -> NDArray[np.bool_]:
    """Say which records the rules of quality took out."""
    if "flag" not in records:
        return np.zeros(records.sizes["record"], dtype=np.bool_)
    meanings = str(records["flag"].attrs.get("flag_meanings", "")).split()
    masks = dict(zip(meanings, np.atleast_1d(records["flag"].attrs.get("flag_masks", [])).tolist(), strict=True))
    return np.asarray(((records["flag"].values & masks.get("record_excluded", 0)) != 0).any(axis=1))


def flags_after(draws: RecordDraws, target_ess: int) -> NDArray[np.int64]:
    """Return what the draws of fitted records say, as one bit mask for each."""
    chains = draws.chains
    flag = np.zeros(len(chains.stress), dtype=np.int64)
    flag[~(chains.ess_bulk.min(axis=1) >= target_ess)] |= FLAGS["short_chain"]
    flag[~(chains.r_hat.max(axis=1) <= R_HAT_LIMIT)] |= FLAGS["ensembles_differ"]
    flag[chains.pareto_k > PARETO_K_LIMIT] |= FLAGS["weights_uneven"]
    flag[draws.misfit > MISFIT_LIMIT] |= FLAGS["contradicts_model"]
    return flag
