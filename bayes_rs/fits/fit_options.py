"""The options of a fit: what is the same for all its records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayes_rs._validation import (
    check_choice,
    check_count,
    check_finite,
    check_non_negative,
    check_positive,
    check_prob,
    check_seed,
)
from bayes_rs.errors import InputError, in_short
from bayes_rs.fits.derived import check_derived
from bayes_rs.intervals import EQUAL_TAILED, INTERVALS
from bayes_rs.options import described, nearest, option, options_of
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.posteriors.sampling import SAMPLERS
from bayes_rs.posteriors.sampling.effort import ESS_MARGIN, Effort
from bayes_rs.priors.interface import LogRatioPrior
from bayes_rs.priors.registry import Prior, make_prior

TARGETS = {
    "record": "the expected tensor of one averaging period, its own mean removed",
    "ensemble": "the tensor of an infinite record",
    "sonic": "the tensor that a sonic at the lidar would have measured in this very record",
}
"""Which R a fit is of, in words."""
INFORMATION = ("variances", "covariances")
"""What of a record the posterior is made of."""
SCATTERS = ("records", "theory")
"""What says how much variances scatter."""
DRAWS = ("auto", "none", "float32", "float64")
"""What is kept of the draws."""
OWN_TURBULENCE = "records"
"""Name of the turbulence that the records themselves have."""
USUAL_TURBULENCE = "fu-2022"
"""The turbulence where nothing is known of it."""
CAMPAIGN = ("auto", "on", "off")
"""Whether the records' common prior is learnt."""
CAMPAIGN_FROM = 30
"""Fitted, steady records from which on ``campaign="auto"`` learns their common prior."""
CAMPAIGN_GROUPS = ("wind_speed", "direction", "hour")
"""Classes of records that a campaign knows by itself; the others are variables of the records."""
CAMPAIGN_PRIORS = ("weak", "ratio")
"""Priors whose distribution over a campaign can be learnt."""
MOST_KEPT = 2000
"""Records up to which ``draws="auto"`` keeps the draws: about 0.1 MB each."""


