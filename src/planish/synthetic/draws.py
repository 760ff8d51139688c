"""Specimens that nobody chose: every parameter drawn from the range in which real papers and instruments lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from planish.synthetic.fields import generator
from planish.synthetic.nuisances import amended
from planish.synthetic.params import SpecimenParams

# (low, high): drawn evenly between them, whole numbers where both are; a list: one of them.
RANGES: dict[str, dict[str, tuple[float, float] | list[Any]]] = {
    "paper": {
        "base_um": (50.0, 60.0),
        "base_fibre_sd_um": (2.0, 4.0),
        "base_floc_sd_um": (1.5, 3.5),
        "base_streak_sd_um": (0.0, 1.0),
        "roughness_um": (2.5, 4.5),
        "anisotropy": (1.3, 1.8),
        "coating_top_um": (9.0, 20.0),
        "coating_bottom_um": (9.0, 20.0),
        "coating_sd_um": (3.0, 5.0),
        "levelling_um": (150.0, 350.0),
        "calendering": (0.5, 1.0),
        "coating_density_sd": (0.0, 0.06),
        "base_density_sd": (0.1, 0.25),
        "filler": (0.05, 0.15),
    },
    "holes": {
        "diameter_um": (150.0, 200.0),
        "stage_um": (0.0, 8.0),
        "axis_ratio": (1.0, 1.12),
        "rim_um": (2.0, 5.0),
        "taper": (0.05, 0.2),
        "tilt_deg": (0.0, 3.0),
        "char_um": (20.0, 50.0),
        "half_closed": (0.0, 0.1),
    },
    "warp": {
        "slope": (0.0, 0.42),
        "tilt_deg": (-7.0, 7.0),
        "wavelength_um": (2500.0, 15000.0),
        "phase_rad": (0.0, 6.28),
        "ruling_deg": (-90.0, 90.0),
        "bump_um": [0.0, 0.0, 50.0, 100.0, 150.0],
        "bump_radius_um": (1500.0, 3000.0),
    },
    "scanner": {
        "voxel_um": (2.4, 3.2),
        "fwhm_um": (3.0, 5.0),
        "noise": (0.03, 0.10),
        "noise_px": (0.0, 2.0),
        "fringe": (0.0, 0.12),
        "cupping": (0.0, 0.05),
        "rings": (0, 3),
        "streak": (0.0, 0.03),
    },
    "sections": {
        "pixel_um": (2.0, 3.0),
        "section_um": (2.5, 4.0),
        "jitter_um": (0.5, 2.0),
        "walk_um": (0.0, 0.2),
        "rotation_deg": (0.0, 0.03),
        "thickness": (0.0, 0.10),
        "missing": (0.0, 0.02),
        "drift": (0.0, 0.04),
        "defocus_um": (0.3, 1.2),
        "knife": (0.0, 0.03),
        "noise": (0.01, 0.04),
    },
    "camera": {
        "pixel_um": (2.6, 8.0),
        "turn_deg": (-180.0, 180.0),
        "scale_range": (0.0, 0.01),
        "radial": (-0.001, 0.001),
        "stretch": (0.0, 0.002),
        "backing": ["pile", "black"],
        "nuisance_sd": (0.004, 0.015),
        "shading": (0.0, 0.02),
        "vignetting": (0.0, 0.06),
        "lens_um": (2.0, 4.0),
        "noise": (0.003, 0.008),
    },
}


def draw_params(params: SpecimenParams) -> SpecimenParams:
    """Draw every parameter of :data:`RANGES` by the seed of ``params``; what is not named there stays."""
    rng = generator(params.seed, "draws")
    changes = {
        section: {name: _draw(limits, rng) for name, limits in ranges.items()} for section, ranges in RANGES.items()
    }
    return amended(params, changes)


def _draw(limits: tuple[float, float] | list[Any], rng: np.random.Generator) -> Any:
    if isinstance(limits, list):
        return limits[int(rng.integers(len(limits)))]
    low, high = limits
    if isinstance(low, int) and isinstance(high, int):
        return int(rng.integers(low, high + 1))
    return float(rng.uniform(low, high))
