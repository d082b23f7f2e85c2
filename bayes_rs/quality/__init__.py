"""Which samples count, and which records are stationary: named rules, each of which says what it found."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
