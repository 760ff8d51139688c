"""Find which stored axes of an array are z, y and x, by the names that its file gives them.

One place for every convention: labels and scales of HDF5, NeXus, axis tags of vigra, dimension
names of zarr, OME, kinds and labels of NRRD, the axes of MRC and TIFF. A file that names no axis is
taken as it is stored, slowest axis first: z, y, x. Names that are there are followed or refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from planish.core.errors import VolumeError
from planish.core.text import and_join
from planish.io.formats import ADVICE
from planish.io.tiff import size_words

# Words for an axis, in small letters; what stands around them (``x_axis``, ``dim z``, ``y (um)``)
# is left aside.
WORDS = {
    "z": ("z", "zs", "slice", "slices", "depth", "plane", "planes", "section", "sections"),
    "y": ("y", "ys", "row", "rows", "height"),
    "x": ("x", "xs", "column", "columns", "col", "cols", "width"),
    "c": ("c", "channel", "channels", "ch", "colour", "color", "rgb", "s", "samples"),
    "t": ("t", "time", "times", "timepoint", "timepoints", "frame", "frames"),
}
LETTERS = {word: letter for letter, words in WORDS.items() for word in words}
# Words that say nothing about which axis it is.
NEUTRAL = frozenset(
    {
        "",
        "dim",
        "dimension",
        "axis",
        "phony",
        "none",
        "unknown",
        "domain",
        "space",
        "spatial",
        "pos",
    }
    | {"position", "positions", "coordinate", "coordinates", "coord", "scale", "of", "the", "image"}
    | {"um", "mm", "nm", "m", "px", "pixel", "pixels", "voxel", "voxels", "index", "translation"}
)
MEANINGS = {"c": "channels", "t": "time points"}
# Nothing has so many channels, so an axis with more holds slices.
LEAST_SLICES = 16


class AxisNames(NamedTuple):
    """Names that one convention gives the stored axes; empty where it has none for an axis."""

    source: str  # for example "the labels of its dimensions"
    names: tuple[str, ...]


class PlacedAxes(NamedTuple):
    """Which stored axes are z, y and x, and what is to be said about that."""

    order: tuple[int, ...]
    notes: tuple[str, ...]  # what was read or assumed of them


def letter_of(name: str) -> str | None:
    """Letter of an axis by its name; empty where the name says nothing, None where it is unknown.

    Examples
    --------
    >>> letter_of("X (um)"), letter_of("dim_0"), letter_of("time"), letter_of("angle")
    ('x', '', 't', None)
    """
    words = re.findall(r"[^\W\d_]+", name.casefold().replace("µ", "u").replace("μ", "u"))
    telling_words = [word for word in words if word not in NEUTRAL]
    if not telling_words:
        return ""
    letters = {LETTERS.get(word) for word in telling_words}
    return letters.pop() if len(letters) == 1 else None


def place_axes(
    shape: Sequence[int],
    namings: Sequence[AxisNames],
    subject: str,
    *,
    channel_labels: str = "",
) -> PlacedAxes:
    """Place the axes of an array that are longer than 1.

    ``subject`` names the file in messages, ``channel_labels`` what its channels show.

    Raises
    ------
    VolumeError
        If not three axes are longer than 1, if a name is unknown, if two conventions contradict
        each other, or if the axes are not z, y and x.
    """
    long_axes = [axis for axis, n in enumerate(shape) if n > 1]
    naming = _agreed_naming(shape, namings, subject)
    letters = [letter_of(naming.names[axis]) if naming else "" for axis in long_axes]
    if len(long_axes) != 3:
        raise VolumeError(
            _no_volume_text(shape, long_axes, letters, naming, subject, channel_labels)
        )
    if naming is None:
        return PlacedAxes(tuple(long_axes), ())
    found = _filled(letters)
    if found is None:
        raise VolumeError(
            f"{subject}: its axes are {_names_text(naming, shape)} by {naming.source}; which of"
            " them are z, y and x is not known. Name them z, y and x, in the order in which they"
            " are stored."
        )
    notes: tuple[str, ...] = ()
    if sorted(found) != ["x", "y", "z"]:
        found, notes = _with_slices(found, shape, long_axes, naming, subject, channel_labels)
    order = tuple(long_axes[found.index(letter)] for letter in "zyx")
    if list(order) != long_axes:
        stored_text = ", ".join(found)
        turned_text = (
            f"Its axes are stored as {stored_text} ({naming.source}), and read as z, y, x."
        )
        notes = (*notes, turned_text)
    return PlacedAxes(order, notes)


def _filled(letters: Sequence[str | None]) -> list[str] | None:
    """Letters of three axes, of which some may have no name; None where these are not clear.

    An axis without a name is the letter that is left, or in its usual place.
    """
    if None in letters:
        return None
    named = [letter for letter in letters if letter]
    left_letters = [letter for letter in "zyx" if letter not in named]
    if set(named) & set(MEANINGS):
        left_letters = left_letters[1:]
    n_missing = len(letters) - len(named)
    if n_missing > len(left_letters):
        return None
    remaining = iter(left_letters)
    filled = [letter or next(remaining) for letter in letters]
    places = ["z" if letter in MEANINGS else letter for letter in filled]
    is_clear = n_missing < 2 or places == ["z", "y", "x"]
    return filled if is_clear else None


def slices_note(count: int, letter: str) -> str:
    """Say that an axis of another name is read as the slices."""
    return (
        f"Its {count} slices are filed as {MEANINGS[letter]}; they are read as slices, in their"
        " order along z."
    )


def _agreed_naming(
    shape: Sequence[int], namings: Sequence[AxisNames], subject: str
) -> AxisNames | None:
    """The first convention that names the axes; None where none does."""
    telling = [
        naming
        for naming in namings
        if any(letter_of(name) != "" for name, n in zip(naming.names, shape, strict=True) if n > 1)
    ]
    for other in telling[1:]:
        for first_name, name, n in zip(telling[0].names, other.names, shape, strict=True):
            letters = {letter_of(first_name), letter_of(name)} - {""}
            if n > 1 and len(letters) > 1:
                raise VolumeError(
                    f"{subject} contradicts itself: its axes are"
                    f" {_names_text(telling[0], shape)} by {telling[0].source}, and"
                    f" {_names_text(other, shape)} by {other.source}. Correct one of them."
                )
    return telling[0] if telling else None


def _names_text(naming: AxisNames, shape: Sequence[int]) -> str:
    names = [name for name, n in zip(naming.names, shape, strict=True) if n > 1]
    return ", ".join(name or "one without a name" for name in names)


def _no_volume_text(
    shape: Sequence[int],
    long_axes: Sequence[int],
    letters: Sequence[str | None],
    naming: AxisNames | None,
    subject: str,
    channel_labels: str,
) -> str:
    extent = size_words(shape) or "one value"
    if naming is not None:
        extent += f" ({', '.join(name or '?' for name in naming.names)})"
    further_texts = [
        _content_text(shape[axis], letter, channel_labels)
        for axis, letter in zip(long_axes, letters, strict=True)
        if letter in MEANINGS
    ]
    if further_texts:
        return f"{subject} has {and_join(further_texts)}: {extent}. {ADVICE}"
    return f"{subject} is no volume but {extent}. {ADVICE}"


def _content_text(count: int, letter: str | None, channel_labels: str) -> str:
    text = f"{count} {MEANINGS[str(letter)]}"
    return f"{text} ({channel_labels})" if letter == "c" and channel_labels else text


def _with_slices(
    letters: list[str],
    shape: Sequence[int],
    long_axes: Sequence[int],
    naming: AxisNames,
    subject: str,
    channel_labels: str,
) -> tuple[list[str], tuple[str, ...]]:
    """Read time points, or as many channels as nothing has, as the slices that are not there."""
    others = [letter for letter in letters if letter not in "yx"]
    if sorted(letters) in (["c", "x", "y"], ["t", "x", "y"]):
        (letter,) = others
        count = shape[long_axes[letters.index(letter)]]
        if letter == "t" or count >= LEAST_SLICES:
            as_slices = ["z" if other == letter else other for other in letters]
            return as_slices, (slices_note(count, letter),)
        content_text = _content_text(count, letter, channel_labels)
        raise VolumeError(f"{subject} has {content_text}: {size_words(shape)}. {ADVICE}")
    raise VolumeError(
        f"{subject} is no volume with the axes z, y and x: its axes are"
        f" {_names_text(naming, shape)} by {naming.source}. {ADVICE}"
    )
