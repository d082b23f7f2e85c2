"""Names of tables of a fit, of the columns of its table ``posterior``, and the rows of that of the prior."""

from __future__ import annotations

from bayes_rs.geometry.stress import STRESSES
from bayes_rs.records.beam_correlation import MOST_BEAMS

ALONG = tuple(f"direction_{number}" for number in range(1, len(STRESSES) + 1))
"""Columns with the contraction along each direction of R; the directions themselves stand in `run.json`."""
ALONG_SHAPE = tuple(f"direction_shape_{number}" for number in range(1, len(STRESSES) + 1))
"""The same of the shape of R."""
CORRELATED = tuple(f"autocorrelation_time_{name}" for name in STRESSES)
"""Columns with the autocorrelation times of the stresses, sampler steps."""
PAIRS = [(i, j) for i in range(len(STRESSES)) for j in range(i, len(STRESSES))]
COVARIANCES = tuple(f"cov_{STRESSES[i]}_{STRESSES[j]}" for i, j in PAIRS)
"""Columns with the posterior covariances of the stresses, m⁴ s⁻⁴."""
PAIRS_MISFIT, N_PAIR = "pairs_misfit", "n_pair"
"""Columns of how well the variances foretell the covariances of beams, and of how many pairs of these there are."""
PER_RECORD = (
    "stresses_learnt",
    "acceptance_rate",
    "n_step",
    "n_draw",
    "mc_error",
    "pareto_k",
    "misfit",
    "beams_probability",
    "sonic_clipped",
    PAIRS_MISFIT,
    N_PAIR,
)
"""Columns with one number a record; NaN where it was not fitted."""
TABLE, HYPER, SUMMARY = "campaign", "campaign_hyper", "campaign_summary"
"""Names of the tables of a campaign: what it found, its hyperparameters, and the records under the learnt prior."""
VARIANCES = "variances_summary"
"""Name of the table with the records by their variances alone, of a fit that uses covariances."""
N_OF_MAST = 3
"""Variances that a mast beside has."""
PATTERN = "pairs_pattern"
"""Name of the table with each record's part of what differs in all records between covariances and variances."""
SAME_FOR_ALL = 100
"""Records whose mean pattern counts in full, and no more: a tenth of one record's scatter is let be."""
N_PRIOR_DRAW = 10_000
"""Draws of the prior that go with a fit, for its outline in figures and for what the data decided."""


def pattern_columns(n_beam: int) -> list[str]:
    """Return the columns with numbers of the table `PATTERN`: one for each pair of views, and a mast's own."""
    n_view = min(n_beam, MOST_BEAMS) + N_OF_MAST
    return [f"pair_{number}" for number in range(1, n_view * (n_view - 1) // 2 + N_OF_MAST + 1)]
