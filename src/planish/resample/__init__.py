"""From values on the flattened mesh to any regular grid, and from image to image."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
