"""Read volumes behind a header of text: NRRD, MetaImage and TOML.

Raw values are mapped, compressed ones unpacked at once.

Compressed values of a MetaImage that do not fit into the memory are read in parts by SimpleITK.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.core.parameter_faults import toml_tables
from planish.core.tables import read_text
from planish.core.typing import Array, DType, Fields, Shape
from planish.io.axes import AxisNames
from planish.io.formats import LoadedVolume, Place, extra, referenced_file
from planish.io.guard import head_of, memory_limit, reading, size_of_file
from planish.io.headed import Header, StoredAxes, axes_of, unpacked_parts, values_behind
from planish.io.lazy import FileArray, Values
from planish.io.orientation import ANATOMICAL, Orientation, orientation_by_words
from planish.io.sizes import NO_SIZE, Stated, stated_in
from planish.io.tiff import damaged

TYPES = {
    "int8": "signed char, int8, int8_t, MET_CHAR",
    "uint8": "uchar, unsigned char, uint8, uint8_t, MET_UCHAR",
    "int16": "short, short int, signed short, signed short int, int16, int16_t, MET_SHORT",
    "uint16": "ushort, unsigned short, unsigned short int, uint16, uint16_t, MET_USHORT",
    "int32": "int, signed int, int32, int32_t, MET_INT, MET_LONG",
    "uint32": "uint, unsigned int, uint32, uint32_t, MET_UINT, MET_ULONG",
    "int64": (
        "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t"
        ", MET_LONG_LONG"
    ),
    "uint64": (
        "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t, MET_ULONG_LONG"
    ),
    "float32": "float, MET_FLOAT",
    "float64": "double, MET_DOUBLE",
}
SPATIAL_KINDS = ("domain", "space", "???", "none", "")
# Short names of spaces in NRRD files.
SPACES = {
    "ras": "right-anterior-superior",
    "las": "left-anterior-superior",
    "lps": "left-posterior-superior",
}
# Letters of AnatomicalOrientation, which say where an axis comes from, and where it leads.
META_LETTERS = {
    "R": "left",
    "L": "right",
    "A": "posterior",
    "P": "anterior",
    "I": "superior",
    "S": "inferior",
}
PACKINGS = {"raw": "", "gzip": "deflate", "gz": "deflate", "bzip2": "bzip2", "bz2": "bzip2"}


def load(place: Place, _channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    path = place.path
    suffix = path.suffix.lower()
    is_meta = suffix in (".mha", ".mhd")
    if is_meta:
        header = _meta_header(head_of(path, 2**20), path)
    elif suffix in (".nrrd", ".nhdr"):
        header = _nrrd_header(head_of(path, 2**20), path)
    else:
        header = _raw_header(path)
    values: Values = values_behind(header)
    if header.packing and is_meta and header.needed_bytes > memory_limit(memory_bytes):
        # SimpleITK reads on behind the end of values that are shorter than declared.
        for _ in unpacked_parts(header):
            pass
        extra("SimpleITK", path)
        values = FileArray(path, header.shape, header.stored_dtype, partial(_read_meta, path))
        values.piece_bytes = values.nbytes // header.shape[0]
    return header.volume(values)


def _type_of(word: str, path: Path) -> DType:
    for name, words in TYPES.items():
        if word in words.split(", "):
            return np.dtype(name)
    raise VolumeError(
        f"{path.name} has values of the type {word!r}. Export it with integer or real values."
    )


def _data_file(name: str, path: Path) -> Path:
    if name.split()[:1] == ["LIST"] or "%" in name:
        raise FileError(f"{path.name} takes its slices from several files. Save it as one file.")
    return referenced_file(path.parent, name, path)


def _text_of(line: bytes) -> str:
    """Text of a line of a header, in UTF-8 or as older programs on Windows write it."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")


def _nrrd_lines(head: bytes) -> Iterator[bytes]:
    """Lines of the header of an NRRD file, up to an empty one or to a list of files."""
    for line in BytesIO(head):
        yield line
        is_list = re.fullmatch(rb"data ?file:=? *LIST\b.*", line.strip(), re.IGNORECASE)
        if is_list or not line.strip():
            return


