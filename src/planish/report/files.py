"""The figures of a page as files: each as SVG that stands alone, and what it shows as numbers as CSV."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from html import escape
from pathlib import Path

from planish.core.files import write_whole
from planish.core.tables import table_text
from planish.report.draw import Picture

FIGURES = "figures"
"""Folder of the figures in a run, or beside a page."""

_LONGEST = 50  # letters of a title in the name of a file


def write_figures(folder: Path, pictures: Sequence[Picture]) -> None:
    """Write figures into a new folder, named by their number on the page and their title.

    Parameters
    ----------
    folder : Path
        It must not exist.
    pictures : sequence of Picture
        In the order of the page.

    Notes
    -----
    The same figures give the same bytes.
    """
    folder.mkdir()
    for number, picture in enumerate(pictures, 1):
        stem = f"{number:02d}-{_in_ascii(picture.title)}"
        write_whole(folder / f"{stem}.svg", standalone(picture).encode())
        for name, table in picture.data.items():
            text = table_text(list(table), zip(*table.values(), strict=True))
            write_whole(folder / f"{stem}-{name}.csv", text.encode())


def standalone(picture: Picture) -> str:
    """Return the SVG of a figure as a file of its own, with its caption, on white."""
    head, _, rest = picture.svg.partition(">")
    inside = f"<title>{escape(picture.title)}</title><desc>{escape(picture.caption)}</desc>"
    ground = '<rect width="100%" height="100%" fill="#ffffff"/>'
    start = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{start}>{inside}{ground}{rest}\n'


def _in_ascii(title: str) -> str:
    """Write a title so that it can be part of the name of a file anywhere."""
    plain = unicodedata.normalize("NFKD", title.replace("µ", "u")).encode("ascii", "ignore").decode().lower()
    words = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")
    whole = words if len(words) <= _LONGEST else words[: _LONGEST + 1].rpartition("-")[0] or words[:_LONGEST]
    return whole or "figure"
