"""BigWarp (Fiji): a CSV without header, or the landmarks in its JSON.

A row is the name, whether the point is active, the moving position and the target position, each x, y or x, y, z in the
physical unit of the images. A position that is not set is ``Infinity``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planish.core.errors import MarkError
from planish.core.tables import finite, table_text
from planish.marks.files.content import Content, check_count, refuse
from planish.marks.files.formats import Outgoing
from planish.marks.files.lists import PointList
from planish.marks.files.model import Floats, labels_of, used_of

COLUMNS = {6: 2, 8: 3}
"""Columns of a file, and the axes that they stand for."""

_NEEDED = "name, active, moving x, y, target x, y (6 columns), or with z (8 columns)"


def looks_like(content: Content) -> bool:
    """Whether the second cell says true or false, or the JSON holds landmarks."""
    if content.json is not None:
        return "movingPoints" in content.json or "landmarks" in content.json
    return len(content.header) > 2 and content.header[1].lower() in ("true", "false")


def read(content: Content) -> list[PointList]:
    """Moving and target points."""
    if content.json is not None:
        return _read_json(content.json, content.name)
    name, rows = content.name, content.rows
    axes = COLUMNS.get(len(content.header))
    if axes is None:
        raise MarkError(
            f"{name}, row {rows.rows[0].line} has {len(content.header)} columns. BigWarp writes {_NEEDED}. Save the "
            "landmarks in BigWarp again."
        )
    width = 2 * axes + 2
    labels: list[str] = []
    used: list[bool] = []
    points: list[list[float]] = []
    faults = list(rows.faults)
    for number, row in rows.rows:
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
    refuse(name, faults, f"BigWarp writes {_NEEDED}.")
    table = np.array(points, dtype=np.float64)
    return _lists(labels, used, table[:, :axes], table[:, axes:])


def write(out: Outgoing) -> dict[str, bytes]:
    """Write a CSV file. A point without one of its positions is not active, as BigWarp has it."""
    axes = max(points.shape[1] for points in out.points.values())
    sides = [np.pad(side, ((0, 0), (0, axes - side.shape[1]))) for side in out.points.values()]
    used = used_of(out.marks)
    rows: list[list[str]] = []
    for k, label in enumerate(labels_of(out.marks)):
        there = [bool(np.isfinite(side[k]).all()) for side in sides]
        cells = [repr(float(v)) if ok else "Infinity" for side, ok in zip(sides, there, strict=True) for v in side[k]]
        rows.append([label, "true" if used[k] and all(there) else "false", *cells])
    return {"": table_text([], rows, quote_all=True).encode()}


def _read_json(content: Mapping[str, Any], name: str) -> list[PointList]:
    """Points of the JSON, alone or in a project (``landmarks``)."""
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