@described
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Options of a fit: prior, sampler, what is uncertain beside R, and what is reported.

    Raises
    ------
    InputError
        If an option is not valid, or two do not go together.

    Notes
    -----
    The target ``"sonic"`` needs noise that was made with ``sonic=True``, and the log-normal likelihood. The sampler
    ``"emcee"`` is one ensemble for many records, driven by proposals that are fitted to each; ``"direct"`` draws
    independently from such proposals, weights and resamples; ``"auto"`` is direct, and emcee for the records whose
    weights are too uneven for that. All give the same posterior. A chain that still misses the target effective sample
    size, or the `monte_carlo_error` that is asked for, after `max_extension` doublings is flagged. Beams whose variance
    is below half of the noise that records hold or tell are left out and flagged.

    Examples
    --------
    >>> FitOptions(prior="flat", prob=0.5).target
    'record'
    """

    seed: int = option(1, "Seed; a record's draws depend on it and on the record's start, not on other records")
    prior: str | Prior = option(
        "weak",
        "Prior of R: a name, a name with parameters as ratio:vv=0.6,sd_vv=0.3, campaign:FILE for one that a campaign "
        "has learnt, or in Python a prior",
        choices="bayes_rs.priors.registry:PRIORS",
        open=True,
    )
    target: str = option(
        "record",
        "Which R: record is that of one averaging period, ensemble that of an infinite record, sonic what a sonic at "
        "the lidar would measure in that period",
        choices=tuple(TARGETS),
    )
    sampler: str = option("emcee", "How the posterior is sampled", choices="bayes_rs.posteriors.sampling:SAMPLERS")
    likelihood: str = option(
        "log-normal",
        "Distribution of the variances",
        choices="bayes_rs.likelihoods.log_normal:LIKELIHOODS",
        flag="",
    )
    information: str = option(
        "variances",
        "What of a record is used: its variances, one a beam; or covariances, the correlations between beams, too, "
        "which see more and lean on the model's coherence; what the variances alone say is kept beside it",
        choices=INFORMATION,
    )
    coherence_log_sd: float = option(
        0.3,
        "With covariances or a mast, standard deviation of the logarithms of the lateral and of the vertical scale "
        "over which velocities go together",
    )
    mast_log_sd: float = option(
        0.1,
        "Standard deviation of the logarithm of the ratio of the stresses at a mast beside the records to those at the "
        "beams",
    )
    target_ess: int = option(1000, "Bulk effective sample size that every stress should reach", flag="--ess")
    max_extension: int = option(5, "How often a chain that is too short may be doubled")
    monte_carlo_error: float | None = option(
        None,
        "Largest Monte-Carlo standard error of the mean, median and ends of the interval of every stress, over its "
        "posterior sd; records that have not reached it get more draws. By default all get what target_ess asks for",
    )
    instrument_noise: float | str = option(
        "records",
        "Variance that the instrument adds to each radial variance; or records, for each record's own: what it holds, "
        "or else what the octaves of its variances tell",
        unit="m² s⁻²",
        choices=("records",),
    )
    scatter: str = option(
        "records",
        "How much variances scatter: records, as theory says and the records' own blocks say beyond it; theory, as in "
        "Gaussian air",
        choices=SCATTERS,
    )
    unsteady_level: float = option(
        0.02, "Share of steady records in which a front or a trend is found by chance; 0 looks for none"
    )
    nuisances: Nuisances = option(Nuisances(), "What is uncertain beside R, and is averaged over", flag="")
    prob: float = option(0.9, "Probability of the credible intervals")
    interval: str = option(
        EQUAL_TAILED,
        "Which credible intervals: equal-tailed, with as much probability below as above, or highest-density, the "
        "narrowest",
        choices=tuple(INTERVALS),
    )
    derived: Sequence[str] = option(
        (), "Quantities in the summary beside the stresses", choices="bayes_rs.fits.derived:NAMES"
    )
    draws: str = option(
        "auto",
        f"What is kept of the draws; auto keeps them, in float64, for up to {MOST_KEPT} records",
        choices=DRAWS,
    )
    campaign: str = option(
        "auto",
        f"Learn from all records which distribution their R come from, and fit each under that, too; auto does so from "
        f"{CAMPAIGN_FROM} steady records on",
        choices=CAMPAIGN,
    )
    campaign_group: str | None = option(
        None,
        "Classes of records that may differ within the campaign, such as sectors of wind direction; or the name of a "
        "variable of the records",
        choices=CAMPAIGN_GROUPS,
        open=True,
    )
    campaign_unsteady: bool = option(False, "Let records that are not steady into the campaign, too")

    def __post_init__(self) -> None:
        """Check the options, one by one and together."""
        check_seed(self.seed)
        check_choice(self.target, tuple(TARGETS), what="target")
        check_choice(self.sampler, tuple(SAMPLERS), what="sampler")
        if self.likelihood != FitOptions.likelihood:  # the default is one of them
            from bayes_rs.likelihoods.log_normal import LIKELIHOODS  # noqa: PLC0415 - to look at files needs no scipy

            check_choice(self.likelihood, tuple(LIKELIHOODS), what="likelihood")
        check_count(self.target_ess, what="target_ess")
        check_count(self.max_extension, what="max_extension", minimum=0)
        if self.monte_carlo_error is not None:
            check_positive(self.monte_carlo_error, what="monte_carlo_error", unit="")
        check_choice(self.draws, DRAWS, what="draws")
        check_choice(self.scatter, SCATTERS, what="scatter")
        if not 0.0 <= check_finite(self.unsteady_level, what="unsteady_level", unit="") < 1.0:
            raise InputError(
                f"Invalid unsteady_level {self.unsteady_level!r}: it must be at least 0 and below 1; 0.02 is usual, 0 "
                "looks for no fronts and trends."
            )
        check_prob(self.prob)
        check_choice(self.interval, tuple(INTERVALS), what="interval")
        object.__setattr__(self, "derived", (self.derived,) if isinstance(self.derived, str) else tuple(self.derived))
        check_derived(self.derived)
        if isinstance(self.instrument_noise, str):
            check_choice(self.instrument_noise, ("records",), what="instrument_noise")
        else:
            check_non_negative(self.instrument_noise, what="instrument_noise", unit="m² s⁻²")
        if not isinstance(self.nuisances, Nuisances):
            raise InputError(f"Invalid nuisances {in_short(self.nuisances)}: give bayes_rs.Nuisances(...).")
        if self.nuisances.instrument_noise_log_sd > 0.0 and self.instrument_noise == 0.0:
            raise InputError(
                "Invalid instrument_noise 0: its logarithm is to be uncertain, so its median must be above 0 m² s⁻²; "
                "'records' takes what the records tell."
            )
        self._check_information()
        if self.target == "sonic" and self.likelihood != "log-normal":
            raise InputError(
                f"Invalid likelihood {self.likelihood!r} for the target 'sonic': only for 'log-normal' is it known how "
                "the sonic and the beams scatter together."
            )
        _ = self.made_prior
        self._check_campaign()

    def _check_information(self) -> None:
        """Refuse what does not go with covariances."""
        check_choice(self.information, INFORMATION, what="information")
        check_non_negative(self.coherence_log_sd, what="coherence_log_sd", unit="")
        check_non_negative(self.mast_log_sd, what="mast_log_sd", unit="")
        if self.information == "variances":
            return
        if self.likelihood != "log-normal":
            raise InputError(
                f"Invalid likelihood {self.likelihood!r} with information 'covariances': only with 'log-normal' is it "
                "known how variances and correlations scatter together."
            )
        if self.target == "sonic":
            raise InputError(
                "Invalid target 'sonic' with information 'covariances': how a sonic scatters with the correlations "
                "between beams is not known here; use the target 'record', or information 'variances'."
            )

    def _check_campaign(self) -> None:
        """Refuse a campaign that is asked for and cannot be had, and options of one that is off."""
        if isinstance(self.campaign, bool):
            object.__setattr__(self, "campaign", "on" if self.campaign else "off")
        check_choice(self.campaign, CAMPAIGN, what="campaign")
        if self.campaign == "on" and self.no_campaign:
            raise InputError(f"Invalid campaign 'on': {self.no_campaign}.")
        if self.campaign == "off" and (self.campaign_group is not None or self.campaign_unsteady):
            name = "campaign_unsteady" if self.campaign_group is None else "campaign_group"
            raise InputError(f"Invalid {name} with campaign 'off': leave one of them out.")

    @property
    def no_campaign(self) -> str:
        """Why there can be no campaign with these options, in a few words; empty if there can be one."""
        if self.target == "sonic":
            return "the tensors of a sonic scatter about R, and the distribution of R is what a campaign learns"
        name = self.made_prior.name
        if name not in CAMPAIGN_PRIORS or not isinstance(self.made_prior, LogRatioPrior):
            return f"it is learnt in the coordinates of the prior weak or ratio, not of {name}"
        return ""

    @cached_property
    def made_prior(self) -> Prior:
        """The prior that `prior` means."""
        return make_prior(self.prior)

    @property
    def known_instrument_noise(self) -> float:
        """The instrument's noise that all records share, m² s⁻²; 0 where the records hold their own."""
        return 0.0 if isinstance(self.instrument_noise, str) else float(self.instrument_noise)

    @property
    def effort(self) -> Effort:
        """What the sampler does: a sonic's tensors are worth less than the draws of R that they scatter about."""
        margin = ESS_MARGIN if self.target == "sonic" else 1.0
        return Effort(int(self.seed), int(np.ceil(margin * self.target_ess)), self.max_extension)

    def keeps_draws(self, n_record: int) -> bool:
        """Say whether the draws of so many records are kept."""
        return self.draws != "none" and (self.draws != "auto" or n_record <= MOST_KEPT)

    @property
    def draws_type(self) -> str:
        """Type of the draws that are kept."""
        return "float64" if self.draws == "auto" else self.draws


