"""Scans compared and chosen by what they tell of R, classic estimators, and the plan of a scene."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
