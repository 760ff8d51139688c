"""Equal grey levels in all sections: gain and offset from the resin's grey and that of the sheet's core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats
from planish.sections.band import SectionSeries

_CORE = 0.7  # of half the thickness: away from the faces and their coatings
_OFF_UM = 30.0  # beyond the faces
_MOST = 50_000  # pixels for a level: the noise of a pixel is divided by 200
_LEAST = 50  # pixels for a level
_ROUNDS = 6
_WIDTH = 2.0  # standard deviations on both sides that the mean of the crowd takes in
_LARGEST_DRIFT = 0.3  # a gain farther from 1 is no drift of colour but another thing in the picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """Corrections that make the grey levels of all sections equal: gain x grey + offset.

    Attributes
    ----------
    gain, offset : ndarray (sections,)
        1 and 0 where the levels could not be measured.
    measured : ndarray of bool (sections,)
    """

    gain: Floats
    offset: Floats
    measured: Bools


def normalise_sections(series: SectionSeries) -> Gains:
    """Find gain and offset of each section from two anchors; one section at a time is looked at.

    Returns
    -------
    Gains
        They bring both anchors to their medians over all sections.

    Raises
    ------
    VolumeError
        If no sheet is found.

    Notes
    -----
    The anchors are the mode of the background and the middle of the sheet's core; both are the mean of the crowd around
    the median, iterated, which is surer than the median. What limits the gain is the sheet: its fibres go up and down
    together by their standard deviation over the root of the number of flocs in the core, some 0.3 % of the contrast in
    8 mm, and this, like a slow change of the sheet's own material, is taken for a drift of colour.
    """
    band, pixel = series.band, series.pixel_um[0]
    n, rows, cols = series.stack.shape
    near, far = _CORE * band.half_um / pixel, (band.half_um + _OFF_UM) / pixel
    inside, outside = 2 * near * cols, max(1.0, rows - 2 * far) * cols
    step = max(1, round(inside / _MOST)), max(1, round(outside / _MOST))

    def levels(i: int) -> tuple[float, float]:
        height = band.heights(i, cols) + np.float32(band.jump[i])
        inner, outer = core_and_background(series.stack[i], height, near, far, step)
        return _crowd_mean(outer), _crowd_mean(inner)

    background, material = np.array(map_threads(levels, range(n)), np.float64).T
    contrast = material - background
    typical = float(np.nanmedian(contrast)) if np.isfinite(contrast).any() else np.nan
    measured = np.abs(contrast - typical) <= _LARGEST_DRIFT * abs(typical)
    gain = np.where(measured, typical / np.where(measured, contrast, 1.0), 1.0)
    level = float(np.median(background[measured])) if measured.any() else 0.0
    offset = np.where(measured, level - gain * np.where(measured, background, 0.0), 0.0)
    return Gains(gain=gain, offset=offset, measured=measured)


def core_and_background(
    section: NDArray[Any], height: NDArray[np.float32], near: float, far: float, step: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Grey levels of the sheet's core and of the background.

    height[c] is the row of the sheet: pixels within ``near`` of it are the core, of which every step[0]-th is taken;
    those beyond ``far`` are the background, of which every step[1]-th is.
    """
    row, middle = np.arange(section.shape[0])[:, None], height.astype(np.float64)
    core = section[(row >= middle - near) & (row <= middle + near)][:: step[0]].astype(np.float32)
    off = section[(row <= middle - far) | (row >= middle + far)][:: step[1]].astype(np.float32)
    return core[~np.isnan(core)][: 2 * _MOST], off[~np.isnan(off)][: 2 * _MOST]


def _crowd_mean(greys: NDArray[np.float32]) -> float:
    """Value around which most of the data lie, by iteration from the median; NaN for a few pixels."""
    if greys.size < _LEAST:
        return np.nan
    precise = greys.astype(np.float64)
    level = float(np.median(precise))
    spread = 1.4826 * float(np.median(np.abs(precise - level)))
    if spread == 0.0:
        return level
    for _ in range(_ROUNDS):
        level = float(precise[np.abs(precise - level) <= _WIDTH * spread].mean())
    return level
