"""Laser holes of a flattened sheet: where its faces show them, and how they run through it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from planish.core.errors import MarkError
from planish.core.facts import HoleTiltFacts, Side
from planish.core.grid import Grid
from planish.core.robust import MAD_TO_SD
from planish.core.typing import Floats, Ints, Pair
from planish.marks.find import find_holes
from planish.marks.params import HoleParams

LAYERS = {
    "top": ("presence", "below the top face"),
    "centre": ("presence_centre", "at the centre surface"),
    "bottom": ("presence_bottom", "above the bottom face"),
}
OTHER_SIDE = ("through", "closed", "unclear")
THROUGH, CLOSED, UNCLEAR = range(3)
# How much material in the middle of a hole closes it.
MATERIAL = 0.5


def find_sheet_holes(maps: xr.Dataset, *, params: HoleParams | None = None, side: Side = "top") -> xr.Dataset:
    """Find the laser holes that one side of a flattened sheet shows, and where they lie in its other layers.

    Parameters
    ----------
    maps : Dataset, dims (v, u) or (y, x)
        ``presence``, ``presence_centre`` and ``presence_bottom``: share of material in a layer below the top face,
        around the centre surface and above the bottom face, 0 to 1, NaN where there is no data. A layer may be missing.
        Attributes, where known: ``layers_apart_um``, from the middle of the top's layer to that of the bottom's, and
        ``layer_to_face``, from the middle of a layer to its face as a share of that.
    params : HoleParams, optional
        Range of diameters on the side; in the other layers they may be 1.4 times off.
    side : {"top", "bottom"}
        Side that is shown. Where its layer is missing the other side's is searched.

    Returns
    -------
    Dataset, dims (mark)
        Holes as :func:`planish.marks.find_holes` gives them, ``x, y`` in the coordinates of the maps and at the face.
        For each layer ``x_top, y_top, cov_xx_top, cov_yy_top, cov_xy_top, diameter_top``, and so on with ``_centre``
        and ``_bottom``, where they were found; NaN where a hole is missing. ``offset_x, offset_y``: from the top to
        the bottom, um. ``other_side``: 0 found on the other side, 1 closed there, 2 neither. Attributes:

        - ``side``, that was searched, and ``layers``, those that are there;
        - ``openings``: how many openings within the sheet are as large as a hole and were not taken for one;
        - ``through``, ``closed``, ``unclear``: counts of ``other_side``; ``other_side_only``: what was found on
          the other side and has no partner on this one;
        - ``offset_count``, ``offset_um``, ``offset_spread_um``, ``offset_error_um``: holes found on both sides, the
          median (x, y) of their offsets, the robust standard deviation, and the standard error of the median;
        - ``to_face_um``: (x, y) that was added to go from the layer to the face;
        - ``tilt_deg``: angle (x, y) of the median offset with the normal, where ``layers_apart_um`` is known.

    Raises
    ------
    MarkError
        If there is no layer of either side, or the maps have no regular grid.

    Notes
    -----
    An offset that all holes share is a laser that was not perpendicular, or a flattening that shears the layers: both
    move the marks against an image of one side by as much. Where it stands out from its error, what it makes from the
    layer to the face is added. Offsets of single holes are mostly the roughness of their rims and are left alone. Rims
    of one hole lie within half its diameter; where it is more oblique, its layers are no longer round.

    Examples
    --------
    >>> y, x = np.mgrid[:100, :120] * 5.0
    >>> at = {"presence": 300, "presence_bottom": 306}
    >>> layers = {name: (("y", "x"), np.hypot(x - u, y - 250) > 80) for name, u in at.items()}
    >>> maps = xr.Dataset(layers, coords={"y": y[:, 0], "x": x[0]})
    >>> find_sheet_holes(maps).offset_x.values.round(0)
    array([6.])
    """
    if side not in ("top", "bottom"):
        raise MarkError(f"The side is {side!r}; an image shows the 'top' or the 'bottom'.")
    layers = {layer: maps[name].values for layer, (name, _) in LAYERS.items() if name in maps}
    other: Side = "bottom" if side == "top" else "top"
    if side not in layers:
        side, other = other, side
    if side not in layers:
        raise MarkError(
            "The maps hold no layer of the material at a face of the sheet (presence or presence_bottom). Make them "
            "again from the volume."
        )
    low, high = (params or HoleParams()).hole_um
    grid = Grid.of(maps)
    holes: dict[str, xr.Dataset] = {}
    for layer, share in layers.items():
        # A tapered hole is narrower, or wider, on the other side than what was asked for.
        sizes = (low, high) if layer == side else (low / 1.4, high * 1.4)
        holes[layer] = find_holes(share, pixel_um=grid.pixel_um, diameter_um=sizes, polarity="dark")
    centres, diameters = _xy(holes[side]), holes[side]["diameter"].values
    count = len(centres)
    rows = {layer: np.arange(count) if layer == side else np.full(count, -1) for layer in LAYERS}
    for layer in layers.keys() - {side}:
        # From one layer to another a hole moves by less than half its diameter: one that is more oblique is not round.
        rows[layer] = _partners(centres, _xy(holes[layer]), 0.5 * diameters)
    state, unpaired = np.full(count, UNCLEAR, dtype=np.uint8), 0
    if other in layers:
        unpaired = holes[other].sizes["mark"] - int(np.count_nonzero(rows[other] >= 0))
        state = _other_side(layers[other], grid.pixel_um, holes[side], holes[other], rows[other])
    holes = {layer: _shifted(dataset, grid.origin_um) for layer, dataset in holes.items()}
    of_layers = _by_layer(holes, rows)
    offsets = _xy(of_layers, "_bottom") - _xy(of_layers, "_top")
    statistics, to_face = _offset_statistics(offsets, maps, side)
    out = _shifted(holes[side], to_face).merge(of_layers, combine_attrs="override")
    for axis, along, offset in zip("xy", ("along the columns", "down the rows"), offsets.T, strict=True):
        long_name = f"Offset from the top to the bottom {along}"
        out[f"offset_{axis}"] = ("mark", offset, {"units": "um", "long_name": long_name})
    out["other_side"] = ("mark", state, {"long_name": "What the other side shows of the hole"})
    out["other_side"].attrs |= {"flag_values": list(range(3)), "flag_meanings": " ".join(OTHER_SIDE)}
    # What is as large as a circle of this share of the holes' diameter is an opening that should be one.
    least_um = 0.6 * float(np.median(diameters if count else [low]))
    out.attrs |= {
        "side": side,
        "layers": list(layers),
        "openings": _openings(layers[side], grid.pixel_um, centres, least_um),
        **{word: int(np.count_nonzero(state == k)) for k, word in enumerate(OTHER_SIDE)},
        "other_side_only": unpaired,
        **statistics,
    }
    return out


def _other_side(
    share: NDArray[np.generic], pixel: Pair, holes: xr.Dataset, partners: xr.Dataset, rows: Ints
) -> NDArray[np.uint8]:
    """Return the state of each hole on the other side, whose holes are ``partners`` and whose material is ``share``."""
    is_through, centres = rows >= 0, _xy(holes)
    state = np.where(is_through, THROUGH, UNCLEAR).astype(np.uint8)
    # Where the other side should show a hole: as far from this one as with the partners.
    shift = np.zeros(2)
    if is_through.any():
        shift = np.median(_xy(partners)[rows[is_through]] - centres[is_through], axis=0)
    axes = [np.arange(n) * step for n, step in zip(share.shape, pixel, strict=True)]
    for k in np.flatnonzero(~is_through).tolist():
        # The shares of the map in the middle of the hole, without those that are missing.
        radius = 0.25 * float(holes["diameter"].values[k])
        down, along = (axis - place for axis, place in zip(axes, (centres[k] + shift)[::-1], strict=True))
        near = [np.flatnonzero(np.abs(d) <= radius) for d in (down, along)]
        distance = np.hypot(down[near[0]][:, None], along[near[1]][None])
        shares = share[np.ix_(*near)].astype(np.float64)[distance <= radius]
        shares = shares[np.isfinite(shares)]
        state[k] = CLOSED if shares.size and np.median(shares) > MATERIAL else UNCLEAR
    return state


def _offset_statistics(offsets: Floats, maps: xr.Dataset, side: Side) -> tuple[dict[str, Any], Floats]:
    """Summarise the offsets from top to bottom, as attributes, and give the move from the layer to its face."""
    measured = offsets[np.isfinite(offsets).all(axis=1)]
    offset = spread = np.full(2, np.nan)
    if len(measured):
        offset = np.median(measured, axis=0)
    if len(measured) > 1:
        spread = MAD_TO_SD * np.median(np.abs(measured - offset), axis=0)
    # The error of a median over that of a mean.
    error = 1.2533 * spread / np.sqrt(max(len(measured), 1))
    to_face = np.zeros(2)
    # The median offset of fewer holes is no better than none; it counts from three standard errors.
    is_sure = len(measured) >= 4 and np.hypot(*offset) > 3.0 * np.hypot(*error)
    if is_sure and maps.attrs.get("layer_to_face"):
        outward = float(maps.attrs["layer_to_face"])
        to_face = (-outward if side == "top" else outward) * offset
    arrays = {"offset_um": offset, "offset_spread_um": spread, "offset_error_um": error, "to_face_um": to_face}
    statistics = {"offset_count": len(measured)} | {name: pair.tolist() for name, pair in arrays.items()}
    if (thickness_um := maps.attrs.get("layers_apart_um")) is not None:
        statistics["tilt_deg"] = np.rad2deg(np.arctan2(offset, thickness_um)).tolist()
    return statistics, to_face


def hole_tilt(holes: xr.Dataset | None) -> HoleTiltFacts | None:
    """Summarise how the holes of :func:`find_sheet_holes` run through the sheet; None for holes of no sheet."""
    if holes is None or "through" not in holes.attrs:
        return None
    attrs = holes.attrs
    offset, error = (np.array(attrs[k], dtype=np.float64) for k in ("offset_um", "offset_error_um"))
    text = "No hole was found on both sides of the sheet."
    if np.isfinite(offset).all():
        text = f"{attrs['offset_count']} holes run through the sheet, shifted by {np.hypot(*offset):.1f} um from its"
        text += " upper to its lower third"
        text += f" (± {np.sqrt(np.mean(error**2)):.1f} um)." if np.isfinite(error).all() else "."
    if closed := attrs["closed"]:
        text += f" {closed} {'is' if closed == 1 else 'are'} closed on the other side."
    facts = {k: v for k, v in attrs.items() if k in HoleTiltFacts.model_fields}
    return HoleTiltFacts.model_validate({**facts, "sentence": text})


def _shifted(holes: xr.Dataset, by: Sequence[float] | Floats) -> xr.Dataset:
    return holes.assign({k: holes[k].copy(data=holes[k].values + d) for k, d in zip("xy", by, strict=True)})


def _xy(holes: xr.Dataset, suffix: str = "") -> Floats:
    return np.stack([holes[f"x{suffix}"].values, holes[f"y{suffix}"].values], axis=1).astype(np.float64)


def _partners(holes: Floats, candidates: Floats, reach: Floats) -> Ints:
    """Return the candidate's row of each hole, -1 for none: either is the other's nearest, and within reach."""
    rows = np.full(len(holes), -1)
    if not len(holes) or not len(candidates):
        return rows
    nearest = np.asarray(KDTree(candidates).query(holes)[1], dtype=np.intp)
    back = np.asarray(KDTree(holes).query(candidates)[1], dtype=np.intp)
    distance = np.hypot(*(candidates[nearest] - holes).T)
    is_mutual = (back[nearest] == np.arange(len(holes))) & (distance <= reach)
    rows[is_mutual] = nearest[is_mutual]
    return rows


def _openings(share: NDArray[np.generic], pixel: Pair, centres: Floats, least_um: float) -> int:
    """Count openings away from the border, as large as a circle of a diameter or larger, that hold no hole."""
    material = share.astype(np.float64)
    has_data = np.isfinite(material)
    labelled: Any = ndimage.label((material < MATERIAL) | ~has_data)
    regions: Ints = labelled[0]
    sizes = np.bincount(regions.ravel(), minlength=int(labelled[1]) + 1) * pixel[0] * pixel[1]
    sizes[np.unique(np.concatenate([regions[[0, -1]].ravel(), regions[:, [0, -1]].ravel(), regions[~has_data]]))] = 0.0
    rows, cols = np.rint(centres[:, ::-1] / pixel).clip(0, np.array(share.shape) - 1).astype(np.intp).T
    sizes[regions[rows, cols]] = 0.0
    return int(np.count_nonzero(sizes[1:] > np.pi / 4 * least_um**2))


def _by_layer(holes: dict[str, xr.Dataset], rows: dict[str, Ints]) -> xr.Dataset:
    """Collect each layer's variables of the holes, NaN where a hole is missing."""
    variables: dict[str, tuple[str, Floats, dict[str, str]]] = {}
    template = next(iter(holes.values()))
    for layer, (_, place) in LAYERS.items():
        for name in ("x", "y", "cov_xx", "cov_yy", "cov_xy", "diameter"):
            numbers = holes[layer][name].values if layer in holes else np.empty(0)
            units, text = template[name].attrs["units"], f"{template[name].attrs['long_name']}, {place}"
            # The last row is that of the holes that are missing, -1.
            column = np.append(numbers, np.nan)[rows[layer]]
            variables[f"{name}_{layer}"] = ("mark", column, {"units": units, "long_name": text})
    return xr.Dataset(variables)
