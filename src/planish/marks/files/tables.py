"""CSV tables with a header: planish's own two, and ImageJ's results of its point tool."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.marks.files.lists import PointList
from planish.marks.files.model import (
    Places,
    about_layer,
    holes_of,
    labels_of,
    layer_names,
    make_marks,
    places_of,
    used_of,
)
from planish.marks.files.text import Rows, check_count, finite, raise_faults
from planish.marks.table import FIXED, MOVING, VOLUME, read_marks, write_marks

_PAIRS = (*MOVING, *VOLUME, *FIXED)
_HOLES = {"diameter_um": "diameter"}


def kind_of_table(rows: Rows) -> str:
    """``pairs``, ``holes`` or ``imagej`` by the names in the header; empty where it is none of them."""
    if not rows:
        return ""
    names = [cell.lower() for cell in rows[0][1]]
    if any(name in names for name in _PAIRS):
        return "pairs"
    if "x_um" in names or "y_um" in names:
        return "holes"
    return "imagej" if {"X", "Y"} <= set(rows[0][1]) else ""


def read_pairs_table(place: Path) -> xr.Dataset:
    """Pairs of the table of :func:`planish.marks.read_marks`, as marks."""
    pairs = read_marks(place)
    sides = {
        side: Places(um=np.stack([pairs[f"{side}_{axis}"].values for axis in axes], axis=1))
        for side, axes in (("moving", "xy"), ("volume", "xyz"), ("fixed", "xy"))
        if f"{side}_x" in pairs
    }
    return make_marks([str(v) for v in pairs["label"].values], sides)


def write_pairs_table(pairs: xr.Dataset, place: Path) -> None:
    """Write pairs as :func:`planish.marks.write_marks` does."""
    write_marks(pairs, place)


def read_points_table(rows: Rows, name: str, kind: str) -> list[PointList]:
    """Points of a table of holes (``x_um``, ``y_um``) or of ImageJ (``X``, ``Y``).

    Raises
    ------
    MarkError
        If a column is missing or a number malformed; the rows are named.
    """
    header = rows[0][1] if kind == "imagej" else [cell.lower() for cell in rows[0][1]]
    wanted = ("X", "Y") if kind == "imagej" else ("x_um", "y_um")
    missing = [column for column in wanted if header.count(column) != 1]
    if missing:
        raise MarkError(
            f"{name} does not have the columns {' and '.join(missing)} once each; found {', '.join(header)[:80]}. Give "
            "a table with one row for each mark."
        )
    check_count(name, len(rows) - 1)
    at = [header.index(column) for column in wanted]
    label_at = header.index("label") if kind == "holes" and "label" in header else None
    extra_at = {_HOLES[c]: header.index(c) for c in _HOLES if c in header} if kind == "holes" else {}
    labels: list[str] = []
    points: list[list[float]] = []
    extras: dict[str, list[float]] = {key: [] for key in extra_at}
    faults: list[str] = []
    for number, row in rows[1:]:
        if len(row) != len(header):
            faults.append(f"row {number} has {len(row)} columns, the header {len(header)}")
            continue
        values = [finite(row[k]) for k in at]
        if None in values:
            faults.append(f"row {number}: {row[at[values.index(None)]]!r} is no finite number")
        points.append([np.nan if v is None else v for v in values])
        labels.append((row[label_at] if label_at is not None else "") or str(len(labels) + 1))
        for key, k in extra_at.items():
            value = finite(row[k])
            extras[key].append(np.nan if value is None else value)
    raise_faults(name, faults, "Correct these rows.")
    if not points:
        raise MarkError(f"{name} has a header and no mark. One row for each is needed.")
    return [
        PointList(
            title=name, labels=labels, points=np.array(points, dtype=np.float64), used=[True] * len(labels), unit="um",
            stated=kind == "holes", placed=kind == "holes", extras={key: np.array(v) for key, v in extras.items()},
            source="clicked" if kind == "imagej" else "imported",
        )
    ]  # fmt: skip


def holes_text(marks: xr.Dataset) -> str:
    """Text of a table of holes for marks of one layer.

    Raises
    ------
    MarkError
        If there are several layers.
    """
    (layer, *more) = layer_names(marks) or [""]
    if more or not layer:
        raise MarkError("A table of holes holds one layer; these marks have several, or none. Write them as pairs.")
    holes = holes_of(marks, layer)
    columns = ["x", "y", *(["diameter"] if "diameter" in holes else [])]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["label", *(f"{c}_um" for c in columns)])
    for k, label in enumerate(labels_of(holes)):
        writer.writerow([label, *(repr(float(holes[c].values[k])) for c in columns)])
    return text.getvalue()


def single_list(marks: xr.Dataset, name: str) -> PointList:
    """Marks of one layer as a list, to be joined with another.

    Raises
    ------
    MarkError
        If there are several layers.
    """
    names = layer_names(marks)
    if len(names) != 1:
        raise MarkError(
            f"{name} already holds the layers {', '.join(names)}. Give it alone, or two files with one each."
        )
    places = places_of(marks, names[0])
    return PointList(
        title=name, labels=labels_of(marks), points=places.um, used=[bool(v) for v in used_of(marks)], unit="um",
        stated=True, placed=True, extras=places.extras, source=places.source, about=about_layer(marks, names[0]),
    )  # fmt: skip
