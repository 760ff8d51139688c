"""Grey values along the rays of the centre surface, and what is asked of them: integrals, lengths, means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Bools, Floats
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams

Grey = NDArray[np.float32]
Direction = Literal["normal", "vertical"]
T = TypeVar("T")

FACES = ("top", "bottom", "interface_top", "interface_bottom")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Grey values along the rays of some rows of the centre surface.

    Lengths are in um; ``s`` is the signed distance from the centre surface, the top is positive.

    Attributes
    ----------
    grey : (rows, cols, s) float32
        NaN outside the volume, beside missing voxels, and on rays without a status of 0.
    s_um : (s,)
        The same for all rays, in equal steps.
    top, bottom, interface_top, interface_bottom : (rows, cols)
        Places of the faces and interfaces; an interface of a side without a coating is its face.
    normals : (rows, cols, 3)
        Directions of the rays along rows, columns and height.
    stretch : (rows, cols, 2)
        Length of a step of one um along rows and columns, measured in the centre surface.
    slope : (rows, cols, 2)
        Of the centre surface along rows and columns, up towards the top.
    oblique : (rows, cols)
        Length of ray for one um along the normal: 1 on normals, 1 / cos of the tilt on vertical rays.
    status : (rows, cols) uint8
    pitch_um : (float, float)
        Between rows and between columns, in projection.
    voxel_um : float
        Voxel size along the axis through the sheet.
    greys : Greys
    params : MeasureParams
    noise_um : float
        Variance of the grey's integral over one um of ray, from the noise alone.
    mirrored : bool
        Whether the array shows the sheet as a mirror does.
    """

    grey: Grey
    s_um: Floats
    top: Floats
    bottom: Floats
    interface_top: Floats
    interface_bottom: Floats
    normals: Floats
    stretch: Floats
    slope: Floats
    oblique: Floats
    status: NDArray[np.uint8]
    pitch_um: tuple[float, float]
    voxel_um: float
    greys: Greys
    params: MeasureParams
    noise_um: float
    mirrored: bool
    mean_stretch: tuple[float, float]
    _cache: dict[str, object] = field(default_factory=lambda: {})

    @property
    def step_um(self) -> float:
        """Distance of two samples."""
        return float(self.s_um[1] - self.s_um[0])

    @property
    def edge_um(self) -> Floats:
        """Length left out of the base at both ends, along the ray (rows, cols)."""
        return self.oblique * (2 * self.greys.blur_um if self.params.edge_um is None else self.params.edge_um)

    @property
    def core(self) -> tuple[Floats, Floats]:
        """Lower and upper end of the base without its edges."""
        return self.interface_bottom + self.edge_um, self.interface_top - self.edge_um

    def between(self, lower: Floats, upper: Floats) -> Bools:
        """Mark the samples that lie between two places on each ray; (rows, cols, s)."""
        return (self.s_um >= lower[..., None]) & (self.s_um <= upper[..., None])

    def samples_within(self, lower: Floats, upper: Floats, *, more: int = 0) -> slice:
        """Samples that lie between two places on any of the rays, and ``more`` on both sides."""
        is_finite = np.isfinite(lower) & np.isfinite(upper)
        if not is_finite.any():
            return slice(0, 1 + more)
        first = int(np.searchsorted(self.s_um, lower[is_finite].min(), side="left")) - more
        last = int(np.searchsorted(self.s_um, upper[is_finite].max(), side="right")) + more
        return slice(max(first, 0), max(min(last, self.s_um.size), max(first, 0) + 1))

    def integral(self, lower: Floats, upper: Floats) -> Floats:
        """Integral of the grey above the air from ``lower`` to ``upper`` (rows, cols); grey times um."""
        return self._pieces(lower, upper, 0.0, 0.0)[0] - self.greys.air * np.maximum(upper - lower, 0.0)

    def mean(self, lower: Floats, upper: Floats) -> Floats:
        """Mean grey above the air between two places; NaN where they are not a step apart."""
        length = upper - lower
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(length >= self.step_um, self.integral(lower, upper) / length, np.nan)

    def length(self, lower: Floats, upper: Floats, *, least: float, most: float) -> tuple[Floats, NDArray[np.int32]]:
        """Length in um with ``least <= grey <= most`` between two places, and how many ends it has there."""
        _, length, ends = self._pieces(lower, upper, least, most)
        return length, ends

    def _pieces(
        self, lower: Floats, upper: Floats, least: float, most: float
    ) -> tuple[Floats, Floats, NDArray[np.int32]]:
        from planish.measure import _ray_kernels

        return _ray_kernels.pieces(
            self.grey, float(self.s_um[0]), self.step_um, lower, upper, float(least), float(most)
        )

    def beyond(self, lower: Floats, upper: Floats, level: float) -> tuple[Floats, NDArray[np.int32]]:
        """Length in um on which the grey is farther from the air than ``level``, and how many ends it has."""
        least, most = (level, np.inf) if self.greys.polarity > 0 else (-np.inf, level)
        return self.length(lower, upper, least=least, most=most)

    def crossing_se(self, contrast: float) -> Floats:
        """Standard error in um of one crossing of a blurred step (rows, cols): ``sqrt(2 pi) w sigma / |contrast|``.

        A step of height C blurred with a Gaussian of standard deviation w has the slope C / (sqrt(2 pi) w) where it is
        half way, and noise of standard deviation sigma moves that place by sigma over the slope.
        """
        blur = max(self.greys.blur_um, 0.5 * self.voxel_um)
        return self.oblique * (np.sqrt(2 * np.pi) * blur * self.greys.noise / max(abs(contrast), 1e-12))

    def integral_se(self, length: Floats | float) -> Floats:
        """Standard error of an integral over ``length`` um: sqrt(noise_um * length)."""
        return np.sqrt(self.noise_um * np.maximum(np.asarray(length, dtype=np.float64), 0.0))

    def cached(self, key: str, work: Callable[[], T]) -> T:
        """Return the outcome of ``work``, worked out once for these rays: for properties that share an inner step."""
        if key not in self._cache:
            self._cache[key] = work()
        return self._cache[key]  # type: ignore[return-value]

    def rows(self, part: slice) -> Rays:
        """Return some of the rows."""
        arrays = ("grey", *FACES, "normals", "stretch", "slope", "oblique", "status")
        cut: dict[str, Any] = {name: getattr(self, name)[part] for name in arrays}
        return replace(self, **cut, _cache={})