def _either(fields: Fields, name: str, default: object) -> Any:
    """Value of a field whose name is written with or without its space."""
    return fields.get(name, fields.get(name.replace(" ", ""), default))


def _nrrd_header(head: bytes, path: Path) -> Header:
    """Header of an NRRD file, whose values lie behind it or in one other file.

    ``head``: the first bytes of the file, more than any header has.
    """
    import nrrd  # pyright: ignore[reportMissingTypeStubs]

    if not head.startswith(b"NRRD"):
        raise FileError(f"{path.name} is no NRRD file. Check its name, or export it again.")
    header_lines = list(_nrrd_lines(head))
    with reading(path):
        # pynrrd would drop what is not ASCII, as in file names.
        fields: Fields = nrrd.read_header(list(map(_text_of, header_lines)))
        extents = tuple(map(int, np.atleast_1d(fields.get("sizes", ()))))
        line_skip = int(_either(fields, "line skip", 0))
        byte_skip = int(_either(fields, "byte skip", 0))
    axes = _nrrd_axes(fields, extents, path)
    dtype = _nrrd_type(fields, path)
    encoding = str(fields.get("encoding", "")).casefold()
    if line_skip != 0 or byte_skip < -1 or (byte_skip and encoding != "raw"):
        raise FileError(
            f"{path.name} skips lines or packed bytes before its values. Save it again without."
        )
    if encoding not in PACKINGS:
        raise FileError(
            f"{path.name} has the encoding {encoding!r}. Save it with the encoding raw or gzip."
        )
    data_name = _either(fields, "data file", None)
    data_file = path
    offset = sum(map(len, header_lines)) + byte_skip
    if data_name is not None:
        data_file = _data_file(str(data_name), path)
        offset = byte_skip
    if byte_skip == -1:  # the values end with the file
        offset = -1
    return Header(
        path=path,
        data=data_file,
        axes=axes,
        stored_dtype=dtype,
        offset=offset,
        packing=PACKINGS[encoding],
        stated=_stated_by_nrrd(fields, axes.header_axes),
        orientations=_oriented_by_nrrd(fields, axes.header_axes),
    )


def _nrrd_type(fields: Fields, path: Path) -> DType:
    """Type of the values with its byte order."""
    dtype = _type_of(str(fields.get("type", "")).strip(), path)
    if dtype.itemsize == 1:
        return dtype
    endian = fields.get("endian")
    if endian not in ("little", "big"):
        raise damaged(path, "its header does not state the byte order (endian)")
    return dtype.newbyteorder(endian)


def _nrrd_axes(fields: Fields, extents: Shape, path: Path) -> StoredAxes:
    """Axes of an NRRD file, each of space or time; ``extents`` are their lengths, fastest first.

    An axis of another kind that is longer than 1 holds samples of a voxel, and is refused.
    """
    kinds = fields.get("kinds") or [""] * len(extents)
    dimension = fields.get("dimension")
    if not extents or len(extents) != dimension or len(kinds) != len(extents):
        raise damaged(path, f"its sizes are {fields.get('sizes')}, its dimension is {dimension}")
    sample_texts: list[str] = []
    for n, kind in zip(extents, kinds, strict=True):
        if n > 1 and kind not in (*SPATIAL_KINDS, "time"):
            sample_texts.append(f"{n} of kind {kind!r}")
    contents_text = f"{' and '.join(sample_texts)} in each voxel" if sample_texts else ""
    return axes_of(extents, path, _names_by_nrrd(fields, kinds), contents_text=contents_text)


def _names_by_nrrd(fields: Fields, kinds: Sequence[str]) -> list[AxisNames]:
    """Names of the axes by their labels, and by the kind of an axis of time; fastest axis first."""
    kind_names = tuple("time" if kind == "time" else "" for kind in kinds)
    labels = tuple(map(str, fields.get("labels") or ()))
    namings = [AxisNames("its kinds", kind_names)] if any(kind_names) else []
    if any(labels) and len(labels) == len(kinds):
        namings.append(AxisNames("its labels", labels))
    return namings


