"""The sheet itself in material coordinates: faces, interfaces, fibres, flocs and holes on one fine grid.

Rules after Dahlström and Uesaka (Ind. Eng. Chem. Res. 48, 10472, 2009): the coating's outer face is a smoothed copy of
the base's surface plus the mean layer, so that the coating is thin where fibres stand up and thick in the pits; what
the layer varies beyond that is random deposition.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planish.core.grid import bilinear
from planish.core.typing import Floats
from planish.synthetic.draws import generator
from planish.synthetic.fields import PITCH_UM, fibrous, lowpass, noise, streaks
from planish.synthetic.holes import burn
from planish.synthetic.params import HoleParams, PaperParams

Field = NDArray[np.float32]
LAYERS = 10  # of the base's texture, from its bottom to its top: a collapsed fibre is some 5 um thick
_FLOC_UM, _STREAK_UM, _DEPOSIT_UM = 1500.0, 2000.0, 100.0  # correlation lengths
_LOOSE_PER_MM2 = 6.0
_SKEW = 0.6
_FILLER_CONTRAST = 2.2  # grey of the filler over that of fibres, less 1


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """Fields on nodes ``origin + pitch * (col, row)``, all (rows, cols) float32.

    Attributes
    ----------
    faces : (4, rows, cols)
        Signed distance in um from the surface that keeps its lengths where the sheet is bent: s_T, s_TI, s_BI, s_B.
    rim_um : (2, rows, cols)
        Signed distance to the nearest hole's rim at the top and the bottom face, negative inside.
    char : (rows, cols)
        Factor on the coating's grey: 1 = untouched, 0.5 at the rim of a hole.
    coating_density, base_mass : (rows, cols)
        Relative, with a mean of 1.
    holes : (n, 2)
        True centres (u, v) at the top face, in um.
    """

    params: PaperParams
    seed: int
    origin: tuple[float, float]
    faces: Field
    rim_um: Field
    char: Field
    coating_density: Field
    base_mass: Field
    holes: Floats

    def covers(self, low: Floats, high: Floats) -> bool:
        """Return True if the fields reach from (u, v) = ``low`` to ``high``, in um."""
        rows, cols = self.faces.shape[1:]
        end = np.add(self.origin, PITCH_UM * np.array([cols - 1, rows - 1]))
        return bool(np.all(low >= self.origin) and np.all(high <= end))

    def at(self, field: Field, u: Floats, v: Floats) -> Floats:
        """Bilinear value of one field at material coordinates; the same rule that the renderer uses."""
        x = np.clip((u - self.origin[0]) / PITCH_UM, 0.0, field.shape[1] - 1.000001)
        y = np.clip((v - self.origin[1]) / PITCH_UM, 0.0, field.shape[0] - 1.000001)
        return bilinear(field, y, x)

    @cached_property
    def reach_um(self) -> float:
        """Largest distance of a face from the centre surface."""
        return float(max(self.faces.max(), -self.faces.min()))

    @cached_property
    def texture(self) -> Field:
        """Relative density of the base through its depth (LAYERS, rows, cols), bottom to top."""
        p, shape = self.params, (self.faces.shape[1], self.faces.shape[2])
        layers = np.empty((LAYERS, *shape), dtype=np.float32)
        for k in range(LAYERS):
            depth = (k + 0.5) / LAYERS
            grains = _FILLER_CONTRAST * p.filler * (1.2 - 1.6 * (depth - 0.5) ** 2)
            net = p.base_density_sd * fibrous(shape, p.anisotropy, generator(self.seed, "net", str(k)), per_mm2=50.0)
            dust = grains * generator(self.seed, "filler", str(k)).standard_normal(shape)
            layers[k] = np.clip(1 + net + dust, 0.2, 2.5)
        return layers

    @cached_property
    def packed(self) -> Field:
        """All that a renderer needs of a node side by side, (rows, cols, 8 + LAYERS)."""
        return np.stack([*self.faces, *self.rim_um, self.char, self.coating_density, *self.texture], axis=-1)


def make_sheet(
    paper: PaperParams, holes: HoleParams, *, low: Floats, high: Floats, centres: Floats, seed: int,
    stiffness: float = 0.0,
) -> Sheet:  # fmt: skip
    """Draw one sheet that covers the material rectangle from ``low`` to ``high`` (u, v) in um.

    ``stiffness``: of the coatings over the base's; it says where the surface lies that keeps its lengths.
    """
    shape = (int(np.ceil((high[1] - low[1]) / PITCH_UM)) + 2, int(np.ceil((high[0] - low[0]) / PITCH_UM)) + 2)
    thickness, relief = _base(paper, shape, seed)
    mass = thickness / thickness.mean() * (1 + 0.03 * noise(shape, 500.0, generator(seed, "mass")))
    mass /= mass.mean()
    faces: list[Floats] = []
    for side, sign, mean in (("top", 1.0, paper.coating_top_um), ("bottom", -1.0, paper.coating_bottom_um)):
        inner = 0.5 * thickness + sign * relief
        coating = _coating(paper, inner, mean, side, seed)
        outer = inner + coating
        # A nip presses the outer face flat; the coating keeps its thickness and the base gives way.
        outer = outer.mean() + paper.calendering * (outer - outer.mean())
        faces += [outer, outer - coating]
    depth = float(np.mean(faces[0] + faces[2]))
    rim, char = burn(holes, centres, shape, (float(low[0]), float(low[1])), depth, seed)
    grain = 0.3 * (mass - mass.mean()) / mass.std() + np.sqrt(1 - 0.09) * noise(shape, 300.0, generator(seed, "grain"))
    top, bottom = (float(np.mean(faces[k] - faces[k + 1])) for k in (0, 2))
    above = neutral_height(float(np.mean(faces[1] + faces[3])), top, bottom, stiffness)
    return Sheet(
        params=paper,
        seed=seed,
        origin=(float(low[0]), float(low[1])),
        faces=np.stack([faces[0], faces[1], -faces[3], -faces[2]]).astype(np.float32) - np.float32(above),
        rim_um=rim,
        char=char,
        coating_density=(1 + paper.coating_density_sd * grain).astype(np.float32),
        base_mass=mass.astype(np.float32),
        holes=centres,
    )


def neutral_height(base_um: float, top_um: float, bottom_um: float, stiffness: float) -> float:
    """Height of a bent laminate's unstrained surface over the middle of its base, in um.

    The layers bend together and no force acts along the sheet: the mean of their middles, weighted with thickness times
    modulus; ``stiffness`` is the coatings' modulus over the base's. With 1 it is the mean of the outer faces.
    """
    moment = top_um * (base_um + top_um) - bottom_um * (base_um + bottom_um)
    return 0.5 * stiffness * moment / (base_um + stiffness * (top_um + bottom_um))


def _base(p: PaperParams, shape: tuple[int, int], seed: int) -> tuple[Floats, Floats]:
    """Thickness of the base, and what bends both of its faces the same way: single fibres in the net."""
    thickness = np.full(shape, p.base_um)
    thickness += p.base_fibre_sd_um * fibrous(shape, p.anisotropy, generator(seed, "fibres"))
    thickness += p.base_floc_sd_um * noise(shape, _FLOC_UM, generator(seed, "flocs"))
    thickness += p.base_streak_sd_um * streaks(shape, _STREAK_UM, generator(seed, "streaks"))
    thickness = np.maximum(thickness, 0.3 * p.base_um)
    variance = p.base_fibre_sd_um**2 + p.base_floc_sd_um**2 + p.base_streak_sd_um**2
    excess_variance = p.roughness_um**2 - 0.25 * variance
    if excess_variance <= 0:
        return thickness, np.zeros(shape)
    # Few fibres lie on top of the others; they stand up and are what a coating leaves bare.
    rngs = (generator(seed, "face", side) for side in ("top", "bottom"))
    top, bottom = (fibrous(shape, p.anisotropy, rng, per_mm2=_LOOSE_PER_MM2) for rng in rngs)
    return thickness, float(np.sqrt(0.5 * excess_variance)) * (top - bottom)


def _coating(p: PaperParams, inner: Floats, mean_um: float, side: str, seed: int) -> Floats:
    """Thickness of one coating layer over the base's face ``inner``, both outwards, in um."""
    shape = (inner.shape[0], inner.shape[1])
    if mean_um == 0:
        return np.zeros(shape)
    levelled = lowpass(inner, p.levelling_um) - inner
    levelled += p.coating_noise_sd_um * noise(shape, 20.0, generator(seed, "coater", side))
    excess_variance = p.coating_sd_um**2 - float(levelled.var())
    if excess_variance > 0:
        # Skewed: a spot can lack more than another can carry too much.
        spots = np.exp(_SKEW * noise(shape, _DEPOSIT_UM, generator(seed, "deposit", side)))
        levelled -= np.sqrt(excess_variance) * (spots - spots.mean()) / spots.std()
    return np.maximum(mean_um + levelled, 0.0)
