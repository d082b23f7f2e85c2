"""The target "sonic": the tensor of a sonic in this very record; exact draws, exact cases, simulated records."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from noise_checks import check_noise
from other_likelihoods import OTHER_LIKELIHOODS
from scenes import records_of
from scipy import stats

from bayes_rs import fit, load_scan, load_turbulence
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import is_realizable, pack_stress, unpack_stress
from bayes_rs.likelihoods.log_normal import LIKELIHOODS
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.calibrating import calibrate
from bayes_rs.noise.choice import noise_for_records
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.net import refined_noise
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.sonic import CLIP_LIMIT, SonicFactor, factored_tensor, match_factor
from bayes_rs.priors.registry import WeakPrior
from bayes_rs.simulation.lines import LineMaker

fit = partial(fit, campaign="off")
"""What one record tells is tested."""

SEED = load_turbulence("fu-2022")
WIND_SPEED = 10.0
FALSE_ALARM = 5e-6  # of each count on each side: 24 counts are a false alarm in some 4000 seeds


def scan_at_sonic(*directions):
    """Beams that measure at the lidar, where the sonic is."""
    vectors = np.array(directions, dtype=float)
    n_beam = len(vectors)
    return Scan(
        "at the sonic",
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True),
        focus_distance=np.full(n_beam, 1e-9),
        beam_time=np.zeros(n_beam),
        scan_duration=1.0,
    )


def sonic_noise(scan, **changes):
    return theory_noise(scan, SEED, **{"wind_speed": WIND_SPEED, "sonic": True, **changes})


def matched(noise):
    return match_factor(noise.sonic_covariance[0, np.newaxis], noise.sonic_beam_covariance[0, np.newaxis])


def joint(noise, factor):
    """The covariance of g and ln y of one state."""
    across = factor.beam_covariance[0]
    return np.block([[factor.covariance[0], across], [across.T, np.log1p(noise.covariance[0])]])


def draw_records(noise, stress, rng, dof=np.inf):
    """Draw sonic's tensors and beam variances of records with these stresses from the joint model."""
    factor = matched(noise)
    whole = joint(noise, factor)
    drawn = rng.multivariate_normal(np.zeros(len(whole)), whole, len(stress), method="eigh")
    if np.isfinite(dof):
        drawn *= np.sqrt(dof / rng.chisquare(dof, (len(stress), 1)))  # one factor for the sonic and the beams
    log_variance = np.log(stress @ noise.gain[0].T) - 0.5 * np.diag(whole)[6:] + drawn[:, 6:]
    return factored_tensor(stress, factor.mean[0] + drawn[:, :6]), np.exp(log_variance)


def draws_of(result):
    """Draws of S, shape (n_record, 6, n)."""
    draws = result["posterior/stress"].transpose("record", "component", "chain", "draw").values
    return draws.reshape(*draws.shape[:2], -1)


