"""Turn lists of points as other programs write them into marks in um.

Units, origins, and which list is which.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import eq
from pathlib import Path
from typing import Any, cast

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict

from planish.core.errors import FileError, MarkError, SizeError
from planish.core.tables import Rows, decode_text, read_bytes, split_rows
from planish.core.typing import Entries, Fields, Floats
from planish.marks.exchange.formats import Unit, known_formats
from planish.marks.exchange.model import MarkPlaces, make_marks
from planish.marks.imagej_selections import ROI, ZIP

MOST_MARKS = 100_000
SELECTIONS = (ROI, ZIP)  # first bytes of a selection of ImageJ, or of an archive of them
MATLAB = (b"MATLAB", b"\x89HDF\r\n\x1a\n")  # first bytes of a file of MATLAB 5 to 7.3


class Part(BaseModel):
    """A part of a JSON file of marks or holes.

    Types are not converted, and unknown keys are faults.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """A file of marks: its name, for messages, and what it holds.

    No text in one of MATLAB, no rows in JSON.
    """

    name: str
    data: bytes
    text: str = ""
    rows: Rows = field(default_factory=lambda: Rows(rows=[], comments=[]))
    json: Fields = field(default_factory=Entries)

    @property
    def header(self) -> list[str]:
        """Cells of the first row."""
        return self.rows.rows[0].cells if self.rows.rows else []


def read_content(path: str | Path) -> Content:
    """Read a file, whatever its format.

    By its first bytes it is a file of MATLAB or ImageJ, JSON, or a table. FileError where it is
    empty or damaged, MarkError where it has more marks than a sheet can have.
    """
    place = Path(path)
    name = place.name
    data = read_bytes(place, what="file of marks")
    # Version 4 of MATLAB has no heading that says what it is.
    is_matlab = data.startswith(MATLAB) or place.suffix.lower() == ".mat"
    if is_matlab or data.startswith(SELECTIONS):
        return Content(name=name, data=data)
    text = decode_text(data, name, what="file of marks")
    if not text.strip():
        raise FileError(f"{name} is empty. Give a file of marks: {known_formats()}.")
    if text.lstrip()[:1] in "{[":
        return Content(name=name, data=data, text=text, json=read_object(text, name))
    rows = split_rows(text)
    check_count(name, len(rows.rows) - 1)
    return Content(name=name, data=data, text=text, rows=rows)


def check_count(name: str, count: int) -> None:
    """Refuse more marks than a sheet can have."""
    if count > MOST_MARKS:
        raise MarkError(
            f"{name} holds {count} marks; {MOST_MARKS} are the most. Give a file with marks only."
        )


def json_text(content: object) -> str:
    """Write JSON in one line."""
    return json.dumps(content, ensure_ascii=False, allow_nan=False)


def json_file(header: Fields, list_name: str, brackets: str, entries: Sequence[str]) -> str:
    """Write a JSON object: a head, and under a name a list or an object.

    The head has one key a line, the list or object one entry a line.
    """
    header_text = "".join(f' "{key}": {json_text(content)},\n' for key, content in header.items())
    entries_text = ",\n".join(f"  {entry}" for entry in entries)
    return f'{{\n{header_text} "{list_name}": {brackets[0]}\n{entries_text}\n {brackets[1]}\n}}\n'


def read_object(text: str, name: str) -> Fields:
    """Read the object of a JSON file of marks or holes."""
    try:
        content: object = json.loads(text, object_pairs_hook=_unique_keys)
    except RecursionError as error:
        raise FileError(
            f"{name} is nested too deeply for a file of marks. Give {known_formats()}."
        ) from error
    except ValueError as error:
        raise FileError(f"{name} is damaged JSON: {error}. Save the marks again.") from error
    if not isinstance(content, dict):
        raise FileError(
            f"{name} is JSON, but no file of marks: it holds a list. These are read:"
            f" {known_formats()}."
        )
    return cast("Entries", content)


def _unique_keys(key_values: list[tuple[str, Any]]) -> Entries:
    entries = dict(key_values)
    if len(entries) < len(key_values):
        key, count = Counter(key for key, _ in key_values).most_common(1)[0]
        raise ValueError(f"the key {key[:40]!r} stands {count} times in one object")
    return entries


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointList:
    """Points of one layer in the numbers of a file.

    ``points`` (n, 2) or (n, 3) are in ``unit``, which the file states (``stated``) or which is
    usual for it; without one it is asked for, and ``columns`` are those that do not state it. The
    first pixel's centre is at ``first_centre`` pixels; NaN is a point that is not set. No labels:
    they have
    numbers only; no ``used``: all are used. ``placed`` positions are those of the layer already;
    others count from the centre of its first pixel. ``extras`` and ``source`` are those of
    `MarkPlaces`, ``about`` is that of `make_marks`.
    """

    title: str
    points: Floats
    unit: Unit | None
    stated: bool = True
    columns: Sequence[str] = ()
    first_centre: float = 0.0
    labels: Sequence[str] = ()
    used: Sequence[bool] = ()
    placed: bool = False
    extras: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    source: str | Sequence[str] = "imported"
    about: Fields = field(default_factory=Entries)

    @property
    def names(self) -> list[str]:
        """Labels, or numbers from 1."""
        numbers = [str(k + 1) for k in range(len(self.points))]
        return list(self.labels) or numbers

    def counts_from_pixel(self, unit: Unit | None) -> bool:
        """Whether positions in ``unit`` count from the first pixel of the layer."""
        return not self.placed or (unit or self.unit) == "pixel"


