"""Homogeneous or sheared: evidence and left-out beams against quadrature, laws, and what it says of known records."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scenes import draw_variances, plain_noise, records_of
from scipy import stats

from bayes_rs import InputError, Nuisances, compare_inflow, load_scan
from bayes_rs.fits.inflow_comparison import inflow_in_words
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.priors.interface import NormalPrior
from bayes_rs.priors.ratio import WeakPrior

SHAPE = np.array([1.0, 0.5, 0.27, 0.05, -0.15, 0.02])
BOTH = Nuisances(vertical_gradient_sd=0.5, lateral_gradient_sd=0.5)


@dataclass(frozen=True)
class SizePrior(NormalPrior):
    """Only the size of the tensor is not known, ln uu ~ N(0, 1): two dimensions with a gradient."""

    name: str = "size"

    @property
    def n_coordinate(self):
        return 1

    def stress(self, coordinate):
        return np.exp(coordinate[..., :1]) * SHAPE

    def in_words(self):
        return "size"


def quadrature(scan, noise, variance, width, used, dof):
    """ln p(ln y of the used beams) by the trapezoidal rule over ln uu and the gradient; without one for width 0."""
    covariance = np.log(1.0 + noise.covariance[0])
    height = scan.focus_distance * scan.level_direction[:, 2]
    height = (height - height.mean()) / 100.0
    if np.isinf(dof):
        noise_of = stats.multivariate_normal(np.zeros(len(used)), covariance[np.ix_(used, used)])
    else:
        noise_of = stats.multivariate_t(np.zeros(len(used)), covariance[np.ix_(used, used)], df=dof)
    size, step = np.linspace(-8.0, 8.0, 801, retstep=True)
    total = -np.inf
    slopes, share = (np.linspace(-8.0, 8.0, 321), 0.05) if width else (np.zeros(1), 1.0 / stats.norm.pdf(0.0))
    for slope in slopes:
        log_mean = np.log(design_matrix(scan) @ SHAPE) + size[:, None] + width * slope * height
        residual = np.log(variance) - log_mean + 0.5 * np.diag(covariance)
        density = noise_of.logpdf(residual[:, used]) + stats.norm.logpdf(size) + stats.norm.logpdf(slope)
        total = np.logaddexp(total, np.logaddexp.reduce(density) + np.log(step * share))
    return total


@pytest.mark.parametrize("dof", [np.inf, 8.0])
def test_evidence_and_left_out_beams_against_quadrature(dof):
    """With no more beams than stresses nothing is reduced, and ln p(y_b | others) = ln p(y) − ln p(others)."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = plain_noise(scan, relative_variance=0.4)  # so large that half a variance of ln y counts
    variance = draw_variances(1.3 * SHAPE[None], scan, noise, np.random.default_rng(1))
    variance *= np.exp(1.5 * scan.focus_distance * scan.level_direction[:, 2] / 100.0)
    nuisances = Nuisances(vertical_gradient_sd=0.7, inflation_dof=dof)
    table = compare_inflow(
        records_of(variance, scan), scan, noise=noise, nuisances=nuisances, prior=SizePrior(), seed=1, n_draw=20_000
    )
    every = np.arange(scan.n_beam)
    whole = [quadrature(scan, noise, variance[0], width, every, dof) for width in (0.0, 0.7)]
    elpd = [
        sum(total - quadrature(scan, noise, variance[0], width, np.delete(every, beam), dof) for beam in every)
        for width, total in zip((0.0, 0.7), whole, strict=True)
    ]
    assert abs(whole[1] - whole[0]) > 0.5  # a record that says something
    for name, expected in (("log_bayes_factor", whole[1] - whole[0]), ("elpd_difference", elpd[1] - elpd[0])):
        error = table[f"{name}_error"][0]
        assert 0.0 < error < 0.05
        assert abs(table[name][0] - expected) < 5.0 * error
    assert table["pareto_k"][0] < 0.7


