"""Sheets whose surfaces are formulas."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import ndimage, special

VOXEL = 3.0


def volume(array, voxel=VOXEL):
    return xr.DataArray(
        array,
        dims=("z", "y", "x"),
        coords={k: np.arange(n) * voxel for k, n in zip("zyx", array.shape, strict=True)},
    )


def slab(
    shape=(70, 50, 56),
    *,
    height=105.0,
    base=55.0,
    coat=17.0,
    slope=0.0,
    wave=0.0,
    greys=(40.0, 90.0, 200.0),
    blur=2.6,
    noise=4.0,
    seed=0,
):
    """A sheet of constant normal layers along a smooth mid-surface, blurred exactly along its
    normal."""
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in shape), indexing="ij")
    middle = height + slope * (x - x.mean()) + wave * np.sin(2 * np.pi * y / 400.0)
    steep = np.hypot(slope, wave * 2 * np.pi / 400.0 * np.cos(2 * np.pi * y / 400.0))
    s = (z - middle) / np.hypot(1, steep)
    half = base / 2 + coat

    def step(d):
        return special.ndtr(d / blur)

    inner = step(base / 2 - s) * step(s + base / 2)
    outer = step(half - s) * step(s + half)
    air, paper, coating = greys
    grey = air + (coating - air) * outer + (paper - coating) * inner
    return grey + np.random.default_rng(seed).normal(0, noise, shape), middle, half


@dataclass(frozen=True)
class Sheet:
    """A flat sheet at any tilt, layers of one grey each, blurred by a Gaussian; every surface is a
    plane.

    ``tilt`` in degrees about the lateral rows' and columns' axis; ``coats`` are the coatings at the
    high and at the low end of the axis through the sheet; ``noise`` is a share of the contrast of
    the brightest layer with the air. ``fringe`` is the size of the phase-contrast fringe at every
    edge, as a share of its step: the second derivative of the edge blurred by ``fringe_px`` voxels,
    times their square.
    """

    voxel: float = 1.4
    lateral: tuple[int, int] = (110, 120)
    thickness: float = 100.0
    coats: tuple[float, float] = (15.0, 15.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    greys: tuple[float, float, float] = (40.0, 95.0, 210.0)
    fwhm: float = 4.0
    noise: float = 0.05
    texture: float = 0.0
    fringe: float = 0.0
    fringe_px: float = 1.5
    margin: float = 40.0
    dtype: str = "uint8"
    inverted: bool = False
    through: str = "z"
    top: str = "high"
    seed: int = 0

    @property
    def slopes(self):
        return tuple(np.tan(np.radians(a)) for a in self.tilt)

    @property
    def cosine(self):
        return 1.0 / np.sqrt(1.0 + sum(s * s for s in self.slopes))

    def middle(self):
        """Height of the sheet's middle above every column, in um, and the number of voxels in
        depth."""
        r, c = (np.arange(n) * self.voxel for n in self.lateral)
        rise = self.slopes[0] * (r - r.mean())[:, None] + self.slopes[1] * (c - c.mean())[None]
        reach = rise.max() + (0.5 * self.thickness) / self.cosine + self.margin
        depth = int(np.ceil(2 * reach / self.voxel)) + 1
        # A third of a voxel off the grid, so that no face lies at the middle of a voxel by chance.
        return rise + 0.5 * (depth - 1) * self.voxel + 0.33 * self.voxel, depth

    def surfaces(self):
        """Heights of the faces and interfaces by name, as ``find_surfaces`` gives them."""
        middle, _ = self.middle()
        half = 0.5 * self.thickness
        high, low = self.coats
        sides = {"top": (half, half - high, high), "bottom": (-half, -half + low, low)}
        if self.top == "low":
            sides = {"bottom": sides["top"], "top": sides["bottom"]}
        found = {"centre": middle}
        for name, (face, inner, coat) in sides.items():
            found[name] = middle + face / self.cosine
            found[f"interface_{name}"] = (
                middle + inner / self.cosine if coat else np.full(middle.shape, np.nan)
            )
        return found

    def volume(self):
        middle, depth = self.middle()
        sigma = self.fwhm / 2.3548
        d = np.arange(depth) * self.voxel
        s = (d[None, None] - middle[..., None]) * self.cosine
        half = 0.5 * self.thickness
        air, base, coating = self.greys

        def edge(x):
            t = x / (self.fringe_px * self.voxel)
            return special.ndtr(x / sigma) + self.fringe * t * np.exp(-0.5 * t * t) / np.sqrt(
                2 * np.pi
            )

        def between(low, high):
            return edge(s - low) - edge(s - high)

        rng = np.random.default_rng(self.seed)
        paper = base - air
        if self.texture:
            # fibres and pores: smooth noise in the base, about 6 um wide
            rough = ndimage.gaussian_filter(rng.normal(size=s.shape), 6.0 / self.voxel / 2.3548)
            paper = paper * (1.0 + self.texture * rough / rough.std())
        grey = air + paper * between(-half + self.coats[1], half - self.coats[0])
        for low, high in ((half - self.coats[0], half), (-half, -half + self.coats[1])):
            if high > low:
                grey = grey + (coating - air) * between(low, high)
        brightest = coating if max(self.coats) else base
        grey = grey + rng.normal(0.0, self.noise * (brightest - air), grey.shape)
        if self.inverted:
            grey = 255.0 - grey
        if self.dtype == "uint16":
            grey = grey * 200.0
        if self.dtype != "float32":
            limit = np.iinfo(self.dtype)
            grey = np.rint(np.clip(grey, limit.min, limit.max))
        else:
            grey = grey / 255.0 - 0.1
        array = np.moveaxis(grey.astype(self.dtype), 2, "zyx".index(self.through))
        return volume(np.ascontiguousarray(array), self.voxel)

    def labels(self):
        """0 air, 1 base, 2 coating, by where the middle of a voxel lies."""
        middle, depth = self.middle()
        d = np.arange(depth) * self.voxel
        s = (d[None, None] - middle[..., None]) * self.cosine
        half = 0.5 * self.thickness
        out = np.where(np.abs(s) <= half, 2, 0)
        out[(s <= half - self.coats[0]) & (s >= -half + self.coats[1])] = 1
        return volume(
            np.ascontiguousarray(np.moveaxis(out.astype(np.uint8), 2, "zyx".index(self.through))),
            self.voxel,
        )
