"""The instrument's noise of records: what they hold, or what their octaves tell, with what is said of it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, check_choice, check_non_negative
from bayes_rs.spectra.octave_likelihood import Octaves, averaged, log_sum
from bayes_rs.spectra.octave_theory import length_nodes
from bayes_rs.spectra.pooled_noise import SHAPE_ERROR, TELLS, PooledNoise, pool_noise

NOISE, NOISE_SD = "instrument_noise", "instrument_noise_sd"
NOISE_COMMON_SD = "instrument_noise_common_sd"
"""Variable of records: the part of the standard deviation that is the same error in all of them."""
NOISE_REPORT = "instrument_noise_report"
"""Attribute of records, JSON, that says what their octaves tell of the instrument's noise."""
_RECORDS = 2000  # at a time
_FEW = 20  # records whose distribution of L is hardly more than each one's own


def known_noise(records: xr.Dataset, instrument_noise: float | str) -> FloatArray | None:
    """Return the instrument's noise in each record, (n_record,), m² s⁻²; None if it is to be told by the records."""
    if not isinstance(instrument_noise, str):
        return np.full(
            records.sizes["record"], check_non_negative(instrument_noise, what="instrument_noise", unit="m² s⁻²")
        )
    check_choice(instrument_noise, ("records",), what="instrument_noise")
    if NOISE not in records:
        return None
    return mean_of_used(records, NOISE)


def mean_of_used(records: xr.Dataset, name: str) -> FloatArray:
    """Return the mean of a variable over each record's used beams, (n_record,); 0 where there are none."""
    own: FloatArray = np.asarray(records[name].values, dtype=np.float64)
    used = (records["flag"].values == 0) & np.isfinite(own)
    count = np.maximum(np.count_nonzero(used, axis=1), 1)
    return np.asarray(np.sum(np.where(used, own, 0.0), axis=1) / count)


def noise_words(records: xr.Dataset) -> str:
    """Say in one line which instrument noise records have, and where it comes from; empty if nothing is known of it."""
    if NOISE_REPORT in records.attrs:
        return str(json.loads(records.attrs[NOISE_REPORT])["words"])
    if NOISE not in records:
        return ""
    noise, variance = mean_of_used(records, NOISE), mean_of_used(records, "variance")
    known = variance > 0.0
    if not known.any():
        return ""
    return (
        f"instrument noise of the records' own: {np.sqrt(np.median(noise[known])):.2g} m/s, "
        f"{100.0 * np.median(noise[known] / variance[known]):.1f} % of the variance; it is taken off"
    )


def nothing_told(records: xr.Dataset) -> xr.Dataset:
    """Return records that say that they tell nothing of the instrument's noise."""
    return records.assign_attrs({NOISE_REPORT: json.dumps({"told": False, "words": _in_words({"told": False})})})


