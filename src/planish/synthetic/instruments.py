"""Instruments that look through the sheet: X-ray scanner, and microtome with a microscope."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planish.core.threads import count_threads, thread_pool
from planish.core.typing import Floats, Shape, Singles
from planish.synthetic import _kernels
from planish.synthetic.fibres import FWHM
from planish.synthetic.params import ScannerParams, SectionsParams, Warp, generator
from planish.synthetic.sheet import PITCH_UM, DrawnSheet

Slab = Singles
_CRACK = -0.5  # grey of a crack less that of resin, over the contrast of the coating
_BLOCK = 192  # columns painted together: the sheet then fills much of the box around it


def painted(
    sheet: DrawnSheet,
    warp: Warp,
    ys_um: Floats,
    *,
    shape: tuple[int, int],
    step_um: float,
    grey: tuple[float, float, float],
    halo: int,
    moved: Floats,
) -> list[tuple[int, int, Slab]]:
    """Paint the planes at ``ys_um`` in blocks as deep as the sheet is.

    The planes are of ``shape`` (x, z) voxels of ``step_um``.

    Painted is what the sheet adds to the ``grey`` of air (before those of base and coating), so
    that air stays an exact 0 under any filter. Each plane is ``moved`` (3, rows) along x, along z,
    and turned about its middle. Gives (first column, first depth, block); blocks are (rows, cols +
    2 halo, depth + 2 halo), column and depth those of the block's first voxel inside the halo.
    Around them there is only air.
    """
    middle_um = 0.5 * (np.array(shape) - 1) * step_um
    shift_x, shift_z, turn = moved
    w, curve = warp.packed()
    reach_um = sheet.reach_um + 2 * step_um
    half_depth = 1.05 * reach_um * float(np.hypot(1.0, warp.steepest))
    base, coating = grey[1] - grey[0], grey[2] - grey[0]
    greys = np.array([base, coating, _CRACK * coating])
    structure = sheet.structure
    structure_args = (np.zeros((1, 1, 0), np.uint8), 0.0, 1.0, -np.inf)
    if structure is not None:
        structure_args = (structure.density, structure.low_um, structure.cell_um, structure.film_um)
    blocks: list[tuple[int, int, Slab]] = []
    for start in range(0, shape[0], _BLOCK):
        stop = min(start + _BLOCK, shape[0])
        xs = np.arange(start - halo, stop + halo) * step_um
        row_columns = [
            _kernels.columns(w, curve, y_um, xs + shift)
            for y_um, shift in zip(ys_um[:, None], shift_x, strict=True)
        ]
        under = np.concatenate(row_columns)
        middle = under[..., 2] - shift_z[:, None] - turn[:, None] * (xs - middle_um[0])
        lowest_px = (middle.min() - half_depth) / step_um
        highest_px = (middle.max() + half_depth) / step_um
        first = max(int(np.floor(lowest_px)) - halo, 0)
        last = min(int(np.ceil(highest_px)) + halo, shape[1] - 1)
        if last < first:
            continue
        block = np.zeros((ys_um.size, xs.size, last - first + 1 + 2 * halo), dtype=np.float32)
        voxels = (ys_um, xs, first - halo, step_um, moved, middle_um)
        columns = (under, half_depth)
        fields = (sheet.packed, np.array(sheet.origin), PITCH_UM, greys)
        _kernels.paint(block, w, curve, *voxels, *columns, *fields, *structure_args)
        blocks.append((start, first, block))
    return blocks


def gaussian_taps(sigma: float) -> Singles:
    """Symmetric taps [centre, 1, 2, ...] of a Gaussian of ``sigma`` voxels, cut at four sigma.

    [1] for 0.
    """
    reach = int(np.ceil(4 * sigma)) if sigma > 0 else 0
    taps = np.exp(-0.5 * (np.arange(reach + 1) / max(sigma, 1e-9)) ** 2)
    return (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)


def noise_gain(taps: Singles) -> np.float32:
    """Standard deviation of white noise of 1 after a filter along one axis."""
    return np.sqrt(taps[0] ** 2 + 2 * np.sum(taps[1:] ** 2))


def smooth(slab: Slab, taps: Singles, axes: Shape) -> Slab:
    """Filter along the axes; the result is shorter by the taps' reach at each end of them."""
    reach = taps.size - 1
    if not reach:
        return slab
    for axis in axes:
        shape = list(slab.shape)
        shape[axis] -= 2 * reach
        smoothed = np.empty(shape, dtype=np.float32)
        # Plane by plane, so that a plane stays in the processor's cache.
        planes, smoothed_planes = (np.moveaxis(a, axis, 1) for a in (slab, smoothed))
        for plane, out in zip(planes, smoothed_planes, strict=True):
            shifted = [plane[k : k + len(out)] for k in range(2 * reach + 1)]
            np.multiply(shifted[reach], taps[0], out=out)
            for k in range(1, reach + 1):
                out += taps[k] * (shifted[reach - k] + shifted[reach + k])
        slab = smoothed
    return slab


