"""Estimates of how long a run takes on two processors.

For ``planish info``, and for the time that is left of a run.
"""

from collections.abc import Mapping

# By stage, and by step of tiles within it: seconds in any case, and for each million of columns or
# pixels.
Seconds = Mapping[str, tuple[float, float]]

SHEET_SECONDS: Seconds = {
    "read": (0.4, 1.2),
    "surface": (0.1, 0.0),
    "survey": (0.3, 1.6),
    "priors": (0.8, 3.8),
    "faces": (0.1, 9.8),
    "faces_below": (0.1, 1.2),
    "assembly": (0.6, 2.0),
    "layers": (0.0, 0.5),
    "measure": (0.2, 1.5),
    "flatten": (0.4, 1.1),
    "check": (0.5, 3.9),
    "resample": (0.2, 0.8),
}
LINK_SECONDS: Seconds = {"register": (0.5, 0.3), "link": (0.5, 2.1), "correlate": (1.7, 1.2)}
START_SECONDS = 3.0  # of the processor, until the first stage begins
WRITE_SECONDS = (3.8, 3.0)


def map_seconds(n_columns: int) -> float:
    """Seconds in which a volume of so many columns through its sheet is mapped.

    On a slow machine twice as many.
    """
    stages = *SHEET_SECONDS.values(), (START_SECONDS, 0.0), WRITE_SECONDS
    # The processors have other work, too.
    return 1.2 * sum(fixed + each * n_columns / 1e6 for fixed, each in stages)
