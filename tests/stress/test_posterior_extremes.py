"""The posterior at the edges: the right answer, or a flag and a clear message; never NaN in silence."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import NotPositiveDefiniteError, fit, load_scan
from bayes_rs.fits.flags import FLAGS
from bayes_rs.geometry.forward import design_matrix, radial_variance
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.ratio import WeakPrior
from bayes_rs.priors.registry import FlatPrior

SAMPLERS = ("emcee", "direct", "auto")


def fitted(records, scan, noise, **options):
    result = fit(records, scan, noise=noise, seed=1, **{"target_ess": 200, "sampler": "auto", **options})
    draws = result["posterior/stress"].transpose("record", "chain", "draw", "component").values
    return result, draws.reshape(len(draws), -1, 6)


def given_noise(scan, covariance):
    return Noise(
        bias=np.full(scan.n_beam, -0.1),
        gain=design_matrix(scan),
        covariance=covariance,
        beam=scan.beam,
        scan_name=scan.name,
        scan_geometry=scan.geometry(),
        wind_speed=10.0,
        yaw=scan.yaw,
        duration=600.0,
        turbulence=plain_noise(scan).turbulence,
        method="given",
    )


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("size", [1e-8, 1e-4, 1.0, 1e2])  # more is not believed
def test_posterior_scales_with_the_data(size, sampler):
    """A scale-free prior and data times c: the same draws times c, because the seed is the same.

    The proposal's curvature comes from differences of the density, which rounding moves by 1e-7; a draw whose
    acceptance hangs on the last digits may go the other way, and there are only a few of those.
    """
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    variance = draw_variances(WeakPrior().draw(3, 1), scan, noise, np.random.default_rng(1))
    _, draws = fitted(records_of(variance, scan), scan, noise, prior=WeakPrior(), sampler=sampler)
    _, scaled = fitted(records_of(size * variance, scan), scan, noise, prior=WeakPrior(median_uu=size), sampler=sampler)
    apart = np.abs(scaled / size - draws) > 1e-4 * draws[..., :3].sum(axis=-1, keepdims=True)
    assert np.mean(apart.any(axis=-1)) < 0.01
    # the default prior, centred on 1 m² s⁻² with a factor of e² as standard deviation, hardly minds
    result, default = fitted(records_of(size * variance, scan), scan, noise, sampler=sampler)
    assert np.isfinite(default).all()
    assert (result["sample_stats/flag"].values == 0).all()
    shift = np.log(default[:, :, 0].mean(axis=1) / (size * draws[:, :, 0].mean(axis=1)))
    # precision of ln uu: about 1/0.2² from the data against 1/2² from the prior
    np.testing.assert_allclose(shift, 0.0, atol=0.05 * abs(np.log(size)) + 0.1)


@pytest.mark.parametrize("size", [1e-3, 1e-2, 1.0, 24.0])
def test_flat_prior_at_any_size_below_its_bound(size):
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = plain_noise(scan)
    shape = np.array([1.0, 0.6, 0.4, 0.1, -0.2, 0.0])
    variance = draw_variances(np.tile(size * shape, (2, 1)), scan, noise, np.random.default_rng(2))
    result, draws = fitted(records_of(variance, scan), scan, noise, prior=FlatPrior(bound=25.0), sampler="auto")
    assert np.isfinite(draws).all()
    assert (draws[..., :3] > 0.0).all()
    assert (draws[..., :3] < 25.0).all()
    assert not (result["sample_stats/flag"].values & FLAGS["short_chain"]).any()


def test_flat_prior_nine_decades_above_the_data_says_so():
    """Its coordinates are made for data within some four decades of its bound; beyond, records are flagged."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = plain_noise(scan)
    variance = draw_variances(np.array([[1e-8, 6e-9, 4e-9, 1e-9, -2e-9, 0.0]]), scan, noise, np.random.default_rng(2))
    result, draws = fitted(records_of(variance, scan), scan, noise, prior=FlatPrior(bound=25.0))
    assert np.isfinite(draws).all()
    assert int(result["sample_stats/flag"].values[0]) & (FLAGS["short_chain"] | FLAGS["ensembles_differ"])
    _, near = fitted(records_of(variance, scan), scan, noise, prior=FlatPrior(bound=25e-8))
    assert 3e-9 < np.median(near[0, :, 0]) < 3e-8


