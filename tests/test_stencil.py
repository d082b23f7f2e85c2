"""Interpolation on even grids: exact for polynomials, in single precision, too."""

import numpy as np
import pytest

from bayes_rs.turbulence.stencil import interpolate_rows, stencil, stretched


@pytest.mark.parametrize("n_point", [4, 6])
def test_exact_for_polynomials_of_its_order(n_point):
    position = np.random.default_rng(1).uniform(2.0, 16.0, 40)
    at, weights = stencil(position, 20, n_point)
    assert at.shape == weights.shape == (40, n_point)
    for power in range(n_point):
        np.testing.assert_allclose(np.sum(weights * at**power, axis=1), position**power, rtol=1e-9)


def test_single_precision_is_that_of_its_rounding():
    rng = np.random.default_rng(2)
    values, position = np.cumsum(rng.normal(size=(7, 60)), axis=1), rng.uniform(3.0, 56.0, (7, 30))
    single = interpolate_rows(values.astype(np.float32), position.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, interpolate_rows(values, position), atol=3e-4)  # slopes of 3 times 60 * 6e-8 * 6


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_stretched_is_the_inverse_of_sinh(kind):
    separation = np.array([-3e5, -2.0, -1e-3, 0.0, 1e-3, 1.0, 4e4, 2e8], dtype=kind)
    found = stretched(separation)
    assert found.dtype == kind
    np.testing.assert_allclose(found, np.arcsinh(separation.astype(np.float64)), atol=2e-6)
