"""Read volumes as folders of slices: TIFF, PNG, BMP or JPEG.

With or without the log that NRecon writes beside them.

The voxel size is ``Pixel Size (um)`` under ``[Reconstruction]``, not that of the camera or before
fine tuning; slices are named by ``Filename Prefix`` under ``[File name convention]``, not by the
key under ``[Acquisition]``.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import PHOTOMETRIC

from planish.core.errors import FileError, SizeError, VolumeError
from planish.core.memory import EAGER_BYTES
from planish.core.numbers import agree
from planish.core.tables import finite
from planish.core.threads import map_threads
from planish.core.typing import Pair
from planish.io.formats import LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.lazy import PagedArray, StoredArray, Values, supported_type, widened
from planish.io.picture import ADVICE, PLUGINS, DecodedPicture, kind_of, load_picture
from planish.io.sizes import Stated
from planish.io.tiff import open_series, size_words

# Files with other extensions (logs, licences, thumbnails of the system) are no slices.
EXTENSIONS = frozenset({".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg"})
MOST_NAMES = 8  # names or numbers written out in a message
ELSEWHERE = "or move the log elsewhere and give `voxel_um`."
DETAIL_KEYS = {  # Keys of a log that describe how the volume was made.
    "system": ("Scanner", "Software version", "Software", "Source Type", "Camera"),
    "acquisition": (
        "Source Voltage (kV)",
        "Source Current (uA)",
        "Filter",
        "Exposure (ms)",
        "Rotation Step (deg)",
        "Frame Averaging",
        "Use 360 Rotation",
        "Image Pixel Size (um)",
        "Study Date and Time",
    ),
    "reconstruction": (
        "Program Version",
        "Ring Artifact Correction",
        "Beam Hardening Correction (%)",
        "Smoothing",
        "Postalignment",
        "Reconstruction from ROI",
        "ROI Top (pixels)",
        "ROI Bottom (pixels)",
        "ROI Left (pixels)",
        "ROI Right (pixels)",
        "ROI reference length",
        "Undersampling factor",
        "HU Calibration",
        "Result File Type",
        "Minimum for CS to Image Conversion",
        "Maximum for CS to Image Conversion",
    ),
}


def list_slices(folder: Path) -> list[Path]:
    """List the slices of a folder in the order of their numbers."""
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    files = sorted(p for p in folder.iterdir() if is_slice_name(p.name) and p.is_file())
    if not files:
        raise FileError(
            f"{folder.name} holds no slices: TIFF, PNG, BMP or JPEG files with numbers in their"
            " names."
        )
    # A preview, a second scan: names that differ in more than numbers.
    patterns = [re.sub(r"\d+", "#", p.stem) + p.suffix.lower() for p in files]
    (main_pattern, n_main), *_ = Counter(patterns).most_common(1)
    if odd_files := [
        p for p, pattern in zip(files, patterns, strict=True) if pattern != main_pattern
    ]:
        raise VolumeError(
            f"{folder.name} holds {n_main} images named like"
            f" {files[patterns.index(main_pattern)].name}, and {len(odd_files)} named otherwise,"
            f" first {odd_files[0].name}. Leave only the slices of one volume there."
        )
    _check_several(files)
    numbers = slice_numbers(files, folder)
    check_no_gap(numbers, folder)
    return [file for _, file in sorted(zip(numbers, files, strict=True))]


def is_slice_name(name: str) -> bool:
    """True if a file name is that of a visible image file."""
    return not name.startswith(".") and Path(name).suffix.lower() in EXTENSIONS


def slice_numbers(files: list[Path], folder: Path) -> list[int]:
    """Find the number that counts the slices: the only one in the names that changes."""
    number_columns = zip(*(map(int, re.findall(r"\d+", p.stem)) for p in files), strict=True)
    changing_columns = [[*column] for column in number_columns if len({*column}) > 1]
    if len(changing_columns) != 1:
        raise VolumeError(
            f"{folder.name}: {len(changing_columns)} numbers change from {files[0].name} to"
            f" {files[-1].name}. Rename the slices with one running number."
        )
    return changing_columns[0]


def check_no_gap(numbers: list[int], folder: Path) -> None:
    """Refuse a series with missing or repeated numbers."""
    sorted_numbers = sorted(numbers)
    if repeated_numbers := sorted(n for n, times in Counter(sorted_numbers).items() if times > 1):
        raise VolumeError(
            f"{folder.name} has more than one slice with the number {first_few(repeated_numbers)}."
            " Remove copies."
        )
    expected_numbers = range(sorted_numbers[0], sorted_numbers[-1] + 1, slice_step(sorted_numbers))
    if n_missing := len(expected_numbers) - len(sorted_numbers):
        missing_text = _first_missing(expected_numbers, sorted_numbers)
        raise VolumeError(
            f"{folder.name} has {len(numbers)} slices from {sorted_numbers[0]} to"
            f" {sorted_numbers[-1]}, {n_missing} missing: {missing_text}. Add them, or move the"
            " slices before or after the gap elsewhere."
        )


def _first_missing(expected_numbers: range, numbers: list[int]) -> str:
    present_numbers = set(numbers)
    return first_few(
        list(islice((n for n in expected_numbers if n not in present_numbers), MOST_NAMES + 1))
    )


def slice_step(numbers: list[int]) -> int:
    """Largest step that meets every number."""
    return math.gcd(*np.diff(sorted(numbers)).tolist())


def first_few(items: Sequence[object]) -> str:
    """Write the first few names or numbers."""
    more_text = ", ..." if len(items) > MOST_NAMES else ""
    return ", ".join(map(str, items[:MOST_NAMES])) + more_text


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Statements of a log; None where it makes none."""

    log: Path
    stated: Stated  # voxel size (z, y, x)
    prefix: str | None  # of the names of the slices
    count: int | None
    numbers: range | None  # of the slices
    extent: tuple[int | None, int | None]  # rows and columns of a slice
    window: Pair | None  # attenuation at grey 0 and at the largest grey value, in NRecon's units
    details: dict[str, str]  # further keys, as written


