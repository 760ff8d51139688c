"""What a file holds, read to its last byte: the facts behind ``planish info``, and what looks wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, InputError, SizeError
from planish.io.guard import size_of_file
from planish.io.image import across, pick_channel
from planish.io.picture import is_picture, kind_of, load_picture
from planish.io.sections import is_section_folder, read_section_stack
from planish.io.sizes import PIXEL, VOXEL, Asked, Stated, agreed_size
from planish.io.slices import list_slices, slice_numbers, slice_step
from planish.io.tiff import only_series, open_tiff
from planish.io.volume import load_volume

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)

SAMPLE_VALUES = 4_000_000
"""Values from which percentiles are taken where counting every grey level is not possible."""

SATURATED_SHARE = 0.001
"""Above this share of values at the end of the range, grey levels were lost."""

FEW_LEVELS = 16


def describe(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    pixel_um: float | tuple[float, float] | None = None,
    override_size: bool = False,
    memory_limit_bytes: int | None = None,
) -> dict[str, Any]:
    """Read a volume or an image completely and tell what it holds.

    Parameters
    ----------
    path : path
    voxel_um, pixel_um : float or sequence, optional
        Size in um, checked against the metadata as the reading functions do.
    override_size : bool
    memory_limit_bytes : int, optional

    Returns
    -------
    dict
        Plain numbers and words, ready for JSON: ``kind`` ("volume", "sections" or "image"), ``file_name``, ``bytes``,
        ``dims``, ``shape``, ``dtype``, ``size_um`` (None where unknown), ``size_source``, ``size_problem``,
        ``extent_um``, ``min``, ``max``, ``percentiles``, ``nan_share``, ``saturated_share`` (values at the largest the
        type can store), and ``warnings``, a list of sentences.

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions; a size that is missing or wrong is reported, not raised.
    """
    path = Path(path)
    if is_image(path):
        return describe_image(path, pixel_um, override_size=override_size, memory_limit_bytes=memory_limit_bytes)
    if is_section_folder(path):
        return describe_sections(path, voxel_um, override_size=override_size, memory_limit_bytes=memory_limit_bytes)
    loaded = load_volume(path, memory_limit_bytes=memory_limit_bytes)
    warnings: list[str] = []
    if path.is_dir():
        step = slice_step(slice_numbers(list_slices(path), path))
        if step > 1:
            warnings.append(f"The slices are numbered in steps of {step}: the z size must be that of {step} slices.")
    return {
        "kind": "volume",
        "file_name": path.name,
        "bytes": loaded.file_bytes,
        **facts(loaded.values, loaded.full_scale, warnings),
        **size_facts(
            loaded.stated, voxel_um, loaded.values.shape, warnings, name=path.name, asked=VOXEL, override=override_size
        ),
        "warnings": warnings,
    }


def describe_sections(
    path: Path,
    voxel_um: float | tuple[float, float, float] | None,
    *,
    override_size: bool,
    memory_limit_bytes: int | None,
) -> dict[str, Any]:
    """Tell what a folder of sections with its counter holds, as photographed."""
    problem = None
    try:
        stack = read_section_stack(
            path, voxel_um=voxel_um, override_size=override_size, memory_limit_bytes=memory_limit_bytes
        )
    except SizeError as error:
        problem = str(error)
        # The values are told all the same; their size is not.
        stack = read_section_stack(path, voxel_um=1.0, override_size=True, memory_limit_bytes=memory_limit_bytes)
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
        **facts(stack.values, stack.attrs["full_scale"], warnings),
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
    memory_limit_bytes: int | None,
) -> dict[str, Any]:
    """Tell what an image holds; its values are those of the luminance, or of channel 0 where there is none."""
    picture = load_picture(path, memory_limit_bytes=memory_limit_bytes)
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
        **facts(values, picture.full_scale, warnings),
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


def is_image(path: Path) -> bool:
    """Whether a path is to be read as one picture; everything else is to be read as a volume."""
    if path.is_dir():
        return False
    if kind_of(path) != "tiff":
        return True
    with open_tiff(path) as tif:
        return is_picture(only_series(tif, path, error=FileError, advice="Give one volume or one image."))


def facts(values: NDArray[Any], full_scale: int | None, warnings: list[str]) -> dict[str, Any]:
    """Shape, type and distribution of the values; what looks wrong is added to `warnings`."""
    low, high, finite, saturated = extremes(values, full_scale)
    nan_share = 1 - finite / values.size
    saturated_share = saturated / values.size
    levels = 0
    if finite == 0:
        warnings.append("There is no number in it, all values are missing.")
        percentiles = dict.fromkeys((str(p) for p in PERCENTILES), None)
    else:
        sample, levels = sorted_sample(values)
        percentiles = {str(p): float(np.percentile(sample, p)) for p in PERCENTILES}
        if low == high:
            warnings.append(f"All values are {low:g}.")
        elif values.dtype.kind in "ui" and 0 < levels < FEW_LEVELS:
            warnings.append(f"It has {levels} grey levels only. Is it a segmentation? planish needs the grey values.")
    if nan_share > 0:
        warnings.append(f"{100 * nan_share:.3g} % of the values are missing (NaN or infinite).")
    if saturated_share > SATURATED_SHARE and low != high:
        warnings.append(
            f"{100 * saturated_share:.3g} % of the values are at {full_scale}, the largest the file can store: "
            "grey levels were cut there."
        )
    return {
        "dims": list(VOXEL.axes if values.ndim == 3 else PIXEL.axes),
        "shape": list(values.shape),
        "dtype": str(values.dtype),
        "min": low,
        "max": high,
        "percentiles": percentiles,
        "nan_share": nan_share,
        "saturated_share": saturated_share,
    }


def extremes(values: NDArray[Any], full_scale: int | None) -> tuple[float | None, float | None, int, int]:
    """Smallest, largest, number of finite values, and number at the end of the range, block by block."""
    low, high, finite, saturated = np.inf, -np.inf, 0, 0
    for block in values:
        numbers = block if block.dtype.kind != "f" else block[np.isfinite(block)]
        if numbers.size:
            low, high = min(low, float(numbers.min())), max(high, float(numbers.max()))
            finite += numbers.size
        if full_scale is not None:
            saturated += int(np.count_nonzero(block == full_scale))
    return (low, high, finite, saturated) if finite else (None, None, 0, 0)


def sorted_sample(values: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Finite values in a regular grid through the data, sorted, and the number of different ones."""
    stride = max(1, int(np.ceil((values.size / SAMPLE_VALUES) ** (1 / values.ndim))))
    sample = np.asarray(values[(slice(None, None, stride),) * values.ndim]).ravel()
    if sample.dtype.kind == "f":
        sample = sample[np.isfinite(sample)]
        if not sample.size:
            sample = np.asarray(values).ravel()
            sample = sample[np.isfinite(sample)]
    sample = np.sort(sample)
    return sample, int(np.count_nonzero(np.diff(sample)) + 1)


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
