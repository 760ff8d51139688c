"""Particles on the sheet, which the measurement takes for coating."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.checks import Check
from planish.core.grid import pitch

Array = NDArray[np.float64]

HEIGHT = 5.0  # MAD, as a standard deviation, over the median around
AREA_UM2 = 400.0
MOST = 1.0  # particles a mm2
_AROUND_UM = 300.0
_COARSE = 10  # cells across the median
_LEAST_MM2 = 0.1  # measured


class Particles(NamedTuple):
    """Particles on one side."""

    mask: NDArray[np.bool_]
    number: int
    area_mm2: float  # that was measured

    @property
    def a_mm2(self) -> float:
        """Particles a mm2."""
        return self.number / max(self.area_mm2, 1e-9)


def find_particles(coating: Array, pitch_um: tuple[float, float]) -> Particles:
    """Find what stands out of a map of a coating, (rows, cols) in um."""
    known = np.isfinite(coating)
    cell = pitch_um[0] * pitch_um[1]
    area = float(known.sum()) * cell * 1e-6
    none = np.zeros(coating.shape, bool)
    if area < _LEAST_MM2:
        return Particles(none, 0, area)
    above = coating - _around(coating, pitch_um)
    scale = 1.4826 * float(np.nanmedian(np.abs(above - np.nanmedian(above))))
    labels, n = ndimage.label(np.nan_to_num(above, nan=-np.inf) > HEIGHT * max(scale, 1e-6))
    sizes = np.bincount(labels.ravel(), minlength=n + 1) * cell
    large = sizes >= AREA_UM2
    large[0] = False
    return Particles(large[labels], int(large.sum()), area)


def _around(coating: Array, pitch_um: tuple[float, float]) -> Array:
    """Median of 300 um around every column, from medians of cells of a tenth."""
    edges = [max(round(_AROUND_UM / _COARSE / p), 1) for p in pitch_um]
    counts = [max(n // e, 1) for n, e in zip(coating.shape, edges, strict=True)]
    part = coating[: counts[0] * edges[0], : counts[1] * edges[1]]
    shape = (counts[0], min(edges[0], coating.shape[0]), counts[1], min(edges[1], coating.shape[1]))
    cells = part.reshape(shape).transpose(0, 2, 1, 3).reshape(counts[0], counts[1], -1)
    filled = np.full(cells.shape[:2], np.nan)
    some = np.isfinite(cells).any(axis=2)
    filled[some] = np.nanmedian(cells[some], axis=1)
    filled[~some] = np.nanmedian(filled) if some.any() else 0.0
    coarse = ndimage.median_filter(filled, size=_COARSE, mode="nearest")
    at = [(np.arange(n) + 0.5) / e - 0.5 for n, e in zip(coating.shape, edges, strict=True)]
    return ndimage.map_coordinates(coarse, np.meshgrid(*at, indexing="ij"), order=1, mode="nearest")


def dust_check(measured: xr.Dataset, side: str) -> Check | None:
    """Judge the particles on the ``top`` or ``bottom`` side; None where no coating was measured."""
    name = f"coating_{side}"
    if name not in measured or not np.isfinite(measured[name].values).any():
        return None
    p = pitch(measured)
    found = find_particles(measured[name].values.astype(np.float64), (float(p[0]), float(p[1])))
    if found.area_mm2 < _LEAST_MM2:
        return None
    covered = 100 * float(found.mask.sum()) / max(int(np.isfinite(measured[name].values).sum()), 1)
    return Check.at_most(
        f"dust, {side}", found.a_mm2, look=MOST, units="1/mm2",
        figures=(name, "base_thickness", "thickness"),
        sentence=f"{found.number} particles stand out of the {side} coating, {found.a_mm2:.2g} a mm², "
        f"on {covered:.2g} % of it.",
        advice="Blow the specimen clean and scan it again, or leave the particles out of the map.",
    )  # fmt: skip
