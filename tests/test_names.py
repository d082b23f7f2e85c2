"""Names of presets, their aliases, and the question for the one that was meant: one mechanism everywhere."""

import tomllib

import pytest
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError, did_you_mean, plain_name
from bayes_rs.fits.settings import Settings
from bayes_rs.models import find_model, models_folder, preset_aliases, preset_names


class TestAliases:
    @pytest.mark.parametrize(
        ("alias", "name"),
        [
            ("windcube-nacelle", "pulsed-4-beam"),
            ("wind-iris", "pulsed-4-beam"),
            ("WindIris", "pulsed-4-beam"),
            ("zxtm", "zx-tm"),
            ("ZX TM", "zx-tm"),
            ("zx300", "zx-300"),
            ("wls200s-dbs", "wls200s-dbs"),
            ("windcube-200s", "wls200s-dbs"),
            ("WindCube v2.1", "windcube-v2"),
            ("6beam", "6-beam"),
        ],
    )
    def test_mean_a_preset(self, alias, name):
        scan = brs.load_scan(alias)
        assert (scan.name, scan.key) == (name, brs.load_scan(name).key)
        changed = brs.load_scan(f"{alias}@probe=point")
        assert (changed.name, changed.key) == (f"{name}@probe=point", brs.load_scan(f"{name}@probe=point").key)

    def test_of_turbulence(self):
        assert brs.load_turbulence("FU 2022").name == "fu-2022"

    def test_are_taken_wherever_a_scan_is(self, tmp_path):
        assert Settings().changed(scan="wind-iris").scan.load().name == "pulsed-4-beam"
        assert brs.load_scan("6-beam@probe=zxtm").probe == brs.load_scan("zx-tm").probe
        done = CliRunner().invoke(commands, ["plan", "zxtm@probe=point"])
        assert done.exit_code == 0
        assert done.output.startswith("zx-tm@probe=point (50 beams)")
        file = tmp_path / "mine.toml"
        file.write_text('base = "zxtm"\n[mounting]\ntilt_deg = 1.0\n')
        assert brs.load_scan(file).n_beam == 50

    @pytest.mark.parametrize("kind", ["scans", "turbulence"])
    def test_no_two_are_the_same(self, kind):
        written = [*preset_names(kind)]
        for name in preset_names(kind):
            written += tomllib.loads((models_folder(kind) / f"{name}.toml").read_text()).get("aliases", [])
        assert len({plain_name(one) for one in written}) == len(written)
        assert preset_aliases(kind).keys() == set(written)

    def test_a_file_keeps_its_own_way(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "zxtm.toml").write_text((models_folder("scans") / "staring.toml").read_text())
        assert brs.load_scan("zxtm.toml").n_beam == 1
        with pytest.raises(InputError, match=r"No file 'zxtn\.toml'"):
            find_model("zxtn.toml", "scans")


class TestDidYouMean:
    @pytest.mark.parametrize(
        ("given", "question"),
        [
            ("zx-tn", "did you mean 'zx-tm'?"),
            ("windcube-nacele", "did you mean 'windcube-nacelle'?"),
            ("windcube", "did you mean 'windcube-v2'?"),
            ("six-beam", "did you mean '6-beam'?"),
        ],
    )
    def test_a_scan(self, given, question):
        with pytest.raises(InputError, match=r"No preset .* in models/scans: use one of .* \.toml file; ") as caught:
            brs.load_scan(given)
        assert str(caught.value).endswith(question)

    def test_no_question_where_nothing_is_near(self):
        with pytest.raises(InputError, match=r"path of a \.toml file\.$"):
            brs.load_scan("quadcopter")
        assert did_you_mean(3, ["3"]) == ""
        assert did_you_mean("x" * 1000, ["x"]) == ""
        assert did_you_mean("", ["a"]) == did_you_mean("--", ["a"]) == ""

    @pytest.mark.parametrize(
        ("call", "match"),
        [
            (lambda: brs.priors.make_prior("weka"), r"Unknown prior 'weka': .*mann; did you mean 'weak'\?"),
            (lambda: brs.load_turbulence("neutral-onshor"), r"did you mean 'neutral-onshore'\?"),
            (lambda: brs.noise.calibrate("2-beam", wind_speed=9.0, method="theroy"), r"did you mean 'theory'\?"),
            (lambda: brs.read("a.csv", "2-beam", file_format="wimdcube"), r"did you mean 'windcube'\?"),
            (lambda: brs.read("a.csv", "2-beam", columns={"radial_velocty": "v"}), r"did you mean 'radial_velocity'\?"),
            (lambda: brs.read("a.csv", "2-beam", positiv="away"), r"did you mean 'positive'\?"),
            (lambda: brs.load_scan("6-beam@tilt=3"), r"Unknown change 'tilt'.*did you mean 'tilt_deg'\?"),
            (lambda: brs.demo_file("6-beam45"), r"did you mean '6-beam-45'\?"),
            (lambda: Settings().changed(min_avalability=0.3), r"did you mean 'min_availability'\?"),
        ],
    )
    def test_other_names(self, call, match):
        with pytest.raises(InputError, match=match):
            call()

    @pytest.mark.parametrize(
        ("words", "line"),
        [
            (["recrds"], "No such command 'recrds'. Did you mean 'records'?"),
            (["fit", "a.csv", "--sampler", "emce"], "'auto'. Did you mean 'emcee'?"),
            (["records", "a.csv", "--format", "wimdcube", "-o", "b.nc"], "'netcdf'. Did you mean 'windcube'?"),
            (["plan", "zx-tn"], "did you mean 'zx-tm'?"),
        ],
    )
    def test_the_command_line(self, words, line):
        done = CliRunner().invoke(commands, words)
        assert line in done.output + str(done.exception)
