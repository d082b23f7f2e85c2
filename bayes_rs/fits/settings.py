"""Everything that a fit of files depends on: one object, a TOML file, the command's options, and in `run.json`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError
from bayes_rs.file_options import ON_BAD_FILE, STANDARD_INPUT, FileOptions
from bayes_rs.fits.fit_options import FitOptions, NoiseOptions, prior_file
from bayes_rs.layouts import Open, read_json
from bayes_rs.options import (
    about_option,
    check_plain,
    described,
    from_plain,
    nearest,
    option,
    options_of,
    to_plain,
)
from bayes_rs.output import output_file
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.quality.rules import QualityRules
from bayes_rs.records.record_options import RecordOptions

if TYPE_CHECKING:
    from bayes_rs.geometry.scan import Scan

AUTO = "auto"
"""The scan that is found in the files."""
RUN_SUFFIX = ".json"
"""How the names of files end that are taken for the `run.json` of a run."""


@described
@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Which scan it is, and how it is mounted.

    Examples
    --------
    >>> ScanOptions(scan="6-beam", opening_angle_deg=45.0).load().n_beam
    6
    """

    scan: str | None = option(
        None,
        "A name that bayes-rs scans lists, or a TOML file; changes follow an @, as in zx-tm@probe=point; auto finds it "
        "in files whose rays say where they point",
        choices="bayes_rs.models:SCANS",
        open=True,
    )
    opening_angle_deg: float | None = option(
        None, "Another half-cone opening angle", unit="degrees", flag="--opening-angle"
    )
    focus_distance: Sequence[float] | None = option(None, "Another focus distance; several for planes", unit="m")
    tilt_deg: float | None = option(
        None, "Another tilt; positive raises the beams that point upwind", unit="degrees", flag="--tilt"
    )
    yaw_deg: float | None = option(None, "Wind direction relative to the lidar axis", unit="degrees", flag="--yaw")
    scan_group: int | None = option(
        None, "With scan auto: which scan of the files it is, where they hold several; bayes-rs find-scan lists them"
    )
    scan_toml: str | None = option(
        None, "The text of the scan's file: it counts where the name does not mean the same scan", flag=""
    )

    def __post_init__(self) -> None:
        """Check the options."""
        if self.scan_group is not None:
            check_count(self.scan_group, what="scan_group")
            if self.scan not in (None, AUTO):
                raise InputError(
                    f"Invalid scan_group with scan {self.scan!r}: it is of scan auto (--scan auto); leave it out."
                )

    def load(self) -> Scan:
        """Return the scan.

        Raises
        ------
        InputError
            If none is named, or it is not valid.
        """
        from bayes_rs.geometry.scan_file import load_scan, load_scan_text  # noqa: PLC0415 - help need not wait for it

        mounted: dict[str, Any] = {
            "opening_angle_deg": self.opening_angle_deg,
            "focus_distance": None if self.focus_distance is None else list(self.focus_distance),
            "tilt_deg": self.tilt_deg,
            "yaw_deg": self.yaw_deg,
        }
        if self.scan_toml is None:
            if self.scan is None:
                raise InputError("No scan is given: name one with scan (--scan), such as zx-tm or a TOML file.")
            if self.scan == AUTO:
                raise InputError(
                    "Scan auto is found in files of rays, and there are none here: name a scan or its file."
                )
            return load_scan(self.scan, **mounted)
        kept = load_scan_text(self.scan_toml, name=self.scan or "scan")
        if self.scan is not None:
            with suppress(InputError):  # the name need not mean anything here
                named = load_scan(self.scan, **mounted)
                return named if named.key == kept.key else kept
        return kept


