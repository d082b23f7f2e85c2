"""The command line: read, call, write."""

from __future__ import annotations

import importlib
import io
import sys

import click

from bayes_rs._version import __version__

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


COMMANDS = {
    "demo": ("data_commands:demo", "The main job on embedded data."),
    "scans": ("data_commands:scans", "List the shipped scans, and what each sees of R."),
    "plan": ("data_commands:plan", "Say what a scene needs computed, and what is skipped."),
    "records": ("data_commands:records", "Make records of files of radial velocities."),
    "calibrate": ("data_commands:calibrate", "Calibrate the noise of a scan, for fit --noise."),
    "fit": ("fit_commands:fit", "Estimate the stresses of every record, with credible intervals."),
    "sensitivity": ("fit_commands:sensitivity", "Say which stresses the data decide, and which the prior."),
    "corner": ("fit_commands:corner", "Draw the posterior of one record of a fit."),
    "report": ("report_command:report", "Write one HTML page of a fit."),
    "spectra": ("spectra_command:spectra", "Spectra, length scale and instrument noise of every record."),
    "wind": ("wind_command:wind", "Mean wind of every record, with standard deviations."),
    "compare": ("design_commands:compare_command", "Compare scans by their interval widths."),
    "optimize": ("design_commands:optimize", "Choose the directions of a scan's beams."),
}
"""The commands: where each is, and what it does. A command is loaded when it is called for."""


class LazyGroup(click.Group):
    """Commands that are loaded when they are called for: help must not wait for numpy."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - the same in any context
        """Return the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as above
        """Load a command."""
        if cmd_name not in COMMANDS:
            return None
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(f"bayes_rs.cli.{module}"), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002 - as above
        """Write the commands with what they do."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="bayes-rs")
def commands() -> None:
    """Reynolds stresses with credible intervals from Doppler-lidar radial velocities."""
