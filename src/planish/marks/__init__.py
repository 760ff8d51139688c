"""Image or presence map -> laser holes; CSV -> pairs of marks."""

from planish.marks.find import Polarity, find_holes
from planish.marks.holes_table import read_holes, write_holes
from planish.marks.table import read_marks, write_marks

__all__ = ["Polarity", "find_holes", "read_holes", "read_marks", "write_holes", "write_marks"]
