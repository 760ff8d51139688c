"""Put the slices of a folder in their order, by the numbers in their names.

Names may hold several numbers, such as a date, a time and an index. One of them counts the slices,
and all have to ask for the same order.
"""

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import chain, filterfalse, islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.core.text import MOST_NAMES, first_few
from planish.core.typing import Texts
from planish.io.formats import pictures_in
from planish.io.picture import is_picture, kind_of
from planish.io.tiff import open_series, shape_words

# A sign is part of a number where not all names have it, and a hyphen otherwise.
NUMBER = re.compile(r"[+-]?\d+")

DECIMALS = "The decimal number in their names counts the slices."


class SliceOrder(NamedTuple):
    """Slices in their order, and what is to be said about it."""

    files: list[Path]
    notes: Texts = ()
    doubts: Texts = ()


def list_slices(folder: Path) -> SliceOrder:
    """List the slices of a folder in the order of their numbers."""
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    files = pictures_in(folder)
    files = [*filterfalse(is_preview, files)] or files
    if not files:
        # Here, so that slices wait for no table of other files.
        from planish.io.other_files import folder_refusal

        raise folder_refusal(folder)
    # A preview, a second scan: names that differ in more than numbers.
    by_pattern: dict[str, list[Path]] = defaultdict(list)
    for file in files:
        pattern = NUMBER.sub("#", file.stem.casefold())
        by_pattern[pattern + file.suffix.lower()].append(file)
    alike, *odd = sorted(by_pattern.values(), key=len, reverse=True)
    if odd:
        odd_files = sorted(chain(*odd))
        raise VolumeError(
            f"{folder.name} holds {len(alike)} images named like {alike[0].name}, and"
            f" {len(odd_files)} named otherwise, first {odd_files[0].name}. Leave only the slices"
            " of one volume there."
        )
    check_several(files)
    numbers, notes = slice_numbers(files, folder)
    check_no_gap(numbers, folder)
    ordered_files = [file for _, file in sorted(zip(numbers, files, strict=True))]
    doubts = () if notes == (DECIMALS,) else step_doubts(numbers)
    return SliceOrder(ordered_files, notes, doubts)


def is_preview(path: Path) -> bool:
    """True for NRecon's preview of a scan, which has no number."""
    return path.stem.casefold().endswith("_spr")


def check_several(files: list[Path]) -> None:
    """Refuse a single slice, and a stack in place of slices."""
    if len(files) > 1:
        return
    file = files[0]
    folder = files[0].parent
    if kind_of(file) == "tiff":
        with open_series(file) as (_, series):
            if not is_picture(series):
                raise VolumeError(
                    f"{folder.name} holds one stack, {file.name}, of {shape_words(series)}. Give"
                    f" {folder.name}/{file.name} in place of the folder."
                )
    from planish.io.other_files import folder_contents  # here, so that slices wait for no table

    raise VolumeError(
        f"{folder.name} holds one slice only, {file.name}: {folder_contents(folder)[0]}. Give all"
        " of the volume."
    )


def slice_numbers(files: list[Path], folder: Path) -> tuple[list[int], Texts]:
    """Find the number in the names that counts the slices, and what is to be said about it.

    Of several numbers that change, one has to count without a gap, and no other may ask for another
    order: the digits of a date and a time rise with it, read one after the other.
    """
    columns = _number_columns(files)
    changing_columns = [column for column in columns if len({*column}) > 1]
    if len(changing_columns) == 1:
        return changing_columns[0], ()
    # Decimal numbers, such as the height of a slice, where no whole number counts.
    counters = [*filter(_counts, changing_columns)]
    if not counters:
        counters = [*filter(_counts, [_decimals(files)])]
    changes_text = (
        f"{len(changing_columns)} numbers change from {files[0].name} to {files[-1].name}"
    )
    if not counters:
        raise VolumeError(
            f"{folder.name}: {changes_text}, and none counts the slices without a gap. Add missing"
            " slices, or rename them with one running number."
        )
    # Of several, the one with the smallest steps, and of these the last in the name.
    numbers = min(reversed(counters), key=slice_step)
    order = sorted(range(len(files)), key=numbers.__getitem__)
    other_columns = [column for column in changing_columns if column is not numbers]
    others_together = [*zip(*other_columns, strict=True)]
    if not _all_rise([*counters, others_together], order):
        raise VolumeError(
            f"{folder.name}: {changes_text}, and they ask for different orders. Rename the slices"
            " with one running number."
        )
    if numbers not in columns:
        return numbers, (DECIMALS,)
    note = f"Of the numbers in {files[order[0]].name} and the other names, number"
    place = columns.index(numbers) + 1
    return numbers, (f"{note} {place} counts the slices; the others that change rise with it.",)


