"""Records from radial velocities: variances, counts, flags and the mean wind, of one series or of many files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
