"""A prior that a campaign has learnt: normal in another prior's coordinates, with the size by wind speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from bayes_rs._validation import FloatArray, check_positive
from bayes_rs._version import __version__
from bayes_rs.errors import InputError
from bayes_rs.priors.interface import N_COORDINATE, LogRatioPrior, Prior
from bayes_rs.priors.ratio import RatioPrior, WeakPrior
from bayes_rs.toml_file import Table, Text, invalid_file, read_toml, toml_value

_BASES: dict[str, type[WeakPrior] | type[RatioPrior]] = {"weak": WeakPrior, "ratio": RatioPrior}
_FORMAT = "campaign prior of bayes_rs"


@dataclass(frozen=True, eq=False)
class LearntGroup:
    """What a campaign has learnt of the records of one group.

    Parameters
    ----------
    mean : ndarray, shape (6,)
        Mean of the base prior's coordinates over the campaign's own wind speeds.
    covariance : ndarray, shape (6, 6)
        Their covariance, the uncertainty of the mean included.
    size_mean : ndarray, shape (n_speed,)
        Mean of the first coordinate, the size, at each wind speed of the table.
    size_covariance : ndarray, shape (n_speed, 6)
        Covariance of the size with all six coordinates at each wind speed.
    n_record : int
        Number of the campaign's records in the group.
    """

    mean: FloatArray
    covariance: FloatArray
    size_mean: FloatArray
    size_covariance: FloatArray
    n_record: int


@dataclass(frozen=True, eq=False, repr=False)
class CampaignPrior(Prior):
    """The distribution that a campaign's records came from: normal in the coordinates of the prior it began with.

    Parameters
    ----------
    base : LogRatioPrior
        The prior that the campaign began with: `WeakPrior` or `RatioPrior`.
    wind_speed : ndarray, shape (n_speed,)
        Wind speeds of the tables of the size, m/s; they rise.
    groups : dict of str to LearntGroup
        By the name of the group; ``""`` is what is known of a record whose group is not known, or is new.
    n_record : int
        Number of records that it was learnt from.

    Raises
    ------
    InputError
        If a covariance is not positive definite, or a shape does not fit.

    Notes
    -----
    The coordinates are those of the base prior, which were standard normal there: ln uu, ln vv/uu, ln ww/uu and the
    Fisher transforms of the correlations, each less its centre and over its width. Here they are normal with the mean
    E[μ] and the covariance E[Σ] + Cov[μ] of the campaign (`bayes_rs.campaign`), so that a direction that the campaign
    has not seen keeps the mean 0 and the variance 1 of the base prior.

    By itself it is the prior of a record at one of the campaign's wind speeds, one as probable as it was there.
    `for_records` takes the wind speed of each record.
    """

    base: LogRatioPrior
    wind_speed: FloatArray
    groups: dict[str, LearntGroup]
    n_record: int
    name: str = "campaign"

    def __post_init__(self) -> None:
        """Check the tables."""
        n = len(self.wind_speed)
        if n < 1 or not np.all(np.diff(self.wind_speed) > 0.0) or not self.wind_speed[0] > 0.0:
            raise InputError("Invalid wind_speed of prior 'campaign': the speeds must be above zero and rise.")
        if "" not in self.groups:
            raise InputError("Invalid groups of prior 'campaign': the entry '' for records of no group is missing.")
        for name, group in self.groups.items():
            shapes = {
                "mean": (N_COORDINATE,),
                "covariance": (N_COORDINATE, N_COORDINATE),
                "size_mean": (n,),
                "size_covariance": (n, N_COORDINATE),
            }
            for key, shape in shapes.items():
                value = getattr(group, key)
                if value.shape != shape or not np.all(np.isfinite(value)):
                    raise InputError(
                        f"Invalid {key} of group {name!r} of prior 'campaign': it must be finite and of shape {shape}."
                    )
            smallest = min(
                float(np.linalg.eigvalsh(matrix)[..., 0].min())
                for matrix in (group.covariance, _with_size(group.covariance, group.size_covariance))
            )
            if not smallest > 0.0 or not np.allclose(group.covariance, group.covariance.T, rtol=0.0, atol=1e-9):
                raise InputError(
                    f"Invalid covariance of group {name!r} of prior 'campaign': it must be symmetric and positive "
                    f"definite, and its smallest eigenvalue is {smallest:.3g}."
                )

    @property
    def mean(self) -> FloatArray:
        """Mean of the coordinates of a record of no known wind speed and group, shape (6,)."""
        return self.groups[""].mean

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coordinates of a record of no known wind speed and group, shape (6, 6)."""
        return self.groups[""].covariance

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses, as the base prior does."""
        return self.base.stress(coordinate)

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the normal log-density of the coordinates."""
        return _log_normal(coordinate - self.mean, _cholesky(self.covariance))

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates from the prior."""
        root = _cholesky(self.covariance)
        return np.asarray(self.mean + rng.standard_normal((n_draw, N_COORDINATE)) @ root.T)

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        middle = self.base.centre + self.base.spread * self.mean
        width = 1.96 * self.base.spread * np.sqrt(np.diag(self.covariance))
        sizes = [
            f"{what} about {np.exp(middle[i]):.3g} (factor {np.exp(width[i]):.2g})"
            for i, what in enumerate(("uu", "vv/uu", "ww/uu"))
        ]
        correlations = [
            f"{what} {np.tanh(middle[i] - width[i]):.2f} to {np.tanh(middle[i] + width[i]):.2f}"
            for i, what in ((3, "uv"), (4, "uw"), (5, "vw given u"))
        ]
        return (
            f"campaign: learnt from {self.n_record} records that began with {self.base.name!r}; {', '.join(sizes)}; "
            f"correlations {', '.join(correlations)} (95 %)"
        )

    def widened(self, factor: float) -> Self:
        """Return the prior with all standard deviations of its coordinates times `factor`."""
        check_positive(factor, what="factor", unit="", where="prior 'campaign'")
        square = factor**2
        groups = {
            name: replace(group, covariance=square * group.covariance, size_covariance=square * group.size_covariance)
            for name, group in self.groups.items()
        }
        return replace(self, groups=groups)

    def for_records(self, wind_speed: FloatArray, group: Sequence[object] | None = None) -> RecordsPrior:
        """Return the prior of records of these wind speeds and groups.

        Parameters
        ----------
        wind_speed : ndarray, shape (n_record,)
            Mean wind speeds, m/s; beyond the table it ends at its last value. A record without one (NaN) gets what is
            known without the wind speed.
        group : sequence of n_record, optional
            The records' groups; one that the campaign did not have is a record of no group.

        Returns
        -------
        prior : RecordsPrior
            With a mean and a covariance for each record.
        """
        speed = np.asarray(wind_speed, dtype=np.float64)
        names = [""] * len(speed) if group is None else [str(name) for name in group]
        names = [name if name in self.groups else "" for name in names]
        mean, covariance = np.empty((len(speed), N_COORDINATE)), np.empty((len(speed), N_COORDINATE, N_COORDINATE))
        for name in set(names):
            rows = np.flatnonzero(np.array([one == name for one in names]))
            mean[rows], covariance[rows] = self._at(self.groups[name], speed[rows])
        return RecordsPrior(self.base, mean, _cholesky(covariance))

    def _at(self, group: LearntGroup, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means (n, 6) and covariances (n, 6, 6) at wind speeds (n,), linear in ln U between the table's."""
        known = speed > 0.0
        place = np.interp(
            np.log(np.where(known, speed, 1.0)), np.log(self.wind_speed), np.arange(len(self.wind_speed), dtype=float)
        )
        low = np.minimum(place.astype(np.int64), max(len(self.wind_speed) - 2, 0))
        high = np.minimum(low + 1, len(self.wind_speed) - 1)
        share = (place - low)[:, None]
        mean = np.broadcast_to(group.mean, (len(speed), N_COORDINATE)).copy()
        size = (1.0 - share[:, 0]) * group.size_mean[low] + share[:, 0] * group.size_mean[high]
        mean[:, 0] = np.where(known, size, mean[:, 0])
        row = (1.0 - share) * group.size_covariance[low] + share * group.size_covariance[high]
        return mean, _with_size(group.covariance, np.where(known[:, None], row, group.covariance[0]))

    def save(self, path: str | Path) -> None:
        """Write the prior to a TOML file, which `load_campaign_prior` and the prior ``"campaign:FILE"`` read.

        Parameters
        ----------
        path : str or Path
            The file; it is replaced.
        """
        base = {key: value for key, value in asdict(self.base).items() if key != "name"}  # type: ignore[call-overload] # a dataclass
        lines = [
            f"format = {toml_value(_FORMAT)}",
            f"version = {toml_value(__version__)}",
            f"n_record = {self.n_record}",
            f"base = {toml_value({'name': self.base.name, **base})}",
            f"wind_speed = {toml_value([float(speed) for speed in self.wind_speed])}",
        ]
        for name, group in self.groups.items():
            lines += ["", "[[group]]", f"name = {toml_value(name)}", f"n_record = {group.n_record}"]
            for field in fields(group)[:-1]:
                value = getattr(group, field.name)
                lines.append(f"{field.name} = {_rows(value.tolist())}")
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


