"""Axis names and voxel sizes in the attributes of an array: those of HDF5 and of zarr.

Programs write them in many ways; all of them are read here, for both containers alike.
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from planish.core.errors import VolumeError
from planish.core.typing import Array, Fields
from planish.io.axes import AxisNames, extended_axes, letter_of
from planish.io.orientation import Orientation, orientation_by_steps
from planish.io.sizes import Stated, bare_unit, stated_in

# Attributes that name the axes as stored, slowest first, in small letters: NeXus, vigra and
# ilastik, xarray in zarr, netCDF, and what people write by hand.
NAME_KEYS = (
    "axes",
    "axistags",
    "dimension_names",
    "_array_dimensions",
    "dimension_labels",
    "axis_labels",
    "axislabels",
    "axis_names",
    "dim_names",
    "dims",
)
# Attributes of an order that may begin with the slowest or the fastest axis: programs differ.
ORDER_KEYS = ("axis_order", "axisorder", "dimension_order", "dimensionorder", "dim_order")
NEXUS_INDICES = "_indices"
# Names that programs use for sizes, with ``_um`` or another unit at the end, or the unit beside;
# before or behind them the one axis that is meant.
SIZE_NAME = re.compile(
    r"(?:(z|y|x|slice)_?)?"
    r"(voxel_?sizes?|element_?sizes?|pixel_?sizes?|spacings?|resolutions?|voxel|step)"
    r"(?:_([zyx]))?(?:_(.*))?"
)
COORDINATE_TOLERANCE = 0.01  # by which the steps of an axis may differ
T = TypeVar("T")


class Coordinates(NamedTuple):
    """Places of the values along an axis, as a file has them beside the array."""

    name: str
    values: Array
    unit: str


def names_by_attributes(attrs: Fields, shape: Sequence[int], *, is_own: bool) -> list[AxisNames]:
    """Names of the stored axes by each attribute that gives some.

    Of the array's own attributes (``is_own``) the number of names has to fit; those of its group
    may be meant for another array.

    Raises
    ------
    VolumeError
        If an attribute of the array names another number of axes than it has, or an order that
        may be meant either way.
    """
    namings: list[AxisNames] = []
    for key in attrs:
        folded_key = str(key).casefold()
        if folded_key not in (*NAME_KEYS, *ORDER_KEYS):
            continue
        words = axis_words(attrs[key])
        if folded_key in ORDER_KEYS and is_own and not _is_usual(words):
            raise VolumeError(
                f"The attribute {key} is {', '.join(words)}, which may begin with the fastest or"
                " the slowest axis. Name the axes in an attribute axes, slowest first."
            )
        names = _on_axes(words, shape, "") if words else None
        if names is not None:
            namings.append(AxisNames(f"the attribute {key}", tuple(names)))
        elif words and is_own:
            raise VolumeError(
                f"The attribute {key} names {len(words)} axes ({', '.join(words)}), the array has"
                f" {len(shape)}. Correct it, or take it out."
            )
    return namings


def _is_usual(words: Sequence[str]) -> bool:
    """True if an order names no two of z, y, x, or names them in this order."""
    letters = [letter for letter in map(letter_of, words) if letter in ("z", "y", "x")]
    return letters == sorted(letters, reverse=True)


def _on_axes(values: Sequence[T], shape: Sequence[int], default: T) -> list[T] | None:
    """One value for each axis, or each longer than 1; None where the count does not fit."""
    if len(values) == len(shape):
        return [*values]
    long_axes = extended_axes(shape)
    if len(values) != len(long_axes):
        return None
    on_axes = [default] * len(shape)
    for axis, value in zip(long_axes, values, strict=True):
        on_axes[axis] = value
    return on_axes


def names_by_indices(attrs: Fields, shape: Sequence[int]) -> list[AxisNames]:
    """Names of the axes by the attributes ``NAME_indices`` of a NeXus group.

    Each holds the number of the stored axis that NAME stands for. Empty where no attribute is such.
    """
    names = [""] * len(shape)
    for key in map(str, attrs):
        indices = np.ravel(np.asarray(attrs[key]))
        is_index = indices.size == 1 and indices.dtype.kind in "ui"
        if not is_index or not key.endswith(NEXUS_INDICES):
            continue
        axis = int(indices[0])
        if 0 <= axis < len(shape):
            names[axis] = key.removesuffix(NEXUS_INDICES)
    if any(names):
        return [AxisNames("the NeXus indices", tuple(names))]
    return []


def axis_words(raw_value: Any) -> list[str]:
    """Names of axes in the value of an attribute.

    A list of words or of entries with a name; ``z:y:x``, ``[z, y, x]`` or ``zyx``; or JSON.

    Examples
    --------
    >>> axis_words("zyx"), axis_words("[z, y, x]"), axis_words('{"axes": [{"key": "x"}]}')
    (['z', 'y', 'x'], ['z', 'y', 'x'], ['x'])
    """
    value = _axes_content(raw_value)
    if isinstance(value, list):
        words = [_entry_word(entry) for entry in value]
        if len(words) != 1:
            return words
        value = words[0]
    if not isinstance(value, str):
        return []
    text = value.strip().strip("[]")
    if set(text.casefold()) <= set("zyxct") and len(text) > 1:
        return [*text]
    return re.findall(r"[^:;,\s]+", text)


def _axes_content(raw_value: Any) -> Any:
    """A list of words or entries, or a text, in the value of an attribute on axes."""
    value = _plain(raw_value)
    if isinstance(value, str) and value.lstrip()[:1] in ("{", "["):
        try:
            value = json.loads(value)
        except ValueError:
            value = value.strip().strip("[]{}")
    if isinstance(value, dict):
        return value.get("axes", [])
    return value


def _entry_word(entry: Any) -> str:
    if isinstance(entry, dict):
        return str(entry.get("name", entry.get("key", "")))
    return str(entry)


def _plain(raw_value: Any) -> Any:
    """A word, a list of words, or what JSON made, out of arrays and bytes."""
    if isinstance(raw_value, (dict, str)):
        return raw_value
    if isinstance(raw_value, (list, tuple)):
        return [_plain(entry) for entry in raw_value]
    if isinstance(raw_value, bytes):
        return raw_value.decode("utf-8", errors="replace")
    if isinstance(raw_value, np.ndarray):
        return _plain(raw_value.tolist())
    return "" if raw_value is None else str(raw_value)


def sizes_by_attributes(attrs: Fields, shape: Sequence[int], order: Sequence[int]) -> list[Stated]:
    """Voxel size along z, y, x by each attribute that states one.

    It is one number, or one for each axis as it is stored. ``order``: which stored axes are z, y
    and x.
    """
    keys = {str(key).casefold(): str(key) for key in attrs}
    stated: list[Stated] = []
    for folded_key, key in keys.items():
        source = f"the attribute {key}"
        if folded_key == "axistags":
            stated += _stated_by_tags(attrs[key], source, shape, order)
        size_name = _size_name(folded_key)
        lengths = _lengths_along(attrs[key], shape)
        if size_name is None or lengths is None:
            continue
        axis, quantity, unit = size_name
        unit = unit or _unit_beside(attrs, keys, quantity)
        if not unit.strip():
            unit = bare_unit(lengths)
            if unit:
                source += f" ({unit}; no unit is written, in another one no scan of paper)"
        units = [unit] * max(len(shape), 3)
        # Of one axis alone by its name, of the others nothing is known.
        if axis:
            along = [lengths[0] if letter == axis else None for letter in "zyx"]
            stated.append(stated_in(source, along, units))
        else:
            stated.append(stated_in(source, lengths, units, order))
    return stated


def _size_name(key: str) -> tuple[str, str, str] | None:
    """Axis, quantity and unit in the name of a size, each empty where it says nothing of it."""
    size_name = SIZE_NAME.fullmatch(key)
    if size_name is None or "unit" in key:
        return None
    prefix, quantity, suffix, unit = size_name.groups(default="")
    axis = "z" if prefix == "slice" else prefix or suffix
    # Of a voxel a unit has to be written; steps are those of one axis.
    is_size = quantity != "step" or axis
    if quantity == "voxel":
        is_size = unit == "um"
    return (axis, quantity, unit) if is_size else None


def _unit_beside(attrs: Fields, keys: Mapping[str, str], quantity: str) -> str:
    """Unit of a size in an attribute of its own; empty where there is none.

    ``keys``: the names of the attributes by these names in small letters.
    """
    for name in (f"{quantity}_units", f"{quantity}_unit", "units", "unit"):
        if name in keys:
            return word_of(attrs[keys[name]])
    return ""


def _stated_by_tags(
    raw_value: Any, source: str, shape: Sequence[int], order: Sequence[int]
) -> list[Stated]:
    """Voxel size by tags of vigra, one for each stored axis, in which a resolution of 0 is none."""
    content = _axes_content(raw_value)
    if not isinstance(content, list):
        return []
    entries = [entry for entry in content if isinstance(entry, dict)]
    if len(entries) != len(shape):
        return []
    lengths: list[float | None] = []
    for entry in entries:
        resolution: Any = entry.get("resolution")
        is_length = isinstance(resolution, (int, float)) and resolution
        lengths.append(float(resolution) if is_length else None)
    units = [str(entry.get("unit", "")) for entry in entries]
    return [stated_in(source, lengths, units, order)]


def _lengths_along(raw_value: Any, shape: Sequence[int]) -> list[float | None] | None:
    """Lengths along the stored axes; None where a value is no number, or the count does not fit."""
    numbers = np.ravel(np.asarray(raw_value))
    if numbers.dtype.kind not in "uif":
        return None
    lengths = list[float | None](numbers.astype(np.float64).tolist())
    if len(lengths) == 1:
        return lengths * len(shape)
    return _on_axes(lengths, shape, None)


def stated_by_coordinates(
    along: Sequence[Coordinates | None], order: Sequence[int]
) -> tuple[list[Stated], list[Orientation]]:
    """Voxel size and hand by the coordinates along the stored axes, None where an axis has none.

    They have to be evenly spaced; where they fall, the axis runs the other way. ``order``: which
    stored axes are z, y and x. Both lists are empty where no axis has coordinates.
    """
    steps: list[float | None] = [None] * len(along)
    units = [""] * len(along)
    notes: list[str] = []
    for i, axis in enumerate(along):
        if axis is not None:
            steps[i] = _step_of(axis.values)
            units[i] = axis.unit
            if steps[i] is None:
                notes.append(f"{axis.name} is not evenly spaced")
    if not notes and not any(steps):
        return [], []
    source = "the spacing of its coordinates"
    lengths = [None if step is None else abs(step) for step in steps]
    stated = stated_in(source, lengths, units, order)
    all_notes = filter(None, [*notes, stated.note])
    stated = stated._replace(note=", ".join(all_notes))
    return [stated], orientation_by_steps(source, [steps[axis] for axis in order])


def _step_of(coordinates: Array) -> float | None:
    """Step along an axis, with its sign; None where the coordinates are not evenly spaced."""
    steps = np.diff(coordinates.astype(np.float64))
    step = float(np.median(steps))
    is_even = np.all(np.abs(steps - step) <= COORDINATE_TOLERANCE * abs(step))
    if step and is_even and np.isfinite(step):
        return step
    return None


def word_of(raw_value: Any) -> str:
    """Read a word that may be stored as bytes, or as an array of one."""
    entries = np.asarray(raw_value).ravel()[:1]
    word: Any = entries[0] if entries.size else ""
    if isinstance(word, bytes):
        return word.decode("utf-8", errors="replace")
    return str(word)
