"""Theory against simulation: the noise of lines and of boxes, where boxes differ, and trends that others published."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from test_calibration import exact_covariance

from bayes_rs.geometry.probe import PointProbe, make_probe
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.noise.box_noise import noise_from_boxes
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.simulation.boxes import BoxGrid, BoxMaker
from bayes_rs.simulation.lines import LineMaker
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace

SEED = load_turbulence("fu-2022")
SMALL_EDDIES = MannTurbulence(dissipation=0.05, length_scale=20.0, gamma=2.0, name="small")
FLOWS = {"seed": (SEED, 10.0), "small eddies": (SMALL_EDDIES, 6.0)}  # turbulence, wind speed in m/s
N_RECORDS = 3000
SIGMAS = 4.5  # for each of up to 21 entries, or some hundred that are strongly correlated
SURE = 1e-4  # probability that a right theory fails one joint test
DIRECTIONS = 5  # leading directions of K that the joint tests look at: they hold most of its trace


def deviations(scan, flow, duration, n_records, seed=1, largest_negative_part=1e-6):
    """Return relative deviations of the beams' variances, shape (n_records, n_beam), and the theory's noise model."""
    turbulence, wind_speed = FLOWS[flow]
    noise = theory_noise(scan, turbulence, wind_speed=wind_speed, duration=duration)
    n_sample = round(duration / scan.scan_duration)
    maker = LineMaker(scan, turbulence, wind_speed=wind_speed, n_sample=n_sample)
    assert maker.negative_part < largest_negative_part
    batch = 500  # records held at a time
    rng = np.random.default_rng(seed)
    variance = np.concatenate([maker.make(batch, rng).var(axis=-1) for _ in range(n_records // batch)])
    return variance / expected_variance(noise) - 1.0, noise


def expected_variance(noise):
    return (1.0 + noise.bias[0]) * (noise.gain[0] @ noise.turbulence.stresses())


def sigmas(deviation, covariance):
    """Return how many standard errors each entry of the measured covariance is off; errors from fourth moments."""
    n = len(deviation)
    measured = deviation.T @ deviation / n
    fourth = (deviation**2).T @ deviation**2 / n
    return (measured - covariance) / np.sqrt((fourth - measured**2) / n)


def probabilities(deviation, noise):
    """Return the probabilities of so large a misfit of the means and of the covariances, if the theory is right.

    Deviations are projected on the leading directions of K and divided by their standard deviations. Their means then
    have the covariance 1/n by theory. Their products, of the mean 1 or 0 by theory, are tested with their own
    covariance (Hotelling's T²).
    """
    n = len(deviation)
    values, vectors = np.linalg.eigh(noise.covariance[0])
    count = min(DIRECTIONS, len(values))
    plain = deviation @ vectors[:, -count:] / np.sqrt(values[-count:])
    of_means = stats.chi2.sf(n * np.sum(plain.mean(axis=0) ** 2), count)
    row, column = np.triu_indices(count)
    product = plain[:, row] * plain[:, column] - (row == column)
    mean, covariance = product.mean(axis=0), np.cov(product, rowvar=False)
    size = len(row)
    hotelling = n * mean @ np.linalg.solve(covariance, mean)
    return of_means, stats.f.sf(hotelling * (n - size) / (size * (n - 1)), size, n - size)


@pytest.fixture(scope="module")
def at_45_degrees():
    """A scan, and what `deviations` finds for it."""
    scan = load_scan("6-beam", opening_angle_deg=45.0)
    return scan, *deviations(scan, "seed", 600.0, N_RECORDS)


class TestLines:
    @pytest.mark.parametrize("flow", FLOWS)
    @pytest.mark.parametrize(
        ("name", "duration", "n_records"),
        [
            ("4-beam", 600.0, N_RECORDS),
            ("6-beam", 600.0, N_RECORDS),
            ("50-beam", 120.0, N_RECORDS),
            pytest.param("50-beam", 600.0, N_RECORDS, marks=pytest.mark.long),
            pytest.param("spinnerlidar@probe=point", 100.0, N_RECORDS, marks=pytest.mark.long),
            pytest.param("spinnerlidar@probe=point", 600.0, 1000, marks=pytest.mark.long),
        ],
    )
    def test_bias_and_covariance_are_the_theorys(self, name, duration, n_records, flow):
        check_agreement(load_scan(name), duration, n_records, flow)

    @pytest.mark.parametrize("flow", FLOWS)
    def test_a_quarter_of_the_spinnerlidar(self, flow):
        scan = load_scan("spinnerlidar@probe=point")
        check_agreement(scan.select(scan.beam[::4]), 100.0, N_RECORDS, flow)

    def test_other_angles_yaw_and_tilt(self):
        check_agreement(
            load_scan("6-beam", opening_angle_deg=45.0, yaw_deg=20.0, tilt_deg=5.0), 600.0, N_RECORDS, "seed"
        )

    @pytest.mark.parametrize("flow", FLOWS)
    @pytest.mark.parametrize(
        "probe", [{"kind": "continuous-wave", "rayleigh_length": 6.1}, {"kind": "pulsed", "gate_length": 30.0}]
    )
    def test_with_a_probe_volume(self, probe, flow):
        scan = replace(load_scan("6-beam"), probe=make_probe(**probe))
        check_agreement(scan, 600.0, N_RECORDS, flow, largest_negative_part=5e-3)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"wind_speed": 12.0},
            {"duration": 500.0},
            {"yaw": 0.3},
            {"turbulence": MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=2.5)},
            {"detrend": "linear"},
        ],
        ids=lambda wrong: next(iter(wrong)),
    )
    def test_a_wrong_theory_is_caught(self, at_45_degrees, wrong):
        scan, deviation, noise = at_45_degrees
        right = {"turbulence": SEED, "wind_speed": 10.0, "duration": 600.0, "yaw": scan.yaw}
        other = theory_noise(scan, **{**right, **wrong})
        variance = (1.0 + deviation) * expected_variance(noise)
        assert min(probabilities(deviation, noise)) > SURE
        assert min(probabilities(variance / expected_variance(other) - 1.0, other)) < 0.01 * SURE

    @pytest.mark.parametrize(("flow", "least", "most"), [("seed", 0.8, 1.3), ("small eddies", 0.5, 0.8)])
    def test_variances_are_nearly_log_normal(self, flow, least, most):
        """Skewed, the more so the fewer eddies a record holds; their logarithms much less."""
        deviation, _ = deviations(load_scan("6-beam"), flow, 600.0, N_RECORDS)
        skewness, of_logs = stats.skew(deviation), stats.skew(np.log1p(deviation))
        assert np.all((skewness > least) & (skewness < most))  # 1.0 to 1.2, and 0.6 to 0.7; the error is 0.1
        assert np.all((of_logs > 0.0) & (of_logs < 0.35))  # 0.1 to 0.3; the error is 0.05

    def test_neighbouring_records_are_independent(self):
        deviation, _ = deviations(load_scan("4-beam"), "seed", 600.0, N_RECORDS)
        neighbours = np.mean(deviation[1:] * deviation[:-1], axis=0) / np.mean(deviation**2, axis=0)
        assert np.all(np.abs(neighbours) < SIGMAS / np.sqrt(N_RECORDS))


def check_agreement(scan, duration, n_records, flow, **options):
    """Fail if any entry, or all together, differ from theory by more than chance."""
    deviation, noise = deviations(scan, flow, duration, n_records, **options)
    standard = np.sqrt(np.diag(noise.covariance[0]) / n_records)
    assert np.abs(deviation.mean(axis=0) / standard).max() < SIGMAS
    off = sigmas(deviation, noise.covariance[0])
    assert np.abs(off).max() < SIGMAS
    of_means, of_covariances = probabilities(deviation, noise)
    assert of_means > SURE
    assert of_covariances > SURE


def box_noise(state, maker):
    """Return K and E[y] of boxes exactly, from their spectral tensor: `exact_covariance` a wave number at a time."""
    n_x, n_y, n_z = maker.grid.shape
    k1 = maker.wave_number
    k2, k3 = (2.0 * np.pi * np.fft.fftfreq(n, d) for n, d in zip((n_y, n_z), maker.grid.spacing[1:], strict=True))
    direction, count = state.line_of_sight, state.n_sample
    place = state.focus - np.outer(state.wind_speed * state.scan.beam_time, [1.0, 0.0, 0.0])
    wave = np.exp(1j * (k2[:, None] * place[:, 1, None, None] + k3 * place[:, 2, None, None]))
    cross = np.empty((len(k1), len(place), len(place)), dtype=np.complex128)
    for i in range(len(k1)):
        root = maker._tensor.spectral_vars[:, :, i].astype(np.float64)
        if i in (0, n_x // 2):
            root[:, :, :: n_y // 2, :: n_z // 2] *= np.sqrt(0.5)  # waves that are their own mirror image
        seen = np.einsum("bi,imyz->bmyz", direction, root) * (wave * probe_transfer_at(state, maker.grid, i))[:, None]
        seen = seen.reshape(len(place), -1)
        cross[i] = (1.0 if i in (0, n_x // 2) else 2.0) * maker.turbulence.dissipation * (seen @ seen.conj().T)
    lag = state.step * np.arange(1 - count, count)
    covariance, expected = np.empty((len(place), len(place))), np.empty(len(place))
    for a, b in np.ndindex(covariance.shape):
        by_lag = (np.exp(1j * np.outer(place[a, 0] - place[b, 0] + lag, k1)) @ cross[:, a, b]).real
        covariance[a, b] = 2.0 * toeplitz_inner(by_lag, by_lag, count, count) / count**2
        if a == b:
            expected[a] = toeplitz_trace(by_lag, count) / count
    return covariance / np.outer(expected, expected), expected


def probe_transfer_at(state, grid, i):
    """Return H(k·n) of each beam at the i-th k₁, shape (n_beam, n_y, n_z); mean over the signs of shortest waves."""
    if isinstance(state.scan.probe, PointProbe):
        return 1.0
    k = [2.0 * np.pi * np.fft.fftfreq(n, d) for n, d in zip(grid.shape, grid.spacing, strict=True)]
    shortest = [np.where(np.arange(n) == n // 2, -1.0, 1.0) for n in grid.shape]
    signs = list(np.ndindex(2 if i == grid.shape[0] // 2 else 1, 2, 2))
    total = 0.0
    for powers in signs:
        k_1, k_2, k_3 = (wave * sign**power for wave, sign, power in zip(k, shortest, powers, strict=True))
        wave = np.stack(np.broadcast_arrays(k_1[i], k_2[:, None], k_3))
        along = np.einsum("bi,iyz->byz", state.line_of_sight, wave)
        total = total + state.scan.probe.transfer(along, state.scan.focus_distance[:, None, None])
    return total / len(signs)


GRIDS = {  # points and spacing in L: some 10 ms a box; coarser boxes hold much in waves of two points, which are
    # cosines about the grid and so depend on where the beams are (`interpolation_weights`)
    "short and narrow": ((128, 14, 14), (0.2, 0.3, 0.3)),
    "long and wide": ((180, 28, 28), (0.2, 0.3, 0.3)),
}


def grid_of(size, turbulence):
    shape, spacing = GRIDS[size]
    return BoxGrid(shape, tuple(turbulence.length_scale * step for step in spacing))


class TestBoxes:
    @pytest.mark.parametrize("flow", FLOWS)
    @pytest.mark.parametrize("size", GRIDS)
    def test_covariance_is_that_of_the_same_truncated_periodic_flow(self, size, flow):
        turbulence, wind_speed = FLOWS[flow]
        state = RecordState(load_scan("4-beam", opening_angle_deg=30.0), wind_speed, 0.2, 60.0)
        grid = grid_of(size, turbulence)
        exact, expected = box_noise(state, BoxMaker(turbulence, grid))
        noise = noise_from_boxes([state], turbulence, 200, 1, grid=grid)[0]
        off = (noise.covariance[0] - exact) / noise.standard_error[0]
        assert np.abs(off).max() < SIGMAS
        radial = expected_variance_in_boxes(noise, turbulence, grid)
        np.testing.assert_allclose(radial, expected, rtol=1e-6)  # boxes are in single precision
        assert noise.details["mean_deviation_sigmas"] < SIGMAS

    def test_exact_covariance_is_the_slow_one(self):
        state, maker = (
            RecordState(load_scan("6-beam"), 10.0, 0.2, 30.0),
            BoxMaker(SEED, grid_of("short and narrow", SEED)),
        )
        fast, slow = box_noise(state, maker), exact_covariance(state, maker)
        np.testing.assert_allclose(fast[0], slow[0], rtol=1e-9)
        np.testing.assert_allclose(fast[1], slow[1], rtol=1e-9)

    @pytest.mark.parametrize("flow", FLOWS)
    @pytest.mark.parametrize(
        "width", [pytest.param(2.1, marks=pytest.mark.long), 6.0, pytest.param(12.0, marks=pytest.mark.long)]
    )
    def test_how_they_differ_from_an_infinite_domain(self, width, flow):
        """The table in docs/noise.md, whose numbers these are."""
        np.testing.assert_allclose(box_differences(width, flow), DIFFERENCES[flow, width], atol=0.0006)


def expected_variance_in_boxes(noise, turbulence, grid):
    tensor = BoxMaker(turbulence, grid).tensor
    n = load_scan("4-beam", opening_angle_deg=30.0).at_yaw(noise.yaw[0])
    return (1.0 + noise.bias[0]) * np.einsum("bi,ij,bj->b", n, tensor, n)


def box_differences(width, flow, probe=None):
    """Return E[y], its relative error, both of beam 0 over the theory's, the largest ratio of K, its Frobenius error.

    Six beams at 15°, 98 m; ten minutes; boxes three records long with L/12 by L/6 by L/6, but for those 2.1 L wide, the
    seed's study's 128 m: L/24 by L/30 by L/30.
    """
    turbulence, wind_speed = FLOWS[flow]
    along, across = (12.0, 6.0) if width > 3.0 else (24.0, 30.0)
    spacing = (turbulence.length_scale / along, *[turbulence.length_scale / across] * 2)
    length = 3.0 * 600.0 * wind_speed
    n_along, n_across = 2 * int(np.ceil(0.5 * length / spacing[0])), 2 * int(np.ceil(0.5 * width * across))
    scan = load_scan("6-beam") if probe is None else replace(load_scan("6-beam"), probe=probe)
    theory = theory_noise(scan, turbulence, wind_speed=wind_speed)
    maker = BoxMaker(turbulence, BoxGrid((n_along, n_across, n_across), spacing))
    covariance, expected = box_noise(RecordState(scan, wind_speed, 0.0, 600.0), maker)
    return (
        expected[0] / expected_variance(theory)[0],
        np.sqrt(covariance[0, 0] / theory.covariance[0, 0, 0]),
        np.max(covariance / theory.covariance[0]),
        np.linalg.norm(covariance - theory.covariance[0]) / np.linalg.norm(theory.covariance[0]),
    )


DIFFERENCES = {
    ("seed", 2.1): (1.013, 1.088, 1.244, 0.202),
    ("seed", 6.0): (0.967, 1.047, 1.136, 0.118),
    ("seed", 12.0): (0.960, 1.025, 1.079, 0.064),
    ("small eddies", 2.1): (1.000, 1.090, 9.445, 0.759),
    ("small eddies", 6.0): (0.962, 1.064, 1.471, 0.189),
    ("small eddies", 12.0): (0.955, 1.043, 1.185, 0.116),
}


class TestPublishedTrends:
    """What is known of the sampling errors of lidars' second moments."""

    @pytest.mark.parametrize("name", ["fu-2022", "iec-b"])
    def test_half_an_hour_leaves_more_than_a_tenth_of_the_along_wind_variance_uncertain(self, name):
        noise = theory_noise(load_scan("staring"), load_turbulence(name), wind_speed=10.0, duration=1800.0)
        assert 0.1 < noise.relative_error[0, 0] < 0.2

    def test_errors_fall_with_the_root_of_the_duration(self):
        short, long = (
            theory_noise(load_scan("staring"), SEED, wind_speed=10.0, duration=duration).relative_error[0, 0]
            for duration in (3600.0, 4.0 * 3600.0)
        )
        assert short / long == pytest.approx(2.0, rel=0.05)

    def test_a_larger_opening_angle_lowers_the_error_of_lateral_stresses(self):
        errors = [least_squares_error(opening_angle_deg=angle) for angle in (10.0, 15.0, 20.0, 30.0, 45.0)]
        assert np.all(np.diff(errors, axis=0) < 0.0)

    def test_a_larger_focus_distance_raises_the_error_of_lateral_stresses(self):
        """Beams further apart see eddies that are less alike, whose differences pass for lateral stresses."""
        errors = [least_squares_error(focus_distance=distance) for distance in (30.0, 60.0, 98.0, 150.0, 250.0)]
        assert np.all(np.diff(errors, axis=0) > 0.0)

    def test_at_fifteen_degrees_the_error_of_vv_is_more_than_twice_vv(self):
        assert least_squares_error()[0] > 2.0 * SEED.stresses()[1]


def least_squares_error(**scan_options):
    """Return the standard deviations of vv and ww by least squares, m² s⁻², from ten minutes of six beams."""
    noise = theory_noise(load_scan("6-beam", **scan_options), SEED, wind_speed=10.0)
    expected = expected_variance(noise)
    solve = np.linalg.pinv(noise.gain[0])
    return np.sqrt(np.diag(solve @ (noise.covariance[0] * np.outer(expected, expected)) @ solve.T))[1:3]
