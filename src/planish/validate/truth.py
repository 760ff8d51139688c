"""Set a run beside the truth of its specimen.

Which material a place of a file shows, and what is true there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.transform import grid_points
from planish.core.typing import Array, Bools, Floats, Ints, Pair, Singles
from planish.register import FittedTransform
from planish.run import Run
from planish.synthetic import DrawnSheet, InstrumentFiles, Specimen
from planish.validate.scenario import Values

FACES = ("top", "interface_top", "interface_bottom", "bottom")
# Thickness -> its outer and inner face
THICKNESSES = {"coating_top": (0, 1), "base_thickness": (1, 2), "thickness": (0, 3)}
# Places that a similarity is fitted to: more make it no better, and their square is held in memory.
FITTED = 400


@dataclass(frozen=True)
class Comparison:
    """One run, the files that it read, and the specimen of which they were made.

    All errors are taken over a regular choice of at most some 400 000 columns of the volume, and
    over the image's pixels. Material is (u, v, s) in um, NaN where a place is missing.
    """

    specimen: Specimen
    files: InstrumentFiles
    run: Run

    @property
    def groups(self) -> Mapping[str, xr.Dataset]:
        """Datasets of the run."""
        return self.run.groups

    @property
    def surfaces(self) -> xr.Dataset:
        """Surfaces and thicknesses of the columns."""
        return self.groups["surfaces"]

    @cached_property
    def columns(self) -> tuple[Ints, Ints]:
        """Rows and columns of the chosen columns."""
        rows, cols = self.surfaces["status"].shape
        # More columns do not make a percentile any surer.
        coarser = np.sqrt(rows * cols / 400_000)
        step = max(1, int(np.ceil(coarser)))
        return np.arange(0, rows, step), np.arange(0, cols, step)

    @cached_property
    def pitch_um(self) -> Pair:
        """Distance of neighbours among the chosen columns, along rows and columns."""
        rows, _ = self.columns
        step = int(rows[1]) if rows.size > 1 else 1
        down, across = pitch(self.surfaces)
        return step * down, step * across

    def at_columns(self, values: Array) -> Floats:
        """Values (y, x) of the run at the chosen columns, as float64."""
        return np.asarray(values[np.ix_(*self.columns)], dtype=np.float64)

    @cached_property
    def material(self) -> Floats:
        """True material (rows, cols, 3) of the points of the centre surface that the run found."""
        heights = self.at_columns(self.surfaces["centre"].values)
        return self.material_over(heights, *self.columns)

    @cached_property
    def measured(self) -> Bools:
        """True where the run measured the column."""
        return self.at_columns(self.surfaces["status"].values) == 0

    def places(self, heights: Floats, rows: Ints, cols: Ints) -> Floats:
        """Return the places of heights over the columns ``rows`` and ``cols``.

        The places are (m, n, 3) as x, y, z of the file, in um; the heights are (m, n).
        """
        frame = Frame.of(self.surfaces)
        y_um = self.surfaces["y"].values[rows]
        x_um = self.surfaces["x"].values[cols]
        coordinates = {
            frame.rows: y_um[:, None],
            frame.cols: x_um,
            frame.through: np.asarray(heights, dtype=np.float64),
        }
        return points_of(coordinates)

    def material_over(self, heights: Floats, rows: Ints, cols: Ints) -> Floats:
        """Material at heights over the columns ``rows`` and ``cols``."""
        return self.material_at(self.places(heights, rows, cols))

    def physical_at(self, places: Floats) -> Floats:
        """Places (..., 3) in space of places in the file."""
        sections = self.groups.get("sections")
        return _where_finite(lambda finite: self.files.to_physical(finite, sections), places)

    def material_at(self, places: Floats) -> Floats:
        """Material of places (..., 3) in the file."""
        return _where_finite(self.specimen.warp.material, self.physical_at(places))

    @property
    def headline(self) -> str:
        """Property that the run puts first: the coating, or without it the sheet's thickness."""
        return next(layer.headline for layer in self.run.results.layers if layer.sheet is not None)

    @property
    def fit(self) -> FittedTransform:
        """The registration of the run."""
        return next(iter(self.run.registrations.values())).fit

    @property
    def linked(self) -> xr.Dataset:
        """Maps of the run on the image's pixels."""
        return self.groups["linked"]

    @cached_property
    def valid(self) -> Bools:
        """Valid pixels (y, x) of the image."""
        return self.linked["valid"].values.astype(bool)

    @cached_property
    def true_uv(self) -> tuple[Floats, Floats]:
        """True material (u, v) of the pixels."""
        u, v = (self.specimen.truth[axis].values.astype(np.float64) for axis in "uv")
        return u, v

    @cached_property
    def linked_material(self) -> Floats:
        """Material (y, x, 3) at the place in the volume that the run gives for each valid pixel."""
        places = np.where(self.valid[..., None], volume_places(self.linked), np.nan)
        return self.material_at(places)

    @cached_property
    def place_error_um(self) -> Floats:
        """Error of each pixel: distance in the sheet from the material shown to the one given."""
        u, v = self.true_uv
        linked_u, linked_v, _ = np.moveaxis(self.linked_material, -1, 0)
        return np.hypot(linked_u - u, linked_v - v)

    def linked_values(self, name: str) -> Floats:
        """A property as it was linked; NaN where a pixel is not valid."""
        values = self.linked[name].values.astype(np.float64)
        return np.where(self.valid, values, np.nan)

    def pixel_thickness(self, name: str, u: Floats, v: Floats) -> Floats:
        """True thickness in um as the mean over a pixel's area around the material (u, v)."""
        total = np.zeros(u.shape)
        for du, dv in self._offsets:
            total += true_thickness(self.specimen.sheet, name, u + du, v + dv)
        return total / len(self._offsets)

    @cached_property
    def _offsets(self) -> Floats:
        """Offsets (k, 2) in (u, v) from a pixel's middle to the points that its mean is taken over.

        A pixel is an area: at 12 um it shows the mean of fibres of 20 to 35 um. One of 4 um is
        taken as a point.
        """
        truth = self.specimen.truth
        axis_offsets = list[Floats]()
        for step in pitch(truth):
            # Of a pixel that counts as a point: the sheet holds little below.
            n = max(1, round(step / 4.0))
            shares = (np.arange(n) + 0.5) / n - 0.5
            axis_offsets.append(step * shares)
        down, across = axis_offsets
        offsets = grid_points(across, down).reshape(-1, 2)
        centre = np.array([float(truth[axis].values.mean()) for axis in "xy"])
        inverse = self.specimen.pose.inverse
        middle = inverse(centre[None])
        return np.asarray(inverse(centre + offsets) - middle, dtype=np.float64)


