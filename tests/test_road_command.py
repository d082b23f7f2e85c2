"""Every option arrives: from the command line in the settings, in the fit, in `run.json` and in a settings file."""

import importlib
import inspect
import json
import subprocess
import sys

import click
import numpy as np
import pytest
from click.shell_completion import ShellComplete
from scenes import draw_variances, plain_noise, records_of
from settings_samples import EVERY, SAMPLES, changed, entry_of, value_of, words_of_needs

import bayes_rs as brs
from bayes_rs.cli import fit_commands
from bayes_rs.cli.group import commands
from bayes_rs.cli.options import FieldOption, refuse_given
from bayes_rs.fits.fit_options import NoiseOptions
from bayes_rs.fits.fitting import split_options
from bayes_rs.fits.settings import SECTIONS, InputOptions, Settings
from bayes_rs.geometry.scan_writing import scan_text
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, log_normal_likelihood
from bayes_rs.likelihoods.reduced_noise import ReducedNoise
from bayes_rs.options import options_of
from bayes_rs.records.record_files import open_record_files
from bayes_rs.records.record_options import ADDED, RecordOptions

ON_THE_COMMAND_LINE = [(section, name) for section, name in EVERY if entry_of(section, name).flag]
"""The others are for settings files and Python."""
NOT_ON_IT = {
    ("scan", "scan_toml"),
    ("files", "files"),  # these are its arguments
    ("records", "expected_count"),
    ("records", "min_count"),
    *(
        ("quality", name)
        for name in (
            "status_valid",
            "status_reject_bits",
            "masks",
            "snr_range",
            "hard_target_speed",
            "blocked_sectors",
            "blade_window",
            "despike_window",
            "despike_threshold",
            "wind_sectors",
            "sub_records",
        )
    ),
    ("fit", "likelihood"),
    ("fit", "nuisances"),  # its options are
}
COMMANDS = {
    "fit": fit_commands.fit,
    "sensitivity": fit_commands.sensitivity,
    **{name: commands.get_command(None, name) for name in ("records", "spectra", "wind", "plan", "calibrate")},
}


@pytest.fixture(autouse=True)
def _likelihood_of_our_own(monkeypatch):
    monkeypatch.setitem(LIKELIHOODS, "mine", log_normal_likelihood)


