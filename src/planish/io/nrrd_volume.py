"""NRRD files with their header attached (``.nrrd``) or detached (``.nhdr``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.io.formats import Place
from planish.io.guard import reading, size_of_file
from planish.io.lazy import FileArray
from planish.io.loaded import ADVICE, LoadedVolume, inside, loaded
from planish.io.sizes import Stated, unit_um
from planish.io.stored import raw_values, unpacked_values
from planish.io.tiff import size_words
from planish.io.tiff_chain import damaged

LARGEST_HEADER = 2**20

TYPES = {
    "int8": "signed char, int8, int8_t",
    "uint8": "uchar, unsigned char, uint8, uint8_t",
    "int16": "short, short int, signed short, signed short int, int16, int16_t",
    "uint16": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "int32": "int, signed int, int32, int32_t",
    "uint32": "uint, unsigned int, uint32, uint32_t",
    "int64": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
    "uint64": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "float32": "float",
    "float64": "double",
}
PACKINGS = {"gzip": "deflate", "gz": "deflate", "bzip2": "bzip2", "bz2": "bzip2"}
SPATIAL = frozenset({"domain", "space", "???", "none", ""})

MEDICAL = "no unit written; mm, as programs for anatomical spaces have it"


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Map the values of a NRRD file, or unpack them."""
    del channel
    path = place.path
    header, end = read_header(path)
    sizes = whole_numbers(header.get("sizes"))
    kinds = header.get("kinds") or [""] * len(sizes)
    if not sizes or len(sizes) != header.get("dimension") or len(kinds) != len(sizes):
        raise damaged(path, f"its sizes are {header.get('sizes')}, its dimension is {header.get('dimension')}")
    several = [f"{n} of kind {kind!r}" for n, kind in zip(sizes, kinds, strict=True) if n > 1 and kind not in SPATIAL]
    long = [axis for axis, n in enumerate(sizes) if n > 1]
    if several or len(long) != 3:
        what = f"has {' and '.join(several)} in each voxel" if several else "is no volume"
        raise VolumeError(f"{path.name} {what}: {size_words(sizes)} (fastest axis first). {ADVICE}")
    stored = stored_type(header, path)
    shape = tuple(sizes[axis] for axis in reversed(long))
    array, data = values_of(header, path, end, shape, stored, memory_bytes=memory_bytes)
    return loaded(
        array,
        path,
        stated=stated_by_header(header, tuple(reversed(long))),
        file_bytes=size_of_file(path) + (0 if data == path else size_of_file(data)),
        memory_bytes=memory_bytes,
    )


def files(place: Place) -> list[Path]:
    """Header and data, which may be one file."""
    header, _ = read_header(place.path)
    data = data_file(header, place.path)
    return [place.path] if data is None else [place.path, data]


def data_file(header: Mapping[str, Any], path: Path) -> Path | None:
    """File with the values; None where they follow the header."""
    name = header.get("data file", header.get("datafile"))
    if name is None:
        return None
    if str(name).split()[:1] == ["LIST"] or "%" in str(name):
        raise FileError(f"{path.name} takes its slices from several files. Save it as one file (.nrrd).")
    return inside(path.parent, str(name), path)


def read_header(path: Path) -> tuple[Mapping[str, Any], int]:
    """Read the header and where it ends."""
    import nrrd  # pyright: ignore[reportMissingTypeStubs]

    size_of_file(path)
    with reading(path), path.open("rb") as file:
        head = file.read(LARGEST_HEADER)
    if not head.startswith(b"NRRD"):
        raise FileError(f"{path.name} is no NRRD file. Check its name, or export it again.")
    taken: list[str] = []
    end = 0
    for line in BytesIO(head):
        taken.append(line.decode("utf-8", errors="replace"))  # pynrrd would drop what is not ASCII, as in file names
        end += len(line)
        if not line.strip():
            break
    with reading(path):
        return nrrd.read_header(taken), end


