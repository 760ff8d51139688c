"""Laser holes followed through the sheet: where each lies below the top face, at the centre and above the bottom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from planish.core.errors import MarkError, SizeError
from planish.marks.find import find_holes

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Side = Literal["top", "bottom"]

LAYERS = ("top", "centre", "bottom")
PLACES = {"top": "below the top face", "centre": "at the centre surface", "bottom": "above the bottom face"}
OF_A_LAYER = (
    ("x", "um", "Hole centre along the columns"),
    ("y", "um", "Hole centre down the rows"),
    ("cov_xx", "um2", "Variance of x"),
    ("cov_yy", "um2", "Variance of y"),
    ("cov_xy", "um2", "Covariance of x and y"),
    ("diameter", "um", "Mean diameter of the rim"),
)
THROUGH, CLOSED, UNCLEAR = 0, 1, 2
OTHER_SIDE = {THROUGH: "through", CLOSED: "closed", UNCLEAR: "unclear"}

# A tapered hole is narrower, or wider, on the other side than what was asked for.
OTHER_DIAMETER = 1.4
# From one layer to another a hole moves by less than this share of its diameter: one that leans more is not round.
REACH = 0.5
# The middle of a hole, as a share of its diameter, and how much material in it closes a hole.
MIDDLE, MATERIAL = 0.25, 0.5
# Standard deviation of a normal distribution over its median absolute deviation; error of a median over that of a mean.
MAD_TO_SD, MEDIAN_TO_MEAN = 1.4826, 1.2533


@dataclass(frozen=True, slots=True, kw_only=True)
class _Offsets:
    """From the top's rim to the bottom's: (n, 2) of each hole, NaN where one is not seen; median, spread, error."""

    each: Floats
    count: int
    median: Floats
    spread: Floats
    error: Floats


def find_holes_in_sheet(
    top: ArrayLike | None,
    centre: ArrayLike | None = None,
    bottom: ArrayLike | None = None,
    *,
    pixel_um: float | tuple[float, float],
    origin_um: tuple[float, float] = (0.0, 0.0),
    diameter_um: tuple[float, float] = (100.0, 300.0),
    side: Side = "top",
    apart_um: float | None = None,
) -> xr.Dataset:
    """Find the laser holes that an image of one side shows, and where they lie in the other layers of the sheet.

    Parameters
    ----------
    top, centre, bottom : array-like, shape (rows, columns), or None
        Share of material below the top face, around the centre surface and above the bottom face, 0 to 1; NaN where
        there is no data. None where there is no such map.
    pixel_um : float or (float, float), in um
        Pixel size, one value or ``(y, x)``.
    origin_um : (float, float), in um
        Place ``(y, x)`` of the first pixel.
    diameter_um : tuple of float, in um
        Smallest and largest diameter of a hole on the wanted side; on the others it may be 1.4 times off.
    side : {"top", "bottom"}
        Side that the image shows. ``x`` and ``y`` are the rims on it.
    apart_um : float, optional
        Distance from the middle of the layer of ``top`` to that of ``bottom``, which makes an angle of the offset.

    Returns
    -------
    Dataset, dims (mark)
        The holes of the wanted side as :func:`planish.marks.find_holes` gives them. For each layer ``x_top, y_top,
        cov_xx_top, cov_yy_top, cov_xy_top, diameter_top``, and so on with ``_centre`` and ``_bottom``; NaN where a hole
        is not seen. ``offset_x, offset_y``: from the top to the bottom, um. ``other_side``: 0 seen on the other side,
        1 closed there, 2 neither. Attributes:

        - ``side``, and ``layers``, those that were searched;
        - ``through``, ``closed``, ``unclear``: counts of ``other_side``; ``other_side_only``: what looks like a hole on
          the other side and has no partner on this one;
        - ``offset_count``, ``offset_um``, ``offset_spread_um``, ``offset_error_um``: holes seen on both sides, the
          median (x, y) of their offsets, the robust standard deviation, and the standard error of the median;
        - ``tilt_deg``: angle (x, y) of the median offset with the normal, where ``apart_um`` is given.

    Raises
    ------
    SizeError
        If a pixel size or the distance of the layers is not a positive number.
    MarkError
        If the map of the wanted side is missing, or the maps have not one shape.

    Notes
    -----
    An offset that all holes share is a laser that was not perpendicular, or a flattening that shears the layers: both
    move the marks against an image of one side by as much. Rims of one hole lie within half its diameter; where it
    leans more, its layers are no longer round.

    Examples
    --------
    >>> y, x = np.mgrid[:100, :120] * 5.0
    >>> upper, lower = (np.hypot(x - at, y - 250) > 80 for at in (300, 306))
    >>> find_holes_in_sheet(upper, None, lower, pixel_um=5.0).offset_x.values.round(0)
    array([6.])
    """
    if side not in ("top", "bottom"):
        raise MarkError(f"The side is {side!r}; an image shows the 'top' or the 'bottom'.")
    maps = {k: np.asarray(v) for k, v in zip(LAYERS, (top, centre, bottom), strict=True) if v is not None}
    if side not in maps:
        raise MarkError(
            f"There is no map of the material at the {side} of the sheet, where the image's holes are looked for. Make "
            "the maps anew from the volume: old ones have that of the top only."
        )
    shapes = {k: v.shape for k, v in maps.items()}
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{k} {shape}" for k, shape in shapes.items())
        raise MarkError(f"The maps of one sheet have different shapes: {listed}. Give maps of one grid.")
    if apart_um is not None and not 0.0 < apart_um < np.inf:
        raise SizeError(f"The layers are {apart_um:g} um apart; a positive number is needed.")
    other: Side = "bottom" if side == "top" else "top"
    wider = diameter_um[0] / OTHER_DIAMETER, diameter_um[1] * OTHER_DIAMETER
    seen = {
        k: find_holes(v, pixel_um=pixel_um, diameter_um=diameter_um if k == side else wider, polarity="dark")
        for k, v in maps.items()
    }
    at, diameters = _xy(seen[side]), seen[side]["diameter"].values
    rows = {k: np.arange(len(at)) if k == side else np.full(len(at), -1) for k in LAYERS}
    for name in maps.keys() - {side}:
        rows[name] = _partners(at, _xy(seen[name]), REACH * diameters)
    state = np.where(rows[other] >= 0, THROUGH, UNCLEAR).astype(np.uint8)
    if other in maps:
        partner = rows[other][state == THROUGH]
        # Where the other side should show a hole: as far from this one as with the others.
        moved = np.median(_xy(seen[other])[partner] - at[state == THROUGH], axis=0) if len(partner) else np.zeros(2)
        size = np.atleast_1d(np.asarray(pixel_um, dtype=np.float64))
        for k in np.flatnonzero(state == UNCLEAR).tolist():
            inside = _middle(maps[other], (size[0], size[-1]), at[k] + moved, MIDDLE * float(diameters[k]))
            state[k] = CLOSED if inside.size and np.median(inside) > MATERIAL else UNCLEAR
    seen = {k: _moved(v, origin_um) for k, v in seen.items()}
    data = _at_layers(seen, rows)
    offsets = _offsets(_xy(data, "_bottom") - _xy(data, "_top"))
    out = _dataset(seen[side], data, offsets, state)
    out.attrs |= {
        "side": side,
        "layers": list(maps),
        **{word: int(np.count_nonzero(state == k)) for k, word in OTHER_SIDE.items()},
        "other_side_only": seen[other].sizes["mark"] - int(np.count_nonzero(rows[other] >= 0)) if other in seen else 0,
        "offset_count": offsets.count,
        "offset_um": offsets.median.tolist(),
        "offset_spread_um": offsets.spread.tolist(),
        "offset_error_um": offsets.error.tolist(),
    }
    if apart_um is not None:
        out.attrs["tilt_deg"] = np.rad2deg(np.arctan2(offsets.median, apart_um)).tolist()
    return out


def _moved(holes: xr.Dataset, origin_um: tuple[float, float]) -> xr.Dataset:
    at = {"x": origin_um[1], "y": origin_um[0]}
    return holes.assign({k: holes[k].copy(data=holes[k].values + first) for k, first in at.items()})


def _xy(holes: xr.Dataset, suffix: str = "") -> Floats:
    return np.stack([holes[f"x{suffix}"].values, holes[f"y{suffix}"].values], axis=1).astype(np.float64)


def _partners(holes: Floats, found: Floats, reach: Floats) -> Ints:
    """Row in ``found`` of each hole, -1 where it has none: either is the other's nearest, and within reach."""
    rows = np.full(len(holes), -1)
    if not len(holes) or not len(found):
        return rows
    nearest = np.asarray(KDTree(found).query(holes)[1], dtype=np.intp)
    back = np.asarray(KDTree(holes).query(found)[1], dtype=np.intp)
    away = np.hypot(*(found[nearest] - holes).T)
    agreed = (back[nearest] == np.arange(len(holes))) & (away <= reach)
    rows[agreed] = nearest[agreed]
    return rows


