"""Which samples count, and which records are stationary: named rules, each of which says what it found."""

from bayes_rs.quality.filtering import ALWAYS_LISTED, Filtered, apply_filters
from bayes_rs.quality.groups import group_median, group_moments
from bayes_rs.quality.periodicity import Periodicity, find_periodicity
from bayes_rs.quality.rules import QualityRules
from bayes_rs.quality.samples import BeamSamples, BoolArray, IntArray
from bayes_rs.quality.sectors import in_sectors
from bayes_rs.quality.spikes import MAD_TO_SIGMA, is_spike

__all__ = [
    "ALWAYS_LISTED",
    "MAD_TO_SIGMA",
    "BeamSamples",
    "BoolArray",
    "Filtered",
    "IntArray",
    "Periodicity",
    "QualityRules",
    "apply_filters",
    "find_periodicity",
    "group_median",
    "group_moments",
    "in_sectors",
    "is_spike",
]
