"""Properties of a synthetic specimen, found surfaces and all, beside its truth at the same material points."""

import numpy as np
import pytest
import xarray as xr

from planish.measure import MeasureParams, measure_along_rays
from planish.surface import find_surfaces

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def measured(specimen):
    voxel = specimen.params.scanner.voxel_um
    coords = {k: np.arange(n) * voxel for k, n in zip("zyx", specimen.volume.shape, strict=True)}
    volume = xr.DataArray(specimen.volume, dims=("z", "y", "x"), coords=coords)
    paper = specimen.params.paper
    # The base's mean relative density is 1: twice its grey above the air stands for the solid.
    air, base, _ = specimen.params.scanner.grey
    options = MeasureParams(
        coating_g_cm3=paper.coating_g_per_cm3, base_g_cm3=paper.base_g_per_cm3, solid_grey=2 * base - air,
        coat_weight_from="attenuation",
    )  # fmt: skip
    names = ["coating_top", "coating_bottom", "thickness", "coat_weight_top", "grammage", "porosity"]
    return measure_along_rays(volume, find_surfaces(volume), names=names, params=options)


@pytest.fixture(scope="module")
def truth(specimen):
    """What the specimen was made of, below each column of the volume."""
    sheet, paper = specimen.sheet, specimen.params.paper
    u, v = specimen.columns["u"].values, specimen.columns["v"].values
    top, inner_top, inner_bottom, bottom = (sheet.at(face, u, v) for face in sheet.faces)
    density = paper.coating_g_per_cm3 * sheet.at(sheet.coating_density, u, v)
    texture = np.mean([sheet.at(layer, u, v) for layer in sheet.texture], axis=0)
    base = inner_top - inner_bottom
    coats = top - inner_top, inner_bottom - bottom
    return {
        "coating_top": coats[0],
        "coating_bottom": coats[1],
        "thickness": top - bottom,
        "coat_weight_top": density * coats[0],
        "grammage": density * sum(coats) + paper.base_g_per_cm3 * base * texture,
        "porosity": 1 - 0.5 * texture,
    }


# bias and scatter in the map's unit; voxels of 4 um, a blur of 5.9 um FWHM and 4 % noise
@pytest.mark.parametrize(
    ("name", "bias", "scatter"),
    [
        ("coating_top", 0.3, 1.2),
        ("coating_bottom", 0.3, 1.2),
        ("thickness", 0.3, 0.8),
        ("coat_weight_top", 0.8, 2.5),
        ("grammage", 1.5, 5.0),
        ("porosity", 0.02, 0.06),
    ],
)
def test_maps_are_near_the_truth(measured, truth, name, bias, scatter):
    error = measured[name].values - truth[name]
    error = error[np.isfinite(error)]
    stated = float(measured[f"{name}_se"].median())
    middle, spread = float(np.median(error)), 1.4826 * float(np.median(np.abs(error - np.median(error))))
    assert error.size > 30_000
    assert abs(middle) < bias
    assert spread < scatter
    # noise is not all: the blur across rays and the base's texture are in the scatter and not in the stated error
    assert 0.25 * spread < stated < 1.5 * spread
