"""Priors on the Reynolds stress tensor: one interface, one module for each prior, found by name."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
