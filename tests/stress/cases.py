"""Random cases, one a seed, and what must hold for each: high-precision references, and laws that no numbers escape.

Every check takes a random generator, draws its own scene, and raises AssertionError with the numbers where the law is
broken. `test_random_cases.py` runs some seeds of each in every run of the tests, `long_run.py` as many as time allows.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import mpmath
import numpy as np
import xarray as xr
from scenes import plain_noise, records_of

import bayes_rs as brs
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.likelihoods.log_normal import log_normal_likelihood
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.posteriors import diagnostics
from bayes_rs.turbulence.toeplitz import toeplitz_inner, toeplitz_trace

EPS = np.finfo(np.float64).eps
DIGITS = 50
SMALL = np.array([0.02, 0.02, 0.02, 0.0, 0.0, 0.0])
"""Added where no direction may be without turbulence, m² s⁻²."""
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def random_tensor(rng: np.random.Generator, *, log_size: float = 6.0) -> np.ndarray:
    """Return stresses of any size and anisotropy, realizable; now and then of one or two components."""
    rank = int(rng.choice([3, 3, 3, 2, 1]))
    root = rng.standard_normal((3, rank)) * 10.0 ** rng.uniform(-2.0, 0.0, rank)
    tensor = root @ root.T * 10.0 ** rng.uniform(-log_size, log_size)
    return np.array([tensor[i, j] for i, j in PAIRS])


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def random_scan(
    rng: np.random.Generator, n_beam: int | None = None, *, most: int = 8, widest: float = np.pi
) -> brs.Scan:
    """Return beams in any directions within an angle of −x, near and far, timed in any order."""
    count = int(rng.integers(1, most + 1)) if n_beam is None else n_beam
    angle = np.arccos(1.0 - rng.uniform(0.0, 1.0, count) * (1.0 - np.cos(widest)))
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    unit = np.stack([-np.cos(angle), np.sin(angle) * np.cos(phase), np.sin(angle) * np.sin(phase)], axis=-1)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    duration = 10.0 ** rng.uniform(-1.0, 1.0)
    return brs.Scan(
        "random",
        unit,
        10.0 ** rng.uniform(1.0, 3.0, count),
        rng.uniform(0.0, duration, count) * (1.0 - 1e-9),
        duration,
        beam=rng.permutation(1000)[:count],
        tilt=float(rng.normal(0.0, 0.1)),
        yaw=float(rng.uniform(-np.pi, np.pi)),
    )


def random_covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a relative covariance whose condition may be up to 1e8."""
    values = 10.0 ** (-rng.uniform(0.0, 8.0) * np.linspace(0.0, 1.0, n)) * 10.0 ** rng.uniform(-3.0, 0.0)
    q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    covariance = q @ np.diag(values) @ q.T
    return 0.5 * (covariance + covariance.T)


