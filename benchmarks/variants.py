"""Specimens that differ from the acceptance specimen in one thing each: nothing may hang on our own generator's habits.

``python -m benchmarks variants [seed]``
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from benchmarks.ledger import ledger
from planish.core.errors import PlanishError
from planish.pipeline import Run, run_study
from planish.study import ImageSection, Study, VolumeSection
from planish.synthetic import Specimen, SpecimenParams, Warp, make_specimen, write_specimen
from planish.synthetic.sheet import SheetParams

_SMALL = SpecimenParams(size_um=(1800.0, 1300.0), holes=6)


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A specimen and how its files are written and read; ``write`` returns the paths and the sections' parameters."""

    name: str
    params: SpecimenParams
    volume: Callable[[np.ndarray], np.ndarray] = lambda v: v
    through: str = "z"
    top: str = "high"
    image: str = "tif"


def _turned(volume: np.ndarray) -> np.ndarray:
    """Turn the specimen by half a turn about x: top side down, without mirroring it."""
    return volume[::-1, ::-1]


VARIANTS = [
    Variant(name="as it is", params=_SMALL),
    Variant(name="uncoated back", params=replace(_SMALL, sheet=SheetParams(coating_bottom_um=0.0))),
    Variant(name="base at half the coating", params=replace(_SMALL, grey=(30.0, 115.0, 200.0))),
    Variant(name="faint base", params=replace(_SMALL, grey=(20.0, 60.0, 230.0))),
    Variant(name="noise 10 %", params=replace(_SMALL, noise=0.10)),
    Variant(name="no noise", params=replace(_SMALL, noise=0.0)),
    Variant(name="blur 4 um", params=replace(_SMALL, blur_um=4.0)),
    Variant(
        name="thin coating 8 um", params=replace(_SMALL, sheet=SheetParams(coating_top_um=8.0, coating_bottom_um=8.0))
    ),
    Variant(name="inverted grey", params=replace(_SMALL, grey=(220.0, 160.0, 40.0))),
    Variant(name="16 bit", params=replace(_SMALL, grey=(9000.0, 20000.0, 48000.0), dtype=np.uint16)),
    Variant(name="float, air at zero", params=replace(_SMALL, grey=(0.0, 0.3, 1.0), dtype=np.float32)),
    Variant(
        name="voxel 2 um, pixel 8 um",
        params=replace(_SMALL, size_um=(1400.0, 1100.0), voxel_um=2.0, pixel_um=8.0, holes=5),
    ),
    Variant(name="voxel 5 um, pixel 2.6 um", params=replace(_SMALL, voxel_um=5.0, pixel_um=2.6)),
    Variant(name="turned by 155 deg", params=replace(_SMALL, rotation_deg=155.0, scale=0.985)),
    Variant(
        name="slope 30 deg, steep ruling",
        params=replace(_SMALL, warp=Warp(slope=0.577, ruling_deg=65.0, wavelength_um=2400.0)),
    ),
    Variant(name="bump 60 um", params=replace(_SMALL, warp=Warp(bump_um=60.0, bump_radius_um=700.0))),
    Variant(name="flat", params=replace(_SMALL, warp=Warp(slope=0.0))),
    Variant(name="12 holes", params=replace(_SMALL, size_um=(2400.0, 1800.0), holes=12)),
    Variant(name="through x", params=_SMALL, volume=lambda v: np.moveaxis(v, 0, 2), through="x"),
    Variant(name="top at the low end", params=_SMALL, volume=_turned, top="low"),
    Variant(name="JPEG in colour", params=_SMALL, image="jpg"),
]


def run_variant(variant: Variant, seed: int) -> tuple[Specimen, Run]:
    """Make, write and link one variant."""
    specimen = make_specimen(replace(variant.params, seed=seed))
    p = specimen.params
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        volume, image = write_specimen(specimen, folder / "specimen")
        section: dict[str, Any] = {"through": variant.through, "top": variant.top}
        turned = variant.volume(specimen.volume)
        if turned is not specimen.volume:
            tifffile.imwrite(volume, np.ascontiguousarray(turned))
            section["voxel_um"] = (p.voxel_um,) * 3
        picture: dict[str, Any] = {}
        if variant.image == "jpg":
            image = image.with_suffix(".jpg")
            grey = np.clip(specimen.image * 255, 0, 255)
            Image.fromarray(np.stack([grey, grey * 0.97, grey * 0.9], axis=-1).astype(np.uint8)).save(image, quality=92)
            picture["pixel_um"] = (p.pixel_um, p.pixel_um)
        study = Study(volume=VolumeSection(path=str(volume), **section), image=ImageSection(path=str(image), **picture))
        return specimen, run_study(study, folder / "run")


def main(seed: int = 3) -> int:
    """Print a line a variant; return how many ended in an error."""
    print(f"{'variant':28s} holes  loo  pos50  pos95 | coating bias  rmse | base bias  rmse |   r2   true  proj  cover")
    failed = 0
    for variant in VARIANTS:
        try:
            specimen, run = run_variant(variant, seed)
        except PlanishError as error:
            print(f"{variant.name:28s} {type(error).__name__}: {error}", flush=True)
            failed += 1
            continue
        if variant.volume is not VARIANTS[0].volume:
            m = run.results["marks"]
            c = run.results["properties"]["coating_top"]
            rows = [r for r in run.results["table"] if r["registration"].startswith("flattened")]
            print(
                f"{variant.name:28s} {m['matched']:2d}/{specimen.params.holes:2d} "
                f"{m['leave_one_out_rms_um']:5.2f}  coating mean "
                f"{c['mean_um']:.2f}  r2 {rows[0]['r2']:.3f} mirrored {m['mirrored']}",
                flush=True,
            )
            continue
        e = ledger(specimen, run)
        print(
            f"{variant.name:28s} {e.found:2d}/{e.holes:2d} {e.leave_one_out:5.2f} {e.position_median:6.2f} "
            f"{e.position_p95:6.2f} | "
            f"{e.coating_bias:12.2f} {e.coating_rmse:5.2f} | {e.base_bias:9.2f} {e.base_rmse:5.2f} | "
            f"{e.r2:.3f}  {e.r2_true:.3f} "
            f"{e.r2_projection:.3f}  {e.coverage:.2f}" + ("" if run.passed else "  gate failed"),
            flush=True,
        )
    return failed
