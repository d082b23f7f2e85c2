"""Figures that are drawn where their numbers are made: comparisons of scans, spectra."""

from __future__ import annotations

from bayes_rs.design.comparison_plot import comparison
from bayes_rs.spectra.spectra_plot import spectra

__all__ = ["comparison", "spectra"]