def directions_and_radial_variances(rng: np.random.Generator) -> None:
    """Beam vectors after tilt and yaw, and n·Rn, in 50 digits."""
    scan, stress = random_scan(rng), random_tensor(rng)
    with mpmath.workdps(DIGITS):
        ca, sa, cy, sy = (
            mpmath.mpf(1) * f(mpmath.mpf(float(x))) for x in (scan.tilt, scan.yaw) for f in (mpmath.cos, mpmath.sin)
        )
        tilt = mpmath.matrix([[ca, 0, -sa], [0, 1, 0], [sa, 0, ca]])
        yaw = mpmath.matrix([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
        tensor = mpmath.matrix(3, 3)
        for value, (i, j) in zip(stress.tolist(), PAIRS, strict=True):
            tensor[i, j] = tensor[j, i] = mpmath.mpf(value)
        exact_direction, exact_variance = [], []
        for vector in scan.beam_direction.tolist():
            n = mpmath.matrix([vector]) * tilt * yaw
            exact_direction.append([float(n[i]) for i in range(3)])
            exact_variance.append(float((n * tensor * n.T)[0]))
    np.testing.assert_allclose(scan.line_of_sight, exact_direction, rtol=0.0, atol=8.0 * EPS)
    size = np.abs(stress[:3]).max()
    np.testing.assert_allclose(
        brs.geometry.radial_variance(scan, stress), exact_variance, rtol=0.0, atol=64.0 * EPS * size
    )


def laws_of_radial_variances(rng: np.random.Generator) -> None:
    """Rotation of everything, n → −n, scaling, order of beams, and the mirror image."""
    scan, stress, q = random_scan(rng), random_tensor(rng), random_rotation(rng)
    n = scan.line_of_sight
    variance = brs.geometry.design_matrix(n) @ stress
    tolerance = 128.0 * EPS * np.abs(stress[:3]).max()
    for other in (
        brs.geometry.design_matrix(n @ q) @ brs.geometry.rotate_stress(stress, q),
        brs.geometry.design_matrix(-n) @ stress,
        brs.geometry.design_matrix(n * [1.0, -1.0, 1.0]) @ (stress * [1, 1, 1, -1, 1, -1]),
        brs.geometry.design_matrix(n) @ (stress * 2.0**40) / 2.0**40,
    ):
        np.testing.assert_allclose(other, variance, rtol=0.0, atol=tolerance)
    order = rng.permutation(scan.n_beam)
    np.testing.assert_array_equal(
        brs.geometry.radial_variance(scan.select(scan.beam[order]), stress),
        brs.geometry.radial_variance(scan, stress)[order],
    )
    assert np.all(variance >= -tolerance), "a realizable tensor has a negative variance"


def principal_variances(rng: np.random.Generator) -> None:
    """Eigenvalues in 50 digits; sums and products of them do not change when axes turn."""
    stress, q = random_tensor(rng), random_rotation(rng)
    with mpmath.workdps(DIGITS):
        uu, vv, ww, uv, uw, vw = (mpmath.mpf(value) for value in stress.tolist())
        values = mpmath.eigsy(mpmath.matrix([[uu, uv, uw], [uv, vv, vw], [uw, vw, ww]]), eigvals_only=True)
        exact = sorted(float(value) for value in values)
    size = max(abs(exact[0]), abs(exact[-1]))
    np.testing.assert_allclose(
        np.sort(brs.geometry.principal_variances(stress)), exact, rtol=0.0, atol=32.0 * EPS * size
    )
    turned = brs.geometry.rotate_stress(stress, q)
    np.testing.assert_allclose(
        np.sort(brs.geometry.principal_variances(turned)), exact, rtol=0.0, atol=128.0 * EPS * size
    )
    np.testing.assert_array_equal(brs.geometry.pack_stress(brs.geometry.unpack_stress(stress)), stress)


def toeplitz_sums(rng: np.random.Generator) -> None:
    """⟨PAP, PBP⟩ and tr PAP with fractions, no rounding anywhere."""
    n_row, n_column = int(rng.integers(2, 9)), int(rng.integers(2, 9))
    detrend = str(rng.choice(["mean", "linear"])) if min(n_row, n_column) > 2 else "mean"
    a, b = rng.integers(-50, 50, (2, n_row + n_column - 1))

    def dense(diagonal: np.ndarray) -> list[list[Fraction]]:
        return [[Fraction(int(diagonal[j - i + n_row - 1])) for j in range(n_column)] for i in range(n_row)]

    def without(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
        return [
            list(column)
            for column in zip(*[_detrended(list(column), detrend) for column in zip(*matrix, strict=True)], strict=True)
        ]

    def both(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
        return without([_detrended(row, detrend) for row in matrix])

    left, right = both(dense(a)), both(dense(b))
    exact = sum(x * y for one, other in zip(left, right, strict=True) for x, y in zip(one, other, strict=True))
    size = float(np.abs(a).max() * np.abs(b).max() * n_row * n_column) + 1.0
    found = float(toeplitz_inner(a, b, n_row, n_column, detrend=detrend))
    assert abs(found - float(exact)) <= 256.0 * EPS * size, (found, float(exact))
    if n_row == n_column:
        trace = sum(left[i][i] for i in range(n_row))
        found = float(toeplitz_trace(a, n_row, detrend=detrend))
        assert abs(found - float(trace)) <= 256.0 * EPS * size, (found, float(trace))


def _detrended(values: list[Fraction], detrend: str) -> list[Fraction]:
    n = len(values)
    mean = sum(values) / n
    rest = [value - mean for value in values]
    if detrend == "mean":
        return rest
    line = [Fraction(2 * i - n + 1, 2) for i in range(n)]
    slope = sum(x * y for x, y in zip(line, rest, strict=True)) / sum(x * x for x in line)
    return [y - slope * x for x, y in zip(line, rest, strict=True)]


def isotropic_covariances(rng: np.random.Generator) -> None:
    """Two points in isotropic von Kármán turbulence: Bessel functions in 50 digits."""
    flow = brs.MannTurbulence(10.0 ** rng.uniform(-4, 1), 10.0 ** rng.uniform(0, 3), 0.0)
    apart = rng.standard_normal(3) * flow.length_scale * 10.0 ** rng.uniform(-5.0, 1.3)
    uu = flow.stresses()[0]
    with mpmath.workdps(DIGITS):
        r = mpmath.sqrt(sum(mpmath.mpf(x) ** 2 for x in apart.tolist())) / mpmath.mpf(flow.length_scale)
        third = mpmath.mpf(1) / 3
        scale = mpmath.mpf(2) ** (2 * third) / mpmath.gamma(third) * r**third
        f = scale * mpmath.besselk(third, r)
        g = f - scale * r * mpmath.besselk(2 * third, r) / 2
        unit = [mpmath.mpf(x) / mpmath.mpf(flow.length_scale) / r for x in apart.tolist()]
        exact = [[float((f - g) * unit[i] * unit[j] + (g if i == j else 0)) for j in range(3)] for i in range(3)]
        # the variance itself, (2/3) ∫E(k) dk with E = αε^(2/3) L^(5/3) (kL)^4 / (1 + k²L²)^(17/6)
        energy = mpmath.beta(mpmath.mpf(5) / 2, third) / 2
        variance = float(2 * third * energy) * flow.dissipation * flow.length_scale ** (2.0 / 3.0)
    np.testing.assert_allclose(uu, variance, rtol=1e-8)
    found = brs.turbulence.velocity_covariance(apart, flow) / uu
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-4)  # the tolerance that it is asked for


def covariances_of_places(rng: np.random.Generator) -> None:
    """Any set of places has a positive semi-definite covariance, symmetric and even, to the tolerance."""
    flow = brs.MannTurbulence(
        10.0 ** rng.uniform(-3, 1), 10.0 ** rng.uniform(0.5, 3), float(rng.choice([0.0, 1.0, 3.2, 5.0]))
    )
    n = int(rng.integers(2, 7))
    place = rng.standard_normal((n, 3)) * flow.length_scale * 10.0 ** rng.uniform(-3.0, 1.0)
    apart = place[None] - place[:, None]
    found = brs.turbulence.velocity_covariance(apart, flow) / flow.stresses()[0]
    np.testing.assert_allclose(found, found.swapaxes(0, 1), rtol=0.0, atol=2e-4)
    whole = found.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)
    lowest = np.linalg.eigvalsh(0.5 * (whole + whole.T))[0]
    assert lowest >= -1e-4 * 3 * n, lowest


def noise_of_random_scenes(rng: np.random.Generator) -> None:
    """Noise by theory: finite, positive semi-definite, and unmoved by order, duplication, reversal and units."""
    scan = random_scan(rng, most=5)
    flow = brs.MannTurbulence(
        10.0 ** rng.uniform(-3, 1), 10.0 ** rng.uniform(0.5, 3), float(rng.choice([0.0, 2.0, 3.2, 5.0]))
    )
    duration = scan.scan_duration * 10.0 ** rng.uniform(1.0, 3.0)
    options = {
        "wind_speed": 10.0 ** rng.uniform(-0.3, 1.5),
        "duration": duration,
        "detrend": str(rng.choice(["mean", "linear"])),
    }
    noise = theory_noise(scan, flow, **options)
    assert np.all(np.isfinite(noise.covariance[0]))
    values = np.linalg.eigvalsh(noise.covariance[0])
    assert values[0] >= -64.0 * EPS * scan.n_beam * values[-1], values
    size = np.abs(noise.covariance[0]).max()
    order = rng.permutation(scan.n_beam)
    mixed = theory_noise(scan.select(scan.beam[order]), flow, **options)
    # each scene may be lifted to the nearest semi-definite matrix, by the error that it promises at most
    lifted = 64.0 * EPS * size + 2.0 * max(noise.details["negative_part"], mixed.details["negative_part"]) * values[-1]
    np.testing.assert_allclose(
        mixed.covariance[0], noise.covariance[0][np.ix_(order, order)], rtol=1e-9, atol=1e-9 * size + lifted
    )
    stronger = theory_noise(scan, replace(flow, dissipation=flow.dissipation * 10.0 ** rng.uniform(-6, 6)), **options)
    # a record that is short beside the eddies keeps a small part of their variance, and rounding is large beside it
    rounding = 1e-10 * size / (1.0 + noise.bias[0].min())
    np.testing.assert_allclose(stronger.covariance[0], noise.covariance[0], rtol=1e-9, atol=rounding)
    factor = 10.0 ** rng.uniform(-1.0, 1.0)
    larger = theory_noise(
        replace(scan, focus_distance=factor * scan.focus_distance),
        replace(flow, length_scale=factor * flow.length_scale),
        **{**options, "wind_speed": factor * options["wind_speed"]},
    )
    np.testing.assert_allclose(larger.covariance[0], noise.covariance[0], rtol=1e-7, atol=1e-8 * size + lifted)


def likelihoods_in_high_precision(rng: np.random.Generator) -> None:
    """The log-normal density with any well-posed beams, in 50 digits."""
    n_beam = int(rng.integers(1, 7))
    scan = random_scan(rng, n_beam)
    matrix = brs.geometry.design_matrix(scan)
    if np.linalg.cond(matrix @ matrix.T) > 1e8:
        return  # beams nearly alike: reduced to what they see, a different density
    covariance = random_covariance(rng, n_beam)
    truth, other = random_tensor(rng), random_tensor(rng)
    level = matrix @ truth
    if np.any(level <= 1e-10 * truth[:3].max()) or np.any(matrix @ other <= 1e-10 * other[:3].max()):
        return  # a beam along which there is nothing: its logarithm is of rounding
    variance = level * np.exp(rng.standard_normal(n_beam) * 0.2)
    offset = float(rng.choice([0.0, 0.1])) * float(level.min())
    other = other * (truth[:3].sum() / other[:3].sum())
    try:
        likelihood = log_normal_likelihood(
            variance[None], np.ones((1, n_beam), dtype=bool), matrix[None], covariance[None], offset
        )
    except NotPositiveDefiniteError:
        with mpmath.workdps(DIGITS):  # ln(1 + K) element by element need not be positive where K is nearly singular
            assert (
                float(mpmath.eigsy(_log_covariance(covariance), eigvals_only=True)[0])
                < 1e-9 * np.log1p(covariance).max()
            )
        return
    found = likelihood.log_density(np.stack([truth, other])[None])[0]
    with mpmath.workdps(DIGITS):
        c = _log_covariance(covariance)
        determinant, exact = mpmath.log(mpmath.det(c)), []
        for stress in (truth, other):
            residual = mpmath.matrix(n_beam, 1)
            for b in range(n_beam):
                mean = sum(mpmath.mpf(float(x)) * mpmath.mpf(float(y)) for x, y in zip(matrix[b], stress, strict=True))
                residual[b] = (
                    mpmath.log(mpmath.mpf(float(variance[b]))) - mpmath.log(mean + mpmath.mpf(offset)) + c[b, b] / 2
                )
            square = (residual.T * mpmath.lu_solve(c, residual))[0]
            exact.append(float(-(square + determinant + n_beam * mpmath.log(2 * mpmath.pi)) / 2))
    values = np.linalg.eigvalsh(np.log1p(covariance))
    condition = values[-1] / values[0]
    # a beam's expected variance is rounded relative to the largest stress; an error d of a residual r changes the
    # exponent by d C^-1 r, at most d |C^-1/2 r| / sqrt(lowest)
    rounding = 64.0 * EPS * max((r[:3].sum() / (matrix @ r)).max() for r in (truth, other))
    slack = rounding * np.sqrt(2.0 * np.abs(exact) + 10.0 * n_beam) / np.sqrt(values[0])
    for one, reference, more in zip(found, exact, slack, strict=True):
        assert abs(one - reference) <= more + (1e3 * EPS * condition + 1e-12) * (1.0 + abs(reference)), (one, reference)


def _log_covariance(covariance: np.ndarray) -> mpmath.matrix:
    n = len(covariance)
    c = mpmath.matrix(n, n)
    for i, j in itertools.product(range(n), range(n)):
        c[i, j] = mpmath.log(1 + mpmath.mpf(float(covariance[i, j])))
    return c


def laws_of_likelihoods(rng: np.random.Generator) -> None:
    """Order of beams, units and n → −n change differences of the log-likelihood by rounding only."""
    n_beam = int(rng.integers(2, 12))
    scan = random_scan(rng, n_beam, widest=1.2)
    matrix = brs.geometry.design_matrix(scan.line_of_sight)
    root = rng.standard_normal((n_beam, 2 * n_beam)) * 0.1
    covariance = root @ root.T / (2 * n_beam) + 0.01 * np.eye(n_beam)
    stress = np.array([random_tensor(rng, log_size=0.5) + SMALL for _ in range(3)])
    variance = matrix @ stress[0] * np.exp(0.2 * rng.standard_normal(n_beam))
    used = rng.random(n_beam) < 0.8
    used[0] = True
    order, size = rng.permutation(n_beam), 10.0 ** rng.uniform(-6.0, 6.0)

    def differences(y: np.ndarray, a: np.ndarray, k: np.ndarray, use: np.ndarray, r: np.ndarray) -> np.ndarray:
        density = log_normal_likelihood(y[None], use[None], a[None], k[None], 0.0).log_density(r[None])[0]
        return np.asarray(density[1:] - density[0])

    first = differences(variance, matrix, covariance, used, stress)
    scale = 1.0 + np.abs(first)
    others = [
        differences(variance[order], matrix[order], covariance[np.ix_(order, order)], used[order], stress),
        differences(variance, brs.geometry.design_matrix(-scan.line_of_sight), covariance, used, stress),
        differences(size * variance, matrix, covariance, used, size * stress),
    ]
    for other in others:
        assert np.all(np.abs(other - first) <= 1e-7 * scale), (first, other)


def priors_give_realizable_tensors(rng: np.random.Generator) -> None:
    """Any coordinates give a tensor that is realizable to rounding, with a finite density."""
    name = str(rng.choice(["weak", "flat", "ratio:vv=0.7,ww=0.4", "mann"]))
    prior = brs.priors.make_prior(name)
    coordinate = rng.standard_normal((50, prior.n_coordinate)) * 10.0 ** rng.uniform(-1.0, 0.5)
    stress = prior.stress(coordinate)
    density = prior.log_density(coordinate)
    assert np.all(np.isfinite(stress)), name
    assert not np.any(np.isnan(density)), name
    lowest = brs.geometry.principal_variances(stress).min(axis=-1)
    assert np.all(lowest >= -64.0 * EPS * stress[:, :3].sum(axis=-1)), (name, lowest.min())


def estimators_recover_exact_variances(rng: np.random.Generator) -> None:
    """Variances without error give back the stresses, whatever scan sees them all, wind direction and units."""
    scan = random_scan(rng, int(rng.integers(6, 12)))
    stress, yaw = random_tensor(rng), rng.uniform(-180.0, 180.0)
    stress = stress / max(1.0, stress[:3].sum() / 800.0)  # more is not believed
    matrix = brs.geometry.design_matrix(scan.at_yaw(np.deg2rad(yaw)))
    condition = np.linalg.cond(matrix)
    if condition > 1e6:
        return
    records = records_of((matrix @ stress)[None], scan, yaw_deg=yaw)
    found = brs.estimate(records, scan, method="lsq")["stress"].values[0]
    np.testing.assert_allclose(found, stress, rtol=0.0, atol=256.0 * EPS * condition * np.abs(stress[:3]).max())


def records_of_random_series(rng: np.random.Generator) -> None:
    """Mean and variance of each record with fractions; order of rows, NaN and gaps change nothing else."""
    n_beam, n_record = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    scan = random_scan(rng, n_beam, widest=1.0)
    start = np.datetime64("2021-03-01", "ns") + 600 * int(rng.integers(0, 50)) * np.timedelta64(10**9, "ns")
    second, beam, velocity = [], [], []
    mean, size = 10.0 ** rng.uniform(-2, 1.6), 10.0 ** rng.uniform(-3, 1)
    for record, number in itertools.product(range(n_record), scan.beam.tolist()):
        count = int(rng.integers(12, 30))
        second += (600.0 * record + np.sort(rng.choice(5990, count, replace=False)) / 10.0).tolist()
        beam += [number] * count
        velocity += (mean + size * rng.standard_normal(count)).tolist()
    order = rng.permutation(len(second))
    time = start + (np.array(second) * 1e9).round().astype("timedelta64[ns]")
    series = xr.Dataset(
        {"radial_velocity": ("sample", np.array(velocity)[order])},
        coords={"time": ("sample", time[order]), "beam": ("sample", np.array(beam)[order])},
    )
    records = brs.make_records(series, scan, min_availability=0.0, min_count=2)
    assert records.sizes["record"] == n_record
    for record, number in itertools.product(range(n_record), scan.beam.tolist()):
        mine = [
            Fraction(v) for s, b, v in zip(second, beam, velocity, strict=True) if b == number and s // 600 == record
        ]
        average = sum(mine) / len(mine)
        spread = float(sum((v - average) ** 2 for v in mine) / len(mine))
        of = records.sel(beam=number).isel(record=record)
        assert int(of["count"]) == len(mine)
        assert abs(float(of["mean"]) - float(average)) <= 16.0 * EPS * (mean + size)
        # the velocities themselves are rounded: 2 eps v of each deviation, so 4 eps v sd of the variance
        assert abs(float(of["variance"]) - spread) <= 32.0 * EPS * (mean + size) * np.sqrt(spread) + 64.0 * EPS * spread


def posteriors_follow_their_data(rng: np.random.Generator) -> None:
    """Scaled data give a scaled posterior; beams in another order the same one; both within Monte-Carlo error."""
    scan = random_scan(rng, int(rng.integers(3, 8)), widest=0.8).with_yaw(0.0)
    noise = plain_noise(scan, relative_variance=10.0 ** rng.uniform(-2.5, -0.7), reach=10.0 ** rng.uniform(0.5, 2.5))
    truth = random_tensor(rng, log_size=0.5) + SMALL
    variance = brs.geometry.design_matrix(scan) @ truth * np.exp(0.1 * rng.standard_normal(scan.n_beam))
    size = 10.0 ** rng.uniform(-6.0, 6.0)
    order = rng.permutation(scan.n_beam)
    mixed = scan.select(scan.beam[order])
    fits = [
        (variance, scan, noise, 1.0),
        (size * variance, scan, noise, size),
        (variance[order], mixed, noise.select(mixed.beam), 1.0),
    ]
    tables = []
    for data, of, with_noise, unit in fits:
        prior = brs.priors.WeakPrior(median_uu=unit)  # the prior has a size, too
        seed = int(rng.integers(1000))
        result = brs.fit(records_of(data[None], of), of, noise=with_noise, seed=seed, sampler="auto", prior=prior)
        table = result.summary().set_index("stress")
        tables.append((table["mean"] / unit, table["sd"] / unit, table["mcse_mean"] / unit))
    mean, sd, error = tables[0]
    for other_mean, _, other_error in tables[1:]:
        distance = np.abs(other_mean - mean) / np.hypot(error, other_error)
        assert float(distance.max()) < 6.0, distance.to_dict()
    assert np.all(sd > 0.0)


def diagnostics_do_not_know_units(rng: np.random.Generator) -> None:
    """Effective sample sizes and R-hat of a·x + b are those of x."""
    chains, draws = 2 * int(rng.integers(1, 4)), int(rng.integers(20, 200))
    x = np.cumsum(rng.standard_normal((1, chains, draws)), axis=-1) * rng.uniform(0.0, 0.2) + rng.standard_normal(
        (1, chains, draws)
    )
    x = np.round(x * 2.0**20) / 2.0**20  # so that a shift is exact, and makes and breaks no ties
    factor, shift = float(rng.choice([-1.0, 1.0])) * 2.0 ** int(rng.integers(-20, 20)), 2.0 ** int(rng.integers(-3, 3))
    for of in (diagnostics.ess_bulk, diagnostics.ess_tail, lambda y: diagnostics.r_hat(y, 2)):
        np.testing.assert_allclose(of(factor * x), of(x), rtol=1e-9)
        np.testing.assert_allclose(of(x + shift), of(x), rtol=1e-9)


def bad_numbers_are_refused(rng: np.random.Generator) -> None:
    """A number that is none gives one line that names it, never a traceback of another kind."""
    bad = float(rng.choice([np.nan, np.inf, -np.inf, -1.0, 0.0]))
    flow = brs.load_turbulence("fu-2022")
    scan = brs.load_scan("4-beam")
    calls: list[Callable[[], object]] = [
        lambda: brs.MannTurbulence(bad, 61.0, 3.2),
        lambda: brs.MannTurbulence(0.05, bad, 3.2),
        lambda: brs.noise.calibrate(scan, flow, wind_speed=bad),
        lambda: brs.noise.calibrate(scan, flow, wind_speed=10.0, duration=bad),
        lambda: brs.simulate(scan, flow, wind_speed=bad, seed=1),
        lambda: brs.load_scan("4-beam", focus_distance=bad),
        lambda: brs.Scan("x", [[0.0, 0.0, 1.0]], [bad], [0.0], 1.0),
        lambda: brs.Scan("x", [[0.0, 0.0, 1.0]], [10.0], [0.0], bad),
    ]
    call = calls[int(rng.integers(len(calls)))]
    try:
        call()
    except InputError as error:
        text = str(error)
        assert "\n" not in text, text
        assert len(text) > 20, text
    else:
        raise AssertionError(f"{bad} was taken")


CHECKS: dict[str, Callable[[np.random.Generator], None]] = {
    check.__name__: check
    for check in (
        directions_and_radial_variances,
        laws_of_radial_variances,
        principal_variances,
        toeplitz_sums,
        isotropic_covariances,
        covariances_of_places,
        noise_of_random_scenes,
        likelihoods_in_high_precision,
        laws_of_likelihoods,
        priors_give_realizable_tensors,
        estimators_recover_exact_variances,
        records_of_random_series,
        posteriors_follow_their_data,
        diagnostics_do_not_know_units,
        bad_numbers_are_refused,
    )
}
"""All checks by name."""


def run(name: str, seed: int) -> None:
    """Run one case; the same name and seed are the same case."""
    CHECKS[name](np.random.default_rng([seed, *name.encode()]))
