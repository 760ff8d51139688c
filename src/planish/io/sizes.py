"""Voxel and pixel sizes: every length becomes micrometres here, and one size comes out or an error.

A missing size is never taken as 1, and of two sizes that disagree none is preferred in silence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from planish.core.arrays import agree
from planish.core.errors import FileError, SizeError
from planish.core.text import and_join
from planish.core.typing import Pair
from planish.io.guard import reading

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

# Length of each unit in um. Keys are case-folded, which also makes the micro sign a Greek mu.
UNITS_UM = {
    "pm": 1e-6, "picometer": 1e-6, "picometre": 1e-6,
    "å": 1e-4, "angstrom": 1e-4, "ångström": 1e-4,
    "nm": 1e-3, "nanometer": 1e-3, "nanometre": 1e-3, "nanometers": 1e-3, "nanometres": 1e-3,
    "um": 1.0, "μm": 1.0, "micron": 1.0, "microns": 1.0,
    "micrometer": 1.0, "micrometre": 1.0, "micrometers": 1.0, "micrometres": 1.0,
    "mm": 1e3, "millimeter": 1e3, "millimetre": 1e3, "millimeters": 1e3, "millimetres": 1e3,
    "cm": 1e4, "centimeter": 1e4, "centimetre": 1e4, "centimeters": 1e4, "centimetres": 1e4,
    "m": 1e6, "meter": 1e6, "metre": 1e6, "meters": 1e6, "metres": 1e6,
    "in": 25400.0, "inch": 25400.0, "inches": 25400.0,
}  # fmt: skip

OVERRIDE = "--override-size"
POSSIBLE_UM = (1e-4, 1000.0)  # of any pixel; outside of it there is no instrument
UNKNOWN_NOTE = "missing, or a default such as 72 dpi"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """Size as one kind of metadata states it."""

    source: str  # for example "ImageJ metadata"
    um: tuple[float | None, ...]  # one entry an axis, slowest axis first; None where the metadata are silent
    note: str = ""  # why, if there is something to say


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """Kind of size that is needed: names, option, and the usual range; outside of it the unit is probably wrong."""

    name: str
    axes: tuple[str, ...]
    option: str
    usual_um: Pair


VOXEL = Asked(name="voxel", axes=("z", "y", "x"), option="--voxel-um", usual_um=(0.01, 100.0))
PIXEL = Asked(name="pixel", axes=("y", "x"), option="--pixel-um", usual_um=(0.01, 500.0))
"""What is asked of the size of a pixel: axes, option, and what is usual."""


def unit_um(unit: str) -> float | None:
    r"""Length of a unit in um, or None if the word is no unit of length.

    Examples
    --------
    >>> unit_um("mm"), unit_um("µm"), unit_um("pixel")
    (1000.0, 1.0, None)
    """
    word = unit.strip().strip('"').casefold().replace("\\u00b5", "μ").replace("\\u03bc", "μ")
    return UNITS_UM.get(word)


def stated_in(
    source: str, values: Sequence[float | None], units: Sequence[str], order: Sequence[int] = (0, 1, 2)
) -> Stated:
    """Turn lengths with their units into um along the axes in `order`; what is no length is noted."""
    lengths: list[float | None] = []
    notes: list[str] = []
    for axis in order:
        value = values[axis] if axis < len(values) else None
        unit = units[axis] if axis < len(units) else ""
        length = unit_um(unit)
        usable = value is not None and math.isfinite(value) and value > 0
        lengths.append(value * length if usable and value is not None and length is not None else None)
        if value is not None and not usable:
            notes.append(f"{value:g} is no size")
        elif usable and length is None:
            notes.append(f"{unit!r} is no unit of length" if unit else f"{value:g} without a unit")
    return Stated(source=source, um=tuple(lengths), note=", ".join(dict.fromkeys(notes)))


def from_density(per_unit: float | None, unit: str) -> float | None:
    """Pixel size in um from pixels per unit of length, or None where nothing is meant by it.

    Exactly 1 pixel per unit, and 72 or 96 pixels per inch in whatever unit, are what programs write when they
    do not know.
    """
    length = unit_um(unit)
    if per_unit is None or length is None or not math.isfinite(per_unit) or per_unit <= 0 or per_unit == 1:
        return None
    um = length / per_unit
    # What programs write when they do not know the resolution, within the rounding of whole pixels per cm.
    return None if any(abs(25400.0 / um - dpi) <= 1.0 for dpi in (72.0, 96.0)) else um


def agreed_size(
    stated: Sequence[Stated],
    user_um: float | Sequence[float] | None,
    *,
    file_name: str,
    asked: Asked,
    override: bool = False,
    unusual: bool = False,
) -> tuple[tuple[float, ...], str]:
    """Find the one size, in um along each axis, that metadata and user agree on, and where it comes from.

    `user_um`, one value for all axes or one each, is taken with `override` whatever the metadata state. A size
    that paper does not have is taken with `unusual` only.

    Raises
    ------
    SizeError
        If it is missing on an axis, contradictory, or outside the possible range.
    """
    stating = [s for s in stated if any(v is not None for v in s.um)]
    sources = " and ".join(s.source for s in stating)
    if user_um is None:
        merged = _merge_stated(stating, file_name=file_name, asked=asked)
        missing = [axis for axis, value in zip(asked.axes, merged, strict=True) if value is None]
        if missing:
            notes = "; ".join(f"{s.source}: {s.note}" for s in stated if s.note)
            along = f" along {and_join(missing)}: {_in_words(stating, asked)} only" if stating else ""
            raise SizeError(
                f"{file_name} states no {asked.name} size{along}{f' ({notes})' if notes else ''}. Give it with "
                f"{asked.option} SIZE (or {','.join(a.upper() for a in asked.axes)}), in um."
            )
        size = tuple(value for value in merged if value is not None)
        _check_range(size, file_name=file_name, asked=asked, unusual=unusual, more=f", and add {OVERRIDE}")
        return size, sources
    size = size_per_axis(user_um, asked)
    contradicting = [
        s for s in stating if any(v is not None and not agree(v, g) for v, g in zip(s.um, size, strict=True))
    ]
    if contradicting and not override:
        raise SizeError(
            f"{file_name}: {asked.option} gives {_axes_words(size, asked)}, but {_in_words(contradicting, asked)}. "
            f"Correct one of them, or add {OVERRIDE} to take the given size."
        )
    _check_range(size, file_name=file_name, asked=asked, unusual=unusual)
    if contradicting:
        replaced = and_join(f"{s.source} ({_axes_words(s.um, asked)})" for s in contradicting)
        return size, f"given, in place of {replaced}"
    # A repeated run gives the very size that the metadata stated the first time; it still comes from there.
    return size, sources if _merge_stated(stating, file_name=file_name, asked=asked) == size else "given"


def size_per_axis(size_um: float | Sequence[float], asked: Asked) -> tuple[float, ...]:
    """Spread a given size over the axes."""
    listed: Any = size_um.tolist() if isinstance(size_um, np.ndarray) else size_um
    sizes: tuple[Any, ...] = tuple(listed) if isinstance(listed, (list, tuple)) else (listed,)
    if not all(not isinstance(v, bool) and isinstance(v, Real) for v in sizes):
        raise SizeError(f"{asked.option}: {size_um!r} is not a size. Give numbers above 0, in um.")
    if len(sizes) == 1:
        sizes = sizes * len(asked.axes)
    if len(sizes) != len(asked.axes):
        raise SizeError(
            f"{asked.option} has {len(sizes)} values, it needs 1 or {len(asked.axes)} ({','.join(asked.axes)}), in um."
        )
    if not all(math.isfinite(v) and v > 0 for v in sizes):
        raise SizeError(
            f"{asked.option}: {','.join(f'{v:g}' for v in sizes)} is not a size. Give numbers above 0, in um."
        )
    return tuple(float(v) for v in sizes)


def _merge_stated(stating: Sequence[Stated], *, file_name: str, asked: Asked) -> tuple[float | None, ...]:
    """Join what several kinds of metadata state; the first that states an axis gives its number."""
    sizes: list[float | None] = [None] * len(asked.axes)
    for metadata in stating:
        for i, (size, value) in enumerate(zip(sizes, metadata.um, strict=True)):
            if size is None:
                sizes[i] = value
            elif value is not None and not agree(size, value):
                raise SizeError(
                    f"{file_name} contradicts itself: {_in_words(stating, asked)}. Give the right {asked.name} size "
                    f"with {asked.option} and add {OVERRIDE}."
                )
    return tuple(sizes)


def _check_range(size: Sequence[float], *, file_name: str, asked: Asked, unusual: bool, more: str = "") -> None:
    """Ask about sizes that no image of paper has, and refuse those that no image has."""
    low, high = asked.usual_um
    for axis, value in zip(asked.axes, size, strict=True):
        possible = POSSIBLE_UM[0] <= value <= POSSIBLE_UM[1]
        if low <= value <= high or (unusual and possible):
            continue
        guess = "The unit is probably wrong"
        for unit, factor in (("nm", 1e-3), ("mm", 1e3), ("m", 1e6)):
            if low <= value * factor <= high:
                guess = f"It looks like {unit} given as um ({value:g} {unit} is {value * factor:g} um)"
                break
        range_words = f"usual are {low:g} to {high:g} um" if possible else f"possible are {POSSIBLE_UM[0]:g} to 1000 um"
        meant = " If it is meant, add --unusual-size." if possible else ""
        raise SizeError(
            f"{file_name}: the {asked.name} size along {axis} is {value:g} um, {range_words}. {guess}. Give the right "
            f"one with {asked.option}, in um{more}.{meant}"
        )


def _in_words(stated: Sequence[Stated], asked: Asked) -> str:
    return and_join(f"{s.source} states {_axes_words(s.um, asked)}" for s in stated)


def _axes_words(size: Sequence[float | None], asked: Asked) -> str:
    """Write a size with its axes, for example ``z 2, y 1.5, x 1.5 um``."""
    parts = [f"{axis} {value:.6g}" for axis, value in zip(asked.axes, size, strict=True) if value is not None]
    return ", ".join(parts) + " um"


def stated_by_tiff(tif: TiffFile, page: TiffPage, path: Path) -> tuple[Stated, ...]:
    """Collect what the metadata state, along z, y, x."""
    with reading(path):
        ome = tif.ome_metadata
        imagej: Mapping[str, Any] | None = tif.imagej_metadata
        density = _rational(page, 283), _rational(page, 282)
        stated: list[Stated] = []
        if ome is not None:  # the first image; the unit is um where none is written, as OME has it
            if "<!ENTITY" in ome or "<!DOCTYPE" in ome:
                raise FileError(
                    f"{path.name}: its OME metadata define entities, which OME never does. Export it again."
                )
            pixels = (e.attrib for e in ElementTree.fromstring(ome).iter() if e.tag.rpartition("}")[2] == "Pixels")
            keys: Mapping[str, str] = next(pixels, {})
            sizes = [_number(keys.get(f"PhysicalSize{axis}")) for axis in "ZYX"]
            units = [keys.get(f"PhysicalSize{axis}Unit", "um") for axis in "ZYX"]
            stated = [stated_in("OME metadata", sizes, units)]
        if imagej is not None and str(imagej.get("unit", "")).strip():
            return (*stated, _stated_by_imagej(imagej, density))
        # The resolution tags, with their unit, never state z.
        code: Any = page.tags.valueof(296)
        unit = {2: "inch", 3: "cm"}.get(code, "") if isinstance(code, int) else ""
        across = [from_density(per_unit, unit) for per_unit in density]
        return *stated, Stated(
            source="the TIFF resolution", um=(None, *across), note=UNKNOWN_NOTE if None in across else ""
        )


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
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) and number > 0 else None
