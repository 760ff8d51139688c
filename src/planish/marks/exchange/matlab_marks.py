"""MATLAB: ``movingPoints``, ``fixedPoints`` of the Control Point Selection tool.

The first pixel's centre is (1, 1).
"""

import io
import warnings
from typing import Any

import numpy as np
import xarray as xr

from planish.core import matlab
from planish.core.errors import FileError, MarkError
from planish.core.transform import are_known
from planish.core.typing import Floats
from planish.marks.exchange.lists import SELECTIONS, Content, PointList

# Variables that hold pairs; the second two are those of MATLAB before 2013.
NAMES = (("movingPoints", "fixedPoints"), ("input_points", "base_points"))
_WANTED = {name for pair in NAMES for name in pair}
_SAVE = (
    "Export the moving and fixed points of valid pairs, then"
    " save('marks.mat','movingPoints','fixedPoints')."
)


def looks_like(content: Content) -> bool:
    """Return whether it begins as a file of MATLAB 5 to 7.3, or is called one.

    Version 4 has no heading.
    """
    return not content.text and not content.data.startswith(SELECTIONS)


def read(content: Content) -> list[PointList]:
    """Read the moving and fixed points of a file.

    In pixels from 0: one is taken off, since MATLAB counts from 1.
    """
    name = content.name
    matrices = _matrices(content)
    pair = next((p for p in NAMES if matrices.keys() >= {*p}), None)
    if pair is None:
        names = ", ".join(sorted(matrices)[:8])[:120] or "nothing"
        raise MarkError(f"{name} holds {names}; {' and '.join(NAMES[0])} are needed. {_SAVE}")
    moving, fixed = (_checked(matrices[variable], variable, name) for variable in pair)
    if len(moving) != len(fixed):
        raise MarkError(
            f"{name}: {len(moving)} points in {pair[0]}, {len(fixed)} in {pair[1]}; as many are"
            f" needed. {_SAVE}"
        )
    if not len(moving):
        raise MarkError(f"{name} holds no point. {_SAVE}")
    sides = {"moving": moving - 1.0, "fixed": fixed - 1.0}
    return [PointList(title=k, points=v, unit="pixel") for k, v in sides.items()]


def _matrices(content: Content) -> dict[str, Floats | None]:
    """Variables of a file by name; None for what is no small real matrix, or not asked for."""
    matrices: dict[str, Floats | None] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = io.BytesIO(content.data)
            for v in matlab.variables(file):
                matrices[v.name] = None
                # Larger matrices are images.
                is_small = v.real and len(v.shape) == 2 and v.count <= 1_000_000
                if is_small and v.name in _WANTED:
                    matrices[v.name] = matlab.values(file, v).astype(np.float64)
    except Exception as error:
        fault = error or type(error).__name__
        raise FileError(
            f"{content.name} cannot be read as a MATLAB file: {fault}. {_SAVE}"
        ) from error
    return matrices


def write(_marks: xr.Dataset, points: dict[str, Floats]) -> dict[str, bytes]:
    """Write a file of version 5."""
    from scipy.io import savemat

    moving, fixed = (side + 1.0 for side in points.values())
    if moving.shape[1] == 3:
        raise MarkError(
            "These marks lie in a volume; MATLAB's control points are flat. Use slicer, elastix or"
            " bigwarp."
        )
    file: Any = io.BytesIO()
    savemat(file, {NAMES[0][0]: moving, NAMES[0][1]: fixed})
    # The usual heading holds the date; without it the same marks make the same bytes.
    heading = b"MATLAB 5.0 MAT-file, pairs of marks in pixels, first centre (1, 1)"
    return {"": heading.ljust(116) + file.getvalue()[116:]}


def _checked(matrix: Floats | None, variable: str, name: str) -> Floats:
    """Give a matrix (n, 2) of positions as float64.

    MarkError for None, which is no real matrix, another shape, or a position that is not finite.
    """
    if matrix is None or matrix.shape[1] != 2:
        size = "no real matrix"
        if matrix is not None:
            size = f"of the size {matrix.shape[0]} x {matrix.shape[1]}"
        raise MarkError(
            f"{name}: {variable} is {size}; n x 2 real numbers are needed, x and y. {_SAVE}"
        )
    wrong_rows = np.flatnonzero(~are_known(matrix)) + 1
    if wrong_rows.size:
        rows = ", ".join(map(str, wrong_rows[:8]))
        raise MarkError(f"{name}: {variable} has no finite position in the rows {rows}. {_SAVE}")
    return np.ascontiguousarray(matrix)