def simulated_records(scan, n_record, seed):
    """Variances of the beams and tensors of a sonic at the lidar, in the same simulated records."""
    with_sonic = Scan(
        "with a sonic",
        np.concatenate([scan.line_of_sight, np.eye(3)]),
        focus_distance=np.append(scan.focus_distance, np.full(3, 1e-9)),
        beam_time=np.append(scan.beam_time, np.zeros(3)),
        scan_duration=scan.scan_duration,
    )
    maker = LineMaker(with_sonic, SEED, wind_speed=WIND_SPEED, n_sample=600)
    rng = np.random.default_rng(seed)
    variance, tensor = [], []
    for _ in range(n_record // 100):
        velocity = maker.make(100, rng)
        variance.append(velocity[:, :-3].var(axis=-1))
        wind = velocity[:, -3:] - velocity[:, -3:].mean(axis=-1, keepdims=True)
        tensor.append(pack_stress(wind @ wind.swapaxes(-1, -2) / wind.shape[-1]))
    return np.concatenate(variance), np.concatenate(tensor)


@pytest.fixture(scope="module")
def six_beams():
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    return scan, sonic_noise(scan)


class TestFactor:
    @pytest.mark.parametrize("wind_speed", [10.0, 2.0])
    def test_draws_have_the_moments_of_the_theory(self, wind_speed):
        """E[A Aᵀ] = 1, Cov[A Aᵀ] = K, Cov[A Aᵀ, y/E[y]] = D, each within 5 standard errors of independent draws."""
        scan = load_scan("4-beam")
        noise = sonic_noise(scan, wind_speed=wind_speed)
        n_draw = 400_000
        flat = np.tile([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], (n_draw, 1))  # R = 1, where T = S
        unit_gain = replace(noise, gain=np.tile([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], (scan.n_beam, 1)))
        tensor, variance = draw_records(unit_gain, flat, np.random.default_rng(1))
        off = np.concatenate([tensor - flat, variance - 1.0], axis=1)
        mean, measured = off.mean(axis=0), off.T @ off / n_draw
        assert np.all(np.abs(mean) < 5.0 * off.std(axis=0) / np.sqrt(n_draw))
        error = np.sqrt(((off**2).T @ off**2 / n_draw - measured**2) / n_draw)
        want = np.block(
            [
                [noise.sonic_covariance[0], noise.sonic_beam_covariance[0]],
                [noise.sonic_beam_covariance[0].T, noise.covariance[0]],
            ]
        )
        assert np.all(np.abs(measured - want) < 5.0 * error)

    def test_to_first_order_only_would_contradict_the_likelihood(self, six_beams):
        """Why g is matched to second order: K beside ln(1 + K) is no covariance."""
        _, noise = six_beams
        first = SonicFactor(np.zeros((1, 6)), noise.sonic_covariance[0, None], noise.sonic_beam_covariance[0, None])
        assert np.linalg.eigvalsh(joint(noise, first))[0] < -1e-4
        assert np.linalg.eigvalsh(joint(noise, matched(noise)))[0] > 0.0

    def test_product_is_that_of_dense_matrices(self):
        rng = np.random.default_rng(2)
        stress, numbers = WeakPrior().draw(50, rng), rng.normal(0.0, 0.5, (50, 6))
        root = np.linalg.cholesky(unpack_stress(stress))
        factor = np.zeros((50, 3, 3))
        factor[:, [0, 1, 2], [0, 1, 2]] = np.exp(0.5 * numbers[:, :3])
        factor[:, [1, 2, 2], [0, 0, 1]] = numbers[:, 3:]
        dense = root @ factor
        np.testing.assert_allclose(
            factored_tensor(stress, numbers), pack_stress(dense @ dense.swapaxes(-1, -2)), rtol=1e-10, atol=1e-12
        )

    def test_every_tensor_is_realizable(self):
        rng = np.random.default_rng(3)
        tensor = factored_tensor(WeakPrior().draw(2000, rng), rng.normal(0.0, 1.0, (2000, 6)))
        assert is_realizable(tensor).all()

    @pytest.mark.parametrize("stress", [[1.0, 0.25, 0.5, 0.5, 0.0, 0.0], [1.0, 0.25, 0.04, 0.5, -0.2, -0.1]])
    def test_a_singular_tensor_stays_singular(self, stress):
        tensor = factored_tensor(np.array(stress), np.array([0.1, -0.2, 0.1, 0.2, -0.1, 0.3]))
        assert np.isfinite(tensor).all()
        assert np.linalg.eigvalsh(unpack_stress(tensor))[0] == pytest.approx(0.0, abs=1e-12)

    def test_a_record_is_matched_alike_in_any_company(self, six_beams):
        _, noise = six_beams
        other = sonic_noise(six_beams[0], wind_speed=1.5)
        covariance = np.stack([noise.sonic_covariance[0], other.sonic_covariance[0]])
        across = np.stack([noise.sonic_beam_covariance[0], other.sonic_beam_covariance[0]])
        for inflation in (1.0, 1.4):
            together = match_factor(covariance, across, inflation=inflation)
            alone = match_factor(covariance[:1], across[:1], inflation=inflation)
            for name in ("mean", "covariance", "beam_covariance"):
                np.testing.assert_array_equal(getattr(together, name)[:1], getattr(alone, name))

    def test_inflation_widens_and_keeps_the_mean(self, six_beams):
        _, noise = six_beams
        factor = match_factor(noise.sonic_covariance[0, None], noise.sonic_beam_covariance[0, None], inflation=2.0)
        np.testing.assert_allclose(factor.covariance, 2.0 * matched(noise).covariance, rtol=1e-12)
        rng = np.random.default_rng(4)
        drawn = rng.multivariate_normal(factor.mean[0], factor.covariance[0], 200_000)
        flat = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        tensor = factored_tensor(np.tile(flat, (len(drawn), 1)), drawn)
        assert np.all(np.abs(tensor.mean(axis=0) - flat) < 5.0 * tensor.std(axis=0) / np.sqrt(len(drawn)))

    def test_too_much_scatter_is_refused(self):
        """E[A_vu²] = 2 leaves nothing for the diagonal, since E[vv] = 1."""
        with pytest.raises(InputError, match=r"stresses scatter too much for the target 'sonic', by 141 % from record"):
            match_factor(np.diag([0.1, 0.1, 0.1, 2.0, 0.1, 0.1])[None], np.zeros((1, 6, 1)))


class TestLaws:
    def test_a_centre_beam_under_frozen_turbulence_is_the_sonic(self):
        """A staring beam at the sonic: S_uu is the beam's variance in every draw, to the theory's own tolerance."""
        scan = load_scan("staring")
        noise = sonic_noise(scan, sonic_position=(-98.0, 0.0, 0.0))
        variance = np.array([[0.4], [1.2], [3.0]])
        result = fit(records_of(variance, scan), scan, noise=noise, target="sonic", seed=1)
        draws = draws_of(result)
        np.testing.assert_allclose(draws[:, 0], variance * np.ones(draws.shape[-1]), rtol=1e-3)
        assert np.all(draws[:, 1].std(axis=-1) > 0.1 * variance[:, 0])  # vv is not seen
        assert result.attrs["sonic_clipped"] < 1e-6

    @pytest.mark.parametrize("direction", [(-1.0, 0.36, 0.0), (-1.0, 0.0, 0.3), (-1.0, 0.3, -0.3)])
    def test_an_inclined_beam_at_the_sonic_is_nearly_its_projection(self, direction):
        """Not exactly: log-normal numbers have the right moments at the flow's own R; R of the draws is another."""
        scan = scan_at_sonic(direction)
        variance = np.array([[1.2]])
        result = fit(records_of(variance, scan), scan, noise=sonic_noise(scan), target="sonic", seed=1)
        seen = design_matrix(scan)[0] @ draws_of(result)[0]
        of_record = (
            design_matrix(scan)[0] @ draws_of(fit(records_of(variance, scan), scan, noise=sonic_noise(scan), seed=1))[0]
        )
        assert seen.mean() == pytest.approx(1.2, rel=0.03)
        assert seen.std() < 0.25 * of_record.std()
        assert 0.0 < result.attrs["sonic_clipped"] < CLIP_LIMIT

    def test_a_sonic_far_away_scatters_by_itself(self, six_beams):
        """Nothing is known of it but R: ln S_uu is ln R_uu and an independent ln(1 + K)."""
        scan, _ = six_beams
        noise = sonic_noise(scan, sonic_position=(0.0, 5000.0, 0.0))
        stress = np.array([[1.2, 0.8, 0.5, 0.0, -0.4, 0.0]])
        records = records_of(stress @ design_matrix(scan).T, scan)
        near = {"scan": scan, "noise": noise, "seed": 1, "target_ess": 8000}
        expected, sonic = (np.log(draws_of(fit(records, target=t, **near))[0, 0]) for t in ("record", "sonic"))
        added = np.log1p(noise.sonic_covariance[0, 0, 0])
        error = np.sqrt(2.0 / 8000)  # of a variance, relatively
        assert sonic.var() == pytest.approx(expected.var() + added, rel=5.0 * error)
        assert sonic.mean() == pytest.approx(expected.mean() - 0.5 * added, abs=5.0 * np.sqrt(sonic.var() / 8000))

    def test_a_record_has_the_same_posterior_alone_and_in_company(self, six_beams):
        scan, noise = six_beams
        _, variance = draw_records(noise, WeakPrior().draw(5, np.random.default_rng(5)), np.random.default_rng(6))
        records = records_of(variance, scan)
        together = fit(records, scan, noise=noise, target="sonic", seed=3)["posterior/stress"]
        alone = fit(records.isel(record=[3]), scan, noise=noise, target="sonic", seed=3)["posterior/stress"]
        np.testing.assert_array_equal(alone.values[:, :, 0], together.values[:, :, 3])

    def test_student_noise_of_many_degrees_is_normal_noise(self, six_beams):
        scan, noise = six_beams
        records = records_of(np.array([[1.2, 0.8, 0.5, 0.0, -0.4, 0.0]]) @ design_matrix(scan).T, scan)
        sd = [
            draws_of(
                fit(records, scan, noise=noise, target="sonic", seed=1, target_ess=6000, nuisances=Nuisances(**how))
            )[0].std(axis=-1)
            for how in ({}, {"inflation_dof": 1e7})
        ]
        np.testing.assert_allclose(sd[1], sd[0], rtol=5.0 * np.sqrt(2.0 * 0.5 / 6000) * 2.0)  # tails are not normal

    def test_a_length_scale_that_is_hardly_uncertain_changes_nothing(self):
        scan = load_scan("staring")
        bank = refined_noise(
            scan, SEED, wind_speed=[WIND_SPEED], length_scale=[40.0, 100.0], cache=False, sonic=True, tolerance=0.02
        )
        records = records_of(np.array([[1.2]]), scan)
        sd = [
            draws_of(
                fit(
                    records.assign(length_scale=("record", [61.0])),
                    scan,
                    noise=bank,
                    target="sonic",
                    seed=1,
                    target_ess=4000,
                    nuisances=Nuisances(length_scale_log_sd=width),
                )
            )[0, 0].std()
            for width in (0.0, 1e-3)
        ]
        assert sd[1] == pytest.approx(sd[0], rel=0.1)


class TestCoverage:
    @pytest.mark.parametrize(
        ("name", "sampler", "dof"),
        [
            ("6-beam", "emcee", np.inf),
            ("4-beam", "emcee", np.inf),
            ("6-beam", "direct", np.inf),
            ("4-beam", "emcee", 5.0),
        ],
    )
    def test_of_the_exact_joint_model(self, name, sampler, dof):
        """R from the prior, sonic and beams from their joint distribution: intervals hold S as often as they say."""
        scan, n_record = load_scan(name), 300
        noise = sonic_noise(scan)
        rng = np.random.default_rng(21)
        tensor, variance = draw_records(noise, WeakPrior().draw(n_record, rng), rng, dof)
        how = {"sampler": sampler, "nuisances": Nuisances(inflation_dof=dof), "seed": 1, "target_ess": 400}
        draws = draws_of(fit(records_of(variance, scan), scan, noise=noise, target="sonic", **how))
        rank = (draws < tensor[:, :, None]).mean(axis=-1)
        for level in (0.5, 0.8, 0.9, 0.95):
            inside = np.count_nonzero(np.abs(rank - 0.5) < 0.5 * level, axis=0)
            assert np.all(inside >= stats.binom.ppf(FALSE_ALARM, n_record, level))
            assert np.all(inside <= stats.binom.ppf(1.0 - FALSE_ALARM, n_record, level))
        for index in range(6):
            assert stats.kstest(rank[:, index], "uniform").pvalue > 1e-4

    @pytest.mark.parametrize("change", ["record", "unseen"])
    def test_it_has_power(self, change):
        """The tensor of the record, or a sonic that the beams do not see, are far too wide for S_uu."""
        scan, n_record = load_scan("6-beam"), 200
        noise = sonic_noise(scan)
        rng = np.random.default_rng(22)
        tensor, variance = draw_records(noise, WeakPrior().draw(n_record, rng), rng)
        unseen = replace(noise, sonic_beam_covariance=np.zeros((6, scan.n_beam)))
        how = {"noise": noise} if change == "record" else {"noise": unseen, "target": "sonic"}
        draws = draws_of(fit(records_of(variance, scan), scan, seed=1, target_ess=200, **how))
        rank = (draws < tensor[:, :, None]).mean(axis=-1)
        inside = np.count_nonzero(np.abs(rank[:, 0] - 0.5) < 0.25)
        assert inside > stats.binom.ppf(1.0 - 1e-6, n_record, 0.5)

    @pytest.mark.parametrize(("name", "angle", "narrower"), [("6-beam", 45.0, 0.3), ("4-beam", 15.0, 0.6)])
    def test_of_simulated_records(self, name, angle, narrower):
        """The seed's flow on lines, the sonic's own samples beside the beams': real S, no log-normal distribution.

        One flow is not the prior, so that only uu, which the prior hardly moves, must be near the nominal share: within
        0.08, of which chance is 0.05 (two standard errors of 400 records at 50 %). The others must not be too narrow.
        """
        scan = load_scan(name, opening_angle_deg=angle)
        variance, tensor = simulated_records(scan, 400, seed=23)
        records, noise = records_of(variance, scan), sonic_noise(scan)
        draws = draws_of(fit(records, scan, noise=noise, target="sonic", seed=1, target_ess=400))
        rank = (draws < tensor[:, :, None]).mean(axis=-1)
        for level in (0.5, 0.8, 0.9, 0.95):
            share = np.mean(np.abs(rank - 0.5) < 0.5 * level, axis=0)
            assert share[0] == pytest.approx(level, abs=0.08)
            assert np.all(share > level - 0.08)
        of_record = draws_of(fit(records, scan, noise=noise, seed=1, target_ess=400))
        assert draws[:, 0].std(axis=-1).mean() < narrower * of_record[:, 0].std(axis=-1).mean()
        error = draws[:, 0].mean(axis=-1) - tensor[:, 0]
        assert abs(error.mean()) < 0.03 * tensor[:, 0].mean()
        assert error.std() < 0.7 * tensor[:, 0].std()  # it follows the sonic from record to record


class TestNoise:
    def test_a_model_with_a_sonic_is_a_noise_model(self, tmp_path, six_beams):
        scan, noise = six_beams
        check_noise(noise, scan, tmp_path)
        again = load_noise(tmp_path / "noise.nc")
        np.testing.assert_array_equal(again.sonic_covariance[0], noise.sonic_covariance[0])
        np.testing.assert_array_equal(again.sonic_beam_covariance[0], noise.sonic_beam_covariance[0])
        np.testing.assert_array_equal(
            noise.select([4, 1]).sonic_beam_covariance, noise.sonic_beam_covariance[:, :, [4, 1]]
        )
        assert noise.details["sonic_position"] == [0.0, 0.0, 0.0]

    def test_off_costs_and_changes_nothing(self, tmp_path, six_beams):
        scan, noise = six_beams
        plain = theory_noise(scan, SEED, wind_speed=WIND_SPEED)
        assert not plain.has_sonic
        np.testing.assert_array_equal(plain.covariance[0], noise.covariance[0])
        plain.save(tmp_path / "plain.nc")
        assert not load_noise(tmp_path / "plain.nc").has_sonic
        assert "sonic_covariance" not in plain.to_dataset()

    def test_the_dissipation_has_no_influence(self, six_beams):
        scan, noise = six_beams
        other = theory_noise(scan, replace(SEED, dissipation=0.2), wind_speed=WIND_SPEED, sonic=True)
        np.testing.assert_allclose(other.sonic_covariance[0], noise.sonic_covariance[0], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            other.sonic_beam_covariance[0], noise.sonic_beam_covariance[0], rtol=1e-9, atol=1e-12
        )

    @pytest.mark.parametrize("name", ["6-beam", "51-beam"])
    def test_joint_covariances_are_positive_semi_definite(self, name):
        assert np.linalg.eigvalsh(sonic_noise(load_scan(name)).joint_covariance[0])[0] > 0.0

    def test_a_bank_is_interpolated(self, tmp_path):
        scan = load_scan("4-beam")
        bank = refined_noise(scan, SEED, wind_speed=[6.0, 14.0], yaw_deg=[0.0, 20.0], cache=tmp_path, sonic=True)
        check_noise(bank, scan, tmp_path)
        assert bank.interpolation_error < 0.01
        speed, yaw = 8.3, np.deg2rad(13.0)
        between = bank.sonic_for_records([speed, speed], [yaw, yaw])
        truth = sonic_noise(scan, wind_speed=speed, yaw=yaw)
        size = np.linalg.norm(truth.joint_covariance[0])
        assert np.linalg.norm(between.covariance[0] - truth.sonic_covariance[0]) < 0.01 * size
        assert np.linalg.norm(between.beam_covariance[0] - truth.sonic_beam_covariance[0]) < 0.01 * size
        assert between.state.tolist() == [0, 0]
        again = refined_noise(scan, SEED, wind_speed=[6.0, 14.0], yaw_deg=[0.0, 20.0], cache=tmp_path, sonic=True)
        assert again.has_sonic
        without = refined_noise(scan, SEED, wind_speed=[6.0, 14.0], yaw_deg=[0.0, 20.0], cache=tmp_path)
        assert not without.has_sonic

    def test_a_bank_of_several_flows_keeps_them_at_one(self):
        scan = load_scan("staring")
        bank = refined_noise(
            scan, SEED, wind_speed=[8.0, 12.0], length_scale=[40.0, 90.0], cache=False, sonic=True, tolerance=0.02
        )
        one = bank.at_turbulence(61.0, 3.2)
        for wind_speed, covariance in zip(one.wind_speed, one.sonic_covariance, strict=True):
            truth = sonic_noise(scan, wind_speed=float(wind_speed))
            np.testing.assert_allclose(covariance[0, 0], truth.sonic_covariance[0, 0, 0], rtol=0.02)

    def test_calibrate_keeps_the_two_apart_in_its_cache(self, tmp_path):
        scan = load_scan("staring")
        how = {"wind_speed": 9.0, "cache": tmp_path}
        assert not calibrate(scan, SEED, **how).has_sonic
        first = calibrate(scan, SEED, sonic=True, **how)
        again = calibrate(scan, SEED, sonic=True, **how)
        np.testing.assert_array_equal(first.joint_covariance[0], again.joint_covariance[0])
        assert not calibrate(scan, SEED, **how).has_sonic

    def test_records_get_it_when_asked(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path))
        scan = load_scan("staring")
        records = records_of(np.array([[1.0], [1.5]]), scan)
        noise = noise_for_records(records, scan, SEED, sonic=True)
        assert noise.has_sonic
        assert noise.in_words().endswith("; with the moments of a sonic")
        records["wind_speed"][:] = [8.0, 9.0]
        bank = noise_for_records(records, scan, SEED, sonic=True)  # the shipped bank has none
        assert bank.has_sonic

    def test_the_whole_job(self, tmp_path, monkeypatch):
        monkeypatch.setenv("BAYES_RS_CACHE", str(tmp_path / "cache"))
        scan = load_scan("staring")
        records = records_of(np.array([[1.0], [1.5]]), scan)
        found = fit(records, scan, output=tmp_path / "out", seed=1, target="sonic", target_ess=200)
        assert found.n_fitted == 2
        assert found.attrs["target"] == "sonic"


