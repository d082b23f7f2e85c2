"""Steadiness: fronts, ramps and trends of the wind, told from eddies by theory's own slow ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.fits.block_states import BlockStates

_N_NULL = 8000
_SEED = 11
_RAMPS = (40, 8, 4)  # ramps last a record over so many, but at least a part
_PLACES = (
    64  # fronts are a record over so many apart, but at least half a part; and long ramps an eighth of their length
)
_EDGE = 1.0  # parts that the middle of a front is away from either end at least
_USUAL = 0.01  # share of steady air that explains more by a shape than what families are compared at
_SMOOTH = (
    0.002  # share of a part's variance that is taken to be noise of its own, beside theory's; more hides fast eddies
)


class _Test(NamedTuple):
    """One test: of the component along (0) or across (1) the wind, for a family of shapes."""

    component: int
    family: str
    share: float


TESTS = (_Test(0, "trend", 0.3), _Test(0, "front", 0.45), _Test(1, "front", 0.1))
"""The tests of a record, and their shares of its false alarms; what is left to one is for what theory leaves out."""


class Modulation(NamedTuple):
    """Intermittency of the air: variance and time scale, s, of the logarithm of its strength."""

    depth: float = 0.0
    time_scale: float = 100.0


STEADY = Modulation()
"""Gaussian air."""


@dataclass(frozen=True, eq=False)
class ComponentTests:
    """The tests of one component in one state.

    Attributes
    ----------
    whitening : ndarray, shape (n_part − 1, n_part)
        From `whitening_of`.
    shapes : dict of str to ndarray, shape (n_shape, n_part)
        From `shapes_of`.
    null : dict of str to ndarray
        The statistic of each family in steady air, ascending.
    """

    whitening: FloatArray
    shapes: dict[str, FloatArray]
    null: dict[str, FloatArray]

    @cached_property
    def white(self) -> dict[str, FloatArray]:
        """Whitened shapes of unit length."""
        found = {name: shapes @ self.whitening.T for name, shapes in self.shapes.items()}
        return {name: shapes / np.linalg.norm(shapes, axis=-1, keepdims=True) for name, shapes in found.items()}


def shapes_of(n_part: int) -> dict[str, FloatArray]:
    """Return the changes that are looked for, by family, each (n_shape, n_part) from 0 to 1, means removed.

    Parameters
    ----------
    n_part : int
        Parts of a record.

    Returns
    -------
    shapes : dict of str to ndarray
        ``"trend"``: the line; ``"front"``: ramps of a fortieth, an eighth and a fourth of a record, each as the means
        of the parts see it, wherever in a part it may be.
    """
    front = []
    for share in _RAMPS:
        length = max(n_part / share, 1.0)
        between = max(n_part / _PLACES, 0.5, length / 8.0)
        away = max(0.5 * length, _EDGE)
        for middle in np.arange(away, n_part - away + 1e-9, between):
            since = np.arange(n_part + 1.0) - (middle - 0.5 * length)
            passed = np.clip(since, 0.0, length)
            front.append(np.diff(0.5 * passed**2 / length + np.maximum(since - length, 0.0)))
    trend = (np.arange(n_part) + 0.5) / n_part
    found = {"trend": trend[None], "front": np.array(front)}
    return {name: shapes - shapes.mean(axis=-1, keepdims=True) for name, shapes in found.items()}


def whitening_of(covariance: FloatArray) -> FloatArray:
    """Return what makes the deviations of parts from their mean independent and of variance one, (n_part − 1, n_part).

    Parameters
    ----------
    covariance : ndarray, shape (n_part,)
        Of the means of two parts, by how many parts they are apart.

    Returns
    -------
    whitening : ndarray, shape (n_part − 1, n_part)
        Its rows sum to zero.
    """
    number = len(covariance)
    matrix = scipy.linalg.toeplitz(covariance) + _SMOOTH * covariance[0] * np.eye(number)
    contrasts = scipy.linalg.null_space(np.ones((1, number))).T
    root = np.linalg.cholesky(contrasts @ matrix @ contrasts.T)
    return np.asarray(scipy.linalg.solve_triangular(root, contrasts, lower=True))


def statistic(white: FloatArray, shapes: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    r"""Return the largest share of a record's whitened winds that one shape explains, and which shape.

    Parameters
    ----------
    white : ndarray, shape (n_record, n_part − 1)
        Whitened winds z.
    shapes : ndarray, shape (n_shape, n_part − 1)
        Whitened shapes e of unit length.

    Returns
    -------
    share : ndarray, shape (n_record,)
        0 to 1.
    which : ndarray of int, shape (n_record,)
        Number of the shape.

    Notes
    -----
    .. math:: \max_e \frac{(e \cdot z)^2}{z \cdot z} .

    For one known shape this is the uniformly most powerful invariant test: the level of the turbulence drops out, and
    without a change the share is a Beta(1/2, (P − 2)/2) variable.
    """
    share = (white @ shapes.T) ** 2
    which = share.argmax(axis=-1)
    total = np.sum(white**2, axis=-1)
    largest = np.take_along_axis(share, which[:, None], axis=-1)[:, 0]
    return np.divide(largest, total, out=np.zeros_like(total), where=total > 0.0), which


@lru_cache(maxsize=1024)
def make_tests(
    covariance: tuple[float, ...], families: tuple[str, ...], duration: float, modulation: Modulation
) -> ComponentTests:
    """Return the tests of one component, with the statistics of steady air by simulation from that very covariance.

    Parameters
    ----------
    covariance : tuple of float
        Of the means of two parts, by how many parts they are apart.
    families : tuple of str
        Which families of `shapes_of` to look for.
    duration : float
        Length of a record, s.
    modulation : Modulation
        Intermittency of the air.

    Returns
    -------
    tests : ComponentTests
        Whitening, shapes, and the null distribution of each family.
    """
    number = len(covariance)
    apart = np.array(covariance)
    whitening = whitening_of(apart)
    tests = ComponentTests(whitening, {name: of for name, of in shapes_of(number).items() if name in families}, {})
    if modulation.depth > 0.0:
        matrix = scipy.linalg.toeplitz(apart) + _SMOOTH * apart[0] * np.eye(number)
        wind = _normal(number) @ np.linalg.cholesky(matrix).T * _strength(number, duration, modulation)
        white = wind @ whitening.T
    else:
        white = _normal(number - 1)  # in Gaussian air, whatever the covariance
    for name, of in tests.white.items():
        tests.null[name] = np.sort(statistic(white, of)[0])
    return tests


@lru_cache(maxsize=4)
def _normal(number: int) -> FloatArray:
    """Return independent normal numbers, (_N_NULL, number), the same for all tests."""
    return np.random.default_rng(_SEED).standard_normal((_N_NULL, number))


@lru_cache(maxsize=4)
def _strength(number: int, duration: float, modulation: Modulation) -> FloatArray:
    """Return by what the winds of parts are multiplied in intermittent air, (_N_NULL, number)."""
    keep = np.exp(-duration / number / modulation.time_scale)
    shock = np.random.default_rng(_SEED + 1).standard_normal((_N_NULL, number))
    found = shock.copy()
    for part in range(1, number):
        found[:, part] = keep * found[:, part - 1] + np.sqrt(1.0 - keep**2) * shock[:, part]
    return np.asarray(np.exp(0.5 * np.sqrt(modulation.depth) * found))


@dataclass(frozen=True)
class Changes:
    """What was found of changes of the wind.

    Parameters
    ----------
    p_value : ndarray, shape (n_record, 2)
        For the wind's components along and across: probability of a change as clear as the clearest one in steady air,
        multiplied such that a level is the share of false alarms of a record; NaN for records that were not compared.
    change : ndarray, shape (n_record, 2, n_part)
        The clearest change of each component, m/s, its mean removed.
    gradual : ndarray of bool, shape (n_record,)
        Whether the clearest of all is a trend over the whole record.
    """

    p_value: FloatArray
    change: FloatArray
    gradual: NDArray[np.bool_]

    def clear(self, level: float) -> NDArray[np.bool_]:
        """Return which components change at a level of false alarms, shape (n_record, 2)."""
        return np.asarray(np.nan_to_num(self.p_value, nan=1.0) < level)

    def size(self, level: float) -> FloatArray:
        """Return the changes from the first part to the last, m/s, (n_record, 2); 0 where none is clear, or NaN."""
        found = np.where(self.clear(level), self.change[..., -1] - self.change[..., 0], 0.0)
        return np.where(np.isnan(self.p_value).all(axis=-1, keepdims=True), np.nan, found)

    def added(self, level: float) -> FloatArray:
        """Return what clear changes add to uu, vv and uv of a record, m² s⁻², (n_record, 3).

        The mean over the record of the products of the changes: a²/12 for a trend of a, a² p (1 − p) for a step of a
        after the share p of the record.
        """
        own = np.where(self.clear(level)[..., None], self.change, 0.0)
        along, across = own[:, 0], own[:, 1]
        pairs = ((along, along), (across, across), (along, across))
        found = np.stack([np.mean(one * other, axis=-1) for one, other in pairs], axis=-1)
        return np.where(np.isnan(self.p_value).all(axis=-1, keepdims=True), np.nan, found)


def find_changes(records: xr.Dataset, states: BlockStates, modulation: Modulation = STEADY) -> Changes:
    """Test records for trends and fronts.

    Parameters
    ----------
    records : Dataset
        With ``part_wind`` and ``part_wind_across``.
    states : BlockStates
        Theory of these records.
    modulation : Modulation
        Intermittency of the air; by default none.

    Returns
    -------
    changes : Changes
        Of each record; p-values are averaged over the length scales that it may have. Records that are far shorter than
        their eddies are not compared.
    """
    n_record, n_part = records["part_wind"].shape
    wind = _components(records)
    p_value, change = np.ones((n_record, len(TESTS))), np.zeros((n_record, len(TESTS), n_part))
    clear = np.full((n_record, len(TESTS)), -np.inf)
    known = np.zeros(n_record, dtype=bool)
    for state, of_state, weight_of_state in states.groups():
        theory = states.theory(state)
        for component, covariance in enumerate(theory.wind):
            seen = np.isfinite(wind[of_state, component]).all(axis=-1)
            rows, weight = of_state[seen], weight_of_state[seen]
            own = [index for index, test in enumerate(TESTS) if test.component == component]
            families = tuple(TESTS[index].family for index in own)
            try:
                tests = make_tests(tuple(covariance.tolist()), families, states.duration, modulation)
            except np.linalg.LinAlgError:  # a record far shorter than its eddies: its parts differ by less than theory
                continue  # is exact to
            known[rows] = True
            for index in own:
                family, share = TESTS[index].family, _share(index, len(theory.wind))
                white = wind[rows, component] @ tests.whitening.T
                found, which = statistic(white, tests.white[family])
                null = tests.null[family]
                above = len(null) - np.searchsorted(null, found, side="left")
                p_value[rows, index] -= weight * (1.0 - np.minimum((1.0 + above) / (1.0 + len(null)) / share, 1.0))
                usual = null[int((1.0 - _USUAL) * len(null))]
                clear[rows, index] = np.logaddexp(clear[rows, index], np.log(weight * (1.0 - usual) / (1.0 - found)))
                shape = tests.shapes[family][which]
                size = np.sum(tests.white[family][which] * white, axis=-1)
                size /= np.linalg.norm(shape @ tests.whitening.T, axis=-1)
                change[rows, index] += (weight * size)[:, None] * shape
    best, smallest = np.empty((n_record, 2), dtype=np.int64), np.empty((n_record, 2))
    for component in range(2):
        own = [index for index, test in enumerate(TESTS) if test.component == component]
        best[:, component] = own[0] + clear[:, own].argmax(axis=-1)  # p-values end where the simulation does
        smallest[:, component] = p_value[:, own].min(axis=-1)
    return Changes(
        p_value=np.where(known[:, None], smallest, np.nan),
        change=change[np.arange(n_record)[:, None], best],
        gradual=np.asarray(clear.argmax(axis=-1) == 0),
    )


def _share(index: int, n_component: int) -> float:
    """Return the share of the false alarms that a test has; where only one component is seen, it has all of them."""
    there = sum(test.share for test in TESTS if test.component < n_component)
    return TESTS[index].share * sum(test.share for test in TESTS) / there


def _components(records: xr.Dataset) -> FloatArray:
    """Return the winds of the parts along and across each record's mean wind, (n_record, 2, n_part)."""
    yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64))
    level = [np.asarray(records[name].values, dtype=np.float64) for name in ("part_wind", "part_wind_across")]
    seen = np.isfinite(level[1]).all(axis=-1, keepdims=True)
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    along = np.where(seen, cos * level[0] - sin * level[1], level[0])
    return np.stack([along, np.where(seen, sin * level[0] + cos * level[1], np.nan)], axis=1)
