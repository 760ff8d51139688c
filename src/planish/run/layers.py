"""A layer of a run, a sheet with its maps or an image.

Sheets as they are mapped, and the laser holes of layers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import xarray as xr

from planish.core.arrays import check_image
from planish.core.checks import Check
from planish.core.errors import check_choice
from planish.core.facts import SIDES, InputFile, Side
from planish.core.grid import Grid
from planish.core.options import params_of
from planish.marks import HoleParams, find_sheet_holes, without_dots
from planish.marks import find_holes as find_image_holes
from planish.results import SheetFacts
from planish.run.study import LayerParams

Shown = xr.DataArray | Mapping[str, xr.Dataset]
"""What is brought to the reference: an image, or the groups of a sheet; the maps only where it is
the reference."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """A sheet that was measured and flattened, or an image."""

    params: LayerParams  # with the sizes and pitches that were used
    source: InputFile
    # Machine direction, deg clockwise on screen from the x axis, if it was given.
    md_deg: float | None = None
    image: xr.DataArray | None = None
    # An image as it is compared; holes are found in the image itself.
    compared: xr.DataArray | None = None
    # Of a sheet: ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u),
    # ``slices``, and ``sections`` of serial sections.
    groups: dict[str, xr.Dataset] = field(default_factory=dict[str, xr.Dataset])
    # Groups that stand in the store of another run with the same bytes, and that store.
    unchanged: dict[str, Path] = field(default_factory=dict[str, Path])
    by_this_code: bool = True  # not of a sheet that was read from a run of other code
    facts: SheetFacts | None = None  # of a sheet
    checks: tuple[Check, ...] = ()  # of a sheet and its volume
    side_found: Side | None = None  # that an image shows, by its texture, where none was given

    @property
    def name(self) -> str:
        """Name of the layer."""
        return self.params.name

    @property
    def kind(self) -> Literal["sheet", "image"]:
        """What it is."""
        return "sheet" if self.image is None else "image"

    @property
    def shown(self) -> Shown:
        """What is brought to the reference.

        That is an image as it is compared, or the groups of a sheet.
        """
        return self.groups if self.compared is None else self.compared

    @property
    def grid(self) -> Grid:
        """Its own pixels: of the image, or of the flat maps."""
        return Grid.of(self.groups["maps"] if self.image is None else self.image)

    @property
    def side_given(self) -> Side | None:
        """Side of the sheet that an image shows, if it was given."""
        return None if self.params.image is None else self.params.image.side

    @property
    def side(self) -> Side:
        """Side of the sheet that the layer shows.

        It is the top for flat maps, and for an image of which nothing is known.
        """
        return self.side_given or self.side_found or "top"


class LayerHoles:
    """Laser holes of the layers of a link by one set of parameters; each face is searched once."""

    def __init__(self, params: HoleParams) -> None:
        self.params, self._holes = params, dict[tuple[str, Side], xr.Dataset]()

    def of(self, layer: Layer, to: Layer) -> xr.Dataset:
        """Give the holes of an image, or of a sheet in the face that the layer ``to`` shows.

        A sheet is seen from its top.
        """
        face_data, side = (
            (layer.groups["maps"], to.side) if layer.image is None else (layer.image, layer.side)
        )
        face: tuple[str, Side] = (layer.name, side)
        if face not in self._holes:
            self._holes[face] = find_holes(
                face_data, params=self.params, side=side, layer=layer.name
            )
        return self._holes[face]

    def searched(self, layer: Layer) -> list[xr.Dataset]:
        """Holes in all faces of a layer that were searched."""
        return [holes for (name, _), holes in self._holes.items() if name == layer.name]


def find_holes(
    shown: xr.DataArray | xr.Dataset,
    *,
    params: HoleParams | None = None,
    side: Side | None = None,
    layer: str | None = None,
) -> xr.Dataset:
    """Find the laser holes in an image (y, x) or in the flat maps (v, u) of a sheet.

    Parameters
    ----------
    shown : DataArray (y, x) or Dataset (v, u)
        An image of :func:`planish.read_image`, or maps of :func:`planish.resample_maps`.
    params : HoleParams, optional
    side : {"top", "bottom"}
        Side of the sheet that the image shows, as the image says where not given, else the top; for
        maps, the side that the image shows which they are registered to: the holes are searched in
        that face.
    layer : str, optional
        What messages call it; ``image`` or ``sheet`` where not given.

    Returns
    -------
    Dataset (mark)
        ``x``, ``y``, ``diameter`` in um, the covariance of each centre in um2; the attributes
        ``layer`` and ``seen_from`` (a flat map is always seen from the top).

    Raises
    ------
    InputError, VolumeError, SizeError
        If it is neither, or the image has no pixel size.
    MarkError
        If the maps have no layer that holes are found in.
    """
    params = params_of(HoleParams, params, "pl.find_holes")
    if side is not None:
        check_choice("side", side, SIDES)
    if isinstance(shown, xr.Dataset):
        holes = find_sheet_holes(shown, params=params, side=side or "top")
        return holes.assign_attrs(layer=layer or "sheet", seen_from="top")
    dy_um, dx_um = check_image(shown, "pl.find_holes({})")
    pixel, side = (dy_um, dx_um), side or shown.attrs.get("side") or "top"
    grey = without_dots(shown.values, pixel, params.hole_um[0]) if params.printed else shown.values
    holes = find_image_holes(grey, pixel_um=pixel, diameter_um=params.hole_um)
    return holes.assign_attrs(layer=layer or "image", seen_from=side)
