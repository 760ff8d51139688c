"""Regions that a study declares as artefacts.

They are given on the pixels of the reference, and as results say them.
"""

from pathlib import Path

import numpy as np

from planish.core.bands import bands
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.marks.regions import Regions
from planish.results import RegionFacts, RegionsFacts

REGIONS = "regions.geojson"
"""Name of the file of a run that holds them, in um of the reference."""


def regions_on(declared: Regions, grid: Grid, path: str | None) -> Regions:
    """Bring regions read from ``path`` to um of the reference.

    InputError where they hold none or all of its pixels.
    """
    regions = declared.on(grid)
    share = region_facts(regions, grid).share
    if share in (0, 1):
        x, y = (f"{coords_um[0]:g} to {coords_um[-1]:g} um" for coords_um in (grid.x_um, grid.y_um))
        raise InputError(
            f"{Path(str(path)).name}: {'every' if share else 'no'} pixel of the reference lies in a"
            f" region. Its pixels lie at x from {x} and y from {y}. Give regions of this reference:"
            " GeoJSON in um, selections of ImageJ and QuPath in its pixels."
        )
    return regions


def region_facts(regions: Regions, grid: Grid) -> RegionsFacts:
    """What was declared, and the share of the reference's pixels that it takes."""
    pixels_of_each = np.zeros(len(regions.declared), dtype=np.int64)
    n_inside = 0
    for rows in bands(grid.shape[0]):
        band_grid = grid.part(rows)
        inside = np.zeros(band_grid.shape, dtype=bool)
        for k, region in enumerate(regions.declared):
            window, mask = region.inside(band_grid)
            inside[window] |= mask
            pixels_of_each[k] += np.count_nonzero(mask)
        n_inside += int(np.count_nonzero(inside))
    rows, cols = grid.shape
    n_pixels = rows * cols
    facts: list[RegionFacts] = []
    for region, n in zip(regions.declared, pixels_of_each.tolist(), strict=True):
        share = n / n_pixels
        of_region = RegionFacts(
            name=region.name, reason=region.reason, author=region.author, share=share
        )
        facts.append(of_region)
    return RegionsFacts(count=len(facts), share=n_inside / n_pixels, regions=tuple(facts))
