"""The holes of a flattened sheet as its face shows them, and places between flat map, volume and pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import MarkError
from planish.core.frame import Frame
from planish.core.grid import pitch, values_at
from planish.marks import Side, find_holes_in_sheet
from planish.pipeline.run import Array
from planish.surface.presence import LAYERS

_ENOUGH_THROUGH = 4  # holes seen on both sides: the median of fewer is no better than none
_STANDS_OUT = 3.0  # standard errors of the median offset
_MIDDLE = float(np.mean(LAYERS["presence"]))  # of the layer, as a share of the thickness from the centre surface
_TO_FACE = (0.5 - _MIDDLE) / (_MIDDLE - float(np.mean(LAYERS["presence_bottom"])))


def holes_of_map(maps: xr.Dataset, hole_um: tuple[float, float], side: Side = "top") -> xr.Dataset:
    """Holes of the flattened sheet, in (u, v), as they are at the face that the other plane shows.

    They are found in a layer below that face. A laser that stands obliquely shifts all of them alike from layer to
    layer; where that stands out from their scatter, what it makes from the layer to the face is put on. Offsets of
    single holes are mostly the roughness of their rims, and are left alone.

    Maps of an older run, which hold one layer only, give those of the top for either side.
    """
    step = pitch(maps)[1]
    layers = {"top": "presence", "centre": "presence_centre", "bottom": "presence_bottom"}
    whole = "presence_bottom" in maps
    holes = find_holes_in_sheet(
        **{layer: maps[name].values if name in maps else None for layer, name in layers.items()},
        pixel_um=step, origin_um=(float(maps["v"].values[0]), float(maps["u"].values[0])), diameter_um=hole_um,
        side=side if whole else "top", apart_um=maps.attrs.get("layers_apart_um"),
    )  # fmt: skip
    offset, error = (np.array(holes.attrs[k], dtype=np.float64) for k in ("offset_um", "offset_error_um"))
    sure = holes.attrs["offset_count"] >= _ENOUGH_THROUGH and np.hypot(*offset) > _STANDS_OUT * np.hypot(*error)
    if not whole or not sure:
        return holes
    outward = (-_TO_FACE if side == "top" else _TO_FACE) * offset
    return holes.assign({k: holes[k].copy(data=holes[k].values + d) for k, d in zip("xy", outward, strict=True)})


def in_sheet_results(holes: xr.Dataset | None) -> dict[str, Any] | None:
    """What the holes of a sheet look like through its thickness; None where none were looked for in a sheet."""
    if holes is None or "through" not in holes.attrs:
        return None
    counts = {k: int(holes.attrs[k]) for k in ("through", "closed", "unclear", "other_side_only", "offset_count")}
    found = {
        k: [float(v) if np.isfinite(v) else None for v in holes.attrs[k]]
        for k in ("offset_um", "offset_spread_um", "offset_error_um", "tilt_deg")
        if k in holes.attrs
    }
    offset, error = (np.array(holes.attrs[k], dtype=np.float64) for k in ("offset_um", "offset_error_um"))
    text = "No hole was seen on both sides of the sheet."
    if np.isfinite(offset).all():
        text = (
            f"{counts['offset_count']} holes run through the sheet, shifted by {np.hypot(*offset):.1f} um from its "
            "upper to its lower third"
        )
        text += f" (± {np.sqrt(np.mean(error**2)):.1f} um)." if np.isfinite(error).all() else "."
    if counts["closed"]:
        text += f" {counts['closed']} {'is' if counts['closed'] == 1 else 'are'} closed on the other side."
    return counts | found | {"side": str(holes.attrs["side"]), "sentence": text}


def in_flat(given: xr.Dataset, flat: xr.Dataset, surfaces: xr.Dataset) -> Array:
    """Given marks (n, 2) in the flat map: as they are, or from the volume by the column they lie in."""
    if "moving_x" in given:
        return np.stack([given["moving_x"].values, given["moving_y"].values], axis=1)
    frame = Frame.of(surfaces)
    columns = np.stack([given[f"volume_{axis}"].values for axis in (frame.cols, frame.rows)], axis=1)
    moving = values_at(flat, ("u", "v"), columns)
    lost = [str(n) for n, p in zip(given["label"].values, moving, strict=True) if not np.isfinite(p).all()]
    if lost:
        raise MarkError(
            f"The marks {', '.join(lost)} do not lie on the sheet. Check the axes and the unit (um) of the table."
        )
    return moving


def at_flat(maps: xr.Dataset, names: tuple[str, str], points: Array) -> Array:
    """Values of two maps at points (n, 2) of the flat sheet."""
    found = values_at(maps, names, points)
    if not np.isfinite(found).all():
        raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
    return found


def cut_holes(image: xr.DataArray, holes: xr.Dataset) -> Array:
    """Circles (n, 3: x, y, radius in um) around holes that the border of an image cuts: those are not found.

    They are what touches the border, is beyond half way from the sheet to the floor of the holes that were found, and
    has a tenth of their area or more.
    """
    if not holes.sizes["mark"]:
        return np.empty((0, 3))
    values = np.asarray(image.values, dtype=np.float64)
    y, x = image["y"].values, image["x"].values
    at, radius = np.stack([holes["x"].values, holes["y"].values], axis=1), 0.5 * holes["diameter"].values
    floor = float(np.nanmedian(values[~outside_holes(y, x, at, 0.6 * radius)]))
    sheet = float(np.nanmedian(values[outside_holes(y, x, at, 1.5 * radius)]))
    if not np.isfinite(floor - sheet) or floor == sheet:
        return np.empty((0, 3))
    beyond = np.isfinite(values) & ((values - sheet) / (floor - sheet) > 0.5)
    labels = np.asarray(ndimage.label(beyond)[0])
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    step = pitch(image)
    least = 0.1 * np.pi * float(np.median(radius)) ** 2 / (step[0] * step[1])
    found: list[tuple[float, float, float]] = []
    for label in border[border > 0]:
        rows, cols = np.nonzero(labels == label)
        if rows.size < least:
            continue
        places = np.stack([x[cols], y[rows]], axis=1)
        middle = places.mean(axis=0)
        reach = np.hypot(*(places - middle).T).max()
        found.append((float(middle[0]), float(middle[1]), float(reach)))
    return np.array(found).reshape(-1, 3)


def outside_holes(
    y_um: Array, x_um: Array, centres_um: Array, radii_um: Array
) -> NDArray[np.bool_]:  # fmt: skip
    """Pixels of a regular grid that are away from every hole and its rim.

    Parameters
    ----------
    y_um, x_um : (rows,) and (cols,)
        Where the pixels lie.
    centres_um : (n, 2), as (x, y)
    radii_um : (n,)
    """
    away = np.ones((y_um.size, x_um.size), dtype=bool)
    for (x, y), radius in zip(centres_um, radii_um, strict=True):
        rows = slice(*np.searchsorted(y_um, (y - radius, y + radius)))
        cols = slice(*np.searchsorted(x_um, (x - radius, x + radius)))
        away[rows, cols] &= np.hypot(x_um[None, cols] - x, y_um[rows, None] - y) > radius
    return away
