"""A specimen whose every answer is known: it feeds the demo, the tests, the benchmarks and the calibration.

Everything is defined in material coordinates ``(u, v, s)`` of the flat sheet and carried into space by an
exact map, so the truth at any pixel or voxel is a formula and not a measurement.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