def read_scan(folder: Path) -> Scan | None:
    """Read the log of a folder; None where there is none of a reconstruction."""
    logs = sorted(p for p in folder.iterdir() if p.name.casefold().endswith("_rec.log"))
    if len(logs) > 1:
        names = ", ".join(p.name for p in logs)
        raise VolumeError(
            f"{folder.name} holds {len(logs)} NRecon logs: {names}. Keep the one of this scan."
        )
    sections = _log_sections(logs[0]) if logs else {}
    keys = sections.get("reconstruction")
    if keys is None:
        return None
    log = logs[0]
    size, step = (
        _number(keys.get("pixel size (um)")),
        _count(keys.get("section to section step", "1")),
    )
    if not size or size < 0 or not step:
        raise SizeError(
            f"{log.name} has no number for"
            f" '{'Section to Section Step' if size else 'Pixel Size (um)'}' under [Reconstruction]."
            " Give the size with `voxel_um=SIZE`, in um, and move the log elsewhere."
        )
    count, first, last = (
        _count(keys.get(k)) for k in ("sections count", "first section", "last section")
    )
    if (
        count is not None
        and first is not None
        and last is not None
        and count != (last - first) / step + 1
    ):
        raise VolumeError(
            f"{log.name} contradicts itself: {count} sections, but from {first} to {last} in steps"
            f" of {step}. Correct the log, or move it elsewhere and give `voxel_um`."
        )
    rows, columns = (
        _count(keys.get(f"result image {side} (pixels)")) for side in ("height", "width")
    )
    low, high = (
        _number(keys.get(f"{end} for cs to image conversion")) for end in ("minimum", "maximum")
    )
    details: dict[str, str] = {}
    for section, names in DETAIL_KEYS.items():
        settings = sections.get(section, {})
        details |= {
            name: settings[name.casefold()] for name in names if name.casefold() in settings
        }
    return Scan(
        log=log,
        stated=Stated("NRecon log", (size * step, size, size)),
        prefix=sections.get("file name convention", {}).get("filename prefix") or None,
        count=count,
        numbers=None if first is None or last is None else range(first, last + 1, step),
        extent=(rows, columns),
        window=None if low is None or high is None or low >= high else (low, high),
        details=details,
    )


def _log_sections(path: Path) -> dict[str, dict[str, str]]:
    """Sections and keys of a log, case-folded.

    The first of keys that occur twice in a section counts.
    """
    with reading(path):
        if path.stat().st_size > 10_000_000:
            raise FileError(
                f"{path.name} is larger than 10 MB and no log of NRecon. Move it elsewhere."
            )
        raw_bytes = path.read_bytes()
    try:
        text = raw_bytes.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Names of people and folders, never numbers.
        text = raw_bytes.decode("cp1252", errors="replace")
    sections: dict[str, dict[str, str]] = {}
    section: dict[str, str] = {}
    for line in map(str.strip, text.splitlines()):
        key, equals, setting = line.partition("=")
        if line.startswith("[") and line.endswith("]"):
            section = sections.setdefault(line[1:-1].strip().casefold(), {})
        elif equals:
            section.setdefault(key.strip().casefold(), setting.strip())
    return sections


