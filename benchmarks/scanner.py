"""How well the scan of an office scanner is linked to a mapped sheet, with and without holes.

``python -m benchmarks scanner [PAIRS [FIRST [FOLDER]]]``: so many scans (20) of each.

Two sheets without and two with eight holes are laid fibre by fibre, scanned by a micro-CT and
mapped. They are scanned on the glass again and again, at 1200 and 2400 dpi in turn, with all traits
of :class:`planish.synthetic.FlatbedParams` drawn from their ranges, and the sheet turned by any
angle. Printed are the distance of what each pixel shows from where the run puts it in the volume,
true over stated error, r over 100 um beside that of the microscope's image, and what the run asks
to look at. FOLDER keeps the mapped sheets. Folders in it with ``volume.tif``, ``image.tif``,
``truth.npz``, ``truth.json`` and ``top.npy``, of another maker, are taken as well.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np
import tifffile
from scipy import ndimage

from benchmarks.paper import KINDS
from benchmarks.shared import folder_for, rms
from planish.analyze import correlate
from planish.analyze.leading_map import leading_map
from planish.core.errors import PlanishError
from planish.run import link, map_sheet, open_run
from planish.synthetic import (
    BurnParams,
    CameraParams,
    SpecimenParams,
    draw_params,
    image_material,
    make_specimen,
    scan_flatbed,
)
from planish.synthetic.pose import draw_pose

SHEETS = (0, 0, 8, 8)
"""Holes of each."""
_SIZE_UM, _FINE_UM = (2100.0, 1600.0), 3.0
_WRONG_UM = 25.0  # further off in the median: the sheet was not found there
_LINK = {"image_side": "top"}
_CLEAN = {"shading": 0.0, "lens_um": 0.0, "colour": False, "gamma": 1.0, "noise": 0.0}
_CLEAN |= {"sharpen": 0.0, "bits": 16, "quality": None}
_R_APART, _RATIO = 0.03, (0.7, 1.5)
_MOST_UM = {1200: 3.0, 2400: 2.0}
"""Largest median error of the place, by dpi."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A picture of a mapped sheet, the face in it, and the true place in the volume of each pixel.

    Lengths in um; ``volume_um`` is (3, rows, columns): x, y, z of the sheet's middle.
    """

    picture: np.ndarray
    face_um: np.ndarray
    volume_um: np.ndarray
    pixel_um: float

    @cached_property
    def tangents(self):
        """What a step of 1 um along x and along y of the picture is in the volume."""
        return [
            np.stack([np.gradient(f, self.pixel_um, axis=axis) for f in self.volume_um])
            for axis in (1, 0)
        ]

    def errors_um(self, scan, linked):
        """Distance on the sheet of what pixels show from where they are put, and the stated one."""
        rows, cols = np.nonzero(linked["valid"].values[::3, ::3])
        rows, cols = 3 * rows, 3 * cols
        at = np.stack([scan.lines_um[rows], scan.columns_um[cols]]) / self.pixel_um
        true, along_x, along_y = (
            np.stack([ndimage.map_coordinates(f, at, order=1) for f in field])
            for field in (self.volume_um, *self.tangents)
        )
        put = np.stack([linked[f"volume_{axis}"].values[rows, cols] for axis in "xyz"])
        off = put - true
        xx, xy, yy = (
            np.sum(a * b, axis=0)
            for a, b in ((along_x, along_x), (along_x, along_y), (along_y, along_y))
        )
        x, y = np.sum(along_x * off, axis=0), np.sum(along_y * off, axis=0)
        determinant = xx * yy - xy * xy
        errors = np.hypot((yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant)
        is_known = np.isfinite(errors)
        return errors[is_known], linked["expected_error"].values[rows, cols][is_known]


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A mapped sheet: its folder with ``run`` and ``image.tif``, and what draws a scene of it."""

    name: str
    folder: Path
    has_holes: bool
    scene: object  # of a generator

    @cached_property
    def microscope_r(self):
        """r over 100 um of the map that leads and the microscope's image."""
        folder = self.folder / "microscope"
        if not folder.exists():
            link(self.folder / "run", self.folder / "image.tif", out=folder, **_LINK)
        return leading_row(open_run(folder)).r


def leading_row(run):
    """Correlation of the map that leads with the image over points of about 100 um."""
    leads = leading_map(run.linked)
    rows = [row for row in run.results.correlations if row.a_map == leads]
    return min(rows, key=lambda row: abs(row.point_um - 100.0))


def r_beside(run, clean):
    """r over the same points with a scan of no trait but the carriage's in place of the image."""
    row, maps = leading_row(run), run.linked
    seen = np.where(maps["valid"].values, maps[row.a_map].values, np.nan)
    image = np.where(maps["valid"].values, clean.values.astype(np.float64), np.nan)
    return correlate(seen, image, pixel_um=clean.pixel_um, point_um=row.point_um).r


