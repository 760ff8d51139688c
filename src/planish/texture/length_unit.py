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


def length_unit_um(first: Grid, second: Grid, *, by_pixel: bool = False) -> float:
    """Return 1 for layers of paper's size; otherwise, or ``by_pixel``, a unit of their pixel.

    The coarser pixel is 4 to 8.6 of it long, and the unit a power of 10 to the third.
    """
    pixel_um = max(*first.pixel_um, *second.pixel_um)
    low_um, high_um = _PAPER_UM
    areas_um2 = [math.prod((*g.shape, *g.pixel_um)) for g in (first, second)]
    is_paper = low_um <= pixel_um <= high_um and min(areas_um2) >= _LEAST_UM**2
    if is_paper and not by_pixel:
        return 1.0
    # A pixel size of many digits is not quite the same after a division.
    step = math.floor(_STEPS * math.log10(pixel_um / _PIXEL_UM) + 0.03)
    return 10.0 ** (step / _STEPS)
