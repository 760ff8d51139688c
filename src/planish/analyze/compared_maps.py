"""The maps that stand for two layers, as every question of a correlation is given them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import xarray as xr

from planish.analyze.params import CorrelateParams
from planish.analyze.quadratic_field import QuadraticField
from planish.analyze.sheet_columns import SheetColumns
from planish.core.area import area_mean, square_px
from planish.core.grid import Grid
from planish.core.typing import Entries, Floats, Pair, TwoFields
from planish.texture.covariance import Lags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedMaps:
    """The maps that stand for two layers, on one mask, and what a run knows of them."""

    a: tuple[str, str]  # layer and map
    b: tuple[str, str]
    units: tuple[str, str]
    # Both maps (rows, cols), averaged to at most 65 536 cells; NaN where one of them is missing.
    x: Floats
    y: Floats
    lags: Lags  # of the cells that count, ``lags.is_valid``
    params: CorrelateParams
    layers: tuple[xr.Dataset, xr.Dataset]  # all maps of both, on the pixels of ``grid``
    grid: Grid
    # Those of each sheet.
    columns: Mapping[str, SheetColumns] = field(default_factory=dict[str, SheetColumns])
    md_deg: float | None = None  # machine direction on the reference
    light: QuadraticField | None = None  # that was taken off the image
    # Means over the larger points, straight from the pixels, where both are sheets and the maps of
    # one quantity.
    repeated_points: TwoFields | None = None

    @property
    def point_um(self) -> float:
        """Edge of the larger points."""
        return self.params.point_um

    @property
    def cell_um(self) -> Pair:
        """Size of a cell along y and x."""
        return self.lags.pixel_um

    @property
    def has_points(self) -> bool:
        """Whether the larger points are no smaller than cells."""
        return self.point_um >= max(self.cell_um)

    @property
    def sizes(self) -> Entries:
        """Size of a cell and of a point, as functions of two maps take them."""
        return {"pixel_um": self.cell_um, "point_um": self.point_um}

    @property
    def why_no_points(self) -> str:
        """Why there are no means over the larger points; empty where there are."""
        if self.point_um >= max(self.cell_um) * (1 - 1e-9):
            return ""
        return (
            f"Points of {self.point_um:g} um are smaller than the means that stand for the pixels."
            " Give larger ones."
        )

    @property
    def points(self) -> TwoFields:
        """Both maps averaged over the larger points."""
        factor = square_px(self.point_um, self.cell_um)
        return area_mean(self.x, factor), area_mean(self.y, factor)

    @property
    def is_sheet_on_image(self) -> bool:
        """Whether a map of a sheet is compared with an image."""
        return "thickness" in self.layers[0] and "image" in self.layers[1]

    @property
    def is_coat_on_image(self) -> bool:
        """Whether thickness or weight of a coating is compared with an image."""
        return self.a[1].startswith("coat") and "image" in self.layers[1]
