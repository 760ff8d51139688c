"""elastix and transformix: the word ``point`` or ``index``, the number of points, one point a line.

``point`` means coordinates in the space of the image, in ITK usually mm; ``index`` (or no word at all) means pixels
from 0. One file holds one side: ``-fp`` the fixed, ``-mp`` the moving points. elastix rounds an index to whole pixels,
so that points are always written as ``point``.
"""

from __future__ import annotations

import re

import numpy as np

from planish.core.errors import MarkError
from planish.marks.files.lists import PointList
from planish.marks.files.model import Floats
from planish.marks.files.text import check_count, finite, raise_faults

_COUNT = re.compile(r"\d{1,9}")
_NEEDED = "'point' or 'index', the number of points, and one point a line, two or three numbers with spaces between"


def looks_like_elastix(text: str) -> bool:
    """Whether it begins with ``point`` or ``index``, or with a whole number alone in its line."""
    first = text.split(maxsplit=1)[:1]
    line = text.lstrip().splitlines()[:1]
    return first in (["point"], ["index"]) or bool(line and _COUNT.fullmatch(line[0].strip()))


def read_elastix(text: str, name: str) -> list[PointList]:
    """Points of one file, as one list.

    Raises
    ------
    MarkError
        If the number of points is not as stated, or a line is malformed.
    """
    check_count(name, text.count("\n") - 2)
    lines = [line.split() for line in text.splitlines() if line.strip()]
    # Word and count may stand in one line or in two.
    head = [word for line in lines[:2] for word in line][:2]
    word = head[0] if head and head[0] in ("point", "index") else ""
    taken = ([word] if word else []) + head[1 if word else 0 :][:1]
    while taken and lines:
        for _ in lines.pop(0):
            taken = taken[1:]
    count = head[1 if word else 0] if len(head) > (1 if word else 0) else ""
    if not _COUNT.fullmatch(count):
        raise MarkError(f"{name} states no number of points (found {count!r}). elastix reads {_NEEDED}.")
    if len(lines) != int(count):
        raise MarkError(
            f"{name} states {int(count)} points and holds {len(lines)} lines of coordinates. Correct the number in its "
            "second line, or add the points that are missing."
        )
    if not lines:
        raise MarkError(f"{name} holds no point. elastix reads {_NEEDED}.")
    axes = len(lines[0])
    faults: list[str] = []
    points: list[list[float]] = []
    for k, cells in enumerate(lines, 1):
        values = [finite(cell) for cell in cells]
        if axes not in (2, 3) or len(cells) != axes:
            faults.append(f"point {k} has {len(cells)} numbers")
        elif None in values:
            faults.append(f"point {k}: {cells[values.index(None)]!r} is no finite number")
        points.append([v for v in values if v is not None])
    raise_faults(name, faults, f"elastix reads {_NEEDED}.")
    numbers = [str(k + 1) for k in range(len(points))]
    in_space = word == "point"
    return [
        PointList(
            title=name, labels=numbers, points=np.array(points, dtype=np.float64), used=[True] * len(points),
            unit="mm" if in_space else "pixel", stated=not in_space,
        )
    ]  # fmt: skip


def elastix_text(points: Floats) -> str:
    """Text of one file for points of shape (n, 2) or (n, 3), in the unit of the image's space."""
    lines = [" ".join(repr(float(v)) for v in row) for row in points]
    return "\n".join(["point", str(len(lines)), *lines]) + "\n"
