"""What a layer shows of its texture: maps of a sheet, or an image, and parts of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.core.area import common_means
from planish.core.errors import InputError
from planish.core.facts import Side
from planish.core.grid import Grid, centres_of, hole_mask
from planish.core.older_names import height_map
from planish.core.transform import Similarity, grid_points
from planish.core.typing import Array, Bools, Floats, Texts
from planish.register.by_texture.rotations import BAND_UM
from planish.texture.length_unit import length_unit_um
from planish.texture.textures import Textures, textures
from planish.texture.white_noise import without_white_noise

_RIM_UM = 60.0  # of a hole in an image, whose burnt rim is no texture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TexturedPlane:
    """Maps of a layer that may show in an image, or the image, each (rows, cols)."""

    maps: dict[str, Array]
    # Height of the face that is seen; its slopes show in light from one side.
    face: dict[str, Array]
    valid: Bools | None  # where the maps may be looked at, if not everywhere
    grid: Grid

    @classmethod
    def of(
        cls,
        layer: xr.Dataset | xr.DataArray,
        side: Side = "top",
        holes: xr.Dataset | None = None,
        unit_um: float = 1.0,
    ) -> TexturedPlane:
        """Take the maps that may show in an image of a side, or an image without its holes.

        InputError for none. ``holes`` are those of the layer, and hide parts of an image alone: the
        maps of a sheet are not known there. The plane's lengths are in units of ``unit_um``.
        """
        if isinstance(layer, xr.DataArray):
            grid = Grid.of(layer)
            valid = None
            if holes is not None and holes.sizes["mark"]:
                radii_um = 0.5 * holes["diameter"].values + unit_um * _RIM_UM
                valid = ~hole_mask(grid, centres_of(holes), radii_um)
            plane = cls(maps={"image": layer.values}, face={}, valid=valid, grid=grid)
            return plane.scaled(1.0 / unit_um)
        names = (f"coating_{side}", "base_thickness", "thickness")
        maps: dict[str, Array] = {}
        for name in filter(layer.__contains__, names):
            if np.isfinite(layer[name].values).any():
                maps[name] = layer[name].values
        if not maps:
            raise InputError(
                "The maps hold no thickness whose texture could be searched. Measure one"
                " (`property`)."
            )
        heights = height_map(side, layer)
        face = {heights: layer[heights].values} if heights in layer else {}
        valid = layer["valid"].values if "valid" in layer else None
        plane = cls(maps=maps, face=face, valid=valid, grid=Grid.of(layer))
        return plane.scaled(1.0 / unit_um)

    @property
    def is_sheet(self) -> bool:
        """Whether it is no image."""
        return "image" not in self.maps

    @property
    def light(self) -> Texts:
        """Names of the slopes of its face."""
        return tuple(f"{name}_{way}" for name in self.face for way in "xy")

    @property
    def middle_um(self) -> Floats:
        """Its middle, ``(x, y)``."""
        corners_um = self.corners_um
        return 0.5 * (corners_um[0] + corners_um[-1])

    @property
    def corners_um(self) -> Floats:
        """Its corners, (4, 2)."""
        left_right = self.grid.x_um[[0, -1]]
        upper_lower = self.grid.y_um[[0, -1]]
        return grid_points(left_right, upper_lower).reshape(4, 2)

    def scaled(self, factor: float) -> TexturedPlane:
        """The layer with lengths that are larger by a factor."""
        y_um = factor * self.grid.y_um
        grid = Grid(y_um=y_um, x_um=factor * self.grid.x_um)
        return replace(self, grid=grid)

    def part(self, low_um: Floats, high_um: Floats) -> TexturedPlane:
        """What lies between two places ``(x, y)``, the one of less x and y first."""
        x_um, y_um = np.transpose([low_um, high_um])
        rows = slice(*np.searchsorted(self.grid.y_um, y_um).tolist())
        cols = slice(*np.searchsorted(self.grid.x_um, x_um).tolist())
        maps = {name: values[rows, cols] for name, values in self.maps.items()}
        face = {name: heights[rows, cols] for name, heights in self.face.items()}
        valid = None if self.valid is None else self.valid[rows, cols]
        grid = self.grid.part(rows, cols)
        return TexturedPlane(maps=maps, face=face, valid=valid, grid=grid)

    def texture(self, pixel_um: float, *, slopes: bool = False) -> tuple[Textures, Floats]:
        """Textures on pixels of about a size, with the slopes of its face, in halves by wavelength.

        And ``(x, y)`` of the middle of the first pixel. Pixels are averaged to as large ones as
        ``pixel_um`` holds whole.
        """
        row_um, col_um = self.grid.pixel_um
        row_factor = max(int(pixel_um / row_um + 1e-6), 1)
        col_factor = max(int(pixel_um / col_um + 1e-6), 1)
        masks = [] if self.valid is None else [self.valid]
        shown_maps = dict(self.maps)
        faces = self.face if slopes else {}
        for name, heights in faces.items():
            # With noise on them, slopes would take up less of the light than there is.
            is_valid = np.logical_and.reduce([np.isfinite(heights), *masks])
            shown_maps[name] = without_white_noise(heights, is_valid)
        factors = row_factor, col_factor
        shown: dict[str, Array] = {}
        for name, values in shown_maps.items():
            (shown[name],) = common_means([values], factors, masks=masks)
        coarse_um = row_factor * row_um, col_factor * col_um
        is_finite = np.isfinite([*shown.values()])
        is_known = np.any(is_finite, axis=0)
        first_y, first_x = 0.5 * np.subtract(coarse_um, (row_um, col_um))
        layer = textures(shown, is_known, coarse_um, band_um=BAND_UM, most_pixels=np.inf)
        for name in faces.keys() & layer.maps.keys():
            # Light spreads in paper: an image shows short waves of slopes less than long ones.
            layer = layer.with_slopes(name).halved(f"{name}_x", f"{name}_y")
        return layer, np.add(self.grid.origin_um, (first_x, first_y))


class PlanePair(NamedTuple):
    """Two layers, a sheet before an image; ``swapped`` where the first one is the fixed one.

    Their lengths are in units of ``unit_um``, and so are places between them.
    """

    a: TexturedPlane
    b: TexturedPlane
    swapped: bool
    unit_um: float = 1.0

    @classmethod
    def of(
        cls,
        moving: xr.Dataset | xr.DataArray,
        fixed: xr.Dataset | xr.DataArray,
        side: Side,
        holes: tuple[xr.Dataset, xr.Dataset] | None,
        *,
        by_pixel: bool = False,
    ) -> PlanePair:
        """Take two layers by what an image of a side may show; ``holes`` of both are masked.

        ``by_pixel``: in the unit of their pixel also where they have paper's size.
        """
        moving_holes, fixed_holes = holes or (None, None)
        unit_um = length_unit_um(Grid.of(moving), Grid.of(fixed), by_pixel=by_pixel)
        first = TexturedPlane.of(moving, side, moving_holes, unit_um)
        second = TexturedPlane.of(fixed, side, fixed_holes, unit_um)
        is_swapped = second.is_sheet and not first.is_sheet
        if is_swapped:
            first, second = second, first
        return cls(first, second, is_swapped, unit_um)


def in_unit(place: Similarity, unit: float) -> Similarity:
    """Measure the shift of a place in another unit, which is so many of its own."""
    x, y = place.shift_um
    return replace(place, shift_um=(x / unit, y / unit))
