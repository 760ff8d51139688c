"""From surfaces, and the volume between them, to properties along the normals of the centre surface."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
