"""Layers: sheets and images as a link needs them, read in the order in which faults are cheap to find."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import xarray as xr

from planish.compute import Compute
from planish.core.grid import Grid
from planish.core.results import InputFile, Side
from planish.io import read_image
from planish.marks import HoleParams, find_sheet_holes
from planish.marks import find_holes as find_image_holes
from planish.pipeline.facts import input_file
from planish.pipeline.onto import FlatSheet, Shown
from planish.pipeline.progress import Progress
from planish.pipeline.run import open_run
from planish.pipeline.sheet import Sheet, changed, map_layer
from planish.study import LayerParams, Study


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """One layer: a sheet with its maps, or an image.

    Attributes
    ----------
    params : LayerParams
        With the sizes that were used.
    grid : Grid
        Its own pixels: of the image, or of the flat maps.
    source : InputFile
    sheet : Sheet or None
    image : DataArray or None
    """

    params: LayerParams
    grid: Grid
    source: InputFile
    sheet: Sheet | None = None
    image: xr.DataArray | None = None
    _holes: dict[Side, xr.Dataset] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the layer."""
        return self.params.name

    @property
    def kind(self) -> Literal["sheet", "image"]:
        """What it is."""
        return "image" if self.sheet is None else "sheet"

    @property
    def side_given(self) -> Side | None:
        """Side of the sheet that an image shows, if it was given."""
        return None if self.params.image is None else self.params.image.side

    @property
    def side(self) -> Side:
        """Side of the sheet that it shows: the top for flat maps, and for an image where nothing is given."""
        return self.side_given or "top"

    @property
    def md_deg(self) -> float | None:
        """Machine direction, deg clockwise on screen from the x axis, if it was given."""
        if self.params.md_deg is not None:
            return self.params.md_deg
        if self.params.image is not None:
            return self.params.image.md_deg
        volume = self.sheet.params.volume if self.sheet is not None else None
        return None if volume is None else volume.md_deg

    @property
    def shown(self) -> Shown:
        """What is brought to the reference."""
        if self.image is not None:
            return self.image
        assert self.sheet is not None
        groups = self.sheet.groups
        return FlatSheet(measured=groups["surfaces"], flat=groups["flat"], maps=groups["maps"])

    @property
    def rim_um(self) -> float:
        """Zone around holes that is left out, as the surface search of the sheet had it."""
        return float(self.sheet.groups["surfaces"].attrs["rim_um"]) if self.sheet is not None else 0.0

    def holes(self, params: HoleParams, side: Side) -> xr.Dataset:
        """Its laser holes; those of a sheet as the face ``side`` shows them."""
        key: Side = side if self.sheet is not None else self.side
        if key not in self._holes:
            shown = self.image if self.sheet is None else self.sheet.groups["maps"]
            assert shown is not None
            self._holes[key] = find_holes(shown, params=params, side=key, layer=self.name)
        return self._holes[key]


def find_holes(
    shown: xr.DataArray | xr.Dataset, *, params: HoleParams | None = None, side: Side = "top", layer: str | None = None
) -> xr.Dataset:
    """Find the laser holes in an image (y, x) or in the flat maps (v, u) of a sheet.

    Parameters
    ----------
    shown : DataArray (y, x) or Dataset (v, u)
        An image of :func:`planish.read_image`, or maps of :func:`planish.resample_maps`.
    params : HoleParams, optional
    side : {"top", "bottom"}
        Side of the sheet that the image shows; for maps, the side that the image shows which they are registered to:
        the holes are searched in that face.
    layer : str, optional
        What messages call it; ``image`` or ``sheet`` where not given.

    Returns
    -------
    Dataset (mark)
        ``x``, ``y``, ``diameter`` in um, the covariance of each centre in um2; the attributes ``layer`` and
        ``seen_from`` (a flat map is always seen from the top).
    """
    params = params or HoleParams()
    if isinstance(shown, xr.Dataset):
        found = find_sheet_holes(shown, params=params, side=side)
        return found.assign_attrs(layer=layer or "sheet", seen_from="top")
    pixel = (float(shown.attrs["pixel_um"][0]), float(shown.attrs["pixel_um"][1]))
    found = find_image_holes(shown.values, pixel_um=pixel, diameter_um=params.hole_um)
    return found.assign_attrs(layer=layer or "image", seen_from=side)


def open_layers(study: Study, *, compute: Compute, progress: Progress, kept: Path | None) -> list[Layer]:
    """Read all layers of a study and map its volumes.

    Images come first: they are quick, and a missing pixel size or too few holes should not cost the time of a volume.
    """
    found: dict[str, Layer] = {}
    for params in sorted(study.layers, key=lambda layer: ("image", "run", "volume").index(layer.kind)):
        name = params.name
        if params.image is not None:
            progress("read", Path(params.path).name)
            image = read_image(
                params.path, pixel_um=params.image.pixel_um, channel=params.image.channel,
                override_size=params.image.override_size,
            )  # fmt: skip
            pixel = (float(image.attrs["pixel_um"][0]), float(image.attrs["pixel_um"][1]))
            own = changed(params, image=changed(params.image, pixel_um=pixel))
            found[name] = Layer(params=own, grid=Grid.of(image), source=input_file(image, params.path), image=image)
            continue
        if params.run is not None:
            progress("read", Path(params.run).name)
            sheet = open_run(params.run).sheet()
        else:
            inside = None if kept is None else kept / name
            sheet = map_layer(params, compute=compute, progress=progress, kept=inside)
        own = params
        if params.run is None:
            own = sheet.params
        elif study.is_sheet_on_image and sheet.params.volume is not None:
            # The study of the run becomes part of this one: the volume linked to the image has the same bytes.
            md_deg = sheet.params.volume.md_deg if params.md_deg is None else params.md_deg
            own = changed(
                sheet.params, name=name, marks=params.marks, volume=changed(sheet.params.volume, md_deg=md_deg)
            )
        found[name] = Layer(params=own, grid=Grid.of(sheet.groups["maps"]), source=sheet.source, sheet=sheet)
    return [found[layer.name] for layer in study.layers]
