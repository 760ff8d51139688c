"""Read volumes behind a header of text: NRRD, MetaImage and TOML.

Raw values are mapped, compressed ones unpacked at once.

Compressed values of a MetaImage that do not fit into the memory are read in parts by SimpleITK.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.core.parameter_faults import toml_tables
from planish.core.tables import read_text
from planish.io.axes import AxisNames
from planish.io.formats import LoadedVolume, Place, extra, referenced_file
from planish.io.guard import head_of, memory_limit, reading, size_of_file
from planish.io.headed import Header, StoredAxes, axes_of, unpacked_parts, values_behind
from planish.io.lazy import FileArray, Values
from planish.io.orientation import ANATOMICAL, Orientation, orientation_by_words
from planish.io.sizes import Stated, stated_in
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
    suffix = place.path.suffix.lower()
    readers = {
        ".nrrd": _nrrd_header,
        ".nhdr": _nrrd_header,
        ".mha": _meta_header,
        ".mhd": _meta_header,
    }
    header = readers[suffix](head_of(path, 2**20), path) if suffix in readers else _raw_header(path)
    values: Values = values_behind(header)
    too_large = header.needed_bytes > memory_limit(memory_bytes)
    if header.packing and suffix in (".mha", ".mhd") and too_large:
        # SimpleITK reads on behind the end of values that are shorter than declared.
        for _ in unpacked_parts(header):
            pass
        extra("SimpleITK", path)
        values = FileArray(
            path, header.shape, header.stored_dtype.newbyteorder("="), partial(_read_meta, path)
        )
        values.piece_bytes = values.nbytes // header.shape[0]
    return header.volume(values)


def _type_of(word: str, path: Path) -> np.dtype[Any]:
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


def _nrrd_header(head: bytes, path: Path) -> Header:
    import nrrd  # pyright: ignore[reportMissingTypeStubs]

    if not head.startswith(b"NRRD"):
        raise FileError(f"{path.name} is no NRRD file. Check its name, or export it again.")
    header_lines: list[str] = []
    header_bytes = 0
    for line in BytesIO(head):
        # pynrrd would drop what is not ASCII, as in file names.
        header_lines.append(_text_of(line))
        header_bytes += len(line)
        is_list = re.fullmatch(rb"data ?file:=? *LIST\b.*", line.strip(), re.IGNORECASE)
        # Names of files follow a list of them to the end.
        if is_list or not line.strip():
            break
    with reading(path):
        fields: Mapping[str, Any] = nrrd.read_header(header_lines)
        extents = tuple(int(n) for n in np.atleast_1d(fields.get("sizes", ())))
        line_skip, byte_skip = (
            int(fields.get(f"{u} skip", fields.get(f"{u}skip", 0))) for u in ("line", "byte")
        )
    kinds = fields.get("kinds") or [""] * len(extents)
    if not extents or len(extents) != fields.get("dimension") or len(kinds) != len(extents):
        raise damaged(
            path, f"its sizes are {fields.get('sizes')}, its dimension is {fields.get('dimension')}"
        )
    sample_texts = [
        f"{n} of kind {kind!r}"
        for n, kind in zip(extents, kinds, strict=True)
        if n > 1 and kind not in (*SPATIAL_KINDS, "time")
    ]
    contents_text = f"{' and '.join(sample_texts)} in each voxel" if sample_texts else ""
    axes = axes_of(extents, path, _names_by_nrrd(fields, kinds), contents_text=contents_text)
    dtype = _type_of(str(fields.get("type", "")).strip(), path)
    endian = fields.get("endian")
    if dtype.itemsize > 1 and endian not in ("little", "big"):
        raise damaged(path, "its header does not state the byte order (endian)")
    encoding = str(fields.get("encoding", "")).casefold()
    if line_skip != 0 or byte_skip < -1 or (byte_skip and encoding != "raw"):
        raise FileError(
            f"{path.name} skips lines or packed bytes before its values. Save it again without."
        )
    if encoding not in PACKINGS:
        raise FileError(
            f"{path.name} has the encoding {encoding!r}. Save it with the encoding raw or gzip."
        )
    data_name = fields.get("data file", fields.get("datafile"))
    return Header(
        path=path,
        data=path if data_name is None else _data_file(str(data_name), path),
        axes=axes,
        stored_dtype=dtype.newbyteorder(">" if endian == "big" else "<"),
        offset=-1 if byte_skip == -1 else byte_skip + (header_bytes if data_name is None else 0),
        packing=PACKINGS[encoding],
        stated=_stated_by_nrrd(fields, axes.header_axes),
        orientations=_oriented_by_nrrd(fields, axes.header_axes),
    )


def _names_by_nrrd(fields: Mapping[str, Any], kinds: Sequence[str]) -> list[AxisNames]:
    """Names of the axes by their labels, and by the kind of an axis of time; fastest axis first."""
    kind_names = tuple("time" if kind == "time" else "" for kind in kinds)
    labels = tuple(str(label) for label in fields.get("labels") or [""] * len(kinds))
    namings = [AxisNames("its kinds", kind_names), AxisNames("its labels", labels)]
    return [naming for naming in namings if len(naming.names) == len(kinds) and any(naming.names)]


def _oriented_by_nrrd(fields: Mapping[str, Any], axes: Sequence[int]) -> list[Orientation]:
    """Where the axes run by the space directions, in a right-handed space."""
    space = str(fields.get("space", "")).strip().casefold()
    directions = fields.get("space directions")
    rows = [None if directions is None else directions[axis] for axis in axes]
    if any(row is None or len(row) != 3 or not np.isfinite(row).all() for row in rows):
        return []
    words = SPACES.get(space, space).split("-")
    basis = np.eye(3)
    if all(word in ANATOMICAL for word in words[:3]) and len(words) >= 3:
        basis = np.array([ANATOMICAL[word] for word in words[:3]])
    elif space == "3d-left-handed":
        basis = np.diag([1.0, 1.0, -1.0])
    source = f"the NRRD space directions ({space or 'no space written; a right-handed one'})"
    return [Orientation(source, np.array(rows, np.float64) @ basis)]


def _stated_by_nrrd(fields: Mapping[str, Any], axes: Sequence[int]) -> list[Stated]:
    """Voxel size along z, y, x: the lengths of the space directions, and the spacings."""
    stated: list[Stated] = []
    directions = fields.get("space directions")
    spacings = fields.get("spacings")
    if directions is not None:
        lengths = [
            None if v is None else float(np.linalg.norm(np.asarray(v, float))) for v in directions
        ]
        # A direction may mix the axes of space only if all of these have one unit.
        unit_names = {str(u).strip('"') for u in np.atleast_1d(fields.get("space units", ()))}
        unit = unit_text = ""
        if len(unit_names) == 1:
            unit = unit_names.pop()
        elif not unit_names and "-" in str(fields.get("space", "")):
            unit = "mm"
            unit_text = " (no unit written; mm, as programs for anatomical spaces have it)"
        stated.append(
            stated_in(f"the NRRD space directions{unit_text}", lengths, [unit] * len(lengths), axes)
        )
    if spacings is not None:
        units = [str(u) for u in np.atleast_1d(fields.get("units", [""] * len(spacings)))]
        stated.append(stated_in("the NRRD spacings", [float(v) for v in spacings], units, axes))
    return stated


def _meta_header(head: bytes, path: Path) -> Header:  # noqa: C901
    fields: dict[str, str] = {}
    header_bytes = 0
    for line in BytesIO(head):
        key, equals, field_text = map(str.strip, _text_of(line).partition("="))
        if key and not equals:
            break
        header_bytes += len(line)
        fields.setdefault(key.casefold(), field_text)
        if "elementdatafile" in fields:
            break
    data_name = fields.get("elementdatafile")
    if data_name is None:
        raise FileError(
            f"{path.name} is no MetaImage: the line ElementDataFile is missing. Export it again."
        )

    def switched(key: str, default: str) -> bool:
        return fields.get(key, default).casefold() in {"true", "t", "1"}

    words = fields.get("dimsize", "").split()
    is_whole = all(word.isascii() and word.isdecimal() and len(word) < 16 for word in words)
    if not is_whole or str(len(words)) != fields.get("ndims", ""):
        raise damaged(
            path,
            f"its sizes are {fields.get('dimsize', '')[:40]!r}, its dimension is"
            f" {fields.get('ndims')}",
        )
    extents = tuple(int(word) for word in words)
    channels = fields.get("elementnumberofchannels", "1")
    contents_text = f"{channels} channels" if channels != "1" else ""
    axes = axes_of(extents, path, contents_text=contents_text)
    dtype = _type_of(fields.get("elementtype", ""), path)
    if not switched("binarydata", "True"):
        raise FileError(f"{path.name} has its values written as text. Save it with binary values.")
    is_local = data_name.casefold() == "local"
    skip_text = fields.get("headersize", "0")
    if skip_text != "0" and (is_local or skip_text != "-1"):
        raise FileError(
            f"{path.name} skips {skip_text} bytes before its values (HeaderSize). Save it again"
            " without."
        )
    is_packed = switched("compresseddata", "False")
    is_big_endian = switched("binarydatabyteordermsb", fields.get("elementbyteordermsb", "False"))
    offset = header_bytes if is_local else 0
    if skip_text == "-1" and not is_packed:
        offset = -1
    unit = fields.get("distanceunits", "")
    stated: list[Stated] = []
    for key in ("ElementSpacing", "ElementSize"):
        if words := fields.get(key.casefold(), "").split():
            source = f"the MetaImage {key} ({unit or 'no unit written; mm, as ITK has it'})"
            with reading(path):
                stated.append(
                    stated_in(
                        source,
                        [float(w) for w in words],
                        [unit or "mm"] * len(extents),
                        axes.header_axes,
                    )
                )
    return Header(
        path=path,
        data=path if is_local else _data_file(data_name, path),
        axes=axes,
        stored_dtype=dtype.newbyteorder(">" if is_big_endian else "<"),
        offset=offset,
        packing="deflate" if is_packed else "",
        stated=stated,
        orientations=_oriented_by_meta(fields, axes.header_axes, path),
    )


def _oriented_by_meta(
    fields: Mapping[str, str], axes: Sequence[int], path: Path
) -> list[Orientation]:
    """Where the axes run by the matrix of a MetaImage, or by its letters where it has none."""
    for key in ("TransformMatrix", "Rotation", "Orientation"):
        words = fields.get(key.casefold(), "").split()
        n = round(len(words) ** 0.5)
        if not words:
            continue
        with reading(path):
            matrix = np.array([float(word) for word in words])
        if n * n != len(words) or n <= max(axes) or not np.isfinite(matrix).all():
            raise damaged(path, f"its {key} is {' '.join(words)[:60]!r}")
        # A row for each axis of the file: where it runs in space.
        rows = matrix.reshape(n, n)[list(axes)]
        across = [k for k in range(n) if n == 3 or np.any(rows[:, k] != 0)][:3]
        directions = rows[:, across]
        return [Orientation(f"the {key}", directions)] if directions.shape == (3, 3) else []
    letters = fields.get("anatomicalorientation", "").strip().upper()
    words_by_axis = [META_LETTERS.get(letter, "") for letter in letters]
    if len(letters) <= max(axes):
        return []
    found = orientation_by_words(
        f"the AnatomicalOrientation {letters}", [words_by_axis[axis] for axis in axes]
    )
    return [] if found is None else [found]


def _read_meta(path: Path, where: Where) -> NDArray[Any]:
    itk: Any = extra("SimpleITK", path)
    reader = itk.ImageFileReader()
    reader.SetImageIO("MetaImageIO")
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    # Axes of length 1 that were left out above lie before the others or after them; here they come
    # back.
    extents = [int(n) for n in reader.GetSize()]
    reversed_spans = iter(reversed(where))
    spans = [next(reversed_spans) if n > 1 else slice(0, 1) for n in extents]
    reader.SetExtractIndex([span.start for span in spans])
    reader.SetExtractSize([span.stop - span.start for span in spans])
    values = np.asarray(itk.GetArrayFromImage(reader.Execute())).reshape(
        [s.stop - s.start for s in where]
    )
    return values[tuple(slice(None, None, s.step) for s in where)]


RAW_TYPES = (
    "uint8",
    "int8",
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
    """Header of raw values in a TOML file; either of the two files is given."""
    header_file = path if path.suffix.lower() == ".toml" else path.with_name(path.name + ".toml")
    if not header_file.is_file() and header_file != path:
        # Here, so that a good file waits for no table of other files.
        from planish.io.other_files import check_kind, description_of

        check_kind(path, takes_text=True)
        description = description_of(path)
        source_text = f" Its numbers stand in {description.name}." if description else ""
        raise FileError(
            f"{path.name} has raw values and no header. Write {header_file.name} beside it,"
            f" {EXAMPLE}.{source_text}"
        )
    if size_of_file(header_file) > 100_000:
        raise FileError(
            f"{header_file.name} is larger than 100 kB and no header. Write one {EXAMPLE}."
        )
    fields = toml_tables(header_file.name, read_text(header_file, what="header"))
    data_name = str(fields.get("file", header_file.name[: -len(".toml")]))
    data_file = referenced_file(header_file.parent, data_name, header_file)
    faults = [f"unknown key {key!r}" for key in fields if key not in KEYS]
    shape, dtype, byte_order = (fields.get(key) for key in ("shape", "dtype", "byte_order"))
    offset = fields.get("offset", 0)
    voxel_um = fields.get("voxel_um")
    if not (
        isinstance(shape, list) and len(shape) == 3 and all(type(n) is int and n > 0 for n in shape)
    ):
        faults.append(f"shape is {shape!r}, needed are three whole numbers [z, y, x]")
    if dtype not in RAW_TYPES:
        faults.append(f"dtype is {dtype!r}, needed is one of {', '.join(RAW_TYPES)}")
    elif np.dtype(dtype).itemsize > 1 and byte_order not in ("little", "big"):
        faults.append(f'byte_order is {byte_order!r}, needed is "little" or "big"')
    if type(offset) is not int or offset < 0:
        faults.append(f"offset is {offset!r}, needed is a number of bytes")
    voxel_sizes: list[Any] = voxel_um if isinstance(voxel_um, list) else [voxel_um] * 3
    are_numbers = all(type(v) in (int, float) and v > 0 for v in voxel_sizes)
    if voxel_um is not None and not (len(voxel_sizes) == 3 and are_numbers):
        faults.append(f"voxel_um is {voxel_um!r}, needed is a number or [z, y, x], in um")
    if not isinstance(fields.get("file", ""), str):
        faults.append("file is no name")
    if faults:
        raise FileError(f"{header_file.name}: {'; '.join(faults)}. Correct the header, {EXAMPLE}.")
    stated_um = tuple(None if v is None else float(v) for v in voxel_sizes)
    n_z, n_y, n_x = (int(n) for n in shape or ())
    order = (0, 1, 2)
    return Header(
        path=header_file,
        data=data_file,
        axes=StoredAxes((n_z, n_y, n_x), order, order, ()),
        offset=int(offset),
        stored_dtype=np.dtype(str(dtype)).newbyteorder(">" if byte_order == "big" else "<"),
        stated=[
            Stated("the TOML header", stated_um, "it has no voxel_um" if None in stated_um else "")
        ],
    )
