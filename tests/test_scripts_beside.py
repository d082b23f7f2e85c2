"""Scripts beside the package: the names that they import are there."""

import ast
import importlib
from pathlib import Path

import pytest

TOP = Path(__file__).parent.parent
SCRIPTS = sorted(path for folder in ("benchmarks", "docs", "notebooks") for path in (TOP / folder).glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_names_of_the_package_that_a_script_imports(script):
    missing = []
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "bayes_rs":
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names if not hasattr(module, alias.name)):
                try:
                    importlib.import_module(f"{node.module}.{name}")
                except ImportError:
                    missing.append(f"{node.module}.{name}")
    assert missing == []
