"""Compare the image of linked maps with every property, without regions declared artefacts."""

import numpy as np
import xarray as xr

from planish.analyze import CorrelateParams
from planish.analyze.compare import CorrelationRow, correlate_layers
from planish.core.arrays import check_dataset
from planish.core.bands import read_bands
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.core.options import params_of
from planish.marks.regions import read_regions
from planish.run.regions import regions_on


def correlate_maps(
    linked: xr.Dataset,
    *,
    params: CorrelateParams | None = None,
    names: tuple[str, str] = ("sheet", "image"),
) -> tuple[CorrelationRow, ...]:
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

    Raises
    ------
    FileError, InputError
        If ``params.regions`` are of no use, or come after a screen was taken off the image.
    """
    check_dataset(
        linked,
        "image",
        "valid",
        expected="linked maps",
        call_format="pl.correlate_maps({})",
        source="pl.resample_maps(measured, flat, onto=image, registration=registration)",
    )
    params = params_of(CorrelateParams, params, "pl.correlate_maps")
    if params.regions is not None:
        regions = regions_on(read_regions(params.regions), grid := Grid.of(linked), params.regions)
        if "reach_um" in linked["image"].attrs:
            raise InputError(
                "A screen was taken off the image before the regions were known, and what they hold"
                " has reached their neighbours. Give --regions to 'planish link' instead."
            )
        valid_bands = [
            valid & ~regions.inside(grid.part(rows))
            for rows, (valid,) in read_bands(linked["valid"])
        ]
        linked = linked.assign(valid=(("y", "x"), np.concatenate(valid_bands)))
    layers = {names[0]: linked.drop_vars("image"), names[1]: linked[["image", "valid"]]}
    return tuple(correlate_layers(*names, layers, params.point_um))
