"""Check for greys of an image that are cut off: paper that is as bright, or as dark, as the camera can show."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.checks import CORRELATION, Check

_SHARE = 0.01  # of the pixels at one end of the scale, from which on a correlation suffers
_SPIKE = 3.0  # times the pixels next to that end
_NEXT = 1 / 64  # of the range of greys, counted as next to an end
_LEAST_LEVELS = 8  # fewer are an image of areas, not of greys


def exposure_check(values: NDArray[Any]) -> Check:
    """Judge the greys of an image of the sheet, away from holes.

    Parameters
    ----------
    values : array, any shape and numeric type
        A sample of the image's greys; NaN is left out.

    Returns
    -------
    Check
        ``look`` where more than 1 % of the pixels share the lowest or the highest grey, three times as many as have
        the greys next to it: r then sees these pixels as equal, and is too weak. Images of fewer than eight levels
        pass: they show areas.
    """
    grey = np.asarray(values, dtype=np.float64)
    grey = grey[np.isfinite(grey)]
    ends = {"low": 0.0, "high": 0.0}
    if grey.size and np.unique(grey).size >= _LEAST_LEVELS:
        lowest, highest = float(grey.min()), float(grey.max())
        near = _NEXT * (highest - lowest)
        for end, end_grey in (("low", lowest), ("high", highest)):
            share = float(np.mean(grey == end_grey))
            near_share = float(np.mean((grey != end_grey) & (np.abs(grey - end_grey) < near)))
            ends[end] = share if share > _SPIKE * near_share else 0.0
    worst = max(ends, key=lambda end: ends[end])
    tone = "bright" if worst == "high" else "dark"
    cut = ends[worst] > _SHARE
    return Check.at_most(
        "clipped image", ends[worst], look=_SHARE, units="share", figures=(CORRELATION,),
        sentence=f"{100 * ends[worst]:.2g} % of the image's pixels on the sheet are as {tone} as its scale allows."
        if cut else "The image's grey scale does not end within the sheet's greys.",
        advice="The true grey of these pixels is lost, and r is too weak. Take the image again with another exposure, "
        "or export it with a wider grey window.",
    )  # fmt: skip
