"""Images of laser holes whose centre and outline are known: eleven papers, holes as a specimen has
them, ten look-alikes, and maps of presence.

Two truths: the centre the laser aimed at, and the area centroid of the outline it cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from planish.core.typing import Floats

DIAMETER_UM, DIAMETER_SD_UM = 175.0, 8.0
FIELD_UM = (3200.0, 4000.0)
HOLES = 12
SHEET_UM, TAPER, TILT_DEG = 55.0, 0.15, 3.0
_ANGLES = np.arange(720) * np.pi / 360


@dataclass(frozen=True, slots=True, kw_only=True)
class Hole:
    """An ellipse with a rough rim at the top, narrower and moved sideways at the bottom; in um."""

    x: float
    y: float
    outline: Floats  # radii at the top, at `_ANGLES`
    char: Floats  # width of the burnt rim
    lean: tuple[float, float]  # where the bottom's centre lies from the top's

    @property
    def centroid(self):
        """Centre of the area that was really cut, at the top."""
        cube = self.outline**3 / (1.5 * np.sum(self.outline**2))
        return np.array(
            [self.x + np.sum(cube * np.cos(_ANGLES)), self.y + np.sum(cube * np.sin(_ANGLES))]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """An image, its pixel, and the holes wholly inside it."""

    image: NDArray[np.float32]
    pixel: float
    holes: list[Hole]


def around(rng, sd, length, perimeter):
    """Gaussian noise around a rim with correlation length ``length``, in um."""
    sigma = max(length / 2 / perimeter * _ANGLES.size, 1.0)
    noise = ndimage.gaussian_filter1d(rng.normal(size=_ANGLES.size), sigma, mode="wrap")
    return sd * noise * np.sqrt(2 * np.sqrt(np.pi) * sigma)


def make_hole(rng, x, y, rough_um=4.0):
    """A hole as the specification's specimen has it."""
    diameter = rng.normal(DIAMETER_UM, DIAMETER_SD_UM)
    ratio = rng.uniform(1.0, 1.12)
    radius = (
        diameter
        / 2
        * (1 + (ratio - 1) / (ratio + 1) * np.cos(2 * (_ANGLES - rng.uniform(0, np.pi))))
    )
    lean, towards = (
        SHEET_UM * np.tan(np.deg2rad(TILT_DEG * rng.random())),
        rng.uniform(0, 2 * np.pi),
    )
    width = max(rng.normal(40.0, 10.0), 10.0)
    return Hole(
        x=x,
        y=y,
        outline=radius + around(rng, rough_um, 30.0, np.pi * diameter),
        char=np.maximum(width + around(rng, 6.0, 40.0, np.pi * diameter), 4.0),
        lean=(float(lean * np.cos(towards)), float(lean * np.sin(towards))),
    )


# --- papers: grey (rows, columns), mean about 1 ---------------------------------------------------


