"""The marks' own JSON: everything that is known of them, one mark a line, with a version.

``docs/marks-files.md`` describes it. A file of a newer version is refused, not guessed at; a key that is not known is
an error, because a misspelt one would be lost in silence.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from planish.core.errors import MarkError
from planish.core.tables import MOST_FAULTS
from planish.marks.files.content import MOST_MARKS, Content, check_count, refuse
from planish.marks.files.formats import Outgoing
from planish.marks.files.model import (
    EXTRAS,
    RESIDUAL,
    RESULTS,
    Places,
    about_layer,
    labels_of,
    layer_names,
    make_marks,
    places_of,
    used_of,
)
from planish.marks.files.plausible import check_marks

FORMAT = "planish-marks"
VERSION = 1

_POSITION = {"diameter": "diameter_um", "axis_ratio": "axis_ratio", "arc_coverage": "arc_coverage"}

Positive = Annotated[float, Field(gt=0)]
Source = Literal["detected", "clicked", "predicted", "imported"]
LayerName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _Sizes(_Part):
    x: Positive
    y: Positive


class _Point(_Part):
    x: float
    y: float


class _Count(_Part):
    x: Annotated[int, Field(gt=0, le=10**9)]
    y: Annotated[int, Field(gt=0, le=10**9)]


class _Axes(_Part):
    x: Literal["right"] = "right"
    y: Literal["down"] = "down"


class _Layer(_Part):
    name: LayerName
    title: Annotated[str, Field(max_length=200)] | None = None
    pixel_um: _Sizes | None = None
    origin_um: _Point | None = None
    size_px: _Count | None = None
    side: Literal["top", "bottom"] | None = None
    machine_direction_deg: float | None = None


class _Place(_Part):
    x: float
    y: float
    z: float | None = None
    covariance_um2: list[list[float]] | None = None
    diameter_um: Positive | None = None
    axis_ratio: Annotated[float, Field(ge=1)] | None = None
    arc_coverage: Annotated[float, Field(ge=0, le=1)] | None = None
    source: Source


class _Mark(_Part):
    label: Annotated[str, Field(min_length=1, max_length=200)]
    used: bool = True
    at: dict[str, _Place]
    residual_um: Annotated[float, Field(ge=0)] | None = None
    leave_one_out_um: Annotated[float, Field(ge=0)] | None = None


class _File(_Part):
    format: Literal["planish-marks"]
    version: Literal[1]
    units: Literal["um"]
    axes: _Axes
    layers: Annotated[list[_Layer], Field(min_length=1, max_length=16)]
    registration: dict[str, Any] | None = None
    marks: Annotated[list[_Mark], Field(max_length=MOST_MARKS)]


def looks_like(content: Content) -> bool:
    """Whether its ``format`` says so."""
    return content.json is not None and content.json.get("format") == FORMAT


def read(file: Content) -> xr.Dataset:
    """Marks of a JSON file.

    Returns
    -------
    Dataset, dims (mark)
        As `make_marks` makes it.
    """
    name, content = file.name, file.json or {}
    version = content.get("version")
    if type(version) is int and version > VERSION:
        raise MarkError(
            f"{name} has version {version} of the format; this planish reads up to version {VERSION}. Update planish, "
            "or write the marks again with the older one."
        )
    marks: object = content.get("marks")
    if isinstance(marks, list):
        check_count(name, len(marks))
    try:
        held = _File.model_validate(dict(content))
    except ValidationError as error:
        raise MarkError(f"{name}: {_faults(error)}. docs/marks-files.md describes the format.") from error
    names = [layer.name for layer in held.layers]
    faults = _own_faults(held, names)
    refuse(name, faults, "docs/marks-files.md describes the format.")
    found = make_marks(
        [mark.label for mark in held.marks],
        {layer: _places(held, layer) for layer in names},
        used=[mark.used for mark in held.marks],
        about={layer.name: layer.model_dump(exclude={"name"}, exclude_none=True) for layer in held.layers},
        results={
            key: values
            for key in RESULTS
            if np.isfinite(values := np.array([_or_nan(getattr(mark, f"{key}_um")) for mark in held.marks])).any()
        },
    )
    check_marks(found, name)
    return found if held.registration is None else found.assign_attrs(registration=held.registration)


def write(out: Outgoing) -> dict[str, bytes]:
    """Write a JSON file, from which `read` gives the same numbers back."""
    marks = out.marks
    layers = layer_names(marks)
    places = {layer: places_of(marks, layer) for layer in layers}
    labels, used = labels_of(marks), used_of(marks)
    rows: list[dict[str, Any]] = []
    for k, label in enumerate(labels):
        row: dict[str, Any] = {"label": label, "used": bool(used[k])}
        row["at"] = {layer: _place(p, k) for layer, p in places.items() if np.isfinite(p.um[k]).all()}
        for key in RESULTS:
            if key in marks and np.isfinite(marks[key].values[k]):
                row[f"{key}_um"] = float(marks[key].values[k])
        rows.append(row)
    head: dict[str, Any] = {"format": FORMAT, "version": VERSION, "units": "um", "axes": {"x": "right", "y": "down"}}
    head["layers"] = [{"name": layer, **about_layer(marks, layer)} for layer in layers]
    if "registration" in marks.attrs:
        head["registration"] = marks.attrs["registration"]
    try:
        _File.model_validate(head | {"marks": rows})
    except ValidationError as error:
        raise MarkError(f"The marks cannot be written: {_faults(error)}.") from error

    def line(value: object) -> str:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)

    top = "".join(f' "{key}": {line(value)},\n' for key, value in head.items())
    text = f'{{\n{top} "marks": [\n' + ",\n".join(f"  {line(row)}" for row in rows) + "\n ]\n}\n"
    return {"": text.encode()}


def _places(file: _File, layer: str) -> Places:
    there = [mark.at.get(layer) for mark in file.marks]
    axes = "xyz" if any(place is not None and place.z is not None for place in there) else "xy"
    points = [[_or_nan(None if p is None else getattr(p, axis)) for axis in axes] for p in there]
    columns: dict[str, list[float]] = {name: [] for name in EXTRAS}
    for place in there:
        for name, key in _POSITION.items():
            columns[name].append(_or_nan(None if place is None else getattr(place, key)))
        cov = None if place is None else place.covariance_um2
        (xx, xy), (_, yy) = cov or [[np.nan, np.nan], [np.nan, np.nan]]
        for name, value in (("cov_xx", xx), ("cov_xy", xy), ("cov_yy", yy)):
            columns[name].append(value)
    return Places(
        um=np.array(points, dtype=np.float64).reshape(len(there), len(axes)),
        source=["imported" if p is None else p.source for p in there],
        extras={name: np.array(values) for name, values in columns.items()},
    )


def _place(places: Places, k: int) -> dict[str, Any]:
    row: dict[str, Any] = {axis: float(v) for axis, v in zip("xyz", places.um[k], strict=False)}
    extras = {name: float(values[k]) for name, values in places.extras.items() if np.isfinite(values[k])}
    if {"cov_xx", "cov_xy", "cov_yy"} <= set(extras):
        xy = extras["cov_xy"]
        row["covariance_um2"] = [[extras["cov_xx"], xy], [xy, extras["cov_yy"]]]
    row |= {key: extras[name] for name, key in _POSITION.items() if name in extras}
    row["source"] = places.source if isinstance(places.source, str) else str(places.source[k])
    return row


def _own_faults(file: _File, names: list[str]) -> list[str]:
    """What the fields alone do not show."""
    faults = [f"the layer {n} is there {names.count(n)} times" for n in sorted(set(names)) if names.count(n) > 1]
    faults += [f"{n} cannot be the name of a layer" for n in names if n == RESIDUAL]
    deep: dict[str, set[bool]] = {}
    for k, mark in enumerate(file.marks):
        for layer, place in mark.at.items():
            where = f"marks[{k}] ({mark.label}) at {layer}"
            if layer not in names:
                faults.append(f"{where}: there is no such layer")
            deep.setdefault(layer, set()).add(place.z is not None)
            cov = place.covariance_um2
            if cov is not None and not _is_covariance(cov):
                faults.append(f"{where}: the covariance is not [[xx, xy], [xy, yy]] of a spread")
    faults += [f"some positions in {n} have z and some have none" for n, kinds in deep.items() if len(kinds) > 1]
    return faults


def _is_covariance(cov: list[list[float]]) -> bool:
    if len(cov) != 2 or any(len(row) != 2 for row in cov):
        return False
    (xx, xy), (yx, yy) = cov
    # Rounding may leave a determinant of a little less than zero.
    return xx >= 0 and yy >= 0 and xy == yx and xy * xy <= xx * yy * (1 + 1e-9)


def _faults(error: ValidationError) -> str:
    listed = error.errors(include_url=False, include_input=False)
    texts = [f"{'.'.join(str(part) for part in e['loc']) or 'the file'}: {e['msg']}" for e in listed[:MOST_FAULTS]]
    more = f"; and {len(listed) - MOST_FAULTS} more" if len(listed) > MOST_FAULTS else ""
    return "; ".join(texts) + more


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else float(value)
