"""Options of the registration.

How marks of two layers are matched, and which model takes one layer to the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from planish.core.options import Params, option
from planish.register.models import MODELS

if TYPE_CHECKING:
    ModelChoice = str
else:
    ModelChoice = Literal[(*MODELS, "auto")]


class RegistrationParams(Params):
    """How marks are matched and which transformation is fitted to them."""

    marks: str | None = option(
        None,
        metavar="FILE",
        help=(
            "Pairs of points from planish or another program (docs/marks-files.md), instead of"
            " finding the holes."
        ),
    )
    by: Literal["auto", "holes", "texture", "both"] = option(
        "auto",
        help=(
            "What the layers are registered by. auto takes holes, and the texture too if either"
            " has fewer than 3 holes; both fits holes and texture in one."
        ),
    )
    near: tuple[float, ...] | None = option(
        None,
        min_length=2,
        max_length=3,
        metavar="X,Y[,RADIUS]",
        help=(
            "Rough place of the middle of the moving layer in the fixed one, in um, for the search"
            " by texture; RADIUS is how far from it the middle may lie, 500 where not given."
        ),
    )
    design: str | None = option(
        None,
        metavar="FILE",
        help=(
            "The pattern that was burnt (pattern.json of 'planish marks design', or a CSV table):"
            " identifies holes by their position."
        ),
    )
    scale_tolerance: float = option(
        0.03,
        gt=0,
        le=1.0,
        metavar="SHARE",
        help=(
            "Largest deviation of the scale from 1, by calibration or strain, such as 0.05; 1"
            " lets the pixel size be twice or half of what was given."
        ),
    )
    tolerance_um: float = option(
        25.0, gt=0, help="Largest distance in um between two marks that match."
    )
    mirror: bool = option(
        False,
        help=(
            "Also try mirror images: for a volume whose slices are numbered against the usual"
            " sense."
        ),
    )
    model: ModelChoice = option(
        "auto",
        help=(
            "Transformation from the moving to the fixed layer. auto is averaged from 6 marks on: a"
            " similarity with as much affine and smooth deviation as the marks show."
        ),
    )
    refine: Literal["affine", "bspline"] | None = option(
        None,
        help=(
            "Also refine the registration of two layers by their maps (needs planish[refine]). The"
            " maps go into the group 'refined'; r is cross-fitted, or stands beside a searched"
            " null."
        ),
    )
