"""Which marks do not belong to the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.register.field import Field
from planish.register.pairs import Pairs

Floats = NDArray[np.float64]

# A right mark is left out in this share of sets of marks.
_CHANCE = 0.01
_LEAST = 4
# So many wrong marks may hide each other.
_HIDDEN = 3


def agreeing(pairs: Pairs, mirrored: bool) -> tuple[NDArray[np.bool_], Field]:
    """Marks that agree, shape (n,), and the field that they make likely.

    The mark that the others expect least is taken out, up to a quarter of all, and judged by the chance that the others
    miss a right one by as much. All up to the last one whose chance is below one in a hundred sets are wrong: a wrong
    mark may hide another. With fewer than 4 marks none can be told.

    References
    ----------
    Rosner (1983), Technometrics 25, 165, doi:10.1080/00401706.1983.10487848.
    """
    n = len(pairs)
    field = best = Field(pairs, mirrored)
    keep = np.ones(n, dtype=np.bool_)
    found, hidden = keep.copy(), 0
    while n >= _LEAST and n - np.count_nonzero(keep) < max(1, n // 4) and hidden < _HIDDEN:
        left, chance = np.flatnonzero(keep), field.left_out()[1]
        worst = int(np.argmin(chance))
        keep[left[worst]] = False
        field = Field(pairs.take(keep), mirrored)
        hidden += 1
        if chance[worst] < _CHANCE / left.size:
            found, best, hidden = keep.copy(), field, 0
    return found, best
