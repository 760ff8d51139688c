"""Every nuisance by its name: what switches it off, and which stage ought to feel it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from planish.synthetic.params import SpecimenParams


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisance:
    """Something that disturbs a measurement and can be switched off.

    Attributes
    ----------
    title : str
        For a table.
    section : str
        Field of :class:`SpecimenParams` that it belongs to.
    off : mapping
        Fields of that section and their values when it is off.
    """

    title: str
    section: str
    off: Mapping[str, Any]


NUISANCES: dict[str, Nuisance] = {
    "base_texture": Nuisance(
        title="grey of fibres and voids", section="paper", off={"base_density_sd": 0.0, "filler": 0.0}
    ),
    "coating_density": Nuisance(title="density of the coating", section="paper", off={"coating_density_sd": 0.0}),
    "stage": Nuisance(title="stage of the laser", section="holes", off={"stage_um": 0.0}),
    "hole_shape": Nuisance(
        title="shape of the holes", section="holes", off={"axis_ratio": 1.0, "rim_um": 0.0, "diameter_sd_um": 0.0}
    ),
    "hole_axis": Nuisance(title="taper and tilt of the holes", section="holes", off={"taper": 0.0, "tilt_deg": 0.0}),
    "char": Nuisance(title="burnt rims", section="holes", off={"char_um": 0.0, "char_sd_um": 0.0}),
    "half_closed": Nuisance(title="half-closed holes", section="holes", off={"half_closed": 0.0}),
    "bump": Nuisance(title="bump that cannot be unrolled", section="warp", off={"bump_um": 0.0}),
    "scan_blur": Nuisance(title="blur of the scan", section="scanner", off={"fwhm_um": 0.0}),
    "scan_noise": Nuisance(title="noise of the scan", section="scanner", off={"noise": 0.0}),
    "fringe": Nuisance(title="phase fringe", section="scanner", off={"fringe": 0.0}),
    "cupping": Nuisance(title="cupping", section="scanner", off={"cupping": 0.0}),
    "rings": Nuisance(title="rings", section="scanner", off={"rings": 0}),
    "streaks": Nuisance(title="streaks", section="scanner", off={"streak": 0.0}),
    "jitter": Nuisance(title="jitter of the sections", section="sections", off={"jitter_um": 0.0}),
    "walk": Nuisance(title="random walk of the sections", section="sections", off={"walk_um": 0.0}),
    "section_turn": Nuisance(title="rotation of the sections", section="sections", off={"rotation_deg": 0.0}),
    "section_place": Nuisance(title="thickness of the sections", section="sections", off={"thickness": 0.0}),
    "missing": Nuisance(title="missing sections", section="sections", off={"missing": 0.0}),
    "drift": Nuisance(title="colour drift", section="sections", off={"drift": 0.0}),
    "defocus": Nuisance(title="defocus", section="sections", off={"defocus_um": 0.0}),
    "knife": Nuisance(title="knife marks", section="sections", off={"knife": 0.0}),
    "section_noise": Nuisance(
        title="noise and resin of the sections", section="sections", off={"noise": 0.0, "texture": 0.0}
    ),
    "calibration": Nuisance(title="pixel size of the image", section="camera", off={"scale_range": 0.0}),
    "distortion": Nuisance(title="distortion of the lens", section="camera", off={"radial": 0.0}),
    "stretch": Nuisance(title="stretch of the sheet", section="camera", off={"stretch": 0.0}),
    "lateral": Nuisance(title="lateral scattering", section="camera", off={"lateral_um": 0.0}),
    "shading": Nuisance(title="shading by the topography", section="camera", off={"shading": 0.0}),
    "vignetting": Nuisance(title="vignetting", section="camera", off={"vignetting": 0.0}),
    "lens": Nuisance(title="blur of the lens", section="camera", off={"lens_um": 0.0}),
    "camera_noise": Nuisance(title="noise of the camera", section="camera", off={"noise": 0.0, "bits": 16}),
}
_INSTRUMENTS = {"scanner", "sections"}


def nuisances_of(params: SpecimenParams, instrument: str) -> list[str]:
    """Names of the nuisances that are on in ``params`` and that ``instrument`` ("scanner" or "sections") can see."""
    unseen = _INSTRUMENTS - {instrument}
    return [name for name, n in NUISANCES.items() if n.section not in unseen and _off(params, n) != params]


def without(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch the named nuisances off."""
    for name in names:
        params = _off(params, NUISANCES[name])
    return params


def with_only(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch every nuisance off but the named ones."""
    keep = set(names)
    assert keep <= NUISANCES.keys(), f"unknown nuisances {sorted(keep - NUISANCES.keys())}"
    return without(params, [name for name in NUISANCES if name not in keep])


def amended(params: Any, changes: Mapping[str, Any]) -> Any:
    """Replace fields by name; a mapping goes into the field that holds a dataclass.

    Raises
    ------
    KeyError
        If there is no such field; the message names it.
    """
    known = {f.name for f in fields(params)}
    done: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in known:
            raise KeyError(name)
        old = getattr(params, name)
        if isinstance(value, Mapping) and is_dataclass(old):
            done[name] = amended(old, value)  # type: ignore[reportUnknownArgumentType]
        else:
            done[name] = tuple(value) if isinstance(old, tuple) else value  # type: ignore[reportUnknownArgumentType]
    return replace(params, **done)


def _off(params: SpecimenParams, nuisance: Nuisance) -> SpecimenParams:
    section = getattr(params, nuisance.section)
    return replace(params, **{nuisance.section: replace(section, **nuisance.off)})
