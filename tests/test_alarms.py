"""Beams that disagree: laws of the scores, their level, and that faults are found and named."""

import json

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import binom

import bayes_rs as brs
from bayes_rs.alarms.beam_check import LEVEL, Block, check_beams
from bayes_rs.alarms.means import TILT_SD, WIND, expected_means, wind_columns
from bayes_rs.alarms.patterns import beam_patterns, independent_patterns, largest_tail, score_patterns
from bayes_rs.alarms.variances import ANY_AIR, FLOOR, Expected, expected_variances
from bayes_rs.alarms.words import CheckWords, beam_words, shift_words
from bayes_rs.fits.flags import FLAGS
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import tilt_matrix

ROUNDING = 1e-9
WIDE = "6-beam@opening_angle_deg=45,focus_distance=52"


def positive(n: int, rng: np.random.Generator) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.3 * np.eye(n)


def square(residual: np.ndarray, covariance: np.ndarray) -> float:
    return float(residual @ np.linalg.solve(covariance, residual))


@pytest.fixture(scope="module")
def scores():
    """Scores of random data, with a beam that the second record does not use."""
    rng = np.random.default_rng(3)
    patterns = beam_patterns(brs.load_scan("6-beam").beam_direction)
    covariance = np.stack([positive(6, rng), positive(6, rng)])
    used = np.ones((2, 6), dtype=bool)
    used[1, 4] = False
    residual = np.where(used, rng.standard_normal((2, 6)), 0.0)
    datum = rng.standard_normal((2, 6))
    return patterns, covariance, used, residual, datum, score_patterns(residual, covariance, used, patterns, datum)


class TestScores:
    def test_a_beam_left_out_takes_its_score_squared_from_chi_square(self, scores):
        _, covariance, used, residual, _, found = scores
        for record in range(2):
            for beam in np.flatnonzero(used[record]):
                others = np.flatnonzero(used[record] & (np.arange(6) != beam))
                without = square(residual[record, others], covariance[record][np.ix_(others, others)])
                assert found.square[record] - found.score[record, beam] ** 2 == pytest.approx(without, rel=ROUNDING)

    def test_a_beams_score_is_its_distance_from_what_the_others_predict(self, scores):
        _, covariance, _, residual, _, found = scores
        others = [0, 1, 3, 4, 5]
        across = covariance[0][2, others]
        weight = np.linalg.solve(covariance[0][np.ix_(others, others)], across)
        away = residual[0, 2] - weight @ residual[0, others]
        assert found.shift[0, 2] == pytest.approx(away, rel=ROUNDING)
        assert found.score[0, 2] == pytest.approx(away / np.sqrt(covariance[0][2, 2] - weight @ across), rel=ROUNDING)

    def test_the_shift_of_a_sector_is_that_of_least_squares(self, scores):
        patterns, covariance, _, residual, _, found = scores
        sector = 6 + 2
        shift = patterns.matrix[sector]
        best = minimize(lambda s: square(residual[0] - s[0] * shift, covariance[0]), [0.0], tol=1e-12)
        assert found.shift[0, sector] == pytest.approx(best.x[0], abs=1e-5)
        assert found.square[0] - found.score[0, sector] ** 2 == pytest.approx(best.fun, rel=1e-6)

    def test_an_exchange_is_that_of_the_data(self, scores):
        _, covariance, _, residual, datum, found = scores
        moved = residual[0].copy()
        moved[1] += datum[0, 4] - datum[0, 1]
        moved[4] += datum[0, 1] - datum[0, 4]
        fall = square(residual[0], covariance[0]) - square(moved, covariance[0])
        assert found.swap[0, 1, 4] == pytest.approx(fall, rel=1e-8)
        assert found.swap[1, 1, 4] == -np.inf

    def test_the_level_is_that_asked_for(self):
        """Of normal data, so many have so large a score by chance: 2000 draws, four standard deviations."""
        scan = brs.load_scan("50-beam")
        patterns = beam_patterns(scan.beam_direction)
        close = 0.1 * np.exp(-np.abs(np.subtract.outer(np.arange(50), np.arange(50))) / 5.0) + FLOOR**2 * np.eye(50)
        draws = np.random.default_rng(4).multivariate_normal(np.zeros(50), close, 2000)
        found = score_patterns(
            draws, np.broadcast_to(close, (2000, 50, 50)), np.ones((2000, 50), bool), patterns, draws
        )
        count = independent_patterns(close, patterns)
        assert 50 < count < len(patterns)
        for level in (0.05, 0.01):
            share = np.mean(largest_tail(np.max(np.abs(found.score), axis=1), count) < level)
            assert abs(share - level) < 4.0 * binom.std(2000, level) / 2000 + 0.2 * level


