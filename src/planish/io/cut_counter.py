"""The cut counter of serial sections: which picture was cut where, and whether the folder agrees.

The counter is ``sections.csv`` beside the pictures, with the columns ``file`` and ``position_um`` in the order of the
cuts. Lines that start with ``#`` are comments; ``# kind: block-face`` or ``# kind: cut`` says what was photographed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.tables import Table, parse_table, read_text
from planish.io.guard import size_of_file
from planish.io.slices import is_slice_name, some

COUNTER = "sections.csv"
COLUMNS = ("file", "position_um")
KINDS = ("block-face", "cut")


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
    """Read the cut counter of a folder and compare it with the pictures there.

    Raises
    ------
    FileError
        If it cannot be read.
    VolumeError
        If columns are missing, numbers unreadable, names given twice, kinds mixed or positions not increasing, or a
        picture is missing or not named.
    """
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    size_of_file(folder / COUNTER)
    text = read_text(folder / COUNTER, what="cut counter")
    table = parse_table(text, f"{COUNTER} in {folder.name}", needed=COLUMNS, error=VolumeError)
    names = [table.text(row, "file") for row in table.rows]
    positions = table.numbers(COLUMNS[1:])[:, 0]
    known: set[str] = set()
    for row, name in zip(table.rows, names, strict=True):
        if not name or Path(name).name != name:
            table.fault(row, f"{name!r} is not the name of a file in this folder")
        elif name in known:
            table.fault(row, f"{name} for the second time")
        known.add(name)
    table.check()
    if len(names) < 2:
        raise VolumeError(f"{table.name} names {len(names)} sections, at least two are needed.")
    for (first, a), (second, b) in pairwise(zip(names, positions, strict=True)):
        if not b > a:
            raise VolumeError(
                f"{table.name}: {second} lies at {b:g} um, {first} before it at {a:g} um. Positions have to increase "
                "in the order of the cuts: correct the counter, or sort its rows by position."
            )
    kind = _kind_of_sections(table)
    _check_pictures(folder, names)
    return Counter(names=names, positions_um=positions, kind=kind)


def _kind_of_sections(table: Table) -> str:
    """What was photographed, as the comments say; empty where they do not. Two kinds are never mixed."""
    split = [comment.partition(":") for comment in table.comments]
    kinds = sorted({value.strip().lower() for key, colon, value in split if colon and key.strip().lower() == "kind"})
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise VolumeError(
            f"{table.name} has the kind {', '.join(map(repr, unknown))}. Known are {' and '.join(KINDS)}."
        )
    if len(kinds) > 1:
        raise VolumeError(
            f"{table.name} has both kinds, {' and '.join(kinds)}. The knife squeezes cut sections by 5 to 15 % and "
            "leaves the block's face as it is: put each kind into a folder of its own."
        )
    return kinds[0] if kinds else ""


def _check_pictures(folder: Path, names: list[str]) -> None:
    """Refuse a folder whose pictures are not those of the counter."""
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise VolumeError(
            f"{folder.name} lacks {len(missing)} of {len(names)} files named in {COUNTER}: {some(missing)}. Add "
            "them, or take their rows out: a gap in the positions is understood as a missing section."
        )
    odd = sorted(p.name for p in folder.iterdir() if is_slice_name(p.name) and p.is_file() and p.name not in set(names))
    if odd:
        raise VolumeError(
            f"{folder.name} holds {len(odd)} pictures that {COUNTER} does not name: {some(odd)}. Add a row for "
            "each with its position, or move them elsewhere."
        )
