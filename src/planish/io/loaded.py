"""What every reader of volumes gives back, and the checks that all of them share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, InputError, VolumeError
from planish.io.guard import size_of_file
from planish.io.lazy import FileArray, settle
from planish.io.sizes import Stated
from planish.io.tiff import size_words

ADVICE = "Save one grey volume alone, as a stack of slices."

MOST_VOXELS = 2**50
"""No scan has more; a larger number is damage."""

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue, Rec. ITU-R BT.709."""

COLOURS = {"red": 0, "green": 1, "blue": 2}
CHANNELS = ("luminance", *COLOURS)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedVolume:
    """Values of a volume and what its files say about them.

    Attributes
    ----------
    values : ndarray, memmap or FileArray, dims (z, y, x)
    stated : sequence of Stated
        Voxel size along z, y, x in the metadata.
    files : sequence of Path
        All that it is made of.
    bits : int
        Of a whole number, where the file uses fewer than its type has.
    attrs : mapping
        Further plain values for the attributes of the volume.
    notes : sequence of str
        Sentences about what looks wrong in the files.
    """

    values: NDArray[Any] | FileArray
    stated: Sequence[Stated]
    files: Sequence[Path]
    bits: int = 64
    attrs: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Sequence[str] = ()

    @property
    def file_bytes(self) -> int:
        """Size of all files."""
        return sum(size_of_file(file) for file in dict.fromkeys(self.files))

    @property
    def full_scale(self) -> int | None:
        """Largest value the file can store; None for floating point."""
        return full_scale(self.values.dtype, self.bits)


def full_scale(dtype: np.dtype[Any], bits: int) -> int | None:
    """Largest value that can be stored, None for floating point."""
    if dtype.kind == "f":
        return None
    return 1 if dtype.kind == "b" else min(int(np.iinfo(dtype).max), 2**bits - 1)


def settled(volume: LoadedVolume, path: Path, *, memory_bytes: int | None) -> LoadedVolume:
    """Check shape and type, and read what is small."""
    shape = volume.values.shape
    if 0 in shape or math.prod(shape) > MOST_VOXELS:
        raise FileError(
            f"{path.name} declares {size_words(shape)} voxels, which no volume has. It is damaged: copy or export it "
            "again."
        )
    if len(shape) != 3 or min(shape) == 1:
        raise VolumeError(f"{path.name} is no volume but {size_words(shape)} voxels (z, y, x). {ADVICE}")
    check_type(volume.values.dtype, path)
    return replace(volume, values=settle(volume.values, memory_bytes=memory_bytes))


def check_type(dtype: np.dtype[Any], path: Path) -> None:
    """Refuse values that are no grey values."""
    if dtype.kind == "b":
        raise VolumeError(f"{path.name} has black and white only (1 bit). Give the grey values it was made from.")
    if dtype.kind not in "uif" or dtype.itemsize > 8:
        raise VolumeError(f"{path.name} has {dtype} values. Needed are integers or real numbers up to 64 bits.")


def inside(folder: Path, name: str, path: Path, *, base: Path | None = None) -> Path:
    """Path of a file that another file names, which has to lie in the same folder or below."""
    target = (base or folder) / name
    try:
        within = "\0" not in name and target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        within = False
    if not within:
        raise FileError(
            f"{path.name} takes data from {name!r}, outside its folder, which planish does not open. "
            "Put the files into one folder and name them without a path."
        )
    if not target.is_file():
        raise FileError(f"{path.name} takes data from {name!r}, which does not exist. Put it beside {path.name}.")
    return target


def check_channel(channel: str | None) -> str | None:
    """Return the name of a channel in small letters."""
    word = None if channel is None else channel.strip().casefold()
    if word not in (None, *CHANNELS):
        raise InputError(
            f"{channel!r} is no channel of a volume. Choose one of {', '.join(CHANNELS)} with --volume-channel."
        )
    return word


def grey_of(colour: NDArray[Any], *, channel: str | None) -> NDArray[Any]:
    """Turn the last axis, red, green and blue, into grey; luminance, where none is chosen, is rounded in integers."""
    if channel not in (None, "luminance"):
        return colour[..., COLOURS[channel]]
    # In double precision 16-bit values come out exact, so that grey stored as colour stays what it was.
    grey = colour[..., :3].astype(np.float64) @ np.array(LUMINANCE)
    return (np.rint(grey) if colour.dtype.kind in "ui" else grey).astype(colour.dtype)


def colour_attrs(channel: str | None, path: Path, *, in_colour: bool) -> dict[str, str]:
    """Attributes of a volume whose files are in colour; a choice of colours is refused where they are not."""
    if not in_colour:
        if channel not in (None, "luminance"):
            raise InputError(f"{path.name} is grey, so it has no {channel}. Leave --volume-channel out.")
        return {}
    chosen = "no channel was chosen, so luminance is" if channel is None else f"the channel chosen is {channel}"
    return {"channel": channel or "luminance", "colour": f"The files are in colour; {chosen}."}