def drawn_sheet(number, home):
    """Make and map one of the sheets, or open it where it was mapped before."""
    holes = SHEETS[number]
    rng = np.random.default_rng([50, number])
    params = replace(
        KINDS["coated"].draw(rng),
        size_um=_SIZE_UM,
        holes=BurnParams(pattern="irregular", count=holes),
        camera=CameraParams(oracle_r2=0.25, shading=0.003, vignetting=0.0, radial=0.0),
    )
    folder = Path(home) / f"coated-{number}"
    if not folder.exists():
        make_specimen(params, folder)
    if not (folder / "run").exists():
        map_sheet(folder / "volume.tif", out=folder / "run")
    specimen = cache(partial(make_specimen, params))

    def scene(rng):
        width, height = _SIZE_UM
        even = replace(
            params.camera,
            pixel_um=_FINE_UM,
            turn_range_deg=180.0,
            scale_range=0.0,
            shading=0.0,
            lens_um=0.0,
            noise=0.0,
            bits=16,
        )
        shape, pose = draw_pose(even, 0.5 * np.array([-width, -height, width, height]), rng)
        made = specimen()
        shown = replace(made, pose=pose, image_shape=shape, params=replace(params, camera=even))
        u, v = image_material(pose, shape, _FINE_UM)
        return Scene(
            picture=shown.image.values,
            face_um=made.sheet.at(made.sheet.faces[0], u, v),
            volume_um=np.moveaxis(made.warp.points(u, v), -1, 0),
            pixel_um=_FINE_UM,
        )

    return Sheet(name=folder.name, folder=folder, has_holes=holes > 0, scene=scene)


def other_sheet(folder):
    """Open a sheet of another maker, turned by quarters."""
    how, truth = json.loads((folder / "truth.json").read_text()), np.load(folder / "truth.npz")
    if not (folder / "run").exists():
        map_sheet(folder / "volume.tif", out=folder / "run")
    image = tifffile.imread(folder / "image.tif")
    width, height = how["size_um"]
    low = np.array([0.5 * (width - how["voxel"]), 0.5 * (height - how["voxel"]), -how["z0"]])
    volume = np.stack([truth[k] for k in "xyz"]) + low[:, None, None]
    top, pitch = np.load(folder / "top.npy").astype(np.float64), 1.5
    at = [truth["v"] / pitch + top.shape[0] / 2, truth["u"] / pitch + top.shape[1] / 2]
    face = ndimage.map_coordinates(ndimage.uniform_filter(top, 3), at, order=1, mode="wrap")

    def scene(rng):
        turns = int(rng.integers(4))
        picture, height_um = np.rot90(image / 4095.0, turns), np.rot90(face, turns)
        return Scene(
            picture=picture,
            face_um=height_um,
            volume_um=np.rot90(volume, turns, axes=(1, 2)),
            pixel_um=how["pixel"],
        )

    return Sheet(name=folder.name, folder=folder, has_holes=len(truth["hole_r"]) > 0, scene=scene)


def write(path, scan, dpi):
    """Write a scan as TIFF with its resolution, and that a scanner took it."""
    kind = "rgb" if scan.values.ndim == 3 else "minisblack"
    tifffile.imwrite(
        path,
        scan.values,
        photometric=kind,
        resolution=(dpi, dpi),
        resolutionunit="INCH",
        software="planish flatbed scanner",
    )


@dataclass(frozen=True, kw_only=True)
class Linked:
    """A scan that was linked: errors of its pixels and what is stated, both in um, and r."""

    dpi: int
    has_holes: bool
    errors_um: np.ndarray
    stated_um: np.ndarray
    line_um: float  # rms of the carriage's error along the scan, less what an affine map takes
    r_off: float  # r of the scan less r of the microscope's image
    r_lost: float  # r of the scan less r of its carriage alone, over the same points
    looks: tuple[str, ...]

    @property
    def median_um(self):
        """Median distance."""
        return float(np.median(self.errors_um))

    @property
    def ratio(self):
        """True over stated error."""
        return rms(self.errors_um) / rms(self.stated_um)

    def line(self):
        """Numbers of a row."""
        return (
            f"off {self.median_um:.2f} um (median), {self.ratio:.2f} of what is stated"
            f" (lines {self.line_um:.1f} um);"
            f" r {self.r_off:+.3f}, on the same points {self.r_lost:+.3f};"
            f" {', '.join(self.looks) or 'nothing to look at'}"
        )


