"""MetaImage files, ``.mha`` or ``.mhd`` with its data beside it: mapped where they are not compressed.

Compressed values are unpacked at once where they fit into the memory; otherwise SimpleITK reads the parts asked for.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.formats import Place, extra
from planish.io.guard import check_blown_up, default_memory_limit, reading, size_of_file
from planish.io.lazy import FileArray
from planish.io.loaded import ADVICE, LoadedVolume, inside, loaded
from planish.io.sizes import Stated, unit_um
from planish.io.stored import check_shape, check_unpacked, raw_values, unpacked_values
from planish.io.tiff import size_words
from planish.io.tiff_chain import damaged

LARGEST_HEADER = 2**16

TYPES = {
    "MET_CHAR": "int8", "MET_UCHAR": "uint8", "MET_SHORT": "int16", "MET_USHORT": "uint16", "MET_INT": "int32",
    "MET_UINT": "uint32", "MET_LONG": "int32", "MET_ULONG": "uint32", "MET_LONG_LONG": "int64",
    "MET_ULONG_LONG": "uint64", "MET_FLOAT": "float32", "MET_DOUBLE": "float64",
}  # fmt: skip


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Map, unpack or lazily read the values of a MetaImage."""
    del channel
    path = place.path
    header, end = read_header(path)
    sizes = whole_numbers(header.get("dimsize", ""), path)
    if str(len(sizes)) != header.get("ndims", "").strip():
        raise damaged(path, f"its sizes are {header.get('dimsize')}, its dimension is {header.get('ndims')}")
    channels = header.get("elementnumberofchannels", "1")
    long = [axis for axis, n in enumerate(sizes) if n > 1]
    if channels != "1" or len(long) != 3:
        what = f"has {channels} channels" if channels != "1" else "is no volume"
        raise VolumeError(f"{path.name} {what}: {size_words(sizes)} (fastest axis first). {ADVICE}")
    order = tuple(reversed(long))
    shape = tuple(sizes[axis] for axis in order)
    check_shape(shape, path)
    word = header.get("elementtype", "")
    if word not in TYPES:
        raise VolumeError(f"{path.name} has values of the type {word!r}. Export it with integer or real values.")
    big = header.get("binarydatabyteordermsb", header.get("elementbyteordermsb", "False"))
    stored = np.dtype(TYPES[word]).newbyteorder(">" if is_true(big) else "<")
    array, data = values_of(header, path, end, shape, stored, memory_bytes=memory_bytes)
    return loaded(
        array,
        path,
        stated=stated_by_header(header, order),
        file_bytes=size_of_file(path) + (0 if data == path else size_of_file(data)),
        memory_bytes=memory_bytes,
    )


def files(place: Place) -> list[Path]:
    """Header and data, which may be one file."""
    data = data_file(read_header(place.path)[0], place.path)
    return [place.path] if data is None else [place.path, data]


def data_file(header: dict[str, str], path: Path) -> Path | None:
    """File with the values; None where they follow the header."""
    name = header["elementdatafile"]
    if name.casefold() == "local":
        return None
    if name.split()[:1] == ["LIST"] or "%" in name:
        raise FileError(f"{path.name} takes its slices from several files. Save it as one file (.mha).")
    return inside(path.parent, name, path)


def read_header(path: Path) -> tuple[dict[str, str], int]:
    """Read the keys, in small letters, and where the header ends."""
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        head = file.read(LARGEST_HEADER)
    found: dict[str, str] = {}
    end = 0
    for line in BytesIO(head):
        end += len(line)
        key, equals, value = line.decode("utf-8", errors="replace").partition("=")
        if not equals and key.strip():
            break
        found.setdefault(key.strip().casefold(), value.strip())
        if key.strip().casefold() == "elementdatafile":
            return found, end
    raise FileError(
        f"{path.name} is no MetaImage or has a damaged header: its line ElementDataFile is missing. Export it again."
    )


def whole_numbers(text: str, path: Path) -> tuple[int, ...]:
    """Read the sizes of the axes."""
    try:
        return tuple(int(word) for word in text.split())
    except ValueError:
        raise damaged(path, f"its sizes are {text[:40]!r}") from None


