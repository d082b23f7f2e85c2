"""The page that helps to choose a scan: sliders, interval widths, and the corner plot of a simulated record."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_rs.app.charts import CONFIG, widths_chart
from bayes_rs.app.choosing import (
    FLOW_SLIDERS,
    N_RECORD,
    PRESETS,
    PROB,
    SCAN_SLIDERS,
    Answer,
    Answers,
    FlowChoice,
    ScanChoice,
    Slider,
    known_prior,
    make_ready,
    number_of,
    prior_widths_at,
)
from bayes_rs.app.corner_chart import corner_chart
from bayes_rs.app.site import Input, Output, Site, State, dcc, html, no_update, one_line
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import EQUAL_TAILED, interval_words

_SHOWN_FIRST = ("4-beam", "50-beam")
_SLIDERS = (*SCAN_SLIDERS, *FLOW_SLIDERS)
_NUMBER = "function(value) { return value + '%s'; }"
_SIMULATED = Slider(name="record", label="Simulated record", unit="", low=1, high=N_RECORD, step=1)


class ScanPage:
    """The page, with what it has answered before.

    Parameters
    ----------
    site : Site
        Where it is added.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self.answers = Answers()
        self._ready = threading.Event()
        self._asked: dict[str, tuple[ScanChoice, FlowChoice]] = {}  # what each visit asked last
        site.page("/scan", self.layout)
        for slider in (*_SLIDERS, _SIMULATED):
            unit = f" {slider.unit}" if slider.unit and slider.unit != "°" else slider.unit
            site.in_browser(_NUMBER % unit, Output(f"value-{slider.name}", "children"), Input(slider.name, "value"))
        inputs = [Input(slider.name, "value") for slider in _SLIDERS]
        common = [Input("centre", "value"), Input("presets", "value"), Input("record", "value"), Input("theme", "data")]
        site.when_rested("asked", [*inputs, *common])
        site.answer(
            self.follow,
            [
                Output("widths", "figure"),
                Output("numbers", "children"),
                Output("found", "children"),
                Output("scan-message", "children"),
            ],
            [Input("asked", "data"), State("visit", "data")],
        )
        site.answer(
            self.posterior,
            [Output("corner", "figure"), Output("to-compare", "data")],
            [Input("asked", "data"), State("visit", "data")],
        )
        site.answer(
            self.compare,
            [
                Output("widths", "figure", allow_duplicate=True),
                Output("numbers", "children", allow_duplicate=True),
                Output("scan-message", "children", allow_duplicate=True),
            ],
            [Input("to-compare", "data"), State("visit", "data")],
            prevent_initial_call=True,
        )

    def layout(self) -> Any:
        """Return the page."""
        first = {**vars(ScanChoice()), **vars(FlowChoice())}
        controls = [
            html.H2("Scan"),
            *(_control(slider, first[slider.name]) for slider in SCAN_SLIDERS[:3]),
            dcc.Checklist(
                id="centre",
                options=[{"label": "One beam points along the axis", "value": "centre"}],
                value=["centre"],
                className="checks",
            ),
            _control(SCAN_SLIDERS[3], first["duration"]),
            html.H2("Flow"),
            *(_control(slider, first[slider.name]) for slider in FLOW_SLIDERS),
            html.H2("Beside it"),
            dcc.Checklist(id="presets", options=list(PRESETS), value=list(_SHOWN_FIRST), className="checks columns"),
        ]
        return html.Div(
            [
                html.H1("Choose a scan"),
                html.Div(
                    [
                        html.Form(controls, className="controls", **{"aria-label": "Scan and flow"}),
                        html.Div(self._results(), className="results"),
                    ],
                    className="two",
                ),
            ]
        )

    def _results(self) -> list[Any]:
        return [
            html.P(id="found", className="headline", **{"aria-live": "polite"}),
            html.P(id="scan-message", role="alert", className="message"),
            html.Section(
                [
                    html.H2(f"Width of the {interval_words(PROB, EQUAL_TAILED)}"),
                    dcc.Graph(id="widths", config=CONFIG, responsive=True, className="widths"),
                    html.Details([html.Summary("The numbers"), html.Div(id="numbers", className="wide")]),
                ]
            ),
            html.Section(
                [
                    html.H2("Posterior of a simulated record"),
                    _control(_SIMULATED, 1),
                    dcc.Graph(id="corner", config=CONFIG, responsive=True, className="corner"),
                    html.P(
                        "All axes in m² s⁻². Their limits follow the flow: a better scan is a smaller patch.",
                        className="note",
                    ),
                ]
            ),
            html.Details([html.Summary("What is calculated"), html.P(_HOW, className="note")]),
            dcc.Store(id="asked"),
            dcc.Store(id="to-compare"),
        ]

    def follow(self, asked: Sequence[Any] | None, visit: str) -> tuple[Any, ...]:
        """Answer the move of a slider: the page's scan, beside those presets that are known in this flow."""
        if not asked:
            return (no_update,) * 4
        *numbers, centre, presets, _, theme = asked
        began = time.perf_counter()
        try:
            scan, flow = _choices(numbers, centre)
            names = _presets(presets)
            self._asked[visit] = scan, flow
            mine = self.site.latest.answer(f"{visit}", lambda: self.answers.get(scan, flow))
        except InputError as error:
            return (*[no_update] * 3, one_line(error))
        if mine is None:
            return (no_update,) * 4
        if not self._ready.is_set():  # once the first answer is there, what the sliders would wait for is made
            self._ready.set()
            threading.Thread(target=make_ready, daemon=True).start()
        known = [one for name in names if (one := self.answers.known(name, flow)) is not None]
        return (
            widths_chart(mine, known, theme),
            numbers_table(mine, known),
            headline(mine, flow, time.perf_counter() - began),
            "",
        )

    def posterior(self, asked: Sequence[Any] | None, visit: str) -> tuple[Any, Any]:
        """Answer the same move with the corner plot of a simulated record; bad input is said beside the widths.

        Presets that are not known in this flow are asked for after it, so that nothing waits for them.
        """
        if not asked:
            return (no_update,) * 2
        *numbers, centre, presets, record, theme = asked
        try:
            scan, flow = _choices(numbers, centre)
            names, which = _presets(presets), _record(record)
            mine = self.site.latest.answer(f"{visit} corner", lambda: self.answers.get(scan, flow))
        except InputError:
            return (no_update,) * 2
        if mine is None:
            return (no_update,) * 2
        chart = corner_chart(mine.draws[which], mine.truth, mine.of_prior, theme)
        waiting = {"scan": vars(scan), "flow": vars(flow), "presets": names, "theme": theme}
        return chart, no_update if all(self.answers.known(name, flow) for name in names) else waiting

    def compare(self, waiting: Mapping[str, Any] | None, visit: str) -> tuple[Any, ...]:
        """Add the presets that were not known yet."""
        if not waiting:
            return (no_update,) * 3
        scan, flow = ScanChoice(**waiting["scan"]), FlowChoice(**waiting["flow"])
        others: list[Answer] = []
        message = ""
        for name in waiting["presets"]:
            try:
                found = self.site.latest.answer(f"{visit} presets", lambda name=name: self.answers.get(name, flow))  # type: ignore[misc]  # of the loop
            except InputError as error:
                message = f"{name}: {one_line(error)}"
                continue
            if found is None:
                return (no_update,) * 3
            others.append(found)
        if self._asked.get(visit) != (scan, flow):
            return (no_update,) * 3  # the page shows another scan by now
        mine = self.answers.get(scan, flow)
        return widths_chart(mine, others, waiting["theme"]), numbers_table(mine, others), message


