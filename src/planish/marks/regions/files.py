"""Files of regions: GeoJSON (RFC 7946) with coordinates in um, x then y, read and written.

Those of ImageJ and QuPath are read.

Which program wrote a file is recognised by its content. ImageJ saves a selection, ``.roi``, or
those of the ROI Manager, ``.zip``, QuPath GeoJSON whose features are its objects. Coordinates of
both are in pixels and 0 at the corner of the first one.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np
from roifile import ROI_OPTIONS, ROI_SUBTYPE, ROI_TYPE, ImagejRoi

from planish.core.errors import FileError
from planish.core.tables import decode_text, raise_faults, read_bytes
from planish.core.typing import Entries
from planish.marks.imagej_selections import LARGEST_FILE, ROI, ZIP, selection_of, selections_in
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

_POLYGONS = (ROI_TYPE.POLYGON, ROI_TYPE.FREEHAND, ROI_TYPE.TRACED)
_NO_AREA = {
    ROI_TYPE.LINE: "a line",
    ROI_TYPE.FREELINE: "a freehand line",
    ROI_TYPE.POLYLINE: "a segmented line",
    ROI_TYPE.NOROI: "empty",
    ROI_TYPE.ANGLE: "an angle",
    ROI_TYPE.POINT: "points",
}
_OVERLAYS = {
    ROI_SUBTYPE.TEXT: "a text",
    ROI_SUBTYPE.ARROW: "an arrow",
    ROI_SUBTYPE.IMAGE: "an image",
}
# ImageJ takes a pixel whose centre lies on a border where the region lies left of it, planish where
# it lies right.
_NUDGE = np.array([2.0**-26, 2.0**-34])
_DRAW = "Draw each region as a polygon, rectangle, oval or freehand selection, and save it again."
_TEXTS = ("name", "reason", "author")


def read_regions(path: str | Path) -> Regions:
    """Read regions of GeoJSON, or of ImageJ: a selection or an archive of them.

    Parameters
    ----------
    path : path

    Returns
    -------
    Regions
        In um of GeoJSON; of ImageJ, QuPath and GeoJSON with ``"units": "pixel"`` in pixels, which
        :meth:`Regions.on` turns into um.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, too large, or holds something else than polygons;
        all faults are named.
    """
    name = Path(path).name
    content = read_bytes(path, what="file of regions", most_bytes=LARGEST_FILE)
    units: object = "pixel"
    readers: list[tuple[str, Callable[[], Region]]] = []
    if content.startswith((ZIP, ROI)):
        remedy = _DRAW
        for part_name, data in selections_in(content, name, most=MOST_REGIONS, remedy=_DRAW):
            read_part = partial(_selection, data, PurePosixPath(part_name).stem)
            readers.append((repr(part_name[:80]), read_part))
    else:
        remedy = "Coordinates are [x, y] in um of the reference; docs/linking.md shows an example."
        root, features = _features(content, name)
        is_of_qupath = any(map(_is_of_qupath, features))
        units = root.get("units", "pixel" if is_of_qupath else "um")
        for k, feature in enumerate(features, 1):
            title = f"region {k}"
            readers.append((title, partial(_region, feature, title)))
    in_pixels = units in ("pixel", "px")
    faults: list[str] = []
    if units != "um" and not in_pixels:
        faults.append("its units are neither um nor pixel")
    regions: list[Region] = []
    for title, read_region in readers:
        try:
            regions.append(read_region())
        except ValueError as error:
            faults.append(f"{title}: {error}")
    raise_faults(name, faults, remedy, error=FileError)
    _check_size(regions, name)
    return Regions(declared=tuple(regions), in_pixels=in_pixels)


def _check_size(regions: Sequence[Region], name: str) -> None:
    """Refuse a file without regions, or with more than a program should work through."""
    if not regions:
        raise FileError(f"{name} holds no region. Draw one, or leave `regions` out.")
    rings = chain.from_iterable(chain(*region.polygons) for region in regions)
    point_count = sum(map(len, rings))
    if len(regions) > MOST_REGIONS or point_count > MOST_POINTS:
        raise FileError(
            f"{name} holds {len(regions)} regions with {point_count} points; {MOST_REGIONS} regions"
            f" with {MOST_POINTS} points are the most. Simplify them, or join them to"
            " MultiPolygons."
        )


def _selection(data: bytes, default_name: str) -> Region:
    """Make a region of a selection; ValueError, with the reason, where it is none.

    In pixels as `ImagejRoi` counts; reason and author are taken from the properties of the
    selection.
    """
    roi = selection_of(data)
    if roi.roitype in _NO_AREA or roi.subtype in _OVERLAYS:
        raise ValueError(
            f"it is {_OVERLAYS.get(roi.subtype) or _NO_AREA.get(roi.roitype)}, which covers no area"
        )
    if roi.composite:
        polygons = nested([ring_of(ring) for ring in _composite_rings(roi)])
    else:
        polygons = ((_border(roi, data[6]),),)
    texts = {"name": text_of(roi.name or default_name, "name")}
    for line in roi.props.splitlines():
        name, _, text = line.partition(":")
        key = name.strip().lower()
        if key in _TEXTS[1:]:
            texts[key] = text_of(text, key)
    return Region(polygons=polygons, **texts)


def _border(roi: ImagejRoi, type_number: int) -> Ring:
    """Give the border of a selection that is a single polygon, rectangle or oval.

    ``type_number`` is that in the file, for the message. ValueError, with the reason, for what is
    none.
    """
    if roi.roitype in (ROI_TYPE.RECT, ROI_TYPE.OVAL):
        if roi.roitype == ROI_TYPE.RECT and roi.rounded_rect_arc_size > 0:
            raise ValueError("it is a rectangle with rounded corners")
        return ring_of(_box(roi))
    if roi.roitype not in _POLYGONS:
        raise ValueError(f"it is of the unknown type {type_number}")
    if roi.options & ROI_OPTIONS.SPLINE_FIT:
        raise ValueError(
            "it is fitted with a spline; take points along it (Edit, Selection, Interpolate)"
        )
    if not 3 <= roi.n_coordinates <= MOST_POINTS:
        raise ValueError(f"it has {roi.n_coordinates} points; 3 to {MOST_POINTS} are possible")
    return ring_of(roi.coordinates() + _NUDGE)


def _box(roi: ImagejRoi) -> Ring:
    """Give the corners of a rectangle; or an oval, as a polygon with its points on it.

    In pixels, from the corner of the first one.
    """
    x = roi.left
    y = roi.top
    w = roi.right - roi.left
    h = roi.bottom - roi.top
    if roi.subpixelrect:
        x = roi.xd
        y = roi.yd
        w = roi.widthd
        h = roi.heightd
    if not (0 < w <= 1e6 and 0 < h <= 1e6):
        raise ValueError(f"it is {w:g} x {h:g} pixels large")
    if roi.roitype == ROI_TYPE.RECT:
        corners = [(0, 0), (w, 0), (w, h), (0, h)]
        return np.add((x, y), corners)
    radius = max(0.5 * max(w, h), 1.0)
    # The polygon of an oval may lie a hundredth of a pixel inside it.
    count = math.ceil(np.pi / math.acos(1 - 0.01 / radius))
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    points_x = x + 0.5 * w * (1 + np.cos(angle))
    points_y = y + 0.5 * h * (1 + np.sin(angle))
    return np.stack([points_x, points_y], axis=1)


def _composite_rings(roi: ImagejRoi) -> Iterator[Ring]:
    """Yield the borders of a composite selection.

    Each is (n, 2), x and y in pixels. ValueError, with the reason, where they cannot be read.
    """
    if roi.shape_roi_size > 3 * MOST_POINTS:
        raise ValueError(f"it has {roi.shape_roi_size} numbers; {MOST_POINTS} points are possible")
    try:
        rings = roi.coordinates(multi=True)
    except NotImplementedError as error:
        raise ValueError(
            "it is a composite selection with curves; split it (More, Split in the ROI Manager)"
        ) from error
    except (RuntimeError, IndexError, OverflowError) as error:
        raise ValueError(
            "it is a composite selection of unknown parts; split it (More, Split in the ROI"
            " Manager)"
        ) from error
    for ring in rings:
        # ImageJ leaves places and lines behind, which cover no area.
        if len(np.unique(ring, axis=0)) > 2:
            yield ring + _NUDGE


def _is_of_qupath(feature: object) -> bool:
    """Return whether a feature is an object of QuPath, which counts in pixels."""
    identifier = _object(feature).get("id")
    is_old = isinstance(identifier, str) and identifier.startswith("Path")
    return is_old or "objectType" in _object(_object(feature).get("properties"))


def _features(data: bytes, name: str) -> tuple[Entries, list[Any]]:
    """Read a FeatureCollection or a Feature, and its features.

    A bare Polygon or MultiPolygon becomes one, as does a list of features.

    FileError for what is no JSON, no GeoJSON of regions, or too large.
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
    if isinstance(content, list):  # as older versions of QuPath write them
        root = {"type": "FeatureCollection", "features": content}
    kind = root.get("type")
    features = root.get("features")
    if kind in ("Polygon", "MultiPolygon"):
        return root, [{"geometry": root}]
    if kind == "Feature":
        return root, [root]
    if kind == "FeatureCollection" and isinstance(features, list):
        return root, cast("list[Any]", features)
    raise FileError(
        f"{name} is JSON, but no GeoJSON of regions: a FeatureCollection, a Feature, a Polygon or a"
        " MultiPolygon is needed. Draw the regions as polygons and save them as GeoJSON."
    )