class TestPatterns:
    def test_sectors_are_neighbours_around_the_cone(self):
        patterns = beam_patterns(brs.load_scan("50-beam").beam_direction)
        members = [tuple(patterns.members(k).tolist()) for k in range(len(patterns))]
        assert members[:50] == [(beam,) for beam in range(50)]
        assert (12, 13, 14, 15, 16) in members
        assert (0, 1, 49) in members
        assert len(set(members)) == len(members)

    def test_the_beam_on_the_axis_is_in_no_sector(self):
        scan = brs.load_scan("6-beam")
        patterns = beam_patterns(scan.beam_direction)
        assert patterns.matrix[6:, 5].sum() == 0
        assert len(patterns) == 11


def variance_case(n_record: int = 5, scan_name: str = "6-beam"):
    scan = brs.load_scan(scan_name)
    gain = np.broadcast_to(design_matrix(scan.beam_direction), (n_record, scan.n_beam, 6))
    near = np.exp(-np.linalg.norm(scan.beam_direction[:, None] - scan.beam_direction, axis=-1) / 0.5)
    size = np.linspace(0.1, 0.5, scan.n_beam)  # different for each beam: what all share is the flow's
    covariance = np.broadcast_to(np.log1p(near * size * size[:, None]), (n_record, scan.n_beam, scan.n_beam))
    place = (scan.beam_direction * scan.focus_distance[:, None])[:, 1:]
    return scan, gain, covariance, place


class TestVariances:
    def test_flow_of_every_kind_leaves_little(self):
        """χ² of variances that hold no noise is that of their flow alone: below the largest of 200 normal ones."""
        _, gain, covariance, place = variance_case(200)
        stress = ANY_AIR.draw(200, 1)
        stress /= stress[:, :1]
        variance = np.einsum("rbi,ri->rb", gain, stress)
        found = expected_variances(variance, np.ones(variance.shape, bool), gain, 0.0 * covariance, 0.0, place)
        assert np.quantile(np.abs(found.left), 0.95) < 0.05

    def test_the_residual_is_that_of_the_best_flow(self):
        """zᵀ V⁻¹ z is the least of the noise's χ² and the prior's: a general minimiser finds the same, to linearity."""
        scan, gain, covariance, place = variance_case()
        rng = np.random.default_rng(2)
        stress = np.array([2.0, 1.2, 0.7, 0.05, -0.2, 0.02])
        noise = rng.multivariate_normal(np.zeros(scan.n_beam), covariance[0], 5)
        variance = np.exp(np.log(gain @ stress) + noise - 0.5 * np.diag(covariance[0]))
        found = expected_variances(variance, np.ones(variance.shape, bool), gain, covariance, 0.0, place)

        def objective(theta: np.ndarray, record: int) -> float:
            model = np.log(gain[record] @ ANY_AIR.stress(theta[:6])) + place @ theta[6:] * 0.003
            away = np.log(variance[record]) + 0.5 * np.diag(covariance[0]) - model
            return square(away, covariance[0] + FLOOR**2 * np.eye(scan.n_beam)) + theta @ theta

        for record in range(5):
            best = minimize(objective, np.zeros(8), args=(record,), method="BFGS").fun
            own = square(found.residual[record], found.covariance()[record])
            assert own == pytest.approx(best, rel=0.02, abs=0.02)

    def test_size_does_not_matter(self):
        scan, gain, covariance, place = variance_case()
        variance = np.random.default_rng(5).uniform(0.5, 1.5, (5, scan.n_beam))
        small, large = (
            expected_variances(c * variance, np.ones(variance.shape, bool), gain, covariance, 0.0, place)
            for c in (0.1, 3.0)
        )
        each = [
            np.einsum("ra,rab,rb->r", f.residual, np.linalg.inv(f.covariance()), f.residual) for f in (small, large)
        ]
        # all of it but the size, whose prior is 20 wide in ln uu
        np.testing.assert_allclose(each[0], each[1], rtol=0.02, atol=0.02)

    def test_the_precision_is_the_inverse_of_the_covariance(self):
        """Of records with beams that are not used, and of such as are fitted again because a beam is far off."""
        scan, gain, covariance, place = variance_case()
        variance = np.random.default_rng(5).uniform(0.5, 1.5, (5, scan.n_beam))
        variance[3, 1] *= 300.0
        used = np.ones(variance.shape, bool)
        used[:2, 2] = False
        found = expected_variances(variance, used, gain, covariance, 0.0, place)
        assert np.abs(found.left[3, 1]) > 3.0
        np.testing.assert_allclose(found.precision, np.linalg.inv(found.covariance()), rtol=1e-9, atol=1e-9)
        datum = np.log(variance)
        own, known = (
            score_patterns(found.residual, found.covariance(), used, beam_patterns(scan.beam_direction), datum, one)
            for one in (None, found.precision)
        )
        for name in ("square", "score", "shift", "swap"):
            np.testing.assert_allclose(getattr(known, name), getattr(own, name), rtol=1e-8, atol=1e-8)

    def test_unused_beams_say_nothing(self):
        scan, gain, covariance, place = variance_case()
        variance = np.random.default_rng(5).uniform(0.5, 1.5, (5, scan.n_beam))
        used = np.ones(variance.shape, bool)
        used[:, 2] = False
        changed = variance.copy()
        changed[:, 2] = 1e-12
        one, other = (expected_variances(v, used, gain, covariance, 0.0, place) for v in (variance, changed))
        np.testing.assert_array_equal(one.residual, other.residual)
        assert (one.residual[:, 2] == 0.0).all()
        assert (one.slope[:, 2] == 0.0).all()