@described
@dataclass(frozen=True, kw_only=True)
class InputOptions(FileOptions):
    """Which files are read, and how they are written."""

    files: Sequence[str] = option((), "Files, folders and patterns of radial velocities, or files of records", flag="")
    # a command is given whole folders, where one bad file must not stop a year: it is named at the end, and counts for
    # the exit code
    on_bad_file: str = option("skip", about_option(FileOptions, "on_bad_file").help, choices=ON_BAD_FILE)

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        names = (self.files,) if isinstance(self.files, (str, Path)) else self.files
        object.__setattr__(self, "files", tuple(str(name) for name in names))

    def of_reading(self) -> dict[str, Any]:
        """Return the options of `bayes_rs.read` that are said, by name."""
        return self.given()


@described
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where the results go, and who does the work.

    Raises
    ------
    InputError
        If the number of workers is not valid.
    """

    output: str | None = option(None, "Folder to write", metavar="FOLDER")
    overwrite: bool = option(False, "Replace the folder of an earlier run, once the new one is whole")
    resume: bool = option(False, "Go on with an interrupted run of the same settings")
    workers: int = option(1, "Processes that share the work")
    scheduler: str | None = option(None, "Address of a Dask scheduler whose workers share the work")

    def __post_init__(self) -> None:
        """Check the options."""
        check_count(self.workers, what="workers")
        if self.scheduler is not None and self.workers != 1:
            raise InputError(
                f"Invalid workers {self.workers} with scheduler {self.scheduler!r}: its own workers do the work; leave "
                "one of them out."
            )


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that a fit of files depends on, section by section.

    It is the content of a settings file (TOML), with a table for each section; the options of ``bayes-rs fit``; and
    what `run.json` holds of a run under ``settings``.

    Parameters
    ----------
    scan : ScanOptions
        Which scan it is.
    files : InputOptions
        Which files, and how they are written.
    records : RecordOptions
        How records are made.
    quality : QualityRules
        Which samples and records count.
    noise : NoiseOptions
        Which noise, or how it is made.
    fit : FitOptions
        The fit itself; its nuisances are the table ``fit.nuisances``.
    output : OutputOptions
        Where the results go.

    Examples
    --------
    >>> settings = Settings().changed(scan="zx-tm", prior="flat", yaw_sd_deg=2.0)
    >>> settings.fit.prior, settings.fit.nuisances.yaw_sd_deg
    ('flat', 2.0)
    """

    scan: ScanOptions = field(default_factory=ScanOptions)
    files: InputOptions = field(default_factory=InputOptions)
    records: RecordOptions = field(default_factory=RecordOptions)
    quality: QualityRules = field(default_factory=QualityRules)
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    output: OutputOptions = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        """Have the correlations made that the fit uses."""
        if self.fit.information == "covariances" and not self.records.correlations:
            object.__setattr__(self, "records", replace(self.records, correlations=True))

    def changed(self, **values: Any) -> Settings:
        """Return settings with other values of some options.

        Parameters
        ----------
        **values
            Options of any section by their names, those of `Nuisances` among them.

        Returns
        -------
        settings : Settings
            The new settings, checked.

        Raises
        ------
        InputError
            If an option is not known or not valid.
        """
        places = option_places()
        by_section: dict[tuple[str, ...], dict[str, Any]] = {}
        for name, value in values.items():
            if name not in places:
                raise InputError(f"Unknown option {name!r} of the settings: {nearest(name, places)}")
            by_section.setdefault(places[name], {})[name] = value
        nuisances = by_section.pop(("fit", "nuisances"), {})
        if nuisances:
            before = by_section.get(("fit",), {}).get("nuisances", self.fit.nuisances)
            by_section.setdefault(("fit",), {})["nuisances"] = replace(before, **nuisances)
        sections = {name: replace(getattr(self, name), **some) for (name,), some in by_section.items()}
        return replace(self, **sections)

    def to_plain(self) -> dict[str, Any]:
        """Return all options as plain values, a mapping for each section."""
        return {name: to_plain(getattr(self, name)) for name in SECTIONS}

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the settings to a TOML file, which `load` reads; files are written with their whole paths.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Replace an existing file.

        Raises
        ------
        InputError
            If the file exists and may not be replaced, or an option cannot be written.
        """
        plain = self.with_whole_paths().to_plain()
        lines = [*_table("fit.nuisances", plain["fit"].pop("nuisances"))]
        lines = [line for name, values in plain.items() for line in _table(name, values)] + lines
        with output_file(path, overwrite=overwrite) as part:
            part.write_text("\n".join(lines), encoding="utf-8", newline="\n")

    def input_files(self) -> list[str]:
        """Return the files that the settings name and that are there: what is read, and may not lie in the output."""
        named: list[str | Path | None] = [*self.files.files, *self.records.motion, *self.records.mast]
        named += [self.noise.noise, self.noise.flow, self.scan.scan, prior_file(self.fit.prior)]
        return [str(name) for name in named if name is not None and Path(name).exists()]

    def all_inputs(self) -> list[str]:
        """Return the same with folders and patterns as they are named: what is read, and not written over."""
        return [*map(str, self.files.files), *self.input_files()]

    def with_whole_paths(self) -> Settings:
        """Return the settings with the paths of files from the root on, so that they hold in every folder."""
        return self._placed_in(Path.cwd())

    def _placed_in(self, folder: Path) -> Settings:
        """Return the settings with relative paths as paths in a folder."""

        def place(name: str | Path) -> str:
            return STANDARD_INPUT if name == STANDARD_INPUT else str(folder / name)

        file = prior_file(self.fit.prior)

        def place_model(name: str) -> str:
            file, at, changes = name.partition(".toml@")
            return place(file) + at + changes if at or name.endswith(".toml") else name

        return replace(
            self,
            scan=replace(self.scan, scan=_unless_none(place_model, self.scan.scan)),
            files=replace(self.files, files=tuple(map(place, self.files.files))),
            records=replace(
                self.records,
                motion=tuple(map(place, self.records.motion)),
                mast=tuple(map(place, self.records.mast)),
            ),
            fit=self.fit if file is None else replace(self.fit, prior=f"campaign:{place(file)}"),
            noise=replace(
                self.noise,
                noise=_unless_none(place, self.noise.noise),
                turbulence=place_model(str(self.noise.turbulence)),
            ),
            output=replace(self.output, output=_unless_none(place, self.output.output)),
        )

    @classmethod
    def load(cls, path: str | Path) -> Settings:
        """Read settings from a TOML file, or from the ``run.json`` of a run, which they repeat.

        Parameters
        ----------
        path : str or Path
            The file. Relative paths in it are relative to its folder.

        Returns
        -------
        settings : Settings
            Checked.

        Raises
        ------
        InputError
            If there is no such file, a section or an option is not known, or a value is not valid.
        """
        file = Path(path)
        if not file.is_file():
            raise InputError(f"No settings file {str(file)!r}: give a TOML file, or the run.json of a run.")
        from bayes_rs.toml_file import read_toml  # noqa: PLC0415 - help need not wait for it

        plain = _with_prior_file(_of_run(file) if file.suffix == RUN_SUFFIX else read_toml(file), file.parent)
        return cls.from_plain(plain, where=f"settings file {str(file)!r}")._placed_in(file.parent)

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any], *, where: str) -> Settings:
        """Make settings from plain values, a mapping for each section.

        Parameters
        ----------
        plain : mapping
            As from `to_plain`; what is missing has its default.
        where : str
            Where they stand, for messages.

        Returns
        -------
        settings : Settings
            Checked.

        Raises
        ------
        InputError
            If a section or an option is not known, or a value is not valid.
        """
        sections: dict[str, Any] = {}
        for name, values in plain.items():
            if name not in SECTIONS:
                raise InputError(f"Unknown section {name!r} in {where}: {nearest(name, SECTIONS)}")
            if not isinstance(values, Mapping):
                raise InputError(f"Invalid section {name!r} in {where}: it must be a table of options, as [{name}].")
            _check_names(values, SECTIONS[name], (name,), where)
            nested = values.get("nuisances") if name == "fit" else None
            if isinstance(nested, Mapping):
                _check_names(nested, Nuisances, (name, "nuisances"), where)
            try:
                sections[name] = from_plain(SECTIONS[name], values, where=where)
            except InputError as error:
                raise InputError(f"In {where}, section {name}: {error}") from error
        return cls(**sections)


SECTIONS: dict[str, type] = {
    "scan": ScanOptions,
    "files": InputOptions,
    "records": RecordOptions,
    "quality": QualityRules,
    "noise": NoiseOptions,
    "fit": FitOptions,
    "output": OutputOptions,
}
"""The sections of the settings, and the classes of their options."""


def option_places() -> dict[str, tuple[str, ...]]:
    """Return the section of each option by its name; ``("fit", "nuisances")`` for those of `Nuisances`.

    Of two options of one name, ``status_valid``, it is that of the files: the other is a rule of quality, which a file
    of settings can name.
    """
    places: dict[str, tuple[str, ...]] = {}
    for name, cls in SECTIONS.items():
        for entry in options_of(cls):
            places.setdefault(entry.name, (name,))
    for entry in options_of(Nuisances):
        places.setdefault(entry.name, ("fit", "nuisances"))
    return places


def _check_names(values: Mapping[str, Any], cls: type, place: tuple[str, ...], where: str) -> None:
    """Refuse options that a section does not have, and say where they belong; and values of another type."""
    here = f"{where}, section {'.'.join(place)}"
    own = {entry.name: place for entry in options_of(cls)}
    every = {**option_places(), **own}
    for name in values:
        if name in own:
            continue
        if name in every:
            raise InputError(f"Unknown option {name!r} in {here}: it is one of section {'.'.join(every[name])}.")
        raise InputError(f"Unknown option {name!r} in {here}: {nearest(name, own, every)}")
    check_plain(cls, values, where=here)


def _unless_none(function: Callable[[str], str], value: str | None) -> str | None:
    return None if value is None else function(value)


def _with_prior_file(plain: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Return settings that name the file of a prior by its whole path: the prior is read as soon as they are made."""
    of_fit = plain.get("fit")
    file = prior_file(of_fit.get("prior")) if isinstance(of_fit, Mapping) else None
    if not file:
        return plain
    return {**plain, "fit": {**plain["fit"], "prior": f"campaign:{(folder / file).absolute()}"}}


