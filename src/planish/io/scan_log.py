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
from functools import partial
from pathlib import Path
from typing import NamedTuple

from planish.core.errors import FileError, SizeError, VolumeError
from planish.core.tables import finite
from planish.core.text import first_few
from planish.core.typing import Pair, Shape, Texts
from planish.io.formats import pictures_in
from planish.io.guard import reading
from planish.io.sizes import NO_SIZE, Stated
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


Settings = dict[str, str]  # by their keys
NumberedFile = tuple[int, Path]


class Log:
    """A log, and the slices that it names; what it does not state is None."""

    def __init__(self, path: Path, slices: list[Path]) -> None:
        """Read a log, and find the slices by the prefix that it states, or by its own name."""
        self.name = path.name
        self.stem = path.stem.casefold()
        self.sections = _log_sections(path)
        self.keys = self.sections.get("reconstruction", {})
        self.prefix = self.sections.get("file name convention", {}).get("filename prefix") or None
        self.named_slices, is_exact = _named(self.prefix or path.stem, slices)
        if not self.named_slices:
            self.named_slices, is_exact = _named(path.stem, slices)
            # A copy of the log of a scan states the prefix of that scan.
            is_exact = is_exact and self.prefix in (None, path.stem)
        # Whether count, numbers and extent are those of the scan that the slices were cut out of.
        self.is_of_whole = bool(self.named_slices) and not is_exact
        self.count = _count(self.keys.get("sections count"))
        self.step = _count(self.keys.get("section to section step", "1")) or 0
        self.ends = [_count(self.keys.get(f"{end} section")) for end in ("first", "last")]
        sides = ("height", "width")
        self.extent = [_count(self.keys.get(f"result image {side} (pixels)")) for side in sides]

    @property
    def is_of_slices(self) -> bool:
        """True for the log of a reconstruction, or of what was exported from one."""
        return bool(self.keys) or self.size_um is not None

    @property
    def numbers(self) -> range | None:
        """Numbers of the slices."""
        first, last = self.ends
        if first is None or last is None:
            return None
        return range(first, last + 1, self.step)

    @property
    def window(self) -> Pair | None:
        """Attenuation at grey 0 and at the largest grey value, as NRecon has it."""
        ends = ("minimum", "maximum")
        low, high = [_number(self.keys.get(f"{end} for cs to image conversion")) for end in ends]
        if low is None or high is None or low >= high:
            return None
        return low, high

    @property
    def size_um(self) -> float | None:
        """Voxel size of a reconstruction; of a program's own section where it has one."""
        sections = [self.keys, *self.sections.values()]
        sizes = [_number(section.get(RECONSTRUCTED)) for section in sections]
        return next((size for size in sizes if size is not None and size > 0), None)

    @property
    def source(self) -> str:
        """Name in messages."""
        if self.stem.endswith("_rec"):
            return "NRecon log"
        return self.name

    @property
    def details(self) -> Settings:
        """Further keys, as written."""
        details: Settings = {}
        for section, names in DETAIL_KEYS.items():
            settings = self.sections.get(section, {})
            for name in names:
                if name.casefold() in settings:
                    details[name] = settings[name.casefold()]
        return details


class Scan(NamedTuple):
    """Log of the slices of a folder, and what is to be said about it."""

    log: Log
    stated: tuple[Stated, ...]  # voxel size (z, y, x), and that of further logs
    notes: Texts = ()
    doubts: Texts = ()


def _named(prefix: str, slices: list[Path]) -> tuple[list[NumberedFile], bool]:
    """Slices with a prefix and a number, in their order, and whether nothing else is in the name.

    Other pictures, such as NRecon's own preview, are left aside.
    """
    pattern = re.compile(re.escape(prefix) + r"_*(\d+)(\D.*)?", re.IGNORECASE)
    by_ending: dict[str, list[NumberedFile]] = defaultdict(list)
    for path in slices:
        match = pattern.fullmatch(path.stem)
        if match is not None:
            number, ending = match.groups(default="")
            by_ending[ending.casefold()].append((int(number), path))
    if "" in by_ending:
        return sorted(by_ending[""]), True
    if len(by_ending) == 1:
        return sorted(*by_ending.values()), False
    return [], False


