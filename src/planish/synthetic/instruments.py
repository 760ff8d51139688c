"""Instruments that look through the sheet: X-ray scanner, and microtome with a microscope."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planish.core.threads import count_threads, thread_pool
from planish.core.typing import Floats, Shape, Shape2D, Singles
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
    shape: Shape2D,
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
    base = grey[1] - grey[0]
    coating = grey[2] - grey[0]
    greys = np.array([base, coating, _CRACK * coating])  # less that of air
    structure = sheet.structure
    # No cells: the base is a slab.
    structure_args = (np.zeros((1, 1, 0), np.uint8), 0.0, 1.0, -np.inf)
    if structure is not None:
        structure_args = (structure.density, structure.low_um, structure.cell_um, structure.film_um)
    blocks: list[tuple[int, int, Slab]] = []
    for start in range(0, shape[0], _BLOCK):
        stop = min(start + _BLOCK, shape[0])
        xs = np.arange(start - halo, stop + halo) * step_um
        row_columns: list[Floats] = []
        for y_um, shift in zip(ys_um[:, None], shift_x, strict=True):
            row_columns.append(_kernels.columns(w, curve, y_um, xs + shift))
        under = np.concatenate(row_columns)
        turned = turn[:, None] * (xs - middle_um[0])
        middle = under[..., 2] - shift_z[:, None] - turned
        lowest_px = (middle.min() - half_depth) / step_um
        highest_px = (middle.max() + half_depth) / step_um
        first = max(int(np.floor(lowest_px)) - halo, 0)
        last = min(int(np.ceil(highest_px)) + halo, shape[1] - 1)
        if last < first:
            continue
        depth = last - first + 1 + 2 * halo
        block = np.zeros((ys_um.size, xs.size, depth), dtype=np.float32)
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
    reach = int(np.ceil(4 * max(sigma, 0.0)))
    places = np.arange(reach + 1) / max(sigma, 1e-9)
    taps = np.exp(-0.5 * places**2)
    total = taps[0] + 2 * taps[1:].sum()
    return (taps / total).astype(np.float32)


def noise_gain(taps: Singles) -> np.float32:
    """Standard deviation of white noise of 1 after a filter along one axis."""
    one_side = np.sum(taps[1:] ** 2)
    return np.sqrt(taps[0] ** 2 + 2 * one_side)


def smooth(slab: Slab, taps: Singles, axes: Shape) -> Slab:
    """Filter along the axes; the result is shorter by the taps' reach at each end of them.

    ``taps`` are the centre and one side of a symmetric filter, as of :func:`gaussian_taps`.
    """
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
                both_sides = shifted[reach - k] + shifted[reach + k]
                out += taps[k] * both_sides
        slab = smoothed
    return slab


def trimmed(slab: Slab, cut: int, axes: Shape) -> Slab:
    """Cut voxels off both ends of the axes."""
    if cut == 0:
        return slab
    parts = [slice(None)] * slab.ndim
    for axis in axes:
        parts[axis] = slice(cut, -cut)
    return slab[tuple(parts)]


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
            stop = start + tile.shape[0]
            out[:, start:stop] = tile.transpose(2, 0, 1)
        return out

    def tiles(self, *, tile_rows: int | None = None) -> Iterator[tuple[int, NDArray[np.generic]]]:
        """Give (first row, tile (rows, x, z)) one after the other.

        A tile has ``tile_rows`` rows along y, the last one may have fewer. None: as many as give
        some 8 million voxels, but at least 24. As many tiles as threads are made at a time.
        """
        # Made once, before threads ask for them.
        _ = self.sheet.packed, self._rings_image, self._cupping_factor
        depth, rows, width = self.shape
        tile_rows = tile_rows or max(_TILE_VOXELS // (depth * width), _LEAST_ROWS)
        starts = range(0, rows, tile_rows)
        threads = count_threads()
        with thread_pool() as pool:
            for batch_start in range(0, len(starts), threads):
                batch = starts[batch_start : batch_start + threads]
                stops = [min(start + tile_rows, rows) for start in batch]
                tiles = pool.map(self.rows, batch, stops)
                yield from zip(batch, tiles, strict=True)

    def rows(self, start: int, stop: int) -> NDArray[np.generic]:
        """Render the rows [start, stop) as (rows, x, z).

        To the grey of air is added what the sheet adds, made fainter towards the middle of the
        field, then rings, streaks and noise, each a share of the contrast of coating and air.
        """
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
            gains: list[float] = []
            for row in range(start, stop):
                rng = generator(self.seed, "gain", str(row))
                gains.append(1 + p.section_gain * rng.standard_normal())
            slab *= np.array(gains, np.float32)[:, None, None]
        if p.dtype != "float32":
            limits = np.iinfo(p.dtype)
            slab = np.clip(np.rint(slab), limits.min, limits.max)
        return slab.astype(p.dtype)

    def _sheet(self, start: int, stop: int) -> Slab:
        """Slices of the sheet as the scanner blurs it, with fringes at its edges, without noise.

        (rows, x, z), the grey that the sheet adds to that of air. A halo as wide as the longer of
        both filters is painted around, and cut off by them.
        """
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
        depth, _, width = self.shape
        slab = np.zeros((stop - start, width, depth), dtype=np.float32)
        axes = (0, 1, 2)
        for first_col, first, block in blocks:
            blurred = trimmed(smooth(block, psf, axes), halo - psf.size + 1, axes)
            if p.fringe:
                curvature = _laplacian(smooth(block, ring, axes))
                fringe = trimmed(curvature, halo - ring.size, axes)
                blurred = blurred - np.float32(p.fringe) * fringe
            _, n_cols, n_deep = blurred.shape
            slab[:, first_col : first_col + n_cols, first : first + n_deep] = blurred
        return slab

    def _noise(self, start: int, stop: int) -> Slab:
        """White or correlated noise of unit standard deviation: (rows, x, z).

        Every row has random numbers of its own, so that rows of a halo are the same in all tiles.
        A Gaussian of half the correlation length makes noise of that length.
        """
        taps = gaussian_taps(0.5 * self.params.noise_px)
        halo = taps.size - 1
        depth, _, width = self.shape
        plane = (width + 2 * halo, depth + 2 * halo)
        planes: list[Slab] = []
        for row in range(start - halo, stop + halo):
            rng = generator(self.seed, "scan", str(row))
            planes.append(rng.standard_normal(plane, dtype=np.float32))
        white = np.stack(planes)
        gain = np.float32(float(noise_gain(taps)) ** 3)
        return smooth(white, taps, (0, 1, 2)) / gain

    def _radius(self) -> Floats:
        """Distance from the axis of rotation in voxels, (x, z)."""
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
            profile = np.exp(-0.5 * (radius - ring_radius) ** 2)
            plane += sign * self.params.ring * profile
        return plane.astype(np.float32)

    def _streaks(self, start: int, stop: int) -> Slab:
        """Lines along x, thin in z, that fade in and out over rows and along x: (rows, x, z).

        Unit standard deviation. Every 8th row is a knot with random numbers of its own, and so is
        every millimetre along x in it; rows and columns between fade from one knot to the next.
        """
        depth, _, width = self.shape
        voxel_um = self.params.voxel_um
        n_knots = int(np.ceil(width * voxel_um / _STREAK_UM)) + 2
        knot_position = np.arange(width, dtype=np.float64) * voxel_um / _STREAK_UM
        taps = gaussian_taps(1.0)
        shape = (1, n_knots, depth + 2 * (taps.size - 1))

        def knot(number: int) -> Floats:
            rng = generator(self.seed, "streaks", str(number))
            white = rng.standard_normal(shape, dtype=np.float32)
            lines = smooth(white, taps, (2,))[0] / noise_gain(taps)
            j = knot_position.astype(int)
            beyond = (knot_position % 1)[:, None]
            return _faded(lines[j], lines[j + 1], beyond)

        first_knot = start // _STREAK_ROWS
        last_knot = (stop - 1) // _STREAK_ROWS + 1
        knots = {k: knot(k) for k in range(first_knot, last_knot + 1)}
        out = np.empty((stop - start, width, depth), dtype=np.float32)
        for i, row in enumerate(range(start, stop)):
            k, beyond = divmod(row, _STREAK_ROWS)
            out[i] = _faded(knots[k], knots[k + 1], beyond / _STREAK_ROWS)
        return out


def _faded(a: Floats, b: Floats, share: Floats | float) -> Floats:
    """Go from one noise to another of the same standard deviation, which stays."""
    rest = 1 - share
    return (a * rest + b * share) / np.sqrt(rest**2 + share**2)


def _laplacian(slab: Slab) -> Slab:
    """Return the Laplacian in voxels, times the variance of the fringe's Gaussian.

    The size of the fringe thus does not depend on its width.
    """
    rows = trimmed(slab, 1, (1, 2))
    cols = trimmed(slab, 1, (0, 2))
    depths = trimmed(slab, 1, (0, 1))
    total = rows[2:] + rows[:-2] + cols[:, 2:]
    total += cols[:, :-2] + depths[..., 2:] + depths[..., :-2]
    centre = trimmed(slab, 1, (0, 1, 2))
    return np.float32(_FRINGE_PX**2) * (total - 6 * centre)


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
    """Cut a block of ``length_um`` along y.

    Along x and z a section is off by white noise and a random walk, along y by an error of its
    thickness, and it is turned. Some sections are lost.
    """
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
    indices = np.flatnonzero(~is_lost)
    shift = params.jitter_um * jitter + params.walk_um * walk
    shift_x, shift_z = shift[:, indices]
    counter = params.section_um * np.arange(count, dtype=np.float64)
    error_um = params.thickness * params.section_um * position_error
    true_y = length_um - counter - error_um
    turn_rad = np.deg2rad(params.rotation_deg) * turn[indices]
    return Poses(
        index=indices,
        counter_um=counter[indices],
        y_um=true_y[indices],
        shift_x_um=shift_x,
        shift_z_um=shift_z,
        turn_rad=turn_rad,
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
    shape: Shape2D
    seed: int

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """Give the pictures (rows, cols) or (rows, cols, 3), one after the other."""
        _ = self.sheet.packed
        count = self.poses.index.size
        step = 8 * count_threads()
        with thread_pool() as pool:
            for start in range(0, count, step):
                batch = range(start, min(start + step, count))
                yield from pool.map(self.picture, batch)

    def picture(self, k: int) -> NDArray[np.uint8]:
        """Render the k-th picture that was kept: (rows, cols) or (rows, cols, 3), 0 to 255.

        Over the sheet in its resin lie a soft texture of the resin and marks of the knife, both the
        same in all colours, and each colour has a gain of its own.
        """
        p = self.params
        contrast = p.grey[0] - p.grey[2]
        number = int(self.poses.index[k])
        rng = generator(self.seed, "section", str(number))
        gains = 1 + p.drift * rng.standard_normal(3)
        rows, cols = self.shape
        knots_shape = (rows // _RESIN_PX + 2, cols // _RESIN_PX + 2)
        knots = rng.standard_normal(knots_shape, dtype=np.float32)
        along_rows = _between(knots, rows)
        resin_texture = _between(along_rows.T, cols).T
        knife_marks = p.knife * contrast * self._knife(number)
        texture = (p.texture * contrast * resin_texture + knife_marks).astype(np.float32)
        if not p.colour:
            return self._exposed(k, p.grey, float(gains[1]), texture, rng)
        channels: list[NDArray[np.uint8]] = []
        resin, base, coating = p.grey
        tints = zip(*_TINTS, strict=True)
        for (of_resin, of_base, of_coating), gain in zip(tints, gains, strict=True):
            grey = (resin * of_resin, base * of_base, coating * of_coating)
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
        """One channel of the k-th picture: ``grey`` of resin, base and coating, by its gain.

        ``texture`` (rows, cols) is added to the resin, and the noise of the camera to all.
        """
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
        for first_col, first, block in blocks:
            blurred = smooth(block, taps, (1, 2))[0]
            n_cols, n_deep = blurred.shape
            picture[first_col : first_col + n_cols, first : first + n_deep] = blurred
        grain = rng.standard_normal(self.shape, dtype=np.float32)
        noise = p.noise * (p.grey[0] - p.grey[2]) * grain
        exposed = gain * (grey[0] + picture.T + texture) + noise
        return np.clip(np.rint(exposed), 0, 255).astype(np.uint8)

    def _knife(self, number: int) -> Slab:
        """Lines across the sheet, the same over as many sections as one part of the edge lasts.

        (1, columns), bright or dark by 1 in their middle, with a Gaussian profile of 1.5 pixels.
        """
        rng = generator(self.seed, "knife", str(number // _EPOCH))
        width = self.shape[1]
        n_marks = rng.poisson(_MARKS_PER_MM * width * self.params.pixel_um * 1e-3)
        x = np.arange(width, dtype=np.float32)[None, :]
        marks = np.zeros((1, width), dtype=np.float32)
        centres = rng.uniform(0, width, n_marks).astype(np.float32)
        signs = rng.choice([-1.0, 1.0], n_marks).astype(np.float32)
        for centre, sign in zip(centres, signs, strict=True):
            from_centre = (x - centre) / np.float32(1.5)
            marks += sign * np.exp(-0.5 * from_centre**2)
        return marks


def _between(knots: Slab, count: int) -> Slab:
    """Rows between knots that are 24 pixels apart, so many of them, by straight lines."""
    knot_position = np.arange(count, dtype=np.float32) / np.float32(_RESIN_PX)
    k = knot_position.astype(int)
    f = (knot_position - k)[:, None].astype(np.float32)
    between = knots[k] * (1 - f) + knots[k + 1] * f
    return between.astype(np.float32)
