"""The log file that NRecon writes beside its slices, ``*_rec.log``: which slices there are, how large, and of what.

The voxel size is ``Pixel Size (um)`` under ``[Reconstruction]``. ``Image Pixel Size (um)`` under ``[Acquisition]`` is
the size before fine tuning, and ``Camera Pixel Size (um)`` that of the camera's chip; neither is meant. The slices are
named by ``Filename Prefix`` under ``[File name convention]``, not by the key of the same name under ``[Acquisition]``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from planish.core.errors import FileError, SizeError, VolumeError
from planish.io.guard import reading
from planish.io.sizes import Stated
from planish.io.slices import check_no_gap, is_slice_name, some

_SUFFIX = "_rec.log"
LARGEST_LOG = 10_000_000

KEPT = {
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """What a log states; None where it does not.

    Attributes
    ----------
    log : Path
    stated : Stated
        Voxel size (z, y, x).
    prefix : str
        Of the names of the slices.
    count, first, last : int
    step : int
        From the number of a slice to the next.
    width, height : int
        Of a slice.
    window : (float, float)
        Attenuation at grey 0 and at the largest grey value, in the units of NRecon.
    kept : dict
        Further keys, as written.
    """

    log: Path
    stated: Stated
    prefix: str | None
    count: int | None
    first: int | None
    last: int | None
    step: int
    width: int | None
    height: int | None
    window: tuple[float, float] | None
    kept: dict[str, str]


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
    found: dict[str, dict[str, str]] = {}
    section: dict[str, str] = {}
    for line in text.splitlines():
        line = line.strip()
        if line.startswith("[") and line.endswith("]"):
            section = found.setdefault(line[1:-1].strip().casefold(), {})
        elif "=" in line:
            key, value = line.split("=", 1)
            section.setdefault(key.strip().casefold(), value.strip())
    return found


def read_scan(folder: Path) -> Scan | None:
    """Read the log of a folder; None where there is none of a reconstruction."""
    logs = sorted(p for p in folder.iterdir() if p.name.casefold().endswith(_SUFFIX))
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
    low, high = (_number(keys.get(f"{end} for cs to image conversion")) for end in ("minimum", "maximum"))
    return Scan(
        log=log,
        stated=Stated(source="NRecon log", um=(size * step, size, size)),
        prefix=sections.get("file name convention", {}).get("filename prefix") or None,
        count=count,
        first=first,
        last=last,
        step=step,
        width=_count(keys.get("result image width (pixels)")),
        height=_count(keys.get("result image height (pixels)")),
        window=None if low is None or high is None or low >= high else (low, high),
        kept={
            name: sections[section][name.casefold()]
            for section, names in KEPT.items()
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
                f"{some(missing)}. Add the missing slices, or move the log elsewhere and give --voxel-um."
            )
        odd = [n for n in numbers if n not in wanted]
        if odd:
            raise VolumeError(
                f"{folder.name} holds slices that {scan.log.name} does not name: {some(odd)}. Move them elsewhere."
            )
    if len(numbers) > 1 and scan.count in (None, len(numbers)):
        check_no_gap(numbers, folder)
    return [path for _, path in numbered]


def check_extent(scan: Scan, file: Path, height: int, width: int) -> None:
    """Refuse slices of another size than that of the reconstruction."""
    if (scan.height or height, scan.width or width) != (height, width):
        raise VolumeError(
            f"{file.name} is {height} x {width} pixels, {scan.log.name} states {scan.height} x {scan.width}. If the "
            "slices were cropped, move the log elsewhere and give --voxel-um."
        )


def _number(text: str | None) -> float | None:
    """Read a number, with a decimal point or comma; None where it is none."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _count(text: str | None) -> int | None:
    """Read a whole number from 0 on."""
    value = _number(text)
    return int(value) if value is not None and value >= 0 and value == int(value) and value < 1e9 else None