@described
@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """Which noise a fit takes, or which turbulence it is made for: by theory, for the records' own winds."""

    noise: str | None = option(None, "Noise file; by default the noise is made for the records' winds", metavar="FILE")
    turbulence: str = option(
        OWN_TURBULENCE,
        "Turbulence that the noise is made for: a name or a TOML file; records is the records' own, with the length "
        "scale that their spectra give, and its uncertainty",
        choices="bayes_rs.models:TURBULENCES",
        open=True,
    )

    @property
    def of_records(self) -> bool:
        """Whether the length scale is the records' own."""
        return isinstance(self.turbulence, str) and self.turbulence == OWN_TURBULENCE

    @property
    def flow(self) -> str:
        """The turbulence, where one is needed: of the records' own, all but the length scale is that of this one."""
        return USUAL_TURBULENCE if self.of_records else self.turbulence


def split_options(options: Mapping[str, Any]) -> tuple[FitOptions, NoiseOptions]:
    """Return the options of a fit by their classes.

    Raises
    ------
    InputError
        If one is not known.
    """
    of_fit = {entry.name for entry in options_of(FitOptions)}
    of_noise = {entry.name for entry in options_of(NoiseOptions)} - {"noise"}
    for name in options:
        if name not in of_fit | of_noise:
            known = dict.fromkeys(sorted(of_fit | of_noise))
            raise InputError(f"Unknown option {name!r} of fit: {nearest(name, known)}")
    return (
        FitOptions(**{name: value for name, value in options.items() if name in of_fit}),
        NoiseOptions(**{name: value for name, value in options.items() if name in of_noise}),
    )


def prior_file(prior: Any) -> str | None:
    """Return the file of a prior ``"campaign:FILE"``; None for any other prior.

    Examples
    --------
    >>> prior_file("campaign:mast/campaign-prior.toml"), prior_file("weak")
    ('mast/campaign-prior.toml', None)
    """
    name, colon, file = prior.partition(":") if isinstance(prior, str) else ("", "", "")
    return file.strip() if name == "campaign" and colon else None
