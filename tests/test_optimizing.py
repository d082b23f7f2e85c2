"""Choosing beams: the closed form, laws, limits, files and the command."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import records_of

import bayes_rs as brs
from bayes_rs import cli
from bayes_rs.design.beam_space import FEASIBLE, free_arcs
from bayes_rs.design.optimize_job import plot_optimum, run_optimize, summary_lines
from bayes_rs.design.scan_criteria import CRITERIA, CriterionOptions, local_prior_covariance, trace_criterion
from bayes_rs.design.scan_limits import ScanLimits
from bayes_rs.design.scan_optimum import SAME_OPTIMUM
from bayes_rs.geometry.scan_file import cone_direction
from bayes_rs.models import preset_names
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.options import options_of

SEED = brs.load_turbulence("fu-2022")
ISOTROPIC = brs.MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=0.0)
REACHED = 1e-6  # what the search has to reach of the closed form, relatively


def around(m, m0, angle_deg):
    """m beams evenly on a cone, m0 along the axis."""
    phase = 2.0 * np.pi * np.arange(m) / m
    return np.concatenate([cone_direction(np.deg2rad(angle_deg), phase), np.tile([[-1.0, 0.0, 0.0]], (m0, 1))])


def closed_form(m, m0, angle_deg):
    c, s = np.cos(np.deg2rad(angle_deg)) ** 2, np.sin(np.deg2rad(angle_deg)) ** 2
    return 10.0 / (m * s**2) + 2.0 / (m * c * s) + 2.0 * c**2 / (m0 * s**2) + 1.0 / m0


def random_scan(rng, n, widest_deg=40.0, **more):
    direction = cone_direction(np.deg2rad(rng.uniform(2.0, widest_deg, n)), np.sort(rng.uniform(0.0, 2.0 * np.pi, n)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return brs.Scan("random", direction, np.full(n, 98.0), np.arange(n) / n, 1.0, **more)


class TestTrace:
    @pytest.mark.parametrize(
        ("m", "m0", "angle"), [(5, 1, 15.0), (5, 1, 45.0), (6, 1, 30.0), (7, 3, 70.0), (9, 2, 52.0)]
    )
    def test_is_the_closed_form_and_the_sum_of_nine_variances(self, m, m0, angle):
        beams = around(m, m0, angle)
        matrix = brs.geometry.design_matrix(beams)
        variance = np.diag(np.linalg.inv(matrix.T @ matrix))
        nine = variance[:3].sum() + 2.0 * variance[3:].sum()
        np.testing.assert_allclose(closed_form(m, m0, angle), nine, rtol=1e-9)
        np.testing.assert_allclose(trace_criterion(beams), nine, rtol=1e-9)

    def test_four_around_one_break_the_closed_form(self):
        """For m = 4 the harmonics of θ mix, and not all stresses are seen: why it is five."""
        assert trace_criterion(around(4, 2, 40.0)) == np.inf

    @pytest.mark.parametrize("angle", [20.0, 30.0, 45.0, 60.0])
    def test_the_search_finds_five_around_one(self, angle):
        best = brs.optimize_scan(n_beams=6, max_angle_deg=angle, criterion="trace")
        np.testing.assert_allclose(best.value, closed_form(5, 1, angle), rtol=REACHED)
        assert best.starts.min() > closed_form(5, 1, angle) * (1.0 - REACHED)  # none is better
        assert best.n_agree >= 12  # half of the starts, or the search would hardly be one for the best
        opening = np.sort(best.angles_deg[:, 0])
        np.testing.assert_allclose(opening, [0.0, *[angle] * 5], atol=0.1)

    def test_without_a_narrow_limit_the_bound_of_all_designs_is_reached(self):
        """6.75 = 40.5/6, which no six beams can beat: six axes of an icosahedron, in any orientation."""
        best = brs.optimize_scan(n_beams=6, max_angle_deg=90.0, criterion="trace")
        np.testing.assert_allclose(best.value, 6.75, rtol=REACHED)
        cosine = np.abs(best.scan.line_of_sight @ best.scan.line_of_sight.T)[np.triu_indices(6, 1)]
        np.testing.assert_allclose(cosine, 1.0 / np.sqrt(5.0), atol=1e-3)
        narrower = np.degrees(np.arccos(np.sqrt(0.2)))
        np.testing.assert_allclose(closed_form(5, 1, narrower), 6.75, rtol=1e-12)

    def test_no_scan_beats_the_bound(self):
        rng = np.random.default_rng(4)
        for n in (6, 7, 12):
            vectors = rng.normal(size=(200, n, 3))
            vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
            assert trace_criterion(vectors).min() >= 40.5 / n * (1.0 - 1e-12)

    def test_one_cone_with_a_centre_beam_is_the_same_optimum(self):
        best = brs.optimize_scan(n_beams=6, max_angle_deg=45.0, criterion="trace", cones=1, n_starts=4)
        np.testing.assert_allclose(best.value, 12.6, rtol=REACHED)
        np.testing.assert_array_equal(best.scan.beam_direction[-1], [-1.0, 0.0, 0.0])

    def test_a_lidar_on_the_ground_has_the_same_optimum(self):
        best = brs.optimize_scan(n_beams=6, max_angle_deg=45.0, criterion="trace", axis="up", n_starts=6)
        np.testing.assert_allclose(best.value, 12.6, rtol=REACHED)
        np.testing.assert_allclose(best.scan.line_of_sight[:, 2].max(), 1.0, atol=1e-5)


class TestLaws:
    def test_turning_all_beams_changes_no_trace(self):
        beams = random_scan(np.random.default_rng(1), 7).beam_direction
        turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
        np.testing.assert_allclose(trace_criterion(beams @ turn), trace_criterion(beams), rtol=1e-9)

    def test_turning_all_azimuths_changes_no_isotropic_noise(self):
        """At Γ = 0 only distances and angles between beams count."""
        scan = random_scan(np.random.default_rng(3), 5)
        angle = 1.1
        turn = np.array([[1.0, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
        both = (scan, replace(scan, beam_direction=scan.beam_direction @ turn))
        plain, turned = (theory_noise(one, ISOTROPIC, wind_speed=10.0) for one in both)
        np.testing.assert_allclose(
            turned.covariance[0], plain.covariance[0], atol=2.0 * plain.details["covariance_error"]
        )

    @pytest.mark.parametrize("criterion", CRITERIA)
    def test_mirror_images_are_equally_good(self, criterion):
        scan = random_scan(np.random.default_rng(5), 6)
        mirrored = replace(scan, beam_direction=scan.beam_direction * [1.0, -1.0, 1.0])
        scale = CriterionOptions(criterion=criterion).make()
        np.testing.assert_allclose(scale.of(mirrored), scale.of(scan), rtol=1e-9)

    @pytest.mark.parametrize("criterion", CRITERIA)
    def test_many_scans_have_the_values_of_each(self, criterion):
        scans = [random_scan(np.random.default_rng(seed), 6) for seed in (5, 6)]
        scale = CriterionOptions(criterion=criterion, yaw_deg=[-10.0, 5.0], turbulence=["fu-2022", "iec-a"]).make()
        found = scale.of_many(np.array([scan.beam_direction for scan in scans]), scans[0])
        np.testing.assert_allclose(found, [scale.of(scan) for scan in scans], rtol=1e-12)

    def test_one_more_beam_never_hurts(self):
        scan = random_scan(np.random.default_rng(6), 6)
        fewer = scan.select(scan.beam[:5])
        assert brs.design.scan_criterion(scan) < brs.design.scan_criterion(fewer)

    def test_dissipation_has_hardly_an_influence(self):
        """It scales R, and the noise is relative; the prior's size of uu is all that knows it, and is wide."""
        scan = random_scan(np.random.default_rng(7), 6)
        wide = brs.priors.WeakPrior(log_sd_uu=50.0)
        values = [
            brs.design.scan_criterion(scan, turbulence=replace(SEED, dissipation=dissipation), prior=wide)
            for dissipation in (0.01, 0.05)
        ]
        np.testing.assert_allclose(values[1], values[0], rtol=1e-6)


