"""bayes_rs: Bayesian Reynolds stresses, with credible intervals, from Doppler-lidar radial velocity variances."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
