"""The result of a fit: one object, whether it is in memory or in a folder, of six records or of a year."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import as_items, check_choice, check_prob, check_switch
from bayes_rs.errors import InputError, in_short
from bayes_rs.fits.campaign_words import campaign_failures, campaign_words, no_campaign_words
from bayes_rs.fits.coherence import Coherence, coherence_of
from bayes_rs.fits.columns import ALONG, ALONG_SHAPE, HYPER, SUMMARY, TABLE, VARIANCES
from bayes_rs.fits.direction_table import direction_medians, direction_rows
from bayes_rs.fits.fit_card import UNREADABLE, fit_card, fit_rows, unreadable_card, unreadable_words
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.fit_options import INFORMATION
from bayes_rs.fits.frames import FRAMES, lidar_frame
from bayes_rs.fits.groups import (
    as_arviz_takes,
    attributes,
    group_names,
    group_of,
    has_group,
    of_one_record,
    tree_of,
)
from bayes_rs.fits.headline import Headline, headline_of
from bayes_rs.fits.read_only import read_only_dataset
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.fits.selection import Selection, check_columns, selected_records
from bayes_rs.fits.summarizing import COLUMNS
from bayes_rs.fits.summary_anew import summarize
from bayes_rs.fits.words import DESCRIBED, describe, error_lines, failure_lines, flag_lines, least_seen
from bayes_rs.intervals import INTERVALS

if TYPE_CHECKING:
    from bayes_rs.priors.campaign import CampaignPrior

_BESIDE = {"campaign_mean": "mean", "campaign_low": "low", "campaign_high": "high"}
"""Columns of the exported summary, and those of the summary under the campaign that they are."""


@dataclass(frozen=True, eq=False)
class Fit(FitData):
    """Posteriors of the Reynolds stress tensors of records, as `fit` makes them and `open_fit` reads them.

    ``fit["posterior"]`` is a group of `to_arviz` as a Dataset, and ``fit.attrs`` holds the attributes of the whole.

    Parameters
    ----------
    run : mapping
        What was run, as plain values: settings, versions, scan, prior, noise, counts; the content of ``run.json``.
    scan : Scan
        The scan, with the records' beams.
    source : Tables
        Where its tables are.
    loaded : callable
        Returns the records and the draws of the prior.
    place : str
        The folder, a whole path; empty in memory.
    """

    def __repr__(self) -> str:
        """Say in a few lines what it is, and what was found."""
        where = f", in {self.place!r}" if self.place else ""
        try:
            counts = f"{self.n_fitted} of {self.n_record} records"
            first = f"<Fit: {counts}, scan {self.scan.name}, sampler {self.settings['fit']['sampler']}{where}"
            return "\n ".join([first, *(f"{name}: {value}" for name, value in fit_rows(self).items())]) + ">"
        except UNREADABLE as error:  # what shows itself must not fail
            return unreadable_words(self, error)

    def _repr_html_(self) -> str:
        """Say it in a notebook, with uu of the records."""
        try:
            return fit_card(self)
        except UNREADABLE as error:  # as above
            return unreadable_card(self, error)

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the whole: target, sampler, seed, scan, prior, noise and others."""
        return attributes(self)

    def summary(
        self,
        *,
        prob: float | None = None,
        interval: str | None = None,
        derived: Sequence[str] | None = None,
        frame: str = "wind",
        campaign: bool = False,
        information: str | None = None,
        records: Selection | None = None,
        columns: Sequence[str] | None = None,
    ) -> pd.DataFrame:
        """Summarize the posterior of every record.

        Parameters
        ----------
        prob : float, optional
            Probability of the intervals; by default that of the fit. Another one needs the draws.
        interval : {"equal-tailed", "highest-density"}, optional
            Which intervals: with as much probability below as above, or the narrowest; by default those of the fit.
            The others need the draws.
        derived : sequence of str, optional
            Quantities beside the six stresses; by default those of the fit. Others need the draws. They are turbulence
            intensities ``"ti"`` (σ_u/U), ``"ti_v"``, ``"ti_w"``; ``"tke"``; ``"friction_velocity"``;
            ``"correlation_uv"``, ``"correlation_uw"``, ``"correlation_vw"``; the invariants ``"anisotropy_2"``,
            ``"anisotropy_3"`` and ``"lumley_xi"``, ``"lumley_eta"`` of the anisotropy tensor.
        frame : {"wind", "lidar"}
            Axes of the stresses and of what is derived from them: of the record's mean wind, or of the levelled lidar
            (x against its view, y to its right, z up), by the record's ``yaw``. The latter needs the draws.
        campaign : bool
            The records under the prior that the campaign has learnt, in place of the given one; of these no draws are
            kept.
        information : {"variances", "covariances"}, optional
            By default that of the fit. Of a fit that uses the covariances between beams, or a mast beside, too,
            ``"variances"`` gives what the variances of the beams say by themselves; of these no draws are kept.
        records : int, str, datetime, Timestamp, datetime64, slice or array_like, optional
            Only these records: numbers, starts (UTC; a text is an ISO time; all records that start then), a slice of
            numbers or of starts (the end left out), or a truth value for each record, as
            ``fit.records["turbine"] == "T07"``. Only their parts are read.
        columns : sequence of str, optional
            Only these columns, in this order.

        Returns
        -------
        table : DataFrame
            A table of your own, which you may change: the fit keeps its numbers.
            One row for each record and stress (and derived quantity): number and start of the record; posterior mean,
            sd, median and ends of the interval, m² s⁻² for stresses, with its probability and kind; ``decided``; least
            squares on the same variances and its standard error, NaN for stresses that the beams do not determine;
            Monte-Carlo standard errors of mean, sd, median and of the interval's ends; effective sample sizes, R-hat,
            and flags in words. Records that were not fitted have NaN.

        Raises
        ------
        InputError
            If prob is not between 0 and 1, a derived quantity, the frame or a column is not known, the records are none
            of the fit's, or draws are needed and were not kept.

        Notes
        -----
        The whole summary of a million records takes 1.0 GB, and 2.9 GB while it is read; with `records` and `columns`
        it takes what is asked for.

        ``decided`` is the share of a stress that the data decided: 0, it is the prior's; 1, the data's. It is 1 less
        the weight that the prior has in the estimate: how far the estimate moves when the prior's centre moves, over
        the room that the prior leaves the stress when the size of the turbulence is known (`what_data_decided`). That
        beams tell the size decides only those stresses that they look along. A turbulence intensity has the number of
        its variance; the other derived quantities have none. Least squares is as by `estimate`, all beams alike and as
        points, less the instrument's noise that the fit knows. In the lidar's frame it is left out.

        The Monte-Carlo errors follow from the effective sample sizes: of the mean sd/√n, of the sd ½ sd √((κ − 1)/n)
        with the kurtosis κ, of the median and the ends those of the quantiles at their places. The interval of
        highest density slides over intervals of the same probability besides, which its ends' errors leave out.
        """
        own = self.settings["fit"]
        check_switch(campaign, what="campaign")
        check_choice(frame, FRAMES, what="frame")
        if prob is not None:
            check_prob(prob)
        wanted = tuple(own["derived"]) if derived is None else tuple(as_items(derived, what="derived"))
        kind = own["interval"] if interval is None else check_choice(interval, tuple(INTERVALS), what="interval")
        as_made = (
            prob in (None, own["prob"])
            and kind == own["interval"]
            and wanted == tuple(own["derived"])
            and frame == "wind"
        )
        alone = self._is_alone(information)
        if campaign and alone:
            raise InputError(
                "The campaign has learnt from the information of the fit: leave information or campaign out."
            )
        if (campaign or alone) and not as_made:
            of_these = "by their variances alone" if alone else "under the campaign"
            raise InputError(
                f"Of the records {of_these} no draws are kept: their summary has the intervals, quantities and axes of "
                "the fit; leave prob, interval, derived and frame out."
            )
        chosen = None if records is None else selected_records(records, self.n_record, lambda: self.time)
        shown = COLUMNS if columns is None else check_columns(columns)
        if as_made:
            if campaign:
                self._campaign_table(TABLE, [])  # says why there is none
            dataset = SUMMARY if campaign else VARIANCES if alone else "summary"
            return self._of_table(dataset, chosen, shown).copy()  # what is kept, or read-only, is not handed out
        table = summarize(self, own["prob"] if prob is None else prob, kind, wanted, frame)
        if chosen is not None:
            table = table[np.isin(table["record"].to_numpy(), chosen)].reset_index(drop=True)
        return table[list(shown)]

    def _is_alone(self, information: str | None) -> bool:
        """Tell whether what is asked for are the variances alone, of a fit that uses covariances or a mast, too."""
        if information is None:
            return False
        if check_choice(information, INFORMATION, what="information") == "variances":
            return VARIANCES in self.source.datasets
        if self.settings["fit"].get("information", "variances") != information:
            raise InputError(
                "The fit used no covariances between beams: fit again with information='covariances' (--information "
                "covariances)."
            )
        return False

    def _of_table(self, dataset: str, chosen: NDArray[np.int64] | None, columns: Sequence[str]) -> pd.DataFrame:
        """Return columns of a summary as it was made, of some records."""
        if chosen is None:
            return self.source.read(dataset, None if columns is COLUMNS else columns)
        read = list(dict.fromkeys(("record", *columns)))
        pieces = [
            piece[np.isin(piece["record"].to_numpy(), chosen)]
            for piece in self.source.pieces(dataset, read, chosen if len(chosen) else np.zeros(1, dtype=np.int64))
        ]
        return pd.concat(pieces, ignore_index=True)[list(columns)]

    def coherence(self) -> Coherence:
        """Return how covariances between beams, and a mast beside, go with what the variances say of the stresses.

        Returns
        -------
        coherence : Coherence
            The misfit over all records, and whether it speaks against the coherence of the model, or the mast.

        Raises
        ------
        InputError
            If the fit used the variances of the beams alone, or no record that was fitted has anything beside them.
        """
        found = coherence_of(self)
        if found is None and VARIANCES in self.source.datasets:
            raise InputError(
                f"None of the {self.n_fitted} records that were fitted, of {self.n_record}, has a covariance between "
                "beams, or a stress of a mast, to compare with the variances: see the flags of the records."
            )
        if found is None:
            raise InputError(
                "The fit has neither covariances between beams nor a mast beside: fit with information='covariances' "
                "(--information covariances), or with a mast."
            )
        return found

    def campaign(self) -> pd.DataFrame:
        """Return what all records together say of the campaign.

        Returns
        -------
        table : DataFrame
            One row for each quantity and bin of wind speed (``"all"`` first): ``quantity``, ``bin``, posterior
            ``mean``, ends ``low`` and ``high`` of the interval of probability ``prob`` and kind ``interval``,
            ``n_record``, and the share ``decided`` of it that the data decided. Quantities are those of
            `bayes_rs.campaign.campaign_table`.

        Raises
        ------
        InputError
            If there is no campaign; the message says why.

        Notes
        -----
        Every row is the posterior of the very number that it names, not an average of the records' posterior means:
        those carry the prior's bias, which does not average out.
        """
        return self._campaign_table(TABLE).copy()

    def campaign_hyper(self) -> pd.DataFrame:
        """Return the hyperparameters of the campaign: the distribution that the records' R come from.

        Returns
        -------
        table : DataFrame
            One row each: ``name``; posterior ``mean``, ``low``, ``high``; ``prior_mean``, ``prior_low``,
            ``prior_high``, of 90 % intervals of the kind ``interval``; the share ``decided`` by the data; ``ess`` and
            ``r_hat``.

        Raises
        ------
        InputError
            If there is no campaign; the message says why.
        """
        return self._campaign_table(HYPER).copy()

    def campaign_prior(self) -> CampaignPrior:
        """Return the prior that the campaign has learnt.

        Returns
        -------
        prior : CampaignPrior
            It can be given to another fit, or saved to a file that ``prior="campaign:FILE"`` names.

        Raises
        ------
        InputError
            If there is no campaign; the message says why.
        """
        self._campaign_table(TABLE, [])
        prior: CampaignPrior = self.loaded.campaign_prior()
        return prior

    @property
    def has_campaign(self) -> bool:
        """Whether the records' common prior was learnt."""
        return TABLE in self.source.datasets

    def _campaign_table(self, name: str, columns: Sequence[str] | None = None) -> pd.DataFrame:
        if name not in self.source.datasets:
            why = self.run["campaign"]["why"] or "it was switched off"
            raise InputError(f"This fit has no campaign: {why}.")
        return self.source.read(name, columns)

    def directions(self) -> pd.DataFrame:
        """Tell for every record how much the posterior contracted along each direction of R.

        Returns
        -------
        table : DataFrame
            Six rows a record, best seen direction first: ``weight``, the singular value over the largest; ``seen``,
            false where no beam's variance changes along the direction; ``contraction`` of the direction's component and
            ``contraction_shape`` of that of R over its trace; and the direction itself, a unit vector over the six
            stresses in the lidar's frame (x against the lidar's axis, level).

        Notes
        -----
        The directions are the right singular vectors d of the design matrix A of the level frame at yaw 0, in which
        they do not change from record to record; the posterior and prior covariances of the stresses are turned into it
        by each record's yaw. contraction = 1 − d·Σ d / d·Σ₀ d, with the covariances of R (or of R over its trace, for
        the shape) under posterior and prior. A direction that is not seen may contract none the less: what is learned
        of the others limits it, through the prior's correlations and because R is realizable. Of the shape, seen and
        unseen directions that share the diagonal mirror each other, because its trace is 1: the contraction of R itself
        tells them apart. For what the data decided of each stress, see ``decided`` of `summary`.
        """
        rows = self.source.read("posterior", ["record", *ALONG, *ALONG_SHAPE])
        along, of_shape = (rows[list(names)].to_numpy(dtype=np.float64) for names in (ALONG, ALONG_SHAPE))
        known = self.run["directions"]
        weight, vectors = (np.asarray(known[name], dtype=np.float64) for name in ("weight", "vectors"))
        return direction_rows(rows["record"].to_numpy(), weight, vectors, along, of_shape)

    def direction_medians(self) -> pd.DataFrame:
        """Return the table of `directions` of the median record, a row for each direction; NaN if none was fitted."""
        found = self.of_records(*ALONG, *ALONG_SHAPE)
        along, of_shape = (np.stack([found[name] for name in names], axis=1) for names in (ALONG, ALONG_SHAPE))
        known = self.run["directions"]
        weight, vectors = (np.asarray(known[name], dtype=np.float64) for name in ("weight", "vectors"))
        return direction_medians(weight, vectors, along, of_shape)

    def lidar_frame(self) -> xr.DataArray:
        """Return the posterior's draws of the stresses in the frame of the levelled lidar.

        Returns
        -------
        stress : DataArray, dims (chain, draw, record, component)
            The draws, m² s⁻²; ``uu`` is the variance along the lidar's axis x, ``vv`` that along y, to its right.

        Raises
        ------
        InputError
            If the draws were not kept.

        Notes
        -----
        Each record's draws are turned by its own wind direction ψ: R_lidar = T_yaw(ψ) R T_yaw(ψ)ᵀ, since beams are
        n · T_yaw(ψ) in the mean-wind frame. No radial variance changes.
        """
        return lidar_frame(self)

    def to_datatree(self, record: RecordKey | None = None) -> xr.DataTree:
        """Return the fit in ArviZ's layout, as xarray holds it.

        Parameters
        ----------
        record : int, str, datetime, Timestamp or datetime64, optional
            Number of a record, or its start (UTC; a text is an ISO time), for this record alone, without the
            dimension ``record`` and with the beams that it uses; by default all records.

        Returns
        -------
        tree : DataTree
            Groups ``posterior`` (``stress`` with dims chain, draw, record, component), ``sample_stats``, ``prior``,
            ``observed_data``, ``posterior_predictive``, and ``log_likelihood`` (of each draw and datum; not for the
            target ``"sonic"``, nor in a folder of more than 2000 records). Records that could not be fitted stay in it,
            as NaN and flagged.

        Raises
        ------
        InputError
            If the draws were not kept, or there is no such record, or it was not fitted.
        """
        groups = {name: self[name] for name in group_names(self)}
        if record is not None:
            groups = of_one_record(groups, self.find_record(record))
        return tree_of(groups, self.attrs)

    def to_arviz(self, record: RecordKey | None = None) -> Any:
        """Return the fit as the functions of ArviZ take it.

        Parameters
        ----------
        record : int, str, datetime, Timestamp or datetime64, optional
            As for `to_datatree`. ArviZ's `loo` needs one: a record's datum is left out of this record alone.

        Returns
        -------
        data : DataTree or InferenceData
            What `to_datatree` returns; before ArviZ 1 as its InferenceData.

        Raises
        ------
        InputError
            As `to_datatree`.
        """
        return as_arviz_takes(self.to_datatree(record))

    @cached_property
    def _groups(self) -> dict[str, xr.Dataset]:
        return {}

    def __getitem__(self, name: str) -> Any:
        """Return a group as a Dataset, or with a slash one variable of it, as ``fit["posterior/stress"]``.

        The arrays are read-only: draws are large, and the fit keeps them.

        Raises
        ------
        InputError
            If there is no such group or variable, or it needs draws that were not kept; a fit is no sequence.
        """
        if not isinstance(name, str):
            raise InputError(
                f"Invalid group {in_short(name)} of a fit: give its name, one of {', '.join(group_names(self))}; a fit "
                "is no sequence: of records, by number or start, there are fit.draws(0) and fit.summary(records=0)."
            )
        group, _, variable = name.partition("/")
        if group not in self._groups:
            self._groups[group] = read_only_dataset(group_of(self, group))
        found = self._groups[group].copy(deep=False)
        if not variable:
            return found
        try:
            return found[variable]
        except KeyError as error:
            known = ", ".join(map(str, found.data_vars))
            words = f"Unknown variable {variable!r} of the group {group!r} of a fit: it must be one of {known}."
            raise InputError(words) from error

    def __contains__(self, name: object) -> bool:
        """Say whether there is a group of that name, with draws where it needs them."""
        return has_group(self, name)

    def headline(self) -> Headline:
        """Return what was found, what the data decided of it and what is doubtful, in three lines.

        Returns
        -------
        headline : Headline
            ``print(fit.headline())`` shows it; ``numbers`` holds the same as plain numbers. Turbulence intensity is
            σ_u/U of the median record: medians over the fitted records of the posterior's median and of the ends of
            its interval, with the 5 % and 95 % quantiles of the records' medians, and where there is a campaign, its
            mean. A stress counts as the prior's by `is_priors` of the median record's ``decided``.
        """
        return headline_of(self)

    @property
    def words(self) -> list[str]:
        """What the scan sees, which prior it was, and what the data said beyond the prior, in lines."""
        run = self.run
        learnt = self.of_records("stresses_learnt")["stresses_learnt"]
        summary = self.of_stresses(*DESCRIBED)
        prob, interval = float(self.settings["fit"]["prob"]), str(self.settings["fit"]["interval"])
        lines = describe(run["scan"], run["sight"], run["prior"], run["prior_widths"], prob, interval, summary, learnt)
        lines += least_seen(self.direction_medians())
        if not self.has_campaign:
            return [*lines, *no_campaign_words(self.run["campaign"])]
        return [*lines, *campaign_words(self.run["campaign"], self.campaign())]

    @property
    def failures(self) -> list[str]:
        """What of the data is not believed, and one line for each record that was not fitted or whose chain fell short.

        Of many records, the first ones.
        """
        known = [*self.run.get("doubts", []), *failure_lines(self.flag, self.time)]
        return [*known, *campaign_failures(self.run["campaign"])]

    @property
    def remarks(self) -> list[str]:
        """One line for each flag that some record has, how many have it and the first; what beams disagree; and
        whether the Monte-Carlo error that was asked for is reached.
        """
        asked = self.settings["fit"].get("monte_carlo_error")
        reached = [] if asked is None else error_lines(asked, self.of_records("mc_error")["mc_error"])
        return [*flag_lines(self.flag, self.time), *self.run.get("beams", {}).get("words", []), *reached]


def check_fit(fit: Fit) -> Fit:
    """Return what is a fit.

    Raises
    ------
    InputError
        If it is something else, such as records or the name of a folder.
    """
    if not isinstance(fit, Fit):
        given = f"{type(fit).__name__} of xarray" if isinstance(fit, (xr.Dataset, xr.DataTree)) else in_short(fit)
        raise InputError(f"Invalid fit, {given}: give what bayes_rs.fit returns, or bayes_rs.open_fit of its folder.")
    return fit


def exported_summary(fit: Fit) -> pd.DataFrame:
    """Return the summary as ``summary.csv`` holds it, with what each row is under the campaign.

    Parameters
    ----------
    fit : Fit
        The fit.

    Returns
    -------
    table : DataFrame
        The columns of `Fit.summary`, and ``campaign_mean``, ``campaign_low``, ``campaign_high``: the same stress under
        the prior that the campaign has learnt; NaN where there is none.
    """
    there = fit.source.read(SUMMARY, list(_BESIDE.values())) if fit.has_campaign else None
    beside = {ours: np.nan if there is None else there[theirs].to_numpy() for ours, theirs in _BESIDE.items()}
    return fit.source.read("summary").assign(**beside)
