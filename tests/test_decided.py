"""What the data decided: laws, the closed form of a linear posterior, and the prior moved by hand."""

import numpy as np
import pytest
from scenes import plain_noise, records_of

from bayes_rs import STRESSES, Nuisances, fit, load_scan
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.posteriors.decided import PriorRoom, leading_variance, what_data_decided
from bayes_rs.priors import FlatPrior, GaussianPrior, MannPrior, RatioPrior, SamplePrior, WeakPrior
from bayes_rs.priors.interface import log_ratios_from_stress, stress_from_correlations

N_CHAIN = 8
WEAK = WeakPrior()
PRIORS = {
    "weak": WEAK,
    "flat": FlatPrior(bound=5.0),
    "ratio": RatioPrior(vv=0.7, sd_vv=0.2, uv=0.2, sd_uv=0.1),
    "gaussian": GaussianPrior([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], 0.01 * np.eye(6)),
    "sample": SamplePrior(WeakPrior(log_sd_uu=0.5).draw(300, seed=5)),
    "mann": MannPrior(),
}


def of_prior(prior, n_draw=40_000, seed=8):
    return PriorRoom.of(prior.draw(n_draw, seed))


def in_chains(draws):
    """Draws (n, 6) as those of one record."""
    return draws.reshape(1, N_CHAIN, -1, 6)


def weak_posterior(covariance, n_draw=160_000, mean=0.0, seed=3):
    """Draws of a posterior that is normal in the weak prior's coordinates."""
    root = np.linalg.cholesky(covariance)
    return in_chains(WEAK.stress(mean + np.random.default_rng(seed).standard_normal((n_draw, 6)) @ root.T))


def after(precision):
    """Covariance in the weak prior's coordinates, given data of this precision there."""
    return np.linalg.inv(np.eye(6) + precision)


def seen(*directions):
    """Precision of data that see ln of these stresses, each with its standard deviation."""
    of_ln = {
        "uu": [WEAK.log_sd_uu, 0, 0, 0, 0, 0],
        "vv": [WEAK.log_sd_uu, WEAK.log_sd_vv, 0, 0, 0, 0],
        "ww": [WEAK.log_sd_uu, 0, WEAK.log_sd_ww, 0, 0, 0],
    }
    rows = [np.array(of_ln[name]) / sd for name, sd in directions]
    return sum(np.outer(row, row) for row in rows)


class TestPriorRoom:
    @pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
    def test_coordinates_are_standard_under_the_prior(self, prior):
        draws = prior.draw(20_000, 1)
        room = PriorRoom.of(draws)
        standard = (log_ratios_from_stress(draws) - room.mean) @ room.standard
        np.testing.assert_allclose(np.cov(standard, rowvar=False, bias=True), np.eye(standard.shape[1]), atol=1e-6)
        np.testing.assert_allclose(standard[:, 0] * room.size_sd, np.log(draws[:, 0]) - room.mean[0], atol=1e-9)

    def test_those_of_weak_are_its_own(self):
        coordinate = WEAK.draw_coordinate(40_000, np.random.default_rng(2))
        room = PriorRoom.of(WEAK.stress(coordinate))
        standard = (log_ratios_from_stress(WEAK.stress(coordinate)) - room.mean) @ room.standard
        # turned among themselves, as directions of equal variance are: the projections are the same, but for 5/√n
        projector = np.linalg.lstsq(coordinate, standard, rcond=None)[0]
        np.testing.assert_allclose(projector @ projector.T, np.eye(6), atol=0.03)
        np.testing.assert_allclose(projector[0, 1:], 0.0, atol=0.03)

    def test_the_inverse_of_the_map(self):
        inner = np.random.default_rng(4).normal(size=(50, 6))
        stress = stress_from_correlations(
            inner[:, 0], inner[:, 0] + inner[:, 1], inner[:, 0] + inner[:, 2], np.tanh(inner[:, 3:])
        )
        np.testing.assert_allclose(log_ratios_from_stress(stress), inner, atol=1e-9)


