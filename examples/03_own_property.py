"""A property of your own: how bright the sheet is near its faces against its core.

It is taken along the true normals.

``python examples/03_own_property.py [FOLDER]`` writes ``03_own_property.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import planish as pl
from planish.measure import Rays, measure_along_rays, ray_property
from planish.synthetic import BurnParams, ScannerParams, SpecimenParams, Warp


# All that a new property needs. `rays.core` is the base without its blurred ends; `rays.mean` is
# the mean grey above the air between two places on each ray, in um from the centre surface.
@ray_property(
    "skin", units="1", long_name="Brightness of the base near its faces over that of its core"
)
def skin(rays: Rays) -> np.ndarray:
    """Mean grey of the outer thirds over that of the middle one."""
    bottom, top = rays.core
    third = (top - bottom) / 3
    outside = 0.5 * (rays.mean(bottom, bottom + third) + rays.mean(top - third, top))
    return outside / rays.mean(bottom + third, top - third)


def main(out: Path) -> xr.Dataset:
    """Measure it on a small synthetic sheet, beside a property that is built in."""
    params = SpecimenParams(
        size_um=(700.0, 500.0),
        holes=BurnParams(pattern="irregular", count=1),
        warp=Warp(slope=0.3),
        scanner=ScannerParams(voxel_um=4.0),
        seed=2,
    )
    volume = pl.make_specimen(params).volume
    maps = measure_along_rays(volume, pl.find_surfaces(volume), names=["skin", "thickness"])
    out.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
    for ax, name in zip(axes, ("skin", "thickness"), strict=True):
        values = maps[name]
        print(
            f"{values.attrs['long_name']}: {float(values.mean()):.3g} ± {float(values.std()):.2g} "
            f"{values.attrs['units']}, {int(values.notnull().sum())} rays"
        )
        values.plot(ax=ax, robust=True, yincrease=False)
        ax.set_title(name)
    figure.savefig(out / "03_own_property.png", dpi=100)
    return maps


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out"))
