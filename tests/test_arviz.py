"""A fit in ArviZ's hands, before and after its version 1: groups, and a log-likelihood that `loo` can use."""

import warnings

import numpy as np
import pytest
import xarray as xr
from scenes import draw_variances, plain_noise, point_scan, records_of
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, multivariate_t

from bayes_rs import InputError, Nuisances, fit, load_scan, open_fit
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.likelihoods.mixture import MixtureLikelihood
from bayes_rs.likelihoods.pointwise import has_beams, log_conditional
from bayes_rs.posteriors.nuisance import RecordNuisances
from bayes_rs.priors.ratio import WeakPrior

SCAN = load_scan("6-beam")
NOISE = plain_noise(SCAN)
ROUNDING = 1e-9  # of sums of a few logarithms, whose matrices have condition numbers of a hundred


def some_records(n_record, seed, scan=SCAN, noise=NOISE):
    rng = np.random.default_rng(seed)
    return records_of(draw_variances(WeakPrior().draw(n_record, rng), scan, noise, rng), scan)


@pytest.fixture(scope="module")
def records():
    """Three records: 0 as it should be, 1 without a beam, 2 with one beam fewer."""
    records = some_records(3, 31)
    records["flag"][1] = 1
    records["flag"][2, 4] = 2
    return records


@pytest.fixture(scope="module")
def found(records):
    return fit(records, SCAN, noise=NOISE, seed=7, target_ess=400)


@pytest.fixture(scope="module")
def many():
    """Eight beams on a cone, which tell five numbers of R."""
    phase = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    scan = point_scan(np.stack([np.full(8, -2.0), np.cos(phase), np.sin(phase)], axis=1))
    return scan, plain_noise(scan)


class TestConditional:
    """The density of each datum given the others is the joint one over that of the others, from SciPy's."""

    STRESS = WeakPrior().draw(4, 5)

    def likelihood(self, dof=np.inf, factor=1.0):
        """Two records of four beams; the second does not use beam 1."""
        used = np.array([[True] * 4, [True, False, True, True]])
        variance = np.array([[1.0, 0.7, 1.3, 0.9], [2.0, 9.0, 1.4, 1.7]])
        gain = np.broadcast_to(design_matrix(SCAN)[:4], (2, 4, 6))
        covariance = np.broadcast_to(factor * NOISE.covariance[0, :4, :4], (2, 4, 4))
        return log_normal_likelihood(variance, used, gain, covariance, dof=dof), used, variance, covariance

    def density(self, log_y, mean, matrix, dof):
        if len(log_y) == 0:
            return 0.0
        if np.isinf(dof):
            return multivariate_normal.logpdf(log_y, mean, matrix)
        return multivariate_t.logpdf(log_y, mean, matrix, df=dof)

    def expected(self, dof, factors=(1.0,), weights=(1.0,)):
        """(record, draw, beam), straight from the definition."""
        found = np.full((2, len(self.STRESS), 4), np.nan)
        _, used, variance, covariance = self.likelihood()
        for record in range(2):
            for draw, stress in enumerate(self.STRESS):
                for beam in np.flatnonzero(used[record]):
                    whole = np.flatnonzero(used[record])
                    joint = []
                    for keep in (whole, whole[whole != beam]):
                        parts = []
                        for factor, weight in zip(factors, weights, strict=True):
                            matrix = np.log1p(factor * covariance[record])
                            mean = np.log(design_matrix(SCAN)[:4] @ stress) - 0.5 * np.diag(matrix)
                            of_some = self.density(
                                np.log(variance[record, keep]), mean[keep], matrix[np.ix_(keep, keep)], dof
                            )
                            parts.append(np.log(weight) + of_some)
                        joint.append(logsumexp(parts))
                    found[record, draw, beam] = joint[0] - joint[1]
        return found

    @pytest.mark.parametrize("dof", [np.inf, 5.0])
    def test_of_beams(self, dof):
        likelihood = self.likelihood(dof)[0]
        assert has_beams(likelihood)
        ours = log_conditional(likelihood, np.broadcast_to(self.STRESS, (2, 4, 6)), of_beams=True)
        np.testing.assert_allclose(ours, self.expected(dof), atol=ROUNDING)

    def test_of_a_mixture(self):
        parts = tuple(self.likelihood(factor=factor)[0] for factor in (0.5, 2.0))
        mixture = MixtureLikelihood(parts, np.array([0.3, 0.7]))
        ours = log_conditional(mixture, np.broadcast_to(self.STRESS, (2, 4, 6)), of_beams=True)
        np.testing.assert_allclose(ours, self.expected(np.inf, (0.5, 2.0), (0.3, 0.7)), atol=ROUNDING)

    def test_of_one_beam_it_is_its_density(self):
        one = np.ones((1, 1))
        likelihood = log_normal_likelihood(one, one > 0.0, design_matrix(SCAN)[None, :1], 0.06 * one[None])
        stress = self.STRESS[None]
        ours = log_conditional(likelihood, stress, of_beams=True)
        np.testing.assert_allclose(ours[..., 0], likelihood.log_density(stress), atol=ROUNDING)

    def test_of_directions(self, many):
        """Of reduced data d = Uᵀ ln y with an orthonormal U that any decomposition of the gains gives."""
        scan, noise = many
        gain, matrix = design_matrix(scan), np.log1p(noise.covariance[0])
        variance = np.exp(np.random.default_rng(1).normal(size=8))
        likelihood = log_normal_likelihood(variance[None], np.ones((1, 8), dtype=bool), gain[None], noise.covariance)
        assert not has_beams(likelihood)
        ours = log_conditional(likelihood, self.STRESS[None], of_beams=False)[0]
        assert np.isnan(ours).sum(axis=1).tolist() == [1] * 4  # five of six columns
        left = np.linalg.qr(likelihood.whitening[0].T)[0][:, :5]
        reduced = left.T @ matrix @ left
        for stress, row in zip(self.STRESS, ours, strict=True):
            residual = left.T @ (np.log(variance) + 0.5 * np.diag(matrix) - np.log(gain @ stress))
            for index in range(5):
                others = np.arange(5) != index
                expected = multivariate_normal.logpdf(residual, cov=reduced) - multivariate_normal.logpdf(
                    residual[others], cov=reduced[np.ix_(others, others)]
                )
                assert row[index] == pytest.approx(expected, abs=1e-7)

    def test_a_tensor_of_likelihood_zero_has_it_for_every_beam(self):
        likelihood = self.likelihood()[0]
        impossible = np.broadcast_to([-1.0, 0.5, 0.3, 0.0, 0.0, 0.0], (2, 1, 6))
        ours = log_conditional(likelihood, impossible, of_beams=True)
        assert np.isneginf(ours[0]).all()
        assert np.isnan(ours[1, 0]).tolist() == [False, True, False, False]


