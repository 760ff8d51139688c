"""Polygons that a user declares as artefacts, in GeoJSON or ImageJ, and the pixels they cover.

One file of a run.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
