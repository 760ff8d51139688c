"""Find voxel and pixel sizes, in um.

A missing one is never taken as 1, and of two that disagree none is taken in silence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from planish.core.errors import FileError, SizeError
from planish.core.numbers import agree
from planish.core.text import and_join
from planish.core.typing import Entries, Fields, Pair, Texts
from planish.core.units import unit_um
from planish.io.guard import reading
from planish.io.resolution import (
    UNIT_OF_TAG,
    Writer,
    doubt_of,
    from_density,
    reason_of_none,
    writer_of,
)

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

OVERRIDE = "`override_size=True`"
NO_SIZE = (None, None, None)  # of a voxel, where the metadata are silent
POSSIBLE_UM = (1e-4, 1000.0)  # of any pixel; outside of it there is no instrument


SizeAndSource = tuple[tuple[float, ...], str]  # in um along each axis, and what states it


class Stated(NamedTuple):
    """Size as one kind of metadata states it."""

    source: str  # for example "ImageJ metadata"
    # One entry an axis, slowest axis first; None where the metadata are silent.
    um: tuple[float | None, ...]
    note: str = ""  # why, if there is something to say
    written: Texts = ()  # what was read along each axis, such as "3 mm"
    doubt: str = ""  # a sentence, where it may be nobody's measurement

    def agrees(self, size: Sequence[float]) -> bool:
        """True if no axis has another size."""
        pairs = zip(self.um, size, strict=True)
        return all(stated_um is None or agree(stated_um, um) for stated_um, um in pairs)


class Asked(NamedTuple):
    """Kind of size that is needed: names, word of a call, and the usual range."""

    name: str
    axes: Texts
    word: str
    usual_um: Pair

    def in_words(self, size: Sequence[float | None]) -> str:
        """Write a size with its axes, for example ``z 2, y 1.5, x 1.5 um``."""
        sizes = zip(self.axes, size, strict=True)
        return ", ".join(f"{axis} {um:.6g}" for axis, um in sizes if um is not None) + " um"

    def statements(self, stated: Sequence[Stated]) -> str:
        """Write what several kinds of metadata state."""
        return and_join(f"{s.source} states {self.in_words(s.um)}" for s in stated)


# Voxel sizes that show a sheet of paper: smaller, and its field is too small; larger, and the sheet
# is blurred.
USUAL_VOXEL_UM = (0.3, 20.0)
VOXEL = Asked("voxel", ("z", "y", "x"), "voxel_um", (0.01, 100.0))
PIXEL = Asked("pixel", ("y", "x"), "pixel_um", (0.01, 500.0))
"""What is asked of the size of a pixel: axes, word of a call, and what is usual."""


def bare_unit(stated_lengths: Sequence[float | None]) -> str:
    """Unit of lengths that are written without one: m or mm, or empty where it is not clear.

    It is the one in which all are voxels of a scan of paper; as micrometres they would lie below
    any microscope.

    >>> bare_unit([3e-6]), bare_unit([0.003]), bare_unit([3.0])
    ('m', 'mm', '')
    """
    least_um, most_um = USUAL_VOXEL_UM
    lengths = [length for length in stated_lengths if length is not None]
    if not lengths or max(lengths) >= VOXEL.usual_um[0]:
        return ""
    for unit, unit_length in (("m", 1e6), ("mm", 1e3)):
        if all(least_um <= length * unit_length <= most_um for length in lengths):
            return unit
    return ""


def stated_in(
    source: str,
    lengths: Sequence[float | None],
    units: Sequence[str],
    order: Sequence[int] = (0, 1, 2),
) -> Stated:
    """Turn lengths with their units into um along the axes in `order`.

    ``lengths`` and ``units`` stand in the order of the file, ``order`` says which of them are along
    z, y and x. One that is missing, or None, is not stated; what is no length is noted.
    """
    sizes: list[float | None] = []
    notes: list[str] = []
    written: list[str] = []
    for axis in order:
        length = lengths[axis] if axis < len(lengths) else None
        if length is None:
            sizes.append(None)
            written.append("")
            continue
        unit = units[axis] if axis < len(units) else ""
        size = _number(length)
        unit_length = unit_um(unit)
        sizes.append(None if size is None or unit_length is None else size * unit_length)
        written.append(f"{length:g} {unit}")
        if size is None:
            notes.append(f"{length:g} is no size")
        elif unit_length is None:
            notes.append(f"{unit!r} is no unit of length" if unit else f"{length:g} without a unit")
    note = ", ".join(dict.fromkeys(notes))
    return Stated(source, tuple(sizes), note, tuple(written))


def agreed_size(
    stated: Sequence[Stated],
    user_um: float | Sequence[float] | None,
    *,
    file_name: str,
    asked: Asked,
    override: bool = False,
    unusual: bool = False,
) -> SizeAndSource:
    """Find the one size that metadata and user agree on, and where it comes from.

    Parameters
    ----------
    stated : sequence of Stated
        Sizes by all kinds of metadata of the file.
    user_um : float or sequence of floats, optional
        One size for all axes or one for each, in um.
    file_name : str
        Name of the file in messages.
    asked : Asked
        Kind of size that is needed.
    override : bool
        Whether `user_um` is taken whatever the metadata state.
    unusual : bool
        Whether a size is taken that paper does not have.

    Returns
    -------
    size : tuple of floats
        Size along each axis, in um.
    source : str
        Metadata that state it, or that it was given.

    Raises
    ------
    SizeError
        If it is missing on an axis, contradictory, or outside the possible range.
    """
    # Those that say something of an axis at least.
    statements = [s for s in stated if s.um.count(None) < len(s.um)]
    if user_um is not None:
        size = size_per_axis(user_um, asked)
        source = _source_of_given(size, statements, file_name, asked, override=override)
        statements = []
    else:
        merged_size = _merge_stated(statements, file_name, asked)
        size = tuple(um for um in merged_size if um is not None)
        source = _sources(statements)
        if len(size) < len(merged_size):
            missing_text = _missing_text(merged_size, stated, statements, asked)
            raise SizeError(f"{file_name} states no {asked.name} size{missing_text}, in um.")
    _check_range(size, statements, file_name, asked, unusual=unusual)
    return size, source


def _sources(statements: Sequence[Stated]) -> str:
    return " and ".join(s.source for s in statements)


def _source_of_given(
    size: tuple[float, ...],
    statements: Sequence[Stated],
    file_name: str,
    asked: Asked,
    *,
    override: bool,
) -> str:
    """Where a size comes from that was given; one that metadata contradict is refused."""
    contradictions = [s for s in statements if not s.agrees(size)]
    if contradictions and not override:
        raise SizeError(
            f"{file_name}: `{asked.word}` gives {asked.in_words(size)}, but"
            f" {asked.statements(contradictions)}. Correct one of them, or add {OVERRIDE} to take"
            " the given size."
        )
    if contradictions:
        replaced_text = and_join(f"{s.source} ({asked.in_words(s.um)})" for s in contradictions)
        return f"given, in place of {replaced_text}"
    # A repeated run gives the very size that the metadata stated the first time; it still comes
    # from there.
    merged_size = _merge_stated(statements, file_name, asked)
    return _sources(statements) if merged_size == size else "given"


def _missing_text(
    size: Sequence[float | None],
    stated: Sequence[Stated],
    statements: Sequence[Stated],
    asked: Asked,
) -> str:
    """Say which axes have no size (None in ``size``), why, and how to give it.

    ``stated`` are all kinds of metadata, ``statements`` those that state an axis at least.
    """
    notes_text = "; ".join(f"{s.source}: {s.note}" for s in stated if s.note)
    if notes_text:
        notes_text = f" ({notes_text})"
    if not statements:
        axes_text = ",".join(asked.axes).upper()
        return f"{notes_text}. Give it with `{asked.word}=SIZE` (or {axes_text})"
    missing_axes: list[str] = []
    axis_texts: list[str] = []
    for axis, um in zip(asked.axes, size, strict=True):
        if um is None:
            missing_axes.append(axis)
        # One number for all axes would contradict what is stated.
        axis_texts.append(axis.upper() if um is None else f"{um:.9g}")
    only_text = f" along {and_join(missing_axes)}: {asked.statements(statements)} only"
    return f"{only_text}{notes_text}. Give all with `{asked.word}={','.join(axis_texts)}`"


def size_per_axis(size_um: float | Sequence[float], asked: Asked) -> tuple[float, ...]:
    """Spread a given size over the axes."""
    axis_sizes: Any = size_um.tolist() if isinstance(size_um, np.ndarray) else size_um
    sizes: Sequence[Any] = [axis_sizes]
    if isinstance(axis_sizes, (list, tuple)):
        sizes = axis_sizes
    numbers = [um for um in sizes if not isinstance(um, bool) and isinstance(um, Real)]
    if len(numbers) < len(sizes) or not all(map(_number, numbers)):
        raise SizeError(f"`{asked.word}`: {size_um!r} is not a size. Give numbers above 0, in um.")
    if len(sizes) not in (1, len(asked.axes)):
        raise SizeError(
            f"`{asked.word}` has {len(sizes)} values, it needs 1 or {len(asked.axes)}"
            f" ({','.join(asked.axes)}), in um."
        )
    if len(sizes) == 1:
        sizes = [*sizes] * len(asked.axes)
    return tuple(map(float, sizes))


def _merge_stated(
    statements: Sequence[Stated], file_name: str, asked: Asked
) -> tuple[float | None, ...]:
    """Join what several kinds of metadata state; the first that states an axis gives its number."""
    sizes: list[float | None] = [None] * len(asked.axes)
    for statement in statements:
        for i, stated_um in enumerate(statement.um):
            size = sizes[i]
            if size is None:
                sizes[i] = stated_um
            elif stated_um is not None and not agree(size, stated_um):
                raise SizeError(
                    f"{file_name} contradicts itself: {asked.statements(statements)}. Give the"
                    f" right {asked.name} size with `{asked.word}` and add {OVERRIDE}."
                )
    return tuple(sizes)


def doubt_of_size(stated: Sequence[Stated], source: str) -> str:
    """Say why the size that was agreed on may be nobody's measurement; nothing where it is one."""
    sized = [s for s in stated if s.um[-1] is not None]
    is_sure = source.startswith("given") or not all(s.doubt for s in sized)
    if is_sure:
        return ""
    return " ".join(dict.fromkeys(s.doubt for s in sized))


