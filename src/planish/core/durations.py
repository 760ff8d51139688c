"""About how long a run takes on two processors: for ``planish info``, and for the time that is left of a run."""

from collections.abc import Mapping

# By stage, and by step of tiles within it: seconds in any case, and for each million of columns or pixels.
Seconds = Mapping[str, tuple[float, float]]

SHEET_SECONDS: Seconds = {
    "read": (0.5, 0.3),
    "surface": (0.2, 0.0),
    "survey": (2.0, 0.2),
    "priors": (3.0, 2.5),
    "faces": (2.5, 6.5),
    "faces_below": (0.4, 1.4),
    "assembly": (2.0, 3.0),
    "layers": (0.5, 1.2),
    "measure": (0.7, 1.6),
    "flatten": (0.9, 0.5),
    "resample": (0.4, 1.1),
    "check": (3.3, 3.6),
}
LINK_SECONDS: Seconds = {"register": (1.0, 0.7), "link": (1.3, 6.3), "correlate": (8.0, 5.0)}
_BUSY = 1.6  # times as long on two processors that have other work, too


def map_seconds(n_columns: int) -> float:
    """Seconds in which a volume of so many columns through its sheet is mapped; on a slow machine twice as many."""
    return _BUSY * sum(fixed + each * n_columns / 1e6 for fixed, each in SHEET_SECONDS.values())