class TestGroup:
    def test_data_that_are_not_there_are_missing(self, found):
        each = found["log_likelihood/variance"]
        assert each.dims == ("chain", "draw", "record", "beam")
        used = found["observed_data/used"] == 1
        assert bool((each.notnull().all(("chain", "draw")) == used).all())

    def test_the_whole_is_the_likelihood(self, found, records):
        """And the draw's stresses are those of the group `posterior`, in the same place."""
        matrix = np.log1p(NOISE.covariance[0])
        stress = found["posterior/stress"].sel(record=0, chain=5).values
        mean = np.log(stress @ design_matrix(SCAN).T) - 0.5 * np.diag(matrix)
        expected = multivariate_normal.logpdf(np.log(records["variance"].values[0]) - mean, cov=matrix)
        ours = found["log_likelihood/joint"].sel(record=0, chain=5)
        np.testing.assert_allclose(ours, expected, rtol=1e-6)  # float32

    def test_more_beams_than_numbers_have_one_for_each_number(self, many):
        scan, noise = many
        found = fit(some_records(1, 3, scan, noise), scan, noise=noise, seed=1, target_ess=200)
        assert set(found["log_likelihood"].data_vars) == {"joint", "direction"}
        assert found.to_datatree(0)["log_likelihood/direction"].sizes["number"] == 5

    def test_a_folder_has_the_same(self, found, records, tmp_path):
        fit(records, SCAN, noise=NOISE, seed=7, target_ess=400, output=tmp_path / "out")
        again = open_fit(tmp_path / "out")
        assert again["log_likelihood"].identical(found["log_likelihood"])
        assert again.to_datatree().identical(found.to_datatree())

    def test_none_for_tensors_of_a_sonic(self):
        scan = load_scan("2-beam")
        from bayes_rs import noise  # noqa: PLC0415 - of this test alone

        own = noise.calibrate(scan, "fu-2022", wind_speed=10.0, sonic=True)
        found = fit(some_records(1, 3, scan, own), scan, noise=own, seed=1, target="sonic", target_ess=200)
        assert "log_likelihood" not in found
        assert "log_likelihood" not in found.to_datatree().children
        with pytest.raises(InputError, match="This fit has no log_likelihood: it is that of R"):
            found["log_likelihood"]

    def test_nuisances_are_as_they_were_sampled(self):
        """With them the likelihood of the draws is that of the sampler: coordinates are found again from the values."""
        choice = Nuisances(yaw_sd_deg=5.0, tilt_sd_deg=1.0, instrument_noise_log_sd=0.5, vertical_gradient_sd=0.2)
        own = RecordNuisances(choice, np.zeros(2), 0.02)
        coordinate = np.random.default_rng(3).normal(size=(2, 50, own.n_coordinate))
        np.testing.assert_allclose(own.coordinate(own.values(coordinate)), coordinate, atol=1e-12)
        still = RecordNuisances(Nuisances(yaw_sd_deg="records"), np.zeros(1), 0.0, np.zeros(1))
        assert still.coordinate({"yaw_error": np.zeros((1, 3))}).tolist() == [[[0.0]] * 3]
        records = some_records(1, 31)
        found = fit(records, SCAN, noise=NOISE, seed=7, target_ess=200, nuisances=choice, instrument_noise=0.02)
        assert bool(np.isfinite(found["log_likelihood/variance"]).all())


