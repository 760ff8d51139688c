"""Polygons that a user declares as artefacts, from GeoJSON or ImageJ -> which pixels they cover.

One file of a run.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
