"""Values of the flattened mesh on any regular grid, and images on the pixels of others.

``maps`` is the entry point: one interpolation from column to pixel by the quads of ``places``;
``warp`` moves images.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