def test_left_out_beams_of_many_are_predicted_from_the_reduced_data():
    """One beam of 50 given what the fit uses of the others: its density by plain Monte Carlo over prior draws."""
    scan = load_scan("50-beam")
    noise = plain_noise(scan, reach=20.0)
    variance = draw_variances(1.3 * SHAPE[None], scan, noise, np.random.default_rng(1))
    nuisances = Nuisances(vertical_gradient_sd=0.7)
    table = compare_inflow(
        records_of(variance, scan), scan, noise=noise, nuisances=nuisances, prior=SizePrior(), seed=1, n_draw=4000
    )
    covariance = np.log(1.0 + noise.covariance[0])
    point = scan.focus_distance[:, None] * scan.level_direction
    height = (point[:, 2] - point[:, 2].mean()) / 100.0
    neutral = np.array([1.0, 0.5, 0.27, 0.0, -0.15, 0.0])
    columns = np.column_stack([design_matrix(scan) / (design_matrix(scan) @ neutral)[:, None], height])
    normal = np.random.default_rng(2).standard_normal((40_000, 2))
    total = 0.0
    for beam in range(scan.n_beam):
        others = np.delete(np.arange(scan.n_beam), beam)
        left, singular, _ = np.linalg.svd(columns[others], full_matrices=False)
        basis = left[:, singular > 1e-9 * singular[0]]
        together = np.zeros((scan.n_beam, basis.shape[1] + 1))
        together[others, :-1], together[beam, -1] = basis, 1.0
        joint = stats.multivariate_normal(np.zeros(together.shape[1]), together.T @ covariance @ together)
        alone = stats.multivariate_normal(
            np.zeros(basis.shape[1]), basis.T @ covariance[np.ix_(others, others)] @ basis
        )
        for width, sign in ((0.7, 1.0), (0.0, -1.0)):
            # the posterior of ln uu and the gradient is narrow: prior draws are squeezed about it, and weighed
            draws = np.array([0.26, 0.0]) + normal * [0.6, 1.0]
            weight = stats.norm.logpdf(draws).sum(axis=1) - stats.norm.logpdf(normal).sum(axis=1)
            log_mean = np.log(design_matrix(scan) @ SHAPE) + draws[:, :1] + width * draws[:, 1:] * height
            residual = (np.log(variance[0]) - log_mean + 0.5 * np.diag(covariance)) @ together
            total += sign * np.logaddexp.reduce(weight + joint.logpdf(residual))
            total -= sign * np.logaddexp.reduce(weight + alone.logpdf(residual[:, :-1]))
    # 40 000 prior draws know each density to about 1/100 here, with common draws for all beams; and our own error
    assert abs(table["elpd_difference"][0] - total) < 5.0 * table["elpd_difference_error"][0] + 0.05


def scene(name, vertical, n_record=12, seed=1, **overrides):
    scan = load_scan(name, **overrides)
    noise, rng = plain_noise(scan), np.random.default_rng(seed)
    variance = draw_variances(np.tile(SHAPE, (n_record, 1)), scan, noise, rng)
    height = scan.focus_distance * scan.level_direction[:, 2]
    return records_of(variance * np.exp(vertical * height / 100.0), scan), scan, noise


def test_several_planes_tell_steep_gradients_from_none():
    """Positive for what is there, either way; the priors' cost for a gradient that is not there is small."""
    nuisances = Nuisances(vertical_gradient_sd=1.0)
    options = {"nuisances": nuisances, "seed": 1, "leave_one_out": False, "n_draw": 1000}
    for gradient, least, most in ((1.5, 1.0, np.inf), (0.0, -np.inf, -1.0)):
        records, scan, noise = scene("51-beam-planes", gradient)
        table = compare_inflow(records, scan, noise=noise, **options)
        total = table["log_bayes_factor"].sum()
        assert least < total < most
        assert (total > 0.0) == ("for gradients" in inflow_in_words(table))
        bias = table["vertical_gradient"].mean() - gradient
        assert abs(bias) < 5.0 * table["vertical_gradient_sd"].mean() / np.sqrt(len(table)) + 0.3  # the prior pulls


