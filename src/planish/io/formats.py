"""Which module reads which file: the one table, and the part of a path that chooses inside a file.

A format is one line here and one module with the function
``load(place, channel, memory_bytes) -> LoadedVolume``. ``channel`` is None or one of
:data:`planish.io.colour.CHANNELS`, for formats in colour; ``memory_bytes`` is the largest decoded size, three quarters
of the memory available where it is None. Values that stay in their file are given unread. It raises FileError for a
file that is damaged or of another format, VolumeError for what is not one grey volume, SizeError, InputError for a
channel that is not there, and ResourceError for what does not fit into the memory.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from planish.core.errors import FileError
from planish.io.guard import quiet
from planish.io.loaded import LoadedVolume


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format of volumes.

    Attributes
    ----------
    name, module : str
        The module is one of this package.
    suffixes : tuple of str
        Ends of the names of its files or folders, in small letters.
    members : tuple of str
        Names of files that mark a folder of this format, whatever its own name.
    parts : bool
        Whether ``path:part`` chooses one volume of several.
    """

    name: str
    module: str
    suffixes: tuple[str, ...]
    members: tuple[str, ...] = ()
    parts: bool = False


ZARR_MEMBERS = ("zarr.json", ".zgroup", ".zarray")
HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".nx")

# The first line that fits is taken, so longer suffixes stand before shorter ones.
FORMATS = (
    Format(name="raw with a header", module="raw_volume", suffixes=(".toml", ".raw", ".vol")),
    Format(name="OME-Zarr", module="zarr_volume", suffixes=(".zarr",), members=ZARR_MEMBERS, parts=True),
    Format(name="NRRD", module="header_volume", suffixes=(".nrrd", ".nhdr")),
    Format(name="MetaImage", module="header_volume", suffixes=(".mha", ".mhd")),
    Format(name="HDF5 or NeXus", module="hdf5_volume", suffixes=HDF5_SUFFIXES, parts=True),
    Format(name="MATLAB", module="matlab_volume", suffixes=(".mat",), parts=True),
)
TIFF = Format(name="TIFF", module="tiff_volume", suffixes=(".tif", ".tiff", ".btf", ".tf8"))
SLICES = Format(name="folder of slices", module="slice_volume", suffixes=())


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A file or folder, and which of its volumes is meant: what stands behind the colon."""

    path: Path
    part: str = ""


def find_place(path: str | Path) -> Place:
    """Split ``file.h5:/entry/data`` at its colon.

    A name that exists as it stands is never split, nor is the letter of a Windows drive.

    Parameters
    ----------
    path : path

    Returns
    -------
    Place

    Examples
    --------
    >>> place = find_place("scan.h5:/entry/data")
    >>> place.path.name, place.part
    ('scan.h5', '/entry/data')
    >>> find_place("C:/scan.h5").part
    ''
    """
    text = str(path)
    if not exists(Path(text)):
        for at in range(len(text) - 1, 0, -1):
            front = text[:at]
            if text[at] != ":" or (at == 1 and front.isalpha()):
                continue
            if exists(Path(front)) or any(front.lower().endswith(s) for f in FORMATS if f.parts for s in f.suffixes):
                return Place(path=Path(front), part=text[at + 1 :])
    return Place(path=Path(text))


def exists(path: Path) -> bool:
    """Whether something has this name; names that no system allows have nothing."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def format_of(place: Place) -> Format:
    """Find the format by the name, or for folders by what lies in them; everything else is an image file."""
    path = place.path
    name = path.name.lower()
    found = next((f for f in FORMATS if name.endswith(f.suffixes) and path.is_dir() == bool(f.members)), None)
    if path.is_dir():
        found = found or next((f for f in FORMATS if any((path / m).is_file() for m in f.members)), SLICES)
    found = found or TIFF
    if place.part and not found.parts:
        raise FileError(
            f"{path.name} is {found.name}, in which {place.part!r} chooses nothing. Leave out ':{place.part}'."
        )
    return found


def loader(found: Format) -> Callable[..., LoadedVolume]:
    """Import the module of a format and return its function ``load``."""
    module: Any = importlib.import_module(f"planish.io.{found.module}")
    return module.load


def extra(module: str, path: Path) -> ModuleType:
    """Import a library that only some installations have."""
    try:
        with quiet():
            return importlib.import_module(module)
    except ImportError as error:
        raise FileError(
            f'{path.name} needs the library {module}, which is not installed. Run: pip install "planish[formats]"'
        ) from error
