"""Contraction along the directions of R that a scan can and cannot see."""

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import fit, load_scan
from bayes_rs.fits.direction_table import covariances_of, direction_words
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.stress import STRESSES, rotate_stress
from bayes_rs.priors.ratio import WeakPrior
from bayes_rs.priors.registry import FlatPrior

YAW = 25.0


def result_of(name, prior="weak", yaw_deg=0.0, n_record=2, **overrides):
    scan = load_scan(name, **overrides).with_yaw(np.deg2rad(yaw_deg))
    noise = plain_noise(scan)
    rng = np.random.default_rng(1)
    variance = draw_variances(WeakPrior().draw(n_record, rng), scan, noise, rng)
    records = records_of(variance, scan, yaw_deg=yaw_deg)
    return scan, fit(records, scan, noise=noise, prior=prior, seed=1, sampler="auto", target_ess=200)


@pytest.mark.parametrize("name", ["staring", "4-beam", "6-beam", "50-beam"])
def test_directions_are_an_orthonormal_basis_and_the_unseen_change_no_beam(name):
    scan, result = result_of(name, yaw_deg=YAW)
    table = result.directions()
    assert len(table) == 12
    basis = table[table["record"] == 0][list(STRESSES)].to_numpy()
    np.testing.assert_allclose(basis @ basis.T, np.eye(6), atol=1e-12)
    level = design_matrix(scan.at_yaw(0.0))
    along = np.linalg.norm(level @ basis.T, axis=0)
    seen = table[table["record"] == 0]["seen"].to_numpy()
    assert seen.sum() == np.linalg.matrix_rank(level)
    assert np.all(along[~seen] < 1e-12)
    np.testing.assert_allclose(along[seen] / along[0], table["weight"].to_numpy()[:6][seen], rtol=1e-12)


def test_contraction_is_that_of_the_components_of_turned_draws():
    """The slow way: every draw turned into the lidar's frame, then variances of its components."""
    _, result = result_of("4-beam", yaw_deg=YAW)
    table = result.directions()
    turn = np.array([[np.cos(a := np.deg2rad(-YAW)), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    prior = rotate_stress(result["prior/stress"].values.reshape(-1, 6), turn)
    for record in (0, 1):
        draws = result["posterior/stress"].sel(record=record).transpose(..., "component").values.reshape(-1, 6)
        draws = rotate_stress(draws, turn)
        rows = table[table["record"] == record]
        basis = rows[list(STRESSES)].to_numpy()
        expected = 1.0 - (draws @ basis.T).var(axis=0) / (prior @ basis.T).var(axis=0)
        np.testing.assert_allclose(rows["contraction"], expected, atol=1e-9)
        shapes = [stress / stress[:, :3].sum(axis=1)[:, None] @ np.eye(6) for stress in (draws, prior)]
        expected = 1.0 - (shapes[0] @ basis.T).var(axis=0) / (shapes[1] @ basis.T).var(axis=0)
        np.testing.assert_allclose(rows["contraction_shape"], expected, atol=1e-9)


def test_an_unseen_direction_keeps_the_width_of_the_prior_where_nothing_binds_it():
    """vv and ww of a staring lidar under the flat prior: no beam and no other stress tells anything about them.

    With 200 effective draws a ratio of variances has a standard deviation of a tenth.
    """
    _, result = result_of("staring", prior=FlatPrior(bound=5.0))
    rows = result.directions()
    free = rows[["vv", "ww"]].pow(2).sum(axis=1) > 1.0 - 1e-9
    assert free.sum() == 4
    assert not rows[free]["seen"].any()
    assert (rows[free]["contraction"].abs() < 0.4).all()
    assert rows[rows["seen"]]["contraction"].min() > 0.7


def test_covariances_are_those_of_numpy():
    draws = WeakPrior().draw(20 * 50, 3).reshape(20, 50, 6)  # more records than are looked at together
    found, of_shape = covariances_of(draws)
    for record, one in enumerate(draws):
        shape = one / one[:, :3].sum(axis=1, keepdims=True)
        np.testing.assert_allclose(found[record], np.cov(one, rowvar=False, bias=True), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(of_shape[record], np.cov(shape, rowvar=False, bias=True), rtol=1e-9, atol=1e-12)


def test_words():
    assert direction_words(np.array([0.0, 0.7, 0.7, 0.0, -0.1, 0.0])) == "0.70 vv + 0.70 ww − 0.10 uw"
    assert direction_words(np.array([-1.0, 0, 0, 0, 0, 0])) == "− 1.00 uu"
