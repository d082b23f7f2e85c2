"""A little of the fuzz, of one seed: nothing may crash, hang, trace back, warn, or give a number from damaged content.

It runs in a process of its own: what it does to save time, and where it keeps its files, is nothing for other tests.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.families import FAMILIES

SEED = 16
N = {
    "files of radial velocities": 64,
    "files of our own": 12,
    "files of several ranges": 8,
    "options of commands": 40,
    "calls from Python": 60,
}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_no_complaints(tmp_path, family):
    script = Path(__file__).with_name("long_run.py")
    done = subprocess.run(  # noqa: S603 - our own script
        [sys.executable, str(script), "--family", family, "--seed", str(SEED), "--inputs", str(N[family])],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"| {family} | {SEED} | {N[family]} | 0 |" in done.stdout
