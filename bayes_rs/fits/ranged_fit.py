"""A fit at several ranges: one `Fit` for each, and what they say together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_card import UNREADABLE, ranges_card, unreadable_card, unreadable_words
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.groups import group_names, has_group, tree_of
from bayes_rs.fits.headline import Headline, headline_of_ranges
from bayes_rs.fits.people_table import PeopleRows
from bayes_rs.fits.read_only import read_only_dataset
from bayes_rs.fits.record_keys import RecordKey
from bayes_rs.fits.selection import Selection
from bayes_rs.geometry.ranged_scan import RangedScan, nearest_range, short
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import is_priors

if TYPE_CHECKING:
    from bayes_rs.priors.campaign import CampaignPrior

_QUANTITIES = ("ti", *STRESSES)
_COLUMNS = ("quantity", "estimate", "low", "high", "prob", "interval", "decided", "n_record", "of")
"""Of a profile, beside range and height."""
_LISTED = 20
"""Lines of failures that are listed one by one."""


@dataclass(frozen=True)
class TablesOfRanges:
    """Stands for the tables of a fit at several ranges, which are those of each."""

    ranges: tuple[float, ...]

    @property
    def datasets(self) -> tuple[str, ...]:
        """Refuse: tables are of one range.

        Raises
        ------
        InputError
            Always.
        """
        raise _of_one(self.ranges)

    def read(self, dataset: str, columns: Any = None, records: Any = None) -> pd.DataFrame:  # noqa: ARG002 - of a protocol
        """Refuse: a table is of one range.

        Raises
        ------
        InputError
            Always.
        """
        raise _of_one(self.ranges)

    def pieces(self, dataset: str, columns: Any, records: Any = None) -> Iterator[pd.DataFrame]:
        """Refuse: a table is of one range.

        Raises
        ------
        InputError
            Always.
        """
        yield self.read(dataset, columns, records)


def _of_one(ranges: Sequence[float]) -> InputError:
    words = ", ".join(short(list(ranges)))
    return InputError(
        f"This fit is at {len(ranges)} range{'s' if len(ranges) > 1 else ''} ({words} m), and what is asked for is of "
        f"one: take one with fit.at({ranges[0]:g}), or open its folder."
    )


@dataclass(frozen=True, eq=False)
class RangedFit(Fit):
    """Posteriors at several ranges: each is a `Fit` of its own, with its own noise, length scale and campaign.

    Parameters
    ----------
    run : mapping
        What was run: settings, versions, scan; the content of ``run.json`` of the whole.
    scan : Scan
        The scan at these ranges.
    source : Tables
        Stands for the tables, which are those of each range.
    loaded : callable
        Not used.
    place : str
        The folder, a whole path; empty in memory.
    opened : sequence of callable or None
        What returns the fit of each range; None for a range without a record that can be fitted.

    Notes
    -----
    What is of one range alone, such as draws, is asked of ``fit.at(range)``. The fits do not know of each other: draws
    of two ranges are independent given the records, though the same eddies pass both.
    """

    opened: Sequence[Callable[[], Fit] | None] = field(default=())

    def __repr__(self) -> str:
        """Say in one line what it is."""
        where = f", in {self.place!r}" if self.place else ""
        try:
            return f"<RangedFit: {len(self.fits)} of {len(self.ranges)} ranges, scan {self.scan.name}{where}>"
        except UNREADABLE as error:  # what shows itself must not fail
            return unreadable_words(self, error)

    def _repr_html_(self) -> str:
        """Say it in a notebook, with uu at each range."""
        try:
            return ranges_card(self.profile() if self.fits else pd.DataFrame(), self.scan.name, self.range_names)
        except UNREADABLE as error:  # as above
            return unreadable_card(self, error)

    @property
    def ranges(self) -> FloatArray:
        """The ranges, shape (n_range,), m: the median distance along the beams."""
        return self._of_ranges.range

    @property
    def heights(self) -> FloatArray | None:
        """The heights above the lidar, shape (n_range,), m; None if it does not look up."""
        return self._of_ranges.height

    @property
    def range_names(self) -> list[str]:
        """What to call the ranges in words, as ``range 80 m`` or ``height 120 m``."""
        return self._of_ranges.names()

    @property
    def _of_ranges(self) -> RangedScan:
        if not isinstance(self.scan, RangedScan):
            raise TypeError("the scan of a RangedFit is a RangedScan")
        return self.scan

    @cached_property
    def fits(self) -> dict[int, Fit]:
        """The fits by the place of their range; ranges without a record that can be fitted are not in it."""
        return {place: self._fit_at(place) for place, made in enumerate(self.opened) if made is not None}

    @cached_property
    def _found(self) -> dict[int, Fit]:
        """The fits that were opened so far, by the place of their range."""
        return {}

    def _fit_at(self, place: int) -> Fit:
        """Open the fit at one range, once: it does not matter to it whether the others are whole."""
        made = self.opened[place]
        if made is None:
            raise InputError(f"No record at {self.range_names[place]} could be fitted: choose another one.")
        if place not in self._found:
            self._found[place] = made()
        return self._found[place]

    def at(self, distance: float | None = None, *, height: float | None = None) -> Fit:
        """Return the fit at one range.

        Parameters
        ----------
        distance : float, optional
            The range, m; the nearest is taken, if it is within half the distance to the next.
        height : float, optional
            The height above the lidar, m, in place of the range.

        Returns
        -------
        fit : Fit
            As `fit` makes it of the records of this range alone.

        Raises
        ------
        InputError
            If there is none near, or none of its records could be fitted.
        """
        if (distance is None) == (height is None):
            raise InputError("Give a range or a height, in m, one of the two.")
        what, wanted, values = ("range", distance, self.ranges)
        if height is not None:
            if self.heights is None:
                raise InputError("This fit has no heights, since the scan does not look up: choose by range.")
            what, wanted, values = ("height", height, self.heights)
        return self._fit_at(nearest_range(values, float(wanted or 0.0), what=what))

    def _together(self, table: Callable[[Fit], pd.DataFrame]) -> pd.DataFrame:
        """Return the tables of all ranges that have rows as one, with range and height before their columns."""
        parts = []
        for place, own in self.fits.items():
            part = table(own).copy()
            if part.empty:
                continue
            if self.heights is not None:
                part.insert(0, "height", float(self.heights[place]))
            part.insert(0, "range", float(self.ranges[place]))
            parts.append(part)
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()

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
        """Summarize the posterior of every record at every range.

        Parameters
        ----------
        prob, interval, derived, frame, campaign, information, records, columns
            As for `Fit.summary`.

        Returns
        -------
        table : DataFrame
            As of `Fit.summary`, range after range, with ``range`` and, of a scan that looks up, ``height`` before its
            columns, m.

        Raises
        ------
        InputError
            As `Fit.summary`.
        """
        return self._together(
            lambda own: own.summary(
                prob=prob,
                interval=interval,
                derived=derived,
                frame=frame,
                campaign=campaign,
                information=information,
                records=records,
                columns=columns,
            )
        )

    def profile(self, record: RecordKey | None = None) -> pd.DataFrame:
        """Return the profile of stresses and turbulence intensity: what all records of each range say together.

        Parameters
        ----------
        record : int, str, datetime, Timestamp or datetime64, optional
            Number of a record, or its start (UTC; a text is an ISO time), for the profile of this record alone.

        Returns
        -------
        table : DataFrame
            One row for each range and quantity (six stresses and ``ti``): ``range``, ``height`` if the scan looks up,
            ``quantity``, ``estimate``, ``low``, ``high``, ``prob``, ``interval``, ``decided``, ``n_record``, and
            ``of``: ``campaign`` where a campaign was learnt, and the numbers are mean and interval of the posterior of
            its mean; ``median record`` where none was, and they are medians over the records of posterior medians and
            ends of intervals, which are wider; ``record`` for one record, with its median. Ranges where the record was
            not fitted have no row.

        Raises
        ------
        InputError
            If the record was fitted at no range.
        """
        if record is None:
            return self._together(_profile_of)
        rows = self._together(lambda own: _record_of(own, record))
        if rows.empty:
            next(iter(self.fits.values())).find_record(record)  # says why
            raise InputError(f"Record {record!r} was fitted at no range.")
        return rows

    def campaign(self) -> pd.DataFrame:
        """Return the campaigns of all ranges that have one, as `Fit.campaign` does, with ``range`` and ``height``.

        Raises
        ------
        InputError
            If no range has one.
        """
        return self._campaigns(lambda own: own.campaign())

    def campaign_hyper(self) -> pd.DataFrame:
        """Return the hyperparameters of the campaigns, as `Fit.campaign_hyper` does, with ``range`` and ``height``.

        Raises
        ------
        InputError
            If no range has a campaign.
        """
        return self._campaigns(lambda own: own.campaign_hyper())

    def campaign_prior(self) -> CampaignPrior:
        """Refuse: a prior is of one range.

        Raises
        ------
        InputError
            Always.
        """
        raise _of_one(self.ranges.tolist())

    @cached_property
    def prior_draws(self) -> FloatArray:
        """Refuse: draws are of one range.

        Raises
        ------
        InputError
            Always.
        """
        raise _of_one(self.ranges.tolist())

    @property
    def nuisance_names(self) -> tuple[str, ...]:
        """Names of the nuisances that have draws, those of every range."""
        return next(iter(self.fits.values())).nuisance_names

    def _campaigns(self, table: Callable[[Fit], pd.DataFrame]) -> pd.DataFrame:
        if not self.has_campaign:
            next(iter(self.fits.values())).campaign()  # says why there is none
        return self._together(lambda own: table(own) if own.has_campaign else pd.DataFrame())

    @property
    def has_campaign(self) -> bool:
        """Whether the records' common prior was learnt at some range."""
        return any(own.has_campaign for own in self.fits.values())

    @cached_property
    def _records(self) -> xr.Dataset:
        from bayes_rs.records.ranges import stack_ranges  # noqa: PLC0415 - not needed for the tables

        scan = self._of_ranges
        there = RangedScan.of(scan.of_one, scan.distance[list(self.fits)])
        return read_only_dataset(stack_ranges([own.records for own in self.fits.values()], there))

    @property
    def records(self) -> xr.Dataset:
        """The records that were fitted, dims (range, record, beam); of the ranges that were; read-only as a `Fit`'s."""
        return self._records.copy(deep=False)

    @property
    def n_record(self) -> int:
        """Number of records, those of all ranges counted."""
        return sum(own.n_record for own in self.fits.values())

    @property
    def n_fitted(self) -> int:
        """Number of records that have a posterior, those of all ranges counted."""
        return sum(own.n_fitted for own in self.fits.values())

    @property
    def flags(self) -> dict[str, int]:
        """How many records have each flag, those of all ranges counted."""
        total: dict[str, int] = {}
        for own in self.fits.values():
            for word, count in own.flags.items():
                total[word] = total.get(word, 0) + count
        return total

    @property
    def has_draws(self) -> bool:
        """Whether the draws of all ranges were kept."""
        return all(own.has_draws for own in self.fits.values())

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the fit at the first range; seed and noise are of that range."""
        return next(iter(self.fits.values())).attrs

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Starts of the records, shape (n_record of one range,)."""
        return next(iter(self.fits.values())).time

    def to_datatree(self, record: RecordKey | None = None) -> xr.DataTree:
        """Return the fits in ArviZ's layout, with the dimension ``range`` before all others.

        Parameters
        ----------
        record : None
            A record is one of one range: ``fit.at(range).to_datatree(record)``.

        Raises
        ------
        InputError
            If the draws of a range were not kept, or a record is given.
        """
        if record is not None:
            raise _of_one(self.ranges.tolist())
        fits = list(self.fits.values())
        groups = {}
        for name in group_names(fits[0]):
            if name == "log_likelihood" and not all(has_group(own, name) for own in fits):
                continue
            parts = [own[name] for own in fits]
            ranges = xr.DataArray(self.ranges[list(self.fits)], dims="range", attrs={"units": "m"}, name="range")
            groups[name] = xr.concat(parts, dim=ranges, join="outer", combine_attrs="drop_conflicts")
        return tree_of(groups, {name: value for name, value in self.attrs.items() if name not in ("seed", "scan_key")})

    def __getitem__(self, name: str) -> Any:
        """Refuse: a group is of one range."""
        raise _of_one(self.ranges.tolist())

    def __contains__(self, name: object) -> bool:
        """Say whether there is a group of that name; they are of each range."""
        return False

    def headline(self) -> Headline:
        """Return what was found, what the data decided of it and what is doubtful: of the profile, in three lines.

        Returns
        -------
        headline : Headline
            As of `Fit.headline`; turbulence intensity at the first and at the last range, from `profile`.
        """
        table = self.profile() if self.n_fitted else pd.DataFrame()
        return headline_of_ranges(self.run, self.fits, self.range_names, table)

    def people_rows(self) -> list[PeopleRows]:
        """Return where the rows of the table for people come from, range after range."""
        heights = self.heights
        return [
            PeopleRows(
                own,
                own.records,
                {
                    "range_m": float(self.ranges[place]),
                    **({} if heights is None else {"height_m": float(heights[place])}),
                },
            )
            for place, own in self.fits.items()
        ]

    def profile_lines(self) -> list[str]:
        """Return the profile as a table of text, a line for each range that has a fit."""
        if not self.n_fitted:
            return []
        what = "range" if self.heights is None else "height"
        lines = [f"{what:>7}{'records':>8}  {'TI':<20}" + "".join(f"{name:>6} " for name in STRESSES).rstrip()]
        table = self.profile()
        for place, own in self.fits.items():
            here = table[table["range"] == float(self.ranges[place])]
            rows = {str(row["quantity"]): row for row in here.to_dict("records")}
            said = f"{_marked(rows['ti'], 3)} ({rows['ti']['low']:.3f}–{rows['ti']['high']:.3f})"
            name = self.range_names[place].partition(" ")[2]
            cells = "".join(f"{_marked(rows[stress], 2):>7}" for stress in STRESSES)
            lines.append(f"{name:>7}{own.n_fitted:>8}  {said:<20}{cells}".rstrip())
        which = interval_words(float(table["prob"].iloc[0]), str(table["interval"].iloc[0]))
        of = " or ".join(dict.fromkeys(table["of"]))
        lines.append(f"TI with {which}, and stresses, m² s⁻² ({of})")
        marked = is_priors(table["decided"].to_numpy(dtype=np.float64)).any()
        return [*lines, *(["*: mostly the prior's"] if marked else [])]

    @property
    def words(self) -> list[str]:
        """What the scan sees and which prior it was, and the profile, a line for each range."""
        fits = list(self.fits.values())
        if not fits:
            return ["no range has a record that can be fitted"]
        names = self.range_names
        lost = [names[place] for place in range(len(names)) if place not in self.fits]
        lines = [f"scan {self.run['scan']}: {fits[0].run['sight']}", f"prior {fits[0].run['prior']}"]
        lines += self.profile_lines()
        return [*lines, *([f"without a record that can be fitted: {', '.join(lost)}"] if lost else [])]

    @property
    def failures(self) -> list[str]:
        """What of the data is not believed, and what failed, with the ranges where it did."""
        return self._lines(lambda own: own.failures)

    @property
    def remarks(self) -> list[str]:
        """One line for each flag that some record has at some range, and what beams disagree."""
        return self._lines(lambda own: own.remarks)

    def _lines(self, lines: Callable[[Fit], Sequence[str]]) -> list[str]:
        where: dict[str, list[str]] = {}
        names = self.range_names
        for place, own in self.fits.items():
            for line in lines(own):
                where.setdefault(line, []).append(names[place])
        said = [
            f"{places[0] if len(places) == 1 else f'{len(places)} ranges'}: {line}" for line, places in where.items()
        ]
        more = len(said) - _LISTED
        return [*said[:_LISTED], *([f"and {more} more lines: see the fits of the ranges"] if more > 0 else [])]


