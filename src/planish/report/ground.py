"""What marks, arrows and outlines are drawn on: the image, a map in grey, or nothing but a place for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from planish.report.draw import FULL, Array, Canvas, Field, field, fit_box, limits, pitch, scale_bar, show
from planish.report.text import count, in_words, plain

_BLANK = 64  # pixels across a ground that shows nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """A picture to draw on.

    Attributes
    ----------
    values : ndarray, shape (rows, cols)
        Shown in grey; NaN is missing.
    y, x : ndarray, in um
        Coordinates of the pixel centres.
    norm : Normalize
        The grey window.
    edge : ndarray of bool, shape (rows, cols), or None
        Where the other map lies; its border is drawn.
    edge_of : str
        What lies there, in words.
    name : str
        What it is, in words: "the image".
    told : str
        What a caption says of it: what is shown, n, mask.
    """

    values: Array
    y: Array
    x: Array
    norm: Normalize
    edge: NDArray[np.bool_] | None
    edge_of: str
    name: str
    told: str


def image_ground(linked: xr.Dataset) -> Ground:
    """Return the image of a link as ground, with the edge of the scanned sheet.

    Parameters
    ----------
    linked : Dataset, dims (y, x)
        ``image``, ``valid``, and ``u``, which says where the image shows the scanned sheet.
    """
    image, valid = linked["image"].values.astype(np.float64), linked["valid"].values.astype(bool)
    x = linked["x"].values
    seen = int(np.isfinite(image).sum())
    return Ground(
        values=image,
        y=linked["y"].values,
        x=x,
        # Holes and what lies beside the sheet may be black or white: the window is for the paper itself.
        norm=limits(image[valid] if valid.any() else image, percent=0.2),
        edge=np.isfinite(linked["u"].values) if "u" in linked else None,
        edge_of="the scanned sheet",
        name="the image",
        told=f"Grey values of {count(seen)} pixels of {plain(round(pitch(x), 4))}, no mask.",
    )


def map_ground(layer: xr.Dataset, name: str, *, of: str, edge: NDArray[np.bool_], edge_of: str) -> Ground:
    """Return a map as ground, in grey.

    Parameters
    ----------
    layer : Dataset, dims (y, x)
    name : str
        The map.
    of : str
        The layer that the map belongs to.
    edge : ndarray of bool, shape (rows, cols)
        Where the other map lies.
    edge_of : str
        The layer that the other map belongs to.
    """
    data = layer[name]
    values = data.values.astype(np.float64)
    x = layer["x"].values
    seen = int(np.isfinite(values).sum())
    title = in_words(str(data.attrs.get("long_name", name)))
    return Ground(
        values=values,
        y=layer["y"].values,
        x=x,
        norm=limits(values, percent=0.2),
        edge=edge,
        edge_of=edge_of,
        name=f"the layer {of}",
        told=f"In grey, {title} of {of}: {count(seen)} pixels of {plain(round(pitch(x), 4))}; mask: what is known.",
    )


def blank_ground(points: Array, *, of: str) -> Ground:
    """Return an empty ground around points, for places in a system of coordinates of which no map is at hand.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        ``(x, y)`` in um.
    of : str
        The layer that the coordinates belong to.
    """
    known = points[np.isfinite(points).all(axis=1)]
    low, high = (known.min(axis=0), known.max(axis=0)) if known.size else (np.zeros(2), np.ones(2))
    room = 0.2 * max(float((high - low).max()), 1.0)
    x, y = (np.linspace(low[k] - room, high[k] + room, _BLANK) for k in (0, 1))
    return Ground(
        values=np.full((_BLANK, _BLANK), np.nan),
        y=y,
        x=x,
        norm=Normalize(0.0, 1.0),
        edge=None,
        edge_of="",
        name=f"the layer {of}",
        told=f"Places are those of {of}, which is not on this grid itself; nothing is shown below, no mask.",
    )


def draw_ground(ground: Ground, *, width: float = FULL) -> tuple[Canvas, Axes, Field, tuple[float, float, float]]:
    """Draw a ground with its scale bar.

    Returns
    -------
    canvas, axes, field, (left, width, height)
        The latter in inches; 0.34 inches are left below for scale bars.
    """
    shown = field(ground.values, ground.y, ground.x, width=width)
    box = fit_box(shown, width, 7.6 if width == FULL else 4.8)
    canvas = Canvas(width, box[1] + 0.34)
    left = (width - box[0]) / 2
    axes = canvas.axes(left, 0.02, *box)
    show(axes, shown, norm=ground.norm, cmap="gray")
    scale_bar(canvas, left, box[1] + 0.06, inches=box[0], um=shown.width, most=0.2)
    return canvas, axes, shown, (left, *box)


def keep_view(axes: Axes, shown: Field) -> None:
    """Show the ground and no more, whatever was drawn over its border."""
    axes.set_xlim(shown.extent[0], shown.extent[1])
    axes.set_ylim(shown.extent[2], shown.extent[3])


def outline(axes: Axes, inside: NDArray[np.bool_], y: Array, x: Array, *, colour: str, width: float) -> None:
    """Draw the border of a region; where it meets the image's edge, along the edge."""
    if not inside.any() or min(inside.shape) < 2:
        return
    padded = np.pad(inside.astype(np.float64), 1)
    rows, cols = (np.concatenate([[c[0] - pitch(c) / 2], c, [c[-1] + pitch(c) / 2]]) for c in (y, x))
    axes.contour(cols, rows, padded, levels=[0.5], colors=[colour], linewidths=[width])
