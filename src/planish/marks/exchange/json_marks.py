"""Read and write the marks' own JSON (docs/marks-files.md).

It holds everything that is known of them, one mark a line, with a version.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Generic, Literal, TypeVar

import numpy as np
import xarray as xr
from pydantic import Field, PositiveFloat

from planish.core.errors import MarkError
from planish.core.tables import naming_faults, raise_faults
from planish.core.transform import are_known
from planish.core.typing import Entries, Floats
from planish.marks.exchange import model
from planish.marks.exchange.lists import (
    MOST_MARKS,
    Content,
    Part,
    check_count,
    json_file,
    json_text,
)
from planish.marks.exchange.model import RESIDUAL, RESULTS, MarkPlaces, check_marks

FORMAT = "planish-marks"
VERSION = 1
_PAGE = "docs/marks-files.md describes the format."
_POSITION = {"diameter": "diameter_um", "axis_ratio": "axis_ratio", "arc_coverage": "arc_coverage"}
T = TypeVar("T")
Label = Annotated[str, Field(min_length=1, max_length=200)]
Source = Literal["detected", "clicked", "predicted", "imported", "tile"]


class _Pair(Part, Generic[T]):
    x: T
    y: T


class _Axes(Part):
    x: Literal["right"] = "right"
    y: Literal["down"] = "down"


class _Layer(Part):
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    title: Annotated[str, Field(max_length=200)] | None = None
    pixel_um: _Pair[PositiveFloat] | None = None
    origin_um: _Pair[float] | None = None
    size_px: _Pair[Annotated[int, Field(gt=0, le=10**9)]] | None = None
    side: Literal["top", "bottom"] | None = None
    machine_direction_deg: float | None = None


class _Place(Part):
    x: float
    y: float
    z: float | None = None
    covariance_um2: list[list[float]] | None = None
    diameter_um: PositiveFloat | None = None
    axis_ratio: Annotated[float, Field(ge=1)] | None = None
    arc_coverage: Annotated[float, Field(ge=0, le=1)] | None = None
    source: Source


class _Mark(Part):
    label: Label
    used: bool = True
    at: dict[str, _Place]
    residual_um: Annotated[float, Field(ge=0)] | None = None
    leave_one_out_um: Annotated[float, Field(ge=0)] | None = None


class _File(Part):
    format: Literal["planish-marks"]
    version: Literal[1]
    units: Literal["um"]
    axes: _Axes
    layers: Annotated[list[_Layer], Field(min_length=1, max_length=16)]
    registration: Entries | None = None
    marks: Annotated[list[_Mark], Field(max_length=MOST_MARKS)]


def looks_like(content: Content) -> bool:
    """Return whether its ``format`` says so."""
    return content.json.get("format") == FORMAT


def read(content: Content) -> xr.Dataset:
    """Read the marks of a JSON file, as `make_marks` makes them.

    ``attrs["registration"]`` keeps what the file says of a fit. MarkError names all faults of the
    file.
    """
    name = content.name
    file = _checked_file(content)
    names = [layer.name for layer in file.layers]
    raise_faults(name, _cross_field_faults(file, names), _PAGE, error=MarkError)
    places: dict[str, MarkPlaces] = {}
    about: dict[str, Entries] = {}
    for layer in file.layers:
        layer_places = [mark.at.get(layer.name) for mark in file.marks]
        places[layer.name] = _places(layer_places)
        about[layer.name] = layer.model_dump(exclude_none=True, exclude={"name"})
    results: dict[str, Floats] = {}
    for key in RESULTS:
        errors_um = _column(file.marks, f"{key}_um")
        if np.isfinite(errors_um).any():
            results[key] = errors_um
    labels = [mark.label for mark in file.marks]
    used = [mark.used for mark in file.marks]
    marks = model.make_marks(labels, places, used=used, about=about, results=results)
    check_marks(marks, name)
    if file.registration is not None:
        marks.attrs["registration"] = file.registration
    return marks


def _checked_file(content: Content) -> _File:
    """Check the fields of a file, each by itself.

    MarkError for a later version, too many marks, or fields that are wrong; all of them are named.
    """
    name = content.name
    entries = content.json
    version = entries.get("version")
    if type(version) is int and version > VERSION:
        raise MarkError(
            f"{name} has version {version} of the format; this planish reads up to version"
            f" {VERSION}. Update planish, or write the marks again with the older one."
        )
    mark_entries: object = entries.get("marks")
    if isinstance(mark_entries, list):
        check_count(name, len(mark_entries))
    with naming_faults(name, _PAGE, error=MarkError):
        return _File.model_validate(dict(entries))


def write(marks: xr.Dataset, _points: dict[str, Floats]) -> dict[str, bytes]:
    """Write a JSON file, from which `read` gives the same numbers back.

    What is not known of a mark is left out. MarkError where something has no place in the format.
    """
    layers = model.layer_names(marks)
    rows: list[Entries] = []
    used = model.used_of(marks).tolist()
    for label, is_used in zip(model.labels_of(marks), used, strict=True):
        rows.append({"label": label, "used": is_used, "at": {}})
    for layer in layers:
        places = model.places_of(marks, layer)
        for k in np.flatnonzero(are_known(places.um)).tolist():
            rows[k]["at"][layer] = _place(places, k)
    for key in filter(marks.__contains__, RESULTS):
        errors_um = marks[key].values
        for k in np.flatnonzero(np.isfinite(errors_um)):
            rows[k][f"{key}_um"] = float(errors_um[k])
    head: Entries = {
        "format": FORMAT,
        "version": VERSION,
        "units": "um",
        "axes": {"x": "right", "y": "down"},
        "layers": [],
    }
    for layer in layers:
        about = {"name": layer, **model.about_layer(marks, layer)}
        # In the same order whatever it came from.
        keys = dict.fromkeys([*_Layer.model_fields, *about])
        head["layers"].append({key: about[key] for key in keys if key in about})
    if "registration" in marks.attrs:
        head["registration"] = marks.attrs["registration"]
    with naming_faults("The marks cannot be written", error=MarkError):
        _File.model_validate(head | {"marks": rows})
    return {"": json_file(head, "marks", "[]", list(map(json_text, rows))).encode()}


def _column(parts: Sequence[Part | None], key: str) -> Floats:
    """Give the numbers of one field; NaN where it is not there."""
    numbers = [getattr(part, key, None) for part in parts]
    return np.array(numbers, dtype=np.float64)


def _places(layer_places: Sequence[_Place | None]) -> MarkPlaces:
    """Positions of one layer, with what is known of them; z where some have it.

    None stands for a mark that is not in the layer: its numbers are NaN.
    """
    um = np.stack([_column(layer_places, axis) for axis in "xyz"], axis=1)
    spread = np.full((len(layer_places), 2, 2), np.nan)
    sources = ["imported"] * len(layer_places)
    for k, place in enumerate(layer_places):
        if place is not None:
            sources[k] = place.source
            if place.covariance_um2 is not None:
                spread[k] = place.covariance_um2
    extras = {name: _column(layer_places, key) for name, key in _POSITION.items()}
    extras["cov_xx"] = spread[:, 0, 0]
    extras["cov_xy"] = spread[:, 0, 1]
    extras["cov_yy"] = spread[:, 1, 1]
    if not np.isfinite(um[:, 2]).any():
        um = um[:, :2]
    return MarkPlaces(um=um, source=sources, extras=extras)


def _place(places: MarkPlaces, k: int) -> Entries:
    """Make the entry of mark ``k`` in a layer.

    What is NaN is left out; a covariance is written where all of it is known.
    """
    row: Entries = dict(zip("xyz", places.um[k].tolist(), strict=False))
    extras: dict[str, float] = {}
    for name, column in places.extras.items():
        if np.isfinite(column[k]):
            extras[name] = float(column[k])
    if extras.keys() >= {"cov_xx", "cov_xy", "cov_yy"}:
        xy = extras["cov_xy"]
        xx = extras["cov_xx"]
        yy = extras["cov_yy"]
        row["covariance_um2"] = [[xx, xy], [xy, yy]]
    row |= {key: extras[name] for name, key in _POSITION.items() if name in extras}
    return row | {"source": places.source[k]}


def _cross_field_faults(file: _File, layers: list[str]) -> list[str]:
    """Faults that no field has for itself: layers, positions and covariances that do not fit.

    ``layers`` are the names of the file's layers, in order.
    """
    counts = Counter(sorted(layers))
    faults = [f"the layer {name} is there {n} times" for name, n in counts.items() if n > 1]
    if RESIDUAL in layers:
        faults.append(f"{RESIDUAL} cannot be the name of a layer")
    z_states: dict[str, set[bool]] = {}
    for k, mark in enumerate(file.marks):
        for layer, place in mark.at.items():
            mark_text = f"marks[{k}] ({mark.label}) at {layer}"
            if layer not in layers:
                faults.append(f"{mark_text}: there is no such layer")
            z_states.setdefault(layer, set()).add(place.z is not None)
            if not _is_covariance(place.covariance_um2):
                faults.append(
                    f"{mark_text}: the covariance is not [[xx, xy], [xy, yy]] of a spread"
                )
    faults += [
        f"some positions in {n} have z and some have none"
        for n, states in z_states.items()
        if len(states) > 1
    ]
    return faults


def _is_covariance(cov: list[list[float]] | None) -> bool:
    if cov is None:
        return True
    if [len(row) for row in cov] != [2, 2]:
        return False
    (xx, xy), (yx, yy) = cov
    # Rounding may leave a determinant of a little less than zero.
    return min(xx, yy) >= 0 and xy == yx and xy * xy <= xx * yy * (1 + 1e-9)