class TestOneRecord:
    def test_has_the_beams_that_it_uses(self, found):
        tree = found.to_datatree(2)
        assert tree["log_likelihood/variance"].dims == ("chain", "draw", "beam")
        assert tree["observed_data"]["beam"].values.tolist() == [0, 1, 2, 3, 5]
        assert tree["posterior/stress"].dims == ("chain", "draw", "component")

    def test_by_its_start(self, found, records):
        start = str(records["time"].values[2])[:19]
        assert found.to_datatree(start).identical(found.to_datatree(2))

    def test_one_that_was_not_fitted(self, found):
        with pytest.raises(InputError, match=r"Record 1 was not fitted"):
            found.to_arviz(1)


class TestInArviz:
    def test_what_it_gets_is_what_it_takes(self, found, arviz):
        data = found.to_arviz(0)
        assert isinstance(data, xr.DataTree) == (int(arviz.__version__.split(".")[0]) >= 1)
        table = arviz.summary(data, var_names=["stress"], round_to="none")
        mean = found["posterior/stress"].sel(record=0).mean(("chain", "draw"))
        np.testing.assert_allclose(table["mean"], mean, rtol=1e-12)

    def test_loo_is_that_of_fits_without_each_beam(self, found, records, arviz):
        """Beam by beam: the fit without it predicts it as well as `loo` says, within the Monte-Carlo errors."""
        loo = quietly(arviz.loo, found.to_arviz(0), var_name="variance", pointwise=True)
        matrix = np.log1p(NOISE.covariance[0])
        log_y = np.log(records["variance"].values[0])
        without = xr.concat([records.isel(record=[0])] * 6, dim="record")
        without["time"] = ("record", without["time"].values + np.arange(6) * np.timedelta64(600, "s"))
        np.fill_diagonal(without["flag"].values, 1)
        refits = fit(without, SCAN, noise=NOISE, seed=11, target_ess=1000)
        for beam in range(6):
            mean = np.log(refits.draws(beam).reshape(-1, 6) @ design_matrix(SCAN).T) - 0.5 * np.diag(matrix)
            others = np.arange(6) != beam
            weight = np.linalg.solve(matrix[np.ix_(others, others)], matrix[others, beam])
            sd = np.sqrt(matrix[beam, beam] - weight @ matrix[others, beam])
            residual = log_y[beam] - mean[:, beam] - (log_y[others] - mean[:, others]) @ weight
            density = np.exp(-0.5 * (residual / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
            # four standard errors of the refit's 1000 draws, and of loo's 400 that the weights make fewer
            error = density.std() / density.mean() * np.hypot(1.0 / np.sqrt(1000.0), 2.0 / np.sqrt(400.0))
            assert pointwise(loo)[beam] == pytest.approx(np.log(density.mean()), abs=4.0 * error)

    def test_loo_tells_the_noise_that_is_from_one_a_ninth_of_it(self, arviz):
        """Twelve records, each beam predicted by its others: noise taken for a third is too sure of them."""
        records = some_records(12, 9)
        total = []
        for factor in (1.0, 1.0 / 9.0):
            noise = plain_noise(SCAN, relative_variance=0.06 * factor)
            found = fit(records, SCAN, noise=noise, seed=1, target_ess=200)
            each = [
                pointwise(quietly(arviz.loo, found.to_arviz(record), var_name="variance", pointwise=True))
                for record in range(12)
            ]
            total.append(np.concatenate(each))
        gain = total[0] - total[1]
        assert gain.sum() > 2.0 * np.sqrt(len(gain)) * gain.std()


def quietly(function, *args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of heavy tails, where a beam decides much: what is tested says how good it is
        return function(*args, **options)


def pointwise(loo):
    """The elpd of each datum, as ArviZ calls it before and since its version 1."""
    return np.asarray(loo.elpd_i if hasattr(loo, "elpd_i") else loo.loo_i)
