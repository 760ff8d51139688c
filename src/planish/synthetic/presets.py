"""Papers by name: the ones of Hirn et al.

(2009), and an uncoated and a one-side-coated one as a contrast.

Also every nuisance by its name, the specimen of the demo, and what a user orders by ``planish
specimen``.
"""

from collections.abc import Iterable
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
    size_um=(2400.0, 1800.0),
    paper=PRESETS["wfc135"][1],
    scanner=ScannerParams(voxel_um=4.0, fwhm_um=4.0, grey=FIBRE_CT.grey),
    holes=BurnParams(pattern="irregular", count=6),
    warp=Warp(slope=0.6),
    camera=CameraParams(pixel_um=5.0, shading=0.003, nuisance_sd=0.004, vignetting=0.0),
)
"""The specimen of the demo: in even, diffuse light the image shows mostly what the coating does;
large and bent enough for a gain of r by flattening that its interval shows."""


class Nuisance(NamedTuple):
    """A disturbance that can be switched off, by fields of a section of :class:`SpecimenParams`."""

    title: str
    section: str
    fields: tuple[str, ...]


# What is off has the size 0, but for these fields.
_OFF: dict[str, Any] = {"fibres": None, "axis_ratio": 1.0, "rings": 0, "bits": 16}


NUISANCES: dict[str, Nuisance] = {
    name: Nuisance(title, section, tuple(fields))
    for name, title, section, *fields in (
        (
            "base_texture",
            "grey of fibres and voids",
            "paper",
            "base_density_sd",
            "filler",
            "fibres",
        ),
        ("coating_density", "density of the coating", "paper", "coating_density_sd"),
        ("stage", "stage of the laser", "holes", "stage_um"),
        (
            "hole_shape",
            "shape of the holes",
            "holes",
            "axis_ratio",
            "rim_um",
            "diameter_sd_um",
        ),
        ("hole_axis", "taper and tilt of the holes", "holes", "taper", "tilt_deg"),
        ("char", "burnt rims", "holes", "char_um", "char_sd_um"),
        ("half_closed", "half-closed holes", "holes", "half_closed"),
        ("bump", "bump that cannot be unrolled", "warp", "bump_um"),
        ("scan_blur", "blur of the scan", "scanner", "fwhm_um"),
        ("scan_noise", "noise of the scan", "scanner", "noise"),
        ("fringe", "phase fringe", "scanner", "fringe"),
        ("cupping", "cupping", "scanner", "cupping"),
        ("rings", "rings", "scanner", "rings"),
        ("streaks", "streaks", "scanner", "streak"),
        ("jitter", "jitter of the sections", "sections", "jitter_um"),
        ("walk", "random walk of the sections", "sections", "walk_um"),
        ("section_turn", "rotation of the sections", "sections", "rotation_deg"),
        ("section_place", "thickness of the sections", "sections", "thickness"),
        ("missing", "missing sections", "sections", "missing"),
        ("drift", "colour drift", "sections", "drift"),
        ("defocus", "defocus", "sections", "defocus_um"),
        ("knife", "knife marks", "sections", "knife"),
        (
            "section_noise",
            "noise and resin of the sections",
            "sections",
            "noise",
            "texture",
        ),
        ("calibration", "pixel size of the image", "camera", "scale_range"),
        ("distortion", "distortion of the lens", "camera", "radial"),
        ("stretch", "stretch of the sheet", "camera", "stretch"),
        ("shading", "shading by the topography", "camera", "shading"),
        ("vignetting", "vignetting", "camera", "vignetting"),
        ("lens", "blur of the lens", "camera", "lens_um"),
        ("camera_noise", "noise of the camera", "camera", "noise", "bits"),
    )
}
"""Every disturbance that can be switched off, by name."""