class TestLaws:
    @pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
    def test_no_data_decide_nothing_and_teach_nothing(self, prior):
        decided, learnt = what_data_decided(in_chains(prior.draw(160_000, 6)), of_prior(prior))
        # learnt: √(2·6/n) of either sample and more in long tails; four of 0.02
        assert learnt[0] == pytest.approx(0.0, abs=0.09)
        # of a variance nothing is left to lean on; a covariance leans on the size, too, where that is not known
        np.testing.assert_allclose(decided[0, :3], 0.0, atol=0.05)

    @pytest.mark.parametrize("error", [0.05, 0.22, 0.5])
    @pytest.mark.parametrize("which", ["uu", "vv", "ww"])
    def test_a_level_alone_decides_that_stress_and_no_other(self, error, which):
        """However noisy it is: noise of the level is no knowledge of the shape."""
        draws = weak_posterior(after(seen((which, error))), 80_000)
        size = STRESSES.index(which)
        room = PriorRoom.of(WEAK.draw(40_000, 8), size)
        decided, learnt = what_data_decided(draws, room)
        known = room.size_sd**2 / (room.size_sd**2 + error**2)
        assert decided[0, size] == pytest.approx(known, abs=0.01)
        assert learnt[0] == pytest.approx(known, abs=0.06)
        np.testing.assert_allclose(np.delete(decided[0], size), 0.0, atol=0.05)

    def test_the_size_is_the_variance_that_beams_see_best(self):
        sizes = {"staring": 0, "50-beam": 0, "6-beam@opening_angle_deg=45": 0, "zx-300": 2}
        for name, size in sizes.items():
            assert leading_variance(design_matrix(load_scan(name).at_yaw(0.0))) == size

    def test_everything_known_is_decided_by_the_data(self):
        decided, learnt = what_data_decided(weak_posterior(1e-4 * np.eye(6)), of_prior(WEAK))
        np.testing.assert_allclose(decided, 1.0, atol=0.001)
        assert learnt[0] == pytest.approx(6.0, abs=0.001)

    def test_more_data_decide_more(self):
        shares = [
            what_data_decided(weak_posterior(after(seen(("uu", 0.2), ("vv", error))), 40_000), of_prior(WEAK))[0][0, 1]
            for error in (2.0, 1.0, 0.5, 0.25, 0.1)
        ]
        assert np.diff(shares).min() > 0.05
        assert shares[0] < 0.15
        assert shares[-1] > 0.8

    def test_units_and_order_of_records_are_nothing(self):
        draws = np.concatenate([weak_posterior(after(seen((name, 0.3))), 1600) for name in ("uu", "vv")])
        decided, learnt = what_data_decided(draws, of_prior(WEAK))
        scaled = what_data_decided(7.0 * draws[::-1], PriorRoom.of(7.0 * WEAK.draw(40_000, 8)))
        np.testing.assert_allclose(scaled[0][::-1], decided, atol=1e-9)
        np.testing.assert_allclose(scaled[1][::-1], learnt, atol=1e-9)

    def test_shares_add_up_to_about_what_is_learnt(self):
        precision = seen(("uu", 0.2), ("ww", 0.3)) + np.diag([0.0, 0.0, 0.0, 4.0, 0.0, 1.0])
        decided, learnt = what_data_decided(weak_posterior(after(precision)), of_prior(WEAK))
        assert decided.sum() == pytest.approx(learnt[0], abs=0.3)

    def test_what_the_prior_fixes_is_the_priors(self):
        prior = RatioPrior(sd_vv=1e-7, sd_ww=1e-7, sd_uv=1e-7, sd_uw=1e-7, sd_vw=1e-7)
        rng = np.random.default_rng(5)
        draws = prior.stress(rng.standard_normal((1600, 6)) * [0.1, 1, 1, 1, 1, 1])
        decided, learnt = what_data_decided(in_chains(draws), of_prior(prior))
        np.testing.assert_allclose(decided, 0.0, atol=1e-9)  # vv is uu times a ratio that no data can change
        assert learnt[0] == pytest.approx(0.99, abs=0.005)

    def test_tensors_at_the_edge_are_not_a_number_and_spoil_no_other_record(self):
        draws = np.concatenate([weak_posterior(after(seen(("uu", 0.3))), 1600)] * 2)
        expected = what_data_decided(draws, of_prior(WEAK))[1][1]
        draws[0, 0, 0] = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]
        decided, learnt = what_data_decided(draws, of_prior(WEAK))
        assert np.isnan(decided[0]).any()
        assert learnt[1] == expected


