"""Holes of one map as a CSV table, one hole a row, lengths in um."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import FileError, MarkError

_COLUMNS = ("x", "y", "diameter")


def write_holes(holes: xr.Dataset, path: str | Path) -> None:
    """Write ``label, x_um, y_um, diameter_um`` of holes as :func:`planish.marks.find_holes` gives them."""
    with Path(path).open("x", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["label", *(f"{name}_um" for name in _COLUMNS)])
        for k in range(holes.sizes["mark"]):
            table.writerow([f"hole {k + 1}", *(repr(float(holes[name].values[k])) for name in _COLUMNS)])


def read_holes(path: str | Path) -> xr.Dataset:
    """Read positions ``x_um, y_um`` of holes; other columns are passed over.

    Raises
    ------
    FileError
        If the file cannot be read.
    MarkError
        If a column is missing or a number is malformed; the message names the rows.
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"{path} cannot be read as a table: {error}. Give a CSV file with the columns x_um, y_um."
        ) from error
    missing = [name for name in ("x_um", "y_um") if rows and name not in rows[0]]
    if missing or not rows:
        lacks = " and ".join(missing) or "rows"
        raise MarkError(f"{path} holds no {lacks}. A table of holes has the columns x_um, y_um.")
    points, faults = [], []
    for number, row in enumerate(rows, start=2):
        try:
            point = float(row["x_um"]), float(row["y_um"])
        except (TypeError, ValueError):
            point = (math.nan, math.nan)
        if not all(map(math.isfinite, point)):
            faults.append(str(number))
        points.append(point)
    if faults:
        raise MarkError(f"{path}: no finite x_um and y_um in the rows {', '.join(faults[:8])}. Write numbers in um.")
    data = np.array(points)
    return xr.Dataset({"x": ("mark", data[:, 0], {"units": "um"}), "y": ("mark", data[:, 1], {"units": "um"})})
