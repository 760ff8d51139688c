"""planish's own tables: pairs of marks (see :mod:`planish.marks.table`), and holes of one layer."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.tables import parse_table, table_text
from planish.marks.files.content import Content, check_count
from planish.marks.files.formats import Outgoing
from planish.marks.files.lists import PointList
from planish.marks.files.model import Places, holes_of, labels_of, layer_names, make_marks, used_pairs
from planish.marks.table import FIXED, MOVING, VOLUME, pairs_of_text, pairs_text

_HOLE_COLUMNS = ("x_um", "y_um")


def looks_like(content: Content) -> bool:
    """Whether the header names a column of pairs or of holes."""
    return any(name.lower() in (*MOVING, *VOLUME, *FIXED, *_HOLE_COLUMNS) for name in content.header)


def read(content: Content) -> xr.Dataset | list[PointList]:
    """Read pairs as marks, or the holes of one layer."""
    names = [name.lower() for name in content.header]
    if not any(name in names for name in (*MOVING, *VOLUME, *FIXED)):
        return [read_points(content, _HOLE_COLUMNS, stated=True, source="imported")]
    pairs = pairs_of_text(content.text, content.name)
    sides = {
        side: Places(um=np.stack([pairs[f"{side}_{axis}"].values for axis in axes], axis=1))
        for side, axes in (("moving", "xy"), ("volume", "xyz"), ("fixed", "xy"))
        if f"{side}_x" in pairs
    }
    return make_marks([str(v) for v in pairs["label"].values], sides)


def write(out: Outgoing) -> dict[str, bytes]:
    """Write pairs in use, or the holes of the only layer."""
    names = layer_names(out.marks)
    if len(names) != 1:
        return {"": pairs_text(used_pairs(out.marks, least=1, name="This set of marks")).encode()}
    holes = holes_of(out.marks, names[0])
    columns = [name for name in ("x", "y", "diameter") if name in holes]
    rows = zip(labels_of(holes), *(holes[name].values for name in columns), strict=True)
    return {"": table_text(["label", *(f"{name}_um" for name in columns)], list(rows)).encode()}


def read_points(content: Content, columns: tuple[str, str], *, stated: bool, source: str) -> PointList:
    """Read the points of a table with a header; lengths in um where it states so."""
    advice = f"Give a table with the columns {' and '.join(columns)} and one row for each mark."
    table = parse_table(content.text, content.name, needed=columns, error=MarkError, advice=advice)
    check_count(content.name, len(table.rows))
    points = table.numbers(columns)
    diameters = [table.text(row, "diameter_um") and table.number(row, "diameter_um") for row in table.rows]
    table.check()
    if not len(points):
        raise MarkError(f"{content.name} has a header and no mark. One row for each is needed.")
    named = "label" in table.header and stated
    return PointList(
        title=content.name, points=points, unit="um", stated=stated, placed=stated, source=source,
        used=[True] * len(points),
        labels=[(table.text(row, "label") if named else "") or str(k) for k, row in enumerate(table.rows, 1)],
        extras={"diameter": np.array([v or np.nan for v in diameters], dtype=np.float64)},
    )  # fmt: skip
