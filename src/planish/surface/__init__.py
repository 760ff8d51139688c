"""From a volume to the faces, interfaces and centre of its sheet."""

from planish.surface.find import find_surfaces
from planish.surface.params import SurfaceParams

__all__ = ["SurfaceParams", "find_surfaces"]
