"""Files of regions: GeoJSON (RFC 7946) with coordinates in um, x then y, read and written; those of ImageJ are read.

Which program wrote a file is recognised by its first bytes. ImageJ saves a selection, ``.roi``, or those of the ROI
Manager, ``.zip``. Its header is that of ``ij.io.RoiDecoder`` (public domain): 64 bytes, big-endian, then places in its
box as shorts, and behind them those of a finer selection as floats. A second header holds the name and the properties.
Coordinates are in pixels and 0 at the corner of the first one.
"""

from __future__ import annotations

import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np

from planish.core.errors import FileError
from planish.core.tables import decode_text, raise_faults, read_bytes
from planish.marks.regions.model import MOST_POINTS, MOST_REGIONS, Region, Regions, Ring, nested, ring_of, text_of

ROI, ZIP = b"Iout", b"PK"  # first bytes of a selection and of an archive
_HEAD, _SECOND = 64, 52  # bytes of the two headers
_SPLINE, _SUBPIXEL, _SUBPIXEL_FROM, _SUBPIXEL_BOX_FROM = 1, 128, 222, 223  # options, and versions from which they hold
_RECTANGLE, _OVAL, _POLYGONS = 1, 2, (0, 7, 8)  # drawn by points, freehand, traced
_NO_AREA = {3: "a line", 4: "a freehand line", 5: "a segmented line", 6: "empty", 9: "an angle", 10: "points"}
_OVERLAYS = {1: "a text", 2: "an arrow", 4: "an image"}
_MOVE, _LINE, _QUADRATIC, _CUBIC, _CLOSE = range(5)  # codes of composite selections
# ImageJ takes a pixel whose centre lies on a border where the region lies left of it, planish where it lies right.
_NUDGE = np.array([2.0**-26, 2.0**-34])
_WIDEST = 1e6  # pixels
_DRAW = "Draw each region as a polygon, rectangle, oval or freehand selection, and save it again."


def _unpacked(data: bytes, name: str, *, most: int) -> list[tuple[str, bytes]]:
    """Names and bytes of an archive of selections, unpacked at most ``most`` bytes."""
    if data.count(b"PK\1\2") > 2 * MOST_REGIONS:  # entries of its table of contents, before that is read
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
    return parts


def _read_selections(parts: list[tuple[str, bytes]], name: str) -> Regions:
    faults: list[str] = []
    regions: list[Region] = []
    for part, data in parts:
        try:
            regions.append(_selection(data, PurePosixPath(part).stem))
        except (ValueError, struct.error) as error:
            why = "it ends early" if isinstance(error, struct.error) else error
            faults.append(f"{part[:80]!r}: {why}")
    raise_faults(name, faults, _DRAW, error=FileError)
    return Regions(declared=tuple(regions), in_pixels=True)


def _selection(data: bytes, default_name: str) -> Region:
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
    label, properties = "", dict[str, str]()
    if _HEAD <= second_header <= len(data) - _SECOND:
        label = _text(data, *struct.unpack_from(">ii", data, second_header + 16))
        lines = _text(data, *struct.unpack_from(">ii", data, second_header + 40)).splitlines()
        properties = {key.strip().lower(): value for key, sign, value in (k.partition(":") for k in lines) if sign}
    texts = {"name": label or default_name} | {k: properties[k] for k in ("reason", "author") if k in properties}
    return Region(polygons=polygons, **{key: text_of(value, key) for key, value in texts.items()})


def _box(data: bytes, kind: int, *, is_subpixel: bool) -> Ring:
    """Give the corners of a rectangle; or an oval, as a polygon with its points on it."""
    top, left, bottom, right = map(_short, struct.unpack_from(">4h", data, 8))
    x, y, w, h = struct.unpack_from(">4f", data, 18) if is_subpixel else (left, top, right - left, bottom - top)
    if not (0 < w <= _WIDEST and 0 < h <= _WIDEST):
        raise ValueError(f"it is {w:g} x {h:g} pixels large")
    if kind == _RECTANGLE:
        return np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
    radius = max(0.5 * max(w, h), 1.0)
    # The polygon of an oval may lie a hundredth of a pixel inside it.
    angle = np.linspace(0, 2 * np.pi, math.ceil(np.pi / math.acos(1 - 0.01 / radius)), endpoint=False)
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


def _text(data: bytes, begin: int, length: int) -> str:
    if begin <= 0 or length <= 0:
        return ""
    if begin + 2 * length > len(data):
        raise ValueError("it ends early")
    return data[begin : begin + 2 * length].decode("utf-16-be", "replace")


_LARGEST_FILE = 64_000_000
_REMEDY = "Coordinates are [x, y] in um of the reference; docs/linking.md shows an example."
_TEXTS = ("name", "reason", "author")