def _oriented_by_nrrd(fields: Fields, axes: Sequence[int]) -> list[Orientation]:
    """Where the axes run by the space directions, in a right-handed space.

    ``axes``: numbers in the header of z, y and x. Empty where there are no directions in three
    dimensions.
    """
    space = str(fields.get("space", "")).strip().casefold()
    directions = fields.get("space directions")
    if directions is None:
        return []
    rows = np.asarray(directions, np.float64)[list(axes)]
    if rows.shape != (3, 3) or not np.isfinite(rows).all():
        return []
    # Where each axis of the file's own space runs in a right-handed one.
    words = SPACES.get(space, space).split("-")[:3]
    basis = [ANATOMICAL[word] for word in words if word in ANATOMICAL]
    if len(basis) != 3:
        basis = np.diag([1.0, 1.0, -1.0 if space == "3d-left-handed" else 1.0])
    source = f"the NRRD space directions ({space or 'no space written; a right-handed one'})"
    return [Orientation(source, rows @ np.asarray(basis))]


def _stated_by_nrrd(fields: Fields, axes: Sequence[int]) -> list[Stated]:
    """Voxel size along z, y, x: the lengths of the space directions, and the spacings.

    ``axes``: numbers in the header of z, y and x.
    """
    stated: list[Stated] = []
    directions = fields.get("space directions")
    if directions is not None:
        vectors = np.asarray(directions, np.float64)
        lengths = np.linalg.norm(vectors, axis=1).tolist()
        # A direction may mix the axes of space only if all of these have one unit.
        space_units = np.atleast_1d(fields.get("space units", ()))
        unit_names = {str(unit_name).strip('"') for unit_name in space_units}
        unit = unit_text = ""
        if len(unit_names) == 1:
            unit = unit_names.pop()
        elif not unit_names and "-" in str(fields.get("space", "")):
            unit = "mm"
            unit_text = " (no unit written; mm, as programs for anatomical spaces have it)"
        source = f"the NRRD space directions{unit_text}"
        stated.append(stated_in(source, lengths, [unit] * len(lengths), axes))
    spacings = fields.get("spacings")
    if spacings is not None:
        units = [*map(str, np.atleast_1d(fields.get("units", ())))]
        lengths = np.asarray(spacings, np.float64).tolist()
        stated.append(stated_in("the NRRD spacings", lengths, units, axes))
    return stated


def _meta_fields(head: bytes, path: Path) -> tuple[dict[str, str], int]:
    """Fields of the header of a MetaImage, by their names in small letters, and its length."""
    fields: dict[str, str] = {}
    header_bytes = 0
    for line in BytesIO(head):
        key, equals, field_text = map(str.strip, _text_of(line).partition("="))
        if key and not equals:
            break
        header_bytes += len(line)
        fields.setdefault(key.casefold(), field_text)
        if "elementdatafile" in fields:
            return fields, header_bytes
    raise FileError(
        f"{path.name} is no MetaImage: the line ElementDataFile is missing. Export it again."
    )


def _switched(field_text: str) -> bool:
    return field_text.casefold() in {"true", "t", "1"}


def _meta_header(head: bytes, path: Path) -> Header:
    """Header of a MetaImage, whose values lie behind it or in one other file.

    ``head``: the first bytes of the file, more than any header has.
    """
    fields, header_bytes = _meta_fields(head, path)
    axes = _meta_axes(fields, path)
    dtype = _type_of(fields.get("elementtype", ""), path)
    if not _switched(fields.get("binarydata", "True")):
        raise FileError(f"{path.name} has its values written as text. Save it with binary values.")
    data_name = fields["elementdatafile"]
    is_local = data_name.casefold() == "local"
    skip_text = fields.get("headersize", "0")
    if skip_text != "0" and (is_local or skip_text != "-1"):
        raise FileError(
            f"{path.name} skips {skip_text} bytes before its values (HeaderSize). Save it again"
            " without."
        )
    is_packed = _switched(fields.get("compresseddata", "False"))
    msb_text = fields.get("binarydatabyteordermsb", fields.get("elementbyteordermsb", "False"))
    data_file = path
    offset = header_bytes
    if not is_local:
        data_file = _data_file(data_name, path)
        offset = 0
    if skip_text == "-1" and not is_packed:
        offset = -1
    return Header(
        path=path,
        stated=_stated_by_meta(fields, axes, path),
        data=data_file,
        axes=axes,
        stored_dtype=dtype.newbyteorder(">" if _switched(msb_text) else "<"),
        offset=offset,
        packing="deflate" if is_packed else "",
        orientations=_oriented_by_meta(fields, axes.header_axes, path),
    )


