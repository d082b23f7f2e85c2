"""A little of the fuzz of options and of Python's calls, of one seed: nothing may crash, hang, trace back or warn."""

import warnings

import pytest

from fuzz import options, python_calls
from fuzz.frame import try_case

SEED = 16
N_COMMAND, N_CALL = 40, 60


@pytest.mark.parametrize(("family", "n"), [(options, N_COMMAND), (python_calls, N_CALL)], ids=["options", "python"])
def test_no_complaints(family, n):
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # pytest's own rule stays out of the forked processes: the frame judges
        found = [try_case(case) for case in family.cases(SEED, n)]
    bad = [f"{one.name}: {one.complaint}" for one in found if one.complaint]
    assert not bad, "\n".join(bad)
    assert len(found) == n
