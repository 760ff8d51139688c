"""Link a volume to an image by hand, step by step.

``planish link VOLUME IMAGE`` gives the same bytes.

``python examples/02_line_by_hand.py [FOLDER]`` writes ``02_line_by_hand.png``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import planish as pl
from planish.synthetic import BurnParams, CameraParams, ScannerParams, SpecimenParams

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
params = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    scanner=ScannerParams(voxel_um=4.0),
    camera=CameraParams(pixel_um=5.0, shading=0.003, nuisance_sd=0.004),
)
with tempfile.TemporaryDirectory() as folder:
    files = pl.make_specimen(params, Path(folder) / "sheet").files

    # The whole line.
    volume, image = pl.read_volume(files.volume), pl.read_image(files.image)
    surfaces = pl.find_surfaces(volume)  # faces, interfaces and centre surface of every column
    # Thickness, coating ... along the normals.
    measured = pl.measure_properties(surfaces, volume=volume)
    flat = pl.flatten_sheet(surfaces).flat  # flat coordinates u, v of every column
    maps = pl.resample_maps(measured, flat)  # maps on a regular grid of the flat sheet
    sheet_holes, image_holes = pl.find_holes(maps), pl.find_holes(image)
    registration = pl.register_marks(sheet_holes, image_holes)
    linked = pl.resample_maps(measured, flat, onto=image, registration=registration)
    rows = pl.correlate_maps(linked)

# How well the two fit, and how far a pixel may be off.
fit = registration.fit
print(fit.sentence)
print(registration.sentence)
print(f"leave-one-out error {fit.leave_one_out_rms_um:.2f} um")
print(f"expected error, median over the image {float(linked.expected_error.median()):.2f} um")
for row in rows:
    if row.a_map == "coating_top":
        print(
            f"coating and image over points of {row.point_um:g} um: r = {row.r:.3f} (n = {row.n})"
        )

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
linked.image.plot(ax=axes[0], cmap="gray", yincrease=False)
linked.coating_top.where(linked.valid).plot(ax=axes[1], yincrease=False, robust=True)
for ax, title in zip(axes, ("Image", "Coating, top side"), strict=True):
    ax.set_title(title)
    ax.set_aspect("equal")
figure.savefig(out / "02_line_by_hand.png", dpi=100)