def _meta_axes(fields: Mapping[str, str], path: Path) -> StoredAxes:
    """Axes of a MetaImage, which has no names for them."""
    size_text = fields.get("dimsize", "")
    dimension = fields.get("ndims")
    words = size_text.split()
    is_whole = all(re.fullmatch(r"[0-9]{1,15}", word) for word in words)
    if not is_whole or str(len(words)) != (dimension or ""):
        raise damaged(path, f"its sizes are {size_text[:40]!r}, its dimension is {dimension}")
    channels = fields.get("elementnumberofchannels", "1")
    contents_text = f"{channels} channels" if channels != "1" else ""
    return axes_of(tuple(map(int, words)), path, contents_text=contents_text)


def _stated_by_meta(fields: Mapping[str, str], axes: StoredAxes, path: Path) -> list[Stated]:
    """Voxel size along z, y, x: the spacing, and the size of an element."""
    unit = fields.get("distanceunits", "")
    stated: list[Stated] = []
    for key in ("ElementSpacing", "ElementSize"):
        words = fields.get(key.casefold(), "").split()
        if words:
            source = f"the MetaImage {key} ({unit or 'no unit written; mm, as ITK has it'})"
            with reading(path):
                lengths = [float(word) for word in words]
            units = [unit or "mm"] * len(lengths)
            stated.append(stated_in(source, lengths, units, axes.header_axes))
    return stated


def _oriented_by_meta(
    fields: Mapping[str, str], axes: Sequence[int], path: Path
) -> list[Orientation]:
    """Where the axes run by the matrix of a MetaImage, or by its letters where it has none.

    ``axes``: numbers in the header of z, y and x.
    """
    for key in ("TransformMatrix", "Rotation", "Orientation"):
        words = fields.get(key.casefold(), "").split()
        if words:
            with reading(path):
                matrix = np.array([*map(float, words)])
            n = round(len(words) ** 0.5)
            is_square = n * n == len(words) and n > max(axes)
            if not is_square or not np.isfinite(matrix).all():
                raise damaged(path, f"its {key} is {' '.join(words)[:60]!r}")
            # A row for each axis of the file: where it runs in space.
            rows = matrix.reshape(n, n)[list(axes)]
            if n != 3:  # of four dimensions, those along which none of the three runs are left out
                is_used = np.any(rows != 0, axis=0)
                rows = rows[:, is_used][:, :3]
            if rows.shape == (3, 3):
                return [Orientation(f"the {key}", rows)]
            return []
    letters = fields.get("anatomicalorientation", "").strip().upper()
    if len(letters) <= max(axes):
        return []
    words_by_axis = [META_LETTERS.get(letters[axis], "") for axis in axes]
    return orientation_by_words(f"the AnatomicalOrientation {letters}", words_by_axis)


def _read_meta(path: Path, where: Where) -> Array:
    """Read a part of a MetaImage; ``where`` is along its axes longer than 1, slowest first."""
    itk: Any = extra("SimpleITK", path)
    reader = itk.ImageFileReader()
    reader.SetImageIO("MetaImageIO")
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    # Axes of length 1 that were left out above lie before the others or after them; here they come
    # back.
    reversed_spans = reversed(where)
    spans = [next(reversed_spans) if n > 1 else slice(0, 1) for n in reader.GetSize()]
    reader.SetExtractIndex([span.start for span in spans])
    reader.SetExtractSize([span.stop - span.start for span in spans])
    image = itk.GetArrayFromImage(reader.Execute())
    values = np.asarray(image).reshape([span.stop - span.start for span in where])
    return values[tuple(slice(None, None, span.step) for span in where)]


