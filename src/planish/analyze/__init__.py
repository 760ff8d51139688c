"""Maps on one grid -> point-wise correlation, and the image-based check of their registration."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
