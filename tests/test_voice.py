"""How much a command says, and where: the options of all commands, the standard input, completion, progress."""

import io
import json
import sys

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs import progress
from bayes_rs.cli import voice
from bayes_rs.cli.group import COMMANDS, commands
from bayes_rs.readers.netcdf_file import load_netcdf
from bayes_rs.readers.standard_input import with_standard_input

LINES = "time,beam,radial_velocity\n2020-09-03T19:00:00,0,-10.0\n2020-09-03T19:00:01,1,-9.5\n"


def run(*words, **more):
    return CliRunner().invoke(commands, [str(word) for word in words], **more)


class TestOptions:
    @pytest.mark.parametrize("name", COMMANDS)
    def test_every_command_has_them(self, name):
        command = commands.get_command(click.Context(commands), name)
        flags = {flag for parameter in command.params for flag in parameter.opts}
        assert {"-v", "--verbose", "-q", "--quiet", "--json", "--color"} <= flags

    @pytest.mark.parametrize("words", [("--quiet", "scans"), ("scans", "-q")])
    def test_quiet_says_nothing_wherever_it_stands(self, words):
        done = run(*words)
        assert (done.exit_code, done.output) == (0, "")

    @pytest.mark.parametrize("words", [("--json", "scans"), ("scans", "--json")])
    def test_json_is_all_of_stdout(self, words):
        found = json.loads(run(*words).stdout)
        staring = next(scan for scan in found["scans"] if scan["name"] == "staring")
        assert staring == {
            "name": "staring",
            "n_beam": 1,
            "rank": 1,
            "condition": 1.0,
            "sees": "sees uu; does not see vv, ww, uv, uw, vw",
        }

    @pytest.mark.parametrize("words", [("scans", "6-beam"), ("plan", "6-beam")])
    def test_other_commands_answer_in_json(self, words):
        assert json.loads(run(*words, "--json").stdout)

    @pytest.mark.parametrize("other", ["--verbose", "--json"])
    def test_opposites_are_refused(self, other):
        done = run("scans", "--quiet", other)
        assert done.exit_code == 2
        assert f"--quiet and {other} ask for opposite things." in done.stderr

    def test_quiet_shows_no_bar_and_ends_with_the_command(self, monkeypatch):
        @click.command()
        def counted():
            with progress.progress_counter(1, "fitting", " records") as counter:
                shown.append(counter.shown)

        class Terminal(io.StringIO):
            def isatty(self):
                return True

        shown = []
        monkeypatch.setattr(type(commands), "get_command", lambda *_: voice.voice_options(counted))
        monkeypatch.setattr(sys, "stderr", Terminal())
        for words in (["scans"], ["-q", "scans"], ["scans", "-q"], ["scans"]):
            commands.main(words, standalone_mode=False)
        assert shown == [True, False, False, True]

    def test_errors_are_said_when_quiet(self):
        done = run("-q", "scans", "no-such-scan")
        assert "No preset 'no-such-scan'" in str(done.exception)


class TestColour:
    @pytest.mark.parametrize(
        ("words", "environment", "coloured"),
        [
            ([], {}, False),  # no terminal
            (["--color"], {}, True),
            ([], {"FORCE_COLOR": "1"}, True),
            (["--no-color"], {"FORCE_COLOR": "1"}, False),
            (["--color"], {"NO_COLOR": "1"}, True),  # who asks for it gets it
            ([], {"NO_COLOR": "1", "FORCE_COLOR": "1"}, False),
        ],
    )
    def test_is_where_it_is_wanted(self, monkeypatch, words, environment, coloured):
        @click.command()
        def told():
            voice.tell_rows([("found", "TI 0.1"), ("doubtful", "all")], doubtful="doubtful")

        monkeypatch.setattr(type(commands), "get_command", lambda *_: voice.voice_options(told))
        for name in ("NO_COLOR", "FORCE_COLOR"):
            monkeypatch.delenv(name, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        # click's runner strips colours itself unless it is told not to; None leaves it to the stream
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stdout", stream)
        commands.main([*words, "scans"], standalone_mode=False)
        assert ("\x1b[" in stream.getvalue()) == coloured
        assert click.unstyle(stream.getvalue()) == "found:    TI 0.1\ndoubtful: all\n"


class TestWidth:
    def test_lines_are_wrapped_on_a_terminal_alone(self, monkeypatch):
        class Terminal(io.StringIO):
            def isatty(self):
                return True

        words = "doubtful: " + "12 records have a front; " * 8
        monkeypatch.setenv("COLUMNS", "60")
        lines = voice._wrapped(words, Terminal(), indent=10).splitlines()
        assert max(map(len, lines)) <= 60
        assert all(line.startswith(" " * 10) for line in lines[1:])
        assert " ".join(" ".join(lines).split()) == words.strip()
        assert voice._wrapped(words, io.StringIO()) == words


class TestStandardInput:
    def test_a_table_is_looked_at(self):
        done = run("look", "-", input=LINES)
        assert done.exit_code == 0, done.output
        assert "2 beams, samples of each: 0: 1, 1: 1" in done.output
        assert done.output.splitlines()[-1].startswith("next: bayes-rs fit - --scan 2-beam")

    def test_records_are_those_of_the_file(self, tmp_path):
        series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=1, seed=1)
        table = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
        text = table.to_csv(index=False, date_format="%Y-%m-%dT%H:%M:%S.%f")
        (tmp_path / "day.csv").write_text(text)
        made = []
        for name, more in (("day.csv", {}), ("-", {"input": text})):
            file = tmp_path / f"{len(made)}.nc"
            done = run("records", tmp_path / name if name != "-" else name, "--scan", "2-beam", "-o", file, **more)
            assert done.exit_code == 0, done.output
            made.append(load_netcdf(file))
        one, other = made
        assert one["variance"].equals(other["variance"])

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"", "is empty: pipe a table of text into it"),
            (b"\x89HDF\r\n\x1a\n rest", "is NetCDF-4 or HDF5, and only a table of text"),
            (b"PAR1....", "is Parquet"),
            (b"\x1f\x8b\x08....", "is compressed (gzip)"),
            (b"some\0thing", "is a binary format"),
        ],
    )
    def test_what_is_no_text_is_refused_in_a_line(self, content, words):
        done = run("look", "-", input=content)
        assert isinstance(done.exception, brs.InputError)
        assert words in str(done.exception)

    def test_it_is_read_once(self):
        with pytest.raises(brs.InputError, match="given twice"), with_standard_input(["-", "-"]):
            pass

    def test_an_error_names_it(self):
        done = run("records", "-", "--scan", "2-beam", "-o", "never.nc", input="time,beam,radial_velocity\nx,0,1\n")
        assert isinstance(done.exception, brs.InputError)
        assert "'-' (the standard input)" in str(done.exception)
        assert "standard-input.csv" not in str(done.exception)


