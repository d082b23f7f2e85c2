"""Runs of the command line in processes of their own, which may be killed or meet a full disk."""

import os
import resource
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

from fit_scene import NOISE, make_records

from bayes_rs import demo_file
from bayes_rs.output import write_netcdf

ROOT = Path(__file__).parents[2]
SERIES = str(demo_file("6-beam"))
FIT = ("fit", SERIES, "--scan", "6-beam", "--sampler", "direct", "--ess", "100")
RECORDS = ("records", SERIES, "--scan", "6-beam")
CALIBRATE = ("calibrate", "2-beam", "--wind-speed", "9.7", "--duration", "60")
OF_RECORDS = (
    "--scan",
    "6-beam",
    "--noise",
    "noise.nc",
    "--sampler",
    "direct",
    "--ess",
    "100",
    "--seed",
    "3",
    "--resume",
)
"""Of a fit of what `write_scene` writes."""
WITHOUT_PICTURES = """
from bayes_rs import __main__ as command
from bayes_rs.cli import fit_commands
fit_commands.draw_pictures = lambda *_: None
command.main()
"""
"""The command, which draws nothing when the fit has ended."""


def write_scene(folder):
    """Write the records of the small fit, and their noise."""
    write_netcdf(make_records(20), folder / "records.nc")
    NOISE.save(folder / "noise.nc")


def _full_disk(size):
    """Let every file grow to this size and no further: what a full disk does, for a process that may not mount one."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def start(*arguments, folder, size=None, own=None):
    """Start `bayes-rs` in a folder; no file may grow beyond `size`. `own` is a Python program to run in its place."""
    paths = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        "BAYES_RS_CACHE": str(folder / "cache"),
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLCONFIGDIR": os.environ.get("MPLCONFIGDIR", str(folder / "matplotlib")),
    }
    program = ["-m", "bayes_rs"] if own is None else ["-c", own]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores interrupts
    try:
        return subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, *program, *map(str, arguments)],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=None if size is None else partial(_full_disk, size),  # noqa: PLW1509 - no threads here
        )
    finally:
        signal.signal(signal.SIGINT, before)


def run(*arguments, folder, size=None, own=None):
    """Run it to its end; return the exit code and what it wrote to stderr."""
    process = start(*arguments, folder=folder, size=size, own=own)
    _, errors = process.communicate(timeout=120)
    return process.returncode, errors


def complaint(errors):
    """The lines of the program on stderr; nothing of Python or of a library is among the rest."""
    assert "Traceback" not in errors, errors
    return [line for line in errors.splitlines() if line.startswith("bayes-rs: ")]
