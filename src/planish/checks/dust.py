"""Particles on the sheet, which the measurement takes for coating."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.checks import Check
from planish.core.grid import pitch
from planish.core.robust import mad_sd
from planish.core.typing import Bools, Floats

HEIGHT = 5.0  # MAD, as a standard deviation, over the median around
AREA_UM2 = 400.0
MOST = 1.0  # particles a mm2
_AROUND_UM = 300.0
_COARSE = 10  # cells across the median
_LEAST_MM2 = 0.1  # measured


class Particles(NamedTuple):
    """Particles on one side."""

    mask: Bools
    number: int
    area_mm2: float  # that was measured

    @property
    def a_mm2(self) -> float:
        """Particles a mm2."""
        return self.number / max(self.area_mm2, 1e-9)


def find_particles(coating: Floats, pitch_um: tuple[float, float]) -> Particles:
    """Find the particles that stand out of a map of a coating, (rows, cols) in um."""
    is_measured = np.isfinite(coating)
    cell = pitch_um[0] * pitch_um[1]
    area = float(is_measured.sum()) * cell * 1e-6
    if area < _LEAST_MM2:
        return Particles(np.zeros(coating.shape, bool), 0, area)
    above = coating - _median_around(coating, pitch_um)
    labels, n = ndimage.label(np.nan_to_num(above, nan=-np.inf) > HEIGHT * max(mad_sd(above), 1e-6))
    sizes = np.bincount(labels.ravel(), minlength=n + 1) * cell
    large = sizes >= AREA_UM2
    large[0] = False
    return Particles(large[labels], int(large.sum()), area)


def _median_around(coating: Floats, pitch_um: tuple[float, float]) -> Floats:
    """Median of 300 um around every column, from medians of cells of a tenth."""
    edges = [max(round(_AROUND_UM / _COARSE / p), 1) for p in pitch_um]
    counts = [max(n // e, 1) for n, e in zip(coating.shape, edges, strict=True)]
    part = coating[: counts[0] * edges[0], : counts[1] * edges[1]]
    shape = (counts[0], min(edges[0], coating.shape[0]), counts[1], min(edges[1], coating.shape[1]))
    cells = part.reshape(shape).transpose(0, 2, 1, 3).reshape(counts[0], counts[1], -1)
    medians = np.full(cells.shape[:2], np.nan)
    is_measured = np.isfinite(cells).any(axis=2)
    medians[is_measured] = np.nanmedian(cells[is_measured], axis=1)
    medians[~is_measured] = np.nanmedian(medians) if is_measured.any() else 0.0
    coarse = ndimage.median_filter(medians, size=_COARSE, mode="nearest")
    coordinates = [(np.arange(n) + 0.5) / e - 0.5 for n, e in zip(coating.shape, edges, strict=True)]
    return ndimage.map_coordinates(coarse, np.meshgrid(*coordinates, indexing="ij"), order=1, mode="nearest")


def dust_check(measured: xr.Dataset, side: str) -> Check | None:
    """Judge the particles on the ``top`` or ``bottom`` side; None where no coating was measured."""
    name = f"coating_{side}"
    if name not in measured or not np.isfinite(measured[name].values).any():
        return None
    p = pitch(measured)
    particles = find_particles(measured[name].values.astype(np.float64), (float(p[0]), float(p[1])))
    if particles.area_mm2 < _LEAST_MM2:
        return None
    covered = 100 * float(particles.mask.sum()) / max(int(np.isfinite(measured[name].values).sum()), 1)
    return Check.at_most(
        f"dust, {side}", particles.a_mm2, look=MOST, units="1/mm2",
        figures=(name, "base_thickness", "thickness"),
        sentence=f"{particles.number} particles stand out of the {side} coating, {particles.a_mm2:.2g} a mm², "
        f"on {covered:.2g} % of it.",
        advice="Blow the specimen clean and scan it again, or leave the particles out of the map.",
    )  # fmt: skip
