"""ImageJ: results of the point tool with the columns ``X`` and ``Y``, in the unit of the image.

Read only.
"""

from planish.marks.exchange.csv_marks import read_points
from planish.marks.exchange.lists import Content, PointList


def looks_like(content: Content) -> bool:
    """Return whether the header has the columns ``X`` and ``Y``."""
    return {"X", "Y"} <= set(content.header)


def read(content: Content) -> list[PointList]:
    """Read the points of one layer."""
    return [read_points(content, ("x", "y"), stated=False, source="clicked")]
