"""Text that comes from files, made fit for terminals and pages."""

import re
from collections.abc import Iterable, Sequence
from decimal import Decimal
from difflib import get_close_matches
from unicodedata import category

MOST_NAMES = 8  # names or numbers written out in a message
_POWER = re.compile(r"(?<![\w.])-?\d(?:\.\d+)?e[+-]\d\d\b")
_FOLDERS = re.compile(
    r"(?<![\w./:])(?:~|[A-Za-z]:)?[/\\]{1,2}(?=\S)(?:(?:(?!\.\w{1,5}\s)[^/\\\n\"'<>|:;,])+[/\\]+)+"
)
_MINUS_ZERO = re.compile(r"(?<![\w.])-(?=0(?:\.0+)?(?![\w.]\w|\w))")


def plain_numbers(text: str) -> str:
    """Write out powers of ten in a sentence, and write no minus sign on a zero.

    Rounding to a few digits makes such powers.

    >>> plain_numbers("6 marks agree to 1e+02 um, near (5.357e+04, 1.42e+04) um")
    '6 marks agree to 100 um, near (53570, 14200) um'
    >>> plain_numbers("p below 1e-15, lag -0.0 um, x -0.04")
    'p below 0.000000000000001, lag 0.0 um, x -0.04'
    """
    text = _MINUS_ZERO.sub("", text)
    return _POWER.sub(lambda power: f"{Decimal(power[0]):f}", text)


def printable(text: str) -> str:
    r"""Escape characters that a terminal would act on, and bytes of names that are not text.

    Written as ``\x1b`` or ``\udcff``.
    """
    # Control characters, and halves of pairs, which stand for bytes that are no UTF-8.
    unprintable = (c for c in text if category(c) in ("Cc", "Cs") and c not in "\n\t")
    return text.translate({ord(c): c.encode("unicode_escape").decode() for c in unprintable})


def without_folders(text: str) -> str:
    r"""Leave the names of files in a text, and take the folders of whole paths off them.

    A folder's name may hold blanks; what stands behind the end of a file's name is text again.

    >>> without_folders(r"/home/Anna Maria/scan.tif is like C:\data\x.tif, not like a/b.tif.")
    'scan.tif is like x.tif, not like a/b.tif.'
    """
    return _FOLDERS.sub("", text)


def quoted(path: str) -> str:
    """A path as a shell takes it."""
    return f'"{path}"' if " " in path else path


def and_join(words: Iterable[str]) -> str:
    """Words in a list: ``a, b and c``."""
    *leading, last = words
    return f"{', '.join(leading)} and {last}" if leading else last


def and_join_few(words: Sequence[str]) -> str:
    """Words in a list: ``a, b and c``; the first eight of ten or more."""
    if len(words) > 9:
        words = [*words[:8], f"{len(words) - 8} more"]
    return and_join(words)


def first_few(items: Sequence[object]) -> str:
    """Write the first few names or numbers."""
    more_text = ", ..." if len(items) > MOST_NAMES else ""
    return ", ".join(map(str, items[:MOST_NAMES])) + more_text


def likely(name: str, words: Iterable[str]) -> str:
    """Name the word that was probably meant, as the end of a message; nothing where none is close.

    >>> likely("coatng_top", ["coating_top", "thickness"])
    ' Did you mean coating_top?'
    """
    matches = get_close_matches(name, list(words), n=1, cutoff=0.6)
    return f" Did you mean {matches[0]}?" if matches else ""
