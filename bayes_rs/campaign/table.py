"""The table of a campaign: its means, spreads, ratios and turbulence intensities, each with an interval."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_generator, check_array
from bayes_rs.campaign.campaign_posterior import CampaignPosterior
from bayes_rs.campaign.cells import BIN_WIDTH, speed_bin
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import EQUAL_TAILED, interval_of

COLUMNS = ("quantity", "bin", "mean", "low", "high", "prob", "interval", "n_record", "decided")
REPRESENTATIVE = 0.9
"""Which quantile of TI represents a bin of wind speed in IEC 61400-1 and DNV practice."""
_OF_ONE = (*STRESSES, "tke", "ti", "u_star", "vv_uu", "ww_uu", "rho_uv", "rho_uw", "rho_vw")
_RELATIVE = ("vv", "ww", "uv", "uw", "vw", "tke")
"""Quantities of the size of uu: what was decided of them is told of their ratios to the mean of uu."""
_SIGNED = ("uv", "uw", "vw", "rho_uv", "rho_uw", "rho_vw")
"""Quantities that may be negative; of all others the logarithm is compared."""
_NORMAL = 3  # stresses before the shear stresses
_LEAST = 3
"""A bin with fewer records has no row: it has no spread and no quantile."""


def campaign_table(
    campaign: CampaignPosterior,
    *,
    prob: float = 0.9,
    interval: str = EQUAL_TAILED,
    wind_speed: FloatArray | None = None,
    stress_mean: FloatArray | None = None,
    chosen: NDArray[np.int64] | None = None,
    offset_sd: FloatArray | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Return a campaign's numbers, each with a credible interval.

    Parameters
    ----------
    campaign : CampaignPosterior
        Result of `sample_campaign`.
    prob : float
        Probability of the intervals.
    interval : {"equal-tailed", "highest-density"}
        Which intervals.
    wind_speed : ndarray, shape (n_all,), optional
        Wind speeds of all records, m/s, where only some were sampled.
    stress_mean : ndarray, shape (n_all, 6), optional
        Posterior means of the stresses of all records, one by one, m² s⁻².
    chosen : ndarray of int, shape (n_record,), optional
        Which of all records were sampled: what `choose_records` gave.
    offset_sd : ndarray, shape (n_record,), optional
        Standard deviation of the error of the instrument's noise that all sampled records have in common, m² s⁻².
    seed : int
        Seed of the draws of the sampling error, where only some records were sampled, and of that of the noise.

    Returns
    -------
    table : pandas.DataFrame
        Columns ``quantity, bin, mean, low, high, prob, interval, n_record, decided``. Bin ``all`` comes first, then
        bins of wind speed as ``7.5-8.5 m/s``, and the groups. Quantities: ``uu, vv, ww, uv, uw, vw, tke`` (m² s⁻²),
        ``ti``, ``u_star`` (m/s), ``vv_uu, ww_uu, rho_uv, rho_uw, rho_vw`` are means over the records, ``sd_uu`` and so
        on standard deviations over the records, and ``ti_p90`` is the 90 % quantile of TI over the records.

    Raises
    ------
    InputError
        If `wind_speed`, `stress_mean` and `chosen` do not fit each other and the campaign.

    Notes
    -----
    Each number is computed anew in every draw of all records, and its interval is that of these values: it is the
    posterior of the number itself, never a mean of posterior means. TI is √uu/U, TKE ½ (uu + vv + ww), and
    u* = (uw² + vw²)^¼.

    Where only n of N records were sampled, means over all records are by the difference estimator: the mean of all
    records' auxiliary values and the sampled records' mean difference from theirs (Cochran 1977, Sect. 7.9, with
    slope 1). The auxiliary is the quantity at `stress_mean`. The error of the sample is drawn by a Bayesian bootstrap
    whose weights are drawn together by √(1 − n/N): 0 where all records were sampled. Standard deviations and quantiles
    have these weights, too, but no auxiliary.

    An error of the instrument's noise is the same one in all records, so that their mean does not average it out. It
    acts on variances as an isotropic part δ of R: each draw of all records has one normal number, which multiplies
    every R_ii by a log-normal factor of mean 1 and of the standard deviation of δ/R_ii, and R_ij by the roots of both.

    `decided` is 1 − variance of the number in the posterior over that in campaigns without data. A number of the size
    of uu is divided by the mean of uu for it, since what says how large turbulence is would otherwise seem to decide
    all else; of what is positive the logarithm is compared, since the prior's long tails would otherwise do.

    References
    ----------
    Cochran (1977), Sampling Techniques, 3rd ed., Wiley.
    """
    rng = as_generator(seed)
    draws = campaign.stress.reshape(-1, campaign.n_record, len(STRESSES))
    if offset_sd is not None:
        draws = _offset(draws, check_array(offset_sd, (campaign.n_record,), what="offset_sd"), rng)
    values = _of_records(draws, campaign.wind_speed)
    before = _of_records(campaign.prior_stress, campaign.wind_speed)
    rest = _Rest(campaign, wind_speed, stress_mean, chosen)
    rows = []
    for name, part, count, by_speed in _bins(campaign, rest):
        share = min(len(part) / count, 1.0)
        weight = _weights(len(draws), len(part), share, rng)
        prior_weight = np.full((len(campaign.prior_stress), len(part)), 1.0 / len(part))
        correction = rest.correction(name, part) if share < 1.0 else {}
        now = _numbers({key: value[:, part] for key, value in values.items()}, weight, correction)
        then = _numbers({key: value[:, part] for key, value in before.items()}, prior_weight, {})
        for quantity in ("ti", "ti_p90") if by_speed else now:
            value = now[quantity]
            low, high = interval_of(value, prob, interval)
            decided = _decided(quantity, now, then)
            rows.append((quantity, name, float(value.mean()), float(low), float(high), prob, interval, count, decided))
    return pd.DataFrame(rows, columns=list(COLUMNS))


