"""What is true of a specimen, whoever made it: its faces, its thicknesses, where its points lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Floats

OF = {
    "coating_top": (0, 1),
    "base_thickness": (1, 2),
    "coating_bottom": (2, 3),
    "thickness": (0, 3),
}
NAMES = tuple(OF)
SIZE_UM, LARGE_UM = (1250.0, 1000.0), (1700.0, 1350.0)


@dataclass(frozen=True, kw_only=True)
class Right:
    """A volume (z, y, x), an image (y, x) and what is true: lengths in um, material (u, v, s),
    points (x, y, z).

    ``thickness`` gives a true thickness by name at (u, v); ``columns`` (y, x, 3) holds u, v and the
    height of the centre surface at each column of the volume; ``faces`` (4, y, x) the heights of
    top, interfaces and bottom there.
    """

    maker: str
    seed: int
    volume: NDArray[Any]
    voxel_um: float
    grey: tuple[float, float, float]
    noise: float
    image: Floats
    pixel_um: float
    holes: Floats
    radius_um: float
    material: Callable[[Floats], Floats]
    points: Callable[[Floats], Floats]
    thickness: Callable[[str, Floats, Floats], Floats]
    image_of: Callable[[Floats], Floats]
    pixels: Callable[[], Floats]
    columns: Floats
    faces: Floats
    note: str
    made: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def uv(self):
        """Material (y, x, 2) that the image's pixels show."""
        return self.pixels()


def heights(columns, voxel_um, faces, at):
    """Heights of the faces over each column, whose distances from the middle ``at`` gives along the
    normal."""
    u, v, middle = np.moveaxis(columns, -1, 0)
    lift = np.sqrt(1 + sum(g**2 for g in np.gradient(middle, voxel_um)))
    return np.stack([middle + lift * at(face, u, v) for face in faces])


def layer(faces, name):
    """Thickness between two of the four faces, by name."""
    upper, lower = OF[name]
    return faces[upper] - faces[lower]
