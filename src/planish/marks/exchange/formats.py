"""List the formats of marks, each by one entry in one table and one module.

The module reads, writes and recognises the format.

The module of a format ``x`` is ``x_marks.py`` with the functions

- ``looks_like(content)``: whether a file is of this format;
- ``read(content)``: marks in um, or one or two lists of points in the unit of the file;
- ``write(marks, points)``, where it is written: bytes of the files, by what is put before the
  suffix of their name. ``points`` are positions (n, 2) or (n, 3) in the unit of the file from the
  centre of the first pixel, NaN where a mark is not in the layer, by role (``moving``, ``fixed``)
  or name of the only layer; empty for planish's own formats.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from planish.core.errors import FileError

Unit = Literal["um", "mm", "pixel"]
"""Unit of the positions in a file of marks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkFormat:
    """A format of marks.

    ``title`` is its name in messages, ``known_by`` that in the list of known formats, ``row`` its
    row of the table in ``docs/marks-files.md``: format, what it holds, unit, first pixel's centre,
    direction, what is kept when it is written. ``suffixes`` ask for it. It is written in ``unit``
    (None for planish's own, which keep the layer's origin), or in another with ``free_unit``.
    ``pairs_only``: it holds only marks that are used and lie in both layers; ``single``: one layer
    alone may be written. ``in_space``: positions hold the place that the picture states, as a NRRD
    does and a TIFF does not.
    """

    title: str
    known_by: str
    row: tuple[str, str, str, str, str, str]
    suffixes: tuple[str, ...] = ()
    unit: Unit | None = None
    free_unit: bool = False
    pairs_only: bool = False
    single: bool = False
    writable: bool = True
    in_space: bool = False


FORMATS: dict[str, MarkFormat] = {
    "matlab": MarkFormat(
        title="MATLAB",
        known_by="MATLAB .mat with movingPoints and fixedPoints",
        suffixes=(".mat",),
        unit="pixel",
        pairs_only=True,
        row=(
            "MATLAB (`.mat`)",
            "`movingPoints`, `fixedPoints`",
            "pixels",
            "**1**",
            "by name",
            "pairs in use, in order",
        ),
    ),
    "json": MarkFormat(
        title="planish JSON",
        known_by="planish JSON",
        suffixes=(".json",),
        row=(
            "planish JSON (`.json`)",
            "any layers",
            "um",
            "the layer's origin",
            "by name",
            "everything",
        ),
    ),
    "slicer": MarkFormat(
        title="3D Slicer",
        known_by="3D Slicer .mrk.json",
        suffixes=(".mrk.json",),
        unit="mm",
        single=True,
        in_space=True,
        row=(
            "3D Slicer (`.mrk.json`)",
            "point lists",
            "mm or um, as stated",
            "0",
            (
                "lists called moving, from or source, and fixed, to or target; otherwise the first"
                " is moving"
            ),
            "all marks; `selected`; `positionStatus`",
        ),
    ),
    "bigwarp": MarkFormat(
        title="BigWarp",
        known_by="BigWarp CSV",
        unit="um",
        free_unit=True,
        row=(
            "BigWarp CSV, and its JSON (read only)",
            "moving, target",
            "that of the images in Fiji; um unless `--unit` says mm or pixel",
            "0",
            "moving first, then target",
            "all marks; `active`; `Infinity` where there is no position",
        ),
    ),
    "elastix": MarkFormat(
        title="elastix points",
        known_by="elastix points",
        suffixes=(".txt", ".pts"),
        unit="mm",
        free_unit=True,
        pairs_only=True,
        single=True,
        in_space=True,
        row=(
            "elastix, transformix points (`.txt`)",
            "one layer a file",
            (
                "`point`: that of the image's space, mm unless `--unit` says otherwise; `index`:"
                " pixels"
            ),
            "0",
            "`-mp` moving, `-fp` fixed",
            "pairs in use, in order, as `point`",
        ),
    ),
    "csv": MarkFormat(
        title="planish table",
        known_by="planish CSV",
        suffixes=(".csv",),
        row=(
            "planish CSV (`.csv`)",
            "moving or volume, fixed; or holes of one layer",
            "um",
            "the layer's origin",
            "by name",
            "pairs in use, labels; of holes labels and diameter",
        ),
    ),
    "columns": MarkFormat(
        title="A table with X and Y",
        known_by=(
            "tables with a row of headings (moving_x_um, moving_y_um, fixed_x_um, fixed_y_um; X"
            " and Y of ImageJ; those of napari, QuPath, CellProfiler, TrackMate)"
        ),
        unit="um",
        writable=False,
        row=(
            "[tables of other programs](#which-columns-a-table-needs) (read only)",
            "one layer, or pairs",
            "that of the headings or of the program",
            "0; QuPath 0.5; MATLAB 1",
            "by name",
            "",
        ),
    ),
    "roi": MarkFormat(
        title="ImageJ selections",
        known_by="points of ImageJ (.roi, .zip)",
        suffixes=(".roi", ".zip"),
        unit="pixel",
        writable=False,
        row=(
            "ImageJ points (`.roi`, `.zip` of the ROI Manager; read only)",
            "one layer",
            "pixels",
            "0",
            "",
            "",
        ),
    ),
}
"""Formats of marks by name, in the order in which a file is compared with them."""

TARGETS = tuple(name for name, form in FORMATS.items() if form.writable)


def module_of(name: str) -> Any:
    """Import the module of a format."""
    return importlib.import_module(f"planish.marks.exchange.{name}_marks")


def target_of(path: str | Path) -> str:
    """Return the format that a suffix asks for.

    ``.mrk.json`` Slicer, ``.json`` planish, ``.txt`` elastix ...

    Raises
    ------
    FileError
        If the name tells no format.
    """
    name = Path(path).name
    by_suffix = {suffix: key for key in TARGETS for suffix in FORMATS[key].suffixes}
    suffixes = [suffix for suffix in by_suffix if name.lower().endswith(suffix)]
    if not suffixes:
        raise FileError(f"{name} does not tell its format. Give `to={', '.join(TARGETS)}`.")
    return by_suffix[max(suffixes, key=len)]


def known_formats() -> str:
    """Name what can be read, in a sentence's end."""
    *most, last = (form.known_by for form in FORMATS.values())
    return f"{', '.join(most)}, and {last}"


def formats_table() -> str:
    """Write the table of ``docs/marks-files.md``."""
    head = ("Format", "Holds", "Unit", "First pixel's centre", "Direction", "Kept when written")
    rows = [head, ("---",) * len(head), *(form.row for form in FORMATS.values())]
    return "".join(f"| {' | '.join(row)} |\n".replace("|  |", "| |") for row in rows)
