"""Papers by name: the ones of Hirn et al.

(2009), and an uncoated and a one-side-coated one as a contrast.

Also every nuisance by its name, the specimen of the demo, and what a user orders by ``planish
specimen``.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Literal, NamedTuple

from pydantic import ValidationInfo, field_validator

from planish.core.options import Params, option
from planish.synthetic.params import (
    SIZES_UM,
    BurnParams,
    CameraParams,
    FibreParams,
    PaperParams,
    ScannerParams,
    SpecimenParams,
    Warp,
)


def _of_fibres(paper: PaperParams, **fibres: Any) -> PaperParams:
    g_per_m2 = paper.base_um * paper.base_g_per_cm3 * (1 - paper.filler)
    return replace(paper, fibres=FibreParams(g_per_m2=g_per_m2, **fibres), least_coating_um=0.5)


_UNCOATED = PaperParams(coating_top_um=0.0, coating_bottom_um=0.0, coating_sd_um=0.0)
_WFC135 = PaperParams(base_um=59.5)  # section 3.3.1, before calendering: base 59.5, coating 17.4 um
PRESETS: dict[str, tuple[str, PaperParams]] = {
    "wfc90": (
        "wood-free coated, 90 g/m2, section 3.4",
        _of_fibres(
            PaperParams(
                base_um=50.0,
                coating_top_um=10.0,
                coating_bottom_um=10.0,
                coating_sd_um=3.8,
                roughness_um=3.2,
            )
        ),
    ),
    "wfc118": (
        "wood-free coated, 118 g/m2, section 3.3.2",
        _of_fibres(
            PaperParams(
                base_um=55.0, coating_top_um=14.5, coating_bottom_um=14.5, coating_sd_um=4.3
            )
        ),
    ),
    "wfc135": (
        "wood-free coated, 135 g/m2, before calendering, section 3.3.1",
        _of_fibres(_WFC135),
    ),
    "wfc135-calendered": (
        "the same after calendering: base 50.5, coating 16.6 um, outer faces half as rough",
        _of_fibres(
            replace(
                _WFC135,
                base_um=50.5,
                coating_top_um=16.6,
                coating_bottom_um=16.6,
                calendering=0.5,
            )
        ),
    ),
    "sc50": (
        "supercalendered, uncoated, filled, 50 g/m2, section 2.1",
        _of_fibres(
            replace(
                _UNCOATED,
                base_um=42.0,
                roughness_um=2.0,
                base_fibre_sd_um=2.2,
                base_floc_sd_um=1.8,
                base_g_per_cm3=1.15,
                filler=0.30,
                calendering=0.5,
            ),
            fuzz_per_mm2=4.0,
        ),
    ),
    "copy80": (
        "copy paper, uncoated, bulky, 80 g/m2",
        _of_fibres(
            replace(
                _UNCOATED,
                base_um=105.0,
                roughness_um=6.0,
                base_fibre_sd_um=4.0,
                base_floc_sd_um=4.0,
                filler=0.10,
            ),
            lumen_um=(0.0, 10.0),
            fuzz_per_mm2=8.0,
        ),
    ),
    "board": (
        "folding boxboard, coated on its top side only, about 230 g/m2",
        _of_fibres(
            PaperParams(
                base_um=330.0,
                base_fibre_sd_um=6.0,
                base_floc_sd_um=8.0,
                roughness_um=6.0,
                coating_top_um=20.0,
                coating_bottom_um=0.0,
                coating_sd_um=5.5,
                base_g_per_cm3=0.60,
            ),
            lumen_um=(0.0, 10.0),
            cell_um=3.0,
        ),
    ),
}
"""Papers by name: what they are, and their parameters."""

MICRO_CT = ScannerParams(
    fwhm_um=4.0,
    noise=0.08,
    noise_px=2.0,
    fringe=0.12,
    cupping=0.04,
    rings=2,
    streak=0.03,
    grey=(40.0, 80.0, 180.0),
)
"""A scanner as scanners are: the plain one of the defaults has only blur and noise."""

FIBRE_CT = replace(MICRO_CT, grey=(40.0, 110.0, 190.0))
"""The same with the grey of a fibre's wall in place of that of a whole base, half of which is
air."""

DEMO = SpecimenParams(
    size_um=(1800.0, 1300.0),
    paper=PRESETS["wfc135"][1],
    scanner=ScannerParams(fwhm_um=4.0, grey=FIBRE_CT.grey),
    holes=BurnParams(pattern="irregular", count=6),
    warp=Warp(wavelength_um=2000.0),
    camera=CameraParams(shading=0.003, nuisance_sd=0.004),
)
"""The specimen of the demo: under diffuse light, with an even base, the image shows mostly what the
coating does."""


class Nuisance(NamedTuple):
    """A disturbance that can be switched off.

    ``off`` holds values of the ``section`` of :class:`SpecimenParams`.
    """

    title: str
    section: str
    off: Mapping[str, Any]


NUISANCES: dict[str, Nuisance] = {
    name: Nuisance(title, section, off)
    for name, title, section, off in (
        (
            "base_texture",
            "grey of fibres and voids",
            "paper",
            {"base_density_sd": 0.0, "filler": 0.0, "fibres": None},
        ),
        ("coating_density", "density of the coating", "paper", {"coating_density_sd": 0.0}),
        ("stage", "stage of the laser", "holes", {"stage_um": 0.0}),
        (
            "hole_shape",
            "shape of the holes",
            "holes",
            {"axis_ratio": 1.0, "rim_um": 0.0, "diameter_sd_um": 0.0},
        ),
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
        (
            "section_noise",
            "noise and resin of the sections",
            "sections",
            {"noise": 0.0, "texture": 0.0},
        ),
        ("calibration", "pixel size of the image", "camera", {"scale_range": 0.0}),
        ("distortion", "distortion of the lens", "camera", {"radial": 0.0}),
        ("stretch", "stretch of the sheet", "camera", {"stretch": 0.0}),
        ("shading", "shading by the topography", "camera", {"shading": 0.0}),
        ("vignetting", "vignetting", "camera", {"vignetting": 0.0}),
        ("lens", "blur of the lens", "camera", {"lens_um": 0.0}),
        ("camera_noise", "noise of the camera", "camera", {"noise": 0.0, "bits": 16}),
    )
}
"""Every disturbance that can be switched off, by name."""


def nuisances_of(params: SpecimenParams, instrument: str) -> list[str]:
    """Return names of the nuisances that are on in ``params`` and act on ``instrument``.

    The instrument is "scanner" or "sections".
    """
    other = {"scanner", "sections"} - {instrument}
    return [
        name
        for name, n in NUISANCES.items()
        if n.section not in other and without(params, [name]) != params
    ]


def without(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch the named nuisances off."""
    for _, section, off in (NUISANCES[name] for name in names):
        params = replace(params, **{section: replace(getattr(params, section), **off)})
    return params


