"""The command line's last resort: whatever ends a command has one line, an exit code, and what is kept."""

import copy
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fault_scenes import OF_RECORDS, start, write_scene

from bayes_rs import InputError, LostResultsError, WorkerError, cli, open_fit
from bayes_rs.cli import scan_commands
from bayes_rs.ledger import fingerprint_of

FAULT = (
    "bayes-rs: this is a fault of bayes_rs, not yours: KeyError: 'yaw'. Please report this line, with the command and, "
    "if you can, its files; BAYES_RS_DEBUG=1 shows where it comes from."
)
TOO_DEEP = "bayes-rs: something that was given is nested too deeply: give a flat one."
NO_MEMORY = (
    "bayes-rs: the memory of this machine is not enough (Unable to allocate 15.0 GiB): ask for less at a time, such as "
    "fewer workers, records or draws."
)


@pytest.fixture
def ended(monkeypatch, capsys):
    """Run `bayes-rs scans`, which ends with this error; return the exit code and the lines of stderr."""

    def run(error):
        def callback(**_):
            raise error

        monkeypatch.setattr(scan_commands.scans, "callback", callback)
        monkeypatch.setattr(sys, "argv", ["bayes-rs", "scans"])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        told = re.sub(r" at cli/group\.py:\d+", "", capsys.readouterr().err)  # it came through what runs the commands
        return caught.value.code, told.splitlines()

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


def gone():
    return LostResultsError("Gone.", damage={})


def with_note(error):
    error.add_note("7 of 9 records are finished and kept in 'out'.")
    return error


class TestOneLine:
    @pytest.mark.parametrize(
        ("error", "code", "line"),
        [
            (KeyError("yaw"), 70, FAULT),
            (MemoryError("Unable to allocate 15.0 GiB"), 2, NO_MEMORY),
            (MemoryError(), 2, NO_MEMORY.replace("Unable to allocate 15.0 GiB", "no more is given")),
            (RecursionError("maximum depth"), 2, TOO_DEEP),
            (BrokenPipeError(32, "Broken pipe"), 141, "bayes-rs: who reads the output has gone (broken pipe)."),
            (InputError("Two\nlines."), 2, "bayes-rs: Two lines."),
            (WorkerError("They die."), 2, "bayes-rs: They die."),
            (gone(), 1, "bayes-rs: Gone."),
            (OSError(28, "No space left on device"), 2,
             "bayes-rs: No space left on device: see to it where the output goes, and run it again."),
            (OSError(28, "No space", "a.nc"), 2, "bayes-rs: [Errno 28] No space: 'a.nc'"),
            (KeyboardInterrupt(), 130, "bayes-rs: interrupted."),
            (AssertionError(), 70, FAULT.replace("KeyError: 'yaw'", "AssertionError: ")),
            (SystemError("in\x1b[31m C"), 70, FAULT.replace("KeyError: 'yaw'", r"SystemError: in\x1b[31m C")),
        ],
    )  # fmt: skip
    @pytest.mark.parametrize("note", [False, True])
    def test_of_every_error(self, ended, error, code, line, note):
        notes = ["bayes-rs: 7 of 9 records are finished and kept in 'out'."] if note else []
        own = copy.copy(error)
        found, lines = ended(with_note(own) if note else own)
        assert [one for one in lines if one] == [line, *notes]
        assert found == code

    def test_it_names_the_place_in_the_package(self, ended):
        with pytest.raises(TypeError) as caught:
            fingerprint_of(None)
        code, (line,) = ended(caught.value)
        assert code == 70
        assert " at ledger.py:" in line

    def test_the_traceback_on_request(self, ended, monkeypatch):
        monkeypatch.setenv("BAYES_RS_DEBUG", "1")
        code, lines = ended(KeyError("yaw"))
        assert code == 70
        assert lines[0] == "Traceback (most recent call last):"
        assert lines[-1] == FAULT
        assert "Traceback" not in "".join(ended(SystemExit(3))[1])


