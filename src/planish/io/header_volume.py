"""Volumes behind a header of text, NRRD, MetaImage and TOML: raw values are mapped, compressed ones unpacked at once.

Compressed values of a MetaImage that do not fit into the memory are read in parts by SimpleITK.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.formats import LoadedVolume, Place, extra, referenced_file
from planish.io.guard import head_of, memory_limit, reading, size_of_file
from planish.io.headed import Header, axes_of, unpacked_parts, values_behind
from planish.io.lazy import FileArray, Values
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import damaged

TYPES = {
    "int8": "signed char, int8, int8_t, MET_CHAR",
    "uint8": "uchar, unsigned char, uint8, uint8_t, MET_UCHAR",
    "int16": "short, short int, signed short, signed short int, int16, int16_t, MET_SHORT",
    "uint16": "ushort, unsigned short, unsigned short int, uint16, uint16_t, MET_USHORT",
    "int32": "int, signed int, int32, int32_t, MET_INT, MET_LONG",
    "uint32": "uint, unsigned int, uint32, uint32_t, MET_UINT, MET_ULONG",
    "int64": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t"
    ", MET_LONG_LONG",
    "uint64": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t, MET_ULONG_LONG",
    "float32": "float, MET_FLOAT",
    "float64": "double, MET_DOUBLE",
}
PACKINGS = {"raw": "", "gzip": "deflate", "gz": "deflate", "bzip2": "bzip2", "bz2": "bzip2"}


def load(place: Place, _channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    path, suffix = place.path, place.path.suffix.lower()
    readers = {".nrrd": _nrrd_header, ".nhdr": _nrrd_header, ".mha": _meta_header, ".mhd": _meta_header}
    header = readers[suffix](head_of(path, 2**20), path) if suffix in readers else _raw_header(path)
    values: Values = values_behind(header)
    too_large = header.needed_bytes > memory_limit(memory_bytes)
    if header.packing and suffix in (".mha", ".mhd") and too_large:
        # SimpleITK reads on behind the end of values that are shorter than declared.
        for _ in unpacked_parts(header):
            pass
        extra("SimpleITK", path)
        values = FileArray(path, header.shape, header.stored.newbyteorder("="), partial(_read_meta, path))
        values.piece_bytes = values.nbytes // header.shape[0]
    return header.volume(values)


def _type_of(word: str, path: Path) -> np.dtype[Any]:
    for name, words in TYPES.items():
        if word in words.split(", "):
            return np.dtype(name)
    raise VolumeError(f"{path.name} has values of the type {word!r}. Export it with integer or real values.")


def _data_file(name: str, path: Path) -> Path:
    if name.split()[:1] == ["LIST"] or "%" in name:
        raise FileError(f"{path.name} takes its slices from several files. Save it as one file.")
    return referenced_file(path.parent, name, path)


def _nrrd_header(head: bytes, path: Path) -> Header:
    import nrrd  # pyright: ignore[reportMissingTypeStubs]

    if not head.startswith(b"NRRD"):
        raise FileError(f"{path.name} is no NRRD file. Check its name, or export it again.")
    header_lines: list[str] = []
    end = 0
    for line in BytesIO(head):
        # pynrrd would drop what is not ASCII, as in file names.
        header_lines.append(line.decode("utf-8", errors="replace"))
        end += len(line)
        if not line.strip():
            break
    with reading(path):
        keys: Mapping[str, Any] = nrrd.read_header(header_lines)
        sizes = tuple(int(n) for n in np.atleast_1d(keys.get("sizes", ())))
        line_skip, byte_skip = (int(keys.get(f"{word} skip", keys.get(f"{word}skip", 0))) for word in ("line", "byte"))
    kinds = keys.get("kinds") or [""] * len(sizes)
    if not sizes or len(sizes) != keys.get("dimension") or len(kinds) != len(sizes):
        raise damaged(path, f"its sizes are {keys.get('sizes')}, its dimension is {keys.get('dimension')}")
    spatial = ("domain", "space", "???", "none", "")
    several = [f"{n} of kind {kind!r}" for n, kind in zip(sizes, kinds, strict=True) if n > 1 and kind not in spatial]
    order = axes_of(sizes, f"{' and '.join(several)} in each voxel" if several else "", path)
    dtype, endian = _type_of(str(keys.get("type", "")).strip(), path), keys.get("endian")
    if dtype.itemsize > 1 and endian not in ("little", "big"):
        raise damaged(path, "its header does not state the byte order (endian)")
    encoding = str(keys.get("encoding", "")).casefold()
    if line_skip != 0 or byte_skip < -1 or (byte_skip and encoding != "raw"):
        raise FileError(f"{path.name} skips lines or packed bytes before its values. Save it again without.")
    if encoding not in PACKINGS:
        raise FileError(f"{path.name} has the encoding {encoding!r}. Save it with the encoding raw or gzip.")
    name = keys.get("data file", keys.get("datafile"))
    return Header(
        path=path,
        data=path if name is None else _data_file(str(name), path),
        shape=tuple(sizes[axis] for axis in order),
        stored=dtype.newbyteorder(">" if endian == "big" else "<"),
        offset=-1 if byte_skip == -1 else byte_skip + (end if name is None else 0),
        packing=PACKINGS[encoding],
        stated=_stated_by_nrrd(keys, order),
    )


def _stated_by_nrrd(keys: Mapping[str, Any], order: tuple[int, ...]) -> list[Stated]:
    """Voxel size along z, y, x: the lengths of the space directions, and the spacings."""
    stated: list[Stated] = []
    directions, spacings = keys.get("space directions"), keys.get("spacings")
    if directions is not None:
        lengths = [None if v is None else float(np.linalg.norm(np.asarray(v, float))) for v in directions]
        # A direction may mix the axes of space only if all of these have one unit.
        words = {str(u).strip('"') for u in np.atleast_1d(keys.get("space units", ()))}
        medical = not words and "-" in str(keys.get("space", ""))
        unit = "mm" if medical else words.pop() if len(words) == 1 else ""
        more = " (no unit written; mm, as programs for anatomical spaces have it)" if medical else ""
        stated.append(stated_in(f"the NRRD space directions{more}", lengths, [unit] * len(lengths), order))
    if spacings is not None:
        units = [str(u) for u in np.atleast_1d(keys.get("units", [""] * len(spacings)))]
        stated.append(stated_in("the NRRD spacings", [float(v) for v in spacings], units, order))
    return stated


def _meta_header(head: bytes, path: Path) -> Header:
    keys: dict[str, str] = {}
    end = 0
    for line in BytesIO(head):
        key, equals, text = map(str.strip, line.decode("utf-8", errors="replace").partition("="))
        if key and not equals:
            break
        end += len(line)
        keys.setdefault(key.casefold(), text)
        if "elementdatafile" in keys:
            break
    name = keys.get("elementdatafile")
    if name is None:
        raise FileError(f"{path.name} is no MetaImage: the line ElementDataFile is missing. Export it again.")

    def switched(key: str, default: str) -> bool:
        return keys.get(key, default).casefold() in {"true", "t", "1"}

    words = keys.get("dimsize", "").split()
    whole = all(word.isascii() and word.isdecimal() and len(word) < 16 for word in words)
    if not whole or str(len(words)) != keys.get("ndims", ""):
        raise damaged(path, f"its sizes are {keys.get('dimsize', '')[:40]!r}, its dimension is {keys.get('ndims')}")
    sizes = tuple(int(word) for word in words)
    channels = keys.get("elementnumberofchannels", "1")
    order = axes_of(sizes, f"{channels} channels" if channels != "1" else "", path)
    dtype = _type_of(keys.get("elementtype", ""), path)
    if not switched("binarydata", "True"):
        raise FileError(f"{path.name} has its values written as text. Save it with binary values.")
    local, skip = name.casefold() == "local", keys.get("headersize", "0")
    if skip != "0" and (local or skip != "-1"):
        raise FileError(f"{path.name} skips {skip} bytes before its values (HeaderSize). Save it again without.")
    packed = switched("compresseddata", "False")
    big = switched("binarydatabyteordermsb", keys.get("elementbyteordermsb", "False"))
    unit = keys.get("distanceunits", "")
    stated: list[Stated] = []
    for key in ("ElementSpacing", "ElementSize"):
        if words := keys.get(key.casefold(), "").split():
            source = f"the MetaImage {key} ({unit or 'no unit written; mm, as ITK has it'})"
            with reading(path):
                stated.append(stated_in(source, [float(w) for w in words], [unit or "mm"] * len(sizes), order))
    return Header(
        path=path,
        data=path if local else _data_file(name, path),
        shape=tuple(sizes[axis] for axis in order),
        stored=dtype.newbyteorder(">" if big else "<"),
        offset=-1 if skip == "-1" and not packed else end if local else 0,
        packing="deflate" if packed else "",
        stated=stated,
    )


def _read_meta(path: Path, where: Where) -> NDArray[Any]:
    """Read a part of compressed values by SimpleITK."""
    itk: Any = extra("SimpleITK", path)
    reader = itk.ImageFileReader()
    reader.SetImageIO("MetaImageIO")
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    # Axes of length 1 that were left out above lie before the others or after them; here they come back.
    sizes = [int(n) for n in reader.GetSize()]
    parts = iter(reversed(where))
    spans = [next(parts) if n > 1 else slice(0, 1) for n in sizes]
    reader.SetExtractIndex([span.start for span in spans])
    reader.SetExtractSize([span.stop - span.start for span in spans])
    values = np.asarray(itk.GetArrayFromImage(reader.Execute())).reshape([s.stop - s.start for s in where])
    return values[tuple(slice(None, None, s.step) for s in where)]


RAW_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64")
KEYS = ("file", "shape", "dtype", "byte_order", "offset", "voxel_um")
EXAMPLE = 'with lines such as: shape = [z, y, x], dtype = "uint16", byte_order = "little", voxel_um = 1.65'


def _raw_header(path: Path) -> Header:
    """Header of raw values in a TOML file; either of the two files is given."""
    header = path if path.suffix.lower() == ".toml" else path.with_name(path.name + ".toml")
    if not header.is_file() and header != path:
        size_of_file(path)
        raise FileError(f"{path.name} has raw values and no header. Write {header.name} beside it, {EXAMPLE}.")
    if size_of_file(header) > 100_000:
        raise FileError(f"{header.name} is larger than 100 kB and no header. Write one {EXAMPLE}.")
    with reading(header), header.open("rb") as file:
        keys = tomllib.load(file)
    data = referenced_file(header.parent, str(keys.get("file", header.name[: -len(".toml")])), header)
    faults = [f"unknown key {key!r}" for key in keys if key not in KEYS]
    shape, dtype, order = (keys.get(key) for key in ("shape", "dtype", "byte_order"))
    offset, voxel_um = keys.get("offset", 0), keys.get("voxel_um")
    if not (isinstance(shape, list) and len(shape) == 3 and all(type(n) is int and n > 0 for n in shape)):
        faults.append(f"shape is {shape!r}, needed are three whole numbers [z, y, x]")
    if dtype not in RAW_TYPES:
        faults.append(f"dtype is {dtype!r}, needed is one of {', '.join(RAW_TYPES)}")
    elif np.dtype(dtype).itemsize > 1 and order not in ("little", "big"):
        faults.append(f'byte_order is {order!r}, needed is "little" or "big"')
    if type(offset) is not int or offset < 0:
        faults.append(f"offset is {offset!r}, needed is a number of bytes")
    sizes: list[Any] = voxel_um if isinstance(voxel_um, list) else [voxel_um] * 3
    if voxel_um is not None and not (len(sizes) == 3 and all(type(v) in (int, float) and v > 0 for v in sizes)):
        faults.append(f"voxel_um is {voxel_um!r}, needed is a number or [z, y, x], in um")
    if not isinstance(keys.get("file", ""), str):
        faults.append("file is no name")
    if faults:
        raise FileError(f"{header.name}: {'; '.join(faults)}. Correct the header, {EXAMPLE}.")
    voxel = tuple(None if v is None else float(v) for v in sizes)
    return Header(
        path=header,
        data=data,
        shape=tuple(int(n) for n in shape or ()),
        offset=int(offset),
        stored=np.dtype(str(dtype)).newbyteorder(">" if order == "big" else "<"),
        stated=[Stated("the TOML header", voxel, "it has no voxel_um" if None in voxel else "")],
    )
