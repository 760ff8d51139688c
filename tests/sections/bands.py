"""A made-up series of sections whose every pose is known: a bent sheet with fibres, photographed by
a careless hand."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import ndtr

Array = NDArray[np.float64]

PITCH_UM = 3.0
PIXEL_UM = (2.43, 2.43)
TURN_RAD = np.deg2rad(0.02)
RESIN, SHEET = 60.0, 160.0


@dataclass(frozen=True, kw_only=True)
class Series:
    """Sections and their truth; errors in um and rad, as `Alignment` has them."""

    stack: NDArray[Any]
    positions_um: Array
    shift_um: Array
    rotation_rad: Array
    gain: Array
    offset: Array
    height_um: Array


def jitter(n, rng, *, white_um=1.5, walk_um=0.15):
    """White errors and a random walk; (n,)."""
    return rng.normal(0.0, white_um, n) + np.cumsum(rng.normal(0.0, walk_um, n))


def fibres(shape, pitch_um, rng, reach_um):
    """Noise of variance 1 whose correlation over a distance d is exp(-(d / reach)^2)."""
    field = gaussian_filter(
        rng.normal(size=shape).astype(np.float32),
        [0.5 * reach_um / p for p in pitch_um],
        mode="wrap",
    )
    return (field / field.std()).astype(np.float64)


def make_series(
    *,
    sections=200,
    rows=130,
    cols=800,
    errors=(1.5, 0.15),
    turn_rad=TURN_RAD,
    drift=0.0,
    noise=10.0,
    texture=10.0,
    rise_um=48.0,
    wave_um=600.0,
    missing=(),
    marks=True,
    seed=1,
    dtype="uint8",
):
    """Photograph a sheet of 90 um, resin 60, sheet 160; the steepest rise along the cut is 2 pi
    rise / wave.

    ``errors`` are the white part and the walk in um, ``drift`` the standard deviation of the gain.
    """
    rng = np.random.default_rng(seed)
    x = np.arange(sections) * PITCH_UM
    across = (np.arange(cols) - 0.5 * (cols - 1)) * PIXEL_UM[1]
    up = (np.arange(rows) - 0.5 * (rows - 1)) * PIXEL_UM[0]
    deep = 64
    material = fibres((sections, deep, cols), (PITCH_UM, *PIXEL_UM), rng, 30.0)
    rough = 2.0 * np.stack(
        [fibres((sections, cols), (PITCH_UM, PIXEL_UM[1]), rng, 30.0) for _ in range(2)]
    )
    height = rise_um * np.sin(2 * np.pi * x[:, None] / wave_um + 0.3) + 15 * np.sin(
        2 * np.pi * across / 1500 + 1
    )
    shift = np.stack(
        [jitter(sections, rng, white_um=errors[0], walk_um=errors[1]) for _ in range(2)], axis=1
    )
    turn = rng.normal(0.0, turn_rad, sections) if turn_rad else np.zeros(sections)
    gain = 1.0 + drift * rng.normal(size=sections)
    offset = 100 * drift * rng.normal(size=sections)
    stack = np.empty((sections, rows, cols), np.float64)
    for i in range(sections):
        true_up = up[:, None] - shift[i, 0] - turn[i] * across
        true_across = across - shift[i, 1] + turn[i] * up[:, None]
        col = true_across / PIXEL_UM[1] + 0.5 * (cols - 1)
        depth = true_up - np.interp(true_across, across, height[i])
        faces = [np.interp(true_across, across, rough[k, i]) for k in range(2)]
        inside = ndtr((depth + 45 - faces[0]) / 2.5) * ndtr((45 + faces[1] - depth) / 2.5)
        grain = map_coordinates(
            material[i],
            [depth / PIXEL_UM[0] + 0.5 * (deep - 1), col],
            order=1,
            mode="nearest",
            prefilter=False,
        )
        image = RESIN + inside * (SHEET - RESIN + texture * grain)
        if marks:
            # One nick of the knife that every section shows in the same place, and scratches that
            # come and go.
            image[:, 300:302] += 25.0
            image[:, int(rng.integers(cols))] -= 40.0
            image[int(rng.integers(rows))] += 40.0
        stack[i] = gain[i] * image + offset[i] + rng.normal(0.0, noise, image.shape)
    if np.dtype(dtype).kind in "ui":
        stack = np.clip(np.rint(stack), 0, 255)
    kept = np.setdiff1d(np.arange(sections), missing)
    return Series(
        stack=stack[kept].astype(dtype),
        positions_um=x[kept],
        shift_um=shift[kept],
        rotation_rad=turn[kept],
        gain=gain[kept],
        offset=offset[kept],
        height_um=height[kept],
    )


def split(at_um, values, *, wave_um=50 * PITCH_UM):
    """Waves longer than ``wave_um``, by fitting cosines over the length, and the rest; along axis
    0."""
    length = at_um[-1] - at_um[0] + PITCH_UM
    order = np.arange(int(2 * length / wave_um) + 1)
    basis = np.cos(np.pi * order * (at_um[:, None] - at_um[0] + 0.5 * PITCH_UM) / length)
    slow = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return slow, values - slow


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))
