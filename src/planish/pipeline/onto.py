"""Sheets and images on the pixels of a reference, each brought there in one step; what is near a hole is masked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_dataset, check_image
from planish.core.errors import CannotRegister, InputError, MarkError
from planish.core.grid import Grid, check_same_grid
from planish.core.tiles import Tile
from planish.io.map_store import HeldMaps, map_tiles
from planish.marks import cut_holes, hole_mask
from planish.marks.files import about_layer, holes_of
from planish.marks.regions import Regions
from planish.pipeline.position_error import PositionErrors
from planish.pipeline.registration import Registration
from planish.register import Chain
from planish.resample import SheetOnto, image_attrs, resample_image
from planish.resample import resample_maps as flat_maps

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Shown = xr.DataArray | Mapping[str, xr.Dataset]
"""What is brought to the reference: an image, or the groups of a sheet; the maps only where it is the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class Away:
    """Which pixels of a reference are away from holes and their burnt rims, and outside of declared regions.

    ``circles`` (n, 3: x, y, radius in um) are the holes with their rims, ``regions`` in um as well.
    """

    circles: Array
    regions: Regions | None = None

    @classmethod
    def of(cls, circles: Iterable[Array], regions: Regions | None = None) -> Away:
        """From the circles of all layers."""
        return cls(np.concatenate([np.empty((0, 3)), *circles]), regions)

    def __call__(self, part: Grid) -> Mask:
        """Say it of some pixels."""
        away = ~hole_mask(part, self.circles[:, :2], self.circles[:, 2])
        return away if self.regions is None else away & ~self.regions.inside(part)

    @property
    def sentence(self) -> str:
        """What a valid pixel is."""
        beside = "" if self.regions is None else ", outside of declared regions"
        return f"Measured, and away from holes and their rims{beside}"


class _Layer:
    """A layer that is brought onto the pixels of a reference, tile by tile."""

    def __init__(self, name: str, shown: Shown, chain: Chain | None, grid: Grid) -> None:
        self.name, self._met = name, chain is None
        self._on = _own_pixels(shown) if chain is None else _moved(shown, chain)
        sheet = None if isinstance(shown, xr.DataArray) else shown
        self._errors = None if chain is None else PositionErrors(sheet, chain, grid)

    def on(self, tile: Tile, part: Grid) -> xr.Dataset:
        """Its maps on a tile of the reference, ``expected_error`` and its shares where it was moved."""
        data = self._on(tile, part)
        if self._errors is None:
            return data
        present = data["image" if "image" in data else "u"].values
        self._met |= bool(np.isfinite(present).any())
        return data.assign(self._errors.on(part, present))

    def check_met(self) -> None:
        """Raise CannotRegister where no tile shows it."""
        if not self._met:
            raise CannotRegister(
                f"The layer {self.name} does not meet the reference: by its marks it lies beside it. Check the marks."
            )


def _own_pixels(shown: Shown) -> Callable[[Tile, Grid], xr.Dataset]:
    """The reference itself, tile by tile."""
    if isinstance(shown, xr.DataArray):
        data = xr.Dataset({"image": (("y", "x"), shown.values, image_attrs(shown))}, coords=Grid.of(shown).coords)
    else:
        maps = shown["maps"].rename({"v": "y", "u": "x"})
        left = [n for n in maps.data_vars if str(n).startswith(("projected_", "presence", "valid"))]
        data = maps.drop_vars(left)
    return lambda tile, _: data.isel(y=tile.rows, x=tile.cols)


def _moved(shown: Shown, chain: Chain) -> Callable[[Tile, Grid], xr.Dataset]:
    """A layer through its chain, tile by tile."""
    if isinstance(shown, xr.DataArray):
        return lambda _, part: resample_image(shown, part, chain, must_meet=False)
    sheet = SheetOnto(shown["surfaces"], shown["flat"], transform=chain)
    return lambda _, part: sheet.on(part)


def bring(
    parts: Mapping[str, tuple[Shown, Chain | None]], away: Away, grid: Grid, sink: HeldMaps, *,
    together: str | None = None,
) -> dict[str, xr.Dataset]:  # fmt: skip
    """Bring sheets and images onto a grid, tile by tile, and mark what is valid there.

    Put into ``sink`` are all maps of each sheet, or ``image``, with ``valid``, and ``expected_error`` of what was moved
    with its shares: as ``layers/NAME``, or a sheet and an image as one group ``together``. Returned are the maps of
    each layer.
    """
    layers = [_Layer(name, *part, grid) for name, part in parts.items()]
    for tile in map_tiles(grid.shape):
        part = grid.part(tile.rows, tile.cols)
        use = away(part)
        found = {layer.name: _with_valid(layer.on(tile, part), use, away.sentence) for layer in layers}
        if together is not None:
            sink.add(together, grid, tile, merged(*found.values()))
        else:
            for name, data in found.items():
                sink.add(f"layers/{name}", grid, tile, data)
    for layer in layers:
        layer.check_met()
    if together is None:
        return {name: sink.group(f"layers/{name}") for name in parts}
    both = sink.group(together)
    return dict(zip(parts, (both.drop_vars("image"), both[["image", "valid"]]), strict=True))


