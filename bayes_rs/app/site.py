"""The app as a site of two pages: what it is made of, and what its answers allow a browser."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_rs.app.latest import Latest
from bayes_rs.errors import InputError, MissingExtraError

try:
    from dash import Dash, ctx, no_update, set_props
    from dash import dcc as _dcc
    from dash import html as _html
    from dash.dependencies import Input, Output, State
except ImportError as error:
    raise MissingExtraError('The app needs the package dash: run pip install "bayes_rs[app]".') from error

if TYPE_CHECKING:
    from _typeshed.wsgi import WSGIApplication

__all__ = ["Input", "Output", "Site", "State", "ctx", "dcc", "html", "no_update", "one_line"]

dcc: Any = _dcc
html: Any = _html
"""The framework's elements; the types that it gives them leave out attributes such as ``aria-label``."""
TITLE = "bayes-rs"
_PAGES = {"/": "Results", "/scan": "Choose a scan"}
_THEME = """
function(path) {
  const dark = window.matchMedia('(prefers-color-scheme: dark)');
  const set = () => dash_clientside.set_props('theme', {data: dark.matches ? 'dark' : 'light'});
  if (!window.bayesRsTheme) { window.bayesRsTheme = true; dark.addEventListener('change', set); }
  return dark.matches ? 'dark' : 'light';
}
"""
"""Says whether the browser wants a dark page, and says it again when that changes."""


REST = 50
"""Milliseconds that a slider must rest before the page asks."""
_RESTED = """
function(...values) {
  const moved = window.bayesRsMoved = window.bayesRsMoved || {};
  const mine = moved['%s'] = (moved['%s'] || 0) + 1;
  return new Promise(done => setTimeout(
    () => done(mine === window.bayesRsMoved['%s'] ? values : window.dash_clientside.no_update), %d));
}
"""


class Site:
    """The site: pages are added to it, and it is served as a WSGI application.

    Everything that a page loads comes from the app itself; the Content-Security-Policy has the browser refuse the rest.
    """

    def __init__(self) -> None:
        self.dash = Dash(
            __name__,
            assets_folder=str(Path(__file__).parent / "assets"),
            serve_locally=True,
            suppress_callback_exceptions=True,  # a page's parts are there when the page is
            title=TITLE,
            update_title="",
            add_log_handler=False,
            enable_mcp=False,
            on_error=_say_error,
        )
        self.dash.enable_dev_tools(
            debug=False, dev_tools_ui=False, dev_tools_hot_reload=False, dev_tools_disable_version_check=True
        )
        self.latest = Latest()
        self._pages: dict[str, Callable[[], Any]] = {}
        self.dash.layout = _frame
        self.in_browser(_THEME, Output("theme", "data"), Input("address", "pathname"))
        self.answer(
            self._page, [Output("page", "children"), Output("links", "children")], [Input("address", "pathname")]
        )

    def page(self, path: str, layout: Callable[[], Any]) -> None:
        """Add the layout of a page, which is made when it is opened."""
        self._pages[path] = layout

    def answer(self, function: Callable[..., Any], outputs: Any, inputs: Sequence[Any], **options: Any) -> None:
        """Have a function answer changes in the page."""
        self.dash.callback(outputs, *inputs, **options)(function)

    def in_browser(self, script: str, output: Any, *inputs: Any) -> None:
        """Have a script answer changes in the page, without asking the server."""
        self.dash.clientside_callback(script, output, *inputs)  # type: ignore[no-untyped-call]  # it has no types

    def when_rested(self, store: str, inputs: Sequence[Any]) -> None:
        """Have a store of the page take the values of inputs as soon as none of them has moved for a moment."""
        self.in_browser(_RESTED % (store, store, store, REST), Output(store, "data"), *inputs)

    @property
    def wsgi(self) -> WSGIApplication:
        """The application that answers requests."""
        application: WSGIApplication = self.dash.server
        return application

    @property
    def policy(self) -> str:
        """What a browser may load: what comes from here, the scripts that pages begin with, and pictures in them."""
        scripts = " ".join(["'self'", *self.dash.csp_hashes()])
        return (
            f"default-src 'self'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
            "connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )

    def _page(self, path: str | None) -> tuple[Any, Any]:
        shown = path if path in self._pages else "/"
        links = [_link(place, name, here=place == shown) for place, name in _PAGES.items()]
        return self._pages[shown](), links


def _link(place: str, name: str, *, here: bool) -> Any:
    current: dict[str, Any] = {"aria-current": "page"} if here else {}
    return html.A(name, href=place, className="here" if here else "", **current)


def _frame() -> Any:
    """Return what all pages have; every opened page has a name of its own."""
    return html.Div(
        [
            dcc.Location(id="address"),
            dcc.Store(id="theme"),
            dcc.Store(id="visit", data=uuid.uuid4().hex),
            html.Header([html.Strong(TITLE), html.Nav(id="links")]),
            html.Main(id="page"),
            html.Div(id="fault", role="alert", className="message"),
        ]
    )


def _say_error(error: Exception) -> None:
    """Show in the page, in one line, what went wrong; bad input has its own place and does not come here."""
    words = str(error) if isinstance(error, (InputError, OSError)) else f"a fault of bayes_rs: {type(error).__name__}"
    set_props("fault", {"children": " ".join(words.split())})


def one_line(error: Exception) -> str:
    """Return what an error says in one line."""
    return " ".join(str(error).split())
