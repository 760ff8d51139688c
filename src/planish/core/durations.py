"""How long a run takes: processor seconds of each stage, imports included.

For ``planish info``, and for the time that is left of a run. Those of a link were measured as
``time.process_time`` between the calls of ``progress``, everything compiled, for images of .07 to
3.2 million pixels; those of a volume are 1.3 times what .08 and .27 million columns took. The
machine ran the loop of :func:`slowness` in :data:`LOOP_SECONDS`. By the clock two processors take
little less: most of a small run is not shared.
"""

import os
import time
from collections.abc import Mapping

# By stage, and by step of tiles within it: seconds in any case, and for each million of columns or
# pixels.
Seconds = Mapping[str, tuple[float, float]]

START: Seconds = {"start": (2.3, 0.0)}  # imports, until the first stage begins
READ_SECONDS = 0.4  # of an image, or of a run with its maps
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
LINK_SECONDS: Seconds = {"register": (0.9, 0.2), "link": (0.8, 0.6), "correlate": (1.9, 0.85)}
WRITE: Seconds = {"write": (1.5, 0.7)}

_LOOPS, LOOP_SECONDS = 300_000, 0.015  # it took 0.013 to 0.026 meanwhile


def map_seconds(n_columns: int) -> float:
    """Seconds in which a volume of so many columns through its sheet is mapped."""
    return _sum(n_columns, START, SHEET_SECONDS, WRITE)


def link_seconds(n_pixels: int) -> float:
    """Seconds in which a sheet that was mapped is linked to an image of so many pixels."""
    return 2 * READ_SECONDS + _sum(n_pixels, START, LINK_SECONDS, WRITE)


def _sum(n: int, *tables: Seconds) -> float:
    return sum(fixed + each * n / 1e6 for table in tables for fixed, each in table.values())


def slowness() -> float:
    """Time that this machine takes now for a plain loop, in times of that of the table's."""
    # Windows counts processor time in steps of 15 ms.
    seconds = time.perf_counter if os.name == "nt" else time.thread_time
    times: list[float] = []
    for _ in range(3):
        start = seconds()
        total = 0
        for i in range(_LOOPS):
            total += i * i
        times.append(seconds() - start)
    return min(times) / LOOP_SECONDS
