"""A microtome and a light microscope: one picture of the cut face every few micrometres, each with its own errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.threads import count_threads, thread_pool
from planish.core.typing import Floats
from planish.synthetic.draws import generator
from planish.synthetic.paint import Slab, gaussian_taps, painted, smooth
from planish.synthetic.params import SectionsParams
from planish.synthetic.sheet import Sheet
from planish.synthetic.warp import Warp

_EPOCH = 40  # sections cut with one part of the knife's edge
_MARKS_PER_MM = 1.5
_RUN = 3  # most sections lost one after the other
# Red, green and blue of resin, stained fibres and coating.
_TINTS = ((1.0, 1.0, 1.0), (1.12, 1.0, 0.72), (0.96, 0.94, 1.05))
_RESIN_PX = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Poses:
    """True poses of the sections that were not lost; all (n,).

    ``counter_um`` is the position along the cut that the microtome counts, ``y_um`` the true one in space; the cut runs
    towards smaller y. A pixel at (x, z) of the picture shows the point
    ``(x + shift_x - turn z', z + shift_z + turn x')``; x', z' are counted from the picture's middle.
    """

    index: NDArray[np.int64]
    counter_um: Floats
    y_um: Floats
    shift_x_um: Floats
    shift_z_um: Floats
    turn_rad: Floats


def draw_poses(params: SectionsParams, length_um: float, seed: int) -> Poses:
    """Cut a block of ``length_um`` along y."""
    count = int(length_um / params.section_um) + 1
    rng = generator(seed, "poses")
    white = rng.standard_normal((2, count))
    walk = np.cumsum(rng.standard_normal((2, count)), axis=1)
    walk -= walk.mean(axis=1, keepdims=True)
    turn = rng.standard_normal(count)
    place = rng.standard_normal(count)
    lost = _lost(params, count, generator(seed, "missing"))
    shift = params.jitter_um * white + params.walk_um * walk
    present = np.flatnonzero(~lost)
    counter = params.section_um * np.arange(count, dtype=np.float64)
    true = length_um - counter - params.thickness * params.section_um * place
    return Poses(
        index=present,
        counter_um=counter[present],
        y_um=true[present],
        shift_x_um=shift[0, present],
        shift_z_um=shift[1, present],
        turn_rad=np.deg2rad(params.rotation_deg) * turn[present],
    )


def _lost(params: SectionsParams, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Sections lost in runs, never the first or the last one."""
    lost = np.zeros(count, dtype=bool)
    starts = np.flatnonzero(rng.random(count) < params.missing / (0.5 * (1 + _RUN)))
    lengths = rng.integers(1, _RUN + 1, count)
    for k in starts:
        # One that is left between two runs keeps them apart.
        if not lost[max(k - 1, 0)]:
            lost[k : k + lengths[k]] = True
    lost[:1] = lost[-1:] = False
    return lost


@dataclass(frozen=True, kw_only=True)
class Microtome:
    """Renders the picture of each section for itself; ``shape``: its rows along z, its columns along x."""

    sheet: Sheet
    warp: Warp
    params: SectionsParams
    poses: Poses
    shape: tuple[int, int]
    seed: int

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """Give the pictures (rows, cols) or (rows, cols, 3), one after the other."""
        _ = self.sheet.packed
        count, step = self.poses.index.size, 8 * count_threads()
        with thread_pool() as pool:
            for start in range(0, count, step):
                yield from pool.map(self.picture, range(start, min(start + step, count)))

    def picture(self, k: int) -> NDArray[np.uint8]:
        """Render the k-th picture that was kept."""
        p = self.params
        contrast = p.grey[0] - p.grey[2]
        number = int(self.poses.index[k])
        rng = generator(self.seed, "section", str(number))
        gains = 1 + p.drift * rng.standard_normal(3)
        knots = rng.standard_normal((self.shape[0] // _RESIN_PX + 2, self.shape[1] // _RESIN_PX + 2), dtype=np.float32)
        uneven = _between(_between(knots, self.shape[0]).T, self.shape[1]).T
        common = (p.texture * contrast * uneven + p.knife * contrast * self._knife(number)).astype(np.float32)
        if not p.colour:
            return self._exposed(k, p.grey, float(gains[1]), common, rng)
        channels = [tuple(float(level * tint[c]) for level, tint in zip(p.grey, _TINTS, strict=True)) for c in range(3)]
        return np.stack([self._exposed(k, g, float(gains[c]), common, rng) for c, g in enumerate(channels)], axis=-1)

    def _exposed(
        self, k: int, grey: tuple[float, ...], gain: float, common: Slab, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        p = self.params
        taps = gaussian_taps(p.defocus_um / p.pixel_um)
        poses = self.poses
        blocks = painted(
            self.sheet, self.warp, poses.y_um[k : k + 1], shape=(self.shape[1], self.shape[0]), step_um=p.pixel_um,
            grey=(grey[0], grey[1], grey[2]), halo=taps.size - 1,
            moved=np.stack([poses.shift_x_um, poses.shift_z_um, poses.turn_rad])[:, k : k + 1],
        )  # fmt: skip
        picture = np.zeros((self.shape[1], self.shape[0]), dtype=np.float32)
        for col, depth, block in blocks:
            blurred = smooth(block, taps, (1, 2))[0]
            picture[col : col + blurred.shape[0], depth : depth + blurred.shape[1]] = blurred
        grain = rng.standard_normal(self.shape, dtype=np.float32)
        exposed = gain * (grey[0] + picture.T + common) + p.noise * (p.grey[0] - p.grey[2]) * grain
        return np.clip(np.rint(exposed), 0, 255).astype(np.uint8)

    def _knife(self, number: int) -> Slab:
        """Lines across the sheet, the same over as many sections as one part of the edge lasts."""
        rng = generator(self.seed, "knife", str(number // _EPOCH))
        width = self.shape[1]
        count = rng.poisson(_MARKS_PER_MM * width * self.params.pixel_um * 1e-3)
        x = np.arange(width, dtype=np.float32)[None, :]
        row = np.zeros((1, width), dtype=np.float32)
        for centre, size in zip(rng.uniform(0, width, count), rng.choice([-1.0, 1.0], count), strict=True):
            row += np.float32(size) * np.exp(-0.5 * ((x - np.float32(centre)) / np.float32(1.5)) ** 2)
        return row


def _between(knots: Slab, count: int) -> Slab:
    """Interpolate rows linearly between knots."""
    position = np.arange(count, dtype=np.float32) / np.float32(_RESIN_PX)
    k = position.astype(int)
    f = (position - k)[:, None].astype(np.float32)
    return (knots[k] * (1 - f) + knots[k + 1] * f).astype(np.float32)
