"""Spectra of radial velocities: what they say about the length scale of the turbulence and the instrument's noise."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
