"""Pairs of marks as a CSV table, one pair a row, lengths in um.

The first side is given in one of two frames, which the header names: ``moving_x_um, moving_y_um`` on the flattened map,
or ``volume_x_um, volume_y_um, volume_z_um`` in the volume. The second side, ``fixed_x_um, fixed_y_um``, is the image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import MarkError
from planish.core.tables import parse_table, read_text, split_rows, table_text

Floats = NDArray[np.float64]

MOVING = ("moving_x_um", "moving_y_um")
VOLUME = ("volume_x_um", "volume_y_um", "volume_z_um")
FIXED = ("fixed_x_um", "fixed_y_um")
RESULTS = ("residual_um", "leave_one_out_um", "weight", "used")

LONG_NAMES = {
    "moving_x": "Mark on the flattened map, x",
    "moving_y": "Mark on the flattened map, y",
    "volume_x": "Mark in the volume, x",
    "volume_y": "Mark in the volume, y",
    "volume_z": "Mark in the volume, z",
    "fixed_x": "Mark in the image, x",
    "fixed_y": "Mark in the image, y",
    "residual": "Distance left by the fit",
    "leave_one_out": "Distance left by the fit to all other marks",
}


def read_marks(path: str | Path) -> xr.Dataset:
    """Read pairs of marks from a CSV file.

    Parameters
    ----------
    path : str or Path
        Header ``label, moving_x_um, moving_y_um, fixed_x_um, fixed_y_um``, or ``volume_x_um, volume_y_um, volume_z_um``
        in place of the moving columns; columns in any order, ``label`` may be missing, other columns are passed over.
        Rows whose ``used`` is 0 or false are left out. Lines that start with ``#`` are comments.

    Returns
    -------
    Dataset, dims (mark)
        ``label`` and ``fixed_x, fixed_y`` with either ``moving_x, moving_y`` or ``volume_x, volume_y,
        volume_z``, in um.

    Raises
    ------
    FileError
        If the file cannot be read.
    MarkError
        If columns are missing or rows are malformed; the message names the rows.
    """
    return pairs_of_text(read_text(path, what="table of marks"), Path(path).name)


def pairs_of_text(text: str, name: str) -> xr.Dataset:
    """Pairs of the text of a table; see :func:`read_marks`."""
    header = [cell.lower() for row in split_rows(text).rows[:1] for cell in row.cells]
    kinds = [side for side in (MOVING, VOLUME) if any(column in header for column in side)]
    first = kinds[0] if kinds else MOVING
    columns = (*first, *FIXED)
    advice = f"Needed: label, then {', '.join(MOVING)} or {', '.join(VOLUME)}, then {', '.join(FIXED)}, all in um."
    table = parse_table(text, name, needed=columns, error=MarkError, advice=advice)
    if len(kinds) == 2:
        table.faults.append("both moving and volume columns are there; keep one kind")
    rows = [row for row in table.rows if table.text(row, "used").lower() not in ("0", "0.0", "false", "no")]
    table.rows[:] = rows
    values = table.numbers(columns)
    labels = [table.text(row, "label") if "label" in table.header else str(k) for k, row in enumerate(rows, 1)]
    good = np.flatnonzero(np.isfinite(values).all(axis=1))
    table.faults += _repeated([labels[k] for k in good], values[good], [rows[k].line for k in good], len(first))
    table.check()
    if not rows:
        raise MarkError(f"{name} has a header and no pair of marks. At least 3 rows are needed.")
    data: dict[str, Any] = {
        key: ("mark", column, {"units": "um", "long_name": LONG_NAMES[key]})
        for key, column in zip((one.removesuffix("_um") for one in columns), values.T.copy(), strict=True)
    }
    return xr.Dataset(data | {"label": ("mark", np.array(labels, dtype=np.str_), {"long_name": "Name of the mark"})})


def write_marks(dataset: xr.Dataset, path: str | Path) -> None:
    """Write pairs of marks as a CSV file that `read_marks` reads back to the same numbers.

    Parameters
    ----------
    dataset : Dataset, dims (mark), in um
        ``moving_x, moving_y`` (or ``volume_x, volume_y, volume_z``), ``fixed_x, fixed_y``; optionally ``label``,
        ``residual``, ``leave_one_out``, ``weight`` and ``used``, under these names or with ``_um`` at the end.
    path : str or Path

    Raises
    ------
    OSError
        If the file cannot be written.
    MarkError
        If a variable is missing.
    """
    Path(path).write_text(pairs_text(dataset), encoding="utf-8", newline="\n")


def pairs_text(dataset: xr.Dataset) -> str:
    """Text of the table of pairs; see :func:`write_marks`."""
    held = {str(name).removesuffix("_um"): variable for name, variable in dataset.variables.items()}
    first = next((side for side in (MOVING, VOLUME) if all(name.removesuffix("_um") in held for name in side)), None)
    if first is None or any(name.removesuffix("_um") not in held for name in FIXED):
        raise MarkError(
            f"The marks hold {', '.join(sorted(held)) or 'nothing'}; fixed_x, fixed_y and either moving_x, moving_y or "
            "volume_x, volume_y, volume_z are needed."
        )
    names = ["label", *first, *FIXED, *(name for name in RESULTS if name.removesuffix("_um") in held)]
    made = {"label": str, "used": int}
    numbers = range(1, dataset.sizes.get("mark", 0) + 1)
    keys = [name.removesuffix("_um") for name in names]
    rows = zip(*(map(made.get(key, float), held[key].values if key in held else numbers) for key in keys), strict=True)
    return table_text(names, list(rows))


def _repeated(labels: list[str], values: Floats, lines: list[int], split: int) -> list[str]:
    faults: list[str] = []
    keys: dict[str, list[Any]] = {
        "label": [label or None for label in labels],
        "first position": [tuple(row) for row in values[:, :split].tolist()],
        "fixed position": [tuple(row) for row in values[:, split:].tolist()],
    }
    for what, entries in keys.items():
        first: dict[object, int] = {}
        for line, entry in zip(lines, entries, strict=True):
            if entry is not None and first.setdefault(entry, line) != line:
                faults.append(f"rows {first[entry]} and {line} have the same {what}")
    return faults