def gauss(rng, shape, length_um, pixel, sd):
    """Gaussian mottle; made on a coarse raster where it is smooth."""
    step = max(1, int(length_um / 6 / pixel))
    small = tuple(-(-n // step) + 4 for n in shape)
    noise = ndimage.gaussian_filter(
        rng.normal(size=small), length_um / 2 / pixel / step, mode="wrap"
    )
    noise *= sd / noise.std()
    if step > 1:
        noise = ndimage.zoom(noise, step, order=1)
    return np.asarray(noise[: shape[0], : shape[1]])


def _fibres(rng, shape, pixel):
    area = shape[0] * shape[1] * pixel * pixel
    n = int(area / 4000.0)
    along = np.linspace(-0.5, 0.5, 160)
    turn, length = rng.vonmises(0, 0.6, n) / 2, rng.uniform(1000, 2500, n)
    row = rng.uniform(0, shape[0], n)[:, None] + along * (length * np.sin(turn) / pixel)[:, None]
    col = rng.uniform(0, shape[1], n)[:, None] + along * (length * np.cos(turn) / pixel)[:, None]
    inside = (row >= 0) & (col >= 0) & (row < shape[0]) & (col < shape[1])
    paper = np.zeros(shape)
    np.add.at(paper, (row[inside].astype(int), col[inside].astype(int)), 1.0)
    paper = ndimage.gaussian_filter(paper, max(9.0 / pixel, 0.5))
    return 1 + 0.08 * (paper - paper.mean()) / paper.std()


def _plane(shape, pixel):
    y, x = (np.arange(n) * pixel for n in shape)
    return y[:, None], x[None]


def _screen(rng, shape, pixel, spread_um, ink):
    """Tone 40 %, 60 lines per cm at 45 degrees; the ink blurred by ``spread_um``."""
    period = 1e4 / 60
    # Round dots: below a threshold of the cosine product the share of the area is the tone.
    sub = max(1, round(pixel / 4.0))
    y, x = _plane((shape[0] * sub, shape[1] * sub), pixel / sub)
    a, b = rng.uniform(0, period, 2)
    p, q = (x + y) * np.sqrt(0.5) + a, (x - y) * np.sqrt(0.5) + b
    wave = np.cos(2 * np.pi * p / period) + np.cos(2 * np.pi * q / period)
    dots = (wave > np.quantile(wave[:: max(1, wave.shape[0] // 300)], 0.6)).astype(np.float64)
    dots = ndimage.gaussian_filter(shrunk(dots, sub), spread_um / pixel)
    return (1 - (1 - ink) * dots) * (1 + gauss(rng, shape, 60, pixel, 0.02))


def _text(rng, shape, pixel, ink):
    """Lines of strokes, bowls and full stops, letters 500 um high, strokes 70 um wide."""
    page = np.zeros(shape)
    y, x = _plane(shape, pixel)
    for line in np.arange(350.0, shape[0] * pixel, 900.0):
        for at in np.arange(200.0, shape[1] * pixel, 420.0):
            rows = slice(int(max(line - 300, 0) / pixel), int((line + 300) / pixel) + 1)
            cols = slice(int(max(at - 220, 0) / pixel), int((at + 220) / pixel) + 1)
            v, u = y[rows] - line, x[:, cols] - at
            letter = rng.integers(5)
            if letter == 0:
                away = np.maximum(np.abs(u), np.abs(v) - 200)
            elif letter == 1:
                away = np.abs(np.hypot(u, v) - 150)
            elif letter == 2:
                away = np.abs(np.hypot(u, v) - 150) + 1e3 * (u > 80)
            elif letter == 3:
                away = np.minimum(
                    np.abs(u) + 1e3 * (np.abs(v) > 240), np.abs(v) + 1e3 * (np.abs(u) > 160)
                )
            else:
                away = np.hypot(u, v - 200) - 60  # a full stop, 190 um across
            page[rows, cols] = np.maximum(
                page[rows, cols], np.clip((35 - away) / max(pixel, 4.0) + 0.5, 0, 1)
            )
    return (1 - (1 - ink) * page) * (1 + gauss(rng, shape, 80, pixel, 0.03))


def _scratched(rng, shape, pixel):
    paper = 1 + gauss(rng, shape, 80, pixel, 0.03)
    y, x = _plane(shape, pixel)
    for _ in range(14):
        turn, off, width = rng.uniform(0, np.pi), rng.uniform(0, 4000), rng.uniform(3, 10)
        away = np.abs(x * np.cos(turn) + y * np.sin(turn) - off)
        paper *= 1 + rng.choice([-0.4, 0.3]) * np.clip((width - away) / pixel + 0.5, 0, 1)
    for _ in range(150):
        r, c = rng.uniform(0, shape[0] * pixel), rng.uniform(0, shape[1] * pixel)
        _spot(paper, pixel, c, r, rng.uniform(5, 30), rng.uniform(0.3, 0.8), 4.0)
    return paper


def _light(shape):
    y, x = np.linspace(-1, 1, shape[0])[:, None], np.linspace(-1, 1, shape[1])[None]
    return 1 + 0.2 * x + 0.1 * y - 0.15 * (x * x + y * y)


def _blocks(image):
    """The coarse steps of JPEG: cosines of blocks of 8 x 8 pixels, rounded."""
    rows, cols = (-(-n // 8) * 8 for n in image.shape)
    part = np.pad(image, ((0, rows - image.shape[0]), (0, cols - image.shape[1])), mode="edge")
    part = part.reshape(rows // 8, 8, cols // 8, 8)
    waves = fft.dctn(part, axes=(1, 3), norm="ortho")
    k = np.arange(8)
    step = 0.06 + 0.025 * (k[:, None] + k[None])
    waves = np.round(waves / step[:, None, :]) * step[:, None, :]
    blocks = fft.idctn(waves, axes=(1, 3), norm="ortho").reshape(rows, cols)
    return blocks[: image.shape[0], : image.shape[1]]


PAPERS = {
    "plain": lambda _r, s, _p, _i: np.ones(s),
    "mottle": lambda r, s, p, _i: 1 + gauss(r, s, 120, p, 0.08) + gauss(r, s, 500, p, 0.05),
    "fibres": lambda r, s, p, _i: _fibres(r, s, p),
    "gloss": lambda r, s, p, _i: (
        1 + gauss(r, s, 60, p, 0.02) + 0.3 * np.maximum(gauss(r, s, 25, p, 1.0) - 2.2, 0)
    ),
    "screen": lambda r, s, p, i: _screen(r, s, p, 4.0, max(i, 0.6)),
    "unresolved": lambda r, s, p, i: _screen(r, s, p, 45.0, i),
    "text": lambda r, s, p, i: _text(r, s, p, i),
    "light": lambda r, s, p, _i: 1 + gauss(r, s, 80, p, 0.04),
    "scratches": lambda r, s, p, _i: _scratched(r, s, p),
    "noise": lambda r, s, p, _i: 1 + gauss(r, s, 60, p, 0.02),
    "blocks": lambda r, s, p, _i: 1 + gauss(r, s, 80, p, 0.04),
}


# --- look-alikes ----------------------------------------------------------------------------------


def _spot(paper, pixel, x, y, radius, factor, soft, ring=0.0):
    """Multiply a spot (or a ring of half width ``ring``) by a factor; its rim ``soft`` um wide."""
    reach = float(np.max(radius)) * (2.5 if soft > 20 else 1.0) + ring + 3 * max(soft, pixel)
    box = _around(x, y, reach, pixel, paper.shape)
    v, u = (
        np.arange(part.start, part.stop) * pixel - at for part, at in zip(box, (y, x), strict=True)
    )
    away, angle = polar(v[:, None], u[None])
    away = away - (np.asarray(radius)[angle] if np.ndim(radius) else radius)
    if ring:
        away = np.abs(away) - ring
    # The pixel's own area softens, too.
    inside = 1 / (1 + np.exp(np.clip(away / (0.3 * max(soft, pixel)), -40, 40)))
    paper[box] *= 1 + (factor - 1) * inside


def _look_alikes(rng, paper, pixel, places, bright):
    """Two printed dots, two blots, two stains, a pit and a ring; the half holes are drawn with the
    holes."""
    kinds = ("dot", "dot", "blot", "blot", "stain", "stain", "pit", "ring")
    for kind, (x, y) in zip(kinds, places, strict=False):
        if kind == "dot":
            _spot(paper, pixel, x, y, rng.uniform(60, 120), rng.uniform(0.4, 0.6), 5.0)
        elif kind == "blot":
            radius = rng.uniform(40, 130)
            _spot(
                paper,
                pixel,
                x,
                y,
                radius * (1 + around(rng, 0.2, 80, 6 * radius)),
                rng.uniform(0.2, 0.6),
                12.0,
            )
        elif kind == "stain":
            _spot(paper, pixel, x, y, rng.uniform(80, 150), rng.uniform(0.6, 0.8), 60.0)
        elif kind == "pit":
            _spot(paper, pixel, x, y, rng.uniform(50, 80), 1.4 if bright else 0.7, 30.0)
        else:
            _spot(paper, pixel, x, y, rng.uniform(80, 110), 0.4, 5.0, ring=12.0)


# --- scenes ---------------------------------------------------------------------------------------


def places(rng):
    """Places (x, y) of the holes, three diameters apart, and of eight look-alikes, two diameters
    from everything."""
    while True:
        found = []
        for count, gap in ((HOLES, 3.0), (HOLES + 8, 2.0)):
            for _ in range(1500):
                if len(found) == count:
                    break
                point = rng.uniform((190, 190), (FIELD_UM[1] - 190, FIELD_UM[0] - 190))
                if all(np.hypot(*(point - other)) > gap * DIAMETER_UM for other in found):
                    found.append(point)
        if len(found) == HOLES + 8:
            return np.array(found[:HOLES]), np.array(found[HOLES:])


def fine_window(hole, pixel, shape, beyond):
    """Pixels around a hole, coordinates of their sub-pixels from its centre, and how many those are
    along a side."""
    box = _around(hole.x, hole.y, hole.outline.max() + beyond, pixel, shape)
    sub = int(np.clip(np.ceil(pixel / 1.5), 3, 15))
    offsets = (np.arange(sub) + 0.5) / sub - 0.5
    v, u = (
        (np.arange(part.start, part.stop)[:, None] + offsets).ravel() * pixel - middle
        for part, middle in zip(box, (hole.y, hole.x), strict=True)
    )
    return box, v[:, None], u[None], sub


def _around(x, y, reach, pixel, shape):
    """Pixels of a square about a place, as far as they are in the image."""
    low = [max(int((at - reach) / pixel), 0) for at in (y, x)]
    high = [min(int((at + reach) / pixel) + 2, n) for at, n in zip((y, x), shape, strict=True)]
    return slice(low[0], max(high[0], low[0])), slice(low[1], max(high[1], low[1]))


def shrunk(values, sub):
    """Means of sub x sub sub-pixels."""
    rows, cols = values.shape
    return values.reshape(rows // sub, sub, cols // sub, sub).mean((1, 3))


def polar(v, u):
    """Radius, and which of the 720 angles."""
    return (
        np.hypot(v, u),
        (np.arctan2(v, u) % (2 * np.pi) / np.pi * 360).astype(np.intp) % _ANGLES.size,
    )


def make_scene(seed, paper, across, *, bright=False, rough_um=4.0):
    """An image of one paper with twelve holes, eight look-alikes and two holes cut by the
    border."""
    rng = np.random.default_rng([seed, list(PAPERS).index(paper), round(across), int(bright)])
    pixel = DIAMETER_UM / across
    shape = (int(FIELD_UM[0] / pixel), int(FIELD_UM[1] / pixel))
    at, others = places(rng)
    image = np.array(PAPERS[paper](rng, shape, pixel, 0.6 if bright else 0.35))
    _look_alikes(rng, image, pixel, others, bright)
    holes = [make_hole(rng, float(p[0]), float(p[1]), rough_um) for p in at]
    cut = [
        make_hole(rng, rng.uniform(-30, 30), rng.uniform(300, FIELD_UM[0] - 300)),
        make_hole(rng, rng.uniform(300, FIELD_UM[1] - 300), FIELD_UM[0] + rng.uniform(-30, 30)),
    ]
    floor = rng.uniform(2.0, 3.0) if bright else rng.uniform(0.05, 0.15)
    for hole in [*holes, *(h for h in cut if np.min(np.hypot(*(at - [h.x, h.y]).T)) > 400)]:
        box, v, u, sub = fine_window(hole, pixel, shape, hole.char.max() + 2 * pixel)
        r, k = polar(v, u)
        r2, k2 = polar(v - hole.lean[1], u - hole.lean[0])
        under = np.repeat(np.repeat(image[box], sub, 0), sub, 1)
        past = r - hole.outline[k]
        values = np.where(past < hole.char[k], under * 0.6, under)
        # Down the wall, the sheet is thinner towards the rim at the bottom.
        depth = np.clip(-past / (TAPER * hole.outline[k]), 0, 1)
        wall = 0.6 + (floor - 0.6) * (0.2 + 0.6 * depth) if bright else 0.3 - 0.1 * depth
        values = np.where(past < 0, wall, values)
        values = np.where(r2 < (1 - TAPER) * hole.outline[k2], floor, values)
        image[box] = shrunk(values, sub)
    if paper == "light":
        image *= _light(shape)
    image = ndimage.gaussian_filter(image, 3.0 / pixel)
    image += rng.normal(0, 0.05 if paper == "noise" else 0.01, shape)
    if paper == "blocks":
        image = _blocks(image)
    return Scene(image=image.astype(np.float32), pixel=pixel, holes=holes)


def make_presence(seed, across, depth, *, rough_um=4.0):
    """Where there is sheet at one depth (0 top, 1 bottom): 0 or 1 and noise; with the true centres
    there."""
    rng = np.random.default_rng([seed, round(across)])
    pixel = DIAMETER_UM / across
    shape = (int(FIELD_UM[0] / pixel), int(FIELD_UM[1] / pixel))
    holes = [make_hole(rng, float(p[0]), float(p[1]), rough_um) for p in places(rng)[0]]
    share = np.ones(shape)
    for hole in holes:
        box, v, u, sub = fine_window(hole, pixel, shape, 3 * pixel)
        r, k = polar(v - depth * hole.lean[1], u - depth * hole.lean[0])
        open_ = r < (1 - TAPER * depth) * hole.outline[k]
        share[box] *= 1 - shrunk(open_, sub)
    seen = share + rng.normal(0, 0.2, shape) > 0.5
    seen ^= rng.random(shape) < 0.02
    centres = np.array([(h.x + depth * h.lean[0], h.y + depth * h.lean[1]) for h in holes])
    return Scene(image=seen.astype(np.float32), pixel=pixel, holes=holes), centres
