"""Marks -> files of planish and of other programs, in the units and the direction that these expect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr

from planish.core.errors import FileError, MarkError, SizeError
from planish.marks.files import bigwarp, elastix, matlab, slicer, tables
from planish.marks.files.lists import Unit, layer_facts, scale_of
from planish.marks.files.model import (
    Floats,
    about_layer,
    labels_of,
    layer_names,
    pair_of_layers,
    points_of,
    used_of,
    used_pairs,
)
from planish.marks.files.native import native_text
from planish.marks.files.plausible import check_marks
from planish.marks.files.text import write_bytes, write_text

Target = Literal["json", "csv", "bigwarp", "elastix", "slicer", "matlab"]

SUFFIXES: dict[str, Target] = {".csv": "csv", ".txt": "elastix", ".pts": "elastix", ".mat": "matlab", ".json": "json"}
USUAL: dict[str, Unit] = {"bigwarp": "um", "elastix": "mm", "slicer": "mm", "matlab": "pixel"}
_FREE = ("bigwarp", "elastix")


def target_of(path: str | Path) -> Target:
    """Format that a name asks for: ``.mrk.json`` Slicer, ``.json`` planish, ``.csv`` pairs, ``.txt`` elastix, ``.mat``.

    Raises
    ------
    FileError
        If the name tells no format.
    """
    place = Path(path)
    if place.name.lower().endswith(".mrk.json"):
        return "slicer"
    found = SUFFIXES.get(place.suffix.lower())
    if found is None:
        raise FileError(
            f"{place.name} does not tell its format. Give --to bigwarp, elastix, slicer, matlab, json or csv."
        )
    return found


def write_any(
    marks: xr.Dataset,
    path: str | Path,
    *,
    to: Target | None = None,
    moving_um: float | Sequence[float] | None = None,
    fixed_um: float | Sequence[float] | None = None,
    unit: Unit | None = None,
    swap: bool = False,
) -> list[Path]:
    """Write marks for planish or for another program.

    Parameters
    ----------
    marks : Dataset, dims (mark)
        As `read_any` gives them; holes go through `marks_of_holes`.
    path : str or Path
        File to make; nothing is overwritten. For elastix, which takes one side from each file, ``-moving`` and
        ``-fixed`` are put before the suffix.
    to : {"json", "csv", "bigwarp", "elastix", "slicer", "matlab"}, optional
        As the name asks where not given.
    moving_um, fixed_um : float or sequence of float, in um, optional
        Pixel sizes, in place of those that the marks hold.
    unit : {"um", "mm", "pixel"}, optional
        Unit of a BigWarp or elastix file: that of the images as the other program opens them. um for BigWarp and mm for
        elastix where not given.
    swap : bool
        Whether the fixed layer is to be the moving one of the other program.

    Returns
    -------
    list of Path
        The files that were made.

    Raises
    ------
    FileError
        If a file is there already or cannot be written.
    MarkError
        If the marks lack what the format needs.
    SizeError
        If a pixel size is needed and not known.

    Notes
    -----
    Other programs count from the centre of the first pixel, so the origin of a layer is taken off. ``json`` keeps all;
    ``bigwarp`` and ``slicer`` keep labels, marks that are not used and marks of one layer only; ``csv``, ``elastix``
    and ``matlab`` hold the pairs in use.
    """
    place, kind = Path(path), to or target_of(path)
    check_marks(marks, "The marks")
    if unit is not None and kind not in _FREE:
        raise SizeError(
            f"A file for {kind} has its own unit; only files for BigWarp and elastix are written in --out-unit."
        )
    if kind == "json":
        write_text(place, native_text(marks))
        return [place]
    if kind == "csv":
        return _write_csv(marks, place)
    names = layer_names(marks)
    single = len(names) == 1 and kind in ("elastix", "slicer")
    sides = names if single else list(pair_of_layers(marks, name="This set of marks"))
    if kind in ("elastix", "matlab"):
        keep = used_of(marks)
        for side in sides:
            keep &= np.isfinite(points_of(marks, side)).all(axis=1)
        if not keep.any():
            raise MarkError(f"No mark is used and lies in {' and '.join(sides)}. Use at least one.")
        marks = marks.isel(mark=np.flatnonzero(keep))
    sizes: dict[str, float | Sequence[float] | None] = {"moving": moving_um, "fixed": fixed_um}
    if single:
        sizes["moving"] = moving_um or fixed_um
    roles: dict[str, str] = dict(zip(("moving", "fixed"), sides, strict=False))
    values = {role: _values(marks, side, role, sizes[role], unit or USUAL[kind], kind) for role, side in roles.items()}
    order: list[str] = ["fixed", "moving"] if swap and not single else list(roles)
    told = dict(zip(("moving", "fixed"), order, strict=False))
    points: dict[str, Floats] = {role: values[own] for role, own in told.items()}
    if kind == "elastix":
        return _write_elastix(points, place, single=single)
    if kind == "bigwarp":
        write_text(place, bigwarp.bigwarp_text(marks, points["moving"], points["fixed"]))
    elif kind == "matlab":
        if any(p.shape[1] == 3 for p in points.values()):
            raise MarkError(
                "These marks lie in a volume; MATLAB's control points are flat. Use slicer, elastix or bigwarp."
            )
        write_bytes(place, matlab.matlab_bytes(points["moving"], points["fixed"]))
    else:
        labels, used = labels_of(marks), [bool(v) for v in used_of(marks)]
        titles = {role: roles[role] if single else role for role in points}
        write_text(place, slicer.slicer_text([(titles[role], labels, used, p) for role, p in points.items()]))
    return [place]


def _values(
    marks: xr.Dataset, layer: str, role: str, size: float | Sequence[float] | None, unit: Unit, kind: str
) -> Floats:
    """Positions of one layer in the unit of the file, from the centre of the first pixel."""
    about = about_layer(marks, layer)
    points = points_of(marks, layer)
    told = layer_facts(size, None, None, role).pixel_um
    factor = scale_of(unit, told or about.get("pixel_um"), points.shape[1], f"The file for {kind}", role)
    origin = np.zeros(points.shape[1])
    origin[:2] = [about.get("origin_um", {}).get(axis, 0.0) for axis in "xy"]
    return (points - origin) / factor + (1.0 if kind == "matlab" else 0.0)


def _write_csv(marks: xr.Dataset, place: Path) -> list[Path]:
    if len(layer_names(marks)) == 1:
        write_text(place, tables.holes_text(marks))
        return [place]
    pairs = used_pairs(marks, least=1, name="This set of marks")
    if place.exists():
        raise FileError(f"{place} is already there; nothing is overwritten. Choose another name.")
    try:
        tables.write_pairs_table(pairs, place)
    except OSError as error:
        raise FileError(f"{place} cannot be written: {error.strerror or error}. Choose another place.") from error
    return [place]


def _write_elastix(points: dict[str, Floats], place: Path, *, single: bool) -> list[Path]:
    files = [place] if single else [place.with_name(f"{place.stem}-{role}{place.suffix}") for role in points]
    there = [file for file in files if file.exists()]
    if there:
        raise FileError(f"{there[0]} is already there; nothing is overwritten. Choose another name.")
    for file, values in zip(files, points.values(), strict=True):
        write_text(file, elastix.elastix_text(values))
    return files
