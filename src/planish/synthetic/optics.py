"""How bright paper is: Kubelka and Munk's theory of light in a stack of scattering layers.

The coefficients of coating and base are usual values for visible light, per mass and area as paper physics states
them: ``s`` and ``k`` in m2/kg, ``W`` in kg/m2.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from planish.core.light import layer_over
from planish.core.typing import Floats
from planish.synthetic.params import PaperParams

BASE_S_M2_PER_KG = 45.0
BASE_K_M2_PER_KG = 1.2
# A triple coating from the base outwards: scattering of the pre, middle and top layer, and its share of the thickness.
COATING_S_M2_PER_KG = (90.0, 110.0, 150.0)
COATING_SHARES = (0.3, 0.3, 0.4)
COATING_K_M2_PER_KG = 0.3

_KG_PER_M2 = 1e-3  # of 1 um with a density of 1 g/cm3
_SHEETS = 200  # of a pile that nothing shines through: 200 sheets of 10 g/m2


def base_weight(paper: PaperParams, base_mass: ArrayLike = 1.0) -> Floats:
    """Grammage of the base in kg/m2: mean thickness by density, times the relative grammage of the place."""
    return paper.base_um * paper.base_g_per_cm3 * _KG_PER_M2 * np.asarray(base_mass, dtype=np.float64)


def coated(
    below: ArrayLike, coating_um: ArrayLike, density: ArrayLike, paper: PaperParams, *, outwards: bool = True
) -> Floats:
    """Reflectance of the triple coating over what lies below it, which is the base unless ``outwards`` is false."""
    weight = paper.coating_g_per_cm3 * _KG_PER_M2 * np.asarray(coating_um, float) * np.asarray(density, float)
    layers = list(zip(COATING_S_M2_PER_KG, COATING_SHARES, strict=True))
    result = np.asarray(below, dtype=np.float64)
    for s, share in layers if outwards else layers[::-1]:
        result = layer_over(result, s, COATING_K_M2_PER_KG, share * weight)
    return result


def sheet_reflectance(
    paper: PaperParams,
    backing: Literal["pile", "black"],
    *,
    coating_top_um: ArrayLike,
    coating_bottom_um: ArrayLike,
    coating_density: ArrayLike = 1.0,
    base_mass: ArrayLike = 1.0,
    base_s_m2_per_kg: ArrayLike = BASE_S_M2_PER_KG,
) -> Floats:
    """Reflectance of the sheet's top side: bottom coating, base and top coating over a backing.

    The backing is a pile of the same paper or a black hollow. Density of the coatings and grammage of the base are
    relative, 1 in the mean.
    """
    below = pile_reflectance(paper) if backing == "pile" else 0.0
    below = coated(below, coating_bottom_um, coating_density, paper, outwards=False)
    below = layer_over(below, base_s_m2_per_kg, BASE_K_M2_PER_KG, base_weight(paper, base_mass))
    return coated(below, coating_top_um, coating_density, paper)


def pile_reflectance(paper: PaperParams) -> float:
    """Reflectance of a pile of mean sheets of this paper that nothing shines through."""
    below = np.zeros(())
    for _ in range(_SHEETS):
        below = coated(below, paper.coating_bottom_um, 1.0, paper, outwards=False)
        below = layer_over(below, BASE_S_M2_PER_KG, BASE_K_M2_PER_KG, base_weight(paper))
        below = coated(below, paper.coating_top_um, 1.0, paper)
    return float(below)
