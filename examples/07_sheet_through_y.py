"""A scan in which the sheet stands on edge.

The axis through the sheet is y, and its top side lies at the low end.

``planish link VOLUME IMAGE --through y --top low --image-side bottom`` does the same.
``python examples/07_sheet_through_y.py [FOLDER]`` writes ``07_sheet_through_y.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import planish as pl
from planish.synthetic import BurnParams, CameraParams, ScannerParams, SpecimenParams

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
params = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    scanner=ScannerParams(voxel_um=4.0),
    camera=CameraParams(pixel_um=5.0, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004),
    seed=5,
)
specimen = pl.make_specimen(params)

# The same specimen as another scanner would hold it: turned about x, so that the sheet's normal
# runs along y and its top faces the low end. From below, the image of the sheet is mirrored.
grey = np.ascontiguousarray(specimen.volume.values[::-1].transpose(1, 0, 2))
coords = {
    d: (d, 4.0 * np.arange(n), {"units": "um"}) for d, n in zip("zyx", grey.shape, strict=True)
}
volume = xr.DataArray(grey, coords=coords, dims=("z", "y", "x"), attrs=specimen.volume.attrs)
image = specimen.image.copy(data=specimen.image.values[:, ::-1])

# How the sheet lies in the volume is never guessed: the frame states it, here and in all that
# follows.
frame = pl.Frame(through="y", top="low")
surfaces = pl.find_surfaces(volume, frame=frame)
measured = pl.measure_properties(surfaces, volume=volume)
flat = pl.flatten_sheet(surfaces).flat
maps = pl.resample_maps(measured, flat)

# The image shows the bottom side: its holes are searched in that face, and the match is that of
# opposite views.
side = "bottom"
registration = pl.register_marks(pl.find_holes(maps, side=side), pl.find_holes(image, side=side))
linked = pl.resample_maps(measured, flat, onto=image, registration=registration)
print(registration.sentence)
print(f"leave-one-out error {registration.fit.leave_one_out_rms_um:.2f} um")

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
volume.sel(z=500, method="nearest").plot(ax=axes[0], cmap="gray")
axes[0].set_title("Volume, section at z = 500 um")
linked.coating_bottom.where(linked.valid).plot(ax=axes[1], robust=True, yincrease=False)
axes[1].set_title("Coating, bottom side")
axes[1].set_aspect("equal")
figure.savefig(out / "07_sheet_through_y.png", dpi=100)
