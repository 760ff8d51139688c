"""The chain of pages in a TIFF file, walked before anything is decoded.

A TIFF file is a chain of tables, one a page; each names the position of the next. A file that was cut while
it was copied has a chain that leads out of it, a damaged one may lead in a circle. Libraries stop there and
return the pages found so far, which would be a shorter volume without a word. Here both are errors.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from planish.core.errors import FileError
from planish.io.guard import reading, size_of_file

MOST_PAGES = 100_000
"""No scan has more slices; a chain this long is damage."""

MOST_TAGS = 4096

TYPE_BYTES = {
    1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8,
}  # fmt: skip
"""Bytes of one value, by TIFF type."""

NEEDED_TAGS = frozenset({256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 322, 323, 324, 325, 339})
"""Size, type, layout and position of the image data, and the description: what is read must be inside the file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Field widths of classic TIFF and BigTIFF."""

    order: str
    count: str
    tag_bytes: int
    offset: str
    value: str
    first: int

    @property
    def inline_bytes(self) -> int:
        """Values up to this size stand in the table itself."""
        return struct.calcsize(self.offset)


def is_tiff(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a TIFF file."""
    return head[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}


def check_chain(path: Path) -> int:
    """Walk the chain of pages from the first to the last."""
    size = size_of_file(path)
    with reading(path), path.open("rb") as file:
        layout, offset = read_header(file, path)
        seen: set[int] = set()
        while offset:
            if offset in seen:
                raise damaged(path, f"page {len(seen) + 1} of its chain is one of the pages before it")
            if len(seen) == MOST_PAGES:
                raise damaged(path, f"it claims more than {MOST_PAGES} pages")
            seen.add(offset)
            offset = check_page(file, path, layout, offset=offset, number=len(seen), size=size)
    if not seen:
        raise damaged(path, "it holds no page")
    return len(seen)


def read_header(file: BinaryIO, path: Path) -> tuple[Layout, int]:
    """Byte order, kind, and position of the first page."""
    head = file.read(16)
    if not is_tiff(head):
        raise FileError(f"{path.name} is not a TIFF file. Export it as TIFF.")
    order = "<" if head[:2] == b"II" else ">"
    if head[2:4] in {b"+\0", b"\0+"}:
        if len(head) < 16:
            raise damaged(path, "it ends within its header")
        layout = Layout(order=order, count=order + "Q", tag_bytes=20, offset=order + "Q", value=order + "HHQ", first=16)
        return layout, struct.unpack(layout.offset, head[8:16])[0]
    if len(head) < 8:
        raise damaged(path, "it ends within its header")
    layout = Layout(order=order, count=order + "H", tag_bytes=12, offset=order + "I", value=order + "HHI", first=8)
    return layout, struct.unpack(layout.offset, head[4:8])[0]


def check_page(file: BinaryIO, path: Path, layout: Layout, *, offset: int, number: int, size: int) -> int:
    """Check the table of one page."""
    count_bytes = struct.calcsize(layout.count)
    if not layout.first <= offset <= size - count_bytes:
        raise damaged(path, f"page {number} should begin at byte {offset}, the file has {size}")
    file.seek(offset)
    tags = struct.unpack(layout.count, file.read(count_bytes))[0]
    if not 0 < tags <= MOST_TAGS:
        raise damaged(path, f"page {number} claims {tags} tags")
    table_bytes = tags * layout.tag_bytes
    table = file.read(table_bytes + layout.inline_bytes)
    if len(table) != table_bytes + layout.inline_bytes:
        raise damaged(path, f"the file ends within the table of page {number}")
    value_bytes = struct.calcsize(layout.value)
    for start in range(0, table_bytes, layout.tag_bytes):
        code, kind, count = struct.unpack_from(layout.value, table, start)
        if code not in NEEDED_TAGS:
            continue
        length = count * TYPE_BYTES.get(kind, 0)
        if length == 0:
            raise damaged(path, f"tag {code} of page {number} has no value")
        if length > layout.inline_bytes:
            position = struct.unpack_from(layout.offset, table, start + value_bytes)[0]
            if position + length > size:
                raise damaged(path, f"tag {code} of page {number} lies outside the file of {size} bytes")
    return struct.unpack_from(layout.offset, table, table_bytes)[0]


def damaged(path: Path, what: str) -> FileError:
    """One message for all kinds of damage: found, and what to do."""
    return FileError(f"{path.name} is cut off or damaged: {what}. Copy or export it again.")
