"""Links to images of 15 and of 160 million pixels: time a pixel, peak memory, size of the page.

    python -m benchmarks large_image [--memory 4GB] [--folder DIR] [--rows 3416,10944]
    python -m benchmarks large_image --texture [--hand] [--near]

A specimen is made with a voxel of 5 um and a pixel of 1.37 um, so large that its image has so many
rows and 4/3 as many columns; ``planish link`` maps and links it in a process of its own. The
specimen of 160 million pixels takes some nine minutes and 10 GB to make.

With ``--texture`` a map of 2.5 x 2 mm without holes is found in an image of 60 x 45 mm at 4 um,
with either hand, or with the right one (``--hand``), or about a place known to 150 um, as a hole
gives it (``--near``): time, peak memory, and how far off.
"""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import tifffile
import xarray as xr
from scipy import ndimage

from benchmarks.shared import folder_for, memory, options, planish, size_of, timed
from planish.core.transform import Similarity, nearest_similarity
from planish.register import RegistrationParams
from planish.run import register_texture
from planish.synthetic import (
    BurnParams,
    CameraParams,
    ScannerParams,
    SpecimenParams,
    make_specimen,
    write_image,
    write_instruments,
)

PIXEL_UM, VOXEL_UM = 1.37, 5.0
_FIELD = 1.2  # image over sheet: it reaches beyond it and is turned against it


def main(*arguments):
    asked = options(
        "large_image",
        arguments,
        rows="3416,10944",
        memory="4GB",
        folder=None,
        texture=False,
        hand=False,
        near=False,
    )
    if asked.texture:
        return find_texture(mirrored=False if asked.hand else None, is_near=asked.near)
    with folder_for(asked.folder) as folder:
        for rows in map(int, asked.rows.split(",")):
            measure(rows, rows * 4 // 3, Path(folder), asked.memory)
    return 0


def measure(rows, cols, folder, limit):
    """Make a specimen where it is not there yet, link it, and print what that took."""
    out, pixels = folder / f"run-{rows}", rows * cols
    shutil.rmtree(out, ignore_errors=True)
    volume, image = specimen(rows, cols, folder / f"image-{rows}")
    ran = timed(planish("link", volume, image, "--out", out, "--memory", limit))
    print(
        f"{pixels / 1e6:.0f} Mpixel: exit code {ran.code}, {ran.seconds:.0f} s, {ran.cpu:.0f} s of"
        f" processor time, {1e6 * ran.cpu / pixels:.2f} us a pixel",
        flush=True,
    )
    print("  " + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in ran.stages.items()))
    if ran.code not in (0, 4):
        print(ran.said)
        return
    print(f"  peak memory {ran.peak / 1e9:.2f} GB")
    print(
        f"  page {size_of(out / 'report.html') / 1e6:.1f} MB, maps"
        f" {size_of(out / 'maps.zarr') / 1e9:.1f} GB"
    )
    shutil.rmtree(out, ignore_errors=True)


def specimen(rows, cols, folder):
    """Volume and image of a specimen whose image has so many pixels."""
    volume, image = folder / "volume.tif", folder / "cut.tif"
    if image.exists():
        return volume, image
    height, width = rows * PIXEL_UM / _FIELD, cols * PIXEL_UM / _FIELD
    while True:
        made = make_specimen(
            SpecimenParams(
                size_um=(width, height),
                holes=BurnParams(count=21),
                camera=CameraParams(pixel_um=PIXEL_UM),
                seed=3,
                scanner=ScannerParams(voxel_um=VOXEL_UM, fwhm_um=8.0),
            )
        )
        if made.image_shape[0] >= rows and made.image_shape[1] >= cols:
            break
        height, width = 1.01 * height, 1.01 * width
    # Another specimen of the same sheet: what it keeps of its scan is gone before the image is
    # drawn.
    write_instruments(make_specimen(made.params, sheet=made.sheet), folder, image=False)
    values = tifffile.imread(write_image(made, folder / "image.tif"))[:rows, :cols]
    per_cm = 1e4 / PIXEL_UM
    tifffile.imwrite(image, values, resolution=(per_cm, per_cm), resolutionunit="CENTIMETER")
    return volume, image


def find_texture(*, mirrored, is_near=False):
    """Find a map with a texture r of .5 in a large image, and print what that took; 1 where it lies
    6 um off."""
    rng, pixel, (rows, cols), (ny, nx) = np.random.default_rng(1), 4.0, (11250, 15000), (500, 625)

    def field(shape):
        smooth = ndimage.gaussian_filter(rng.standard_normal(shape, dtype=np.float32), 4)
        return smooth / smooth.std()

    # Seams do not matter.
    image = np.concatenate([field((2250, cols)) for _ in range(rows // 2250)])
    sheet = field((ny, nx))
    turn, middle = (
        Similarity(scale=1.01, rotation_rad=np.deg2rad(133.0)),
        0.5 * pixel * np.array([nx, ny]),
    )
    place = nearest_similarity(turn.matrix(), middle, np.array([41000.0, 22000.0]))
    part = np.s_[5000:6000, 9750:10750]
    points = np.stack(
        np.meshgrid(*(np.arange(s.start, s.stop) * pixel for s in part[::-1])), axis=-1
    )
    at = np.moveaxis(place.inverse(points)[..., ::-1] / pixel, -1, 0)
    seen = ndimage.map_coordinates(sheet, at, order=3, cval=np.nan)
    image[part] = np.where(
        np.isfinite(seen), 0.5 * np.nan_to_num(seen) + np.sqrt(0.75) * image[part], image[part]
    )
    maps = {
        "coating_top": 15 + 3 * sheet,
        "base_thickness": 50 + 15 * field((ny, nx)),
        "topography_top": field((ny, nx)),
    }
    maps |= {
        "thickness": maps["coating_top"] + maps["base_thickness"],
        "valid": np.ones((ny, nx), dtype=bool),
    }
    moving = xr.Dataset(
        {name: (("v", "u"), values) for name, values in maps.items()},
        coords={"v": np.arange(ny) * pixel, "u": np.arange(nx) * pixel},
    )
    fixed = xr.DataArray(
        image,
        dims=("y", "x"),
        coords={"y": np.arange(rows) * pixel, "x": np.arange(cols) * pixel},
        attrs={"pixel_um": [pixel, pixel]},
    )
    begun, begun_cpu = time.perf_counter(), time.process_time()
    params = RegistrationParams(near=(41000.0, 22000.0, 150.0) if is_near else None)
    registration = register_texture(moving, fixed, mirrored=mirrored, params=params)
    seconds, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
    corners = np.array([[0.0, 0.0], [nx * pixel, ny * pixel]])
    off_um = float(np.linalg.norm(registration(corners) - place(corners), axis=1).max())
    print(
        f"{rows * cols / 1e6:.0f} Mpixel by texture: {seconds:.0f} s, {cpu:.0f} s of processor"
        f" time, peak memory {memory(peak=True) / 1e9:.2f} GB, {off_um:.2f} um off at the corners"
    )
    return int(off_um > 6.0)