def read_scan(folder: Path) -> Scan | None:
    """Read the log of the slices of a folder; None where there is none."""
    slices = pictures_in(folder)
    log_files = filter(_is_log, sorted(folder.iterdir()))
    logs = [_whole_log(file, slices) for file in log_files]
    reconstructions = [log for log in logs if log.is_of_slices]
    if not reconstructions:
        return _scan_by_projections(logs, slices)
    log, *copies = _naming_logs(reconstructions, folder)
    # Copies, and the log of the whole scan beside that of a part, have to state the same size.
    other_logs = [o for o in reconstructions if o in copies or _is_of_whole(o, log)]
    further = [Stated(o.name, (None, o.size_um, o.size_um)) for o in other_logs]
    return Scan(log, (_stated_by(log), *further), _note_on_others(log, slices))


def _is_of_whole(other: Log, log: Log) -> bool:
    """True for the log of the scan out of which that of another log was cut."""
    return other is not log and log.stem.startswith(other.stem)


def _whole_log(path: Path, slices: list[Path]) -> Log:
    """Read a log; refuse one that is named like the slices and ends before it says anything."""
    log = Log(path, slices)
    if log.stem.endswith("_rec") and log.named_slices and not log.is_of_slices:
        raise FileError(
            f"{log.name} is named like the slices and has no section [Reconstruction]: it is cut"
            f" off or damaged. Copy it again, {ELSEWHERE}"
        )
    return log


def _naming_logs(reconstructions: list[Log], folder: Path) -> list[Log]:
    """The log that names the slices, and its copies, which name the same ones."""
    logs = [log for log in reconstructions if log.named_slices] or reconstructions
    logs = sorted(logs, key=lambda log: len(log.name))
    if any(log.named_slices != logs[0].named_slices for log in logs):
        names = ", ".join(log.name for log in logs)
        raise VolumeError(
            f"{folder.name} holds {len(logs)} NRecon logs: {names}. Keep the one of this scan."
        )
    return logs


def _note_on_others(log: Log, slices: list[Path]) -> Texts:
    """Say which pictures of a folder a log does not name."""
    named_files = {path for _, path in log.named_slices}
    unnamed = [p for p in slices if p not in named_files and not is_preview(p)]
    if not named_files or not unnamed:
        return ()
    unnamed_text = f"Pictures left aside: {len(unnamed)}, first {unnamed[0].name}."
    return (f"{log.name} names {len(named_files)} slices. {unnamed_text}",)


def _is_log(path: Path) -> bool:
    """True for a log that is short enough to be one of a reconstruction."""
    is_named = path.suffix.casefold() == ".log" and path.is_file()
    return is_named and path.stat().st_size <= 10_000_000


def _scan_by_projections(logs: list[Log], slices: list[Path]) -> Scan | None:
    """Read the log of the projections beside slices that have no log of their own.

    None where there is none either. Of such a log the size alone holds for the slices.
    """
    if not slices:
        return None
    for log in logs:
        keys = log.sections.get("acquisition", {})
        sizes = [size for key in PROJECTED if (size := _number(keys.get(key)))]
        if not sizes:
            continue
        name = log.name
        first_slice = slices[0]
        projections, _ = _named(keys.get("filename prefix") or log.stem, slices)
        if projections and not re.search("_rec|_voi", log.stem):
            raise VolumeError(
                f"{first_slice.parent.name} holds X-ray projections, first {first_slice.name}, as"
                f" {name} states. Give the folder of the reconstructed slices, {ELSEWHERE}"
            )
        source = f"{name} (its projections)"
        stated = Stated(source, NO_SIZE, "the slices have other names")
        doubts: Texts = ()
        if first_slice.stem.casefold().startswith(log.stem):
            stated = Stated(source, (sizes[0],) * 3)
            doubts = (
                f"{name} states the size of the projections, {sizes[0]:g} um, and none of the"
                " slices: that size is right unless the reconstruction was scaled.",
            )
        return Scan(log, (stated,), doubts=doubts)
    return None


def _stated_by(log: Log) -> Stated:
    """Size along z, y, x of the slices that the log of a reconstruction names."""
    size = log.size_um
    if not size or not log.step:
        raise SizeError(
            f"{log.name} has no number for"
            f" '{'Section to Section Step' if size else 'Pixel Size (um)'}' under [Reconstruction]."
            " Give the size with `voxel_um=SIZE`, in um, and move the log elsewhere."
        )
    if log.numbers is not None and log.count not in (None, len(log.numbers)):
        first, last = log.ends
        raise VolumeError(
            f"{log.name} contradicts itself: {log.count} sections, but from {first} to {last} in"
            f" steps of {log.step}. Correct the log, or move it elsewhere and give `voxel_um`."
        )
    return Stated(log.source, (size * log.step, size, size))