def size_attrs(
    asked: Asked, size: Sequence[float], source: str, stated: Sequence[Stated]
) -> Entries:
    """Attributes of a volume or an image on the size that was agreed on, and where it is from."""
    attrs: Entries = {asked.word: list(size), f"{asked.word}_source": source}
    doubt = doubt_of_size(stated, source)
    return attrs | {"size_doubt": doubt} if doubt else attrs


def with_advice(doubt: str, asked: Asked) -> str:
    """Say what to do about a size that may be nobody's measurement, behind the doubt."""
    return (
        f"{doubt} Compare a known length; if the size is another one, give it with"
        f" `{asked.word}=SIZE` and {OVERRIDE}."
    )


def _check_range(
    size: Sequence[float],
    statements: Sequence[Stated],
    file_name: str,
    asked: Asked,
    *,
    unusual: bool,
) -> None:
    """Ask about sizes that no image of paper has, and refuse those that no image has.

    What was read is said, and no reason is guessed.
    """
    low, high = asked.usual_um
    for i, um in enumerate(size):
        is_possible = POSSIBLE_UM[0] <= um <= POSSIBLE_UM[1]
        if low <= um <= high or (unusual and is_possible):
            continue
        origin_text = f"`{asked.word}` gives it"
        more_text = ""
        origins = [s for s in statements if s.um[i] is not None]
        if origins:
            written = origins[0].written[i] if origins[0].written else "it"
            origin_text = f"{origins[0].source} states {written}"
            more_text = f", and add {OVERRIDE}"
        limits_text = f"possible are {POSSIBLE_UM[0]:g} to 1000 um"
        meant_text = ""
        if is_possible:
            limits_text = f"usual are {low:g} to {high:g} um"
            meant_text = " If it is meant, add `unusual_size=True`."
        raise SizeError(
            f"{file_name}: the {asked.name} size along {asked.axes[i]} is {um:g} um"
            f" ({origin_text}); {limits_text}. Check the number and its unit. Give the right one"
            f" with `{asked.word}`, in um{more_text}.{meant_text}"
        )