def with_only(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch every nuisance off but the named ones."""
    kept_names = set(names)
    assert kept_names <= NUISANCES.keys(), (
        f"unknown nuisances {sorted(kept_names - NUISANCES.keys())}"
    )
    return without(params, [name for name in NUISANCES if name not in kept_names])


INSTRUMENTS = ("ct", "sections", "stack", "image", "print")


class SpecimenOptions(Params):
    """The user's order: a paper, a size, the instruments, and their errors."""

    preset: str = option("wfc135", help="Paper; `list` names them.", metavar="NAME")
    size: Literal["T0", "T1", "T2", "T3"] = option(
        "T1", help="0.8 x 0.6, 3 x 2, 8 x 6 or 20 x 15 mm; the last has no voxels."
    )
    slab: bool = option(
        False, help="A base of one grey with exact faces, in place of single fibres."
    )
    seed: int = option(0, ge=0, help="Another one, another specimen.")
    instrument: tuple[str, ...] = option(
        ("ct", "sections", "image", "print"),
        metavar="|".join(INSTRUMENTS),
        help="What is written; repeatable. All but 'stack' where not given.",
    )
    voxel_um: float = option(3.0, ge=0.5, help="Voxel of the scan.")
    nuisance: tuple[str, ...] | None = option(
        None,
        metavar="NAME",
        help="Only these are on; repeatable. 'none': no nuisance. All are on where not given.",
    )

    @field_validator("preset", "instrument", "nuisance")
    @classmethod
    def _check_names(cls, value: Any, info: ValidationInfo) -> Any:
        kind, names = {
            "preset": ("paper", (*PRESETS,)),
            "instrument": ("instrument", INSTRUMENTS),
            "nuisance": ("nuisance", (*NUISANCES, "none")),
        }[str(info.field_name)]
        if unknown := [
            name
            for name in ([value] if isinstance(value, str) else value or ())
            if name not in names
        ]:
            raise ValueError(
                f"there is no {kind} {', '.join(unknown)}; there are {', '.join(names)}"
            )
        return value

    def params(self) -> SpecimenParams:
        """Parameters of the specimen."""
        # A field of a millimetre has no room for the coded pattern.
        holes = BurnParams(pattern="irregular", count=3) if self.size == "T0" else BurnParams()
        paper = PRESETS[self.preset][1]
        if self.slab or self.size == "T3":  # without voxels no fibre is seen
            paper = paper.as_slab()
        params = SpecimenParams(
            size_um=SIZES_UM[self.size],
            paper=paper,
            holes=holes,
            scanner=replace(FIBRE_CT if paper.fibres else MICRO_CT, voxel_um=self.voxel_um),
            seed=self.seed,
        )
        return params if self.nuisance is None else with_only(params, set(self.nuisance) - {"none"})