def whole_numbers(values: Any) -> tuple[int, ...]:
    """Read the sizes of the axes."""
    if values is None:
        return ()
    return tuple(int(v) for v in np.atleast_1d(np.asarray(values)).ravel())


def stored_type(header: Mapping[str, Any], path: Path) -> np.dtype[Any]:
    """Type of the values in the file."""
    word = str(header.get("type", "")).strip()
    name = next((name for name, words in TYPES.items() if word in words.split(", ")), None)
    if name is None:
        raise VolumeError(f"{path.name} has values of the type {word!r}. Export it with integer or real values.")
    dtype = np.dtype(name)
    order = header.get("endian")
    if dtype.itemsize > 1 and order not in ("little", "big"):
        raise damaged(path, "its header does not state the byte order (endian)")
    return dtype.newbyteorder(">" if order == "big" else "<")


def values_of(
    header: Mapping[str, Any],
    path: Path,
    end: int,
    shape: tuple[int, ...],
    stored: np.dtype[Any],
    *,
    memory_bytes: int | None,
) -> tuple[Any | FileArray, Path]:
    """Find the data, and map or unpack them; return them with their file."""
    detached = data_file(header, path)
    data = path if detached is None else detached
    offset = end if detached is None else 0
    line_skip, byte_skip = (
        int(header.get(key, header.get(key.replace(" ", ""), 0))) for key in ("line skip", "byte skip")
    )
    encoding = str(header.get("encoding", "")).casefold()
    if line_skip != 0 or byte_skip < -1 or (byte_skip and encoding != "raw"):
        raise FileError(f"{path.name} skips lines or packed bytes before its values. Save it again without.")
    if encoding == "raw":
        needed = math.prod(shape) * stored.itemsize
        offset = max(size_of_file(data) - needed, 0) if byte_skip == -1 else offset + byte_skip
        return raw_values(path, data, shape, stored, offset=offset), data
    if encoding not in PACKINGS:
        raise FileError(f"{path.name} has the encoding {encoding!r}. Save it with the encoding raw or gzip.")
    array = unpacked_values(
        path, data, shape, stored, offset=offset, packing=PACKINGS[encoding], memory_bytes=memory_bytes
    )
    return array, data


def stated_by_header(header: Mapping[str, Any], order: tuple[int, ...]) -> list[Stated]:
    """Voxel size along z, y, x: the lengths of the space directions, and the spacings."""
    stated: list[Stated] = []
    directions = header.get("space directions")
    if directions is not None:
        lengths = [None if v is None else float(np.linalg.norm(np.asarray(v, float))) for v in directions]
        units: Any = header.get("space units")
        # A direction may mix the axes of space only if all of these have one unit.
        words = {str(u).strip('"') for u in np.atleast_1d(units)} if units is not None else set[str]()
        medical = not words and "-" in str(header.get("space", ""))
        unit = "mm" if medical else words.pop() if len(words) == 1 else ""
        source = f"the NRRD space directions ({MEDICAL})" if medical else "the NRRD space directions"
        stated.append(in_um(lengths, [unit] * len(lengths), order, source=source))
    spacings = header.get("spacings")
    if spacings is not None:
        units = header.get("units")
        words_of = [str(u) for u in np.atleast_1d(units)] if units is not None else [""] * len(spacings)
        stated.append(in_um([float(v) for v in spacings], words_of, order, source="the NRRD spacings"))
    return stated


def in_um(values: list[float | None], units: list[str], order: tuple[int, ...], *, source: str) -> Stated:
    """Turn lengths of the header's axes into um along z, y, x."""
    found: list[float | None] = []
    notes: list[str] = []
    for axis in order:
        value = values[axis] if axis < len(values) else None
        unit = units[axis] if axis < len(units) else ""
        length = unit_um(unit)
        usable = value is not None and math.isfinite(value) and value > 0
        found.append(value * length if usable and value is not None and length is not None else None)
        if usable and length is None:
            notes.append(f"{value:g} without a unit" if not unit else f"{unit!r} is no unit of length")
    return Stated(source=source, um=tuple(found), note=", ".join(dict.fromkeys(notes)))
