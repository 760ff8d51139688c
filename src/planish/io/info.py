"""Contents of a file and what looks wrong in it: the facts behind ``planish info``."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from planish.core.durations import link_seconds, map_seconds
from planish.core.errors import FileError, InputError, ResourceError, SizeError
from planish.core.frame import likely_through
from planish.core.memory import (
    LINK_BYTES,
    LOOK_BYTES,
    PIXEL_BYTES,
    PROGRAM_BYTES,
    SAMPLE_VALUES,
    bytes_to_hold,
    bytes_to_map,
)
from planish.core.typing import Entries, Pair, Texts
from planish.io.formats import (
    TIFF,
    Place,
    find_place,
    format_of,
    full_scale,
)
from planish.io.guard import size_of_file
from planish.io.image import across, pick_channel, picture_attrs
from planish.io.inspection import declared_facts, inspect_values
from planish.io.lazy import FileArray, Values, unmapped
from planish.io.orientation import hand_sentence
from planish.io.picture import is_picture, kind_of, load_picture
from planish.io.sections import SectionStack, is_section_folder, open_sections
from planish.io.sizes import (
    PIXEL,
    USUAL_VOXEL_UM,
    VOXEL,
    SizeAndSource,
    Stated,
    agreed_size,
    doubt_of_size,
    with_advice,
)
from planish.io.tiff import open_series
from planish.io.volume import load_volume, open_volume

SENTENCES = ("doubts", "notes")  # attributes of a volume that are said on their own
T = TypeVar("T")
# Finds the size and its source, or raises SizeError.
Agreed = Callable[..., SizeAndSource]


class _Look(NamedTuple):
    """What may be looked at in a file, and what is to be said about it."""

    most_bytes: int | None  # that may be decoded for its values; None where headers alone are read
    show: Callable[[Values], None] | None
    warnings: list[str]

    def loaded(self, load: Callable[..., T]) -> T | None:
        """What `load` gives where it may be decoded; None where it needs more memory."""
        if self.most_bytes is not None:
            with suppress(ResourceError):
                return load(memory_bytes=self.most_bytes)
        return None

    def facts(self, values: Values, largest: int | None, dims: Texts, *, is_read: bool) -> Entries:
        """Facts of values that were read, or of those that are declared."""
        if is_read:
            facts = inspect_values(values, largest, self.warnings, dims=dims)
            if self.show is not None:
                self.show(values)
            return facts
        if self.most_bytes is not None:
            size_gb = math.prod(values.shape) * values.dtype.itemsize / 1e9
            self.warnings.append(
                f"Its {size_gb:.2g} GB can only be decoded whole, so no grey was looked at."
            )
        return declared_facts(values, dims)


def describe(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    pixel_um: float | Pair | None = None,
    channel: str | None = None,
    override_size: bool = False,
    memory_bytes: int | None = None,
    look: Callable[[Values], None] | None = None,
    values: bool = True,
) -> Entries:
    """Inspect a volume or an image and report what it holds, in little memory.

    Of large ones, parts are read.

    Parameters
    ----------
    path : path
    voxel_um, pixel_um : float or sequence, optional
        Size in um, checked against the metadata as the reading functions do.
    channel : str, optional, as in :func:`planish.io.read_volume`, for volumes and sections
    override_size : bool
    memory_bytes : int, optional
        What may be decoded at once; of files that can only be decoded whole and have more, values
        are not looked at.
    look : callable, optional
        Is given the values of a volume (z, y, x), or of an image (y, x), where they may be looked
        at.
    values : bool; whether values are looked at; otherwise headers alone are read

    Returns
    -------
    dict
        Plain numbers and words, ready for JSON: ``kind`` ("volume", "sections" or "image"),
        ``file_name``, ``bytes``, ``dims``, ``shape``, ``dtype``, ``size_um`` (None where unknown),
        ``size_source``, ``size_problem``, ``extent_um``, ``min``, ``max``, ``percentiles``,
        ``nan_share``, ``saturated_share`` (values at the largest the type can store),
        ``bottom_share`` (values of 0), all None where no value was looked at, ``sampled`` (which
        slices, or rows and columns, were looked at; None for all), and ``warnings``, a list of
        sentences. For volumes also ``format``, ``stored`` (how they are read), ``through`` (the
        axis that seems to run through the sheet; None where the grey does not tell), ``run_bytes``
        and ``run_seconds`` (memory with which ``planish map`` measures single voxels, and its time,
        roughly), ``metadata`` (what a log states, and choices made). For images ``link_bytes`` and
        ``link_seconds``: memory and time of ``planish link`` with a sheet that was mapped. Times
        are those of the machine of :mod:`planish.core.durations`.

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions; a size that is missing or wrong is reported, not raised.
    """
    place = find_place(path)
    memory_bytes = LOOK_BYTES if memory_bytes is None else memory_bytes
    options: Entries = {"override": override_size, "unusual": True}
    named_options = options | {"file_name": place.path.name}
    # What can be read of the values only by decoding more than that, is not.
    look_at = _Look(memory_bytes if values else None, look, [])
    if is_section_folder(place.path):
        kind = "sections"
        sections = open_sections(place.path, channel=channel, memory_bytes=memory_bytes)
        facts = _describe_sections(
            sections, partial(sections.agreed_size, voxel_um, **options), look_at.warnings
        )
    elif is_image(place):
        find_size = partial(agreed_size, asked=PIXEL, user_um=pixel_um, **named_options)
        kind = "image"
        facts = _describe_image(place.path, find_size, look_at)
    else:
        find_size = partial(agreed_size, asked=VOXEL, user_um=voxel_um, **named_options)
        kind = "volume"
        facts = _describe_volume(place, find_size, channel, look_at)
    return {"kind": kind, "file_name": place.path.name, **facts, "warnings": look_at.warnings}


def _describe_volume(
    place: Place,
    find_size: Agreed,
    channel: str | None,
    look_at: _Look,
) -> Entries:
    """Report what a volume holds; of its values, if they can be read within ``most_bytes``."""
    warnings = look_at.warnings
    loaded = look_at.loaded(partial(load_volume, place, channel=channel))
    is_read = loaded is not None
    # Of what does not fit into the memory, the values are not read.
    loaded = loaded or open_volume(place, channel=channel)
    grey_values = unmapped(loaded.values)
    warnings += loaded.attrs.get("doubts", [])
    warnings += filter(None, [hand_sentence(loaded.attrs, "volume")])
    largest = full_scale(grey_values.dtype, loaded.bits)
    facts = look_at.facts(grey_values, largest, VOXEL.axes, is_read=is_read)
    find_size = partial(find_size, loaded.stated)
    shape = grey_values.shape
    size_facts = _size_facts(find_size, shape, warnings, loaded.stated, USUAL_VOXEL_UM)
    window = loaded.attrs.get("attenuation_window")
    if window is not None and is_read and grey_values.dtype == np.uint8:
        warnings.append(
            f"NRecon wrote 8 bits: grey 0 to 255 is attenuation {window[0]:g} to {window[1]:g}, and"
            f" what lies outside was cut ({100 * facts['bottom_share']:.3g} % of the values are 0,"
            f" {100 * facts['saturated_share']:.3g} % are 255). 16 bits lose nothing."
        )
    # Memory and time of ``planish map`` are those for a sheet across the shortest axis.
    n_columns = math.prod(shape) // min(shape)
    storage_text, whole_bytes = _storage_of(loaded.values, warnings)
    needed_bytes = max(bytes_to_map(n_columns), bytes_to_hold(whole_bytes))
    return {
        "bytes": loaded.file_bytes,
        "format": format_of(place).name,
        **facts,
        **size_facts,
        "stored": storage_text,
        "run_bytes": PROGRAM_BYTES + needed_bytes,
        "run_seconds": map_seconds(n_columns),
        "through": likely_through(grey_values) if is_read else None,
        "notes": loaded.attrs.get("notes", []),
        "metadata": {k: v for k, v in loaded.attrs.items() if k not in SENTENCES},
    }


def _describe_sections(sections: SectionStack, find_size: Agreed, warnings: list[str]) -> Entries:
    """Report what serial sections hold; between them some may be missing."""
    steps_um = np.diff(sections.positions_um)
    pitch_um = float(np.median(steps_um))
    n_missing = np.rint(steps_um / pitch_um).astype(int) - 1
    size_facts = _size_facts(find_size, sections.values.shape, warnings, sections.first.stated)
    if size_facts["extent_um"] is not None:
        size_facts["extent_um"][0] = float(np.ptp(sections.positions_um)) + pitch_um
    if missing_total := n_missing.sum():
        subject_text = f"{missing_total} sections are"
        if missing_total == 1:
            subject_text = "1 section is"
        warnings.append(
            f"{subject_text} missing between the others, at most {n_missing.max()} in a row."
        )
    largest = full_scale(sections.values.dtype, sections.first.bits)
    facts = inspect_values(sections.values, largest, warnings, dims=VOXEL.axes)
    return {"bytes": sections.file_bytes, **facts, **size_facts}


def _describe_image(path: Path, find_size: Agreed, look_at: _Look) -> Entries:
    """Report what an image holds.

    Its values are those of the luminance, or of channel 0 where there is none.
    """
    warnings = look_at.warnings
    picture = look_at.loaded(partial(load_picture, path))
    is_read = picture is not None
    picture = picture or load_picture(path, decode=False)
    full_values = picture.values
    shape = picture.values.shape[:2]
    # Of a larger image, some rows and columns are looked at.
    n_pixels = math.prod(shape)
    stride = max(1, math.ceil(math.sqrt(n_pixels / SAMPLE_VALUES)))
    picture = picture._replace(values=full_values[::stride, ::stride])
    try:
        channel_values, _ = pick_channel(picture, "luminance", file_name=path.name)
    except FileError:
        raise
    except InputError as error:
        warnings.append(error.text)
        channel_values, _ = pick_channel(picture, "0", file_name=path.name)
    if kind_of(path) == "jpeg":
        warnings.append("JPEG loses detail and adds block edges. Use TIFF or PNG if there is one.")
    warnings += filter(None, [hand_sentence(picture_attrs(picture.orientation), "image")])
    shown_values = channel_values if is_read else full_values
    largest = full_scale(full_values.dtype, picture.bits)
    facts = look_at.facts(shown_values, largest, PIXEL.axes, is_read=is_read)
    if is_read and stride > 1:
        facts["sampled"] = f"every {stride} rows and columns"
    stated = across(picture.stated)
    find_size = partial(find_size, stated)
    size_facts = _size_facts(find_size, shape, warnings, stated, PIXEL.usual_um)
    return {
        "bytes": size_of_file(path),
        **facts,
        "shape": list(shape),
        "dtype": str(full_values.dtype),
        "colour": picture.colour,
        "channels": full_values.shape[2] if full_values.ndim == 3 else 1,
        "link_bytes": LINK_BYTES + PIXEL_BYTES * n_pixels,
        "link_seconds": link_seconds(n_pixels),
        **size_facts,
    }


def _storage_of(values: Values, warnings: list[str]) -> tuple[str, int]:
    """How a volume is held, and its bytes that are in the memory at once."""
    if isinstance(values, np.memmap):
        return "mapped from its file", 0
    if not isinstance(values, FileArray):
        return "decoded in memory", values.nbytes
    whole_bytes = 0
    if values.whole_slices:
        whole_bytes = values.nbytes
        warnings.append(
            "It does not fit into the memory, and its slices can only be decoded whole. Bring it"
            " into a store with 'planish import' first."
        )
    return "read in parts when they are needed", whole_bytes


def is_image(place: Place) -> bool:
    """True if a path is to be read as one picture; everything else is to be read as a volume."""
    if format_of(place) is not TIFF:
        return False
    if kind_of(place.path) != "tiff":
        return True
    advice = "Give one volume or one image."
    # Whoever reads the file looks at its data.
    with open_series(place.path, advice=advice, has_data=False) as (_, series):
        return is_picture(series)


def _size_facts(
    find_size: Agreed,
    shape: Sequence[int],
    warnings: list[str],
    stated: Sequence[Stated],
    usual_um: Pair | None = None,
) -> Entries:
    """Voxel or pixel size and where it comes from, or why there is none.

    Unusual ones are doubted, and those that nobody may have measured. ``shape``: along the axes
    that have a size; ``usual_um``: from the least to the greatest edge that is not doubted.
    """
    facts: Entries = dict.fromkeys(("size_um", "size_source", "size_problem", "extent_um"))
    try:
        size, source = find_size()
    except SizeError as error:
        warnings.append(error.text)
        return facts | {"size_problem": error.text}
    asked = PIXEL if len(size) == len(PIXEL.axes) else VOXEL
    if doubt := doubt_of_size(stated, source):
        warnings.append(with_advice(doubt, asked))
    try:
        find_size(unusual=False)
    except SizeError as error:  # as a run says it
        warnings.append(error.text)
        usual_um = None
    if usual_um is not None:
        warnings += _doubts_of_edges(size, f"{asked.name}s", usual_um)
    extent_um = [n * um for n, um in zip(shape, size, strict=True)]
    return facts | {"size_um": list(size), "size_source": source, "extent_um": extent_um}


def _doubts_of_edges(size: Sequence[float], elements: str, usual_um: Pair) -> list[str]:
    """Say which edges of voxels or pixels, in um, paper does not have."""
    doubts: list[str] = []
    least, most = usual_um
    shortest = min(size)
    longest = max(size)
    if shortest < least or longest > most:
        edges_text = " x ".join(f"{v:g}" for v in size)
        range_text = f"{least:g} to {most:g} um"
        doubts.append(
            f"{elements.capitalize()} of {edges_text} um are unusual for paper ({range_text}). Is"
            " the unit right?"
        )
    # Longest over shortest edge of a voxel; beyond, one of them is probably wrong.
    if longest > 5.0 * shortest:
        size_name = "z size" if len(size) == 3 else "size"
        doubts.append(
            f"The edges of {elements} differ by a factor of {longest / shortest:.3g}. Is"
            f" the {size_name} right?"
        )
    return doubts
