"""The app as a server on this machine: begun, said where, and ended by an interrupt."""

from __future__ import annotations

import errno
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING

from bayes_rs.app.guard import HOST, Guard
from bayes_rs.errors import InputError

if TYPE_CHECKING:
    from werkzeug.serving import BaseWSGIServer

    from bayes_rs.app.site import Site

_BACKLOG = 64


def listen(port: int) -> socket.socket:
    """Return a socket that listens at a port of this machine alone; 0 takes any that is free.

    Raises
    ------
    InputError
        If the port is taken, or may not be used.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port is free again as soon as an app has ended
        sock.bind((HOST, port))
        sock.listen(_BACKLOG)
    except OSError as error:
        sock.close()
        why = "in use" if error.errno == errno.EADDRINUSE else f"not to be had ({error.strerror})"
        raise InputError(
            f"Port {port} of {HOST} is {why}: choose another with --port, or 0 for any that is free."
        ) from error
    return sock


def serve(site: Site, port: int, say: Callable[[str], None], began: Callable[[str], None]) -> None:
    """Serve the app until it is interrupted.

    Parameters
    ----------
    site : Site
        The app.
    port : int
        Where; 0 for any free one.
    say : callable
        Takes the line that says where.
    began : callable
        Takes the address once the app answers.

    Raises
    ------
    InputError
        If the port cannot be had.
    """
    with closing(listen(port)) as sock:
        address = f"http://{HOST}:{sock.getsockname()[1]}/"
        server = _server(site, sock)
        say(f"the app is at {address} (stop it with Ctrl+C)")
        worker = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        worker.start()
        try:
            began(address)
            worker.join()
        finally:
            server.shutdown()
            worker.join()
            server.server_close()


def _server(site: Site, sock: socket.socket) -> BaseWSGIServer:
    """Return a server of threads, which says nothing of requests that are answered."""
    from werkzeug.serving import make_server  # noqa: PLC0415 - of the extra

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    port = sock.getsockname()[1]
    made = make_server(HOST, port, Guard(site.wsgi, port, site.policy), threaded=True, fd=sock.fileno())
    made.daemon_threads = True  # type: ignore[attr-defined]  # of the threaded server
    return made
