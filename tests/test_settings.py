"""The settings: what a file of them holds, how they change, and what is said of a wrong one."""

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from settings_samples import EVERY, SAMPLES, changed, entry_of, value_of

from bayes_rs.errors import InputError
from bayes_rs.fits.settings import SECTIONS, ScanOptions, Settings, option_places
from bayes_rs.likelihoods.log_normal import LIKELIHOODS, log_normal_likelihood
from bayes_rs.options import options_of
from bayes_rs.posteriors.nuisance import Nuisances


@pytest.fixture(autouse=True)
def _likelihood_of_our_own(monkeypatch):
    monkeypatch.setitem(LIKELIHOODS, "mine", log_normal_likelihood)


def toml(tmp_path, text):
    file = tmp_path / "settings.toml"
    file.write_text(text, encoding="utf-8")
    return file


class TestRoundTrip:
    @pytest.mark.parametrize(("section", "name"), EVERY)
    def test_every_option_comes_back_from_toml_and_json(self, section, name, tmp_path):
        sample = SAMPLES[section][name]
        settings = changed(Settings(), section, sample, name)
        assert value_of(settings, section, name) == sample.value
        assert value_of(settings, section, name) != entry_of(section, name).default
        settings.save(tmp_path / "all.toml")
        assert Settings.load(tmp_path / "all.toml") == settings
        again = json.loads(json.dumps(settings.to_plain()))
        assert Settings.from_plain(again, where="run.json") == settings

    def test_what_is_not_said_has_its_default(self, tmp_path):
        assert Settings.load(toml(tmp_path, "")) == Settings()
        Settings().save(tmp_path / "plain.toml")
        assert Settings.load(tmp_path / "plain.toml") == Settings()

    def test_a_file_is_not_replaced_unless_told(self, tmp_path):
        file = toml(tmp_path, "mine")
        with pytest.raises(InputError, match="exists: give another name"):
            Settings().save(file)
        assert file.read_text() == "mine"
        Settings().save(file, overwrite=True)
        assert Settings.load(file) == Settings()

    def test_words_for_numbers_come_back(self, tmp_path):
        settings = Settings().changed(yaw_sd_deg="records", instrument_noise="records")
        settings.save(tmp_path / "words.toml")
        assert Settings.load(tmp_path / "words.toml") == settings

    def test_ranges_of_single_beams_come_back(self, tmp_path):
        settings = Settings().changed(cnr_range={0: (-23.0, 0.0), 5: (-20.0, 0.0)})
        settings.save(tmp_path / "ranges.toml")
        assert Settings.load(tmp_path / "ranges.toml") == settings

    def test_a_prior_of_python_cannot_be_written(self, tmp_path):
        from bayes_rs.priors.ratio import WeakPrior  # noqa: PLC0415 - beside its use

        with pytest.raises(
            InputError, match=r"Invalid prior WeakPrior\(.*it cannot be written to a file; give its name"
        ):
            Settings().changed(prior=WeakPrior()).save(tmp_path / "prior.toml")
        assert list(tmp_path.iterdir()) == []


