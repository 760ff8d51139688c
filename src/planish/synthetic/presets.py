"""Papers by name: the ones of Hirn et al. (2009), and an uncoated and a one-side-coated one as a contrast.

Also the specimen of the demo, and what a user orders by ``planish specimen``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

from pydantic import ValidationInfo, field_validator

from planish.core.options import Params, option
from planish.synthetic.nuisances import NUISANCES, with_only
from planish.synthetic.params import SIZES_UM, CameraParams, HoleParams, PaperParams, ScannerParams, SpecimenParams
from planish.synthetic.warp import Warp

_WFC135 = PaperParams(base_um=59.5)  # section 3.3.1, before calendering: base 59.5, coating 17.4 um

PRESETS: dict[str, tuple[str, PaperParams]] = {
    "wfc90": (
        "wood-free coated, 90 g/m2, section 3.4",
        PaperParams(base_um=50.0, coating_top_um=10.0, coating_bottom_um=10.0, coating_sd_um=3.8, roughness_um=3.2),
    ),
    "wfc118": (
        "wood-free coated, 118 g/m2, section 3.3.2",
        PaperParams(base_um=55.0, coating_top_um=14.5, coating_bottom_um=14.5, coating_sd_um=4.3),
    ),
    "wfc135": ("wood-free coated, 135 g/m2, before calendering, section 3.3.1", _WFC135),
    "wfc135-calendered": (
        "the same after calendering: base 50.5, coating 16.6 um, outer faces half as rough",
        replace(_WFC135, base_um=50.5, coating_top_um=16.6, coating_bottom_um=16.6, calendering=0.5),
    ),
    "sc50": (
        "supercalendered, uncoated, filled, 50 g/m2, section 2.1",
        PaperParams(
            base_um=42.0, coating_top_um=0.0, coating_bottom_um=0.0, coating_sd_um=0.0, roughness_um=2.0,
            base_fibre_sd_um=2.2, base_floc_sd_um=1.8, base_g_per_cm3=1.15, filler=0.30, calendering=0.5,
        ),
    ),
    "board": (
        "folding boxboard, coated on its top side only, about 230 g/m2",
        PaperParams(
            base_um=330.0, base_fibre_sd_um=6.0, base_floc_sd_um=8.0, roughness_um=6.0, coating_top_um=20.0,
            coating_bottom_um=0.0, coating_sd_um=5.5, base_g_per_cm3=0.60,
        ),
    ),
}  # fmt: skip

# A scanner as scanners are: the plain one of the defaults has only blur and noise.
MICRO_CT = ScannerParams(
    fwhm_um=4.0, noise=0.08, noise_px=2.0, fringe=0.12, cupping=0.04, rings=2, streak=0.03, grey=(40.0, 80.0, 180.0)
)

# Diffuse light and an even base: the image shows mostly what the coating does.
DEMO = SpecimenParams(
    size_um=(1800.0, 1300.0),
    holes=HoleParams(pattern="irregular", count=6),
    warp=Warp(wavelength_um=2000.0),
    camera=CameraParams(shading=0.003, nuisance_sd=0.004),
)


INSTRUMENTS = ("ct", "sections", "stack", "image", "print")


class SpecimenOptions(Params):
    """What a user orders: a paper, a size, the instruments, and their errors."""

    preset: str = option("wfc135", help="Paper; --list names them.", metavar="NAME")
    size: Literal["T0", "T1", "T2", "T3"] = option(
        "T1", help="0.8 x 0.6, 3 x 2, 8 x 6 or 20 x 15 mm; the last has no voxels."
    )
    seed: int = option(0, ge=0, help="Another one, another specimen.")
    instrument: tuple[str, ...] = option(
        ("ct", "sections", "image", "print"), metavar="|".join(INSTRUMENTS),
        help="What is written; repeatable. All but 'stack' where not given.",
    )  # fmt: skip
    voxel_um: float = option(3.0, ge=0.5, help="Voxel of the scan.")
    nuisance: tuple[str, ...] | None = option(
        None, metavar="NAME", help="Only these are on; repeatable. 'none': no nuisance. All are on where not given."
    )

    @field_validator("preset", "instrument", "nuisance")
    @classmethod
    def _known(cls, value: Any, info: ValidationInfo) -> Any:
        what, names = {
            "preset": ("paper", (*PRESETS,)),
            "instrument": ("instrument", INSTRUMENTS),
            "nuisance": ("nuisance", (*NUISANCES, "none")),
        }[str(info.field_name)]
        if unknown := [name for name in ([value] if isinstance(value, str) else value or ()) if name not in names]:
            raise ValueError(f"there is no {what} {', '.join(unknown)}; there are {', '.join(names)}")
        return value

    def params(self) -> SpecimenParams:
        """Parameters of the specimen."""
        # A field of a millimetre has no room for the coded pattern.
        holes = HoleParams(pattern="irregular", count=3) if self.size == "T0" else HoleParams()
        params = SpecimenParams(
            size_um=SIZES_UM[self.size], paper=PRESETS[self.preset][1], holes=holes,
            scanner=replace(MICRO_CT, voxel_um=self.voxel_um), seed=self.seed,
        )  # fmt: skip
        return params if self.nuisance is None else with_only(params, set(self.nuisance) - {"none"})
