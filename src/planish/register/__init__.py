"""Marks of two layers -> which belong together, the transformation between them, and how far it may be off."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
