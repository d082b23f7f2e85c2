"""A little of the fuzz, of one seed: nothing may crash, hang, trace back, warn, or give a number from damaged content."""

import warnings

import pytest

from fuzz.families import FAMILIES
from fuzz.frame import try_case

SEED = 16
N = {"files of radial velocities": 64, "files of our own": 24, "options of commands": 40, "calls from Python": 60}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_no_complaints(family):
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # pytest's own rule stays out of the forked processes: the frame judges
        found = [try_case(case) for case in FAMILIES[family](SEED, N[family])]
    bad = [f"{one.name}: {one.complaint}" for one in found if one.complaint]
    assert not bad, "\n".join(bad)
    assert len(found) == N[family]
