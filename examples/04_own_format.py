"""A format of your own: any array becomes a volume with its frame and its sizes.

Here a volume comes from a NumPy archive. To let ``planish map sheet.npz`` and ``read_volume`` open
it too, make it a module and one line in the table of formats: CONTRIBUTING.md shows the diff.

``python examples/04_own_format.py [FOLDER]`` writes ``04_own_format.png``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import planish as pl
from planish.synthetic import BurnParams, ScannerParams, SpecimenParams


def read_npz(path: Path) -> xr.DataArray:
    """Read the archive of a laboratory: ``grey`` (z, y, x), and ``voxel_mm``."""
    with np.load(path, allow_pickle=False) as archive:
        return volume_of(archive["grey"], 1000.0 * float(archive["voxel_mm"]))


def volume_of(grey: np.ndarray, voxel_um: float) -> xr.DataArray:
    """Put coordinates in um on an array (z, y, x): all that planish needs to know of a volume."""
    coords = {
        d: (d, np.arange(n) * voxel_um, {"units": "um"})
        for d, n in zip("zyx", grey.shape, strict=True)
    }
    return xr.DataArray(
        grey, coords=coords, dims=("z", "y", "x"), attrs={"voxel_um": (voxel_um,) * 3}
    )


def main(out: Path) -> xr.Dataset:
    """Write such an archive, read it, and measure the sheet in it."""
    params = SpecimenParams(
        size_um=(700.0, 500.0),
        holes=BurnParams(pattern="irregular", count=1),
        scanner=ScannerParams(voxel_um=4.0),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.npz"
        np.savez(path, grey=pl.make_specimen(params).volume.values, voxel_mm=0.004)
        volume = read_npz(path)
    surfaces = pl.find_surfaces(volume)
    measured = pl.measure_properties(surfaces, volume=volume)
    maps = pl.resample_maps(measured, pl.flatten_sheet(surfaces).flat)
    print(f"thickness {float(maps.thickness.mean()):.1f} um on {int(maps.valid.sum())} pixels")

    out.mkdir(parents=True, exist_ok=True)
    figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    maps.thickness.plot(ax=ax, robust=True, yincrease=False)
    figure.savefig(out / "04_own_format.png", dpi=100)
    return maps


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out"))
