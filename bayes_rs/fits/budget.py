"""The uncertainty budget of a fit: what of each interval comes from where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_items, check_count
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import Batch
from bayes_rs.fits.budget_moments import ENOUGH, OVER_CASES, Moments, switched_moments
from bayes_rs.fits.budget_sources import COMBINED, KINDS, PRIOR, REST, SAMPLING, SWITCHED, sources_of
from bayes_rs.fits.columns import N_PRIOR_DRAW
from bayes_rs.fits.derived import INTENSITIES, check_derived
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions, split_options
from bayes_rs.fits.noise_choice import noise_and_records, with_median_length_scale
from bayes_rs.fits.parts import batch_size
from bayes_rs.fits.plan import PRIOR_SEED
from bayes_rs.fits.prepare import can_be_fitted, prepare
from bayes_rs.fits.ranged_fit import RangedFit
from bayes_rs.fits.selection import Selection, selected_records
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.options import nearest, options_of
from bayes_rs.posteriors.decided import PriorRoom, leading_variance
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.sampling.chains import N_ENSEMBLE
from bayes_rs.processor import one_thread
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records

COLUMNS = (
    "stress", "source", "type", "variance", "u", "relative", "share", "share_mcse", "mean", "low", "high", "expanded",
    "prob", "interval", "decided",
)  # fmt: skip
"""Columns of a budget; before them ``record`` where each record has its own."""
MOST_RECORDS = 200
"""Records that a budget is the mean of; of more, so many, evenly spaced."""
LEAST_DRAWS = 256
_BETWEEN = {3: (0, 1), 4: (0, 2), 5: (1, 2)}
"""The variances that uv, uw and vw stand between."""
_NO_CAMPAIGN = {"campaign": "off", "campaign_group": None, "campaign_unsteady": False}
_BLOCK_NUMBERS = 4_000_000
"""Numbers that are held at once for each case and quantity."""


def budget(
    fit: Fit,
    *,
    records: Selection | None = None,
    each: bool = False,
    derived: Sequence[str] | None = None,
    n_draw: int = 4096,
    **uncertain: Any,
) -> pd.DataFrame:
    r"""Tell what of the uncertainty of a fit comes from sampling, from each nuisance, and from the prior.

    Parameters
    ----------
    fit : Fit
        From `fit` or `open_fit`, of R: not of the target ``"sonic"``.
    records : int, slice or array_like, optional
        Only these records, as in `Fit.summary`; by default all that were fitted, or 200 of them, evenly spaced.
    each : bool
        A budget for each record, in place of the mean of their variances.
    derived : sequence of str, optional
        Quantities beside the six stresses, such as ``"ti"``; by default those of the fit.
    n_draw : int
        Draws of a record; where fewer than 250 of them are effective, it gets more.
    **uncertain
        Fields of `Nuisances` in place of those of the fit: what is not known and was not counted, as ``yaw_sd_deg=2``,
        ``tilt_sd_deg=0.5`` or ``probe_length_log_sd=0.1``.

    Returns
    -------
    table : DataFrame
        For each stress a row for each ``source``, with the ``type`` of its evaluation (A or B), its part ``variance``
        of the posterior's variance (m⁴ s⁻⁴ for stresses), the standard uncertainty ``u`` that this is (its root; below
        zero where the variance is), ``relative`` to the estimate (for uv, uw, vw to the root of the two variances that
        they stand between), its ``share`` of the whole variance, and the Monte-Carlo error ``share_mcse`` of that. The
        last row, ``"combined"``, has the combined standard uncertainty, the estimate ``mean``, the ends ``low`` and
        ``high`` of its interval, the ``expanded`` uncertainty, half of its width, and ``decided`` as in `Fit.summary`;
        of several records their means.

        ``attrs`` hold ``left_out``, the sources that do not count; ``first_order``, the sum of both first-order parts
        over V₀, by stress; ``least_effective``, the least effective number of draws; and ``n_record``.

    Raises
    ------
    InputError
        If the fit is at several ranges or of a sonic's tensor, a nuisance is not known, or no record is left.

    Notes
    -----
    V is the posterior variance with everything uncertain, :math:`V_{-i}` that with source i known, at its central
    value, and :math:`V_0` that with all of them known. By the law of total variance
    :math:`V = E[\mathrm{Var}(q | \eta_i)] + \mathrm{Var}(E[q | \eta_i])`, and :math:`V - V_{-i}` stands for the second
    term: what the variance would fall by if the source were known.

    :math:`V_0` is that of a weighted mean of the data and the prior. The prior takes part as an input quantity of type
    B whose estimate is its centre and whose standard uncertainty is its own; so both parts are those of the law of
    propagation (GUM, eq. 10 and 13), with :math:`\partial E[q]/\partial x = \mathrm{Cov}(q, x)` for the data's
    residuals r of unit variance, and the prior's coordinates z of unit variance,

    .. math::
        u_\mathrm{sampling}^2 \propto \sum_k \mathrm{Cov}(q, r_k)^2 , \qquad
        u_\mathrm{prior}^2 \propto \sum_j \mathrm{Cov}(q, z_j)^2 .

    In a linear, Gaussian model they sum to :math:`V_0`. In others they are what first order says, and :math:`V_0` is
    apportioned in that ratio. The prior is no addition to an interval that would be narrower without it: without it
    the part of the data would be larger, and infinite for a stress that no beam sees. Its part is by how much the
    estimate is off if the prior is off by its own standard uncertainty. An unseen stress has a part of sampling
    besides, that of the level: the beams tell it, and the prior's ratio carries it over. ``decided``, which leaves the
    level out, says whose the stress itself is.

    The ``"rest"`` is what is left of V: sources that act together, and that a posterior is not linear. It is as small
    as the sources are, and may be below zero. All cases are weighted from the same draws, so that the errors of their
    differences are small; ``share_mcse`` is by the jackknife over four independent sets.

    Type A is the scatter of the variances of a finite record, by theory, and what the records' blocks scatter beyond
    it. All else is called type B, also the length scale and the noise that spectra of the same records tell.

    References
    ----------
    JCGM 100:2008 (GUM), sections 4.1 to 5.1. JCGM 101:2008, for distributions.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> records = brs.make_records(brs.simulate("50-beam", "fu-2022", wind_speed=10.0, n_records=4, seed=1), "50-beam")
    >>> table = budget(brs.fit(records, "50-beam", seed=1, sampler="auto"), yaw_sd_deg=5.0)
    >>> share = table.pivot(index="source", columns="stress", values="share")
    >>> bool(share.loc["prior", "vv"] > 0.5), bool(share.loc["prior", "uu"] < 0.1)
    (True, True)
    """
    if isinstance(fit, RangedFit):
        raise InputError(f"A budget is of a fit at one range: give one of the {len(fit.ranges)} (fit.at).")
    noise, own, choice = fit.loaded.inputs()
    wanted = own.derived if derived is None else tuple(as_items(derived, what="derived"))
    known = {entry.name: entry for entry in options_of(Nuisances)}
    for name in uncertain:
        if name not in known:
            raise InputError(f"Unknown nuisance {name!r} of a budget: {nearest(name, known)}")
    own = replace(own, nuisances=replace(own.nuisances, **uncertain), derived=wanted)
    chosen = fit.fitted.copy()
    if records is not None:
        chosen[:] = False
        chosen[selected_records(records, fit.n_record, lambda: fit.time)] = True
        chosen &= fit.fitted
    return _budget_of(fit.records, fit.scan, noise, own, choice, np.flatnonzero(chosen), each, n_draw)


def budget_of_records(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    seed: int,
    noise: Noise | str | Path | None = None,
    n_draw: int = 4096,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
    **options: Any,
) -> pd.DataFrame:
    """Return the budget of a fit of these records without fitting them first.

    Parameters
    ----------
    records, scan, seed, noise, say
        As in `fit`.
    n_draw
        As in `budget`.
    **options
        As in `fit`.

    Returns
    -------
    table : DataFrame
        As `budget` of that fit.

    Raises
    ------
    InputError
        As `fit` and `budget`.
    """
    own, choice = split_options({**options, "seed": seed, **_NO_CAMPAIGN})
    check_are_records(records)
    records = believed(records)
    return _budget_of(records, as_scan(scan), given_noise(noise), own, choice, None, False, n_draw, say)


def _budget_of(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise | None,
    options: FitOptions,
    choice: NoiseOptions,
    chosen: NDArray[np.int64] | None,
    each: bool,
    n_draw: int,
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
) -> pd.DataFrame:
    if options.target == "sonic":
        raise InputError("A budget is of R, and this fit is of what a sonic would measure: fit with target 'record'.")
    check_derived(options.derived)
    check_count(n_draw, what="n_draw", minimum=LEAST_DRAWS)
    options = with_median_length_scale(options, choice, records, noise)
    with one_thread():
        if noise is None or chosen is None or (options.nuisances.yaw_sd_of_records and "yaw_sd" not in records):
            noise, records = noise_and_records(records, scan, noise, options, choice, say)
        scan, noise, batch = prepare(records, scan, noise, options)
        possible = can_be_fitted(batch)
        number = possible if chosen is None else chosen[np.isin(chosen, possible)]
        if len(number) == 0:
            raise InputError("No record was fitted, so there is nothing to tell: see the records' flags.")
        if len(number) > MOST_RECORDS:
            number = number[np.linspace(0, len(number) - 1, MOST_RECORDS).round().astype(np.int64)]
        batch = batch.take(number)
        sources = sources_of(batch, noise, options)
        size = leading_variance(design_matrix(scan.at_yaw(0.0)))
        room = PriorRoom.of(options.made_prior.draw(N_PRIOR_DRAW, PRIOR_SEED), size)
        found = _moments(batch, noise, options, sources, room, n_draw)
    names = (*STRESSES, *options.derived)
    places = [np.array([row]) for row in range(len(number))] if each else [np.arange(len(number))]
    tables = []
    for place in places:
        table = _table(found, place, sources, names, options)
        if each:
            table.insert(0, "record", int(number[place[0]]))
        tables.append(table)
    whole = pd.concat(tables, ignore_index=True)
    data, prior = (_first_order(part, slice(None)) for part in (found.by_data, found.by_prior))
    least = _variances(found, slice(None))[-1]
    whole.attrs = {
        "left_out": [name for name in SWITCHED if name not in sources],
        "first_order": dict(zip(names, ((data + prior).mean(axis=0) / least.mean(axis=0)).tolist(), strict=True)),
        "least_effective": float(found.effective.min()),
        "n_record": len(number),
    }
    return whole


def _moments(
    batch: Batch, noise: Noise, options: FitOptions, sources: Sequence[str], room: PriorRoom, n_draw: int
) -> Moments:
    """Return the moments of all records, some of them together in memory."""
    n_beam = batch.variance.shape[1]
    together = max(1, min(batch_size(n_beam), _BLOCK_NUMBERS // (n_draw * max(n_beam, len(STRESSES)))))
    order, parts = [], []
    for first in range(0, len(batch), together):
        rows = np.arange(first, min(first + together, len(batch)))
        for of_rows, part in switched_moments(batch.take(rows), noise, options, sources, room, n_draw):
            order.append(rows[of_rows])
            parts.append(part)
    back = np.argsort(np.concatenate(order))
    joined: dict[str, FloatArray] = {}
    for name in Moments.__dataclass_fields__:
        axis, arrays = int(name in OVER_CASES), [getattr(part, name) for part in parts]
        if name in ("by_data", "by_prior"):  # records may have different numbers of data: no datum moves nothing
            most = max(array.shape[2] for array in arrays)
            arrays = [np.pad(array, ((0, 0), (0, 0), (0, most - array.shape[2]), (0, 0))) for array in arrays]
        joined[name] = np.take(np.concatenate(arrays, axis=axis), back, axis=axis)
    return Moments(**joined)


def _variances(found: Moments, sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return posterior variances (n_case, n_record, n_quantity) by some of the sets of draws together."""
    weight = found.weight[..., sets] / found.weight[..., sets].sum(axis=-1, keepdims=True)
    mean = np.einsum("crs,crqs->crq", weight, found.mean[..., sets])
    apart = found.variance[..., sets] + (found.mean[..., sets] - mean[..., np.newaxis]) ** 2
    return np.asarray(np.einsum("crs,crqs->crq", weight, apart))


