"""The page on settings runs, and its tables are those of the classes of options."""

import doctest
import importlib.util
import tomllib
from pathlib import Path

from bayes_rs.fits.settings import SECTIONS, Settings, option_places

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"
_spec = importlib.util.spec_from_file_location("settings_table", PAGE.with_name("settings_table.py"))
table = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(table)


def rows_by_section() -> dict[str, list[dict[str, str]]]:
    found: dict[str, list[dict[str, str]]] = {}
    for part in table.option_tables().split("### ")[1:]:
        title, _, text = part.partition("\n\n")
        lines = [line.replace(r"\|", "/").strip("|").split("|") for line in text.split("\n") if line]
        head, _, *lines = ([cell.strip() for cell in line] for line in lines)
        assert {len(line) for line in lines} == {len(head)}
        found[title.strip("`[]")] = [dict(zip(head, line, strict=True)) for line in lines]
    return found


def test_the_page_runs():
    failed, attempted = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert attempted > 8
    assert failed == 0


def test_the_tables_stand_on_the_page():
    assert PAGE.read_text(encoding="utf-8").splitlines().count(table.MARK) == 1


def test_every_option_has_a_row_with_its_default_and_its_flag():
    rows = rows_by_section()
    expected = dict(table.sections())
    assert [name for name in expected if name != "fit.nuisances"] == list(SECTIONS)
    assert set(rows) == set(expected)
    for section, options in expected.items():
        assert [row["option"] for row in rows[section]] == [f"`{entry.name}`" for entry in options]
        for entry, row in zip(options, rows[section], strict=True):
            assert row["command line"].strip("`") == entry.flag
            assert row["unit"] == entry.about.unit
            assert entry.about.help.rstrip(".") in row["what it does"]
            if type(entry.default) in (int, str):
                assert row["default"] == f"`{entry.default}`"
            if type(entry.default) is float:
                assert float(row["default"].strip("`")) == entry.default
    assert {row["option"].strip("`") for part in rows.values() for row in part} == set(option_places()) - {"nuisances"}


def test_the_example_of_a_file_is_one():
    text = PAGE.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    settings = Settings.from_plain(tomllib.loads(text), where="the page")
    assert settings.scan.load().name == "zx-tm"
    assert settings.fit.nuisances.yaw_sd_deg == 2.0
