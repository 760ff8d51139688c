"""All pictures of a session: the maps of a run and the images beside them.

Each is read by window, at every level.
"""

import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr

from planish.analyze.compare import is_property
from planish.app.picture import (
    TILE,
    ComputedLevels,
    Plane,
    PlanePicture,
    Stored,
    cache_folder,
    layer_run,
)
from planish.app.strain import strains
from planish.core.area import middles, overview_count
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.core.labelled import variable_data
from planish.core.lazy import LazyArray, Where
from planish.core.memory import TILE_BYTES
from planish.core.typing import Array, Ints, Shape2D, Singles, Window
from planish.io import ImageParams, fingerprint
from planish.io.image import across, channel_of
from planish.io.light import read_corrected
from planish.io.map_store import CHUNK, overviews_of, stored_group
from planish.io.picture import DecodedPicture, is_mapped, load_picture
from planish.io.sizes import PIXEL, agreed_size
from planish.run.named_maps import EXPLAINED, OCTAVES
from planish.run.overlay import LINKED
from planish.run.run import MAPS, open_results, study_of

_PLACES = ("u", "v", "volume_x", "volume_y", "volume_z", "projected_u", "projected_v")


class Pictures:
    """All pictures of a session, by their ids."""

    def __init__(self, pictures: Iterable[PlanePicture]) -> None:
        self._by_id = {f"p{k}": replace(picture, id=f"p{k}") for k, picture in enumerate(pictures)}

    @classmethod
    def of(cls, run: Path, image: ImageParams | None = None) -> Self:
        """Find the pictures of a run folder, and of the image that it shall be linked to.

        Raises
        ------
        FileError
            If the run or the image is damaged or not there.
        """
        pictures = [*_of_run(run)]
        if image is not None:
            pictures.append(image_picture(image, plane="fixed", layer="image", name="image"))
        return cls(pictures)

    def __iter__(self) -> Iterator[PlanePicture]:
        """In the order in which a page lists them."""
        return iter(self._by_id.values())

    def __getitem__(self, id: str) -> PlanePicture:
        """The picture with an id; InputError where there is none."""
        if id not in self._by_id:
            raise InputError(f"This session has no picture {id[:20]!r}.")
        return self._by_id[id]

    def on_same_pixels(self, picture: PlanePicture) -> list[PlanePicture]:
        """All pictures on the pixels of a picture, itself among them."""
        grid = picture.grid
        geometry = [*grid.origin_um, *grid.pixel_um]
        same_size = [p for p in self if p.plane == picture.plane and p.grid.shape == grid.shape]
        return [
            p for p in same_size if np.allclose([*p.grid.origin_um, *p.grid.pixel_um], geometry)
        ]

    def on(self, plane: Plane, layer: str) -> list[PlanePicture]:
        """All pictures of a plane: of a moving one, those of its layer."""
        return [p for p in self if p.plane == plane and (plane == "fixed" or p.layer == layer)]

    def valid_of(self, *pictures: PlanePicture) -> list[PlanePicture]:
        """The masks that say where values of pictures count."""
        layers = {p.layer for p in pictures}
        masks = [p for p in self.on_same_pixels(pictures[0]) if p.variable == "valid"]
        return [p for p in masks if p.layer in layers]


def _of_run(run: Path) -> Iterator[PlanePicture]:
    """Pictures of a run: of each layer by itself, on the reference, and of what was made of all.

    Names begin with that of the layer where several layers have maps of one name.
    """
    results = open_results(run)
    study = study_of(run, results)
    if not results.is_link:
        name = results.layers[0].name
        yield from _sheet(run, layer=name, prefix="")
        for group in (EXPLAINED, OCTAVES):
            yield from group_pictures(run, group, plane="moving", layer=name)
        return
    images = {params.name: params.image for params in study.layers}
    for layer in results.moving:
        name = layer.name
        image = images[name]
        prefix = "" if study.is_sheet_on_image else f"{name}/"
        if image is None:
            yield from _sheet(layer_run(run, name), layer=name, prefix=prefix)
        elif Path(image.path).is_file():
            yield image_picture(image, plane="moving", layer=name, name=f"{prefix}image")
    reference = results.reference.name
    groups = [(LINKED, reference, "")]
    if not study.is_sheet_on_image:
        groups = [(f"layers/{x.name}", x.name, f"{x.name}/") for x in results.layers]
    groups += [(EXPLAINED, reference, ""), (OCTAVES, reference, "")]
    for group, name, prefix in (*groups, ("refined", "refined", "refined/")):
        yield from group_pictures(run, group, plane="fixed", layer=name, prefix=prefix)