def _first_order(moved: FloatArray, sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return sums of squares (n_record, n_quantity) of covariances: mean products of sets have no bias."""
    some = moved[..., sets]
    n = some.shape[-1]
    products = some.sum(axis=-1) ** 2 - (some**2).sum(axis=-1)
    return np.asarray(np.maximum(products.sum(axis=-1) / (n * (n - 1.0)), 0.0))


def _parts(found: Moments, place: NDArray[np.int64], sets: slice | NDArray[np.int64]) -> FloatArray:
    """Return the variances of sampling, each source, prior, rest and all, (n_row, n_quantity), means over records."""
    variance = _variances(found, sets)[:, place]
    data, prior = (_first_order(part[place], sets) for part in (found.by_data, found.by_prior))
    of_data = data / np.where(data + prior > 0.0, data + prior, 1.0)
    whole, least = variance[0], variance[-1]
    of_sources = whole - variance[1:-1]
    rest = whole - least - of_sources.sum(axis=0)
    rows = [of_data * least, *of_sources, (1.0 - of_data) * least, rest, whole]
    return np.stack([row.mean(axis=0) for row in rows])


def _table(
    found: Moments, place: NDArray[np.int64], sources: Sequence[str], names: Sequence[str], options: FitOptions
) -> pd.DataFrame:
    """Return the budget of some records together."""
    variance = _parts(found, place, slice(None))
    share = variance / variance[-1]
    sets = np.arange(N_ENSEMBLE)
    left = np.stack([_parts(found, place, np.delete(sets, one)) for one in sets])
    left = left / left[:, -1:]
    error = np.sqrt((N_ENSEMBLE - 1.0) * np.mean((left - left.mean(axis=0)) ** 2, axis=0))
    weight = found.weight[0] / found.weight[0].sum(axis=-1, keepdims=True)
    mean = np.einsum("rs,rqs->rq", weight, found.mean[0])[place].mean(axis=0)
    low, high = found.low[place].mean(axis=0), found.high[place].mean(axis=0)
    of_stress = found.decided[place].mean(axis=0)
    decided = [*of_stress, *(of_stress[INTENSITIES[name]] if name in INTENSITIES else np.nan for name in names[6:])]
    scale = np.abs(mean)
    for index, (one, other) in _BETWEEN.items():
        scale[index] = np.sqrt(mean[one] * mean[other])
    u = np.sign(variance) * np.sqrt(np.abs(variance))
    rows = []
    for column, name in enumerate(names):
        for row, source in enumerate((SAMPLING, *sources, PRIOR, REST, COMBINED)):
            last = source == COMBINED
            ends = (mean, low, high, 0.5 * (high - low))
            rows.append(
                (
                    name,
                    source,
                    KINDS.get(source, "B"),
                    float(variance[row, column]),
                    float(u[row, column]),
                    float(u[row, column] / scale[column]),
                    float(share[row, column]),
                    float(error[row, column]),
                    *(float(values[column]) if last else np.nan for values in ends),
                    options.prob if last else np.nan,
                    options.interval if last else "",
                    float(decided[column]) if last else np.nan,
                )
            )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def budget_lines(table: pd.DataFrame) -> list[str]:
    """Lay out a budget for reading: a line for each source with its share of each stress's variance.

    Parameters
    ----------
    table : DataFrame
        From `budget`, of all records together.

    Returns
    -------
    lines : list of str
        A heading; shares in per cent by source; the combined standard uncertainty, in the stress's own unit; half of
        the interval's width; the share that the data decided; and which sources do not count.

    Examples
    --------
    >>> row = {"stress": "uu", "type": "", "variance": 0.04, "u": 0.2, "share": 1.0, "expanded": 0.33, "prob": 0.9}
    >>> rows = [{**row, "source": "sampling", "type": "A", "share": 0.7}, {**row, "source": "prior", "share": 0.3}]
    >>> for line in budget_lines(pd.DataFrame([*rows, {**row, "source": "combined", "decided": 0.8}])):
    ...     print(line)
    share of the variance     type       uu
    sampling                  A        70 %
    prior                              30 %
    combined, standard                0.200
    half of the 90 % interval         0.330
    decided by the data                80 %
    """
    names = list(dict.fromkeys(table["stress"]))
    rows = {(row["source"], row["stress"]): row for row in table.to_dict("records")}

    def line(first: str, kind: str, words: Sequence[str]) -> str:
        return f"{first:<26}{kind:<4}" + "".join(f"{word:>9}" for word in words)

    lines = [line("share of the variance", "type", [name[:8] for name in names])]
    for source in dict.fromkeys(table["source"]):
        if source != COMBINED:
            found = [rows[source, name] for name in names]
            lines.append(line(source, found[0]["type"], [_percent(row["share"]) for row in found]))
    last = [rows[COMBINED, name] for name in names]
    half = f"half of the {100.0 * last[0]['prob']:g} % interval"
    lines.append(line("combined, standard", "", [f"{row['u']:#.3g}" for row in last]))
    lines.append(line(half, "", [f"{row['expanded']:#.3g}" for row in last]))
    lines.append(line("decided by the data", "", [_percent(row["decided"]) for row in last]))
    if left_out := table.attrs.get("left_out"):
        lines.append(f"taken for known: {', '.join(left_out)}")
    if (least := table.attrs.get("least_effective", ENOUGH)) < ENOUGH:
        lines.append(f"few draws: {least:.0f} effective ones in the worst of the records, so its numbers are poor")
    return lines


def _percent(share: float) -> str:
    return f"{100.0 * share:z.0f} %".replace("-", "\N{MINUS SIGN}") if np.isfinite(share) else "–"
