"""Turbulence: Mann's model, and its covariances and spectra at one and two points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
