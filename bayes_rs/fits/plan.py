"""What a long fit is asked for and what it does, checked before anything is written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice
from bayes_rs._version import __version__
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch, FitOptions
from bayes_rs.fits.digest import digest, digest_parts
from bayes_rs.fits.direction_table import prior_covariances, scan_directions
from bayes_rs.fits.draw_store import check_zarr
from bayes_rs.fits.fitting import can_be_fitted, fit_options, flags_before, prepare
from bayes_rs.fits.parts import Part, Shared
from bayes_rs.fits.result import N_PRIOR_DRAW, PRIOR_SEED, noise_summary
from bayes_rs.fits.summarizing import PriorOutline, check_summary_options
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_writing import scan_text
from bayes_rs.noise.noise import Noise
from bayes_rs.output import RUN_FILE
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors.registry import Prior

DRAWS = ("none", "float32", "float64", "zarr")
"""What is kept of the draws."""
LAYOUT = 2
"""Of the tables and of what is kept of the files that were read: a folder of another one is not gone on with."""
PART_RECORDS = 128
"""Records of a part: what is lost at most when a run is interrupted, for each worker."""
_NUMBERS_FROM = ("numpy", "scipy", "emcee")
"""Packages whose version can change a number."""


@dataclass(frozen=True, kw_only=True)
class CampaignOptions:
    """What `fit_campaign` is asked for beside data and noise, checked; the arguments are those of that name.

    Raises
    ------
    InputError
        If an option is not valid.
    MissingExtraError
        If draws are to go to Zarr, and that is not installed.
    """

    seed: int
    prior: str | Prior = "weak"
    target: str = "record"
    sampler: str = "auto"
    likelihood: str = "log-normal"
    nuisances: Nuisances | None = None
    target_ess: int = 1000
    max_extension: int = 5
    instrument_noise: float | str = 0.0
    prob: float = 0.9
    derived: Sequence[str] = ()
    draws: str = "none"

    def __post_init__(self) -> None:
        """Check all options."""
        check_summary_options(self.prob, self.derived)
        check_choice(self.draws, DRAWS, what="draws")
        if self.draws == "zarr":
            check_zarr()
        _ = self.of_fit

    @cached_property
    def of_fit(self) -> FitOptions:
        """Those of the fit itself, as its records take them."""
        return fit_options(
            self.prior,
            self.target,
            self.sampler,
            self.likelihood,
            self.nuisances,
            self.instrument_noise,
            self.target_ess,
            self.max_extension,
            self.seed,
        )

    def for_fit(self) -> dict[str, Any]:
        """Return the arguments of `bayes_rs.fit` by name."""
        own = ("prob", "derived", "draws")
        return {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name not in own}

    def for_key(self) -> dict[str, Any]:
        """Return what tells runs with other options apart, by name, for `digest_parts`."""
        of_fit = {entry.name: getattr(self.of_fit, entry.name) for entry in fields(self.of_fit)}
        own = ("instrument_noise", "prob", "derived", "draws")
        return {**of_fit, **{name: getattr(self, name) for name in own}, "layout_of_the_tables": LAYOUT}

    def for_run(self) -> dict[str, Any]:
        """Return what `run.json` says of the options."""
        of_fit, noise = self.of_fit, self.instrument_noise
        return {
            "prior": of_fit.prior.in_words(),
            "prior_option": self.prior if isinstance(self.prior, str) else None,
            "nuisances": of_fit.nuisances.in_words(),
            "target": self.target,
            "sampler": self.sampler,
            "likelihood": self.likelihood,
            "instrument_noise": noise if isinstance(noise, str) else float(noise),
            "seed": of_fit.seed,
            "target_ess": int(self.target_ess),
            "max_extension": int(self.max_extension),
            "prob": float(self.prob),
            "derived": list(self.derived),
            "draws": self.draws,
        }


@dataclass(frozen=True)
class CampaignPlan:
    """What a long fit does.

    Parameters
    ----------
    key : str
        Fingerprint of data, options and versions.
    key_parts : dict of str to str
        The fingerprints that it is made of, by what they are of.
    shared : Shared
        What all parts need.
    parts : list of Part
        The records, `PART_RECORDS` at a time.
    prior_draws : ndarray, shape (n, 6)
        Draws of the prior, m² s⁻².
    run : dict
        What `run.json` says of the options.
    """

    key: str
    key_parts: Mapping[str, str]
    shared: Shared
    parts: list[Part]
    prior_draws: FloatArray
    run: Mapping[str, Any]

    @property
    def n_record(self) -> int:
        """Number of records."""
        return sum(len(part.batch) for part in self.parts)

    @property
    def datasets(self) -> tuple[str, ...]:
        """The Parquet datasets."""
        return ("summary", "posterior", *(("draws",) if self.shared.draws in ("float32", "float64") else ()))


def plan_campaign(records: xr.Dataset, scan: Scan, noise: Noise, options: CampaignOptions) -> CampaignPlan:
    """Check that records, scan and noise belong together, and cut the records into parts.

    Raises
    ------
    InputError
        If they do not belong together.
    NoiseMismatchError
        If the noise was made for another scan.
    """
    of_fit = options.of_fit
    scan, noise, batch = prepare(
        records, scan, noise, instrument_noise=options.instrument_noise, nuisances=of_fit.nuisances
    )
    batch = replace(batch, used=batch.used & np.isfinite(batch.variance))
    parts = _parts(records, batch)
    described = [(part.record, part.time, part.flag) for part in parts]
    versions = number_versions()
    key_parts = digest_parts(
        version=__version__,
        packages=versions,
        scan=scan.key,
        noise=noise,
        records=[batch, described],
        part_records=PART_RECORDS,
        **options.for_key(),
    )
    key = digest(key_parts)
    prior_draws = of_fit.prior.draw(N_PRIOR_DRAW, PRIOR_SEED)
    weight, vectors = scan_directions(scan)
    shared = Shared(
        noise,
        of_fit,
        PriorOutline(prior_draws, options.derived),
        vectors,
        prior_covariances(prior_draws),
        options.prob,
        options.draws,
        scan.n_beam,
    )
    run = {
        "bayes_rs": __version__,
        "packages": versions,
        "key": key,
        "key_parts": key_parts,
        "scan": scan.name,
        "scan_key": scan.key,
        "scan_toml": scan_text(scan),
        "sight": sight(scan).in_words(),
        "directions": {"weight": weight.tolist(), "vectors": vectors.tolist()},
        "noise": noise_summary(noise),
        **options.for_run(),
        "n_record": len(batch),
    }
    return CampaignPlan(key, key_parts, shared, parts, prior_draws, run)


def _parts(records: xr.Dataset, batch: Batch) -> list[Part]:
    flag = flags_before(records, batch.used, can_be_fitted(batch))
    n_record = len(batch)
    number = np.arange(n_record)  # as in the result of `fit`
    start: NDArray[np.datetime64] = np.full(n_record, np.datetime64("NaT", "ns"))
    if "time" in records.coords:
        start = records["time"].values
        if np.issubdtype(start.dtype, np.datetime64):
            start = start.astype("datetime64[ns]")  # one type for all parts, and for records from any source
    slices = [slice(first, first + PART_RECORDS) for first in range(0, n_record, PART_RECORDS)]
    return [Part(i, batch.take(rows), number[rows], start[rows], flag[rows]) for i, rows in enumerate(slices)]


def number_versions() -> dict[str, str]:
    """Return the versions of the packages whose numbers are in the results."""
    return {name: version(name) for name in _NUMBERS_FROM}


def check_versions(output: str | Path) -> None:
    """Refuse to go on with a run that other versions of the packages began: numbers could differ within one result.

    Raises
    ------
    InputError
        If `run.json` in the folder names other versions.
    """
    try:
        found = json.loads((Path(output) / RUN_FILE).read_text(encoding="utf-8")).get("packages", {})
    except (OSError, ValueError, AttributeError):
        return  # not a folder of ours: `prepare_resumable_folder` says so
    for name, now in number_versions().items():
        if found.get(name, now) != now:
            raise InputError(
                f"Output folder {str(output)!r} is of a run with {name} {found[name]}, and this is {name} {now}, whose "
                f"numbers could differ: go on with {name} {found[name]}, give another name, or overwrite."
            )
