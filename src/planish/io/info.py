"""What a file holds and what looks wrong: the facts behind ``planish info``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, InputError, SizeError
from planish.io.formats import SLICES, TIFF, Place, find_place, format_of
from planish.io.guard import size_of_file
from planish.io.image import across, pick_channel
from planish.io.lazy import FileArray
from planish.io.loaded import LoadedVolume
from planish.io.look import inspect_values
from planish.io.picture import is_picture, kind_of, load_picture
from planish.io.sections import is_section_folder, read_section_stack
from planish.io.sizes import PIXEL, VOXEL, Asked, Stated, agreed_size
from planish.io.slices import list_slices, slice_numbers, slice_step
from planish.io.tiff import only_series, open_tiff
from planish.io.volume import load_volume

USUAL_VOXEL_UM = (0.3, 20.0)
"""Voxel sizes that show a sheet of paper: smaller, and its field is too small; larger, and the sheet is blurred."""

MOST_UNEQUAL = 5.0
"""Longest over shortest edge of a voxel; beyond, one of them is probably wrong."""

COLUMN_BYTES = 520
BASE_BYTES = 530 * 10**6
COLUMN_SECONDS = 35e-6
BASE_SECONDS = 15.0
"""What ``planish map`` needs for each column through the sheet and in any case, on two busy cores."""


def describe(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    pixel_um: float | tuple[float, float] | None = None,
    channel: str | None = None,
    override_size: bool = False,
    memory_bytes: int | None = None,
) -> dict[str, Any]:
    """Inspect a volume or an image and report what it holds; of large volumes, a few slices are read.

    Parameters
    ----------
    path : path
    voxel_um, pixel_um : float or sequence, optional
        Size in um, checked against the metadata as the reading functions do.
    channel : str, optional
        As in :func:`planish.io.read_volume`, for volumes and sections.
    override_size : bool
    memory_bytes : int, optional

    Returns
    -------
    dict
        Plain numbers and words, ready for JSON: ``kind`` ("volume", "sections" or "image"), ``file_name``, ``bytes``,
        ``dims``, ``shape``, ``dtype``, ``size_um`` (None where unknown), ``size_source``, ``size_problem``,
        ``extent_um``, ``min``, ``max``, ``percentiles``, ``nan_share``, ``saturated_share`` (values at the largest the
        type can store), ``bottom_share`` (values of 0), ``sampled`` (which slices were looked at; None for all), and
        ``warnings``, a list of sentences. For volumes also ``format``, ``stored`` (how they are read), ``run_bytes``
        and ``run_seconds`` (rough estimates for ``planish map``), ``metadata`` (what a log states, and choices made).

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions; a size that is missing or wrong is reported, not raised.
    """
    place = find_place(path)
    path = place.path
    if is_image(place):
        return describe_image(path, pixel_um, override_size=override_size, memory_bytes=memory_bytes)
    if is_section_folder(path):
        return describe_sections(
            path, voxel_um, channel=channel, override_size=override_size, memory_bytes=memory_bytes
        )
    loaded = load_volume(place, channel=channel, memory_bytes=memory_bytes)
    warnings = list(loaded.notes)
    found = format_of(place)
    if found.name == SLICES.name and "nrecon" not in loaded.attrs:
        step = slice_step(slice_numbers(list_slices(path), path))
        if step > 1:
            warnings.append(f"The slices are numbered in steps of {step}: the z size must be that of {step} slices.")
    found_values = inspect_values(loaded.values, loaded.full_scale, warnings, dims=VOXEL.axes)
    size = size_facts(
        loaded.stated, voxel_um, loaded.values.shape, warnings, name=path.name, asked=VOXEL, override=override_size
    )
    warnings += size_doubts(size["size_um"]) + window_doubts(loaded, found_values)
    if isinstance(loaded.values, FileArray) and loaded.values.whole_slices:
        warnings.append(
            "It does not fit into the memory, and its slices can only be decoded whole. Bring it into a store with "
            "'planish import' first."
        )
    return {
        "kind": "volume",
        "file_name": path.name,
        "bytes": loaded.file_bytes,
        "format": found.name,
        "stored": how_stored(loaded.values),
        **found_values,
        **size,
        **estimates(loaded.values),
        "metadata": dict(loaded.attrs),
        "warnings": warnings,
    }


def how_stored(values: NDArray[Any] | FileArray) -> str:
    """How a volume is held."""
    if isinstance(values, FileArray):
        return "read in parts when they are needed"
    return "mapped from its file" if isinstance(values, np.memmap) else "decoded in memory"


def estimates(values: NDArray[Any] | FileArray) -> dict[str, float]:
    """Memory and time that ``planish map`` will need, roughly, if the sheet lies across the shortest axis."""
    columns = math.prod(values.shape) // min(values.shape)
    decoded = 0 if isinstance(values, (np.memmap, FileArray)) else values.nbytes
    return {
        "run_bytes": BASE_BYTES + COLUMN_BYTES * columns + decoded,
        "run_seconds": BASE_SECONDS + COLUMN_SECONDS * columns,
    }


def size_doubts(size_um: Sequence[float] | None) -> list[str]:
    """Sentences about voxel sizes that are possible but unusual."""
    if size_um is None:
        return []
    found: list[str] = []
    low, high = USUAL_VOXEL_UM
    if min(size_um) < low or max(size_um) > high:
        found.append(
            f"Voxels of {' x '.join(f'{v:g}' for v in size_um)} um are unusual for a scan of paper ({low:g} to "
            f"{high:g} um). Is the unit right?"
        )
    if max(size_um) > MOST_UNEQUAL * min(size_um):
        found.append(
            f"The edges of a voxel differ by a factor of {max(size_um) / min(size_um):.3g}. Is the z size right?"
        )
    return found


def window_doubts(loaded: LoadedVolume, values: Mapping[str, Any]) -> list[str]:
    """What an 8-bit reconstruction has lost: attenuation outside the window that was chosen for the grey values."""
    window = loaded.attrs.get("attenuation_window")
    if window is None or loaded.values.dtype != np.uint8:
        return []
    return [
        f"NRecon wrote 8 bits: grey 0 to 255 is attenuation {window[0]:g} to {window[1]:g}, and what lies outside was "
        f"cut ({100 * values['bottom_share']:.3g} % of the values are 0, {100 * values['saturated_share']:.3g} % are "
        "255). 16 bits lose nothing."
    ]


def describe_sections(
    path: Path,
    voxel_um: float | tuple[float, float, float] | None,
    *,
    channel: str | None,
    override_size: bool,
    memory_bytes: int | None,
) -> dict[str, Any]:
    """Report what a folder of sections with its counter holds, as photographed."""
    problem = None
    try:
        stack = read_section_stack(
            path,
            voxel_um=voxel_um,
            channel=channel,
            override_size=override_size,
            memory_bytes=memory_bytes,
        )
    except SizeError as error:
        problem = str(error)
        # The values are reported all the same; their size is not.
        stack = read_section_stack(path, voxel_um=1.0, channel=channel, override_size=True, memory_bytes=memory_bytes)
    steps = np.diff(stack.positions_um)
    step = float(np.median(steps))
    missing = int(np.sum(np.rint(steps / step) - 1))
    warnings = [problem] if problem else []
    if missing:
        longest = int(np.rint(steps.max() / step)) - 1
        word = "section is" if missing == 1 else "sections are"
        warnings.append(f"{missing} {word} missing between the others, at most {longest} in a row.")
    size = None if problem else [float(v) for v in stack.attrs["voxel_um"]]
    extent = None
    if size is not None:
        sides = (n * um for n, um in zip(stack.values.shape[1:], size[1:], strict=True))
        extent = [float(np.ptp(stack.positions_um)) + step, *sides]
    return {
        "kind": "sections",
        "file_name": path.name,
        "bytes": int(stack.attrs["file_bytes"]),
        **inspect_values(stack.values, stack.attrs["full_scale"], warnings, dims=VOXEL.axes),
        "size_um": size,
        "size_source": None if problem else str(stack.attrs["voxel_um_source"]),
        "size_problem": problem,
        "extent_um": extent,
        "warnings": warnings,
    }


def describe_image(
    path: Path,
    pixel_um: float | tuple[float, float] | None,
    *,
    override_size: bool,
    memory_bytes: int | None,
) -> dict[str, Any]:
    """Report what an image holds; its values are those of the luminance, or of channel 0 where there is none."""
    picture = load_picture(path, memory_bytes=memory_bytes)
    warnings: list[str] = []
    try:
        values, _ = pick_channel(picture, "luminance", file_name=path.name)
    except FileError:
        raise
    except InputError as error:
        warnings.append(str(error))
        values, _ = pick_channel(picture, "0", file_name=path.name)
    if kind_of(path) == "jpeg":
        warnings.append("JPEG loses detail and adds block edges. Use TIFF or PNG if there is one.")
    if picture.orientation != 1:
        warnings.append(f"An orientation tag ({picture.orientation}) asks viewers to turn the image; planish does not.")
    samples = picture.values.shape[2] if picture.values.ndim == 3 else 1
    return {
        "kind": "image",
        "file_name": path.name,
        "bytes": size_of_file(path),
        **inspect_values(values, picture.full_scale, warnings, dims=PIXEL.axes),
        "dtype": str(picture.values.dtype),
        "colour": picture.colour,
        "channels": samples,
        **size_facts(
            across(picture.stated),
            pixel_um,
            values.shape,
            warnings,
            name=path.name,
            asked=PIXEL,
            override=override_size,
        ),
        "warnings": warnings,
    }


def is_image(place: Place) -> bool:
    """Whether a path is to be read as one picture; everything else is to be read as a volume."""
    if format_of(place).name != TIFF.name:
        return False
    if kind_of(place.path) != "tiff":
        return True
    with open_tiff(place.path) as tif:
        return is_picture(only_series(tif, place.path, error=FileError, advice="Give one volume or one image."))


def size_facts(
    stated: Sequence[Stated],
    given: float | Sequence[float] | None,
    shape: Sequence[int],
    warnings: list[str],
    *,
    name: str,
    asked: Asked,
    override: bool,
) -> dict[str, Any]:
    """Voxel or pixel size and where it comes from, or why there is none."""
    try:
        size, source = agreed_size(stated, given, file_name=name, asked=asked, override=override)
    except SizeError as error:
        warnings.append(str(error))
        return {"size_um": None, "size_source": None, "size_problem": str(error), "extent_um": None}
    return {
        "size_um": list(size),
        "size_source": source,
        "size_problem": None,
        "extent_um": [n * um for n, um in zip(shape, size, strict=True)],
    }
