"""The slices of a page: read from the volume by window, or those that the run keeps; with the faces found in them."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.exploring.maps import Packed, packed
from planish.core.errors import PlanishError
from planish.core.frame import Frame
from planish.core.lazy import chunks_of, read_box
from planish.core.memory import SLICES_VOXELS
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

_MOST, _WIDEST, _HIGHEST, _POINTS = 320, 1600, 300, 600  # slices; pixels of one along and across; points of a line


@dataclass(frozen=True, slots=True, kw_only=True)
class Stack:
    """The slices of one sheet, each with its top side up.

    Attributes
    ----------
    about : dict
        What the script has to know: ``sheet``; the axes ``rows`` across the slices, ``cols`` along them and ``through``
        the sheet; ``sign``, which makes the top the larger height; where each slice lies along ``rows`` (``at``), the
        height of its upper edge (``top``), turned by ``sign``, and its start along ``cols``; width and height of a
        picture (``size``), where each ends in all of them, their format (``kind``), first point and pitch of the lines.
        All in um.
    pictures : tuple of str
        In base64.
    lines : dict of Packed
        Heights of the surfaces (slices, points), turned by ``sign``.
    used : Packed
        Where the columns were measured.
    note : str
        Which slices there are, in words.
    """

    about: dict[str, Any]
    pictures: tuple[str, ...]
    lines: dict[str, Packed]
    used: Packed
    note: str

    def letters(self) -> int:
        """Size of all that is packed."""
        return sum(map(len, self.pictures)) + sum(len(line.text) for line in (*self.lines.values(), self.used))


def stack_of(run: Run, facts: LayerFacts, budget: int, compute: Compute, progress: Progress) -> Stack | None:
    """The slices of a sheet; None where the run that holds its surfaces is not there."""
    mapped = sheet_run(run, facts.name)
    if mapped is None or (sheet := sheet_facts(mapped)) is None:
        return None
    run_slices, surfaces = mapped.groups["slices"], mapped.groups["surfaces"]
    scale = limits(run_slices["grey"].values.ravel()[:: max(1, run_slices["grey"].size // 600_000)], GREYS, percent=0.3)
    file_name = facts.source.name
    try:
        data, under, every = _from_volume(mapped, sheet, surfaces, scale, compute, progress)
        note = f"one in {every} rows of {file_name}" if every > 1 else f"every row of {file_name}"
    except _VolumeUnavailable as reason:
        rows = run_slices["row"].values
        under = surfaces[_needed(surfaces)].isel(y=rows).load()
        data = run_slices.assign(
            grey=run_slices["grey"].copy(data=_greys(run_slices["grey"].values, scale)),
            row=("slice", np.arange(rows.size)),
        )
        note = f"the {rows.size} that the run keeps, as {reason}"
    cuts = [take_slice(data, under, k) for k in range(data.sizes["slice"])]
    cuts = [cut for cut in cuts if any(np.isfinite(line).any() for line in cut.lines.values())]
    thinned = ""
    while cuts:
        stack = _stack(cuts, facts.name, Frame.of(surfaces), f"{note}{thinned}")
        if stack.letters() <= budget:
            return stack
        cuts = cuts[::2] if len(cuts) > 1 else []
        thinned = f", thinned out to {len(cuts)}"
    return None


class _VolumeUnavailable(Exception):
    """Why no slices are read from the volume, in words that end a sentence."""


def _from_volume(
    run: Run, facts: LayerFacts, surfaces: xr.Dataset, scale: Scale, compute: Compute, progress: Progress
) -> tuple[xr.Dataset, xr.Dataset, int]:
    """Slices as the run keeps them, with the surfaces in their rows, and how many rows of voxels apart they are."""
    try:
        params = volume_params(run, facts, progress)
        if is_section_folder(params.path):
            raise _VolumeUnavailable(f"{facts.source.name} holds sections, which would have to be aligned again")
        volume = read_whole(params, compute, progress)
    except PlanishError as error:
        progress("slices", f"only those of the run: {error.text}")
        raise _VolumeUnavailable(f"{facts.source.name} was not there unchanged when this page was made") from error
    frame = Frame.of(surfaces)
    depth = volume.coords[frame.through].values
    wide = round(_pitch(surfaces["y"].values) / _pitch(volume.coords[frame.rows].values))
    rows = surfaces.sizes["y"]
    step = max(math.ceil(2 / wide), math.ceil(rows / _MOST))  # every second row, where there is room
    chosen = np.arange(step // 2, rows, step) if rows > step else np.array([0])
    under = surfaces[_needed(surfaces)].isel(y=chosen).load()
    low, high = _span(under, depth)
    voxels = chosen * wide + wide // 2
    every = math.ceil(volume.sizes[frame.cols] / _WIDEST)
    grey = _read(volume, frame, voxels, slice(low, high), every, scale, progress)
    x = volume.coords[frame.cols].values[: grey.shape[2] * every].reshape(-1, every).mean(axis=1)
    coords = {"slice": volume.coords[frame.rows].values[voxels], "height": depth[low:high], "x": x}
    data = xr.Dataset({"grey": (("slice", "height", "x"), grey)}, coords=coords)
    return data.assign(row=("slice", np.arange(chosen.size))), under, step * wide


def _needed(surfaces: xr.Dataset) -> list[str]:
    return [name for name, *_ in LINES if name in surfaces] + ["thickness"]


def _pitch(places: NDArray[Any]) -> float:
    return float(places[1] - places[0]) if places.size > 1 else 1.0


def _span(surfaces: xr.Dataset, depth: NDArray[Any]) -> tuple[int, int]:
    """Give the first and last plane of the volume that hold the surfaces, with a margin."""
    heights = np.concatenate([surfaces[name].values.ravel() for name in surfaces.data_vars if name != "thickness"])
    heights = heights[np.isfinite(heights)]
    if not heights.size:
        return 0, depth.size
    margin = _margin(np.abs(surfaces["thickness"].values))
    inside = np.flatnonzero((depth >= heights.min() - margin) & (depth <= heights.max() + margin))
    return int(inside[0]), int(inside[-1]) + 1


def _margin(thickness_um: NDArray[Any]) -> float:
    finite = thickness_um[np.isfinite(thickness_um)]
    return max(0.3 * float(np.median(finite)) if finite.size else 0.0, 20.0)


def _read(
    volume: xr.DataArray, frame: Frame, rows: NDArray[np.intp], depth: slice, every: int, scale: Scale,
    progress: Progress,
) -> NDArray[np.uint8]:  # fmt: skip
    """Grey values (rows, depth, cols), of every ``every`` columns the mean, read in whole blocks along z."""
    cols = volume.sizes[frame.cols] // every
    out = np.zeros((rows.size, depth.stop - depth.start, cols), np.uint8)
    step = int(rows[1] - rows[0]) if rows.size > 1 else 1
    for block in _blocks(volume, frame, rows, depth):
        is_inside, heights = np.ones(rows.size, bool), block
        if frame.rows == "z":
            is_inside, heights = (rows >= block.start) & (rows < block.stop), depth
        if not is_inside.any():
            continue
        progress("slices", f"{frame.rows} of the volume, planes {block.start} to {block.stop}")
        # Evenly spaced places as a slice, by which lazy arrays read no more than they must.
        first, last = rows[is_inside][[0, -1]].tolist()
        box = {frame.rows: slice(first, last + 1, step), frame.through: heights, frame.cols: slice(None)}
        part = read_box(volume, box)
        if every > 1:
            part = part[:, :, : cols * every].reshape(*part.shape[:2], cols, every).mean(axis=3)
        out[is_inside, heights.start - depth.start : heights.stop - depth.start] = _greys(part, scale)
    return out


def _blocks(volume: xr.DataArray, frame: Frame, rows: NDArray[np.intp], depth: slice) -> Iterator[slice]:
    """Parts of the volume along z, so that each plane of a file, or chunk of a store, is read once."""
    whole = chunks_of(volume)[0]
    sizes = {frame.rows: rows.size, frame.cols: volume.sizes[frame.cols], frame.through: depth.stop - depth.start}
    plane = math.prod(size for axis, size in sizes.items() if axis != "z")
    long = max(SLICES_VOXELS // max(plane, 1) // whole, 1) * whole
    first, last = (int(rows[0]), int(rows[-1]) + 1) if frame.rows == "z" else (depth.start, depth.stop)
    for begin in range(first // whole * whole, last, long):
        yield slice(max(begin, first), min(begin + long, last))


def _greys(values: NDArray[Any], scale: Scale) -> NDArray[np.uint8]:
    """Grey values in 8 bits; what is missing is black."""
    share = (np.asarray(values, dtype=np.float32) - scale.low) / (scale.high - scale.low)
    return np.rint(255 * np.clip(np.nan_to_num(share, nan=0.0), 0, 1)).astype(np.uint8)


def _stack(cuts: list[Slice], sheet: str, frame: Frame, note: str) -> Stack:
    """Cut every slice to the sheet in it, all to the same height, and pack it."""
    x, heights = cuts[0].x, cuts[0].heights
    dx, dz = _pitch(x), abs(_pitch(heights))
    margin = _margin(np.stack([np.abs(cut.lines["top"] - cut.lines["bottom"]) for cut in cuts]))
    windows = [cut.window(float(x[0]), float(x[-1]), margin) for cut in cuts]
    rows = min(math.ceil(max(high - low for _, _, low, high in windows) / dz) + 1, heights.size)
    first = [
        int(np.clip(round((heights[0] - (low + high) / 2) / dz - (rows - 1) / 2), 0, heights.size - rows))
        for _, _, low, high in windows
    ]
    kind, pictures = _pictures([cut.grey[top : top + rows] for cut, top in zip(cuts, first, strict=True)])
    every = max(1, math.ceil(x.size / _POINTS))
    lines = {
        name: packed(np.round(np.stack([cut.lines[name][::every] for cut in cuts]) / (dz / 16)) * (dz / 16), bits=16)
        for name, *_ in LINES if any(np.isfinite(cut.lines[name]).any() for cut in cuts)
    }  # fmt: skip
    about = {
        "sheet": sheet, "rows": frame.rows, "cols": frame.cols, "through": frame.through, "sign": frame.sign,
        "at": [cut.place_um for cut in cuts], "top": [float(heights[top]) + dz / 2 for top in first],
        "start": float(x[0]) - dx / 2, "size": (x.size * dx, rows * dz),
        "ends": np.cumsum([len(picture) for picture in pictures]).tolist(), "kind": kind, "pictures": "",
        "points": (float(x[0]), every * dx),
    }  # fmt: skip
    return Stack(
        about=about, pictures=pictures, lines=lines,
        used=packed(np.where(np.stack([cut.used[::every] for cut in cuts]), 1.0, np.nan)),
        note=f"{len(cuts)} slices across {frame.rows}: {note}; pixels of {dx:.4g} um, lossy pictures",
    )  # fmt: skip


def _pictures(greys: list[NDArray[Any]]) -> tuple[str, tuple[str, ...]]:
    """Compress pictures; where Pillow has no WebP, as JPEG."""
    from PIL import Image, features

    kind = "webp" if features.check("webp") else "jpeg"
    pictures: list[str] = []
    for grey in greys:
        image = Image.fromarray(grey.astype(np.uint8))
        if image.height > _HIGHEST:
            image = image.resize((image.width, _HIGHEST), Image.Resampling.BOX)
        data = io.BytesIO()
        image.convert("RGB").save(data, format=kind.upper(), quality=38)  # their grains are noise
        pictures.append(base64.b64encode(data.getvalue()).decode("ascii"))
    return kind, tuple(pictures)
