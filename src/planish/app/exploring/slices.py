"""The slices of a page: read from the volume by window, or those that the run keeps.

With the faces found in them.
"""

import base64
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.exploring.maps import Packed, packed
from planish.core.errors import PlanishError
from planish.core.frame import Frame
from planish.core.grid import step_of
from planish.core.labelled import chunks_of, read_box
from planish.core.memory import SLICES_VOXELS
from planish.core.typing import Array, Entries, Ints, Texts
from planish.exports.run_contents import sheet_facts, sheet_run, volume_params
from planish.io.sections import is_section_folder
from planish.report.colours import GREYS, Scale, limits
from planish.report.slices import LINES, Slice, take_slice
from planish.results import LayerFacts
from planish.run.compute import Compute, Progress
from planish.run.run import Run
from planish.run.volume import read_whole

BUDGET = 5_000_000
"""Letters that all slices may take."""

# Pixels of a slice; points of a line in it.
_MAX_SLICES = 320
_MAX_COLS = 1600
_MAX_ROWS = 300
_MAX_POINTS = 600


@dataclass(frozen=True, slots=True, kw_only=True)
class Stack:
    """The slices of one sheet, each with its top side up.

    ``spec`` is what the script has to know, in um: ``sheet``; the axes ``rows`` across the slices,
    ``cols`` along them and ``through`` the sheet; ``sign``, which makes the top the larger height;
    where each slice lies along ``rows`` (``at``), the height of its upper edge (``top``), turned by
    ``sign``, and its start along ``cols``; width and height of a picture (``size``), where each
    ends in all of them, their format (``kind``), first point and pitch of lines.
    """

    spec: Entries
    pictures: Texts  # in base64
    lines: dict[str, Packed]  # heights of the surfaces (slices, points), turned by ``sign``
    measured: Packed  # where the columns were measured
    note: str  # which slices there are, in words

    def letters(self) -> int:
        """Size of all that is packed."""
        packed_texts = [heights.text for heights in (*self.lines.values(), self.measured)]
        return sum(map(len, (*self.pictures, *packed_texts)))


