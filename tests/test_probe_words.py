"""What a fit and a plan say of the probe volume."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from bayes_rs import load_scan, load_turbulence, simulate, write_report
from bayes_rs.cli.group import commands
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.probe_words import probe_loss, probe_words
from bayes_rs.noise.store import find_shipped_noise

FLOW = load_turbulence("fu-2022")


def percents(words):
    return [float(number) for number in re.search(r"takes ([\d.]+)(?: to ([\d.]+))? %", words).groups() if number]


class TestWords:
    def test_hold_the_smallest_and_the_largest_part_that_the_gain_lacks(self):
        bank = find_shipped_noise(load_scan("pulsed-4-beam"), FLOW)
        speed, yaw = np.array([5.0, 8.0, 12.0]), np.deg2rad([-40.0, 0.0, 13.0])
        gain = bank.for_records(speed, yaw).gain
        points = np.stack([design_matrix(load_scan("pulsed-4-beam").at_yaw(angle)) for angle in yaw])
        loss = 1.0 - (gain @ FLOW.stresses()) / (points @ FLOW.stresses())
        # noise keeps its directions to 1e-9
        np.testing.assert_allclose(probe_loss(bank, speed, yaw), loss, atol=1e-8)
        words = probe_words(bank, speed, yaw)
        # two digits are printed
        assert percents(words) == pytest.approx([100.0 * loss.min(), 100.0 * loss.max()], abs=0.51)
        assert words.startswith("probe volume: pulsed, gate of 30 m and top-hat pulse of 30 m; it takes ")
        assert words.endswith("; --scan pulsed-4-beam@probe=point counts the beams as points")

    def test_small_eddies_lose_more_and_those_beyond_the_noise_count_as_its_smallest(self):
        scan = load_scan("pulsed-4-beam").select([0])
        noise = calibrate(scan, FLOW, wind_speed=10.0, length_scale=[15.0, 100.0], cache=False)
        speed, yaw = np.full(4, 10.0), np.zeros(4)
        small, large, beyond, unknown = probe_loss(noise, speed, yaw, [15.0, 100.0, 5.0, np.nan])[:, 0]
        flows = {
            size: calibrate(scan, replace(FLOW, length_scale=size), wind_speed=10.0, cache=False)
            for size in (15.0, 100.0)
        }
        assert small == pytest.approx(probe_loss(flows[15.0], [10.0], [0.0])[0, 0], abs=1e-6)
        assert large == pytest.approx(probe_loss(flows[100.0], [10.0], [0.0])[0, 0], abs=1e-6)
        assert beyond == small > 2.0 * large
        assert unknown == probe_loss(noise, [10.0], [0.0])[0, 0]

    def test_of_focused_lidars_name_length_and_focus_and_keep_other_changes(self):
        noise = calibrate(load_scan("zx-tm@focus_distance=80").select([0, 12]), FLOW, wind_speed=10.0, cache=False)
        words = probe_words(noise, [10.0], [0.0])
        assert words.startswith("probe volume: continuous-wave, Rayleigh length 4.1 m at 80 m; it takes ")
        assert "--scan zx-tm@focus_distance=80,probe=point counts" in words

    def test_of_a_scan_of_ones_own_name_no_preset(self):
        scan = replace(load_scan("pulsed-4-beam"), name="mine")
        words = probe_words(calibrate(scan, FLOW, wind_speed=10.0, cache=False), [10.0], [0.0])
        assert words.endswith("; @probe=point behind the name of its file counts the beams as points")

    @pytest.mark.parametrize(("name", "wind"), [("6-beam", 8.0), ("pulsed-4-beam@probe=point", 8.0), ("zx-tm", np.nan)])
    def test_there_are_none_for_points_or_without_a_wind(self, name, wind):
        assert probe_words(find_shipped_noise(load_scan(name), FLOW), [wind], [0.0]) == ""


@pytest.mark.usefixtures("no_pictures")
def test_a_fit_says_what_the_probe_takes_and_the_scans_name_says_that_it_is_off(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path / "cache"))
    series = simulate(load_scan("pulsed-4-beam"), FLOW, wind_speed=10.0, n_records=2, seed=3)
    series.to_dataframe().reset_index()[["time", "beam", "radial_velocity"]].to_csv(
        tmp_path / "x.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S.%f"
    )
    columns = [f"--column={name}={name}" for name in ("time", "beam", "radial_velocity")]
    for name in ("pulsed-4-beam", "pulsed-4-beam@probe=point"):
        out = tmp_path / name
        arguments = ["fit", str(tmp_path / "x.csv"), "--scan", name, *columns, "--positive=away", "-v", "-o", str(out)]
        done = CliRunner().invoke(commands, arguments)
        assert done.exit_code == 0, done.output
        run = json.loads((out / "run.json").read_text(encoding="utf-8"))
        assert run["scan"] == name
        said = [line for line in done.output.splitlines() if line.startswith("probe volume: ")]
        if name == "pulsed-4-beam":
            assert said == [run["probe_volume"]]
            assert 10.0 < percents(said[0])[0] < 20.0
        else:
            assert said == []
            assert run["probe_volume"] == ""
        page = write_report(out).read_text(encoding="utf-8")
        assert ("Probe volume: pulsed" in page.split('<p class="lead">')[1].split("</p>")[0]) == (said != [])


def test_the_plan_says_it_too():
    done = CliRunner().invoke(commands, ["plan", "pulsed-4-beam"])
    assert "--scan pulsed-4-beam@probe=point counts the beams as points" in done.output
    done = CliRunner().invoke(commands, ["plan", "pulsed-4-beam@probe=point"])
    assert "probe volume: no probe integral" in done.output
