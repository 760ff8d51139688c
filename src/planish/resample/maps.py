"""Bring the maps of a flattened sheet, and images, onto a regular grid, each in one step."""

import math
from typing import Any

import numpy as np
import xarray as xr
from scipy import special

from planish.core.axial import angle_of, is_axial, summable_of
from planish.core.errors import SurfaceError
from planish.core.frame import Frame
from planish.core.grid import Grid, pitch
from planish.core.transform import Similarity, grid_points
from planish.core.typing import Entries, Floats
from planish.resample.places import Mesh, covering_grid, find_places, resample_dataset
from planish.resample.warp import warp_image


def resample_maps(
    surfaces: xr.Dataset,
    flat: xr.Dataset,
    *,
    onto: Grid | None = None,
    transform: Any = None,
    map_um: float | None = None,
) -> xr.Dataset:
    """Bring the properties of a sheet onto its flat maps, or in one step onto a reference's pixels.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x)
        Surfaces with their measured properties: all variables whose attribute ``role`` is
        ``property`` or that have a ``support_um``, and their standard errors.
    flat : Dataset, dims (y, x), in um
        Of :func:`planish.flatten.flatten_sheet`.
    onto : Grid, optional
        Pixels of a reference; a grid (v, u) that covers the flat sheet where not given.
    transform : callable with a ``similarity``, optional
        From the flat sheet to the reference; only with ``onto``.
    map_um : float, optional
        Pixel of the flat maps; the volume's columns where not given. Only without ``onto``.

    Returns
    -------
    Dataset, dims (v, u), or (y, x) on a reference
        The properties, and of each pixel the place in the volume (``volume_x``, ``volume_y``,
        ``volume_z``). Flat maps also hold the place in the projection, the layers in which holes
        are looked for, and ``valid``; maps on a reference the place ``u``, ``v`` in the flat sheet.

    Raises
    ------
    SurfaceError
        The surfaces hold no properties, or the sheet has no flat coordinates.

    Notes
    -----
    The transformation is applied to the nodes of the sheet: values are interpolated once, from the
    volume's columns to the pixels. The standard error of a pixel that is the mean of many columns
    is smaller than theirs by the share of the variance that the mean keeps; what is common to all
    columns stays. Angles of an axis are averaged by the doubled angle, those of ``NAME_angle`` by
    ``NAME_cos2`` and ``NAME_sin2`` where these are there.
    """
    if onto is not None:
        return SheetOnto(surfaces, flat, transform=transform).on(onto)
    uv = _flat_coordinates(flat)
    step_um = pitch(surfaces)
    names = _variable_names(surfaces)
    pixel_um = map_um or math.sqrt(math.prod(step_um))
    grid = covering_grid(uv, pixel_um)
    places = find_places(uv, grid, least_um=min(step_um))
    column_fields = _on_columns(surfaces, flat, names, ("projected_u", "projected_v"))
    coords = {"v": grid.y_um, "u": grid.x_um}
    maps = resample_dataset(column_fields, places, dims=("v", "u"), coords=coords)
    maps = _as_stored(maps, surfaces, names, pixel_um, Similarity())
    is_measured = np.isfinite(maps["thickness"].values)
    maps["valid"] = (("v", "u"), is_measured, {"long_name": "Measured"})
    maps.attrs["overlaps"] = places.overlaps
    layer_heights: list[float] = []
    for name in names[2]:
        layer = surfaces[name].attrs["layer"]
        layer_heights.append(float(np.mean(layer)))
    if layer_heights:
        # Where the layers lie that holes are found in, in thicknesses: the face is half a thickness
        # from the centre surface.
        separation = max(layer_heights) - min(layer_heights)
        maps.attrs["layers_apart_um"] = separation * float(surfaces.attrs["thickness_um"])
        maps.attrs["layer_to_face"] = (0.5 - max(layer_heights)) / separation
    return maps


Names = tuple[list[str], list[str], list[str]]
"""Of the properties, of the standard errors that are known, and of the layers that holes are found
in."""