def _region(feature: object, default_name: str) -> Region:
    """Make a region of a feature of GeoJSON; ValueError, with the reason, where it is none.

    Coordinates are in the unit of the file. Without a name of its own it has the default one.
    """
    geometry = _object(_object(feature).get("geometry"))
    properties = _object(feature).get("properties")
    geometry_type = geometry.get("type")
    coordinates = geometry.get("coordinates")
    if geometry_type not in ("Polygon", "MultiPolygon"):
        type_text = repr(geometry_type[:40]) if isinstance(geometry_type, str) else "none"
        raise ValueError(f"its geometry is {type_text}; a Polygon or MultiPolygon is needed")
    if not isinstance(properties, dict | None):
        raise ValueError("its properties are no object")
    texts = {key: text_of(_object(properties).get(key), key) for key in _TEXTS}
    texts["name"] = texts["name"] or default_name
    is_single = geometry_type == "Polygon"
    polygons = [coordinates] if is_single else _list(coordinates, "coordinates")
    borders = [tuple(map(_ring, _list(polygon, "a polygon"))) for polygon in polygons]
    return Region(polygons=tuple(borders), **texts)


def _ring(points: object) -> Ring:
    """Make a border of the positions of GeoJSON; ValueError, with the reason, where it is none."""
    positions = _list(points, "a border")
    # A third number, which the format allows, is a height.
    for k, position in enumerate(positions, 1):
        is_pair = isinstance(position, list) and len(position) in (2, 3)
        if not is_pair or any(type(v) not in (int, float) for v in position):
            raise ValueError(f"position {k} of a border is not [x, y]")
    try:
        points_xy = [position[:2] for position in positions]
        return ring_of(np.array(points_xy, dtype=np.float64))
    except OverflowError as error:
        raise ValueError("a coordinate is beyond all numbers") from error


