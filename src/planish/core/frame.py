"""How the sheet lies in the volume.

Which axis runs through it, by the grey too, and which side is the top.

The lateral axes keep the order they have in the array: ``rows`` is the first of the two that remain
and ``cols`` the second. Heights are coordinates along the axis through the sheet, in um; ``sign``
turns them so that the top is up.

Seen from its top the sheet is mirrored when the three axes (cols, rows, towards the viewer) are an
odd permutation of (x, y, z): a camera above the high end of z sees x to the right and y downwards;
from the other side one is reversed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from planish.core.errors import InputError, check_choice

if TYPE_CHECKING:
    import xarray as xr

    from planish.core.facts import Side
    from planish.core.lazy import LazyArray
    from planish.core.typing import Array, Floats

Axis = Literal["z", "y", "x"]
End = Literal["high", "low"]
AXES: tuple[Axis, ...] = ("z", "y", "x")
ENDS: tuple[End, ...] = ("high", "low")
_LATERAL: dict[str, tuple[Axis, Axis]] = {"z": ("y", "x"), "y": ("z", "x"), "x": ("z", "y")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Pose of the sheet in the array."""

    through: Axis = "z"  #: axis that runs through the sheet
    top: End = "high"  #: end of that axis at which the sheet's top side lies

    def __post_init__(self) -> None:
        """Refuse other axes and ends."""
        check_choice("through", self.through, AXES)
        check_choice("top", self.top, ENDS)

    @property
    def rows(self) -> Axis:
        """Axis along the rows of every map."""
        return _LATERAL[self.through][0]

    @property
    def cols(self) -> Axis:
        """Axis along the columns of every map."""
        return _LATERAL[self.through][1]

    @property
    def sign(self) -> float:
        """Factor on heights that makes the top the larger one."""
        return 1.0 if self.top == "high" else -1.0

    def side_at(self, *, from_high: bool) -> Side:
        """Name the side of the sheet at the high end of the axis through it, or at the low end."""
        if from_high == (self.top == "high"):
            return "top"
        return "bottom"

    @property
    def mirrored(self) -> bool:
        """True if the lateral grid is a mirror image of the view from the top."""
        return (self.through == "y") != (self.top == "low")

    def columns(self, volume: xr.DataArray) -> xr.DataArray:
        """Return a view of the volume with dims (rows, cols, through); no copy."""
        return volume.transpose(self.rows, self.cols, self.through)

    def lies(self) -> dict[str, str]:
        """Return what a volume records of how the sheet lies in it."""
        return {"through": self.through, "top_side": self.top}

    def attrs(self) -> dict[str, str]:
        """Return what a dataset on this frame records."""
        return {**self.lies(), "row_axis": self.rows, "col_axis": self.cols}

    @classmethod
    def of(cls, data: xr.Dataset | xr.DataArray) -> Frame:
        """Read the frame back from a dataset's attributes.

        Z and its high end where a volume says nothing of it.
        """
        return cls(through=data.attrs.get("through", "z"), top=data.attrs.get("top_side", "high"))

    @classmethod
    def asked(
        cls, volume: xr.DataArray, frame: Frame | None, through: Axis | None, top: End | None
    ) -> Frame:
        """The frame of a call: as given, in one piece or in words, or as the volume says.

        InputError if it is given twice, or as something else.
        """
        words = {"through": through, "top": top}
        keywords = {name: word for name, word in words.items() if word is not None}
        if frame is None:
            return replace(cls.of(volume), **keywords)
        if not isinstance(frame, cls):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError(
                f'frame={frame!r} is no frame. Write through="y", or frame=pl.Frame(through="y").'
            )
        if keywords:
            raise InputError(
                f"frame= and {' and '.join(f'{name}=' for name in keywords)} say the same. Leave"
                " one out."
            )
        return frame


def likely_through(values: Array | LazyArray | xr.Variable) -> Axis | None:
    """Name the axis along which the mean grey changes most.

    None where two do, as with a round field of view.

    A sheet fills some planes across its normal; those along it are alike. Some slices of ``values``
    (z, y, x) are read.
    """
    import numpy as np

    sample = _sample(values)
    is_value = np.isfinite(sample)
    mean = np.mean(sample[is_value]) if is_value.any() else 0.0
    sample[~is_value] = mean
    planes = ((1, 2), (0, 2), (0, 1))  # across each axis
    variances = [float(sample.mean(axis=axes).var()) for axes in planes]
    _, second, largest = sorted(variances)
    # The second axis may have this share of the variance along the first.
    if not largest > 0 or second > 0.3 * largest:
        return None
    return AXES[variances.index(largest)]


def _sample(values: Array | LazyArray | xr.Variable) -> Floats:
    """Some values of a volume (z, y, x), its axes as they are."""
    import numpy as np

    # 24 of the slices and 200 places along either other axis; of a file in chunks only three rows
    # of these, each once.
    depth, height, _ = getattr(values, "encoding", {}).get("chunks") or (1, 1, 1)
    slice_indices = np.unique(np.linspace(0, values.shape[0] - 1, 24).astype(int))
    steps = [max(1, n // 200) for n in values.shape[1:]]
    n_bands = values.shape[1] // height
    starts = height * np.linspace(0, n_bands - 1, 3).astype(int)
    bands = [slice(None)]
    if depth > 1 and 6 * height < values.shape[1]:
        bands = [slice(k, k + height) for k in starts]
    planes: list[Array] = []
    # Slices of one layer of chunks are read together.
    for layer in np.unique(slice_indices // depth):
        indices = slice_indices[slice_indices // depth == layer]
        parts: list[Array] = []
        for band in bands:
            slab = np.asarray(values[indices[0] : indices[-1] + 1, band])
            parts.append(slab[indices - indices[0], :: steps[0], :: steps[1]])
        planes += [*np.concatenate(parts, axis=1)]
    return np.stack(planes).astype(np.float64)


def other_axis(volume: xr.DataArray, through: str) -> str:
    """Name the axis that looks like the sheet's normal, where another one was given."""
    axis = likely_through(volume.variable)
    if axis in (None, through):
        return ""
    return f"The grey changes most along {axis}: try `through={axis}`."
