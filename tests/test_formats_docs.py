"""The page on file formats runs, and its table is that of the registry."""

import doctest
import importlib.util
from dataclasses import replace
from pathlib import Path

from bayes_rs.readers import READERS

PAGE = Path(__file__).parents[1] / "docs" / "formats.md"
_spec = importlib.util.spec_from_file_location("format_table", PAGE.with_name("format_table.py"))
table = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(table)


def test_the_page_runs():
    failed, attempted = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert attempted > 8
    assert failed == 0


def test_the_table_stands_on_the_page():
    assert PAGE.read_text(encoding="utf-8").splitlines().count(table.MARK) == 1


def test_the_table_names_every_format_and_its_conventions(monkeypatch):
    monkeypatch.setitem(READERS, "mine", replace(READERS["long"], name="mine", defaults={"invalid": (-9.0, 5.0)}))
    head, rule, *rows = [
        [cell.strip() for cell in row.strip("|").split("|")] for row in table.format_table().split("\n")
    ]
    assert len(rows) == len(READERS)
    assert {len(row) for row in (head, rule, *rows)} == {len(table.HEAD)}
    for (name, reader), row in zip(READERS.items(), rows, strict=True):
        cell = dict(zip(head, row, strict=True))
        assert cell["`file_format`"] == f"`{name}`"
        sign = "must be given" if "positive" in reader.must_say else reader.defaults.get("positive", "away")
        assert cell["sign"].endswith(sign)
        assert cell["time stamp"].startswith(reader.defaults.get("time_stamp") or "as it stands")
        assert cell["source"] == reader.source
    assert rows[-1][5] == "-9 to 5"
