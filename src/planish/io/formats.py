"""Give the table of formats: which module reads which file.

Also the part of a path that chooses in a file, and what a reader gives.

A module has the function ``load(place, channel, memory_bytes) -> LoadedVolume``. ``channel`` is
None or one of :data:`CHANNELS`; ``memory_bytes`` is the largest decoded size, None for three
quarters of the memory available. It raises FileError for a file that is damaged or of another
format, VolumeError for what is not one grey volume, SizeError, InputError for a channel that is not
there, and ResourceError for what does not fit into the memory.
"""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import FunctionType, MappingProxyType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from planish.core.errors import FileError, InputError, VolumeError
from planish.core.plugins import Plugin, faults_named, find_plugin
from planish.core.reflectance import LUMINANCE
from planish.core.text import printable
from planish.core.typing import Array, DType, Fields, Shape, Texts
from planish.io.guard import quiet
from planish.io.lazy import Values
from planish.io.orientation import Orientation
from planish.io.sizes import Stated
from planish.io.tiff import is_tiff, size_words

ADVICE = "Save one grey volume alone, as a stack of slices."
COLOURS = {"red": 0, "green": 1, "blue": 2}
CHANNELS = ("luminance", *COLOURS)


Starts = Sequence[tuple[int, bytes]]  # each a byte of a file and what stands from there on


class VolumeFormat(NamedTuple):
    """A format of volumes or pictures."""

    name: str
    module: str  # of this package
    suffixes: Texts = ()  # ends of the names of its files or folders, in small letters
    # Names of files that mark a folder of this format, whatever its own name.
    marker_files: Texts = ()
    has_parts: bool = False  # whether ``path:part`` chooses one volume of several
    starts: Starts = ()  # by which its files are known; none where they may begin with any bytes
    plugin: Plugin | None = None  # of another package, which reads it


