"""Maps as text: a matrix of one map, or a table of points or pixels with every map."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.core.area import AreaMeans
from planish.core.axial import summable
from planish.core.bands import band_of, bands
from planish.core.errors import StudyError
from planish.core.memory import TABLE_VALUES, TEXT_VALUES
from planish.core.typing import Array, Floats
from planish.exports.content import ExportHistory, Maps, column_of
from planish.exports.formats import ExportParams

_LEAST = 0.5  # share of a point that has to be valid: as in the correlations


def write_matrix(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write one map: lines with ``#`` on what it is, then rows, with tabs.

    Numbers read back to the same float32.
    """
    (name,) = maps.names
    dy_um, dx_um = maps.pixel_um
    y0, x0 = maps.origin_um
    y, x = maps.dims
    rows, cols = maps.shape
    header_lines = [
        f"{name}: {maps.titles[name]}",
        f"unit: {maps.units[name]}",
        f"pixel: {dx_um!r} um along {x}, {dy_um!r} um along {y}",
        f"middle of the first pixel: {x} = {x0!r} um, {y} = {y0!r} um",
        f"{rows} rows, {cols} columns; missing: NaN",
        history.json(**maps.facts()),
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in header_lines)
        for _, band in maps.bands(name, np.float32):
            rows_at_once = max(1, TEXT_VALUES // band.shape[1])
            for start in range(0, len(band), rows_at_once):
                table = _texts(band[start : start + rows_at_once])
                file.writelines("\t".join(row) + "\n" for row in table)


def write_points(maps: Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write a row for each point, or for each pixel where ``point_um`` is 0.

    A point is the mean over its valid pixels, weighted by area; it stands in the table where half
    of it is valid, as in the correlations, whichever maps are written. In a group without a map
    ``valid`` every pixel that has a value counts. Pixels stand there where any map has a value,
    with ``valid`` as it is. StudyError where a point is smaller than a pixel.
    """
    point_um = params.point_um or 0.0
    if point_um and point_um < max(maps.pixel_um) * (1 - 1e-9):
        raise StudyError(
            f"A point of {point_um:g} um is smaller than a pixel of {max(maps.pixel_um):g} um. Give"
            " a larger `point_um`, or 0 for every pixel."
        )
    y, x = maps.dims
    names = maps.names
    rows_text = "pixels"
    blocks = _pixels(maps, names)
    last_columns: list[str] = []
    if point_um:
        names = [name for name in names if name != "valid"]
        rows_text = f"points of {point_um:g} um"
        blocks = _points(maps, names, point_um)
        last_columns = ["valid_share"]
    map_columns = [column_of(name, maps.units[name]) for name in names]
    header = [f"{x}_um", f"{y}_um", *map_columns, *last_columns]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {history.json(**maps.facts(), rows=rows_text)}\n")
        file.write(",".join(header) + "\n")
        for block in blocks:
            file.writelines(",".join(row) + "\n" for row in _texts(block.T))


def _pixels(maps: Maps, names: list[str]) -> Iterator[Floats]:
    """Give the pixels that show anything, band by band.

    Each band is (2 + maps, n): places along x and y in um, then the values of every map.
    """
    y, x = maps.at_um
    rows, cols = maps.shape
    rows_at_once = max(1, TABLE_VALUES // (cols * len(names)))
    # ``valid`` has a value everywhere and is none to be shown, unless it is all that there is.
    properties = [k for k, name in enumerate(names) if name != "valid"] or slice(None)
    for start in range(0, rows, rows_at_once):
        rows_slice = slice(start, min(start + rows_at_once, rows))
        map_bands = [band_of(maps.data[name], rows_slice) for name in names]
        values = np.stack(map_bands).astype(np.float64)
        has_value = np.isfinite(values[properties]).any(axis=0)
        coords_um = np.stack(np.meshgrid(x, y[rows_slice]))
        yield np.concatenate([coords_um[:, has_value], values[:, has_value]])


def _points(maps: Maps, names: list[str], point_um: float) -> Iterator[Floats]:
    """Give all points at once, (3 + maps, n).

    Those are places along x and y in um, means of every map, and the share of valid pixels.
    """
    dy_um, dx_um = maps.pixel_um
    pixels_per_point = (point_um / dy_um, point_um / dx_um)
    # The share counts every valid pixel, a mean those of them that have a value.
    validity = AreaMeans(maps.shape, pixels_per_point, least_share=0.0)
    means = {name: AreaMeans(maps.shape, pixels_per_point, least_share=_LEAST) for name in names}
    for rows in bands(maps.shape[0]):
        map_bands: dict[str, Array] = {}
        for name in names:
            band = band_of(maps.data[name], rows).astype(np.float64)
            map_bands[name] = summable(maps.data[name], band)
        has_value = {name: np.isfinite(band) for name, band in map_bands.items()}
        if maps.valid is not None:
            valid = band_of(maps.valid, rows).astype(bool)
        else:
            valid = np.any([*has_value.values()], axis=0)
        every_pixel = np.ones_like(valid)
        validity.add(rows.start, every_pixel, valid.astype(np.float64))
        for name, area_means in means.items():
            area_means.add(rows.start, valid & has_value[name], map_bands[name])
    (shares,) = validity.means()
    n_rows, n_cols = shares.shape
    # The first point begins at the border of the first pixel.
    y0, x0 = maps.origin_um
    y = y0 - 0.5 * dy_um + point_um * (np.arange(n_rows) + 0.5)
    x = x0 - 0.5 * dx_um + point_um * (np.arange(n_cols) + 0.5)
    coords_um = np.meshgrid(x, y)
    map_means = [area_means.means()[0] for area_means in means.values()]
    columns = np.stack([*coords_um, *map_means, shares])
    yield columns[:, shares >= _LEAST - 1e-9]


def _texts(values: NDArray[np.floating]) -> list[list[str]]:
    """Numbers (rows, cols) as the shortest texts that read back to the same float32.

    Whole numbers without a point.
    """
    rows = values.astype(np.float32).astype("U").tolist()
    return [[*map(_text, row)] for row in rows]


def _text(number: str) -> str:
    if number == "nan":
        return "NaN"
    return number.removesuffix(".0")