BYTE_TYPES = ("uint8", "int8")
RAW_TYPES = (
    *BYTE_TYPES,
    "uint16",
    "int16",
    "uint32",
    "int32",
    "uint64",
    "int64",
    "float16",
    "float32",
    "float64",
)
KEYS = ("file", "shape", "dtype", "byte_order", "offset", "voxel_um")
EXAMPLE = (
    'with lines such as: shape = [z, y, x], dtype = "uint16", byte_order = "little", voxel_um ='
    " 1.65"
)


def _raw_header(path: Path) -> Header:
    """Header of raw values in a TOML file; either of the two files is given.

    The header of ``scan.raw`` is ``scan.raw.toml``.
    """
    header_file = path
    if path.suffix.lower() != ".toml":
        header_file = path.with_name(path.name + ".toml")
    if not header_file.is_file() and header_file != path:
        raise _no_header(path, header_file)
    if size_of_file(header_file) > 100_000:
        raise FileError(
            f"{header_file.name} is larger than 100 kB and no header. Write one {EXAMPLE}."
        )
    fields = toml_tables(header_file.name, read_text(header_file, what="header"))
    data_name = str(fields.get("file", header_file.name[: -len(".toml")]))
    data_file = referenced_file(header_file.parent, data_name, header_file)
    unknown_texts = [f"unknown key {key!r}" for key in fields if key not in KEYS]
    faults = [*unknown_texts, *_raw_faults(fields)]
    if faults:
        raise FileError(f"{header_file.name}: {'; '.join(faults)}. Correct the header, {EXAMPLE}.")
    stated = Stated("the TOML header", NO_SIZE, "it has no voxel_um")
    voxel_um = fields.get("voxel_um")
    if voxel_um is not None:
        stated = Stated("the TOML header", tuple(map(float, _per_axis(voxel_um))))
    dtype = np.dtype(fields["dtype"])
    if dtype.itemsize > 1:
        dtype = dtype.newbyteorder(fields["byte_order"])
    order = (0, 1, 2)
    return Header(
        path=header_file,
        data=data_file,
        axes=StoredAxes(tuple(fields["shape"]), order, order, ()),
        offset=fields.get("offset", 0),
        stored_dtype=dtype,
        stated=[stated],
    )


def _no_header(path: Path, header_file: Path) -> FileError:
    """Give the error for raw values alone, which may be those of another format."""
    # Here, so that a good file waits for no table of other files.
    from planish.io.other_files import check_kind, description_of

    check_kind(path, takes_text=True)
    description = description_of(path)
    source_text = f" Its numbers stand in {description.name}." if description else ""
    return FileError(
        f"{path.name} has raw values and no header. Write {header_file.name} beside it,"
        f" {EXAMPLE}.{source_text}"
    )


def _raw_faults(fields: Fields) -> Iterator[str]:
    """Faults of a TOML header of raw values, in words."""
    shape, dtype, byte_order = map(fields.get, ("shape", "dtype", "byte_order"))
    if not _are_three(shape, int):
        yield f"shape is {shape!r}, needed are three whole numbers [z, y, x]"
    if dtype not in RAW_TYPES:
        yield f"dtype is {dtype!r}, needed is one of {', '.join(RAW_TYPES)}"
    elif dtype not in BYTE_TYPES and byte_order not in ("little", "big"):
        yield f'byte_order is {byte_order!r}, needed is "little" or "big"'
    offset = fields.get("offset", 0)
    if type(offset) is not int or offset < 0:
        yield f"offset is {offset!r}, needed is a number of bytes"
    voxel_um = fields.get("voxel_um", 1)
    if not _are_three(_per_axis(voxel_um), int, float):
        yield f"voxel_um is {voxel_um!r}, needed is a number or [z, y, x], in um"
    if not isinstance(fields.get("file", ""), str):
        yield "file is no name"


def _per_axis(voxel_um: Any) -> list[Any]:
    if isinstance(voxel_um, list):
        return voxel_um
    return [voxel_um] * 3


def _are_three(numbers: Any, *types: type) -> bool:
    """True for a list of three numbers above 0 of these types."""
    if not isinstance(numbers, list) or len(numbers) != 3:
        return False
    return all(type(n) in types and n > 0 for n in numbers)
