"""What a fit does, checked before anything is written: its parts, and what tells it from every other fit."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs._version import __version__
from bayes_rs.fits.batch import Batch
from bayes_rs.fits.columns import N_PRIOR_DRAW, PATTERN, VARIANCES
from bayes_rs.fits.digest import digest, digest_parts
from bayes_rs.fits.direction_table import prior_covariances, scan_directions
from bayes_rs.fits.fit_options import MOST_KEPT, FitOptions
from bayes_rs.fits.flags import FLAGS, flags_before
from bayes_rs.fits.more_draws import expected_times, most_draws
from bayes_rs.fits.noise_choice import about_probe
from bayes_rs.fits.parts import Part, Shared, batch_size, n_kept
from bayes_rs.fits.prepare import can_be_fitted, is_all_noise, prepare
from bayes_rs.fits.record_beams import RecordBeams, record_beams
from bayes_rs.geometry.forward import design_matrix, sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_writing import scan_text
from bayes_rs.noise.noise import Noise
from bayes_rs.options import to_plain
from bayes_rs.posteriors.decided import PriorRoom, leading_variance
from bayes_rs.posteriors.sampling.chains import BLOCK, N_CHAIN
from bayes_rs.records.belief import doubt_lines
from bayes_rs.sizes import check_size, check_work

LAYOUT = 7
"""Version of the on-disk layout. A folder with another version cannot be resumed."""
PART_RECORDS = 128
"""Records of a part: what each worker loses at most when a run is interrupted."""
LONG_FIT, LONG_PART = 20_000, 8
"""Records from which on parts are so many times as long: a million records are then a few thousand files."""
PRIOR_SEED = 0
_COPIES_SAMPLED, _COPIES_KEPT, _SECONDS_A_DRAW = 12.0, 3.0, 1e-5
_NUMBERS_FROM = ("numpy", "scipy", "emcee")
"""Packages whose version can change a number."""


@dataclass(frozen=True)
class Plan:
    """What a fit does.

    Parameters
    ----------
    key_parts : dict of str to str
        Fingerprints of data, options and versions, by what they are of.
    shared : Shared
        What all parts need.
    parts : list of Part
        The records, `part_size` at a time.
    prior_draws : ndarray, shape (n, 6)
        Draws of the prior, m² s⁻².
    scan : Scan
        The scan, with the records' beams only.
    records : Dataset
        The records.
    run : dict
        What `run.json` says of all this.
    """

    key_parts: Mapping[str, str]
    shared: Shared
    parts: list[Part]
    prior_draws: FloatArray
    scan: Scan
    records: xr.Dataset
    run: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Fingerprint of data, options and versions."""
        return digest(dict(self.key_parts))

    @property
    def n_record(self) -> int:
        """Number of records."""
        return sum(len(part.batch) for part in self.parts)

    @property
    def datasets(self) -> tuple[str, ...]:
        """Names of the tables that every part has."""
        alone = (VARIANCES, PATTERN) if self.shared.alone else ()
        return ("summary", "posterior", *alone, *(("draws", "predicted") if self.shared.keep_draws else ()))


def plan_fit(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    options: FitOptions,
    *,
    inputs: Mapping[str, Any],
    in_folder: bool = False,
    like: Plan | None = None,
) -> Plan:
    """Check that records, scan and noise belong together, and cut the records into parts.

    `inputs` is what the records and the noise were made of, by name: it tells the fit from others. Draws that go to a
    folder are not in memory together. Of a plan that is `like` this one, of the same options and beams, the numbers of
    the prior are taken: they are not made anew.

    Raises
    ------
    InputError
        If they do not belong together.
    NoiseMismatchError
        If the noise was made for another scan.
    """
    scan, noise, batch = prepare(records, scan, noise, options)
    check_draws(len(batch), noise.n_beam, options, in_folder=in_folder)
    beams = record_beams(records, scan, noise, batch, options)
    size = part_size(len(batch), options)
    parts = _parts(records, batch, beams, size, options)
    key_parts = digest_parts(
        **version_parts(),
        scan=scan.key,
        **inputs,
        part_records=size,
        **option_parts(options),
    )
    prior = options.made_prior
    weight, vectors = scan_directions(scan)
    level = design_matrix(scan.at_yaw(0.0))
    if like is not None and like.shared.options is options and like.scan.key == scan.key:
        prior_draws, widths = like.prior_draws, like.run["prior_widths"]
        room, covariances = like.shared.room, like.shared.prior_covariances
    else:
        prior_draws = prior.draw(N_PRIOR_DRAW, PRIOR_SEED)
        widths = [float(width) for width in prior.interval_widths(options.prob, options.interval)]
        room, covariances = PriorRoom.of(prior_draws, leading_variance(level)), prior_covariances(prior_draws)
    shared = Shared(
        noise=noise,
        options=options,
        room=room,
        level=level,
        vectors=vectors,
        prior_covariances=covariances,
        keep_draws=options.keeps_draws(len(batch)),
        beam=scan.beam,
        alone=batch.pairs is not None,
    )
    run = {
        **software(),
        "settings": {"fit": plain_options(options)},
        "scan": scan.name,
        "scan_key": scan.key,
        "scan_toml": scan_text(scan),
        "sight": sight(scan).in_words(),
        "directions": {"weight": weight.tolist(), "vectors": vectors.tolist()},
        "noise": noise_summary(noise),
        "probe_volume": about_probe(noise, records),
        "prior": prior.in_words(),
        "prior_name": prior.name,
        "prior_widths": widths,
        "length_scale": json.loads(records.attrs.get("length_scale_report", "null")),
        "instrument_noise": json.loads(records.attrs.get("instrument_noise_report", "null")),
        "nuisances": options.nuisances.in_words(),
        "nuisance_names": list(options.nuisances.names),
        "doubts": doubt_lines(records),
        "n_record": len(batch),
        "part_records": size,
        "n_chain": N_CHAIN,
        "n_draw": n_kept(options),
        "n_predicted": n_kept(options) // BLOCK,
        "beams": beams.numbers,
    }
    return Plan(key_parts, shared, parts, prior_draws, scan, records, run)


