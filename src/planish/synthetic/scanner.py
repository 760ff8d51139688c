"""An X-ray scanner: blur, phase fringe, cupping, rings, streaks and noise over the painted sheet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planish.core.threads import count_threads, thread_pool
from planish.core.typing import Floats
from planish.synthetic.draws import generator
from planish.synthetic.paint import Slab, gaussian_taps, painted, smooth, trimmed
from planish.synthetic.params import ScannerParams
from planish.synthetic.sheet import Sheet
from planish.synthetic.warp import Warp

_TILE_VOXELS, _LEAST_ROWS = 1 << 23, 24  # of a tile; the rows around it are painted twice
_FRINGE_PX = 1.5
_FWHM = float(np.sqrt(8 * np.log(2.0)))
_STREAK_ROWS, _STREAK_UM = 8, 1000.0  # a streak lasts so long across and along


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """Renders rows of a volume, each of them for itself: the bytes do not depend on tiles or threads.

    ``shape`` counts voxels along z, y, x. The axis of rotation stands along y, in the middle of x and z.
    """

    sheet: Sheet
    warp: Warp
    params: ScannerParams
    shape: tuple[int, int, int]
    seed: int

    def volume(self, *, tile_rows: int | None = None) -> NDArray[np.generic]:
        """Return the volume (z, y, x)."""
        out = np.empty(self.shape, dtype=self.params.dtype)
        for start, tile in self.tiles(tile_rows=tile_rows):
            out[:, start : start + tile.shape[0]] = tile.transpose(2, 0, 1)
        return out

    def tiles(self, *, tile_rows: int | None = None) -> Iterator[tuple[int, NDArray[np.generic]]]:
        """Give (first row, tile (rows, x, z)) one after the other; some ``2 * threads`` tiles are in memory."""
        _ = self.sheet.packed, self._plane, self._cups  # made once, before threads ask for them
        tile_rows = tile_rows or max(_TILE_VOXELS // (self.shape[0] * self.shape[2]), _LEAST_ROWS)
        starts, threads = range(0, self.shape[1], tile_rows), count_threads()
        with thread_pool() as pool:
            for begin in range(0, len(starts), threads):
                part = starts[begin : begin + threads]
                stops = [min(start + tile_rows, self.shape[1]) for start in part]
                yield from zip(part, pool.map(self.rows, part, stops), strict=True)

    def rows(self, start: int, stop: int) -> NDArray[np.generic]:
        """Render the rows [start, stop) as (rows, x, z)."""
        p = self.params
        contrast = p.grey[2] - p.grey[0]
        slab = self._sheet(start, stop)
        if p.cupping:
            slab = slab * self._cups
        if p.rings:
            slab = slab + contrast * self._plane
        if p.streak:
            slab = slab + p.streak * contrast * self._streaks(start, stop)
        if p.noise:
            slab = slab + p.noise * abs(contrast) * self._noise(start, stop)
        slab = slab + np.float32(p.grey[0])
        if p.dtype != "float32":
            limits = np.iinfo(p.dtype)
            slab = np.clip(np.rint(slab), limits.min, limits.max)
        return slab.astype(p.dtype)

    def _sheet(self, start: int, stop: int) -> Slab:
        p = self.params
        psf = gaussian_taps(p.fwhm_um / _FWHM / p.voxel_um)
        ring = gaussian_taps(_FRINGE_PX)
        halo = max(psf.size - 1, ring.size if p.fringe else 0)
        ys = np.arange(start - halo, stop + halo, dtype=np.float64) * p.voxel_um
        blocks = painted(
            self.sheet, self.warp, ys, shape=(self.shape[2], self.shape[0]), step_um=p.voxel_um, grey=p.grey, halo=halo,
            moved=np.zeros((3, ys.size)),
        )  # fmt: skip
        slab = np.zeros((stop - start, self.shape[2], self.shape[0]), dtype=np.float32)
        axes = (0, 1, 2)
        for col, depth, block in blocks:
            blurred = trimmed(smooth(block, psf, axes), halo - psf.size + 1, axes)
            if p.fringe:
                fringe = trimmed(_laplacian(smooth(block, ring, axes)), halo - ring.size, axes)
                blurred = blurred - np.float32(p.fringe) * fringe
            slab[:, col : col + blurred.shape[1], depth : depth + blurred.shape[2]] = blurred
        return slab

    def _noise(self, start: int, stop: int) -> Slab:
        """White or correlated noise of unit standard deviation; every row has random numbers of its own."""
        taps = gaussian_taps(0.5 * self.params.noise_px)
        halo = taps.size - 1
        plane = (self.shape[2] + 2 * halo, self.shape[0] + 2 * halo)
        rngs = (generator(self.seed, "scan", str(row)) for row in range(start - halo, stop + halo))
        white = np.stack([rng.standard_normal(plane, dtype=np.float32) for rng in rngs])
        gain = float(np.sqrt(taps[0] ** 2 + 2 * np.sum(taps[1:] ** 2))) ** 3
        return smooth(white, taps, (0, 1, 2)) / np.float32(gain)

    def _radius(self) -> Floats:
        """Distance (x, z) from the axis of rotation in voxels."""
        x = np.arange(self.shape[2])[:, None] - 0.5 * (self.shape[2] - 1)
        z = np.arange(self.shape[0])[None, :] - 0.5 * (self.shape[0] - 1)
        return np.hypot(x, z)

    @cached_property
    def _cups(self) -> Slab:
        """Factor (x, z) on what is brighter than air: the middle of the field comes out too faint."""
        radius = self._radius()
        return (1 - self.params.cupping * (1 - (radius / radius.max()) ** 2)).astype(np.float32)

    @cached_property
    def _plane(self) -> Slab:
        """Rings (x, z), the same in all rows."""
        rng, radius = generator(self.seed, "rings"), self._radius()
        plane = np.zeros(radius.shape)
        for _ in range(self.params.rings):
            ring_radius, sign = rng.uniform(0.05, 0.6) * radius.max(), rng.choice([-1.0, 1.0])
            plane += sign * self.params.ring * np.exp(-0.5 * (radius - ring_radius) ** 2)
        return plane.astype(np.float32)

    def _streaks(self, start: int, stop: int) -> Slab:
        """Lines along x, thin in z, that fade in and out over rows and along x; unit standard deviation."""
        knots_x = int(np.ceil(self.shape[2] * self.params.voxel_um / _STREAK_UM)) + 2
        at_x = np.arange(self.shape[2]) * self.params.voxel_um / _STREAK_UM
        taps = gaussian_taps(1.0)

        def knot(row: int) -> Floats:
            rng = generator(self.seed, "streaks", str(row))
            white = rng.standard_normal((1, knots_x, self.shape[0] + 2 * (taps.size - 1)), dtype=np.float32)
            lines = smooth(white, taps, (2,))[0] / np.sqrt(taps[0] ** 2 + 2 * np.sum(taps[1:] ** 2))
            j, f = at_x.astype(int), (at_x % 1)[:, None]
            return (lines[j] * (1 - f) + lines[j + 1] * f) / np.sqrt((1 - f) ** 2 + f**2)

        knots = {k: knot(k) for k in range(start // _STREAK_ROWS, (stop - 1) // _STREAK_ROWS + 2)}
        out = np.empty((stop - start, self.shape[2], self.shape[0]), dtype=np.float32)
        for i, row in enumerate(range(start, stop)):
            k, f = row // _STREAK_ROWS, (row % _STREAK_ROWS) / _STREAK_ROWS
            out[i] = (knots[k] * (1 - f) + knots[k + 1] * f) / np.sqrt((1 - f) ** 2 + f**2)
        return out


def _laplacian(slab: Slab) -> Slab:
    """Laplacian in voxels, times the variance of the fringe's Gaussian: its size does not depend on its width."""
    inner = slab[1:-1, 1:-1, 1:-1]
    total = slab[2:, 1:-1, 1:-1] + slab[:-2, 1:-1, 1:-1] + slab[1:-1, 2:, 1:-1]
    total += slab[1:-1, :-2, 1:-1] + slab[1:-1, 1:-1, 2:] + slab[1:-1, 1:-1, :-2]
    return np.float32(_FRINGE_PX**2) * (total - 6 * inner)
