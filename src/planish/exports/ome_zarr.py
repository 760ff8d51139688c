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
    """Write maps as one float32 image (y, x), or (c, y, x) of several, placed in um.

    Its levels are the maps and their overviews, each half as fine and made of means of known
    pixels. Chunks that the run's store holds with the same bytes are copied.
    """
    names = maps.names
    group = zarr.open_group(path, mode="w-", zarr_format=3)
    has_channels = len(names) > 1
    dims = ["c", "y", "x"] if has_channels else ["y", "x"]
    rows, cols = maps.shape
    arrays: list[Any] = []  # of the levels, the finest first
    for level in range(1 + overview_count(maps.shape)):
        # A single map has no axis of channels: the first of three numbers falls away.
        shape = (len(names), rows, cols)
        chunk = (1, min(rows, BAND), min(cols, BAND))
        array = group.create_array(
            str(level),
            shape=shape[-len(dims) :],
            dtype=np.float32,
            chunks=chunk[-len(dims) :],
            fill_value=np.nan,
            compressors=CODECS,
            dimension_names=dims,
            config={"write_empty_chunks": True},
        )
        arrays.append(array)
        rows = (rows + 1) // 2
        cols = (cols + 1) // 2
    windows: list[dict[str, float]] = []
    for k, name in enumerate(names):
        channel = (k,) if has_channels else ()  # what comes before rows in an index
        levels = maps.levels.get(name, ())
        if not _copied(path, levels, len(arrays), channel):
            _fill(arrays, maps, name, channel)
        coarsest = np.asarray(arrays[-1][(*channel, ...)])
        windows.append(_window(coarsest))
    group.attrs.update(_attributes(maps, windows, len(arrays), history))


def _fill(arrays: list[Any], maps: Maps, name: str, channel: Shape) -> None:
    """Write a map into its channel of all levels, each overview from the level before it."""
    for rows, band in maps.bands(name, np.float32):
        arrays[0][(*channel, rows)] = band
    for finer, coarser in pairwise(arrays):
        for rows in bands(coarser.shape[-2]):
            finer_rows = slice(2 * rows.start, 2 * rows.stop)
            finer_values = summable(maps.data[name], finer[(*channel, finer_rows)])
            coarser[(*channel, rows)] = halved_values(finer_values)


def _window(overview: Singles) -> dict[str, float]:
    """Extremes of a map, and the limits between which it is shown first, for OMERO."""
    low, high = percentile_limits(overview)
    window = {"min": 0.0, "max": 1.0, "start": low, "end": high}
    finite = overview[np.isfinite(overview)]
    if finite.size:
        window["min"] = float(finite.min())
        window["max"] = float(finite.max())
    return window


def _copied(path: Path, run_folders: Sequence[Path], n_levels: int, channel: Shape) -> bool:
    """Copy the chunks of a map and its overviews, ``run_folders``, into a channel of the image.

    False, and nothing is done, where their bytes are not those that the image would have: arrays
    may differ only in a first axis.
    """
    image_folders = [path / str(k) for k in range(n_levels)]
    if [*map(_layout, run_folders)] != [*map(_layout, image_folders)]:
        return False
    for run_folder, image_folder in zip(run_folders, image_folders, strict=True):
        channel_folder = image_folder.joinpath("c", *map(str, channel))
        shutil.copytree(
            run_folder / "c", channel_folder, copy_function=shutil.copyfile, dirs_exist_ok=True
        )
    return True


def _layout(folder: Path) -> list[Any]:
    """What the bytes of an array's chunks depend on, of its last two axes."""
    metadata = json.loads((folder / "zarr.json").read_text(encoding="utf-8"))
    keys = ("data_type", "codecs", "chunk_key_encoding", "fill_value")
    values = [metadata[key] for key in keys]
    chunk = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    return [values, chunk[-2:], metadata["shape"][-2:]]


def _attributes(
    maps: Maps, windows: list[dict[str, float]], n_levels: int, history: ExportHistory
) -> Entries:
    """What the image says of itself: its levels and places, its channels, and the history."""
    names = maps.names
    title = names[0]
    axes = "yx"
    if len(names) > 1:
        title = maps.group
        axes = "cyx"
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