def read_regions(path: str | Path) -> Regions:
    """Read regions of GeoJSON, or of ImageJ: a selection or an archive of them.

    Parameters
    ----------
    path : path

    Returns
    -------
    Regions
        In um of GeoJSON; of ImageJ in pixels, which :meth:`Regions.on` turns into um.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, too large, or holds something else than polygons.
    """
    name = Path(path).name
    content = read_bytes(path, what="file of regions", most=_LARGEST_FILE)
    if content.startswith((ZIP, ROI)):
        parts = _unpacked(content, name, most=_LARGEST_FILE) if content.startswith(ZIP) else [(name, content)]
        regions = _read_selections(parts, name)
    else:
        regions = _read_geojson(content, name)
    points = sum(len(ring) for region in regions.declared for rings in region.polygons for ring in rings)
    if not regions.declared:
        raise FileError(f"{name} holds no region. Draw one, or leave --regions out.")
    if len(regions.declared) > MOST_REGIONS or points > MOST_POINTS:
        raise FileError(
            f"{name} holds {len(regions.declared)} regions with {points} points; {MOST_REGIONS} regions with "
            f"{MOST_POINTS} points are the most. Simplify them, or join them to MultiPolygons."
        )
    return regions


def _read_geojson(data: bytes, name: str) -> Regions:
    """Read a FeatureCollection, a Feature, or a bare Polygon or MultiPolygon.

    FileError if it is no GeoJSON, damaged, or holds something else than polygons; all faults are named.
    """
    text = decode_text(data, name, what="file of regions")
    # Every point has a bracket: what has far more of them would fill the memory when it is decoded.
    if max(text.count("["), text.count("{")) > 2 * MOST_POINTS:
        raise FileError(f"{name} holds more than {MOST_POINTS} points. Simplify the regions.")
    try:
        content: object = json.loads(text)
    except RecursionError as error:
        raise FileError(f"{name} is nested too deeply for GeoJSON. Save the regions again.") from error
    except ValueError as error:
        raise FileError(f"{name} is neither GeoJSON nor a file of ImageJ: {error}. Save the regions again.") from error
    faults: list[str] = []
    regions: list[Region] = []
    for k, feature in enumerate(_features(content, name, faults), 1):
        try:
            regions.append(_region(feature, f"region {k}"))
        except ValueError as error:
            faults.append(f"region {k}: {error}")
    raise_faults(name, faults, _REMEDY, error=FileError)
    return Regions(declared=tuple(regions))


def _features(content: object, name: str, faults: list[str]) -> Iterator[dict[str, Any]]:
    """Yield all features of a file; a bare geometry becomes one."""
    top = _object(content) or {}
    kind = top.get("type")
    if top.get("units", "um") != "um":
        faults.append("its units are not um")
    if kind in ("Polygon", "MultiPolygon"):
        yield {"geometry": top}
    elif kind == "Feature":
        yield top
    elif kind == "FeatureCollection" and isinstance(top.get("features"), list):
        yield from (_object(feature) or {} for feature in cast("list[object]", top["features"]))
    else:
        raise FileError(
            f"{name} is JSON, but no GeoJSON of regions: a FeatureCollection, a Feature, a Polygon or a MultiPolygon "
            "is needed. Draw the regions as polygons and save them as GeoJSON."
        )


def _region(feature: dict[str, Any], default_name: str) -> Region:
    geometry, properties = _object(feature.get("geometry")) or {}, feature.get("properties")
    kind, places = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        described = repr(kind[:40]) if isinstance(kind, str) else "none"
        raise ValueError(f"its geometry is {described}; a Polygon or MultiPolygon is needed")
    if properties is not None and _object(properties) is None:
        raise ValueError("its properties are no object")
    texts = {key: text_of((properties or {}).get(key), key) for key in _TEXTS}
    polygons = tuple(
        tuple(_ring(ring) for ring in _list(rings, "a polygon"))
        for rings in (_list(places, "coordinates") if kind == "MultiPolygon" else [places])
    )
    return Region(polygons=polygons, **(texts | {"name": texts["name"] or default_name}))


def _ring(points: object) -> Ring:
    listed = _list(points, "a border")
    # A third number, which the format allows, is a height.
    for k, place in enumerate(listed, 1):
        if not isinstance(place, list) or len(place) not in (2, 3) or any(type(v) not in (int, float) for v in place):
            raise ValueError(f"position {k} of a border is not [x, y]")
    try:
        return ring_of(np.array([p[:2] for p in listed], dtype=np.float64))
    except OverflowError as error:
        raise ValueError("a coordinate is beyond all numbers") from error


def _list(value: object, title: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"{title} is no list, or empty")
    return cast("list[Any]", value)


def _object(value: object) -> dict[str, Any] | None:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


def geojson_text(regions: Regions) -> str:
    """Write regions in um as a FeatureCollection, one feature a line; reading it gives the same numbers back."""
    assert not regions.in_pixels
    rows: list[str] = []
    for region in regions.declared:
        polygons = [[[*ring.tolist(), ring[0].tolist()] for ring in rings] for rings in region.polygons]
        kind, places = ("Polygon", polygons[0]) if len(polygons) == 1 else ("MultiPolygon", polygons)
        texts = {key: text for key in _TEXTS if (text := getattr(region, key))}
        feature = {"type": "Feature", "properties": texts, "geometry": {"type": kind, "coordinates": places}}
        rows.append(f"  {json.dumps(feature, ensure_ascii=False)}")
    features = ",\n".join(rows)
    return f'{{\n "type": "FeatureCollection",\n "units": "um",\n "features": [\n{features}\n ]\n}}\n'
