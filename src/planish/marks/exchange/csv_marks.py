"""planish's own tables, lengths in um: pairs of marks, and holes of one layer.

The first side of a pair is given in one of two frames, which the header names: ``moving_x_um,
moving_y_um`` on the flattened map, or ``volume_x_um, volume_y_um, volume_z_um`` in the volume. The
second side, ``fixed_x_um, fixed_y_um``, is the image. Rows whose ``used`` is 0 or false are left
out.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.files import write_whole
from planish.core.tables import CsvTable, heading_of, parse_table, table_text
from planish.core.typing import Floats
from planish.marks.exchange.lists import Content, PointList
from planish.marks.exchange.model import (
    MarkPlaces,
    holes_of,
    labels_of,
    layer_names,
    make_marks,
    used_pairs,
)

_SIDES = {
    "moving": ("moving_x_um", "moving_y_um"),
    "volume": ("volume_x_um", "volume_y_um", "volume_z_um"),
    "fixed": ("fixed_x_um", "fixed_y_um"),
}
_TYPES: dict[str, Callable[[Any], float]] = {"used": int}  # others are numbers
# What stands in ``used``, also where a spreadsheet in another language has saved it.
NO_WORDS = ("0", "0.0", "false", "no", "falsch", "nein", "faux", "non", "falso")
YES_WORDS = ("", "1", "1.0", "true", "yes", "wahr", "ja", "vrai", "oui", "vero", "verdadero")


def looks_like(content: Content) -> bool:
    """Return whether the header names a column of pairs or of holes, and states no other unit."""
    columns = {"x_um", "y_um"}.union(*_SIDES.values())
    headings = [heading_of(cell) for cell in content.header]
    names = [f"{heading.name}_um" for heading in headings if heading.unit not in ("", "um")]
    is_named = any(name.lower() in columns for name in content.header)
    return is_named and not columns.intersection(names)


def read(content: Content) -> xr.Dataset | list[PointList]:
    """Read pairs as marks, or the holes of one layer.

    A dataset of the layers moving or volume, and fixed, or a list of points where only ``x_um,
    y_um`` are there. MarkError where columns or rows are missing or malformed.
    """
    names = {name.lower() for name in content.header}
    sides = [side for side, columns in _SIDES.items() if names.intersection(columns)]
    if not sides:
        return [_read_holes(content)]
    first = "volume" if sides[0] == "volume" else "moving"
    moving_text, volume_text, fixed_text = map(", ".join, _SIDES.values())
    advice = f"Needed: label, then {moving_text} or {volume_text}, then {fixed_text}, all in um."
    needed = (*_SIDES[first], *_SIDES["fixed"])
    table = parse_table(content.text, content.name, needed=needed, error=MarkError, advice=advice)
    if "moving" in sides and "volume" in sides:
        table.faults.append("both moving and volume columns are there; keep one kind")
    rows_in_use(table)
    places: dict[str, MarkPlaces] = {}
    for side in (first, "fixed"):
        places[side] = MarkPlaces(um=table.numbers(_SIDES[side]))
    check_rows(table, "pair of marks. At least 3 rows are needed.")
    return make_marks(labels_in(table), places)


def write(marks: xr.Dataset, _points: dict[str, Floats]) -> dict[str, bytes]:
    """Write pairs in use, or the holes of the only layer."""
    names = layer_names(marks)
    if len(names) != 1:
        return {"": pairs_text(used_pairs(marks, least=1, name="This set of marks")).encode()}
    holes = holes_of(marks, names[0])
    return {"": holes_text(holes, labels_of(holes)).encode()}


def holes_text(holes: xr.Dataset, labels: Sequence[str]) -> str:
    """Write the table of holes."""
    names = filter(holes.__contains__, ("x", "y", "diameter"))
    columns = {f"{name}_um": holes[name].values for name in names}
    rows = zip(labels, *columns.values(), strict=True)
    return table_text(["label", *columns], rows)


def write_marks(dataset: xr.Dataset, path: str | Path) -> None:
    """Write pairs of marks as a CSV file that `read_any` reads back to the same numbers.

    Parameters
    ----------
    dataset : Dataset, dims (mark), in um
        ``moving_x, moving_y`` (or ``volume_x, volume_y, volume_z``), ``fixed_x, fixed_y``;
        optionally ``label``, ``residual``, ``leave_one_out``, ``weight`` and ``used``, under these
        names or with ``_um`` at the end.
    path : str or Path

    Raises
    ------
    FileError
        If the file is there already or cannot be written.
    MarkError
        If a variable is missing.
    """
    write_whole(Path(path), pairs_text(dataset).encode())


def pairs_text(dataset: xr.Dataset) -> str:
    """Write the table of pairs; see :func:`write_marks`.

    Only the columns that the dataset has are written; the positions of both sides have to be there.
    """
    variables = {f"{name}".removesuffix("_um"): v for name, v in dataset.variables.items()}
    named = {f"{name}_um" for name in variables}
    sides = [side for side, names in _SIDES.items() if named.issuperset(names)]
    if len(sides) < 2 or sides[-1] != "fixed":
        raise MarkError(
            f"The marks hold {', '.join(sorted(variables)) or 'nothing'}; fixed_x, fixed_y and"
            " either moving_x, moving_y or volume_x, volume_y, volume_z are needed."
        )
    columns: dict[str, Iterable[Any]] = {"label": labels_of(dataset)}
    positions = (*_SIDES[sides[0]], *_SIDES["fixed"])
    for name in (*positions, "residual_um", "leave_one_out_um", "weight", "used"):
        key = name.removesuffix("_um")
        if key in variables:
            columns[name] = map(_TYPES.get(key, float), variables[key].values)
    return table_text(list(columns), zip(*columns.values(), strict=True))


def _read_holes(content: Content) -> PointList:
    """Read a table of holes as a list of points with diameters."""
    table, points, diameters = table_of_holes(content.text, content.name)
    return PointList(
        title=content.name,
        points=points,
        unit="um",
        placed=True,
        labels=labels_in(table),
        extras={"diameter": diameters},
    )


def table_of_holes(text: str, name: str, *, kind: str = "mark") -> tuple[CsvTable, Floats, Floats]:
    """Read a table of holes: its places (n, 2), and diameters, NaN where there is none, in um.

    Rows whose ``used`` says no are left out. ``kind`` is the word for a row in a message.
    """
    needed = ("x_um", "y_um")
    diameter = "diameter_um"
    table = parse_table(text, name, needed=needed, optional=(diameter,), error=MarkError)
    rows_in_use(table)
    points = table.numbers(needed)
    diameters: list[float | None] = []
    for row in table.rows:
        is_stated = bool(table.text(row, diameter))
        diameters.append(table.number(row, diameter) if is_stated else np.nan)
    check_rows(table, f"{kind}. One row for each is needed.")
    return table, points, np.array(diameters, dtype=np.float64)


def check_rows(table: CsvTable, needed: str = "mark. One row for each is needed.") -> None:
    """Raise the faults of a table, or that it has no row."""
    table.check()
    if not table.rows:
        raise MarkError(f"{table.name} has a header and no {needed}")


def rows_in_use(table: CsvTable) -> None:
    """Leave out the rows of a table whose ``used`` says no; another word is a fault of the row."""
    rows_used = [row for row in table.rows if table.text(row, "used").casefold() not in NO_WORDS]
    for row in rows_used:
        word = table.text(row, "used")
        if word.casefold() not in YES_WORDS:
            table.fault(row, f"used is {word!r}, which is neither yes nor no")
    table.rows[:] = rows_used


def labels_in(table: CsvTable, *, unique: bool = False) -> list[str]:
    """Return the labels of the rows, or their numbers.

    With ``unique`` labels that are there twice are none: they name the picture.
    """
    column = "Label" if "Label" in table.header else "label"
    labels = [table.text(row, column, str(k)) for k, row in enumerate(table.rows, 1)]
    if unique and len(set(labels)) < len(labels):
        return [str(k) for k, _ in enumerate(table.rows, 1)]
    return labels
