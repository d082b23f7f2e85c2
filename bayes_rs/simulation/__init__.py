"""A virtual lidar: records drawn on lines, or seen in boxes of turbulence; and boxes for simulators of loads."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
