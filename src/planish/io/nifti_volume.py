"""NIfTI files of one volume, versions 1 and 2: raw values are mapped, those in a gzip unpacked at once."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError
from planish.io.formats import LoadedVolume, Place
from planish.io.guard import quiet, reading
from planish.io.headed import Header, axes_of, packing_of, unpacked_head, values_behind
from planish.io.lazy import ChangedArray, FileArray, StoredArray
from planish.io.sizes import stated_in
from planish.io.tiff import damaged

LEAST_OFFSETS = {1: 348, 2: 540}  # bytes of the header of each version
MIRRORED = (
    "By its affine the axes of {} make a left-handed system: as a stack of slices it is a mirror image of the "
    "specimen. Flip one axis where you export it, or the sheet will lie on its image like its own reflection."
)


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map the values, or leave them to be unpacked; values that the header scales become float32."""
    path = place.path
    keys, version = _header(unpacked_head(path, LEAST_OFFSETS[2]), path)
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
    packing = packing_of(path)
    header = Header(
        shape=tuple(sizes[axis] for axis in order), stored=stored, data=path, offset=0 if packing else offset,
        packing=packing, stated=[stated_in("the NIfTI pixdim", lengths, [unit] * len(sizes), order)],
        skip=offset if packing else 0,
    )  # fmt: skip
    values = values_behind(path, header)
    if slope is not None and intercept is not None and (slope, intercept) != (1.0, 0.0):
        inner = values if isinstance(values, FileArray) else StoredArray(path, header.shape, stored, offset=offset)
        values = ChangedArray(inner, partial(_scaled, slope=slope, intercept=intercept), np.dtype(np.float32))
    hand = {"hand": "left, by the affine"} if mirrored else {}
    notes = [MIRRORED.format(path.name)] if mirrored else []
    return LoadedVolume(values=values, stated=header.stated, files=[path], attrs=hand, notes=notes)


def _header(head: bytes, path: Path) -> tuple[Any, int]:
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