def is_true(text: str) -> bool:
    """Read a switch."""
    return text.strip().casefold() in {"true", "t", "1"}


def values_of(
    header: dict[str, str],
    path: Path,
    end: int,
    shape: tuple[int, ...],
    stored: np.dtype[Any],
    *,
    memory_bytes: int | None,
) -> tuple[NDArray[Any] | FileArray, Path]:
    """Find the data, and map, unpack or leave them; return them with their file."""
    if not is_true(header.get("binarydata", "True")):
        raise FileError(f"{path.name} has its values written as text. Save it with binary values.")
    detached = data_file(header, path)
    local, data = detached is None, path if detached is None else detached
    skip = header.get("headersize", "0")
    if skip != "0" and (local or skip != "-1"):
        raise FileError(f"{path.name} skips {skip} bytes before its values (HeaderSize). Save it again without.")
    offset = end if local else 0
    if not is_true(header.get("compresseddata", "False")):
        if skip == "-1":
            offset = max(size_of_file(data) - int(np.prod(shape, dtype=object)) * stored.itemsize, 0)
        return raw_values(path, data, shape, stored, offset=offset), data
    needed = int(np.prod(shape, dtype=object)) * stored.itemsize
    if needed > (default_memory_limit() if memory_bytes is None else memory_bytes):
        check_blown_up(data, decoded_bytes=needed, stored_bytes=size_of_file(data))
        # SimpleITK reads on behind the end of values that are shorter than declared.
        check_unpacked(path, data, needed, offset=offset, packing="deflate")
        return MetaArray(path, shape, stored.newbyteorder("=")), data
    array = unpacked_values(path, data, shape, stored, offset=offset, packing="deflate", memory_bytes=memory_bytes)
    return array, data


class MetaArray(FileArray):
    """Compressed values, of which SimpleITK reads parts."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        extra("SimpleITK", path)
        self.path, self.shape, self.dtype = path, shape, dtype
        self.piece_bytes = shape[1] * shape[2] * dtype.itemsize

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part."""
        itk: Any = extra("SimpleITK", self.path)
        reader = itk.ImageFileReader()
        reader.SetImageIO("MetaImageIO")
        reader.SetFileName(str(self.path))
        reader.ReadImageInformation()
        # Axes of length 1 that were left out above lie before the others or after them; here they come back.
        sizes = tuple(int(n) for n in reader.GetSize())
        long = [axis for axis, n in enumerate(sizes) if n > 1]
        start, size = [0] * len(sizes), [1] * len(sizes)
        for part, axis in zip(reversed(where), long, strict=True):
            start[axis], size[axis] = part.start, range(part.start, part.stop, part.step)[-1] + 1 - part.start
        reader.SetExtractIndex(start)
        reader.SetExtractSize(size)
        values = np.asarray(itk.GetArrayFromImage(reader.Execute()))
        values = values.reshape([range(s.start, s.stop, s.step)[-1] + 1 - s.start for s in where])
        return values[tuple(slice(None, None, s.step) for s in where)]


def stated_by_header(header: dict[str, str], order: tuple[int, ...]) -> list[Stated]:
    """Voxel size along z, y, x; in mm where no other unit is written, as ITK has it."""
    unit = header.get("distanceunits", "")
    length = unit_um(unit or "mm")
    stated: list[Stated] = []
    for key, name in (("elementspacing", "ElementSpacing"), ("elementsize", "ElementSize")):
        if key not in header:
            continue
        source = f"the MetaImage {name} ({unit or 'no unit written; mm, as ITK has it'})"
        try:
            values = [float(word) for word in header[key].split()]
        except ValueError:
            values = []
        usable = len(values) > max(order) and all(np.isfinite(v) and v > 0 for v in values)
        if length is None or not usable:
            note = f"{unit!r} is no unit of length" if usable else f"{header[key][:40]!r} are no sizes"
            stated.append(Stated(source=source, um=(None, None, None), note=note))
        else:
            stated.append(Stated(source=source, um=tuple(values[axis] * length for axis in order)))
    return stated
