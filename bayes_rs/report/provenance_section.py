"""How the numbers were made."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from bayes_rs.report.report_data import ReportData
from bayes_rs.report.tables import flat, folded, pairs, table

_SCAN_BOX = '<div class="scroll" tabindex="0" role="region" aria-label="The scan file"><pre>{}</pre></div>'


def provenance_section(found: ReportData) -> str:
    """Return the content of the section."""
    run = dict(found.run)
    text = run.get("scan_toml")
    if isinstance(text, str):
        run["scan_toml"] = "see below"
    entries: Iterable[tuple[str, str]] = flat(run)
    content = _settings(found)
    content += folded("Table: run.json, entry by entry", table("run.json", ("entry", "value"), entries, n_text=2))
    if isinstance(text, str):
        content += folded("The scan, as the scan file that load_scan reads", _SCAN_BOX.format(escape(text)))
    return content


def _settings(found: ReportData) -> str:
    """Return what the fit was made with, in a few words each."""
    entries = [("Scan", str(found.run.get("scan", "")) or "unknown scan")]
    if found.target:
        entries.append(("Target", found.target))
    if found.prior:
        entries.append(("Prior", found.prior.split(":", 1)[0]))
    noise = found.run.get("noise")
    if isinstance(noise, dict) and "turbulence" in noise:
        entries.append(("Noise", f"{noise.get('method', '')}, {noise['turbulence']}"))
    for title in ("Length scale", "Instrument noise"):
        if said := (found.run.get(title.lower().replace(" ", "_")) or {}).get("words"):
            start = title.lower()
            entries.append((title, str(said).removeprefix(f"{start} ").removeprefix(f"{start}: ")))
    return pairs(entries, "key-numbers")