def stated_by_tiff(tif: TiffFile, page: TiffPage, path: Path) -> tuple[Stated, ...]:
    """Collect what the metadata state, along z, y, x."""
    with reading(path):
        imagej: Fields | None = tif.imagej_metadata
        # Pixels per unit of length along y and x.
        density = [_fraction(page.tags.valueof(code)) for code in (283, 282)]
        tags = {tag.code: tag.value for tag in page.tags}
        photo_tags: Any = tags.get(34665)
        writer = writer_of(tags, photo_tags if isinstance(photo_tags, dict) else ())
        stated = _stated_by_ome(tif.ome_metadata, path)
        if imagej is not None and str(imagej.get("unit", "")).strip():
            return *stated, _stated_by_imagej(imagej, density, writer)
        # The resolution tags, with their unit, never state z.
        unit = UNIT_OF_TAG.get(page.tags.valueof(296), "")
        return *stated, stated_density("the TIFF resolution", density, unit, writer)


def _stated_by_ome(ome: str | None, path: Path) -> list[Stated]:
    """Size of the first image; the unit is um where none is written, as OME has it."""
    if ome is None:
        return []
    if "<!ENTITY" in ome or "<!DOCTYPE" in ome:
        raise FileError(
            f"{path.name}: its OME metadata define entities, as OME never does. Export it again."
        )
    attributes: dict[str, str] = {}
    for element in ElementTree.fromstring(ome).iter():
        if element.tag.rpartition("}")[2] == "Pixels":
            attributes = element.attrib
            break
    sizes = [_real(attributes.get(f"PhysicalSize{axis}")) for axis in "ZYX"]
    units = [attributes.get(f"PhysicalSize{axis}Unit", "um") for axis in "ZYX"]
    return [stated_in("OME metadata", sizes, units)]


