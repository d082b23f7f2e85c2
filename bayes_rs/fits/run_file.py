"""What `run.json` of a fit holds, for those who read it again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, model_validator

from bayes_rs.errors import InputError
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.layouts import Count, Finite, Open, Positive, check_plain
from bayes_rs.options import check_plain as check_options
from bayes_rs.options import from_plain, options_of

_SIX = Field(min_length=len(STRESSES), max_length=len(STRESSES))
_Six = Annotated[list[Finite], _SIX]
_Number = Annotated[int, Field(ge=1, le=2**40)]
_ADVICE = "resume the fit to make it again, or fit anew"


class _Sight(Open):
    weight: _Six
    vectors: Annotated[list[_Six], _SIX]


class _FitSection(Open):
    derived: list[str]


class _Settings(Open):
    fit: _FitSection


class AboutCampaign(Open):
    """What there is to say of a campaign, or why there is none."""

    on: bool
    why: str = ""
    n_record: Count = 0
    n_sampled: Count = 0
    n_sweep: Count = 0
    acceptance: dict[str, Finite] = Field(default_factory=dict)
    ess: Finite = 0.0
    r_hat: float = 1.0
    converged: bool = True
    prior: str = ""

    @model_validator(mode="after")
    def _says_all(self) -> AboutCampaign:
        wanted = set(type(self).model_fields) - {"why"} if self.on else {"why"}
        if missing := sorted(wanted - self.model_fields_set):
            raise ValueError(f"it has no {missing[0]}")
        return self


class _Told(Open):
    words: str = ""


class _Beams(Open):
    words: list[str] = Field(default_factory=list)
    together: list[str] = Field(default_factory=list)


class RunOfFit(Open):
    """The entries of `run.json` that a fit is read by; others may be there."""

    bayes_rs: str
    packages: dict[str, str] = Field(default_factory=dict)
    settings: _Settings
    scan: str
    scan_key: str
    scan_toml: str
    sight: str
    directions: _Sight
    noise: dict[str, Any]
    probe_volume: str = ""
    prior: str
    prior_name: str
    prior_widths: _Six
    length_scale: _Told | None = None
    instrument_noise: _Told | None = None
    nuisances: str
    nuisance_names: list[str]
    doubts: list[str] = Field(default_factory=list)
    n_record: _Number
    part_records: _Number
    n_chain: _Number
    n_draw: _Number
    n_predicted: Count
    n_resumed: Count = 0
    beams: _Beams = _Beams()
    campaign: AboutCampaign = AboutCampaign(on=False, why="")
    bad_files: dict[str, str] = Field(default_factory=dict)
    samples_late: Count = 0
    first_late: str = ""
    key_parts: dict[str, str] = Field(default_factory=dict)


class OneRange(Open):
    """A range, and the folder of its fit; none where no record could be fitted."""

    range: Positive
    height: Positive | None = None
    distance: Annotated[list[Positive], Field(min_length=1)]
    folder: Annotated[str, Field(pattern=r"^[a-z]+-[0-9.]+m$")] | None = None


class RunOfRanges(Open):
    """The entries of `run.json` that a fit at several ranges is read by."""

    bayes_rs: str
    settings: _Settings
    scan: str
    scan_toml: str
    ranges: Annotated[list[OneRange], Field(min_length=1)]
    bad_files: dict[str, str] = Field(default_factory=dict)
    samples_late: Count = 0
    first_late: str = ""


def checked_run_of_ranges(run: Mapping[str, Any], file: str) -> RunOfRanges:
    """Return what `run.json` of a fit at several ranges says, checked.

    Raises
    ------
    InputError
        If an entry is missing, or is of another type.
    """
    found: RunOfRanges = check_plain(RunOfRanges, dict(run), what=f"File {file!r}", advice=_ADVICE)
    return found


def checked_run(run: Mapping[str, Any], file: str) -> RunOfFit:
    """Return what `run.json` says, checked, with the options of the fit, which are checked as settings are.

    Parameters
    ----------
    run : mapping
        The content.
    file : str
        Where it stands, for messages.

    Raises
    ------
    InputError
        If an entry is missing, is of another type, or is not possible.
    """
    what = f"File {file!r}"
    found: RunOfFit = check_plain(RunOfFit, dict(run), what=what, advice=_ADVICE)
    options = run["settings"]["fit"]
    for entry in options_of(FitOptions):
        if entry.name not in options:
            raise InputError(f"{what} cannot be used: settings.fit has no {entry.name}; {_ADVICE}.")
    plain = {**options, "prior": "weak"}  # that of a file need not be there any more, nor an object of Python
    check_options(FitOptions, plain, where=f"file {file!r}")
    from_plain(FitOptions, plain, where=f"file {file!r}")
    return found