def points_of(coordinates: Mapping[str, Floats | float]) -> Floats:
    """Points (..., 3) of their coordinates by axis, which are spread out against each other."""
    spread = np.broadcast_arrays(*(coordinates[axis] for axis in "xyz"))
    return np.stack(spread, axis=-1)


def volume_places(maps: xr.Dataset) -> Floats:
    """Places (y, x, 3) in the volume of the pixels of maps, um."""
    return np.stack([maps[f"volume_{axis}"].values for axis in "xyz"], axis=-1)


def _where_finite(function: Callable[[Floats], Floats], points: Floats) -> Floats:
    """Apply a function to points (..., 3) that have a place; the others stay NaN."""
    is_finite = np.isfinite(points).all(axis=-1)
    mapped = np.full(points.shape, np.nan)
    if is_finite.any():
        mapped[is_finite] = function(points[is_finite])
    return mapped


def true_thickness(sheet: DrawnSheet, name: str, u: Floats, v: Floats) -> Floats:
    """True thickness in um at material (u, v); ``name`` as the run calls it.

    NaN where (u, v) is.
    """
    outer, inner = THICKNESSES[name]
    return field_at(sheet, sheet.faces[outer] - sheet.faces[inner], u, v)


def field_at(sheet: DrawnSheet, field: Singles, u: Floats, v: Floats) -> Floats:
    """Value of a field of the sheet at material (u, v); NaN where that is."""
    is_finite = np.isfinite(u) & np.isfinite(v)
    sampled = np.full(u.shape, np.nan)
    sampled[is_finite] = sheet.at(field, u[is_finite], v[is_finite])
    return sampled


def rms(errors: Floats) -> float | None:
    """Root mean square of what is finite; None where nothing is."""
    mean_square = mean_of(errors**2)
    return None if mean_square is None else float(np.sqrt(mean_square))


def percentile(errors: Floats, percent: float) -> float | None:
    """Percentile of the absolute value of what is finite; None where nothing is."""
    finite = np.abs(errors[np.isfinite(errors)])
    return float(np.percentile(finite, percent)) if finite.size else None


def mean_of(errors: Floats) -> float | None:
    """Mean of what is finite; None where nothing is."""
    finite = errors[np.isfinite(errors)]
    return float(finite.mean()) if finite.size else None


def bias_rmse_p95(stem: str, errors: Floats) -> Values:
    """``stem_bias``, ``stem_rmse`` and ``stem_p95`` of what is finite."""
    return {
        f"{stem}_bias": mean_of(errors),
        f"{stem}_rmse": rms(errors),
        f"{stem}_p95": percentile(errors, 95),
    }
