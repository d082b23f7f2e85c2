"""The interface of all priors, and what several of them share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_generator, check_choice, check_count, check_prob
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.html_parts import bars, card
from bayes_rs.intervals import EQUAL_TAILED, INTERVALS, interval_of
from bayes_rs.sizes import check_size

N_COORDINATE = 6
"""Number of coordinates of most priors: one for each stress."""

_WIDTH_DRAWS = 200_000
_WIDTH_SEED = 20
_SHOWN_DRAWS = 4000
"""Draws of a prior that is shown: its ends are good to a few per cent, as much as a picture shows."""


class Prior(ABC):
    """The narrow interface of all priors: a name, words, unbounded coordinates and the map from them to stresses."""

    name: str

    @property
    def n_coordinate(self) -> int:
        """Number of coordinates; six for most."""
        return N_COORDINATE

    @abstractmethod
    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates, shape (..., n_coordinate), to stresses, shape (..., 6), m² s⁻²; smooth."""

    @abstractmethod
    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the normalized log-density, shape (...), of coordinates, shape (..., n_coordinate); smooth."""

    @abstractmethod
    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior, shape (n_draw, n_coordinate)."""

    @abstractmethod
    def in_words(self) -> str:
        """Say in one line what the prior assumes."""

    def __repr__(self) -> str:
        """Say in one line what it is."""
        return f"<{type(self).__name__}: {self.in_words()}>"

    def _repr_html_(self) -> str:
        """Say in a notebook what the prior assumes, with a picture of the shape of R that it expects."""
        draws = self.draw(_SHOWN_DRAWS, _WIDTH_SEED)
        low, middle, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
        middle[np.abs(middle) < 3e-3 * (high - low)] = 0.0  # Monte-Carlo error
        rows = [("assumes", self.in_words())]
        rows += [
            (name, f"median {middle[index]:.3g} m² s⁻², 90 % between {low[index]:.3g} and {high[index]:.3g}")
            for index, name in enumerate(STRESSES)
        ]
        left, centre, right = np.quantile(draws[:, 1:] / draws[:, :1], [0.05, 0.5, 0.95], axis=0)
        names = [f"{name}/uu" for name in STRESSES[1:]]
        picture = bars(centre, left, right, names, "median and 90 % interval of ratios", (-1.0, 2.0))
        return card(f"Prior {self.name}", rows, picture)

    def draw(self, n_draw: int, seed: int | np.random.Generator) -> FloatArray:
        """Draw stresses from the prior, shape (n_draw, 6), m² s⁻²."""
        count = check_count(n_draw, what="n_draw")
        check_size(f"{count} draws of the prior", 400.0 * count, "draw fewer.")
        return self.stress(self.draw_coordinate(count, as_generator(seed)))

    def interval_widths(self, prob: float = 0.9, interval: str = EQUAL_TAILED) -> FloatArray:
        """Return the width of the interval of each stress, shape (6,), m² s⁻².

        From 200 000 draws with a fixed seed; the relative error is below a per cent for 90 % unless the prior's tails
        are very long.
        """
        low, high = interval_of(self.draw(_WIDTH_DRAWS, _WIDTH_SEED).T, prob, interval)
        return np.asarray(high - low)

    def widened(self, factor: float) -> Self:
        """Return the same prior with all its widths multiplied by `factor`: for checks of what the prior decides."""
        raise InputError(f"Prior {self.name!r} cannot be widened by {factor:g}: give it the method `widened`.")

    def for_records(self, wind_speed: FloatArray, group: Sequence[object] | None = None) -> Prior:  # noqa: ARG002 - for priors that differ
        """Return the prior of records of these wind speeds, shape (n_record,), m/s, and groups.

        It is this prior itself, unless the prior knows how stresses depend on the wind speed or on the group.
        """
        return self

    def take(self, records: NDArray[np.int64]) -> Prior:  # noqa: ARG002 - for priors that differ
        """Return the prior of some of the records: this prior itself, unless it differs from record to record."""
        return self