def _record_of(fit: Fit, record: RecordKey) -> pd.DataFrame:
    """Return the rows of one record at one range; none if it was not fitted."""
    try:
        number = fit.find_record(record)
    except InputError:
        return pd.DataFrame()
    table = _with_intensity(fit, number)
    rows = table.set_index("stress").loc[list(_QUANTITIES)].reset_index()
    rows = rows.rename(columns={"stress": "quantity", "median": "estimate"})
    return rows[list(_COLUMNS[:-2])].assign(n_record=1, of="record").reset_index(drop=True)


def _profile_of(fit: Fit) -> pd.DataFrame:
    """Return the rows of one range."""
    if fit.has_campaign:
        table = fit.campaign().rename(columns={"mean": "estimate"})
        rows = table[(table["bin"] == "all") & table["quantity"].isin(_QUANTITIES)]
        return rows[list(_COLUMNS[:-1])].assign(of="campaign").reset_index(drop=True)
    table = _with_intensity(fit)
    middle = table.groupby("stress")[["median", "low", "high", "decided"]].median().reindex(list(_QUANTITIES))
    rows = middle.reset_index().rename(columns={"stress": "quantity", "median": "estimate"})
    prob, kind = float(table["prob"].iloc[0]), str(table["interval"].iloc[0])
    return rows.assign(prob=prob, interval=kind, n_record=fit.n_fitted, of="median record")[list(_COLUMNS)]


def _with_intensity(fit: Fit, record: int | None = None) -> pd.DataFrame:
    """Return the summary's rows of the stresses, and of the turbulence intensity, σ_u/U, by the same ends."""
    table = fit.summary(
        records=record, columns=["record", "stress", "median", "low", "high", "prob", "interval", "decided"]
    )
    table = table[table["stress"].isin(STRESSES)]
    speed = fit.records["wind_speed"].values.astype(np.float64)
    ends = ["median", "low", "high"]
    intensity = table[table["stress"] == "uu"].copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        of_record = speed[intensity["record"].to_numpy()][:, np.newaxis]
        intensity[ends] = np.sqrt(intensity[ends].to_numpy(dtype=np.float64)) / of_record
    return pd.concat([table, intensity.assign(stress="ti")], ignore_index=True)


def _marked(row: Mapping[Any, Any], digits: int) -> str:
    """Write an estimate, with a star where it is mostly the prior's."""
    return f"{row['estimate']:z.{digits}f}{'*' if is_priors(row['decided']) else ' '}"
