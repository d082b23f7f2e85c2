"""The fit: from records and a noise model to the posterior of R for every record."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs import diagnostics
from bayes_rs._validation import FloatArray, as_generator, check_choice, check_count, check_non_negative
from bayes_rs.errors import InputError
from bayes_rs.likelihood import LogNormalLikelihood, log_normal_likelihood
from bayes_rs.noise import NoiseBank, NoiseModel, RecordNoise
from bayes_rs.prior import Prior, make_prior
from bayes_rs.progress import progress
from bayes_rs.result import FLAGS, RecordDraws, assemble
from bayes_rs.sampling import N_CHAIN, N_ENSEMBLE, RecordSampler
from bayes_rs.scan import Scan

TARGETS = ("record", "ensemble")
SAMPLERS = ("emcee",)
R_HAT_LIMIT = 1.05
"""Ensembles of a record that differ by more than this have not found the same posterior."""
_CHUNK = 256
"""Records that are sampled together; memory, not the result, depends on it."""
_CHUNK_NUMBERS = 4_000_000
"""Entries of the covariances of records that are sampled together: 32 MB an array."""
_LEAST_STEPS = 64
_PREDICT_EVERY = 16
"""One in so many draws gives a draw of the posterior predictive distribution."""


def fit(
    records: xr.Dataset,
    scan: Scan,
    *,
    noise: NoiseModel | NoiseBank,
    seed: int,
    prior: str | Prior = "weak",
    target: str = "record",
    sampler: str = "emcee",
    target_ess: int = 1000,
    max_extension: int = 5,
    instrument_noise: float = 0.0,
    show_progress: bool | None = None,
) -> xr.DataTree:
    """Sample the posterior of the Reynolds stress tensor of every record.

    Parameters
    ----------
    records : Dataset, dims (record, beam)
        From `make_records`: ``variance`` (m² s⁻²), ``flag``, and per record ``wind_speed`` (m/s) and ``yaw`` (degree).
    scan : Scan
        The scan that measured them.
    noise : NoiseModel or NoiseBank
        From `calibrate`, `theory_bank` or `load_noise`, made for this scan and record length. Each record gets the
        noise of its own wind speed and direction if the states of a bank form a net, and of its own ``length_scale``
        (m) and ``gamma`` if they hold them and the bank spans several. The attribute ``n_outside_noise`` of the
        result counts the records outside the bank, which use its edge.
    seed : int
        Seed. A record's draws depend on the seed and the record's start, not on the records beside it.
    prior : str or Prior
        ``"weak"``, ``"flat"``, or a prior with other parameters.
    target : str
        Which R: ``"record"``, the expected tensor of one averaging period with its own mean removed, or ``"ensemble"``,
        the tensor of an infinite record.
    sampler : str
        ``"emcee"``.
    target_ess : int
        Bulk effective sample size that every stress of every record should reach.
    max_extension : int
        How often a chain that is too short may be doubled. One that still misses the target is flagged.
    instrument_noise : float
        Variance that the instrument adds to each radial variance, m² s⁻².
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
        If records and scan do not belong together, or an argument is invalid.
    NoiseMismatchError
        If the noise was made for another scan or record length.

    Notes
    -----
    E[y_b] = n·R n (+ instrument noise), times 1 + bias_b for the ensemble target; the noise of y is log-normal with the
    noise model's relative covariance. See `LogNormalLikelihood`, `WeakPrior` and `RecordSampler`.
    """
    chosen_prior = make_prior(prior)
    check_choice(target, TARGETS, what="target")
    check_choice(sampler, SAMPLERS, what="sampler")
    check_count(target_ess, what="target_ess")
    check_count(max_extension, what="max_extension", minimum=0)
    check_non_negative(instrument_noise, what="instrument_noise", unit="m² s⁻²")
    as_generator(seed)
    scan = _checked_scan(records, scan)
    noise = noise.select(scan.beam)
    noise.check_scan(scan)
    _check_duration(records, noise)

    variance = np.asarray(records["variance"].values, dtype=np.float64)
    usable = (records["flag"].values == 0) & (variance > 0.0)
    wind_speed = np.asarray(records["wind_speed"].values, dtype=np.float64)
    yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64))
    fitted = np.flatnonzero(usable.any(axis=1) & (wind_speed > 0.0) & np.isfinite(yaw))
    keys = _stream_keys(records)
    outside = np.zeros(len(variance), dtype=np.bool_)

    def sample(chunk: NDArray[np.int64]) -> RecordDraws:
        at_record = _noise_of(noise, records, wind_speed, yaw, chunk)
        outside[chunk] = at_record.outside
        gain = at_record.gain
        if target == "ensemble":
            gain = gain * (1.0 + at_record.bias)[:, :, None]
        likelihood = log_normal_likelihood(
            variance[chunk], usable[chunk], gain, at_record.covariance, offset=instrument_noise
        )
        noise_factor = _symmetric_root(np.log1p(at_record.covariance), at_record.state)
        return _sample_chunk(
            likelihood, chosen_prior, int(seed), keys[chunk], target_ess, max_extension, noise_factor, usable[chunk]
        )

    size = int(np.clip(_CHUNK_NUMBERS // scan.n_beam**2, 1, _CHUNK))
    chunks = [fitted[start : start + size] for start in range(0, len(fitted), size)]
    draws = [sample(chunk) for chunk in progress(chunks, len(chunks), "sampling", disable=_disable(show_progress))]
    joined = _joined(draws) if draws else None
    return assemble(
        records,
        scan,
        noise,
        chosen_prior,
        fitted=fitted,
        usable=usable,
        draws=joined,
        flag=_result_flags(records, usable, fitted, joined, target_ess),
        attributes={
            "target": target,
            "sampler": sampler,
            "seed": int(seed),
            "target_ess": target_ess,
            "n_outside_noise": int(np.count_nonzero(outside)),
        },
    )


def _disable(show_progress: bool | None) -> bool | None:
    return None if show_progress is None else not show_progress


def _sample_chunk(
    likelihood: LogNormalLikelihood,
    prior: Prior,
    seed: int,
    keys: NDArray[np.int64],
    target_ess: int,
    max_extension: int,
    noise_factor: FloatArray,
    usable: NDArray[np.bool_],
) -> RecordDraws:
    """Sample records together; double the chains of those that miss the target until the budget is spent."""
    n_record = len(keys)
    # a whole number of thinning blocks: chains are halved when they are extended, and every sixteenth draw predicts
    n_draw = max(_LEAST_STEPS, _PREDICT_EVERY * -(-2 * target_ess // (N_CHAIN * _PREDICT_EVERY)))
    sampler = RecordSampler(likelihood, prior, seed, keys)
    everyone = np.arange(n_record)
    coordinate, acceptance = sampler.run(n_draw, everyone)
    n_step = np.full(n_record, n_draw)
    time = np.empty((n_record, 6))
    stress = prior.stress(coordinate)
    bulk, tail, hat = _diagnose(stress, time, everyone, stride=1)
    missing = everyone
    for extension in range(max_extension):
        missing = missing[(bulk[missing].min(axis=1) < target_ess) | (hat[missing].max(axis=1) > R_HAT_LIMIT)]
        if len(missing) == 0:
            break
        stride = 2 ** (extension + 1)
        more, more_acceptance = sampler.run(n_draw * stride // 2, missing)
        # one in two of the old draws (thinned to every stride/2 steps) and one in `stride` of the new ones
        new = more[:, :, stride - 1 :: stride]
        coordinate[missing] = np.concatenate([coordinate[missing][:, :, 1::2], new], axis=2)
        acceptance[missing] = 0.5 * (acceptance[missing] + more_acceptance)
        n_step[missing] = n_draw * stride
        stress[missing] = prior.stress(coordinate[missing])
        bulk[missing], tail[missing], hat[missing] = _diagnose(stress[missing], time, missing, stride)
    predicted = _predict(stress, likelihood, noise_factor, usable, sampler)
    return RecordDraws(stress, predicted, bulk, tail, hat, time, acceptance, n_step)


def _diagnose(
    stress: FloatArray, time: FloatArray, records: NDArray[np.int64], stride: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ESS (bulk, tail) and R-hat, shape (n, 6), of stresses (n, chain, draw, 6); fill the records' times."""
    by_component = np.moveaxis(stress, -1, 1)
    time[records] = diagnostics.autocorrelation_time(by_component) * stride
    return (
        diagnostics.ess_bulk(by_component),
        diagnostics.ess_tail(by_component),
        diagnostics.r_hat(by_component, N_ENSEMBLE),
    )