class TestEnds:
    @pytest.mark.parametrize(
        ("number", "word"),
        [(signal.SIGTERM, "ended by SIGTERM."), (signal.SIGHUP, "ended by SIGHUP."), (signal.SIGINT, "interrupted.")],
    )
    def test_by_a_signal(self, tmp_path, number, word):
        """What is finished is kept, and named."""
        write_scene(tmp_path)
        process = start("fit", "records.nc", *OF_RECORDS, "-o", "out", folder=tmp_path)
        while process.poll() is None and not (tmp_path / "out" / "records.nc").exists():
            time.sleep(0.01)
        process.send_signal(number)
        _, errors = process.communicate(timeout=120)
        lines = [line for line in errors.splitlines() if line.startswith("bayes-rs: ")]
        assert "Traceback" not in errors
        if process.returncode != 0:  # it may have come to its end before
            assert process.returncode == 128 + number
            assert lines[0] == f"bayes-rs: {word}"
            assert "kept in" in lines[1]

    @pytest.mark.parametrize(
        ("number", "word"), [(signal.SIGTERM, "ended by SIGTERM."), (signal.SIGINT, "interrupted.")]
    )
    @pytest.mark.parametrize("place", ["bayes_rs.fits.parts.fit_batch", "bayes_rs.fits.fit_writing.write_netcdf"])
    @pytest.mark.parametrize("end", ["swallowed", "replaced"])
    def test_that_a_library_does_not_pass_on(self, tmp_path, number, word, place, end):
        """It is heard all the same, and nothing that was made after it is kept."""
        module, name = place.rsplit(".", 1)
        own = (
            "import importlib, os, sys\n"
            "from bayes_rs.cli import main\n"
            f"module = importlib.import_module({module!r})\n"
            f"kept = module.{name}\n"
            "class Gone:\n"
            "    def __del__(self):\n"
            f"        os.kill(os.getpid(), {int(number)})\n"
            "class Named:\n"
            "    def __set_name__(self, owner, name):\n"
            f"        os.kill(os.getpid(), {int(number)})\n"
            "def broken(*arguments, **options):\n"
            f"    if {end!r} == 'swallowed':\n"
            "        Gone()\n"
            f"    if {end!r} == 'replaced':\n"
            "        type('Holder', (), {'one': Named()})\n"
            "    return kept(*arguments, **options)\n"
            f"module.{name} = broken\n"
            f"sys.argv = ['bayes-rs', 'fit', 'records.nc', *{OF_RECORDS!r}, '-o', 'out']\n"
            "main()\n"
        )
        write_scene(tmp_path)
        process = start(folder=tmp_path, own=own)
        _, errors = process.communicate(timeout=120)
        lines = [line for line in errors.splitlines() if line]
        assert process.returncode == 128 + number
        assert lines[0] == f"bayes-rs: {word}"
        assert lines[1].startswith("bayes-rs: 0 of 20 records are finished and kept in ")
        written = {file.name for file in (tmp_path / "out").rglob("*") if file.is_file()}
        assert not any(name.endswith(".parquet") for name in written if name.startswith("part"))
        assert ("records.nc" in written) == (name == "fit_batch")

    def test_while_the_pictures_are_drawn(self, tmp_path):
        own = (
            "import os, sys\n"
            "from bayes_rs.cli import fit_commands, main\n"
            "fit_commands._figures = lambda _: os.kill(os.getpid(), 2)\n"
            f"sys.argv = ['bayes-rs', 'fit', 'records.nc', *{OF_RECORDS!r}, '-o', 'out']\n"
            "main()\n"
        )
        write_scene(tmp_path)
        process = start(folder=tmp_path, own=own)
        assert process.communicate(timeout=120)[1].splitlines()[-2:] == [
            "bayes-rs: interrupted.",
            "bayes-rs: The fit is finished and kept in 'out'; of its pictures some are missing.",
        ]
        assert process.returncode == 130
        assert open_fit(tmp_path / "out").n_record == 20

    @pytest.mark.parametrize("debug", ["", "1"])
    def test_while_scipy_reads_its_table(self, tmp_path, debug, monkeypatch):
        """Compiled code prints what it swallows by itself."""
        monkeypatch.setenv("BAYES_RS_DEBUG", debug)
        own = (
            "import os, sys\n"
            "import numpy as np\n"
            "from bayes_rs.cli import main\n"
            "kept = np.load\n"
            "def broken(*arguments, **options):\n"
            "    np.load = kept\n"
            "    os.kill(os.getpid(), 2)\n"
            "np.load = broken\n"
            f"sys.argv = ['bayes-rs', 'fit', 'records.nc', *{OF_RECORDS!r}, '-o', 'out']\n"
            "main()\n"
        )
        write_scene(tmp_path)
        process = start(folder=tmp_path, own=own)
        errors = process.communicate(timeout=120)[1]
        assert process.returncode == 130
        lines = [line for line in errors.splitlines() if line]
        assert lines[-2] == "bayes-rs: interrupted."
        assert (len(lines) == 2) == (debug == "")

    def test_that_comes_when_all_is_shown(self, tmp_path):
        own = (
            "import os, sys\n"
            "from bayes_rs.cli import main, scan_commands\n"
            "class Gone:\n"
            "    def __del__(self):\n"
            "        os.kill(os.getpid(), 2)\n"
            "scan_commands.scans.callback = lambda **_: Gone() and None\n"
            "sys.argv = ['bayes-rs', 'scans']\n"
            "main()\n"
        )
        process = start(folder=tmp_path, own=own)
        assert process.communicate()[1].split() == ["bayes-rs:", "interrupted."]
        assert process.returncode == 130

    def test_who_may_not_be_hung_up_goes_on(self, tmp_path):
        """`nohup` has the signal ignored."""
        own = (
            "import os, signal, sys\n"
            "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
            "from bayes_rs.cli import main, scan_commands\n"
            "scan_commands.scans.callback = lambda **_: os.kill(os.getpid(), signal.SIGHUP)\n"
            "sys.argv = ['bayes-rs', 'scans']\n"
            "main()\n"
        )
        process = start(folder=tmp_path, own=own)
        assert process.communicate()[1] == ""
        assert process.returncode == 0

    @pytest.mark.parametrize("module", ["click", "bayes_rs.cli.group", "numpy", "bayes_rs.cli.scan_commands"])
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_in_the_first_moments(self, tmp_path, module, number):
        own = (
            "import os, sys\n"
            "from bayes_rs.cli import main\n"
            "class Finder:\n"
            "    done = False\n"
            "    def find_spec(self, name, path=None, target=None):\n"
            f"        if name == {module!r} and not self.done:\n"
            "            self.done = True\n"
            f"            os.kill(os.getpid(), {int(number)})\n"
            "sys.meta_path.insert(0, Finder())\n"
            "sys.argv = ['bayes-rs', 'scans']\n"
            "main()\n"
        )
        process = start(folder=tmp_path, own=own)
        out, errors = process.communicate()
        assert out == ""
        word = "interrupted." if number == signal.SIGINT else "ended by SIGTERM."
        assert [line for line in errors.splitlines() if line] == [f"bayes-rs: {word}"]
        assert process.returncode == 128 + number


class TestTheOutput:
    def test_a_broken_pipe(self, tmp_path):
        process = start("scans", folder=tmp_path)
        process.stdout.close()
        with process.stderr:
            errors = process.stderr.read()
        assert process.wait() == 141
        assert errors == "bayes-rs: who reads the output has gone (broken pipe).\n"

    def test_nobody_reads_anything(self, tmp_path):
        process = start("scans", folder=tmp_path)
        process.stdout.close()
        process.stderr.close()
        assert process.wait() == 141

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
    def test_a_full_disk(self):
        with open("/dev/full", "w") as full:  # noqa: PTH123 - a device
            done = subprocess.run(
                [sys.executable, "-m", "bayes_rs", "scans"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
            )
        assert done.returncode == 2
        assert done.stderr == "bayes-rs: No space left on device: see to it where the output goes, and run it again.\n"

    @pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
    def test_a_stream_that_is_closed(self, closed):
        words = f'"{sys.executable}" -m bayes_rs scans {closed}'
        done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, check=False, env={**os.environ})  # noqa: S603, S607 - our own
        assert done.returncode == 0
        assert done.stderr == ""
