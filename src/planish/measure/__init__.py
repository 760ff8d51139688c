"""From surfaces to properties along the normals of the centre surface."""

from planish.measure.along_normals import PROPERTIES, measure_properties

__all__ = ["PROPERTIES", "measure_properties"]
