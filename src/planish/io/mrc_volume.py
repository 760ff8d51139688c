"""MRC files (CCP4 maps, tomograms of electron microscopes): raw values are mapped, packed ones unpacked at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.io.formats import LoadedVolume, Place
from planish.io.guard import quiet
from planish.io.headed import Header, axes_of, packing_of, unpacked_head, values_behind
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import damaged

HEADER_BYTES = 1024
IMOD_STAMP, IMOD_AT = 1146047817, 40  # where it stands in extra2, the next number says whether bytes are signed
DEFAULT_NOTE = "1 Angstrom is what programs write when they do not know"


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    path = place.path
    keys = _header(unpacked_head(path, HEADER_BYTES), path)
    sizes = tuple(int(keys[name]) for name in ("nx", "ny", "nz"))
    more = int(keys["nsymbt"])
    if min(sizes) < 1 or more < 0:
        raise damaged(path, f"its sizes are {sizes}, its extended header has {more} bytes")
    packing, offset = packing_of(path), HEADER_BYTES + more
    order = axes_of(sizes, "", path)
    header = Header(
        shape=tuple(sizes[axis] for axis in order), stored=_type_of(keys, path), data=path,
        offset=0 if packing else offset, packing=packing, stated=[_stated(keys, order)], skip=offset if packing else 0,
    )  # fmt: skip
    return LoadedVolume(values=values_behind(path, header), stated=header.stated, files=[path])


def _header(head: bytes, path: Path) -> Any:
    """Read the header alone, in whichever byte order makes sense of it."""
    with quiet:
        from mrcfile import dtypes
    if len(head) == HEADER_BYTES:
        for order in ("<", ">"):
            keys = np.frombuffer(head, dtypes.HEADER_DTYPE.newbyteorder(order))[0]
            if 0 <= int(keys["mode"]) < 128 and all(0 < int(keys[name]) < 2**24 for name in ("nx", "ny", "nz")):
                return keys
    raise FileError(f"{path.name} is no MRC file. Check its name, or export it again.")


def _type_of(keys: Any, path: Path) -> np.dtype[Any]:
    """Type of the values by their mode; bytes of programs that say so by IMOD's flags are unsigned."""
    from mrcfile import utils

    mode, order = int(keys["mode"]), keys.dtype["nx"].byteorder
    try:
        dtype = np.dtype(utils.dtype_from_mode(mode))
    except ValueError:
        dtype = np.dtype(np.void)
    if dtype.kind not in "iuf":
        raise VolumeError(f"{path.name} has values of the mode {mode}. Export it with whole or real numbers.")
    stamp, flags = np.frombuffer(keys["extra2"].tobytes(), np.dtype(np.int32).newbyteorder(order), 2, IMOD_AT)
    if mode == 0 and stamp == IMOD_STAMP and not flags & 1:
        dtype = np.dtype(np.uint8)
    return dtype.newbyteorder(order)


def _stated(keys: Any, order: tuple[int, ...]) -> Stated:
    """Size of a voxel: the cell by its intervals; its axes may stand in another order than those of the array."""
    cell = {1: ("x", "mx"), 2: ("y", "my"), 3: ("z", "mz")}
    lengths: list[float | None] = []
    for name in ("mapc", "mapr", "maps"):
        along, count = cell.get(int(keys[name]), ("", ""))
        number = int(keys[count]) if count else 0
        lengths.append(float(keys["cella"][along]) / number if number > 0 else None)
    if all(v in (0.0, 1.0) for v in lengths):
        return Stated(source="the MRC cell", um=(None, None, None), note=DEFAULT_NOTE if lengths[0] else "it is 0")
    return stated_in("the MRC cell", lengths, ["angstrom"] * 3, order)
