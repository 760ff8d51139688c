"""Property and image side by side, and the image with the thin regions outlined: Fig. 6 of the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.report.draw import BESIDE, HALF, Array, Picture, field, half_page, limits, pitch
from planish.report.ground import draw_ground, image_ground, outline
from planish.report.maps import PROPERTY
from planish.report.text import count, in_figure, in_words, length, percent, plain, unit

_OUTLINE = "#ff5238"
_HARDLY = 1e-3  # of the valid pixels: with fewer below the limit, the outlines would show next to nothing
_THINNEST = 5.0  # per cent
_SMALLEST = 12  # pixels of a region that is outlined


def draw_outlines(linked: xr.Dataset, *, name: str, thin_um: float) -> list[Picture]:
    """Draw property and image side by side, and the image with the thin regions outlined (Hirn et al. 2009, Fig. 6).

    Parameters
    ----------
    linked : Dataset, dims (y, x)
        ``image``, ``valid`` and the property.
    name : str
        The property: the coating of the top side, or the thickness of a sheet without coating.
    thin_um : float
        What counts as thin.
    """
    y, x = linked["y"].values, linked["x"].values
    ground = image_ground(linked)
    valid = linked["valid"].values.astype(bool)
    values = np.where(valid, linked[name].values.astype(np.float64), np.nan)
    n = int(np.isfinite(values).sum())
    title = str(linked[name].attrs.get("long_name", name))
    units = in_figure(unit(str(linked[name].attrs.get("units", "um"))))
    pixel = plain(round(pitch(x), 4))
    tail = f"n = {count(n)} pixels of {pixel}; mask: measured, and away from holes and their rims."

    label = f"{in_figure(title)} / {units}" if units else in_figure(title)
    shown = field(values, y, x, width=HALF - BESIDE)
    canvas, _ = half_page(shown, norm=limits(values), cmap=PROPERTY, label=label)
    first = canvas.picture(
        kind="jpeg",
        title=f"(a) {title}, on the image's pixels",
        caption=f"Unit {unit(str(linked[name].attrs.get('units', 'um')))}. {tail}",
    )

    shown = field(linked["image"].values, y, x, width=HALF - BESIDE)
    canvas, _ = half_page(shown, norm=ground.norm, cmap="gray", label="")
    seen = int(np.isfinite(linked["image"].values).sum())
    second = canvas.picture(
        kind="jpeg",
        title="(b) The image, same region",
        caption=f"Grey values, the window set by the valid pixels; n = {count(seen)} pixels of {pixel}, no mask.",
    )

    thin = float(np.count_nonzero(values < thin_um)) / max(n, 1)
    limit, note = thin_um, f"Outlined: {in_words(title)} below {plain(thin_um)}, {percent(thin)} of the valid pixels."
    canvas, axes, *_ = draw_ground(ground)
    if thin < _HARDLY:
        limit = float(np.nanpercentile(values, _THINNEST)) if n else thin_um
        few = "No valid pixel is" if thin == 0 else f"Only {percent(thin)} of the valid pixels are"
        note = (
            f"{few} below {plain(thin_um)}; there is next to nothing to outline there. Outlined instead: the thinnest "
            f"{_THINNEST:g} %, {in_words(title)} below {length(limit)}."
        )
        if thin > 0:
            outline(axes, _regions(values < thin_um, 1), y, x, colour="#39c5ff", width=1.2)
            note = f"{note} In blue, what is below {plain(thin_um)}."
    drawn = _regions(values < limit, _SMALLEST)
    outline(axes, drawn, y, x, colour=_OUTLINE, width=1.3)
    dark = _darkness(linked["image"].values.astype(np.float64), drawn, valid)
    third = canvas.picture(
        kind="jpeg",
        title="(c) Thin regions on the image",
        caption=f"{note} Regions under {_SMALLEST} pixels are not drawn. {dark}{tail}",
    )
    return [first, second, third]


def _regions(thin: NDArray[np.bool_], smallest: int) -> NDArray[np.bool_]:
    """Keep connected regions of at least so many pixels."""
    labels, found = _label(thin)
    if found == 0:
        return thin
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(sizes[labels] >= smallest, dtype=bool)


def _label(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    result: Any = ndimage.label(mask, structure=np.ones((3, 3), dtype=int))
    return np.asarray(result[0], dtype=np.int32), int(result[1])


def _darkness(image: Array, drawn: NDArray[np.bool_], valid: NDArray[np.bool_]) -> str:
    """Say how the grey value inside the outlines compares with the rest."""
    inside, outside = image[drawn & valid], image[valid & ~drawn]
    if inside.size == 0 or outside.size == 0 or float(np.std(image[valid])) == 0:
        return ""
    shift = float(inside.mean() - outside.mean()) / float(np.std(image[valid]))
    word = "darker" if shift < 0 else "brighter"
    return f"Inside, the image is on average {abs(shift):.2f} standard deviations {word} than elsewhere. "
