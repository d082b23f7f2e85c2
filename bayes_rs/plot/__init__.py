"""Figures: posteriors, stresses over time, comparisons of scans, spectra."""