class TestPaths:
    TEXT = """
        [scan]
        scan = "ours.toml@tilt_deg=2"
        [files]
        files = ["raw", "more/*.csv", "/data/last.csv"]
        [records]
        motion = ["motion.csv"]
        mast = ["cup.csv", "sonic/*.dat"]
        mast_position = [-200, 0, 10]
        [noise]
        noise = "noise.nc"
        turbulence = "flow.toml"
        [output]
        output = "out"
        """

    def test_relative_ones_are_relative_to_the_file(self, tmp_path):
        found = Settings.load(toml(tmp_path, self.TEXT))
        assert found.scan.scan == f"{tmp_path}/ours.toml@tilt_deg=2"
        assert found.files.files == (f"{tmp_path}/raw", f"{tmp_path}/more/*.csv", "/data/last.csv")
        assert found.records.motion == (f"{tmp_path}/motion.csv",)
        assert found.records.mast == (f"{tmp_path}/cup.csv", f"{tmp_path}/sonic/*.dat")
        assert found.records.mast_position == (-200.0, 0.0, 10.0)
        assert found.noise.noise == f"{tmp_path}/noise.nc"
        assert found.noise.turbulence == f"{tmp_path}/flow.toml"
        assert found.output.output == f"{tmp_path}/out"

    def test_they_are_written_whole(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        settings = Settings().changed(files="day.csv", scan="ours.toml", noise="noise.nc", output="out")
        settings.save(tmp_path / "elsewhere" / "s.toml")
        found = Settings.load(Path("elsewhere", "s.toml"))
        assert found.files.files == (f"{tmp_path}/day.csv",)
        assert (found.scan.scan, found.noise.noise) == (f"{tmp_path}/ours.toml", f"{tmp_path}/noise.nc")
        assert found.output.output == f"{tmp_path}/out"

    def test_names_are_no_paths(self, tmp_path):
        found = Settings.load(toml(tmp_path, '[scan]\nscan = "zx-tm@probe=point"\n[noise]\nturbulence = "iec-a"\n'))
        assert (found.scan.scan, found.noise.turbulence) == ("zx-tm@probe=point", "iec-a")


class TestChanged:
    def test_options_find_their_sections(self):
        settings = Settings().changed(scan="zx-tm", duration=300.0, prior="flat", tilt_sd_deg=1.0, workers=2)
        assert settings.scan.scan == "zx-tm"
        assert settings.records.duration == 300.0
        assert settings.fit.prior == "flat"
        assert settings.fit.nuisances == Nuisances(tilt_sd_deg=1.0)
        assert settings.output.workers == 2

    def test_what_was_there_stays(self):
        settings = Settings().changed(prior="flat", tilt_sd_deg=1.0).changed(yaw_sd_deg=2.0)
        assert settings.fit.prior == "flat"
        assert settings.fit.nuisances == Nuisances(tilt_sd_deg=1.0, yaw_sd_deg=2.0)

    def test_whole_nuisances_and_one_of_them(self):
        settings = Settings().changed(nuisances=Nuisances(tilt_sd_deg=1.0), yaw_sd_deg=2.0)
        assert settings.fit.nuisances == Nuisances(tilt_sd_deg=1.0, yaw_sd_deg=2.0)

    def test_an_unknown_option(self):
        with pytest.raises(InputError, match=r"^Unknown option 'priors' of the settings: did you mean 'prior'\?$"):
            Settings().changed(priors="flat")

    def test_a_wrong_value(self):
        with pytest.raises(InputError, match=r"^Invalid prob 2\.0: it must be between 0 and 1\.$"):
            Settings().changed(prob=2.0)

    def test_every_option_has_a_place(self):
        assert set(option_places()) == {name for _, name in EVERY}


class TestErrors:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("[fits]\n", "Unknown section 'fits' in settings file {file}: did you mean 'fit'?"),
            ("fit = 3\n", "Invalid section 'fit' in settings file {file}: it must be a table of options, as [fit]."),
            (
                "[fit]\npriors = 'flat'\n",
                "Unknown option 'priors' in settings file {file}, section fit: did you mean 'prior'?",
            ),
            (
                "[noise]\nprior = 'flat'\n",
                "Unknown option 'prior' in settings file {file}, section noise: it is one of section fit.",
            ),
            (
                "[fit]\nyaw_sd = 2\n",
                (
                    "Unknown option 'yaw_sd' in settings file {file}, section fit: did you mean 'yaw_sd_deg' of "
                    "section fit.nuisances?"
                ),
            ),
            (
                "[fit.nuisances]\nyaw_sd = 2\n",
                "Unknown option 'yaw_sd' in settings file {file}, section fit.nuisances: did you mean 'yaw_sd_deg'?",
            ),
            (
                "[output]\nqqqq = 2\n",
                (
                    "Unknown option 'qqqq' in settings file {file}, section output: the options are output, overwrite, "
                    "resume, workers, scheduler."
                ),
            ),
            (
                "[fit]\nprob = '0.9'\n",
                "Invalid prob '0.9' in settings file {file}, section fit: it must be a number.",
            ),
            (
                "[fit]\nseed = 1.5\n",
                "Invalid seed 1.5 in settings file {file}, section fit: it must be a whole number.",
            ),
            (
                "[fit]\nseed = true\n",
                "Invalid seed true in settings file {file}, section fit: it must be a whole number.",
            ),
            ("[fit]\nprior = 3\n", "Invalid prior 3 in settings file {file}, section fit: it must be a text."),
            (
                "[output]\noverwrite = 'no'\n",
                "Invalid overwrite 'no' in settings file {file}, section output: it must be true or false.",
            ),
            (
                "[files]\ncolumns = 'RWS'\n",
                "Invalid columns 'RWS' in settings file {file}, section files: it must be a table.",
            ),
            (
                "[quality]\ncnr_range = -23\n",
                "Invalid cnr_range -23 in settings file {file}, section quality: it must be a list or a table.",
            ),
            (
                "[fit]\ninstrument_noise = [1]\n",
                "Invalid instrument_noise [1] in settings file {file}, section fit: it must be a number or a text.",
            ),
            (
                "[fit]\nprob = 2.0\n",
                "In settings file {file}, section fit: Invalid prob 2.0: it must be between 0 and 1.",
            ),
            (
                "[fit.nuisances]\ninflation = -1\n",
                (
                    "In settings file {file}, section fit: Invalid inflation -1 in the nuisances: it must be a finite "
                    "number above zero."
                ),
            ),
            (
                "[output]\nworkers = 2\nscheduler = 'tcp://a:1'\n",
                (
                    "In settings file {file}, section output: Invalid workers 2 with scheduler 'tcp://a:1': its own "
                    "workers do the work; leave one of them out."
                ),
            ),
        ],
    )
    def test_one_line_says_what_where_and_what_to_do(self, text, message, tmp_path):
        file = toml(tmp_path, text)
        with pytest.raises(InputError) as caught:
            Settings.load(file)
        assert str(caught.value) == message.format(file=repr(str(file)))

    def test_no_file(self, tmp_path):
        with pytest.raises(InputError, match=r"No settings file '.*none\.toml': give a TOML file, or the run\.json"):
            Settings.load(tmp_path / "none.toml")

    @pytest.mark.parametrize(
        "value", ["", "text", 3, -1, 1.5, True, [], [1], ["a"], [[1, 2]], {}, {"a": 1}, {"a": [[1, 2]]}]
    )
    def test_no_value_of_a_wrong_kind_does_worse_than_be_refused(self, value):
        places = [({section: {entry.name: value}}) for section, cls in SECTIONS.items() for entry in options_of(cls)]
        places += [{"fit": {"nuisances": {entry.name: value}}} for entry in options_of(Nuisances)]
        for plain in places:
            with suppress(InputError):
                Settings.from_plain(plain, where="file")


