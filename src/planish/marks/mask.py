"""Where holes lie in a map or an image: also those that its border cuts."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.grid import Grid

Floats = NDArray[np.float64]


def hole_mask(grid: Grid, centres_um: Floats, radii_um: Floats) -> NDArray[np.bool_]:
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
        the floor of the whole holes, and has a tenth of their area or more.
    """
    circles: list[tuple[float, float, float]] = []
    if holes.sizes["mark"]:
        grid = Grid.of(image)
        values = np.asarray(image.values, dtype=np.float64)
        at, radius = np.stack([holes["x"].values, holes["y"].values], axis=1), 0.5 * holes["diameter"].values
        floor = float(np.nanmedian(values[hole_mask(grid, at, 0.6 * radius)]))
        sheet = float(np.nanmedian(values[~hole_mask(grid, at, 1.5 * radius)]))
        if np.isfinite(floor - sheet) and floor != sheet:
            circles = _touching(np.isfinite(values) & ((values - sheet) / (floor - sheet) > 0.5), grid, radius)
    data = np.array(circles, dtype=np.float64).reshape(-1, 3).T
    return xr.Dataset({k: ("mark", v, {"units": "um"}) for k, v in zip(("x", "y", "diameter"), data, strict=True)})


def _touching(beyond: NDArray[np.bool_], grid: Grid, radius: Floats) -> list[tuple[float, float, float]]:
    """Circles around the regions that touch the border."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(beyond)[0])
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    down, across = grid.pixel_um
    least = 0.1 * np.pi * float(np.median(radius)) ** 2 / (down * across)
    circles: list[tuple[float, float, float]] = []
    for label in border[border > 0]:
        rows, cols = np.nonzero(labels == label)
        if rows.size >= least:
            places = np.stack([grid.x_um[cols], grid.y_um[rows]], axis=1)
            middle = places.mean(axis=0)
            circles.append((float(middle[0]), float(middle[1]), 2 * float(np.hypot(*(places - middle).T).max())))
    return circles
