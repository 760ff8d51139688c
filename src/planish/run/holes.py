"""Find the laser holes in an image or in the maps of a sheet; each face of a link once."""

import xarray as xr

from planish.core.arrays import check_dataset, check_image
from planish.core.errors import check_choice
from planish.core.facts import SIDES, Side
from planish.core.options import params_of
from planish.marks import HoleParams, find_sheet_holes, without_dots
from planish.marks import find_holes as find_image_holes
from planish.run.layers import MappedLayer


class HoleSearch:
    """Laser holes of the layers of a link by one set of parameters; each face is searched once."""

    def __init__(self, params: HoleParams) -> None:
        self.params = params
        self._holes = dict[tuple[str, Side], xr.Dataset]()

    def of(self, layer: MappedLayer, to: MappedLayer) -> xr.Dataset:
        """Give the holes of an image, or of a sheet in the face that the layer ``to`` shows.

        A sheet is seen from its top.
        """
        side = to.side if layer.image is None else layer.side
        face = (layer.name, side)
        if face not in self._holes:
            shown = layer.groups["maps"] if layer.image is None else layer.image
            self._holes[face] = find_holes(shown, params=self.params, side=side, layer=layer.name)
        return self._holes[face]

    def searched(self, layer: MappedLayer) -> list[xr.Dataset]:
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
        check_dataset(
            shown,
            expected="maps",
            source="pl.resample_maps(measured, flat)",
            call_format="pl.find_holes({})",
        )
        holes = find_sheet_holes(shown, params=params, side=side or "top")
        return holes.assign_attrs(layer=layer or "sheet", seen_from="top")
    dy_um, dx_um = check_image(shown, "pl.find_holes({})")
    grey, pixel_um = shown.values, (dy_um, dx_um)
    if params.printed:
        grey = without_dots(grey, pixel_um, params.hole_um[0])
    holes = find_image_holes(grey, pixel_um=pixel_um, diameter_um=params.hole_um)
    side = side or shown.attrs.get("side") or "top"
    return holes.assign_attrs(layer=layer or "image", seen_from=side)
