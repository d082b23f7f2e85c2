"""Points that fill the cube evenly, and what an interrupt may not do to them."""

import subprocess
import sys

import numpy as np
from scipy.stats import qmc

from bayes_rs.even_points import even_points


def test_they_are_scrambled_sobol_points_inside_the_cube():
    found = even_points(100, 5, np.random.default_rng(3))
    np.testing.assert_array_equal(found, qmc.Sobol(5, rng=np.random.default_rng(3)).random_base2(7)[:100])
    assert np.all((found > 0.0) & (found < 1.0))


def test_an_interrupt_while_the_table_is_read_is_no_set_of_equal_points():
    """scipy swallows it, and would go on without direction numbers."""
    own = """
import numpy as np
from bayes_rs.even_points import even_points
kept = np.load
def broken(*arguments, **options):
    np.load = kept
    raise KeyboardInterrupt
np.load = broken
try:
    even_points(8, 3, np.random.default_rng(1))
except KeyboardInterrupt:
    print("interrupted")
print(even_points(8, 3, np.random.default_rng(1)).tolist())
"""
    done = subprocess.run([sys.executable, "-c", own], capture_output=True, text=True, check=True)  # noqa: S603 - our own
    word, points = done.stdout.splitlines()
    assert word == "interrupted"
    assert points == str(even_points(8, 3, np.random.default_rng(1)).tolist())
