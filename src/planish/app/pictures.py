"""All pictures of a session: the maps of a run and the images beside them, each read by window, at every level."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from planish.app.made_levels import MadeLevels, cache_place
from planish.app.strain import strains
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.core.lazy import Where, held
from planish.core.overviews import count_of, middles
from planish.io import ImageParams
from planish.io.image import across, channel_of
from planish.io.map_store import CHUNK, OVERVIEWS, stored_group
from planish.io.picture import Picture as Decoded
from planish.io.picture import is_mapped, load_picture
from planish.io.sizes import PIXEL, agreed_size
from planish.pipeline.compare import is_property
from planish.pipeline.linking import LINKED
from planish.pipeline.run import MAPS, is_run, open_results
from planish.study import LayerParams, read_study

Plane = Literal["moving", "fixed"]

TILE = 256
"""Pixels along the edge of a tile."""

LAST_CODE = 65535

_PLACES = ("u", "v", "volume_x", "volume_y", "volume_z", "projected_u", "projected_v")
_WINDOW = 256  # pixels along the edge of the parts of a picture that show which values it has
_FEW, _MANY = 2, 4  # such parts along each side, with and without a coarse level
_WIDENED = 2.0  # spans by which their range is widened


class PictureFacts(BaseModel):
    """What a page has to know of a picture; see :class:`Picture`."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    id: str
    plane: Plane
    layer: str
    name: str
    title: str
    units: str
    shape: tuple[int, int]
    pixel_um: tuple[float, float]
    origin_um: tuple[float, float]
    levels: int
    tile: int
    scale: float
    offset: float
    range: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Codes:
    """Values as whole numbers of 16 bits: 0 is missing, k from 1 on is ``offset + scale * (k - 1)``.

    The first and the last code also stand for all values beyond them.
    """

    offset: float
    scale: float

    @classmethod
    def between(cls, low: float, high: float) -> Codes:
        """Codes of all values from ``low`` to ``high``."""
        return cls(low, (high - low) / (LAST_CODE - 1) or 1.0)

    def of(self, values: NDArray[Any]) -> NDArray[np.uint16]:
        """Code each value."""
        if values.dtype == np.bool_:
            return values.astype(np.uint16) + np.uint16(1)
        known = np.isfinite(values)
        found = np.rint((np.where(known, values.astype(np.float64), self.offset) - self.offset) / self.scale) + 1
        return np.where(known, np.clip(found, 1, LAST_CODE), 0).astype(np.uint16)

    def values(self, codes: NDArray[np.uint16]) -> NDArray[np.float64]:
        """The values that codes stand for; NaN where they are missing."""
        return np.where(codes == 0, np.nan, self.offset + self.scale * (codes.astype(np.float64) - 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A map or an image on one of the two planes of a session.

    Attributes
    ----------
    id : str
        By which the page asks for it.
    plane : {"moving", "fixed"}
    layer : str
        Layer that it belongs to.
    name : str
        Variable in the store; with the layer before it where several layers have their own.
    title, units : str
    levels : sequence of DataArray (rows, cols)
        Full resolution first, each next one with pixels twice as wide; values are read where they are asked for.
    around_zero : bool
        Whether 0 is in the middle of its colours.
    """

    id: str
    plane: Plane
    layer: str
    name: str
    title: str
    units: str
    levels: Sequence[xr.DataArray]
    around_zero: bool = False

    @property
    def full(self) -> xr.DataArray:
        """Full resolution."""
        return self.levels[0]

    @cached_property
    def grid(self) -> Grid:
        """Pixels of full resolution."""
        return Grid.of(self.full)

    @property
    def is_mask(self) -> bool:
        """Whether it holds truth values."""
        return self.full.dtype == np.bool_

    def level_within(self, pixels: int) -> int:
        """The finest level of at most so many pixels."""
        fitting = (k for k, data in enumerate(self.levels) if data.size <= pixels)
        return next(fitting, len(self.levels) - 1)

    @cached_property
    def codes(self) -> Codes:
        """How tiles hold its values: room for single pixels, which vary more than the parts that were looked at."""
        values = np.concatenate([self._coarse, self._sample])
        if self.is_mask or values.size == 0:
            return Codes(0.0, 1.0)
        low, high = float(values.min()), float(values.max())
        span = max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-30)
        more = 0.0 if len(self.levels) == 1 else _WIDENED * span
        return Codes.between(low - more, low + span + more)

    @cached_property
    def range(self) -> tuple[float, float]:
        """2nd to 98th percentile."""
        values = self._coarse if self._coarse.size else self._sample
        if self.is_mask or values.size == 0:
            return 0.0, 1.0
        low, high = (float(v) for v in np.percentile(values, [2, 98]))
        if self.around_zero:
            high = max(abs(low), abs(high))
            low = -high
        return (low, high) if high > low else (low - 0.5, high + 0.5)

    @cached_property
    def _coarse(self) -> NDArray[np.float64]:
        """Known values of the coarsest level, where it is there already."""
        there = isinstance(self.levels, _Stored) or len(self.levels) == 1
        return _known([self.levels[-1].values] if there else [])

    @cached_property
    def _sample(self) -> NDArray[np.float64]:
        """Known values of windows all over the picture, each within one chunk."""
        if len(self.levels) == 1:
            return _known([])
        each = _FEW if self._coarse.size else _MANY
        tops, lefts = (
            (np.linspace(0.5, n - 0.5, 2 * each + 1).astype(int)[1::2] // CHUNK * CHUNK).tolist()
            for n in self.full.shape
        )
        return _known([self.full[r : r + _WINDOW, c : c + _WINDOW].values for r in tops for c in lefts])

    @property
    def facts(self) -> PictureFacts:
        """What a page has to know."""
        rows, cols = self.grid.shape
        return PictureFacts(
            id=self.id, plane=self.plane, layer=self.layer, name=self.name, title=self.title, units=self.units,
            shape=(rows, cols), pixel_um=self.grid.pixel_um, origin_um=self.grid.origin_um, levels=len(self.levels),
            tile=TILE, scale=self.codes.scale, offset=self.codes.offset, range=self.range,
        )  # fmt: skip


def _known(parts: Sequence[NDArray[Any]]) -> NDArray[np.float64]:
    values = np.concatenate([np.empty(0), *(part.ravel() for part in parts)]).astype(np.float64)
    return values[np.isfinite(values)]


class _Stored(tuple[xr.DataArray, ...]):
    """Levels that lie in a store."""


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

    def __init__(self, found: Iterable[Picture]) -> None:
        self._by_id = {one.id: one for one in (replace(p, id=f"p{k}") for k, p in enumerate(found))}

    @classmethod
    def of(cls, run: Path, image: ImageParams | None = None) -> Self:
        """Find the pictures of a run folder, and of the image that it shall be linked to.

        Raises
        ------
        FileError
            If the run or the image is damaged or not there.
        """
        found = [*_of_run(run)]
        if image is not None:
            found.append(image_picture(ImageFile.of(image), plane="fixed", name="image"))
        return cls(found)

    def __iter__(self) -> Iterator[Picture]:
        """In the order in which a page lists them."""
        return iter(self._by_id.values())

    def __getitem__(self, id: str) -> Picture:
        """The picture with an id; InputError where there is none."""
        if id not in self._by_id:
            raise InputError(f"This session has no picture {id[:20]!r}.")
        return self._by_id[id]

    def beside(self, picture: Picture) -> list[Picture]:
        """All pictures on the pixels of a picture, itself among them."""
        return [p for p in self if p.plane == picture.plane and _same_pixels(p, picture)]

    def on(self, plane: Plane, layer: str) -> list[Picture]:
        """All pictures of a plane: of a moving one, those of its layer."""
        return [p for p in self if p.plane == plane and (plane == "fixed" or p.layer == layer)]

    def valid_of(self, *pictures: Picture) -> list[Picture]:
        """The masks that say where values of pictures count."""
        layers = {p.layer for p in pictures}
        return [p for p in self.beside(pictures[0]) if p.layer in layers and p.name.split("/")[-1] == "valid"]

    def described(self) -> list[dict[str, Any]]:
        """What a page has to know of all of them, as JSON has it."""
        return [one.facts.model_dump() for one in self]


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
    places = {one.name.removeprefix(prefix): one.levels for one in maps}
    for name, shown, levels in strains(run, places) if (run / MAPS / "strain").is_dir() else ():
        yield Picture(
            id="", plane="moving", layer=layer, name=prefix + name, title=shown.title, units=shown.units,
            levels=_Stored(levels), around_zero=True,
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
        levels: Sequence[xr.DataArray] = _Stored((data, *(one[name] for one in smaller if name in one)))
        if len(levels) <= count_of(shape):
            levels = _on_grids(MadeLevels(data, cache_place(path / "zarr.json", group, name)), Grid.of(data))
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


def _on_grids(made: MadeLevels, grid: Grid) -> list[xr.DataArray]:
    """Levels with the coordinates of their pixels."""
    found: list[xr.DataArray] = []
    y, x = grid.y_um, grid.x_um
    for level in made.levels():
        found.append(xr.DataArray(xr.Variable(("y", "x"), held(level)), coords={"y": y, "x": x}))
        y, x = middles(y), middles(x)
    return found


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
    made = MadeLevels(_ImageValues(file, (rows, cols)), place, keep_all=not is_mapped(file.path))
    return Picture(
        id="", plane=plane, layer=file.layer, name=name, title=title, units="1",
        levels=_on_grids(made, Grid.regular((rows, cols), file.pixel_um)),
    )  # fmt: skip


class _ImageValues:
    """One channel of an image file; decoded when a window is read for the first time, where the file is not mapped."""

    def __init__(self, file: ImageFile, shape: tuple[int, int]) -> None:
        self._file, self.shape, self.dtype = file, shape, np.dtype(np.float32)
        self._opening = threading.Lock()
        self._picture: Decoded | None = None

    def __getitem__(self, where: Where, /) -> NDArray[np.float32]:
        """Read a window."""
        with self._opening:
            if self._picture is None:
                self._picture = load_picture(self._file.path)
        part = replace(self._picture, values=self._picture.values[where])
        return channel_of(part, self._file.channel, file_name=self._file.path.name)[0]
