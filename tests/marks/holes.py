"""Images of holes whose outlines are known: drawn independently of the package, and otherwise than
the benchmark's."""

from dataclasses import dataclass

import numpy as np
from benchmarks.hole_scenes import around
from numpy.typing import NDArray
from scipy import ndimage

Floats = NDArray[np.float64]
ANGLES = 720


@dataclass
class Hole:
    """One hole: an ellipse with a rough rim, in um."""

    x: float
    y: float
    outline: Floats
    char: Floats

    @property
    def centre(self):
        """Least-squares centre of the outline that was really cut."""
        angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
        return self.x + 2 * np.mean(self.outline * np.cos(angle)), self.y + 2 * np.mean(
            self.outline * np.sin(angle)
        )


@dataclass
class Scene:
    """An image and the holes wholly inside it."""

    image: NDArray[np.generic]
    holes: list[Hole]

    @property
    def centres(self):
        """Centres (n, 2), (x, y) in um."""
        return np.array([hole.centre for hole in self.holes])


def make_hole(rng, x, y, diameter=180.0, *, rough=4.0, ratio=1.06):
    """A hole with rough rim and an irregular char ring."""
    angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
    second = (ratio - 1) / (ratio + 1)
    radius = diameter / 2 * (1 + second * np.cos(2 * (angle - rng.uniform(0, np.pi))))
    outline = radius + around(rng, rough, 30.0, np.pi * diameter)
    char = np.maximum(10.0, 40.0 + around(rng, 10.0, 40.0, np.pi * diameter))
    return Hole(x, y, outline, char)


def texture(rng, shape, length_px, sd):
    """Gaussian mottle with correlation length in pixels."""
    noise = ndimage.gaussian_filter(rng.normal(size=shape), length_px / 2, mode="wrap")
    return sd * noise / noise.std()


def scene(rng, shape, pixel, holes, *, mottle=0.08, length_um=80.0, noise=0.02):
    """Render dark holes with char into a textured sheet; grey 1 is the mean brightness of the
    paper."""
    py, px = np.broadcast_to(pixel, 2)
    rows, columns = shape
    sheet = 1.0 + texture(rng, shape, length_um / px, mottle)
    fine = 1.0 + texture(rng, shape, max(1.0, 20.0 / px), 0.3 * mottle)
    image = np.maximum(sheet * fine, 0.05)
    sub = 5
    offsets = (np.arange(sub) + 0.5) / sub - 0.5
    for hole in holes:
        reach = hole.outline.max() + hole.char.max() + 2 * max(px, py)
        j0, j1 = max(0, int((hole.x - reach) / px)), min(columns, int((hole.x + reach) / px) + 2)
        i0, i1 = max(0, int((hole.y - reach) / py)), min(rows, int((hole.y + reach) / py) + 2)
        yy = ((np.arange(i0, i1)[:, None] + offsets).ravel()) * py - hole.y
        xx = ((np.arange(j0, j1)[:, None] + offsets).ravel()) * px - hole.x
        r = np.hypot(yy[:, None], xx[None])
        turn = (np.arctan2(yy[:, None], xx[None]) % (2 * np.pi)) / (2 * np.pi) * ANGLES
        index = turn.astype(int) % ANGLES
        outline, ring = hole.outline[index], hole.char[index]
        under = np.repeat(np.repeat(image[i0:i1, j0:j1], sub, 0), sub, 1)
        burnt = np.where(r < outline + ring, under * (0.6 + 0.1 * (r - outline) / 40), under)
        # Taper: the wall between the rim at the top and the narrower rim at the bottom.
        values = np.where(r < outline, np.where(r < 0.85 * outline, 0.12, 0.2), burnt)
        image[i0:i1, j0:j1] = values.reshape(i1 - i0, sub, j1 - j0, sub).mean((1, 3))
    yy, xx = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    tilt = rng.uniform(0, 2 * np.pi)
    image = image * (1 + 0.1 * (np.cos(tilt) * xx + np.sin(tilt) * yy) - 0.1 * (xx**2 + yy**2))
    image = ndimage.gaussian_filter(image, (3.0 / py, 3.0 / px))
    return Scene(image + rng.normal(0, noise, shape), holes)
