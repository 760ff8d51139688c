"""The sheet itself in material coordinates: faces, interfaces, fibres, flocs and holes on one fine grid.

Rules after Dahlström and Uesaka (Ind. Eng. Chem. Res. 48, 10472, 2009): the coating's outer face is a smoothed copy of
the base's surface plus the mean layer, so that the coating is thin where fibres stand up and thick in the pits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from planish.synthetic import _kernels

Field = NDArray[np.float32]
PITCH_UM = 3.0
_LAYERS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetParams:
    """What the sheet is made of; lengths in um, means and standard deviations (``_sd``)."""

    base_um: float = 55.0
    base_floc_sd_um: float = 2.5  # flocs of 1.5 mm: formation
    base_fibre_sd_um: float = 4.5  # single fibres, 35 um
    coating_top_um: float = 17.4  # 135 g/m2 wood-free coated paper, Hirn et al. 2009, section 3.3.1
    coating_bottom_um: float = 17.4
    levelling_um: float = 250.0  # wavelength at which the coating follows the base by half
    coating_noise_sd_um: float = 0.5
    base_density_sd: float = 0.15  # of the base's grey, relative
    hole_um: float = 175.0  # 150-200 um by the laser, Hirn et al. 2009, section 2.1
    hole_sd_um: float = 8.0
    hole_rim_um: float = 3.0  # roughness of the rim
    hole_taper: float = 0.10  # relative loss of diameter from top to bottom
    char_um: float = 40.0  # burnt rim


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """Fields on nodes ``origin + pitch * (col, row)``, all (rows, cols) float32.

    Attributes
    ----------
    faces : (4, rows, cols)
        Signed distance from the centre surface in um: s_T, s_TI, s_BI, s_B.
    texture : (layers, rows, cols)
        Relative density of the base through its depth, bottom to top.
    rim_um, char : (rows, cols)
        Signed distance to the nearest hole's rim at the top face (negative inside); burn, 1 = untouched.
    holes : (n, 2)
        True centres (u, v) in um.
    """

    params: SheetParams
    origin: tuple[float, float]
    faces: Field
    texture: Field
    rim_um: Field
    char: Field
    holes: NDArray[np.float64]

    def at(self, field: Field, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bilinear value of one field at material coordinates; the same rule that the renderer uses."""
        x = np.clip((u - self.origin[0]) / PITCH_UM, 0.0, field.shape[1] - 1.000001)
        y = np.clip((v - self.origin[1]) / PITCH_UM, 0.0, field.shape[0] - 1.000001)
        j, i = x.astype(int), y.astype(int)
        fx, fy = x - j, y - i
        top = field[i, j] * (1 - fx) + field[i, j + 1] * fx
        low = field[i + 1, j] * (1 - fx) + field[i + 1, j + 1] * fx
        return top * (1 - fy) + low * fy

    @property
    def taper_per_um(self) -> float:
        """Loss of the hole's radius per um of depth below the top face."""
        p = self.params
        return 0.5 * p.hole_um * p.hole_taper / (p.base_um + p.coating_top_um + p.coating_bottom_um)


def make_sheet(
    params: SheetParams,
    *,
    low: tuple[float, float],
    high: tuple[float, float],
    holes: NDArray[np.float64],
    rng: np.random.Generator,
) -> Sheet:
    """Draw one sheet that covers the material rectangle from ``low`` to ``high`` (u, v) in um."""
    shape = tuple(int(np.ceil((h - lo) / PITCH_UM)) + 2 for lo, h in zip(low[::-1], high[::-1], strict=True))
    top_fibres, bottom_fibres = _fibres(shape, rng, 260), _fibres(shape, rng, 260)
    floc = 0.5 * params.base_floc_sd_um * _noise(shape, 750.0, rng)
    base = []
    for fibres in (top_fibres, bottom_fibres):
        rough = params.base_fibre_sd_um * (0.6 * _noise(shape, 17.0, rng) + 1.8 * (fibres - fibres.mean()))
        base.append(params.base_um / 2 + floc + rough)
    faces = []
    for surface, mean in zip(base, (params.coating_top_um, params.coating_bottom_um), strict=True):
        outer = surface
        if mean > 0:
            outer = (
                _lowpass(surface, params.levelling_um) + mean + params.coating_noise_sd_um * _noise(shape, 10.0, rng)
            )
        faces.append(np.maximum(outer, surface))
    texture = np.stack([_density(shape, params.base_density_sd, rng) for _ in range(_LAYERS)])
    rim, char = _burn(params, holes, shape, low, rng)
    stacked = np.stack([faces[0], base[0], -base[1], -faces[1]])
    return Sheet(
        params=params,
        origin=low,
        faces=stacked.astype(np.float32),
        texture=texture.astype(np.float32),
        rim_um=rim.astype(np.float32),
        char=char.astype(np.float32),
        holes=holes,
    )


