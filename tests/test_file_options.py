"""Options of reading: each of them arrives, from Python and from a scan's table, and a bad one is one clear line."""

import re
from dataclasses import replace

import numpy as np
import pytest

from bayes_rs import InputError
from bayes_rs.file_options import OF_READING
from bayes_rs.geometry import as_scan, load_scan, save_scan
from bayes_rs.options import from_plain, options_of, to_plain
from bayes_rs.readers import READERS, FileOptions, read, stream
from bayes_rs.readers.format import resolve_format

OTHER = {
    "file_format": "wide",
    "columns": {"time": "Time"},
    "beam_numbers": {"LOS2": 2},
    "positive": "towards",
    "velocity_unit": "km/h",
    "invalid": (9999.0, -1.0),
    "velocity_limit": 120.0,
    "time_zone": "UTC+1",
    "time_format": "%d.%m.%Y %H:%M",
    "time_stamp": "end",
    "sample_duration": 0.5,
    "separator": ";",
    "decimal": ",",
    "skip_rows": 3,
    "comment": "#",
    "encoding": "cp1252",
    "status_valid": 3.0,
    "angle_tolerance_deg": 0.25,
    "range_tolerance": 7.0,
    "gate_length": 30.0,
    "range": (80.0, 120.0),
    "height": (50.0,),
    "gates_by": "height",
    "phase_zero_deg": 90.0,
    "phase_turns": "down",
    "out_of_order": "sort",
    "bad_rows": "drop",
    "on_bad_file": "skip",
}
"""A value of each option that is not its default."""
OF_INSTRUMENT = [name for name in OTHER if name not in OF_READING]
BASE = load_scan("2-beam")


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{key}" = {toml(item)}' for key, item in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else str(list(value) if isinstance(value, tuple) else value)


def scan_file(folder, text):
    file = folder / "mine.toml"
    file.write_text(f'base = "2-beam"\n[file]\n{text}\n', encoding="utf-8")
    return file


def test_every_option_has_another_value_here():
    assert list(OTHER) == [entry.name for entry in options_of(FileOptions)]
    assert FileOptions(**OTHER).given() == OTHER
    assert FileOptions().given() == {}


@pytest.mark.parametrize("name", OTHER)
def test_an_option_arrives_from_the_caller(name):
    asked = FileOptions(**{name: OTHER[name]})
    assert getattr(resolve_format(asked, BASE), name) == OTHER[name]
    assert from_plain(FileOptions, to_plain(asked), where="a file") == asked


@pytest.mark.parametrize("name", OF_INSTRUMENT)
def test_an_option_arrives_from_the_scan(tmp_path, name):
    scan = load_scan(scan_file(tmp_path, f"{name} = {toml(OTHER[name])}"))
    assert list(scan.file_format) == [name]
    assert getattr(resolve_format(FileOptions(), scan), name) == OTHER[name]
    again = load_scan(save_scan(scan, tmp_path / "again.toml"))
    assert again.file_format == scan.file_format


@pytest.mark.parametrize("name", OF_INSTRUMENT)
def test_an_option_arrives_from_the_format(name):
    assert getattr(resolve_format(FileOptions(), BASE, defaults={name: OTHER[name]}), name) == OTHER[name]


@pytest.mark.parametrize("name", OF_READING)
def test_what_is_a_matter_of_one_reading_is_not_the_scans(tmp_path, name):
    with pytest.raises(InputError, match=f"file.{name} = '{OTHER[name]}': unknown key"):
        load_scan(scan_file(tmp_path, f"{name} = {toml(OTHER[name])}"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('positive = "up"', "file: unknown positive 'up': it must be one of away, towards."),
        ('colums = { time = "t" }', "file.colums = a table of 1 keys: unknown key; did you mean 'columns'?"),
        ("invalid = [true]", "file: invalid entry of invalid True: it must be a finite number."),
        ('status_valid = "1"', "file: invalid status_valid '1': it must be a finite number."),
        ("sample_duration = -1", "file: invalid sample_duration -1 s: it must be a finite number above zero."),
        ("time_zone = 1", "file: invalid time_zone 1: it must be a text."),
        ("beam_numbers = { a = 1.5 }", "file: invalid beam_numbers entry 'a': 1.5: it must be a whole number"),
        ("columns = { time = true }", "file: invalid column True for 'time' in columns: it must be a heading"),
        (f'separator = "{"x" * 300}"', "an entry of 302 characters is no option; at most 200 may be."),
        ("positive = [1, 2]", "file: unknown positive (1, 2): it must be one of away, towards."),
        ("positive = { a = 1 }", "file: unknown positive {'a': 1}: it must be one of away, towards."),
    ],
)
def test_a_bad_table_is_one_line_with_place_value_and_rule(tmp_path, text, message):
    file = scan_file(tmp_path, text)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_scan(file)
    assert str(caught.value).startswith(f"Invalid scan file {str(file)!r}: ")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("way", [read, lambda *a, **k: next(stream(*a, **k))], ids=["read", "stream"])
def test_a_misspelt_keyword(tmp_path, way):
    with pytest.raises(InputError, match="Unknown option 'postive' in the options of reading: did you mean 'positive'"):
        way(tmp_path / "a.csv", BASE, postive="away")


@pytest.mark.parametrize("way", [read, lambda *a, **k: next(stream(*a, **k))], ids=["read", "stream"])
def test_a_scan_by_its_name(tmp_path, way):
    file = tmp_path / "a.csv"
    file.write_text("time,beam,radial_velocity\n2024-01-01T00:00:00,0,-8\n")
    assert way(file, "2-beam").attrs["scan_key"] == BASE.key
    assert as_scan(BASE) is BASE


def test_the_formats_are_those_of_the_registry(monkeypatch):
    (entry,) = [entry for entry in options_of(FileOptions) if entry.name == "file_format"]
    assert entry.choices == ("auto", *READERS)
    monkeypatch.setitem(READERS, "mine", replace(READERS["long"], name="mine"))
    assert entry.choices[-1] == "mine"


def test_an_option_of_numbers_takes_an_array():
    assert FileOptions(invalid=np.array([1.0, 2.0])).invalid == (1.0, 2.0)
