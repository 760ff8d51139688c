"""Read, calm where noisy, and fit the columns that levels, blur and fringe are learnt from."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from planish.core.errors import VolumeError
from planish.core.robust import mad_sd
from planish.core.threads import map_threads
from planish.core.tiles import Tile
from planish.core.typing import Floats, Ints, Singles
from planish.surface.columns import Columns, Edge, GreyScale, Guide, Side, oriented
from planish.surface.faces import fit_columns
from planish.surface.survey import Survey

_QUIET = 8.0  # contrast-to-noise ratio below which columns are smoothed with their neighbours
_BLENDS = (0.5, 0.75, 1.0, 1.5, 2.0)  # columns
_SEEN = 3.0  # below it no face is found with certainty, and columns are averaged at any rate
# Columns: what is narrower gives a neighbour less than a twentieth of the weight.
_LEAST_BLEND = 0.4
_ASTRAY = 400.0  # cost of a column whose fit went astray; no worse one counts for more


class Sample(NamedTuple):
    """Columns read from one end, as one row."""

    grey: Singles  # (1, n, depth), above the air, from outside to inside
    outer: Floats  # (1, n), expected depth of the face at that end, in voxels
    opposite: Floats  # (1, n), of the other face
    cos_tilt: Floats  # (1, n), cosine of the sheet's tilt
    row: Ints  # (1, n), number of the sampled row

    def thinned(self, every: int) -> Sample:
        """Return every so-many-th column."""
        return Sample._make(part[:, ::every] for part in self)


Samples = dict[bool, Sample]  # by whether they are read from the high end


def subsample(indices: Ints, max_count: int) -> Ints:
    """Take so many of an index (n, ...) at most, spread over all of it."""
    count = len(indices)
    places = np.linspace(0, count - 1, min(count, max_count)).astype(int)
    return indices[np.unique(places)]


class Sampler:
    """Reads sample columns from both ends and fits them.

    What it learns on the way is as in :class:`Priors`.
    """

    def __init__(self, columns: Columns, guide: Guide, survey: Survey) -> None:
        """Choose the rows that are sampled; grey is on the scale of the survey.

        ``embedded_level`` is the grey that separates the sheet from other material, and 0 where air
        lies beside it; noise and ``scatter`` are of one column before any averaging.
        """
        self.columns = columns
        self.guide = guide
        self.embedded_level = survey.coarse.threshold if survey.surroundings != "air" else 0.0
        self.scale = GreyScale(air_grey=survey.air_grey, polarity=survey.polarity)
        pitch = columns.pitch
        # How far the block's face may lie from a column's own: a block's slope and the roughness.
        block_um = survey.coarse.block * max(pitch[:2])
        self.search_px = 2.0 + 1.5 * block_um / pitch[2]
        # A scan without noise has a little all the same.
        least_noise = 1e-6 * abs(survey.air_grey) + 1e-9
        self.voxel_noise = max(survey.noise / columns.step, least_noise)
        self.scatter = self.single_noise = self.noise = self.voxel_noise
        has_sheet = np.isfinite(guide.low) & np.isfinite(guide.high)
        row_indices = subsample(np.flatnonzero(has_sheet.any(axis=1)), 24)
        col_count = min(columns.shape[1], 1024)  # columns of each of them
        # Pieces of rows, spread over the sheet: starts that are far apart from one row to the next,
        # multiples of the golden section.
        start_shares = (np.arange(row_indices.size) * 0.6180339887498949) % 1.0
        col_starts = (start_shares * (columns.shape[1] - col_count + 1)).astype(int)
        starts = zip(row_indices.tolist(), col_starts.tolist(), strict=True)
        self.rows = [Tile(r, r + 1, c, c + col_count) for r, c in starts]
        self.cache: dict[float, dict[Tile, Singles]] = {}  # grey of the rows, by the blending

    def _blend(self, blend_sd: float) -> None:
        self.scale = replace(self.scale, blend_sd=blend_sd)

    def _read(self, tile: Tile, *, from_high: bool) -> Singles:
        scale = self.scale
        # The same columns are looked at several times: all are read.
        if scale.blend_sd not in self.cache:

            def read(tile: Tile) -> Singles:
                guide = self.guide.part(scale.grown(tile, self.columns.shape[:2]))
                return oriented(self.columns, tile, guide, scale)[0][0]

            row_greys = map_threads(read, self.rows)
            self.cache[scale.blend_sd] = dict(zip(self.rows, row_greys, strict=True))
        grey = self.cache[scale.blend_sd][tile]
        return np.ascontiguousarray(grey[:, ::-1]) if from_high else grey

    def sample(self, *, from_high: bool) -> Sample:
        """Columns read from one end; VolumeError if none shows both faces.

        Some 3000 in all, as many of each sampled row and spread over it.
        """
        columns_per_row = max(1, 3000 // len(self.rows))
        row_samples: list[Sample] = []
        for row_number, tile in enumerate(self.rows):
            guide = self.guide.part(tile)
            faces = guide.faces(self.columns.shape[2], from_high=from_high)
            outer, opposite = np.concatenate(faces)
            has_faces = np.isfinite(outer) & np.isfinite(opposite)
            columns = subsample(np.flatnonzero(has_faces), columns_per_row)
            if columns.size:
                grey = self._read(tile, from_high=from_high)[columns]
                expected = outer[columns], opposite[columns], guide.cos_tilt[0, columns]
                row_samples.append(Sample(grey, *expected, np.full(columns.size, row_number)))
        if not row_samples:
            raise VolumeError(
                "No column of the volume shows both faces of the sheet. Check `through`."
            )
        joined = map(np.concatenate, zip(*row_samples, strict=True))
        return Sample(*(array[None] for array in joined))

    def samples(self) -> Samples:
        """Columns read from either end."""
        return {from_high: self.sample(from_high=from_high) for from_high in (True, False)}

    def calm(self, step: float, widest: float = 2.0) -> None:
        """Choose how far to average columns with neighbours; say what noise and scatter remain.

        ``step``: the least step of grey that is looked for; ``widest``: columns that may be
        averaged, as the standard deviation of a Gaussian, to see it better than just so.
        """
        self._blend(0.0)
        self.scatter = self.single_noise = self.noise = self.voxel_noise
        air_noise = self._air_noise()
        if air_noise > 1.15 * self.noise:
            # Neighbouring voxels share their noise, or streaks lie in the air: averaging helps
            # less, so it is tried.
            self.noise = self.single_noise = air_noise
            blends = {*_BLENDS}
            # Averaging over less than half a column blurs, and hardly lessens what is shared.
            if widest >= _BLENDS[0]:
                blends.add(widest)
            for blend_sd in sorted(blends):
                needed = _QUIET if blend_sd <= widest else _SEEN
                if step / self.noise >= needed:
                    break
                self._blend(blend_sd)
                self.noise = self._air_noise()
        elif (cnr := step / self.noise) < _QUIET:
            # Averaging over a Gaussian of s voxels divides white noise by 2 sqrt(pi) s.
            gain_per_column = 2 * np.sqrt(np.pi)
            quiet_sd, seen_sd = np.array([_QUIET, _SEEN]) / cnr / gain_per_column
            blend_sd = min(quiet_sd, 1.5, max(seen_sd, widest))
            if blend_sd >= _LEAST_BLEND:
                self._blend(blend_sd)
                self.noise /= max(1.0, gain_per_column * blend_sd)
        # What rounding to whole numbers takes off, and no column is a staircase to within a
        # hundredth of its contrast.
        is_rounded = np.issubdtype(self.columns.volume.dtype, np.integer)
        rounding_sd = 12.0**-0.5 if is_rounded else 0.0
        self.scatter = max(self.noise, rounding_sd, 0.01 * step)

    def _air_noise(self) -> float:
        """Standard deviation of the air just outside the faces, as the fit will see it.

        NaN where there is none.
        """
        if self.embedded_level:
            return float("nan")  # what lies beside is no air
        width_px = int(np.ceil(15.0 / self.columns.pitch[2]))  # from the face into the air
        air_samples: list[Singles] = []
        for tile in self.rows:
            for from_high in (True, False):
                grey = self._read(tile, from_high=from_high)
                outer, _ = self.guide.part(tile).faces(grey.shape[1], from_high=from_high)
                search_start = np.nan_to_num(outer[0] - self.search_px, nan=-1.0)
                first_index = search_start.astype(int) - width_px
                # At two distances from the face; a start below 0 lies outside the column.
                for start_index in (first_index, first_index - width_px):
                    columns = np.flatnonzero(start_index >= 0)
                    air_samples.append(grey[columns, start_index[columns]])
        return mad_sd(np.concatenate(air_samples).astype(float))

    def quiet(self, samples: Samples, width: float) -> Samples:
        """Sample columns that are means over their neighbours.

        They are averaged as far as the sheet's slope does not widen the blur, whose standard
        deviation is ``width`` voxels. The samples as they are where that is no farther than now.
        """
        slope = np.hypot(self.guide.slope_r, self.guide.slope_c)
        steep_slope = float(np.nanpercentile(slope, 90)) * self.columns.step
        # In columns: within one of them the sheet rises by less than a third of the blur.
        blend_sd = min(2.0, 0.3 * width / max(steep_slope, 1e-3))
        previous_sd = self.scale.blend_sd
        if blend_sd <= max(previous_sd, 0.3):
            return samples
        self._blend(blend_sd)
        quiet_samples = {from_high: self.sample(from_high=from_high) for from_high in samples}
        self._blend(previous_sd)
        return quiet_samples

    def fit(self, sample: Sample, side: Side, edge: Edge, window: float = 0.0) -> Floats:
        """Fit every column: (5, 1, n) face, thickness, both greys and cost.

        As :func:`planish.surface.faces.fit_columns`, which explains ``window``.
        """
        limits = self.scatter, self.search_px, self.embedded_level, self.columns.pitch[2]
        return fit_columns(sample.grey, sample[1:4], side, edge, limits, window=window)


def cost_limit(cost: Floats) -> float:
    """Cost above which a column counts no more: its fit went astray.

    Where most columns cost more than that, the staircase is what does not fit, and what fits it
    worse must still show.
    """
    finite_costs = cost[np.isfinite(cost)]
    if not finite_costs.size:
        return _ASTRAY
    return max(_ASTRAY, 4.0 * float(np.median(finite_costs)))
