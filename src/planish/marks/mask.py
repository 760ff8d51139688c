"""Find the pixels of a map or an image that lie in holes, or in the dots of a print.

Also in holes that its border cuts.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.bands import read_bands, thinned
from planish.core.grid import Grid, centres_of, hole_mask
from planish.core.robust import otsu_borders
from planish.core.typing import Array, Bools, Floats, Ints, Pair, Singles
from planish.marks.candidates import Raster, reduce_to


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
        ``x, y, diameter`` (um) of a circle around each: what touches the border, is beyond half way
        from the sheet to the floor of the whole holes, and has a tenth of their area or more. None
        is wider than twice the largest.
    """
    grid = Grid.of(image)
    radii_um = 0.5 * holes["diameter"].values
    circles: list[tuple[float, float, float]] = []
    for rows, cols in _border_regions(image, grid, centres_of(holes), radii_um):
        pixels_um = np.stack([grid.x_um[cols], grid.y_um[rows]], axis=1)
        x, y = pixels_um.mean(axis=0).tolist()
        offset_x, offset_y = (pixels_um - (x, y)).T
        radius_um = float(np.hypot(offset_x, offset_y).max())
        # The ground beside a sheet is no hole, and its circle covers the sheet.
        if radius_um <= 2 * radii_um.max():
            circles.append((x, y, 2 * radius_um))
    rows_um = np.array(circles, dtype=np.float64)
    columns = rows_um.reshape(-1, 3).T
    named = zip(("x", "y", "diameter"), columns, strict=True)
    return xr.Dataset({name: ("mark", column, {"units": "um"}) for name, column in named})


def _border_regions(
    image: xr.DataArray, grid: Grid, centres: Floats, radii_um: Floats
) -> Iterator[tuple[Ints, Ints]]:
    """Yield rows and columns of what touches the border and is nearer to holes than to the sheet.

    It is beyond half way from the sheet to the floor of holes; nothing where there are none.
    ``centres`` (n, 2) are x, y of whole holes, in um.
    """
    if not len(radii_um):
        return
    # Inside the rim, and outside the char.
    inner_mask = hole_mask(grid, centres, 0.6 * radii_um)
    outer_mask = hole_mask(grid, centres, 1.5 * radii_um)
    _, (greys, inner_mask, outer_mask) = thinned(image, inner_mask, outer_mask)
    floor = _median(greys[inner_mask])
    sheet = _median(greys[~outer_mask])
    if not np.isfinite(floor - sheet) or floor == sheet:
        return
    is_beyond: list[Bools] = []
    for _, (band,) in read_bands(image):
        depth_shares = (band.astype(np.float64) - sheet) / (floor - sheet)
        is_beyond.append(np.isfinite(band) & (depth_shares > 0.5))
    labels, _ = ndimage.label(np.concatenate(is_beyond))
    border_labels = np.union1d(labels[[0, -1]], labels[:, [0, -1]])
    row_um, col_um = grid.pixel_um
    least_um2 = 0.1 * np.pi * float(np.median(radii_um)) ** 2
    boxes = ndimage.find_objects(labels)
    for label in border_labels[border_labels > 0]:
        down, across = boxes[label - 1]
        rows, cols = np.nonzero(labels[down, across] == label)
        if rows.size >= least_um2 / (row_um * col_um):
            yield rows + down.start, cols + across.start


def _median(greys: Array) -> float:
    return float(np.nanmedian(greys)) if greys.size else np.nan


def without_dots(image: NDArray[np.floating], pixel_um: Pair, least_um: float) -> Singles:
    """Make bright what is dark and too narrow for the smallest hole.

    Parameters
    ----------
    image : ndarray, shape (rows, cols)
        Printed paper, lighter than its ink; NaN is missing.
    pixel_um : (float, float)
        Along y and x.
    least_um : float
        Diameter of the smallest hole, larger than that of the largest dot.

    Returns
    -------
    ndarray, shape (rows, cols)
        The image with the median grey of the paper where dots are; holes and paper keep their
        values.

    Notes
    -----
    Dark is what lies below the level that parts two classes of grey best (Otsu 1979). What a disc
    of ``least_um``, all dark, reaches is a hole (morphological opening); all other dark pixels are
    dots.

    References
    ----------
    Otsu (1979), IEEE Trans. Syst. Man Cybern. 9, 62, doi:10.1109/TSMC.1979.4310076.
    """
    greys = np.asarray(image, dtype=np.float32)
    # 40 pixels across the smallest hole distinguish dots from holes.
    coarse_greys, coarse_um, _ = reduce_to(Raster(greys, pixel_um), least_um / 40.0)
    has_data = np.isfinite(coarse_greys)
    if not has_data.any():
        return greys
    filled = np.where(has_data, coarse_greys, np.median(coarse_greys[has_data]))
    smooth = ndimage.gaussian_filter(filled, 1.0)
    counts, grey_edges = np.histogram(smooth[has_data], 256)
    (best_edge,) = otsu_borders(counts, counts * np.arange(256), 2)
    is_dark = has_data & (smooth < float(grey_edges[best_edge]))
    if not is_dark.any() or not (has_data & ~is_dark).any():
        return greys
    # Beyond the border may be more of a hole, or of a dot: a hole that it cuts stays one.
    padded = np.pad(is_dark | ~has_data, 1, constant_values=True)
    depth_um = np.asarray(ndimage.distance_transform_edt(padded, sampling=coarse_um))
    depth_um = depth_um[1:-1, 1:-1]
    hole_cores = is_dark & (depth_um >= least_um / 2 - 0.5 * max(coarse_um))
    # A hole grows back beyond the discs in it: its rim stays as it is.
    reach_um = least_um / 2 + 1.5 * max(coarse_um)
    is_hole = hole_cores
    if hole_cores.any():
        from_core_um = ndimage.distance_transform_edt(~hole_cores, sampling=coarse_um)
        is_hole = np.asarray(from_core_um) < reach_um
    # Two pixels around a dot are not yet as bright as paper.
    is_dot = ndimage.binary_dilation(is_dark & ~is_hole, iterations=2) & ~is_hole
    nearest_coarse: list[Ints] = []
    for axis in range(2):
        factor = round(coarse_um[axis] / pixel_um[axis])
        coarse = np.arange(greys.shape[axis]) // factor
        nearest_coarse.append(np.minimum(coarse, is_dot.shape[axis] - 1))
    paper_grey = np.median(coarse_greys[has_data & ~is_dark])
    is_dot = is_dot[np.ix_(*nearest_coarse)]
    return np.where(is_dot & np.isfinite(greys), paper_grey, greys)