def scanned(sheet, number, path):
    """Scan a sheet and link it; None where that is refused, and what was drawn, in words."""
    rng = np.random.default_rng([50, number, int(sheet.has_holes)])
    params = draw_params(replace(SpecimenParams(), seed=int(rng.integers(1 << 30)))).flatbed
    params = replace(params, dpi=(1200.0, 2400.0)[number % 2])
    scene = sheet.scene(rng)
    scan, clean = (
        scan_flatbed(
            scene.picture,
            scene.face_um,
            pixel_um=scene.pixel_um,
            params=traits,
            seed=np.random.SeedSequence([50, number]),
        )
        for traits in (params, replace(params, **_CLEAN))
    )
    write(path, scan, params.dpi)
    drawn = (
        f"{sheet.name} {params.dpi:.0f} dpi, light {params.shading:.3f},"
        f" lens {params.lens_um:.0f} um, gamma {params.gamma}, sharpen {params.sharpen:.1f}"
    )
    try:
        run = link(sheet.folder / "run", path, gamma=params.gamma, **_LINK)
    except PlanishError as error:
        return None, f"{drawn}: refused: {error.text[:120]}"
    errors_um, stated_um = scene.errors_um(scan, run.linked)
    rows = np.arange(scan.lines_um.size)
    line_um = scan.lines_um - np.polyval(np.polyfit(rows, scan.lines_um, 1), rows)
    found = Linked(
        dpi=int(params.dpi),
        has_holes=sheet.has_holes,
        errors_um=errors_um,
        stated_um=stated_um,
        line_um=float(line_um.std()),
        r_off=leading_row(run).r - sheet.microscope_r,
        r_lost=leading_row(run).r - r_beside(run, clean),
        looks=tuple(check.name for check in run.results.checks_in("look", "fail")),
    )
    return found, f"{drawn}: {found.line()}"


def main(pairs=20, first=0, folder=None):
    """Print each link and the goals; the number of goals that were missed."""
    started = time.process_time()
    with folder_for(None if folder is None else Path(folder)) as place:
        home = Path(place)
        sheets = [drawn_sheet(k, home) for k in range(len(SHEETS))]
        sheets += [other_sheet(truth.parent) for truth in sorted(home.glob("*/truth.npz"))]
        found = []
        for has_holes in (False, True):
            alike = [sheet for sheet in sheets if sheet.has_holes == has_holes]
            for number in range(first, first + pairs):
                # Two scans of a sheet, one of each resolution, and on to the next.
                sheet = alike[number // 2 % len(alike)]
                linked, words = scanned(sheet, number, home / "scan.tif")
                found.append(linked)
                print(f"{number}: {words}", flush=True)
    print(f"{time.process_time() - started:.0f} s CPU")
    return judged(found, 2 * pairs)


def judged(found, count):
    """Print the goals; how many were missed."""
    linked = [f for f in found if f is not None]
    wrong = sum(f.median_um > _WRONG_UM for f in linked)
    goals = {
        f"linked: {len(linked)} of {count} (90 %)": len(linked) >= 0.9 * count,
        f"wrongly: {wrong} (0)": wrong == 0,
    }
    by_dpi = defaultdict(list)
    for f in linked:
        by_dpi[f.dpi].append(f)
    for dpi, of_dpi in sorted(by_dpi.items()):
        median = float(np.median([f.median_um for f in of_dpi]))
        goals[f"{dpi} dpi: median {median:.2f} um ({_MOST_UM[dpi]:g})"] = median <= _MOST_UM[dpi]
        for has_holes in (False, True):
            alike = [f for f in of_dpi if f.has_holes == has_holes]
            if alike:
                words = "with holes" if has_holes else "without"
                medians, ratios = [f.median_um for f in alike], [f.ratio for f in alike]
                print(
                    f"{dpi} dpi {words}: median {np.median(medians):.2f} um, most"
                    f" {max(medians):.2f}; true over stated {rms(np.array(ratios)):.2f} pooled"
                )
    ratio = rms(np.array([f.ratio for f in linked]))
    goals[f"true over stated {ratio:.2f} pooled (.7 to 1.5)"] = _RATIO[0] <= ratio <= _RATIO[1]
    for name, words in (("r_off", "of the microscope's image"), ("r_lost", "on the same points")):
        off = [f for f in linked if abs(getattr(f, name)) > _R_APART]
        silent = sum(not f.looks for f in off)
        near = f"r within {_R_APART} of that {words}: {len(linked) - len(off)}"
        goals[f"{near}; of the others without a look: {silent} (0)"] = silent == 0
    for words, is_met in goals.items():
        print(f"{'met' if is_met else 'MISSED'}: {words}")
    return sum(not is_met for is_met in goals.values())
