"""The campaign: the distribution that the stresses of all its records came from, sampled together with the records."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
