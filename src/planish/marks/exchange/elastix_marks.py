"""elastix and transformix: the word ``point`` or ``index``, the number of points, one point a line.

``point`` means coordinates in the space of the image, in ITK usually mm; ``index`` (or no word at
all) means pixels from 0. One file holds one side: ``-fp`` the fixed, ``-mp`` the moving points.
elastix rounds an index to whole pixels, so that points are always written as ``point``.
"""

import re

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.tables import finite, raise_faults
from planish.core.typing import Floats
from planish.marks.exchange.lists import Content, PointList

_HEAD = re.compile(r"\s*(?:(point|index)(?:\s+|$))?(\S*)\s*?(?:\n|$)")
_NEEDED = (
    "'point' or 'index', the number of points, and one point a line, two or three numbers with"
    " spaces between"
)


def looks_like(content: Content) -> bool:
    """Return whether it begins with ``point``, ``index``, or a whole number alone in its line."""
    line, *_ = [*content.text.lstrip().splitlines(), ""]
    words = line.split()
    if words and words[0] in ("point", "index"):
        words = words[1:] or ["0"]
    return len(words) == 1 and _is_count(words[0])


def read(content: Content) -> list[PointList]:
    """Read the points of one file, as one list.

    Without the word ``point`` they are pixels; with it, mm are assumed, since the file states no
    unit. Faults name the points from 1.
    """
    name = content.name
    word, lines = _word_and_lines(content)
    axes = len(lines[0])
    faults: list[str] = []
    points: list[list[float | None]] = []
    for k, cells in enumerate(lines, 1):
        coordinates = [finite(cell) for cell in cells]
        points.append(coordinates)
        if axes not in (2, 3) or len(cells) != axes:
            faults.append(f"point {k} has {len(cells)} numbers")
        elif None in coordinates:
            faults.append(f"point {k}: {cells[coordinates.index(None)]!r} is no finite number")
    raise_faults(name, faults, f"elastix reads {_NEEDED}.", error=MarkError)
    places = np.array(points, dtype=np.float64)
    unit, stated = ("mm", False) if word == "point" else ("pixel", True)
    return [PointList(title=name, points=places, unit=unit, stated=stated)]


def _word_and_lines(content: Content) -> tuple[str, list[list[str]]]:
    """Give the word at the head of a file, and the cells of the lines of points below it.

    The word is ``point``, ``index`` or None. MarkError where the number of points is missing or
    another than that of the lines.
    """
    name = content.name
    text = content.text
    # Word and count may stand in one line or in two.
    head = _HEAD.match(text)
    word, count = head.groups() if head else ("", "")
    if head is None or not _is_count(count):
        raise MarkError(
            f"{name} states no number of points (found {count!r}). elastix reads {_NEEDED}."
        )
    body = text[head.end() :]
    lines = [*filter(None, map(str.split, body.splitlines()))]
    if len(lines) != int(count):
        raise MarkError(
            f"{name} states {int(count)} points and holds {len(lines)} lines of coordinates."
            " Correct the number in its second line, or add the points that are missing."
        )
    if not lines:
        raise MarkError(f"{name} holds no point. elastix reads {_NEEDED}.")
    return word, lines


def write(_marks: xr.Dataset, points: dict[str, Floats]) -> dict[str, bytes]:
    """Write one file for each layer."""
    files: dict[str, bytes] = {}
    for role, places in points.items():
        lines = [" ".join(map(repr, row)) for row in places.tolist()]
        text = "\n".join(["point", str(len(lines)), *lines]) + "\n"
        files["" if len(points) == 1 else f"-{role}"] = text.encode()
    return files


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 10
