"""Image or presence map -> laser holes; CSV -> pairs of marks; a field -> a pattern of holes to burn."""

from planish.marks.design import Pattern, check_pattern, design_pattern, own_pattern
from planish.marks.find import Polarity, find_holes
from planish.marks.holes_table import read_holes, write_holes
from planish.marks.in_sheet import Side, find_holes_in_sheet
from planish.marks.table import read_marks, write_marks

__all__ = [
    "Pattern",
    "Polarity",
    "Side",
    "check_pattern",
    "design_pattern",
    "find_holes",
    "find_holes_in_sheet",
    "own_pattern",
    "read_holes",
    "read_marks",
    "write_holes",
    "write_marks",
]