def _predict(
    stress: FloatArray,
    likelihood: LogNormalLikelihood,
    noise_factor: FloatArray,
    usable: NDArray[np.bool_],
    sampler: RecordSampler,
) -> FloatArray:
    """Draw radial variances from the posterior predictive distribution."""
    some = stress[:, :, _PREDICT_EVERY - 1 :: _PREDICT_EVERY]
    n_record, n_chain, n_some, _ = some.shape
    n_beam = likelihood.gain.shape[1]
    mean = some.reshape(n_record, -1, 6) @ likelihood.gain.swapaxes(-1, -2) + likelihood.offset[:, None, :]
    normal = sampler.streams.normal(np.arange(n_record), (n_chain * n_some, n_beam))
    half_variance = 0.5 * np.einsum("rbk,rbk->rb", noise_factor, noise_factor)
    log_noise = normal @ noise_factor.swapaxes(-1, -2) - half_variance[:, None, :]
    predicted = np.where(usable[:, None, :], mean * np.exp(log_noise), np.nan)
    return predicted.reshape(n_record, n_chain, n_some, n_beam)


def _symmetric_root(matrices: FloatArray, state: NDArray[np.int64]) -> FloatArray:
    """Return square roots of positive semi-definite matrices, one decomposition for each different state."""
    _, first, inverse = np.unique(state, return_index=True, return_inverse=True)
    values, vectors = np.linalg.eigh(matrices[first])
    # eigenvalues below zero are rounding: NoiseModel has refused anything more
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]
    return np.asarray(roots[inverse.reshape(-1)])


