"""What a run needs of the memory, in bytes: the program, the maps of its columns, a volume that is held as a whole."""

from __future__ import annotations

import math

PROGRAM_BYTES = 3 * 10**8  # what Python, its libraries and the compiled kernels take
# What a measured column takes at the peak: heights, properties, coordinates, map pixels, and the work on them.
COLUMN_BYTES = 900
MAPS_SHARE = 0.6  # share of the memory beside the program that the maps may take; the tiles get the rest
HELD_TIMES = 3  # the memory beside the program as a multiple of a volume that is held as a whole


def bytes_to_map(columns: float) -> int:
    """Memory beside the program in which the maps of so many columns take their share."""
    return math.ceil(columns * COLUMN_BYTES / MAPS_SHARE)


def bytes_to_hold(volume_bytes: float) -> int:
    """Memory beside the program in which a volume is held as a whole."""
    return math.ceil(HELD_TIMES * volume_bytes)


def enough_gb(amount: float) -> str:
    """Write bytes in GB, rounded up: given as ``--memory``, they suffice."""
    return f"{math.ceil(amount / 1e8) / 10:.1f}"
