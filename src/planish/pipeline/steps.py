"""Steps of the line that join stages, as ``planish link``, the stage commands and a notebook call them."""

from __future__ import annotations

import xarray as xr

from planish.analyze import CorrelateParams
from planish.core.checks import check_same_grid
from planish.core.errors import InputError
from planish.core.results import CorrelationRow
from planish.pipeline.compare import correlate_layers
from planish.pipeline.onto import linked_maps
from planish.pipeline.registration import Registration
from planish.resample import resample_maps as flat_maps


def resample_maps(
    measured: xr.Dataset, flat: xr.Dataset, *, onto: xr.DataArray | None = None,
    registration: Registration | None = None, map_um: float | None = None,
) -> xr.Dataset:  # fmt: skip
    """Bring a sheet's properties onto a regular grid: of the flat sheet, or the pixels of an image.

    Values are interpolated once, from the columns of the volume to the pixels of the result.

    Parameters
    ----------
    measured : Dataset (y, x)
        Of :func:`planish.measure_properties`.
    flat : Dataset (y, x)
        Flat coordinates, of :func:`planish.flatten_sheet`.
    onto : DataArray (y, x), optional
        An image of :func:`planish.read_image`; with ``registration``.
    registration : Registration, optional
        From the flat sheet to the image, of :func:`planish.register_marks`.
    map_um : float, optional
        Pixel of the flat maps; the pitch of the columns where not given.

    Returns
    -------
    Dataset
        Maps (v, u) of the flat sheet; or linked maps (y, x) on the image's pixels, with ``image``, ``valid`` and
        ``expected_error``.

    Raises
    ------
    SurfaceError
        If the two datasets stand on different columns.
    InputError
        If only one of ``onto`` and ``registration`` is given.
    """
    check_same_grid(measured, flat)
    if onto is None and registration is None:
        return flat_maps(measured, flat, map_um=map_um)
    if onto is None or registration is None:
        raise InputError("onto and registration belong together: give both, or neither for the flat maps.")
    return linked_maps(measured, flat, onto=onto, registration=registration)


def correlate_maps(
    linked: xr.Dataset, *, params: CorrelateParams | None = None, names: tuple[str, str] = ("sheet", "image")
) -> tuple[CorrelationRow, ...]:  # fmt: skip
    """Correlate every property with the image, per pixel and over larger points.

    Parameters
    ----------
    linked : Dataset (y, x)
        Linked maps of :func:`planish.resample_maps`.
    params : CorrelateParams, optional
    names : (str, str)
        What the rows call the two layers.

    Returns
    -------
    tuple of CorrelationRow
        As ``results.correlations`` of a run.
    """
    params = params or CorrelateParams()
    layers = {names[0]: linked.drop_vars("image"), names[1]: linked[["image", "valid"]]}
    return tuple(correlate_layers(*names, layers, params.point_um))
