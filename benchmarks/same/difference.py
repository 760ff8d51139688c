"""Where two folders of results differ: every array, type, attribute, number and cell, named by
place and size."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Mapping

import numpy as np

Keys = Mapping[str, str]
"""Old key -> new key of results, indices as ``[]``: ``layers[].sheet.numbers`` ->
``layers[].sheet.values``."""

_INDEX = re.compile(r"\[\d+\]")
_STORE = {"zarr.json", ".zgroup", ".zarray"}
_SCRIPT = re.compile(r"<(script|style)\b.*?</\1>", re.DOTALL)
_WORDS = re.compile(r"<[^>]*>")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# By a command: words may change, numbers stand in the other files.
_SAID = re.compile(r"\d\d-[a-z]+\.(err|txt)")
_UUID = re.compile(r"urn:uuid:[0-9a-f-]+")  # which OME asks to be another one for each file
_SIDE = re.compile(r"(?<=/)(old|new)(?=/)")  # folder of a side, in whole paths
_OF_THEIR_OWN = {".jsonl", ".lock", ".log"}  # journals know the time


def differences(old, new, keys):
    """Give place and size of every difference of two folders, file by file; hidden files do not
    count."""
    places = [sorted(units(folder)) for folder in (old, new)]
    for place in sorted({*places[0]} | {*places[1]}):
        sides = [folder / place for folder in (old, new)]
        if not all(path.exists() for path in sides):
            yield place, f"only {'old' if sides[0].exists() else 'new'}"
        elif sides[0].is_dir() or sides[0].read_bytes() != sides[1].read_bytes():
            compare = (
                _stores if sides[0].is_dir() else _READERS.get(sides[0].suffix.lower(), _bytes)
            )
            for where, what in compare(*sides, keys):
                yield f"{place}{':' if where else ''}{where}", what


def units(folder):
    """Files of a folder, a Zarr store counting as one."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix in _OF_THEIR_OWN:
            continue
        if path.is_dir() and not any((path / name).is_file() for name in _STORE):
            yield from (f"{path.name}/{inner}" for inner in units(path))
        elif not _SAID.fullmatch(path.name):
            yield path.name


# --- arrays --------------------


def arrays(old, new):
    """Say how two arrays differ: type, shape, or how many values by how much; NaN equals NaN."""
    if (old.dtype, old.shape) != (new.dtype, new.shape):
        return f"{old.dtype} {old.shape} -> {new.dtype} {new.shape}"
    if old.tobytes() == new.tobytes():
        return None
    if old.dtype.kind not in "fiucb":
        return f"{int(np.sum(old != new))} of {old.size} values"
    different = (
        (old != new) & ~(np.isnan(old) & np.isnan(new)) if old.dtype.kind in "fc" else old != new
    )
    if not different.any():
        return None  # the sign of a zero or the bits of a NaN
    by = np.abs(old[different].astype(np.float64) - new[different].astype(np.float64))
    lost = int(np.sum(~np.isfinite(by)))
    largest = np.max(by[np.isfinite(by)], initial=0.0)
    return f"{int(different.sum())} of {old.size} values, by up to {largest:.3g}" + (
        f", {lost} missing" if lost else ""
    )


def _named_arrays(old, new, values, keys):
    """Differences of arrays by their names, and of their attributes."""
    for name in sorted({*old} | {*new}):
        if name not in old or name not in new:
            yield name, f"only {'old' if name in old else 'new'}"
            continue
        before, after = old[name], new[name]
        yield from (
            (f"{name}.{key}", what)
            for key, what in _values(dict(before.attrs), dict(after.attrs), keys)
        )
        if hasattr(before, "shape") and (what := arrays(values(before), values(after))):
            yield name, what


def _stores(old, new, keys):
    import zarr

    members = [_members(zarr.open(path, mode="r")) for path in (old, new)]
    yield from _named_arrays(*members, lambda array: np.asarray(array[...]), keys)


def _members(root):
    import zarr

    return {"/": root} | (
        dict(root.members(max_depth=None)) if isinstance(root, zarr.Group) else {}
    )


def _tiff(old, new, _keys):
    import tifffile

    with tifffile.TiffFile(old) as before, tifffile.TiffFile(new) as after:
        if what := arrays(before.asarray(), after.asarray()):
            yield "", what
        for name in ("description", "resolution", "software"):
            a, b = (
                _UUID.sub("", str(getattr(file.pages.first, name, ""))) for file in (before, after)
            )
            if a != b:
                yield name, _shortly(a, b)