class TestMeans:
    def test_columns_are_what_a_wind_does(self):
        """The mean of a beam in a sheared wind, and of one that is tilted further, to first order."""
        scan = brs.load_scan("6-beam")
        columns, _ = wind_columns(scan.beam_direction, scan.focus_distance)
        point = scan.beam_direction * scan.focus_distance[:, None]
        wind = np.array([10.0, 1.0, 0.2])
        strain = np.array([[0.0, 0.005, 0.02], [0.0, 0.003, 0.01], [0.0, 0.0, 0.0]])
        want = np.einsum("bi,bi->b", scan.beam_direction, wind + point @ strain.T)
        along, across, up = columns[:, :3].T
        shears = columns[:, 3:7] @ np.array([0.02, 0.005, 0.01, 0.003])
        np.testing.assert_allclose(10.0 * along + across + 0.2 * up + shears, want, rtol=1e-12)
        angle = 1e-6
        turned = scan.beam_direction @ tilt_matrix(angle)
        slope = (turned - scan.beam_direction) @ [1.0, 0.0, 0.0] / angle
        np.testing.assert_allclose(columns[:, list(WIND).index("tilt")], slope, atol=1e-6)

    def test_a_steady_wind_leaves_nothing(self):
        scan = brs.load_scan("50-beam")
        columns, _ = wind_columns(scan.level_direction, scan.focus_distance)
        mean = (columns @ np.array([1.0, 0.1, 0.01, 0.002, 0.0005, 0.0005, 0.0, -0.03, 0.02]))[None] * 9.0
        noise = 1e-3 * np.eye(50)[None]
        used = np.ones((1, 50), bool)
        found = expected_means(mean, used, scan.level_direction, scan.focus_distance, np.array([9.0]), noise)
        assert np.abs(found.left).max() < 0.002

    @pytest.mark.parametrize(("name", "told"), [("4-beam-planes", True), ("50-beam", False)])
    def test_a_wrong_tilt_is_told_where_distances_differ(self, name, told):
        """At a single distance a tilt is the same as a shear, and nothing is said."""
        scan = brs.load_scan(name)
        rng = np.random.default_rng(7)
        columns, _ = wind_columns(scan.level_direction, scan.focus_distance)
        wind = np.zeros((30, len(WIND)))
        wind[:, 0], wind[:, 3], wind[:, -1] = 1.0, rng.normal(0.0015, 0.0005, 30), np.deg2rad(5.0)
        mean = wind @ columns.T + 0.005 * rng.standard_normal((30, scan.n_beam))
        noise = np.broadcast_to(1e-4 * np.eye(scan.n_beam), (30, scan.n_beam, scan.n_beam))
        used = np.ones(mean.shape, bool)
        expected = expected_means(mean, used, scan.level_direction, scan.focus_distance, np.ones(30), noise)
        block = Block(used, mean, expected)
        shape = (30, scan.n_beam)
        quiet = Expected(np.zeros(shape), np.zeros((*shape, 1)), noise + 0.02 * np.eye(scan.n_beam), np.zeros(shape))
        check = check_beams([(Block(used, np.zeros(shape), quiet), block)], beam_patterns(scan.beam_direction), 30)
        angle, sd = np.degrees(check.kinds["mean"].tilt)
        assert abs(angle - 5.0) < 3.0 * sd
        lines = [line for line in CheckWords(check, scan.beam, 61.0).of_all()[0] if "tilted by" in line]
        assert bool(lines) == told, (angle, sd)
        assert (sd > 2.0) == (not told)


