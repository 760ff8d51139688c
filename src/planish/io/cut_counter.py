"""The cut counter of serial sections: which picture was cut where, and whether the folder agrees.

The counter is ``sections.csv`` beside the pictures, with the columns ``file`` and ``position_um`` in the order of the
cuts. Lines that start with ``#`` are comments; ``# kind: block-face`` or ``# kind: cut`` says what was photographed.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.io.guard import reading, size_of_file
from planish.io.slices import MOST_NAMES, is_slice_name

COUNTER = "sections.csv"
COLUMNS = ("file", "position_um")
KINDS = ("block-face", "cut")
LARGEST_COUNTER = 10_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Counter:
    """The cut counter: files in the order of the cuts, their positions in um, and the kind of picture."""

    names: list[str]
    positions_um: NDArray[np.float64]
    kind: str

    @property
    def pitch_um(self) -> float:
        """Median step."""
        return float(np.median(np.diff(self.positions_um)))


def read_counter(folder: Path) -> Counter:
    """Read the cut counter of a folder.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Counter

    Raises
    ------
    FileError
        If it cannot be read.
    VolumeError
        If columns are missing, numbers unreadable, names given twice, kinds mixed or positions not increasing.
    """
    lines, comments = counter_lines(folder)
    if not lines:
        raise VolumeError(f"{COUNTER} in {folder.name} is empty. Its first row has to be {','.join(COLUMNS)}.")
    delimiter = max(";,\t", key=lines[0][1].count)
    rows = [(number, next(csv.reader([line], delimiter=delimiter))) for number, line in lines]
    header = [name.strip().lower() for name in rows[0][1]]
    absent = [name for name in COLUMNS if name not in header]
    if absent:
        raise VolumeError(
            f"{COUNTER} in {folder.name} has the columns {', '.join(header)}; {' and '.join(absent)} missing. Its "
            f"first row has to be {','.join(COLUMNS)}."
        )
    names: list[str] = []
    positions: list[float] = []
    faults: list[str] = []
    for number, row in rows[1:]:
        if len(row) != len(header):
            faults.append(f"row {number} has {len(row)} columns, the header {len(header)}")
            continue
        name, text = (row[header.index(column)].strip() for column in COLUMNS)
        position = as_number(text, decimal_comma=delimiter != ",")
        if position is None:
            faults.append(f"row {number}: the position {text!r} is not a number")
        elif not name or Path(name).name != name:
            faults.append(f"row {number}: {name!r} is not the name of a file in this folder")
        elif name in names:
            faults.append(f"row {number}: {name} for the second time")
        else:
            names.append(name)
            positions.append(position)
    if faults:
        more = f"; and {len(faults) - MOST_NAMES} more" if len(faults) > MOST_NAMES else ""
        advice = "" if delimiter != "," else " Decimal commas need semicolons between the columns."
        raise VolumeError(
            f"{COUNTER} in {folder.name}: {'; '.join(faults[:MOST_NAMES])}{more}. Correct these rows.{advice}"
        )
    if len(names) < 2:
        raise VolumeError(f"{COUNTER} in {folder.name} names {len(names)} sections, at least two are needed.")
    for (first, a), (second, b) in pairwise(zip(names, positions, strict=True)):
        if not b > a:
            raise VolumeError(
                f"{COUNTER} in {folder.name}: {second} lies at {b:g} um, {first} before it at {a:g} um. Positions have "
                "to increase in the order of the cuts: correct the counter, or sort its rows by position."
            )
    return Counter(names=names, positions_um=np.array(positions, np.float64), kind=kind_of_sections(comments, folder))


def counter_lines(folder: Path) -> tuple[list[tuple[int, str]], list[str]]:
    """Lines of the counter with their numbers, and its comments without the sign."""
    place = folder / COUNTER
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    if size_of_file(place) > LARGEST_COUNTER:
        raise FileError(f"{COUNTER} in {folder.name} is larger than 10 MB and no cut counter.")
    with reading(place):
        data = place.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{COUNTER} in {folder.name} is no text in UTF-8. Save it as CSV (UTF-8).") from error
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [line.lstrip("#").strip() for _, line in numbered if line.startswith("#")]
    return [(number, line) for number, line in numbered if not line.startswith("#")], comments


def as_number(text: str, *, decimal_comma: bool) -> float | None:
    """Read a finite number, with a decimal comma where that cannot be a delimiter; None where it is none."""
    if decimal_comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def kind_of_sections(comments: list[str], folder: Path) -> str:
    """What was photographed, as the comments say; empty where they do not.

    Raises
    ------
    VolumeError
        If the kind is unknown, or two kinds are mixed: cut sections are squeezed along the cut, block faces are not.
    """
    split = [comment.partition(":") for comment in comments]
    kinds = sorted({value.strip().lower() for key, colon, value in split if colon and key.strip().lower() == "kind"})
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise VolumeError(
            f"{COUNTER} in {folder.name} has the kind {', '.join(map(repr, unknown))}. Known are {' and '.join(KINDS)}."
        )
    if len(kinds) > 1:
        raise VolumeError(
            f"{COUNTER} in {folder.name} has both kinds, {' and '.join(kinds)}. The knife squeezes cut sections by 5 "
            "to 15 % and leaves the block's face as it is: put each kind into a folder of its own."
        )
    return kinds[0] if kinds else ""


def check_folder(folder: Path, counter: Counter) -> None:
    """Refuse a folder whose pictures are not those of the counter.

    Raises
    ------
    VolumeError
        Naming the first few that are missing or too many.
    """
    named = set(counter.names)
    missing = [name for name in counter.names if not (folder / name).is_file()]
    if missing:
        raise VolumeError(
            f"{folder.name} lacks {len(missing)} of {len(named)} files named in {COUNTER}: {some_names(missing)}. Add "
            "them, or take their rows out: a gap in the positions is understood as a missing section."
        )
    odd = sorted(p.name for p in folder.iterdir() if is_slice_name(p.name) and p.is_file() and p.name not in named)
    if odd:
        raise VolumeError(
            f"{folder.name} holds {len(odd)} pictures that {COUNTER} does not name: {some_names(odd)}. Add a row for "
            "each with its position, or move them elsewhere."
        )


def some_names(names: list[str]) -> str:
    """Write the first few names."""
    return ", ".join(names[:MOST_NAMES]) + (", ..." if len(names) > MOST_NAMES else "")
