"""Angles of an axis, such as that of fibres: 90 and -90 degrees are one direction.

Their means and spreads are those of the doubled angles (Mardia and Jupp 2000, Directional
Statistics, sections 2.2 and 2.3, doi:10.1002/9780470316979).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from planish.core.errors import InputError
from planish.core.typing import Array, Floats

if TYPE_CHECKING:
    import xarray as xr


PERIOD_DEG = 180.0
"""After which the angles of an axis repeat."""


def is_axial(data: Any) -> bool:
    """Whether a map holds angles of an axis; InputError where they repeat after another angle."""
    attrs = getattr(data, "attrs", {})
    name = str(getattr(data, "name", ""))
    return has_axes(name, attrs.get("period_deg"))


def has_axes(name: str, period_deg: float | None) -> bool:
    """The same by a map's name and the period that it states: older maps state none."""
    if period_deg is None:
        return name.startswith("fibre_angle")
    if period_deg != PERIOD_DEG:
        raise InputError(
            f"{name} has angles that repeat after {period_deg:g} degrees. Only those"
            f" of an axis, which repeat after {PERIOD_DEG:g}, have means here. Change the"
            " attribute, or give the cosine and the sine as maps."
        )
    return True


def refuse_axial(data: Any) -> None:
    """Raise InputError where a map that is to be correlated holds angles of an axis."""
    if is_axial(data):
        raise InputError(
            f"{data.name} holds angles of an axis: 90 and -90 degrees are one direction, and an r"
            " with them means nothing. Take the cosine and the sine of the doubled angle: of"
            " fibre_angle they are the maps fibre_cos2 and fibre_sin2."
        )


def summable(data: Any, values: Array) -> Array:
    """Values of a map that have a mean: of an axis, unit vectors of the doubled angles."""
    return doubled(values) if is_axial(data) else values


def summable_of(maps: xr.Dataset, name: Any) -> Array:
    """The same of one of several maps: NAME_angle by NAME_cos2 and NAME_sin2, where they are there.

    Those are vectors as long as the direction prevails.
    """
    stem = str(name).removesuffix("_angle")
    cosine = f"{stem}_cos2"
    sine = f"{stem}_sin2"
    if is_axial(maps[name]) and cosine in maps and sine in maps:
        return maps[cosine].values + 1j * maps[sine].values
    return summable(maps[name], maps[name].values)


def doubled(angles_deg: Array) -> Array:
    """Unit vectors of the doubled angles, as complex numbers."""
    return np.exp(2j * np.deg2rad(angles_deg))


def axial_angle(cosine: Floats, sine: Floats) -> Floats:
    """Angle in degrees, -90 to 90, of a direction without sense.

    From means of the cosine and sine of its double.
    """
    return np.rad2deg(0.5 * np.arctan2(sine, cosine))


def angle_of(vectors: Any) -> Floats:
    """Angle of the axis of means of what ``summable`` gives."""
    return axial_angle(np.real(vectors), np.imag(vectors))


def near_axis(angles_deg: Floats | float, axis_deg: Floats | float) -> Any:
    """The same directions, as angles within a quarter turn of an axis."""
    return axis_deg + (angles_deg - axis_deg + PERIOD_DEG / 2) % PERIOD_DEG - PERIOD_DEG / 2


def distribution(values: Floats, vectors: Array, *, ddof: int = 0) -> tuple[float, float, Floats]:
    """Mean and standard deviation of values of a map, and the values for percentiles.

    ``vectors`` are what ``summable`` makes of them. Of an axis: its mean, half of the circular
    standard deviation of the doubled angles, and the angles near the mean, which may pass 90
    degrees.
    """
    if not np.iscomplexobj(vectors):
        return float(values.mean()), float(values.std(ddof=ddof)), values
    total = vectors.sum()
    mean = float(angle_of(total))
    length = min(float(np.abs(total) / np.abs(vectors).sum()), 1.0)  # it may be rounded up
    sd = np.rad2deg(0.5 * np.sqrt(-2 * np.log(length)))
    return mean, float(sd), near_axis(values, mean)
