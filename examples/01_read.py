"""Read a volume and an image, and look at them before anything is measured.

``python examples/01_read.py [FOLDER]`` writes ``01_read.png``. At the terminal: ``planish info
volume.tif``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import planish as pl
from planish.synthetic import BurnParams, ScannerParams, SpecimenParams

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# A synthetic sheet of paper takes the place of your files.
params = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    scanner=ScannerParams(voxel_um=4.0),
)
with tempfile.TemporaryDirectory() as folder:
    files = pl.make_specimen(params, Path(folder) / "sheet").files

    # Sizes come from the files. Where a file does not state its size, give it: voxel_um=(z, y, x),
    # pixel_um=(y, x).
    volume = pl.read_volume(files.volume)
    image = pl.read_image(files.image)

    # Both are xarray objects with coordinates in um; voxel i has its centre at i x size.
    print(volume.sizes, volume.dtype, volume.attrs["voxel_um"], volume.attrs["voxel_um_source"])
    print(image.sizes, image.dtype, image.attrs["pixel_um"], image.attrs["pixel_um_source"])

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    # a cross-section: the sheet is warped.
    volume.sel(y=500, method="nearest").plot(ax=left, cmap="gray")
    left.set_title("Volume, section at y = 500 um")
    image.plot(ax=right, cmap="gray", yincrease=False)
    right.set_title("Image")
    right.set_aspect("equal")
    figure.savefig(out / "01_read.png", dpi=100)
