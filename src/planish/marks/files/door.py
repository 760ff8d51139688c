"""The one door for files of marks: what a file is, is seen in its content, not in its name."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import xarray as xr

from planish.core.errors import FileError, MarkError, SizeError
from planish.marks.files import bigwarp, elastix, matlab, slicer, tables
from planish.marks.files.lists import LayerFacts, PointList, Unit, join_lists, layer_facts
from planish.marks.files.model import used_pairs
from planish.marks.files.native import FORMAT, read_native
from planish.marks.files.plausible import check_marks, check_plausible
from planish.marks.files.text import decode, read_bytes, split_rows

Format = Literal["json", "csv", "bigwarp", "elastix", "slicer", "matlab", "imagej"]

TITLES: dict[str, str] = {
    "json": "planish JSON", "csv": "planish table", "bigwarp": "BigWarp", "elastix": "elastix points",
    "slicer": "3D Slicer", "matlab": "MATLAB", "imagej": "ImageJ results",
}  # fmt: skip

_KNOWN = (
    "planish JSON or CSV, BigWarp CSV, elastix points, 3D Slicer .mrk.json, MATLAB .mat with movingPoints and "
    "fixedPoints, and ImageJ results with X and Y"
)


def read_any(
    path: str | Path,
    second: str | Path | None = None,
    *,
    moving_um: float | Sequence[float] | None = None,
    fixed_um: float | Sequence[float] | None = None,
    moving_origin_um: Sequence[float] | None = None,
    fixed_origin_um: Sequence[float] | None = None,
    moving_shape: Sequence[int] | None = None,
    fixed_shape: Sequence[int] | None = None,
    unit: Unit | None = None,
    swap: bool = False,
) -> xr.Dataset:
    """Read marks in any of the formats of ``docs/marks-files.md``.

    Parameters
    ----------
    path : str or Path
        A file with both layers, or with one.
    second : str or Path, optional
        The fixed layer, where ``path`` holds the moving one only. Marks belong together in their order.
    moving_um, fixed_um : float or sequence of float, in um, optional
        Pixel size of the layer: one number, ``(y, x)``, or ``(z, y, x)`` of a volume. Needed where the file counts in
        pixels.
    moving_origin_um, fixed_origin_um : sequence of 2 floats, in um, optional
        ``(x, y)`` of the centre of the layer's first pixel, from which other programs count; 0 where not given.
    moving_shape, fixed_shape : sequence of 2 ints, optional
        Rows and columns of the layer. With its pixel size, marks that cannot lie in it are refused.
    unit : {"um", "mm", "pixel"}, optional
        Unit of a file that does not state its own; um for BigWarp and ImageJ, mm for elastix where not given.
    swap : bool
        Whether the moving layer of the file is the fixed one here: the image was moved onto the map or the volume.

    Returns
    -------
    Dataset, dims (mark)
        As :func:`planish.marks.files.make_marks` makes it, lengths in um, x to the right and y down.
        ``attrs["read_from"]`` says the format, the unit, and whether the file stated the unit.

    Raises
    ------
    FileError
        If a file cannot be read, has more than 10 MB, or is in no known format.
    MarkError
        If marks are missing, malformed, repeated, or cannot lie in their layer.
    SizeError
        If a pixel size is needed and not given, or units contradict each other.
    """
    moving = layer_facts(moving_um, moving_origin_um, moving_shape, "moving")
    fixed = layer_facts(fixed_um, fixed_origin_um, fixed_shape, "fixed")
    places = [Path(path)] if second is None else [Path(path), Path(second)]
    name = " and ".join(place.name for place in places)
    found = [_read(place) for place in places]
    if second is None and isinstance(found[0][1], xr.Dataset):
        if unit not in (None, "um"):
            raise SizeError(
                f"{name} states its unit, um, and --unit says {unit}. Leave --unit out, or correct the file."
            )
        marks = _with_facts(found[0][1], moving, fixed, swap)
        told = "um", True
    else:
        lists: list[PointList] = []
        for place, (_, content) in zip(places, found, strict=True):
            new = [tables.single_list(content, place.name)] if isinstance(content, xr.Dataset) else content
            if second is not None and len(new) != 1:
                raise MarkError(
                    f"{place.name} holds {len(new)} lists of points already. Give it alone, or two files with one each."
                )
            lists += new
        marks = join_lists(lists, name=name, moving=moving, fixed=fixed, unit=unit, swap=swap)
        told = unit or lists[0].unit, all(one.stated for one in lists)
    marks.attrs["read_from"] = {"format": found[0][0], "unit": told[0], "stated": told[1]}
    check_marks(marks, name)
    if unit != "um":
        check_plausible(marks, name)
    return marks


def read_pairs(path: str | Path, second: str | Path | None = None, *, least: int = 3, **how: Any) -> xr.Dataset:
    """Read pairs of marks in any format, as :func:`planish.marks.read_marks` gives them.

    Parameters
    ----------
    path, second
        As for `read_any`.
    least : int
        Fewer pairs are an error.
    **how
        Further parameters of `read_any`.

    Returns
    -------
    Dataset, dims (mark)
        As `used_pairs`: the marks that are used and lie in both layers.

    Raises
    ------
    FileError, MarkError, SizeError
        As `read_any`, and where there are not two layers or too few pairs.
    """
    return used_pairs(read_any(path, second, **how), least=least, name=Path(path).name)


def format_of(path: str | Path) -> Format:
    """Which format a file has.

    Raises
    ------
    FileError
        If it cannot be read or is in no known format.
    """
    place = Path(path)
    return _look(place, read_bytes(place))[0]


def _read(place: Path) -> tuple[Format, xr.Dataset | list[PointList]]:
    data = read_bytes(place)
    kind, content = _look(place, data)
    name = place.name
    if kind == "matlab":
        return kind, matlab.read_matlab(data, name)
    if kind == "elastix":
        return kind, elastix.read_elastix(content, name)
    if kind == "slicer":
        return kind, slicer.read_slicer(content, name)
    if kind == "json":
        return kind, read_native(content, name)
    if kind == "bigwarp":
        is_json = isinstance(content, dict)
        return kind, bigwarp.read_bigwarp_json(content, name) if is_json else bigwarp.read_bigwarp(content, name)
    if kind == "csv" and tables.kind_of_table(content) == "pairs":
        return kind, tables.read_pairs_table(place)
    return kind, tables.read_points_table(content, name, "imagej" if kind == "imagej" else "holes")


def _look(place: Path, data: bytes) -> tuple[Format, Any]:
    """Format of a file, and its content as far as it had to be understood for that."""
    name = place.name
    # Version 4 has no heading that says what it is.
    if matlab.looks_like_matlab(data) or place.suffix.lower() == ".mat":
        return "matlab", None
    text = decode(data, name)
    if not text.strip():
        raise FileError(f"{name} is empty. Give a file of marks: {_KNOWN}.")
    if text.lstrip()[:1] in "{[":
        return _look_json(text, name)
    if text.startswith("# Markups fiducial file"):
        raise FileError(f"{name} is a point list of Slicer in the old format .fcsv. Save it in Slicer as .mrk.json.")
    if elastix.looks_like_elastix(text):
        return "elastix", text
    rows = split_rows(text, name)
    if bigwarp.looks_like_bigwarp(rows):
        return "bigwarp", rows
    table = tables.kind_of_table(rows)
    if table:
        return ("imagej" if table == "imagej" else "csv"), rows
    first = ",".join(rows[0][1])[:60] if rows else ""
    raise FileError(f"{name} begins with {first!r} and is in no known format of marks. These are read: {_KNOWN}.")


def _look_json(text: str, name: str) -> tuple[Format, Any]:
    try:
        content = json.loads(text, object_pairs_hook=_once)
    except RecursionError as error:
        raise FileError(f"{name} is nested too deeply for a file of marks. Give a file of marks: {_KNOWN}.") from error
    except ValueError as error:
        raise FileError(f"{name} is damaged JSON: {error}. Save the marks again.") from error
    if isinstance(content, dict):
        if content.get("format") == FORMAT:
            return "json", content
        if "markups" in content:
            return "slicer", content
        if "movingPoints" in content or "landmarks" in content:
            return "bigwarp", content
        held = ", ".join(map(str, list(content)[:6])) or "nothing"
    else:
        held = "a list"
    raise FileError(f"{name} is JSON, but no file of marks: it holds {held[:80]}. These are read: {_KNOWN}.")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        key, count = Counter(key for key, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {key[:40]!r} stands {count} times in one object")
    return found


def _with_facts(marks: xr.Dataset, moving: LayerFacts, fixed: LayerFacts, swap: bool) -> xr.Dataset:
    """Marks with what the user says of their layers beside what the file says."""
    if swap:
        raise MarkError("A planish file says itself which layer is the moving one. Leave --swap out.")
    layers = {name: dict(about) for name, about in marks.attrs["layers"].items()}
    for side, facts in (("moving", moving), ("volume", moving), ("fixed", fixed)):
        if side in layers:
            layers[side] |= facts.about()
    if list(layers) == ["marks"]:
        layers["marks"] |= moving.about() | fixed.about()
    return marks.assign_attrs(layers=layers)
