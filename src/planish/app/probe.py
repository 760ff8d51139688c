"""Values of pictures at a point and along a line, of full resolution and read by window."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planish.app.picture import Answer, Picture, finite_or_none
from planish.app.tiles import Tiles
from planish.core.errors import InputError
from planish.core.typing import Bools, Floats

MOST_SAMPLES = 2000
"""Pixels along a profile; a longer line is read from a coarser level."""


class ValueAt(Answer):
    """Value of one picture at a point; None where it has none."""

    id: str
    layer: str
    name: str
    title: str
    units: str
    value: float | None


class VolumePlace(Answer):
    """Place of the centre surface in the volume, in um along its axes."""

    layer: str
    x: float
    y: float
    z: float


class Cursor(Answer):
    """All values at a point (x, y) of a plane, in um, and the place in the volume that it shows."""

    x: float
    y: float
    row: int | None
    col: int | None
    values: tuple[ValueAt, ...]
    volume: VolumePlace | None


class ProfileOf(Answer):
    """Values of one picture along a line."""

    id: str
    name: str
    units: str
    values: tuple[float | None, ...]


class Profile(Answer):
    """Values along a line at ``at_um`` from its beginning, of pixels that are ``pixel_um`` wide."""

    pixel_um: float
    at_um: tuple[float, ...]
    lines: tuple[ProfileOf, ...]


def cursor(tiles: Tiles, picture: Picture, x: float, y: float) -> Cursor:
    """Values of all pictures on the pixels of one, at the pixel that holds a point."""
    rows, cols, (inside,) = _pixels(picture, np.array([[x, y]]), 0)
    pictures = tiles.pictures.on_same_pixels(picture)
    value_of = {p.id: finite_or_none(tiles.values_at(p, 0, rows, cols)[0]) if inside else None for p in pictures}
    return Cursor(
        x=x, y=y, row=int(rows[0]) if inside else None, col=int(cols[0]) if inside else None,
        values=tuple(
            ValueAt(id=p.id, layer=p.layer, name=p.name, title=p.title, units=p.units, value=value_of[p.id])
            for p in pictures
        ),
        volume=_volume_place(picture, pictures, value_of),
    )  # fmt: skip


def profile(tiles: Tiles, pictures: list[Picture], line: tuple[float, float, float, float]) -> Profile:
    """Values of pictures on one grid along the line from (x0, y0) to (x1, y1) in um, each of the pixel it crosses."""
    x0, y0, x1, y1 = line
    length = math.hypot(x1 - x0, y1 - y0)
    if length == 0:
        raise InputError("The line has no length. Give two places: x0, y0, x1, y1 in um.")
    first = pictures[0]
    pixel = min(first.grid.pixel_um)
    coarsest = len(first.levels) - 1
    level = min(max(0, math.ceil(math.log2(length / pixel / MOST_SAMPLES))), coarsest)
    step = pixel * 2**level
    distances_um = np.linspace(0, length, min(int(length / step), 4 * MOST_SAMPLES) + 1)
    points = np.array([x0, y0]) + (distances_um / length)[:, None] * np.array([x1 - x0, y1 - y0])
    rows, cols, inside = _pixels(first, points, level)
    lines: list[ProfileOf] = []
    for picture in pictures:
        values = np.full(distances_um.size, np.nan)
        values[inside] = tiles.values_at(picture, level, rows[inside], cols[inside])
        lines.append(
            ProfileOf(id=picture.id, name=picture.name, units=picture.units, values=tuple(map(finite_or_none, values)))
        )
    return Profile(pixel_um=step, at_um=tuple(distances_um.tolist()), lines=tuple(lines))


def _pixels(picture: Picture, points: Floats, level: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Bools]:
    """Rows and columns of the pixels of a level that hold points (n, 2: x, y), and which lie in the picture.

    Pixels of all levels share one corner.
    """
    (x0, y0), (dy, dx) = picture.grid.origin_um, picture.grid.pixel_um
    rows = np.floor((points[:, 1] - y0) / dy + 0.5).astype(np.intp) >> level
    cols = np.floor((points[:, 0] - x0) / dx + 0.5).astype(np.intp) >> level
    height, width = picture.levels[level].shape
    return rows, cols, (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)


def _volume_place(picture: Picture, pictures: list[Picture], value_of: dict[str, float | None]) -> VolumePlace | None:
    """The place in the volume, of the picture's own layer or the first one that has it."""
    places = {(p.layer, p.name.split("/")[-1]): value_of[p.id] for p in pictures}
    for layer in dict.fromkeys([picture.layer, *(p.layer for p in pictures)]):
        x, y, z = (places.get((layer, f"volume_{axis}")) for axis in "xyz")
        if x is not None and y is not None and z is not None:
            return VolumePlace(layer=layer, x=x, y=y, z=z)
    return None
