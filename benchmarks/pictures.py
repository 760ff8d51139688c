"""Pictures of the documents: made from runs, so that they show what the program gives.

``python -m benchmarks pictures [NAME ...]`` writes docs/images/NAME.png; all of them where none is
named.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import tifffile
from PIL import Image
from scipy import ndimage
from tests import console

import planish as pl
from benchmarks import paper
from benchmarks.app import opened
from benchmarks.evidence import field
from benchmarks.shared import planish as command_of
from benchmarks.shared import succeeded

mpl.use("Agg")
import matplotlib.pyplot as plt

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
_MISSING = "#d4d6d8"  # as on the page of a run


def planish(*arguments, folder):
    """Run the program in a folder."""
    succeeded(command_of(*arguments), cwd=folder)


def stored(drawn, folder, colours=200):
    """Keep a drawn figure in few colours: a third of the bytes."""
    with Image.open(drawn) as picture:
        picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(
            folder / drawn.name, optimize=True
        )


def demo(folder):
    """The folder of the demo, which several pictures share."""
    demo_folder = folder.parent / "demo"
    if not demo_folder.exists():
        planish("demo", "--out", "demo", folder=folder.parent)
    return demo_folder


def linked(path, folder):
    """The image of the demo's specimen, and its coating on the same pixels."""
    maps = pl.open_run(demo(folder) / "run").linked
    valid = maps.valid.to_numpy()
    y, x = (maps[name].to_numpy() / 1000.0 for name in ("y", "x"))
    rows, cols = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
    window = (slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1))
    extent = (x[window[1]][0], x[window[1]][-1], y[window[0]][-1], y[window[0]][0])
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
    layers = (
        ("image", "gray", "Image: grey value"),
        ("coating_top", "viridis", "Coating, top side / µm"),
    )
    for ax, (name, colours, label) in zip(axes, layers, strict=True):
        seen = maps[name].to_numpy()[window]
        low, high = np.nanpercentile(np.where(valid[window], seen, np.nan), (1, 99))
        # The image with its holes.
        values = seen if name == "image" else np.where(valid[window], seen, np.nan)
        shown = ax.imshow(
            values, extent=extent, cmap=colours, vmin=low, vmax=high, interpolation="none"
        )
        ax.set_facecolor(_MISSING)
        ax.set_xlabel("x / mm")
        figure.colorbar(shown, ax=ax, label=label, shrink=0.85, extend="both")
    axes[0].set_ylabel("y / mm")
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def tutorial(path, folder):
    """What the tutorial shows: sections through the scan, the first page of the report, two of its
    figures."""
    page = (IMAGES.parent / "tutorial.md").read_text(encoding="utf-8")
    outcomes = console.run(page, folder)
    if faults := console.report(outcomes):
        raise SystemExit(faults)
    shutil.copyfile(folder / "look.png", path.with_name("tutorial-look.png"))
    shot(folder / "run" / "report.html", path, 1100, 940)
    planish("report", "run", "-o", "page.html", "--figures", folder=folder)
    parts = {
        "slices": "slices-with-the-surfaces-found",
        "marks": "marks-in-the-image-and-their-residuals",
    }
    for name, part in parts.items():
        (figure,) = (folder / "figures").glob(f"*-{part}.svg")
        shot(figure, path.with_name(f"tutorial-{name}.png"), *size_of(figure))


def size_of(figure):
    """Width and height of an SVG figure in pixels, the width being 760."""
    box = re.search(
        r'viewBox="[\d.-]+ [\d.-]+ ([\d.]+) ([\d.]+)"', figure.read_text(encoding="utf-8")
    )
    width, height = float(box[1]), float(box[2])
    return 760, round(760 * height / width)


def shot(page, path, width, height):
    """Take a picture of a page or figure as a browser shows it."""
    browser = next(
        (
            found
            for name in ("chromium", "google-chrome", "chrome")
            if (found := shutil.which(name))
        ),
        None,
    )
    if browser is None:
        raise SystemExit("Pictures of pages need chromium on the path.")
    if page.suffix == ".svg":  # stretched to the window
        holder = page.with_suffix(".html")
        holder.write_text(
            f'<body style="margin:0"><img src="{page.name}" style="width:100%">', encoding="utf-8"
        )
        page = holder
    with tempfile.TemporaryDirectory() as profile:
        command = [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--hide-scrollbars",
            "--disable-background-networking",
            "--disable-sync",
            f"--user-data-dir={profile}",
            f"--screenshot={path}",
            f"--window-size={width},{height}",
            page.resolve().as_uri(),
        ]
        subprocess.run(command, check=True, capture_output=True)
    stored(path, path.parent, 128)


