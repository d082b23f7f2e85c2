"""The mean wind in the field: its error, profiles, motion of the lidar, pairs of beams."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
