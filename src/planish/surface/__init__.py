"""From a volume to the faces, interfaces and centre of its sheet."""

from planish.surface.find import SurfaceParams, find_surfaces

__all__ = ["SurfaceParams", "find_surfaces"]
