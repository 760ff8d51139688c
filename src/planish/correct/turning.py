"""The axis of rotation: its place in the array, and the distance of every voxel from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import InputError, SizeError, VolumeError
from planish.core.typing import Floats
from planish.correct.params import Axis

SECTORS = 16  # parts of a full turn that are compared: a ring shows in all of them, a structure of the sheet does not

_LEAST_PLANE, _LEAST_LENGTH = 24, 8
_FAR = 0.5  # of the field's width; an axis further outside is taken for a mistake
_AXES: dict[Axis, tuple[Axis, Axis]] = {"z": ("y", "x"), "y": ("z", "x"), "x": ("z", "y")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Turning:
    """The axis of rotation.

    ``centre_um`` and ``pitch_um`` are its place and the voxel size along the two other axes, in array order; ``shape``
    are the voxels along the axis of rotation and along the two others.
    """

    axis: Axis
    centre_um: tuple[float, float]
    pitch_um: tuple[float, float]
    shape: tuple[int, int, int]

    @property
    def plane(self) -> tuple[Axis, Axis]:
        """The two axes across the axis of rotation, in array order."""
        return _AXES[self.axis]

    @property
    def order(self) -> tuple[int, int, int]:
        """Axes of the array (z, y, x) in the order axis of rotation, plane."""
        a, b, c = ("zyx".index(name) for name in (self.axis, *self.plane))
        return a, b, c

    @property
    def step_um(self) -> float:
        """Width of a bin of the radius: half a voxel, so that a ring of one voxel keeps its height."""
        return 0.5 * min(self.pitch_um)

    @property
    def bins(self) -> int:
        """Number of bins of the radius."""
        return int(np.ceil(self.farthest_um / self.step_um)) + 1

    @property
    def farthest_um(self) -> float:
        """Largest radius in the field."""
        ends = [
            max(abs(c), abs((n - 1) * p - c))
            for c, n, p in zip(self.centre_um, self.shape[1:], self.pitch_um, strict=True)
        ]
        return math.hypot(*ends)

    def radius_um(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Floats:
        """Distance (rows, cols) from the axis in um."""
        r, c = self._offsets(rows, cols)
        return np.hypot(r[:, None], c[None, :])

    def sectors(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[np.int64]:
        """Number (rows, cols) of the part of the turn; parts begin at the axes of the array."""
        r, c = self._offsets(rows, cols)
        angle = np.arctan2(r[:, None], c[None, :]) / (2 * np.pi) % 1.0
        return np.minimum((angle * SECTORS).astype(np.int64), SECTORS - 1)

    def _offsets(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> tuple[Floats, Floats]:
        (a, b), (p, q) = self.centre_um, self.pitch_um
        return rows.astype(np.float64) * p - a, cols.astype(np.float64) * q - b


def make_turning(volume: xr.DataArray, axis: Axis, centre_um: tuple[float, float] | None) -> Turning:
    """Place the axis of rotation; in the middle of the field where ``centre_um`` is None."""
    if "voxel_um" not in volume.attrs:
        raise SizeError("The volume has no voxel size ('voxel_um'). Read it with read_volume, which asks for one.")
    size = dict(zip("zyx", (float(v) for v in volume.attrs["voxel_um"]), strict=True))
    plane = _AXES[axis]
    shape = (volume.sizes[axis], volume.sizes[plane[0]], volume.sizes[plane[1]])
    if shape[0] < _LEAST_LENGTH:
        raise VolumeError(
            f"The volume has {shape[0]} voxel(s) along {axis}, the axis of rotation; at least {_LEAST_LENGTH} are "
            "needed to separate a ring from the sheet. Give the whole stack, or another axis with --rotation-axis."
        )
    if min(shape[1:]) < _LEAST_PLANE:
        raise VolumeError(
            f"The volume has {shape[1]} x {shape[2]} voxels along {plane[0]} and {plane[1]}, across the axis of "
            f"rotation; at least {_LEAST_PLANE} are needed. Give the whole stack, or another --rotation-axis."
        )
    pitch = (size[plane[0]], size[plane[1]])
    ends = [(n - 1) * p for n, p in zip(shape[1:], pitch, strict=True)]
    centre = (0.5 * ends[0], 0.5 * ends[1]) if centre_um is None else centre_um
    for name, position, end in zip(plane, centre, ends, strict=True):
        if not -_FAR * end <= position <= (1 + _FAR) * end:
            raise InputError(
                f"The axis of rotation would stand at {name} = {position:g} um; the field runs from 0 to {end:g} um. "
                f"Give --rotation-centre-um as {plane[0]},{plane[1]} in um from the first voxel."
            )
    return Turning(axis=axis, centre_um=centre, pitch_um=pitch, shape=shape)
