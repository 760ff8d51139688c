"""All pictures of a session: the maps of a run and the images beside them, each read by window, at every level."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.computed_levels import ComputedLevels, cache_place
from planish.app.picture import Picture, Plane, Stored
from planish.app.strain import strains
from planish.core.area import count_of, middles
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.core.lazy import LazyArray, Where, held
from planish.io import ImageParams
from planish.io.image import across, channel_of
from planish.io.map_store import OVERVIEWS, stored_group
from planish.io.picture import DecodedPicture, is_mapped, load_picture
from planish.io.sizes import PIXEL, agreed_size
from planish.pipeline.compare import is_property
from planish.pipeline.linking import LINKED
from planish.pipeline.run import MAPS, is_run, open_results
from planish.study import LayerParams, read_study

_PLACES = ("u", "v", "volume_x", "volume_y", "volume_z", "projected_u", "projected_v")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFile:
    """An image that no store holds, as :func:`planish.read_image` reads it.

    ``pixel_um`` is the pixel that was agreed upon, along y and x.
    """

    path: Path
    pixel_um: tuple[float, float]
    channel: str = "luminance"
    layer: str = "image"

    @classmethod
    def of(cls, params: ImageParams, layer: str = "image") -> Self:
        """As options ask for it; SizeError where the pixel size is not known."""
        path = Path(params.path)
        stated = across(load_picture(path, decode=False).stated)
        size, _ = agreed_size(
            stated, params.pixel_um, file_name=path.name, asked=PIXEL, override=params.override_size,
            unusual=params.unusual_size,
        )  # fmt: skip
        return cls(path=path, pixel_um=(size[0], size[1]), channel=params.channel, layer=layer)


class Pictures:
    """All pictures of a session, by their ids."""

    def __init__(self, pictures: Iterable[Picture]) -> None:
        self._by_id = {picture.id: picture for picture in (replace(p, id=f"p{k}") for k, p in enumerate(pictures))}

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
            pictures.append(image_picture(ImageFile.of(image), plane="fixed", name="image"))
        return cls(pictures)

    def __iter__(self) -> Iterator[Picture]:
        """In the order in which a page lists them."""
        return iter(self._by_id.values())

    def __getitem__(self, id: str) -> Picture:
        """The picture with an id; InputError where there is none."""
        if id not in self._by_id:
            raise InputError(f"This session has no picture {id[:20]!r}.")
        return self._by_id[id]

    def on_same_pixels(self, picture: Picture) -> list[Picture]:
        """All pictures on the pixels of a picture, itself among them."""
        return [p for p in self if p.plane == picture.plane and _same_pixels(p, picture)]

    def on(self, plane: Plane, layer: str) -> list[Picture]:
        """All pictures of a plane: of a moving one, those of its layer."""
        return [p for p in self if p.plane == plane and (plane == "fixed" or p.layer == layer)]

    def valid_of(self, *pictures: Picture) -> list[Picture]:
        """The masks that say where values of pictures count."""
        layers = {p.layer for p in pictures}
        return [p for p in self.on_same_pixels(pictures[0]) if p.layer in layers and p.name.split("/")[-1] == "valid"]

    def described(self) -> list[dict[str, Any]]:
        """What a page has to know of all of them, as JSON has it."""
        return [picture.facts.model_dump() for picture in self]


def _same_pixels(a: Picture, b: Picture) -> bool:
    return a.grid.shape == b.grid.shape and np.allclose(
        [*a.grid.origin_um, *a.grid.pixel_um], [*b.grid.origin_um, *b.grid.pixel_um]
    )


def _of_run(run: Path) -> Iterator[Picture]:
    """The pictures of a run: of every moving layer, then of what lies on the reference."""
    results, study = open_results(run), read_study(run / "run.toml")
    if not results.is_link:
        yield from _sheet(run, layer=results.layers[0].name, prefix="")
        return
    together = study.is_sheet_on_image
    for facts in results.moving:
        params = next(layer for layer in study.layers if layer.name == facts.name)
        yield from _moving(run, params, prefix="" if together else f"{facts.name}/")
    if together:
        yield from group_pictures(run, LINKED, plane="fixed", layer=results.reference.name)
        yield from group_pictures(run, "refined", plane="fixed", layer="refined", prefix="refined/")
        return
    for layer in results.layers:
        yield from group_pictures(run, f"layers/{layer.name}", plane="fixed", layer=layer.name, prefix=f"{layer.name}/")


def _moving(run: Path, params: LayerParams, *, prefix: str) -> Iterator[Picture]:
    """A moving layer on its own plane: the maps of a sheet, or an image."""
    if params.image is not None:
        if Path(params.image.path).is_file():
            yield image_picture(ImageFile.of(params.image, params.name), plane="moving", name=f"{prefix}image")
        return
    inner = run / "layers" / params.name
    yield from _sheet(inner if is_run(inner) else run, layer=params.name, prefix=prefix)


def _sheet(run: Path, *, layer: str, prefix: str) -> Iterator[Picture]:
    """The maps of a sheet on its own plane, and the strains of its flattening."""
    maps = [*group_pictures(run, "maps", plane="moving", layer=layer, prefix=prefix)]
    yield from maps
    places = {picture.name.removeprefix(prefix): picture.levels for picture in maps}
    for name, strain, levels in strains(run, places) if (run / MAPS / "strain").is_dir() else ():
        yield Picture(
            id="", plane="moving", layer=layer, name=prefix + name, title=strain.title, units=strain.units,
            levels=Stored(levels), around_zero=True,
        )  # fmt: skip


def group_pictures(run: Path, group: str, *, plane: Plane, layer: str, prefix: str = "") -> Iterator[Picture]:
    """The maps of a group of a run: images and properties first, places last."""
    path = run / MAPS
    if not (path / group).is_dir():
        return
    full, smaller = stored_group(path, group), [*_overviews(path, group)]
    shape = tuple(full.sizes.values())
    maps = {str(name): data for name, data in full.data_vars.items() if data.ndim == 2}
    for name in sorted(maps, key=lambda name: _order(maps[name])):
        data = maps[name]
        if data.dtype.kind not in "fb":  # codes have no mean: no smaller copies
            continue
        levels: Sequence[xr.DataArray] = Stored((data, *(one[name] for one in smaller if name in one)))
        if len(levels) <= count_of(shape):
            levels = _on_grids(ComputedLevels(data, cache_place(path / "zarr.json", group, name)), Grid.of(data))
        yield Picture(
            id="", plane=plane, layer=layer, name=prefix + name, title=str(data.attrs.get("long_name", name)),
            units=str(data.attrs.get("units", "")), levels=levels,
        )  # fmt: skip


def _overviews(path: Path, group: str) -> Iterator[xr.Dataset]:
    k = 1
    while (path / OVERVIEWS / group / str(k)).is_dir():
        yield stored_group(path, f"{OVERVIEWS}/{group}/{k}")
        k += 1


def _order(data: xr.DataArray) -> tuple[int, str]:
    name = str(data.name)
    kinds = (name == "image", is_property(data), name not in _PLACES and not name.endswith("_se"), name not in _PLACES)
    return (kinds.index(True) if True in kinds else len(kinds)), name


def _on_grids(levels: ComputedLevels, grid: Grid) -> list[xr.DataArray]:
    """Levels with the coordinates of their pixels."""
    arrays: list[xr.DataArray] = []
    y, x = grid.y_um, grid.x_um
    for level in levels.levels():
        arrays.append(xr.DataArray(xr.Variable(("y", "x"), held(level)), coords={"y": y, "x": x}))
        y, x = middles(y), middles(x)
    return arrays


def image_picture(file: ImageFile, *, plane: Plane, name: str) -> Picture:
    """The picture of an image file.

    Raises
    ------
    FileError
        If it is damaged or of another format.
    InputError
        If it has no such channel.
    """
    head = load_picture(file.path, decode=False)
    _, title = channel_of(replace(head, values=head.values[:1, :1]), file.channel, file_name=file.path.name)
    rows, cols = head.values.shape[:2]
    place = cache_place(file.path, "image", file.channel)
    levels = ComputedLevels(_ImageValues(file, (rows, cols)), place, keep_all=not is_mapped(file.path))
    return Picture(
        id="", plane=plane, layer=file.layer, name=name, title=title, units="1",
        levels=_on_grids(levels, Grid.regular((rows, cols), file.pixel_um)),
    )  # fmt: skip


class _ImageValues(LazyArray):
    """One channel of an image file; decoded when a window is read for the first time, where the file is not mapped."""

    def __init__(self, file: ImageFile, shape: tuple[int, int]) -> None:
        self._file, self.shape, self.dtype = file, shape, np.dtype(np.float32)
        self._opening = threading.Lock()
        self._picture: DecodedPicture | None = None

    def read(self, where: Where) -> NDArray[np.float32]:
        """Read a window."""
        with self._opening:
            if self._picture is None:
                self._picture = load_picture(self._file.path)
        part = replace(self._picture, values=self._picture.values[where])
        return channel_of(part, self._file.channel, file_name=self._file.path.name)[0]
