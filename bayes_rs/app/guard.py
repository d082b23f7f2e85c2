"""Who may ask: the app's own page in a browser on this machine, and nobody else."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed.wsgi import StartResponse, WSGIApplication, WSGIEnvironment

HOST = "127.0.0.1"
"""The address that the app is bound to."""
_NAMES = (HOST, "localhost")
_METHODS = ("GET", "HEAD", "POST")
_MOST_BYTES = 1_000_000
"""Of a question: numbers of sliders and names of files."""
_SAME = ("same-origin", "none")


class Guard:
    """A WSGI application in front of another, which refuses what does not come from the app's own page.

    Parameters
    ----------
    app : callable
        The WSGI application behind it.
    port : int
        The port that the app listens at.
    policy : str
        The Content-Security-Policy of every answer.

    Notes
    -----
    A page elsewhere can name this machine in two ways. Its own name may be made to point here (DNS rebinding): then the
    header ``Host`` has that name. Or it sends to 127.0.0.1 across sites: then ``Origin`` or ``Sec-Fetch-Site`` say so.
    There is no websocket; a request for one is refused.
    """

    def __init__(self, app: WSGIApplication, port: int, policy: str) -> None:
        self.app = app
        self.hosts = {f"{name}:{port}" for name in _NAMES} | (set(_NAMES) if port == 80 else set())
        self.origins = {f"http://{host}" for host in self.hosts}
        self.headers = [
            ("Content-Security-Policy", policy),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
        ]

    def __call__(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        """Answer a request, or refuse it."""
        reason = self.refusal(environ)
        if reason:
            body = f"{reason}\n".encode()
            start_response(
                "403 Forbidden",
                [("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(body))), *self.headers],
            )
            return [body]

        def start(status: str, headers: list[tuple[str, str]], *more: Any) -> Callable[[bytes], object]:
            return start_response(status, [*headers, *self.headers], *more)

        return self.app(environ, start)

    def refusal(self, environ: WSGIEnvironment) -> str:
        """Return why a request is refused; empty if it is not."""
        method, length = environ["REQUEST_METHOD"], environ.get("CONTENT_LENGTH") or "0"
        from_elsewhere = environ.get("HTTP_ORIGIN", "") not in self.origins | {""} or (
            method != "GET" and environ.get("HTTP_SEC_FETCH_SITE", "none") not in _SAME
        )
        too_large = not length.isdecimal() or int(length) > _MOST_BYTES or "HTTP_TRANSFER_ENCODING" in environ
        reasons = {
            "this app answers to 127.0.0.1 and localhost, at its own port": environ.get("HTTP_HOST") not in self.hosts,
            "this request comes from another site": from_elsewhere,
            "this app answers to GET and POST": method not in _METHODS,
            "this app has no websocket": "HTTP_UPGRADE" in environ,
            "this request is larger than any of the app's pages": too_large,
        }
        return next((f"Refused: {words}." for words, so in reasons.items() if so), "")