class TestReferences:
    @pytest.mark.parametrize("prior", [WEAK, PRIORS["ratio"]], ids=["weak", "ratio"])
    def test_coordinates_say_what_the_stresses_say(self, prior):
        rng = np.random.default_rng(4)
        coordinate = 0.4 * rng.standard_normal((20, N_CHAIN, 50, 6)) + rng.normal(size=(20, 1, 1, 6))
        stress, room = prior.stress(coordinate), of_prior(prior)
        own = what_data_decided(stress, room)
        for found, expected in zip(what_data_decided(stress, room, (coordinate, prior.spread)), own, strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)

    def test_the_closed_form_of_a_linear_posterior(self):
        """In a normal posterior Cov(c·z, z) = Σ c, for the logarithms of the three variances."""
        precision = seen(("uu", 0.2), ("vv", 0.4)) + 0.5 * np.outer(v := np.array([0.1, -1, 2, 0.3, 0, 1]), v)
        covariance = after(precision)
        room = of_prior(WEAK)
        decided, learnt = what_data_decided(weak_posterior(covariance), room)
        slopes = np.array(
            [
                [WEAK.log_sd_uu, 0, 0, 0, 0, 0],
                [WEAK.log_sd_uu, WEAK.log_sd_vv, 0, 0, 0, 0],
                [WEAK.log_sd_uu, 0, WEAK.log_sd_ww, 0, 0, 0],
            ]
        )
        moved = slopes @ covariance
        weight = np.maximum(np.abs(moved[:, 0]) / WEAK.log_sd_uu, np.linalg.norm(moved[:, 1:], axis=1) / room.room[:3])
        # 160 000 draws: a covariance of standard numbers to 0.0025, and the room to 0.5 %; four of them
        np.testing.assert_allclose(decided[0, :3], 1.0 - weight, atol=0.015)
        assert learnt[0] == pytest.approx(np.trace(np.eye(6) - covariance), abs=0.03)

    def test_the_prior_moved_by_hand(self):
        """Weights of a curved likelihood under shifted priors: how far the means of ln uu … and uv … move."""
        rng = np.random.default_rng(11)
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        proposal = np.array([0.2, 1.0, 1.0, 1.0, 1.0, 1.0])  # of the prior's, where the data are
        coordinate = proposal * rng.standard_normal((400_000, 6))
        stress = WEAK.stress(coordinate)
        mean = stress @ design_matrix(scan).T
        data = np.array([[1.1, 0.55, 0.3, 0.1, -0.2, 0.05]]) @ design_matrix(scan).T

        def weights(shift):
            misfit = ((np.log(mean) - np.log(data)) ** 2).sum(axis=1) / 0.25**2
            prior = ((coordinate - shift) ** 2).sum(axis=1) - ((coordinate / proposal) ** 2).sum(axis=1)
            weight = np.exp(-0.5 * (misfit + prior))
            return weight / weight.sum()

        plain = weights(np.zeros(6))
        size = plain @ np.sqrt(stress[:, [0, 0, 1]] * stress[:, [1, 2, 2]])
        quantity = np.concatenate([np.log(stress[:, :3]), stress[:, 3:] / size], axis=1)
        step = 0.01
        moved = np.array(
            [(weights(step * e) - weights(-step * e)) @ quantity / (2.0 * step) for e in np.eye(6)]
        )  # (centre of the prior, stress)
        room = of_prior(WEAK)
        weight = np.maximum(np.abs(moved[0]) / WEAK.log_sd_uu, np.linalg.norm(moved[1:], axis=0) / room.room)
        picked = rng.choice(len(stress), 64_000, p=plain)
        decided, _ = what_data_decided(in_chains(stress[picked]), room)
        # the draws that were picked: 1/√10⁴ of a room at most, as few are far from the mode; and of the room 0.5 %
        np.testing.assert_allclose(decided[0], 1.0 - weight, atol=0.03)
        assert decided.max() - decided.min() > 0.3

    def test_few_draws_have_no_bias(self):
        """The product of independent ensembles: squares of their errors alone would be a share of 0.13 here."""
        prior = RatioPrior(sd_vv=0.05, sd_ww=0.05)
        rng = np.random.default_rng(12)
        draws = prior.stress(rng.standard_normal((500, N_CHAIN, 40, 6)) * [0.1, 1, 1, 1, 1, 1])
        room = of_prior(prior)
        of_size = what_data_decided(draws, room)[0][:, 0]
        error = 0.1 * prior.sd_uu * np.sqrt(5.0 / 320.0) / room.room[0]
        assert error > 0.4
        assert 1.0 - np.median(of_size) < 0.5 * error