def named_slices(scan: Scan, folder: Path) -> list[Path]:
    """Slices with the prefix of a log, in their order.

    Other pictures, such as NRecon's own preview, are left aside.
    """
    prefix, numbered_files = scan.prefix or "", list[tuple[int, Path]]()
    for path in folder.iterdir():
        digits = path.stem[len(prefix) :]
        if (
            path.stem.casefold().startswith(prefix.casefold())
            and digits.isdecimal()
            and is_slice_name(path.name)
        ):
            numbered_files.append((int(digits), path))
    numbered_files.sort()
    if not numbered_files:
        raise VolumeError(
            f"{folder.name} holds no slice named {prefix} and a number, as {scan.log.name} states."
            f" Rename the slices, {ELSEWHERE}"
        )
    numbers = [number for number, _ in numbered_files]
    if scan.numbers is not None:
        expected_numbers = scan.numbers
        if missing_text := _first_missing(expected_numbers, numbers):
            raise VolumeError(
                f"{scan.log.name} states {len(expected_numbers)} sections, {folder.name} holds"
                f" {len(numbers)}. Missing: {missing_text}. Add them, {ELSEWHERE}"
            )
        if odd := [n for n in numbers if n not in expected_numbers]:
            raise VolumeError(
                f"{folder.name} holds slices that {scan.log.name} does not name: {first_few(odd)}."
                " Move them elsewhere."
            )
    if len(numbers) > 1 and scan.count in (None, len(numbers)):
        check_no_gap(numbers, folder)
    return [path for _, path in numbered_files]


_number = partial(finite, decimal_comma=True)


def _count(text: str | None) -> int | None:
    number = _number(text)
    return (
        int(number) if number is not None and 0 <= number < 1e9 and number == int(number) else None
    )