_REST_MS = 3000  # until all tiles of a tab are drawn
_REGION_UM = "608.6, 428.5, 1774.6, 1235"


def app(path, folder):
    """The four tabs of the app, with the run of the demo."""
    with opened(demo(folder) / "run") as (page, url, _):
        page.goto(url)
        page.get_by_role("cell", name="hole 3", exact=True).click()
        shot_of_tab(page, path, "marks")
        page.get_by_role("tab", name="Surfaces", exact=True).click()
        shot_of_tab(page, path, "surfaces")
        page.get_by_role("tab", name="Maps", exact=True).click()
        page.get_by_text(re.compile("Scatter of [0-9]+ points")).wait_for()
        region = page.get_by_label("Region, um", exact=True)
        region.fill(_REGION_UM)
        region.press("Enter")
        page.get_by_text(re.compile("n_eff [0-9.]+ [(]")).wait_for()
        shot_of_tab(page, path, "maps")
        page.get_by_role("tab", name="Flattening", exact=True).click()
        shot_of_tab(page, path, "flattening")


def shot_of_tab(page, path, tab):
    """Take a picture of a page that a browser drives."""
    page.wait_for_timeout(_REST_MS)
    picture = path.with_name(f"app-{tab}.png")
    page.screenshot(path=picture)
    stored(picture, picture.parent, 128)


def first_of_demo(path, folder):
    """The first pages of two reports: of the demo, and of its scan with an image of another
    sheet."""
    shot(demo(folder) / "run" / "report.html", path, 1280, 900)
    specimen = demo(folder) / "specimen"
    with_noise_alone(specimen / "image.tif", folder / "unrelated.tif")
    planish("link", specimen / "volume.tif", "unrelated.tif", "--out", "run", folder=folder)
    shot(folder / "run" / "report.html", path.with_name("first-unrelated.png"), 1280, 900)


def first_pages(path, folder):
    """The first pages of four other reports."""
    specimen = ["ct", "sections", "image"]
    which = [word for name in specimen for word in ("--instrument", name)]
    preset = ["--preset", "wfc118", "--seed", "3"]
    even = ["--without", "shading", "--without", "vignetting"]
    planish("specimen", *preset, *which, *even, "--out", "sheet", folder=folder)
    overexposed(folder / "sheet" / "image.ome.tif", folder / "overexposed.tif")
    runs = {
        "sections": [
            "link",
            "sheet/sections",
            "sheet/image.ome.tif",
            "--through",
            "y",
            "--memory",
            "13GB",
        ],
        "two-volumes": ["link", "sheet/scan", "run-sections", "--through", "y"],
        "overexposed": ["link", "sheet/scan", "overexposed.tif", "--through", "y"],
    }
    measured = Path(os.environ.get("PLANISH_DATA") or IMAGES.parents[2] / "shared" / "data")
    cell = measured / "battery_sector_right"
    if cell.exists():
        runs["wall"] = [
            "map",
            str(cell),
            "--voxel-um",
            "1",
            "--through",
            "x",
            "--sheet-grey",
            "100,255",
        ]
    for name, command in runs.items():
        planish(*command, "--out", f"run-{name}", folder=folder)
        shot(folder / f"run-{name}" / "report.html", path.with_name(f"first-{name}.png"), 1280, 900)


def with_noise_alone(image, path):
    """The image of another sheet with the holes of this one: noise of 120 um between the holes."""
    read = pl.read_image(image)
    grey = read.to_numpy().astype(np.float64)
    middle = float(np.median(grey))
    holes = ndimage.binary_dilation((grey < 0.6 * middle) | (grey > 1.6 * middle), iterations=8)
    holes = ndimage.binary_dilation(ndimage.binary_opening(holes, iterations=6), iterations=10)
    noise, _ = field(np.random.default_rng(5), grey.shape, 30.0, "exp")
    sheet = np.where(holes, grey, np.clip(middle + np.std(grey[~holes]) * noise, 0, 65535)).astype(
        np.uint16
    )
    _written(path, sheet, read.attrs["pixel_um"])