def nuisances_of(params: SpecimenParams, instrument: str) -> list[str]:
    """Return names of the nuisances that are on and act on an instrument.

    Parameters
    ----------
    params : SpecimenParams
    instrument : {"scanner", "sections"}
    """
    other = {"scanner", "sections"} - {instrument}
    return [
        name
        for name, n in NUISANCES.items()
        if n.section not in other and without(params, [name]) != params
    ]


def without(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch nuisances off.

    Parameters
    ----------
    params : SpecimenParams
    names : iterable of str; keys of :data:`NUISANCES`
    """
    for name in names:
        _, section, fields = NUISANCES[name]
        off = {field: _OFF.get(field, 0.0) for field in fields}
        without_it = replace(getattr(params, section), **off)
        params = replace(params, **{section: without_it})
    return params


def with_only(params: SpecimenParams, names: Iterable[str]) -> SpecimenParams:
    """Switch every nuisance off but some.

    Parameters
    ----------
    params : SpecimenParams
    names : iterable of str; keys of :data:`NUISANCES`, which stay on
    """
    kept_names = set(names)
    assert kept_names <= NUISANCES.keys(), (
        f"unknown nuisances {sorted(kept_names - NUISANCES.keys())}"
    )
    return without(params, [name for name in NUISANCES if name not in kept_names])


INSTRUMENTS = ("ct", "sections", "stack", "image", "print", "flatbed")


class SpecimenOptions(Params):
    """The user's order: a paper, a size, the instruments, and their errors."""

    preset: str = option("wfc135", help="Paper; `list` names them.", metavar="NAME")
    size: Literal["T0", "T1", "T2", "T3"] = option(
        "T1", help="0.8 x 0.6, 3 x 2, 8 x 6 or 20 x 15 mm; the last has no voxels."
    )
    slab: bool = option(False, help="A base of one grey with exact faces instead of single fibres.")
    seed: int = option(0, ge=0, help="Another seed gives another specimen.")
    instrument: tuple[str, ...] = option(
        ("ct", "sections", "image", "print"),
        metavar="|".join(INSTRUMENTS),
        help="What is written; repeatable; default: all but 'stack' and 'flatbed'.",
    )
    voxel_um: float = option(3.0, ge=0.5, help="Voxel of the scan.")
    nuisance: tuple[str, ...] | None = option(
        None,
        metavar="NAME",
        help="Switch on only these; repeatable; 'none' for no nuisance; default: all.",
    )
    without: tuple[str, ...] = option(
        (), metavar="NAME", help="Switch these nuisances off; repeatable."
    )

    @field_validator("preset", "instrument", "nuisance", "without")
    @classmethod
    def _check_names(cls, value: Any, info: ValidationInfo) -> Any:
        kind, names = {
            "preset": ("paper", (*PRESETS,)),
            "instrument": ("instrument", INSTRUMENTS),
            "nuisance": ("nuisance", (*NUISANCES, "none")),
            "without": ("nuisance", (*NUISANCES,)),
        }[str(info.field_name)]
        given_names = [value] if isinstance(value, str) else value or ()
        unknown = [name for name in given_names if name not in names]
        if unknown:
            raise ValueError(
                f"there is no {kind} {', '.join(unknown)}; there are {', '.join(names)}"
            )
        return value

    def params(self) -> SpecimenParams:
        """Parameters of the specimen."""
        # A field of a millimetre has no room for the coded pattern.
        holes = BurnParams()
        if self.size == "T0":
            holes = BurnParams(pattern="irregular", count=3)
        paper = PRESETS[self.preset][1]
        if self.slab or self.size == "T3":  # without voxels no fibre is seen
            paper = paper.as_slab()
        scanner = replace(FIBRE_CT if paper.fibres else MICRO_CT, voxel_um=self.voxel_um)
        size_um = SIZES_UM[self.size]
        params = SpecimenParams(
            size_um=size_um, paper=paper, holes=holes, scanner=scanner, seed=self.seed
        )
        if self.nuisance is not None:
            params = with_only(params, set(self.nuisance) - {"none"})
        return without(params, self.without)
