"""Scatter of variances: what wandering strength does, what the blocks tell of it, and what it does to the noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import xarray as xr

import bayes_rs as brs
from bayes_rs.fits.block_states import BlockStates
from bayes_rs.fits.variance_scatter import averaged, excess_of_blocks, learn_scatter, record_scatter
from bayes_rs.likelihoods.reduced_noise import ReducedRecordNoise
from bayes_rs.likelihoods.scattered import scattered, scattered_reduced, scattered_sonic
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.record_noise import SonicNoise
from bayes_rs.records.block_statistics import BLOCKS
from bayes_rs.turbulence.mann import MannTurbulence

DURATION = 600.0
SIGMAS = 4.0
FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="test")


def strength(n_record, depth, time_scale, rng, n_step=480):
    """The strength exp(√D g − D/2) over records, (n_record, n_step)."""
    keep = np.exp(-DURATION / n_step / time_scale)
    shock = rng.standard_normal((n_record, n_step))
    found = shock.copy()
    for step in range(1, n_step):
        found[:, step] = keep * found[:, step - 1] + np.sqrt(1.0 - keep**2) * shock[:, step]
    return np.exp(np.sqrt(depth) * found - 0.5 * depth)


class TestWanderingStrength:
    @pytest.mark.parametrize("time_scale", [20.0, 100.0, 640.0])
    def test_mean_of_a_process_by_quadrature(self, time_scale):
        of_lag, _ = scipy.integrate.quad(lambda x: 2.0 * (1.0 - x) * np.exp(-x * DURATION / time_scale), 0.0, 1.0)
        assert averaged(DURATION, time_scale) == pytest.approx(of_lag, rel=1e-9)

    def test_limits_of_the_mean(self):
        assert averaged(1e-3, 100.0) == pytest.approx(1.0, rel=1e-4)
        assert averaged(1e6, 100.0) == pytest.approx(2.0 * 100.0 / 1e6, rel=1e-3)

    @pytest.mark.parametrize("time_scale", [20.0, 100.0, 640.0])
    def test_scatter_of_records_by_quadrature(self, time_scale):
        def expected(depth):
            return scipy.integrate.quad(
                lambda x: 2.0 * (1.0 - x) * np.expm1(depth * np.exp(-x * DURATION / time_scale)), 0.0, 1.0
            )[0]

        depths = np.array([0.0, 1e-3, 0.25, 1.0])
        found = record_scatter(depths, DURATION, time_scale)
        np.testing.assert_allclose(found, [expected(depth) for depth in depths], rtol=1e-6, atol=1e-15)
        assert found[1] == pytest.approx(1e-3 * averaged(DURATION, time_scale), rel=1e-3)

    @pytest.mark.parametrize(("depth", "time_scale"), [(0.25, 100.0), (0.64, 100.0)])
    def test_against_simulated_strength(self, depth, time_scale):
        of_air = strength(4000, depth, time_scale, np.random.default_rng(3))
        mean = of_air.mean(axis=1)
        squares = (mean - 1.0) ** 2
        found = float(record_scatter(np.array([depth]), DURATION, time_scale)[0])
        assert abs(squares.mean() - found) < SIGMAS * squares.std() / np.sqrt(len(mean))
        for column, number in enumerate(BLOCKS):
            blocks = np.log(of_air.reshape(len(of_air), number, -1).mean(axis=-1)).var(axis=-1, ddof=1)
            expected = depth * excess_of_blocks(DURATION, time_scale)[column]
            # to first order in the depth
            assert blocks.mean() == pytest.approx(expected, rel=0.12)


def states_of(expected, n_record, n_beam=6):
    """States whose theory is one of `expected` scatters, (2, len(BLOCKS))."""
    pattern = np.full(n_record, (1 << n_beam) - 1)
    states = BlockStates(None, FLOW, DURATION, pattern, pattern * 0, pattern * 0, {0: np.ones(n_record)})
    theory = SimpleNamespace(scatter=expected[0], scatter_of_beams=expected[1])
    return SimpleNamespace(groups=states.groups, theory=lambda _: theory, duration=DURATION)


EXPECTED = np.array([[0.03, 0.035, 0.04], [0.1, 0.15, 0.2]])


def drawn(depth, time_scale, n_record, rng, *, shared=1.0, n_beam=6):
    """Records whose blocks scatter as in air of such a strength: shared by the beams, or of each by itself."""
    of_air = strength(n_record, depth, time_scale, rng) if depth else np.ones((n_record, 480))
    of_beam = [strength(n_record, depth, time_scale, rng) if shared == 0.0 and depth else of_air for _ in range(n_beam)]
    whole, beams = np.empty((n_record, len(BLOCKS))), np.empty((n_record, len(BLOCKS)))
    for column, number in enumerate(BLOCKS):
        both = [one.reshape(n_record, number, -1).mean(axis=-1) for one in of_beam]
        common = np.sqrt(EXPECTED[0, column]) * rng.standard_normal((n_record, number))
        own = np.sqrt(EXPECTED[1, column] - EXPECTED[0, column]) * rng.standard_normal((n_beam, n_record, number))
        logs = np.log(np.mean(both, axis=0)) + common
        whole[:, column] = logs.var(axis=-1, ddof=1)
        beams[:, column] = np.mean(
            [(np.log(one) + common + each).var(axis=-1, ddof=1) for one, each in zip(both, own, strict=True)], axis=0
        )
    return xr.Dataset(
        {"block_scatter": (("record", "blocks"), whole), "block_scatter_of_beams": (("record", "blocks"), beams)}
    )


class TestLearning:
    @pytest.mark.parametrize(("depth", "time_scale"), [(0.25, 100.0), (0.64, 100.0), (0.4, 40.0)])
    def test_depth_and_time_scale_are_found(self, depth, time_scale):
        records = drawn(depth, time_scale, 300, np.random.default_rng(4))
        found = learn_scatter(records, states_of(EXPECTED, 300))
        truth = float(record_scatter(np.array([depth]), DURATION, time_scale)[0])
        # from one time scale to the next in reach of three hundred records v changes by a third
        assert 0.8 * truth < found.common.mean() < 1.5 * truth
        assert found.time_scale == pytest.approx(time_scale, rel=0.5)
        assert found.shared > 0.9

    @pytest.mark.parametrize(("n_record", "most"), [(1, 0.01), (6, 0.008), (100, 0.002)])
    def test_gaussian_air_pays_next_to_nothing(self, n_record, most):
        """The mean over forty campaigns of what is added to K, beside a K of 0.05."""
        rng = np.random.default_rng(5)
        states = states_of(EXPECTED, n_record)
        added = [learn_scatter(drawn(0.0, 100.0, n_record, rng), states).common.mean() for _ in range(40)]
        assert np.mean(added) < most

    def test_a_strength_of_each_beam_is_not_shared(self):
        records = drawn(0.5, 100.0, 300, np.random.default_rng(6), shared=0.0)
        found = learn_scatter(records, states_of(EXPECTED, 300))
        assert found.shared < 0.3
        np.testing.assert_allclose(found.common, found.shared * (found.common + found.own))

    def test_quiet_and_restless_records_are_told_apart(self):
        rng = np.random.default_rng(7)
        records = xr.concat([drawn(0.0, 100.0, 150, rng), drawn(0.64, 100.0, 150, rng)], dim="record")
        found = learn_scatter(records, states_of(EXPECTED, 300))
        assert found.common[150:].mean() > 10.0 * found.common[:150].mean()

    def test_records_that_do_not_tell_get_what_the_others_say(self):
        records = drawn(0.5, 100.0, 100, np.random.default_rng(8))
        records["block_scatter"].values[3] = np.nan
        out = np.zeros(100, dtype=bool)
        out[4] = True
        found = learn_scatter(records, states_of(EXPECTED, 100), leave_out=out)
        assert found.n_record == 98
        assert found.common[3] == found.common[4]
        assert found.common[3] == pytest.approx(np.delete(found.common, [3, 4]).mean(), rel=0.1)

    def test_no_record_tells(self):
        records = drawn(0.5, 100.0, 3, np.random.default_rng(9))
        records["block_scatter"].values[:] = np.nan
        found = learn_scatter(records, states_of(EXPECTED, 3))
        assert found.n_record == 0
        np.testing.assert_array_equal(found.common, 0.0)


@pytest.fixture(scope="module")
def noise():
    found = theory_noise("6-beam", FLOW, wind_speed=10.0, sonic=True)
    return found, found.for_records([10.0, 10.0], [0.0, 0.0])


class TestNoise:
    SCATTER = np.array([[0.2, 0.1], [0.0, 0.0]])

    def test_moments_of_the_product(self, noise):
        _, at = noise
        found = scattered(at, self.SCATTER)
        rng = np.random.default_rng(1)
        root = np.linalg.cholesky(np.log1p(at.covariance[0]))
        y = np.exp(rng.standard_normal((200_000, 6)) @ root.T - 0.5 * np.sum(root**2, axis=1))
        shape = 1.0 / self.SCATTER[0]
        y *= rng.gamma(shape[0], 1.0 / shape[0], (200_000, 1)) * rng.gamma(shape[1], 1.0 / shape[1], (200_000, 6))
        np.testing.assert_allclose(np.cov(y, rowvar=False), found.covariance[0], rtol=0.05)
        np.testing.assert_allclose(found.covariance[1], at.covariance[1], rtol=1e-12)

    def test_reduced_noise_is_the_reduction_of_the_whole(self, noise):
        _, at = noise
        left = np.linalg.qr(np.random.default_rng(2).standard_normal((6, 3)))[0]
        logs = np.log1p(at.covariance)
        reduced = ReducedRecordNoise(at.gain, at.bias, left.T @ logs @ left, np.einsum("rbb->rb", logs), at.outside)
        found = scattered_reduced(reduced, left, self.SCATTER)
        whole = np.log1p(scattered(at, self.SCATTER).covariance)
        np.testing.assert_allclose(found.covariance, left.T @ whole @ left, rtol=1e-9)
        np.testing.assert_allclose(found.log_variance, np.einsum("rbb->rb", whole), rtol=1e-9)

    def test_a_sonic_shares_what_all_beams_share(self, noise):
        """With a factor m of all: Cov[m S] and Cov[m S, m y], exactly."""
        noise, at = noise
        sonic = noise.sonic_for_records([10.0, 10.0], [0.0, 0.0])
        found = scattered_sonic(sonic, self.SCATTER)
        rng, n = np.random.default_rng(3), 400_000
        joint = np.block(
            [[sonic.covariance[0], sonic.beam_covariance[0]], [sonic.beam_covariance[0].T, at.covariance[0]]]
        )
        values, vectors = np.linalg.eigh(joint)
        mean = np.r_[1.0, 1.0, 1.0, 0.0, 0.0, 0.0, np.ones(6)]
        both = mean + rng.standard_normal((n, 12)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        both *= rng.gamma(5.0, 0.2, (n, 1))
        moments = np.cov(both, rowvar=False)
        np.testing.assert_allclose(found.covariance[0], moments[:6, :6], atol=0.01)
        np.testing.assert_allclose(found.beam_covariance[0], moments[:6, 6:], atol=0.01)
        assert isinstance(found, SonicNoise)
        np.testing.assert_allclose(found.covariance[1], sonic.covariance[1], rtol=1e-12)


class TestFit:
    @pytest.mark.parametrize("name", ["6-beam", "50-beam"])
    def test_scatter_widens_intervals_and_theory_leaves_them(self, name):
        scan = brs.load_scan(name)
        noise = Noise.join([theory_noise(scan, FLOW, wind_speed=speed) for speed in (9.0, 11.0)])  # a net
        variance = np.tile(scan.level_direction[:, 0] ** 2, (2, 1))
        plain = xr.Dataset(
            {
                "variance": (("record", "beam"), variance),
                "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.uint8)),
                "wind_speed": ("record", [10.0, 10.0]),
                "yaw": ("record", [0.0, 0.0]),
            },
            coords={"beam": scan.beam},
        )
        wide = plain.assign(variance_scatter=("record", [0.3, 0.0]), variance_scatter_of_beams=("record", [0.0, 0.0]))

        def widths(records, **options):
            found = brs.fit(records, scan, noise=noise, seed=1, draws="none", **options).summary()
            uu = found[found["stress"] == "uu"]
            return (uu["high"] - uu["low"]).to_numpy()

        with_it, without = widths(wide), widths(wide, scatter="theory")
        assert with_it[0] > 1.5 * without[0]
        assert with_it[1] == pytest.approx(without[1], rel=1e-6)
        np.testing.assert_array_equal(without, widths(plain))

    def test_records_that_wander_are_told(self):
        scan = brs.load_scan("2-beam")
        series = brs.simulate(scan, FLOW, wind_speed=10.0, n_records=60, seed=2)
        order = series["time"].values.astype("datetime64[ns]").astype(np.int64)
        step = ((order - order.min()) // 1_250_000_000).astype(int)
        of_air = strength(60, 0.64, 100.0, np.random.default_rng(3)).ravel()
        along = dict(zip(scan.beam.tolist(), scan.level_direction[:, 0].tolist(), strict=True))
        mean = 10.0 * np.array([along[beam] for beam in series["beam"].values.tolist()])
        wander = series.assign(radial_velocity=mean + (series["radial_velocity"] - mean) * np.sqrt(of_air[step]))
        noise = theory_noise(scan, FLOW, wind_speed=10.0)
        lines = []
        found = {}
        for name, one in (("calm", series), ("wandering", wander)):
            records = brs.make_records(one, scan)
            options = {"seed": 1, "target_ess": 100, "sampler": "direct", "campaign": "off", "draws": "none"}
            fit = brs.fit(records, scan, noise=noise, say=lines.append, **options)
            found[name] = fit.records["variance_scatter"].values
        assert found["calm"].mean() < 0.01
        assert 0.1 < found["wandering"].mean() < 0.4
        assert sum(line.startswith("scatter of the variances beyond Gaussian air") for line in lines) == 2


def test_an_unknown_scatter_is_refused():
    with pytest.raises(brs.errors.InputError, match="scatter"):
        brs.FitOptions(scatter="none")
    assert replace(brs.FitOptions(), scatter="theory").scatter == "theory"
