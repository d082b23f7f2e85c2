"""The uncertainty budget of a fit: what of each stress's variance comes from where, as a picture and a table."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayes_rs.fits.budget import budget
from bayes_rs.fits.budget_sources import COMBINED, PRIOR, REST
from bayes_rs.fits.budget_table import budget_notes
from bayes_rs.fits.fit_object import Fit
from bayes_rs.intervals import interval_words
from bayes_rs.posteriors.decided import PRIORS, is_priors
from bayes_rs.report.packing import plain
from bayes_rs.report.tables import NO_VALUE, UNIT, figure, folded, key, lines, number, table

_WHAT = (
    "What the posterior variances are made of, as the GUM (JCGM 100) has it. A source's part is by how much the "
    "variance would fall if the source were known; those of sampling and of the prior share what is left. Type A is "
    "the scatter of finite records, all else is called type B. The rest is what does not add up, since sources act "
    "together."
)


class BudgetShown(NamedTuple):
    """A budget as the page shows it.

    Parameters
    ----------
    data : dict
        What the script draws.
    content : str
        The section.
    """

    data: dict[str, Any]
    content: str


def make_budget(fit: Fit) -> BudgetShown:
    """Return the budget of a fit's records together, turbulence intensity with it.

    Raises
    ------
    InputError
        As from `bayes_rs.budget`.
    """
    found = budget(fit, derived=tuple(fit.settings["fit"]["derived"]) or ("ti",))
    return BudgetShown(_data(found), _section(found))


def _data(found: pd.DataFrame) -> dict[str, Any]:
    """Return what the script draws: the share of each source in each stress, and whose the stress is."""
    names = list(dict.fromkeys(found["stress"]))
    share = found.pivot(index="source", columns="stress", values="share")[names]
    last = found[found["source"] == COMBINED].set_index("stress").loc[names]
    return {
        "names": ["TI" if name == "ti" else name for name in names],
        "u": [number(value, 2) for value in last["u"]],
        "priors": [int(np.isfinite(value) and is_priors(value)) for value in last["decided"]],
        "sources": [
            {"name": source, "kind": part_class(source), "share": plain(100.0 * share.loc[source].to_numpy())}
            for source in dict.fromkeys(found["source"])
            if source != COMBINED
        ],
    }


def _section(found: pd.DataFrame) -> str:
    """Return the content of the section."""
    kinds = found.drop_duplicates("source").set_index("source")["type"]
    sources = [source for source in kinds.index if source != COMBINED]
    caption = "".join(
        key(f"part {part_class(source)}", f"{source}, type {kinds[source]}" if kinds[source] else source)
        for source in sources
    )
    count = found.attrs["n_record"]
    said = [_WHAT, f"Of {count} records together: means of their variances." if count > 1 else "Of one record."]
    grey = (
        f"A name in grey: {PRIORS}. Bars to the left of 0: the posterior is narrower for the source being uncertain. "
        f"u: combined standard uncertainty, {UNIT}; of TI a number."
    )
    told = [*said, *(f"{note[:1].upper()}{note[1:]}." for note in budget_notes(found))]
    content = folded("Table: uncertainty budget", _table(found, sources, kinds))
    return lines(told) + figure("budget", caption + grey, content)


def part_class(source: str) -> str:
    """Return the class of a source's marks, which the style sheet colours."""
    return {PRIOR: "hatch", REST: "rest"}.get(source, source.replace(" ", "-"))


def _table(found: pd.DataFrame, sources: list[str], kinds: Any) -> str:
    names = list(dict.fromkeys(found["stress"]))
    row = {(one["source"], one["stress"]): one for one in found.to_dict("records")}
    last = [row[COMBINED, name] for name in names]
    called = interval_words(float(last[0]["prob"]), str(last[0]["interval"]))
    cells = [
        *((source, kinds[source], *(_percent(row[source, name]["share"]) for name in names)) for source in sources),
        ("combined standard uncertainty u", "", *(number(one["u"]) for one in last)),
        ("u over the estimate", "", *(_percent(one["relative"]) for one in last)),
        (f"half of the {called}", "", *(number(one["expanded"]) for one in last)),
        ("decided by the data", "", *(_percent(one["decided"]) for one in last)),
    ]
    header = ("share of the variance", "type", *("TI" if name == "ti" else name for name in names))
    caption = "Shares of the variance by source; u and intervals of the stresses in m² s⁻²"
    return table(caption, header, cells, n_text=2)


def _percent(share: float) -> str:
    return f"{100.0 * share:z.0f} %".replace("-", "−") if np.isfinite(share) else NO_VALUE