class _Rest:
    """All records of which only some were sampled."""

    def __init__(
        self,
        campaign: CampaignPosterior,
        wind_speed: FloatArray | None,
        stress_mean: FloatArray | None,
        chosen: NDArray[np.int64] | None,
    ) -> None:
        given = [one is not None for one in (wind_speed, stress_mean, chosen)]
        if any(given) and not all(given):
            raise InputError("Give wind_speed, stress_mean and chosen together, or none of them.")
        self.wind_speed = campaign.wind_speed
        self.auxiliary: dict[str, FloatArray] = {}
        self.chosen = np.arange(campaign.n_record)
        if wind_speed is None or stress_mean is None or chosen is None:
            return
        self.wind_speed = check_array(wind_speed, (None,), what="wind_speed")
        mean = check_array(stress_mean, (len(self.wind_speed), len(STRESSES)), what="stress_mean")
        self.chosen = np.asarray(chosen, dtype=np.int64)
        if self.chosen.shape != (campaign.n_record,) or not np.array_equal(
            self.wind_speed[self.chosen], campaign.wind_speed
        ):
            raise InputError(
                f"Invalid chosen of {self.chosen.size} entries: they must be the places of the campaign's "
                f"{campaign.n_record} records among all."
            )
        self.auxiliary = {key: value[0] for key, value in _of_records(mean[None], self.wind_speed).items()}

    def correction(self, name: str, part: NDArray[np.int64]) -> dict[str, tuple[float, FloatArray]]:
        """Return, by quantity, the auxiliary's mean over all records of a bin, and its values at the sampled ones."""
        everyone = np.ones(len(self.wind_speed), dtype=np.bool_)
        if name != "all":
            everyone = speed_bin(self.wind_speed) == speed_bin(self.wind_speed[self.chosen[part[:1]]])[0]
        return {key: (float(value[everyone].mean()), value[self.chosen[part]]) for key, value in self.auxiliary.items()}


def _bins(campaign: CampaignPosterior, rest: _Rest) -> Iterator[tuple[str, NDArray[np.int64], int, bool]]:
    """Yield name, sampled records, number of all records, and whether it is one of wind speed, of each bin."""
    yield "all", np.arange(campaign.n_record), len(rest.wind_speed), False
    number, of_all = speed_bin(campaign.wind_speed), speed_bin(rest.wind_speed)
    for one in np.unique(number):
        part = np.flatnonzero(number == one)
        if len(part) >= _LEAST:
            name = f"{max(one - 0.5, 0.0) * BIN_WIDTH:g}-{(one + 0.5) * BIN_WIDTH:g} m/s"
            yield name, part, int(np.count_nonzero(of_all == one)), True
    names = np.array(campaign.group)
    for label in sorted(set(campaign.group) - {""}):
        part = np.flatnonzero(names == label)
        if len(part) >= _LEAST:  # of records that were not sampled no group is known
            yield label, part, len(part), False