@pytest.fixture
def bayes_rs(monkeypatch, capsys, no_pictures):  # noqa: ARG001 - there are none
    """Run a command line; return its exit code, and the lines of stdout and stderr."""
    from bayes_rs import cli  # noqa: PLC0415 - beside its use

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["bayes-rs", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return caught.value.code or 0, out.splitlines(), err.splitlines()

    return run


@pytest.fixture
def settings_of_fit(monkeypatch, tmp_path):
    """Return the settings that a command line of `fit` hands to the fit; nothing is read."""
    handed = []

    def take(settings, **_more):
        handed.append(settings)
        raise brs.InputError("far enough")

    monkeypatch.setattr("bayes_rs.fits.from_files.fit_files", take)
    monkeypatch.setattr("bayes_rs.records.record_files.open_record_files", lambda *_args: None)
    monkeypatch.setattr("bayes_rs.output.check_output_folder", lambda *_args, **_options: None)

    def run(*words, to=True):
        first = [] if str(words[0]).endswith((".toml", ".json")) else ["/data/day.csv"]
        arguments = [*first, *map(str, words)]
        if to and "--output" not in arguments:
            arguments += ["--output", str(tmp_path / "out")]
        if "--scan" not in arguments and first:
            arguments += ["--scan", "6-beam"]
        with pytest.raises(brs.InputError, match="far enough"):
            commands.main(["fit", *arguments], standalone_mode=False)
        return handed.pop()

    return run


class TestEveryOption:
    def test_each_has_a_sample_that_is_not_its_default(self):
        assert {(section, name) for section in SAMPLES for name in SAMPLES[section]} == set(EVERY)
        for section, name in EVERY:
            assert SAMPLES[section][name].value != entry_of(section, name).default

    def test_those_without_a_flag_are_these(self):
        assert set(EVERY) - set(ON_THE_COMMAND_LINE) == NOT_ON_IT
        assert all(bool(SAMPLES[section][name].words) == bool(entry_of(section, name).flag) for section, name in EVERY)

    @pytest.mark.parametrize(("section", "name"), ON_THE_COMMAND_LINE)
    def test_it_goes_from_the_command_line_into_the_settings(self, section, name, settings_of_fit):
        sample = SAMPLES[section][name]
        found = settings_of_fit(*words_of_needs(sample.needs), *sample.words)
        assert value_of(found, section, name) == sample.value
        files = ("/data/day.csv",)
        output = found.output.output
        plain = settings_of_fit("--seed", 1)
        expected = changed(plain.changed(files=files), section, sample, name)
        assert found == expected.changed(output=output)  # and it changes no other

    @pytest.mark.parametrize(("section", "name"), ON_THE_COMMAND_LINE)
    def test_it_counts_before_a_settings_file(self, section, name, settings_of_fit, tmp_path):
        entry, sample = entry_of(section, name), SAMPLES[section][name]
        file = tmp_path / "s.toml"
        Settings().changed(files="/data/day.csv", scan="6-beam", output="/data/there", seed=11).save(file)
        found = settings_of_fit(file, *words_of_needs(sample.needs), *sample.words)
        assert value_of(found, section, name) == sample.value
        assert found.fit.seed == (sample.value if name == "seed" else 11)  # what the file says of others stays
        assert entry.default != sample.value

    @pytest.mark.parametrize(("section", "name"), EVERY)
    def test_a_settings_file_brings_it_into_the_fit(self, section, name, settings_of_fit, tmp_path):
        sample, file = SAMPLES[section][name], tmp_path / "s.toml"
        base = Settings().changed(files="/data/day.csv", scan="6-beam")
        changed(base, section, sample, name).save(file)
        if name == "scan_toml":
            return  # it stands in for the scan: see tests/test_settings.py
        assert value_of(settings_of_fit(file, to=name != "output"), section, name) == sample.value

    @pytest.mark.parametrize(("section", "name"), ON_THE_COMMAND_LINE)
    def test_save_settings_writes_it(self, section, name, settings_of_fit, tmp_path):
        sample, file = SAMPLES[section][name], tmp_path / "saved.toml"
        found = settings_of_fit(*words_of_needs(sample.needs), *sample.words, "--save-settings", file)
        saved = Settings.load(file)
        assert value_of(saved, section, name) == sample.value
        assert saved == found

    @pytest.mark.parametrize(
        ("section", "name"), [(section, name) for section, name in EVERY if section in ("fit", "noise", "nuisances")]
    )
    def test_python_takes_it_as_a_keyword(self, section, name):
        sample = SAMPLES[section][name]
        if name == "noise":
            assert "noise" in inspect.signature(brs.fit).parameters
            return
        settings = changed(Settings(), section, sample, name)
        keywords = {entry.name: getattr(settings.fit, entry.name) for entry in options_of(SECTIONS["fit"])}
        if section == "noise":
            keywords[name] = sample.value
        own, choice = split_options(keywords)
        assert own == settings.fit
        assert choice == settings.noise


class TestHelp:
    @pytest.mark.parametrize(("section", "name"), ON_THE_COMMAND_LINE)
    def test_it_says_what_the_field_says(self, section, name):
        entry = entry_of(section, name)
        context = click.Context(COMMANDS["fit"])
        option = next(one for one in COMMANDS["fit"].params if isinstance(one, FieldOption) and entry.flag in one.opts)
        names, text = option.get_help_record(context)
        assert entry.flag in names
        assert text.startswith(entry.about.help.rstrip("."))
        assert entry.about.unit in text
        default = entry.default
        if isinstance(default, (int, float, str)) and not isinstance(default, bool):
            shown = f"{default:g}" if isinstance(default, float) else default
            assert f"default: {shown}]" in text
        for choice in () if entry.about.open and len(entry.choices) > 12 else entry.choices:
            assert choice in text + names

    @pytest.mark.parametrize("command", list(COMMANDS))
    def test_no_line_is_wider_than_the_terminal(self, command):
        context = click.Context(COMMANDS[command], max_content_width=110, terminal_width=110)
        assert max(map(len, COMMANDS[command].get_help(context).splitlines())) <= 110

    def test_sections_have_titles(self, bayes_rs):
        code, out, err = bayes_rs("fit", "--help")
        assert (code, err) == (0, [])
        titles = [line for line in out if line.endswith(":") and not line.startswith(" ")]
        assert titles == [
            "Scan:",
            "Files of radial velocities:",
            "Records:",
            "Quality:",
            "Noise:",
            "Fit:",
            "What is uncertain beside R:",
            "Output:",
            "Options:",
        ]

    def test_it_does_not_wait_for_the_science(self):
        code = (
            "import sys; from bayes_rs.cli.group import commands\n"
            "try: commands.main(['fit', '--help'])\n"
            "except SystemExit: pass\n"
            "heavy = {'scipy.special', 'scipy.stats', 'pandas', 'xarray', 'pyarrow', 'emcee', 'matplotlib'}\n"
            "print(sorted(heavy & set(sys.modules)))"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
        assert done.stdout.splitlines()[-1] == "[]"

    @pytest.mark.parametrize(
        ("words", "incomplete", "wanted"),
        [
            (["fit", "--prior"], "fl", ["flat"]),
            (["fit", "--scan"], "6-", ["6-beam"]),
            (["fit", "--sampler"], "", ["emcee", "direct", "auto"]),
            (["fit", "--yaw-sd"], "r", ["records"]),
            (["fit", "--turbulence"], "iec", ["iec-a", "iec-b", "iec-c"]),
            (["records", "--format"], "wi", ["wide", "windcube"]),
            (["fit", "--vertical"], "", []),
        ],
    )
    def test_values_are_completed(self, words, incomplete, wanted):
        shell = ShellComplete(commands, {}, "bayes-rs", "_BAYES_RS_COMPLETE")
        found = [item.value for item in shell.get_completions(words, incomplete) if item.type == "plain"]
        assert [value for value in found if value in wanted] == wanted


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with a small file, its records and noise, and a scan file of the user's own."""
    folder = tmp_path_factory.mktemp("road")
    scan = brs.load_scan("2-beam", tilt_deg=2.0)
    brs.save_scan(brs.load_scan("2-beam"), folder / "mine.toml")
    series = brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    table = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
    table.to_csv(folder / "day.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S.%f")
    brs.noise.calibrate(scan, "fu-2022", wind_speed=10.0).save(folder / "noise.nc")
    records = brs.make_records(brs.read(folder / "day.csv", scan), scan)
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    return folder


QUICK = ("--sampler", "direct", "--ess", 100)
MINE = ("--scan", "mine.toml", "--tilt", 2)


class TestRun:
    """A run is in its `run.json`, and comes from it again."""

    GROUPS = (
        ("fit", ("seed", "prior", "target", "sampler", "target_ess", "prob", "derived", "draws", "instrument_noise")),
        ("fit", ("max_extension", "interval")),
        ("nuisances", ("yaw_sd_deg", "tilt_sd_deg", "inflation", "inflation_dof")),
        ("nuisances", ("vertical_gradient_sd", "instrument_noise_log_sd")),
        ("records", ("duration", "min_availability")),
        ("quality", ("velocity_range", "frozen_run", "trend_level", "min_wind_speed", "exclude", "despike")),
        ("files", ("file_format", "positive", "velocity_unit", "time_zone", "on_bad_file", "out_of_order", "invalid")),
        ("noise", ("turbulence",)),
    )

    @pytest.mark.parametrize(("section", "names"), GROUPS)
    def test_options_are_in_the_run_file_and_repeat_it(self, section, names, bayes_rs, scene, tmp_path, monkeypatch):
        monkeypatch.chdir(scene)
        words = [*MINE, *QUICK]
        for name in names:
            sample = SAMPLES[section][name]
            words += [*words_of_needs(sample.needs), *sample.words]
        if "exclude" in names:
            words += ["--exclude", "low_wind"]
        code, _, err = bayes_rs("fit", "day.csv", *words, "-o", tmp_path / "one")
        assert code in {0, 1}, err
        run = json.loads((tmp_path / "one" / "run.json").read_text())
        held = Settings.from_plain(run["settings"], where="run.json")
        for name in names:
            if name != "exclude":
                assert value_of(held, section, name) == SAMPLES[section][name].value
        monkeypatch.chdir(tmp_path)  # paths are whole
        again, _, err = bayes_rs("fit", "one/run.json", "-o", "two")
        assert again == code, err
        assert (tmp_path / "two" / "summary.csv").read_bytes() == (tmp_path / "one" / "summary.csv").read_bytes()

    @pytest.mark.parametrize("more", [("--noise", "noise.nc"), ()])
    @pytest.mark.parametrize("file", ["day.csv", "records.nc"])
    def test_a_run_is_repeated_bit_by_bit(self, file, more, bayes_rs, scene, tmp_path, monkeypatch):
        monkeypatch.chdir(scene)
        code, _, err = bayes_rs("fit", file, *MINE, *QUICK, *more, "-o", tmp_path / "one")
        assert code == 0, err
        monkeypatch.chdir(tmp_path)
        code, _, err = bayes_rs("fit", "one/run.json", "-o", "two")
        assert code == 0, err
        assert (tmp_path / "two" / "summary.csv").read_bytes() == (tmp_path / "one" / "summary.csv").read_bytes()
        assert (tmp_path / "one" / "noise.nc").exists() == bool(more)

    @pytest.mark.parametrize("given", ["object", "file", "none"])
    def test_a_run_of_python_is_repeated_bit_by_bit(self, given, bayes_rs, scene, tmp_path, monkeypatch):
        scan = brs.load_scan(scene / "mine.toml", tilt_deg=2.0)
        records = open_record_files([scene / "records.nc"], scan)
        noise = {"object": brs.noise.load(scene / "noise.nc"), "file": scene / "noise.nc", "none": None}[given]
        found = brs.fit(
            records, scan, seed=3, noise=noise, sampler="direct", target_ess=100, output=tmp_path / "one", prior="flat"
        )
        assert found.settings["noise"]["noise"] == (None if given == "none" else "noise.nc")
        monkeypatch.chdir(tmp_path)
        code, _, err = bayes_rs("fit", "one/run.json", "-o", "two")
        assert code == 0, err
        assert (tmp_path / "two" / "summary.csv").read_bytes() == (tmp_path / "one" / "summary.csv").read_bytes()

    def test_a_saved_file_repeats_the_run_too(self, bayes_rs, scene, tmp_path, monkeypatch):
        monkeypatch.chdir(scene)
        words = [*MINE, *QUICK, "--save-settings", tmp_path / "s.toml"]
        assert bayes_rs("fit", "day.csv", *words, "-o", tmp_path / "one")[0] == 0
        assert bayes_rs("fit", tmp_path / "s.toml", "-o", tmp_path / "two")[0] == 0
        assert (tmp_path / "two" / "summary.csv").read_bytes() == (tmp_path / "one" / "summary.csv").read_bytes()
        before = (tmp_path / "s.toml").read_bytes()
        code, _, err = bayes_rs("fit", "day.csv", *words, "-o", tmp_path / "three")
        assert code == 2
        assert "exists, and --save-settings replaces none: give another." in err[-1]
        assert (tmp_path / "s.toml").read_bytes() == before
        assert not (tmp_path / "three").exists()

    @pytest.mark.parametrize("file", ["one/s.toml", "one/below/s.toml", "one"])
    def test_a_file_in_the_output_folder_is_refused_before_anything_is_written(
        self, file, bayes_rs, scene, tmp_path, monkeypatch
    ):
        monkeypatch.chdir(scene)
        words = ("-o", tmp_path / "one", "--save-settings", tmp_path / file)
        code, _, err = bayes_rs("fit", "day.csv", *MINE, *words)
        assert code == 2
        assert f"Invalid --save-settings {str(tmp_path / file)!r}: it is in the output folder" in err[-1]
        assert list(tmp_path.iterdir()) == []

    def test_other_files_count_before_those_of_a_run(self, bayes_rs, scene, tmp_path):
        scan = brs.load_scan(scene / "mine.toml", tilt_deg=2.0)
        first = ("fit", scene / "day.csv", "--scan", scene / "mine.toml", "--tilt", 2, *QUICK)
        assert bayes_rs(*first, "-o", tmp_path / "one")[0] == 0
        one = open_record_files([scene / "records.nc"], scan).isel(record=[1])
        one.to_netcdf(tmp_path / "second.nc", engine="h5netcdf")
        code, out, _ = bayes_rs("fit", tmp_path / "one" / "run.json", tmp_path / "second.nc", "-o", tmp_path / "two")
        assert code == 0
        assert out[0].endswith("; 1 of 1 records fitted")
        assert brs.open_fit(tmp_path / "two").run["source_files"] == ["second.nc"]

    def test_what_the_command_line_says_of_the_scan_counts(self, settings_of_fit, scene, tmp_path):
        scan = brs.load_scan(scene / "mine.toml", tilt_deg=2.0)
        named = {
            "scan": str(scene / "mine.toml"),
            "scan_toml": scan_text(scan),
            "settings": {"scan": {"tilt_deg": 2.0}},
        }
        (tmp_path / "run.json").write_text(json.dumps(named))
        assert settings_of_fit(tmp_path / "run.json").scan.load().tilt == scan.tilt
        found = settings_of_fit(tmp_path / "run.json", "--tilt", 5).scan.load()
        assert found.tilt == pytest.approx(np.deg2rad(5.0))

    def test_how_bad_files_are_met_is_no_part_of_the_key(self, bayes_rs, scene, tmp_path):
        words = ("fit", scene / "day.csv", "--scan", scene / "mine.toml", *QUICK, "-o", tmp_path / "out")
        assert bayes_rs(*words)[0] == 0
        code, _, err = bayes_rs(*words, "--resume", "--on-bad-file", "error")
        assert code == 0, err
        assert "2 of 2 records were finished by an earlier run" in err
        code, _, err = bayes_rs(*words, "--resume", "--positive", "towards")
        assert code == 2
        assert "is of a run that differs in reading options" in err[-1]


class TestNoEffect:
    """An option that would do nothing is refused, not dropped."""

    @pytest.mark.parametrize("command", ["fit", "sensitivity"])
    @pytest.mark.parametrize("option", [("--turbulence", "iec-a")])
    def test_how_noise_is_made_beside_a_noise_file(self, command, option, bayes_rs, scene, tmp_path):
        words = ("--scan", scene / "mine.toml", "--tilt", 2, "--noise", scene / "noise.nc", *option)
        code, _, err = bayes_rs(command, scene / "records.nc", *words, "-o", tmp_path / "out")
        assert code == 2
        assert f"{option[0]}: it says how noise is made, and the noise of " in err[-1]
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("command", "section", "name"),
        [
            *(
                ("fit", section, name)
                for section, name in ON_THE_COMMAND_LINE
                if section in ("files", "records", "quality") and name not in ADDED
            ),
            *((command, "records", "duration") for command in ("sensitivity", "records", "wind")),
        ],
    )
    def test_options_of_series_for_records(self, command, section, name, bayes_rs, scene, tmp_path):
        sample = SAMPLES[section][name]
        words = ("--scan", scene / "mine.toml", "--tilt", 2, *words_of_needs(sample.needs), *sample.words)
        code, _, err = bayes_rs(command, scene / "records.nc", *words, "-o", tmp_path / "out")
        assert code == 2
        assert f"{entry_of(section, name).flag}: for radial velocities only, and " in err[-1]

    def test_the_law_of_no_profile(self, bayes_rs, scene, tmp_path):
        words = (scene / "day.csv", "--scan", scene / "mine.toml", "--law", "log", "-o", tmp_path / "w.csv")
        code, _, err = bayes_rs("wind", *words)
        assert code == 2
        assert "--law: it is of the profile, which is fitted where --hub-height is given: add that." in err[-1]

    def test_boxes_of_a_theory(self, bayes_rs, tmp_path):
        words = ("2-beam", "--wind-speed", 10, "--boxes", 5, "-o", tmp_path / "n.nc")
        code, _, err = bayes_rs("calibrate", *words)
        assert code == 2
        assert "--boxes: it is of boxes, and the noise is made by theory: add --method boxes." in err[-1]

    def test_nothing_is_refused_that_is_not_given(self):
        @click.command()
        @click.option("--one", default=1)
        @click.option("--other", default=2)
        def command(one, other):
            refuse_given(("one",), "no.")
            assert (one, other) == (1, 3)

        command.main(["--other", "3"], standalone_mode=False)


class TestBadFiles:
    @pytest.fixture
    def folder(self, scene, tmp_path):
        raw = tmp_path / "raw"
        raw.mkdir()
        (raw / "day.csv").write_bytes((scene / "day.csv").read_bytes())
        (raw / "junk.csv").write_text("no table")
        return raw

    @pytest.mark.parametrize("command", ["fit", "records", "wind", "spectra", "sensitivity"])
    def test_one_among_good_ones_is_named_at_the_end(self, command, folder, scene, bayes_rs, tmp_path):
        more = QUICK if command in ("fit", "sensitivity") else ()
        words = (folder, "--scan", scene / "mine.toml", *more)
        code, _, err = bayes_rs(command, *words, "-o", tmp_path / "out.nc")
        assert code == 1, err
        assert err[-1].startswith("file ")
        assert "junk.csv: File" in err[-1]
        code, _, err = bayes_rs(command, *words, "--on-bad-file", "error", "-o", tmp_path / "refused")
        assert code == 2
        assert any(line.startswith("bayes-rs: File ") and "junk.csv" in line for line in err)

    @pytest.mark.parametrize("command", ["fit", "records", "wind", "spectra", "sensitivity"])
    def test_none_that_can_be_used(self, command, folder, scene, bayes_rs, tmp_path):
        (folder / "day.csv").unlink()
        code, out, err = bayes_rs(command, folder, "--scan", scene / "mine.toml", "-o", tmp_path / "out")
        assert (code, out) == (2, [])
        assert len(err) == 1
        assert "junk.csv" in err[0]
        assert not (tmp_path / "out").exists()

    def test_python_refuses_them_by_default(self, folder):
        with pytest.raises(brs.InputError, match=r"junk\.csv"):
            brs.read(folder, "2-beam")


def test_results_that_are_gone_are_no_bad_input(bayes_rs, monkeypatch, tmp_path):
    def lost(*_args, **_options):
        raise brs.LostResultsError("Results are gone: summary/part-0 is not there.", damage={"summary/part-0": "gone"})

    monkeypatch.setattr("bayes_rs.fits.from_files.fit_files", lost)
    monkeypatch.setattr("bayes_rs.records.record_files.open_record_files", lambda *_args: None)
    code, out, err = bayes_rs("fit", "day.csv", "--scan", "2-beam", "-o", tmp_path / "out")
    assert (code, out) == (1, [])
    assert err == ["bayes-rs: Results are gone: summary/part-0 is not there."]


class Handed(Exception):  # noqa: N818 - it carries a call, and is no error
    """What a command handed to the function that does its work."""


@pytest.fixture
def handed(monkeypatch, scene):
    """Run a command line up to the function that does the work; return the function's arguments by name."""

    def run(function, command, *words):
        module, _, name = function.partition(":")
        signature = inspect.signature(getattr(importlib.import_module(module), name))

        def take(*args, **options):
            raise Handed(signature.bind(*args, **options).arguments)

        monkeypatch.setattr(f"{module}.{name}", take)
        with pytest.raises(Handed) as caught:
            commands.main([command, *map(str, words)], standalone_mode=False)
        found = caught.value.args[0]
        more = found.pop("options") if isinstance(found.get("options"), dict) else {}
        return {**found, **more}

    run.mine = (scene / "day.csv", "--scan", scene / "mine.toml", "--tilt", 2)
    return run


class TestOtherCommands:
    """Each option of the commands beside `fit` reaches the function that does the work."""

    @pytest.mark.parametrize(
        ("words", "name", "value"),
        [
            (("--length-scale-prior", 80, 0.5), "length_scale_prior", (80.0, 0.5)),
            (("--instrument-noise", 0.1), "instrument_noise", 0.1),
            (("--instrument-noise-sd", 0.05), "instrument_noise_sd", 0.05),
            (("--tapers", 3), "tapers", 3),
            (("--one-length-scale",), "one_length_scale", True),
            (("--turbulence", "iec-a"), "turbulence", "iec-a"),
            (("--overwrite",), "overwrite", True),
        ],
    )
    def test_spectra(self, words, name, value, handed, tmp_path):
        found = handed(
            "bayes_rs.spectra.spectra_job:run_spectra", "spectra", *handed.mine, *words, "-o", tmp_path / "s"
        )
        assert found[name] == value
        assert found["scan"].tilt == pytest.approx(np.deg2rad(2.0))
        assert found["source_files"] == ["day.csv"]

    @pytest.mark.parametrize(
        ("words", "name", "value"),
        [
            (("--wind-speed", 8, "--wind-speed", 12), "wind_speed", [8.0, 12.0]),
            (("--wind-speed", 8, "--noise-yaw", 10), "yaw_deg", [10.0]),
            (("--wind-speed", 8, "--duration", 300), "duration", 300.0),
            (("--wind-speed", 8, "--turbulence", "iec-b"), "turbulence", "iec-b"),
            (("--wind-speed", 8, "--sonic"), "sonic", True),
            (("--wind-speed", 8), "method", "theory"),
            (
                ("--wind-speed", 8, "--method", "boxes", "--boxes", 7, "--seed", 9),
                "method",
                brs.noise.Boxes(n_boxes=7, seed=9),
            ),
        ],
    )
    def test_calibrate(self, words, name, value, handed, tmp_path):
        found = handed(
            "bayes_rs.noise.calibrating:calibrate", "calibrate", "6-beam", "--yaw", 5, *words, "-o", tmp_path / "n.nc"
        )
        assert found[name] == value
        assert found["scan"].yaw == pytest.approx(np.deg2rad(5.0))

    @pytest.mark.parametrize("command", ["fit", "sensitivity"])
    def test_noise_that_is_made_for_records(self, command, handed, tmp_path):
        words = ("--turbulence", "iec-b", "--target", "sonic", "-o", tmp_path / "out")
        found = handed("bayes_rs.noise.calibrating:calibrate", command, *handed.mine, *words)
        assert (found["turbulence"], found["sonic"]) == ("iec-b", True)

    def test_plan(self, handed):
        words = ("6-beam", "--opening-angle", 40, "--turbulence", "iec-b", "--wind-speed", 7, "--duration", 300)
        found = handed("bayes_rs.design.planning:plan", "plan", *words, "--prior", "flat", "--ess", 50)
        assert found["scan"].key == brs.load_scan("6-beam", opening_angle_deg=40.0).key
        assert found["turbulence"] == brs.load_turbulence("iec-b")
        wanted = {"wind_speed": 7.0, "duration": 300.0, "prior": "flat", "target_ess": 50}
        assert {name: found[name] for name in wanted} == wanted

    @pytest.mark.parametrize(
        ("section", "name"),
        [
            (section, name)
            for section, name in ON_THE_COMMAND_LINE
            if section in ("fit", "nuisances", "noise")
            and name not in ("derived", "draws", "campaign", "campaign_group", "campaign_unsteady")
        ],
    )
    def test_sensitivity(self, section, name, handed):
        sample = SAMPLES[section][name]
        words = (*words_of_needs(sample.needs), *sample.words, "--factor", 3)
        found = handed("bayes_rs.fits.prior_check:prior_sensitivity", "sensitivity", *handed.mine, *words)
        assert (getattr(found["nuisances"], name) if section == "nuisances" else found[name]) == sample.value
        assert found["factors"] == (3.0,)

    def test_wind(self, handed, tmp_path):
        words = (*handed.mine, "--heading", 350, "--turbulence", "iec-b", "--hub-height", 80, "-o", tmp_path / "w.csv")
        found = handed("bayes_rs.wind.mean_vector:mean_wind", "wind", *words)
        assert (found["heading_deg"], found["turbulence"]) == (350.0, brs.load_turbulence("iec-b"))

    def test_the_profile_of_wind(self, handed, tmp_path):
        words = (*handed.mine, "--law", "log", "--turbulence", "iec-b", "--hub-height", 80, "-o", tmp_path / "w.csv")
        found = handed("bayes_rs.wind.profile:wind_profile", "wind", *words)
        wanted = {"hub_height": 80.0, "law": "log", "turbulence": brs.load_turbulence("iec-b")}
        assert {name: found[name] for name in wanted} == wanted

    @pytest.mark.parametrize(
        ("section", "name"), [(section, name) for section, name in ON_THE_COMMAND_LINE if section == "files"]
    )
    def test_how_spectra_read_files(self, section, name, handed, tmp_path):
        sample = SAMPLES[section][name]
        found = handed("bayes_rs.readers.reading:read", "spectra", *handed.mine, *sample.words, "-o", tmp_path / "s")
        assert found.get(name, "error" if name == "on_bad_file" else None) == sample.value

    def test_blades_are_looked_for_in_a_whole_series(self, handed, tmp_path):
        words = SAMPLES["quality"]["blade_frequency"].words
        found = handed("bayes_rs.records.making:make_records", "records", *handed.mine, *words, "-o", tmp_path / "r.nc")
        assert found["quality"].blade_frequency == (0.3, 1.2)

    @pytest.mark.parametrize(
        ("command", "section", "name"),
        [
            (command, section, name)
            for command in ("records", "fit")
            for section, name in ON_THE_COMMAND_LINE
            if section in ("files", "records", "quality")
            and name not in ADDED
            and (command, name) != ("records", "blade_frequency")  # the test above
        ],
    )
    def test_how_records_are_made(self, command, section, name, handed, tmp_path):
        sample = SAMPLES[section][name]
        words = (*handed.mine, *words_of_needs(sample.needs), *sample.words, "-o", tmp_path / "out")
        module = "bayes_rs.records.record_store" if command == "records" else "bayes_rs.fits.from_files"
        found = handed(f"{module}:store_records", command, *words)
        place = {"files": found["reading"], "quality": found["quality"]}.get(section)
        assert (found[name] if place is None else getattr(place, name)) == sample.value

    @pytest.mark.parametrize(
        ("function", "words", "name", "value"),
        [
            ("fit_into", ("--workers", 2), "workers", 2),
            ("fit_into", ("--scheduler", "tcp://10.0.0.1:8786"), "client", "tcp://10.0.0.1:8786"),
            ("begin_result_folder", ("--resume",), "resume", True),
            ("begin_result_folder", ("--overwrite",), "overwrite", True),
            ("check_motion", ("--motion", "there.csv"), "options", RecordOptions(motion=("there.csv",))),
            ("add_motion", ("--duration", 300), "options", RecordOptions(duration=300.0)),
            ("add_motion", ("--separator", ";"), "files", InputOptions(files=("day.csv",), separator=";")),
            (
                "mast_of",
                ("--mast", "there.csv", "--mast-position", -9, 0, 1),
                "options",
                RecordOptions(mast=("there.csv",), mast_position=(-9.0, 0.0, 1.0)),
            ),
            ("noise_and_records", ("--turbulence", "iec-a"), "choice", NoiseOptions(turbulence="iec-a")),
        ],
    )
    def test_how_fit_does_its_work(self, function, words, name, value, handed, scene, tmp_path, monkeypatch):
        monkeypatch.chdir(scene)
        if ";" in words:
            (scene / "day.csv").rename(scene / "kept.csv")
            (scene / "day.csv").write_text((scene / "kept.csv").read_text().replace(",", ";"))
        given = ("--noise", "noise.nc") if function == "fit_into" else ()
        try:
            found = handed(
                f"bayes_rs.fits.from_files:{function}", "fit", "day.csv", *MINE, *given, *words, "-o", tmp_path / "out"
            )
        finally:
            if ";" in words:
                (scene / "kept.csv").replace(scene / "day.csv")
        assert found[name] == value
        if given:
            assert found["noise"].scan_name == "2-beam"


@pytest.fixture(scope="module", params=["6-beam", "50-beam"])
def beams(request):
    scan = brs.load_scan(request.param)
    noise, rng = plain_noise(scan), np.random.default_rng(1)
    variance = draw_variances(np.tile([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], (2, 1)), scan, noise, rng)
    net = brs.noise.calibrate(scan, wind_speed=[8.0, 12.0], yaw_deg=[-20.0, 20.0], tolerance=0.2)
    assert ReducedNoise.suits(net) == (scan.n_beam > 6)
    return records_of(variance, scan), scan, net


class TestFewBeamsAndMany:
    """Many beams are fitted from noise that was reduced beforehand: an option must arrive on that road, too."""

    @pytest.mark.parametrize(
        ("section", "name"),
        [
            (section, name)
            for section, name in EVERY
            if section == "nuisances" and not name.startswith(("length_scale", "yaw_sd_missing"))
        ],
    )
    def test_what_is_uncertain_changes_the_posterior(self, section, name, beams):
        sample, (made, scan, noise) = SAMPLES[section][name], beams
        if name == "probe_length_log_sd":  # points have no length
            scan = brs.load_scan(f"{scan.name}@probe=zx-tm")
            noise = plain_noise(scan)
        needs = {"instrument_noise": 0.05} if name == "instrument_noise_log_sd" else {}
        options = {"noise": noise, "seed": 1, "sampler": "direct", "target_ess": 50, **needs}
        plain = brs.fit(made, scan, **options).summary()
        other = brs.fit(made, scan, nuisances=brs.Nuisances(**{name: sample.value}), **options).summary()
        assert not np.allclose(plain["mean"], other["mean"], rtol=1e-6)
