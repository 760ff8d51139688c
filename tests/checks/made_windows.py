"""Windows of slices that are in memory, summed up by numpy alone."""

import numpy as np

from planish.checks.windows import BLOCK, Window


def window_of(slices, axis="z"):
    """The window over the whole of some slices (slices, rows, cols)."""
    values = np.asarray(slices, dtype=np.float32).astype(np.float64)
    n, rows, cols = values.shape
    edge = min(BLOCK, rows, cols)
    whole = values[:, : rows // edge * edge, : cols // edge * edge]
    by_block = whole.reshape(n, rows // edge, edge, cols // edge, edge)
    u = np.diff(values, axis=0)
    return Window(
        axis=axis,
        first=0,
        square=np.mean(u**2, axis=(1, 2)),
        product=np.mean(u[:-1] * u[1:], axis=(1, 2)),
        blocks=by_block.mean(axis=(2, 4)).astype(np.float32),
    )