class TestRefusals:
    @pytest.fixture
    def scene(self, six_beams):
        scan, noise = six_beams
        _, variance = draw_records(noise, WeakPrior().draw(2, np.random.default_rng(7)), np.random.default_rng(8))
        return records_of(variance, scan), scan, noise

    def test_noise_without_a_sonic(self, scene):
        records, scan, noise = scene
        plain = replace(noise, sonic_covariance=None, sonic_beam_covariance=None)
        with pytest.raises(
            InputError, match=r"holds no moments with a sonic, .* make it with noise.calibrate\(..., sonic=True\)"
        ):
            fit(records, scan, noise=plain, target="sonic", seed=1)

    def test_another_likelihood(self, scene, monkeypatch):
        records, scan, noise = scene
        monkeypatch.setitem(LIKELIHOODS, "gamma", OTHER_LIKELIHOODS["gamma"])
        with pytest.raises(InputError, match="Invalid likelihood 'gamma' for the target 'sonic'"):
            fit(records, scan, noise=noise, target="sonic", likelihood="gamma", seed=1)

    def test_moments_that_contradict_each_other(self, scene, caplog):
        records, scan, noise = scene
        wrong = replace(noise, sonic_beam_covariance=1.2 * noise.sonic_beam_covariance[0])
        found = fit(records, scan, noise=wrong, target="sonic", seed=1)
        assert found.flags["likelihood_failed"] == 2
        assert found.n_fitted == 0
        (said,) = caplog.messages
        assert said.startswith("Of records 0 to 1, 2 cannot be fitted: ")

    def test_boxes(self, scene):
        _, scan, _ = scene
        with pytest.raises(InputError, match="only method='theory' has the joint moments"):
            calibrate(scan, SEED, wind_speed=10.0, method="boxes", sonic=True)

    def test_half_of_the_moments(self, scene):
        _, _, noise = scene
        with pytest.raises(InputError, match="give both, sonic_covariance and sonic_beam_covariance, or none"):
            replace(noise, sonic_covariance=None)

    @pytest.mark.parametrize("shape", [(6, 5), (5, 6)])
    def test_a_wrong_shape(self, scene, shape):
        _, _, noise = scene
        with pytest.raises(InputError, match="sonic_beam_covariance in noise of scan '6-beam'"):
            replace(noise, sonic_beam_covariance=np.zeros(shape))