@dataclass(frozen=True, eq=False, repr=False)
class RecordsPrior(Prior):
    """A normal prior of another prior's coordinates, with a mean and a covariance for each record.

    Parameters
    ----------
    base : Prior
        The prior whose coordinates and map these are.
    mean : ndarray, shape (n_record, 6)
        Means of the coordinates.
    root : ndarray, shape (n_record, 6, 6)
        Lower Cholesky factors of their covariances.
    """

    base: Prior
    mean: FloatArray
    root: FloatArray
    name: str = "campaign"

    def stress(self, coordinate: FloatArray) -> FloatArray:
        """Map coordinates to stresses, as the base prior does."""
        return self.base.stress(coordinate)

    def log_density(self, coordinate: FloatArray) -> FloatArray:
        """Return the log-density, shape (n_record, n_draw), of coordinates, shape (n_record, n_draw, 6)."""
        return _log_normal(coordinate - self.mean[:, None, :], self.root)

    def draw_coordinate(self, n_draw: int, rng: np.random.Generator) -> FloatArray:
        """Draw coordinates of records, each of which is as probable as any other; shape (n_draw, 6)."""
        record = rng.integers(len(self.mean), size=n_draw)
        normal = rng.standard_normal((n_draw, N_COORDINATE))
        return np.asarray(self.mean[record] + (self.root[record] @ normal[..., None])[..., 0])

    def in_words(self) -> str:
        """Say in one line what the prior assumes."""
        return f"campaign: the prior of a campaign at the wind speeds of {len(self.mean)} records"

    def widened(self, factor: float) -> Self:
        """Return the prior with all standard deviations of its coordinates times `factor`."""
        check_positive(factor, what="factor", unit="", where="prior 'campaign'")
        return replace(self, root=factor * self.root)

    def take(self, records: NDArray[np.int64]) -> RecordsPrior:
        """Return the prior of some of the records."""
        return RecordsPrior(self.base, self.mean[records], self.root[records])


