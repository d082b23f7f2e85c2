"""The page of results: open a fit, spectra or files, and look at the beams and at any record."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs import plot
from bayes_rs.app.charts import CONFIG, availability_chart
from bayes_rs.app.choosing import number_of
from bayes_rs.app.opening import Opened, open_place, place_below, places, with_fit
from bayes_rs.app.pictures import picture
from bayes_rs.app.record_view import corner_of, record_chart, record_rows, record_table, spectra_of
from bayes_rs.app.site import Input, Output, Site, State, ctx, dcc, html, no_update, one_line
from bayes_rs.errors import InputError
from bayes_rs.fits.fit_object import Fit
from bayes_rs.fits.settings import Settings
from bayes_rs.intervals import interval_words
from bayes_rs.models import SCANS
from bayes_rs.report.availability import make_availability
from bayes_rs.result_folder import RUN_FILE

_MOST_KEPT = 3
_RECORD = "function(value, names) { return names && names.length ? names[value] : ''; }"
_FAULTS = (InputError, OSError, ValueError)


class ResultsPage:
    """The page, with what was opened last.

    Parameters
    ----------
    site : Site
        Where it is added.
    start : Path
        The folder that things are opened in and below.
    first : str
        What is opened at once, relative to it; nothing if empty.
    settings : Settings
        How files are read.
    """

    def __init__(self, site: Site, start: Path, first: str, settings: Settings) -> None:
        self.site = site
        self.start = start
        self.first = first
        self.settings = settings
        self._kept: OrderedDict[tuple[Any, ...], Opened] = OrderedDict()
        site.page("/", self.layout)
        site.answer(
            self.open,
            [Output("opened", "data"), Output("opened-message", "children"), Output("opened-view", "children")],
            [
                Input("place", "value"),
                Input("path", "n_submit"),
                Input("open", "n_clicks"),
                Input("scan-name", "value"),
                State("path", "value"),
                State("visit", "data"),
            ],
        )
        site.answer(
            self.again,
            [
                Output("opened", "data", allow_duplicate=True),
                Output("opened-message", "children", allow_duplicate=True),
                Output("opened-view", "children", allow_duplicate=True),
            ],
            [
                Input("estimate", "n_clicks"),
                Input("at-range", "value"),
                State("opened", "data"),
                State("visit", "data"),
            ],
            prevent_initial_call=True,
        )
        site.answer(
            self.pictures,
            [
                Output("beams", "src"),
                Output("series", "src"),
                Output("availability", "figure"),
            ],
            [Input("opened", "data"), Input("theme", "data"), State("visit", "data")],
        )
        site.answer(
            self.record,
            [Output("intervals", "figure"), Output("record-table", "children"), Output("record-message", "children")],
            [Input("record-rested", "data"), Input("theme", "data"), State("opened", "data"), State("visit", "data")],
        )
        site.answer(
            self.record_pictures,
            [Output("record-corner", "src"), Output("record-spectra", "src")],
            [Input("record-rested", "data"), State("opened", "data"), State("visit", "data")],
        )
        site.when_rested("record-rested", [Input("record-number", "value")])
        site.in_browser(
            _RECORD, Output("record-name", "children"), Input("record-number", "value"), Input("record-names", "data")
        )

    def layout(self) -> Any:
        """Return the page."""
        return html.Div(
            [
                html.H1("Results"),
                html.Form(
                    [
                        _field("Found below the folder", "place", _select("place", places(self.start), self.first)),
                        _field(
                            "Or a path below it",
                            "path",
                            dcc.Input(id="path", type="text", debounce=True, className="text", maxLength=1000),
                        ),
                        _field("Scan of the files", "scan-name", _select("scan-name", ["auto", *SCANS], "", "as told")),
                        html.Button("Open", id="open", type="button"),
                    ],
                    className="places",
                    **{"aria-label": "What to open"},
                ),
                html.P(["In ", html.Code(str(self.start)), ". Nothing there is written to."], className="note"),
                html.P(id="opened-message", role="alert", className="message"),
                dcc.Store(id="opened"),
                dcc.Loading(
                    html.Div(id="opened-view"),
                    delay_show=300,
                    show_initially=False,
                    target_components={"opened-view": "children"},
                ),
            ]
        )

    def open(
        self, place: Any, _submitted: Any, _clicked: Any, scan: Any, path: Any, visit: str
    ) -> tuple[Any, Any, Any]:
        """Open what was chosen, or what was written if that is why the page asks."""
        written = ctx.triggered_id in ("path", "open") and path
        name = str(path if written else place or "")
        if not name:
            return None, "", _nothing()
        return self._shown({"name": name, "scan": str(scan or ""), "at": "", "fitted": False}, visit)

    def again(self, clicked: Any, at: Any, opened: Mapping[str, Any] | None, visit: str) -> tuple[Any, Any, Any]:
        """Open the same with the posteriors of its records, or at another range."""
        asked = (ctx.triggered_id == "estimate" and clicked) or (ctx.triggered_id == "at-range" and at)
        if not asked or not opened or (ctx.triggered_id == "at-range" and at == opened["at"]):
            return no_update, no_update, no_update
        more = {"fitted": True} if ctx.triggered_id == "estimate" else {"at": str(at)}
        return self._shown({**opened, **more}, visit)

    def _shown(self, what: dict[str, Any], visit: str) -> tuple[Any, Any, Any]:
        try:
            found = self.site.latest.answer(f"{visit} open", lambda: self._opened(what))
        except _FAULTS as error:
            return (no_update, one_line(error), no_update) if what["fitted"] else (None, one_line(error), _nothing())
        if found is None:
            return no_update, no_update, no_update
        return what, "", _view(found, what)

    def _opened(self, what: Mapping[str, Any]) -> Opened:
        """Return what is open, which is read again if it has changed."""
        path = place_below(self.start, what["name"])
        stamp = (path / RUN_FILE if path.is_dir() and (path / RUN_FILE).exists() else path).stat().st_mtime_ns
        key = (str(path), stamp, what["scan"], what["at"], what["fitted"])
        found = self._kept.get(key)
        if found is None:
            if what["fitted"]:
                found = with_fit(self._opened({**what, "fitted": False}), self.settings)
            else:
                found = open_place(path, what["name"], self.settings, what["scan"], what["at"])
            self._kept[key] = found
            while len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        return found

    def pictures(self, what: Mapping[str, Any] | None, theme: str, visit: str) -> tuple[Any, Any, Any]:
        """Return the pictures of all records together."""
        if not what:
            return no_update, no_update, no_update
        found = self.site.latest.answer(f"{visit} pictures", lambda: self._opened(what))
        if found is None:
            return no_update, no_update, no_update
        beams = None if found.scan is None else picture(lambda: plot.scan(found.scan))  # type: ignore[arg-type]  # as asked
        fit = found.fit
        series = None if fit is None or not fit.fitted.any() else picture(lambda: plot.stresses(fit))
        return beams, series, _availability(found, theme)

    def record(self, number: Any, theme: str, what: Mapping[str, Any] | None, visit: str) -> tuple[Any, Any, Any]:
        """Return intervals and numbers of one record."""
        try:
            found = self.site.latest.answer(f"{visit} record", lambda: self._opened(what)) if what and number else None
            if found is None or found.fit is None:
                return no_update, no_update, ""
            rows = record_rows(found.fit, _number(number, found))
            own = found.fit.settings["fit"]
            which = interval_words(float(own["prob"]), str(own["interval"]))
            return record_chart(found.fit, rows, theme), record_table(rows, which), ""
        except InputError as error:
            return {"data": [], "layout": {}}, None, one_line(error)

    def record_pictures(self, number: Any, what: Mapping[str, Any] | None, visit: str) -> tuple[Any, Any]:
        """Return the corner plot and the spectra of one record, which take longer."""

        def make() -> tuple[Any, Any] | None:
            found = self._opened(what) if what and number else None
            if found is None:
                return None
            place = _number(number, found)
            corner = spectra = None
            if found.fit is not None and found.fit.has_draws and found.fit.fitted[place]:
                corner = picture(corner_of(found.fit, place))
            if found.spectra is not None:
                try:
                    spectra = picture(spectra_of(found, place))
                except InputError:
                    spectra = None  # a record without samples has no spectrum
            return corner, spectra

        made = self.site.latest.answer(f"{visit} record pictures", make)
        return made if made is not None else (no_update, no_update)


def _number(rested: Any, found: Opened) -> int:
    """Return the record of a slider that has come to rest."""
    number = number_of(rested[0] if isinstance(rested, list) and rested else None)
    if not 0.0 <= number < found.n_record:
        raise InputError(f"No such record: there are {found.n_record}, numbered from 0.")
    return int(number)


def _field(label: str, name: str, entry: Any) -> Any:
    return html.Div([html.Label(label, htmlFor=name), entry], className="field")


def _select(name: str, values: list[str], value: str, nothing: str = "choose …") -> Any:
    """Return a list to choose from; names of files are text there."""
    return dcc.Dropdown(
        id=name, options=[{"label": one, "value": one} for one in values], value=value or None, placeholder=nothing
    )


def _nothing() -> Any:
    return html.P("Open a folder of a fit or of spectra, or a file of radial velocities.", className="note")


def _view(found: Opened, what: Mapping[str, Any]) -> Any:
    """Return the parts of the page for what was opened; pictures follow."""
    fit = found.fit
    parts: list[Any] = [
        html.H2(found.name),
        html.P(found.kind[0].upper() + found.kind[1:] + "."),
        *(_headline(fit) if fit is not None else []),
        html.Details([html.Summary("In words"), html.Ul([html.Li(line) for line in found.lines], className="facts")]),
    ]
    asked = list(found.ranges)
    parts += [
        html.Div(
            _field("Range", "at-range", _select("at-range", asked, what["at"] or next(iter(asked), ""))),
            hidden=not asked,
        ),
        html.Button(
            "Estimate the stresses of these records",
            id="estimate",
            type="button",
            hidden=fit is not None or found.spectra_fit is not None,
        ),
    ]
    parts += [html.H2("Beams"), _figure("beams", "Where the beams point, from the lidar, from above and from the side")]
    parts += [html.H2("Availability"), dcc.Graph(id="availability", config=CONFIG, responsive=True, className="map")]
    parts += [html.H2("Stresses")] if fit is not None else []
    parts += [_figure("series", "Stresses of all records, with credible intervals")]
    last = max(found.n_record - 1, 0)
    shown = fit is not None or found.spectra is not None
    parts += [
        html.Div(
            [
                html.H2("One record"),
                html.Div(
                    [
                        html.Label("Record", htmlFor="record-number"),
                        html.Output(id="record-name", htmlFor="record-number"),
                        dcc.Input(
                            id="record-number",
                            type="range",
                            min=0,
                            max=last,
                            step=1,
                            value=_first(found),
                        ),
                    ],
                    className="control",
                ),
                dcc.Store(id="record-names", data=found.record_names),
                dcc.Store(id="record-rested"),
                html.P(id="record-message", role="alert", className="message"),
                html.Div(
                    [
                        dcc.Graph(id="intervals", config=CONFIG, responsive=True, className="widths"),
                        html.Div(id="record-table", className="wide"),
                    ],
                    hidden=fit is None,
                ),
                dcc.Loading(
                    [
                        _figure("record-corner", "Posterior of the record, with the outline of the prior"),
                        _figure("record-spectra", "Spectra of the record’s radial velocities"),
                    ],
                    delay_show=300,
                    target_components={"record-corner": "src", "record-spectra": "src"},
                ),
                html.P(
                    ""
                    if found.spectra is not None
                    else "A fit keeps no spectra: open its files, or a folder of bayes-rs spectra.",
                    className="note",
                ),
            ],
            hidden=not shown,
        )
    ]
    return parts


def _headline(fit: Fit) -> list[Any]:
    """Return what a fit found, in three lines."""
    rows = [part for name, words in fit.headline().rows() for part in (html.Dt(name), html.Dd(words))]
    return [html.Dl(rows, className="found")]


def _first(found: Opened) -> int:
    """Return the first record that has something to show."""
    if found.fit is not None and found.fit.fitted.any():
        return int(np.argmax(found.fit.fitted))
    return 0


def _figure(name: str, words: str) -> Any:
    return html.Figure([html.Img(id=name, alt=words), html.Figcaption(words)])


def _availability(found: Opened, theme: str) -> Any:
    records = found.records
    if records is None or "flag" not in records:
        return {"data": [], "layout": {}}
    duration = float(records.attrs.get("duration", np.nan))
    timed = "time" in records.coords and np.isfinite(duration)
    made = make_availability(records, 3600.0 / duration if timed else None)
    return availability_chart(made, _column_names(records, made.edges[:-1]), theme)


def _column_names(records: Any, numbers: NDArray[np.int64]) -> list[str]:
    """Return short names of records: month, day and time of their starts where these are known, or their numbers."""
    if "time" not in records.coords or not np.issubdtype(records["time"].dtype, np.datetime64):
        return [str(number) for number in numbers.tolist()]
    return [str(time)[5:16].replace("T", " ") for time in records["time"].values[numbers]]
