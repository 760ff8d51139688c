"""Options of the flattening and of the flat maps."""

from typing import Literal

from planish.core.options import Params, option


class FlattenParams(Params):
    """How the centre surface is flattened, and the pixel of the flat maps."""

    mesh_um: float | None = option(
        None,
        gt=0,
        help="Pitch of the spring mesh in um; default: four columns, or more for large sheets.",
    )
    method: Literal["multigrid", "relaxation"] = option(
        "multigrid",
        help=(
            "multigrid: straight to the least spring energy; relaxation: the damped motion of Hirn"
            " et al. (2009)."
        ),
    )
    neutral: Literal["base", "faces"] | None = option(
        None,
        help=(
            "Surface that stays unstrained when the sheet is bent: the middle of the base, or the"
            " mean of the faces; default: base, if both interfaces are measured."
        ),
    )
    rest: Literal["arc", "chord"] = option(
        "arc",
        help=(
            "Rest lengths of the springs: along the curved surface, or straight through space as in"
            " Hirn et al. (2009)."
        ),
    )
    map_um: float | None = option(
        None, gt=0, help="Pixel of the flat maps in um; default: the columns of the volume."
    )