def stated_density(
    source: str, density: Sequence[float | None], unit: str, writer: Writer
) -> Stated:
    """Size along z, y, x by pixels per unit of length along y, x."""
    sizes_um = [from_density(per_unit, unit) for per_unit in density]
    reasons: dict[str, None] = {}
    for per_unit, um in zip(density, sizes_um, strict=True):
        if um is None and per_unit is not None:
            reasons[reason_of_none(per_unit, unit)] = None
    stated = Stated(source, (None, *sizes_um), ", ".join(reasons))
    return _doubted(stated, writer)


def _doubted(stated: Stated, writer: Writer) -> Stated:
    """Size along z, y, x by a resolution along y, x, and whether somebody measured it."""
    sizes_um = [um for um in stated.um[1:] if um is not None]
    doubts = [doubt_of(um, writer) for um in sizes_um]
    if not any(doubts):
        return stated
    dpi_texts = [f"{25400.0 / um:.4g}" for um in sizes_um]
    source = f"{stated.source} of {' x '.join(dict.fromkeys(dpi_texts))} dpi"
    return stated._replace(source=source, doubt=next(filter(None, doubts)))


def _stated_by_imagej(meta: Fields, density: Sequence[float | None], writer: Writer) -> Stated:
    """Read `unit` (`yunit`, `zunit`), `spacing`, and pixels per unit from the resolution tags.

    ``density``: these pixels along y and x.
    """
    unit = str(meta.get("unit", ""))
    if unit_um(unit) is None:
        return Stated("ImageJ metadata", NO_SIZE, f"{unit!r} is no unit of length")
    unit_y = str(meta.get("yunit") or unit)
    unit_z = str(meta.get("zunit") or unit)
    sizes_um = map(_pixel_um, density, (unit_y, unit))
    slice_distance = _real(meta.get("spacing"))
    spacing = stated_in("", [slice_distance], [unit_z], (0,))
    note = f"its spacing: {spacing.note}" if spacing.note else ""
    if meta.get("spacing") is None:
        note = "it has no slice spacing (ImageJ leaves out a spacing of exactly 1)"
    stated = Stated("ImageJ metadata", (*spacing.um, *sizes_um), note)
    is_resolution = unit_um(unit) in (unit_um("inch"), unit_um("cm"))
    return _doubted(stated, writer) if is_resolution else stated


def _pixel_um(per_unit: float | None, unit: str) -> float | None:
    """Pixel size (um) by ImageJ's pixels per unit of length."""
    if unit.strip().casefold() in {"inch", "in", "inches", "cm"}:
        return from_density(per_unit, unit)
    unit_length = unit_um(unit)
    if per_unit is None or unit_length is None:
        return None
    return unit_length / per_unit


def _fraction(tag_value: Any) -> float | None:
    if not isinstance(tag_value, tuple) or len(tag_value) != 2:  # pyright: ignore[reportUnknownArgumentType]
        return None
    numerator, denominator = map(_number, tag_value)
    if numerator is None or denominator is None:
        return None
    return numerator / denominator


def _number(raw_value: Any) -> float | None:
    number = _real(raw_value)
    if number is not None and math.isfinite(number) and number > 0:
        return number
    return None


def _real(raw_value: Any) -> float | None:
    """Read a number as it stands, which need not be a size."""
    try:
        return float(raw_value)
    except (TypeError, ValueError):
        return None
