"""Maps, a surface and a registration that are known, as they are written."""

import numpy as np
import xarray as xr

from folders import bytes_of
from planish.core.frame import Frame
from planish.core.grid import Grid
from planish.core.transform import Affine
from planish.exports import (
    DirectedTransform,
    ExportHistory,
    ExportParams,
    Maps,
    Surface,
    TransformPair,
    writer_of,
)
from planish.report import Scale

PIXEL_UM = (2.6, 1.37)
FIRST_UM = (-18.2, -66.0)
HISTORY = ExportHistory(
    planish="0.2.0",
    exported_by="0.2.0",
    study_sha256="ab" * 32,
    inputs=({"layer": "sheet", "name": "Volumen µ.tif", "sha256": "cd" * 32},),
)


def maps(shape=(600, 1100), dims=("y", "x")):
    """Maps of several types with missing values; more than a band, and an odd number of columns of
    chunks."""
    rng = np.random.default_rng(7)
    coating = rng.normal(17, 4, shape).astype(np.float32)
    coating[rng.random(shape) < 0.2] = np.nan
    tilt = rng.normal(20, 5, shape)
    tilt[:3] = np.nan
    status = rng.integers(0, 3, shape).astype(np.uint8)
    at = [first + p * np.arange(n) for first, p, n in zip(FIRST_UM, PIXEL_UM, shape, strict=True)]
    data = xr.Dataset(
        {
            "coating_top": (
                dims,
                coating,
                {"units": "um", "long_name": "Coating thickness, top side"},
            ),
            "tilt": (dims, tilt, {"units": "deg", "long_name": "Tilt of the sheet"}),
            "valid": (dims, np.isfinite(coating), {"long_name": "Measured"}),
            "status": (
                dims,
                status,
                {"long_name": "Status", "flag_values": [0, 1, 2], "flag_meanings": "a b c"},
            ),
        },
        coords={dim: (dim, values, {"units": "um"}) for dim, values in zip(dims, at, strict=True)},
    )
    return Maps(data=data, group="linked", valid=data["valid"])


def written(content, path, to, **options):
    """Write as a format."""
    writer_of(to)(content, path, HISTORY, ExportParams(to=to, **options))
    return path


def files_of(path):
    """Bytes of the files of an export, whatever its name is."""
    return bytes_of(path) if path.is_dir() else {"": path.read_bytes()}


def surface(through="z", top="high", name="top"):
    """A slope of 30 x 40 columns with a hole; its map is the column's number."""
    frame = Frame(through=through, top=top)
    rows, cols = 3.0 * np.arange(30), 2.0 * np.arange(40)
    heights = 100.0 + 0.1 * rows[:, None] + 0.2 * cols[None, :]
    heights[10:14, 20:25] = np.nan
    number = np.arange(heights.size, dtype=np.float32).reshape(heights.shape)
    number[0, 0] = np.nan
    data = xr.Dataset(
        {
            name: (("y", "x"), heights, {"units": "um"}),
            "coating_top": (("y", "x"), number, {"units": "um"}),
        },
        coords={"y": rows, "x": cols},
        attrs=frame.attrs(),
    )
    scales = {"coating_top": Scale(low=0.0, high=float(heights.size))}
    return Surface(data=data, name=name, maps=("coating_top",), scales=scales)


def transform_pair(*, bent):
    """An affine map, with a wave of 3 um on it where ``bent``."""
    affine = Affine(
        linear=((0.99, 0.12), (-0.13, 1.01)), source=(900.0, 700.0), target=(1200.0, 800.0)
    )

    def forward(points):
        at = np.asarray(points, dtype=np.float64)
        wave = 3.0 * np.sin(2 * np.pi * at[..., ::-1] / 900.0) if bent else 0.0
        return affine(at) + wave

    def back(points):
        wanted = np.asarray(points, dtype=np.float64)
        at = affine.inverse(wanted)
        for _ in range(50):
            at = affine.inverse(wanted - (forward(at) - affine(at)))
        return at

    grids = Grid.regular((500, 640), 3.0, (-66.0, -18.0)), Grid.regular((435, 534), 4.0)
    return TransformPair(
        forward=DirectedTransform(
            source="sheet",
            target="image",
            function=forward,
            grid=grids[0],
            affine=affine,
            exact=not bent,
        ),
        back=DirectedTransform(
            source="image",
            target="sheet",
            function=back,
            grid=grids[1],
            affine=affine.inverse,
            exact=not bent,
        ),
        model="averaged",
    )