@dataclass(frozen=True, slots=True)
class LayerPixels:
    """Pixels of one layer, as far as they are known.

    Raises
    ------
    SizeError
        If a size is no positive number, or an origin no finite one.
    """

    #: one size, ``(y, x)``, or ``(z, y, x)`` for a volume, in um; kept as a tuple.
    pixel_um: Any = None
    #: ``(x, y)`` of the centre of the first pixel, from which other programs count, in um.
    origin_um: Sequence[float] | None = None
    shape: Sequence[int] | None = None  #: rows and columns

    def __post_init__(self) -> None:
        """Check sizes and origin."""
        if self.pixel_um is not None:
            sizes = np.atleast_1d(np.asarray(self.pixel_um, dtype=np.float64))
            is_length = np.isfinite(sizes) & (sizes > 0)
            if not 1 <= len(sizes) <= 3 or not is_length.all():
                raise SizeError(
                    f"The pixel size of a layer is {self.pixel_um!r} um; one positive number, two"
                    " (y, x), or three for a volume (z, y, x) are needed in `moving_pixel_um` and"
                    " `fixed_pixel_um`."
                )
            object.__setattr__(self, "pixel_um", tuple(sizes.tolist()))
        origin = (0.0, 0.0) if self.origin_um is None else self.origin_um
        if len(origin) != 2 or not np.isfinite(origin).all():
            raise SizeError(
                f"The origin of a layer is {self.origin_um!r} um; two numbers (x, y) are needed."
            )

    def about(self) -> Entries:
        """Give the facts as they are kept with the marks.

        As ``pixel_um``, ``origin_um`` and ``size_px``, each with ``x`` and ``y``; what is not known
        is left out.
        """
        about: Entries = {}
        if self.pixel_um is not None:
            *_, col_um = self.pixel_um
            row_um, *_ = self.pixel_um[-2:]
            about["pixel_um"] = {"x": col_um, "y": row_um}
        if self.origin_um is not None:
            x, y = map(float, self.origin_um)
            about["origin_um"] = {"x": x, "y": y}
        if self.shape is not None:
            rows, cols = map(int, self.shape)
            about["size_px"] = {"x": cols, "y": rows}
        return about

    def frame(self, unit: Unit, axes: int, name: str, side: str) -> tuple[Floats, Floats]:
        """Give the place of the first pixel, and length of one unit, along x, y (and z) in um.

        The place is that of the pixel's centre, in um whatever the unit, with z 0. ``axes`` is 2,
        or 3 for points of a volume; ``name`` and ``side`` are those of the file and of the layer,
        for messages. SizeError where pixels are meant and their size is not known.
        """
        origin = np.zeros(axes)
        origin[:2] = self.origin_um or (0.0, 0.0)
        if unit != "pixel":
            return origin, np.full(axes, 1000.0 if unit == "mm" else 1.0)
        option = "fixed" if side == "fixed" else "moving"
        if self.pixel_um is None:
            raise SizeError(
                f"Positions in {name} are in pixels, and the pixel size of the {side} layer is not"
                f" known. Give it in um to planish marks convert with `{option}_pixel_um`."
            )
        if axes == 3 and len(self.pixel_um) == 2:
            raise SizeError(
                f"{name} holds points of a volume in voxels; the sizes z, y, x (or one for all) are"
                f" needed in `{option}_pixel_um`."
            )
        pixel_um = self.pixel_um if len(self.pixel_um) > 1 else self.pixel_um * 3
        return origin, np.array(pixel_um[::-1])[:axes]


