"""Images of holes whose outlines are known: a test's own generator, independent of the package."""

from dataclasses import dataclass, field

import numpy as np
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
    def centre(self) -> tuple[float, float]:
        """Least-squares centre of the outline that was really cut."""
        angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
        return self.x + 2 * np.mean(self.outline * np.cos(angle)), self.y + 2 * np.mean(self.outline * np.sin(angle))


@dataclass
class Scene:
    """An image and the holes wholly inside it."""

    image: NDArray[np.generic]
    holes: list[Hole] = field(default_factory=list)

    @property
    def centres(self) -> Floats:
        """Centres (n, 2), (x, y) in um."""
        return np.array([hole.centre for hole in self.holes]).reshape(-1, 2)


def periodic_noise(rng: np.random.Generator, sd: float, length: float, perimeter: float) -> Floats:
    """Gaussian noise around a rim with correlation length ``length`` (1/e of the autocorrelation) in um."""
    sigma = length / 2 / perimeter * ANGLES
    noise = ndimage.gaussian_filter1d(rng.normal(size=ANGLES), sigma, mode="wrap")
    return sd * noise / np.sqrt(1 / (2 * np.sqrt(np.pi) * sigma))


def make_hole(
    rng: np.random.Generator, x: float, y: float, diameter: float, *, rough: float = 4.0, ratio: float | None = None
) -> Hole:
    """A hole with rough rim and an irregular char ring."""
    angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
    ratio = rng.uniform(1.0, 1.12) if ratio is None else ratio
    second = (ratio - 1) / (ratio + 1)
    radius = diameter / 2 * (1 + second * np.cos(2 * (angle - rng.uniform(0, np.pi))))
    outline = radius + (periodic_noise(rng, rough, 30.0, np.pi * diameter) if rough else 0.0)
    char = np.maximum(10.0, 40.0 + periodic_noise(rng, 10.0, 40.0, np.pi * diameter))
    return Hole(x, y, outline, char)


def texture(rng: np.random.Generator, shape: tuple[int, int], length_px: float, sd: float) -> Floats:
    """Gaussian mottle with correlation length in pixels."""
    noise = ndimage.gaussian_filter(rng.normal(size=shape), length_px / 2, mode="wrap")
    return sd * noise / noise.std()


def place(rng: np.random.Generator, n: int, size_um: tuple[float, float], margin: float, gap: float) -> Floats:
    """Random places (x, y) no closer than ``gap``."""
    points: list[Floats] = []
    for _ in range(5000):
        if len(points) == n:
            break
        point = rng.uniform((margin, margin), (size_um[1] - margin, size_um[0] - margin))
        if all(np.hypot(*(point - other)) >= gap for other in points):
            points.append(point)
    return np.array(points).reshape(-1, 2)


def blemished(rng: np.random.Generator, sheet: Floats, count: int, py: float, px: float) -> Floats:
    """Dirt spots (irregular, soft or sharp, to 250 um) and dark curved fibres (12 to 24 um wide), ``count`` of each."""
    yy, xx = np.mgrid[: sheet.shape[0], : sheet.shape[1]] * np.array([py, px])[:, None, None]
    for _ in range(count):
        x, y = rng.uniform((0, 0), (xx.max(), yy.max()))
        turn, ratio, diameter = rng.uniform(0, np.pi), rng.uniform(0.4, 1), rng.uniform(20, 250)
        u = (xx - x) * np.cos(turn) + (yy - y) * np.sin(turn)
        v = (yy - y) * np.cos(turn) - (xx - x) * np.sin(turn)
        r = np.hypot(u, v / ratio) + texture(rng, sheet.shape, 40 / px, 8.0)
        inside = 1 / (1 + np.exp(np.clip((r - diameter / 2) / rng.uniform(3, 15), -50, 50)))
        sheet = sheet * (1 - rng.uniform(0.2, 0.6) * inside)
        x, y = rng.uniform((0, 0), (xx.max(), yy.max()))
        away = np.abs(np.hypot(xx - x, yy - y) - rng.uniform(100, 600))
        bow = np.abs(np.angle(np.exp(1j * (np.arctan2(yy - y, xx - x) - turn))))
        sheet = sheet * (1 - 0.5 * (away < rng.uniform(6, 12)) * (bow < rng.uniform(0.5, 3)))
    return sheet


def scene(
    rng: np.random.Generator,
    *,
    shape: tuple[int, int],
    pixel: float | tuple[float, float],
    holes: list[Hole],
    kind: str = "reflected",
    mottle: float = 0.10,
    length_um: float = 80.0,
    light: float = 0.2,
    blur_um: float = 3.0,
    noise: float = 0.02,
    blemishes: int = 0,
) -> Scene:
    """Render holes into a textured sheet; grey 1 is the mean brightness of the paper.

    kind "reflected": dark holes with char x 0.6; "transmitted": bright holes with dark char; "presence": 1 and 0.
    """
    py, px = (pixel, pixel) if isinstance(pixel, float | int) else pixel
    rows, columns = shape
    sheet = 1.0 + texture(rng, shape, length_um / px, mottle)
    fine = 1.0 + texture(rng, shape, max(1.0, 20.0 / px), 0.3 * mottle)
    sheet = np.maximum(sheet * fine, 0.05)
    sheet = blemished(rng, sheet, blemishes, py, px)
    kinds = {"reflected": (0.12, 0.2, 0.6), "transmitted": (2.2, 1.6, 0.5), "presence": (0.0, 0.0, 1.0)}
    floor, wall, char = kinds[kind]
    image = sheet.copy()
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
        burnt = np.where(r < outline + ring, under * (char + 0.1 * (kind != "presence") * (r - outline) / 40), under)
        # Taper: the wall between the rim at the top and the narrower rim at the bottom.
        hollow = np.where(r < 0.85 * outline, floor, wall)
        values = np.where(r < outline, hollow, burnt)
        image[i0:i1, j0:j1] = values.reshape(i1 - i0, sub, j1 - j0, sub).mean((1, 3))
    yy, xx = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    if kind != "presence":
        tilt = rng.uniform(0, 2 * np.pi)
        image = image * (1 + light / 2 * (np.cos(tilt) * xx + np.sin(tilt) * yy) - light / 2 * (xx**2 + yy**2))
    image = ndimage.gaussian_filter(image, (blur_um / py, blur_um / px))
    image = image + rng.normal(0, noise, shape)
    return Scene(image, holes)
