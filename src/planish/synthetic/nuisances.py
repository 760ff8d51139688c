"""Every nuisance by its name: what switches it off."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from planish.synthetic.params import SpecimenParams


class Nuisance(NamedTuple):
    """A disturbance that can be switched off: ``off`` holds values of the ``section`` of :class:`SpecimenParams`."""

    title: str
    section: str
    off: Mapping[str, Any]


NUISANCES: dict[str, Nuisance] = {
    name: Nuisance(title, section, off)
    for name, title, section, off in (
        ("base_texture", "grey of fibres and voids", "paper", {"base_density_sd": 0.0, "filler": 0.0}),
        ("coating_density", "density of the coating", "paper", {"coating_density_sd": 0.0}),
        ("stage", "stage of the laser", "holes", {"stage_um": 0.0}),
        ("hole_shape", "shape of the holes", "holes", {"axis_ratio": 1.0, "rim_um": 0.0, "diameter_sd_um": 0.0}),
        ("hole_axis", "taper and tilt of the holes", "holes", {"taper": 0.0, "tilt_deg": 0.0}),
        ("char", "burnt rims", "holes", {"char_um": 0.0, "char_sd_um": 0.0}),
        ("half_closed", "half-closed holes", "holes", {"half_closed": 0.0}),
        ("bump", "bump that cannot be unrolled", "warp", {"bump_um": 0.0}),
        ("scan_blur", "blur of the scan", "scanner", {"fwhm_um": 0.0}),
        ("scan_noise", "noise of the scan", "scanner", {"noise": 0.0}),
        ("fringe", "phase fringe", "scanner", {"fringe": 0.0}),
        ("cupping", "cupping", "scanner", {"cupping": 0.0}),
        ("rings", "rings", "scanner", {"rings": 0}),
        ("streaks", "streaks", "scanner", {"streak": 0.0}),
        ("jitter", "jitter of the sections", "sections", {"jitter_um": 0.0}),
        ("walk", "random walk of the sections", "sections", {"walk_um": 0.0}),
        ("section_turn", "rotation of the sections", "sections", {"rotation_deg": 0.0}),
        ("section_place", "thickness of the sections", "sections", {"thickness": 0.0}),
        ("missing", "missing sections", "sections", {"missing": 0.0}),
        ("drift", "colour drift", "sections", {"drift": 0.0}),
        ("defocus", "defocus", "sections", {"defocus_um": 0.0}),
        ("knife", "knife marks", "sections", {"knife": 0.0}),
        ("section_noise", "noise and resin of the sections", "sections", {"noise": 0.0, "texture": 0.0}),
        ("calibration", "pixel size of the image", "camera", {"scale_range": 0.0}),
        ("distortion", "distortion of the lens", "camera", {"radial": 0.0}),
        ("stretch", "stretch of the sheet", "camera", {"stretch": 0.0}),
        ("lateral", "lateral scattering", "camera", {"lateral_um": 0.0}),
        ("shading", "shading by the topography", "camera", {"shading": 0.0}),
        ("vignetting", "vignetting", "camera", {"vignetting": 0.0}),
        ("lens", "blur of the lens", "camera", {"lens_um": 0.0}),
        ("camera_noise", "noise of the camera", "camera", {"noise": 0.0, "bits": 16}),
    )
}
_INSTRUMENTS = {"scanner", "sections"}


def nuisances_of(params: SpecimenParams, instrument: str) -> list[str]:
    """Names of the nuisances that are on in ``params`` and act on ``instrument`` ("scanner" or "sections")."""
    other = _INSTRUMENTS - {instrument}
    return [name for name, n in NUISANCES.items() if n.section not in other and without(params, [name]) != params]


def without(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch the named nuisances off."""
    for _, section, off in (NUISANCES[name] for name in names):
        params = replace(params, **{section: replace(getattr(params, section), **off)})
    return params


def with_only(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch every nuisance off but the named ones."""
    keep = set(names)
    assert keep <= NUISANCES.keys(), f"unknown nuisances {sorted(keep - NUISANCES.keys())}"
    return without(params, [name for name in NUISANCES if name not in keep])
