"""BigWarp (Fiji): a CSV without header, or the landmarks in its JSON.

A row is the name, whether the point is active, the moving position and the target position, each x, y or x, y, z in the
physical unit of the images. A position that is not set is ``Infinity``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.marks.files.lists import PointList
from planish.marks.files.model import Floats, labels_of, used_of
from planish.marks.files.text import Rows, check_count, finite, raise_faults

COLUMNS = {6: 2, 8: 3}
"""Columns of a file, and the axes that they stand for."""

_NEEDED = "name, active, moving x, y, target x, y (6 columns), or with z (8 columns)"


def looks_like_bigwarp(rows: Rows) -> bool:
    """Whether the second cell says true or false."""
    return bool(rows) and len(rows[0][1]) > 2 and rows[0][1][1].lower() in ("true", "false")


def read_bigwarp(rows: Rows, name: str) -> list[PointList]:
    """Moving and target points of a CSV file.

    Raises
    ------
    MarkError
        If a row has another number of columns, or a cell is no number; the rows are named.
    """
    axes = COLUMNS.get(len(rows[0][1]))
    if axes is None:
        raise MarkError(
            f"{name}, row {rows[0][0]} has {len(rows[0][1])} columns. BigWarp writes {_NEEDED}. Save the landmarks in "
            "BigWarp again."
        )
    width = 2 * axes + 2
    labels: list[str] = []
    used: list[bool] = []
    points: list[list[float]] = []
    faults: list[str] = []
    for number, row in rows:
        if len(row) != width:
            faults.append(f"row {number} has {len(row)} columns, the first {width}")
            continue
        active = row[1].lower()
        if active not in ("true", "false"):
            faults.append(f"row {number}: active is {row[1]!r}, not true or false")
        values = [_coordinate(cell) for cell in row[2:]]
        if None in values:
            faults.append(f"row {number}: {row[2 + values.index(None)]!r} is no number")
        labels.append(row[0] or f"row {number}")
        used.append(active == "true")
        points.append([np.nan if value is None else value for value in values])
    raise_faults(name, faults, f"BigWarp writes {_NEEDED}.")
    table = np.array(points, dtype=np.float64)
    return _lists(labels, used, table[:, :axes], table[:, axes:])


def read_bigwarp_json(content: Mapping[str, Any], name: str) -> list[PointList]:
    """Moving and target points of BigWarp's JSON, alone or in a project (``landmarks``).

    Raises
    ------
    MarkError
        If a list is missing or malformed, or they differ in length.
    """
    inner: object = content.get("landmarks", content)
    marks: Mapping[str, Any] = inner if isinstance(inner, Mapping) else {}
    axes: Any = marks.get("numDimensions")
    sides: list[list[list[float]]] = []
    for key in ("movingPoints", "fixedPoints"):
        rows: object = marks.get(key)
        check_count(name, len(rows) if isinstance(rows, list) else 0)
        found = [_position(row, axes) for row in rows] if isinstance(rows, list) else [None]
        if axes not in (2, 3) or None in found:
            raise MarkError(
                f"{name}: {key} is no list of positions with numDimensions ({axes!r}) numbers each; 2 or 3 are needed. "
                "Save the landmarks in BigWarp again."
            )
        sides.append([row for row in found if row is not None])
    moving, fixed = sides
    names: object = marks.get("names")
    active: object = marks.get("active")
    labels = [str(v) for v in names] if isinstance(names, list) else []
    used = [v is True for v in active] if isinstance(active, list) else []
    counts = (len(moving), len(fixed), len(labels), len(used))
    if len(set(counts)) > 1 or not moving:
        raise MarkError(
            f"{name} holds {counts[0]} moving points, {counts[1]} fixed points, {counts[2]} names and {counts[3]} of "
            "active; as many of each are needed. Save the landmarks in BigWarp again."
        )
    return _lists(labels, used, np.array(moving), np.array(fixed))


def bigwarp_text(marks: xr.Dataset, moving: Floats, fixed: Floats) -> str:
    """Text of a CSV file; positions of shape (n, 2) or (n, 3) in the unit of the file, NaN where not set.

    A point without one of its positions is not active, as BigWarp has it.
    """
    axes = max(moving.shape[1], fixed.shape[1])
    sides = [np.pad(side, ((0, 0), (0, axes - side.shape[1]))) for side in (moving, fixed)]
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\n")
    used = used_of(marks)
    for k, label in enumerate(labels_of(marks)):
        there = [bool(np.isfinite(side[k]).all()) for side in sides]
        cells = [repr(float(v)) if ok else "Infinity" for side, ok in zip(sides, there, strict=True) for v in side[k]]
        writer.writerow([label, "true" if used[k] and all(there) else "false", *cells])
    return text.getvalue()


def _lists(labels: list[str], used: list[bool], moving: Floats, fixed: Floats) -> list[PointList]:
    return [
        PointList(title=title, labels=labels, points=_unset(points), used=used, unit="um", stated=False)
        for title, points in (("moving", moving), ("target", fixed))
    ]


def _unset(points: Floats) -> Floats:
    """Positions, with NaN in all axes where BigWarp has none."""
    return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)


def _coordinate(cell: object) -> float | None:
    """Number of a cell, infinite where no position is set; None where it is none."""
    if isinstance(cell, str) and cell.lstrip("+-").lower() in ("infinity", "inf"):
        return float("inf")
    if isinstance(cell, float) and cell in (float("inf"), float("-inf")):
        return float("inf")
    return finite(cell)


def _position(row: object, axes: object) -> list[float] | None:
    if not isinstance(row, list) or len(row) != axes:
        return None
    values = [_coordinate(cell) for cell in row]
    return None if None in values else [value for value in values if value is not None]
