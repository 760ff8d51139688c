"""Read NIfTI files of one volume, versions 1 and 2, and MRC files.

They are mapped, or unpacked at once where they are packed.
"""

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
    "By its affine the axes of {} make a left-handed system: as a stack of slices it is a mirror"
    " image of the specimen. Flip one axis where you export it, or the sheet will lie on its image"
    " like its own reflection."
)


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    is_nifti = place.path.name.lower().endswith((".nii", ".nii.gz"))
    return (_load_nifti if is_nifti else _load_mrc)(place.path)


def _header_of(
    path: Path,
    extents: tuple[int, ...],
    axes: tuple[int, ...],
    dtype: np.dtype[Any],
    offset: int,
    stated: Stated,
) -> Header:
    """Header of values that begin at a byte of a file, which may be packed as a whole."""
    packing, shape = packing_of(path), tuple(extents[axis] for axis in axes)
    offset, skip_bytes = (0, offset) if packing else (offset, 0)
    return Header(path, path, shape, dtype, offset, [stated], packing, skip_bytes)


def _load_nifti(path: Path) -> LoadedVolume:
    """Values of a NIfTI file; those that the header scales become float32."""
    fields, header_bytes = _nifti_header(unpacked_head(path, LONGEST_NIFTI), path)
    with reading(path):
        extents = tuple(int(n) for n in fields.get_data_shape())
        dtype, offset = np.dtype(fields.get_data_dtype()), int(fields.get_data_offset())
        slope, intercept = fields.get_slope_inter()
        unit_name = str(fields.get_xyzt_units()[0])
        unit = {"meter": "m", "micron": "um", "unknown": ""}.get(unit_name, unit_name)
        voxel_lengths = [float(v) for v in fields.get_zooms()]
        # Without a code no affine was written, and nibabel would make one up.
        has_affine = any(int(fields[name]) > 0 for name in ("sform_code", "qform_code"))
        is_mirrored = has_affine and bool(np.linalg.det(fields.get_best_affine()[:3, :3]) < 0)
    if min(extents, default=0) < 0 or offset < header_bytes:
        raise damaged(path, f"its sizes are {extents}, its values begin at byte {offset}")
    axes = axes_of(extents, "", path)
    stated = stated_in("the NIfTI pixdim", voxel_lengths, [unit] * len(extents), axes)
    header = _header_of(path, extents, axes, dtype, offset, stated)
    values = values_behind(header)
    if slope is not None and intercept is not None and (slope, intercept) != (1.0, 0.0):
        if not isinstance(values, FileArray):
            values = stored_planes(path, header.shape, dtype, offset=offset)
        scale = partial(_scaled, slope=slope, intercept=intercept)
        values = ViewArray(values, range(3), scale, np.dtype(np.float32))
    hand_attrs = {"hand": "left, by the affine"} if is_mirrored else {}
    return header.volume(
        values, attrs=hand_attrs, notes=[MIRRORED.format(path.name)] if is_mirrored else []
    )


def _nifti_header(head: bytes, path: Path) -> tuple[Any, int]:
    """Read the header alone, and its length.

    What nibabel opens may name other files and extensions of any size.
    """
    with quiet:
        from nibabel import Nifti1Header, Nifti2Header
    header_class, n_bytes, magic = Nifti1Header, 348, head[344:347]
    if head[:4] in (LONGEST_NIFTI.to_bytes(4, "little"), LONGEST_NIFTI.to_bytes(4, "big")):
        header_class, n_bytes, magic = Nifti2Header, LONGEST_NIFTI, head[4:7]
    if magic in (b"ni1", b"ni2"):
        raise FileError(
            f"{path.name} has its values in another file (.img). Save it as one file, .nii or"
            " .nii.gz."
        )
    if len(head) < n_bytes or magic not in (b"n+1", b"n+2"):
        raise FileError(f"{path.name} is no NIfTI file. Check its name, or export it again.")
    with reading(path):
        return header_class(head[:n_bytes], check=False), n_bytes


def _scaled(values: NDArray[Any], *, slope: float, intercept: float) -> NDArray[Any]:
    return (values * np.float64(slope) + np.float64(intercept)).astype(np.float32)


HEADER_BYTES = 1024
# Where it stands in extra2, the next number says whether bytes are signed.
IMOD_STAMP, IMOD_AT = 1146047817, 40


def _load_mrc(path: Path) -> LoadedVolume:
    fields = _mrc_header(unpacked_head(path, HEADER_BYTES), path)
    extents = tuple(int(fields[name]) for name in ("nx", "ny", "nz"))
    extended_bytes = int(fields["nsymbt"])
    if min(extents) < 1 or extended_bytes < 0:
        raise damaged(
            path, f"its sizes are {extents}, its extended header has {extended_bytes} bytes"
        )
    axes = axes_of(extents, "", path)
    offset, dtype = HEADER_BYTES + extended_bytes, _type_of(fields, path)
    header = _header_of(path, extents, axes, dtype, offset, _stated(fields, axes))
    return header.volume(values_behind(header))


def _mrc_header(head: bytes, path: Path) -> Any:
    with quiet:
        from mrcfile import dtypes
    if len(head) == HEADER_BYTES:
        for byte_order in ("<", ">"):
            fields = np.frombuffer(head, dtypes.HEADER_DTYPE.newbyteorder(byte_order))[0]
            if 0 <= int(fields["mode"]) < 128 and all(
                0 < int(fields[name]) < 2**24 for name in ("nx", "ny", "nz")
            ):
                return fields
    raise FileError(f"{path.name} is no MRC file. Check its name, or export it again.")


def _type_of(fields: Any, path: Path) -> np.dtype[Any]:
    """Type of the values by their mode.

    Bytes of programs that say so by IMOD's flags are unsigned.
    """
    from mrcfile import utils

    mode, byte_order = int(fields["mode"]), fields.dtype["nx"].byteorder
    try:
        dtype = np.dtype(utils.dtype_from_mode(mode))
    except ValueError:
        dtype = np.dtype(np.void)
    if dtype.kind not in "iuf":
        raise VolumeError(
            f"{path.name} has values of the mode {mode}. Export it with whole or real numbers."
        )
    stamp, flags = np.frombuffer(
        fields["extra2"].tobytes(), np.dtype(np.int32).newbyteorder(byte_order), 2, IMOD_AT
    )
    if mode == 0 and stamp == IMOD_STAMP and not flags & 1:
        dtype = np.dtype(np.uint8)
    return dtype.newbyteorder(byte_order)


def _stated(fields: Any, axes: tuple[int, ...]) -> Stated:
    """Size of a voxel: the cell by its intervals.

    Its axes may stand in another order than those of the array.
    """
    cell_lengths: list[float | None] = []
    for name in ("mapc", "mapr", "maps"):
        axis = {1: "x", 2: "y", 3: "z"}.get(int(fields[name]), "")
        n_intervals = int(fields[f"m{axis}"]) if axis else 0
        cell_lengths.append(float(fields["cella"][axis]) / n_intervals if n_intervals > 0 else None)
    if all(length in (0.0, 1.0) for length in cell_lengths):
        note_text = (
            "1 Angstrom is what programs write when they do not know"
            if cell_lengths[0]
            else "it is 0"
        )
        return Stated("the MRC cell", (None, None, None), note_text)
    return stated_in("the MRC cell", cell_lengths, ["angstrom"] * 3, axes)
