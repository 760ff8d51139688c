"""NIfTI files of one volume, versions 1 and 2, and MRC files (CCP4 maps, tomograms of electron microscopes).

Raw values are mapped, packed ones unpacked at once.
"""

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
from planish.io.lazy import ChangedArray, FileArray, StoredArray
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import damaged

LEAST_OFFSETS = {1: 348, 2: 540}  # bytes of the header of each version
MIRRORED = (
    "By its affine the axes of {} make a left-handed system: as a stack of slices it is a mirror image of the "
    "specimen. Flip one axis where you export it, or the sheet will lie on its image like its own reflection."
)


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    is_nifti = place.path.name.lower().endswith((".nii", ".nii.gz"))
    return _load_nifti(place.path) if is_nifti else _load_mrc(place.path)


def _header_of(
    path: Path, sizes: tuple[int, ...], order: tuple[int, ...], stored: np.dtype[Any], offset: int, stated: Stated
) -> Header:
    """Header of values that begin at a byte of a file, which may be packed as a whole."""
    packing = packing_of(path)
    return Header(
        shape=tuple(sizes[axis] for axis in order), stored=stored, data=path, offset=0 if packing else offset,
        packing=packing, stated=[stated], skip=offset if packing else 0,
    )  # fmt: skip


def _load_nifti(path: Path) -> LoadedVolume:
    """Values of a NIfTI file; those that the header scales become float32."""
    keys, version = _nifti_header(unpacked_head(path, LEAST_OFFSETS[2]), path)
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
    if min(sizes, default=0) < 0 or offset < LEAST_OFFSETS[version]:
        raise damaged(path, f"its sizes are {sizes}, its values begin at byte {offset}")
    order = axes_of(sizes, "", path)
    stated = stated_in("the NIfTI pixdim", lengths, [unit] * len(sizes), order)
    header = _header_of(path, sizes, order, stored, offset, stated)
    values = values_behind(path, header)
    if slope is not None and intercept is not None and (slope, intercept) != (1.0, 0.0):
        inner = values if isinstance(values, FileArray) else StoredArray(path, header.shape, stored, offset=offset)
        values = ChangedArray(inner, partial(_scaled, slope=slope, intercept=intercept), np.dtype(np.float32))
    hand = {"hand": "left, by the affine"} if mirrored else {}
    notes = [MIRRORED.format(path.name)] if mirrored else []
    return LoadedVolume(values=values, stated=header.stated, files=[path], attrs=hand, notes=notes)


def _nifti_header(head: bytes, path: Path) -> tuple[Any, int]:
    """Read the header alone: what nibabel opens may name other files and extensions of any size."""
    with quiet:
        import nibabel
    version = 2 if head[:4] in ((540).to_bytes(4, "little"), (540).to_bytes(4, "big")) else 1
    header_class: Any = (nibabel.Nifti1Header, nibabel.Nifti2Header)[version - 1]
    magic = head[344:348] if version == 1 else head[4:8]
    if magic[:3] in (b"ni1", b"ni2"):
        raise FileError(f"{path.name} has its values in another file (.img). Save it as one file, .nii or .nii.gz.")
    if len(head) < LEAST_OFFSETS[version] or magic[:3] not in (b"n+1", b"n+2"):
        raise FileError(f"{path.name} is no NIfTI file. Check its name, or export it again.")
    with reading(path):
        return header_class(head[: LEAST_OFFSETS[version]], check=False), version


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
    return LoadedVolume(values=values_behind(path, header), stated=header.stated, files=[path])


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
    cell = {1: ("x", "mx"), 2: ("y", "my"), 3: ("z", "mz")}
    lengths: list[float | None] = []
    for name in ("mapc", "mapr", "maps"):
        along, count = cell.get(int(keys[name]), ("", ""))
        number = int(keys[count]) if count else 0
        lengths.append(float(keys["cella"][along]) / number if number > 0 else None)
    if all(v in (0.0, 1.0) for v in lengths):
        note = "1 Angstrom is what programs write when they do not know" if lengths[0] else "it is 0"
        return Stated(source="the MRC cell", um=(None, None, None), note=note)
    return stated_in("the MRC cell", lengths, ["angstrom"] * 3, order)
