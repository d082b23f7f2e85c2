"""The command line: read, call, write."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bayes_rs._version import __version__

if TYPE_CHECKING:
    import xarray as xr

    from bayes_rs.job import Outcome
    from bayes_rs.long_job import LongOutcome
    from bayes_rs.noise import NoiseBank, NoiseModel
    from bayes_rs.nuisance import Nuisances
    from bayes_rs.scan import Scan

_Command = TypeVar("_Command", bound=Callable[..., Any])

EXIT_FLAGGED = 1
EXIT_BAD_INPUT = 2
_JOB_OPTIONS = (
    "noise_file",
    "turbulence",
    "noise_method",
    "prior",
    "target",
    "sampler",
    "likelihood",
    "target_ess",
    "instrument_noise",
    "prob",
    "derived",
    "seed",
)
"""Options of `fit` that both kinds of jobs take under the same name."""
_SENSITIVITY_OPTIONS = (
    "noise_file",
    "turbulence",
    "noise_method",
    "prior",
    "factors",
    "prob",
    "target",
    "sampler",
    "instrument_noise",
    "seed",
)
"""Options of `sensitivity` that its job takes under the same name."""


def main() -> None:
    """Run the command line; the exit code is 0 for done, 1 for done with failures that are listed, 2 for bad input."""
    from bayes_rs.errors import InputError, MissingExtraError, WorkerError

    try:
        code = commands.main(prog_name="bayes-rs", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        code = error.exit_code
    except click.ClickException as error:
        click.echo(f"bayes-rs: {error.format_message()}", err=True)
        code = EXIT_BAD_INPUT
    except click.Abort as error:
        click.echo("bayes-rs: interrupted.", err=True)
        _echo_notes(error.__cause__ or error.__context__)
        code = 130
    except (InputError, MissingExtraError, WorkerError, OSError) as error:
        click.echo(f"bayes-rs: {error}", err=True)
        _echo_notes(error)
        code = EXIT_BAD_INPUT
    sys.exit(code)


def _echo_notes(error: BaseException | None) -> None:
    for note in getattr(error, "__notes__", []):
        click.echo(f"bayes-rs: {note}", err=True)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="bayes-rs")
def commands() -> None:
    """Reynolds stresses with credible intervals from Doppler-lidar radial velocities."""


def _scan_options(command: _Command) -> _Command:
    named = click.option(
        "--scan", "scan_name", required=True, help="A name that `bayes-rs scans` lists, or a TOML file."
    )
    return named(_mounting_options(command))


def _mounting_options(command: _Command) -> _Command:
    for option in reversed(
        [
            click.option(
                "--opening-angle", "opening_angle_deg", type=float, help="Another half-cone opening angle, degrees."
            ),
            click.option(
                "--focus-distance", type=float, multiple=True, help="Another focus distance, m; several for planes."
            ),
            click.option("--tilt", "tilt_deg", type=float, help="Another tilt, degrees; positive raises the beam."),
            click.option("--yaw", "yaw_deg", type=float, help="Wind direction relative to the lidar axis, degrees."),
        ]
    ):
        command = option(command)
    return command


def _reading_options(command: _Command) -> _Command:
    for option in reversed(
        [
            click.option(
                "--format", "file_format", default="auto", show_default=True, help="auto, long, wide or netcdf."
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
            click.option(
                "--velocity-unit", type=click.Choice(["m/s", "km/h", "knot"]), help="Unit of the radial velocity."
            ),
            click.option("--invalid", type=float, multiple=True, help="A number that stands for a missing value."),
            click.option("--time-zone", help="Zone of times without one, as UTC or +01:00."),
            click.option("--separator", help="Between the columns of a CSV file."),
            click.option("--decimal", help="Decimal mark of a CSV file."),
            click.option("--status-valid", type=float, help="Status of a good sample."),
            click.option(
                "--out-of-order",
                type=click.Choice(["error", "sort"]),
                default="error",
                show_default=True,
                help="What to do when time goes backwards.",
            ),
        ]
    ):
        command = option(command)
    return command


def _record_options(command: _Command) -> _Command:
    for option in reversed(
        [
            click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s."),
            click.option(
                "--min-availability",
                type=float,
                default=0.8,
                show_default=True,
                help="Least share of the expected samples of a beam.",
            ),
            click.option("--cnr-range", type=(float, float), help="Lowest and highest carrier-to-noise ratio, dB."),
            click.option("--despike", type=click.Choice(["median"]), help="Rule that drops spikes."),
        ]
    ):
        command = option(command)
    return command


def _nuisance_options(command: _Command) -> _Command:
    for option in reversed(
        [
            click.option(
                "--yaw-sd",
                type=float,
                default=0.0,
                help="Uncertainty of the wind direction, degrees (standard deviation).",
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
                help="Median length scale, m, with --length-scale-sd; by default the records' own, or that of "
                "--turbulence.",
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
        ]
    ):
        command = option(command)
    return command


@commands.command()
@click.option("-o", "--output", default="bayes-rs-demo", show_default=True, help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier demo.")
@click.option("--seed", type=int, default=1, show_default=True)
def demo(output: str, overwrite: bool, seed: int) -> None:
    """The main job on embedded data: what a six-beam and a single-angle lidar know of the same wind."""
    from bayes_rs.demo import run_demo

    for line in run_demo(output, seed=seed, overwrite=overwrite):
        click.echo(line)


@commands.command()
def scans() -> None:
    """List the shipped scans and what each can see of the six stresses."""
    from bayes_rs.forward import sight
    from bayes_rs.models import preset_names
    from bayes_rs.scan_file import load_scan

    click.echo(f"{'scan':<20}{'beams':>6}{'rank':>6}{'condition':>11}  what it sees of R")
    for name in preset_names("scans"):
        scan = load_scan(name)
        seen = sight(scan)
        click.echo(f"{name:<20}{scan.n_beam:>6}{seen.rank:>6}{seen.condition:>11.1f}  {seen.in_words()}")
    click.echo("\nrank: independent directions of R that the beams see, of 6; condition: largest over smallest")
    click.echo("singular value of what is seen. Any scan takes --opening-angle, --focus-distance, --tilt and --yaw.")


@commands.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@_scan_options
@_reading_options
@_record_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="NetCDF file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def records(files: tuple[Path, ...], output: Path, overwrite: bool, **options: Any) -> None:
    """Make records, one variance a beam and averaging period, from files of radial velocities."""
    from bayes_rs.output import output_file

    with output_file(output, overwrite=overwrite) as part:
        made, _ = _make_records(files, options)
        made.to_netcdf(part, engine="h5netcdf")
    click.echo(f"{made.sizes['record']} records in {output}")


@commands.command()
@click.argument("scan")
@_mounting_options
@click.option("--turbulence", default="fu-2022", show_default=True, help="A name in models/turbulence, or a TOML file.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option(
    "--prior", default="weak", show_default=True, help="weak, flat, ratio or mann, as ratio:vv=0.6,sd_vv=0.3."
)
@click.option("--ess", "target_ess", type=int, default=1000, show_default=True, help="Effective sample size to reach.")
def plan(
    scan: str, turbulence: str, wind_speed: float, duration: float, prior: str, target_ess: int, **scan_options: Any
) -> None:
    """Say what a scene needs computed, what is skipped and why, and what bounds the error."""
    from bayes_rs.mann import load_turbulence
    from bayes_rs.planning import plan as make_plan

    made = make_plan(
        _load_scan({"scan_name": scan, **scan_options}),
        load_turbulence(turbulence),
        wind_speed=wind_speed,
        duration=duration,
        prior=prior,
        target_ess=target_ess,
    )
    for line in made.lines():
        click.echo(line)


@commands.command()
@click.argument("scan")
@_mounting_options
@click.option("--turbulence", default="fu-2022", show_default=True, help="A name in models/turbulence, or a TOML file.")
@click.option(
    "--wind-speed", type=float, multiple=True, required=True, help="Mean wind speed, m/s; several make a bank."
)
@click.option(
    "--noise-yaw",
    type=float,
    multiple=True,
    help="Wind direction relative to the lidar axis, degrees; several make a bank.",
)
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option("--method", default="theory", show_default=True, help="theory or boxes.")
@click.option("--sonic", is_flag=True, help="With the moments that `fit --target sonic` needs.")
@click.option("--boxes", "n_boxes", type=int, default=100, show_default=True, help="Number of turbulence boxes.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="NetCDF file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def calibrate(
    scan: str,
    turbulence: str,
    wind_speed: tuple[float, ...],
    noise_yaw: tuple[float, ...],
    duration: float,
    method: str,
    sonic: bool,
    n_boxes: int,
    seed: int,
    output: Path,
    overwrite: bool,
    **scan_options: Any,
) -> None:
    """Calibrate the noise of a scan's beam variances, and write it to a file for `fit --noise`."""
    from bayes_rs.calibration import calibrate as run_calibration
    from bayes_rs.mann import load_turbulence
    from bayes_rs.output import output_file

    with output_file(output, overwrite=overwrite) as part:
        noise = run_calibration(
            _load_scan({"scan_name": scan, **scan_options}),
            load_turbulence(turbulence),
            wind_speed=list(wind_speed) if len(wind_speed) > 1 else wind_speed[0],
            yaw_deg=(list(noise_yaw) if len(noise_yaw) > 1 else noise_yaw[0]) if noise_yaw else None,
            duration=duration,
            method=method,
            n_boxes=n_boxes,
            seed=seed,
            sonic=sonic,
        )
        noise.save(part)
    for line in _noise_lines(noise):
        click.echo(line)
    click.echo(f"noise in {output}")


