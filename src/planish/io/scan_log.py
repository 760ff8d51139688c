"""Read the logs that the programs of SkyScan scanners write beside slices.

NRecon writes one of a reconstruction; CTAn and DataViewer write one beside the slices that they
export, often a copy of it with the numbers of the whole scan. The log of the slices is the one that
names them: by the ``Filename Prefix`` under ``[File name convention]``, not by the key under
``[Acquisition]``, or by its own name.

The voxel size is ``Pixel Size (um)`` under ``[Reconstruction]``, not that of the camera or before
fine tuning.
"""

import re
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from planish.core.errors import FileError, SizeError, VolumeError
from planish.core.tables import finite
from planish.core.text import first_few
from planish.core.typing import Pair
from planish.io.formats import is_slice_name
from planish.io.guard import reading
from planish.io.sizes import Stated
from planish.io.slice_names import (
    SliceOrder,
    check_no_gap,
    check_several,
    first_missing,
    is_preview,
    list_slices,
    step_doubts,
)
from planish.io.tiff import size_words

ELSEWHERE = "or move the log elsewhere and give `voxel_um`."
RECONSTRUCTED = "pixel size (um)"
# Of the projections; a reconstruction has it, too, where nothing was scaled.
PROJECTED = ("scaled image pixel size (um)", "image pixel size (um)")
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


NumberedFile = tuple[int, Path]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Statements of a log; None where it makes none."""

    log: Path
    stated: tuple[Stated, ...]  # voxel size (z, y, x), and that of further logs
    details: dict[str, str]  # further keys, as written
    prefix: str | None = None  # of the names of the slices
    named_slices: list[NumberedFile] = field(default_factory=list[NumberedFile])
    step: int = 1  # between the numbers of slices
    count: int | None = None
    numbers: range | None = None  # of the slices
    extent: tuple[int | None, int | None] = (None, None)  # rows and columns of a slice
    # Whether count, numbers and extent are those of the scan that the slices were cut out of.
    is_of_whole: bool = False
    window: Pair | None = (
        None  # attenuation at grey 0 and at the largest grey value, as NRecon has it
    )
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


class _Log:
    """A log, and the slices that it names."""

    def __init__(self, path: Path, slices: list[Path]) -> None:
        self.path, self.sections = path, _log_sections(path)
        self.keys = self.sections.get("reconstruction", {})
        prefix = self.sections.get("file name convention", {}).get("filename prefix") or None
        self.prefix = prefix
        self.named_slices, self.is_exact = _named(prefix or path.stem, slices)
        if not self.named_slices:
            self.named_slices, self.is_exact = _named(path.stem, slices)
            # A copy of the log of a scan states the prefix of that scan.
            self.is_exact = self.is_exact and prefix in (None, path.stem)

    @property
    def size_um(self) -> float | None:
        """Voxel size of a reconstruction; of a program's own section where it has one."""
        sections = [self.keys, *self.sections.values()]
        sizes = [_number(section.get(RECONSTRUCTED)) for section in sections]
        return next((size for size in sizes if size is not None and size > 0), None)

    @property
    def source(self) -> str:
        """Name in messages."""
        is_of_nrecon = self.path.name.casefold().endswith("_rec.log")
        return "NRecon log" if is_of_nrecon else self.path.name


def _named(prefix: str, slices: list[Path]) -> tuple[list[NumberedFile], bool]:
    """Slices with a prefix and a number, in their order, and whether nothing else is in the name.

    Other pictures, such as NRecon's own preview, are left aside.
    """
    pattern = re.compile(re.escape(prefix) + r"_*(\d+)(\D.*)?", re.IGNORECASE)
    by_ending: dict[str, list[NumberedFile]] = defaultdict(list)
    for path in slices:
        match = pattern.fullmatch(path.stem)
        if match is not None:
            by_ending[(match[2] or "").casefold()].append((int(match[1]), path))
    if "" in by_ending:
        return sorted(by_ending[""]), True
    return (sorted(*by_ending.values()), False) if len(by_ending) == 1 else ([], False)


