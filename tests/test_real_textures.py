"""Measured data: images of one tissue, linked by what both show."""

import numpy as np
import pytest
import tifffile
import xarray as xr
from scipy import ndimage

import planish as pl
from folders import refused
from planish.core.errors import CannotRegister
from planish.core.transform import Similarity, nearest_similarity


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("moving", "fixed"),
    [((0, 0), (2, 0)), ((3, 1), (2, 0))],
    ids=["two depths", "another channel and depth"],
)
def test_images_of_one_tissue_are_linked_by_their_texture_and_one_of_another_is_refused(
    shared_data, moving, fixed
):
    """Light-sheet images of one epithelium, by the numbers of depth and channel; the second under
    another camera.

    Their pixel is 0.36 um, and the field 92 um wide: no paper's. Cell walls lean, so one depth
    shows them beside where another does.
    """
    layers = tifffile.imread(
        shared_data("tissue_sheet_mesh") / "basics_example_projected.tif"
    ).astype(np.float64)
    pixel, camera_pixel, shape = 0.36, 0.45, layers.shape[2:]
    coords = {"v": np.arange(shape[0]) * pixel, "u": np.arange(shape[1]) * pixel}
    maps = xr.Dataset({"coating_top": (("v", "u"), layers[moving])}, coords)
    maps["valid"] = maps.coating_top.notnull()
    turn, middle = (
        Similarity(rotation_rad=np.deg2rad(37.0), scale=1.01),
        0.5 * pixel * (np.array(shape) - 1),
    )
    place = nearest_similarity(turn.matrix(), middle, np.array([77.4, 68.4]))
    axes = [np.arange(320) * camera_pixel] * 2
    at = place.inverse(np.stack(np.meshgrid(*axes), axis=-1))[..., ::-1] / pixel
    filled = np.nan_to_num(layers[fixed], nan=float(np.nanmedian(layers[fixed])))
    seen = ndimage.map_coordinates(filled, np.moveaxis(at, -1, 0), order=3, cval=np.nan)
    image = xr.DataArray(
        np.where(np.isnan(seen), np.median(filled), seen),
        {"y": axes[1], "x": axes[0]},
        ("y", "x"),
        attrs={"pixel_um": [camera_pixel] * 2},
    )
    found = pl.register_texture(maps, image, mirrored=False)
    organoid = tifffile.imread(
        shared_data("tissue_sheet_mesh") / "Neural_tube_organoid_DAPI_betaCat-small.tif"
    )[15, 0]
    other = xr.DataArray(
        np.pad(organoid.astype(np.float64), 60, constant_values=np.median(organoid)),
        dims=("y", "x"),
        attrs={"pixel_um": [camera_pixel] * 2},
    )
    other = other.assign_coords(
        {dim: np.arange(size) * camera_pixel for dim, size in other.sizes.items()}
    )
    refused(CannotRegister, "stands out by its texture", pl.register_texture, maps, other)
    corners = np.array([[18.0, 18.0], [72.0, 18.0], [18.0, 72.0], [72.0, 72.0]])
    off_pixels = np.linalg.norm(found(corners) - place(corners), axis=1) / pixel
    print(
        f"off by {off_pixels.min():.2f} to {off_pixels.max():.2f} pixels, p"
        f" {found.false_probability:.1g}"
    )
    assert off_pixels.max() < 1.2
