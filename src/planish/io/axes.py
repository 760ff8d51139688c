"""Find which stored axes of an array are z, y and x, by the names that its file gives them.

One place for every convention: labels and scales of HDF5, NeXus, axis tags of vigra, dimension
names of zarr, OME, kinds and labels of NRRD, the axes of MRC and TIFF. A file that names no axis is
taken as it is stored, slowest axis first: z, y, x. Names that are there are followed or refused.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from planish.core.errors import VolumeError
from planish.core.text import and_join
from planish.core.typing import Shape, Texts
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
    names: Texts


class PlacedAxes(NamedTuple):
    """Which stored axes are z, y and x, and what is to be said about that."""

    order: Shape
    notes: Texts  # what was read or assumed of them


def letter_of(name: str) -> str | None:
    """Letter of an axis by its name; empty where the name says nothing, None where it is unknown.

    Examples
    --------
    >>> letter_of("X (um)"), letter_of("dim_0"), letter_of("time"), letter_of("angle")
    ('x', '', 't', None)
    """
    # The micro sign and the Greek letter look alike.
    text = name.casefold().replace("µ", "u").replace("μ", "u")
    words = re.findall(r"[^\W\d_]+", text)
    telling_words = [word for word in words if word not in NEUTRAL]
    if not telling_words:
        return ""
    letters = {LETTERS.get(word) for word in telling_words}
    if len(letters) == 1:
        return letters.pop()
    return None


def extended_axes(shape: Sequence[int]) -> list[int]:
    """Axes along which an array has more than one value."""
    return [axis for axis, n in enumerate(shape) if n > 1]


class _Naming(NamedTuple):
    """Names of the axes longer than 1 by one convention, and their letters."""

    source: str
    names: list[str]
    letters: list[str | None]
    all_names: Texts

    def __str__(self) -> str:
        names = [name or "one without a name" for name in self.names]
        return f"{', '.join(names)} by {self.source}"


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
    long_axes = extended_axes(shape)
    telling = _telling_namings(namings, long_axes, subject)
    if not telling:
        if len(long_axes) != 3:
            extent = size_words(shape) or "one value"
            raise VolumeError(f"{subject} is no volume but {extent}. {ADVICE}")
        return PlacedAxes(tuple(long_axes), ())
    naming = telling[0]
    lengths = [shape[axis] for axis in long_axes]
    letters, notes = _spatial_letters(naming, lengths, subject, size_words(shape), channel_labels)
    order = [long_axes[letters.index(letter)] for letter in "zyx"]
    if order != long_axes:
        stored_text = f"Its axes are stored as {', '.join(letters)} ({naming.source})"
        notes.append(f"{stored_text}, and read as z, y, x.")
    return PlacedAxes(tuple(order), tuple(notes))


def _spatial_letters(
    naming: _Naming, lengths: list[int], subject: str, shape_text: str, channel_labels: str
) -> tuple[list[str], list[str]]:
    """Which of three axes are z, y and x, in the order stored, and what was assumed of them.

    ``lengths`` are those of the axes that `naming` names, in voxels; the texts are for messages. An
    axis of time, or of many channels, is read as z where no axis is called so; any other one is
    refused.
    """
    letters = _filled(naming.letters)
    if letters is None:
        raise VolumeError(
            f"{subject}: its axes are {naming}; which of them are z, y and x is not known. Name"
            " them z, y and x, in the order in which they are stored."
        )
    notes: list[str] = []
    counts = dict(zip(letters, lengths, strict=True))
    further = [letter for letter in letters if letter in MEANINGS]
    letter = further[0] if len(further) == 1 else ""
    if "z" not in letters and may_be_slices(letter, counts.get(letter, 0)):
        notes.append(slices_note(counts[letter], letter))
        letters[letters.index(letter)] = "z"
    elif further:
        labels_text = f" ({channel_labels})" if channel_labels else ""
        content_text = and_join(f"{counts[letter]} {MEANINGS[letter]}" for letter in further)
        raise VolumeError(
            f"{subject} has {content_text}{labels_text}: {shape_text}"
            f" ({', '.join(naming.all_names)}). {ADVICE}"
        )
    if sorted(letters) != ["x", "y", "z"]:
        raise VolumeError(
            f"{subject} is no volume with the axes z, y and x: its axes are {naming}. {ADVICE}"
        )
    return letters, notes


def may_be_slices(letter: str, count: int) -> bool:
    """True if an axis of time points or of many channels may hold the slices."""
    return letter == "t" or (letter == "c" and count >= LEAST_SLICES)


def _telling_namings(
    namings: Sequence[AxisNames], long_axes: Sequence[int], subject: str
) -> list[_Naming]:
    """The conventions that say something of an axis, which may not contradict each other.

    ``long_axes``: numbers of the stored axes that are longer than 1; the others are left aside.
    """
    telling: list[_Naming] = []
    for source, all_names in namings:
        names = [all_names[axis] for axis in long_axes]
        naming = _Naming(source, names, [*map(letter_of, names)], all_names)
        if all(letter == "" for letter in naming.letters):
            continue
        telling.append(naming)
        for first_letter, letter in zip(telling[0].letters, naming.letters, strict=True):
            if "" not in (first_letter, letter) and first_letter != letter:
                raise VolumeError(
                    f"{subject} contradicts itself: its axes are {telling[0]}, and {naming}."
                    " Correct one of them."
                )
    return telling


def _filled(letters: Sequence[str | None]) -> list[str] | None:
    """Letters of all axes, of which some may have no name; None where these are not clear.

    In ``letters`` an axis without a name is empty, one with an unknown name None. The former is the
    letter that is left, or in its usual place.
    """
    named = [*filter(None, letters)]
    free_letters = [letter for letter in "zyx" if letter not in named]
    # An axis of channels or time points stands for the first of them, z.
    if set(named) & set(MEANINGS):
        free_letters = free_letters[1:]
    n_missing = len(letters) - len(named)
    if None in letters or n_missing > len(free_letters):
        return None
    remaining = iter(free_letters)
    filled = [letter or next(remaining) for letter in letters]
    places = ["z" if letter in MEANINGS else letter for letter in filled]
    if n_missing < 2 or places == ["z", "y", "x"]:
        return filled
    return None


def slices_note(count: int, letter: str) -> str:
    """Say that an axis of another name is read as the slices."""
    return (
        f"Its {count} slices are filed as {MEANINGS[letter]}; they are read as slices, in their"
        " order along z."
    )
