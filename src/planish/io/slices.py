"""A folder of numbered slices: which files belong to it, in which order, whether one is missing, and NRecon's log.

The log file that NRecon writes beside its slices, ``*_rec.log``, states which slices there are, how large, and of what.
The voxel size is ``Pixel Size (um)`` under ``[Reconstruction]``. ``Image Pixel Size (um)`` under ``[Acquisition]`` is
the size before fine tuning, and ``Camera Pixel Size (um)`` that of the camera's chip; neither is meant. The slices are
named by ``Filename Prefix`` under ``[File name convention]``, not by the key of the same name under ``[Acquisition]``.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path

from planish.core.errors import FileError, SizeError, VolumeError
from planish.io.guard import reading
from planish.io.sizes import Stated

EXTENSIONS = frozenset({".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg"})
"""Files with other extensions (logs, licences, thumbnails of the system) are no slices."""

MOST_NAMES = 8  # names or numbers written out in a message
LARGEST_LOG = 10_000_000

DETAIL_KEYS = {
    "system": ("Scanner", "Software version", "Software", "Source Type", "Camera"),
    "acquisition": (
        "Source Voltage (kV)", "Source Current (uA)", "Filter", "Exposure (ms)", "Rotation Step (deg)",
        "Frame Averaging", "Use 360 Rotation", "Image Pixel Size (um)", "Study Date and Time",
    ),
    "reconstruction": (
        "Program Version", "Ring Artifact Correction", "Beam Hardening Correction (%)", "Smoothing", "Postalignment",
        "Reconstruction from ROI", "ROI Top (pixels)", "ROI Bottom (pixels)", "ROI Left (pixels)", "ROI Right (pixels)",
        "ROI reference length", "Undersampling factor", "HU Calibration", "Result File Type",
        "Minimum for CS to Image Conversion", "Maximum for CS to Image Conversion",
    ),
}  # fmt: skip
"""Keys of a log that describe how the volume was made."""


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
    """True if a file name is that of a visible image file."""
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
        raise VolumeError(
            f"{folder.name} has more than one slice with the number {first_few(repeated)}. Remove the copies."
        )
    step = slice_step(ordered)
    wanted, present = range(ordered[0], ordered[-1] + 1, step), set(ordered)
    count = len(wanted) - len(ordered)
    if count:
        missing = list(islice((n for n in wanted if n not in present), MOST_NAMES + 1))
        raise VolumeError(
            f"{folder.name} has {len(ordered)} slices from {ordered[0]} to {ordered[-1]}, {count} missing: "
            f"{first_few(missing)}. Add them, or move the slices before or after the gap elsewhere."
        )


def slice_step(numbers: list[int]) -> int:
    """Largest step that meets every number."""
    ordered = sorted(numbers)
    return math.gcd(*(b - a for a, b in pairwise(ordered)))


def first_few(items: Sequence[object]) -> str:
    """Write the first few names or numbers."""
    more = ", ..." if len(items) > MOST_NAMES else ""
    return ", ".join(map(str, items[:MOST_NAMES])) + more


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Statements of a log; None where it makes none."""

    log: Path
    stated: Stated  # voxel size (z, y, x)
    prefix: str | None  # of the names of the slices
    count: int | None
    first: int | None
    last: int | None
    step: int  # from the number of a slice to the next
    extent: tuple[int | None, int | None]  # rows and columns of a slice
    window: tuple[float, float] | None  # attenuation at grey 0 and at the largest grey value, in NRecon's units
    details: dict[str, str]  # further keys, as written


def _read_log(path: Path) -> dict[str, dict[str, str]]:
    """Sections and keys of a log, case-folded; the first of keys that occur twice in a section counts."""
    with reading(path):
        if path.stat().st_size > LARGEST_LOG:
            raise FileError(f"{path.name} is larger than 10 MB and no log of NRecon. Move it elsewhere.")
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")  # names of people and folders, never numbers
    sections: dict[str, dict[str, str]] = {}
    section: dict[str, str] = {}
    for line in text.splitlines():
        line = line.strip()
        if line.startswith("[") and line.endswith("]"):
            section = sections.setdefault(line[1:-1].strip().casefold(), {})
        elif "=" in line:
            key, value = line.split("=", 1)
            section.setdefault(key.strip().casefold(), value.strip())
    return sections


