"""The command line: read, call, write."""

from __future__ import annotations

import io
import sys

import click

from bayes_rs._version import __version__
from bayes_rs.cli.data_commands import calibrate, demo, plan, records, scans
from bayes_rs.cli.design_commands import compare_command, optimize, trade_off_command
from bayes_rs.cli.fit_commands import corner, fit, sensitivity
from bayes_rs.cli.report_command import report
from bayes_rs.cli.spectra_command import spectra
from bayes_rs.cli.wind_command import wind

EXIT_FAILURES = 1
EXIT_BAD_INPUT = 2


def main() -> None:
    """Run the command line; the exit code is 0 for done, 1 for done with failures that are listed, 2 for bad input."""
    from bayes_rs.errors import InputError, LostResultsError, MissingExtraError, WorkerError

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be text
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
    except (InputError, LostResultsError, MissingExtraError, WorkerError, OSError) as error:
        click.echo(f"bayes-rs: {_one_line(error)}", err=True)
        _echo_notes(error)
        code = EXIT_FAILURES if isinstance(error, LostResultsError) else EXIT_BAD_INPUT
    sys.exit(code)


def _one_line(error: BaseException) -> str:
    """Return what an error says without line breaks and control characters, which names and libraries bring along."""
    words = " ".join(str(error).split())
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in words)


def _echo_notes(error: BaseException | None) -> None:
    for note in getattr(error, "__notes__", []):
        click.echo(f"bayes-rs: {note}", err=True)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="bayes-rs")
def commands() -> None:
    """Reynolds stresses with credible intervals from Doppler-lidar radial velocities."""


for command in (
    demo,
    scans,
    plan,
    records,
    calibrate,
    fit,
    sensitivity,
    corner,
    report,
    spectra,
    wind,
    compare_command,
    optimize,
    trade_off_command,
):
    commands.add_command(command)
