"""Penetration of ink: the depth below the top face that holds given shares of the ink on the ray (P-12)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.registry import Measured, ray_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Rays


class Options(Params):
    """Options of the penetration of ink."""

    ink_grey: tuple[float, float] | None = option(
        None, metavar="LOW,HIGH", help="Grey range of ink, for the depth to which it penetrates."
    )
    ink_reach_um: float | None = option(
        None,
        gt=0,
        cli=None,
        help="Depth below the top face to which ink is looked for; half the sheet where not given.",
    )

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.ink_grey is not None and not self.ink_grey[0] < self.ink_grey[1]:
            raise ValueError(f"ink_grey runs from {self.ink_grey[0]:g} to {self.ink_grey[1]:g}; give the smaller first")
        return self


_SHARES = np.array([0.50, 0.90, 0.95])
REASONS = ("no_ink", "ink_reaches_limit")
NO_INK, AT_LIMIT = 1, 2
_LEAST_VOXELS = 1.0


def _check(params: MeasureParams, _greys: Greys) -> None:
    if params.ink_grey is None:
        raise CannotMeasure(
            "The depth of ink needs the grey values that are ink. Give their range as ink_grey = [low, high] in "
            "[properties] of a study file; look at a printed and an unprinted spot in the slices."
        )


def _depths(rays: Rays) -> tuple[Floats, NDArray[np.uint8]]:
    from planish.measure import _ray_kernels

    def work() -> tuple[Floats, NDArray[np.uint8]]:
        assert rays.params.ink_grey is not None
        reach = rays.params.ink_reach_um
        limit = 0.5 * (rays.top + rays.bottom) if reach is None else np.maximum(rays.top - reach, rays.bottom)
        low, high = rays.params.ink_grey
        grey, first, step = rays.grey, float(rays.s_um[0]), rays.step_um
        depth, total = _ray_kernels.depths_of_shares(grey, first, step, rays.top, limit, low, high, _SHARES)
        # Ink that is still there where the search ends may go deeper: its shares are not known.
        near, _ = rays.length(limit, limit + step, least=low, most=high)
        reason = np.zeros(total.shape, dtype=np.uint8)
        reason[near > 0.5 * step] = AT_LIMIT
        reason[total < _LEAST_VOXELS * rays.voxel_um] = NO_INK
        return np.where(reason == 0, depth, np.nan), reason

    return rays.cached("ink", work)


for _which, (_share, _title) in enumerate(
    {50: "Depth of half the ink", 90: "Depth of 90 % of the ink", 95: "Depth of 95 % of the ink"}.items()
):

    @ray_property(f"ink_depth_{_share}", units="um", long_name=_title, reasons=REASONS, check=_check,
                  when=lambda params, _greys: params.ink_grey is not None)  # fmt: skip
    def depth(rays: Rays, which: int = _which) -> Measured:
        """P-12: depth below the top face that holds 50, 90 or 95 % of the length of ink on the ray.

        Ink is what lies in the grey range ``ink_grey``, from the face down to ``ink_reach_um``. Missing values are
        censored, not zero: where there is no ink (less than a voxel), and where ink reaches the limit of the search.
        Colour that bleeds below a cut surface and dye taken up by the resin look like ink. SE: the face's and one
        crossing's with the contrast of half the ink's range.
        """
        assert rays.params.ink_grey is not None
        depths, reason = _depths(rays)
        low, high = rays.params.ink_grey
        se = np.where(np.isfinite(depths[which]), np.sqrt(2.0) * rays.crossing_se(0.5 * (high - low)), np.nan)
        return Measured(values=depths[which], se=se, reason=reason)
