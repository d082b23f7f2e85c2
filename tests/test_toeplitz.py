"""Toeplitz matrices without their mean or line: dense matrices, and records with known answers."""

import numpy as np
import pytest

from bayes_rs.errors import InputError
from bayes_rs.turbulence.toeplitz import gapped_inner, gapped_trace, toeplitz_inner, toeplitz_trace


def dense(diagonals, n_row, n_column):
    return diagonals[np.arange(n_column)[None, :] - np.arange(n_row)[:, None] + n_row - 1]


def projection(n, detrend):
    columns = np.stack([np.ones(n), np.arange(n)], axis=-1)[:, : 1 if detrend == "mean" else 2]
    basis = np.linalg.qr(columns)[0]
    return np.eye(n) - basis @ basis.T


def gapped_projection(present, detrend):
    place = np.flatnonzero(present)
    columns = np.stack([np.ones(len(place)), place], axis=-1)[:, : 1 if detrend == "mean" else 2]
    basis = np.linalg.qr(columns)[0]
    return np.eye(len(place)) - basis @ basis.T


class TestToeplitz:
    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    @pytest.mark.parametrize(("n_row", "n_column"), [(7, 7), (5, 9), (40, 39), (3, 4), (1, 4), (1, 1)])
    def test_equals_dense_matrices(self, n_row, n_column, detrend):
        first, second = np.random.default_rng(0).normal(size=(2, 3, n_row + n_column - 1))
        left, right = projection(n_row, detrend), projection(n_column, detrend)
        exact = [
            np.sum((left @ dense(a, n_row, n_column) @ right) * (left @ dense(b, n_row, n_column) @ right))
            for a, b in zip(first, second, strict=True)
        ]
        np.testing.assert_allclose(toeplitz_inner(first, second, n_row, n_column, detrend=detrend), exact, atol=1e-10)

    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    def test_trace_equals_dense_matrices(self, detrend):
        diagonals = np.random.default_rng(1).normal(size=39)
        left = projection(20, detrend)
        exact = np.trace(left @ dense(diagonals, 20, 20) @ left)
        np.testing.assert_allclose(toeplitz_trace(diagonals, 20, detrend=detrend), exact, atol=1e-12)

    def test_ornstein_uhlenbeck_record(self):
        """Time scale 20 s, record 600 s: 0.239 of the process variance, where the long-record formula says 0.258."""
        n = 6000
        tau = 0.1 * np.abs(np.arange(-(n - 1), n))
        covariance = np.exp(-tau / 20.0)
        mean = toeplitz_trace(covariance, n) / n
        error = np.sqrt(2.0 * toeplitz_inner(covariance, covariance, n, n)) / n
        np.testing.assert_allclose(error, 0.239, atol=5e-4)
        np.testing.assert_allclose(mean, 1.0 - 2.0 / 30.0 + 2.0 / 900.0, atol=1e-4)  # 1 - var(mean), in closed form
        np.testing.assert_allclose(np.sqrt(2.0 * 20.0 / 600.0), 0.258, atol=5e-4)

    def test_isserlis_by_simulation(self):
        rng = np.random.default_rng(2)
        lags = np.array([0.1, 0.3, 0.5, 0.4, 0.2])
        own = np.array([0.1, 0.4, 1.0, 0.4, 0.1])
        joint = np.block([[dense(own, 3, 3), dense(lags, 3, 3)], [dense(lags, 3, 3).T, dense(own, 3, 3)]])
        draws = rng.multivariate_normal(np.zeros(6), joint, 400_000)
        found = np.cov(draws[:, :3].var(axis=1), draws[:, 3:].var(axis=1))
        exact = [2.0 / 9.0 * toeplitz_inner(c, c, 3, 3) for c in (own, lags)]
        np.testing.assert_allclose([found[0, 0], found[0, 1]], exact, rtol=0.02)  # four standard errors

    def test_refuses_the_wrong_number_of_diagonals(self):
        with pytest.raises(InputError, match=r"a matrix of 3 rows and 3 columns has 5 of them"):
            toeplitz_inner(np.ones(4), np.ones(4), 3, 3)


class TestGaps:
    """Rows and columns that are not there: the dense matrix of those that are."""

    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    @pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
    def test_equals_dense_matrices(self, shape, detrend):
        rng = np.random.default_rng(3)
        diagonals = rng.normal(size=(*shape, 9 + 13 - 1))
        rows, columns = rng.random((*shape, 9)) < 0.7, rng.random((*shape, 13)) < 0.7
        found = gapped_inner(diagonals, rows, columns, detrend=detrend)
        assert found.shape == shape
        for index in np.ndindex(shape):
            there = dense(diagonals[index], 9, 13)[np.ix_(rows[index], columns[index])]
            left, right = (gapped_projection(present[index], detrend) for present in (rows, columns))
            np.testing.assert_allclose(found[index], np.sum((left @ there @ right) ** 2), atol=1e-10)

    @pytest.mark.parametrize("detrend", ["mean", "linear"])
    @pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
    def test_trace_equals_dense_matrices(self, shape, detrend):
        rng = np.random.default_rng(4)
        diagonals, present = rng.normal(size=(*shape, 21)), rng.random((*shape, 11)) < 0.7
        found = gapped_trace(diagonals, present, detrend=detrend)
        assert found.shape == shape
        for index in np.ndindex(shape):
            left = gapped_projection(present[index], detrend)
            there = dense(diagonals[index], 11, 11)[np.ix_(present[index], present[index])]
            np.testing.assert_allclose(found[index], np.trace(left @ there @ left), atol=1e-10)

    def test_refuses_the_wrong_number_of_diagonals(self):
        with pytest.raises(InputError, match=r"Invalid diagonals of shape \(4,\): a matrix with row_present of shape"):
            gapped_inner(np.ones(4), np.ones(3, dtype=bool), np.ones(3, dtype=bool))