def read_scan(folder: Path) -> Scan | None:
    """Read the log of a folder; None where there is none of a reconstruction."""
    logs = sorted(p for p in folder.iterdir() if p.name.casefold().endswith("_rec.log"))
    if len(logs) > 1:
        raise VolumeError(
            f"{folder.name} holds {len(logs)} NRecon logs: {', '.join(p.name for p in logs)}. "
            "Keep the one of this scan."
        )
    sections = _read_log(logs[0]) if logs else {}
    keys = sections.get("reconstruction")
    if keys is None:
        return None
    log = logs[0]
    size, step = _number(keys.get("pixel size (um)")), _count(keys.get("section to section step", "1"))
    if not size or size < 0 or not step:
        raise SizeError(
            f"{log.name} has no number for '{'Section to Section Step' if size else 'Pixel Size (um)'}' under "
            "[Reconstruction]. Give the size with --voxel-um SIZE, in um, and move the log elsewhere."
        )
    count, first, last = (_count(keys.get(k)) for k in ("sections count", "first section", "last section"))
    if count is not None and first is not None and last is not None and count != (last - first) / step + 1:
        raise VolumeError(
            f"{log.name} contradicts itself: {count} sections, but from {first} to {last} in steps of {step}. "
            "Correct the log, or move it elsewhere and give --voxel-um."
        )

    def size_of(side: str) -> int | None:
        return _count(keys.get(f"result image {side} (pixels)"))

    low, high = (_number(keys.get(f"{end} for cs to image conversion")) for end in ("minimum", "maximum"))
    return Scan(
        log=log,
        stated=Stated(source="NRecon log", um=(size * step, size, size)),
        prefix=sections.get("file name convention", {}).get("filename prefix") or None,
        count=count,
        first=first,
        last=last,
        step=step,
        extent=(size_of("height"), size_of("width")),
        window=None if low is None or high is None or low >= high else (low, high),
        details={
            name: sections[section][name.casefold()]
            for section, names in DETAIL_KEYS.items()
            for name in names
            if name.casefold() in sections.get(section, {})
        },
    )


def named_slices(scan: Scan, folder: Path) -> list[Path]:
    """Slices with the prefix of a log, in their order; other pictures, such as NRecon's own preview, are left aside."""
    prefix = scan.prefix or ""
    numbered: list[tuple[int, Path]] = []
    for path in folder.iterdir():
        digits = path.stem[len(prefix) :]
        if path.stem.casefold().startswith(prefix.casefold()) and digits.isdecimal() and is_slice_name(path.name):
            numbered.append((int(digits), path))
    numbered.sort()
    if not numbered:
        raise VolumeError(
            f"{folder.name} holds no slice named {prefix} and a number, as {scan.log.name} states. Give the "
            "slices their names back, or move the log elsewhere and give --voxel-um."
        )
    numbers = [number for number, _ in numbered]
    if scan.first is not None and scan.last is not None:
        present, wanted = set(numbers), range(scan.first, scan.last + 1, scan.step)
        missing = list(islice((n for n in wanted if n not in present), 9))
        if missing:
            raise VolumeError(
                f"{scan.log.name} states {len(wanted)} sections, {folder.name} holds {len(numbers)}. Missing: "
                f"{first_few(missing)}. Add the missing slices, or move the log elsewhere and give --voxel-um."
            )
        odd = [n for n in numbers if n not in wanted]
        if odd:
            raise VolumeError(
                f"{folder.name} holds slices that {scan.log.name} does not name: {first_few(odd)}. Move them elsewhere."
            )
    if len(numbers) > 1 and scan.count in (None, len(numbers)):
        check_no_gap(numbers, folder)
    return [path for _, path in numbered]


def _number(text: str | None) -> float | None:
    """Read a number, with a decimal point or comma; None where it is none."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _count(text: str | None) -> int | None:
    value = _number(text)
    return int(value) if value is not None and value >= 0 and value == int(value) and value < 1e9 else None
