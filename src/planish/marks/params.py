"""Options of the search for laser holes."""

from pydantic import PositiveFloat

from planish.core.options import Params, option


class HoleParams(Params):
    """Which holes are searched for."""

    hole_um: tuple[PositiveFloat, PositiveFloat] = option(
        (100.0, 300.0), metavar="LEAST,MOST", help="Range of hole diameters in um."
    )
    printed: bool = option(
        False,
        help=(
            "The image is a print: remove dots narrower than the smallest hole before searching"
            " for holes."
        ),
    )
