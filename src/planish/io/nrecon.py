"""The log file that NRecon writes beside its slices: ``*_rec.log``.

The voxel size is ``Pixel Size (um)`` under ``[Reconstruction]``. ``Image Pixel Size (um)`` under ``[Acquisition]`` is
the size before fine tuning, and ``Camera Pixel Size (um)`` that of the camera's chip; neither is meant.
"""

from __future__ import annotations

from pathlib import Path

from planish.core.errors import SizeError, VolumeError
from planish.io.guard import reading
from planish.io.sizes import Stated

_SECTION = "reconstruction"
_SUFFIX = "_rec.log"


def rec_log(folder: Path) -> Path | None:
    """Path of the log in a folder of slices, None where there is none.

    Raises
    ------
    VolumeError
        If there are several: then the folder holds more than one scan.
    """
    logs = sorted(p for p in folder.iterdir() if p.name.casefold().endswith(_SUFFIX))
    if len(logs) > 1:
        raise VolumeError(
            f"{folder.name} holds {len(logs)} NRecon logs: {', '.join(p.name for p in logs)}. "
            "Keep the one of this scan."
        )
    return logs[0] if logs else None


def read_log(path: Path) -> dict[str, dict[str, str]]:
    """Sections and keys of a log, case-folded; the first of keys that occur twice in a section counts."""
    with reading(path):
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8")
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


def stated_by_log(folder: Path, slices: int) -> Stated | None:
    """Voxel size that the log of a folder states, (z, y, x) in um; None where no log tells of a reconstruction.

    Raises
    ------
    SizeError
        If the log has no usable size.
    VolumeError
        If the folder does not hold as many slices as the log tells of.
    """
    log = rec_log(folder)
    if log is None:
        return None
    keys = read_log(log).get(_SECTION)
    if keys is None:
        return None
    size, step = _number(keys.get("pixel size (um)")), _number(keys.get("section to section step", "1"))
    if size is None or step is None:
        raise SizeError(
            f"{log.name} has no number for 'Pixel Size (um)' under [Reconstruction]. "
            "Give the size with --voxel-um SIZE, in um, and move the log elsewhere."
        )
    count = _number(keys.get("sections count"))
    if count is not None and int(count) != slices:
        raise VolumeError(
            f"{log.name} tells of {int(count)} sections, {folder.name} holds {slices}. "
            "Add the missing slices, or move the log elsewhere and give --voxel-um."
        )
    return Stated(source="NRecon log", um=(size * step, size, size))


def _number(text: str | None) -> float | None:
    """Read a positive number, with a decimal point or comma; None where it is none."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if value > 0 and value != float("inf") else None
