"""Files of our own that were changed: a small sample of the fuzz; docs/testing.md has the counts of the long runs."""

import pytest

from fuzz.frame import run_cases
from fuzz.own_files import cases

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")]


def test_changed_files_of_our_own_end_in_a_line():
    wrong = [f"{one.name}: {one.complaint}" for one in run_cases(cases(seed=16, n=30)) if one.complaint]
    assert not wrong
