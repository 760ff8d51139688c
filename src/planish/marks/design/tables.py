"""Holes of a pattern as a CSV table, and patterns that others give as such a table."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import MarkError
from planish.marks.design.pattern import Burn, Pattern, own_pattern, read_text

COLUMNS = ("label", "x_um", "y_um", "diameter_um")
_MOST_FAULTS = 8


def holes_csv(pattern: Pattern, *, seen: bool = False) -> str:
    """Write ``label,x_um,y_um,diameter_um``, a hole a row.

    Parameters
    ----------
    seen : bool
        Positions as an image of the laser's side shows them, from its upper left corner with y down, instead of
        those of the stage.
    """
    return _csv(pattern, pattern.seen_um if seen else pattern.points_um)


def read_pattern(
    path: str | Path, *, field_um: tuple[float, float] | None = None, diameter_um: float | None = None
) -> Pattern:
    """Read a pattern: the JSON of a design, or a CSV table of anybody's holes.

    Parameters
    ----------
    path : str or Path
        A table has the columns ``x_um, y_um`` and may have ``diameter_um``, whose median counts; others are passed
        over.
    field_um : (width, height), optional
        Of a table only: the region in the middle of the holes whose maps are to be compared.
    diameter_um : float, optional
        Of a table only; goes before the column.

    Raises
    ------
    FileError
        If the file cannot be read.
    MarkError
        If it is no pattern, or a number is missing or malformed.
    """
    place = Path(path)
    text = read_text(place, "pattern")
    if text.lstrip().startswith("{"):
        if field_um is not None or diameter_um is not None:
            raise MarkError(
                f"{place.name} states its field and diameter itself; they can be given for a CSV table only."
            )
        return Pattern.from_json(text)
    points, diameters = _rows(place.name, text)
    burn = Burn()
    if diameter_um is not None or diameters.size:
        chosen = diameter_um if diameter_um is not None else float(np.median(diameters))
        if not 10 <= chosen <= 2000:
            raise MarkError(f"{place.name}: a diameter of {chosen:g} um; 10 to 2000 um are possible.")
        burn = replace(burn, diameter_um=chosen)
    return own_pattern(points, name=place.stem, field_um=field_um, burn=burn)


def _csv(pattern: Pattern, points: NDArray[np.float64]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for label, (x, y) in zip(pattern.labels, points, strict=True):
        table.writerow([label, *(f"{value:.6f}".rstrip("0").rstrip(".") for value in (x, y, pattern.burn.diameter_um))])
    return text.getvalue()


def _rows(name: str, text: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise MarkError(f"{name} is empty. A table of holes has the columns x_um, y_um.")
    try:
        rows = list(csv.reader(lines, delimiter=max(",;\t", key=lines[0].count), strict=True))
    except csv.Error as error:
        raise MarkError(f"{name} is no CSV table: {error}. One hole a row, with commas between.") from error
    names = [cell.strip().lower() for cell in rows[0]]
    missing = [column for column in ("x_um", "y_um") if column not in names]
    if missing:
        raise MarkError(
            f"{name} has no column {' and '.join(missing)}; found {', '.join(names)[:120]}. A table of holes has the "
            "columns x_um, y_um."
        )
    wanted = [names.index(column) for column in COLUMNS[1:] if column in names]
    found: list[list[float]] = []
    faults: list[str] = []
    for number, row in enumerate(rows[1:], 2):
        try:
            values = [float(row[column]) for column in wanted]
        except (ValueError, IndexError):
            values = [math.nan]
        if all(map(math.isfinite, values)):
            found.append(values)
        else:
            faults.append(str(number))
    if faults:
        raise MarkError(
            f"{name}: no finite numbers in the rows {', '.join(faults[:_MOST_FAULTS])}. Write numbers in um."
        )
    data = np.array(found, dtype=np.float64).reshape(-1, len(wanted))
    return data[:, :2], data[:, 2] if data.shape[1] > 2 else np.zeros(0)