def _middle(share: NDArray[np.generic], pixel: tuple[float, float], at: Floats, radius: float) -> Floats:
    """Values of a map within ``radius`` of a place (x, y), without those that are missing."""
    sizes = zip(share.shape, pixel, at[::-1], strict=True)
    down, along = (np.arange(n) * step - place for n, step, place in sizes)
    rows, cols = (np.flatnonzero(np.abs(d) <= radius) for d in (down, along))
    away = np.hypot(down[rows][:, None], along[cols][None])
    values = share[np.ix_(rows, cols)].astype(np.float64)[away <= radius]
    return values[np.isfinite(values)]


def _at_layers(seen: dict[str, xr.Dataset], rows: dict[str, Ints]) -> xr.Dataset:
    """Each layer's values of the holes, NaN where they are not seen."""
    data: dict[str, tuple[str, Floats, dict[str, str]]] = {}
    for layer in LAYERS:
        known = rows[layer] >= 0
        for name, unit, text in OF_A_LAYER:
            values = np.full(known.shape, np.nan)
            if known.any():
                values[known] = seen[layer][name].values[rows[layer][known]]
            data[f"{name}_{layer}"] = ("mark", values, {"units": unit, "long_name": f"{text}, {PLACES[layer]}"})
    return xr.Dataset(data)


def _offsets(each: Floats) -> _Offsets:
    known = each[np.isfinite(each).all(axis=1)]
    nothing = np.full(2, np.nan)
    median = np.median(known, axis=0) if len(known) else nothing
    spread = MAD_TO_SD * np.median(np.abs(known - median), axis=0) if len(known) > 1 else nothing
    error = MEDIAN_TO_MEAN * spread / np.sqrt(max(len(known), 1))
    return _Offsets(each=each, count=len(known), median=median, spread=spread, error=error)


def _dataset(holes: xr.Dataset, data: xr.Dataset, offsets: _Offsets, state: NDArray[np.uint8]) -> xr.Dataset:
    flags = {"flag_values": list(OTHER_SIDE), "flag_meanings": " ".join(OTHER_SIDE.values())}
    texts = ("Offset from the top to the bottom along the columns", "Offset from the top to the bottom down the rows")
    added = {
        f"offset_{axis}": ("mark", offsets.each[:, k], {"units": "um", "long_name": texts[k]})
        for k, axis in enumerate("xy")
    }
    out = holes.merge(data, combine_attrs="override").assign(added)
    return out.assign(other_side=("mark", state, {"long_name": "What the other side shows of the hole"} | flags))