class TestRunFile:
    PLAIN = {"scan": "mine", "scan_toml": "text of the scan", "settings": {"fit": {"seed": 3}}}  # noqa: RUF012 - read only

    def load(self, tmp_path, run):
        (tmp_path / "run.json").write_text(json.dumps(run))
        return Settings.load(tmp_path / "run.json")

    def test_a_run_of_python_is_repeated_from_the_records_beside_it(self, tmp_path):
        found = self.load(tmp_path, self.PLAIN)
        assert found.files.files == (f"{tmp_path}/records.nc",)
        assert found.scan == ScanOptions(scan="mine", scan_toml="text of the scan")
        assert found.fit.seed == 3
        assert found.output.output is None

    def test_a_run_of_files_is_repeated_from_them(self, tmp_path):
        run = {**self.PLAIN, "settings": {"files": {"files": ["/data/day.csv"]}, "noise": {"noise": "noise.nc"}}}
        found = self.load(tmp_path, run)
        assert found.files.files == ("/data/day.csv",)
        assert found.noise.noise == f"{tmp_path}/noise.nc"

    def test_a_run_with_a_prior_of_python_is_not(self, tmp_path):
        with pytest.raises(
            InputError, match=r"had a prior that is an object of Python \(ours: wide\), so it cannot be"
        ):
            self.load(tmp_path, {**self.PLAIN, "prior": "ours: wide", "settings": {"fit": {"prior": None}}})

    @pytest.mark.parametrize("run", [[], {"demo": 1}, {"settings": 3}])
    def test_another_file(self, run, tmp_path):
        with pytest.raises(InputError, match=r"run\.json' cannot be used: .*; give the run\.json of a fit\."):
            self.load(tmp_path, run)

    def test_no_json(self, tmp_path):
        (tmp_path / "run.json").write_text("{")
        with pytest.raises(
            InputError, match=r"run\.json' cannot be read as JSON: Expecting .*; give the run\.json of a fit\."
        ):
            Settings.load(tmp_path / "run.json")


class TestScan:
    def test_the_text_counts_where_the_name_means_another_scan(self):
        import bayes_rs as brs  # noqa: PLC0415 - beside its use
        from bayes_rs.geometry.scan_writing import scan_text  # noqa: PLC0415 - as above

        scan = replace(brs.load_scan("6-beam", tilt_deg=1.0), name="50-beam")
        kept = ScanOptions(scan="50-beam", scan_toml=scan_text(scan)).load()
        assert (kept.key, kept.name) == (scan.key, "50-beam")

    def test_no_scan(self):
        with pytest.raises(InputError, match=r"^No scan is given: name one with scan \(--scan\)"):
            ScanOptions().load()