def join_lists(
    lists: Sequence[PointList],
    *,
    name: str,
    moving: LayerPixels,
    volume: LayerPixels,
    fixed: LayerPixels,
    unit: Unit | None,
    swap: bool,
) -> xr.Dataset:
    """Join marks in um from one list (layer ``marks``) or two.

    The points of two lists belong together in their order.

    They are ``moving`` (``volume`` where its z varies) and ``fixed``, exchanged where their names
    or ``swap`` say so.
    """
    for point_list in lists:
        check_count(name, len(point_list.points))
    _check_unit(lists, name, unit)
    facts_of = {"marks": moving if moving.pixel_um or moving.origin_um else fixed}
    if len(lists) > 1:
        lists = _moving_first(lists, name, swap=swap)
        facts_of = {"moving": moving, "fixed": fixed}
    first = lists[0]
    places: dict[str, MarkPlaces] = {}
    about: dict[str, Entries] = {}
    counted: list[str] = []
    used = np.ones(len(first.points), bool)
    for point_list, (side, facts) in zip(lists, facts_of.items(), strict=True):
        coordinates = _coordinates(point_list, side, name)
        layer = side
        if side == "moving" and coordinates.shape[1] == 3:
            layer = "volume"
            facts = volume
        places[layer] = _places(point_list, coordinates, side, facts, unit, name)
        about[layer] = dict(point_list.about) | facts.about()
        if point_list.counts_from_pixel(unit):
            counted.append(layer)
        if point_list.used:
            used &= point_list.used
    marks = make_marks(first.names, places, used=used.tolist(), about=about)
    return marks.assign_attrs(from_first_pixel=counted)


def _moving_first(lists: Sequence[PointList], name: str, *, swap: bool) -> Sequence[PointList]:
    """Two lists, that of the moving side first: by their names, and exchanged by ``swap``.

    MarkError where their points cannot belong together in their order.
    """
    if len(lists) > 2:
        titles = ", ".join(f"{p.title} ({len(p.points)})" for p in lists[:8])
        raise MarkError(
            f"{name} holds {len(lists)} lists of points: {titles}. Two are needed; save those two"
            " alone."
        )
    first_title, last_title = (p.title.strip().lower() for p in lists)
    is_reversed = first_title in ("fixed", "to", "target", "image")
    is_reversed = is_reversed and last_title in ("moving", "from", "source", "volume")
    if swap != is_reversed:
        lists = lists[::-1]
    first, last = lists
    a = first.names
    b = last.names
    if len(a) != len(b):
        raise MarkError(
            f"{name}: {len(a)} moving points ({first.title}) and {len(b)} fixed points"
            f" ({last.title}). Points belong together in their order, so both need the same"
            " number: add or remove points."
        )
    if a != b and sorted(a) == sorted(b):
        k = [*map(eq, a, b)].index(False)
        raise MarkError(
            f"{name}: both lists have the same labels in another order: {a[k]} and {b[k]} are"
            f" both number {k + 1}. Points belong together in their order: sort one list, or"
            " rename its points."
        )
    return lists


def _check_unit(lists: Sequence[PointList], name: str, unit: Unit | None) -> None:
    """Refuse a unit that contradicts the file, and positions without any."""
    columns: list[str] = []
    for point_list in lists:
        if point_list.unit is None:
            columns += point_list.columns
        elif point_list.stated and unit not in (None, point_list.unit):
            raise SizeError(
                f"{name} states its unit, {point_list.unit}, and `unit` says {unit}. Leave `unit`"
                " out, or correct the file."
            )
    if columns and unit is None:
        raise SizeError(
            f"{name}: {', '.join(columns)} state no unit. Call them"
            f" {', '.join(f'{column}_um' for column in columns)} (or _mm, _px), or convert the"
            " file by planish marks convert, given `unit`."
        )


def _coordinates(point_list: PointList, side: str, name: str) -> Floats:
    """Coordinates of points, with z where it says something; MarkError for a fixed side."""
    points = point_list.points
    z = points[:, 2:]
    z = z[np.isfinite(z)]
    # A picture opened as a volume of one slice has z = 0; for the fixed side any one plane is a
    # picture.
    if not z.any() or (side == "fixed" and np.ptp(z) == 0):
        return points[:, :2]
    if side == "fixed":
        raise MarkError(
            f"{name}: the points of the fixed side ({point_list.title}) differ in z. That side has"
            " to be a flat image; where the volume was the fixed or target one, give `swap`."
        )
    return points


def _places(
    point_list: PointList,
    coordinates: Floats,
    side: str,
    facts: LayerPixels,
    unit: Unit | None,
    name: str,
) -> MarkPlaces:
    """Convert points, and what else is known of them, to um.

    ``coordinates`` (n, 2) or (n, 3) are those of the list, ``facts`` the pixels of the layer;
    without a ``unit`` that of the list holds.
    """
    unit = unit or point_list.unit
    assert unit is not None
    axes = coordinates.shape[1]
    origin, factor = facts.frame(unit, axes, name, side)
    first_centre = np.zeros(axes)
    if unit == "pixel" or facts.pixel_um:
        _, pixel_um = facts.frame("pixel", axes, name, side)
        first_centre[:2] = point_list.first_centre * pixel_um[:2]
    start = origin if point_list.counts_from_pixel(unit) else 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # check_marks refuses what is too far away
        um = start + coordinates * factor - first_centre
    return MarkPlaces(um=um, source=point_list.source, extras=point_list.extras)
