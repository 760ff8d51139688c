"""Arrays instead of files: NumPy, a memory map and zarr give the same surfaces, and a link of them.

``python examples/16_from_arrays.py [FOLDER]`` writes ``16_from_arrays.png``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import zarr

import planish as pl
from planish.synthetic import BurnParams, ScannerParams, SpecimenParams

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# A synthetic sheet of paper takes the place of your arrays.
params = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    scanner=ScannerParams(voxel_um=4.0),
)
specimen = pl.make_specimen(params)
stack, picture = specimen.volume.values, specimen.image.values

with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
    np.save(Path(folder) / "stack.npy", stack)
    arrays = {
        "NumPy": stack,
        "memory map": np.load(Path(folder) / "stack.npy", mmap_mode="r"),
        "zarr": zarr.array(stack, chunks=(64, 64, 64)),
    }
    found = {
        name: pl.find_surfaces(pl.volume(array, voxel_um=4.0)) for name, array in arrays.items()
    }
    for name, surfaces in found.items():
        same = surfaces.identical(found["NumPy"])
        print(
            f"{name}: sheet of {surfaces.attrs['thickness_um']:.1f} um, the same as from NumPy:"
            f" {same}"
        )

    run = pl.link(
        pl.volume(stack, voxel_um=4.0),
        pl.image(picture, pixel_um=specimen.image.attrs["pixel_um"], side="top"),
        out=Path(folder) / "run",
        point_um=50,
    )
    print(run)
    linked = run.linked.load()

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
linked.image.plot(ax=left, cmap="gray", yincrease=False, add_colorbar=False)
left.set(title="Image, an array", aspect="equal")
linked.coating_top.where(linked.valid).plot(ax=right, cmap="viridis", yincrease=False)
right.set(title="Coating, from an array of voxels", aspect="equal")
figure.savefig(out / "16_from_arrays.png", dpi=100)
