"""Layers on the grid of a reference, each brought there in one step, and what their pixels may be off."""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from planish.analyze import masked_lag
from planish.core.errors import SizeError
from planish.core.grid import Grid, pitch
from planish.core.transform import Similarity
from planish.pipeline.run import Array
from planish.pipeline.sheet import on_mesh, single, uv
from planish.properties import turned_angles, with_angles
from planish.register import Chain
from planish.resample import find_places, resample_dataset, warp_image
from planish.results import lag_results

_LOOKED_AT = 200  # places a side at which the expected error is worked out; it varies over millimetres
_REACH_UM, _COARSEST_UM, _TILE_UM, _SURROGATES = 150.0, 1000.0, 1000.0, 99


class Way(Protocol):
    """What takes points of a sheet to the reference."""

    def __call__(self, points: ArrayLike, /) -> Array:
        """Take points (..., 2) to the reference, in um."""
        ...

    @property
    def similarity(self) -> Similarity:
        """The closest similarity."""
        ...


def sheet_on(grid: Grid, surfaces: xr.Dataset, flat: xr.Dataset, way: Way) -> xr.Dataset:
    """All maps of a sheet (y, x) on a grid, in one step from the mesh: nothing is resampled twice."""
    places = find_places(
        way(uv(flat)), shape=grid.shape, pixel_um=grid.pixel_um, origin_um=grid.origin_um,
        least_um=min(pitch(surfaces)) * way.similarity.scale,
    )  # fmt: skip
    source = on_mesh(surfaces, flat).drop_vars(["projected_u", "projected_v"])
    found = resample_dataset(source, places, dims=("y", "x"), coords=grid.coords)
    return single(with_angles(turned_angles(found, way.similarity)))


def image_on(grid: Grid, image: xr.DataArray, way: Chain, *, memory_bytes: int) -> xr.Dataset:
    """An image (y, x) on a grid: means over the area where pixels become larger, interpolated elsewhere."""
    pixel = (float(image.attrs["pixel_um"][0]), float(image.attrs["pixel_um"][1]))
    warped = warp_image(
        image.values, pixel, way.inverse, grid.shape, grid.pixel_um, origin_um=grid.origin_um,
        memory_bytes=memory_bytes,
    )  # fmt: skip
    return xr.Dataset({"image": (("y", "x"), warped.values, image_attrs(image))}, coords=grid.coords)


def image_attrs(image: xr.DataArray) -> dict[str, str]:
    """Name and unit of an image's values."""
    return {"long_name": str(image.attrs.get("long_name", "Image")), "units": "1"}


def expected_error(way: Chain, grid: Grid, shown: Array) -> xr.DataArray:
    """How far each pixel may be off, in um of the reference, where ``shown`` (y, x) is finite.

    It is worked out on a lattice of at most some 200 x 200 places and interpolated between.
    """
    at = [np.linspace(v[0], v[-1], min(v.size, _LOOKED_AT)) for v in (grid.y_um, grid.x_um)]
    places = way.inverse(np.stack(np.meshgrid(at[1], at[0]), axis=-1))
    coarse = xr.DataArray(way.expected_error_um(places), dims=("y", "x"), coords={"y": at[0], "x": at[1]})
    fine = coarse.interp(y=grid.y_um, x=grid.x_um).values
    values = np.where(np.isfinite(shown), fine, np.nan).astype(np.float32)
    attrs = {"long_name": "Expected error of the place, rms", "units": "um"}
    return xr.DataArray(values, dims=("y", "x"), coords=grid.coords, attrs=attrs)


def headline_of(maps: xr.Dataset, side: Literal["top", "bottom"] = "top") -> str:
    """The map that stands for a layer: an image itself, the coating of the side that is seen, or the thickness."""
    if "image" in maps and "thickness" not in maps:
        return "image"
    coating = f"coating_{side}"
    return coating if np.isfinite(maps[coating].values).any() else "thickness"


def agreement(
    a: Array, b: Array, valid: NDArray[np.bool_], pixel_um: tuple[float, float], error: Array, name: str
) -> dict[str, Any] | None:
    """Look whether two maps themselves agree that they lie right, within the expected error of the registration.

    None where there are too few pixels for any lag.
    """
    shown = error[np.isfinite(error) & valid]
    expected = float(np.sqrt(np.mean(shown.astype(np.float64) ** 2))) if shown.size else None
    short = min(n * um for n, um in zip(valid.shape, pixel_um, strict=True))
    try:
        lag = masked_lag(
            np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64), valid, pixel_um,
            reach_um=min(_REACH_UM, short / 4), band_um=(None, _COARSEST_UM),
            tiles_um=_TILE_UM if short >= 2 * _TILE_UM else None, surrogates=_SURROGATES,
        )  # fmt: skip
    except SizeError:
        return None  # too few pixels for any lag
    return lag_results(lag, expected_um=expected, headline=name)