def _spectrum(shape: tuple[int, ...]) -> NDArray[np.float64]:
    fy = fft.fftfreq(shape[0], PITCH_UM)[:, None]
    fx = fft.rfftfreq(shape[1], PITCH_UM)[None, :]
    return fy * fy + fx * fx


def _noise(shape: tuple[int, ...], sigma_um: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Gaussian random field of unit standard deviation, smoothed with ``sigma_um``."""
    white = fft.rfft2(rng.standard_normal(shape))
    field = fft.irfft2(white * np.exp(-2 * np.pi**2 * sigma_um**2 * _spectrum(shape)), shape)
    field -= field.mean()
    return field / field.std()


def _lowpass(field: NDArray[np.float64], half_um: float) -> NDArray[np.float64]:
    """Gaussian filter that halves a wave of length ``half_um``."""
    gain = np.exp(-np.log(2.0) * half_um**2 * _spectrum(field.shape))
    return fft.irfft2(fft.rfft2(field) * gain, field.shape)


def _fibres(shape: tuple[int, ...], rng: np.random.Generator, per_9mm2: int) -> NDArray[np.float64]:
    area = shape[0] * shape[1] * PITCH_UM**2 / 9e6
    count = max(int(per_9mm2 * area), 8)
    field = np.zeros(shape)
    starts = rng.uniform(-200, [shape[1] + 200, shape[0] + 200], (count, 2))
    angles = rng.vonmises(0.0, 0.5, count) / 2 + rng.integers(0, 2, count) * np.pi
    lengths = rng.uniform(1000, 2500, count) / PITCH_UM
    widths = rng.uniform(20, 35, count) / PITCH_UM
    curls = rng.normal(0, 4e-4, count) * PITCH_UM
    _kernels.lay_fibres(field, starts, angles, lengths, widths, curls, 1.0)
    return field


def _density(shape: tuple[int, ...], sd: float, rng: np.random.Generator) -> NDArray[np.float64]:
    fibres = _fibres(shape, rng, 450)
    field = fibres + 0.4 * _noise(shape, 12.0, rng)
    field = (field - field.mean()) / field.std()
    return np.clip(1 + sd * field, 0.2, 1.8)


def _burn(
    params: SheetParams,
    holes: NDArray[np.float64],
    shape: tuple[int, ...],
    low: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed distance to the holes' rims, and the coating's burn around them."""
    rim = np.full(shape, 1e4)
    reach = 2 * params.hole_um
    for u, v in holes:
        radius = 0.5 * rng.normal(params.hole_um, params.hole_sd_um)
        j0, j1 = (int((u - low[0] + d) / PITCH_UM) for d in (-reach, reach))
        i0, i1 = (int((v - low[1] + d) / PITCH_UM) for d in (-reach, reach))
        i0, j0, i1, j1 = max(i0, 0), max(j0, 0), min(i1, shape[0]), min(j1, shape[1])
        y = low[1] + PITCH_UM * np.arange(i0, i1)[:, None] - v
        x = low[0] + PITCH_UM * np.arange(j0, j1)[None, :] - u
        angle = np.arctan2(y, x)
        rough = np.zeros_like(angle)
        for order in range(2, 14):  # waves around the rim down to about 30 um; order 1 would move the centre
            a, b = rng.normal(0, params.hole_rim_um / np.sqrt(12), 2)
            rough += a * np.cos(order * angle) + b * np.sin(order * angle)
        rim[i0:i1, j0:j1] = np.minimum(rim[i0:i1, j0:j1], np.hypot(x, y) - radius - rough)
    char = 1 - 0.5 * np.exp(-np.maximum(rim, 0) / (0.5 * params.char_um))
    return rim, char
