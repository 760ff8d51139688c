"""Specimens like a real run: what its results say of sheet, warp and instruments, and what has to be assumed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import InputError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.marks import find_holes
from planish.pipeline import Run, open_run
from planish.pipeline.sheet import Sheet
from planish.study import Study
from planish.synthetic.params import SIZES_UM, SpecimenParams
from planish.validate.scenario import Scenario

Array = NDArray[np.float64]

_FWHM = 2.3548  # of a Gaussian, in standard deviations: 2 sqrt(2 ln 2)
_LEAST_UM = (1200.0, 900.0)  # lateral extent that holds enough holes
_LEAST_HOLES, _BORDER_UM, _HOLE_UM2 = 5, 260.0, 75_000.0  # holes, their distance from the border, area for each
_SPECK_UM = 300.0  # the slopes of the warp are those of the centre surface over such lengths


@dataclass(frozen=True, slots=True, kw_only=True)
class Like:
    """Parameters of specimens like a real run, and where each of them comes from.

    Attributes
    ----------
    params : SpecimenParams
    study : dict
        Tables of the run's own study that do not belong to its files, for the runs on the specimens.
    taken, assumed : tuple of str
        Sentences.
    """

    params: SpecimenParams
    study: dict[str, dict[str, Any]]
    taken: tuple[str, ...]
    assumed: tuple[str, ...]

    def scenario(self, base: Scenario) -> Scenario:
        """The scenario with this paper and these instruments in place of its own; limits and seeds stay."""
        changes = {
            name: _as_dict(getattr(self.params, name)) for name in ("paper", "holes", "warp", "scanner", "camera")
        }
        return base.model_copy(
            update={
                "name": f"{base.name}-like",
                "title": "Specimens like the given run",
                "instrument": "stack",
                "size": self.params.size_um,
                "specimen": changes,
                "study": self.study,
                "kind": "line",
            }
        )


def like_run(folder: Path) -> Like:
    """Read a run folder and find the parameters of specimens that are like it.

    Parameters
    ----------
    folder : Path
        Run folder with ``results.json``, ``run.toml`` and ``maps.zarr``; of a map or a link.

    Returns
    -------
    Like

    Raises
    ------
    FileError
        If a file of the run is missing or damaged.
    InputError
        If the run does not hold what is needed.
    """
    run = open_run(folder)
    sheet = run.sheet()
    taken: list[str] = []
    assumed: list[str] = []
    params = _with_scan(SpecimenParams(), sheet, taken, assumed)
    params = _with_paper(params, sheet, taken, assumed)
    params = _with_warp(params, run.groups, taken, assumed)
    params = _with_camera(params, run, taken, assumed)
    params = _with_holes(params, run.study, run.groups, taken, assumed)
    parts = {
        "surface": sheet.params.surface, "flatten": sheet.params.flatten, "holes": run.study.holes,
        "registration": run.study.registration, "correlate": run.study.correlate,
    }  # fmt: skip
    tables = {
        name: part.model_dump(mode="json", exclude_none=True, exclude={"marks", "sheet_grey"})
        for name, part in parts.items()
    }
    assumed.append("Fringes, cupping, rings and streaks of a scanner cannot be read from a run: they are off.")
    return Like(params=params, study=tables, taken=tuple(taken), assumed=tuple(assumed))


def _with_scan(params: SpecimenParams, sheet: Sheet, taken: list[str], assumed: list[str]) -> SpecimenParams:
    """Voxel, size, blur and noise of the volume."""
    volume, surfaces = sheet.source, sheet.facts.surfaces
    voxel = [float(v) for v in volume.size_um]
    size = float(np.exp(np.mean(np.log(voxel))))
    sides = dict(zip("zyx", (n * v for n, v in zip(volume.shape, voxel, strict=True)), strict=True))
    wide, high = sides[surfaces.col_axis], sides[surfaces.row_axis]
    most = SIZES_UM["T1"]
    extent = (float(np.clip(wide, _LEAST_UM[0], most[0])), float(np.clip(high, _LEAST_UM[1], most[1])))
    taken.append(f"Voxels of {size:.3g} um.")
    if max(voxel) > 1.05 * min(voxel):
        assumed.append(f"The voxels are {' x '.join(f'{v:.3g}' for v in voxel)} um; cubes of the same volume are made.")
    if extent != (wide, high):
        assumed.append(
            f"The field is {wide / 1000:.2g} x {high / 1000:.2g} mm; specimens of "
            f"{extent[0] / 1000:.2g} x {extent[1] / 1000:.2g} mm are made."
        )
    scanner = replace(params.scanner, voxel_um=size)
    blur = surfaces.blur_um
    if blur:
        scanner = replace(scanner, fwhm_um=_FWHM * float(blur))
        taken.append(f"Blur of {float(blur):.2g} um (standard deviation), as the surface search learnt it.")
    air, base, noise = (surfaces.grey_air, surfaces.grey_base, surfaces.grey_noise)
    coating = next((g for g in (surfaces.grey_coating_top, surfaces.grey_coating_bottom) if g is not None), None)
    bright = coating if coating is not None else base
    contrast = abs(float(bright) - float(air))
    if contrast > 0 and noise is not None:
        scanner = replace(scanner, noise=float(noise) / contrast)
        taken.append(f"Noise of {100 * scanner.noise:.2g} % of the contrast to air.")
        if coating is not None:
            step = scanner.grey[2] - scanner.grey[0]
            share = float(np.clip((float(base) - float(air)) / (float(coating) - float(air)), 0.05, 0.95))
            scanner = replace(scanner, grey=(scanner.grey[0], scanner.grey[0] + share * step, scanner.grey[2]))
            taken.append(f"The base paper is {share:.2g} times as bright as the coating.")
    return replace(params, size_um=extent, scanner=scanner)


def _with_paper(params: SpecimenParams, sheet: Sheet, taken: list[str], assumed: list[str]) -> SpecimenParams:
    """Thicknesses of the layers."""
    found = sheet.facts.properties
    paper = params.paper
    for side in ("top", "bottom"):
        layer = found.get(f"coating_{side}")
        mean = layer.mean if layer else 0.0
        paper = replace(paper, **{f"coating_{side}_um": mean})
        taken.append(f"Coating on the {side} side: {f'{mean:.3g} um' if layer else 'none'}.")
    top = found.get("coating_top")
    paper = replace(paper, coating_sd_um=top.sd if top else 0.0)
    base = found.get("base_thickness") or found["thickness"]
    paper = replace(paper, base_um=base.mean)
    taken.append(f"Base paper of {paper.base_um:.3g} um.")
    assumed.append("The spread of the coating holds the error of its measurement: specimens are a little too uneven.")
    assumed.append("Roughness, formation and densities are those of a wood-free coated paper.")
    return replace(params, paper=paper)


def _with_warp(
    params: SpecimenParams, groups: dict[str, xr.Dataset], taken: list[str], assumed: list[str]
) -> SpecimenParams:
    """Steepest slope, direction and wavelength of the centre surface."""
    surfaces, flat = groups["surfaces"], groups["flat"]
    steps = pitch(surfaces)
    every = [max(1, int(_SPECK_UM / 4 / p)) for p in steps]
    centre = np.asarray(surfaces["centre"].values[:: every[0], :: every[1]], dtype=np.float64)
    if min(centre.shape) < 3:
        raise InputError("The field of the run is too small to tell how the sheet is bent. Give a larger one.")
    down, across = (np.gradient(centre, e * p, axis=i) for i, (e, p) in enumerate(zip(every, steps, strict=True)))
    known = np.isfinite(down) & np.isfinite(across)
    if np.count_nonzero(known) < 10:
        raise InputError("The run holds next to no centre surface. Look at its report before making specimens like it.")
    slopes = np.stack([across[known], down[known]], axis=1)
    slopes -= slopes.mean(axis=0)  # a tilt of the whole sheet makes it no harder to flatten
    _, directions = np.linalg.eigh(slopes.T @ slopes)
    along, aside = slopes @ directions[:, 1], slopes @ directions[:, 0]
    slope = float(np.percentile(np.abs(along), 95))  # of a sine, 0.997 of the steepest
    if Frame.of(surfaces).mirrored:
        directions = directions * np.array([[-1.0], [1.0]])
    ruling = float(np.rad2deg(np.arctan2(directions[1, 1], directions[0, 1])))
    ruling = (ruling + 90.0) % 180.0 - 90.0
    waves = _wavelength(centre, every, steps, slope)
    taken.append(f"Slopes of up to {slope:.2g} (95 %), rolled along {ruling:.0f} degrees, waves of {waves:.0f} um.")
    share = float(np.sqrt(np.mean(aside**2) / max(float(np.mean(along**2)), 1e-12)))
    assumed.append(
        f"The sheet is taken to be bent in one direction only; across it the slopes are {share:.2g} times as large."
    )
    stretch = [
        float(np.nanmax(flat[a].values) - np.nanmin(flat[a].values))
        - float(np.nanmax(flat[b].values) - np.nanmin(flat[b].values))
        for a, b in (("u", "projected_u"), ("v", "projected_v"))
    ]
    taken.append(f"For comparison: flattening made the run's sheet longer by {stretch[0]:.0f} x {stretch[1]:.0f} um.")
    warp = replace(params.warp, slope=slope, wavelength_um=waves, ruling_deg=ruling)
    return replace(params, warp=warp)


def _wavelength(centre: Array, every: list[int], pitch: tuple[float, float], slope: float) -> float:
    """Wavelength of a sine with this steepest slope and the height of the centre surface: 2 pi A / slope."""
    known = centre[np.isfinite(centre)]
    y, x = np.indices(centre.shape)[:, np.isfinite(centre)]
    plane = np.stack([np.ones(known.size), y.astype(np.float64), x.astype(np.float64)], axis=1)
    height = known - plane @ np.linalg.lstsq(plane, known, rcond=None)[0]
    span = max(n * e * p for n, e, p in zip(centre.shape, every, pitch, strict=True))
    amplitude = float(np.sqrt(2.0) * height.std())
    # Shorter waves than the surface search passes cannot be in its result; longer ones than the field look like a tilt.
    return float(np.clip(2 * np.pi * amplitude / max(slope, 1e-6), 800.0, 4 * span))


def _with_camera(
    params: SpecimenParams,
    run: Run,
    taken: list[str],
    assumed: list[str],
) -> SpecimenParams:
    """Pixel size and pose of the image."""
    image, marks = run.results.reference, run.results.layers[0].registration
    if image.kind != "image" or marks is None:
        assumed.append(f"The run has no image: one with pixels of {params.camera.pixel_um:g} um is made.")
        return params
    pixel = float(np.sqrt(np.prod([float(v) for v in image.source.size_um])))
    taken.append(f"Image pixels of {pixel:.3g} um, turned by {marks.rotation_deg:.1f} degrees.")
    camera = replace(
        params.camera,
        pixel_um=pixel,
        turn_deg=marks.rotation_deg,
        turn_range_deg=0.0,
        scale_range=abs(marks.scale - 1.0),
    )
    r2 = next(
        (r.r2 for r in run.results.correlations if r.a_map == run.results.layers[0].headline and r.point_um > 50), None
    )
    if r2 is not None and 0.01 < r2 < 0.99 and "linked" in run.groups:
        camera = replace(camera, oracle_r2=float(r2))
        taken.append(f"The image follows the coating with r2 = {float(r2):.2g} at larger points.")
        assumed.append("That r2 is taken as the true one; measuring errors make it a little too low.")
    return replace(params, camera=camera)


def _with_holes(
    params: SpecimenParams, study: Study, groups: dict[str, xr.Dataset], taken: list[str], assumed: list[str]
) -> SpecimenParams:
    """Number and diameter of the holes that the run's image shows."""
    width, height = params.size_um
    room = max(_LEAST_HOLES, int((width - 2 * _BORDER_UM) * (height - 2 * _BORDER_UM) / _HOLE_UM2))
    holes, count = params.holes, _LEAST_HOLES
    found = None
    if "linked" in groups:
        linked = groups["linked"]
        pixel = pitch(linked)
        found = find_holes(np.asarray(linked["image"].values), pixel_um=pixel, diameter_um=study.holes.hole_um)
    if found is not None and found.sizes["mark"] > 1:
        sizes = np.asarray(found["diameter"].values, dtype=np.float64)
        count = max(count, len(sizes))
        holes = replace(holes, diameter_um=float(np.median(sizes)), diameter_sd_um=float(sizes.std(ddof=1)))
        taken.append(f"{len(sizes)} holes of {holes.diameter_um:.0f} um, as the image shows them.")
    else:
        assumed.append(f"Holes of {holes.diameter_um:.3g} um: the image of the run shows none.")
    holes = replace(holes, pattern="irregular", count=min(count, room))
    assumed.append(f"{holes.count} holes are scattered over each specimen, and not where they are in the run.")
    return replace(params, holes=holes)


def _as_dict(section: Any) -> dict[str, Any]:
    return {name: getattr(section, name) for name in section.__dataclass_fields__}
