"""What flattening gains: r of coating and image, flattened and by the better projection.

``python -m benchmarks gains [SEED ...]``

The specimens of the demo (seed 1 is the demo's own) and of the tutorial (3 is its own), in even,
diffuse light, each linked once; 1 to 6 and 3 to 8 where no seed is given. Printed is what the page
of each run says of points of 100 um and of the pixel. 1 where the gain of the demo or of the
tutorial over points may be 0.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import planish as pl
from benchmarks.shared import planish, succeeded
from planish.report.tables import comparison_sentence

DEMO, TUTORIAL = 1, 3
_OTHERS = 5
_SHEET = ["--size", "T1", "--slab", "--voxel-um", "6"]
_SEEN_BY = ["--instrument", "ct", "--instrument", "image"]
_EVEN = ["--without", "shading", "--without", "vignetting"]
_LINK = ["--through", "y", "--image-side", "top", "--headline", "coating_top"]


def main(*seeds):
    """Print the gains."""
    doubtful = False
    with tempfile.TemporaryDirectory() as name:
        for seed in seeds or range(DEMO, DEMO + _OTHERS + 1):
            folder = Path(name) / f"demo-{seed}"
            succeeded(planish("demo", "--seed", seed, "--out", folder))
            low = said(f"demo, seed {seed}", folder / "run")
            doubtful |= int(seed) == DEMO and low <= 0
        for seed in seeds or range(TUTORIAL, TUTORIAL + _OTHERS + 1):
            folder = Path(name) / f"sheet-{seed}"
            succeeded(
                planish("specimen", *_SHEET, *_SEEN_BY, *_EVEN, "--seed", seed, "--out", folder)
            )
            layers = (folder / "scan", folder / "image.ome.tif")
            succeeded(planish("link", *layers, *_LINK, "--out", folder / "run"))
            low = said(f"tutorial, seed {seed}", folder / "run")
            doubtful |= int(seed) == TUTORIAL and low <= 0
    return int(doubtful)


def said(what, folder):
    """Print what one run gains; the lower end of the interval of the gain over the largest
    points."""
    results = pl.open_run(folder).results
    projected = [one for one in results.comparison if one.registration.startswith("projection")]
    largest = max(one.point_um for one in projected)
    better = max((one for one in projected if one.point_um == largest), key=lambda row: row.r2)
    print(f"{what}: {comparison_sentence(results)}", flush=True)
    return better.difference_interval[0]
