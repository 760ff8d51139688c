"""Files of regions: GeoJSON (RFC 7946) with coordinates in um, x then y, read and written.

Those of ImageJ are read.

Which program wrote a file is recognised by its first bytes. ImageJ saves a selection, ``.roi``, or
those of the ROI Manager, ``.zip``. Its header is that of ``ij.io.RoiDecoder`` (public domain): 64
bytes, big-endian, then places in its box as shorts, and behind them those of a finer selection as
floats. A second header holds the name and the properties. Coordinates are in pixels and 0 at the
corner of the first one.
"""

import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np

from planish.core.errors import FileError
from planish.core.tables import decode_text, raise_faults, read_bytes
from planish.marks.regions.model import (
    MOST_POINTS,
    MOST_REGIONS,
    Region,
    Regions,
    Ring,
    nested,
    ring_of,
    text_of,
)

ROI, ZIP = b"Iout", b"PK"  # first bytes of a selection and of an archive
_HEAD = 64  # bytes
_RECTANGLE, _OVAL, _POLYGONS = 1, 2, (0, 7, 8)  # drawn by points, freehand, traced
_NO_AREA = {
    3: "a line",
    4: "a freehand line",
    5: "a segmented line",
    6: "empty",
    9: "an angle",
    10: "points",
}
_OVERLAYS = {1: "a text", 2: "an arrow", 4: "an image"}
_MOVE, _LINE, _QUADRATIC, _CUBIC, _CLOSE = range(5)  # codes of composite selections
# ImageJ takes a pixel whose centre lies on a border where the region lies left of it, planish where
# it lies right.
_NUDGE = np.array([2.0**-26, 2.0**-34])
_DRAW = "Draw each region as a polygon, rectangle, oval or freehand selection, and save it again."
_LARGEST_FILE = 64_000_000
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
        If the file cannot be read, is damaged, too large, or holds something else than polygons;
        all faults are named.
    """
    name = Path(path).name
    content = read_bytes(path, what="file of regions", most_bytes=_LARGEST_FILE)
    faults: list[str] = []
    readers: list[tuple[str, Callable[[], Region]]] = []
    if is_imagej := content.startswith((ZIP, ROI)):
        remedy = _DRAW
        for part_name, data in (
            _unpacked(content, name) if content.startswith(ZIP) else [(name, content)]
        ):
            readers.append(
                (repr(part_name[:80]), partial(_selection, data, PurePosixPath(part_name).stem))
            )
    else:
        remedy = "Coordinates are [x, y] in um of the reference; docs/linking.md shows an example."
        for k, feature in enumerate(_features(content, name, faults), 1):
            readers.append((f"region {k}", partial(_region, feature, f"region {k}")))
    regions: list[Region] = []
    for title, read_region in readers:
        try:
            regions.append(read_region())
        except (ValueError, struct.error) as error:
            faults.append(
                f"{title}: {'it ends early' if isinstance(error, struct.error) else error}"
            )
    raise_faults(name, faults, remedy, error=FileError)
    point_count = sum(
        len(ring) for region in regions for rings in region.polygons for ring in rings
    )
    if not regions:
        raise FileError(f"{name} holds no region. Draw one, or leave --regions out.")
    if len(regions) > MOST_REGIONS or point_count > MOST_POINTS:
        raise FileError(
            f"{name} holds {len(regions)} regions with {point_count} points; {MOST_REGIONS} regions"
            f" with {MOST_POINTS} points are the most. Simplify them, or join them to"
            " MultiPolygons."
        )
    return Regions(declared=tuple(regions), in_pixels=is_imagej)


def _unpacked(data: bytes, name: str) -> list[tuple[str, bytes]]:
    # Entries of its table of contents, before that is read.
    if data.count(b"PK\1\2") > 2 * MOST_REGIONS:
        raise FileError(
            f"{name} holds more than {MOST_REGIONS} entries. Give an archive of the ROI Manager of"
            " ImageJ."
        )
    files: list[tuple[str, bytes]] = []
    bytes_left = _LARGEST_FILE
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for entry in archive.infolist():
                if entry.is_dir() or entry.filename.startswith("__MACOSX/"):
                    continue
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError("packed in an unusual way")
                # What the archive says of its sizes need not be true.
                with archive.open(entry) as stream:
                    files.append((entry.filename, stream.read(bytes_left + 1)))
                bytes_left -= len(files[-1][1])
                if bytes_left < 0:
                    raise FileError(
                        f"{name} is too large when unpacked. Give an archive of the ROI Manager of"
                        " ImageJ."
                    )
    # One with a password is a RuntimeError.
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        RuntimeError,
        ValueError,
        struct.error,
    ) as error:
        raise FileError(
            f"{name} is a damaged archive ({error}). Save the selections again."
        ) from error
    if not files:
        raise FileError(f"{name} is an empty archive. {_DRAW}")
    return files


def _selection(data: bytes, default_name: str) -> Region:  # noqa: C901
    """Make a region of a selection.

    ValueError where it is none, struct.error where it ends early.
    """
    if not data.startswith(ROI):
        raise ValueError("it is no selection of ImageJ")
    version, selection_type = struct.unpack_from(">hB", data, 4)
    (composite_size,) = struct.unpack_from(">i", data, 36)
    subtype, option_flags, corner_diameter, header2_offset = struct.unpack_from(
        ">hh2xh4xi", data, 48
    )
    if selection_type in _NO_AREA or subtype in _OVERLAYS:
        raise ValueError(
            f"it is {_OVERLAYS.get(subtype) or _NO_AREA.get(selection_type)}, which covers no area"
        )
    subpixel_version = version if option_flags & 128 else 0
    if composite_size > 0:
        polygons = nested([ring_of(ring) for ring in _composite_rings(data, composite_size)])
    elif selection_type in (_RECTANGLE, _OVAL):
        if selection_type == _RECTANGLE and corner_diameter > 0:
            raise ValueError("it is a rectangle with rounded corners")
        polygons = ((ring_of(_box(data, selection_type, is_subpixel=subpixel_version >= 223)),),)
    elif selection_type in _POLYGONS:
        if option_flags & 1:
            raise ValueError(
                "it is fitted with a spline; take points along it (Edit, Selection, Interpolate)"
            )
        polygons = ((ring_of(_polygon(data, is_subpixel=subpixel_version >= 222)),),)
    else:
        raise ValueError(f"it is of the unknown type {selection_type}")
    texts = {"name": default_name}
    if _HEAD <= header2_offset <= len(data) - 52:
        texts["name"] = _text(data, header2_offset + 16) or default_name
        for line in _text(data, header2_offset + 40).splitlines():
            key, _, text = line.partition(":")
            if key.strip().lower() in _TEXTS[1:]:
                texts[key.strip().lower()] = text
    return Region(polygons=polygons, **{key: text_of(text, key) for key, text in texts.items()})


def _box(data: bytes, selection_type: int, *, is_subpixel: bool) -> Ring:
    """Give the corners of a rectangle; or an oval, as a polygon with its points on it."""
    top, left, bottom, right = map(_short, struct.unpack_from(">4h", data, 8))
    x, y, w, h = (
        struct.unpack_from(">4f", data, 18)
        if is_subpixel
        else (left, top, right - left, bottom - top)
    )
    if not (0 < w <= 1e6 and 0 < h <= 1e6):
        raise ValueError(f"it is {w:g} x {h:g} pixels large")
    if selection_type == _RECTANGLE:
        return np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
    radius = max(0.5 * max(w, h), 1.0)
    # The polygon of an oval may lie a hundredth of a pixel inside it.
    angle = np.linspace(
        0, 2 * np.pi, math.ceil(np.pi / math.acos(1 - 0.01 / radius)), endpoint=False
    )
    return np.stack([x + 0.5 * w * (1 + np.cos(angle)), y + 0.5 * h * (1 + np.sin(angle))], axis=1)


def _polygon(data: bytes, *, is_subpixel: bool) -> Ring:
    """Give the places of the points, in whole pixels within the selection's box, or finer."""
    y0, x0, count = struct.unpack_from(">2h4xH", data, 8)
    if count == 0:  # more than two bytes can count
        (count,) = struct.unpack_from(">i", data, 18)
    if not 3 <= count <= MOST_POINTS:
        raise ValueError(f"it has {count} points; 3 to {MOST_POINTS} are possible")
    start, kind = (_HEAD + 4 * count, "f") if is_subpixel else (_HEAD, "h")
    coordinates = struct.unpack_from(f">{2 * count}{kind}", data, start)
    points = np.array(coordinates, dtype=np.float64).reshape(2, count).T
    if not is_subpixel:
        points = np.maximum(np.where(points < -5000, points + 65536, points), 0)
        points = points + np.array([_short(x0), _short(y0)])
    return points + _NUDGE