class _RunToRepeat(Open):
    settings: dict[str, dict[str, Any]]
    scan: str
    scan_toml: str


def _of_run(file: Path) -> dict[str, Any]:
    """Return the settings that a `run.json` holds, such that they repeat the run from its own folder."""
    try:
        content = file.read_bytes()
    except OSError as error:
        raise InputError(f"File {str(file)!r} cannot be read as the run.json of a run: {error}.") from error
    run = read_json(_RunToRepeat, content, what=f"File {str(file)!r}", advice="give the run.json of a fit")
    plain = {name: dict(values) for name, values in run["settings"].items()}
    if plain.get("fit", {}).get("prior", "") is None:
        raise InputError(
            f"The run of {str(file)!r} had a prior that is an object of Python ({run.get('prior')}), so it cannot be "
            "repeated from its file: fit again in Python."
        )
    plain["scan"] = {"scan": run["scan"], **plain.get("scan", {}), "scan_toml": run["scan_toml"]}
    plain.setdefault("files", {}).setdefault("files", [])
    if not plain["files"]["files"]:
        plain["files"]["files"] = ["records.nc"]
    plain.pop("output", None)
    return plain


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table of a TOML file; what is not said is left out, since TOML has no null."""
    from bayes_rs.toml_file import toml_value  # noqa: PLC0415 - help need not wait for it

    said = {key: value for key, value in values.items() if value is not None and value not in ([], {})}
    return [f"[{name}]", *(f"{key} = {toml_value(value)}" for key, value in said.items()), ""] if said else []
