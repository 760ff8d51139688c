"""From values on the flattened mesh to any regular grid, and from image to image.

``maps`` is the entry point: one interpolation from column to pixel by the quads of ``places``;
``warp`` moves images.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
