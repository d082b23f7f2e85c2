"""A little of the fuzz, of one seed: nothing may crash, hang, trace back, warn, or give a number from damaged content.

What families have in common is made once: those that do not change what others find are tried together.

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
    ("files of radial velocities",): 20,
    ("files of our own", "files of several ranges"): 4,
    ("options of commands",): 14,
    ("calls from Python",): 20,
}
"""Inputs of the families that are tried in one process; three times as many in the long run."""


def test_every_family_is_tried():
    assert sorted(family for together in N for family in together) == sorted(FAMILIES)


@pytest.mark.slow
@pytest.mark.parametrize("more", [1, pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.parametrize("families", N, ids=" and ".join)
def test_no_complaints(tmp_path, families, more):
    n_input = more * N[families]
    asked = [word for family in families for word in ("--family", family)]
    script = Path(__file__).with_name("long_run.py")
    done = subprocess.run(  # noqa: S603 - our own script
        [sys.executable, str(script), *asked, "--seed", str(SEED), "--inputs", str(n_input)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for family in families:
        assert f"| {family} | {SEED} | {n_input} | 0 |" in done.stdout
