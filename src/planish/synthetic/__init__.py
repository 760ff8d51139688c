"""A specimen whose every answer is known: it feeds the demo, the tests and the benchmarks.

Everything is defined in material coordinates ``(u, v, s)`` of the flat sheet and carried into space by an
exact map, so the truth at any pixel or voxel is a formula and not a measurement.
"""

from planish.synthetic.specimen import Specimen, SpecimenParams, make_specimen, write_specimen
from planish.synthetic.warp import Warp

__all__ = ["Specimen", "SpecimenParams", "Warp", "make_specimen", "write_specimen"]
