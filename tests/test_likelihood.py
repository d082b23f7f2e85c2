"""The likelihood: against the textbook density, its reduction, and its refusals."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from other_likelihoods import OTHER_LIKELIHOODS, register
from scenes import draw_variances, plain_noise, records_of
from scipy import stats

from bayes_rs import InputError, NotPositiveDefiniteError, fit, load_scan
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.stress import is_realizable
from bayes_rs.likelihoods.log_normal import (
    LIKELIHOODS,
    REFERENCE_STRESS,
    log_normal_likelihood,
    make_likelihood,
)
from bayes_rs.priors.registry import WeakPrior

ROOT = Path(__file__).parents[1]


def build(scan, variance, used=None, *, covariance=None, offset=0.0):
    n_record, n_beam = variance.shape
    matrix = plain_noise(scan).covariance[0] if covariance is None else covariance
    return log_normal_likelihood(
        variance,
        np.ones_like(variance, dtype=bool) if used is None else used,
        np.broadcast_to(design_matrix(scan), (n_record, n_beam, 6)),
        np.broadcast_to(matrix, (n_record, n_beam, n_beam)),
        offset=offset,
    )


@pytest.fixture
def stress():
    return WeakPrior(log_sd_uu=0.5).draw(7, seed=1)


def textbook(scan, covariance, variance, stress, offset=0.0):
    """Log-density of ln y by scipy, one record and one tensor at a time."""
    log_covariance = np.log(1.0 + covariance)
    mean = np.log(design_matrix(scan) @ stress + offset) - 0.5 * np.diag(log_covariance)
    return stats.multivariate_normal(mean, log_covariance).logpdf(np.log(variance))


@pytest.mark.parametrize("name", ["staring", "2-beam", "4-beam", "5-beam", "6-beam"])
def test_without_surplus_beams_it_is_the_textbook_density(name, stress):
    scan = load_scan(name)
    noise = plain_noise(scan)
    variance = draw_variances(stress, scan, noise, np.random.default_rng(2))
    density = build(scan, variance, offset=0.02).log_density(np.broadcast_to(stress, (7, 7, 6)))
    expected = [[textbook(scan, noise.covariance[0], y, r, 0.02) for r in stress] for y in variance]
    np.testing.assert_allclose(density, expected, rtol=1e-9)  # condition of K below 1e4, rounding


def test_moments_are_those_of_the_noise_model():
    """E[y] = A R and Cov[y_a, y_b] = K_ab E[y_a] E[y_b]: the claim on which everything rests."""
    scan = load_scan("6-beam", opening_angle_deg=40.0)
    noise = plain_noise(scan)
    stress = WeakPrior().draw(1, seed=5)
    n_draw = 200_000
    variance = draw_variances(np.repeat(stress, n_draw, axis=0), scan, noise, np.random.default_rng(3))
    expected = design_matrix(scan) @ stress[0]
    np.testing.assert_allclose(variance.mean(axis=0), expected, rtol=5.0 * np.sqrt(0.06 / n_draw))
    relative = np.cov((variance / expected).T)
    np.testing.assert_allclose(relative, noise.covariance[0], atol=5.0 * 0.06 * np.sqrt(3.0 / n_draw))


@pytest.mark.parametrize("name", ["50-beam", "51-beam", "spinnerlidar@probe=point", "staring-planes"])
def test_reduced_density_is_that_of_the_projected_data(name, stress):
    """Any orthonormal basis of the column space at the reference shape, by another route than the code's."""
    scan = load_scan(name)
    noise = plain_noise(scan)
    variance = draw_variances(stress, scan, noise, np.random.default_rng(4))
    matrix = design_matrix(scan)
    gradient = matrix / (matrix @ REFERENCE_STRESS)[:, None]
    values, vectors = np.linalg.eigh(gradient @ gradient.T)
    basis = vectors[:, values > 1e-12 * values[-1]]
    log_covariance = np.log(1.0 + noise.covariance[0])
    mean = (np.log(matrix @ stress.T).T - 0.5 * np.diag(log_covariance)) @ basis
    expected = [
        [stats.multivariate_normal(m, basis.T @ log_covariance @ basis).logpdf(np.log(y) @ basis) for m in mean]
        for y in variance
    ]
    likelihood = build(scan, variance)
    assert set(likelihood.n_datum) == {basis.shape[1]}
    density = likelihood.log_density(np.broadcast_to(stress, (7, 7, 6)))
    np.testing.assert_allclose(density, expected, rtol=1e-6)  # the eigenvectors of a Gram matrix lose half the digits