def _written(path, grey, pixel_um):
    size = (1e4 / pixel_um[1], 1e4 / pixel_um[0])
    tifffile.imwrite(path, grey, resolution=size, resolutionunit="CENTIMETER")


def overexposed(image, path):
    """The same image in 8 bits, its brightest 30 % cut off."""
    read = pl.read_image(image)
    grey = read.to_numpy()
    low, high = np.percentile(grey, (2, 70))
    bright = np.round(255 * np.clip((grey - low) / (high - low), 0, 1)).astype(np.uint8)
    _written(path, bright, read.attrs["pixel_um"])


def gallery(path, folder):
    """What the examples draw; those on measured data that are not there keep their pictures."""
    examples = sorted((IMAGES.parents[1] / "examples").glob("*.py"))
    for example in examples:
        done = subprocess.run(
            [sys.executable, str(example), str(folder)],
            check=False,
            env=os.environ | {"MPLBACKEND": "agg"},
        )
        drawn = folder / f"{example.stem}.png"
        if done.returncode or not drawn.exists():
            print(f"{example.stem}: not drawn")
            continue
        stored(drawn, path.parent / "examples")


_FACES = {
    "top": "#ff9f1c",
    "interface_top": "#2ec4b6",
    "interface_bottom": "#2ec4b6",
    "bottom": "#ff9f1c",
}


def drawn_sheets(path, folder):
    """A slice of the first specimen of each kind of paper, with the faces found in it."""
    for name in paper.KINDS:
        volume = paper.drawn(name, 0).volume
        voxel_um = float(volume["x"][1])
        row = volume.sizes["y"] // 2
        figure, axes = plt.subplots(
            2, 1, figsize=(8, 4.4), layout="constrained", sharex=True, sharey=True
        )
        for ax in axes:
            extent = tuple(
                voxel_um * (edge - 0.5) for edge in (0, volume.sizes["x"], 0, volume.sizes["z"])
            )
            ax.imshow(volume[:, row], cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent)
        try:
            surfaces = pl.find_surfaces(volume).isel(y=row)
            for face, colour in _FACES.items():
                axes[1].plot(surfaces["x"], surfaces[face], color=colour, linewidth=0.8)
            heights = np.concatenate([surfaces["top"].values, surfaces["bottom"].values])
        except pl.PlanishError:
            axes[1].set_title("refused", fontsize=9)
            heights = volume["z"].values
        low, high = max(float(np.nanmin(heights)) - 100.0, 0.0), float(np.nanmax(heights)) + 50.0
        axes[0].set(xlim=(300.0, 1200.0), ylim=(low, high), ylabel="z / µm")
        axes[1].set(xlabel="x / µm", ylabel="z / µm")
        drawn = folder / f"paper-{name.replace(' ', '-')}.png"
        figure.savefig(drawn, dpi=100)
        plt.close(figure)
        stored(drawn, path.parent)


STUDIES = ("fig-06", "fig-07", "fig-09", "fig-11", "flattening", "no-holes", "large")
"""Of full specimens, as docs/studies.md shows them."""


def studies(path, folder):
    """Figures of the studies; their statements, which the page quotes, are printed."""
    program = IMAGES.parents[1] / "examples" / "studies" / "make.py"
    for name in STUDIES:
        command = [sys.executable, str(program), name, "--size", "full", "--out", str(folder)]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        stored(folder / f"{name}.png", path.parent / "studies")


PICTURES = {
    "linked": linked,
    "tutorial-page": tutorial,
    "app": app,
    "first-demo": first_of_demo,
    "first-pages": first_pages,
    "examples": gallery,
    "studies": studies,
    "drawn-sheets": drawn_sheets,
}


def main(*names):
    """Make the pictures that are named."""
    with tempfile.TemporaryDirectory() as shared:
        for name in names or PICTURES:
            folder = Path(shared) / name
            folder.mkdir()
            PICTURES[name](IMAGES / f"{name}.png", folder)
            print(f"{name}: done")
    return 0
