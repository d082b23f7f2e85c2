"""Options that several commands share, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    import xarray as xr

    from bayes_rs.geometry.scan import Scan
    from bayes_rs.posteriors.nuisance import Nuisances

_Command = TypeVar("_Command", bound=Callable[..., Any])


def _together(*options: Callable[[Any], Any]) -> Callable[[_Command], _Command]:
    """Return one decorator for several options, listed in the order of the help."""

    def decorate(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


class NumberOrRecords(click.ParamType):  # type: ignore[type-arg] # generic in new versions of click only
    """A number of some unit, or the word records."""

    name = "number or records"

    def __init__(self, unit: str) -> None:
        """Take the unit, for the message."""
        self.unit = unit

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        """Return the number, or the word."""
        if value == "records":
            return "records"
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} must be a number, {self.unit}, or the word records.", param, ctx)


mounting_options = _together(
    click.option("--opening-angle", "opening_angle_deg", type=float, help="Another half-cone opening angle, degrees."),
    click.option("--focus-distance", type=float, multiple=True, help="Another focus distance, m; several for planes."),
    click.option("--tilt", "tilt_deg", type=float, help="Another tilt, degrees; positive raises the beam."),
    click.option("--yaw", "yaw_deg", type=float, help="Wind direction relative to the lidar axis, degrees."),
)
"""How the scan is mounted, if not as its file says."""


scan_options = _together(
    click.option(
        "--scan",
        "scan_name",
        required=True,
        help="A name that `bayes-rs scans` lists, or a TOML file; changes follow an @, as in zx-tm@probe=point.",
    ),
    mounting_options,
)
"""Which scan it is, and how it is mounted."""


reading_options = _together(
    click.option(
        "--format",
        "file_format",
        default="auto",
        show_default=True,
        help="Format of the files; auto finds it from their suffix and what they hold.",
    ),
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="OURS=THEIRS",
        help="Name of a column, as radial_velocity=RWS.",
    ),
    click.option(
        "--beam-number",
        "beam_numbers",
        multiple=True,
        metavar="THEIRS=OURS",
        help="Number of a beam, as LOS2=2.",
    ),
    click.option(
        "--positive", type=click.Choice(["away", "towards"]), help="Sign of the radial velocity in the files."
    ),
    click.option("--velocity-unit", type=click.Choice(["m/s", "km/h", "knot"]), help="Unit of the radial velocity."),
    click.option("--invalid", type=float, multiple=True, help="A number that stands for a missing value."),
    click.option("--time-zone", help="Zone of times without one, as UTC or +01:00."),
    click.option("--separator", help="Between the columns of a CSV file."),
    click.option("--decimal", help="Decimal mark of a CSV file."),
    click.option("--status-valid", type=float, help="Status of a good sample."),
    click.option(
        "--time-stamp",
        type=click.Choice(["start", "middle", "end"]),
        help="What a time in the files stands for: start, middle or end of a sample.",
    ),
    click.option("--time-format", help="Format of times in the files that are not ISO 8601, as %d.%m.%Y %H:%M:%S."),
    click.option("--sample-duration", type=float, help="Length of a sample, s, for --time-stamp."),
    click.option("--angle-tolerance", "angle_tolerance_deg", type=float, help="Of a ray from its beam, degrees."),
    click.option(
        "--phase-zero",
        "phase_zero_deg",
        type=float,
        help="Where on its cone a ZX's phase is zero, degrees: 0 sideways (y), 90 up.",
    ),
    click.option("--phase-turns", type=click.Choice(["up", "down"]), help="Which way it turns from there."),
    click.option("--range-tolerance", type=float, help="Of a gate from a beam's focus distance, m."),
    click.option(
        "--on-bad-file",
        type=click.Choice(["error", "skip"]),
        default="error",
        show_default=True,
        help="What to do with a file that cannot be used.",
    ),
    click.option(
        "--out-of-order",
        type=click.Choice(["error", "sort"]),
        default="error",
        show_default=True,
        help="What to do when time goes backwards.",
    ),
)
"""How the files are written, as for `bayes_rs.read`."""


_RULES = (
    "cnr_range",
    "velocity_range",
    "hard_target_cnr",
    "frozen_run",
    "blade_threshold",
    "blade_frequency",
    "despike",
    "trend_level",
    "sub_variance_limit",
    "half_ratio_limit",
    "min_wind_speed",
    "exclude",
)
"""Options of records that `bayes_rs.QualityRules` takes under the same name."""

_MAKING = ("duration", "min_availability", "motion", "motion_columns", *_RULES)
"""Options of records."""

record_options = _together(
    click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s."),
    click.option(
        "--min-availability",
        type=float,
        default=0.8,
        show_default=True,
        help="Least share of the expected samples of a beam.",
    ),
    click.option("--cnr-range", type=(float, float), help="Lowest and highest carrier-to-noise ratio, dB."),
    click.option("--velocity-range", type=(float, float), help="Lowest and highest radial velocity, m/s."),
    click.option("--hard-target-cnr", type=float, help="Drop samples that hardly move from this CNR on, dB."),
    click.option("--frozen-run", type=int, help="Drop runs of so many equal values."),
    click.option("--blade-threshold", type=float, help="Drop samples so many robust deviations towards zero."),
    click.option("--blade-frequency", type=(float, float), help="Where to look for the blades' frequency, Hz."),
    click.option("--despike", type=click.Choice(["median"]), help="Rule that drops spikes."),
    click.option("--trend-level", type=float, help="Level of the test for a trend, as 0.01; remarks on records."),
    click.option("--sub-variance-limit", type=float, help="Share of the variance between parts that is remarked on."),
    click.option("--half-ratio-limit", type=float, help="Ratio of the halves' variances that is remarked on."),
    click.option("--min-wind-speed", type=float, help="Mean wind speed below which a record is remarked on, m/s."),
    click.option(
        "--motion",
        type=click.Path(path_type=Path),
        multiple=True,
        help="File with the lidar's own tilt and roll over time, for each record's own attitude; several.",
    ),
    click.option(
        "--motion-column",
        "motion_columns",
        multiple=True,
        metavar="OURS=THEIRS",
        help="Its columns, as time=Timestamp or tilt_deg=Tilt.",
    ),
    click.option(
        "--exclude",
        multiple=True,
        type=click.Choice(["not_stationary", "low_wind"]),
        help="A remark that takes a record out of the fit; repeatable.",
    ),
)
"""How records are made, as for `bayes_rs.make_records`."""


instrument_noise_option = click.option(
    "--instrument-noise",
    type=NumberOrRecords("m² s⁻²"),
    default=0.0,
    show_default=True,
    help="Variance that the instrument adds, m² s⁻²; or records, for what each record holds for each beam, as those "
    "that bayes-rs spectra writes.",
)
"""What the instrument adds to the variances, as in `bayes_rs.fit`."""


nuisance_options = _together(
    click.option(
        "--yaw-sd",
        type=NumberOrRecords("degrees"),
        default=0.0,
        help="Uncertainty of the wind direction, degrees (standard deviation); or records, for each record's own: as "
        "it holds it, else as its beams' means give it.",
    ),
    click.option(
        "--yaw-sd-missing",
        type=float,
        help="With --yaw-sd records, that of records which have none, degrees; by default they are refused.",
    ),
    click.option("--tilt-sd", type=float, default=0.0, help="Uncertainty of the lidar's tilt, degrees."),
    click.option(
        "--instrument-noise-sd",
        type=float,
        default=0.0,
        help="Uncertainty of --instrument-noise: standard deviation of its logarithm.",
    ),
    click.option(
        "--length-scale-sd",
        type=float,
        default=0.0,
        help="Uncertainty of the turbulence's length scale: standard deviation of its logarithm.",
    ),
    click.option(
        "--length-scale",
        type=float,
        help="Median length scale, m, with --length-scale-sd; by default the records' own, or that of --turbulence.",
    ),
    click.option(
        "--vertical-gradient-sd",
        type=float,
        default=0.0,
        help="Vertical change of the stresses: standard deviation of the change of their logarithm over 100 m.",
    ),
    click.option(
        "--lateral-gradient-sd", type=float, default=0.0, help="The same for a lateral change of the stresses."
    ),
    click.option(
        "--inflation", type=float, default=1.0, help="Factor of the noise's covariance, for less Gaussian flow."
    ),
    click.option(
        "--inflation-dof",
        type=float,
        default=float("inf"),
        help="Degrees of freedom of an uncertain factor; by default it is certain.",
    ),
)
"""What is uncertain beside R, as in `bayes_rs.Nuisances`."""


def chosen_scan(options: dict[str, Any]) -> Scan:
    """Load the scan that the options name, mounted as they say."""
    from bayes_rs.geometry.scan_file import load_scan

    distances = options["focus_distance"]
    return load_scan(
        options["scan_name"],
        opening_angle_deg=options["opening_angle_deg"],
        focus_distance=list(distances) if distances else None,
        tilt_deg=options["tilt_deg"],
        yaw_deg=options["yaw_deg"],
    )


def chosen_nuisances(records: xr.Dataset | None, options: dict[str, Any]) -> Nuisances:
    """Return what the options say is uncertain beside R."""
    from bayes_rs.posteriors.nuisance import Nuisances
    from bayes_rs.turbulence.mann import load_turbulence

    length_scale = options["length_scale"]
    if length_scale is not None and not options["length_scale_sd"] > 0.0:
        raise click.UsageError(
            "--length-scale is only used with --length-scale-sd: give both, or another --turbulence."
        )
    made_here = options["noise_file"] is None and (records is None or "length_scale" not in records)
    if options["length_scale_sd"] > 0.0 and length_scale is None and made_here:
        length_scale = load_turbulence(options["turbulence"]).length_scale
    return Nuisances(
        yaw_sd_deg=options["yaw_sd"],
        yaw_sd_missing_deg=options["yaw_sd_missing"],
        tilt_sd_deg=options["tilt_sd"],
        instrument_noise_log_sd=options["instrument_noise_sd"],
        length_scale_log_sd=options["length_scale_sd"],
        length_scale=length_scale,
        vertical_gradient_sd=options["vertical_gradient_sd"],
        lateral_gradient_sd=options["lateral_gradient_sd"],
        inflation=options["inflation"],
        inflation_dof=options["inflation_dof"],
    )


def read_or_make_records(files: tuple[Path, ...], options: dict[str, Any]) -> tuple[xr.Dataset, Scan]:
    """Read files and make records, or read records; say on stderr what was read and dropped."""
    scan = chosen_scan(options)
    if (made := given_records(files, scan)) is not None:
        return made, scan
    return records_of(read_series(files, scan, options), scan, options), scan


def given_records(files: tuple[Path, ...], scan: Scan) -> xr.Dataset | None:
    """Read records that were written before; None if the files are something else.

    Raises
    ------
    UsageError
        If the command line has options of reading, or of making records: they would have no effect.
    """
    from bayes_rs.records.record_files import open_record_files

    made = open_record_files(files, scan)
    context = click.get_current_context()
    without_effect = [
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.name in (*_reading_names(), *_MAKING)
        and context.get_parameter_source(parameter.name) is click.core.ParameterSource.COMMANDLINE
    ]
    if made is not None and without_effect:
        raise click.UsageError(
            f"{', '.join(without_effect)}: for radial velocities only, and {str(files[0])!r} holds records that were "
            "made before: leave it out, or give the files of radial velocities."
        )
    return made


def read_series(files: tuple[Path, ...], scan: Scan, options: dict[str, Any]) -> xr.Dataset:
    """Read radial velocities as the reading options say."""
    from bayes_rs.readers.reading import read

    return read(list(files), scan, **reading_choices(options))


def _reading_names() -> list[str]:
    from bayes_rs.file_options import FileOptions
    from bayes_rs.options import options_of

    return [entry.name for entry in options_of(FileOptions)]


def reading_choices(options: dict[str, Any]) -> dict[str, Any]:
    """Return the reading options that are given, by the names of `bayes_rs.readers.FileOptions`."""
    from bayes_rs.file_options import FileOptions

    numbers = _pairs(options["beam_numbers"], "--beam-number")
    chosen = {
        **{name: options[name] for name in _reading_names()},
        "columns": _pairs(options["columns"], "--column"),
        "beam_numbers": {theirs: _whole(ours) for theirs, ours in numbers.items()},
        "invalid": options["invalid"] or None,
    }
    return FileOptions(**chosen).given()


def records_of(series: xr.Dataset, scan: Scan, options: dict[str, Any]) -> xr.Dataset:
    """Make records as the options say, and say on stderr what was read and dropped."""
    from bayes_rs.records.making import make_records
    from bayes_rs.records.report import describe_report

    if options["motion_columns"] and not options["motion"]:
        raise click.UsageError("--motion-column is only used with --motion: give the file, or leave it out.")
    made = make_records(series, scan, **record_choices(options))
    for line in describe_report(made):
        click.echo(line, err=True)
    if options["motion"]:
        from bayes_rs.file_options import FileOptions
        from bayes_rs.records.record_options import RecordOptions
        from bayes_rs.wind.motion import add_motion

        columns = _pairs(options["motion_columns"], "--motion-column")
        asked = RecordOptions(motion=options["motion"], motion_columns=columns)
        made = add_motion(made, scan, asked, FileOptions(**reading_choices(options)))
        without = int((made["motion_count"] == 0).sum())
        click.echo(f"tilt and roll from {len(options['motion'])} files; {without} records without", err=True)
    return made


def record_choices(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of records by the names of `bayes_rs.make_records`."""
    from bayes_rs.quality.rules import QualityRules

    rules = QualityRules(**{name: options[name] for name in _RULES})
    return {"duration": options["duration"], "min_availability": options["min_availability"], "quality": rules}


def _pairs(texts: tuple[str, ...], option: str) -> dict[str, str]:
    for text in texts:
        if "=" not in text:
            raise click.UsageError(f"{option} {text!r}: write it as NAME=NAME.")
    return dict(text.split("=", 1) for text in texts)


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise click.UsageError(
            f"--beam-number: {text!r} must be a whole number, the beam's number in the scan."
        ) from error