def _all_rise(columns: Sequence[Sequence[Any]], order: list[int]) -> bool:
    """True if the entries of all columns rise, or stay, in an order of the files."""
    return all(sorted(column) == [*map(column.__getitem__, order)] for column in columns)


def _number_columns(files: list[Path]) -> list[list[int]]:
    """Numbers of all names, one list for each place in a name."""
    columns: list[list[int]] = []
    numbers = [NUMBER.findall(path.stem) for path in files]
    for words in zip(*numbers, strict=True):
        signs = {word[0] if word[0] in "+-" else "" for word in words}
        if len(signs) == 1:
            words = [word.lstrip("+-") for word in words]
        columns.append([*map(int, words)])
    return columns


def _decimals(files: list[Path]) -> list[int]:
    """Numbers with a point in all names, without the point; empty where they are no such."""
    numbers: list[int] = []
    decimals: set[int] = set()
    for path in files:
        words = re.findall(r"(?<![\d.])(\d+)\.(\d+)(?![\d.])", path.stem)
        if len(words) != 1:
            return []
        numbers.append(int("".join(words[0])))
        decimals.add(len(words[0][1]))
    return numbers if len(decimals) == 1 else []


def _counts(numbers: list[int]) -> bool:
    """True if numbers rise by one step, whatever their order in the list."""
    steps = {*np.diff(sorted(numbers)).tolist()}
    return len(steps) == 1 and 0 not in steps


def check_no_gap(numbers: list[int], folder: Path) -> None:
    """Refuse a series with missing or repeated numbers."""
    sorted_numbers = sorted(numbers)
    repeated_numbers = sorted({a for a, b in pairwise(sorted_numbers) if a == b})
    if repeated_numbers:
        raise VolumeError(
            f"{folder.name} has more than one slice with the number {first_few(repeated_numbers)}."
            " Remove copies."
        )
    expected_numbers = range(sorted_numbers[0], sorted_numbers[-1] + 1, slice_step(sorted_numbers))
    n_missing = len(expected_numbers) - len(sorted_numbers)
    if n_missing:
        missing_text = first_missing(expected_numbers, sorted_numbers)
        raise VolumeError(
            f"{folder.name} has {len(numbers)} slices from {sorted_numbers[0]} to"
            f" {sorted_numbers[-1]}, {n_missing} missing: {missing_text}. Add them, or move the"
            " slices before or after the gap elsewhere."
        )


def first_missing(expected_numbers: range, numbers: list[int]) -> str:
    """Write the first of the numbers that are not there."""
    present_numbers = set(numbers)
    missing = (n for n in expected_numbers if n not in present_numbers)
    return first_few(list(islice(missing, MOST_NAMES + 1)))


def slice_step(numbers: list[int]) -> int:
    """Largest step that meets every number."""
    return math.gcd(*np.diff(sorted(numbers)).tolist())


def step_doubts(numbers: list[int], expected_step: int = 1) -> Texts:
    """Say that slices are further apart than one another, or than their log states."""
    step = slice_step(numbers)
    if step == expected_step:
        return ()
    step_text = f"The slices are numbered in steps of {step}, not {expected_step}"
    return (f"{step_text}: the z size must be that of {step} slices.",)