HEAD_BYTES = 512  # the longest header by which a kind of file is known ends within them
HDF5_START = (0, b"\x89HDF\r\n\x1a\n")
FORMATS = (  # The first line that fits is taken, so longer suffixes stand before shorter ones.
    VolumeFormat("raw with a header", "header_volume", (".toml", ".raw", ".vol")),
    VolumeFormat(
        "OME-Zarr", "zarr_volume", (".zarr",), ("zarr.json", ".zgroup", ".zarray"), has_parts=True
    ),
    VolumeFormat("NRRD", "header_volume", (".nrrd", ".nhdr"), starts=[(0, b"NRRD0")]),
    VolumeFormat("MetaImage", "header_volume", (".mha", ".mhd"), starts=[(0, b"ObjectType")]),
    VolumeFormat(
        "HDF5 or NeXus",
        "hdf5_volume",
        (".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".nx"),
        has_parts=True,
        starts=[HDF5_START],
    ),
    VolumeFormat(
        "NIfTI",
        "binary_volume",
        (".nii", ".nii.gz"),
        starts=[(344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0")],
    ),
    VolumeFormat(
        "MRC",
        "binary_volume",
        (".mrc", ".rec", ".st", ".ali", ".map", ".mrc.gz", ".mrc.bz2"),
        starts=[(208, b"MAP ")],
    ),
    VolumeFormat(
        "MATLAB",
        "matlab_volume",
        (".mat",),
        has_parts=True,
        starts=[(0, b"MATLAB 5.0 MAT"), (0, b"MATLAB 7.3 MAT"), HDF5_START],
    ),
)
_PART_SUFFIXES = tuple(suffix for f in FORMATS if f.has_parts for suffix in f.suffixes)
TIFF = VolumeFormat("TIFF", "tiff_volume", (".tif", ".tiff", ".btf", ".tf8"))
SLICES = VolumeFormat("folder of slices", "slice_volume")
PICTURES = (
    VolumeFormat("PNG", "picture", (".png",), starts=[(0, b"\x89PNG\r\n\x1a\n")]),
    VolumeFormat("JPEG", "picture", (".jpg", ".jpeg"), starts=[(0, b"\xff\xd8\xff")]),
    VolumeFormat("BMP", "picture", (".bmp",), starts=[(0, b"BM")]),
)
# Files with other extensions (logs, licences, thumbnails of the system) are no slices.
PICTURE_SUFFIXES = {".tif": "TIFF", ".tiff": "TIFF"} | {
    suffix: picture.name for picture in PICTURES for suffix in picture.suffixes
}


class Place(NamedTuple):
    """A file or folder, and which of its volumes is meant: what stands behind the colon."""

    path: Path
    part: str = ""

    @property
    def name(self) -> str:
        """Name of the file, and the part behind it: ``scan.h5:/entry/data``."""
        return f"{self.path.name}:{self.part}" if self.part else self.path.name

    @property
    def stem(self) -> str:
        """Name of the file without its ending, and the part behind it: ``scan-entry-data``."""
        return "-".join([self.path.stem, *filter(None, self.part.split("/"))])


def find_place(path: str | Path) -> Place:
    """Split ``file.h5:/entry/data`` at its colon.

    A name that exists as it stands is never split, nor is the letter of a Windows drive.

    Examples
    --------
    >>> place = find_place("scan.h5:/entry/data")
    >>> place.path.name, place.part
    ('scan.h5', '/entry/data')
    >>> find_place("C:/scan.h5").part
    ''
    """
    text = str(path)
    if printable(text) != text:
        raise FileError(
            f"The name {printable(text)} holds what is no text. Results hold names: give it"
            " another."
        )
    if exists(Path(text)):
        return Place(Path(text))
    path_text = text.rpartition(":")[0]
    while path_text and not (len(path_text) == 1 and path_text.isalpha()):
        if exists(Path(path_text)) or path_text.lower().endswith(_PART_SUFFIXES):
            part = text[len(path_text) + 1 :]
            return Place(Path(path_text), part.replace(os.sep, "/"))
        path_text = path_text.rpartition(":")[0]
    return Place(Path(text))


def exists(path: Path) -> bool:
    """True if something has this name; names that no system allows have nothing."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def path_words(part: str) -> list[str]:
    """Names along a path within a file or store."""
    return [name for name in part.split("/") if name not in ("", ".")]


def format_of(place: Place) -> VolumeFormat:
    """Find the format by the name, or for folders by what lies in them.

    A file that none of them has may be of a format that another package reads. Everything else is
    an image file.
    """
    file_format = _format_of(place.path)
    if place.part and not file_format.has_parts:
        raise FileError(
            f"{place.path.name} is {file_format.name}, in which {place.part!r} chooses nothing."
            f" Leave out ':{place.part}'."
        )
    return file_format


def _format_of(path: Path) -> VolumeFormat:
    """Format by the end of a name, then by the files of a folder, then that of a plugin."""
    is_folder = path.is_dir()
    for file_format in FORMATS:
        is_of_kind = is_folder == bool(file_format.marker_files)
        if is_of_kind and path.name.lower().endswith(file_format.suffixes):
            return file_format
    if is_folder:
        for file_format in FORMATS:
            if any((path / marker).is_file() for marker in file_format.marker_files):
                return file_format
        return SLICES
    ending = path.suffix.lower()
    if ending not in (*TIFF.suffixes, *PICTURE_SUFFIXES, ""):
        plugin = find_plugin("format", ending[1:])
        if plugin is not None:
            return VolumeFormat(plugin.name, plugin.package, (ending,), plugin=plugin)
    return TIFF


def format_by_bytes(head: bytes) -> VolumeFormat | None:
    """Find the format to which the first bytes of a file belong."""
    if is_tiff(head):
        return TIFF
    return next((f for f in (*PICTURES, *FORMATS) if begins(head, f.starts)), None)


def begins(head: bytes, starts: Starts) -> bool:
    """True if one of some marks stands at its place in the first bytes of a file."""
    return any(head.startswith(mark, byte) for byte, mark in starts)


def is_slice_name(name: str) -> bool:
    """True if a file name is that of a visible image file."""
    return not name.startswith(".") and Path(name).suffix.lower() in PICTURE_SUFFIXES


def pictures_in(folder: Path) -> list[Path]:
    """Visible image files of a folder, sorted by name."""
    return sorted(p for p in folder.iterdir() if is_slice_name(p.name) and p.is_file())


def loader(file_format: VolumeFormat) -> Callable[..., LoadedVolume]:
    """Import the module of a format and return its function ``load``."""
    plugin = file_format.plugin
    if plugin is None:
        module: Any = importlib.import_module(f"planish.io.{file_format.module}")
        return module.load
    load: Callable[..., LoadedVolume] = plugin.load(FunctionType)

    def named_load(*arguments: object) -> LoadedVolume:
        with faults_named(str(plugin), plugin.entry.module):
            return load(*arguments)

    return named_load


def extra(module: str, path: Path) -> ModuleType:
    """Import a library that only some installations have."""
    try:
        with quiet:
            return importlib.import_module(module)
    except ImportError as error:
        raise FileError(
            f"{path.name} needs the library {module}, which is not installed. Run: pip install"
            ' "planish[formats]"'
        ) from error


class LoadedVolume(NamedTuple):
    """Values of a volume and what its files say about them."""

    values: Values  # dims (z, y, x)
    stated: Sequence[Stated]  # voxel size along z, y, x in the metadata
    files: Sequence[Path]  # all that it is made of
    bits: int = 64  # of a whole number, where the file uses fewer than its type has
    attrs: Fields = MappingProxyType({})  # further ones of the volume, plain values
    doubts: Sequence[str] = ()  # sentences about what looks wrong in the files
    notes: Sequence[str] = ()  # sentences about what was assumed to read them
    orientations: Sequence[Orientation] = ()  # as each kind of metadata states it

    @property
    def file_bytes(self) -> int:
        """Size of all files."""
        return sum(file.stat().st_size for file in dict.fromkeys(self.files))


def full_scale(dtype: DType, bits: int) -> int | None:
    """Largest value that can be stored, None for floating point."""
    if dtype.kind == "f":
        return None
    if dtype.kind == "b":
        return 1
    return min(int(np.iinfo(dtype).max), 2**bits - 1)


def check_type(dtype: DType, path: Path) -> None:
    """Refuse values that are no grey values."""
    if dtype.kind == "b":
        raise VolumeError(
            f"{path.name} has black and white only (1 bit). Give the grey values it was made from."
        )
    if dtype.kind not in "uif" or dtype.itemsize > 8:
        raise VolumeError(
            f"{path.name} has {dtype} values. Needed are integers or real numbers up to 64 bits."
        )


def referenced_file(
    folder: Path, name: str, path: Path, *, base_folder: Path | None = None
) -> Path:
    """Path of a file that another file names, which has to lie in the same folder or below."""
    target = (base_folder or folder) / name.replace("\\", "/")
    try:
        is_within = "\0" not in name and target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        is_within = False
    if not is_within:
        raise FileError(
            f"{path.name} takes data from {name!r}, outside its folder, which planish does not"
            " open. Put the files into one folder and name them without a path."
        )
    if not target.is_file():
        raise FileError(
            f"{path.name} takes data from {name!r}, which does not exist. Put it beside"
            f" {path.name}, and name it there without a path."
        )
    return target


ListedVolume = tuple[str, Shape, str]  # name, shape and type of a volume in a file


def describe_volumes(volumes: Sequence[ListedVolume], name: str) -> str:
    """List the volumes (name, shape, type) of a file, and say how one is chosen."""
    if not volumes:
        return ADVICE
    volumes_text = ", ".join(
        f"{volume} ({size_words(shape)} {dtype})" for volume, shape, dtype in volumes[:8]
    )
    more_text = f" and {len(volumes) - 8} more" if len(volumes) > 8 else ""
    return f"Its volumes are {volumes_text}{more_text}: choose one as {name}:{volumes[0][0]}."


def only_volume(volumes: Sequence[ListedVolume], name: str) -> str:
    """Name of the only volume of a file."""
    if len(volumes) != 1:
        count_text = f"{len(volumes)} volumes" if volumes else "no volume"
        raise VolumeError(f"{name} holds {count_text}. {describe_volumes(volumes, name)}")
    return volumes[0][0]


def check_channel(channel: str | None) -> str | None:
    """Return the name of a channel in small letters."""
    word = None if channel is None else channel.strip().casefold()
    if word not in (None, *CHANNELS):
        raise InputError(
            f"{channel!r} is no channel of a volume. Choose {', '.join(CHANNELS)} with"
            " `volume_channel`."
        )
    return word


def grey_of(colour: Array, *, channel: str | None) -> Array:
    """Turn the last axis, red, green and blue, into grey.

    Luminance, where none is chosen, is rounded in integers.
    """
    if channel not in (None, "luminance"):
        return colour[..., COLOURS[channel]]
    # In double precision 16-bit values come out exact, so that grey stored as colour stays what it
    # was.
    grey = colour[..., :3].astype(np.float64) @ np.array(LUMINANCE)
    if colour.dtype.kind in "ui":
        grey = np.rint(grey)
    return grey.astype(colour.dtype)


def colour_attrs(channel: str | None, path: Path, *, in_colour: bool) -> dict[str, str]:
    """Attributes of a volume whose files are in colour.

    A choice of colours is refused where they are not.
    """
    if not in_colour:
        if channel not in (None, "luminance"):
            raise InputError(
                f"{path.name} is grey, so it has no {channel}. Leave `volume_channel` out."
            )
        return {}
    choice_text = f"the channel chosen is {channel}"
    if channel is None:
        choice_text = "no channel was chosen, so luminance is"
    return {"channel": channel or "luminance", "colour": f"The files are in colour; {choice_text}."}


def check_chunks(
    positions: Iterable[Shape],
    shape: Shape,
    chunk: Shape,
    *,
    name: str,
) -> Texts:
    """Compare the chunks of an array with those it should have.

    Writers leave out chunks that hold nothing but the fill value, so a few that are missing may be
    the air around a sample. A whole layer of the array without any is a copy that was cut off, or a
    wrong shape.

    ``positions``: of the chunks that are stored, counted in chunks along each axis; ``shape`` of
    the array and of one ``chunk``, in values.
    """
    grid = tuple(-(-n // c) for n, c in zip(shape, chunk, strict=True))
    expected = [*map(range, grid)]
    # Chunks outside of it are left over by a larger array of this name.
    stored = [
        p for p in positions if len(p) == len(grid) and all(map(range.__contains__, expected, p))
    ]
    total = math.prod(grid)
    loss = f"{total - len(stored)} of its {total} chunks are not stored"
    names = "tczyx"[-len(grid) :] if len(grid) <= 5 else range(len(grid))
    for axis, n in enumerate(grid):
        missing_indices = set(range(n)) - {position[axis] for position in stored}
        if missing_indices:
            c = chunk[axis]
            first = c * min(missing_indices)
            raise FileError(
                f"{name} has no values for {names[axis]} {first} to"
                f" {min(first + c, shape[axis]) - 1}: {loss}. It is cut off, or its shape is"
                " wrong: copy or export it again."
            )
    if len(stored) == total:
        return ()
    return (f"{loss} and read as one constant: the file does not say whether something is lost.",)