def _list(content: object, title: str) -> list[Any]:
    if not isinstance(content, list) or not content:
        raise ValueError(f"{title} is no list, or empty")
    return cast("list[Any]", content)


def _object(content: object) -> Entries:
    return cast("Entries", content) if isinstance(content, dict) else {}


def _closed(ring: Ring) -> list[list[float]]:
    return [*ring.tolist(), ring[0].tolist()]


def geojson_text(regions: Regions) -> str:
    """Write regions in um as a FeatureCollection, one feature a line.

    Reading it gives the same numbers back.
    """
    assert not regions.in_pixels
    feature_lines: list[str] = []
    for region in regions.declared:
        polygons: list[Any] = [[*map(_closed, rings)] for rings in region.polygons]
        geometry = {"type": "MultiPolygon", "coordinates": polygons}
        if len(polygons) == 1:
            geometry = {"type": "Polygon", "coordinates": polygons[0]}
        texts = {key: getattr(region, key) for key in _TEXTS if getattr(region, key)}
        feature = {"type": "Feature", "properties": texts, "geometry": geometry}
        feature_lines.append(f"  {json.dumps(feature, ensure_ascii=False)}")
    features = ",\n".join(feature_lines)
    return (
        f'{{\n "type": "FeatureCollection",\n "units": "um",\n "features": [\n{features}\n ]\n}}\n'
    )
