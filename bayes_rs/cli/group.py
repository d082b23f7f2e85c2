"""The commands, and where each is: loaded when it is called for."""

from __future__ import annotations

import importlib

import click
from click.shell_completion import CompletionItem

from bayes_rs._version import __version__
from bayes_rs.cli.voice import colour_of_environment, voice_options
from bayes_rs.errors import did_you_mean

COMMANDS = {
    "demo": ("data_commands:demo", "The main job on embedded data."),
    "scans": ("scan_commands:scans", "List the shipped scans and what each sees of R, or show one."),
    "find-scan": ("scan_commands:find_scan", "Make the scan that files were measured with."),
    "look": ("scan_commands:look", "Say what is in files, and what to type next."),
    "plan": ("data_commands:plan", "Say what a scene needs computed, and what is skipped."),
    "records": ("data_commands:records", "Make records of files of radial velocities."),
    "calibrate": ("data_commands:calibrate", "Calibrate the noise of a scan, for fit --noise."),
    "fit": ("fit_commands:fit", "Estimate the stresses of every record, with credible intervals."),
    "sensitivity": ("fit_commands:sensitivity", "Say which stresses the data decide, and which the prior."),
    "corner": ("fit_commands:corner", "Draw the posterior of one record of a fit."),
    "report": ("report_command:report", "Write one HTML page of a fit."),
    "boxes": ("boxes_command:boxes", "Write boxes of turbulence of a record, for simulators of loads."),
    "app": ("app_command:app", "Look through results and choose a scan, in the browser."),
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
        return voice_options(command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command by its name; of one that is not there ask for the nearest."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            meant = did_you_mean(args[0], COMMANDS)
            ctx.fail(f"No such command {args[0]!r}.{f' {meant[0].upper()}{meant[1:]}' if meant else ''}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        """Run the command; that nobody reads its output any more ends it with words, and click would say none."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise click.Abort from error

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the names of the commands, with what they do; none is loaded for it."""
        named = ((name, words) for name, (_, words) in COMMANDS.items() if name.startswith(incomplete))
        found = [CompletionItem(name, help=words) for name, words in named]
        return [*found, *(click.Command.shell_complete(self, ctx, incomplete) if incomplete.startswith("-") else [])]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002 - as above
        """Write the commands with what they do."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="bayes-rs")
@click.pass_context
def commands(ctx: click.Context) -> None:
    """Reynolds stresses with credible intervals from Doppler-lidar radial velocities."""
    if ctx.color is None:
        ctx.color = colour_of_environment()


voice_options(commands)
