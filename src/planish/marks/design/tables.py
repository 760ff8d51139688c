"""Holes of a pattern as a CSV table, and patterns that others give as such a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from planish.core.errors import MarkError
from planish.core.tables import parse_table, read_text, table_text
from planish.marks.design.pattern import Burn, Pattern, own_pattern

COLUMNS = ("label", "x_um", "y_um", "diameter_um")


def holes_csv(pattern: Pattern, *, imaged: bool = False) -> str:
    """Write ``label,x_um,y_um,diameter_um``, a hole a row.

    Parameters
    ----------
    imaged : bool
        Positions as an image of the laser's side shows them, from its upper left corner with y down, instead of
        those of the stage.
    """
    rows = [
        [label, *(f"{value:.6f}".rstrip("0").rstrip(".") for value in (x, y, pattern.burn.diameter_um))]
        for label, (x, y) in zip(pattern.labels, pattern.imaged_um if imaged else pattern.points_um, strict=True)
    ]
    return table_text(COLUMNS, rows)


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
    text = read_text(place, what="pattern")
    if text.lstrip().startswith("{"):
        if field_um is not None or diameter_um is not None:
            raise MarkError(
                f"{place.name} states its field and diameter itself; they can be given for a CSV table only."
            )
        return Pattern.from_json(text)
    table = parse_table(text, place.name, needed=COLUMNS[1:3], error=MarkError)
    points = table.numbers(COLUMNS[1:3])
    diameters = table.numbers(COLUMNS[3:]) if COLUMNS[3] in table.header else np.empty(0)
    table.check()
    burn = Burn()
    if diameter_um is not None or diameters.size:
        chosen = diameter_um if diameter_um is not None else float(np.median(diameters))
        if not 10 <= chosen <= 2000:
            raise MarkError(f"{place.name}: a diameter of {chosen:g} um; 10 to 2000 um are possible.")
        burn = replace(burn, diameter_um=chosen)
    return own_pattern(points, name=place.stem, field_um=field_um, burn=burn)