def _like(coordinate: FloatArray) -> FloatArray:
    """Return an empty array of the shape of coordinates (..., 6), each of the six a run of numbers unless all six are.

    Of many draws of several records what is calculated of one of the six then takes half of the time.
    """
    if coordinate.strides[-1] == coordinate.itemsize:
        return np.empty_like(coordinate, dtype=np.float64)
    return np.moveaxis(np.empty((coordinate.shape[-1], *coordinate.shape[:-1])), 0, -1)


def sum_of_squares(values: FloatArray) -> FloatArray:
    """Return Σ v² over the last axis, to the last bit NumPy's sum; where another axis is a run, without a copy."""
    if values.strides[-1] == values.itemsize:
        return np.asarray(np.sum(values * values, axis=-1))
    return np.asarray(np.einsum("...k,...k->...", values, values))


class NormalPrior(Prior):
    """A prior whose coordinates are independent and standard normal: all of its content is in the map."""

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density of the coordinates, which are independent and standard normal."""
        square = sum_of_squares(np.asarray(coordinate, dtype=np.float64))
        return np.asarray(-0.5 * square - 0.5 * self.n_coordinate * np.log(2.0 * np.pi))

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        return rng.standard_normal((n_draw, self.n_coordinate))


_HALF_LOGARITHMS = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
"""Those of standard deviations, in place of variances."""


class LogRatioPrior(NormalPrior):
    """A prior of ln uu, ln vv/uu, ln ww/uu and artanh of ρ_uv, ρ_uw and ρ_vw·u: normal and independent."""

    @property
    @abstractmethod
    def centre(self) -> FloatArray:
        """Means of these six numbers, shape (6,)."""

    @property
    @abstractmethod
    def spread(self) -> FloatArray:
        """Standard deviations of these six numbers, shape (6,)."""

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses."""
        return _stress_of_ratios(coordinate, self.centre, self.spread)

    def interval_widths(self, prob: float = 0.9, interval: str = EQUAL_TAILED) -> FloatArray:
        """Return the same, found once for each prior: it takes longer than all the rest of a small fit."""
        check_prob(prob)
        check_choice(interval, tuple(INTERVALS), what="interval")
        return np.array(_kept_widths(tuple(self.centre), tuple(self.spread), float(prob), interval))

    def coordinate(self, stress: FloatArray) -> FloatArray:
        """Return the coordinates, shape (..., 6), of positive definite stresses, shape (..., 6), m² s⁻²."""
        return np.asarray((log_ratios(stress) - self.centre) / self.spread)


def _stress_of_ratios(coordinate: FloatArray, centre: FloatArray, spread: FloatArray) -> FloatArray:
    inner = np.multiply(spread * _HALF_LOGARITHMS, coordinate, out=_like(coordinate))
    inner += centre * _HALF_LOGARITHMS
    inner[..., 1] += inner[..., 0]
    inner[..., 2] += inner[..., 0]
    sd, rho = inner[..., :3], inner[..., 3:]
    return _stress_from_deviations(np.exp(sd, out=sd), np.tanh(rho, out=rho), _like(inner))


@lru_cache(maxsize=64)
def _kept_widths(centre: tuple[float, ...], spread: tuple[float, ...], prob: float, interval: str) -> tuple[float, ...]:
    coordinate = as_generator(_WIDTH_SEED).standard_normal((_WIDTH_DRAWS, N_COORDINATE))
    low, high = interval_of(_stress_of_ratios(coordinate, np.array(centre), np.array(spread)).T, prob, interval)
    return tuple((high - low).tolist())


