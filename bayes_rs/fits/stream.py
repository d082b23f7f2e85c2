"""Fits of records one by one, as they close: of radial velocities that come in pieces, while they are measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError, in_short
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions
from bayes_rs.fits.fitting import fit_in_memory, noise_section
from bayes_rs.fits.noise_choice import noise_and_records, noise_for_later, with_median_length_scale
from bayes_rs.fits.plan import Plan, of_last_record, plan_fit, with_settings
from bayes_rs.fits.prepare import check_beside_mast, check_duration
from bayes_rs.fits.range_job import RangeJob, joined_ranges, named, seed_of_range
from bayes_rs.fits.settings import Settings
from bayes_rs.geometry.ranged_scan import RangedScan, nearest_range
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.processor import one_thread
from bayes_rs.readers.ranged_series import scan_of_series
from bayes_rs.records.belief import believed
from bayes_rs.records.closing import ClosingRecords
from bayes_rs.records.given import check_is_series
from bayes_rs.records.ranges import split_ranges
from bayes_rs.records.record_options import options_of_series

MEMORY = 5
"""Records before each that tell of it, too: with it, an hour of ten-minute records."""


class Stream:
    """Fits each record of radial velocities as it closes, while they come in.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan that measures, or its name or file.
    settings : Settings, str or Path, optional
        How records are made and fitted: the sections ``records``, ``quality``, ``noise`` and ``fit`` of settings, or of
        their file. Files and the folder of results play no part.
    noise : Noise, str, Path or mapping, optional
        Noise of this scan and record length, or its file; of several ranges a mapping of each range, m, to its own. By
        default it is made once, when the first record with a wind closes, and kept: at least for 3 to 25 m/s, for
        directions up to 20° to both sides of that record's, and for length scales from 10 to 320 m, or for the one of
        the turbulence that the settings name. Records beyond are flagged ``outside_noise``.
    every : float, optional
        A record begins every so many seconds: a sliding window. By default one begins where the last ended.
    lateness : float
        How far, s, a sample may come behind the latest one before it: each record waits so long after its end. A sample
        that comes later is refused.
    memory : int
        So many records in a row before each tell, together with it, of its length scale, its instrument noise and the
        scatter of its variances, and of beams that disagree. 0: each record by itself.
    say : callable
        Takes lines that tell how the noise is made.
    **options
        Options of the settings by name, as ``duration=600.0``, ``prior="flat"``, ``seed=2``, ``turbulence="fu-2022"``
        or ``despike="median"``.

    Raises
    ------
    InputError
        If an option is not valid or asks for what only all records together tell, or the noise is of another scan or
        duration.

    Notes
    -----
    The numbers are those of the batch, bit by bit on processors of one kind:
    ``fit(make_records(series).isel(record=slice(k - memory, k + 1)), noise=stream.noise, campaign="off")`` gives of its
    last record what the stream gives of record k. Where nothing is learnt from other records, with noise of one length
    scale and ``instrument_noise=0.0, scatter="theory", unsteady_level=0.0``, that is also what the fit of all records
    gives, whatever the memory; only ``beams_disagree`` still looks at them. Draws depend on the seed and on the start
    of a record, not on how the samples come.

    A stream learns no campaign, since later records would change the earlier ones. The distribution that an earlier
    campaign has found is a prior: ``prior="campaign:FILE"``. Records of a sliding window overlap, so that those before
    one are those that lie end to end with it: an overlap would count the same air twice.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    >>> noise = brs.noise.calibrate("2-beam", wind_speed=10.0)
    >>> stream = brs.Stream("2-beam", noise=noise, seed=1)
    >>> for first in range(0, 2400, 800):  # the samples come 800 at a time
    ...     for record in stream.add(series.isel(sample=slice(first, first + 800))):
    ...         print(record.records["time"].values[0].astype("datetime64[m]"), len(record.summary()))
    2000-01-01T00:00 6
    >>> len(stream.close())
    1
    """

    def __init__(
        self,
        scan: Scan | str | Path,
        settings: Settings | str | Path | None = None,
        *,
        noise: Noise | str | Path | Mapping[float, Noise | str | Path] | None = None,
        every: float | None = None,
        lateness: float = 0.0,
        memory: int = MEMORY,
        say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
        **options: Any,
    ) -> None:
        self.scan = as_scan(scan)
        self.settings = _of(settings, options)
        self.memory = check_count(memory, what="memory", minimum=0)
        self._say = say
        self._given = self.settings.noise.noise if noise is None else noise
        self._places = [] if isinstance(self._given, Mapping) else self._made(self.scan)
        self._waiting: list[list[xr.Dataset]] = []
        self._closing = ClosingRecords(
            self.scan,
            before=self.memory,
            every=every,
            lateness=lateness,
            quality=self.settings.quality,
            **options_of_series(self.settings.records),
        )

    @property
    def noise(self) -> Noise | dict[float, Noise] | None:
        """The noise: given, or made for the first record; None until then. Of several ranges that of each, by its m."""
        if not isinstance(self.scan, RangedScan):
            return self._places[0].noise if self._places else None
        places = zip(self.scan.range.tolist(), self._places, strict=True)
        return {distance: place.noise for distance, place in places if place.noise is not None} or None

    def _made(self, scan: Scan) -> list[_Place]:
        """Return the places that records of a scan are of, with the noise that is given."""
        choice, options, given = self.settings.noise, self.settings.fit, self._given
        if not isinstance(scan, RangedScan):
            if isinstance(given, Mapping):
                raise InputError("The given noise is of several ranges, and these samples have none: give that of one.")
            return [_Place(scan, options, choice, given_noise(given), self._say).checked(self.settings)]
        noises: dict[int, Noise | None] = {}
        if isinstance(given, Mapping):
            for distance, one in given.items():
                noises[nearest_range(scan.range, distance)] = given_noise(one)
        elif given_noise(given) is not None:
            raise InputError(
                f"The given noise is of one range, and these samples are of {scan.n_range}: give a mapping of each "
                "range to its own, as noise={80.0: near, 120.0: far}, or leave it out, and it is made."
            )
        return [
            _Place(
                scan.at(index),
                replace(options, seed=seed_of_range(options.seed, float(scan.range[index]))),
                choice,
                noises.get(index),
                named(self._say, name),
            ).checked(self.settings)
            for index, name in enumerate(scan.names())
        ]

    def add(self, samples: xr.Dataset) -> list[Fit]:
        """Take the next samples, and return the fits of the records that close with them.

        Parameters
        ----------
        samples : Dataset
            Radial velocities as from `bayes_rs.read`, from one sample to many records. A record closes with the first
            sample that comes `lateness` after its end. Repeated samples count once.

        Returns
        -------
        fits : list of Fit
            One of each record, in the order of their starts; empty if none closes. It has that record alone, also one
            without any sample, flagged and not fitted. Before there is noise, records wait for the first with a wind.
            Of several ranges a `RangedFit`, without those that had no wind yet.

        Raises
        ------
        InputError
            If the samples are not valid or one comes too late; nothing of them is taken then.
        """
        check_is_series(samples, ranges=True)
        scan = scan_of_series(samples, self.scan)
        places = self._places if scan is self.scan and self._places else self._made(scan)
        found = self._closing.add(samples)
        self.scan, self._places = scan, places
        return self._fitted(found, last=False)

    def close(self) -> list[Fit]:
        """Return the fits of the records that are still open, as `add` does, and take no more samples."""
        return self._fitted(self._closing.close(), last=True)

    def _fitted(self, found: Sequence[xr.Dataset], *, last: bool) -> list[Fit]:
        several = isinstance(self.scan, RangedScan)
        self._waiting += [list(map(believed, split_ranges(one) if several else [one])) for one in found]
        for records in self._waiting:
            if all(place.noise is not None for place in self._places):
                break
            for place, own in zip(self._places, records, strict=True):
                place.find_noise(own)
        if all(place.noise is None for place in self._places):
            if last and self._waiting:
                raise InputError(
                    f"No noise is given, and none of {len(self._waiting)} records has a wind speed and direction that "
                    "it could be made for: give noise, or look at the flags of make_records(series, scan)."
                )
            return []
        waited, self._waiting = self._waiting, []
        return [self._fit(records) for records in waited]

    def _fit(self, records: list[xr.Dataset]) -> Fit:
        """Fit the last record of each place."""
        places = zip(self._places, records, strict=True)
        fits = [None if place.noise is None else place.fit(own) for place, own in places]
        if not isinstance(self.scan, RangedScan):
            return next(fit for fit in fits if fit is not None)
        choice = self.settings.noise
        job = RangeJob(xr.Dataset(), self.scan, self.settings.fit, choice, {"noise": noise_section(choice, None)})
        return joined_ranges(job, fits)


@dataclass
class _Place:
    """What records are of: a scan, or one of its ranges; with its noise and what is the same for all its fits."""

    scan: Scan
    options: FitOptions
    choice: NoiseOptions
    noise: Noise | None
    say: Callable[[str], None]
    plan: Plan | None = None
    section: dict[str, Any] | None = None

    def checked(self, settings: Settings) -> _Place:
        """Return this place, if its noise is of its scan and of records of the settings."""
        if self.noise is not None:
            self.noise.select(self.scan.beam).check_scan(self.scan)
            check_duration(settings.records.duration, self.noise)
        return self

    def _own(self, records: xr.Dataset) -> FitOptions:
        return with_median_length_scale(self.options, self.choice, records, self.noise)

    def find_noise(self, records: xr.Dataset) -> None:
        """Make the noise for the last of some records, if there is none and that one has a wind."""
        if self.noise is None:
            with one_thread():
                self.noise = noise_for_later(records, self.scan, self._own(records), self.choice, self.say)

    def fit(self, records: xr.Dataset) -> Fit:
        """Fit the last of some records as one among them."""
        own = self._own(records)
        with one_thread():
            found, told = noise_and_records(records, self.scan, self.noise, own, self.choice, lambda line: None)  # noqa: ARG005
            self.plan = plan_fit(told, self.scan, found, own, inputs={}, like=self.plan)
        self.section = self.section or noise_section(self.choice, self.noise)
        plan = with_settings(of_last_record(self.plan), noise=self.section)
        return fit_in_memory(plan, 1, None, progress=False)


def _of(settings: Settings | str | Path | None, options: dict[str, Any]) -> Settings:
    """Return the settings of a stream, checked."""
    if isinstance(settings, (str, Path)):
        settings = Settings.load(settings)
    if not isinstance(settings, (Settings, type(None))):
        raise InputError(f"Invalid settings {in_short(settings)}: give Settings(), or the file of some.")
    changed = (Settings() if settings is None else settings).changed(**options)
    own = changed.fit
    if own.campaign == "on" or own.campaign_group is not None or own.campaign_unsteady:
        raise InputError(
            "A stream learns no campaign, since it does not know the records to come: leave campaign, campaign_group "
            "and campaign_unsteady out, or give what another fit has learnt as prior='campaign:FILE'."
        )
    for name in ("motion", "mast"):
        if getattr(changed.records, name):
            raise InputError(
                f"The option {name} is not used in a stream: its files are whole when all is measured; fit with them "
                "afterwards."
            )
    check_beside_mast(own, there=False)
    return replace(changed, fit=replace(own, campaign="off"))