@pytest.fixture(scope="module")
def days():
    """Records of good air, by scan."""
    return {
        name: brs.make_records(
            brs.simulate(name, "fu-2022", wind_speed=10.0, n_records=40, seed=2, shear=0.015), brs.load_scan(name)
        )
        for name in ("6-beam", "50-beam", WIDE)
    }


def told(records, name, **options):
    return brs.fit(records, name, seed=1, sampler="direct", draws="none", target_ess=50, campaign="off", **options)


class TestFit:
    @pytest.mark.parametrize("name", ["6-beam", "50-beam", WIDE])
    def test_good_air_is_good(self, days, name):
        fit = told(days[name], name)
        assert fit.flags["beams_disagree"] <= 1
        assert not [line for line in fit.remarks if "beams" in line and "flag" not in line]
        table = fit.table("posterior")
        assert table["misfit"].between(0.0, 6.0).all()
        assert table["beams_probability"].between(0.0, 1.0).all()

    def test_a_dead_beam_is_named(self, days):
        spoiled = days["6-beam"].copy(deep=True)
        spoiled["variance"][:, 3], spoiled["mean"][:, 3] = 0.002, 0.0
        fit = told(spoiled, "6-beam")
        assert fit.flags["beams_disagree"] == 40
        assert any(line.startswith("all records together: beam 3 looks dead") for line in fit.remarks)
        assert fit.table("posterior")["beams_words"].str.startswith("beam 3").mean() > 0.9

    def test_a_fault_of_half_the_records_does_not_hide_in_their_scatter(self, days):
        spoiled = days["6-beam"].copy(deep=True)
        spoiled["variance"][::2, 3] = 0.02
        found = told(spoiled, "6-beam").flag & FLAGS["beams_disagree"]
        assert np.count_nonzero(found[::2]) >= 15
        assert np.count_nonzero(found[1::2]) <= 1

    def test_a_wake_in_a_sector_is_named(self, days):
        """20 % less variance is beyond the power of one record, not of 40."""
        for factor, share in ((0.5, 0.9), (0.8, 0.0)):
            spoiled = days["50-beam"].copy(deep=True)
            spoiled["variance"][:, 12:17] *= factor
            fit = told(spoiled, "50-beam")
            assert fit.flags["beams_disagree"] >= 40 * share
            lines = [line for line in fit.remarks if line.startswith("all records together: beams 12 to 16")]
            assert len(lines) == 1, fit.remarks
            percent = int(lines[0].split(" have ")[1].split(" %")[0])
            assert abs(percent - 100 * (1 - factor)) <= 5
            assert "(sector 86° to 115°)" in lines[0]

    @pytest.mark.parametrize("pair", [(0, 2), (3, 0)])
    def test_exchanged_beams_are_named(self, days, pair):
        spoiled = days["6-beam"].copy(deep=True)
        for name in ("variance", "mean"):
            spoiled[name][:, list(pair)] = spoiled[name].values[:, list(pair[::-1])]
        remarks = told(spoiled, "6-beam").remarks
        first, second = sorted(pair)
        assert any(line == f"all records together: beams {first} and {second} look exchanged" for line in remarks)

    def test_records_without_means_are_looked_at_by_their_variances(self, days):
        spoiled = days["6-beam"].drop_vars("mean").copy(deep=True)
        spoiled["variance"][4, 5] *= 8.0
        fit = told(spoiled, "6-beam")
        assert np.flatnonzero(fit.flag & FLAGS["beams_disagree"]).tolist() == [4]
        assert fit.run["beams"]["tilt_deg"] is None

    def test_the_same_in_a_folder(self, days, tmp_path):
        spoiled = days["6-beam"].isel(record=slice(0, 12)).copy(deep=True)
        spoiled["variance"][3, 5] *= 8.0
        memory, folder = (told(spoiled, "6-beam", output=output) for output in (None, tmp_path / "fit"))
        for name in ("misfit", "beams_probability", "beams_words"):
            assert memory.table("posterior")[name].equals(folder.table("posterior")[name])
        assert json.loads((tmp_path / "fit/run.json").read_text())["beams"] == memory.run["beams"]
        assert memory.summary().query("record == 3")["flag"].str.contains("beams_disagree").all()

    def test_one_beam_agrees_with_itself(self):
        series = brs.simulate("staring", "fu-2022", wind_speed=10.0, n_records=12, seed=1)
        fit = told(brs.make_records(series, "staring"), "staring")
        assert fit.flags["beams_disagree"] == 0
        assert fit.table("posterior")["beams_probability"].isna().all()


