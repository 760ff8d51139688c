"""Which marks do not belong to the others."""

from __future__ import annotations

import numpy as np

from planish.core.typing import Bools
from planish.register.field import Field
from planish.register.pairs import Pairs

# A right mark is left out in this share of sets of marks.
_CHANCE = 0.01
_LEAST = 4
# So many wrong marks may hide each other.
_HIDDEN = 3
# Right ones that may be taken out before them.
_MORE = 2
_MANY = 150


def agreeing(pairs: Pairs, mirrored: bool) -> tuple[Bools, Field]:
    """Marks that agree, shape (n,), and the field that they make likely.

    The mark that the others expect least is taken out, up to a quarter of all and a few, and judged by the chance that
    they miss a right one by as much. All up to the last one whose chance is below one in a hundred sets are wrong, but
    for those that the marks left at the end do expect: wrong marks hide each other and accuse right ones. With fewer
    than 4 marks none can be told.

    References
    ----------
    Rosner (1983), Technometrics 25, 165, doi:10.1080/00401706.1983.10487848.
    """
    n = len(pairs)
    field = best = Field(pairs, mirrored)
    keep = np.ones(n, dtype=np.bool_)
    order, wrong = [], 0
    more, hidden = (_MORE, _HIDDEN) if 2 * _LEAST <= n <= _MANY else (0, 1)
    while n >= _LEAST and len(order) < max(1, n // 4) + more and len(order) - wrong < hidden + more:
        remaining, chance = np.flatnonzero(keep), field.left_out()[1]
        # The more marks were taken out without need, the more choices there were.
        limit = np.log(_CHANCE) - (1 + len(order) - wrong) * np.log(remaining.size)
        # Among many marks a few wrong ones accuse no right ones: all that stand out at once.
        count = max(1, int(np.count_nonzero(chance < limit))) if n > _MANY else 1
        out = np.argsort(chance, kind="stable")[:count]
        # Of marks that were taken together, the one that stands out most: it moves the mean of the others.
        out = out[np.sort(np.unique(field.group[out], return_index=True)[1])]
        order += remaining[out].tolist()
        keep[order] = False
        field = Field(pairs.take(keep), mirrored)
        if chance.min() < limit:
            wrong, best = len(order), field
    keep[:] = True
    keep[order[:wrong]] = False
    for mark in reversed(order[:wrong]) if n <= _MANY else ():
        keep[mark] = True
        field = Field(pairs.take(keep), mirrored)
        if field.left_out()[1][np.count_nonzero(keep[:mark])] < np.log(_CHANCE / np.count_nonzero(keep)):
            keep[mark] = False
        else:
            best = field
    return keep, best