def _control(slider: Slider, value: float) -> Any:
    """Return a slider with its label and its value."""
    return html.Div(
        [
            html.Label(slider.label, htmlFor=slider.name),
            html.Output(id=f"value-{slider.name}", htmlFor=slider.name),
            dcc.Input(
                id=slider.name,
                type="range",
                min=slider.low,
                max=slider.high,
                step=slider.step,
                value=value,
            ),
        ],
        className="control",
    )


def _choices(values: Sequence[Any], centre: Any) -> tuple[ScanChoice, FlowChoice]:
    """Return scan and flow of the sliders' values."""
    numbers = dict(zip((slider.name for slider in _SLIDERS), values, strict=True))
    flow = {slider.name: numbers[slider.name] for slider in (*FLOW_SLIDERS, SCAN_SLIDERS[3])}
    scan = {slider.name: numbers[slider.name] for slider in SCAN_SLIDERS[:3]}
    return ScanChoice(**scan, centre=bool(centre)), FlowChoice(**flow)


def _presets(names: object) -> list[str]:
    if not isinstance(names, list) or any(name not in PRESETS for name in names):
        raise InputError(f"Invalid presets: choose of {', '.join(PRESETS)}.")
    return [name for name in PRESETS if name in names]


def _record(value: object) -> int:
    """Return the place of a simulated record, from its number on the page."""
    number = number_of(value)
    if not 1.0 <= number <= N_RECORD:
        raise InputError(f"Invalid record: it goes from 1 to {N_RECORD}.")
    return int(number) - 1