def _composite_rings(data: bytes, float_count: int) -> Iterator[Ring]:
    """Yield the borders of a composite selection.

    Moves, lines and ends, each a code and its place.
    """
    if float_count > 3 * MOST_POINTS:
        raise ValueError(f"it has {float_count} numbers; {MOST_POINTS} points are possible")
    floats = np.array(struct.unpack_from(f">{float_count}f", data, _HEAD))
    offset, ring_starts = 0, list[list[int]]()
    while offset < float_count:
        code = floats[offset]
        if code in (_QUADRATIC, _CUBIC):
            raise ValueError(
                "it is a composite selection with curves; split it (More, Split in the ROI Manager)"
            )
        if code not in (_MOVE, _LINE, _CLOSE) or (code == _LINE and not ring_starts):
            raise ValueError(
                "it is a composite selection of unknown parts; split it (More, Split in the ROI"
                " Manager)"
            )
        if code == _MOVE:
            ring_starts.append([])
        if code != _CLOSE:
            ring_starts[-1].append(offset + 1)
        offset += 1 if code == _CLOSE else 3
    if offset > float_count:
        raise ValueError("it ends early")
    for vertex_offsets in map(np.array, ring_starts):
        ring = np.stack([floats[vertex_offsets], floats[vertex_offsets + 1]], axis=1)
        # ImageJ leaves places and lines behind, which cover no area.
        if len(np.unique(ring, axis=0)) > 2:
            yield ring + _NUDGE