class TestPosterior:
    def test_prior_is_linearized_where_it_is_narrow_exactly(self):
        prior = centred_prior(SEED, 0.02)
        draws = prior.draw(40_000, seed=1)
        sample = np.cov(draws.T)
        linear = local_prior_covariance(prior, SEED)
        np.testing.assert_allclose(np.sqrt(np.diag(linear)), np.sqrt(np.diag(sample)), rtol=0.02)  # 40 000 draws: 0.4 %
        scale = np.sqrt(np.outer(np.diag(sample), np.diag(sample)))
        np.testing.assert_allclose(linear / scale, sample / scale, atol=0.03)

    def test_widths_are_those_of_a_fit_where_the_posterior_is_narrow(self):
        """Eight hours of expected variances: the data decide, and only sampling error (2 %) and curvature remain."""
        scan, hours = brs.load_scan("6-beam", opening_angle_deg=45.0), 28800.0
        prior, noise = centred_prior(SEED, 0.4), theory_noise(scan, SEED, wind_speed=10.0, duration=hours)
        variance = noise.gain[0] @ SEED.stresses() * np.exp(-0.5 * np.log1p(np.diag(noise.covariance[0])))
        records = records_of(variance[np.newaxis], scan).assign_attrs(duration=hours)
        result = brs.fit(records, scan, noise=noise, prior=prior, seed=1, target_ess=4000, progress=False)
        draws = result["posterior"]["stress"].transpose("component", ...).values.reshape(6, -1)
        low, high = np.quantile(draws, [0.05, 0.95], axis=1)
        expected = CriterionOptions(prior=prior, duration=hours).make().widths(scan)[0]
        np.testing.assert_allclose(high - low, expected, rtol=0.06)
        alone = local_prior_covariance(prior, SEED)
        assert np.all(high - low < 0.6 * 3.29 * np.sqrt(np.diag(alone)))  # the prior did not decide

    def test_widths_make_the_criterion(self):
        scan = brs.load_scan("6-beam")
        scale = CriterionOptions(stresses=["vv=3", "uw"]).make()
        widths = scale.widths(scan)[0]
        expected = (0.75 * widths[1] + 0.25 * widths[4]) / SEED.stresses()[0]
        np.testing.assert_allclose(scale.of(scan), [expected], rtol=1e-12)

    @pytest.mark.parametrize("prior", ["weak", "ratio", "flat:bound=20"])
    def test_priors_reach_the_turbulence(self, prior):
        covariance = local_prior_covariance(brs.priors.make_prior(prior), SEED)
        assert np.linalg.eigvalsh(covariance)[0] > 0.0