def headline(mine: Answer, flow: FlowChoice, seconds: float) -> list[Any]:
    """Say what the scan would know, in a sentence, and how long the answer took."""
    priors = [name for name, own in zip(STRESSES, mine.of_prior, strict=True) if own]
    said = f"{', '.join(priors) or 'none'} {'are' if len(priors) > 1 else 'is'} mostly the prior’s"
    return [
        html.Strong(f"{mine.learnt:.1f} of 6 stresses learnt from a record; {said}."),
        f" The scan {mine.sight}. Turbulence intensity {100 * flow.intensity:.1f} %, ",
        *["αε", html.Sup("2/3"), f" = {flow.turbulence().dissipation:.3g} m", html.Sup("4/3"), " s⁻². "],
        html.Span(f"Answered in {seconds:.2f} s.", className="note"),
    ]


def numbers_table(mine: Answer, others: Sequence[Answer]) -> Any:
    """Return the widths as a table, for who would rather read."""
    at_size, alone = prior_widths_at(mine.truth), known_prior().widths(PROB)
    head = ["stress", "true", "width", "± Monte Carlo", "decided by the data", "prior at this size", "prior alone"]
    rows = [
        [
            name,
            f"{mine.truth[i]:.2f}",
            f"{mine.width[i]:.2f}",
            f"{mine.error[i]:.2f}",
            f"{mine.decided[i]:.2f}{' (the prior’s)' if mine.of_prior[i] else ''}",
            f"{at_size[i]:.2f}",
            f"{alone[i]:.3g}",
            *(f"{one.width[i]:.2f}{' (the prior’s)' if one.of_prior[i] else ''}" for one in others),
        ]
        for i, name in enumerate(STRESSES)
    ]
    return html.Table(
        [
            html.Caption(
                f"Widths of the {interval_words(PROB, EQUAL_TAILED)}, and stresses, in m² s⁻²; "
                "decided: 1 the data, 0 the prior"
            ),
            html.Thead(html.Tr([html.Th(name, scope="col") for name in [*head, *(one.label for one in others)]])),
            html.Tbody(
                [html.Tr([html.Th(row[0], scope="row"), *(html.Td(value) for value in row[1:])]) for row in rows]
            ),
        ]
    )


_HOW = (
    f"The noise of the beams’ variances is that of Gaussian Mann turbulence by theory. From it {N_RECORD} records are "
    "drawn evenly, the same numbers for every scan, and each gets its posterior under the prior ‘weak’; a width is the "
    "mean over them. Its error is the spread of the records over the root of their number, which overstates it. "
    "Covariances of velocities are within 0.1 % of uu, which moves a width by up to 0.02 %. Beams of the page’s scan "
    "see points, once a second; presets are as they are shipped. The command bayes-rs compare gives the same widths "
    "from 128 records, and for any scan."
)
