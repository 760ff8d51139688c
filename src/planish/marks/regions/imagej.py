"""Regions as ImageJ saves them: a selection, ``.roi``, or those of the ROI Manager, ``.zip``.

The header is that of ``ij.io.RoiDecoder`` (public domain): 64 bytes, big-endian, then places relative to its box as
shorts, and behind them those of a finer selection as floats. A second header holds the name and the properties.
Coordinates are in pixels and 0 at the corner of the first one.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import PurePosixPath

import numpy as np

from planish.core.errors import FileError
from planish.core.tables import raise_faults
from planish.marks.regions.model import MOST_POINTS, MOST_REGIONS, Region, Regions, Ring, nested, ring_of, text_of

ROI, ZIP = b"Iout", b"PK"  # first bytes of a selection and of an archive

_ENTRY = b"PK\1\2"  # begins an entry of the table of contents of an archive
_HEAD, _SECOND = 64, 52  # bytes of the two headers
_SPLINE, _SUBPIXEL, _SUBPIXEL_FROM, _SUBPIXEL_BOX_FROM = 1, 128, 222, 223  # options, and versions from which they hold
_RECTANGLE, _OVAL, _POLYGONS = 1, 2, (0, 7, 8)  # drawn by points, freehand, traced
_NO_AREA = {3: "a line", 4: "a freehand line", 5: "a segmented line", 6: "empty", 9: "an angle", 10: "points"}
_OVERLAYS = {1: "a text", 2: "an arrow", 4: "an image"}
_MOVE, _LINE, _QUADRATIC, _CUBIC, _CLOSE = range(5)  # codes of composite selections
# ImageJ takes a pixel whose centre lies on a border where the region lies left of it, planish where it lies right.
_NUDGE = np.array([2.0**-26, 2.0**-34])
_FLATTENED = 0.01  # pixels by which the polygon of an oval may lie inside it
_WIDEST = 1e6  # pixels
_DRAW = "Draw each region as a polygon, rectangle, oval or freehand selection, and save it again."


def read_roi(data: bytes, name: str) -> Regions:
    """Read a selection; FileError if it is damaged or covers no area."""
    return _read([(name, data)], name)


def read_roi_zip(data: bytes, name: str, *, most: int) -> Regions:
    """Read an archive of selections, unpacked at most ``most`` bytes; FileError if one of them is of no use."""
    if data.count(_ENTRY) > 2 * MOST_REGIONS:  # before its table of contents is read
        raise FileError(f"{name} holds more than {MOST_REGIONS} entries. Give an archive of the ROI Manager of ImageJ.")
    parts: list[tuple[str, bytes]] = []
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                if entry.is_dir() or entry.filename.startswith("__MACOSX/"):
                    continue
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError("packed in an unusual way")
                with archive.open(entry) as file:  # what the archive says of its sizes need not be true
                    parts.append((entry.filename, file.read(most + 1)))
                most -= len(parts[-1][1])
                if most < 0:
                    raise FileError(f"{name} is too large when unpacked. Give an archive of the ROI Manager of ImageJ.")
    # One with a password is a RuntimeError.
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError, struct.error) as error:
        raise FileError(f"{name} is a damaged archive ({error}). Save the selections again.") from error
    if not parts:
        raise FileError(f"{name} is an empty archive. {_DRAW}")
    return _read(parts, name)


def _read(parts: list[tuple[str, bytes]], name: str) -> Regions:
    faults: list[str] = []
    regions: list[Region] = []
    for part, data in parts:
        try:
            regions.append(_region(data, PurePosixPath(part).stem))
        except (ValueError, struct.error) as error:
            why = "it ends early" if isinstance(error, struct.error) else error
            faults.append(f"{part[:80]!r}: {why}")
    raise_faults(name, faults, _DRAW, error=FileError)
    return Regions(declared=tuple(regions), in_pixels=True)


def _region(data: bytes, default_name: str) -> Region:
    """Make a region of a selection; ValueError or struct.error where it is none."""
    if not data.startswith(ROI):
        raise ValueError("it is no selection of ImageJ")
    version, kind = struct.unpack_from(">hB", data, 4)
    (composite,) = struct.unpack_from(">i", data, 36)
    subtype, options, _, rounded, _, second_header = struct.unpack_from(">hhhhii", data, 48)
    if kind in _NO_AREA or subtype in _OVERLAYS:
        raise ValueError(f"it is {_OVERLAYS.get(subtype) or _NO_AREA.get(kind)}, which covers no area")
    subpixel_version = version if options & _SUBPIXEL else 0
    if composite > 0:
        polygons = nested([ring_of(ring) for ring in _composite_rings(data, composite)])
    elif kind in (_RECTANGLE, _OVAL):
        if kind == _RECTANGLE and rounded > 0:
            raise ValueError("it is a rectangle with rounded corners")
        polygons = ((ring_of(_box(data, kind, is_subpixel=subpixel_version >= _SUBPIXEL_BOX_FROM)),),)
    elif kind in _POLYGONS:
        if options & _SPLINE:
            raise ValueError("it is fitted with a spline; take points along it (Edit, Selection, Interpolate)")
        polygons = ((ring_of(_polygon(data, is_subpixel=subpixel_version >= _SUBPIXEL_FROM)),),)
    else:
        raise ValueError(f"it is of the unknown type {kind}")
    label, properties = _name_and_properties(data, second_header)
    texts = {key: text_of(value, key) for key, value in (("name", label or default_name), *properties.items())}
    return Region(polygons=polygons, **texts)


def _box(data: bytes, kind: int, *, is_subpixel: bool) -> Ring:
    """Give the corners of a rectangle; or an oval, as a polygon with its points on it."""
    top, left, bottom, right = map(_short, struct.unpack_from(">4h", data, 8))
    x, y, w, h = struct.unpack_from(">4f", data, 18) if is_subpixel else (left, top, right - left, bottom - top)
    if not (0 < w <= _WIDEST and 0 < h <= _WIDEST):
        raise ValueError(f"it is {w:g} x {h:g} pixels large")
    if kind == _RECTANGLE:
        return np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
    radius = max(0.5 * max(w, h), 1.0)
    angle = np.linspace(0, 2 * np.pi, math.ceil(np.pi / math.acos(1 - _FLATTENED / radius)), endpoint=False)
    return np.stack([x + 0.5 * w * (1 + np.cos(angle)), y + 0.5 * h * (1 + np.sin(angle))], axis=1)


def _polygon(data: bytes, *, is_subpixel: bool) -> Ring:
    """Give the places of the points: whole pixels within the box of the selection, or finer ones."""
    y0, x0, _, _, count = struct.unpack_from(">4hH", data, 8)
    if count == 0:  # more than two bytes can count
        (count,) = struct.unpack_from(">i", data, 18)
    if not 3 <= count <= MOST_POINTS:
        raise ValueError(f"it has {count} points; 3 to {MOST_POINTS} are possible")
    begin, kind = (_HEAD + 4 * count, ">f4") if is_subpixel else (_HEAD, ">i2")
    size = 2 * count * np.dtype(kind).itemsize
    if len(data) < begin + size:
        raise ValueError("it ends early")
    places = np.frombuffer(data, kind, 2 * count, begin).reshape(2, count).T.astype(np.float64)
    if not is_subpixel:
        places = np.maximum(np.where(places < -5000, places + 65536, places), 0)
        places = places + np.array([_short(x0), _short(y0)])
    return places + _NUDGE


def _composite_rings(data: bytes, count: int) -> Iterator[Ring]:
    """Yield the borders of a composite selection: moves, lines and ends, each a code and its place."""
    if count > 3 * MOST_POINTS:
        raise ValueError(f"it has {count} numbers; {MOST_POINTS} points are possible")
    if len(data) < _HEAD + 4 * count:
        raise ValueError("it ends early")
    numbers = np.frombuffer(data, ">f4", count, _HEAD).astype(np.float64)
    position, begins = 0, list[list[int]]()
    while position < count:
        code = numbers[position]
        if code in (_QUADRATIC, _CUBIC):
            raise ValueError("it is a composite selection with curves; split it (More, Split in the ROI Manager)")
        if code not in (_MOVE, _LINE, _CLOSE) or (code == _LINE and not begins):
            raise ValueError("it is a composite selection of unknown parts; split it (More, Split in the ROI Manager)")
        if code == _MOVE:
            begins.append([])
        if code != _CLOSE:
            begins[-1].append(position + 1)
        position += 1 if code == _CLOSE else 3
    if position > count:
        raise ValueError("it ends early")
    for places in map(np.array, begins):
        ring = np.stack([numbers[places], numbers[places + 1]], axis=1)
        if len(np.unique(ring, axis=0)) > 2:  # ImageJ leaves places and lines behind, which cover no area
            yield ring + _NUDGE


def _short(value: int) -> int:
    """Undo the overflow of a place beyond 32767, as ImageJ does."""
    return value + 65536 if value < -5000 else value


def _name_and_properties(data: bytes, begin: int) -> tuple[str, dict[str, str]]:
    """Read the name of a selection, and its properties ``reason`` and ``author``."""
    if not _HEAD <= begin <= len(data) - _SECOND:
        return "", {}
    name = _text(data, *struct.unpack_from(">ii", data, begin + 16))
    lines = [line.partition(":") for line in _text(data, *struct.unpack_from(">ii", data, begin + 40)).splitlines()]
    properties = {key.strip().lower(): value for key, sign, value in lines if sign}
    return name, {key: properties[key] for key in ("reason", "author") if key in properties}


def _text(data: bytes, begin: int, length: int) -> str:
    if begin <= 0 or length <= 0:
        return ""
    if begin + 2 * length > len(data):
        raise ValueError("it ends early")
    return data[begin : begin + 2 * length].decode("utf-16-be", "replace")