def read_scan(folder: Path) -> Scan | None:
    """Read the log of the slices of a folder; None where there is none."""
    files = sorted(p for p in folder.iterdir() if p.is_file())
    slices = [p for p in files if is_slice_name(p.name)]
    logs = [_Log(p, slices) for p in files if _is_log(p)]
    reconstructions = [log for log in logs if log.keys or log.size_um]
    naming_logs = [log for log in reconstructions if log.named_slices] or reconstructions
    # A log and its copies name the same slices.
    naming_logs.sort(key=lambda log: len(log.path.name))
    if any(log.named_slices != naming_logs[0].named_slices for log in naming_logs):
        names = ", ".join(log.path.name for log in naming_logs)
        raise VolumeError(
            f"{folder.name} holds {len(naming_logs)} NRecon logs: {names}. Keep the one of this"
            " scan."
        )
    if not naming_logs:
        return _scan_by_projections(logs, slices)
    log = naming_logs[0]
    named_files = {path for _, path in log.named_slices}
    others = [p for p in slices if p not in named_files and not is_preview(p)]
    notes: tuple[str, ...] = ()
    if named_files and others:
        notes = (
            f"{log.path.name} names {len(named_files)} slices. Pictures left aside: {len(others)},"
            f" first {others[0].name}.",
        )
    # Copies, and the log of the whole scan beside that of a part, have to state the same size.
    further: list[Stated] = []
    for other in reconstructions:
        is_of_whole = log.path.stem.casefold().startswith(other.path.stem.casefold())
        if other is not log and (other in naming_logs or is_of_whole):
            further.append(Stated(other.path.name, (None, other.size_um, other.size_um)))
    return _scan_of(log, further, notes)


def _is_log(path: Path) -> bool:
    """True for the log of a reconstruction, and for others that are short enough to be one."""
    name = path.name.casefold()
    is_short = path.stat().st_size <= 10_000_000
    return name.endswith("_rec.log") or (name.endswith(".log") and is_short)


def _scan_by_projections(logs: list[_Log], slices: list[Path]) -> Scan | None:
    """Read the log of the projections beside slices that have no log of their own.

    None where there is none either. Of such a log the size alone holds for the slices.
    """
    for log in logs:
        keys = log.sections.get("acquisition", {})
        sizes = [size for key in PROJECTED if (size := _number(keys.get(key)))]
        if not sizes:
            continue
        name, first_slice = log.path.name, slices[0] if slices else log.path
        projections, _ = _named(keys.get("filename prefix") or log.path.stem, slices)
        is_export = any(word in log.path.stem.casefold() for word in ("_rec", "_voi"))
        if projections and not is_export:
            raise VolumeError(
                f"{first_slice.parent.name} holds X-ray projections, first {first_slice.name}, as"
                f" {name} states. Give the folder of the reconstructed slices, {ELSEWHERE}"
            )
        source = f"{name} (its projections)"
        stated = Stated(source, (None, None, None), "the slices have other names")
        doubts: tuple[str, ...] = ()
        if first_slice.stem.casefold().startswith(log.path.stem.casefold()):
            stated = Stated(source, (sizes[0],) * 3)
            doubts = (
                f"{name} states the size of the projections, {sizes[0]:g} um, and none of the"
                " slices: that size is right unless the reconstruction was scaled.",
            )
        return Scan(log=log.path, stated=(stated,), details=_details(log), doubts=doubts)
    return None


def _scan_of(log: _Log, further: list[Stated], notes: tuple[str, ...]) -> Scan:
    """Read the statements of the log of a reconstruction."""
    name, keys, size = log.path.name, log.keys, log.size_um
    step = _count(keys.get("section to section step", "1"))
    if not size or not step:
        raise SizeError(
            f"{name} has no number for"
            f" '{'Section to Section Step' if size else 'Pixel Size (um)'}' under [Reconstruction]."
            " Give the size with `voxel_um=SIZE`, in um, and move the log elsewhere."
        )
    count, first, last = (
        _count(keys.get(k)) for k in ("sections count", "first section", "last section")
    )
    numbers = None if first is None or last is None else range(first, last + 1, step)
    if numbers is not None and count not in (None, len(numbers)):
        raise VolumeError(
            f"{name} contradicts itself: {count} sections, but from {first} to {last} in steps"
            f" of {step}. Correct the log, or move it elsewhere and give `voxel_um`."
        )
    rows, columns = (
        _count(keys.get(f"result image {side} (pixels)")) for side in ("height", "width")
    )
    low, high = (
        _number(keys.get(f"{end} for cs to image conversion")) for end in ("minimum", "maximum")
    )
    return Scan(
        log=log.path,
        stated=(Stated(log.source, (size * step, size, size)), *further),
        prefix=log.prefix,
        named_slices=log.named_slices,
        step=step,
        count=count,
        numbers=numbers,
        extent=(rows, columns),
        is_of_whole=bool(log.named_slices) and not log.is_exact,
        window=None if low is None or high is None or low >= high else (low, high),
        details=_details(log),
        notes=notes,
    )