def test_a_beam_that_is_not_used_changes_nothing(stress):
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    variance = draw_variances(stress, scan, noise, np.random.default_rng(5))
    used = np.ones_like(variance, dtype=bool)
    used[:, 2] = False
    spoiled = variance.copy()
    spoiled[:, 2] = np.nan
    some = np.array([0, 1, 3, 4, 5])
    smaller = build(scan.select(some), variance[:, some], covariance=noise.covariance[0][np.ix_(some, some)])
    tensors = np.broadcast_to(stress, (7, 7, 6))
    np.testing.assert_allclose(
        build(scan, spoiled, used).log_density(tensors), smaller.log_density(tensors), rtol=1e-10
    )


def test_the_order_of_the_beams_does_not_matter(stress):
    scan = load_scan("51-beam")
    variance = draw_variances(stress, scan, plain_noise(scan), np.random.default_rng(6))
    order = np.random.default_rng(7).permutation(51)
    tensors = np.broadcast_to(stress, (7, 7, 6))
    there = build(scan, variance).log_density(tensors)
    turned = build(scan.select(order), variance[:, order]).log_density(tensors)
    np.testing.assert_allclose(turned, there, rtol=1e-8)


def test_scaling_of_data_and_stress_shifts_nothing_but_nothing(stress):
    """ln y and ln A R move together: the density of ln y is unchanged under a change of units."""
    scan = load_scan("6-beam")
    variance = draw_variances(stress, scan, plain_noise(scan), np.random.default_rng(8))
    tensors = np.broadcast_to(stress, (7, 7, 6))
    for factor in (1e-8, 1e4):
        np.testing.assert_allclose(
            build(scan, factor * variance).log_density(factor * tensors),
            build(scan, variance).log_density(tensors),
            rtol=1e-9,
        )


def test_a_tensor_that_gives_a_beam_no_variance_has_likelihood_zero():
    """A rank-one tensor across the beam; or a gain that is no positive form, as interpolation can leave it."""
    scan = load_scan("2-beam")
    likelihood = build(scan, np.ones((1, 2)))
    beam = scan.line_of_sight[0]
    across = np.cross(beam, [0.0, 0.0, 1.0])
    tensor = np.outer(across, across)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    assert likelihood.log_density(np.array([[tensor, -tensor, 1e-3 - tensor]]))[0].max() < -100.0
    assert np.isneginf(likelihood.log_density(np.array([[-np.ones(6)]]))[0, 0])


@pytest.mark.parametrize(("name", "n_draw"), [("6-beam", 3), ("6-beam", 20_000), ("spinnerlidar@probe=point", 400)])
def test_draws_do_not_depend_on_those_beside_them(name, n_draw):
    """Records and draws are worked on in blocks: several records, one record, and parts of a record at a time."""
    scan = load_scan(name)
    truth = WeakPrior(log_sd_uu=0.5).draw(3, seed=1)
    likelihood = build(scan, draw_variances(truth, scan, plain_noise(scan), np.random.default_rng(9)))
    stress = WeakPrior(log_sd_uu=0.5).draw(3 * n_draw, seed=2).reshape(3, n_draw, 6)
    noise = np.linspace(0.0, 0.1, 3 * n_draw).reshape(3, n_draw)
    together = likelihood.log_density(stress, noise)
    for record in range(3):
        for draws in (slice(0, 2), slice(n_draw - 1, n_draw)):
            alone = likelihood.take(np.array([record])).log_density(stress[[record], draws], noise[[record], draws])
            np.testing.assert_allclose(alone[0], together[record, draws], rtol=1e-11)  # order of the sums


class TestRegistry:
    """Names are options of `fit` and stand in results."""

    def test_there_is_one(self):
        assert list(LIKELIHOODS) == ["log-normal"]

    def test_it_takes_one_of_your_own(self, stress, monkeypatch):
        """Noise that is independent from beam to beam, by its name in a fit: another density, the right one."""
        scan = load_scan("6-beam")
        noise = plain_noise(scan)

        def independent(variance, used, gain, covariance, offset=0.0, **options):
            alone = covariance * np.eye(covariance.shape[-1])
            return log_normal_likelihood(variance, used, gain, alone, offset, **options)

        monkeypatch.setitem(LIKELIHOODS, "independent", independent)
        variance = draw_variances(stress, scan, noise, np.random.default_rng(2))
        records = records_of(variance, scan)
        found = fit(records, scan, noise=noise, seed=1, sampler="direct", target_ess=100, likelihood="independent")
        same = replace(noise, covariance=noise.covariance * np.eye(6))
        expected = fit(records, scan, noise=same, seed=1, sampler="direct", target_ess=100)
        np.testing.assert_array_equal(found["posterior/stress"], expected["posterior/stress"])

    def test_unknown_name(self):
        with pytest.raises(InputError, match=r"Unknown likelihood 'normal': it must be one of log-normal"):
            make_likelihood("normal", *[np.ones((1, 2))] * 4)

    def test_those_for_comparison_can_be_registered(self, monkeypatch):
        monkeypatch.setattr("other_likelihoods.LIKELIHOODS", registry := dict(LIKELIHOODS))
        register()
        assert list(registry) == ["log-normal", *OTHER_LIKELIHOODS]


