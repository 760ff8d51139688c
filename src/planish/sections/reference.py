"""Places of sections against something that lies still: the edge of the block, a line of the fixture.

Neighbours show quick errors only; a slow drift looks like a bend of the sheet. What is fixed to the stage shows the
drift itself. An edge or line along the rows of the photographs gives the place along the columns and the rotation, one
along the columns the other place.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from planish.core.errors import VolumeError
from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats
from planish.sections.band import Stack

Strip = tuple[int, int]

_PARTS = 12  # pieces along the line: their spread says how sure a place is, their course gives the rotation
_BLURS_UM = (12.0, 4.0, 2.0)  # Gaussian sigma, from coarse to fine: the first reaches as far as sections are off
_STEPS = 4
_ALIKE = 0.7  # correlation with the mean profile below which a piece does not show the line
_LEAST = 4  # pixels across a strip


def fixed_places(
    stack: Stack,
    pixel_um: tuple[float, float],
    *,
    rows: Strip | None = None,
    cols: Strip | None = None,
) -> Floats:
    """Find the place of every section against lines that lie still.

    Parameters
    ----------
    stack : ndarray (sections, rows, cols)
    pixel_um : (row, col)
    rows : (int, int), optional
        First and last row of a strip that shows a line or edge along the rows, and nothing else that changes.
    cols : (int, int), optional
        The same for a line or edge along the columns.

    Returns
    -------
    ndarray (sections, 3)
        Shift along (row, col) in um and rotation in rad, about their means over the sections, signs as in
        :class:`planish.sections.Alignment`; NaN where no strip was given for it or a section does not show the line.

    Raises
    ------
    VolumeError
        If a strip lies outside the photographs, is too narrow, or shows no line.
    """
    n = stack.shape[0]
    places = np.full((n, 3), np.nan)
    for axis, strip in ((0, rows), (1, cols)):
        if strip is None:
            continue
        size = stack.shape[1 + axis]
        low, high = strip
        if not (low >= 0 and low + _LEAST <= high < size):
            raise VolumeError(
                f"The strip {low} to {high} of a fixed line does not lie in the photographs, which have {size} "
                f"{'rows' if axis == 0 else 'columns'}, or is narrower than {_LEAST} pixels. Give first and last one."
            )
        place, turn = _line_places(stack, axis, strip, pixel_um)
        places[:, axis] = place
        if np.isnan(places[:, 2]).all():
            # Along a column the place is smaller by rotation y, along a row larger by rotation x.
            places[:, 2] = turn if axis == 0 else -turn
    mean = np.array([np.nanmean(c) if np.isfinite(c).any() else 0.0 for c in places.T])
    return places - mean


def _line_places(stack: Stack, axis: int, strip: Strip, pixel_um: tuple[float, float]) -> tuple[Floats, Floats]:
    """Place in um and slope of the line of each section, against their mean."""
    n, pixel = stack.shape[0], pixel_um[axis]
    length = stack.shape[2 - axis]
    edges = np.linspace(0, length, _PARTS + 1).astype(int)

    def cut(i: int) -> Floats:
        grey = np.asarray(stack[i], dtype=np.float64)
        grey = grey[strip[0] : strip[1] + 1] if axis == 0 else grey[:, strip[0] : strip[1] + 1].T
        return np.add.reduceat(grey, edges[:-1], axis=1).T / np.diff(edges)[:, None]

    profiles = np.stack(map_threads(cut, range(n)))  # (sections, pieces, across)
    off = np.zeros(profiles.shape[:2])
    alike = np.zeros(profiles.shape[:2])
    for blur in _BLURS_UM:
        smooth = gaussian_filter1d(profiles, max(blur / pixel, 0.5), axis=2, mode="nearest")
        for _ in range(_STEPS):
            moved = _shifted(smooth, off)
            template = np.median(moved, axis=0)
            step, alike = _match_template(moved, template)
            off += np.clip(step, -2 * blur / pixel, 2 * blur / pixel)
            off -= np.median(off)
    shows_line = alike > _ALIKE
    if np.count_nonzero(shows_line.sum(axis=1) >= _PARTS // 2) < 0.5 * n:
        direction = "rows" if axis == 0 else "columns"
        raise VolumeError(
            f"The {direction} {strip[0]} to {strip[1]} show no line or edge that lies still in most sections. Look at "
            "a few photographs and give a strip that shows the same straight line throughout."
        )
    along = (0.5 * (edges[1:] + edges[:-1] - 1) - 0.5 * (length - 1)) * pixel_um[1 - axis]
    return _fit_lines(off * pixel, shows_line, along)


def _shifted(profiles: Floats, off: Floats) -> Floats:
    """Profiles read at their places plus ``off``, linearly between pixels."""
    across = profiles.shape[2]
    position = np.clip(np.arange(across) + off[..., None], 0, across - 1)
    low = np.minimum(position.astype(int), across - 2)
    share = position - low
    a, b = (np.take_along_axis(profiles, k, axis=2) for k in (low, low + 1))
    return a * (1 - share) + b * share


def _match_template(moved: Floats, template: Floats) -> tuple[Floats, Floats]:
    """Match profiles with a template: how much further each lies, in pixels, and its correlation with it.

    A profile is gain x template + offset, moved a little: least squares for the three.
    """
    slope = np.gradient(template, axis=1)
    inner = slice(2, -2)
    t, g, f = template[:, inner], slope[:, inner], moved[..., inner]
    t, g, f = (v - v.mean(axis=-1, keepdims=True) for v in (t, g, f))
    tt, tg, gg = (t * t).sum(axis=-1), (t * g).sum(axis=-1), (g * g).sum(axis=-1)
    ft, fg, ff = (f * t).sum(axis=-1), (f * g).sum(axis=-1), (f * f).sum(axis=-1)
    det = np.maximum(tt * gg - tg * tg, 1e-12)
    gain, move = (ft * gg - fg * tg) / det, (fg * tt - ft * tg) / det
    alike = ft / np.sqrt(np.maximum(ff * tt, 1e-12))
    good = gain > 0.2
    return np.where(good, -move / np.where(good, gain, 1.0), 0.0), alike


def _fit_lines(off: Floats, shows_line: Bools, along: Floats) -> tuple[Floats, Floats]:
    """Mean and slope of each section's pieces; the mean course of all sections is the line's own and is taken off."""
    measured = np.where(shows_line, off, np.nan)
    counted = shows_line.sum(axis=0) > 0
    line_course = np.zeros(off.shape[1])
    line_course[counted] = np.nanmedian(measured[:, counted], axis=0)
    place, turn = np.full(off.shape[0], np.nan), np.full(off.shape[0], np.nan)
    for i in range(off.shape[0]):
        pieces = shows_line[i]
        if np.count_nonzero(pieces) < _PARTS // 2:
            continue
        slope, mean = np.polyfit(along[pieces], (off[i] - line_course)[pieces], 1)
        place[i], turn[i] = mean, slope
    return place, turn