def of_last_record(plan: Plan) -> Plan:
    """Return the plan of the last record alone, as it was prepared among the others."""
    part, last = plan.parts[-1], slice(-1, None)
    one = Part(
        0,
        part.batch.take(last),
        np.zeros(1, dtype=part.record.dtype),
        part.time[last],
        part.flag[last],
        {name: values[last] for name, values in part.known.items()},
    )
    shared = replace(plan.shared, keep_draws=plan.shared.options.keeps_draws(1))
    run = {**plan.run, "n_record": 1}
    return replace(plan, shared=shared, parts=[one], records=plan.records.isel(record=last), run=run)


def part_size(n_record: int, options: FitOptions) -> int:
    """Return how many records a part has: more in a long fit, unless draws are kept, which are many times as large."""
    return PART_RECORDS * (1 if n_record < LONG_FIT or options.keeps_draws(n_record) else LONG_PART)


def with_settings(plan: Plan, **sections: Any) -> Plan:
    """Return a plan whose run says what else it depended on, section by section."""
    return replace(plan, run={**plan.run, "settings": {**sections, **plan.run["settings"]}})


def check_draws(n_record: int, n_beam: int, options: FitOptions, *, in_folder: bool = False) -> None:
    """Refuse so many draws of so many records that no memory holds them, or no one waits for them.

    In a folder they are written part by part, and those of up to `MOST_KEPT` records once more, together.

    Raises
    ------
    InputError
        If there are too many.
    """
    n_byte = 48.0 * N_CHAIN * n_kept(options)  # of a record: six stresses of each draw
    together = max(min(n_record, batch_size(n_beam)), 1.0 if options.monte_carlo_error is None else most_draws(options))
    kept = n_record if options.keeps_draws(n_record) and (n_record <= MOST_KEPT or not in_folder) else together
    what = f"The draws of {n_record} records with target_ess {options.target_ess}"
    advice = "choose a smaller target_ess (--ess), 1000 is usual, or keep no draws (--draws none)."
    check_size(what, n_byte * (_COPIES_SAMPLED * together + _COPIES_KEPT * kept), advice)
    check_work(what, _SECONDS_A_DRAW * n_record * N_CHAIN * n_kept(options) * expected_times(options), advice)


def plain_options(options: FitOptions) -> dict[str, Any]:
    """Return the options as `run.json` holds them; a prior that is an object of Python is null there."""
    if isinstance(options.prior, str):
        return to_plain(options)
    return {**to_plain(replace(options, prior="weak")), "prior": None}


def version_parts() -> dict[str, Any]:
    """Return what of the software tells fits apart, for `digest_parts`."""
    return {"version": __version__, **number_versions(), "layout_of_the_tables": LAYOUT}


def option_parts(options: FitOptions) -> dict[str, Any]:
    """Return what tells fits with other options apart, by name, for `digest_parts`."""
    parts = {name: getattr(options, name) for name in options.__dataclass_fields__}
    return {**parts, "prior": options.made_prior}


def number_versions() -> dict[str, str]:
    """Return the versions of the packages whose numbers are in the results."""
    return {name: _version_of(name, version) for name in _NUMBERS_FROM}


@cache
def _version_of(package: str, look_up: Callable[[str], str]) -> str:
    return look_up(package)  # in the package's files


def software() -> dict[str, Any]:
    """Return what `run.json` says of the software."""
    return {
        "bayes_rs": __version__,
        "python": platform.python_version(),
        "packages": {
            **number_versions(),
            "xarray": _version_of("xarray", version),
            "pandas": _version_of("pandas", version),
        },
    }


def noise_summary(noise: Noise) -> dict[str, Any]:
    """Return which noise it is, as plain numbers and texts."""
    realizations = float(noise.n_realizations[0])
    return {
        "method": noise.method,
        "turbulence": noise.turbulence.name,
        "length_scales": sorted({round(float(scale), 6) for scale in noise.length_scale}),
        "gammas": sorted({round(float(gamma), 6) for gamma in noise.gamma}),
        "duration": noise.duration,
        "wind_speeds": sorted({round(float(speed), 6) for speed in noise.wind_speed}),
        "yaws_deg": sorted({round(float(np.rad2deg(yaw)), 6) for yaw in noise.yaw}),
        "n_realizations": realizations if np.isfinite(realizations) else None,
    }


def _parts(records: xr.Dataset, batch: Batch, beams: RecordBeams, size: int, options: FitOptions) -> list[Part]:
    flag = flags_before(records, batch.used, can_be_fitted(batch)) | FLAGS["beams_disagree"] * beams.disagree
    flag |= FLAGS["noise_above_variance"] * is_all_noise(records, options)
    number = np.arange(len(batch))
    start = starts(records)
    slices = [slice(first, first + size) for first in range(0, len(batch), size)]
    return [
        Part(i, batch.take(rows), number[rows], start[rows], flag[rows], beams.columns(rows))
        for i, rows in enumerate(slices)
    ]


def starts(records: xr.Dataset) -> NDArray[np.datetime64]:
    """Return the starts of records, shape (n_record,), in one type from any source; NaT where there is no time."""
    if "time" in records.coords and np.issubdtype(records["time"].dtype, np.datetime64):
        return np.asarray(records["time"].values.astype("datetime64[ns]"))
    return np.full(records.sizes["record"], np.datetime64("NaT", "ns"))
