"""A table of points or pixels: the place, every map, the share that is valid."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.area import AreaMeans
from planish.core.bands import band_of, bands
from planish.core.errors import StudyError
from planish.writers.content import History, Maps, column_of
from planish.writers.matrix import as_text
from planish.writers.params import ExportParams

Array = NDArray[np.float64]
_AT_ONCE = 2_000_000  # numbers in memory
_LEAST = 0.5  # share of a point that has to be valid: as in the correlations


def write(maps: Maps, path: Path, history: History, params: ExportParams) -> None:
    """Write a row for each point, or for each pixel where ``point_um`` is 0.

    A point is the mean over its valid pixels, weighted by area; it stands in the table where half of it is valid, as in
    the correlations. Without a map ``valid`` every pixel that has a value counts. Pixels stand there where any map
    has a value, with ``valid`` as it is.

    Raises
    ------
    StudyError
        A point is smaller than a pixel.
    """
    size = params.point_um or 0.0
    if size and size < max(maps.pixel_um) * (1 - 1e-9):
        raise StudyError(
            f"A point of {size:g} um is smaller than a pixel of {max(maps.pixel_um):g} um. Give a larger --point-um, "
            "or 0 for every pixel."
        )
    y, x = maps.dims
    names = [name for name in maps.names if name != "valid" or not size]
    columns = [
        f"{x}_um",
        f"{y}_um",
        *(column_of(name, maps.units(name)) for name in names),
        *(["valid_share"] if size else []),
    ]
    kind = f"points of {size:g} um" if size else "pixels"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {history.json(**maps.facts(), rows=kind)}\n")
        file.write(",".join(columns) + "\n")
        for places, values in _points(maps, names, size) if size else _pixels(maps, names):
            numbers = (as_text(part) for part in (places.T, values.T))
            file.writelines(",".join(at + row) + "\n" for at, row in zip(*numbers, strict=True))


def _pixels(maps: Maps, names: list[str]) -> Iterator[tuple[Array, Array]]:
    """Give places (2, n) and values (names, n) of the pixels that show anything, band by band."""
    y, x = maps.at_um
    rows, cols = maps.shape
    step = max(1, _AT_ONCE // (cols * len(names)))
    every = [k for k, name in enumerate(names) if name != "valid"] or slice(None)
    for begin in range(0, rows, step):
        part = slice(begin, min(begin + step, rows))
        values = np.stack([band_of(maps.data[name], part).astype(np.float64) for name in names])
        shows = np.isfinite(values[every]).any(axis=0)
        at = np.stack(np.broadcast_arrays(x[None, :], y[part, None]))
        yield at[:, shows], values[:, shows]


def _points(maps: Maps, names: list[str], size: float) -> Iterator[tuple[Array, Array]]:
    """Give places (2, n) and values (names and share of valid pixels, n) of all points."""
    pixel, (top, left) = maps.pixel_um, maps.origin_um
    factor = size / pixel[0], size / pixel[1]
    whole = AreaMeans(maps.shape, factor, least=0.0)
    each = {name: AreaMeans(maps.shape, factor, least=_LEAST) for name in names}
    for rows in bands(maps.shape[0]):
        parts = {name: band_of(maps.data[name], rows).astype(np.float64) for name in names}
        if "valid" in maps.data:
            valid = band_of(maps.data["valid"], rows).astype(bool)
        else:
            valid = np.any([np.isfinite(part) for part in parts.values()], axis=0)
        whole.add(rows.start, np.ones(valid.shape, bool), valid.astype(np.float64))
        for name, mean in each.items():
            mean.add(rows.start, valid & np.isfinite(parts[name]), parts[name])
    (share,) = whole.means()
    means = [mean.means()[0] for mean in each.values()]
    shows = share >= _LEAST - 1e-9
    down, across = (np.arange(n) for n in share.shape)
    # A point begins at the border of the first pixel.
    y = top - 0.5 * pixel[0] + size * (down + 0.5)
    x = left - 0.5 * pixel[1] + size * (across + 0.5)
    at = np.stack(np.broadcast_arrays(x[None, :], y[:, None]))
    yield at[:, shows], np.stack([*means, share])[:, shows]
