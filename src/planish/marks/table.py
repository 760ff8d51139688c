"""Pairs of marks as a CSV table, one pair a row, lengths in um.

The first side is given in one of two frames, which the header names: ``moving_x_um, moving_y_um`` on the flattened map,
or ``volume_x_um, volume_y_um, volume_z_um`` in the volume. The second side, ``fixed_x_um, fixed_y_um``, is the image.
"""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import FileError, MarkError

MOVING = ("moving_x_um", "moving_y_um")
VOLUME = ("volume_x_um", "volume_y_um", "volume_z_um")
FIXED = ("fixed_x_um", "fixed_y_um")
RESULTS = ("residual_um", "leave_one_out_um", "weight", "used")
LARGEST_FILE = 10_000_000
MOST_FAULTS = 8

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
    place = Path(path)
    lines = _lines(place)
    if not lines:
        raise MarkError(f"{place.name} is empty. Its first row has to be {','.join(('label', *MOVING, *FIXED))}.")
    (_, header), *rows = lines
    names = [name.strip().lower() for name in header]
    first = _first_side(place.name, names)
    wanted = (*first, *FIXED)
    columns = {name: names.index(name) for name in wanted}
    label_at = names.index("label") if "label" in names else None
    used_at = names.index("used") if "used" in names else None
    labels: list[str] = []
    values: list[list[float]] = []
    numbers: list[int] = []
    faults: list[str] = []
    for number, row in rows:
        if len(row) != len(names):
            faults.append(f"row {number} has {len(row)} columns, the header {len(names)}")
            continue
        if used_at is not None and row[used_at].strip().lower() in ("0", "0.0", "false", "no"):
            continue
        numeric = [_number(row[columns[name]]) for name in wanted]
        bad = [f"{name} {row[columns[name]]!r}" for name, value in zip(wanted, numeric, strict=True) if value is None]
        if bad:
            faults.append(f"row {number}: {', '.join(bad)} is not a finite number")
            continue
        labels.append(row[label_at].strip() if label_at is not None else str(len(labels) + 1))
        values.append([value for value in numeric if value is not None])
        numbers.append(number)
    faults += _duplicates(labels, values, numbers, len(first))
    if faults:
        more = f"; and {len(faults) - MOST_FAULTS} more" if len(faults) > MOST_FAULTS else ""
        raise MarkError(f"{place.name}: {'; '.join(faults[:MOST_FAULTS])}{more}. Correct these rows.")
    if not values:
        raise MarkError(f"{place.name} has a header and no pair of marks. At least 3 rows are needed.")
    table = np.array(values, dtype=np.float64)
    data = {name.removesuffix("_um"): table[:, column] for column, name in enumerate(wanted)}
    return _dataset(labels, data)


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
    held = {str(name).removesuffix("_um"): variable for name, variable in dataset.variables.items()}
    first = next((side for side in (MOVING, VOLUME) if all(name.removesuffix("_um") in held for name in side)), None)
    if first is None or any(name.removesuffix("_um") not in held for name in FIXED):
        raise MarkError(
            f"The marks hold {', '.join(sorted(held)) or 'nothing'}; fixed_x, fixed_y and either moving_x, moving_y or "
            "volume_x, volume_y, volume_z are needed."
        )
    names = ["label", *first, *FIXED, *(name for name in RESULTS if name.removesuffix("_um") in held)]
    count = dataset.sizes.get("mark", 0)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in range(count):
        cells: list[str] = []
        for name in names:
            key = name.removesuffix("_um")
            value = held[key].values[row] if key in held else row + 1
            cells.append(str(value) if key == "label" else str(int(value)) if key == "used" else repr(float(value)))
        writer.writerow(cells)
    Path(path).write_text(text.getvalue(), encoding="utf-8", newline="\n")


def _lines(place: Path) -> list[tuple[int, list[str]]]:
    """Rows with their line numbers, without comments and empty lines."""
    try:
        if place.stat().st_size > LARGEST_FILE:
            raise MarkError(f"{place.name} is larger than {LARGEST_FILE // 1_000_000} MB and no table of marks.")
        text = place.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise FileError(f"{place} cannot be read: {error.strerror or error}. Check the path.") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{place} is no text in UTF-8. Save the table as CSV (UTF-8).") from error
    lines = text.splitlines()
    numbered = enumerate(lines, 1)
    used = [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    if not used:
        return []
    delimiter = max(",;\t", key=used[0][1].count)
    try:
        parsed = list(csv.reader([line for _, line in used], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise MarkError(f"{place.name} is no CSV table: {error}. One pair a row, with commas between.") from error
    if len(parsed) != len(used):
        raise MarkError(f"{place.name} has quoted text over several lines. One pair a row is needed.")
    return [(number, row) for (number, _), row in zip(used, parsed, strict=True)]


def _first_side(file: str, names: list[str]) -> tuple[str, ...]:
    """Which frame the first side is given in, with every fault of the header in one message."""
    faults: list[str] = []
    repeated = sorted({name for name in names if names.count(name) > 1 and name})
    if repeated:
        faults.append(f"columns given twice: {', '.join(repeated)}")
    some = [side for side in (MOVING, VOLUME) if any(name in names for name in side)]
    if len(some) == 2:
        faults.append("both moving and volume columns are there; keep one kind")
    side = some[0] if some else MOVING
    missing = [name for name in (*side, *FIXED) if name not in names]
    if missing:
        faults.append(f"columns missing: {', '.join(missing)}")
    if faults:
        raise MarkError(
            f"{file}: {'; '.join(faults)}. Found {', '.join(names)}. Needed: label, then {', '.join(MOVING)} or "
            f"{', '.join(VOLUME)}, then {', '.join(FIXED)}, all in um."
        )
    return side


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _duplicates(labels: list[str], values: list[list[float]], numbers: list[int], split: int) -> list[str]:
    faults: list[str] = []
    keys = {
        "label": [label or None for label in labels],
        "first position": [tuple(row[:split]) for row in values],
        "fixed position": [tuple(row[split:]) for row in values],
    }
    for what, entries in keys.items():
        seen: dict[object, int] = {}
        for number, entry in zip(numbers, entries, strict=True):
            if entry is None:
                continue
            if entry in seen:
                faults.append(f"rows {seen[entry]} and {number} have the same {what}")
            seen.setdefault(entry, number)
    return faults


def _dataset(labels: list[str], data: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]) -> xr.Dataset:
    variables: dict[str, tuple[str, object, dict[str, str]]] = {
        name: ("mark", values, {"units": "um", "long_name": LONG_NAMES[name]}) for name, values in data.items()
    }
    variables["label"] = ("mark", np.array(labels, dtype=np.str_), {"long_name": "Name of the mark"})
    return xr.Dataset(variables)
