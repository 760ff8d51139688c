"""Contents of a file and what looks wrong in it: the facts behind ``planish info``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

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
from planish.core.typing import Pair
from planish.io.formats import SLICES, TIFF, Place, find_place, format_of
from planish.io.guard import size_of_file
from planish.io.image import across, pick_channel
from planish.io.inspection import declared_facts, inspect_values
from planish.io.lazy import FileArray, Values, unmapped
from planish.io.picture import is_picture, kind_of, load_picture
from planish.io.sections import Sections, is_section_folder, open_sections
from planish.io.sizes import PIXEL, VOXEL, agreed_size
from planish.io.slice_volume import list_slices, slice_numbers, slice_step
from planish.io.tiff import open_series
from planish.io.volume import declared_volume, load_volume

# Voxel sizes that show a sheet of paper: smaller, and its field is too small; larger, and the sheet is blurred.
USUAL_VOXEL_UM = (0.3, 20.0)

Agreed = Callable[..., tuple[tuple[float, ...], str]]  # finds the size and its source, or raises SizeError
Look = Callable[[Values], None]


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
) -> dict[str, Any]:
    """Inspect a volume or an image and report what it holds, in little memory: parts of large ones are read.

    Parameters
    ----------
    path : path
    voxel_um, pixel_um : float or sequence, optional
        Size in um, checked against the metadata as the reading functions do.
    channel : str, optional
        As in :func:`planish.io.read_volume`, for volumes and sections.
    override_size : bool
    memory_bytes : int, optional
        What may be decoded at once; of files that can only be decoded whole and have more, values are not looked at.
    look : callable, optional
        Is given the values of a volume (z, y, x), or of an image (y, x), where they may be looked at.
    values : bool
        Whether values are looked at; otherwise headers alone are read.

    Returns
    -------
    dict
        Plain numbers and words, ready for JSON: ``kind`` ("volume", "sections" or "image"), ``file_name``, ``bytes``,
        ``dims``, ``shape``, ``dtype``, ``size_um`` (None where unknown), ``size_source``, ``size_problem``,
        ``extent_um``, ``min``, ``max``, ``percentiles``, ``nan_share``, ``saturated_share`` (values at the largest the
        type can store), ``bottom_share`` (values of 0), all None where no value was looked at, ``sampled`` (which
        slices, or rows and columns, were looked at; None for all), and
        ``warnings``, a list of sentences. For volumes also ``format``, ``stored`` (how they are read),
        ``through`` (the axis that seems to run through the sheet; None where the grey does not tell), ``run_bytes``
        and ``run_seconds`` (memory with which ``planish map`` measures single voxels, and its time, roughly),
        ``metadata`` (what a log states, and choices made). For images ``link_bytes`` and ``link_seconds``: memory of
        ``planish link``, and what it takes after the volume.

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions; a size that is missing or wrong is reported, not raised.
    """
    place = find_place(path)
    memory_bytes = LOOK_BYTES if memory_bytes is None else memory_bytes
    options: dict[str, Any] = {"override": override_size, "unusual": True}
    warnings: list[str] = []
    if is_section_folder(place.path):
        kind, sections = "sections", open_sections(place.path, channel=channel, memory_bytes=memory_bytes)
        facts = _describe_sections(sections, partial(sections.agreed_size, voxel_um, **options), warnings)
    elif is_image(place):
        kind, options = "image", options | {"file_name": place.path.name, "asked": PIXEL, "user_um": pixel_um}
        facts = _describe_image(place.path, partial(agreed_size, **options), memory_bytes, look, values, warnings)
    else:
        kind, options = "volume", options | {"file_name": place.path.name, "asked": VOXEL, "user_um": voxel_um}
        agreed = partial(agreed_size, **options)
        facts = _describe_volume(place, agreed, channel, memory_bytes, look, values, warnings)
    return {"kind": kind, "file_name": place.path.name, **facts, "warnings": warnings}


def _describe_volume(
    place: Place,
    agreed: Agreed,
    channel: str | None,
    memory_bytes: int,
    look: Look | None,
    wanted: bool,
    warnings: list[str],
) -> dict[str, Any]:
    """Report what a volume holds; of its values, if they are wanted and can be read within the memory."""
    loaded = None
    with suppress(ResourceError):
        loaded = load_volume(place, channel=channel, memory_bytes=memory_bytes) if wanted else None
    is_read = loaded is not None
    loaded = loaded or declared_volume(place, channel=channel)
    grey, file_format = unmapped(loaded.values), format_of(place)
    warnings += loaded.notes
    if file_format is SLICES and "nrecon" not in loaded.attrs:
        step = slice_step(slice_numbers(list_slices(place.path), place.path))
        if step > 1:
            warnings.append(f"The slices are numbered in steps of {step}: the z size must be that of {step} slices.")
    facts = _value_facts(grey, loaded.full_scale, warnings, VOXEL.axes, look, is_read, wanted)
    size = _size_facts(partial(agreed, loaded.stated), grey.shape, warnings, ("Voxels", USUAL_VOXEL_UM))
    window = loaded.attrs.get("attenuation_window")
    if window is not None and is_read and grey.dtype == np.uint8:
        warnings.append(
            f"NRecon wrote 8 bits: grey 0 to 255 is attenuation {window[0]:g} to {window[1]:g}, and what lies outside "
            f"was cut ({100 * facts['bottom_share']:.3g} % of the values are 0, {100 * facts['saturated_share']:.3g} % "
            "are 255). 16 bits lose nothing."
        )
    # How a volume is held; memory and time of ``planish map`` for a sheet across the shortest axis.
    values, columns = loaded.values, math.prod(grey.shape) // min(grey.shape)
    stored, whole_bytes = "decoded in memory", values.nbytes
    if isinstance(values, np.memmap):
        stored, whole_bytes = "mapped from its file", 0
    elif isinstance(values, FileArray):
        stored, whole_bytes = "read in parts when they are needed", values.nbytes if values.whole_slices else 0
        if values.whole_slices:
            warnings.append(
                "It does not fit into the memory, and its slices can only be decoded whole. Bring it into a store with "
                "'planish import' first."
            )
    return {
        "bytes": loaded.file_bytes,
        "format": file_format.name,
        **facts,
        **size,
        "stored": stored,
        "run_bytes": PROGRAM_BYTES + max(bytes_to_map(columns), bytes_to_hold(whole_bytes)),
        # What ``planish map`` takes for each column through the sheet and in any case, on two busy cores.
        "run_seconds": 15.0 + 35e-6 * columns,
        "through": likely_through(grey) if is_read else None,
        "metadata": dict(loaded.attrs),
    }


def _describe_sections(sections: Sections, agreed: Agreed, warnings: list[str]) -> dict[str, Any]:
    """Report what a folder of sections with its counter holds, as photographed."""
    steps = np.diff(sections.positions_um)
    step = float(np.median(steps))
    missing = np.rint(steps / step).astype(int) - 1
    size = _size_facts(agreed, sections.values.shape, warnings)
    if size["extent_um"] is not None:
        size["extent_um"][0] = float(np.ptp(sections.positions_um)) + step
    if missing.sum():
        word = "section is" if missing.sum() == 1 else "sections are"
        warnings.append(f"{missing.sum()} {word} missing between the others, at most {missing.max()} in a row.")
    facts = inspect_values(sections.values, sections.full_scale, warnings, dims=VOXEL.axes)
    return {"bytes": sections.file_bytes, **facts, **size}


def _describe_image(
    path: Path, agreed: Agreed, memory_bytes: int, look: Look | None, wanted: bool, warnings: list[str]
) -> dict[str, Any]:
    """Report what an image holds; its values are those of the luminance, or of channel 0 where there is none."""
    picture = None
    with suppress(ResourceError):
        picture = load_picture(path, memory_bytes=memory_bytes) if wanted else None
    is_read = picture is not None
    picture = picture or load_picture(path, decode=False)
    whole, shape = picture.values, picture.values.shape[:2]
    # Of a larger image, some rows and columns are looked at.
    step = max(1, math.ceil(math.sqrt(math.prod(shape) / SAMPLE_VALUES)))
    picture = picture._replace(values=whole[::step, ::step])
    try:
        values, _ = pick_channel(picture, "luminance", file_name=path.name)
    except FileError:
        raise
    except InputError as error:
        warnings.append(error.text)
        values, _ = pick_channel(picture, "0", file_name=path.name)
    if kind_of(path) == "jpeg":
        warnings.append("JPEG loses detail and adds block edges. Use TIFF or PNG if there is one.")
    if picture.orientation != 1:
        warnings.append(f"An orientation tag ({picture.orientation}) asks viewers to turn the image; planish does not.")
    shown = values if is_read else whole
    facts = _value_facts(shown, picture.full_scale, warnings, PIXEL.axes, look, is_read, wanted)
    if is_read and step > 1:
        facts["sampled"] = f"every {step} rows and columns"
    size = _size_facts(partial(agreed, across(picture.stated)), shape, warnings, ("Pixels", PIXEL.usual_um))
    return {
        "bytes": size_of_file(path),
        **facts,
        "shape": list(shape),
        "dtype": str(whole.dtype),
        "colour": picture.colour,
        "channels": whole.shape[2] if whole.ndim == 3 else 1,
        "link_bytes": LINK_BYTES + PIXEL_BYTES * math.prod(shape),
        "link_seconds": 2.5e-6 * math.prod(shape),
        **size,
    }


def is_image(place: Place) -> bool:
    """True if a path is to be read as one picture; everything else is to be read as a volume."""
    if format_of(place) is not TIFF:
        return False
    if kind_of(place.path) != "tiff":
        return True
    with open_series(place.path, error=FileError, advice="Give one volume or one image.") as (_, series):
        return is_picture(series)


def _value_facts(
    values: Values,
    full_scale: int | None,
    warnings: list[str],
    dims: tuple[str, ...],
    look: Look | None,
    is_read: bool,
    wanted: bool,
) -> dict[str, Any]:
    if is_read:
        facts = inspect_values(values, full_scale, warnings, dims=dims)
        if look is not None:
            look(values)
        return facts
    if wanted:
        size_gb = math.prod(values.shape) * values.dtype.itemsize / 1e9
        warnings.append(f"Its {size_gb:.2g} GB can only be decoded whole, so no grey was looked at.")
    return declared_facts(values, dims)


def _size_facts(
    agreed: Agreed, shape: Sequence[int], warnings: list[str], usual: tuple[str, Pair] | None = None
) -> dict[str, Any]:
    """Voxel or pixel size and where it comes from, or why there is none; with ``usual``, unusual ones are doubted."""
    try:
        size, source = agreed()
    except SizeError as error:
        warnings.append(error.text)
        return {"size_um": None, "size_source": None, "size_problem": error.text, "extent_um": None}
    if usual is not None:
        elements, (low, high) = usual
        least, most = min(size), max(size)
        if least < low or most > high:
            edges, limits = " x ".join(f"{v:g}" for v in size), f"{low:g} to {high:g} um"
            warnings.append(f"{elements} of {edges} um are unusual for paper ({limits}). Is the unit right?")
        # Longest over shortest edge of a voxel; beyond, one of them is probably wrong.
        if most > 5.0 * least:
            edge = f"Is the {'z size' if elements == 'Voxels' else 'size'} right?"
            warnings.append(f"The edges of {elements.lower()} differ by a factor of {most / least:.3g}. {edge}")
    extent = [n * um for n, um in zip(shape, size, strict=True)]
    return {"size_um": list(size), "size_source": source, "size_problem": None, "extent_um": extent}