def _offset(draws: FloatArray, sd: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return draws of stresses from which one error δ of the instrument's noise is taken, the same in all records.

    R_ii is multiplied by a factor of mean 1 and of the standard deviation of δ/R_ii (1 at most), and the shear stresses
    with the roots of both: so tensors stay tensors, and means stay means.
    """
    normal = rng.standard_normal(len(draws))[:, None]
    root = np.empty((*draws.shape[:2], _NORMAL))
    for index in range(_NORMAL):
        log_sd = np.sqrt(np.log1p(np.minimum(sd / draws[..., index], 1.0) ** 2))
        root[..., index] = np.exp(-0.5 * log_sd * normal - 0.25 * log_sd**2)
    first, second = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])  # of uu, vv, ww, uv, uw, vw
    return np.asarray(draws * root[..., first] * root[..., second])


def _of_records(stress: FloatArray, wind_speed: FloatArray) -> dict[str, FloatArray]:
    """Return each quantity of each record, shape (n_draw, n_record), of stresses (n_draw, n_record, 6)."""
    uu, vv, ww, uv, uw, vw = np.moveaxis(stress, -1, 0)
    found = dict(zip(STRESSES, (uu, vv, ww, uv, uw, vw), strict=True))
    found["tke"] = 0.5 * (uu + vv + ww)
    found["ti"] = np.sqrt(uu) / wind_speed
    found["u_star"] = (uw**2 + vw**2) ** 0.25
    found["vv_uu"], found["ww_uu"] = vv / uu, ww / uu
    found["rho_uv"], found["rho_uw"], found["rho_vw"] = (
        uv / np.sqrt(uu * vv),
        uw / np.sqrt(uu * ww),
        vw / np.sqrt(vv * ww),
    )
    return found


def _weights(n_draw: int, n: int, share: float, rng: np.random.Generator) -> FloatArray:
    """Return weights of n records, shape (n_draw, n), whose scatter is that of a sample of this share of all."""
    equal = np.full((n_draw, n), 1.0 / n)
    if share >= 1.0:
        return equal
    drawn = rng.standard_exponential((n_draw, n))
    drawn /= drawn.sum(axis=1, keepdims=True)
    return np.asarray(equal + np.sqrt(1.0 - share) * (drawn - equal))


def _numbers(
    values: dict[str, FloatArray], weight: FloatArray, correction: dict[str, tuple[float, FloatArray]]
) -> dict[str, FloatArray]:
    """Return the numbers of a bin, each of shape (n_draw,), of values and weights (n_draw, n_record)."""
    found: dict[str, FloatArray] = {}
    for key in _OF_ONE:
        found[key] = np.einsum("dr,dr->d", weight, values[key])
        if key in correction:
            of_all, of_sampled = correction[key]
            found[key] = found[key] + of_all - weight @ of_sampled
    for key in _OF_ONE:
        plain = np.einsum("dr,dr->d", weight, values[key])
        found[f"sd_{key}"] = np.sqrt(np.einsum("dr,dr->d", weight, (values[key] - plain[:, None]) ** 2))
    found["ti_p90"] = _quantile(values["ti"], weight)
    return found


def _quantile(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return weighted quantiles, shape (n_draw,): linear between the middles of the steps of the distribution."""
    order = np.argsort(values, axis=1)
    ordered, mass = np.take_along_axis(values, order, axis=1), np.take_along_axis(weight, order, axis=1)
    middle = np.cumsum(mass, axis=1) - 0.5 * mass
    above = np.sum(middle < REPRESENTATIVE, axis=1)
    high = np.clip(above, 1, values.shape[1] - 1)[:, None]
    a, b = (np.take_along_axis(ordered, high - i, axis=1)[:, 0] for i in (1, 0))
    p, q = (np.take_along_axis(middle, high - i, axis=1)[:, 0] for i in (1, 0))
    share = np.clip((REPRESENTATIVE - p) / np.maximum(q - p, 1e-300), 0.0, 1.0)
    return np.asarray(a + share * (b - a))


def _decided(quantity: str, now: dict[str, FloatArray], then: dict[str, FloatArray]) -> float:
    """Return the share of a number that the data decided."""
    root = quantity.removeprefix("sd_")

    def told(numbers: dict[str, FloatArray]) -> FloatArray:
        value = numbers[quantity]
        if root in _RELATIVE:
            value = value / numbers["uu"]
        elif root == "u_star":
            value = value / np.sqrt(numbers["uu"])
        return np.asarray(value if root in _SIGNED else np.log(np.maximum(value, 1e-300)))

    return float(np.clip(1.0 - np.var(told(now)) / np.var(told(then)), 0.0, 1.0))