def staring(prior, relative_variance=1e-3, **options):
    """The fit of one record of one beam along the wind."""
    scan = load_scan("staring")
    noise = plain_noise(scan, relative_variance=relative_variance)
    return fit(
        records_of(np.ones((1, 1)), scan), scan, noise=noise, prior=prior, seed=1, **{"target_ess": 2000, **options}
    )


class TestInFits:
    @pytest.mark.parametrize("prior", ["weak", "flat:bound=5"])
    @pytest.mark.parametrize("relative_variance", [1e-3, 0.1])
    def test_one_beam_learns_one_stress(self, prior, relative_variance):
        found = staring(prior, relative_variance)
        decided = found.summary().set_index("stress")["decided"]
        assert decided["uu"] > (0.5 if prior.startswith("flat") else 0.95)
        # 4000 draws: 1/√4000 of the room each, in five directions; four of them
        np.testing.assert_allclose(decided.drop("uu"), 0.0, atol=0.15)
        learnt = found.table("posterior")["stresses_learnt"].item()
        assert learnt == pytest.approx(decided["uu"], abs=0.25)

    def test_all_is_learnt_of_six_wide_beams_without_noise(self):
        scan = load_scan("6-beam", opening_angle_deg=45.0)
        records = records_of(np.array([[1.0, 0.6, 0.4, 0.1, -0.2, 0.05]]) @ design_matrix(scan).T, scan)
        noise = plain_noise(scan, relative_variance=1e-4)
        found = fit(records, scan, noise=noise, prior=FlatPrior(bound=5.0), seed=1, target_ess=200)
        assert found.summary()["decided"].min() > 0.9
        assert found.table("posterior")["stresses_learnt"].item() > 5.8

    def test_nuisances_are_none_of_the_six(self):
        found = staring("weak", nuisances=Nuisances(instrument_noise_log_sd=0.5), instrument_noise=0.2, target_ess=400)
        assert 0.9 < found.table("posterior")["stresses_learnt"].item() < 1.15

    def test_the_table_holds_it_whatever_the_interval(self):
        found = staring("weak", derived=("tke", "ti", "ti_v"))
        table = found.summary().set_index("stress")["decided"]
        expected, learnt = what_data_decided(found.draws(), PriorRoom.of(found.prior_draws))
        # the table's are of the coordinates of the same draws: the same but for rounding
        np.testing.assert_allclose(table[list(STRESSES)], expected[0], rtol=1e-9, atol=1e-12)
        assert found.table("posterior")["stresses_learnt"].item() == pytest.approx(learnt[0], rel=1e-9)
        assert table["ti"] == table["uu"]
        assert table["ti_v"] == table["vv"]
        assert np.isnan(table["tke"])
        other = found.summary(prob=0.5, derived=["ti_w"]).set_index("stress")["decided"]
        np.testing.assert_array_equal(other[list(STRESSES)], table[list(STRESSES)])
        assert other["ti_w"] == table["ww"]

    def test_in_the_lidars_frame_it_is_that_of_turned_draws(self):
        """A beam along the lidar's axis with the wind from the side sees vv of the wind and uu of the lidar."""
        scan = load_scan("staring")
        records = records_of(np.ones((1, 1)), scan, yaw_deg=90.0)
        found = fit(records, scan, noise=plain_noise(scan), seed=1, prior="weak")
        wind = found.summary().set_index("stress")["decided"]
        lidar = found.summary(frame="lidar").set_index("stress")["decided"]
        assert wind["vv"] > 0.9
        assert wind["uu"] < 0.2
        assert lidar["uu"] > 0.9
        assert lidar["vv"] < 0.2
