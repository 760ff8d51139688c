"""What a TIFF file states about the size of its voxels: OME, ImageJ, and the plain resolution tags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from tifffile import TiffFile, TiffPage

from planish.core.errors import FileError
from planish.io.guard import reading
from planish.io.sizes import Stated, from_density, stated_in, unit_um

RESOLUTION_UNITS = {2: "inch", 3: "cm"}

UNKNOWN_NOTE = "missing, or a default such as 72 dpi"


def stated_by_tiff(tif: TiffFile, page: TiffPage, path: Path) -> tuple[Stated, ...]:
    """Collect what the metadata state, along z, y, x."""
    with reading(path):
        ome = tif.ome_metadata
        imagej: Mapping[str, Any] | None = tif.imagej_metadata
        density = _rational(page, 283), _rational(page, 282)
        stated = [] if ome is None else [_stated_by_ome(ome, path)]
        if imagej is not None and str(imagej.get("unit", "")).strip():
            return (*stated, _stated_by_imagej(imagej, density))
        # The resolution tags, with their unit, never state z.
        code: Any = page.tags.valueof(296)
        unit = RESOLUTION_UNITS.get(code, "") if isinstance(code, int) else ""
        across = [from_density(per_unit, unit) for per_unit in density]
        return *stated, Stated(
            source="the TIFF resolution", um=(None, *across), note=UNKNOWN_NOTE if None in across else ""
        )


def _stated_by_ome(xml: str, path: Path) -> Stated:
    """Read PhysicalSizeX, Y and Z of the first image; the unit is um where none is written, as OME has it."""
    if "<!ENTITY" in xml or "<!DOCTYPE" in xml:
        raise FileError(f"{path.name}: its OME metadata define entities, which OME never does. Export it again.")
    pixels = (e for e in ElementTree.fromstring(xml).iter() if e.tag.rpartition("}")[2] == "Pixels")
    first = next(pixels, None)
    keys: Mapping[str, str] = {} if first is None else first.attrib
    sizes = [_number(keys.get(f"PhysicalSize{axis}")) for axis in "ZYX"]
    return stated_in("OME metadata", sizes, [keys.get(f"PhysicalSize{axis}Unit", "um") for axis in "ZYX"])


def _stated_by_imagej(meta: Mapping[str, Any], density: tuple[float | None, float | None]) -> Stated:
    """Read `unit` (`yunit`, `zunit`), `spacing`, and pixels per unit from the resolution tags."""
    unit = str(meta.get("unit", ""))
    if unit_um(unit) is None:
        return Stated(source="ImageJ metadata", um=(None, None, None), note=f"{unit!r} is no unit of length")
    unit_y, unit_z = (str(meta.get(key) or unit) for key in ("yunit", "zunit"))
    across: list[float | None] = []
    for per_unit, its_unit in zip(density, (unit_y, unit), strict=True):
        length = unit_um(its_unit)
        if its_unit.strip().casefold() in {"inch", "in", "inches", "cm"}:
            across.append(from_density(per_unit, its_unit))
        else:
            across.append(None if per_unit is None or length is None else length / per_unit)
    spacing, length = _number(meta.get("spacing")), unit_um(unit_z)
    z = None if spacing is None or length is None else spacing * length
    note = "" if z is not None else "it has no slice spacing (ImageJ leaves out a spacing of exactly 1)"
    return Stated(source="ImageJ metadata", um=(z, *across), note=note)


def _rational(page: TiffPage, code: int) -> float | None:
    """Value of a tag that holds a fraction; None where it is no positive number."""
    value: Any = page.tags.valueof(code)
    if not isinstance(value, tuple) or len(value) != 2:  # pyright: ignore[reportUnknownArgumentType]
        return None
    top, bottom = _number(value[0]), _number(value[1])
    return None if top is None or bottom is None else top / bottom


def _number(value: Any) -> float | None:
    """Read a positive finite number, or None."""
    try:
        result = float(value)
    except (TypeError, ValueError):
        return None
    return result if math.isfinite(result) and result > 0 else None