def _details(log: _Log) -> dict[str, str]:
    details: dict[str, str] = {}
    for section, names in DETAIL_KEYS.items():
        settings = log.sections.get(section, {})
        details |= {
            name: settings[name.casefold()] for name in names if name.casefold() in settings
        }
    return details


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
    is_utf_16 = raw_bytes[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = raw_bytes.decode("utf-16" if is_utf_16 else "utf-8-sig")
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
            # Casefolding makes the micro sign a Greek mu.
            name = key.strip().casefold().replace("μm", "um")
            section.setdefault(name, setting.strip())
    return sections


def slices_of_scan(scan: Scan, folder: Path) -> SliceOrder:
    """Slices in their order, as a log names them or in the order of their numbers, with notes."""
    if not scan.named_slices and scan.prefix is not None:
        from planish.io.other_files import folder_contents  # here, so that slices wait for no table

        raise VolumeError(
            f"{folder.name} holds no slice named {scan.prefix} and a number, as {scan.log.name}"
            f" states: {folder_contents(folder)[0]}. Rename the slices, {ELSEWHERE}"
        )
    if not scan.named_slices:
        order = list_slices(folder)
        _check_count(scan, len(order.files), folder)
        return order if scan.step == 1 else order._replace(doubts=())
    numbers, files = [number for number, _ in scan.named_slices], [p for _, p in scan.named_slices]
    check_several(files)
    if not scan.is_of_whole:
        _check_numbers(scan, numbers, folder)
        _check_count(scan, len(files), folder)
    check_no_gap(numbers, folder)
    return SliceOrder(files, doubts=step_doubts(numbers, scan.step))


def _check_numbers(scan: Scan, numbers: list[int], folder: Path) -> None:
    if scan.numbers is None:
        return
    if missing_text := first_missing(scan.numbers, numbers):
        raise VolumeError(
            f"{scan.log.name} states {len(scan.numbers)} sections, {folder.name} holds"
            f" {len(numbers)}. Missing: {missing_text}. Add them, {ELSEWHERE}"
        )
    if odd_numbers := [n for n in numbers if n not in scan.numbers]:
        raise VolumeError(
            f"{folder.name} holds slices that {scan.log.name} does not name:"
            f" {first_few(odd_numbers)}. Move them elsewhere."
        )


def _check_count(scan: Scan, n_files: int, folder: Path) -> None:
    if scan.count not in (None, n_files):
        raise VolumeError(
            f"{scan.log.name} states {scan.count} sections, {folder.name} holds {n_files}. Add"
            f" the others, {ELSEWHERE}"
        )


def check_extent(scan: Scan, shape: tuple[int, ...], first_file: Path) -> tuple[str, ...]:
    """Compare the shape of a volume with that in its log, and say what a copy of a log states."""
    stated_shape = (scan.count, *scan.extent)
    pairs = [(n, there) for n, there in zip(shape, stated_shape, strict=True) if there is not None]
    if all(n == there for n, there in pairs):
        return ()
    shape_text = " x ".join("?" if there is None else str(there) for there in stated_shape)
    if not scan.is_of_whole:
        raise VolumeError(
            f"{first_file.name} is {size_words(shape[1:])} pixels, {scan.log.name} states"
            f" {scan.extent[0]} x {scan.extent[1]}. If the slices were cropped, move the log"
            " elsewhere and give `voxel_um`."
        )
    # Cutting keeps the size of a voxel, scaling does not.
    factors = {round(there / n) for n, there in pairs}
    is_scaled = len(pairs) == 3 and len(factors) == 1
    if is_scaled or any(n > there for n, there in pairs):
        raise VolumeError(
            f"{scan.log.name} states {shape_text} voxels, the slices have {size_words(shape)}: they"
            f" were scaled, or the log is another's. Move the log elsewhere and give `voxel_um`."
        )
    return (
        f"{scan.log.name} describes {shape_text} voxels, the slices have"
        f" {size_words(shape)}: they are read as a part of these, cut out and not scaled.",
    )


_number = partial(finite, decimal_comma=True)


def _count(text: str | None) -> int | None:
    number = _number(text)
    return (
        int(number) if number is not None and 0 <= number < 1e9 and number == int(number) else None
    )
