"""Read NIfTI files of one volume, versions 1 and 2, and MRC files.

They are mapped, or unpacked at once where they are packed.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.core.typing import Array, DType, Floats, Shape, Texts
from planish.io.axes import AxisNames
from planish.io.formats import LoadedVolume, Place
from planish.io.guard import quiet, reading
from planish.io.headed import (
    Header,
    StoredAxes,
    axes_of,
    packing_of,
    unpacked_head,
    values_behind,
)
from planish.io.lazy import ViewArray, unmapped
from planish.io.orientation import Orientation
from planish.io.sizes import NO_SIZE, Stated, stated_in
from planish.io.tiff import damaged

LONGEST_NIFTI = 540  # bytes of the header of version 2
NIFTI_AXES = ("x", "y", "z", "t", "u", "v", "w")  # as the standard calls them, fastest first


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked."""
    if place.path.name.lower().endswith((".nii", ".nii.gz")):
        return _load_nifti(place.path)
    return _load_mrc(place.path)


def _header_of(
    path: Path, axes: StoredAxes, dtype: DType, offset: int, stated: list[Stated]
) -> Header:
    """Header of values that begin at byte ``offset`` of a file, which may be packed as a whole."""
    packing = packing_of(path)
    skip_bytes = 0
    if packing:  # the byte is one of the unpacked file
        skip_bytes = offset
        offset = 0
    return Header(path, path, axes, dtype, offset, stated, packing, skip_bytes)


def _load_nifti(path: Path) -> LoadedVolume:
    """Values of a NIfTI file; those that the header scales become float32.

    The header counts its axes from x, the fastest; arrays have z first.
    """
    fields, header_bytes = _nifti_header(unpacked_head(path, LONGEST_NIFTI), path)
    with reading(path):
        extents = tuple(map(int, fields.get_data_shape()))
        dtype = np.dtype(fields.get_data_dtype())
        offset = int(fields.get_data_offset())
        slope, intercept = fields.get_slope_inter()
        unit_name, time_name = map(str, fields.get_xyzt_units())
        unit = {"meter": "m", "micron": "um", "unknown": ""}.get(unit_name, unit_name)
        voxel_lengths = list(map(float, fields.get_zooms()))
        affines = _affines(fields)
    if min(extents, default=0) < 0 or offset < header_bytes:
        raise damaged(path, f"its sizes are {extents}, its values begin at byte {offset}")
    naming = AxisNames("the NIfTI standard", NIFTI_AXES[: len(extents)])
    axes = axes_of(extents, path, [naming])
    units = [unit] * 3 + [time_name] * (len(extents) - 3)
    stated = [stated_in("the NIfTI pixdim", voxel_lengths, units, axes.header_axes)]
    orientations: list[Orientation] = []
    if axes.header_axes != (2, 1, 0):  # time points in place of z have no place in an affine
        affines = {}
    for name, affine in affines.items():
        # A row for each of z, y, x: where it runs in space.
        orientation = Orientation(f"the {name}", affine[:, ::-1].T)
        orientations.append(orientation)
        if not orientation.is_flat:
            lengths = np.linalg.norm(affine, axis=0).tolist()
            stated.append(stated_in(f"the NIfTI {name}", lengths, units, axes.header_axes))
    header = _header_of(path, axes, dtype, offset, stated)._replace(orientations=orientations)
    values = values_behind(header)
    if (slope, intercept) not in ((None, None), (1.0, 0.0)):
        inner: Any = unmapped(values)
        scale = partial(_scaled, slope=slope, intercept=intercept)
        values = ViewArray(inner, range(3), scale, np.dtype(np.float32))
    return header.volume(values)


def _affines(fields: Any) -> dict[str, Floats]:
    """Columns x, y, z of the affines that were written, by their name."""
    # Without a code none was written, and nibabel would make one up.
    getters = {"sform": fields.get_sform, "qform": fields.get_qform}
    written = [name for name in getters if int(fields[f"{name}_code"]) > 0]
    return {name: np.asarray(getters[name](), np.float64)[:3, :3] for name in written}


def _nifti_header(head: bytes, path: Path) -> tuple[Any, int]:
    """Read the header alone, and its length.

    ``head``: the first `LONGEST_NIFTI` bytes; they begin with the length of the header, 348 or 540.
    What nibabel opens may name other files and extensions of any size.
    """
    with quiet:
        from nibabel import Nifti1Header, Nifti2Header
    header_class = Nifti1Header
    n_bytes = 348
    magic = head[344:347]
    if LONGEST_NIFTI in (int.from_bytes(head[:4], "little"), int.from_bytes(head[:4])):
        header_class = Nifti2Header
        n_bytes = LONGEST_NIFTI
        magic = head[4:7]
    if magic in (b"ni1", b"ni2"):
        raise FileError(
            f"{path.name} has its values in another file (.img). Save it as one file, .nii or"
            " .nii.gz."
        )
    if len(head) < n_bytes or magic not in (b"n+1", b"n+2"):
        raise FileError(f"{path.name} is no NIfTI file. Check its name, or export it again.")
    with reading(path):
        return header_class(head[:n_bytes], check=False), n_bytes