class SheetOnto:
    """The maps of a sheet on a reference's pixels, part by part.

    ``transform``, with a ``similarity``, leads there from the flat sheet; without one the flat
    coordinates are those of the reference.
    """

    def __init__(self, surfaces: xr.Dataset, flat: xr.Dataset, *, transform: Any = None) -> None:
        """Carry the nodes of the sheet to the reference, once for all parts."""
        uv = _flat_coordinates(flat)
        self._surfaces = surfaces
        self._similarity = Similarity()
        properties, errors, _ = _variable_names(surfaces)
        self._names: Names = (properties, errors, [])  # no layers
        self._columns = _on_columns(surfaces, flat, self._names, ("u", "v"))
        if transform is not None:
            uv = transform(uv)
            self._similarity = transform.similarity
        least_um = min(pitch(surfaces)) * self._similarity.scale
        self._mesh = Mesh.of(uv, least_um=least_um)

    def on(self, part: Grid) -> xr.Dataset:
        """The maps on some pixels of the reference."""
        (rows, cols), places = self._mesh.under(part)
        column_fields = self._columns.isel(y=rows, x=cols)
        coords = {"y": part.y_um, "x": part.x_um}
        maps = resample_dataset(column_fields, places, dims=("y", "x"), coords=coords)
        # On the sheet.
        pixel_um = math.sqrt(math.prod(part.pixel_um)) / self._similarity.scale
        return _as_stored(maps, self._surfaces, self._names, pixel_um, self._similarity)


def _flat_coordinates(flat: xr.Dataset) -> Floats:
    return np.stack([flat["u"].values, flat["v"].values], axis=-1)


def _as_stored(
    maps: xr.Dataset, surfaces: xr.Dataset, names: Names, pixel_um: float, similarity: Similarity
) -> xr.Dataset:
    """Turn angles with the sheet, give the errors of means, and cast maps to their stored types."""
    properties, errors, layers = names
    maps = _with_angles(maps, similarity)
    for name in errors:
        se = se_of_mean(maps[name].values, surfaces[name].attrs, pixel_um)
        maps[name] = maps[name].copy(data=se)
    # Geometry stays double.
    measured = [n for n in properties + errors if "support_um" not in surfaces[n].attrs]
    singles = [n for n in measured + layers if n in maps]
    return maps.assign(maps[singles].astype(np.float32, keep_attrs=True))


def resample_image(
    image: xr.DataArray,
    onto: Grid,
    transform: Any,
    *,
    memory_bytes: int = 2**31,
    must_meet: bool = True,
) -> xr.Dataset:
    """Bring an image (y, x) onto the pixels of a reference.

    Parameters
    ----------
    image : DataArray, dims (y, x)
        With ``pixel_um`` in its attributes.
    onto : Grid
    transform : callable with an ``inverse``
        From the image to the reference.
    memory_bytes : int
        What may be taken beside the image.
    must_meet : bool
        Whether it is an error that the grid shows nothing of the image.

    Returns
    -------
    Dataset, dims (y, x)
        ``image``: means over the area where pixels become larger, interpolated elsewhere.
    """
    row_um, col_um = image.attrs["pixel_um"]
    values = warp_image(
        image.values,
        onto,
        transform.inverse,
        pixel_um=(float(row_um), float(col_um)),
        memory_bytes=memory_bytes,
        must_meet=must_meet,
    )
    warped = xr.Variable(("y", "x"), values, image_attrs(image))
    return xr.Dataset({"image": warped}, coords=onto.coords)


def image_attrs(image: xr.DataArray) -> Entries:
    """Give the name and unit of an image's values.

    They come with how far each value reached for its neighbours, where it did.
    """
    name = str(image.attrs.get("long_name", "Image"))
    attrs: Entries = {"long_name": name, "units": "1"}
    if "reach_um" in image.attrs:
        attrs["reach_um"] = image.attrs["reach_um"]
    return attrs


class Lattice:
    """Some of a grid's places, evenly spaced, at most some 200 x 200.

    ``places`` (rows, cols, 2) are their (x, y) in um.
    """

    def __init__(self, grid: Grid) -> None:
        self._y_um = _thinned(grid.y_um)
        self._x_um = _thinned(grid.x_um)
        self.places: Floats = grid_points(self._x_um, self._y_um)

    def between(self, values: Floats, part: Grid) -> Floats:
        """Interpolate values (rows, cols) of the places bilinearly on some pixels of the grid."""
        by_rows = _between(values, self._y_um, part.y_um)
        by_cols = _between(by_rows.T, self._x_um, part.x_um)
        return np.ascontiguousarray(by_cols.T)


def _thinned(axis_um: Floats) -> Floats:
    count = min(axis_um.size, 200)
    return np.linspace(axis_um[0], axis_um[-1], count)


def _between(values: Floats, nodes_um: Floats, pixels_um: Floats) -> Floats:
    """Interpolate the rows (nodes, cols) of values linearly at some pixels between their places.

    Beyond the outermost places the line goes on; a single one has its value everywhere.
    """
    last = nodes_um.size - 1
    n_before = np.searchsorted(nodes_um, pixels_um, side="right")
    low = np.clip(n_before - 1, 0, max(last - 1, 0))
    high = np.minimum(low + 1, last)
    spacing_um = np.where(high > low, nodes_um[high] - nodes_um[low], 1.0)
    share = ((pixels_um - nodes_um[low]) / spacing_um)[:, None]
    return values[low] * (1.0 - share) + values[high] * share


