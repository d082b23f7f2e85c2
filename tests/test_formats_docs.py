"""The page on file formats runs."""

import doctest
from pathlib import Path

from bayes_rs.readers import registry

PAGE = Path(__file__).parents[1] / "docs" / "formats.md"


def test_the_page_runs():
    failed, attempted = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert attempted > 8
    assert failed == 0


def test_the_page_names_every_format_and_its_sign():
    text = PAGE.read_text(encoding="utf-8")
    for name, reader in registry.READERS.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{name}` |")]
        if "positive" in reader.defaults:
            assert reader.defaults["positive"] in row.split("|")[3]
        if invalid := reader.defaults.get("invalid", ()):
            assert f"| {min(invalid):g} to {max(invalid):g} |" in row
        stamp = reader.defaults.get("time_stamp")
        assert (stamp or "as it stands") in row
