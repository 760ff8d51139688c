"""Sheets and images on the pixels of a reference, each brought there in one step; what is near a hole is masked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, InputError, MarkError
from planish.core.grid import Grid, check_same_grid
from planish.marks import cut_holes, hole_mask
from planish.marks.files import holes_of
from planish.pipeline.position_error import position_errors
from planish.pipeline.registration import Registration
from planish.register import Chain
from planish.resample import image_attrs, resample_image
from planish.resample import resample_maps as flat_maps

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

VALID = {"long_name": "Measured, and away from holes and their rims"}

Shown = xr.DataArray | Mapping[str, xr.Dataset]
"""What is brought to the reference: an image, or the groups of a sheet; the maps only where it is the reference."""


def on_reference(
    parts: Mapping[str, tuple[Shown, Chain | None]], circles: Iterable[Array], grid: Grid, *,
    memory_bytes: int = 2**31,
) -> tuple[dict[str, xr.Dataset], Mask]:  # fmt: skip
    """Bring sheets and images onto a grid and mark what is valid there.

    ``circles`` (n, 3: x, y, radius in um) are the holes on the reference with their burnt rims. Returned are all maps
    of each sheet, or ``image``, with ``valid``, and ``expected_error`` of what was moved with its shares; and what is
    away from holes.
    """
    away = np.ones(grid.shape, dtype=bool)
    for found in circles:
        away &= ~hole_mask(grid, found[:, :2], found[:, 2])
    maps = {name: _brought(name, *part, grid, memory_bytes) for name, part in parts.items()}
    for name, data in maps.items():
        known = np.isfinite(data["thickness" if "thickness" in data else "image"].values) & away
        maps[name] = data.assign(valid=(("y", "x"), known, VALID))
    return maps, away


def _brought(name: str, shown: Shown, chain: Chain | None, grid: Grid, memory_bytes: int) -> xr.Dataset:
    if isinstance(shown, xr.DataArray):
        if chain is None:
            return xr.Dataset({"image": (("y", "x"), shown.values, image_attrs(shown))}, coords=grid.coords)
        data = resample_image(shown, grid, chain, memory_bytes=memory_bytes)
    elif chain is None:
        maps = shown["maps"].rename({"v": "y", "u": "x"})
        return maps.drop_vars([n for n in maps.data_vars if str(n).startswith(("projected_", "presence", "valid"))])
    else:
        data = flat_maps(shown["surfaces"], shown["flat"], onto=grid, transform=chain)
    present = data["image" if "image" in data else "u"].values
    if not np.isfinite(present).any():
        raise CannotRegister(
            f"The layer {name} does not meet the reference: by its marks it lies beside it. Check the marks."
        )
    return data.assign(position_errors(None if isinstance(shown, xr.DataArray) else shown, chain, grid, present))


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
        If the registration belongs to another image.
    """
    check_same_grid(measured, flat)
    if onto is None and registration is None:
        return flat_maps(measured, flat, map_um=map_um)
    if onto is None or registration is None:
        raise InputError("onto and registration belong together: give both, or neither for the flat maps.")
    grid = Grid.of(onto)
    _refuse_other_image(registration, grid)
    chain = Chain(fits=(registration.fit,))
    rim_um = float(measured.attrs["rim_um"])
    circles = (
        hole_circles(registration.marks, "moving", rim_um, chain=chain),
        hole_circles(registration.marks, "fixed", rim_um, image=onto),
    )
    maps, _ = on_reference(
        {"sheet": ({"surfaces": measured, "flat": flat}, chain), "image": (onto, None)}, circles, grid
    )
    return merged(maps["sheet"], maps["image"])


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
