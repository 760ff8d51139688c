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
    header_lines = [
        f"{name}: {maps.titles[name]}",
        f"unit: {maps.units[name]}",
        f"pixel: {dx_um!r} um along {x}, {dy_um!r} um along {y}",
        f"middle of the first pixel: {x} = {x0!r} um, {y} = {y0!r} um",
        f"{maps.shape[0]} rows, {maps.shape[1]} columns; missing: NaN",
        history.json(**maps.facts()),
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in header_lines)
        for _, band in maps.bands(name, np.float32):
            rows_at_once = max(1, TEXT_VALUES // band.shape[1])
            for start in range(0, len(band), rows_at_once):
                rows = _texts(band[start : start + rows_at_once])
                file.writelines("\t".join(row) + "\n" for row in rows)


def write_points(maps: Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write a row for each point, or for each pixel where ``point_um`` is 0.

    A point is the mean over its valid pixels, weighted by area; it stands in the table where half
    of it is valid, as in the correlations. Without a map ``valid`` every pixel that has a value
    counts. Pixels stand there where any map has a value, with ``valid`` as it is. StudyError where
    a point is smaller than a pixel.
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
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {history.json(**maps.facts(), rows=rows_text)}\n")
        file.write(",".join([f"{x}_um", f"{y}_um", *map_columns, *last_columns]) + "\n")
        for block in blocks:
            file.writelines(",".join(row) + "\n" for row in _texts(block.T))


def _pixels(maps: Maps, names: list[str]) -> Iterator[Floats]:
    """Give the columns (x, y and every map; n) of the pixels that show anything, band by band."""
    y, x = maps.at_um
    rows, cols = maps.shape
    rows_at_once = max(1, TABLE_VALUES // (cols * len(names)))
    property_indices = [k for k, name in enumerate(names) if name != "valid"] or slice(None)
    for start in range(0, rows, rows_at_once):
        rows_slice = slice(start, min(start + rows_at_once, rows))
        map_bands = [band_of(maps.data[name], rows_slice) for name in names]
        values = np.stack(map_bands).astype(np.float64)
        has_value = np.isfinite(values[property_indices]).any(axis=0)
        coords_um = np.stack(np.broadcast_arrays(x[None, :], y[rows_slice, None]))
        yield np.concatenate([coords_um[:, has_value], values[:, has_value]])


def _points(maps: Maps, names: list[str], point_um: float) -> Iterator[Floats]:
    """Give the columns (x, y, every map, share of valid pixels; n) of all points."""
    pixel_um = maps.pixel_um
    pixels_per_point = point_um / pixel_um[0], point_um / pixel_um[1]
    validity = AreaMeans(maps.shape, pixels_per_point, least_share=0.0)
    means = {name: AreaMeans(maps.shape, pixels_per_point, least_share=_LEAST) for name in names}
    for rows in bands(maps.shape[0]):
        map_bands: dict[str, Array] = {}
        for name in names:
            band = band_of(maps.data[name], rows).astype(np.float64)
            map_bands[name] = summable(maps.data[name], band)
        if "valid" in maps.data:
            valid = band_of(maps.data["valid"], rows).astype(bool)
        else:
            valid = np.any([np.isfinite(band) for band in map_bands.values()], axis=0)
        validity.add(rows.start, np.ones(valid.shape, bool), valid.astype(np.float64))
        for name, area_means in means.items():
            area_means.add(rows.start, valid & np.isfinite(map_bands[name]), map_bands[name])
    (shares,) = validity.means()
    # A point begins at the border of the first pixel.
    low_um = np.array(maps.origin_um) - 0.5 * np.array(pixel_um)
    y, x = (
        low + point_um * (np.arange(n) + 0.5) for low, n in zip(low_um, shares.shape, strict=True)
    )
    coords_um = np.broadcast_arrays(x[None, :], y[:, None])
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
    return "NaN" if number == "nan" else number.removesuffix(".0")
