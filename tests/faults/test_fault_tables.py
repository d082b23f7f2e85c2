"""Hostile tables in, and tables out that no spreadsheet runs."""

import bz2
import gzip
import json
import lzma
import os
import zipfile

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from bayes_rs import InputError, load_scan, make_records, read
from bayes_rs.cli.group import commands
from bayes_rs.models import models_folder
from bayes_rs.output import write_csv
from bayes_rs.readers import compressed

SCAN = load_scan("staring")
HEADINGS = "time,beam,radial_velocity\n"
FORMULAS = ['=HYPERLINK("http://x","y")', "+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", "\t=1", "\r=1", "="]


class TestIn:
    @pytest.mark.parametrize("value", FORMULAS[:4])
    def test_a_formula_is_no_number(self, tmp_path, value):
        file = tmp_path / "a.csv"
        pd.DataFrame({"time": ["2020-01-01T00:00:00"], "beam": [0], "radial_velocity": [value]}).to_csv(
            file, index=False
        )
        with pytest.raises(InputError, match=r"Invalid radial_velocity .* it must be a number"):
            read(file, SCAN)

    @pytest.mark.parametrize("value", ["1e308", "-1e308", "inf", "nan"])
    def test_huge_values_make_no_record_that_is_used(self, tmp_path, value):
        """Their square overflows: the record is flagged or without a finite variance, and the others are unharmed."""
        file = tmp_path / "a.csv"
        rows = [
            f"{np.datetime64('2020-01-01T00:00:00') + np.timedelta64(k, 's')},0,{value if k in (7, 8) else k % 5}"
            for k in range(1200)
        ]
        file.write_text(HEADINGS + "\n".join(rows) + "\n")
        with np.errstate(over="ignore", invalid="ignore"):
            records = make_records(read(file, SCAN), SCAN)
        assert records["variance"].values[1, 0] == pytest.approx(2.0, rel=1e-12)
        first = records["variance"].values[0, 0]
        assert not np.isfinite(first) or first == pytest.approx(2.0, rel=0.01)

    def test_a_number_beyond_all_floats(self, tmp_path):
        """Some versions of pandas take it for infinity, others for text."""
        file = tmp_path / "a.csv"
        file.write_text(HEADINGS + "2020-01-01T00:00:00,0,1.0\n2020-01-01T00:00:01,0,1e999\n")
        try:
            series = read(file, SCAN)
        except InputError as error:
            refusal = str(error)
        else:
            refusal = ""
            assert np.isfinite(series["radial_velocity"].values).tolist() == [True, False]
        assert refusal == "" or "Invalid radial_velocity '1e999' in column 'radial_velocity', line 3" in refusal

    @pytest.mark.parametrize(
        "content", [(HEADINGS * 2).encode("utf-16"), b"\x00" * 5000, os.urandom(3000), b"PK\x03\x04"]
    )
    def test_other_encodings(self, tmp_path, content):
        (tmp_path / "a.csv").write_bytes(content)
        with pytest.raises(InputError, match=r"a\.csv") as caught:
            read(tmp_path / "a.csv", SCAN)
        assert len(str(caught.value)) < 8000

    def test_a_byte_order_mark(self, tmp_path):
        (tmp_path / "a.csv").write_text(f"\ufeff{HEADINGS}2020-01-01T00:00:00,0,1.0\n", encoding="utf-8")
        assert read(tmp_path / "a.csv", SCAN).sizes["sample"] == 1

    @pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zip"])
    def test_bombs(self, tmp_path, monkeypatch, suffix):
        """A megabyte of a gigabyte: what comes out is counted, whatever the file says of itself."""
        monkeypatch.setattr(compressed, "MOST_BYTES", 10_000_000)
        file, content = tmp_path / f"a.csv{suffix}", b"0" * 30_000_000
        if suffix == ".zip":
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("a.csv", content)
        else:
            with {".gz": gzip, ".bz2": bz2, ".xz": lzma}[suffix].open(file, "wb") as packed:
                packed.write(content)
        with pytest.raises(InputError, match="unpacks to more than 10000000 bytes"):
            read(file, SCAN)

    @pytest.mark.parametrize("name", ["../../evil.csv", "/etc/evil.csv", "a\\..\\evil.csv", "=1.csv"])
    def test_paths_in_an_archive_lead_nowhere(self, tmp_path, name):
        (tmp_path / "here").mkdir()
        file = tmp_path / "here" / "a.csv.zip"
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(name, f"{HEADINGS}2020-01-01T00:00:00,0,1.0\n")
        assert read(file, SCAN).sizes["sample"] == 1
        assert {path.name for path in tmp_path.rglob("*")} == {"here", "a.csv.zip"}


class TestOut:
    @pytest.mark.parametrize("text", FORMULAS)
    def test_no_cell_is_a_formula(self, tmp_path, text):
        table = pd.DataFrame({"scan": [text, "6-beam"], "number": [-1.5, 2.0], "mixed": [text, 3]})
        write_csv(table, tmp_path / "a.csv", index=False)
        found = pd.read_csv(tmp_path / "a.csv", keep_default_na=False)
        assert found["scan"].tolist() == [f"'{text}".replace("\r", " "), "6-beam"]
        assert found["mixed"].iloc[0] == f"'{text}".replace("\r", " ")
        assert found["number"].tolist() == [-1.5, 2.0]
        assert table["scan"].iloc[0] == text  # the table itself is as it was

    @pytest.mark.slow
    def test_names_of_scans_in_a_comparison(self, tmp_path, monkeypatch):
        """A scan is named in the table as the user named it, whose folder somebody else may have filled."""
        monkeypatch.chdir(tmp_path)
        names = ["=1+1.toml", "-2+3$\\frac{$.toml"]
        for name in names:
            (tmp_path / name).write_bytes((models_folder("scans") / "4-beam.toml").read_bytes())
        done = CliRunner().invoke(commands, ["compare", "-o", "out", "--records", "3", "--", *names])
        assert done.exit_code == 0, done.output
        table = pd.read_csv(tmp_path / "out" / "comparison.csv")
        assert set(table["scan"]) == {f"'{name}" for name in names}
        rows = json.loads((tmp_path / "out" / "comparison.json").read_text())["rows"]
        assert {row["scan"] for row in rows} == set(names)
        assert (tmp_path / "out" / "comparison.png").stat().st_size > 1000  # a dollar sign is no mathematics
