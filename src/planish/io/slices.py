"""A folder of numbered slices: which files belong to it, in which order, and whether one is missing."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from itertools import islice, pairwise
from pathlib import Path

from planish.core.errors import FileError, VolumeError

EXTENSIONS = frozenset({".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg"})
"""Files with other extensions (logs, licences, thumbnails of the system) are no slices."""

MOST_NAMES = 8
"""Names or numbers written out in a message."""


def list_slices(folder: Path) -> list[Path]:
    """List the slices of a folder in the order of their numbers."""
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    files = sorted(p for p in folder.iterdir() if is_slice_name(p.name) and p.is_file())
    if not files:
        raise FileError(
            f"{folder.name} holds no slices. Needed are TIFF, PNG, BMP or JPEG files with numbers in their names."
        )
    check_one_series(files, folder)
    if len(files) == 1:
        raise VolumeError(f"{folder.name} holds one slice only, {files[0].name}. Needed are all slices of the volume.")
    numbers = slice_numbers(files, folder)
    check_no_gap(numbers, folder)
    return [file for _, file in sorted(zip(numbers, files, strict=True))]


def is_slice_name(name: str) -> bool:
    """Whether a file name is that of a visible image file."""
    return not name.startswith(".") and Path(name).suffix.lower() in EXTENSIONS


def check_one_series(files: list[Path], folder: Path) -> None:
    """Refuse image files whose names differ in more than numbers: a preview, a second scan."""
    patterns = Counter(pattern(p) for p in files)
    if len(patterns) == 1:
        return
    main = patterns.most_common(1)[0][0]
    example = next(p for p in files if pattern(p) == main)
    odd = [p for p in files if pattern(p) != main]
    raise VolumeError(
        f"{folder.name} holds {patterns[main]} images named like {example.name}, and {len(odd)} named otherwise, "
        f"first {odd[0].name}. Leave only the slices of one volume in the folder."
    )


def pattern(file: Path) -> str:
    """Return the name with every number replaced, so that all slices of a series have the same."""
    return re.sub(r"\d+", "#", file.stem) + file.suffix.lower()


def slice_numbers(files: list[Path], folder: Path) -> list[int]:
    """Find the number that counts the slices: the only one in the names that changes."""
    columns = list(zip(*(re.findall(r"\d+", p.stem) for p in files), strict=True))
    changing = [[int(text) for text in column] for column in columns if len({int(text) for text in column}) > 1]
    if len(changing) != 1:
        raise VolumeError(
            f"{folder.name}: {len(changing)} numbers change from {files[0].name} to {files[-1].name}, "
            "the slices need exactly one. Rename them with one running number."
        )
    return changing[0]


def check_no_gap(numbers: list[int], folder: Path) -> None:
    """Refuse a series with missing or repeated numbers."""
    ordered = sorted(numbers)
    repeated = sorted(n for n, times in Counter(ordered).items() if times > 1)
    if repeated:
        raise VolumeError(f"{folder.name} has more than one slice with the number {some(repeated)}. Remove the copies.")
    step = slice_step(ordered)
    wanted, present = range(ordered[0], ordered[-1] + 1, step), set(ordered)
    count = len(wanted) - len(ordered)
    if count:
        missing = list(islice((n for n in wanted if n not in present), MOST_NAMES + 1))
        raise VolumeError(
            f"{folder.name} has {len(ordered)} slices from {ordered[0]} to {ordered[-1]}, {count} missing: "
            f"{some(missing)}. Add them, or move the slices before or after the gap elsewhere."
        )


def slice_step(numbers: list[int]) -> int:
    """Largest step that meets every number."""
    ordered = sorted(numbers)
    return math.gcd(*(b - a for a, b in pairwise(ordered)))


def some(items: Sequence[object]) -> str:
    """Write the first few names or numbers."""
    more = ", ..." if len(items) > MOST_NAMES else ""
    return ", ".join(map(str, items[:MOST_NAMES])) + more
