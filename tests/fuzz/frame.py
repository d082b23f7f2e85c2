"""One input, tried in a process of its own: what a crash, a hang, a traceback or a warning is, and who saw it.

The process is forked from one that has loaded the package, so that an input costs milliseconds and not the loading.
"""

import io
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

CPU_SECONDS = 30
"""What an input may take of the processor before it counts as a hang; a good one takes a tenth of a second."""
WALL_SECONDS = 600.0
"""After which a process that does not work at all, and waits for something, is given up."""
MOST_BYTES = 6 * 1024**3
"""Memory that a process may ask for; what wants more meets a MemoryError."""
WORDS = (
    "Traceback (most recent call last)",
    "Warning: ",
    "Fatal Python error",
    "Segmentation fault",
    "this is a fault",
)
"""What no output may hold; the last are the words of the last resort."""


@dataclass(frozen=True)
class Case:
    """One input: its name, and what is done with it in a folder of its own.

    `run` returns the exit code of a command, or None; what it raises but does not expect is a fault. `check` is called
    in the same process with the exit code and all that was printed, and returns a complaint, or nothing.
    """

    name: str
    run: Callable[[Path], int | None]
    check: Callable[[int | None, str], str] | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one input; no complaint if it ended as it should."""

    name: str
    code: int | None
    complaint: str
    output: str
    cpu_seconds: float


def command(*arguments: object) -> Callable[[Path], int]:
    """What runs `bayes-rs` with these arguments in the case's folder, and gives its exit code."""

    def run(folder: Path) -> int:
        from bayes_rs.cli import main  # noqa: PLC0415 - loaded once, before the processes are forked

        os.chdir(folder)
        sys.argv = ["bayes-rs", *map(str, arguments)]
        try:
            main()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)
        return 0

    return run


def python(call: Callable[[Path], object]) -> Callable[[Path], None]:
    """What calls Python in the case's folder; our errors and those of the system are answers, all others are faults."""

    def run(folder: Path) -> None:
        from bayes_rs.errors import InputError  # noqa: PLC0415 - as above

        os.chdir(folder)
        try:
            call(folder)
        except (InputError, OSError) as error:
            text = str(error)
            if not text.strip() or "\n" in text or len(text) > 2000:
                raise AssertionError(f"not one line: {text[:300]!r}") from error
            sys.stderr.write(f"{text}\n")

    return run


def try_case(case: Case) -> Outcome:
    """Try one input in a process of its own, with limits on its processor time and its memory."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
        folder, output = Path(place) / "here", Path(place) / "output"
        folder.mkdir()
        child = os.fork()
        if child == 0:
            _in_child(case, folder, output)
        code, used = _wait(child)
        text = output.read_bytes().decode("utf-8", "replace") if output.exists() else ""
    return Outcome(case.name, code, _complaint(code, text), text, used)


def _in_child(case: Case, folder: Path, output: Path) -> None:
    code: int | None = 99
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        written = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for number, own in ((0, nothing), (1, written), (2, written)):
            os.dup2(own, number)
        sys.stdout = io.TextIOWrapper(os.fdopen(1, "wb", closefd=False), encoding="utf-8", write_through=True)
        sys.stderr = io.TextIOWrapper(
            os.fdopen(2, "wb", closefd=False), encoding="utf-8", errors="backslashreplace", write_through=True
        )
        code = case.run(folder)
        sys.stdout.flush()
        sys.stderr.flush()
        if case.check is not None:
            complaint = case.check(code, output.read_bytes().decode("utf-8", "replace"))
            if complaint:
                sys.stderr.write(f"\nCOMPLAINT: {complaint}\n")
        code = code or 0
    except BaseException:  # noqa: BLE001 - whatever it is, the parent is told
        traceback.print_exc()
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code if code is not None else 0)


def _wait(child: int) -> tuple[int, float]:
    end = time.monotonic() + WALL_SECONDS
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() > end:
            with suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            break
        time.sleep(0.003)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)  # what it had started
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime


def _complaint(code: int, text: str) -> str:
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return "hangs"
    if code < 0:
        return f"crashes by {signal.Signals(-code).name}"
    for word in (*WORDS, "COMPLAINT: "):
        if word in text:
            return next(line.strip() for line in text.splitlines() if word in line) + _last(text, word)
    return "ends with the exit code 70" if code == 70 else ""


def _last(text: str, word: str) -> str:
    return f" ... {text.strip().splitlines()[-1][:200]}" if word.startswith("Traceback") else ""
