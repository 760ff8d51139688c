"""In which unit the textures of two layers are looked at.

Waves, grids, tiles and reaches of a search by texture are stated for paper, in um. What is not of
paper's size has the same ones in a unit of its own, so they keep their number of pixels.
"""

import math

from planish.core.grid import Grid

# Of layers that show paper, the coarser pixel: below it a field is too small, and above it the
# longest wave of the search has not 4 pixels.
_PAPER_UM = (0.3, 37.5)
_LEAST_UM = 250.0  # root of an area; in a smaller one a texture and itself are at chance
_PIXEL_UM = 4.0  # of paper, and up to twice as much: the shortest wave has 2 to 4.5 of it
_STEPS = 3  # of units in a decade: a hundredth of paper with such a pixel has its numbers


def length_unit_um(first: Grid, second: Grid) -> float:
    """Return 1 for layers of paper's size; otherwise the unit of their pixel."""
    areas_um2 = [math.prod((*grid.shape, *grid.pixel_um)) for grid in (first, second)]
    low_um, high_um = _PAPER_UM
    if low_um <= _coarser_um(first, second) <= high_um and min(areas_um2) >= _LEAST_UM**2:
        return 1.0
    return pixel_unit_um(first, second)


def pixel_unit_um(first: Grid, second: Grid) -> float:
    """Return a unit in proportion to the coarser pixel of two layers: that is 4 to 8.6 long."""
    # A pixel size of many digits is not quite the same after a division.
    step = math.floor(_STEPS * math.log10(_coarser_um(first, second) / _PIXEL_UM) + 0.03)
    return 10.0 ** (step / _STEPS)


def _coarser_um(first: Grid, second: Grid) -> float:
    return max(*first.pixel_um, *second.pixel_um)