@dataclass(frozen=True, eq=False)
class ToldNoise:
    """What octaves tell of the instrument's noise in records: nodes of its share of the variance, and their weights.

    Parameters
    ----------
    rows : ndarray of int
        Numbers of the records whose octaves are looked at.
    octaves : Octaves
        Of these.
    pooled : PooledNoise
        What they say together.
    prior : tuple of float
        Median and standard deviation of ln L a priori, m and 1.
    """

    rows: NDArray[np.int64]
    octaves: Octaves
    pooled: PooledNoise
    prior: tuple[float, float]

    @classmethod
    def of(cls, rows: NDArray[np.int64], octaves: Octaves, prior: tuple[float, float]) -> ToldNoise:
        """Return what the octaves of records tell."""
        return cls(rows, octaves, pool_noise(octaves, median=prior[0], log_sd=prior[1]), prior)

    def _blocks(self) -> Iterable[tuple[slice, FloatArray, FloatArray, FloatArray]]:
        """Give some records at a time: shares, logarithms of their weights, and the log-likelihood there."""
        return self._few if len(self.rows) <= _RECORDS else self._all()

    @cached_property
    def _few(self) -> list[tuple[slice, FloatArray, FloatArray, FloatArray]]:
        return list(self._all())

    def _all(self) -> Iterator[tuple[slice, FloatArray, FloatArray, FloatArray]]:
        share, log_weight = self.pooled.nodes()
        for first in range(0, len(self.rows), _RECORDS):
            some = slice(first, first + _RECORDS)
            yield some, share[some], log_weight, self.octaves.take(some).log_likelihood(share[some])

    def of_length(self) -> FloatArray:
        """Return the log-likelihood of ln L, averaged over the noise, (n_record, n_length)."""
        parts = [averaged(density, log_weight) for _, _, log_weight, density in self._blocks()]
        return np.concatenate(parts) if parts else np.zeros((0, len(length_nodes())))

    def _of_records(self, records: xr.Dataset, report: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of the share of each record."""
        speed = np.asarray(records["wind_speed"].values, dtype=np.float64)[self.rows]
        centre, width = np.full(len(speed), np.log(self.prior[0])), self.prior[1]
        if report["n_told"] >= _FEW:
            centre = np.log(report["length_scale"]) + report["slope"] * np.log(speed / report["wind_speed"])
            width = float(np.hypot(report["spread"], report["log_sd"]))
        mean, sd = np.empty(len(speed)), np.empty(len(speed))
        for some, share, log_prior, density in self._blocks():
            log_length = -0.5 * ((length_nodes() - centre[some, np.newaxis]) / width) ** 2
            log_weight = log_prior + log_sum(density + log_length[:, np.newaxis])
            weight = np.exp(log_weight - log_sum(log_weight)[:, np.newaxis])
            mean[some] = np.sum(weight * share, axis=1)
            sd[some] = np.sqrt(np.sum(weight * (share - mean[some, np.newaxis]) ** 2, axis=1))
        return mean, sd

    def given_to(self, records: xr.Dataset, length_report: dict[str, Any]) -> xr.Dataset:
        """Return records with length scales with the noise, too, where they tell it, and words on it."""
        share, sd = self._of_records(records, length_report)
        middle, middle_sd = float(np.median(share)), float(np.median(sd))
        report: dict[str, Any] = {
            "told": middle_sd < max(TELLS, 0.5 * middle),
            "share": middle,
            "share_sd": middle_sd,
            "power": float(np.clip(self.pooled.power, 0.0, 1.0)),
        }
        found = records
        if report["told"]:
            variance = self.octaves.variance
            known = np.isfinite(variance)
            usual = float(np.exp(np.mean(np.log(variance[known])))) if known.any() else 0.0
            size = np.zeros(records.sizes["record"])
            size[self.rows] = np.where(known, variance, usual)  # as the shares of those that tell nothing
            of = {name: np.zeros(len(size)) for name in (NOISE, NOISE_SD, NOISE_COMMON_SD)}
            of[NOISE][self.rows] = share * size[self.rows]
            of[NOISE_SD][self.rows] = np.hypot(sd, SHAPE_ERROR) * size[self.rows]
            of[NOISE_COMMON_SD][self.rows] = np.hypot(share * self.pooled.common_log_sd, SHAPE_ERROR) * size[self.rows]
            report["sd"] = float(np.sqrt(np.median(of[NOISE][self.rows])))
            found = records.assign({name: _of_beams(records, values) for name, values in of.items()})
            found[NOISE].attrs["long_name"] = "variance of the instrument's noise"
        report["words"] = _in_words(report)
        return found.assign_attrs({NOISE_REPORT: json.dumps(report)})


def _of_beams(records: xr.Dataset, values: FloatArray) -> tuple[tuple[str, str], FloatArray, dict[str, str]]:
    """Return the same number for all beams of a record."""
    whole = np.repeat(values[:, np.newaxis], records.sizes["beam"], axis=1)
    return ("record", "beam"), whole, {"units": "m2 s-2"}


def _in_words(report: dict[str, Any]) -> str:
    if not report["told"]:
        return "instrument noise: the records do not tell it, and none is taken off their variances"
    if report["share"] < SHAPE_ERROR:
        return f"instrument noise from the spectra: less than {100.0 * SHAPE_ERROR:.0f} % of the variances"
    return (
        f"instrument noise from the spectra: {report['sd']:.2g} m/s, {100.0 * report['share']:.1f} % of the variance "
        f"(known to {100.0 * np.hypot(report['share_sd'], SHAPE_ERROR):.1f} %); it is taken off"
    )
