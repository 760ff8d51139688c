"""Checks of a scan: the order of its slices, its grey scale, one sheet and not two, dust."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
