"""Where the beams point, and what they see of R: stresses, probe volumes, scans, attitude, gradients."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
