"""Figures: posteriors, campaigns, stresses over time, Lumley's triangle, comparisons of scans, spectra."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