@pytest.mark.parametrize("condition", [1e2, 1e6, 1e10, 1e12, 1e14])
def test_noise_of_any_condition(condition):
    """Six beams whose errors are nearly one: what they differ in is known ever better, until it is known exactly."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    values = np.full(scan.n_beam, 0.06 / condition)
    values[0] = 0.06 * scan.n_beam
    basis = np.linalg.qr(np.column_stack([np.ones(6), np.eye(6)[:, 1:]]))[0]
    noise = given_noise(scan, (basis * values) @ basis.T)
    stress = np.array([[1.0, 0.6, 0.4, 0.1, -0.2, 0.0]])
    variance = draw_variances(stress, scan, noise, np.random.default_rng(3))
    result, draws = fitted(records_of(variance, scan), scan, noise, max_extension=7)
    assert np.isfinite(draws).all()
    flag = int(result["sample_stats/flag"].values[0])
    if flag == 0:
        correlation = draws[0, :, 3] / np.sqrt(draws[0, :, 0] * draws[0, :, 1])
        expected = 0.1 / np.sqrt(0.6)
        assert abs(correlation.mean() - expected) < 5.0 * correlation.std() + 1e-3
    else:
        assert flag & (FLAGS["short_chain"] | FLAGS["weights_uneven"] | FLAGS["ensembles_differ"])


def test_noise_that_is_singular_is_refused():
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = given_noise(scan, np.full((6, 6), 0.06))
    variance = radial_variance(scan, np.array([[1.0, 0.6, 0.4, 0.1, -0.2, 0.0]]))
    shape = (1, scan.n_beam)
    gain = np.broadcast_to(noise.gain, (*shape, 6))
    with pytest.raises(NotPositiveDefiniteError, match="The noise of record 0 is singular: the smallest eigenvalue"):
        log_normal_likelihood(variance, np.ones(shape, dtype=bool), gain, noise.covariance)
    found, _ = fitted(records_of(variance, scan), scan, noise)
    assert found.flags["likelihood_failed"] == 1  # and other records would be fitted
    assert found.n_fitted == 0


def test_a_beam_twice_with_the_same_data_changes_nothing():
    """Two beams with errors that are one and the same: their covariance is singular, and they are one beam."""
    single = load_scan("4-beam")
    index = [0, 1, 2, 3, 0]
    doubled = replace(
        single,
        beam_direction=single.beam_direction[index],
        focus_distance=single.focus_distance[index],
        beam_time=single.beam_time[index],
        beam=np.append(single.beam, 99),
    )
    noise = plain_noise(single)
    twice = given_noise(doubled, noise.covariance[0][np.ix_(index, index)])
    variance = draw_variances(WeakPrior().draw(2, 4), single, noise, np.random.default_rng(4))
    _, plain = fitted(records_of(variance, single), single, noise, target_ess=2000)
    _, again = fitted(records_of(variance[:, index], doubled), doubled, twice, target_ess=2000)
    error = plain.std(axis=1) * np.sqrt(2.0 / 2000.0)
    assert np.all(np.abs(plain.mean(axis=1) - again.mean(axis=1)) < 5.0 * error)


@pytest.mark.parametrize("name", ["staring", "spinnerlidar@probe=point"])
def test_one_beam_and_four_hundred(name):
    scan = load_scan(name)
    noise = plain_noise(scan)
    stress = WeakPrior().draw(3, 5)
    variance = draw_variances(stress, scan, noise, np.random.default_rng(5))
    result, draws = fitted(records_of(variance, scan), scan, noise)
    assert np.isfinite(draws).all()
    assert (result["sample_stats/flag"].values & ~FLAGS["yaw_not_seen"] == 0).all()
    rank = (draws[:, :, 0] < stress[:, None, 0]).mean(axis=1)
    assert np.all((rank > 1e-3) & (rank < 1.0 - 1e-3))


@pytest.mark.parametrize("floor", [1e-3, 1e-6, 1e-9])
def test_a_tensor_on_the_boundary(floor):
    """R nearly of rank one across some beams: variances spread over nine decades."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    noise = plain_noise(scan)
    axis = np.array([1.0, 0.3, -0.2])
    tensor = np.outer(axis, axis) + floor * np.eye(3)
    stress = np.array([tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    variance = draw_variances(stress[None], scan, noise, np.random.default_rng(6))
    for prior in (WeakPrior(log_sd_vv=2.0, log_sd_ww=2.0, z_sd=2.0), FlatPrior(bound=5.0)):
        result, draws = fitted(records_of(variance, scan), scan, noise, prior=prior, max_extension=6)
        assert np.isfinite(draws).all()
        tensors = draws[0][:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
        assert np.linalg.eigvalsh(tensors).min() > -1e-12
        flag = int(result["sample_stats/flag"].values[0])
        low, high = np.quantile(draws[0, :, 0], [0.0005, 0.9995])
        assert flag or low < stress[0] < high


def test_a_beam_ten_times_too_energetic_is_told():
    scan = load_scan("50-beam")
    noise = plain_noise(scan, relative_variance=0.03)
    variance = draw_variances(np.tile([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], (5, 1)), scan, noise, np.random.default_rng(7))
    variance[2, 10] *= 10.0
    result, draws = fitted(records_of(variance, scan), scan, noise)
    assert np.isfinite(draws).all()
    flags = result["sample_stats/flag"].values & FLAGS["beams_disagree"]
    np.testing.assert_array_equal(flags != 0, np.arange(5) == 2)
    assert result.summary().query("record == 2")["flag"].str.contains("beams_disagree").all()
