"""What stands for a layer, and whether two maps themselves agree that they lie right."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import masked_lag
from planish.core.errors import SizeError
from planish.pipeline.run import Array
from planish.results import lag_results

_REACH_UM, _COARSEST_UM, _TILE_UM, _SURROGATES = 150.0, 1000.0, 1000.0, 99


def headline_of(maps: xr.Dataset, side: Literal["top", "bottom"] = "top") -> str:
    """The map that stands for a layer: an image itself, the coating of the side that is seen, or the thickness."""
    if "image" in maps and "thickness" not in maps:
        return "image"
    coating = f"coating_{side}"
    return coating if np.isfinite(maps[coating].values).any() else "thickness"


def agreement(
    a: Array, b: Array, valid: NDArray[np.bool_], pixel_um: tuple[float, float], error: Array, name: str
) -> dict[str, Any] | None:
    """Look whether two maps themselves agree that they lie right, within the expected error of the registration.

    None where there are too few pixels for any lag.
    """
    shown = error[np.isfinite(error) & valid]
    expected = float(np.sqrt(np.mean(shown.astype(np.float64) ** 2))) if shown.size else None
    short = min(n * um for n, um in zip(valid.shape, pixel_um, strict=True))
    try:
        lag = masked_lag(
            np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64), valid, pixel_um,
            reach_um=min(_REACH_UM, short / 4), band_um=(None, _COARSEST_UM),
            tiles_um=_TILE_UM if short >= 2 * _TILE_UM else None, surrogates=_SURROGATES,
        )  # fmt: skip
    except SizeError:
        return None  # too few pixels for any lag
    return lag_results(lag, expected_um=expected, headline=name)