class TestScatter:
    @pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
    def test_the_factor_is_that_of_the_noise(self, factor):
        """Normal residuals of so much more variance than the noise says; its interval holds the truth, widened by 2."""
        rng = np.random.default_rng(6)
        patterns = beam_patterns(brs.load_scan("50-beam").beam_direction)
        noise = 0.002 * np.eye(50) + FLOOR**2 * np.eye(50)
        slope = 0.5 * rng.standard_normal((50, 3))
        own = factor * 0.002 * np.eye(50)
        residual = rng.multivariate_normal(np.zeros(50), own, 100) + rng.standard_normal((100, 3)) @ slope.T
        each = [np.broadcast_to(one, (100, *one.shape)) for one in (slope, noise)]
        left = residual - residual @ np.linalg.pinv(slope).T @ slope.T
        expected = Expected(residual, *each, left)
        block = Block(np.ones((100, 50), bool), residual, expected)
        check = check_beams([(block, None)], patterns, 100)
        found, low, high = check.scatter
        assert low < found < high
        assert abs(found - factor) < 2.0 * (high - low), (found, factor)
        words, _ = CheckWords(check, np.arange(50), 61.0).of_all()
        assert bool([line for line in words if "scatter against each other" in line]) == (factor != 1.0)
        if factor == 2.0:
            assert check.kinds["variance"].excess > 1.2
        assert np.mean(check.probability < LEVEL) <= 0.06


class TestWords:
    @pytest.mark.parametrize(
        ("shift", "words"),
        [
            (np.log(0.6), "beam 3 has 40 % less variance than the others explain"),
            (np.log(1.5), "beam 3 has 50 % more variance than the others explain"),
            (np.log(3.1), "beam 3 has 3.1 times the variance that the others explain"),
            (np.log(0.05), "beam 3 looks dead: 5 % of the variance that the others explain"),
        ],
    )
    def test_of_a_beam(self, shift, words):
        assert shift_words("variance", [3], (90.0, 90.0), float(shift)) == words

    def test_of_neighbours(self):
        assert beam_words([0, 1, 49], (352.8, 7.2)) == "beams 0, 1 and 49 (sector 353° to 7°)"
        assert shift_words("mean", [1, 2], (0.0, 90.0), -0.08) == (
            "beams 1 and 2 (sector 0° to 90°) have a mean velocity that is 8 % of the wind off what the others say"
        )

    def test_tilt_has_room(self):
        assert np.degrees(TILT_SD) > 2.0