def _sheet(run: Path, *, layer: str, prefix: str) -> Iterator[PlanePicture]:
    """The flat maps of a sheet, and what flattening did to it, where the run has it."""
    maps = [*group_pictures(run, "maps", plane="moving", layer=layer, prefix=prefix)]
    yield from maps
    if not (run / MAPS / "strain").is_dir():
        return
    levels_of = {picture.name.removeprefix(prefix): picture.levels for picture in maps}
    for name, display, levels in strains(run, levels_of):
        yield PlanePicture(
            plane="moving",
            layer=layer,
            name=prefix + name,
            title=display.title,
            units=display.units,
            levels=Stored(levels),
            around_zero=True,
        )


def group_pictures(
    run: Path, group: str, *, plane: Plane, layer: str, prefix: str = ""
) -> Iterator[PlanePicture]:
    """The maps of a group of a run: images and properties first, places last.

    Parameters
    ----------
    run : path
    group : str
        Name of the group in the store of the run.
    plane : {"moving", "fixed"}
        Plane that they are shown in.
    layer : str
        Layer that they are of.
    prefix : str
        Begins their names.

    Yields
    ------
    PlanePicture
    """
    store = run / MAPS
    if not (store / group).is_dir():
        return
    groups = [stored_group(store, level) for level in (group, *overviews_of(store, group))]
    # Codes have no mean: no smaller copies.
    maps = [m for m in groups[0].values() if m.ndim == 2 and m.dtype.kind in "fb"]
    for data in sorted(maps, key=_sort_key):
        name = str(data.name)
        levels: Sequence[xr.DataArray] = Stored(level[name] for level in groups if name in level)
        if len(levels) <= overview_count(data.shape):
            folder = cache_folder(store / "zarr.json", group, name)
            levels = _on_grids(ComputedLevels(data, folder), Grid.of(data))
        yield PlanePicture(
            plane=plane,
            layer=layer,
            name=prefix + name,
            title=str(data.attrs.get("long_name", name)),
            units=str(data.attrs.get("units", "")),
            levels=levels,
        )


def _sort_key(data: xr.DataArray) -> tuple[int, str]:
    """First the image, then properties, other values, standard errors, places; each by name."""
    name = str(data.name)
    is_value = name not in _PLACES
    is_of_rank = (
        name == "image",
        is_property(data),
        is_value and not name.endswith("_se"),
        is_value,
        True,
    )
    return is_of_rank.index(True), name


def _on_grids(levels: ComputedLevels, grid: Grid) -> list[xr.DataArray]:
    arrays: list[xr.DataArray] = []
    coords = {"y": grid.y_um, "x": grid.x_um}
    for level in levels.levels():
        variable = xr.Variable(("y", "x"), variable_data(level))
        arrays.append(xr.DataArray(variable, coords=coords))
        coords = {axis: middles(um) for axis, um in coords.items()}
    return arrays


def image_picture(params: ImageParams, *, plane: Plane, layer: str, name: str) -> PlanePicture:
    """Give the picture of an image file that no store holds.

    It is as :func:`planish.read_image` reads it, with its errors.
    """
    path = Path(params.path)
    header = load_picture(path, decode=False)
    (row_um, col_um), _ = agreed_size(
        across(header.stated),
        params.pixel_um,
        file_name=path.name,
        asked=PIXEL,
        override=params.override_size,
        unusual=params.unusual_size,
    )
    first_pixel = header._replace(values=header.values[:1, :1])
    _, title = channel_of(first_pixel, params.channel, file_name=path.name)
    rows, cols = header.values.shape[:2]
    options = params.model_dump_json(include={"channel", "gamma", "white_exposure"})
    references = filter(None, (params.white, params.dark))
    hashes = [*map(fingerprint, references)]
    folder = cache_folder(path, "image", options, *hashes)
    keep_all = params.white is not None or not is_mapped(path)
    levels = ComputedLevels(_ImageValues(params, (rows, cols)), folder, keep_all=keep_all)
    grid = Grid.regular((rows, cols), (row_um, col_um))
    return PlanePicture(
        plane=plane,
        layer=layer,
        name=name,
        title=title,
        units="1",
        levels=_on_grids(levels, grid),
    )


class _ImageValues(LazyArray):
    """One channel of an image file.

    Decoded when a window is read for the first time, where the file is not mapped.
    """

    def __init__(self, params: ImageParams, shape: Shape2D) -> None:
        self._params = params
        self.shape = shape
        self.dtype = np.dtype(np.float32)
        self._lock = threading.Lock()
        self._decoded: DecodedPicture | None = None
        self._corrected: Singles | None = None

    def read(self, where: Where) -> Singles:
        """Read a window."""
        params = self._params
        path = Path(self._params.path)
        with self._lock:
            if params.white is not None:
                if self._corrected is None:
                    self._corrected = read_corrected(params)[0].values
                return self._corrected[where]
            if self._decoded is None:
                self._decoded = load_picture(path)
        window = self._decoded._replace(values=self._decoded.values[where])
        return channel_of(window, params.channel, file_name=path.name, gamma=params.gamma)[0]


