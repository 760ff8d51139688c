"""Budgets of memory: what a run needs, reads or holds at once.

``run.compute`` has the default of ``--memory``.
"""

import math

PROGRAM_BYTES = 3 * 10**8  # what Python, its libraries and the compiled kernels take
# What a measured column takes at the peak: heights, properties, coordinates, map pixels, and the
# work on them.
COLUMN_BYTES = 900
# Share of the memory beside the program that the maps may take; the tiles get the rest.
MAPS_SHARE = 0.6
HELD_TIMES = 3  # the memory beside the program as a multiple of a volume that is held as a whole
KEPT_SHARE = 0.03  # share of the memory for maps of a store that are read back
# The photographs and the volume made from them are in memory at the same time.
COPIES_OF_SECTIONS = 2
# Where the memory is less than the first number, freed arrays of so many bytes are given back at
# once. It takes time, most of all for the small buffers that files are decoded into: those only
# where nothing else will do.
RETURNED_BYTES = ((8 * 10**8, 2**17), (5 * 10**9, 2**22))
# What ``planish link`` takes for each pixel of the image, which is held with the search for its
# holes, and in any case.
PIXEL_BYTES = 16
LINK_BYTES = 400 * 10**6

# Files
UNKNOWN_BYTES = 8 * 2**30  # what is assumed to be free where the system does not report it
FREE_SHARE = 0.75  # share of what is free that one file may fill; the rest is for the work on it
# Up to this size what can be read in parts is read at once: it then never waits for the disk again.
EAGER_BYTES = 2**30
# Decoded slices that are kept, because the next part often lies in the same ones.
DECODED_BYTES = 256 * 2**20
# Of packed values: read at a time, and unpacked from that.
PACKED_BYTES = 4 * 2**20
UNPACKED_BYTES = 64 * 2**20
# What is decoded at once for a look: several copies of it, and the program, take 400 MiB.
LOOK_BYTES = 64 * 2**20
SAMPLE_BYTES = 256 * 2**20  # what is read of a volume that is too large to be read for a look
SAMPLE_VALUES = 4_000_000  # of a volume or an image, for percentiles
# Of a volume that is brought into a store: one is read while the other is compressed.
BLOCKS_AT_WORK = 2

# Maps
# Of a group of maps from which on it stays in its store and is read part by part.
LARGE_BYTES = 2**29
SAMPLE_PIXELS = 2**22  # of maps, that show how their values are distributed, or are drawn
TILE_BYTES = 96 * 2**20  # blocks of pictures that the app holds
# Numbers of a map that are texts at a time, and of a table's rows.
TEXT_VALUES = 200_000
TABLE_VALUES = 2_000_000
WHOLE_BYTES = 200_000_000  # of maps that are held as a whole to be written, where they need not be

# Parts of a volume
WINDOW_BYTES = 8e6  # a piece of a window of slices that are compared
SLICES_VOXELS = 2**24  # read at a time for the slices of a page
STACK_BYTES = 2**26  # a part of a volume that is written as TIFF


def bytes_to_map(column_count: float) -> int:
    """Memory beside the program in which the maps of so many columns take their share."""
    return math.ceil(column_count * COLUMN_BYTES / MAPS_SHARE)


def bytes_to_hold(volume_bytes: float) -> int:
    """Memory beside the program in which a volume is held as a whole."""
    return math.ceil(HELD_TIMES * volume_bytes)


def enough_gb(byte_count: float) -> str:
    """Write bytes in GB, rounded up: given as ``--memory``, they suffice."""
    return f"{math.ceil(byte_count / 1e8) / 10:.1f}"