def centred_prior(flow, spread):
    uu, vv, ww, _, uw, _ = flow.stresses().tolist()
    return brs.priors.RatioPrior(
        uu=uu,
        sd_uu=spread,
        vv=vv / uu,
        sd_vv=spread,
        ww=ww / uu,
        sd_ww=spread,
        uw=uw / np.sqrt(uu * ww),
        sd_uv=spread,
        sd_uw=spread,
        sd_vw=spread,
    )


class TestLimits:
    def test_all_are_kept(self):
        best = brs.optimize_scan(
            n_beams=7,
            criterion="trace",
            rotor_radius=60.0,
            focus_distance=[80.0, 120.0],
            blocked_deg=[(200.0, 250.0), (350.0, 20.0)],
            min_elevation_deg=-12.0,
            min_spread_deg=40.0,
            tilt_deg=3.0,
            n_starts=6,
        )
        assert best.scan.n_beam == 14
        reach = best.scan.beam_direction * best.scan.focus_distance[:, np.newaxis]
        assert np.hypot(reach[:, 1], reach[:, 2]).max() <= 60.0 + 120.0 * FEASIBLE
        assert np.degrees(np.arcsin(best.scan.line_of_sight[:, 2])).min() >= -12.0 - 1e-5
        opening, phase = best.angles_deg.T
        moving = phase[opening > 1e-4]
        assert not np.any((moving > 200.0 + 1e-4) & (moving < 250.0 - 1e-4))
        assert not np.any((moving > 350.0 + 1e-4) | (moving < 20.0 - 1e-4))
        cosine = best.scan.beam_direction @ best.scan.beam_direction.T
        assert np.degrees(np.arccos(cosine.min())) >= 40.0 - 1e-5
        assert best.outside  # what is best without limits is not within them
        free = brs.optimize_scan(n_beams=7, criterion="trace", max_angle_deg=30.0, n_starts=6)
        assert best.value > 0.5 * free.value  # two planes: every direction twice

    def test_a_spread_that_the_optimum_has_not_is_kept_at_a_small_cost(self):
        """Five around one at 30° span 2 asin(sin 30° sin 72°) = 56.8° at most."""
        best = brs.optimize_scan(n_beams=6, max_angle_deg=30.0, criterion="trace", min_spread_deg=59.0)
        cosine = best.scan.beam_direction @ best.scan.beam_direction.T
        np.testing.assert_allclose(np.degrees(np.arccos(cosine.min())), 59.0, atol=1e-4)
        assert closed_form(5, 1, 30.0) < best.value < 1.1 * closed_form(5, 1, 30.0)
        assert best.n_agree >= 12

    def test_the_optimum_beside_a_blocked_sector_is_found_by_many_starts(self):
        """Beams that came upon the sector's edge stay there, and the search goes on with the others."""
        options = {"n_beams": 6, "max_angle_deg": 30.0, "criterion": "trace", "blocked_deg": [(0.0, 150.0)]}
        best, other = (brs.optimize_scan(seed=seed, **options) for seed in (1, 2))
        np.testing.assert_allclose(best.value, other.value, rtol=REACHED)
        assert best.n_agree >= 4
        assert best.value > 1.01 * closed_form(5, 1, 30.0)

    def test_a_single_cone_is_one(self):
        best = brs.optimize_scan(5, max_angle_deg=25.0, cones=1, centre=False, n_starts=2)
        assert np.ptp(best.angles_deg[:, 0]) < 1e-9

    def test_two_cones_are_two(self):
        best = brs.optimize_scan(n_beams=8, max_angle_deg=50.0, criterion="trace", cones=2, centre=False, n_starts=6)
        assert len(np.unique(best.angles_deg[:, 0].round(6))) <= 2

    @pytest.mark.parametrize("seed", range(5))
    def test_free_sectors_are_what_is_not_blocked(self, seed):
        rng = np.random.default_rng(seed)
        start = rng.uniform(-100.0, 500.0, 3)
        blocked = np.stack([start, start + rng.uniform(5.0, 110.0, 3)], axis=1)
        arcs = np.degrees(free_arcs(blocked.tolist()))
        for phase in rng.uniform(0.0, 360.0, 300):
            hit = np.any(np.mod(phase - blocked[:, 0], 360.0) < blocked[:, 1] - blocked[:, 0])
            free = np.any(np.mod(phase - arcs[:, 0], 360.0) < arcs[:, 1] - arcs[:, 0])
            assert hit != free