def trimmed(slab: Slab, cut: int, axes: Shape) -> Slab:
    """Cut voxels off both ends of the axes."""
    if cut == 0:
        return slab
    inner = slice(cut, -cut)
    whole = slice(None)
    return slab[tuple(inner if axis in axes else whole for axis in range(slab.ndim))]


_TILE_VOXELS, _LEAST_ROWS = 1 << 23, 24  # of a tile; the rows around it are painted twice
_FRINGE_PX = 1.5

_STREAK_ROWS, _STREAK_UM = 8, 1000.0  # a streak lasts so long across and along


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """Renders rows of a volume, each of them for itself.

    The bytes do not depend on tiles or threads.

    ``shape`` counts voxels along z, y, x. The axis of rotation stands along y, in the middle of x
    and z.
    """

    sheet: DrawnSheet
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
        """Give (first row, tile (rows, x, z)) one after the other.

        As many tiles as threads are made at a time.
        """
        # Made once, before threads ask for them.
        _ = self.sheet.packed, self._rings_image, self._cupping_factor
        tile_rows = tile_rows or max(_TILE_VOXELS // (self.shape[0] * self.shape[2]), _LEAST_ROWS)
        starts = range(0, self.shape[1], tile_rows)
        threads = count_threads()
        with thread_pool() as pool:
            for batch_start in range(0, len(starts), threads):
                batch = starts[batch_start : batch_start + threads]
                stops = [min(start + tile_rows, self.shape[1]) for start in batch]
                yield from zip(batch, pool.map(self.rows, batch, stops), strict=True)

    def rows(self, start: int, stop: int) -> NDArray[np.generic]:
        """Render the rows [start, stop) as (rows, x, z)."""
        p = self.params
        contrast = p.grey[2] - p.grey[0]
        slab = self._sheet(start, stop)
        if p.cupping:
            slab = slab * self._cupping_factor
        if p.rings:
            slab = slab + contrast * self._rings_image
        if p.streak:
            slab = slab + p.streak * contrast * self._streaks(start, stop)
        if p.noise:
            slab = slab + p.noise * abs(contrast) * self._noise(start, stop)
        slab = slab + np.float32(p.grey[0])
        if p.section_gain:
            rngs = (generator(self.seed, "gain", str(row)) for row in range(start, stop))
            gains = np.array(
                [1 + p.section_gain * rng.standard_normal() for rng in rngs], np.float32
            )
            slab *= gains[:, None, None]
        if p.dtype != "float32":
            limits = np.iinfo(p.dtype)
            slab = np.clip(np.rint(slab), limits.min, limits.max)
        return slab.astype(p.dtype)

    def _sheet(self, start: int, stop: int) -> Slab:
        """Slices of the sheet as the scanner blurs it, with fringes at its edges, without noise."""
        p = self.params
        psf = gaussian_taps(p.fwhm_um / FWHM / p.voxel_um)
        ring = gaussian_taps(_FRINGE_PX)
        halo = max(psf.size - 1, ring.size if p.fringe else 0)
        ys = np.arange(start - halo, stop + halo, dtype=np.float64) * p.voxel_um
        blocks = painted(
            self.sheet,
            self.warp,
            ys,
            shape=(self.shape[2], self.shape[0]),
            step_um=p.voxel_um,
            grey=p.grey,
            halo=halo,
            moved=np.zeros((3, ys.size)),
        )
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
        """White or correlated noise of unit standard deviation.

        Every row has random numbers of its own.
        """
        taps = gaussian_taps(0.5 * self.params.noise_px)
        halo = taps.size - 1
        plane = (self.shape[2] + 2 * halo, self.shape[0] + 2 * halo)
        rngs = (generator(self.seed, "scan", str(row)) for row in range(start - halo, stop + halo))
        white = np.stack([rng.standard_normal(plane, dtype=np.float32) for rng in rngs])
        gain = np.float32(float(noise_gain(taps)) ** 3)
        return smooth(white, taps, (0, 1, 2)) / gain

    def _radius(self) -> Floats:
        z, x = (np.arange(n) - 0.5 * (n - 1) for n in self.shape[::2])
        return np.hypot(x[:, None], z)

    @cached_property
    def _cupping_factor(self) -> Slab:
        """Factor (x, z) that makes what is lighter than air too faint in the field's middle."""
        radius = self._radius()
        depth = 1 - (radius / radius.max()) ** 2
        return (1 - self.params.cupping * depth).astype(np.float32)

    @cached_property
    def _rings_image(self) -> Slab:
        rng = generator(self.seed, "rings")
        radius = self._radius()
        plane = np.zeros(radius.shape)
        for _ in range(self.params.rings):
            ring_radius = rng.uniform(0.05, 0.6) * radius.max()
            sign = rng.choice([-1.0, 1.0])
            plane += sign * self.params.ring * np.exp(-0.5 * (radius - ring_radius) ** 2)
        return plane.astype(np.float32)

    def _streaks(self, start: int, stop: int) -> Slab:
        """Lines along x, thin in z, that fade in and out over rows and along x.

        Unit standard deviation.
        """
        depth, _, width = self.shape
        n_knots = int(np.ceil(width * self.params.voxel_um / _STREAK_UM)) + 2
        knot_position = np.arange(width, dtype=np.float64) * self.params.voxel_um / _STREAK_UM
        taps = gaussian_taps(1.0)
        shape = (1, n_knots, depth + 2 * (taps.size - 1))

        def knot(number: int) -> Floats:
            rng = generator(self.seed, "streaks", str(number))
            white = rng.standard_normal(shape, dtype=np.float32)
            lines = smooth(white, taps, (2,))[0] / noise_gain(taps)
            j = knot_position.astype(int)
            return _faded(lines[j], lines[j + 1], (knot_position % 1)[:, None])

        knots = {k: knot(k) for k in range(start // _STREAK_ROWS, (stop - 1) // _STREAK_ROWS + 2)}
        out = np.empty((stop - start, width, depth), dtype=np.float32)
        for i, row in enumerate(range(start, stop)):
            k, beyond = divmod(row, _STREAK_ROWS)
            out[i] = _faded(knots[k], knots[k + 1], beyond / _STREAK_ROWS)
        return out


def _faded(a: Floats, b: Floats, share: Floats | float) -> Floats:
    """Go from one noise to another of the same standard deviation, which stays."""
    return (a * (1 - share) + b * share) / np.sqrt((1 - share) ** 2 + share**2)


def _laplacian(slab: Slab) -> Slab:
    """Return the Laplacian in voxels, times the variance of the fringe's Gaussian.

    The size of the fringe thus does not depend on its width.
    """
    rows = trimmed(slab, 1, (1, 2))
    cols = trimmed(slab, 1, (0, 2))
    depths = trimmed(slab, 1, (0, 1))
    total = rows[2:] + rows[:-2] + cols[:, 2:]
    total += cols[:, :-2] + depths[..., 2:] + depths[..., :-2]
    return np.float32(_FRINGE_PX**2) * (total - 6 * trimmed(slab, 1, (0, 1, 2)))


_EPOCH = 40  # sections cut with one part of the knife's edge
_MARKS_PER_MM = 1.5
_RUN = 3  # most sections lost one after the other
# Red, green and blue of resin, stained fibres and coating.
_TINTS = ((1.0, 1.0, 1.0), (1.12, 1.0, 0.72), (0.96, 0.94, 1.05))
_RESIN_PX = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Poses:
    """True poses of the sections that were not lost; all (n,).

    ``counter_um`` is the position along the cut that the microtome counts, ``y_um`` the true one in
    space; the cut runs
    towards smaller y. A pixel at (x, z) of the picture shows the point
    ``(x + shift_x - turn z', z + shift_z + turn x')``; x', z' are counted from the picture's
    middle.
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
    jitter = rng.standard_normal((2, count))
    walk = np.cumsum(rng.standard_normal((2, count)), axis=1)
    walk -= walk.mean(axis=1, keepdims=True)
    turn = rng.standard_normal(count)
    position_error = rng.standard_normal(count)
    rng = generator(seed, "missing")  # sections are lost in runs, never the first or the last one
    is_lost = np.zeros(count, dtype=bool)
    mean_run = 0.5 * (1 + _RUN)
    run_starts = np.flatnonzero(rng.random(count) < params.missing / mean_run)
    run_lengths = rng.integers(1, _RUN + 1, count)
    for k in run_starts:
        if not is_lost[max(k - 1, 0)]:  # one that is left between two runs keeps them apart
            is_lost[k : k + run_lengths[k]] = True
    is_lost[:1] = is_lost[-1:] = False
    shift = params.jitter_um * jitter + params.walk_um * walk
    indices = np.flatnonzero(~is_lost)
    counter = params.section_um * np.arange(count, dtype=np.float64)
    true_y = length_um - counter - params.thickness * params.section_um * position_error
    return Poses(
        index=indices,
        counter_um=counter[indices],
        y_um=true_y[indices],
        shift_x_um=shift[0, indices],
        shift_z_um=shift[1, indices],
        turn_rad=np.deg2rad(params.rotation_deg) * turn[indices],
    )


@dataclass(frozen=True, kw_only=True)
class Microtome:
    """Renders the picture of each section for itself.

    ``shape``: its rows along z, its columns along x.
    """

    sheet: DrawnSheet
    warp: Warp
    params: SectionsParams
    poses: Poses
    shape: tuple[int, int]
    seed: int

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """Give the pictures (rows, cols) or (rows, cols, 3), one after the other."""
        _ = self.sheet.packed
        count = self.poses.index.size
        step = 8 * count_threads()
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
        rows, cols = self.shape
        knots_shape = (rows // _RESIN_PX + 2, cols // _RESIN_PX + 2)
        knots = rng.standard_normal(knots_shape, dtype=np.float32)
        resin_texture = _between(_between(knots, rows).T, cols).T
        knife_marks = p.knife * contrast * self._knife(number)
        texture = (p.texture * contrast * resin_texture + knife_marks).astype(np.float32)
        if not p.colour:
            return self._exposed(k, p.grey, float(gains[1]), texture, rng)
        channels: list[NDArray[np.uint8]] = []
        for (resin, base, coating), gain in zip(zip(*_TINTS, strict=True), gains, strict=True):
            grey = (p.grey[0] * resin, p.grey[1] * base, p.grey[2] * coating)
            channels.append(self._exposed(k, grey, float(gain), texture, rng))
        return np.stack(channels, axis=-1)

    def _exposed(
        self,
        k: int,
        grey: tuple[float, float, float],
        gain: float,
        texture: Slab,
        rng: np.random.Generator,
    ) -> NDArray[np.uint8]:
        """One channel of the k-th picture: ``grey`` of resin, base and coating, by its gain."""
        p = self.params
        taps = gaussian_taps(p.defocus_um / p.pixel_um)
        poses = self.poses
        rows, cols = self.shape
        moves = (poses.shift_x_um, poses.shift_z_um, poses.turn_rad)
        blocks = painted(
            self.sheet,
            self.warp,
            poses.y_um[k : k + 1],
            shape=(cols, rows),
            step_um=p.pixel_um,
            grey=grey,
            halo=taps.size - 1,
            moved=np.stack([move[k : k + 1] for move in moves]),
        )
        picture = np.zeros((cols, rows), dtype=np.float32)
        for col, depth, block in blocks:
            blurred = smooth(block, taps, (1, 2))[0]
            picture[col : col + blurred.shape[0], depth : depth + blurred.shape[1]] = blurred
        grain = rng.standard_normal(self.shape, dtype=np.float32)
        noise = p.noise * (p.grey[0] - p.grey[2]) * grain
        exposed = gain * (grey[0] + picture.T + texture) + noise
        return np.clip(np.rint(exposed), 0, 255).astype(np.uint8)

    def _knife(self, number: int) -> Slab:
        """Lines across the sheet, the same over as many sections as one part of the edge lasts."""
        rng = generator(self.seed, "knife", str(number // _EPOCH))
        width = self.shape[1]
        n_marks = rng.poisson(_MARKS_PER_MM * width * self.params.pixel_um * 1e-3)
        x = np.arange(width, dtype=np.float32)[None, :]
        marks = np.zeros((1, width), dtype=np.float32)
        centres = rng.uniform(0, width, n_marks).astype(np.float32)
        signs = rng.choice([-1.0, 1.0], n_marks).astype(np.float32)
        for centre, sign in zip(centres, signs, strict=True):
            marks += sign * np.exp(-0.5 * ((x - centre) / np.float32(1.5)) ** 2)
        return marks


def _between(knots: Slab, count: int) -> Slab:
    knot_position = np.arange(count, dtype=np.float32) / np.float32(_RESIN_PX)
    k = knot_position.astype(int)
    f = (knot_position - k)[:, None].astype(np.float32)
    return (knots[k] * (1 - f) + knots[k + 1] * f).astype(np.float32)
