"""Rings and cupping of a micro-CT volume: found, corrected, and reported."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