class TestSearch:
    def test_same_seed_same_scan(self):
        one, two = (brs.optimize_scan(n_beams=7, max_angle_deg=40.0, criterion="trace", seed=3) for _ in range(2))
        np.testing.assert_array_equal(one.scan.beam_direction, two.scan.beam_direction)
        np.testing.assert_array_equal(one.starts, two.starts)
        other = brs.optimize_scan(n_beams=7, max_angle_deg=40.0, criterion="trace", seed=4)
        assert not np.array_equal(one.scan.beam_direction, other.scan.beam_direction)
        np.testing.assert_allclose(one.value, other.value, rtol=REACHED)

    def test_the_worst_of_several_states_counts(self):
        options = {
            "n_beams": 3,
            "max_angle_deg": 30.0,
            "n_starts": 1,
            "cones": 1,
            "centre": True,
        }
        flows = ["fu-2022", "stable-onshore"]
        alone = [brs.optimize_scan(turbulence=flow, **options) for flow in flows]
        both = brs.optimize_scan(turbulence=flows, **options)
        each = [brs.design.scan_criterion(both.scan, turbulence=flow) for flow in flows]
        np.testing.assert_allclose(list(both.by_state.values()), each, rtol=1e-12)
        assert both.value == max(both.by_state.values())
        for one in alone:  # a scan cannot do better in the worst case than the best for one state does in that
            assert both.value >= one.value * (1.0 - SAME_OPTIMUM)

    def test_the_worst_of_several_wind_directions_counts(self):
        options = {"n_beams": 3, "max_angle_deg": 30.0, "turbulence": SEED, "n_starts": 2}
        both = brs.optimize_scan(yaw_deg=[0.0, 25.0], **options)
        assert both.n_evaluations < 1000  # 241; for a digit that the noise does not tell it took thousands
        each = [brs.design.scan_criterion(both.scan.with_yaw(np.deg2rad(yaw)), turbulence=SEED) for yaw in (0, 25)]
        assert list(both.by_state) == ["fu-2022, yaw 0°", "fu-2022, yaw 25°"]
        np.testing.assert_allclose(list(both.by_state.values()), each, rtol=1e-12)
        np.testing.assert_allclose(
            brs.design.scan_criterion(both.scan, turbulence=SEED, yaw_deg=[0.0, 25.0]), max(each), rtol=1e-12
        )
        straight = brs.optimize_scan(**options)
        assert straight.value <= both.by_state["fu-2022, yaw 0°"] * (1.0 + SAME_OPTIMUM)
        assert brs.design.scan_criterion(straight.scan, turbulence=SEED, yaw_deg=25.0) > both.value

    def test_a_dwell_makes_scans_of_more_beams_slower(self):
        for planes, visits in (("simultaneous", 6), ("sequential", 12)):
            best = brs.optimize_scan(
                n_beams=6,
                max_angle_deg=30.0,
                criterion="trace",
                n_starts=1,
                focus_distance=[50.0, 90.0],
                dwell=2.0,
                planes=planes,
            )
            assert best.scan.scan_duration == 2.0 * visits
            assert best.details["seconds_a_scan"] == 2.0 * visits

    def test_the_best_of_several_numbers_of_beams(self):
        """Trace by 5 around 1 at a cone falls with every beam, so the largest number wins."""
        options = {"max_angle_deg": 45.0, "criterion": "trace", "n_starts": 4, "seed": 3}
        best = brs.optimize_scan(n_beams=(7, 6, 8), **options)
        alone = {number: brs.optimize_scan(n_beams=number, **options).value for number in (6, 7, 8)}
        assert best.by_number == alone
        assert list(best.by_number) == [6, 7, 8]
        assert best.scan.n_beam == 8
        assert best.to_dict()["by_number"]["6"] == alone[6]

    def test_what_is_reported_is_of_the_scan(self):
        best = brs.optimize_scan(n_beams=4, max_angle_deg=30.0, turbulence=SEED, n_starts=3)
        np.testing.assert_allclose(brs.design.scan_criterion(best.scan, turbulence=SEED), best.value, rtol=1e-12)
        np.testing.assert_allclose(best.starts.min(), best.value, rtol=1e-9)
        np.testing.assert_allclose(np.mean(list(best.widths.values())), best.value, rtol=1e-12)
        assert np.all(np.diff(best.starts) >= 0.0)
        assert best.spread >= 0.0
        inside = [value for name, value in best.references.items() if name not in best.outside]
        assert len(inside) >= 3
        assert best.value <= min(inside)
        four = brs.load_scan("4-beam", focus_distance=98.0)
        shipped = replace(four, beam_time=best.scan.beam_time, scan_duration=best.scan.scan_duration)
        np.testing.assert_allclose(
            best.references["4-beam as shipped"], brs.design.scan_criterion(shipped, turbulence=SEED), rtol=1e-9
        )

    def test_times_are_shared(self):
        best = brs.optimize_scan(
            n_beams=6,
            max_angle_deg=30.0,
            criterion="trace",
            n_starts=1,
            focus_distance=[50.0, 90.0],
            scan_duration=3.0,
            planes="sequential",
        )
        np.testing.assert_allclose(best.scan.beam_time, 0.25 * np.arange(12))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"n_beams": 0}, "Invalid n_beams 0: it must be a whole number of at least 1."),
        ({"max_angle_deg": None}, "The beams have no limit: give max_angle_deg"),
        ({"max_angle_deg": 95.0}, "Invalid max_angle_deg 95.0: it must be above 0 and at most 90 degrees."),
        ({"rotor_radius": -1.0}, "Invalid rotor_radius -1.0 m: it must be a finite number above zero."),
        ({"focus_distance": [98.0, 0.0]}, "Invalid focus_distance 0.0 m"),
        ({"criterion": "best"}, "Unknown criterion 'best': it must be one of width, trace."),
        ({"turbulence": (), "criterion": "width"}, "Invalid turbulence []: give one, or several"),
        (
            {"max_angel_deg": 30.0},
            "Unknown option 'max_angel_deg' in the call of optimize_scan: did you mean 'max_angle",
        ),
        ({"stresses": ["uu"]}, "The criterion 'trace' counts the whole tensor"),
        ({"criterion": "width", "turbulence": SEED, "stresses": ["tt"]}, "Unknown stress 'tt'"),
        ({"criterion": "width", "turbulence": SEED, "stresses": ["uu", "uu=2"]}, "name each once"),
        ({"criterion": "width", "stresses": ["uu=x"]}, "Invalid weight of uu 'x': it must be a finite number"),
        ({"criterion": "width", "stresses": ["uu=-1"]}, "Invalid weight of uu '-1': it must be a finite number"),
        ({"criterion": "width", "stresses": ["uu=0"]}, "Invalid stresses ['uu=0']: one must have a weight above zero"),
        ({"criterion": "width", "turbulence": SEED, "prior": "flat:bound=0.1"}, "does not hold the stresses"),
        ({"n_beams": 5}, "Invalid n_beams 5: the criterion 'trace' needs at least 6 beams to see all six stresses"),
        ({"cones": 1, "centre": False}, "A single cone without a beam along its axis never sees all six stresses"),
        ({"cones": 7}, "Invalid cones 7: there are 6 beams"),
        ({"cones": 6, "centre": True}, "with a beam along the axis, 5 beams are left"),
        ({"blocked_deg": [(10.0, 10.0)]}, "Invalid blocked_deg [10.0, 10.0]: from and to must differ"),
        ({"blocked_deg": [(0.0, 200.0), (150.0, 10.0)]}, "together they block all directions"),
        ({"blocked_deg": [10.0]}, "Invalid blocked_deg of shape (1,)"),
        ({"min_elevation_deg": 60.0}, "Found 0 scans within the limits"),
        ({"min_spread_deg": 61.0}, "Invalid min_spread_deg 61.0: 6 beams that are no more than 30 degrees off"),
        ({"axis": "down"}, "Unknown axis 'down': it must be one of upwind, up."),
        ({"planes": "both"}, "Unknown planes 'both'"),
        ({"n_starts": 0}, "Invalid n_starts 0"),
        ({"n_beams": []}, "Invalid n_beams []: give at least one number of beams."),
        ({"n_beams": [6, 0]}, "Invalid n_beams 0"),
        ({"dwell": 0.0}, "Invalid dwell 0.0 s"),
        (
            {"dwell": 1.0, "scan_duration": 3.0},
            "Invalid dwell 1 s with scan_duration 3 s: one follows from the other and",
        ),
        ({"criterion": "width", "turbulence": SEED, "yaw_deg": []}, "Invalid yaw_deg []: give at least one direction"),
        ({"criterion": "width", "turbulence": SEED, "yaw_deg": 200.0}, "Invalid yaw_deg [200.0]"),
        ({"scan_duration": 0.0}, "Invalid scan_duration 0.0 s"),
        ({"seed": -1}, "Invalid seed -1"),
    ],
)
def test_refusals(options, text):
    with pytest.raises(brs.InputError) as caught:
        brs.optimize_scan(**{"n_beams": 6, "max_angle_deg": 30.0, "criterion": "trace", **options})
    assert text in str(caught.value)