def load(place: Place, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices at once where it fits, otherwise slice by slice on demand."""
    scan = read_scan(place.path)
    files = slice_files(place.path, scan)
    values, first = load_pictures(files, channel=channel, memory_bytes=memory_bytes)
    attrs: dict[str, Any] = colour_attrs(channel, place.path, in_colour=first.in_colour)
    stated = first.stated
    if scan is not None:
        if any(
            wanted not in (None, n) for wanted, n in zip(scan.extent, values.shape[1:], strict=True)
        ):
            raise VolumeError(
                f"{files[0].name} is {size_words(values.shape[1:])} pixels, {scan.log.name} states"
                f" {scan.extent[0]} x {scan.extent[1]}. If the slices were cropped, move the log"
                " elsewhere and give `voxel_um`."
            )
        attrs |= {"nrecon": scan.details} | (
            {} if scan.window is None else {"attenuation_window": list(scan.window)}
        )
        stated = (scan.stated, *stated)
    return LoadedVolume(values=values, stated=stated, files=files, bits=first.bits, attrs=attrs)


def slice_files(folder: Path, scan: Scan | None) -> list[Path]:
    """Slices of a folder in their order, as the log names them or in the order of their numbers."""
    files = (
        list_slices(folder) if scan is None or scan.prefix is None else named_slices(scan, folder)
    )
    if scan is not None and scan.count not in (None, len(files)):
        raise VolumeError(
            f"{scan.log.name} states {scan.count} sections, {folder.name} holds {len(files)}. Add"
            f" the others, {ELSEWHERE}"
        )
    _check_several(files)
    return files


def _check_several(files: list[Path]) -> None:
    if len(files) < 2:
        raise VolumeError(
            f"{files[0].parent.name} holds one slice only, {files[0].name}. Give all of the volume."
        )


def load_pictures(
    files: list[Path], *, channel: str | None, memory_bytes: int | None, photographs: bool = False
) -> tuple[Values, DecodedPicture]:
    """Grey values of pictures that are alike, dims (picture, y, x), and the first picture.

    What does not fit into the memory, or can be read where it lies, stays in the files. Photographs
    of sections are compared with each other several times, so they are only left there where they
    do not fit.
    """
    folder, limit = files[0].parent, memory_limit(memory_bytes)
    first = load_picture(files[0], memory_bytes=limit)
    colour_attrs(channel, folder, in_colour=first.in_colour)
    grey = _grey_values(first, files[0], channel)
    dtype, shape = supported_type(grey.dtype), (len(files), *grey.shape)
    first_key, stored_dtype, offset = _slice_header(files[0])
    eager_bytes = limit if photographs or offset is None else min(limit, EAGER_BYTES)
    if math.prod(shape) * dtype.itemsize <= eager_bytes:
        values = np.empty(shape, dtype)
        values[0] = grey

        def read(i: int) -> None:
            picture = load_picture(files[i], memory_bytes=limit)
            _check_same(picture, first, file=files[i], first_file=files[0])
            values[i] = _grey_values(picture, files[i], channel)

        map_threads(read, range(1, len(files)))
        return values, first
    # Threads decode photographs while others are compared.
    check_memory(
        folder,
        needed_bytes=4 * first.values.nbytes if photographs else 2 * grey.nbytes,
        limit_bytes=limit,
    )
    planes: list[tuple[Path, int]] = []
    for file in files:
        file_key, file_dtype, offset = _slice_header(file)
        if file_key != first_key:
            _check_same(
                load_picture(file, memory_bytes=limit), first, file=file, first_file=files[0]
            )
        if offset is not None and file_dtype == stored_dtype and first.values.ndim == 2:
            planes.append((file, offset))
    if len(planes) == len(files):
        return widened(StoredArray(planes, shape, stored_dtype)), first
    return (
        PagedArray(
            folder, shape, dtype, shape[1], partial(_slice_rows, files, channel, grey.shape)
        ),
        first,
    )


def _slice_rows(
    files: list[Path], channel: str | None, shape: tuple[int, ...], page: int, start: int, stop: int
) -> NDArray[Any]:
    file = files[page]
    grey = _grey_values(load_picture(file), file, channel)
    if grey.shape != shape:
        raise VolumeError(
            f"{file.name} is {size_words(grey.shape)} pixels, {size_words(shape)} when the folder"
            " was opened. Leave the slices alone while planish reads them."
        )
    return grey[start:stop]


def _slice_header(file: Path) -> tuple[tuple[Any, ...], np.dtype[Any], int | None]:
    """Format, size and type of a slice, which is not decoded.

    Its type in the file, and from where it lies as it is.
    """
    format_name = kind_of(file)
    if format_name != "tiff":
        with reading(file), file.open("rb") as stream:
            image = PLUGINS[format_name](stream)
            return (
                (format_name, image.size, image.mode, image.info.get("dpi")),
                np.dtype(np.uint8),
                None,
            )
    with open_series(file, error=FileError, advice=ADVICE) as (tif, series), reading(file):
        page = series.keyframe
        resolution = tuple(page.tags.valueof(code) for code in (282, 283, 296))
        page_facts = (page.photometric, page.bitspersample, page.compression, resolution)
        offset = series.dataoffset if page.photometric == PHOTOMETRIC.MINISBLACK else None
        header_key = (format_name, series.shape, series.axes, str(series.dtype), *page_facts)
        return header_key, series.dtype.newbyteorder(tif.byteorder), offset


def _grey_values(picture: DecodedPicture, file: Path, channel: str | None) -> NDArray[Any]:
    """Grey values of a picture in its own type.

    Colour becomes luminance where no channel is chosen.
    """
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2:
        return picture.values
    if picture.colour == "grey":
        return picture.values[..., 0]
    if picture.colour == "rgb":
        return grey_of(picture.values, channel=channel)
    raise VolumeError(
        f"{file.name} is neither grey nor red, green and blue:"
        f" {size_words(picture.values.shape[:2])} pixels with {picture.values.shape[2]} samples."
        " Export all pictures in grey."
    )


def _check_same(
    picture: DecodedPicture, first: DecodedPicture, *, file: Path, first_file: Path
) -> None:
    check_type(picture.values.dtype, file)
    facts = [
        (p.colour, f"{size_words(p.values.shape[:2])} pixels", f"{p.values.dtype} values")
        for p in (picture, first)
    ]
    for verb, feature, a, b in zip(
        ("is", "is", "has"), ("colour", "size", "type"), *facts, strict=True
    ):
        if a != b:
            raise VolumeError(
                f"{file.name} {verb} {a}, {first_file.name} {verb} {b}. All slices need the same"
                f" {feature}: export them again or remove the odd one."
            )
    for stated, first_stated in zip(picture.stated, first.stated, strict=False):
        for a, b in zip(stated.um, first_stated.um, strict=True):
            if a is not None and b is not None and not agree(a, b):
                raise SizeError(
                    f"{file.name} states a pixel size of {a:g} um, {first_file.name} one of {b:g}"
                    " um. All slices need the same: remove the wrong slices or their resolution"
                    " tags."
                )