Key = tuple[str, int, int, int]


class Tiles:
    """Windows of pictures, block by block; ``read_bytes`` counts all that were read so far."""

    def __init__(self, pictures: Pictures, *, most_bytes: int = TILE_BYTES) -> None:
        self.pictures = pictures
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._blocks = OrderedDict[Key, Future[Array]]()
        self._held_bytes = 0
        self.read_bytes = 0

    def tile(self, id: str, level: int, row: int, col: int) -> bytes:
        """Codes of one tile: TILE x TILE little-endian 16-bit values, row by row.

        0 where there is no picture.

        Raises
        ------
        InputError
            If there is no such picture, level or tile.
        FileError
            If the picture is damaged.
        """
        picture = self.pictures[id]
        if not 0 <= level < len(picture.levels):
            raise InputError(
                f"{picture.name} has {len(picture.levels)} levels; there is no level {level}."
            )
        rows, cols = picture.levels[level].shape
        if not (0 <= row * TILE < rows and 0 <= col * TILE < cols):
            raise InputError(f"Level {level} of {picture.name} has no tile {row}, {col}.")
        tile_rows = slice(row * TILE, min((row + 1) * TILE, rows))
        tile_cols = slice(col * TILE, min((col + 1) * TILE, cols))
        window_codes = picture.codes.of(self.window(picture, level, tile_rows, tile_cols))
        codes = np.zeros((TILE, TILE), "<u2")
        n_rows, n_cols = window_codes.shape
        codes[:n_rows, :n_cols] = window_codes
        return codes.tobytes()

    def window(self, picture: PlanePicture, level: int, rows: slice, cols: slice) -> Array:
        """Values of a window of a level."""
        shape = (rows.stop - rows.start, cols.stop - cols.start)
        pixels = np.empty(shape, picture.levels[level].dtype)
        for i in range(rows.start // CHUNK, -(-rows.stop // CHUNK)):
            for j in range(cols.start // CHUNK, -(-cols.stop // CHUNK)):
                block = self.block(picture, level, i, j)
                to_rows, from_rows = _overlap(rows, i, block.shape[0])
                to_cols, from_cols = _overlap(cols, j, block.shape[1])
                pixels[to_rows, to_cols] = block[from_rows, from_cols]
        return pixels

    def values_at(self, picture: PlanePicture, level: int, rows: Ints, cols: Ints) -> Array:
        """Values of single pixels (n,) of a level."""
        pixels = np.empty(rows.size, picture.levels[level].dtype)
        block_rows = rows // CHUNK
        block_cols = cols // CHUNK
        for i, j in {*zip(block_rows.tolist(), block_cols.tolist(), strict=True)}:
            is_in = (block_rows == i) & (block_cols == j)
            block = self.block(picture, level, i, j)
            pixels[is_in] = block[rows[is_in] % CHUNK, cols[is_in] % CHUNK]
        return pixels

    def block(self, picture: PlanePicture, level: int, i: int, j: int) -> Array:
        """The i-th block down and j-th across, of CHUNK pixels a side or what there are.

        Whoever asks for it while it is read waits for the same one. Of the blocks that are held,
        the one that was not asked for the longest goes first.
        """
        key = (picture.id, level, i, j)
        with self._lock:
            new_future = Future[Array]()
            future = self._blocks.setdefault(key, new_future)
            self._blocks.move_to_end(key)
        if future is not new_future:
            return future.result()
        try:
            rows = slice(i * CHUNK, (i + 1) * CHUNK)
            cols = slice(j * CHUNK, (j + 1) * CHUNK)
            block = picture.levels[level][rows, cols].values
        except BaseException as error:
            with self._lock:
                self._blocks.pop(key, None)
            new_future.set_exception(error)
            raise
        new_future.set_result(block)
        with self._lock:
            self.read_bytes += block.nbytes
            self._held_bytes += block.nbytes
            while self._held_bytes > self._most_bytes:
                oldest = next(iter(self._blocks))
                if oldest == key:
                    break
                if self._blocks[oldest].done():
                    self._held_bytes -= self._blocks.pop(oldest).result().nbytes
                else:
                    self._blocks.move_to_end(oldest)
        return block


def _overlap(window: slice, k: int, length: int) -> Window:
    """Part of a window that the k-th block covers, from the window's start and the block's.

    ``length`` of the block, along the axis of both.
    """
    first = k * CHUNK
    start = max(window.start, first)
    stop = min(window.stop, first + length)
    in_window = slice(start - window.start, stop - window.start)
    return in_window, slice(start - first, stop - first)