class _Group(Table):
    name: Text
    n_record: Annotated[int, Field(ge=0)]
    mean: list[float]
    covariance: list[list[float]]
    size_mean: list[float]
    size_covariance: list[list[float]]


class _File(Table):
    format: Literal["campaign prior of bayes_rs"]
    version: Text
    n_record: Annotated[int, Field(ge=1)]
    base: dict[str, Any]
    wind_speed: list[float]
    group: list[_Group]


def load_campaign_prior(path: str | Path) -> CampaignPrior:
    """Read a prior that a campaign has learnt.

    Parameters
    ----------
    path : str or Path
        A file of `CampaignPrior.save`.

    Returns
    -------
    prior : CampaignPrior
        The prior.

    Raises
    ------
    InputError
        If there is no such file, or it does not hold such a prior.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(
            f"There is no file {str(path)!r} to read a prior from: give the file that a campaign's prior was saved to."
        )
    try:
        table = _File.model_validate(read_toml(file))
    except ValidationError as error:
        raise invalid_file("campaign prior", file, error) from None
    try:
        kind = _BASES[table.base["name"]]
        base = kind(**{key: value for key, value in table.base.items() if key != "name"})
        groups = {
            one.name: LearntGroup(
                np.array(one.mean, dtype=np.float64),
                np.array(one.covariance, dtype=np.float64),
                np.array(one.size_mean, dtype=np.float64),
                np.array(one.size_covariance, dtype=np.float64),
                one.n_record,
            )
            for one in table.group
        }
        return CampaignPrior(base, np.array(table.wind_speed, dtype=np.float64), groups, table.n_record)
    except (KeyError, TypeError, ValueError) as error:
        reason = str(error) if isinstance(error, InputError) else "its base or a table of numbers cannot be used"
        raise InputError(f"Invalid campaign prior file {str(path)!r}: {reason}") from None


def _cholesky(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def _with_size(covariance: FloatArray, row: FloatArray) -> FloatArray:
    """Return covariances (n, 6, 6) with their first row and column replaced by `row` (n, 6)."""
    whole = np.broadcast_to(covariance, (len(row), N_COORDINATE, N_COORDINATE)).copy()
    whole[:, 0, :] = row
    whole[:, :, 0] = row
    return whole


def _log_normal(centred: FloatArray, root: FloatArray) -> FloatArray:
    """Return the normal log-density of coordinates less their mean; `root` is (6, 6), or (n_record, 6, 6)."""
    whitening = np.linalg.solve(root, np.eye(N_COORDINATE))
    whitened = centred @ whitening.swapaxes(-1, -2)
    log_volume = np.log(np.diagonal(whitening, axis1=-2, axis2=-1)).sum(axis=-1)
    square = np.sum(whitened**2, axis=-1, dtype=np.float64)
    constant = log_volume if root.ndim == 2 else log_volume[:, None]
    return np.asarray(constant - 0.5 * square - 0.5 * N_COORDINATE * np.log(2.0 * np.pi))


def _rows(values: list[Any]) -> str:
    """Return a list as TOML, a list of lists with one line for each."""
    if values and isinstance(values[0], list):
        return "[\n" + "".join(f"  {toml_value(row)},\n" for row in values) + "]"
    return toml_value(values)
