"""What the sentences on a pair of maps call things."""

from typing import NamedTuple


class Wording(NamedTuple):
    """What sentences call things.

    The size of points, the values of the image, and the titles of both maps.
    """

    point_um: float = float("nan")
    image: str = "grey value"
    titles: tuple[str, ...] = ()
