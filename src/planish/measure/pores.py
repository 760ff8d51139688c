"""Size of the pores of the base: chords in the plane of the sheet, and the largest spheres that fit (P-10).

Pores are voids (:func:`~planish.measure.phases.void_level`) inside the base; they end at its interfaces. What is
smaller than two voxels is not seen. Neither size has a standard error: it depends on which voids were resolved, and a
distribution of pores needs 20 mm2 to be stable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.phases import void_level
from planish.measure.registry import ray_property

if TYPE_CHECKING:
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Rays


class Options(Params):
    """Options of the pores' sizes."""

    pore_limit_um: float = option(40.0, gt=0, cli=None, help="Size above which pores are not distinguished.")


def _voids(rays: Rays) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Samples that are void (rows, cols, s), and how many there are on each ray."""

    def work() -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        # Beyond what any base reaches there is no void; one sample more on either side is the wall there.
        samples = rays.samples_within(*rays.core, more=1)
        beyond = rays.greys.polarity * (rays.grey[..., samples] - np.float32(void_level(rays.greys, rays.params)))
        void = ((beyond < 0) & rays.between(*rays.core)[..., samples]).astype(np.uint8)
        return void, void.sum(axis=-1, dtype=np.int64)

    return rays.cached("voids", work)


def _reach(params: MeasureParams) -> float:
    return params.pore_limit_um


def chords(void: NDArray[np.uint8], axis: int, most: int) -> NDArray[np.int64]:
    """Sum over the void samples of each ray of the run of void through them along an axis, in steps (rows, cols).

    A run ends ``most`` steps to each side.
    """
    total = np.zeros(void.shape, dtype=np.int16)
    for turned in (slice(None), slice(None, None, -1)):
        lines, sums = (np.moveaxis(a, axis, 0)[turned] for a in (void, total))
        run = np.zeros(lines.shape[1:], dtype=np.int16)
        for line, to in zip(lines, sums, strict=True):
            run = np.minimum(run + 1, most) * line
            to += run
    return (total - (void > 0)).sum(axis=-1)


@ray_property("pore_chord", units="um", long_name="Pore chord in the plane", halo_um=_reach, support_um=_reach)
def pore_chord(rays: Rays) -> Floats:
    """Mean in-plane length of the voids on the ray: of the runs through each void sample, along rows and columns.

    Lengths are those in the centre surface. A run counts ``pore_limit_um`` to each side and no further. Longer runs
    hold more samples and count so much more often. NaN where the ray meets no void.
    """
    void, count = _voids(rays)
    total = np.zeros(count.shape)
    for k, pitch in enumerate(rays.pitch_um):
        along = chords(void, k, max(int(rays.params.pore_limit_um / pitch), 1))
        total += 0.5 * along * pitch * rays.stretch[..., k]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(count > 0, total / count, np.nan)


def distances(void: NDArray[np.uint8], step: tuple[float, float, float], most: float) -> NDArray[np.float32]:
    """Distance of each void sample to the nearest solid one, no more than ``most``; um, 0 in the solid."""
    from scipy import ndimage

    if void.all():
        return np.full(void.shape, most, dtype=np.float32)
    return np.minimum(ndimage.distance_transform_edt(void, sampling=step), most).astype(np.float32)


@ray_property("pore_diameter", units="um", long_name="Pore diameter", support_um=_reach,
              halo_um=lambda params: 1.5 * params.pore_limit_um)  # fmt: skip
def pore_diameter(rays: Rays) -> Floats:
    """Diameter of the largest sphere inside the voids, at most ``pore_limit_um``, mean over the void on the ray.

    Each void sample takes the largest sphere that holds it. The distance to the nearest solid sample is half a sample
    too long; a mean half step is taken off. Distances along slopes are stretched by the sheet's mean slope. NaN where
    the ray meets no void.
    """
    from planish.measure import _pore_kernels

    void, count = _voids(rays)
    step = rays.pitch_um[0] * rays.mean_stretch[0], rays.pitch_um[1] * rays.mean_stretch[1], rays.step_um
    half = 0.5 * float(np.mean(step))
    distance = distances(void, step, 0.5 * rays.params.pore_limit_um + half)
    radius = _pore_kernels.inscribed(distance, step)
    size = np.where(void > 0, 2 * np.maximum(radius - half, 0.5 * half), 0.0).sum(axis=-1, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(count > 0, size / count, np.nan)
