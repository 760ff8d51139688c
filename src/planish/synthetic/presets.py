"""Papers by name: the ones of Hirn et al. (2009), and an uncoated and a one-side-coated one as a contrast."""

from __future__ import annotations

from dataclasses import replace

from planish.synthetic.params import PaperParams, ScannerParams

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


def preset(name: str) -> PaperParams:
    """Return the paper of that name; KeyError where there is none."""
    return PRESETS[name][1]