def stack_of(
    run: Run, layer: LayerFacts, max_letters: int, compute: Compute, progress: Progress
) -> Stack | None:
    """The slices of a sheet; None where the run that holds its surfaces is not there.

    As many as fit into ``max_letters``: every second one is left out until they do.
    """
    mapped = sheet_run(run, layer.name)
    sheet = None if mapped is None else sheet_facts(mapped)
    if mapped is None or sheet is None:
        return None
    run_slices = mapped.groups["slices"]
    surfaces = mapped.groups["surfaces"]
    greys = run_slices["grey"].values.ravel()
    scale = limits(greys[:: max(1, greys.size // 600_000)], GREYS, percent=0.3)
    try:
        slices, slice_surfaces, row_step = _from_volume(mapped, sheet, scale, compute, progress)
        rows_text = f"one in {row_step} rows" if row_step > 1 else "every row"
        rows_text = f"{rows_text} of {layer.source.name}"
    except _VolumeUnavailable as unavailable:
        stored_rows = run_slices["row"].values
        slice_surfaces = surfaces[_read_names(surfaces)].isel(y=stored_rows).load()
        grey = run_slices["grey"].copy(data=_greys(run_slices["grey"].values, scale))
        slices = run_slices.assign(grey=grey, row=("slice", np.arange(stored_rows.size)))
        rows_text = f"the {stored_rows.size} that the run keeps, as {unavailable}"
    cuts = (take_slice(slices, slice_surfaces, k) for k in range(slices.sizes["slice"]))
    sheet_slices = [cut for cut in cuts if np.isfinite([*cut.lines.values()]).any()]
    thinned_text = ""
    while sheet_slices:
        stack = _stack(sheet_slices, layer.name, Frame.of(surfaces), f"{rows_text}{thinned_text}")
        if stack.letters() <= max_letters:
            return stack
        sheet_slices = sheet_slices[::2] if len(sheet_slices) > 1 else []
        thinned_text = f", thinned out to {len(sheet_slices)}"
    return None


class _VolumeUnavailable(Exception):
    """Why no slices are read from the volume, in words that end a sentence."""


def _from_volume(
    run: Run, layer: LayerFacts, scale: Scale, compute: Compute, progress: Progress
) -> tuple[xr.Dataset, xr.Dataset, int]:
    """Slices as the run keeps them, with the surfaces in their rows.

    Also how many rows of voxels apart they are. ``scale`` is the grey that is black, and white.
    """
    try:
        params = volume_params(run, layer, progress)
        if is_section_folder(params.path):
            raise _VolumeUnavailable(
                f"{layer.source.name} holds sections, which would have to be aligned again"
            )
        volume = read_whole(params, compute, progress)
    except PlanishError as error:
        progress("slices", f"only those of the run: {error.text}")
        raise _VolumeUnavailable(
            f"{layer.source.name} was not there unchanged when this page was made"
        ) from error
    surfaces = run.groups["surfaces"]
    frame = Frame.of(surfaces)
    depth_um = volume.coords[frame.through].values
    column_um = step_of(surfaces["y"].values)
    column_voxels = round(column_um / step_of(volume.coords[frame.rows].values))
    n_rows = surfaces.sizes["y"]
    # Every second row, where there is room.
    step = max(math.ceil(2 / column_voxels), math.ceil(n_rows / _MAX_SLICES))
    row_indices = np.arange(step // 2, n_rows, step) if n_rows > step else np.array([0])
    slice_surfaces = surfaces[_read_names(surfaces)].isel(y=row_indices).load()
    planes = _planes(slice_surfaces, depth_um)
    voxel_rows = row_indices * column_voxels + column_voxels // 2
    col_step = math.ceil(volume.sizes[frame.cols] / _MAX_COLS)
    grey = _read_greys(volume, frame, voxel_rows, planes, col_step, scale, progress)
    coords = {  # in um
        "slice": volume.coords[frame.rows].values[voxel_rows],
        "height": depth_um[planes],
        "x": _means(volume.coords[frame.cols].values, col_step),
    }
    rows = ("slice", np.arange(row_indices.size))
    slices = xr.Dataset({"grey": (tuple(coords), grey), "row": rows}, coords)
    return slices, slice_surfaces, step * column_voxels


def _means(values: Array, col_step: int) -> Array:
    """Means of every ``col_step`` columns, along the last axis; fewer at its end are left out."""
    n_cols = values.shape[-1] // col_step
    whole = values[..., : n_cols * col_step]
    return whole.reshape(*whole.shape[:-1], n_cols, col_step).mean(axis=-1)


def _read_names(surfaces: xr.Dataset) -> list[str]:
    return [name for name, *_ in LINES if name in surfaces] + ["thickness"]


def _planes(surfaces: xr.Dataset, depth_um: Array) -> slice:
    """Planes of voxels, at ``depth_um`` along the axis through the sheet, in which the sheet lies.

    With a margin to either side; all where no surface was found.
    """
    heights_um = surfaces.drop_vars("thickness").to_array().values
    heights_um = heights_um[np.isfinite(heights_um)]
    if not heights_um.size:
        return slice(0, depth_um.size)
    margin_um = _margin_um(np.abs(surfaces["thickness"].values))
    is_above = depth_um >= heights_um.min() - margin_um
    planes = np.flatnonzero(is_above & (depth_um <= heights_um.max() + margin_um))
    return slice(int(planes[0]), int(planes[-1]) + 1)


def _margin_um(thickness_um: Array) -> float:
    """Depth that is shown beside the sheet: 0.3 of its median thickness, at least 20 um."""
    finite = thickness_um[np.isfinite(thickness_um)]
    return max(0.3 * float(np.median(finite)) if finite.size else 0.0, 20.0)


def _read_greys(
    volume: xr.DataArray,
    frame: Frame,
    rows: Ints,
    planes: slice,
    col_step: int,
    scale: Scale,
    progress: Progress,
) -> NDArray[np.uint8]:
    """Read grey values (rows, depth, cols) in whole blocks along z, black to white in 8 bits.

    ``rows`` are evenly spaced rows of voxels, ``planes`` those through the sheet. Every
    ``col_step`` columns give their mean.
    """
    shape = (rows.size, planes.stop - planes.start, volume.sizes[frame.cols] // col_step)
    greys = np.zeros(shape, np.uint8)
    row_step = 1
    if rows.size > 1:
        row_step = int(rows[1] - rows[0])
    for block in _blocks(volume, frame, rows, planes):
        is_in_block = np.ones(rows.size, bool)
        block_planes = block
        if frame.rows == "z":
            is_in_block = (rows >= block.start) & (rows < block.stop)
            block_planes = planes
        if not is_in_block.any():
            continue
        progress("slices", f"{frame.rows} of the volume, planes {block.start} to {block.stop}")
        # Evenly spaced places as a slice, by which lazy arrays read no more than they must.
        first, last = rows[is_in_block][[0, -1]].tolist()
        box = {
            frame.rows: slice(first, last + 1, row_step),
            frame.through: block_planes,
            frame.cols: slice(None),
        }
        voxels = read_box(volume, box)
        if col_step > 1:
            voxels = _means(voxels, col_step)
        depth = slice(block_planes.start - planes.start, block_planes.stop - planes.start)
        greys[is_in_block, depth] = _greys(voxels, scale)
    return greys


def _blocks(volume: xr.DataArray, frame: Frame, rows: Ints, planes: slice) -> Iterator[slice]:
    """Parts of the volume along z, so each plane of a file, or chunk of a store, is read once.

    Along z lie the rows, where the sheet's rows do, or the planes; of about `SLICES_VOXELS` voxels
    that are read together, and of whole chunks.
    """
    chunk_planes = chunks_of(volume)[0]
    n_planes = planes.stop - planes.start
    sizes = {frame.rows: rows.size, frame.cols: volume.sizes[frame.cols], frame.through: n_planes}
    plane_voxels = math.prod(size for axis, size in sizes.items() if axis != "z")
    block_planes = max(SLICES_VOXELS // max(plane_voxels, 1) // chunk_planes, 1) * chunk_planes
    first = planes.start
    last = planes.stop
    if frame.rows == "z":
        first = int(rows[0])
        last = int(rows[-1]) + 1
    for start in range(first // chunk_planes * chunk_planes, last, block_planes):
        yield slice(max(start, first), min(start + block_planes, last))


def _greys(values: Array, scale: Scale) -> NDArray[np.uint8]:
    """Grey values in 8 bits; what is missing is black."""
    fraction = (np.asarray(values, np.float32) - scale.low) / (scale.high - scale.low)
    shown = np.clip(np.nan_to_num(fraction, nan=0.0), 0, 1)
    return np.rint(255 * shown).astype(np.uint8)


def _stack(slices: list[Slice], sheet: str, frame: Frame, note: str) -> Stack:
    """Cut every slice to the sheet in it, all to the same height, and pack it.

    ``sheet`` is the name of its layer, ``note`` says which slices these are.
    """
    x_um = slices[0].x
    heights_um = slices[0].heights
    dx_um = step_of(x_um)
    dz_um = abs(step_of(heights_um))
    thickness_um = np.stack([cut.lines["top"] - cut.lines["bottom"] for cut in slices])
    margin_um = _margin_um(np.abs(thickness_um))
    windows = [cut.window(float(x_um[0]), float(x_um[-1]), margin_um) for cut in slices]
    lows_um = np.array([low_um for *_, low_um, _ in windows])
    highs_um = np.array([high_um for *_, high_um in windows])
    # Rows of voxels, the top first: as many as the deepest window needs, about each one's middle.
    n_rows = min(math.ceil((highs_um - lows_um).max() / dz_um) + 1, heights_um.size)
    first_rows = (heights_um[0] - (lows_um + highs_um) / 2) / dz_um - (n_rows - 1) / 2
    top_rows = np.clip(np.rint(first_rows).astype(int), 0, heights_um.size - n_rows)
    greys = [cut.grey[k : k + n_rows] for cut, k in zip(slices, top_rows, strict=True)]
    image_format, pictures = _pictures(greys)
    point_step = max(1, math.ceil(x_um.size / _MAX_POINTS))
    is_measured = np.stack([cut.used[::point_step] for cut in slices])
    step_um = dz_um / 16  # to which heights are rounded: they pack well, and nobody sees it
    lines: dict[str, Packed] = {}
    for name, *_ in LINES:
        line_um = np.stack([cut.lines[name] for cut in slices])
        if np.isfinite(line_um).any():
            whole_steps = np.round(line_um[:, ::point_step] / step_um)
            lines[name] = packed(whole_steps * step_um, bits=16)
    spec = {
        "sheet": sheet,
        "rows": frame.rows,
        "cols": frame.cols,
        "through": frame.through,
        "sign": frame.sign,
        "at": [cut.place_um for cut in slices],
        "top": [float(heights_um[k]) + dz_um / 2 for k in top_rows],
        "start": float(x_um[0]) - dx_um / 2,
        "size": (x_um.size * dx_um, n_rows * dz_um),
        "ends": np.cumsum([len(picture) for picture in pictures]).tolist(),
        "kind": image_format,
        "pictures": "",
        "points": (float(x_um[0]), point_step * dx_um),
    }
    return Stack(
        spec=spec,
        pictures=pictures,
        lines=lines,
        measured=packed(np.where(is_measured, 1.0, np.nan)),
        note=(
            f"{len(slices)} slices across {frame.rows}: {note}; pixels of {dx_um:.4g} um, lossy"
            " pictures"
        ),
    )


def _pictures(greys: list[Array]) -> tuple[str, Texts]:
    """Format of the pictures of slices, and each packed, in base64; high ones with fewer rows."""
    from PIL import Image, features

    image_format = "webp" if features.check("webp") else "jpeg"
    pictures: list[str] = []
    for grey in greys:
        image = Image.fromarray(grey.astype(np.uint8))
        if image.height > _MAX_ROWS:
            image = image.resize((image.width, _MAX_ROWS), Image.Resampling.BOX)
        buffer = io.BytesIO()
        # Their grains are noise.
        image.convert("RGB").save(buffer, format=image_format.upper(), quality=38)
        pictures.append(base64.b64encode(buffer.getvalue()).decode("ascii"))
    return image_format, tuple(pictures)