def _short(coordinate: int) -> int:
    """Undo the overflow of a place beyond 32767, as ImageJ does."""
    return coordinate + 65536 if coordinate < -5000 else coordinate


def _text(data: bytes, offset: int) -> str:
    start, length = struct.unpack_from(">ii", data, offset)
    if start <= 0 or length <= 0:
        return ""
    return struct.unpack_from(f"{2 * length}s", data, start)[0].decode("utf-16-be", "replace")


def _features(data: bytes, name: str, faults: list[str]) -> list[Any]:
    """Read the features of a FeatureCollection or a Feature.

    A bare Polygon or MultiPolygon becomes one.
    """
    text = decode_text(data, name, what="file of regions")
    # Every point has a bracket: what has far more of them would fill the memory when it is decoded.
    if max(text.count("["), text.count("{")) > 2 * MOST_POINTS:
        raise FileError(f"{name} holds more than {MOST_POINTS} points. Simplify the regions.")
    try:
        content: object = json.loads(text)
    except RecursionError as error:
        raise FileError(
            f"{name} is nested too deeply for GeoJSON. Save the regions again."
        ) from error
    except ValueError as error:
        raise FileError(
            f"{name} is neither GeoJSON nor a file of ImageJ: {error}. Save the regions again."
        ) from error
    root = _object(content)
    kind, features = root.get("type"), root.get("features")
    if root.get("units", "um") != "um":
        faults.append("its units are not um")
    if kind in ("Polygon", "MultiPolygon"):
        return [{"geometry": root}]
    if kind == "Feature":
        return [root]
    if kind == "FeatureCollection" and isinstance(features, list):
        return cast("list[Any]", features)
    raise FileError(
        f"{name} is JSON, but no GeoJSON of regions: a FeatureCollection, a Feature, a Polygon or a"
        " MultiPolygon is needed. Draw the regions as polygons and save them as GeoJSON."
    )


def _region(feature: object, default_name: str) -> Region:
    geometry, properties = (
        _object(_object(feature).get("geometry")),
        _object(feature).get("properties"),
    )
    geometry_type, coordinates = geometry.get("type"), geometry.get("coordinates")
    if geometry_type not in ("Polygon", "MultiPolygon"):
        type_text = repr(geometry_type[:40]) if isinstance(geometry_type, str) else "none"
        raise ValueError(f"its geometry is {type_text}; a Polygon or MultiPolygon is needed")
    if not isinstance(properties, dict | None):
        raise ValueError("its properties are no object")
    texts = {key: text_of(_object(properties).get(key), key) for key in _TEXTS}
    texts["name"] = texts["name"] or default_name
    polygons = (
        _list(coordinates, "coordinates") if geometry_type == "MultiPolygon" else [coordinates]
    )
    borders = (map(_ring, _list(polygon, "a polygon")) for polygon in polygons)
    return Region(polygons=tuple(map(tuple, borders)), **texts)


def _ring(points: object) -> Ring:
    positions = _list(points, "a border")
    # A third number, which the format allows, is a height.
    for k, position in enumerate(positions, 1):
        is_pair = isinstance(position, list) and len(position) in (2, 3)
        if not is_pair or any(type(v) not in (int, float) for v in position):
            raise ValueError(f"position {k} of a border is not [x, y]")
    try:
        return ring_of(np.array([position[:2] for position in positions], dtype=np.float64))
    except OverflowError as error:
        raise ValueError("a coordinate is beyond all numbers") from error


def _list(content: object, title: str) -> list[Any]:
    if not isinstance(content, list) or not content:
        raise ValueError(f"{title} is no list, or empty")
    return cast("list[Any]", content)


def _object(content: object) -> dict[str, Any]:
    return cast("dict[str, Any]", content) if isinstance(content, dict) else {}


def geojson_text(regions: Regions) -> str:
    """Write regions in um as a FeatureCollection, one feature a line.

    Reading it gives the same numbers back.
    """
    assert not regions.in_pixels
    feature_lines: list[str] = []
    for region in regions.declared:
        polygons = [
            [[*ring.tolist(), ring[0].tolist()] for ring in rings] for rings in region.polygons
        ]
        geometry_type, coordinates = (
            ("Polygon", polygons[0]) if len(polygons) == 1 else ("MultiPolygon", polygons)
        )
        texts = {key: text for key in _TEXTS if (text := getattr(region, key))}
        geometry = {"type": geometry_type, "coordinates": coordinates}
        feature = {"type": "Feature", "properties": texts, "geometry": geometry}
        feature_lines.append(f"  {json.dumps(feature, ensure_ascii=False)}")
    features = ",\n".join(feature_lines)
    return (
        f'{{\n "type": "FeatureCollection",\n "units": "um",\n "features": [\n{features}\n ]\n}}\n'
    )
