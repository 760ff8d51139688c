"""About how long a run takes on two processors: for ``planish info``, and for the time that is left of a run."""

from collections.abc import Mapping

# By stage, and by step of tiles within it: seconds in any case, and for each million of columns or pixels.
Seconds = Mapping[str, tuple[float, float]]

SHEET_SECONDS: Seconds = {
    "read": (0.5, 0.1),
    "surface": (0.1, 0.0),
    "survey": (0.4, 0.65),
    "priors": (2.0, 0.2),
    "faces": (0.1, 1.1),
    "faces_below": (0.1, 0.25),
    "assembly": (1.0, 0.85),
    "layers": (0.1, 0.1),
    "measure": (0.2, 0.2),
    "flatten": (0.4, 0.1),
    "resample": (0.2, 0.16),
    "check": (2.0, 0.8),
}
LINK_SECONDS: Seconds = {"register": (0.5, 0.3), "link": (0.5, 2.1), "correlate": (1.7, 1.2)}
START_SECONDS = 3.0  # of the processor, until the first stage begins
_BUSY = 1.6  # times as long on two processors that have other work, too


def map_seconds(n_columns: int) -> float:
    """Seconds in which a volume of so many columns through its sheet is mapped; on a slow machine twice as many."""
    return _BUSY * sum(fixed + each * n_columns / 1e6 for fixed, each in SHEET_SECONDS.values())
