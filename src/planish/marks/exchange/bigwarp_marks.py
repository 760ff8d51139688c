"""BigWarp (Fiji): a CSV without header, or the landmarks in its JSON.

``Infinity`` is a position that is not set.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.tables import DECIMAL_COMMAS, CsvRow, Rows, raise_faults, table_text
from planish.core.transform import are_known
from planish.core.typing import Fields, Floats
from planish.marks.exchange.lists import Content, PointList
from planish.marks.exchange.model import labels_of, used_of

_NEEDED = "name, active, moving x, y, target x, y (6 columns), or with z (8 columns)"
# As spreadsheets in several languages write them again.
_STATES = {
    **dict.fromkeys(("true", "wahr", "vrai", "vero", "verdadero"), True),
    **dict.fromkeys(("false", "falsch", "faux", "falso"), False),
}
_UNSET = ("infinity", "inf")
_AGAIN = "Save the landmarks in BigWarp again."


def looks_like(content: Content) -> bool:
    """Return whether the second cell says true or false, or the JSON holds landmarks."""
    has_state = len(content.header) > 2 and content.header[1].lower() in _STATES
    return has_state or bool({"movingPoints", "landmarks"} & content.json.keys())


def read(content: Content) -> list[PointList]:
    """Read the moving and target points.

    Two lists, in the order of the rows. BigWarp states no unit: um is assumed. A position that is
    not set, ``Infinity``, is NaN.
    """
    name = content.name
    rows = _rows_of_json(content.json, name) if content.json else content.rows.rows
    first = rows[0].line
    width = len(rows[0].cells)
    if width not in (6, 8):
        has_commas = width > 8 and content.rows.delimiter == ","
        hint = f" ({DECIMAL_COMMAS})" * has_commas
        raise MarkError(
            f"{name}, row {first} has {width} columns{hint}. BigWarp writes {_NEEDED}. {_AGAIN}"
        )
    points: list[list[float | None]] = []
    faults = list(content.rows.faults)
    for row in rows:
        if len(row.cells) != width:
            faults.append(f"row {row.line} has {len(row.cells)} columns, the first {width}")
            continue
        points.append(_coordinates(row, content.rows, faults))
    raise_faults(name, faults, f"BigWarp writes {_NEEDED}.", error=MarkError)
    # One coordinate that is not set leaves the point without a position.
    numbers = np.array(points, dtype=np.float64)
    sides = numbers.reshape(len(points), 2, -1)
    sides[~are_known(sides)] = np.nan
    labels = [row.cells[0] or f"row {row.line}" for row in rows]
    used = [_STATES[row.cells[1].lower()] for row in rows]
    list_of = partial(PointList, labels=labels, used=used, unit="um", stated=False)
    moving, target = sides.swapaxes(0, 1)
    return [list_of(title="moving", points=moving), list_of(title="target", points=target)]


def _coordinates(row: CsvRow, rows: Rows, faults: list[str]) -> list[float | None]:
    """Coordinates in a row, infinite where not set; what is wrong goes into ``faults``.

    The row holds name, state, and two or three numbers of either side; None stands for what is no
    number.
    """
    state = row.cells[1]
    if state.lower() not in _STATES:
        faults.append(f"row {row.line}: active is {state!r}, not true or false")
    coordinates: list[float | None] = []
    for cell in row.cells[2:]:
        is_unset = cell.lstrip("+-").lower() in _UNSET
        coordinates.append(np.inf if is_unset else rows.number(cell))
    if None in coordinates:
        cell = row.cells[2 + coordinates.index(None)]
        faults.append(f"row {row.line}: {cell!r} {rows.number_fault(cell)}")
    return coordinates


def _rows_of_json(content: Fields, name: str) -> list[CsvRow]:
    """Landmarks, alone or in a project, as the rows that BigWarp writes of them.

    MarkError where points, names and states do not have the shape that BigWarp gives them.
    """
    landmarks = content.get("landmarks", content)
    entries: Fields = landmarks if isinstance(landmarks, Mapping) else {}
    axes = entries.get("numDimensions")
    for key in ("movingPoints", "fixedPoints"):
        points = entries.get(key)
        if axes not in (2, 3) or not _are_points(points, axes):
            raise MarkError(
                f"{name}: {key} is no list of positions with numDimensions ({axes!r}) numbers"
                f" each; 2 or 3 are needed. {_AGAIN}"
            )
    keys = ("names", "active", "movingPoints", "fixedPoints")
    columns = [entries[key] if isinstance(entries.get(key), list) else [] for key in keys]
    labels, active, moving, fixed = map(len, columns)
    if not labels == active == moving == fixed > 0:
        raise MarkError(
            f"{name} holds {moving} moving points, {fixed} fixed points, {labels} names and"
            f" {active} of active; as many of each are needed. {_AGAIN}"
        )
    rows: list[CsvRow] = []
    for label, state, moving_point, fixed_point in zip(*columns, strict=True):
        cells = [*map(str, (label, state, *moving_point, *fixed_point))]
        rows.append(CsvRow(len(rows) + 1, cells))
    return rows


def _are_points(points: Any, axes: int) -> bool:
    if not isinstance(points, list):
        return False
    return all(isinstance(point, list) and len(point) == axes for point in points)


def write(marks: xr.Dataset, points: dict[str, Floats]) -> dict[str, bytes]:
    """Write a CSV file. A point without one of its positions is not active, as BigWarp has it.

    ``points`` are those of `formats`: (n, 2) or (n, 3) of the moving and the fixed side, in the
    unit of the file.
    """
    axes = max(side.shape[1] for side in points.values())
    sides: list[Floats] = []
    for side in points.values():
        missing_axes = axes - side.shape[1]
        side = np.pad(side, ((0, 0), (0, missing_axes)))
        side[~are_known(side)] = np.inf
        sides.append(side)
    numbers = np.hstack(sides)
    is_used = used_of(marks) & are_known(numbers)
    rows: list[list[Any]] = []
    for k, label in enumerate(labels_of(marks)):
        cells = ["Infinity" if n == np.inf else n for n in numbers[k].tolist()]
        rows.append([label, "true" if is_used[k] else "false", *cells])
    return {"": table_text([], rows, quote_all=True).encode()}
