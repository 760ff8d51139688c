"""Make specimens like a real run.

From what its results state of sheet, warp and instruments, and what has to be assumed.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import InputError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.typing import Entries, Floats, Texts
from planish.marks import find_holes
from planish.run import Run, open_run
from planish.synthetic import SIZES_UM, SpecimenParams
from planish.validate.scenario import Scenario

_LEAST_UM = (1200.0, 900.0)  # lateral extent that holds enough holes
# Holes, their distance from the border, area for each.
_LEAST_HOLES, _BORDER_UM, _HOLE_UM2 = 5, 260.0, 75_000.0


def like_run(folder: Path) -> SpecimenTemplate:
    """Find parameters of specimens like a run of one volume.

    FileError if it is damaged, InputError if it lacks any.
    """
    run = open_run(folder)
    volumes = [layer for layer in run.study.layers if layer.kind == "volume"]
    if len(volumes) != 1 or "surfaces" not in run.groups:
        raise InputError(
            f"{folder} does not hold the map of one volume. Give a run of planish map, or of one"
            " volume."
        )
    (volume,) = volumes
    study = run.study
    models = {"surface": volume.surface, "flatten": volume.flatten, "holes": study.holes}
    models |= {"registration": study.registration, "correlate": study.correlate}
    # What is of the specimen itself, or of its own grey.
    excluded = {"marks", "design", "sheet_grey", "seed_um", "labels"}
    template = SpecimenTemplate(run)
    for section, model in models.items():
        options = model.model_dump(mode="json", exclude_none=True, exclude=excluded)
        template.study[section] = options
    template.scan()
    template.greys()
    template.paper()
    template.warp()
    template.camera()
    template.holes()
    template.assumed.append(
        "Fringes, cupping, rings and streaks of a scanner cannot be read from a run: they are off."
    )
    return template


class SpecimenTemplate:
    """Specimens like a real run: parameters, and where each of them comes from."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.params = SpecimenParams()
        # Options of the run that do not belong to its files, for the runs on the specimens.
        self.study: dict[str, Entries] = {}
        self.derived: list[str] = []  # sentences, as those assumed
        self.assumed: list[str] = []
        layers = run.results.layers
        self.layer, self.sheet = next((layer, layer.sheet) for layer in layers if layer.sheet)

    @property
    def notes(self) -> Texts:
        """Sentences on what was taken from the run and what was assumed."""
        taken = [f"Taken: {note}" for note in self.derived]
        assumed = [f"Assumed: {note}" for note in self.assumed]
        return (*taken, *assumed)

    def scenario(self, base: Scenario) -> Scenario:
        """The scenario with this paper and these instruments in place of its own.

        Limits and seeds stay.
        """
        sections = ("paper", "holes", "warp", "scanner", "camera")
        specimen = {name: asdict(getattr(self.params, name)) for name in sections}
        changes = {
            "instrument": "stack",
            "size": self.params.size_um,
            "specimen": specimen,
            "study": self.study,
        }
        name, title = f"{base.name}-like", "Specimens like the given run"
        return base.model_copy(update=changes | {"name": name, "title": title})

    def change(self, section: str, **values: Any) -> None:
        """Replace fields of one section of the parameters."""
        changed = replace(getattr(self.params, section), **values)
        self.params = replace(self.params, **{section: changed})

    def scan(self) -> None:
        """Voxel, lateral size and blur of the volume.

        Specimens have cubes as voxels, of the same volume, and a field within what is made (x, y).
        """
        surfaces, voxel_sides = self.sheet.surfaces, self.layer.source.size_um
        voxel_um = float(np.exp(np.mean(np.log(voxel_sides))))
        sides_um = np.multiply(self.layer.source.shape, voxel_sides).tolist()
        sides = dict(zip("zyx", sides_um, strict=True))
        field = sides[surfaces.col_axis], sides[surfaces.row_axis]
        wide, high = np.clip(field, _LEAST_UM, SIZES_UM["T1"]).tolist()
        self.params = replace(self.params, size_um=(wide, high))
        self.derived.append(f"Voxels of {voxel_um:.3g} um.")
        if max(voxel_sides) > 1.05 * min(voxel_sides):
            stated = " x ".join(f"{v:.3g}" for v in voxel_sides)
            self.assumed.append(f"The voxels are {stated} um; cubes of the same volume are made.")
        if (wide, high) != field:
            run_field, specimen_field = (
                f"{a / 1000:.2g} x {b / 1000:.2g} mm" for a, b in (field, (wide, high))
            )
            self.assumed.append(
                f"The field is {run_field}; specimens of {specimen_field} are made."
            )
        self.change("scanner", voxel_um=voxel_um)
        if blur := surfaces.blur_um:
            self.change("scanner", fwhm_um=2.3548 * blur)  # of a Gaussian: 2 sqrt(2 ln 2)
            self.derived.append(
                f"Blur of {blur:.2g} um (standard deviation), learnt by the surface search."
            )

    def greys(self) -> None:
        """Noise of the volume, and how bright base and coating are in it.

        The contrast of the brighter layer to the air is the unit of both. Nothing is taken where
        the run does not state its greys.
        """
        surfaces = self.sheet.surfaces
        air, base, noise = surfaces.grey_air, surfaces.grey_base, surfaces.grey_noise
        if air is None or base is None or noise is None:
            return
        coating = surfaces.grey_coating_top
        if coating is None:
            coating = surfaces.grey_coating_bottom
        bright = base if coating is None else coating
        if bright == air:
            return
        self.change("scanner", noise=noise / abs(bright - air))
        self.derived.append(
            f"Noise of {100 * self.params.scanner.noise:.2g} % of the contrast to air."
        )
        if coating is not None:
            dark, _, light = self.params.scanner.grey
            share = float(np.clip((base - air) / (coating - air), 0.05, 0.95))
            middle = dark + share * (light - dark)
            self.change("scanner", grey=(dark, middle, light))
            self.derived.append(f"The base paper is {share:.2g} times as bright as the coating.")

    def paper(self) -> None:
        """Thicknesses of the layers, and how uneven the coating is; the rest stays as it is."""
        thicknesses = self.sheet.properties
        if any(p.mean is None for p in thicknesses.values()):
            raise InputError(
                "The run withholds its thicknesses, because a check failed. Mend what it names"
                " first."
            )
        for side in ("top", "bottom"):
            coating = thicknesses.get(f"coating_{side}")
            self.change("paper", **{f"coating_{side}_um": coating.mean if coating else 0.0})
            self.derived.append(
                f"Coating on the {side} side: {f'{coating.mean:.3g} um' if coating else 'none'}."
            )
        top = thicknesses.get("coating_top")
        base = thicknesses.get("base_thickness") or thicknesses["thickness"]
        self.change("paper", coating_sd_um=top.sd if top else 0.0, base_um=base.mean)
        self.derived.append(f"Base paper of {base.mean:.3g} um.")
        self.assumed.append(
            "The coating's spread holds its error of measurement: specimens are a little too"
            " uneven."
        )
        self.assumed.append(
            "Roughness, formation and densities are those of a wood-free coated paper."
        )

    def warp(self) -> None:
        """Steepest slope, direction and wavelength of the centre surface.

        The direction is that of the principal axis of all slopes; a sheet of one rolling wave is
        made, of the slope along that axis that 95 % keep below. Angles count from x towards y of
        the flat map as the top shows it.
        """
        surfaces, flat = self.run.groups["surfaces"], self.run.groups["flat"]
        steps = pitch(surfaces)
        # The slopes of the warp are those of the centre surface over 300 um.
        down, across = (max(1, int(300.0 / 4 / p)) for p in steps)
        spacing_um = [down * steps[0], across * steps[1]]
        centre = surfaces["centre"].values[::down, ::across].astype(np.float64)
        if min(centre.shape) < 3:
            raise InputError(
                "The field of the run is too small to measure how the sheet is bent. Give a larger"
                " one."
            )
        dz_dy, dz_dx = np.array(np.gradient(centre, *spacing_um))
        is_finite = np.isfinite(dz_dy) & np.isfinite(dz_dx)
        if np.count_nonzero(is_finite) < 10:
            raise InputError(
                "The run holds almost no centre surface. Check its report before making specimens"
                " like it."
            )
        slopes = np.stack([dz_dx[is_finite], dz_dy[is_finite]], axis=1)
        slopes -= slopes.mean(axis=0)  # a tilt of the whole sheet makes it no harder to flatten
        _, directions = np.linalg.eigh(slopes.T @ slopes)
        cross, ruled = directions.T  # of the smaller and of the larger scatter
        ruled_slopes, cross_slopes = slopes @ ruled, slopes @ cross
        # Of a sine, 0.997 of the steepest.
        steepest_slope = float(np.percentile(np.abs(ruled_slopes), 95))
        if Frame.of(surfaces).mirrored:
            directions = directions * np.array([[-1.0], [1.0]])
        x, y = directions[:, 1]
        steepest_deg = float(np.rad2deg(np.arctan2(y, x)))
        ruling = (steepest_deg + 90.0) % 180.0 - 90.0
        wavelength_um = _wavelength(centre, spacing_um, steepest_slope)
        self.change("warp", slope=steepest_slope, wavelength_um=wavelength_um, ruling_deg=ruling)
        self.derived.append(
            f"Slopes of up to {steepest_slope:.2g} (95 %), rolled along {ruling:.0f} degrees, waves"
            f" of {wavelength_um:.0f} um."
        )
        ruled_square = max(float(np.mean(ruled_slopes**2)), 1e-12)
        share = float(np.sqrt(np.mean(cross_slopes**2) / ruled_square))
        self.assumed.append(
            f"The sheet is bent in one direction only; across it the slopes are {share:.2g} times"
            " as large."
        )
        growth_um: list[float] = []
        for axis in "uv":
            flattened = np.ptp(_finite(flat[axis].values))
            projected = np.ptp(_finite(flat[f"projected_{axis}"].values))
            growth_um.append(float(flattened - projected))
        self.derived.append(
            f"For comparison: flattening made the run's sheet longer by {growth_um[0]:.0f} x"
            f" {growth_um[1]:.0f} um."
        )

    def camera(self) -> None:
        """Pixel size and pose of the image, and how well it follows the coating.

        The deviation of the registration's scale from 1 becomes the range of the camera's scale.
        """
        results = self.run.results
        registration = self.layer.registration
        if registration is None or results.reference.kind != "image":
            self.assumed.append(
                f"The run has no image: one with pixels of {self.params.camera.pixel_um:g} um is"
                " made."
            )
            return
        pixel_um = float(np.sqrt(np.prod(results.reference.source.size_um)))
        turn_deg = registration.rotation_deg
        scale_range = abs(registration.scale - 1.0)
        self.derived.append(f"Image pixels of {pixel_um:.3g} um, turned by {turn_deg:.1f} degrees.")
        self.change(
            "camera",
            pixel_um=pixel_um,
            turn_deg=turn_deg,
            turn_range_deg=0.0,
            scale_range=scale_range,
        )
        of_headline = [row for row in results.correlations if row.a_map == self.layer.headline]
        r2 = next((row.r2 for row in of_headline if row.point_um > 50), None)
        if r2 is not None and 0.01 < r2 < 0.99:
            self.change("camera", oracle_r2=r2)
            self.derived.append(
                f"The image follows the coating with r2 = {r2:.2g} at larger points."
            )
            self.assumed.append(
                "That r2 is taken as the true one; measuring errors make it a little too low."
            )

    def holes(self) -> None:
        """Number and diameter of the holes that the run's image shows.

        As many as there is room for, and `_LEAST_HOLES` at least, so that specimens can be linked.
        """
        width, height = self.params.size_um
        inner_um2 = (width - 2 * _BORDER_UM) * (height - 2 * _BORDER_UM)
        most_holes = max(_LEAST_HOLES, int(inner_um2 / _HOLE_UM2))
        diameters_um = np.empty(0)
        hole_um = self.run.study.holes.hole_um
        if (linked := self.run.groups.get("linked")) is not None:
            image = np.asarray(linked["image"].values)
            holes = find_holes(image, pixel_um=pitch(linked), diameter_um=hole_um)
            diameters_um = holes["diameter"].values.astype(np.float64)
        if diameters_um.size > 1:
            median_um = float(np.median(diameters_um))
            sd_um = float(diameters_um.std(ddof=1))
            self.change("holes", diameter_um=median_um, diameter_sd_um=sd_um)
            self.derived.append(
                f"{diameters_um.size} holes of {median_um:.0f} um, as the image shows them."
            )
        else:
            self.assumed.append(
                f"Holes of {self.params.holes.diameter_um:.3g} um: the image of the run shows none."
            )
        count = min(max(_LEAST_HOLES, diameters_um.size), most_holes)
        self.change("holes", pattern="irregular", count=count)
        self.assumed.append(
            f"{count} holes are scattered over each specimen, and not where they are in the run."
        )


def _wavelength(centre: Floats, spacing_um: list[float], slope: float) -> float:
    """Return the wavelength of a sine with this steepest slope and the centre surface's height.

    It is 2 pi A / slope.
    """
    heights = _finite(centre)
    rows, cols = np.nonzero(np.isfinite(centre))
    plane = np.stack([np.ones(heights.size), rows, cols], axis=1)
    coefficients, *_ = np.linalg.lstsq(plane, heights, rcond=None)
    detrended = heights - plane @ coefficients
    span = max(np.multiply(centre.shape, spacing_um).tolist())
    amplitude = float(np.sqrt(2.0) * detrended.std())
    wavelength = 2 * np.pi * amplitude / max(slope, 1e-6)
    # Shorter waves than the surface search passes cannot be in its result; longer ones than the
    # field look like a tilt.
    return float(np.clip(wavelength, 800.0, 4 * span))


def _finite(values: Floats) -> Floats:
    """Values that are known, one after the other."""
    return values[np.isfinite(values)]