def _matlab(old, new, _keys):
    from pymatreader import read_mat

    yield from _values(read_mat(str(old)), read_mat(str(new)), {})


def _netcdf(old, new, _keys):
    import xarray as xr

    with xr.open_dataset(old) as before, xr.open_dataset(new) as after:
        yield from _values(dict(before.attrs), dict(after.attrs), {})
        yield from _named_arrays(before.variables, after.variables, lambda array: array.values, {})


# --- values --------------------


def _values(old, new, keys):
    before, after = (dict(_flat(side)) for side in (old, new))
    before = {_renamed(place, keys): value for place, value in before.items()}
    for place in [*before, *(place for place in after if place not in before)]:
        if place not in before or place not in after:
            yield (
                place,
                f"only {'old' if place in before else 'new'}: {(before | after)[place]!r:.80}",
            )
        elif isinstance(before[place], np.ndarray) or isinstance(after[place], np.ndarray):
            if what := arrays(np.asarray(before[place]), np.asarray(after[place])):
                yield place, what
        elif not _same(before[place], after[place]):
            yield place, _shortly(before[place], after[place])


def _flat(value, place=""):
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list | tuple) and value:
        for k, inner in enumerate(value):
            yield from _flat(inner, f"{place}[{k}]")
    else:
        yield place, _SIDE.sub("side", value) if isinstance(value, str) else value


def _renamed(place, keys):
    """The new key: the longest old one that the place begins with, its indices kept in their
    order."""
    bare, numbers = _INDEX.sub("[]", place), iter(_INDEX.findall(place))
    begins = [key for key in keys if bare == key or bare.startswith((f"{key}.", f"{key}["))]
    if not begins:
        return place
    longest = max(begins, key=len)
    return re.sub(r"\[\]", lambda _: next(numbers), keys[longest] + bare.removeprefix(longest))


def _same(old, new):
    return type(old) is type(new) and (
        old == new or (isinstance(old, float) and old != old and new != new)
    )


def _shortly(old, new):
    if isinstance(old, int | float) and isinstance(new, int | float) and not isinstance(old, bool):
        return f"{old!r} -> {new!r} (by {new - old:.3g})"
    a, b = str(old), str(new)
    first = next(
        (k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b))
    )
    begin = max(0, first - 20)
    return f"{a[begin : first + 60]!r} -> {b[begin : first + 60]!r}"


def _json(old, new, keys):
    try:
        sides = [json.loads(path.read_text(encoding="utf-8")) for path in (old, new)]
    except ValueError:  # two documents, or none where a command was refused
        return _bytes(old, new, keys)
    return _values(*sides, keys)


def _toml(old, new, _keys):
    return _values(*(tomllib.loads(path.read_text(encoding="utf-8")) for path in (old, new)), {})


def _csv(old, new, _keys):
    rows = [list(csv.reader(path.read_text(encoding="utf-8").splitlines())) for path in (old, new)]
    if len(rows[0]) != len(rows[1]):
        yield "", f"{len(rows[0])} rows -> {len(rows[1])}"
    for k, (before, after) in enumerate(zip(*rows, strict=False)):
        if before != after:
            yield f"row {k}", _shortly(", ".join(before), ", ".join(after))


def _html(old, new, _keys):
    """Numbers of the text and content of the scripts; words may change."""
    texts = [path.read_text(encoding="utf-8") for path in (old, new)]
    scripts = [[found[0] for found in _SCRIPT.finditer(text)] for text in texts]
    if scripts[0] != scripts[1]:
        sizes = [sum(map(len, side)) for side in scripts]
        yield (
            "scripts",
            f"{len(scripts[0])} of {sizes[0]} bytes -> {len(scripts[1])} of {sizes[1]} bytes",
        )
    numbers = [_NUMBER.findall(_WORDS.sub(" ", _SCRIPT.sub(" ", text))) for text in texts]
    if numbers[0] != numbers[1]:
        yield "numbers", _shortly(" ".join(numbers[0]), " ".join(numbers[1]))


def _bytes(old, new, _keys):
    a, b = (np.frombuffer(path.read_bytes(), np.uint8) for path in (old, new))
    if a.size != b.size:
        yield "", f"{a.size} bytes -> {b.size} bytes"
    elif (a != b).any():
        yield "", f"{int((a != b).sum())} of {a.size} bytes, the first at {int(np.argmax(a != b))}"


_READERS = {
    ".json": _json,
    ".geojson": _json,
    ".toml": _toml,
    ".csv": _csv,
    ".html": _html,
    ".tif": _tiff,
    ".mat": _matlab,
    ".nc": _netcdf,
}
