"""A base of single fibres, pressed, with filler.

Ribbons are laid on each other from the middle of the sheet outwards.

Deposition after K. Niskanen, M. Alava (Phys. Rev. Lett. 73, 3475, 1994) and K. Niskanen et al.
(KCL-PAKKA, 11th Fundamental Research Symposium, 1997): a fibre takes the lowest surface above what
lies there whose slope is at most its flexibility. Half of the fibres are laid from each side, so
that both faces are rough.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.grid import at_index
from planish.core.typing import Floats, Shape2D, Singles, TwoFields
from planish.synthetic.params import FilmParams, PaperParams, generator

WALL_G_PER_CM3 = 1.5
_FILLER_G_PER_CM3, _FILLER_UM3 = 2.7, 4.2  # of calcite; volume of a grain of 2 um
# What a grain adds to a cell of 1 um; 100 is wall: it fills half and is twice as bright.
_GRAIN = 110
FWHM = float(np.sqrt(8 * np.log(2.0)))  # of a Gaussian over its standard deviation
_TRIES = 6  # places of a fibre, of which it takes the lowest
_FACE_ROWS = 64
# Height of a sheet before the press over its solid thickness, and more with hollow fibres.
_DEEPEST = (2.5, 10.5)


def drawn_angles(anisotropy: float, count: int, rng: np.random.Generator) -> Floats:
    """Directions of fibres, by von Mises' angles: ``anisotropy`` is number along u over across."""
    axes = rng.vonmises(0.0, 0.5 * np.log(anisotropy), count) / 2
    return axes + rng.integers(0, 2, count) * np.pi


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Density of a base in cells of ``cell_um`` from ``low_um`` up, as faces.

    The density is (rows, cols, cells) uint8, wall 100.
    """

    density: NDArray[np.uint8]
    low_um: float
    cell_um: float
    # Height of the upper side of a film below the sheet, which has no holes.
    film_um: float = -np.inf

    @property
    def high_um(self) -> float:
        """Upper border of the highest cell."""
        return self.low_um + self.cell_um * self.density.shape[2]

    def on_film(self, bottom: Floats, film: FilmParams) -> Structure:
        """Put a film below a sheet with the face ``bottom`` (rows, cols), in um.

        A film lies flat at its gap below the lowest point of the face. A tape touches: its upper
        side lies where 1 % of the face is lower, and its adhesive fills the valleys of the face up
        to 30 um above that. Cells hold the film's grey times the share of them that it fills.
        """
        if film.is_tape:
            film_top_um = float(np.percentile(bottom, 1.0))
            upper_um = np.minimum(bottom, film_top_um + 30.0)
        else:
            film_top_um = float(bottom.min()) - film.gap_um
            upper_um = np.full(bottom.shape, film_top_um)
        film_low_um = film_top_um - film.film_um
        deepest_um = min(self.low_um, film_low_um - 2 * self.cell_um)
        low_um = float(np.floor(deepest_um))
        n_cells_below = int(np.ceil((self.low_um - low_um) / self.cell_um))
        widths = ((0, 0), (0, 0), (n_cells_below, 0))
        density = np.pad(self.density, widths)
        cells = np.arange(density.shape[2] + 1) - n_cells_below
        cell_borders = self.low_um + self.cell_um * cells
        cols = slice(0, round(film.share * bottom.shape[1]))
        for k, (start_um, stop_um) in enumerate(pairwise(cell_borders)):
            highest_um = np.minimum(stop_um, upper_um[:, cols])
            filled_um = highest_um - max(start_um, film_low_um)
            share = np.clip(filled_um, 0.0, None) / self.cell_um
            film_density = np.rint(np.minimum(100 * film.grey * share, 255))
            film_cells = density[:, cols, k]
            np.maximum(film_cells, film_density.astype(np.uint8), out=film_cells)
        return Structure(
            density=density,
            low_um=float(cell_borders[0]),
            cell_um=self.cell_um,
            film_um=film_top_um,
        )

    def face(self, blur_um: float, pitch_um: float, *, top: bool) -> Singles:
        """Height (rows, cols) of a face without coating, NaN where there is none.

        It is the outermost place at which the wall, under a Gaussian blur of ``blur_um`` full
        width, reaches half of its own density. Give it a structure without loose fibres, which are
        no part of the face.
        """
        sigma = blur_um / FWHM
        sigmas = (sigma / pitch_um, sigma / pitch_um, sigma / self.cell_um)
        halo_rows = int(np.ceil(4 * sigma / pitch_um)) + 1
        rows, cols, n_cells = self.density.shape
        face = np.full((rows, cols), np.nan, dtype=np.float32)
        for start in range(0, rows, _FACE_ROWS):
            halo_start = max(start - halo_rows, 0)
            stop = min(start + _FACE_ROWS, rows)
            with_halo = self.density[halo_start : stop + halo_rows]
            wall_share = with_halo.astype(np.float32) / 100.0
            blurred = ndimage.gaussian_filter(np.minimum(wall_share, 1.0), sigmas)
            blurred = blurred[start - halo_start :][: stop - start]
            if top:  # cells count from the outside
                blurred = blurred[..., ::-1]
            outer_blurred = np.zeros_like(blurred)
            outer_blurred[..., 1:] = blurred[..., :-1]
            is_face = (blurred >= 0.5) & (outer_blurred < 0.5)
            k = is_face.argmax(axis=2)
            inner = at_index(blurred, k)
            outer = at_index(outer_blurred, k)
            part_of_cell = (inner - 0.5) / np.maximum(inner - outer, 1e-6)
            crossing = k - part_of_cell + 0.5
            if top:
                crossing = n_cells - crossing
            height = crossing * self.cell_um + self.low_um
            has_face = is_face.any(axis=2)
            face[start:stop] = np.where(has_face, height, np.nan)
        return face


class FibreMat:
    """Fibres of a base before the press, one half above its middle and one below.

    The lower half is kept upside down.
    """

    def __init__(
        self, paper: PaperParams, shape: Shape2D, pitch_um: float, ground: Floats, seed: int
    ) -> None:
        """Lay the fibres; ``ground`` is the height of the middle, on which both halves begin.

        It is in um at the nodes (rows, cols) of the sheet's grid, ``pitch_um`` apart.
        """
        fibres = paper.fibres
        assert fibres is not None
        self._paper = paper
        self._fibres = fibres
        self._pitch = pitch_um
        self._seed = seed
        self._grounds = (ground, -ground)
        self._shares: list[NDArray[np.uint8]] = []
        self.heights: list[Floats] = []
        for side, half_ground in zip(("upper", "lower"), self._grounds, strict=True):
            rng = generator(seed, "fibre mat", side)
            shares, heights = self._lay(shape, half_ground, rng)
            self._shares.append(shares)
            self.heights.append(heights)

    def _lay(
        self, shape: Shape2D, ground: Floats, rng: np.random.Generator
    ) -> tuple[NDArray[np.uint8], Floats]:
        """Lay the fibres of one half: their shares of the cells, and the heights they reach.

        Shares (rows, cols, cells) are of wall, in hundredths, in cells of ``cell_um`` above
        ``ground``; heights (rows, cols) are those of the highest fibre, in um.
        """
        from planish.synthetic import _fibre_kernels

        p = self._fibres
        pitch = self._pitch
        solid_um = 0.5 * p.g_per_m2 / WALL_G_PER_CM3
        lengths, widths, walls, lumens = self._drawn(shape, solid_um, rng)
        n_fibres = lengths.size
        angles = drawn_angles(self._paper.anisotropy, n_fibres, rng)
        curls = rng.normal(0.0, 4e-4, n_fibres) * pitch
        lengths, widths = lengths / pitch, widths / pitch
        length = lengths[:, None, None]
        shares_of_field = rng.uniform(0.0, 1.0, (n_fibres, _TRIES, 2))
        middles = shares_of_field * (np.array(shape[::-1]) + length)
        middles -= 0.5 * length
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        starts = middles - 0.5 * length * directions[:, None]
        flexibility = rng.uniform(*p.flexibility, n_fibres) * pitch
        hollow_share = 0.5 * sum(p.lumen_um) / sum(p.wall_um)
        depth = _DEEPEST[0] + _DEEPEST[1] * hollow_share
        n_cells = int(depth * solid_um / p.cell_um) + 8
        shares = np.zeros((*shape, n_cells), dtype=np.uint8)
        top = ground.copy()
        ribbons = (starts, angles - 0.5 * curls * lengths, lengths, widths, curls)
        solid_sum_um = solid_um * shape[0] * shape[1]
        _fibre_kernels.lay_ribbons(
            shares, top, ground, *ribbons, walls, lumens, flexibility, p.cell_um, solid_sum_um
        )
        return shares, np.minimum(top, ground + n_cells * p.cell_um)

    def _drawn(
        self, shape: Shape2D, solid_um: float, rng: np.random.Generator
    ) -> tuple[Floats, ...]:
        """Draw lengths, widths, walls and lumens (n,), in um, of more fibres than are laid.

        ``solid_um`` is the height of their walls over the whole field. Lengths and widths of fines
        are below those of fibres. 0.86 is the share of a flat ribbon that one with rounded edges
        has, as ``lay_ribbons`` lays it.
        """
        p = self._fibres
        pitch = self._pitch
        area = float(shape[0] * shape[1]) * pitch**2
        volume_um3 = 0.0
        batches = list[tuple[Floats, ...]]()
        # A fibre begins outside as often as inside: the field grows by its length, which its middle
        # may lie in.
        while volume_um3 < 1.1 * solid_um * area:
            is_fine = rng.random(512) < p.fines

            fine_lengths = rng.uniform(60.0, 250.0, 512)
            coarse_lengths = rng.uniform(*p.length_um, 512)
            lengths = np.where(is_fine, fine_lengths, coarse_lengths)
            fine_widths = rng.uniform(6.0, 15.0, 512)
            coarse_widths = rng.uniform(*p.width_um, 512)
            widths = np.where(is_fine, fine_widths, coarse_widths)
            walls = rng.uniform(*p.wall_um, 512)
            lumens = np.where(is_fine, 0.0, rng.uniform(*p.lumen_um, 512))
            height, width = (n * pitch + lengths for n in shape)
            share_in_field = area / (height * width)
            batches.append((lengths, widths, walls, lumens))
            volumes = lengths * widths * 2 * walls * 0.86
            volume_um3 += float(np.sum(volumes * share_in_field))
        return tuple(np.concatenate(samples) for samples in zip(*batches, strict=True))

    def calendered(self) -> TwoFields:
        """Heights of both faces, outwards, with the mean thickness and roughness of the paper.

        The voids give way evenly until the thickness is right; then a nip brings the heights closer
        to their mean, as far as walls and the height before the press allow.
        """
        p = self._paper
        solids: list[Floats] = []
        voids: list[Floats] = []
        for shares, height, ground in zip(self._shares, self.heights, self._grounds, strict=True):
            hundredths = shares.sum(axis=2, dtype=np.float64)
            solid = hundredths * self._fibres.cell_um / 100
            solids.append(np.minimum(solid, height - ground))
            voids.append(height - ground - solids[-1])

        def mean_um(halves: list[Floats]) -> float:
            return float(sum(half.mean() for half in halves))

        def faces(flattening: float) -> list[Floats]:
            """Faces whose distances from their mean are multiplied by ``flattening``.

            The share of the voids that stays open makes the mean thickness right; a wall gives way
            by a tenth at most. What the clipping changes of the thickness is spread over both.
            """
            open_share = (p.base_um - mean_um(solids)) / mean_um(voids)
            pressed_halves: list[Floats] = []
            for ground, solid, void in zip(self._grounds, solids, voids, strict=True):
                dense = ground + solid  # without any void
                height = dense + max(open_share, 0.0) * void
                mean = height.mean()
                height = mean + flattening * (height - mean)
                pressed_halves.append(np.clip(height, ground + 0.9 * solid, dense + void))
            excess_um = p.base_um - mean_um(pressed_halves)
            return [face + 0.5 * excess_um for face in pressed_halves]

        low = 0.0
        high = 1.0
        for _ in range(20):
            flattening = 0.5 * (low + high)
            variances = [face.var() for face in faces(flattening)]
            if float(np.sqrt(np.mean(variances))) < p.roughness_um:
                low = flattening
            else:
                high = flattening
        upper, lower = faces(0.5 * (low + high))
        return upper, lower

    def pressed(self, top: Floats, bottom: Floats, neutral_um: float) -> Structure:
        """Press the upper half to ``top``, the lower to ``bottom``, strew filler.

        Both faces (rows, cols) are in um from the middle of the sheet, up; heights of the structure
        count from ``neutral_um``. Grains of filler lie between the faces, and loose fibres stand up
        from them where the paper has any.
        """
        from planish.synthetic import _fibre_kernels

        p = self._fibres
        paper = self._paper
        margin_um = (p.fuzz_um[1] if p.fuzz_per_mm2 else 0.0) + 3 * p.cell_um
        low_um = float(np.floor(bottom.min() - margin_um))
        depth_um = top.max() + margin_um - low_um
        n_cells = int(np.ceil(depth_um / p.cell_um))
        density = np.zeros((*top.shape, n_cells), dtype=np.uint8)
        outward_faces = ((1.0, top), (-1.0, -bottom))
        halves = zip(self._shares, self.heights, self._grounds, strict=True)
        for (sign, face), half in zip(outward_faces, halves, strict=True):
            _fibre_kernels.press(density, low_um, sign, *half, face, p.cell_um, p.void_floor)
        cell_um3 = self._pitch**2 * p.cell_um
        filler_g_per_cm3 = paper.filler * paper.base_g_per_cm3
        grain_probability = filler_g_per_cm3 / _FILLER_G_PER_CM3 / _FILLER_UM3 * cell_um3
        rng = generator(self._seed, "filler")
        if grain_probability:
            for k in range(n_cells):
                height = low_um + (k + 0.5) * p.cell_um
                is_grain = rng.random(top.shape, dtype=np.float32) < grain_probability
                is_grain &= (height < top) & (height > bottom)
                added = _GRAIN / p.cell_um * is_grain
                density[..., k] += added.astype(np.uint8)
        if p.fuzz_per_mm2:
            for sign, face in outward_faces:
                rng = generator(self._seed, "fuzz", str(sign))
                area_mm2 = top.size * self._pitch**2 * 1e-6
                n = max(int(p.fuzz_per_mm2 * area_mm2), 1)
                lengths = rng.uniform(100.0, 350.0, n) / self._pitch
                starts = rng.uniform(0, 1, (n, 2)) * top.shape[::-1]
                angles = rng.uniform(0, 2 * np.pi, n)
                widths = rng.uniform(12.0, 22.0, n) / self._pitch
                curls = rng.normal(0, 2e-3, n) * self._pitch
                thickness = rng.uniform(3.0, 6.0, n)
                rises = rng.uniform(*p.fuzz_um, n)
                fuzz = (starts, angles, lengths, widths, curls, thickness, rises)
                _fibre_kernels.raise_fibres(density, low_um, sign, face, *fuzz, p.cell_um)
        return Structure(density=density, low_um=low_um - neutral_um, cell_um=p.cell_um)
