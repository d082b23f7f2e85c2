"""A fit in a folder, read as the same object as one in memory: nothing of what makes a fit is loaded for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError, in_short
from bayes_rs.fits import campaign_files
from bayes_rs.fits.columns import N_PRIOR_DRAW
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.folder_tables import FolderTables
from bayes_rs.fits.ranged_fit import RangedFit, TablesOfRanges
from bayes_rs.fits.run_file import RunOfFit, checked_run, checked_run_of_ranges
from bayes_rs.fits.tables import ADVICE, read_table
from bayes_rs.geometry.ranged_scan import RangedScan
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import load_scan_text
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.ledger import LEDGER
from bayes_rs.result_folder import RUN_FILE, ResultFolder, open_result_folder

if TYPE_CHECKING:
    from bayes_rs.fits.fit_data import FitData
    from bayes_rs.fits.fit_options import FitOptions, NoiseOptions
    from bayes_rs.noise.noise import Noise
    from bayes_rs.priors.registry import Prior

PRIOR_FILE = "prior.parquet"
RECORDS_FILE = "records.nc"
ARVIZ_FILE = "posterior.nc"


def open_fit(folder: str | Path) -> Fit:
    """Open the fit in a folder; tables and draws are read when they are asked for.

    Parameters
    ----------
    folder : str or Path
        Output folder of `fit` or of ``bayes-rs fit``, or a file at its top, such as ``posterior.nc``.

    Returns
    -------
    fit : Fit
        As `fit` returned it; of a fit at several ranges a `RangedFit`. Every file is compared with its fingerprint when
        it is read.

    Raises
    ------
    InputError
        If it is not the folder of a fit, the fit has not ended, or `run.json` was changed since it was written.

    Examples
    --------
    >>> import tempfile, bayes_rs as brs
    >>> records = brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1), "2-beam")
    >>> with tempfile.TemporaryDirectory() as place:
    ...     found = brs.fit(records, "2-beam", seed=1, output=f"{place}/two")
    ...     open_fit(f"{place}/two").summary().equals(found.summary())
    True
    """
    if not isinstance(folder, (str, Path)):
        raise InputError(f"Invalid folder of a fit {in_short(folder)}: give its name.")
    folder = _folder_of(Path(folder))
    name = str(folder)
    if folder.is_dir():
        folder = folder.absolute()  # tables are read later, when another directory may be the current one
    opened = open_result_folder(folder)
    if not opened.finished:
        raise InputError(f"The fit in {name!r} has not ended: resume it, or wait for its end.")
    run = opened.run()
    if "ranges" in run:
        return ranged_fit_in(run, str(folder))
    if "settings" not in run or "n_record" not in run:
        raise InputError(f"No fit in {name!r}: its {RUN_FILE} is of another command.")
    checked = checked_run(run, str(opened.path / RUN_FILE))
    return fit_in(opened, run, checked, load_scan_text(checked.scan_toml, name=checked.scan), str(folder))


def ranged_fit_in(run: Mapping[str, Any], place: str) -> RangedFit:
    """Return the fit at several ranges of which `run.json` says this; that of a range is opened when it is asked for.

    Parameters
    ----------
    run : mapping
        The content.
    place : str
        The folder.

    Raises
    ------
    InputError
        If the content is not as it should be.
    """
    file = str(Path(place) / RUN_FILE)
    checked = checked_run_of_ranges(run, file)
    base = load_scan_text(checked.scan_toml, name=checked.scan)
    try:
        scan = RangedScan.of(base, [one.distance for one in checked.ranges])
    except (InputError, ValueError) as error:
        raise InputError(f"File {file!r} cannot be used: its ranges are not such of its scan: {error}") from error
    opened = [None if one.folder is None else partial(open_fit, Path(place) / one.folder) for one in checked.ranges]
    return RangedFit(run, scan, TablesOfRanges(tuple(scan.range.tolist())), None, place, tuple(opened))


def _folder_of(place: Path) -> Path:
    """Return the folder of results that a file stands in, in place of the file; what else there is stays what it is."""
    return place.parent if place.is_file() and (place.parent / LEDGER).is_file() else place


def fit_in(folder: ResultFolder, run: Mapping[str, Any], checked: RunOfFit, scan: Scan, place: str) -> Fit:
    """Return the fit in a folder whose `run.json` says this, which may not have ended."""
    tables = FolderTables(folder, checked, scan.beam.tolist())
    return Fit(run, scan, tables, _InFolder(folder, tables), place)


@dataclass(frozen=True)
class _InFolder:
    """The records and the prior's draws of a fit in a folder."""

    folder: ResultFolder
    tables: FolderTables

    def records(self) -> xr.Dataset:
        from bayes_rs.readers.netcdf_file import load_netcdf  # noqa: PLC0415 - not needed for the tables
        from bayes_rs.records.layout import check_layout  # noqa: PLC0415 - as above

        file = self.folder.checked(RECORDS_FILE)
        found = load_netcdf(file)
        what = f"The records in {str(file)!r}"
        check_layout(found, "variance", "beam", "flag", "wind_speed", "yaw", what=what, advice=ADVICE)
        for name, own, of_fit in (
            ("records", found.sizes["record"], self.tables.run.n_record),
            ("beams", found["beam"].values.tolist(), list(self.tables.beams)),
        ):
            if own != of_fit:
                raise InputError(f"{what} cannot be used: the {name} are {own}, and {of_fit} were fitted; {ADVICE}.")
        return found

    def prior_draws(self) -> FloatArray:
        table = read_table(self.folder, [PRIOR_FILE], dict.fromkeys(STRESSES, "amount"))
        if len(table) != N_PRIOR_DRAW or table.isna().to_numpy().any():
            raise InputError(
                f"File {str(self.folder.path / PRIOR_FILE)!r} does not hold {N_PRIOR_DRAW} draws; {ADVICE}."
            )
        return table.to_numpy(dtype=np.float64)

    def has_log_likelihood(self) -> bool:
        return self.folder.names(ARVIZ_FILE) == [ARVIZ_FILE]

    def log_likelihood(self, fit: FitData) -> xr.Dataset:
        from bayes_rs.readers.netcdf_file import load_netcdf  # noqa: PLC0415 - not needed for the tables

        file = self.folder.checked(ARVIZ_FILE)
        found = load_netcdf(file, group="/log_likelihood")
        sizes = {"chain": self.tables.run.n_chain, "draw": self.tables.run.n_draw, "record": fit.n_record}
        known = {**sizes, "beam": len(self.tables.beams), "number": found.sizes.get("number", 0)}
        for name, value in found.data_vars.items():
            dims = (*sizes, *map(str, value.dims[3:]))
            if value.dims != dims or len(dims) > 4 or any(known.get(dim) != value.sizes[dim] for dim in dims):
                raise InputError(
                    f"The log-likelihood in {str(file)!r} cannot be used: {name!r} does not have a number for each "
                    f"draw of the fit; {ADVICE}."
                )
        return found

    def inputs(self) -> tuple[Noise | None, FitOptions, NoiseOptions]:
        """Return the noise, if one was given, and the options: what the fit is repeated with."""
        from bayes_rs.fits.settings import Settings  # noqa: PLC0415 - not needed for the tables
        from bayes_rs.noise.given import given_noise  # noqa: PLC0415 - as above

        settings = Settings.load(self.folder.path / RUN_FILE)
        return given_noise(settings.noise.noise), settings.fit, settings.noise

    def campaign_prior(self) -> Prior | None:
        from bayes_rs.priors.campaign import load_campaign_prior  # noqa: PLC0415 - seldom needed

        here = campaign_files.PRIOR_FILE in self.folder.names()
        return load_campaign_prior(self.folder.checked(campaign_files.PRIOR_FILE)) if here else None
