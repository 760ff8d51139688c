"""Specimens that both sides of a comparison read: ``python inputs.py FOLDER``, with the planish of
the old side."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from planish.synthetic import (
    CameraParams,
    PrintParams,
    ScannerParams,
    SectionsParams,
    SpecimenParams,
    Warp,
    make_specimen,
    write_image,
    write_instruments,
)

try:
    from planish.synthetic import BurnParams
except ImportError:  # its former name
    from planish.synthetic import HoleParams as BurnParams

VOXEL_UM, PIXEL_UM = 4.0, 5.0
_CAMERA = CameraParams(pixel_um=PIXEL_UM, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004)
_SMALL = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    warp=Warp(slope=0.35, wavelength_um=1800.0),
    scanner=ScannerParams(voxel_um=VOXEL_UM),
    sections=SectionsParams(pixel_um=3.0, section_um=4.0),
    camera=_CAMERA,
    seed=5,
)
_OTHER = replace(
    _SMALL,
    warp=Warp(slope=0.25, wavelength_um=2300.0, phase_rad=2.0, ruling_deg=80.0),
    scanner=ScannerParams(voxel_um=3.5, fwhm_um=4.5),
    camera=replace(_CAMERA, pixel_um=6.0, turn_deg=40.0),
    seed=6,
)
_THRESHOLDS = (65, 145)  # between the greys of air, base and coating
_REGIONS = """{"type": "FeatureCollection", "features": [{"type": "Feature",
"properties": {"name": "stain", "reason": "ink", "author": "A. Reader"},
"geometry": {"type": "Polygon",
"coordinates": [[[300, 300], [600, 320], [580, 520], [310, 500], [300, 300]]]}}]}
"""


def main(folder):
    """Write all of them."""
    small = make_specimen(_SMALL)
    write_instruments(small, folder / "small")
    write_instruments(small, folder / "sections", volume="sections", image=False)
    write_instruments(make_specimen(_OTHER, sheet=small.sheet), folder / "other")
    for seed in range(1, 5):
        write_instruments(make_specimen(replace(_SMALL, seed=10 + seed)), folder / f"s{seed}")
    rows = [f"s{k},s{k}/volume.tif,s{k}/image.tif,{'AB'[k % 2]},{k}" for k in range(1, 5)]
    (folder / "specimens.csv").write_text(
        "\n".join(["name,volume,image,paper,sheet", *rows]) + "\n", encoding="utf-8"
    )
    printed = replace(_SMALL, camera=replace(_CAMERA, screen=PrintParams()))
    write_instruments(make_specimen(printed, sheet=small.sheet), folder / "printed")
    wide = replace(_SMALL, size_um=(3200.0, 2700.0))  # two octaves of mottle
    for name, camera in (("wide", _CAMERA), ("wide-turned", replace(_CAMERA, turn_deg=30.0))):
        write_image(make_specimen(replace(wide, camera=camera)), folder / f"{name}.tif")

    grey = small.volume.values
    save(folder / "upside-down.tif", grey[::-1, ::-1])  # turned about x: the image shows its bottom
    # Turned further: through y, the top at the low end.
    save(folder / "laid.tif", grey[:, ::-1].transpose(1, 0, 2))
    save(folder / "cut-grey.tif", np.minimum(grey, np.percentile(grey, 93)).astype(grey.dtype))
    y, x = (np.arange(n) - (n - 1) / 2 for n in grey.shape[1:])
    radius = np.hypot(y[:, None], x)
    rings = 10 * np.exp(-(((radius - 50) / 1.5) ** 2)) - 8 * np.exp(-(((radius - 85) / 2) ** 2))
    save(folder / "rings.tif", np.clip(grey + rings, 0, 255).astype(grey.dtype))
    sharp = replace(_SMALL, scanner=ScannerParams(voxel_um=VOXEL_UM, fwhm_um=0.5, noise=0.0))
    clear = make_specimen(sharp, sheet=small.sheet).volume.values
    save(folder / "labels.tif", np.digitize(clear, _THRESHOLDS).astype(np.uint8))
    (folder / "regions.geojson").write_text(_REGIONS, encoding="utf-8")
    write_marks(folder / "marks")


def write_marks(folder):
    """Write marks as ImageJ and BigWarp do, in the layouts that planish only reads."""
    folder.mkdir()
    moving = [(250.0, 500.0), (1250.0, 312.5), (800.0, 1500.0), (2000.0, 1800.0)]
    fixed = [(402.0, 806.0), (2006.0, 510.0), (1282.0, 2410.0), (3208.0, 2886.0)]
    for name, points in (("moving", moving), ("fixed", fixed)):
        rows = [f"{k},0,{112 + k},112,112,{x},{y},1" for k, (x, y) in enumerate(points, 1)]
        (folder / f"{name}.csv").write_text(
            "\n".join([" ,Area,Mean,Min,Max,X,Y,Slice", *rows]) + "\n", encoding="utf-8"
        )
    inner = {
        "type": "BigWarpLandmarks",
        "numDimensions": 2,
        "movingPoints": moving,
        "fixedPoints": fixed,
    }
    inner |= {"active": [True] * len(moving), "names": [f"Pt-{k}" for k in range(len(moving))]}
    (folder / "bigwarp.json").write_text(json.dumps({"landmarks": inner}), encoding="utf-8")


def save(path, volume):
    """Write a volume as ImageJ does."""
    size, metadata = (
        (1 / VOXEL_UM, 1 / VOXEL_UM),
        {"spacing": VOXEL_UM, "unit": "um", "axes": "ZYX"},
    )
    tifffile.imwrite(
        path, np.ascontiguousarray(volume), imagej=True, resolution=size, metadata=metadata
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
