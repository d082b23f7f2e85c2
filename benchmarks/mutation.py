"""Mutation of the core: plant one fault at a time in a module, run its tests, list the faults that survive.

``python benchmarks/mutation.py --module geometry/stress --count 20 --seed 1``. No file is changed: a process of its own
reads the fault in place of the module, and stops at the first test that fails. Texts, annotations and errors are left
alone. A survivor is equivalent (no input tells it from the program), a matter of speed, or a test that is missing.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
OPERATORS = [(ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.BitAnd, ast.BitOr), (ast.And, ast.Or)]
COMPARISONS = [(ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)]
NAMES = [("sin", "cos"), ("min", "max"), ("any", "all"), ("zeros", "ones"), ("argmin", "argmax")]
OTHER: dict[Any, Any] = {a: b for pair in (*OPERATORS, *COMPARISONS, *NAMES) for a, b in (pair, pair[::-1])}
DROPPED = {"swapaxes", "copy", "abs", "sqrt", "round", "cumsum"}
LIMIT = 600.0
KEPT = ast.Raise | ast.JoinedStr | ast.ImportFrom


def changes(node: Any) -> Iterator[ast.AST]:  # noqa: PLR0912 - a branch for each kind of node
    """Yield what may stand in place of a node."""
    match node:
        case ast.BinOp(op=ast.MatMult()):
            yield _with(node, left=node.right, right=node.left)
        case ast.BinOp() | ast.AugAssign() if type(node.op) in OTHER:
            yield _with(node, op=OTHER[type(node.op)]())
            yield node.left if isinstance(node, ast.BinOp) else ast.Pass()
        case ast.Compare(ops=[op]):
            yield _with(node, ops=[OTHER[type(op)]()])
            yield ast.UnaryOp(ast.Not(), node)
        case ast.BoolOp():
            yield _with(node, op=OTHER[type(node.op)]())
        case ast.UnaryOp():
            yield node.operand
        case ast.If() | ast.IfExp():
            yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value - 1 if value > 0 else value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(2.0 * value if value > 1e-3 else value + 1.0)  # a tolerance may be a little other
        case ast.Attribute(attr="T"):
            yield node.value
        case ast.Attribute(attr=attr) if attr in OTHER:
            yield _with(node, attr=OTHER[attr])
        case ast.Call(func=ast.Attribute(attr=attr, value=value)) if attr in DROPPED:
            yield node.args[0] if getattr(value, "id", "") == "np" else value
        case ast.Call(func=ast.Attribute(attr="where"), args=[test, one, other]):
            yield _with(node, args=[test, other, one])
        case ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Subscript()]):
            yield ast.Pass()


def _with(node: Any, **parts: Any) -> Any:
    return type(node)(**{**vars(node), **parts})


def places(node: ast.AST) -> Iterator[tuple[Any, Any]]:
    """Yield where nodes stand: an object or a list, and the field or the number in it."""
    for field, value in ast.iter_fields(node):
        if field in {"annotation", "returns", "decorator_list"}:
            continue
        listed = list(enumerate(value)) if isinstance(value, list) else [(field, value)]
        for key, child in listed:
            if isinstance(child, ast.AST) and not isinstance(child, KEPT):
                yield (value if isinstance(value, list) else vars(node)), key
                yield from places(child)


def faults(source: str) -> list[tuple[int, int]]:
    """Return the faults of a module, as the number of the place and of the change there."""
    listed = enumerate(places(ast.parse(source)))
    return [(number, which) for number, (holder, key) in listed for which, _ in enumerate(changes(holder[key]))]


def planted(source: str, number: int, which: int) -> tuple[str, str]:
    """Return what a fault changes, in words, and the text of the module with it."""
    tree = ast.parse(source)
    holder, key = list(places(tree))[number]
    old = holder[key]
    new = copy.deepcopy(list(changes(old))[which])
    words = f"{old.lineno}: {ast.unparse(old)} -> {ast.unparse(new)}".replace("\n", "; ")
    holder[key] = new
    return words, ast.unparse(ast.fix_missing_locations(tree))


def passes(module: str, source: str, tests: list[str]) -> bool:
    """Tell whether all tests pass with `source` as the module, within `LIMIT` seconds."""
    with tempfile.TemporaryDirectory() as folder:
        own = {"PYTHONPATH": str(ROOT), "BAYES_RS_CACHE": folder, "HYPOTHESIS_STORAGE_DIRECTORY": folder}
        command = [sys.executable, __file__, "--as", module, *tests]
        options: Any = {"cwd": ROOT, "env": {**os.environ, **own}, "capture_output": True, "timeout": LIMIT}
        try:
            return subprocess.run(command, input=source.encode(), check=False, **options).returncode == 0  # noqa: S603 - our own
        except subprocess.TimeoutExpired:
            return False


def run_tests(module: str, tests: list[str]) -> int:
    """Run tests in this process with the module's text from the standard input; return pytest's exit code."""
    source, whole = sys.stdin.buffer.read(), SourceFileLoader.get_code

    def get_code(loader: Any, name: str) -> Any:
        return compile(source, loader.path, "exec", dont_inherit=True) if name == module else whole(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]  # for this process only
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not long", *tests]))


def main() -> None:
    """Plant faults at random, and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--module", required=True, help="in the package, as geometry/stress")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tests", nargs="+", help="tests to run; by default the files that name the module")
    given = parser.parse_args()
    source = (ROOT / "bayes_rs" / f"{given.module}.py").read_text(encoding="utf-8")
    module = f"bayes_rs.{given.module.replace('/', '.')}"
    files = sorted((ROOT / "tests").glob("test_*.py"), key=lambda path: Path(given.module).name not in path.name)
    tests = given.tests or [str(path) for path in files if module in path.read_text(encoding="utf-8")]
    if not passes(module, source, tests):
        raise SystemExit(f"Without a fault the tests of {module} fail, or take longer than {LIMIT:g} s.")
    possible = faults(source)
    chosen = random.Random(given.seed).sample(possible, min(given.count, len(possible)))  # noqa: S311 - no secret
    both = [planted(source, *fault) for fault in chosen]
    survivors = [words for words, text in both if passes(module, text, tests)]
    print("\n".join([*survivors, f"{len(survivors)} of {len(chosen)} faults survive; {len(possible)} are possible."]))


if __name__ == "__main__":
    sys.exit(run_tests(sys.argv[2], sys.argv[3:]) if sys.argv[1:2] == ["--as"] else main())