@commands.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@_scan_options
@_reading_options
@_record_options
@click.option(
    "--noise",
    "noise_file",
    type=click.Path(path_type=Path),
    help="Noise file; by default it is made for the records' wind speeds and directions.",
)
@click.option(
    "--turbulence", default="fu-2022", show_default=True, help="Turbulence of the noise, if no noise file is given."
)
@click.option("--noise-method", default="theory", show_default=True, help="theory or boxes, if no noise file is given.")
@click.option(
    "--prior", default="weak", show_default=True, help="weak, flat, ratio or mann, as ratio:vv=0.6,sd_vv=0.3."
)
@click.option("--target", default="record", show_default=True, help="record, ensemble or sonic: which R.")
@click.option(
    "--sampler",
    default="emcee",
    show_default=True,
    help="emcee, direct, auto or emcee-plain; auto is direct, and emcee for the records where that does not do.",
)
@click.option(
    "--likelihood", default="log-normal", show_default=True, help="log-normal, gamma, gaussian or gaussian-plugin."
)
@_nuisance_options
@click.option("--ess", "target_ess", type=int, default=1000, show_default=True, help="Effective sample size to reach.")
@click.option(
    "--instrument-noise", type=float, default=0.0, show_default=True, help="Variance that the instrument adds, m² s⁻²."
)
@click.option("--prob", type=float, default=0.9, show_default=True, help="Probability of the credible intervals.")
@click.option(
    "--derived", multiple=True, help="More rows in the summary: ti, tke, friction_velocity, anisotropy_2, anisotropy_3."
)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option(
    "--draws",
    type=click.Choice(["full", "float32", "float64", "none"]),
    default="full",
    show_default=True,
    help="What is kept of the draws. full: the result in one NetCDF file, with figures, for up to 2000 records. "
    "The others are for any number of records, part by part into Parquet tables.",
)
@click.option("--workers", type=int, default=1, show_default=True, help="Processes that share the work; not with full.")
@click.option("--resume", is_flag=True, help="Go on with an interrupted run of the same command; not with full.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def fit(
    files: tuple[Path, ...], output: Path, draws: str, workers: int, resume: bool, overwrite: bool, **options: Any
) -> None:
    """Estimate the Reynolds stresses of every record, with credible intervals.

    FILES are radial velocities, or records that `bayes-rs records` wrote: of a year, one file a month, say.
    """
    from bayes_rs.job import run_fit
    from bayes_rs.long_job import MOST_FULL, run_long_fit
    from bayes_rs.output import check_output_folder

    if not resume:
        check_output_folder(output, overwrite=overwrite)
    made, scan = _make_records(files, options)
    common: dict[str, Any] = {
        **{name: options[name] for name in _JOB_OPTIONS},
        "nuisances": _nuisances(made, options),
        "overwrite": overwrite,
        "say": lambda line: click.echo(line, err=True),
        "source_files": [file.name for file in files],
    }
    n_record = made.sizes["record"]
    if draws == "full" and n_record > MOST_FULL:
        click.echo(
            f"{n_record} records: more than {MOST_FULL}, so no draws and no figures are kept; "
            "--draws float32 keeps the draws",
            err=True,
        )
        draws = "none"
    outcome: Outcome | LongOutcome
    if draws == "full":
        if resume or workers != 1:
            raise click.UsageError(
                f"--resume and --workers are not for --draws full, which up to {MOST_FULL} records have by default: "
                "add --draws none, float32 or float64."
            )
        outcome = run_fit(made, scan, output, **common)
    else:
        outcome = run_long_fit(made, scan, output, draws=draws, workers=workers, resume=resume, **common)
    for line in outcome.words:
        click.echo(line)
    click.echo(f"{outcome.n_fitted} of {outcome.n_record} records fitted; results in {output}")
    for line in outcome.failures:
        click.echo(line, err=True)
    if outcome.failures:
        sys.exit(EXIT_FLAGGED)