def _scaled(values: Array, *, slope: float, intercept: float) -> Array:
    return (values * np.float64(slope) + np.float64(intercept)).astype(np.float32)


HEADER_BYTES = 1024
MRC_AXES = {1: "x", 2: "y", 3: "z"}
# Where it stands in extra2, the next number says whether bytes are signed.
IMOD_STAMP = 1146047817
IMOD_AT = 40


def _load_mrc(path: Path) -> LoadedVolume:
    """Values of an MRC file, whose axes may be stored in any order."""
    fields = _mrc_header(unpacked_head(path, HEADER_BYTES), path)
    extents = tuple(int(fields[name]) for name in ("nx", "ny", "nz"))
    extended_bytes = int(fields["nsymbt"])
    if min(extents) < 1 or extended_bytes < 0:
        raise damaged(
            path, f"its sizes are {extents}, its extended header has {extended_bytes} bytes"
        )
    axis_numbers = (int(fields[name]) for name in ("mapc", "mapr", "maps"))
    letters = tuple(MRC_AXES.get(number, "") for number in axis_numbers)
    naming = AxisNames("mapc, mapr and maps", letters)
    axes = axes_of(extents, path, [naming] if any(letters) else [])
    offset = HEADER_BYTES + extended_bytes
    dtype = _type_of(fields, path)
    stated = _stated(fields, letters, axes.header_axes)
    header = _header_of(path, axes, dtype, offset, [stated])
    return header.volume(values_behind(header))


def _mrc_header(head: bytes, path: Path) -> Any:
    """The fields of a header by their names, in the byte order in which they make sense."""
    with quiet:
        from mrcfile import dtypes
    if len(head) == HEADER_BYTES:
        for byte_order in ("<", ">"):
            fields = np.frombuffer(head, dtypes.HEADER_DTYPE.newbyteorder(byte_order))[0]
            # In the wrong order, small whole numbers become huge ones.
            sizes = [int(fields[name]) for name in ("nx", "ny", "nz")]
            has_sizes = min(sizes) > 0 and max(sizes) < 2**24
            if has_sizes and 0 <= int(fields["mode"]) < 128:
                return fields
    raise FileError(f"{path.name} is no MRC file. Check its name, or export it again.")


def _type_of(fields: Any, path: Path) -> DType:
    """Type of the values by their mode.

    Bytes of programs that say so by IMOD's flags are unsigned.
    """
    from mrcfile import utils

    mode = int(fields["mode"])
    byte_order = fields.dtype["nx"].byteorder
    try:
        dtype = np.dtype(utils.dtype_from_mode(mode))
    except ValueError:
        dtype = np.dtype(np.void)
    if dtype.kind not in "iuf":
        raise VolumeError(
            f"{path.name} has values of the mode {mode}. Export it with whole or real numbers."
        )
    whole = np.dtype(np.int32).newbyteorder(byte_order)
    stamp, flags = np.frombuffer(fields["extra2"].tobytes(), whole, 2, IMOD_AT)
    if mode == 0 and stamp == IMOD_STAMP and not flags & 1:
        dtype = np.dtype(np.uint8)
    return dtype.newbyteorder(byte_order)


def _stated(fields: Any, letters: Texts, axes: Shape) -> Stated:
    """Size of a voxel: the cell by its intervals, along z, y, x.

    ``letters``: which axis of the cell each axis of the header is, fastest first, empty where it
    does not say; ``axes``: numbers in the header of z, y and x.
    """
    voxel_lengths: list[float | None] = []
    for letter in letters:
        n_intervals = int(fields[f"m{letter}"]) if letter else 0
        length = None
        if n_intervals > 0:
            length = float(fields["cella"][letter]) / n_intervals
        voxel_lengths.append(length)
    if all(length in (0.0, 1.0) for length in voxel_lengths):
        note_text = "it is 0"
        if voxel_lengths[0]:
            note_text = "1 Angstrom is what programs write when they do not know"
        return Stated("the MRC cell", NO_SIZE, note_text)
    return stated_in("the MRC cell", voxel_lengths, ["angstrom"] * 3, axes)
