"""The thin-plate spline as a transformation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planish.core.transform import Pair
from planish.core.typing import Floats
from planish.register._bent_kernels import add_thin_plate
from planish.register.bent import Bent, Kernel


def bending(squares: Floats) -> Floats:
    """The kernel ``r**2 log r`` of squared distances."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > 0, 0.5 * squares * np.log(squares), 0.0)


def _slope(squares: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        return np.where(squares > 0, np.log(squares) + 1.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThinPlate(Bent):
    """An affine map and smooth local changes around the marks, with ``U(r) = r**2 log r``.

    References
    ----------
    Wahba (1990), Spline Models for Observational Data, doi:10.1137/1.9781611970128.
    """

    everywhere: ClassVar[bool] = False

    source: Pair  # in um: middle of the marks
    size: float  # in um: their rms distance from it
    nodes: Floats  # (m, 2): places of the marks, scaled
    affine: Floats  # (3, 2), in um: constant and linear part
    bend: Floats  # (m, 2), in um: coefficients of the kernels
    # The parameter lambda of the spline in um**2: 0 goes through all marks, infinity is affine. It is what
    # ``scipy.interpolate.RBFInterpolator`` calls ``smoothing``.
    smoothing_um2: float

    def __post_init__(self) -> None:
        """Lay the arrays out as they are read back from a file, so that sums have the same bytes."""
        for name in ("nodes", "affine", "bend"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64, order="C"))

    def bends(self) -> Iterator[tuple[Kernel, Kernel, Floats]]:
        """One kernel."""
        yield bending, _slope, self.bend

    def add_bends(self, scaled: Floats, out: Floats) -> None:
        """Add the local changes at scaled points, as :class:`Bent` does, in one compiled loop."""
        add_thin_plate(scaled, self.nodes, self.bend, out)
