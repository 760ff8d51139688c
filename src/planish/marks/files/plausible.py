"""Marks that cannot be right: not unique, without a position, or not in their layer.

Where the extent of a layer is known, pixels or millimetres that were taken for um, and x and y that are exchanged, are
recognised by it.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.typing import Bools, Floats
from planish.marks.files.content import refuse
from planish.marks.files.model import about_layer, labels_of, layer_names, points_of, used_of

FARTHEST_UM = 1e9  # positions beyond are errors of unit or of writing; within, no arithmetic overflows
SLACK = 0.05  # marks may lie outside their layer by this share of it: borders are cut in many ways
LEAST_MARKS = 3
_LEAST_FACTOR = 1.5  # pixels of nearly 1 um cannot be distinguished from um
_MM_SPAN = 0.01


def check_marks(marks: xr.Dataset, name: str) -> None:
    """Refuse marks that are not unique or lie at no finite position."""
    labels, used = labels_of(marks), used_of(marks)
    if not labels:
        raise MarkError(f"{name} holds no mark. Set marks in both layers and save them again.")
    faults = [f"the label {label!r} is there {count} times" for label, count in Counter(labels).items() if count > 1]
    for layer in layer_names(marks):
        points = points_of(marks, layer)
        missing = np.isnan(points)
        wrong = (np.abs(points) > FARTHEST_UM).any(axis=1) | (missing.any(axis=1) & ~missing.all(axis=1))
        faults += [f"{labels[k]} has no position within a kilometre in {layer}" for k in np.flatnonzero(wrong)]
        first: dict[tuple[float, ...], int] = {}
        for k in np.flatnonzero(used & np.isfinite(points).all(axis=1)).tolist():
            other = first.setdefault(tuple(points[k].tolist()), k)
            if other != k:
                faults.append(f"{labels[other]} and {labels[k]} have the same position in {layer}")
    refuse(name, faults, "Give each mark a label and a place of its own.")


def check_plausible(marks: xr.Dataset, name: str) -> None:
    """Refuse marks that cannot be um in their layer, where its pixel size and its size in pixels are known."""
    stated = marks.attrs.get("read_from", {}).get("stated", True)
    for layer in layer_names(marks):
        about = about_layer(marks, layer)
        points = points_of(marks, layer)[:, :2]
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < LEAST_MARKS or not {"pixel_um", "size_px"} <= about.keys():
            continue
        misfit = _misfit(points, about, stated=stated)
        if misfit:
            raise MarkError(f"{name}: the marks in {layer} span {misfit}")


def _misfit(points: Floats, about: dict[str, Any], *, stated: bool) -> str:
    """Describe why marks cannot be um in their layer; empty where they can."""
    facts = {"origin_um": {"x": 0.0, "y": 0.0}} | about
    pixel, count, origin = (
        np.array([facts[key][axis] for axis in "xy"], dtype=np.float64) for key in ("pixel_um", "size_px", "origin_um")
    )
    size = pixel * count
    placed = points - origin
    spans = f"{_size(np.ptp(points, axis=0))}, the layer {_size(size)}"
    is_inside = _inside(placed, size).all()
    are_halves = bool(np.all(points * 2 == np.round(points * 2)))
    # Places clicked on pixels and then turned into um are multiples of the pixel.
    are_pixels = bool(np.all(np.abs(placed / pixel - np.round(placed / pixel)) < 1e-6))
    if are_halves and not are_pixels and pixel.max() > _LEAST_FACTOR and _inside(points, count).all():
        return (
            f"{spans}, and all positions are whole or half numbers: they look like pixels. "
            f"{_remedy('pixel', stated)} If they are um, write them with decimals."
        )
    if is_inside and _inside(points * 1000, size).all() and np.ptp(points, axis=0).max() < _MM_SPAN * size.max():
        return f"{spans}: they look like mm. {_remedy('mm', stated)}"
    if is_inside:
        return ""
    spans += f" from ({origin[0]:g}, {origin[1]:g}) um"
    if _inside(points, count).all():
        return f"{spans}: they look like pixels. {_remedy('pixel', stated)}"
    if _inside(placed[:, ::-1], size).all():
        return f"{spans}: they would fit with x and y exchanged. Exchange the columns: x runs to the right, y down"
    far = int(np.count_nonzero(~_inside(placed, size)))
    return (
        f"{spans}: {far} of {len(points)} lie outside it. Check the unit, the pixel size, and that they belong to this "
        "image"
    )


def _remedy(unit: str, stated: bool) -> str:
    """Advise what to do with positions in another unit than um."""
    if stated:
        by = "the pixel size" if unit == "pixel" else "1000"
        return f"The file says um: multiply them by {by}."
    sizes = " with --moving-pixel-um and --fixed-pixel-um" if unit == "pixel" else ""
    return f"Convert them by planish marks convert --unit {unit}{sizes}."


def _inside(points: Floats, size: Floats) -> Bools:
    return np.all((points >= -SLACK * size) & (points <= (1 + SLACK) * size), axis=1)


def _size(um: Floats) -> str:
    """Write width and height: ``1.9 x 1.2 mm``."""
    if max(um) < 100:
        return f"{um[0]:.3g} x {um[1]:.3g} um"
    return f"{um[0] / 1000:.3g} x {um[1] / 1000:.3g} mm"
