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
from bayes_rs.fits.budget_moments import OVER_CASES, Moments, switched_moments
from bayes_rs.fits.budget_sources import possible_sources, sources_of
from bayes_rs.fits.budget_table import budget_table, first_order, variances
from bayes_rs.fits.columns import N_PRIOR_DRAW
from bayes_rs.fits.derived import check_derived
from bayes_rs.fits.fit_object import Fit, check_fit
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions, split_options
from bayes_rs.fits.noise_choice import noise_and_records, with_median_length_scale
from bayes_rs.fits.parts import batch_size
from bayes_rs.fits.plan import PRIOR_SEED
from bayes_rs.fits.prepare import can_be_fitted, check_noise_is_less, prepare
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
from bayes_rs.processor import one_thread
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records

MOST_RECORDS = 200
"""Records that a budget is the mean of; of more, so many, evenly spaced."""
LEAST_DRAWS = 256
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
    records : int, str, datetime, Timestamp, datetime64, slice or array_like, optional
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
    check_fit(fit)
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
    check_noise_is_less([records], options)
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
        table = budget_table(found, place, sources, names, options)
        if each:
            table.insert(0, "record", int(number[place[0]]))
        tables.append(table)
    whole = pd.concat(tables, ignore_index=True)
    data, prior = (first_order(part, slice(None)) for part in (found.by_data, found.by_prior))
    least = variances(found, slice(None))[-1]
    whole.attrs = {
        "left_out": [name for name in possible_sources(batch, options) if name not in sources],
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
