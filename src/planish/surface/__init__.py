"""From a volume to the faces, interfaces and centre of its sheet."""

from planish.surface.find import find_surfaces
from planish.surface.labels import MEANING, surfaces_from_labels
from planish.surface.params import SurfaceParams

__all__ = ["MEANING", "SurfaceParams", "find_surfaces", "surfaces_from_labels"]
