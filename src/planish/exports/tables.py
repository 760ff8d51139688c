"""Maps as text: a matrix of one map, or a table of points or pixels with every map."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.area import AreaMeans
from planish.core.bands import band_of, bands
from planish.core.errors import StudyError
from planish.core.memory import TABLE_VALUES, TEXT_VALUES
from planish.core.typing import Floats
from planish.exports.content import ExportHistory, Maps, column_of
from planish.exports.formats import ExportParams

_LEAST = 0.5  # share of a point that has to be valid: as in the correlations


def write_matrix(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write one map: what it is in lines with ``#``, then a line for each row, with tabs between.

    Numbers read back to the same float32.
    """
    (name,) = maps.names
    (down, across), (y0, x0), (y, x) = maps.pixel_um, maps.origin_um, maps.dims
    head = [
        f"{name}: {maps.titles[name]}",
        f"unit: {maps.units[name]}",
        f"pixel: {across!r} um along {x}, {down!r} um along {y}",
        f"middle of the first pixel: {x} = {x0!r} um, {y} = {y0!r} um",
        f"{maps.shape[0]} rows, {maps.shape[1]} columns; missing: NaN",
        history.json(**maps.facts()),
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in head)
        for _, band in maps.bands(name, np.float32):
            step = max(1, TEXT_VALUES // band.shape[1])
            for begin in range(0, len(band), step):
                file.writelines("\t".join(row) + "\n" for row in _texts(band[begin : begin + step]))


def write_points(maps: Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
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
    titles = [f"{x}_um", f"{y}_um", *(column_of(name, maps.units[name]) for name in names)]
    kind = f"points of {size:g} um" if size else "pixels"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {history.json(**maps.facts(), rows=kind)}\n")
        file.write(",".join([*titles, "valid_share"] if size else titles) + "\n")
        for columns in _points(maps, names, size) if size else _pixels(maps, names):
            file.writelines(",".join(row) + "\n" for row in _texts(columns.T))


def _pixels(maps: Maps, names: list[str]) -> Iterator[Floats]:
    """Give the columns (x, y and every map; n) of the pixels that show anything, band by band."""
    y, x = maps.at_um
    rows, cols = maps.shape
    step = max(1, TABLE_VALUES // (cols * len(names)))
    every = [k for k, name in enumerate(names) if name != "valid"] or slice(None)
    for begin in range(0, rows, step):
        band = slice(begin, min(begin + step, rows))
        numbers = np.stack([band_of(maps.data[name], band).astype(np.float64) for name in names])
        shows = np.isfinite(numbers[every]).any(axis=0)
        places = np.stack(np.broadcast_arrays(x[None, :], y[band, None]))
        yield np.concatenate([places[:, shows], numbers[:, shows]])


def _points(maps: Maps, names: list[str], size: float) -> Iterator[Floats]:
    """Give the columns (x, y, every map, share of valid pixels; n) of all points."""
    pixel = maps.pixel_um
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
    # A point begins at the border of the first pixel.
    y, x = (
        first - 0.5 * pitch + size * (np.arange(count) + 0.5)
        for first, pitch, count in zip(maps.origin_um, pixel, share.shape, strict=True)
    )
    places = np.broadcast_arrays(x[None, :], y[:, None])
    yield np.stack([*places, *(mean.means()[0] for mean in each.values()), share])[:, share >= _LEAST - 1e-9]


def _texts(numbers: NDArray[np.floating]) -> list[list[str]]:
    """Numbers (rows, cols) as the shortest texts that read back to the same float32; whole numbers without a point."""
    rows = numbers.astype(np.float32).astype("U").tolist()
    return [["NaN" if text == "nan" else text.removesuffix(".0") for text in row] for row in rows]