class TestFiles:
    @pytest.mark.parametrize("name", preset_names("scans"))
    def test_every_preset_survives_a_round_trip(self, name, tmp_path):
        scan = brs.load_scan(name, tilt_deg=4.0, yaw_deg=-7.5)
        back = brs.load_scan(brs.save_scan(scan, tmp_path / f"{name}.toml"))
        assert back.key == scan.key
        np.testing.assert_allclose(back.line_of_sight, scan.line_of_sight, atol=1e-15, rtol=1e-15)
        assert (back.name, back.title, back.source) == (scan.name, scan.title, scan.source)
        assert back.probe == scan.probe
        assert back.file_format == scan.file_format
        np.testing.assert_array_equal(back.beam, scan.beam)

    def test_words_with_quotes_and_lines(self, tmp_path):
        scan = replace(
            brs.load_scan("staring"),
            title='a "b" \\ c\nd\té',
            file_format={"columns": {"time": "c = 1"}},
        )
        back = brs.load_scan(brs.save_scan(scan, tmp_path / "x.toml"))
        assert (back.title, back.file_format) == (scan.title, scan.file_format)

    @pytest.mark.parametrize(
        "change",
        [
            {"beam_time": [0.0, 0.3]},
            {"focus_distance": [50.0, 98.0]},
            {"focus_distance": [50.0, 98.0], "beam_time": [0.3, 0.0], "beam": [4, 2]},
            {"beam_direction": [[-1.0, 0.0, 0.0]] * 2, "focus_distance": [50.0, 98.0], "beam": [1, 0]},
        ],
    )
    def test_beams_with_their_own_times_distances_and_numbers_survive_too(self, change, tmp_path):
        scan = replace(brs.load_scan("2-beam"), **{key: np.array(value) for key, value in change.items()})
        file = brs.save_scan(scan, tmp_path / "x.toml")
        assert brs.load_scan(file).key == scan.key
        if "focus_distance" in change and "beam_direction" in change:
            with pytest.raises(
                brs.InputError, match=r"to one direction, so focus_distance=70\.0 of all does not apply: wri"
            ):
                brs.load_scan(file, focus_distance=70.0)
        else:
            assert brs.load_scan(file, focus_distance=70.0).focus_distance.tolist() == [70.0, 70.0]

    def test_refusals(self, tmp_path):
        scan = brs.load_scan("2-beam-planes")
        with pytest.raises(brs.InputError, match=r"must end in \.toml"):
            brs.save_scan(scan, tmp_path / "x.txt")
        brs.save_scan(scan, tmp_path / "x.toml")
        with pytest.raises(brs.InputError, match="exists"):
            brs.save_scan(scan, tmp_path / "x.toml")
        brs.save_scan(brs.load_scan("2-beam"), tmp_path / "x.toml", overwrite=True)
        assert brs.load_scan(tmp_path / "x.toml").n_beam == 2


