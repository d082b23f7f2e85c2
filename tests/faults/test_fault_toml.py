"""Hostile TOML: refused in one short line, fast, with little memory, and no other file is read for it."""

import time
import tracemalloc

import pytest

from bayes_rs import InputError, load_scan, load_turbulence

HEAD = 'title = "t"\nsource = "s"\n'
TIMING = "[timing]\nscan_duration = 1.0\n"
CONE = f"{HEAD}[beams]\npattern = 'cone'\ncount = 4\nopening_angle_deg = 30.0\nfocus_distance = [100.0]\n{TIMING}"
BEAM = "[[beams.beam]]\nid = 1\nvector = [1.0, 0.0, 0.0]\n"
LIST = f"{HEAD}[beams]\npattern = 'list'\nfocus_distance = [100.0]\n{BEAM}{TIMING}"
FLOW = f"{HEAD}dissipation = 0.05\nlength_scale = 61.0\ngamma = 3.2\n"
DEEP = 100_000
SCANS = {
    "nested arrays": (f"{HEAD}x = {'[' * DEEP}{']' * DEEP}", "is nested too deeply"),
    "nested tables": (f"{HEAD}x = {'{a=' * 5000}1{'}' * 5000}", "is nested too deeply"),
    "dotted keys": (HEAD + ".".join("a" * DEEP) + " = 1", "has a key of more than 32 parts"),
    "quoted dotted keys": (HEAD + '"a" . ' * DEEP + "a = 1", "has a key of more than 32 parts"),
    "digits": (CONE.replace("count = 4", f"count = {'9' * 5000}"), "is not valid TOML: Exceeds the limit"),
    "large number": (CONE.replace("count = 4", f"count = {'9' * 50}"), "beams.count = 9999.*less than or equal to"),
    "trillion beams": (CONE.replace("count = 4", "count = 1000000000000"), "beams.count.*less than or equal to 10000"),
    "many planes": (
        CONE.replace("[100.0]", f"[{'100.0,' * 5000}]"),
        "4 beams on 5000 planes: all together may be 10000",
    ),
    "many distances": (CONE.replace("[100.0]", f"[{'1.0,' * 20_000}]"), "should have at most 10000 items"),
    "long file": (f"# {'x' * 9_000_000}", "has 9000002 bytes: a TOML file may have"),
    "infinity": (CONE.replace("100.0", "inf"), "focus_distance.0 = inf: input should be a finite number"),
    "no number": (CONE.replace("30.0", "nan"), "opening_angle_deg = nan: input should be a finite number"),
    "overflow": (CONE.replace("100.0", "1e400"), "focus_distance.0 = inf: input should be a finite number"),
    "huge distance": (CONE.replace("100.0", "1e308"), "focus_distance.0 = 1e.308: .* less than or equal to 1000000"),
    "no duration": (CONE.replace("duration = 1.0", "duration = 1e-320"), "scan_duration = 1e-320: .*greater than"),
    "true for a number": (CONE.replace("duration = 1.0", "duration = true"), "scan_duration = True: .* valid number"),
    "true for a count": (CONE.replace("count = 4", "count = true"), "count = True: .* valid integer"),
    "text for a number": (CONE.replace("duration = 1.0", "duration = '1.0'"), "scan_duration = '1.0': .* valid number"),
    "date": (CONE.replace("duration = 1.0", "duration = 2020-01-01"), "scan_duration = .*valid number"),
    "unknown key": (f"{CONE}evil = 1\n", "timing.evil = 1: unknown key; remove it"),
    "key of two lines": (f'{CONE}"a\\nb\\u001b[31m" = 1\n', r"timing\.a\\nb\\x1b\[31m' = 1: unknown key"),
    "long text": (CONE.replace("cone", "x" * DEEP), "beams = a table of"),
    "long unknown": (f"{CONE}evil = '{'x' * DEEP}'\n", "timing.evil = 'xxx"),
    "control character": (CONE.replace('"t"', '"\\u0000"'), "title = .*cannot stand in a text; remove it"),
    "number of a beam": (LIST.replace("id = 1", f"id = {'9' * 25}"), "beams.beam.0.id = .*less than or equal"),
    "long vector": (LIST.replace("[1.0, 0.0", "[1e308, 1e308"), "vector.0 = 1e.308: .*less than or equal"),
    "two of a number": (LIST.replace(BEAM, 2 * BEAM), "one for each beam, all different"),
    "base of itself": ('base = "x"\n', "more than 8 files are based on each other"),
    "base elsewhere": ('base = "../x"\n', r"base = '\.\./x': it must be the name of a scan"),
    "base by its path": ('base = "/etc/x"\n', "base = '/etc/x': it must be the name of a scan"),
    "base with NUL": ('base = "\\u0000"\n', "it must be the name of a scan"),
    "long base": (f'base = "{"a" * 5000}"\n', "it must be the name of a scan"),
    "base of another type": ("base = 5\n", "base = 5: it must be the name of a scan"),
    "UTF-16": (CONE.encode("utf-16"), "is not valid TOML: .*decode"),
}
FLOWS = {
    "true": (FLOW.replace("61.0", "true"), "length_scale = True: input should be a valid number"),
    "text": (FLOW.replace("61.0", "'61'"), "length_scale = '61': input should be a valid number"),
    "huge": (FLOW.replace("61.0", "1e308"), "length_scale = 1e.308: .*less than or equal"),
    "nested": (f"{FLOW}x = {'[' * DEEP}", "is nested too deeply"),
    "key of two lines": (f'{FLOW}"a\\nb" = 1\n', r"'a\\nb' = 1: unknown key"),
    "digits": (FLOW.replace("61.0", "9" * 5000), "is not valid TOML: Exceeds the limit"),
    "source": (FLOW.replace('"s"', '"\\u0007"'), "cannot stand in a text; remove it"),
}


def refused(folder, load, content, rule):
    file = folder / "x.toml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    tracemalloc.start()
    began = time.process_time()
    try:
        with pytest.raises(InputError, match=rule) as caught:
            load(file)
        assert time.process_time() - began < 20.0
        assert tracemalloc.get_traced_memory()[1] < 300e6
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert message.isprintable()
    assert len(message.replace(str(file), "")) < 400


@pytest.mark.parametrize("name", SCANS)
def test_scan(tmp_path, name):
    refused(tmp_path, load_scan, *SCANS[name])


@pytest.mark.parametrize("name", FLOWS)
def test_turbulence(tmp_path, name):
    refused(tmp_path, load_turbulence, *FLOWS[name])


def test_no_file_outside_the_folder_is_based_on(tmp_path):
    """There is one, it is valid, and it is not read."""
    (tmp_path / "other.toml").write_text(CONE)
    (tmp_path / "mine").mkdir()
    refused(tmp_path / "mine", load_scan, 'base = "../other"\n', "it must be the name of a scan")
    refused(tmp_path / "mine", load_scan, f'base = "{tmp_path / "other"}"\n', "it must be the name of a scan")


@pytest.mark.parametrize("content", [CONE, f"\ufeff{CONE}", LIST, CONE.replace("100.0", "100")])
def test_what_these_are_made_from_is_read(tmp_path, content):
    (tmp_path / "x.toml").write_text(content, encoding="utf-8")
    assert load_scan(tmp_path / "x.toml").n_beam in (1, 4)


def test_the_most_beams_are_read(tmp_path):
    (tmp_path / "x.toml").write_text(CONE.replace("count = 4", "count = 10000"))
    assert load_scan(tmp_path / "x.toml").n_beam == 10_000
