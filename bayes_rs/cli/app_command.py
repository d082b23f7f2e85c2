"""The command that begins the app."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import click

from bayes_rs.cli.options import GroupedCommand, Quantity, settings_of, settings_options


@click.command(cls=GroupedCommand)
@click.argument("files", nargs=-1, metavar="[FOLDER|FILES...]", type=click.Path())
@settings_options("scan", "files", "records", "quality")
@click.option(
    "--port",
    type=Quantity("port", minimum=0),
    default=8050,
    show_default=True,
    help="Port of 127.0.0.1 to listen at; 0 takes any that is free.",
)
@click.option("--open/--no-open", "show", default=True, show_default=True, help="Open the app in the browser.")
def app(files: tuple[str, ...], port: int, show: bool, **options: Any) -> None:
    """Look through results and choose a scan, in the browser; only this machine can reach it.

    Without an argument it looks for results below the working folder. The options say how files of radial velocities
    are read. It runs until it is interrupted. It needs the extra: pip install "bayes_rs[app]".
    """
    settings = settings_of((), options)

    from bayes_rs.app.server import serve
    from bayes_rs.errors import InputError
    from bayes_rs.interrupts import take_notice

    if port > 65535:
        raise InputError(f"Invalid port {port}: it is at most 65535.")

    from bayes_rs.app.making import make_app

    site = make_app(files, settings)
    try:
        serve(site, port, click.echo, _show if show else lambda address: None)  # noqa: ARG005 - nothing is opened
    except KeyboardInterrupt:  # also when the system ends it: that is how a server is stopped
        take_notice()
        click.echo("stopped.")


def _show(address: str) -> None:
    """Open a browser where there is somebody to see it."""
    if not sys.stdout.isatty():
        return
    import webbrowser

    with suppress(webbrowser.Error):
        webbrowser.open(address)