class TestCommand:
    def run(self, monkeypatch, capsys, *words):
        monkeypatch.setattr(sys, "argv", ["bayes-rs", "optimize", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return caught.value.code or 0, out, err

    def test_writes_scan_numbers_and_picture(self, monkeypatch, capsys, tmp_path):
        words = ("--beams", 6, "--max-angle", 45, "--criterion", "trace", "--focus-distance", 80, "--seed", 2)
        code, out, err = self.run(monkeypatch, capsys, *words, "--starts", 4, "-o", tmp_path / "out")
        assert (code, err) == (0, "")
        assert "12.6  " in out.replace("\n", "  ")
        assert "5 around one at 45°" in out
        assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
            "beams.png",
            "fingerprints.jsonl",
            "optimum.json",
            "run.json",
            "scan.toml",
        ]
        scan = brs.load_scan(tmp_path / "out" / "scan.toml")
        np.testing.assert_allclose(brs.design.scan_criterion(scan, "trace"), 12.6, rtol=REACHED)
        assert scan.focus_distance.tolist() == [80.0] * 6
        numbers = json.loads((tmp_path / "out" / "optimum.json").read_text(encoding="utf-8"))
        assert len(numbers["starts"]) == 4
        assert numbers["references"]["one cone at 45°"] is None  # does not see all stresses: no number in JSON
        same = brs.optimize_scan(
            n_beams=6, max_angle_deg=45.0, criterion="trace", focus_distance=80.0, seed=2, n_starts=4
        )
        np.testing.assert_allclose(scan.beam_direction, same.scan.beam_direction, atol=1e-15)
        code, _, err = self.run(monkeypatch, capsys, *words, "-o", tmp_path / "out")
        assert code == 2
        assert "exists" in err

    def test_limits_reach_the_search(self, monkeypatch, capsys, tmp_path):
        limits = (
            "--blocked",
            "240:300",
            "--min-elevation",
            -15,
            "--centre",
            "--cones",
            2,
            "--tilt",
            2,
            "--dwell",
            0.5,
        )
        code, _, _ = self.run(
            monkeypatch, capsys, "--beams", 7, "--rotor-radius", 50, "--criterion", "trace", "--starts", 2, *limits,
            "--min-spread", 20, "-o", tmp_path / "out",
        )  # fmt: skip
        assert code == 0
        asked = json.loads((tmp_path / "out" / "optimum.json").read_text(encoding="utf-8"))["asked_for"]
        expected = {
            "blocked_deg": [[240.0, 300.0]],
            "min_elevation_deg": -15.0,
            "centre": True,
            "cones": 2,
            "tilt_deg": 2.0,
            "seconds_a_scan": 3.5,
            "dwell": 0.5,
            "rotor_radius": 50.0,
            "min_spread_deg": 20.0,
        }
        assert {key: asked[key] for key in expected} == expected

    @pytest.mark.parametrize(
        ("words", "text"),
        [
            (("--beams", 6), "The beams have no limit"),
            (
                ("--beams", 6, "--max-angle", 30, "--blocked", "left"),
                "Invalid range 'left': write it as FROM:TO",
            ),
        ],
    )
    def test_bad_input_is_one_line(self, monkeypatch, capsys, tmp_path, words, text):
        code, _, err = self.run(monkeypatch, capsys, *words, "--criterion", "trace", "-o", tmp_path / "out")
        assert code == 2
        assert len(err.splitlines()) == 1
        assert text in err
        assert not (tmp_path / "out").exists()

    def test_every_option_has_a_word(self, monkeypatch, capsys):
        """All fields of both classes are options of the command."""
        _, out, _ = self.run(monkeypatch, capsys, "--help")
        for cls in (ScanLimits, CriterionOptions):
            for entry in options_of(cls):
                assert entry.flag in out, entry.name
        assert "/ --no-centre " in out

    def test_what_judges_a_scan_reaches_the_search(self, monkeypatch, capsys, tmp_path):
        words = ("--stress", "vv=3", "--stress", "uw", "--prior", "ratio", "--wind-speed", 8, "--duration", 300)
        more = ("--turbulence", "iec-a", "--yaw", 5, "--probe", "pulsed-4-beam", "--beams", 2, "--starts", 1)
        code, _, err = self.run(monkeypatch, capsys, "--max-angle", 30, *words, *more, "-o", tmp_path / "out")
        assert (code, err) == (0, "")
        best = json.loads((tmp_path / "out" / "optimum.json").read_text(encoding="utf-8"))
        options = {
            "stresses": ["vv=3", "uw"],
            "prior": "ratio",
            "wind_speed": 8.0,
            "duration": 300.0,
            "turbulence": ["iec-a"],
            "yaw_deg": [5.0],
        }
        assert {name: best["asked_for"][name] for name in options} == options
        scan = brs.load_scan(tmp_path / "out" / "scan.toml")
        assert scan.probe == brs.load_scan("pulsed-4-beam").probe
        assert brs.design.scan_criterion(scan, **options) == pytest.approx(best["value"], rel=1e-9)

    def test_summary_and_picture_of_a_width(self, tmp_path):
        best, said = run_optimize(
            3,
            tmp_path / "out",
            options={"max_angle_deg": 20.0, "turbulence": ["fu-2022", "stable-onshore"], "cones": 1},
            n_starts=2,
        )
        assert said == summary_lines(best)
        text = "\n".join(said)
        assert "in each state: fu-2022" in text
        assert "90 % widths over uu: uu" in text
        left, right = plot_optimum(best).axes
        dots = next(line for line in left.lines if line.get_marker() == "o")
        opening = np.hypot(dots.get_xdata(), dots.get_ydata())
        np.testing.assert_allclose(opening, best.angles_deg[:, 0], atol=1e-9)
        drawn = next(line for line in right.lines if line.get_marker() == "o")
        np.testing.assert_array_equal(drawn.get_ydata(), best.starts)