class TestCompletion:
    def complete(self, words, incomplete):
        shell = ShellComplete(commands, {}, "bayes-rs", "_BAYES_RS_COMPLETE")
        return [item.value for item in shell.get_completions([str(word) for word in words], incomplete)]

    def test_commands_have_their_whole_words(self):
        shell = ShellComplete(commands, {}, "bayes-rs", "_BAYES_RS_COMPLETE")
        found = {item.value: item.help for item in shell.get_completions([], "")}
        assert found == {name: words for name, (_, words) in COMMANDS.items()}
        assert not any(words.endswith("...") for words in found.values())

    @pytest.mark.parametrize(
        ("words", "incomplete", "wanted"),
        [
            ([], "sc", ["scans"]),
            (["scans"], "zx", ["zx-300", "zx-tm"]),
            (["plan"], "6-b", ["6-beam", "6-beam-planes"]),
            (["compare", "6-beam"], "50", ["50-beam", "50-beam-planes"]),
            (["scans"], "zx-tm@pr", ["zx-tm@probe="]),
            (["scans"], "zx-tm@probe=point,foc", ["zx-tm@probe=point,focus_distance="]),
            (["fit", "--scan"], "stari", ["staring", "staring-planes"]),
            (["fit", "--column"], "rad", ["radial_velocity="]),
            ([], "--verb", ["--verbose"]),
        ],
    )
    def test_values(self, words, incomplete, wanted):
        assert self.complete(words, incomplete) == wanted

    def test_headings_of_the_file(self, tmp_path):
        file = tmp_path / "day.csv"
        file.write_text("Timestamp;RWS;RWSStatus\n1;2;3\n", encoding="utf-8-sig")
        words = ["fit", file, "--column"]
        assert self.complete(words, "radial_velocity=R") == ["radial_velocity=RWS", "radial_velocity=RWSStatus"]
        assert self.complete(words, "time=") == ["time=Timestamp", "time=RWS", "time=RWSStatus"]
        (tmp_path / "day.nc").write_bytes(b"CDF\x01")
        assert self.complete(["fit", tmp_path / "day.nc", "--column"], "time=") == []


class TestProgress:
    def test_what_is_noted_counts_before_its_part_is_finished(self):
        with progress.progress_counter(10, "fitting", " records", initial=2, disable=False) as counter:
            seen = []
            for step in (lambda: progress.note_done(3), lambda: progress.note_done(1), lambda: counter.update(4)):
                step()
                seen.append(counter._bar.n)
            progress.note_done(4)
            progress.note_done(4)  # a part that is done twice, since its worker died
            seen.append(counter._bar.n)
        assert seen == [5, 6, 6, 10]

    def test_workers_are_heard(self):
        with (
            progress.progress_counter(5, "fitting", " records", disable=False) as counter,
            progress.worker_tally() as tally,
        ):
            token = progress._counting.set(None)  # as in a process of its own
            try:
                progress.tally_in(tally.file)
                progress.note_done(2)
                progress.note_done(1)
            finally:
                progress.tally_in(None)
                progress._counting.reset(token)
            assert counter._bar.n == 0
            tally.look()
            assert counter._bar.n == 3

    def test_nobody_is_asked_where_no_bar_is_shown(self):
        with progress.progress_counter(5, "fitting", " records", disable=True), progress.worker_tally() as tally:
            assert (tally.file, tally.seconds) == (None, None)
        progress.note_done(1)  # and nothing counts