def _variable_names(surfaces: xr.Dataset) -> Names:
    """Names of the maps, of their standard errors, and of the layers' own.

    Maps are properties, and what has a ``support_um``; layers are what holes are found in. Errors
    of which none is known are left out. Surfaces without a map are refused.
    """
    properties: list[str] = []
    supported: list[str] = []
    layers: list[str] = []
    for name, variable in surfaces.data_vars.items():
        if variable.attrs.get("role") == "property":
            properties.append(str(name))
        elif "support_um" in variable.attrs:
            supported.append(str(name))
        if "layer" in variable.attrs:
            layers.append(str(name))
    maps = properties + supported
    if not maps:
        raise SurfaceError("The surfaces hold no properties. Measure them first (planish measure).")
    errors: list[str] = []
    for name in maps:
        error = surfaces.get(f"{name}_se")
        if error is not None and np.isfinite(error.values).any():
            errors.append(f"{name}_se")
    return maps, errors, layers


def se_of_mean(se: Floats, attrs: Entries, pixel_um: float) -> Floats:
    """Give the standard error of the mean over a pixel of columns.

    ``se`` is that of a column, and ``attrs`` are of its map: ``common_um`` is what is common to all
    columns, and stays. Without ``patch_um2`` all of it stays.

    The errors of the columns have a Gaussian autocorrelation. Its integral is ``patch_um2`` = 2 pi
    s^2; a square of side L keeps the variance's share g(L / s)^2, g(x) = sqrt(2 pi) / x
    erf(x / sqrt 2) - 2 (1 - exp(-x^2 / 2)) / x^2.
    """
    if "patch_um2" not in attrs:
        return se
    sigma_um = np.sqrt(float(attrs["patch_um2"]) / (2 * np.pi))
    x = pixel_um / sigma_um
    plateau = np.sqrt(2 * np.pi) / x * special.erf(x / np.sqrt(2))
    share = plateau - 2 * -np.expm1(-0.5 * x * x) / x**2
    common_se = float(attrs["common_um"])
    variance = se**2
    variance -= common_se**2
    np.maximum(variance, 0.0, out=variance)
    variance *= share**2
    variance += common_se**2
    return np.sqrt(variance, out=variance)


def _on_columns(
    surfaces: xr.Dataset, flat: xr.Dataset, names: Names, coordinates: tuple[str, str]
) -> xr.Dataset:
    """Fields of the sheet's columns, with flat coordinates and their places in the volume.

    ``coordinates`` are the names of the coordinates in ``flat`` that are taken along. The volume's
    axes are named as its frame lays the sheet.
    """
    properties, errors, layers = names
    fields = surfaces[properties + errors + layers]
    fields = fields.assign(flat[list(coordinates)].data_vars)
    frame = Frame.of(surfaces)
    is_flattened = np.isfinite(flat["u"].values)
    positions = {
        frame.rows: surfaces["y"].values[:, None],
        frame.cols: surfaces["x"].values,
        frame.through: surfaces["centre"].values,
    }
    for axis in ("x", "y", "z"):
        attrs = {"units": "um", "long_name": f"Centre surface, {axis} in the volume"}
        place = np.where(is_flattened, positions[axis], np.nan)
        fields[f"volume_{axis}"] = (("y", "x"), place, attrs)
    return fields


def _with_angles(maps: xr.Dataset, similarity: Similarity) -> xr.Dataset:
    """Turn the directions of axes with the sheet.

    An angle whose parts are there is that of their means, to which even directions add more. An
    axis is averaged as a complex number of twice its angle.
    """
    turn = np.exp(2j * similarity.rotation_rad)
    for name, angle in maps.data_vars.items():
        if not is_axial(angle):
            continue
        vectors = summable_of(maps, name)
        if similarity.mirrored:  # x reversed: an angle a becomes 180 - a, its double -2a
            vectors = vectors.conj()
        vectors = vectors * turn
        turned = {name: angle_of(vectors)}
        stem = str(name).removesuffix("_angle")
        if f"{stem}_cos2" in maps and f"{stem}_sin2" in maps:
            turned |= {f"{stem}_cos2": vectors.real, f"{stem}_sin2": vectors.imag}
        turned_maps = {k: maps[k].copy(data=values) for k, values in turned.items()}
        maps = maps.assign(turned_maps)
    return maps
