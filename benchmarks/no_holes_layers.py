"""How far off layers without holes are linked: a CT scan and serial sections, a chain of three, and
two images.

``python -m benchmarks no_holes_layers [SHEETS]``

Coated sheets of the demo's kind, 1.5 x 1.2 mm, without holes. Printed are distances in the plane of
the sheet: for two volumes between the pieces of paper that they show at one pixel; for the chain of
sections, scan and image, and for two images of different cameras, to where the pixel truly lies. At
most 1.5 um between volumes, and 1 pixel between images.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from planish.run import link
from planish.synthetic import DEMO, SectionsParams, Warp, make_specimen, write_instruments
from planish.validate import pair_errors
from planish.validate.errors import PAIR, Comparison

_MOST_UM, _MOST_PIXELS = 1.5, 1.0


def main(sheets=3):
    """Print the distances of each sheet; 1 where a median is too large."""
    missed = False
    for seed in range(5, 5 + sheets):
        with tempfile.TemporaryDirectory() as folder:
            missed |= _measured(seed, Path(folder))
    return int(missed)


def _measured(seed, folder):
    params = replace(
        DEMO,
        seed=seed,
        size_um=(1500.0, 1200.0),
        scanner=replace(DEMO.scanner, voxel_um=3.0),
        holes=replace(DEMO.holes, count=0),
        warp=Warp(wavelength_um=2000.0),
        camera=replace(DEMO.camera, pixel_um=4.0, vignetting=0.04, turn_range_deg=180.0),
        sections=SectionsParams(pixel_um=3.0, section_um=6.0),
    )
    specimen = make_specimen(params)
    camera = replace(params.camera, pixel_um=6.0, turn_deg=-65.0, nuisance_sd=0.006)
    other = make_specimen(replace(params, camera=camera, seed=seed + 100), sheet=specimen.sheet)
    scan = write_instruments(specimen, folder / "scan", volume="scanner")
    sections = write_instruments(specimen, folder / "sections", volume="sections", image=False)
    second = write_instruments(other, folder / "other", volume="stack")
    files = dict(zip(PAIR, (scan, sections), strict=True))
    layers = {name: f"{name}={of.volume}" for name, of in files.items()}

    pair = link(*layers.values(), through="y")
    values = pair_errors([(specimen, of) for of in files.values()], pair)
    print(
        f"sheet {seed}, two volumes: median {values['pair_median']:.2f}, 95 %"
        f" {values['pair_p95']:.2f} um; rms {values['pair_rms']:.2f} for"
        f" {values['pair_predicted_rms']:.2f} um stated",
        flush=True,
    )

    ordered = [layers[PAIR[1]], layers[PAIR[0]], f"photo={scan.image}"]
    chain = link(*ordered, chain=True, through="y")
    for name in PAIR:
        off_um = _off_image(specimen, files[name], chain, name)
        print(f"sheet {seed}, {name} in a chain of three: {_spread(off_um)} um", flush=True)

    images = link(f"small={scan.image}", f"large={second.image}")
    grid = images.groups["layers/small"]
    points = np.stack(np.meshgrid(grid["x"], grid["y"]), axis=-1)[grid["valid"].values]
    shown = images.registrations["small"].fit.inverse(points)
    off_pixels = (
        np.linalg.norm(specimen.pose.inverse(shown) - other.pose.inverse(points), axis=-1)
        / camera.pixel_um
    )
    print(
        f"sheet {seed}, two images: {_spread(off_pixels)} pixels of {camera.pixel_um:g} um",
        flush=True,
    )
    return bool((values["pair_median"] or 0.0) > _MOST_UM or np.median(off_pixels) > _MOST_PIXELS)


def _off_image(specimen, files, run, name):
    """Distances in the plane between what a layer shows at the pixels of the image and what truly
    lies there."""
    maps = run.groups[f"layers/{name}"]
    valid = maps["valid"].values
    places = np.stack([maps[f"volume_{axis}"].values[valid] for axis in ("x", "y", "z")], axis=-1)
    comparison = Comparison(specimen, files, replace(run, groups=run.sheets[name].groups))
    points = np.stack(np.meshgrid(maps["x"], maps["y"]), axis=-1)[valid]
    shown = comparison.material_at(places.astype(np.float64))
    return np.linalg.norm(shown[..., :2] - specimen.pose.inverse(points), axis=-1)


def _spread(off):
    return f"median {np.nanmedian(off):.2f}, 95 % {np.nanpercentile(off, 95):.2f}"
