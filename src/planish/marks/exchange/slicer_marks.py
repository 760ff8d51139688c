"""3D Slicer: point lists in ``.mrk.json``, in mm.

In ``LPS``, x runs to the patient's left and y to the back, which for a picture that is read without
a direction of its own is right and down, as here. In ``RAS`` both signs are opposite. Two lists
belong together in the order of their points; a point that is not selected takes no part in Slicer's
own fits.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.tables import finite, raise_faults
from planish.core.typing import Entries, Fields, Floats
from planish.marks.exchange.lists import Content, PointList
from planish.marks.exchange.model import labels_of, used_of

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


_SIGNS: dict[Any, list[float]] = {"LPS": [1.0, 1.0, 1.0], "RAS": [-1.0, -1.0, 1.0]}


def looks_like(content: Content) -> bool:
    """Return whether it is JSON with markups."""
    return "markups" in content.json


def read(content: Content) -> list[PointList]:
    """Read the point lists of a file; lines, curves, planes and empty lists are passed over."""
    name = content.name
    markups = _markups(content.json["markups"])
    points = [m for m in markups if m.get("type") == "Fiducial" and m.get("controlPoints")]
    if len(points) > 16:
        raise MarkError(
            f"{name} holds {len(points)} lists of points; two are needed. Save those two alone."
        )
    if points:
        return [_point_list(markup, k, name) for k, markup in enumerate(points)]
    kinds = ", ".join(sorted({str(m.get("type")) for m in markups})) or "nothing"
    raise MarkError(
        f"{name} holds no list of points, but {kinds}. Save a point list in Slicer as .mrk.json."
    )


def _markups(entries: Any) -> list[Any]:
    """Those entries of a file that may be markups."""
    if not isinstance(entries, list):
        return []
    return [entry for entry in entries if isinstance(entry, Mapping)]


def write(marks: xr.Dataset, points: dict[str, Floats]) -> dict[str, bytes]:
    """Write one list for each layer, in mm.

    ``points`` are positions (n, 2) or (n, 3) by the name of the list, NaN where a mark is not set.
    """
    labels = labels_of(marks)
    used = used_of(marks).tolist()
    markups: list[Entries] = []
    for role, places in points.items():
        rows = zip(labels, used, places.tolist(), strict=True)
        controls = [_control(number, *row) for number, row in enumerate(rows, 1)]
        markup = {
            "type": "Fiducial",
            "name": role,
            "coordinateSystem": "LPS",
            "coordinateUnits": "mm",
            "locked": False,
            "fixedNumberOfControlPoints": False,
            "labelFormat": "%N-%d",
            "lastUsedControlPointNumber": len(labels),
            "controlPoints": controls,
        }
        markups.append(markup)
    content = {"@schema": SCHEMA, "markups": markups}
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    return {"": f"{text}\n".encode()}


def _control(number: int, label: str, is_used: bool, place: list[float]) -> Entries:
    """Make a point of a list; ``place`` is x, y (and z) in mm, NaN where it is not set."""
    is_set = bool(np.isfinite(place).all())
    return {
        "id": str(number),
        "label": label,
        "description": "",
        "associatedNodeID": "",
        "position": [*place, 0.0][:3] if is_set else [0.0, 0.0, 0.0],
        "selected": is_used,
        "locked": False,
        "visibility": True,
        "positionStatus": "defined" if is_set else "undefined",
    }


def _point_list(markup: Fields, k: int, name: str) -> PointList:
    """Points of a list, in its unit and as LPS; a place that is not defined is NaN.

    ``markup`` is an entry of the file, number ``k`` from 0. MarkError names all points that are
    malformed.
    """
    title = str(markup.get("name") or f"list {k + 1}")
    coordinate_system: object = markup.get("coordinateSystem", "LPS")
    if coordinate_system not in _SIGNS:
        raise MarkError(
            f"{name}: {title} is in {coordinate_system!r}; LPS or RAS is needed. Save it so in"
            " Slicer."
        )
    unit_code: Any = markup.get("coordinateUnits", "mm")
    unit = unit_code[0] if isinstance(unit_code, list) and unit_code else unit_code
    if unit not in ("mm", "um"):
        raise MarkError(
            f"{name}: {title} is in {unit!r}; mm or um is needed. Save it so in Slicer."
        )
    entries: Any = markup["controlPoints"]
    controls: list[Any] = entries if isinstance(entries, list) else [None]
    faults: list[str] = []
    points: list[list[float | None]] = []
    labels: list[str] = []
    used: list[bool] = []
    for number, control in enumerate(controls, 1):
        point_text = f"point {number} of {title}"
        if not isinstance(control, Mapping):
            faults.append(f"{point_text} is malformed")
            continue
        points.append(_position(control, point_text, faults))
        labels.append(str(control.get("label") or f"{title} {number}"))
        used.append(control.get("selected", True) is not False)
    raise_faults(name, faults, "Save the list in Slicer again.", error=MarkError)
    return PointList(
        title=title,
        points=np.array(points, dtype=np.float64) * _SIGNS[coordinate_system],
        unit=unit,
        labels=labels,
        used=used,
    )


def _position(control: Fields, point_text: str, faults: list[str]) -> list[float | None]:
    """Place of a point, which may be set nowhere; what is wrong with it goes into ``faults``.

    The place is x, y, z in the unit of the list, None three times where there is none.
    """
    status: Any = control.get("positionStatus", "defined")
    if status != "defined":
        if status not in ("undefined", "preview"):
            faults.append(f"{point_text} has the status {str(status)[:40]!r}")
        return [None] * 3
    position: Any = control.get("position")
    point: list[float | None] = [None] * 3
    if isinstance(position, list) and len(position) == 3:
        point = [None if isinstance(number, str) else finite(number) for number in position]
    if None in point:
        position_text = f"has the position {str(position)[:40]}, not three finite numbers"
        faults.append(f"{point_text} {position_text}")
    return point
