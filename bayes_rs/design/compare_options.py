"""Options of a comparison of scans: the keywords of `compare`, and those of the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_rs._validation import as_items, check_choice, check_count, check_positive, check_seed
from bayes_rs.design.estimators import ESTIMATORS
from bayes_rs.errors import InputError
from bayes_rs.intervals import EQUAL_TAILED, INTERVALS
from bayes_rs.options import described, option
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

METHODS = ("fast", "full", "both")
TARGETS = ("record", "ensemble")
_FAST, _FULL = 128, 200  # records of a scene


@described
@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of a comparison of scans.

    Raises
    ------
    InputError
        If a value is not valid.
    """

    turbulence: str | MannTurbulence | tuple[str | MannTurbulence, ...] = option(
        "fu-2022",
        "Turbulence of the flow, by its name or file; of several, each is a case of its own",
        choices="bayes_rs.models:TURBULENCES",
        open=True,
    )
    prior: str | Prior | tuple[str | Prior, ...] = option(
        "weak", "Prior; of several, each is a case of its own", choices="bayes_rs.priors.registry:PRIORS", open=True
    )
    wind_speed: float = option(10.0, "Mean wind speed", unit="m/s")
    duration: float | Sequence[float] = option(
        600.0, "Length of a record; several are compared with each other", unit="s"
    )
    target: str = option(
        "record", "Which R is the truth: that of the record, or that of the ensemble, as in a fit", choices=TARGETS
    )
    method: str = option(
        "fast",
        "fast: variances of records are drawn from the noise, evenly; full: records are simulated, and treated as "
        "measured ones are",
        choices=METHODS,
    )
    n_records: int | None = option(
        None, f"Records for each scene; {_FAST} for fast and {_FULL} for full if not given", flag="--records"
    )
    estimators: str | Sequence[str] | None = option(
        None,
        "Classic estimators beside the posterior; all if not given",
        choices="bayes_rs.design.estimators:ESTIMATORS",
        flag="--estimator",
    )
    interval: str = option(
        EQUAL_TAILED,
        "Which credible intervals: equal-tailed, with as much probability below as above, or highest-density, the "
        "narrowest",
        choices=tuple(INTERVALS),
    )
    seed: int = option(1, "Same seed, same numbers")

    def __post_init__(self) -> None:
        check_choice(self.method, METHODS, what="method of comparison")
        check_choice(self.target, TARGETS, what="target")
        check_positive(self.wind_speed, what="wind_speed", unit="m/s")
        for duration in self.durations:
            check_positive(duration, what="duration", unit="s")
        if not self.durations or len(set(self.durations)) < len(self.durations):
            raise InputError(f"Invalid duration {self.duration!r}: give at least one, and each once.")
        if self.n_records is not None:
            check_count(self.n_records, what="n_records", minimum=2)
        for name in self.classic:
            check_choice(name, tuple(ESTIMATORS), what="estimator")
        check_choice(self.interval, tuple(INTERVALS), what="interval")
        check_seed(self.seed)

    @property
    def durations(self) -> tuple[float, ...]:
        """The record lengths, s."""
        several = isinstance(self.duration, (tuple, list, np.ndarray))
        return tuple(self.duration) if several else (self.duration,)  # type: ignore[arg-type, return-value]

    @property
    def classic(self) -> tuple[str, ...]:
        """The classic estimators."""
        if isinstance(self.estimators, str):
            return (self.estimators,)
        return tuple(ESTIMATORS) if self.estimators is None else tuple(as_items(self.estimators, what="estimators"))

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of records."""
        return ("fast", "full") if self.method == "both" else (self.method,)

    def flows(self) -> list[MannTurbulence]:
        """Return the turbulences."""
        given = [self.turbulence] if isinstance(self.turbulence, (str, MannTurbulence)) else list(self.turbulence)
        return [as_turbulence(flow) for flow in given]

    def priors(self) -> list[Prior]:
        """Return the priors."""
        given = [self.prior] if isinstance(self.prior, (str, Prior)) else list(self.prior)
        return [make_prior(prior) for prior in given]

    def count(self, kind: str) -> int:
        """Return the number of records of this kind."""
        return self.n_records or (_FAST if kind == "fast" else _FULL)