def _log_sections(path: Path) -> dict[str, Settings]:
    """Sections and keys of a log, case-folded.

    The first of keys that occur twice in a section counts.
    """
    with reading(path):
        raw_bytes = path.read_bytes()
    is_utf_16 = raw_bytes[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = raw_bytes.decode("utf-16" if is_utf_16 else "utf-8-sig")
    except UnicodeDecodeError:
        # Names of people and folders, never numbers.
        text = raw_bytes.decode("cp1252", errors="replace")
    sections: dict[str, Settings] = {}
    section: Settings = {}
    for line in map(str.strip, text.splitlines()):
        key, equals, setting = line.partition("=")
        if line.startswith("[") and line.endswith("]"):
            section = sections.setdefault(line[1:-1].strip().casefold(), {})
        elif equals:
            # Casefolding makes the micro sign a Greek mu.
            name = key.strip().casefold().replace("μm", "um")
            section.setdefault(name, setting.strip())
    return sections


def ordered_slices(folder: Path, scan: Scan | None) -> SliceOrder:
    """Slices in their order, as a log names them or in the order of their numbers, with notes."""
    if scan is None or not scan.log.is_of_slices:
        return list_slices(folder)
    log = scan.log
    if not log.named_slices and log.prefix is not None:
        from planish.io.other_files import folder_contents  # here, so that slices wait for no table

        raise VolumeError(
            f"{folder.name} holds no slice named {log.prefix} and a number, as {log.name}"
            f" states: {folder_contents(folder)[0]}. Rename the slices, {ELSEWHERE}"
        )
    if not log.named_slices:
        order = list_slices(folder)
        _check_count(log, len(order.files), folder)
        if log.step == 1:
            return order
        return order._replace(doubts=())
    numbers = [number for number, _ in log.named_slices]
    files = [path for _, path in log.named_slices]
    check_several(files)
    if not log.is_of_whole:
        _check_numbers(log, numbers, folder)
        _check_count(log, len(files), folder)
    check_no_gap(numbers, folder)
    return SliceOrder(files, doubts=step_doubts(numbers, log.step))


def _check_numbers(log: Log, numbers: list[int], folder: Path) -> None:
    if log.numbers is None:
        return
    if missing_text := first_missing(log.numbers, numbers):
        raise VolumeError(
            f"{log.name} states {len(log.numbers)} sections, {folder.name} holds"
            f" {len(numbers)}. Missing: {missing_text}. Add them, {ELSEWHERE}"
        )
    if odd_numbers := [n for n in numbers if n not in log.numbers]:
        raise VolumeError(
            f"{folder.name} holds slices that {log.name} does not name:"
            f" {first_few(odd_numbers)}. Move them elsewhere."
        )


def _check_count(log: Log, n_files: int, folder: Path) -> None:
    if log.count not in (None, n_files):
        raise VolumeError(
            f"{log.name} states {log.count} sections, {folder.name} holds {n_files}. Add"
            f" the others, {ELSEWHERE}"
        )


def check_extent(log: Log, shape: Shape) -> Texts:
    """Compare the shape (z, y, x) of a volume with that in its log.

    Say what the copy of a log states that belongs to the whole scan; VolumeError where the shape
    cannot be that of a part of it.
    """
    stated_shape = [log.count, *log.extent]
    lengths = zip(shape, stated_shape, strict=True)
    ratios = [stated / n for n, stated in lengths if stated is not None]
    if set(ratios) <= {1.0}:
        return ()
    stated_text = " x ".join("?" if n is None else str(n) for n in stated_shape)
    shapes_text = f"{log.name} states {stated_text} voxels, the slices have {size_words(shape)}"
    # Cutting keeps the size of a voxel, scaling does not: all edges change by one factor.
    is_scaled = len(ratios) == 3 and len({*map(round, ratios)}) == 1
    if not log.is_of_whole or is_scaled or min(ratios) < 1:
        raise VolumeError(
            f"{shapes_text}: they were cropped or scaled, or the log is another's. Move the log"
            " elsewhere and give `voxel_um`."
        )
    return (f"{shapes_text}: they are read as a part of these, cut out and not scaled.",)


_number = partial(finite, decimal_comma=True)


def _count(text: str | None) -> int | None:
    number = _number(text)
    if number is None or not 0 <= number < 1e9 or not number.is_integer():
        return None
    return int(number)
