"""Sphinx's configuration of the documentation site: `make docs` builds it into docs/_build/html, without a network."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import tomllib
from functools import partial
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

# what runs while the site is built: the notebooks in their short form, and nothing is written to the user's cache
os.environ["BAYES_RS_SHORT"] = "1"
os.environ.setdefault("BAYES_RS_CACHE", str(HERE / "_build" / "cache"))
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
# the notebooks' kernel is this interpreter, whatever is installed beside it, and says nothing that is not an error
_kernel = HERE / "_build" / "jupyter" / "kernels" / "python3" / "kernel.json"
_kernel.parent.mkdir(parents=True, exist_ok=True)
_command = [sys.executable, "-m", "ipykernel_launcher", "--log-level=ERROR", "-f", "{connection_file}"]
_kernel.write_text(json.dumps({"argv": _command, "display_name": "Python 3", "language": "python"}), encoding="utf-8")
os.environ["JUPYTER_PATH"] = str(_kernel.parents[2])

import api_tables  # noqa: E402 - it lies beside this file
import format_table  # noqa: E402 - as above
import settings_table  # noqa: E402 - as above

project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["name"]
author = "The bayes_rs developers"
project_copyright = author
release = version_of("bayes_rs")
version = release

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
]
source_suffix = {".rst": "restructuredtext", ".md": "myst-nb", ".ipynb": "myst-nb"}  # generated pages take the first
exclude_patterns = ["_build", "**/.ipynb_checkpoints"]
templates_path = ["_templates"]

# pages
myst_enable_extensions = ["amsmath", "attrs_block", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# notebooks: stored without outputs, so every build runs them; an error in one is a warning, and fails the build
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_show_tb = True
nb_merge_streams = True
nb_output_stderr = "remove"  # progress bars

# reference
add_module_names = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
# the pages of names are made for what is in this file: the lists of api.md come later, when its page is read
_names = HERE / "_build" / "names.rst"
_names.write_text(api_tables.autosummaries("../api"), encoding="utf-8")
autosummary_generate = [str(_names)]
autosummary_imported_members = True
default_role = "py:obj"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
python_use_unqualified_type_names = True

# look
html_theme = "furo"
html_title = "bayes_rs"
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f4e79", "color-brand-content": "#1f4e79"},
    "dark_css_variables": {"color-brand-primary": "#8fb8de", "color-brand-content": "#8fb8de"},
}
pygments_style = "friendly"
pygments_dark_style = "monokai"

# equations: one file of MathJax, with its fonts in it, from the package that brings it; no server is asked
_mathjax = find_spec("sphinx-mathjax-offline")
if _mathjax is None or not _mathjax.submodule_search_locations:
    html_static_path = ["_static"]  # the pages can be read, with equations in TeX; the build needs the group docs
else:
    html_static_path = ["_static", str(Path(_mathjax.submodule_search_locations[0]) / "static/mathjax/tex-svg.js")]
mathjax_path = "tex-svg.js"
mathjax3_config = {"svg": {"fontCache": "global"}, "options": {"enableMenu": False}}

_MIRRORED = {"notebooks": ("*.ipynb",), "benchmarks": ("README.md", "measured.md", "*.csv", "*.png")}
_EQUATION = re.compile(r"^ {4,}\S")
_STUB = "\n".join(file.read_text(encoding="utf-8") for file in sorted((ROOT / "bayes_rs").rglob("__init__.pyi")))
_PLACES = {
    name: f"{api_tables.place_of(subject)}.{name}"
    for subject in reversed(api_tables.SUBJECTS)
    for name in api_tables.listed(subject)
}
_OUR_NAME = re.compile(r"(?<![`:\w])`(" + "|".join(_PLACES) + r")`(?!`)")
_OUR_TYPE = re.compile(r"\b(" + "|".join(re.findall(r" as ([A-Z][a-z]\w+)$", _STUB, re.MULTILINE)) + r")\b")


def mirror_siblings(*_: Any) -> None:
    """Copy what the site shows from folders beside docs/ into it: notebooks, and the benchmarks' page and tables."""
    for folder, patterns in _MIRRORED.items():
        target = HERE / folder
        target.mkdir(exist_ok=True)
        wanted = {file.name: file for pattern in patterns for file in sorted((ROOT / folder).glob(pattern))}
        for old in target.iterdir():
            if old.is_file() and old.name not in wanted:
                old.unlink()
        for file in wanted.values():
            shutil.copy2(file, target / file.name)


_MADE = {
    "formats": {format_table.MARK: format_table.format_table},
    "settings": {settings_table.MARK: settings_table.option_tables},
    "api": {api_tables.mark(subject): partial(api_tables.names_of, subject) for subject in api_tables.SUBJECTS},
}
"""What is made from the program, by the page and by the mark that stands for it."""


def made_tables(_: Any, docname: str, source: list[str]) -> None:
    """Put tables that are made from the program where their pages have a mark for them."""
    for mark, made in _MADE.get(docname, {}).items():
        source[0] = source[0].replace(mark, made())


def point_inside(_: Any, docname: str, source: list[str]) -> None:
    """Turn links between docs/ and the folders beside it, as they are on the disk, into links within the site."""
    if "/" not in docname:
        source[0] = re.sub(r"\]\(\.\./(notebooks|benchmarks)/", r"](\1/", source[0])
        source[0] = re.sub(r"\n\n```$", "\n```", source[0], flags=re.MULTILINE)  # what doctests need, readers do not
    elif docname.startswith(tuple(_MIRRORED)):
        source[0] = source[0].replace("](../docs/", "](../")


def show_docstring(_: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Show indented equations as they stand, no bar of |k| as a substitution, and our own types as links."""
    del what, name, obj, options

    def linked(match: re.Match[str]) -> str:
        return f"`~{_PLACES[match[1]]}`"

    shown: list[str] = []
    section = ""
    literal = False
    for index, line in enumerate(lines):
        if index + 1 < len(lines) and set(lines[index + 1]) == {"-"}:
            section = line.strip()
        after_blank = index > 0 and not lines[index - 1].strip()
        if _EQUATION.match(line) and after_blank and section in {"", "Notes"} and not literal:
            while shown and not shown[-1].strip():
                shown.pop()
            shown += ["", "::", ""]
            literal = True
        elif line.strip() and not line.startswith(" "):
            literal = False
        if literal or line.lstrip().startswith((">>>", "...")):
            shown.append(line)
        elif section in {"Parameters", "Returns", "Yields"} and " : " in line and not line.startswith(" "):
            names, of, kind = line.partition(" : ")
            shown.append(names + of + _OUR_TYPE.sub(r"`\1`", kind))
        else:
            shown.append(_OUR_NAME.sub(linked, line.replace("|", r"\|")))
    lines[:] = shown


def setup(app: Any) -> None:
    """Connect what is above."""
    app.connect("config-inited", mirror_siblings)
    app.connect("source-read", made_tables)
    app.connect("source-read", point_inside)
    app.connect("autodoc-process-docstring", show_docstring, priority=400)