def _noise_of(
    noise: NoiseModel | NoiseBank,
    records: xr.Dataset,
    wind_speed: FloatArray,
    yaw: FloatArray,
    chunk: NDArray[np.int64],
) -> RecordNoise:
    """Return the noise of some records; of their own turbulence where they have one and the bank spans several."""
    if isinstance(noise, NoiseModel):
        return noise.for_records(wind_speed[chunk], yaw[chunk])
    own = {name: records[name].values[chunk] for name in ("length_scale", "gamma") if name in records}
    return noise.for_records(wind_speed[chunk], yaw[chunk], **own)


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


def _check_duration(records: xr.Dataset, noise: NoiseModel | NoiseBank) -> None:
    models = noise.models if isinstance(noise, NoiseBank) else (noise,)
    duration = float(records.attrs.get("duration", models[0].duration))
    if not np.isclose(duration, models[0].duration):
        raise InputError(
            f"The records last {duration:g} s and the noise is for records of {models[0].duration:g} s: "
            "calibrate the noise for the records' duration."
        )


def _stream_keys(records: xr.Dataset) -> NDArray[np.int64]:
    """Return what makes each record's random stream its own: its start, or its number where there is no time."""
    if "time" in records.coords and np.issubdtype(records["time"].dtype, np.datetime64):
        starts = records["time"].values.astype("datetime64[ns]").astype(np.int64)
        if len(np.unique(starts)) == len(starts):
            return starts
    return np.arange(records.sizes["record"], dtype=np.int64)


def _joined(draws: list[RecordDraws]) -> RecordDraws:
    names = RecordDraws.__dataclass_fields__
    return RecordDraws(**{name: np.concatenate([getattr(part, name) for part in draws]) for name in names})


def _result_flags(
    records: xr.Dataset,
    usable: NDArray[np.bool_],
    fitted: NDArray[np.int64],
    draws: RecordDraws | None,
    target_ess: int,
) -> NDArray[np.int64]:
    """Return one bit mask for each record; the bits are in `FLAGS`."""
    flag = np.zeros(len(usable), dtype=np.int64)
    flag[~usable.any(axis=1)] |= FLAGS["no_usable_beam"]
    flag[usable.any(axis=1) & ~usable.all(axis=1)] |= FLAGS["beam_left_out"]
    unfitted = np.setdiff1d(np.flatnonzero(usable.any(axis=1)), fitted)
    flag[unfitted] |= FLAGS["no_wind"]
    if "record_flag" in records:
        meanings = str(records["record_flag"].attrs.get("flag_meanings", "")).split()
        masks = np.atleast_1d(records["record_flag"].attrs.get("flag_masks", []))
        for meaning, mask in zip(meanings, masks, strict=True):
            if meaning == "yaw_not_seen":
                flag[(records["record_flag"].values & mask) != 0] |= FLAGS["yaw_not_seen"]
    if draws is not None:
        flag[fitted[draws.ess_bulk.min(axis=1) < target_ess]] |= FLAGS["short_chain"]
        flag[fitted[draws.r_hat.max(axis=1) > R_HAT_LIMIT]] |= FLAGS["ensembles_differ"]
    return flag