@pytest.mark.parametrize("name", [*LIKELIHOODS, *OTHER_LIKELIHOODS])
def test_there_is_no_instrument_noise_unless_it_is_given(name, stress):
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    variance = draw_variances(stress, scan, noise, np.random.default_rng(10))
    shape = (7, scan.n_beam)
    gain, covariance = (
        np.broadcast_to(noise.gain[0], (*shape, 6)),
        np.broadcast_to(noise.covariance[0], (*shape, shape[1])),
    )
    tensors = np.broadcast_to(stress, (7, 7, 6))
    maker = {**LIKELIHOODS, **OTHER_LIKELIHOODS}[name]
    found, none, some = (
        maker(variance, np.ones(shape, dtype=bool), gain, covariance, *offset).log_density(tensors)
        for offset in ((), (0.0,), (0.1,))
    )
    np.testing.assert_array_equal(found, none)
    assert np.all(found != some)


def test_the_reference_shape_is_that_of_near_neutral_flow():
    """Realizable, with equal parts to the left and to the right, and momentum that goes down."""
    assert is_realizable(REFERENCE_STRESS)
    np.testing.assert_array_equal(REFERENCE_STRESS[[3, 5]], 0.0)
    assert REFERENCE_STRESS[4] < 0.0 < REFERENCE_STRESS[2] < REFERENCE_STRESS[1] < REFERENCE_STRESS[0]


@pytest.fixture(scope="module")
def benchmark_of_likelihoods():
    path = ROOT / "benchmarks" / "likelihoods.py"
    spec = importlib.util.spec_from_file_location("likelihoods", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def measured():
    return pd.read_csv(ROOT / "benchmarks" / "likelihoods.csv")


class TestTheChoice:
    """The default is chosen by a measurement; the page that says so must say what was measured."""

    def test_the_tables_in_the_docs_are_those_that_were_measured(self, benchmark_of_likelihoods, measured):
        lines = (ROOT / "docs" / "likelihood.md").read_text(encoding="utf-8").replace("−", "-").splitlines()
        shown = [line for line in lines if line.startswith(("| weak |", "| flat |"))]
        assert shown == benchmark_of_likelihoods.summary(measured)
        costs = benchmark_of_likelihoods.costs(measured)
        assert [line for line in lines if line in costs] == costs

    def test_all_likelihoods_were_measured_on_enough_records(self, measured):
        assert set(measured["likelihood"]) == {*LIKELIHOODS, *OTHER_LIKELIHOODS}
        lines = measured[measured["source"] == "lines"]
        assert lines["trusted"].min() >= 900
        assert measured.groupby(["scan", "prior", "source", "likelihood"]).ngroups == 4 * 2 * 2 * 4

    def test_the_default_is_as_well_calibrated_as_the_best(self, measured):
        """Mean coverages of the log-normal are nominal to a point, and no other has a better score by a percent."""
        lines = measured[measured["source"] == "lines"]
        for _, part in lines.groupby("prior"):
            mean = part.groupby("likelihood").mean(numeric_only=True)
            for level in (50, 80, 90, 95):
                assert mean.loc["log-normal", f"cover_{level}"] == pytest.approx(level / 100.0, abs=0.01)
            assert mean.loc["log-normal", "score"] < 1.01 * mean["score"].min()


class TestRefusals:
    def test_singular_noise(self):
        scan = load_scan("2-beam")
        with pytest.raises(
            NotPositiveDefiniteError, match=r"noise of record 0 is singular: the smallest eigenvalue"
        ) as e:
            build(scan, np.ones((1, 2)), covariance=np.full((2, 2), 0.06))
        assert abs(e.value.smallest_eigenvalue) < 1e-15

    def test_no_beam(self):
        with pytest.raises(InputError, match=r"Record 1 has no usable beam"):
            build(load_scan("2-beam"), np.ones((2, 2)), np.array([[True, True], [False, False]]))

    @pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
    def test_a_variance_that_is_not_positive(self, value):
        with pytest.raises(
            InputError, match=r"Invalid variance .* of record 0, beam 1: it must be positive; flag the beam"
        ):
            build(load_scan("2-beam"), np.array([[1.0, value]]))