def _with_valid(data: xr.Dataset, use: Mask, meaning: str) -> xr.Dataset:
    known = np.isfinite(data["thickness" if "thickness" in data else "image"].values) & use
    return data.assign(valid=(("y", "x"), known, {"long_name": meaning}))


def hole_circles(
    marks: xr.Dataset, side: str, rim_um: float, *, chain: Chain | None = None, image: xr.DataArray | None = None
) -> Array:
    """Circles (n, 3: x, y, radius in um) around all holes of one layer, on the reference.

    ``chain`` leads from the layer to the reference where it is another one; of the layer's own ``image``, the holes
    that its border cuts are included.
    """
    holes = holes_of(marks, side)
    found = _circles(holes)
    if image is not None:
        found = np.concatenate([found, _circles(cut_holes(image, holes))])
    if chain is not None:
        found = np.column_stack([chain(found[:, :2]), found[:, 2] * chain.similarity.scale])
        found = found[np.isfinite(found).all(axis=1)]
    return found + np.array([0.0, 0.0, rim_um])


def _circles(holes: xr.Dataset) -> Array:
    return np.stack([holes["x"].values, holes["y"].values, 0.5 * holes["diameter"].values], axis=1)


def merged(sheet: xr.Dataset, image: xr.Dataset) -> xr.Dataset:
    """The maps of a sheet and an image on the image's pixels as one dataset, ``linked``."""
    return sheet.assign(image=image["image"], valid=sheet["valid"] & image["valid"]).assign_attrs()


def resample_maps(
    measured: xr.Dataset, flat: xr.Dataset, *, onto: xr.DataArray | None = None,
    registration: Registration | None = None, map_um: float | None = None,
) -> xr.Dataset:  # fmt: skip
    """Bring a sheet's properties onto a regular grid: of the flat sheet, or the pixels of an image.

    Values are interpolated once, from the columns of the volume to the pixels of the result.

    Parameters
    ----------
    measured : Dataset (y, x)
        Of :func:`planish.measure_properties`.
    flat : Dataset (y, x)
        Flat coordinates, of :func:`planish.flatten_sheet`.
    onto : DataArray (y, x), optional
        An image of :func:`planish.read_image`; with ``registration``.
    registration : Registration, optional
        From the flat sheet to the image, of :func:`planish.register_marks`.
    map_um : float, optional
        Pixel of the flat maps; the pitch of the columns where not given.

    Returns
    -------
    Dataset
        Maps (v, u) of the flat sheet; or linked maps (y, x) on the image's pixels: all properties, where in the volume
        each pixel lies, ``image``, ``expected_error`` in um, and ``valid``: measured, and away from holes and their
        rims.

    Raises
    ------
    SurfaceError
        If the two datasets stand on different columns.
    InputError
        If only one of ``onto`` and ``registration`` is given.
    MarkError
        If the registration belongs to another image, or goes from the image to the sheet.
    """
    check_dataset(
        measured, "centre", what="measured surfaces", maker="pl.measure_properties(surfaces, volume=volume)",
        call="pl.resample_maps({}, flat)",
    )  # fmt: skip
    check_dataset(
        flat, "u", "v", what="flat coordinates", maker="pl.flatten_sheet(surfaces).flat",
        call="pl.resample_maps(measured, {})",
    )  # fmt: skip
    check_same_grid(measured, flat)
    if onto is None and registration is None:
        return flat_maps(measured, flat, map_um=map_um)
    if onto is None or registration is None:
        raise InputError("onto and registration belong together: give both, or neither for the flat maps.")
    check_image(onto, "pl.resample_maps(measured, flat, onto={}, registration=registration)")
    sides = [about_layer(registration.marks, side).get("title") for side in ("moving", "fixed")]
    if sides == ["image", "sheet"]:
        raise MarkError(
            "The registration goes from the image to the sheet; needed is one from the sheet to the image. Write "
            "pl.register_marks(pl.find_holes(maps), pl.find_holes(image))."
        )
    grid = Grid.of(onto)
    _refuse_other_image(registration, grid)
    chain = Chain(fits=(registration.fit,))
    rim_um = float(measured.attrs["rim_um"]) + float(onto.attrs.get("reach_um", 0.0))
    circles = (
        hole_circles(registration.marks, "moving", rim_um, chain=chain),
        hole_circles(registration.marks, "fixed", rim_um, image=onto),
    )
    parts: dict[str, tuple[Shown, Chain | None]] = {
        "sheet": ({"surfaces": measured, "flat": flat}, chain), "image": (onto, None),
    }  # fmt: skip
    sink = HeldMaps()
    bring(parts, Away.of(circles), grid, sink, together="linked")
    return sink.group("linked")


def _refuse_other_image(registration: Registration, grid: Grid) -> None:
    """Marks beside the image show that the registration belongs to another one, or its pixels have another size."""
    (x, y), fixed, pixel = grid.origin_um, registration.fit.fixed, max(grid.pixel_um)
    least, most = np.array([x, y]) - pixel, np.array([grid.x_um[-1], grid.y_um[-1]]) + pixel
    beside = int(np.count_nonzero(((fixed < least) | (fixed > most)).any(axis=1)))
    if beside:
        raise MarkError(
            f"{beside} of {len(fixed)} marks of the registration lie beside the image. It belongs to another image, or "
            "the pixel size is another one: give the image that was registered."
        )
