"""Pictures of synthetic specimens for docs/specimens.md: does it look like paper?

``python -m benchmarks specimens`` writes docs/images/specimen-*.png
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

from planish.synthetic import (
    FIBRE_CT,
    PRESETS,
    BurnParams,
    CameraParams,
    SectionsParams,
    SpecimenParams,
    Warp,
    make_specimen,
)

mpl.use("Agg")
import matplotlib.pyplot as plt

_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
_SIZE_UM = (1500.0, 1100.0)


def main(seed=7):
    """Draw one sheet a preset: both volumes in cross-section, the image, the print, and the
    coating."""
    for name in PRESETS:
        path = _FOLDER / f"specimen-{name}.png"
        draw(name, seed, path)
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")
    return 0


def draw(name, seed, path):
    """Draw one preset."""
    params = SpecimenParams(
        size_um=_SIZE_UM,
        paper=PRESETS[name][1],
        holes=BurnParams(pattern="irregular", count=3),
        warp=Warp(slope=0.25, wavelength_um=1800.0),
        scanner=replace(FIBRE_CT, voxel_um=1.37),
        sections=SectionsParams(colour=True),
        camera=CameraParams(pixel_um=2.6, turn_range_deg=0.0, shift_range_um=0.0),
        seed=seed,
    )
    specimen = make_specimen(params)
    scanner, microtome = specimen.scanner, specimen.microtome
    row = int(0.45 * scanner.shape[1])
    scan = scanner.rows(row, row + 1)[0].T[::-1]
    section = int(np.argmin(np.abs(specimen.poses.y_um - row * 1.37)))
    photo = microtome.picture(section)[::-1]
    figure, axes = plt.subplot_mosaic(
        [["ct", "ct", "ct"], ["lm", "lm", "lm"], ["image", "print", "coating"]],
        figsize=(9, 8.6),
        height_ratios=[1.5, 1.5, 2.2],
        layout="constrained",
    )
    extent = (0.0, _SIZE_UM[0], 0.0, specimen.extent_um[2])
    axes["ct"].imshow(scan, cmap="gray", extent=extent, aspect="equal", vmin=0, vmax=255)
    axes["lm"].imshow(photo, extent=extent, aspect="equal")
    crop = (slice(100, 480), slice(100, 480))
    wide = (0.0, 380 * 2.6, 380 * 2.6, 0.0)
    shades = {"cmap": "gray", "extent": wide, "vmin": 0.3, "vmax": 1.0}
    axes["image"].imshow(specimen.image.values[crop], **shades)
    axes["print"].imshow(specimen.printed.values[crop], **shades | {"vmin": 0.0})
    coated = params.paper.coating_top_um > 0
    truth = specimen.truth["coating_top" if coated else "thickness"].values[crop]
    shown = axes["coating"].imshow(truth, cmap="viridis", extent=wide, vmin=0 if coated else None)
    figure.colorbar(
        shown,
        ax=axes["coating"],
        label=("top coating" if coated else "thickness") + " / µm",
        shrink=0.8,
    )
    titles = {
        "ct": "micro-CT, voxel 1.37 µm, with all of its artefacts",
        "lm": "section under the light microscope, 0.81 µm",
        "image": "image, 2.6 µm",
        "print": "printed, 60 lines/cm, 40 %",
        "coating": "truth",
    }
    for key, title in titles.items():
        axes[key].set_title(title, fontsize=9, loc="left")
        axes[key].tick_params(labelsize=7)
        axes[key].set_xlabel("µm", fontsize=7)
    for key in ("ct", "lm"):
        axes[key].set_xlim(0, 1000)
    figure.savefig(path, dpi=100)
    plt.close(figure)
    # Few colours are enough, and keep the file small.
    Image.open(path).convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE).save(
        path, optimize=True
    )
