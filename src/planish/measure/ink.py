"""Penetration of ink: the depth below the top face that holds given shares of the ink on the ray (P-12)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure
from planish.measure import _ray_kernels
from planish.measure.greys import Greys
from planish.measure.options import RayOptions
from planish.measure.rays import Array, Rays
from planish.measure.registry import Measured, ray_property

_SHARES = np.array([0.50, 0.90, 0.95])
REASONS = ("no_ink", "ink_reaches_limit")
NO_INK, AT_LIMIT = 1, 2
_LEAST_VOXELS = 1.0


def _check(options: RayOptions, _greys: Greys) -> None:
    if options.ink_grey is None:
        raise CannotMeasure(
            "The depth of ink needs the grey values that are ink. Give their range as ink_grey = [low, high] in "
            "[properties]; look at a printed and an unprinted spot in the slices."
        )


def _depths(rays: Rays) -> tuple[Array, NDArray[np.uint8]]:
    def work() -> tuple[Array, NDArray[np.uint8]]:
        assert rays.options.ink_grey is not None
        reach = rays.options.ink_reach_um
        limit = 0.5 * (rays.top + rays.bottom) if reach is None else np.maximum(rays.top - reach, rays.bottom)
        low, high = rays.options.ink_grey
        grey, first, step = rays.grey, float(rays.s_um[0]), rays.step_um
        depth, total = _ray_kernels.depths_of_shares(grey, first, step, rays.top, limit, low, high, _SHARES)
        # Ink that is still there where the search ends may go deeper: its shares are not known.
        near, _ = rays.length(limit, limit + step, least=low, most=high)
        reason = np.zeros(total.shape, dtype=np.uint8)
        reason[near > 0.5 * step] = AT_LIMIT
        reason[total < _LEAST_VOXELS * rays.voxel_um] = NO_INK
        return np.where(reason == 0, depth, np.nan), reason

    return rays.once("ink", work)


def _measured(rays: Rays, which: int) -> Measured:
    """SE: the face's and one crossing's with the contrast of half the ink's range."""
    assert rays.options.ink_grey is not None
    depth, reason = _depths(rays)
    low, high = rays.options.ink_grey
    se = np.where(np.isfinite(depth[which]), np.sqrt(2.0) * rays.crossing_se(0.5 * (high - low)), np.nan)
    return Measured(values=depth[which], se=se, reason=reason)


@ray_property("ink_depth_50", units="um", long_name="Depth of half the ink", reasons=REASONS, check=_check)
def ink_depth_50(rays: Rays) -> Measured:
    """P-12: depth below the top face that holds 50 % of the length of ink on the ray.

    Ink is what lies in the grey range ``ink_grey``, from the face down to ``ink_reach_um``. Missing values are
    censored, not zero: where there is no ink (less than a voxel), and where ink reaches the limit of the search. Colour
    that bleeds below a cut surface and dye taken up by the resin look like ink.
    """
    return _measured(rays, 0)


@ray_property("ink_depth_90", units="um", long_name="Depth of 90 % of the ink", reasons=REASONS, check=_check)
def ink_depth_90(rays: Rays) -> Measured:
    """P-12: the same for 90 %."""
    return _measured(rays, 1)


@ray_property("ink_depth_95", units="um", long_name="Depth of 95 % of the ink", reasons=REASONS, check=_check)
def ink_depth_95(rays: Rays) -> Measured:
    """P-12: the same for 95 %."""
    return _measured(rays, 2)
