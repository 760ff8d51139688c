"""Right specimens with their exact truth: some by planish.synthetic, some by a second maker that
shares no code."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.paper import KINDS
from benchmarks.wrong import maker
from benchmarks.wrong.truth import LARGE_UM, SIZE_UM, Right, heights, layer
from planish.synthetic import (
    MICRO_CT,
    PRESETS,
    BurnParams,
    CameraParams,
    SectionsParams,
    SpecimenParams,
    Warp,
    make_specimen,
)
from planish.validate.truth import field_at

_SECTIONS = SectionsParams(pixel_um=2.5, section_um=4.0)


@dataclass(frozen=True, kw_only=True)
class Draw:
    """What is ordered: the maker, a seed, and what the kind of input asks for."""

    maker: str = "planish"
    seed: int = 0
    large: bool = False
    coated: bool = True
    steep: bool = False
    # Kind of benchmarks.paper whose sheet is laid fibre by fibre; a slab where empty.
    fibres: str = ""
    holes: int | None = None
    slope: float | None = None
    # Seed of the hole pattern, where two specimens share the laser's program.
    program: int | None = None


@lru_cache(maxsize=24)
def drawn(order):
    """Make a specimen, or take it from the last ones made."""
    return _ours(order) if order.maker == "planish" else maker.make(order)


def _ours(order):
    params = _of_fibres(order) if order.fibres else _slab(order)
    # The pattern of another specimen: the same seed for the holes, another for the paper.
    if order.program is not None:
        return _reprogrammed(params, order)
    while True:
        try:
            return _right(make_specimen(params), order)
        except ValueError:  # so many holes do not fit
            params = replace(params, holes=replace(params.holes, count=params.holes.count - 2))


def _slab(order):
    rng = np.random.default_rng([7, order.seed])
    # For a quick run.
    thin = {name: paper for name, (_, paper) in PRESETS.items() if paper.base_um < 80.0}
    names = [name for name, paper in thin.items() if (paper.coating_top_um > 0) == order.coated]
    paper = thin[str(rng.choice(names))].as_slab()
    slope = order.slope
    if slope is None:
        slope = rng.uniform(0.5, 0.9) if order.steep else rng.uniform(0.02, 0.4)
    voxel = rng.uniform(4.4, 5.4) if paper.coating_top_um > 12 or not order.coated else 3.8
    scanner = replace(
        MICRO_CT,
        voxel_um=voxel,
        fwhm_um=rng.uniform(1.0, 1.5) * voxel,
        noise=rng.uniform(0.03, 0.08),
        fringe=float(rng.choice([0.0, 0.1])),
        cupping=rng.uniform(0, 0.03),
        rings=int(rng.integers(0, 3)),
        streak=rng.uniform(0, 0.02),
    )
    return SpecimenParams(
        size_um=_size(order),
        paper=paper,
        seed=order.seed,
        scanner=scanner,
        sections=_SECTIONS,
        holes=_holes(order, rng),
        warp=Warp(
            slope=slope,
            wavelength_um=rng.uniform(1800, 4000),
            phase_rad=rng.uniform(0, 6.28),
            ruling_deg=rng.uniform(-90, 90),
            tilt_deg=rng.uniform(-4, 4),
        ),
        camera=_camera(rng),
        stiffness=float(np.random.default_rng([9, order.seed]).uniform(0, 3)),
    )


def _of_fibres(order):
    """A sheet of single fibres with as many holes, and a camera, as the slabs have."""
    rng = np.random.default_rng([11, order.seed])
    params = KINDS[order.fibres].draw(rng)
    holes = _holes(order, rng)
    warp = params.warp if order.slope is None else replace(params.warp, slope=order.slope)
    return replace(
        params,
        size_um=_size(order),
        holes=holes,
        warp=warp,
        camera=_camera(rng),
        sections=_SECTIONS,
    )


def _size(order):
    return LARGE_UM if order.large else SIZE_UM


def _holes(order, rng):
    count = order.holes or int(rng.integers(8, 13) if order.large else rng.integers(6, 9))
    return BurnParams(
        pattern="irregular", count=count, diameter_um=rng.uniform(115, 140), char_um=20.0
    )


def _camera(rng):
    """Even, diffuse light: a fall-off is no right input, and light from one side none.

    On uncoated sheets a shading of 0.004 moves r by up to 0.15.
    """
    return CameraParams(
        pixel_um=rng.uniform(4.0, 5.5),
        shading=0.0,
        nuisance_sd=0.005,
        radial=rng.uniform(0, 4e-4),
        vignetting=0.0,
        scale_range=0.005,
    )


def _reprogrammed(params, order):
    """The holes of the specimen of the seed ``program`` in the sheet of this seed."""
    from planish.synthetic.sheet import make_sheet

    first = drawn(replace(order, seed=order.program or 0, program=None)).made["specimen"]
    low = np.array(first.sheet.origin) - 400.0
    high = np.array(first.sheet.origin) + 3.0 * np.array(first.sheet.faces.shape[:0:-1]) + 400.0
    stage = np.random.default_rng([8, order.seed]).normal(
        0, params.holes.stage_um, first.sheet.holes.shape
    )
    sheet = make_sheet(
        params.paper,
        first.params.holes,
        low=low,
        high=high,
        centres=first.sheet.holes + stage,
        seed=order.seed,
        stiffness=params.stiffness,
    )
    params = replace(params, holes=first.params.holes, size_um=first.params.size_um)
    return _right(make_specimen(params, sheet=sheet), order)


def _right(made, order):
    p, sheet, warp = made.params, made.sheet, made.warp
    under = np.stack([made.columns[k].values for k in ("u", "v", "centre")], axis=-1)
    step = p.scanner.voxel_um
    return Right(
        maker="planish",
        seed=order.seed,
        volume=made.volume.values,
        voxel_um=step,
        grey=p.scanner.grey,
        noise=p.scanner.noise * (p.scanner.grey[2] - p.scanner.grey[0]),
        image=np.asarray(made.image.values, np.float64),
        pixel_um=p.camera.pixel_um,
        holes=sheet.holes,
        radius_um=0.5 * p.holes.diameter_um,
        material=warp.material,
        points=lambda uv: warp.points(uv[..., 0], uv[..., 1]),
        thickness=lambda name, u, v: field_at(sheet, layer(sheet.faces, name), u, v),
        image_of=made.pose,
        pixels=lambda: np.stack([made.truth["u"].values, made.truth["v"].values], axis=-1),
        columns=under,
        faces=heights(under, step, sheet.faces, sheet.at),
        note=(
            f"base {p.paper.base_um:g}, coating {p.paper.coating_top_um:g}, slope"
            f" {p.warp.slope:.2f}"
        ),
        made={"specimen": made},
    )