def test_gradients_cost_certainty_about_what_they_look_like():
    records, scan, noise = scene("6-beam", 0.0, opening_angle_deg=45.0)
    vertical = compare_inflow(
        records, scan, noise=noise, nuisances=Nuisances(vertical_gradient_sd=0.5), seed=1, leave_one_out=False
    )
    assert vertical["wider_uw"].min() > 1.05
    assert vertical["wider_uv"].mean() == pytest.approx(1.0, abs=0.05)
    lateral = compare_inflow(
        records, scan, noise=noise, nuisances=Nuisances(lateral_gradient_sd=0.5), seed=1, leave_one_out=False
    )
    assert lateral["wider_uv"].min() > 1.05
    assert lateral["wider_uw"].mean() == pytest.approx(1.0, abs=0.05)


def test_a_scan_without_extent_has_nothing_to_say():
    scan = load_scan("staring")
    noise = plain_noise(scan)
    table = compare_inflow(records_of(np.array([[1.0], [2.0]]), scan), scan, noise=noise, nuisances=BOTH, seed=1)
    assert np.all(np.abs(table["log_bayes_factor"]) < 5.0 * table["log_bayes_factor_error"])
    assert table["elpd_difference"].isna().all()  # no other beam to predict it from
    assert table["verdict"].tolist() == ["cannot tell"] * 2


def test_a_record_has_the_same_numbers_in_any_company():
    records, scan, noise = scene("6-beam", 0.3, 4)
    records["flag"].values[1] = 1
    records["flag"].values[2, 3] = 1
    options = {"noise": noise, "nuisances": BOTH, "seed": 1, "n_draw": 500}
    table = compare_inflow(records, scan, **options)
    assert table["verdict"][1] == "not fitted"
    assert table.loc[1].drop(["record", "time", "verdict"]).isna().all()
    alone = compare_inflow(records.isel(record=[2]), scan, **options)
    for name in table.columns.drop(["record", "time", "verdict"]):
        assert alone[name][0] == table[name][2]
    again = compare_inflow(records, scan, **options)
    pd.testing.assert_frame_equal(table, again)


def test_words_of_a_table():
    table = pd.DataFrame(
        {
            "log_bayes_factor": [2.0, np.nan, 1.5, -9.0],
            "log_bayes_factor_error": [0.3, np.nan, 0.4, 0.0],
            "elpd_difference": [1.0, np.nan, 2.0, -3.0],
        }
    )
    assert inflow_in_words(table) == (
        "3 records: very strong for homogeneous flow (log Bayes factor -5.50 ± 0.50); one beam out, elpd difference "
        "0.00 ± 4.58"
    )
    assert inflow_in_words(table[:1]) == "1 record: positive for gradients (log Bayes factor 2.00 ± 0.30)"
    with pytest.raises(InputError, match="No record of the table"):
        inflow_in_words(table[1:2])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"nuisances": Nuisances(yaw_sd_deg=2.0)}, "nothing to compare"),
        ({"nuisances": Nuisances(vertical_gradient_sd=0.5, length_scale_log_sd=0.3)}, "length scale is uncertain"),
        ({"n_draw": 10}, "n_draw"),
        ({"target": "sonic"}, "target"),
    ],
)
def test_what_cannot_be_compared_is_refused(change, words):
    records, scan, noise = scene("6-beam", 0.0, 1)
    with pytest.raises(InputError, match=words):
        compare_inflow(records, scan, **{"noise": noise, "nuisances": BOTH, "seed": 1, **change})


def test_weights_that_cannot_be_trusted_are_said_so(monkeypatch):
    records, scan, noise = scene("6-beam", 0.0, 1)
    monkeypatch.setattr("bayes_rs.fits.inflow_comparison.PARETO_K_LIMIT", -np.inf)
    table = compare_inflow(records, scan, noise=noise, nuisances=BOTH, prior=WeakPrior(), seed=1, leave_one_out=False)
    assert table["verdict"][0] == "weights uneven: not to be trusted"
