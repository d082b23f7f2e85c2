"""The table of file formats on the page formats.md, made from the registry of readers."""

from bayes_rs.readers.interface import Reader
from bayes_rs.readers.registry import READERS

MARK = "% the table of formats stands here, made from the registry of readers"
HEAD = ("`file_format`", "files", "sign", "time stamp", "zone", "invalid", "status", "source", "options of its own")


def format_table() -> str:
    """Return the table: a row for each format, in the order in which they are tried."""
    rows = [HEAD, ("---",) * len(HEAD), *(_row(reader) for reader in READERS.values())]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _row(reader: Reader) -> tuple[str, ...]:
    of = reader.defaults
    own = "as the file says, or " if reader.own_options is not None else ""
    invalid = of.get("invalid", ())
    status = of.get("status_valid")
    return (
        f"`{reader.name}`",
        reader.title,
        "must be given" if "positive" in reader.must_say else own + of.get("positive", "away"),
        f"{of['time_stamp']} of a sample" if "time_stamp" in of else "as it stands",
        of.get("time_zone", "UTC"),
        f"{min(invalid):g} to {max(invalid):g}" if invalid else "none",
        (own if reader.name == "netcdf" else "") + (f"{status:g} is good" if status is not None else "–"),
        reader.source,
        "all" if reader.uses is None else ", ".join(f"`{name}`" for name in sorted(reader.uses)),
    )