@commands.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@_scan_options
@_reading_options
@_record_options
@click.option(
    "--noise",
    "noise_file",
    type=click.Path(path_type=Path),
    help="Noise file; by default it is made for the records' wind speeds and directions.",
)
@click.option(
    "--turbulence", default="fu-2022", show_default=True, help="Turbulence of the noise, if no noise file is given."
)
@click.option("--noise-method", default="theory", show_default=True, help="theory or boxes, if no noise file is given.")
@click.option("--prior", default="weak", show_default=True, help="The prior whose width is varied, as for fit.")
@click.option(
    "--factor",
    "factors",
    type=float,
    multiple=True,
    default=(0.5, 2.0),
    show_default=True,
    help="Factor of all widths of the prior; several are compared.",
)
@click.option("--target", default="record", show_default=True, help="record, ensemble or sonic: which R.")
@click.option("--sampler", default="auto", show_default=True, help="emcee, direct, auto or emcee-plain.")
@_nuisance_options
@click.option(
    "--instrument-noise", type=float, default=0.0, show_default=True, help="Variance that the instrument adds, m² s⁻²."
)
@click.option("--prob", type=float, default=0.9, show_default=True, help="Probability of the central intervals.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="CSV file to write, with all columns.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def sensitivity(files: tuple[Path, ...], output: Path | None, overwrite: bool, **options: Any) -> None:
    """Fit the records under narrower and wider priors, and say which stresses the data decided.

    FILES are radial velocities, or one NetCDF file that `bayes-rs records` wrote.
    """
    from contextlib import nullcontext

    from bayes_rs.output import output_file
    from bayes_rs.sensitivity_job import run_sensitivity, sensitivity_lines

    with nullcontext() if output is None else output_file(output, overwrite=overwrite) as part:
        made, scan = _make_records(files, options)
        table = run_sensitivity(
            made,
            scan,
            **{name: options[name] for name in _SENSITIVITY_OPTIONS},
            nuisances=_nuisances(made, options),
            say=lambda line: click.echo(line, err=True),
        )
        if part is not None:
            table.to_csv(part, index=False)
    click.echo(
        f"Widths of {100.0 * options['prob']:g} % intervals, m² s⁻², medians over the fitted of "
        f"{made.sizes['record']} records. With the prior's width times a factor:"
    )
    click.echo("the posterior's width over its own under the prior itself; near 1, the data decide.")
    for line in sensitivity_lines(table):
        click.echo(line)
    if output is not None:
        click.echo(f"table in {output}")


@commands.command(name="compare")
@click.argument("scans", nargs=-1, required=True, metavar="SCAN...")
@click.option("--turbulence", multiple=True, default=("fu-2022",), show_default=True, help="Name or file; repeatable.")
@click.option("--prior", multiple=True, default=("weak",), show_default=True, help="As for fit; repeatable.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option("--target", default="record", show_default=True, help="record or ensemble: which R.")
@click.option(
    "--method",
    type=click.Choice(["fast", "full", "both"]),
    default="fast",
    show_default=True,
    help="fast: variances drawn from the noise model; full: simulated records.",
)
@click.option("--records", "n_records", type=int, help="Records for each scene; 128 fast, 200 full by default.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def compare_command(scans: tuple[str, ...], output: Path, **options: Any) -> None:
    """Compare scans by how well they would know each stress.

    SCAN is a name that `bayes-rs scans` lists or a TOML file, with changes after an @, such as
    6-beam@opening_angle_deg=30,focus_distance=49+98.
    """
    from bayes_rs.compare_job import run_compare

    _, words = run_compare(scans, output, **options)
    for line in words:
        click.echo(line)
    click.echo(f"table, figure and JSON in {output}")


@commands.command(name="trade-off")
@click.option("--beams", "n_beams", type=int, default=6, show_default=True, help="Number of beams of the contours.")
@click.option("--centre/--no-centre", default=True, show_default=True, help="One of them along the axis, or none.")
@click.option("--angle", "opening_angle_deg", type=float, multiple=True, help="Opening angle, degrees; several.")
@click.option("--distance", "focus_distance", type=float, multiple=True, help="Focus distance, m; several.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option(
    "--at",
    type=(float, float),
    default=(15.0, 98.0),
    show_default=True,
    metavar="ANGLE DISTANCE",
    help="Where numbers of beams and record lengths vary.",
)
@click.option("--number", "numbers", type=int, multiple=True, help="Number of beams of the lines; several.")
@click.option("--record-length", "durations", type=float, multiple=True, help="Record length, s; several.")
@click.option("--turbulence", default="fu-2022", show_default=True, help="Name or file.")
@click.option("--prior", default="weak", show_default=True, help="As for fit.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--scan-duration", type=float, default=1.0, show_default=True, help="Time for all beams once, s.")
@click.option("--probe-of", metavar="SCAN", help="A scan whose probe volume the beams have; points by default.")
@click.option("--records", "n_records", type=int, default=32, show_default=True, help="Records for each scene.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def trade_off_command(output: Path, overwrite: bool, **options: Any) -> None:
    """Expected interval widths of beams on a cone: opening angle, focus distance, number of beams, record length."""
    from bayes_rs.trade_job import run_trade_off

    given = {name: value for name, value in options.items() if value != ()}  # what is not listed has the job's default
    run_trade_off(output, overwrite=overwrite, say=click.echo, **given)
    click.echo(f"tables and figure in {output}")


@commands.command()
@click.option("--beams", "n_beams", type=int, required=True, help="Number of beams.")
@click.option("--max-angle", "max_angle_deg", type=float, help="Largest opening angle, degrees.")
@click.option("--rotor-radius", type=float, help="Largest distance of a measured point from the axis, m.")
@click.option(
    "--focus-distance", type=float, multiple=True, default=(98.0,), show_default=True, help="m; several for planes."
)
@click.option(
    "--criterion",
    type=click.Choice(["width", "variance", "trace"]),
    default="width",
    show_default=True,
    help="Interval widths, posterior variance, or least squares under independent noise.",
)
@click.option(
    "--turbulence",
    multiple=True,
    default=("fu-2022",),
    show_default=True,
    help="Name or file; of several, the worst case counts. Without influence on trace.",
)
@click.option("--stress", "stresses", multiple=True, help="For width: which stresses count; all by default.")
@click.option("--weight", "weights", type=float, multiple=True, help="For width: weight of each --stress.")
@click.option("--prior", default="weak", show_default=True, help="As for fit.")
@click.option("--wind-speed", type=float, default=10.0, show_default=True, help="Mean wind speed, m/s.")
@click.option("--duration", type=float, default=600.0, show_default=True, help="Averaging period, s.")
@click.option("--scan-duration", type=float, default=1.0, show_default=True, help="Time for all beams once, s.")
@click.option("--planes", default="simultaneous", show_default=True, help="simultaneous or sequential.")
@click.option("--cones", type=int, help="How many opening angles the beams share; each its own by default.")
@click.option("--centre/--no-centre", default=None, help="Hold one beam on the axis, or none.")
@click.option("--blocked", multiple=True, metavar="FROM:TO", help="Blocked range of theta, degrees from y towards z.")
@click.option("--min-elevation", "min_elevation_deg", type=float, help="Least angle above the horizontal, degrees.")
@click.option(
    "--min-spread", "min_spread_deg", type=float, default=0.0, show_default=True, help="Angle of two beams at least."
)
@click.option("--axis", default="upwind", show_default=True, help="upwind, or up for a lidar on the ground.")
@click.option("--tilt", "tilt_deg", type=float, default=0.0, show_default=True, help="Tilt of the lidar, degrees.")
@click.option("--probe-of", metavar="SCAN", help="A scan whose probe volume the beams have; points by default.")
@click.option("--starts", "n_starts", type=int, default=24, show_default=True, help="Number of local searches.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier run.")
def optimize(output: Path, overwrite: bool, **options: Any) -> None:
    """Choose the directions of a scan's beams, within limits, so that they tell most about R."""
    from bayes_rs.optimize_job import run_optimize

    options["stresses"], options["weights"] = options["stresses"] or None, options["weights"] or None
    run_optimize(output, overwrite=overwrite, say=click.echo, **options)
    click.echo(f"scan, numbers and picture in {output}")


@commands.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--record", default="0", show_default=True, help="Number of the record, or its start as 2020-09-04T12:00 (UTC)."
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Picture to write; by default corner-RECORD.png in FOLDER."
)
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
def corner(folder: Path, record: str, output: Path | None, overwrite: bool) -> None:
    """Draw the posterior of one record of a fit, with the outline of the prior."""
    from bayes_rs.job import open_result
    from bayes_rs.output import output_file
    from bayes_rs.plots import plot_corner

    figure = plot_corner(open_result(folder), record)
    picture = output if output is not None else folder / f"corner-{record.replace(':', '')}.png"
    with output_file(picture, overwrite=overwrite) as part:
        figure.savefig(part, dpi=130)  # type: ignore[attr-defined]
    click.echo(str(picture))


def _load_scan(options: dict[str, Any]) -> Scan:
    from bayes_rs.scan_file import load_scan

    distances = options["focus_distance"]
    return load_scan(
        options["scan_name"],
        opening_angle_deg=options["opening_angle_deg"],
        focus_distance=list(distances) if distances else None,
        tilt_deg=options["tilt_deg"],
        yaw_deg=options["yaw_deg"],
    )


def _nuisances(records: xr.Dataset, options: dict[str, Any]) -> Nuisances:
    from bayes_rs.mann import load_turbulence
    from bayes_rs.nuisance import Nuisances

    length_scale = options["length_scale"]
    if length_scale is not None and not options["length_scale_sd"] > 0.0:
        raise click.UsageError(
            "--length-scale is only used with --length-scale-sd: give both, or another --turbulence."
        )
    made_here = options["noise_file"] is None and "length_scale" not in records
    if options["length_scale_sd"] > 0.0 and length_scale is None and made_here:
        length_scale = load_turbulence(options["turbulence"]).length_scale
    return Nuisances(
        yaw_sd_deg=options["yaw_sd"],
        tilt_sd_deg=options["tilt_sd"],
        instrument_noise_log_sd=options["instrument_noise_sd"],
        length_scale_log_sd=options["length_scale_sd"],
        length_scale=length_scale,
        inflation=options["inflation"],
        inflation_dof=options["inflation_dof"],
    )


def _make_records(files: tuple[Path, ...], options: dict[str, Any]) -> tuple[Any, Scan]:
    """Read files and make records, or read records; say on stderr what was read and dropped."""
    from bayes_rs.job import open_record_files
    from bayes_rs.readers import read_radial_velocity
    from bayes_rs.records import describe_report, make_records

    scan = _load_scan(options)
    if (made := open_record_files(files, scan)) is not None:
        return made, scan
    series = read_radial_velocity(
        list(files),
        scan,
        file_format=options["file_format"],
        columns=_pairs(options["columns"], "--column") or None,
        beam_numbers={theirs: _whole(ours) for theirs, ours in _pairs(options["beam_numbers"], "--beam-number").items()}
        or None,
        positive=options["positive"],
        velocity_unit=options["velocity_unit"],
        invalid=list(options["invalid"]) or None,
        time_zone=options["time_zone"],
        separator=options["separator"],
        decimal=options["decimal"],
        status_valid=options["status_valid"],
        out_of_order=options["out_of_order"],
    )
    made = make_records(
        series,
        scan,
        duration=options["duration"],
        min_availability=options["min_availability"],
        cnr_range=options["cnr_range"],
        despike=options["despike"],
    )
    for line in describe_report(made):
        click.echo(line, err=True)
    return made, scan


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


def _noise_lines(noise: NoiseModel | NoiseBank) -> list[str]:
    from bayes_rs.noise import NoiseBank

    models = noise.models if isinstance(noise, NoiseBank) else (noise,)
    return [
        f"wind {model.wind_speed:g} m/s: relative standard deviation of a beam variance "
        f"{model.relative_error.min():.3f} to {model.relative_error.max():.3f}"
        for model in models
    ]
