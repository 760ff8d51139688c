"""OME-Zarr 0.5: maps as an image of several resolutions.

Chunks of a run's store are copied, others are written.
"""

import json
import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from planish.core.area import halved_values, overview_count
from planish.core.axial import summable
from planish.core.bands import BAND, bands
from planish.core.typing import Entries, Shape, Singles
from planish.exports.content import ExportHistory, Maps, percentile_limits
from planish.exports.formats import ExportParams
from planish.io.map_chunks import CODECS
from planish.io.store import multiscale


def write(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write maps as one float32 image (y, x), or (c, y, x), placed in um.

    Overviews are means of known pixels.
    """
    names = maps.names
    shapes = [maps.shape]
    has_channels = len(names) > 1
    group = zarr.open_group(path, mode="w-", zarr_format=3)
    for _ in range(overview_count(maps.shape)):
        rows, cols = shapes[-1]
        shapes.append(((rows + 1) // 2, (cols + 1) // 2))
    dims = ["c", "y", "x"] if has_channels else ["y", "x"]
    arrays: list[Any] = []
    for level, level_shape in enumerate(shapes):
        chunk = [min(n, BAND) for n in level_shape]
        array = group.create_array(
            str(level),
            shape=(len(names), *level_shape)[-len(dims) :],
            dtype=np.float32,
            chunks=(1, *chunk)[-len(dims) :],
            fill_value=np.nan,
            compressors=CODECS,
            dimension_names=dims,
            config={"write_empty_chunks": True},
        )
        arrays.append(array)
    windows: list[dict[str, float]] = []
    for k, name in enumerate(names):
        channel = (k,) if has_channels else ()
        if not _copied(path, maps.levels.get(name, ()), len(arrays), channel):
            for rows, band in maps.bands(name, np.float32):
                arrays[0][(*channel, rows)] = band
            for finer, coarser in pairwise(arrays):
                for rows in bands(coarser.shape[-2]):
                    finer_rows = finer[(*channel, slice(2 * rows.start, 2 * rows.stop))]
                    coarser[(*channel, rows)] = halved_values(summable(maps.data[name], finer_rows))
        windows.append(_window(np.asarray(arrays[-1][(*channel, ...)])))  # of the coarsest
    group.attrs.update(_attributes(maps, windows, len(arrays), history))


def _window(overview: Singles) -> dict[str, float]:
    low, high = percentile_limits(overview)
    finite = overview[np.isfinite(overview)]
    extremes = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return {"min": extremes[0], "max": extremes[1], "start": low, "end": high}


def _copied(path: Path, run_folders: Sequence[Path], n_levels: int, channel: Shape) -> bool:
    """Copy the chunks of a map and its overviews.

    False, and nothing is done, where they are not those of the image.
    """
    image_folders = [path / str(k) for k in range(n_levels)]
    if len(run_folders) != n_levels or not all(map(_alike, run_folders, image_folders)):
        return False
    for run_folder, image_folder in zip(run_folders, image_folders, strict=True):
        channel_folder = image_folder.joinpath("c", *map(str, channel))
        shutil.copytree(
            run_folder / "c", channel_folder, copy_function=shutil.copyfile, dirs_exist_ok=True
        )
    return True


def _alike(source: Path, target: Path) -> bool:
    """Tell whether two arrays differ only in a first axis, so their chunks have the same bytes."""
    return _layout(source) == _layout(target)


def _layout(folder: Path) -> list[Any]:
    """What the bytes of an array's chunks depend on, of its last two axes."""
    metadata = json.loads((folder / "zarr.json").read_text(encoding="utf-8"))
    keys = ("data_type", "codecs", "chunk_key_encoding", "fill_value")
    chunk = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return [*map(metadata.get, keys), chunk[-2:], metadata["shape"][-2:]]


def _attributes(
    maps: Maps, windows: list[dict[str, float]], n_levels: int, history: ExportHistory
) -> Entries:
    names = maps.names
    title, axes = (maps.group, "cyx") if len(names) > 1 else (names[0], "yx")
    multiscales = multiscale(
        title, axes, maps.pixel_um, maps.origin_um, n_levels, kind="mean of 2 x 2 known pixels"
    )
    channels: list[Entries] = []
    for (name, units), window in zip(maps.units.items(), windows, strict=True):
        channel = {"label": f"{name} ({units})", "color": "FFFFFF", "active": name == names[0]}
        channels.append(channel | {"window": window})
    return {
        "ome": {"version": "0.5", "multiscales": [multiscales], "omero": {"channels": channels}},
        "planish": {
            "history": history.json(**maps.facts()),
            "units": maps.units,
            "titles": maps.titles,
        },
    }
