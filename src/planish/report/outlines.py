"""Property and image side by side, and the image with the thin regions outlined: Fig. 6 of the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.report.colours import Array, limits
from planish.report.draw import BESIDE, FULL, HALF, Picture, half_page, pitch, reduced
from planish.report.registration import ARROW, EDGE, draw_ground, image_ground
from planish.report.text import count, in_words, label_of, length, percent, plain, title_of, unit_of

_HARDLY = 1e-3  # of the valid pixels: with fewer below the limit, the outlines would show next to nothing
_THINNEST = 5.0  # per cent
_SMALLEST = 12  # pixels of a region that is outlined


def draw_outlines(linked: xr.Dataset, *, name: str, thin_um: float) -> list[Picture]:
    """Draw property and image side by side, and the image with thin regions outlined (Hirn et al. 2009, Fig. 6)."""
    y, x = linked["y"].values, linked["x"].values
    valid = linked["valid"].values.astype(bool)
    ground = image_ground(linked["image"], valid=valid, edge=None, edge_of="")
    values = np.where(valid, linked[name].values.astype(np.float64), np.nan)
    n = int(np.isfinite(values).sum())
    title, pixel = title_of(linked[name]), plain(round(pitch(x), 4))
    tail = f"n = {count(n)} pixels of {pixel}; mask: measured, without holes and rims."

    canvas, _ = half_page(
        reduced(values, y, x, width=HALF - BESIDE), scale=limits(values), label=label_of(linked[name])
    )  # fmt: skip
    first = canvas.picture(title=f"(a) {title}, on the image's pixels", caption=f"Unit {unit_of(linked[name])}. {tail}")

    canvas, _ = half_page(reduced(ground.values, y, x, width=HALF - BESIDE), scale=ground.scale, label="")
    second = canvas.picture(
        title="(b) The image, same region",
        caption=(
            f"Grey values between limits set by the valid pixels; n = {count(int(np.isfinite(ground.values).sum()))} "
            f"pixels of {pixel}, no mask."
        ),
    )

    thin = float(np.count_nonzero(values < thin_um)) / max(n, 1)
    limit, note = thin_um, f"Outlined: {in_words(title)} below {plain(thin_um)}, {percent(thin)} of the valid pixels."
    canvas, axes, _ = draw_ground(ground, width=FULL)
    if thin < _HARDLY:
        limit = float(np.nanpercentile(values, _THINNEST)) if n else thin_um
        few = "No valid pixel is" if thin == 0 else f"Only {percent(thin)} of the valid pixels are"
        note = (
            f"{few} below {plain(thin_um)}; too few to outline. Outlined instead: the thinnest "
            f"{_THINNEST:g} %, {in_words(title)} below {length(limit)}."
        )
        if thin > 0:
            axes.outline(_regions(values < thin_um, 1), y, x, colour=EDGE, width=1.6)
            note = f"{note} In blue, what is below {plain(thin_um)}."
    drawn = _regions(values < limit, _SMALLEST)
    axes.outline(drawn, y, x, colour=ARROW, width=1.7)
    dark = _darkness(ground.values, drawn, valid)
    third = canvas.picture(
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
    from scipy import ndimage

    result: Any = ndimage.label(mask, structure=np.ones((3, 3), dtype=int))
    return np.asarray(result[0], dtype=np.int32), int(result[1])


def _darkness(image: Array, drawn: NDArray[np.bool_], valid: NDArray[np.bool_]) -> str:
    """Compare the grey value inside the outlines with the rest."""
    inside, outside = image[drawn & valid], image[valid & ~drawn]
    if inside.size == 0 or outside.size == 0 or float(np.std(image[valid])) == 0:
        return ""
    shift = float(inside.mean() - outside.mean()) / float(np.std(image[valid]))
    word = "darker" if shift < 0 else "brighter"
    return f"Inside, the image is on average {abs(shift):.2f} standard deviations {word} than elsewhere. "
