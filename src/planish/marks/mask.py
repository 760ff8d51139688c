"""Pixels of a map or an image that lie in holes, also in those that its border cuts."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.bands import band_of, bands, thinned
from planish.core.grid import Grid
from planish.core.typing import Bools, Floats


def hole_mask(grid: Grid, centres_um: Floats, radii_um: Floats) -> Bools:
    """Mark the pixels of a grid that lie in a hole.

    Parameters
    ----------
    grid : Grid
    centres_um : ndarray, shape (n, 2)
        ``x, y`` of the holes.
    radii_um : ndarray, shape (n,)
        Their radii; with the burnt rim where that has to be masked, too.

    Returns
    -------
    ndarray of bool, shape of the grid
        True within a radius of a centre.
    """
    inside = np.zeros(grid.shape, dtype=bool)
    for (x, y), radius in zip(centres_um, radii_um, strict=True):
        rows = slice(np.searchsorted(grid.y_um, y - radius), np.searchsorted(grid.y_um, y + radius, "right"))
        cols = slice(np.searchsorted(grid.x_um, x - radius), np.searchsorted(grid.x_um, x + radius, "right"))
        inside[rows, cols] |= np.hypot(grid.x_um[None, cols] - x, grid.y_um[rows, None] - y) <= radius
    return inside


def cut_holes(image: xr.DataArray, holes: xr.Dataset) -> xr.Dataset:
    """Find what the border of an image cuts of holes; :func:`find_holes` leaves such holes out.

    Parameters
    ----------
    image : DataArray, dims (y, x), coordinates in um
    holes : Dataset, dims (mark)
        The whole holes of the image, of :func:`find_holes`.

    Returns
    -------
    Dataset, dims (mark)
        ``x, y, diameter`` (um) of a circle around each: what touches the border, is beyond half way from the sheet to
        the floor of the whole holes, and has a tenth of their area or more. What is wider than twice the largest of
        them is none.
    """
    circles: list[tuple[float, float, float]] = []
    if holes.sizes["mark"]:
        grid = Grid.of(image)
        centres, radius = np.stack([holes["x"].values, holes["y"].values], axis=1), 0.5 * holes["diameter"].values
        inner, outer = (hole_mask(grid, centres, factor * radius) for factor in (0.6, 1.5))
        _, (greys, inner, outer) = thinned(image, inner, outer)
        floor, sheet = (float(np.nanmedian(greys[use])) if use.any() else np.nan for use in (inner, ~outer))
        if np.isfinite(floor - sheet) and floor != sheet:
            is_beyond = [_is_beyond(band_of(image, rows), floor, sheet) for rows in bands(grid.shape[0])]
            circles = _border_circles(np.concatenate(is_beyond), grid, radius)
    columns = np.array(circles, dtype=np.float64).reshape(-1, 3).T
    return xr.Dataset({k: ("mark", v, {"units": "um"}) for k, v in zip(("x", "y", "diameter"), columns, strict=True)})


def _is_beyond(greys: NDArray[Any], floor: float, sheet: float) -> Bools:
    """Return which greys are beyond half way from the sheet to the floor of the holes."""
    return np.isfinite(greys) & ((greys.astype(np.float64) - sheet) / (floor - sheet) > 0.5)


def _border_circles(is_beyond: Bools, grid: Grid, radius: Floats) -> list[tuple[float, float, float]]:
    """Give circles around the regions that touch the border."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(is_beyond)[0])
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    down, across = grid.pixel_um
    least = 0.1 * np.pi * float(np.median(radius)) ** 2 / (down * across)
    circles: list[tuple[float, float, float]] = []
    boxes = ndimage.find_objects(labels)
    for label in border[border > 0]:
        box = boxes[label - 1]
        rows, cols = (index + side.start for index, side in zip(np.nonzero(labels[box] == label), box, strict=True))
        if rows.size >= least:
            points = np.stack([grid.x_um[cols], grid.y_um[rows]], axis=1)
            middle = points.mean(axis=0)
            reach = float(np.hypot(*(points - middle).T).max())
            if reach <= 2 * radius.max():  # the ground beside a sheet is no hole, and its circle covers the sheet
                circles.append((float(middle[0]), float(middle[1]), 2 * reach))
    return circles
