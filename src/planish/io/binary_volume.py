"""NIfTI files of one volume, versions 1 and 2, and MRC files: mapped, or unpacked at once where they are packed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.io.formats import LoadedVolume, Place
from planish.io.guard import quiet, reading
from planish.io.headed import Header, axes_of, packing_of, unpacked_head, values_behind
from planish.io.lazy import FileArray, ViewArray, stored_planes
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import damaged

LONGEST_NIFTI = 540  # bytes of the header of version 2
MIRRORED = (
    "By its affine the axes of {} make a left-handed system: as a stack of slices it is a mirror image of the "
    "specimen. Flip one axis where you export it, or the sheet will lie on its image like its own reflection."
)


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    is_nifti = place.path.name.lower().endswith((".nii", ".nii.gz"))
    return (_load_nifti if is_nifti else _load_mrc)(place.path)


def _header_of(
    path: Path, sizes: tuple[int, ...], order: tuple[int, ...], stored: np.dtype[Any], offset: int, stated: Stated
) -> Header:
    """Header of values that begin at a byte of a file, which may be packed as a whole."""
    packing, shape = packing_of(path), tuple(sizes[axis] for axis in order)
    offset, skip = (0, offset) if packing else (offset, 0)
    return Header(
        path=path, data=path, shape=shape, stored=stored, offset=offset, packing=packing, skip=skip, stated=[stated]
    )


def _load_nifti(path: Path) -> LoadedVolume:
    """Values of a NIfTI file; those that the header scales become float32."""
    keys, header_bytes = _nifti_header(unpacked_head(path, LONGEST_NIFTI), path)
    with reading(path):
        sizes = tuple(int(n) for n in keys.get_data_shape())
        stored, offset = np.dtype(keys.get_data_dtype()), int(keys.get_data_offset())
        slope, intercept = keys.get_slope_inter()
        word = str(keys.get_xyzt_units()[0])
        unit = {"meter": "m", "micron": "um", "unknown": ""}.get(word, word)
        lengths = [float(v) for v in keys.get_zooms()]
        # Without a code no affine was written, and nibabel would make one up.
        has_affine = any(int(keys[name]) > 0 for name in ("sform_code", "qform_code"))
        mirrored = has_affine and bool(np.linalg.det(keys.get_best_affine()[:3, :3]) < 0)
    if min(sizes, default=0) < 0 or offset < header_bytes:
        raise damaged(path, f"its sizes are {sizes}, its values begin at byte {offset}")
    order = axes_of(sizes, "", path)
    stated = stated_in("the NIfTI pixdim", lengths, [unit] * len(sizes), order)
    header = _header_of(path, sizes, order, stored, offset, stated)
    values = values_behind(header)
    if slope is not None and intercept is not None and (slope, intercept) != (1.0, 0.0):
        inner = values if isinstance(values, FileArray) else stored_planes(path, header.shape, stored, offset=offset)
        values = ViewArray(inner, range(3), partial(_scaled, slope=slope, intercept=intercept), np.dtype(np.float32))
    hand = {"hand": "left, by the affine"} if mirrored else {}
    return header.volume(values, attrs=hand, notes=[MIRRORED.format(path.name)] if mirrored else [])


def _nifti_header(head: bytes, path: Path) -> tuple[Any, int]:
    """Read the header alone, and its length: what nibabel opens may name other files and extensions of any size."""
    with quiet:
        from nibabel import Nifti1Header, Nifti2Header
    header_class, length, magic = Nifti1Header, 348, head[344:347]
    if head[:4] in (LONGEST_NIFTI.to_bytes(4, "little"), LONGEST_NIFTI.to_bytes(4, "big")):
        header_class, length, magic = Nifti2Header, LONGEST_NIFTI, head[4:7]
    if magic in (b"ni1", b"ni2"):
        raise FileError(f"{path.name} has its values in another file (.img). Save it as one file, .nii or .nii.gz.")
    if len(head) < length or magic not in (b"n+1", b"n+2"):
        raise FileError(f"{path.name} is no NIfTI file. Check its name, or export it again.")
    with reading(path):
        return header_class(head[:length], check=False), length


def _scaled(values: NDArray[Any], *, slope: float, intercept: float) -> NDArray[Any]:
    return (values * np.float64(slope) + np.float64(intercept)).astype(np.float32)


HEADER_BYTES = 1024
IMOD_STAMP, IMOD_AT = 1146047817, 40  # where it stands in extra2, the next number says whether bytes are signed


def _load_mrc(path: Path) -> LoadedVolume:
    keys = _mrc_header(unpacked_head(path, HEADER_BYTES), path)
    sizes = tuple(int(keys[name]) for name in ("nx", "ny", "nz"))
    more = int(keys["nsymbt"])
    if min(sizes) < 1 or more < 0:
        raise damaged(path, f"its sizes are {sizes}, its extended header has {more} bytes")
    order = axes_of(sizes, "", path)
    header = _header_of(path, sizes, order, _type_of(keys, path), HEADER_BYTES + more, _stated(keys, order))
    return header.volume(values_behind(header))


def _mrc_header(head: bytes, path: Path) -> Any:
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
    lengths: list[float | None] = []
    for name in ("mapc", "mapr", "maps"):
        axis = {1: "x", 2: "y", 3: "z"}.get(int(keys[name]), "")
        number = int(keys[f"m{axis}"]) if axis else 0
        lengths.append(float(keys["cella"][axis]) / number if number > 0 else None)
    if all(length in (0.0, 1.0) for length in lengths):
        note = "1 Angstrom is what programs write when they do not know" if lengths[0] else "it is 0"
        return Stated("the MRC cell", (None, None, None), note)
    return stated_in("the MRC cell", lengths, ["angstrom"] * 3, order)
