"""Files of regions: GeoJSON (RFC 7946) with coordinates in um, x then y, read and written; those of ImageJ are read.

Which program wrote a file is recognised by its first bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from planish.core.errors import FileError
from planish.core.tables import decode_text, raise_faults, read_bytes
from planish.marks.regions.imagej import ROI, ZIP, read_roi, read_roi_zip
from planish.marks.regions.model import MOST_POINTS, MOST_REGIONS, Region, Regions, Ring, ring_of, text_of

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
    if content.startswith(ZIP):
        regions = read_roi_zip(content, name, most=_LARGEST_FILE)
    else:
        regions = (read_roi if content.startswith(ROI) else _read_geojson)(content, name)
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

    Raises
    ------
    FileError
        If it is no GeoJSON, damaged, or holds something else than polygons; all faults are named.
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
    rows = ",\n".join(f"  {json.dumps(_feature(region), ensure_ascii=False)}" for region in regions.declared)
    return f'{{\n "type": "FeatureCollection",\n "units": "um",\n "features": [\n{rows}\n ]\n}}\n'


def _feature(region: Region) -> dict[str, Any]:
    polygons = [[[*ring.tolist(), ring[0].tolist()] for ring in rings] for rings in region.polygons]
    geometry: dict[str, Any] = {"type": "MultiPolygon", "coordinates": polygons}
    if len(polygons) == 1:
        geometry = {"type": "Polygon", "coordinates": polygons[0]}
    texts = {key: text for key in _TEXTS if (text := getattr(region, key))}
    return {"type": "Feature", "properties": texts, "geometry": geometry}
