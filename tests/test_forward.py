"""The forward model: radial variances from stresses, and what beams can see."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayes_rs import InputError, load_scan
from bayes_rs.geometry.forward import _gain_change, design_matrix, radial_variance, sight
from bayes_rs.geometry.scan_file import cone_direction
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.models import preset_names
from bayes_rs.priors.registry import WeakPrior
from bayes_rs.readers.rays import direction_of

STRESS = arrays(np.float64, 6, elements=st.floats(-5.0, 5.0))
ANGLE = st.floats(-np.pi, np.pi)


class TestLaws:
    @given(STRESS, ANGLE, ANGLE)
    def test_design_matrix_is_the_quadratic_form(self, stress, opening, phase):
        beam = cone_direction(opening, phase)
        slow = sum(beam[i] * beam[j] * unpack_stress(stress)[i, j] for i in range(3) for j in range(3))
        assert radial_variance([beam], stress)[0] == pytest.approx(slow, abs=1e-13)  # rounding of nine products

    def test_isotropic_turbulence_gives_the_same_variance_on_every_beam(self):
        variance = radial_variance(load_scan("spinnerlidar"), [0.7, 0.7, 0.7, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(variance, 0.7, rtol=1e-14)

    @given(STRESS)
    def test_the_sign_of_the_beams_does_not_matter(self, stress):
        beams = load_scan("6-beam").line_of_sight
        np.testing.assert_array_equal(radial_variance(beams, stress), radial_variance(-beams, stress))

    def test_a_monte_carlo_variance_pins_the_signs_of_uv_and_uw(self):
        stress = np.array([1.8, 0.9, 0.5, 0.45, -0.4, 0.1])
        rng = np.random.default_rng(5)
        n_draw = 200_000
        wind = rng.multivariate_normal(np.zeros(3), unpack_stress(stress), n_draw)
        beams = load_scan("6-beam", opening_angle_deg=40.0, tilt_deg=4.0, yaw_deg=12.0).line_of_sight
        measured = (wind @ beams.T).var(axis=0)
        # the variance of n normal numbers has relative standard deviation (2/n)^½; five of them
        np.testing.assert_allclose(measured, radial_variance(beams, stress), rtol=5.0 * np.sqrt(2.0 / n_draw))

    def test_a_beam_above_the_axis_sees_negative_uw_as_more_variance(self):
        """n₁ n₃ < 0 for a beam that looks upwind and up, so 2 n₁ n₃ uw > 0 for uw < 0."""
        up, down = cone_direction(np.deg2rad(15.0), np.array([np.pi / 2, -np.pi / 2]))
        variance = radial_variance([up, down], [1.0, 0.5, 0.3, 0.0, -0.2, 0.0])
        assert variance[0] - variance[1] == pytest.approx(2.0 * np.sin(np.deg2rad(30.0)) * 0.2, rel=1e-12)

    def test_an_extra_variance_on_all_beams_is_isotropic_stress(self):
        matrix = design_matrix(load_scan("6-beam"))
        shift = np.linalg.lstsq(matrix, np.full(6, 0.3), rcond=None)[0]
        np.testing.assert_allclose(shift, [0.3, 0.3, 0.3, 0.0, 0.0, 0.0], atol=1e-12)  # condition 50, rounding


class TestSight:
    @pytest.mark.parametrize("opening", [10.0, 15.0, 30.0, 54.7356, 80.0])
    def test_one_cone_cannot_see_its_documented_direction(self, opening):
        scan = load_scan("50-beam", opening_angle_deg=opening)
        blind = np.array([1.0, *[-1.0 / np.tan(np.deg2rad(opening)) ** 2] * 2, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(design_matrix(scan) @ blind, 0.0, atol=1e-14 * np.abs(blind).max())
        seen = sight(scan)
        assert seen.rank == 5
        np.testing.assert_allclose(seen.unseen, [blind], rtol=1e-9)

    def test_at_the_magic_angle_the_unseen_direction_is_traceless(self):
        scan = load_scan("50-beam", opening_angle_deg=np.rad2deg(np.arctan(np.sqrt(2.0))))
        assert sight(scan).unseen[0, :3].sum() == pytest.approx(0.0, abs=1e-9)

    @pytest.mark.parametrize(
        ("name", "rank", "words"),
        [
            ("staring", 1, "sees uu; does not see vv, ww, uv, uw, vw"),
            ("2-beam", 2, "sees uv; sees uu only together with vv; does not see ww, uw, vw"),
            ("4-beam", 4, "sees uv, uw, vw; sees only 1 combination of uu, vv, ww"),
            ("5-beam", 5, "sees uu, uv, uw, vw; sees vv only together with ww"),
            ("6-beam", 6, "sees all six stresses"),
            ("50-beam", 5, "sees uv, uw, vw; sees uu only together with vv + ww"),
            ("51-beam", 6, "sees all six stresses"),
            ("spinnerlidar", 6, "sees all six stresses"),
        ],
    )
    def test_ranks_and_words_of_the_instruments(self, name, rank, words):
        seen = sight(load_scan(name))
        assert seen.rank == rank
        assert seen.in_words() == words

    @pytest.mark.parametrize("name", [n for n in preset_names("scans") if not n.startswith("spinnerlidar-")])
    def test_unseen_directions_change_no_variance(self, name):
        scan = load_scan(name)
        seen = sight(scan)
        assert len(seen.unseen) == 6 - seen.rank
        change = design_matrix(scan) @ seen.unseen.T
        np.testing.assert_allclose(change, 0.0, atol=1e-12 * max(1.0, np.abs(seen.unseen).max(initial=0.0)))

    @pytest.mark.parametrize("n_beam", [1, 2, 3, 4, 5])
    def test_unseen_directions_are_in_reduced_echelon_form(self, n_beam):
        """Each leads with a 1 where all others are 0, so that there is one such list for beams in any order."""
        beams = np.random.default_rng(4).normal(size=(n_beam, 3))
        unseen = sight(beams).unseen
        lead = [int(np.flatnonzero(row)[0]) for row in unseen]
        assert lead == sorted(lead)
        np.testing.assert_allclose(unseen[:, lead], np.eye(6 - n_beam), rtol=0.0, atol=1e-12)  # rounding
        np.testing.assert_allclose(sight(beams[::-1]).unseen, unseen, rtol=0.0, atol=1e-9)  # condition below 1e3

    @pytest.mark.parametrize("off", [0.0, 0.02, 0.3])
    def test_what_an_error_of_the_angles_could_make_is_not_told(self, off):
        """Four beams at an elevation of 75° and the zenith: those in the field are hundredths of a degree off."""
        azimuth = np.array([0.0, 90.0, 180.0, 270.0, 0.0]) + off * np.array([-1.0, 0.5, 0.7, -0.2, 0.0])
        elevation = np.array([75.0, 75.0, 75.0, 75.0, 90.0]) + 0.3 * off * np.array([1.0, -1.0, 0.5, 0.2, -1.0])
        seen = sight(direction_of(azimuth, elevation))
        assert (seen.rank, seen.in_words()) == (5, "sees uu, vv, ww, uw, vw; does not see uv")
        np.testing.assert_array_equal(seen.unseen, [[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
        if off:
            assert "only together with" in sight(direction_of(azimuth, elevation), pointing_deg=0.0).in_words()

    def test_a_sixth_beam_by_mistake_is_no_sixth_direction(self):
        """Beams that differ by 0.05° are one: what they tell apart is less than what their angles are known to."""
        beams = direction_of(np.array([0.0, 90.0, 180.0, 270.0, 0.0, 0.05]), np.array([75.0] * 4 + [90.0, 75.03]))
        assert sight(beams, pointing_deg=0.0).rank == 6
        seen = sight(beams)
        assert (seen.rank, seen.in_words()) == (5, "sees uu, vv, ww, uw, vw; does not see uv")
        assert seen.condition < 100.0

    def test_an_azimuth_that_is_really_another_is_told(self):
        """tan 20° = 0.364: the unseen direction is uv in the frame of the beams, which is turned by 10°."""
        beams = direction_of(np.array([10.0, 100.0, 190.0, 280.0, 0.0]), np.array([75.0, 75.0, 75.0, 75.0, 90.0]))
        assert sight(beams).in_words() == "sees ww, uw, vw; sees uu only together with vv − 2.75 uv"

    @pytest.mark.parametrize("name", preset_names("scans"))
    def test_the_tolerance_changes_nothing_that_is_told_of_presets(self, name):
        exact, told = sight(load_scan(name), pointing_deg=0.0), sight(load_scan(name))
        assert (told.rank, told.condition, told.in_words()) == (exact.rank, exact.condition, exact.in_words())

    def test_an_angle_that_is_none(self):
        with pytest.raises(InputError, match="Invalid pointing_deg -1"):
            sight(load_scan("6-beam"), pointing_deg=-1.0)

    @pytest.mark.parametrize("n_beam", [4, 5, 6, 12])
    def test_the_tolerance_is_what_turned_beams_make(self, n_beam):
        """Beams turned at random: their gains for what is unseen, and the unseen direction, move as far as is said."""
        rng = np.random.default_rng(n_beam)
        azimuth = np.arange(0.0, 360.0, 360.0 / n_beam)
        beams = direction_of(azimuth, np.full(n_beam, 62.0))
        unseen = np.linalg.svd(design_matrix(beams))[2][-1]
        tilt = np.deg2rad(0.1) * rng.standard_normal((4000, n_beam, 3))
        tilt -= np.sum(tilt * beams, axis=-1, keepdims=True) * beams
        change = design_matrix(beams + tilt) @ unseen - design_matrix(beams) @ unseen
        expected = np.deg2rad(0.1) * _gain_change(beams, unseen[np.newaxis])[:, 0]
        np.testing.assert_allclose(change.std(axis=0), expected, rtol=0.05)  # 4000 draws: 1.1 %, 12 beams

    def test_words_say_how_much_of_one_stress_goes_with_another(self):
        """On the cone n₁² = 2 n₂² + n₃² one more uu is undone by 2 less vv and 1 less ww."""
        phase = np.linspace(0.1, 6.0, 9)
        beams = np.stack([-np.ones(9), np.sin(phase) / np.sqrt(2.0), np.cos(phase)], axis=-1)
        assert sight(beams).in_words() == "sees uv, uw, vw; sees uu only together with vv + 0.5 ww"

    @pytest.mark.parametrize("name", ["4-beam", "50-beam", "51-beam", "6-beam"])
    def test_more_planes_of_the_same_beams_see_nothing_more(self, name):
        assert sight(load_scan(f"{name}-planes")).rank == sight(load_scan(name)).rank

    def test_condition_number_of_the_six_beam_scan(self):
        """The six-beam scan at 15° has condition number 50.6 in any frame that is turned about its axis."""
        assert sight(load_scan("6-beam")).condition == pytest.approx(50.6, abs=0.05)

    def test_least_squares_recovers_what_is_seen(self):
        stress = WeakPrior().draw(1, seed=3)[0]
        matrix = design_matrix(load_scan("6-beam"))
        np.testing.assert_allclose(np.linalg.solve(matrix, matrix @ stress), stress, rtol=1e-10, atol=1e-10)


def test_bad_vectors_are_refused():
    with pytest.raises(InputError, match=r"Invalid beam vectors of shape \(2,\): the last dimension must be 3"):
        design_matrix([1.0, 0.0])
