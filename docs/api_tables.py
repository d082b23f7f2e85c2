"""The lists of names on the page api.md, made from the stubs of the package and of its subjects."""

from __future__ import annotations

import re
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "bayes_rs"
SUBJECTS = ("", *sorted(file.parent.name for file in PACKAGE.glob("*/__init__.pyi")))
"""The package itself, and its modules by subject."""
_NAME = re.compile(r"^from \.(\S*) import \w+ as (\w+)$", re.MULTILINE)


def mark(subject: str) -> str:
    """Return the line of the page that stands for the names of a subject."""
    return f"% the names of {place_of(subject)} stand here"


def place_of(subject: str) -> str:
    """Return where the names of a subject are, as ``bayes_rs.noise``."""
    return f"bayes_rs.{subject}" if subject else "bayes_rs"


def names_in(subject: str) -> dict[str, str]:
    """Return the public names of a subject, each with the module that defines it; without the subjects themselves."""
    stub = (PACKAGE / subject / "__init__.pyi").read_text(encoding="utf-8")
    where = f"{subject}." if subject else ""
    return {name: f"{where}{module}" for module, name in _NAME.findall(stub) if module}


def listed(subject: str) -> list[str]:
    """Return the functions and classes of a subject, without those that are on top, too."""
    on_top = {name for name, module in names_in("").items() if subject and module.startswith(f"{subject}.")}
    return [name for name in names_in(subject) if name != "__version__" and not name.isupper() and name not in on_top]


def names_of(subject: str) -> str:
    """Return the list of the names of a subject, each with its first line, for a page in Markdown."""
    return f"```{{eval-rst}}\n{_autosummary(subject, 'api')}\n```"


def autosummaries(toctree: str) -> str:
    """Return the lists of all names, whose pages are in a folder."""
    return "\n\n".join(_autosummary(subject, toctree) for subject in SUBJECTS) + "\n"


def _autosummary(subject: str, toctree: str) -> str:
    names = "\n".join(f"   ~{place_of(subject)}.{name}" for name in listed(subject))
    return f".. autosummary::\n   :toctree: {toctree}\n   :nosignatures:\n\n{names}"
