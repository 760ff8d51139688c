"""Text that comes from files, made fit for terminals and pages."""

from __future__ import annotations

from unicodedata import category

_UNFIT = ("Cc", "Cs")  # control characters; halves of pairs, which stand for bytes that are no UTF-8


def printable(text: str) -> str:
    r"""Write what no terminal should act on, and bytes of names that are no text, as ``\x1b`` or ``\udcff``."""
    return "".join(
        c.encode("unicode_escape").decode() if category(c) in _UNFIT and c not in "\n\t" else c for c in text
    )
