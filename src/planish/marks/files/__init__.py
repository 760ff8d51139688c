"""Marks in files: planish's own JSON and tables, BigWarp, elastix, 3D Slicer, MATLAB and ImageJ."""

from planish.marks.files.door import TITLES, Format, format_of, read_any, read_pairs
from planish.marks.files.lists import Unit
from planish.marks.files.model import (
    Places,
    about_layer,
    holes_of,
    layer_names,
    make_marks,
    marks_of_holes,
    used_pairs,
)
from planish.marks.files.write import Target, target_of, write_any

__all__ = [
    "TITLES",
    "Format",
    "Places",
    "Target",
    "Unit",
    "about_layer",
    "format_of",
    "holes_of",
    "layer_names",
    "make_marks",
    "marks_of_holes",
    "read_any",
    "read_pairs",
    "target_of",
    "used_pairs",
    "write_any",
]
