"""Specimens that differ from one another in one thing each: nothing may hang on our own generator's habits.

``python -m benchmarks variants [seed]``
"""

from __future__ import annotations

from typing import Any

from planish.validate.certify import run_scenario
from planish.validate.scenario import Scenario

_PLAIN: dict[str, Any] = {"holes": {"pattern": "irregular", "count": 6}, "camera": {"radial": 0.0, "stretch": 0.0}}
_FIGURES = (
    "recall_image", "recall_volume", "tre_median", "tre_p95", "pixel_coating_top_bias", "pixel_coating_top_rmse",
    "pixel_base_thickness_rmse", "r_point", "r_true_point", "tre_projection_p95",
)  # fmt: skip

VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "uncoated back": {"paper": {"coating_bottom_um": 0.0}},
    "base at half the coating": {"scanner": {"grey": [30.0, 115.0, 200.0]}},
    "faint base": {"scanner": {"grey": [20.0, 60.0, 230.0]}},
    "noise 10 %": {"scanner": {"noise": 0.10}},
    "no noise": {"scanner": {"noise": 0.0}},
    "blur 9.4 um": {"scanner": {"fwhm_um": 9.4}},
    "thin coating 8 um": {"paper": {"coating_top_um": 8.0, "coating_bottom_um": 8.0, "coating_sd_um": 3.0}},
    "inverted grey": {"scanner": {"grey": [220.0, 160.0, 40.0]}},
    "16 bit": {"scanner": {"grey": [9000.0, 20000.0, 48000.0], "dtype": "uint16"}},
    "float, air at zero": {"scanner": {"grey": [0.0, 0.3, 1.0], "dtype": "float32"}},
    "voxel 2 um, pixel 8 um": {"scanner": {"voxel_um": 2.0}, "camera": {"pixel_um": 8.0}},
    "voxel 5 um, pixel 2.6 um": {"scanner": {"voxel_um": 5.0}, "camera": {"pixel_um": 2.6}},
    "turned by 155 deg": {"camera": {"turn_deg": 155.0}},
    "slope 30 deg, steep ruling": {"warp": {"slope": 0.577, "ruling_deg": 65.0, "wavelength_um": 2400.0}},
    "tilt 15 deg": {"warp": {"slope": 0.1, "tilt_deg": 15.0}},
    "bump 60 um": {"warp": {"bump_um": 60.0, "bump_radius_um": 700.0}},
    "flat": {"warp": {"slope": 0.0}},
}


def main(seed: int = 3) -> int:
    """Print a line a variant; return how many ended in an error or with a quality gate failed."""
    print(f"{'':28s}" + " ".join(f"{name[-15:]:>15s}" for name in _FIGURES))
    failed = 0
    for name, changes in VARIANTS.items():
        specimen = {k: _PLAIN.get(k, {}) | changes.get(k, {}) for k in _PLAIN.keys() | changes.keys()}
        scenario = Scenario(name="variant", title=name, size=(1800.0, 1300.0), specimen=specimen)
        entry = run_scenario(scenario, [seed]).entries[0]
        values = (entry.values.get(figure) for figure in _FIGURES)
        words = "; ".join([*entry.failed, *([entry.refusal] if entry.refusal else [])])
        print(f"{name:28s}" + " ".join(f"{'-' if v is None else f'{v:.3f}':>15s}" for v in values) + f"  {words}")
        failed += bool(words)
    return failed
