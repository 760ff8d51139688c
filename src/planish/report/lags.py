"""Where single parts of two maps lie against each other, by their own patterns and without the marks."""

from __future__ import annotations

from typing import Any

import numpy as np

from planish.report.draw import Array, Picture, halo, round_below, scale_bar
from planish.report.draw import pitch as step_of
from planish.report.ground import Ground, draw_ground, keep_view
from planish.report.registration import ARROW, plain_factor
from planish.report.text import count, length, plain

_REACH = 0.11  # of the picture's width: the longest arrow
_SILENT = "#7d8790"


def draw_lags(told: dict[str, Any] | None, ground: Ground, *, first: str, second: str, width: float) -> Picture | None:
    """Draw the lags of the tiles that have a distinct one; None where there are no such tiles.

    Parameters
    ----------
    told : dict or None
        Lag of map b against map a as in the results: ``tiles`` with ``x``, ``y``, ``lag_um``, ``distinct``;
        ``pixel_um``, ``silence``.
    ground : Ground
        Map b, or what else is on its grid.
    first, second : str
        What maps a and b show, in words.
    width : float
        Inches.
    """
    at, lag, silent = lag_places(told or {}, ground)
    if not len(at) or told is None:
        return None
    longest = float(np.hypot(*lag.T).max())
    canvas, axes, shown, box = draw_ground(ground, width=width)
    magnified = round_below(_REACH * shown.width / longest) if longest > 1e-9 else 1.0
    axes.plot(*silent.T, ls="", marker="o", ms=3.2, mew=0, color=_SILENT, path_effects=halo(1.4))
    axes.plot(*at.T, ls="", marker="o", ms=3.0, mew=0, color=ARROW, path_effects=halo(1.4))
    axes.quiver(
        *at.T, *(magnified * lag.T), angles="xy", scale_units="xy", scale=1.0, color=ARROW, width=0.005, headwidth=4,
        headlength=4.5, headaxislength=4, path_effects=halo(1.8), zorder=5,
    )  # fmt: skip
    keep_view(axes, shown)
    if longest > 1e-9:
        scale_bar(
            canvas, box[0] + 0.45 * box[1], box[2] + 0.06, inches=box[1], um=shown.width / magnified, most=0.16,
            colour=ARROW, label="{} of lag",
        )  # fmt: skip
    doubt = " The check as a whole gives no answer: read the arrows with caution." if told.get("silence") else ""
    side = f" of {plain(told['tile_um'])}" if told.get("tile_um") else ""
    return canvas.picture(
        kind="jpeg",
        title="What the maps say of their place, part by part",
        caption=(
            f"Arrows go from where the registration puts a piece of {first} to where {second} shows it, drawn "
            f"{plain_factor(magnified)} times as long as they are; the longest is {length(longest, 2)}. Arrows that "
            "all point one way are a shift, arrows that turn or diverge a rotation or a stretch, arrows in disorder "
            f"are chance. n = {count(len(at))} of {count(len(at) + len(silent))} overlapping tiles{side} with a lag of "
            f"their own, grey dots the others.{doubt} {ground.told}"
        ),
    )


def lag_places(told: dict[str, Any], ground: Ground) -> tuple[Array, Array, Array]:
    """Return where tiles with a lag of their own lie on a ground, their lags, and where the others lie.

    Parameters
    ----------
    told : dict
        ``tiles`` and ``pixel_um`` of the results.
    ground : Ground

    Returns
    -------
    ndarray, shape (n, 2); ndarray, shape (n, 2); ndarray, shape (m, 2)
        ``(x, y)`` in um.

    Notes
    -----
    Tiles count from the middle of the first pixel that was compared, which may be the mean of several.
    """
    tiles: list[dict[str, Any]] = told.get("tiles") or []
    if not tiles:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2))
    y0, x0 = (
        float(c[0]) + (float(p) - step_of(c)) / 2 for c, p in zip((ground.y, ground.x), told["pixel_um"], strict=True)
    )
    at = np.array([(tile["x"] + x0, tile["y"] + y0) for tile in tiles])
    speaks = np.array([bool(tile["distinct"]) and tile["lag_um"] is not None for tile in tiles])
    lags = [tile["lag_um"] for tile, use in zip(tiles, speaks, strict=True) if use]
    return at[speaks], np.array(lags, dtype=np.float64).reshape(-1, 2), at[~speaks]