def log_ratios(stress: FloatArray) -> FloatArray:
    """Return ln uu, ln vv/uu, ln ww/uu and artanh of ρ_uv, ρ_uw and ρ_vw·u, shape (..., 6), of stresses (..., 6)."""
    uu, vv, ww, uv, uw, vw = np.moveaxis(stress, -1, 0)
    rho_uv, rho_uw, rho_vw = uv / np.sqrt(uu * vv), uw / np.sqrt(uu * ww), vw / np.sqrt(vv * ww)
    partial = (rho_vw - rho_uv * rho_uw) / np.sqrt((1.0 - rho_uv**2) * (1.0 - rho_uw**2))
    fisher = np.arctanh(np.stack([rho_uv, rho_uw, partial], axis=-1))
    return np.concatenate([np.stack([np.log(uu), np.log(vv / uu), np.log(ww / uu)], axis=-1), fisher], axis=-1)


def stress_from_correlations(log_uu: FloatArray, log_vv: FloatArray, log_ww: FloatArray, rho: FloatArray) -> FloatArray:
    """Build stresses from log-variances and (ρ_uv, ρ_uw, partial ρ_vw·u); realizable for every |ρ| ≤ 1."""
    sd = np.exp(0.5 * np.stack([log_uu, log_vv, log_ww], axis=-1))
    return _stress_from_deviations(sd, rho, np.empty((*log_uu.shape, N_COORDINATE)))


def _stress_from_deviations(sd: FloatArray, rho: FloatArray, out: FloatArray) -> FloatArray:
    """Build stresses from standard deviations of u, v, w, (..., 3), and what `stress_from_correlations` takes."""
    sd_u, sd_v, sd_w = sd[..., 0], sd[..., 1], sd[..., 2]
    rho_uv, rho_uw, partial = rho[..., 0], rho[..., 1], rho[..., 2]
    uu, vv, ww, uv, uw, vw = (out[..., index] for index in range(N_COORDINATE))
    for correlation, rest in ((rho_uv, vw), (rho_uw, uw)):
        np.subtract(1.0, np.multiply(correlation, correlation, out=rest), out=rest)
    np.sqrt(np.multiply(vw, uw, out=vw), out=vw)
    np.multiply(vw, partial, out=vw)
    np.add(vw, np.multiply(rho_uv, rho_uw, out=uv), out=vw)  # ρ_vw
    np.multiply(vw, np.multiply(sd_v, sd_w, out=uv), out=vw)
    np.multiply(rho_uv, np.multiply(sd_u, sd_v, out=uv), out=uv)
    np.multiply(rho_uw, np.multiply(sd_u, sd_w, out=uw), out=uw)
    for one, variance in ((sd_u, uu), (sd_v, vv), (sd_w, ww)):
        np.multiply(one, one, out=variance)
    return out


def log_ratios_from_stress(stress: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Return ln uu, ln vv/uu, ln ww/uu, artanh of ρ_uv, ρ_uw and of the partial ρ_vw·u, shape (..., 6); into `out`.

    That is the inverse of `stress_from_correlations`. What is not realizable, or is at the edge, is not finite.
    """
    uu, _, _, uv, uw, vw = (stress[..., index] for index in range(N_COORDINATE))
    root = np.sqrt(stress[..., :3])
    sd_u, sd_v, sd_w = root[..., 0], root[..., 1], root[..., 2]
    found = np.empty_like(stress) if out is None else out  # keeps the layout in memory
    rho_uv, rho_uw, partial = found[..., 3], found[..., 4], found[..., 5]
    np.divide(uv, sd_u * sd_v, out=rho_uv)
    np.divide(uw, sd_u * sd_w, out=rho_uw)
    np.divide(vw, sd_v * sd_w, out=partial)
    partial -= rho_uv * rho_uw
    partial /= np.sqrt((1.0 - rho_uv * rho_uv) * (1.0 - rho_uw * rho_uw))
    np.arctanh(found[..., 3:], out=found[..., 3:])
    np.divide(stress[..., 1:3], stress[..., :1], out=found[..., 1:3])
    found[..., 0] = uu
    np.log(found[..., :3], out=found[..., :3])
    return found
