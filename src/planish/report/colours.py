"""Colours of maps.

Five perceptually ordered scales, limits from percentiles, and maps as small PNG or JPEG images.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.axial import is_axial

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
PROPERTY = "viridis"
GEOMETRY = "cividis"
SIGNED = "RdBu_r"
CYCLIC = "twilight"
GREYS = "grey"
ERROR = "magma"
MISSING = "#d4d6d8"
_ANCHORS = {
    PROPERTY: (
        "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26818e 21908c 1f9f88 28ae80 3ebc74 5dc963"
        " 82d34c abdc32 d5e21a fde725"
    ),
    GEOMETRY: (
        "00224e 002e6a 1a386f 32436d 434e6c 52596d 61656f 6f7073 7c7b78 8b8778 9b9376 aba072 bbad6c"
        " ccba64 ddc958 efd748 fee838"
    ),
    SIGNED: (
        "053061 175290 2a71b2 3f8dc0 6bacd0 9ac9e0 c1ddec dfecf3 f7f7f6 fbe6d9 fbceb6 f5ac8b e58268"
        " d25749 bb2a34 960f26 67001f"
    ),
    CYCLIC: (
        "e2d9e2 c4ced4 95b5c7 7297c1 6276ba 5e51ad 592a8f 45135c 2f1436 4a1342 741e4f 983550 b25652"
        " c27c63 cca389 d8c7be e2d9e2"
    ),
    ERROR: (
        "000004 0a0822 1d1146 36106a 50127c 691c81 822681 9c2e7f b63779 cf4170 e65163 f5695c fb8761"
        " fea571 fec387 fde0a2 fcfdbf"
    ),
    GREYS: "000000 ffffff",
}
_SHADES = 255  # and one more for missing values


@dataclass(frozen=True, slots=True)
class Scale:
    """Colour limits and the name of the colours between them.

    Values beyond a limit have its colour.
    """

    low: float
    high: float
    colours: str = PROPERTY

    def fractions(self, values: ArrayLike) -> Array:
        """Return the place of each value between the limits: 0 is the lower one, 1 the upper."""
        return (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)

    def shades(self, values: ArrayLike) -> NDArray[np.uint8]:
        """Return the index of each value's colour; the last one is for missing values."""
        fractions = self.fractions(values)
        shade_indices = np.rint(np.clip(fractions, 0.0, 1.0) * (_SHADES - 1))
        return np.where(np.isfinite(fractions), shade_indices, _SHADES).astype(np.uint8)


def limits(
    values: ArrayLike,
    colours: str = PROPERTY,
    *,
    percent: float = 1.0,
    symmetric: bool = False,
    low: float | None = None,
) -> Scale:
    """Return a colour scale with limits from percentiles, so single pixels do not flatten the rest.

    Parameters
    ----------
    values : array
        NaN is missing.
    colours : str
        Name of the colours.
    percent : float
        Of the values, which lie beyond either limit.
    symmetric : bool
        Zero is in the middle; ``percent`` of the absolute values lie beyond.
    low : float, optional
        The lower limit, in place of that of the percentile.

    Returns
    -------
    Scale
    """
    data = np.asarray(values, dtype=np.float64).ravel()
    data = data[np.isfinite(data)]
    data = data[:: max(1, data.size // 2_000_000)]  # as many values do for a percentile
    if data.size == 0:
        return Scale(0.0, 1.0, colours)
    if symmetric:
        high = float(np.percentile(np.abs(data), 100 - percent)) or 1.0  # where all are 0
        return Scale(-high, high, colours)
    bottom, top = np.percentile(data, [percent, 100 - percent]).tolist()
    if top - bottom <= 1e-9 * max(abs(bottom), abs(top), 1e-300):  # all values are the same
        bottom -= 0.5
        top += 0.5
    if low is None:
        return Scale(bottom, top, colours)
    return Scale(low, max(top, low + 1e-12), colours)


def colours_of(data: xr.DataArray, limit_values: Array) -> Scale:
    """Return the colours of a map; of an angle of fibres always the same, of others by values."""
    # An angle of fibres begins again at 180 degrees, and so must its colours.
    if is_axial(data):
        return Scale(-90.0, 90.0, CYCLIC)
    if data.name == "image":
        return limits(limit_values, GREYS)
    return limits(limit_values)


def partner_of(name: str, map_names: Sequence[str]) -> str | None:
    """Return the map of the other side of the sheet: the two share their colours."""
    for side, opposite_side in (("_top", "_bottom"), ("_bottom", "_top")):
        partner_name = name.removesuffix(side) + opposite_side
        if name.endswith(side) and partner_name in map_names:
            return partner_name
    return None


def image_uri(values: ArrayLike, scale: Scale, *, missing: str = MISSING) -> str:
    """Return a map as an image in a ``data:`` address: PNG, or JPEG where it has many pixels.

    Parameters
    ----------
    values : array (rows, cols)
    scale : Scale
    missing : str
        Colour of what is missing.

    Returns
    -------
    str
    """
    from PIL import Image

    # The last colour is that of missing values, which Scale.shades gives the last index.
    palette = np.vstack([colours_in_steps(scale.colours), _rgb(missing[1:])])
    shades = scale.shades(values)
    # Of many pixels, a JPEG is a fraction of a PNG.
    kind = "png"
    data = io.BytesIO()
    if shades.size <= 250_000:
        image = Image.fromarray(shades)
        image.putpalette(palette.tobytes())
        image.save(data, format=kind)
    else:
        kind = "jpeg"
        image = Image.fromarray(palette[shades])
        image.save(data, format=kind, quality=88, subsampling=0)
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    return f"data:image/{kind};base64,{encoded}"


@cache
def colours_in_steps(colours: str) -> NDArray[np.uint8]:
    """Return the colours of all shades: (255, 3)."""
    anchors = _rgb(_ANCHORS[colours])
    fractions = np.linspace(0, 1, _SHADES)
    anchor_fractions = np.linspace(0, 1, len(anchors))
    channels = [np.interp(fractions, anchor_fractions, channel) for channel in anchors.T]
    return np.rint(channels).T.astype(np.uint8)


def _rgb(codes: str) -> NDArray[np.uint8]:
    """Return colours (n, 3) of their hexadecimal codes."""
    return np.frombuffer(bytes.fromhex(codes), dtype=np.uint8).reshape(-1, 3)
