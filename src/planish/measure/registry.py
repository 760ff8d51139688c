"""What a property is, and the list of them: a function of rays, or of whole maps, with a name, a unit and its reasons.

::

    @ray_property("ash", units="1", long_name="Share of bright matter")
    def ash(rays):
        bright, _ = rays.beyond(rays.bottom, rays.top, 150.0)
        return bright / (rays.top - rays.bottom)

A function returns an array (rows, cols), NaN where it has no answer, or a :class:`Measured` that carries a standard
error and reasons beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure
from planish.measure.greys import Greys
from planish.measure.options import RayOptions
from planish.measure.ray_frame import RayFrame
from planish.measure.rays import Array, Rays


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Values of a property with what is known of them.

    Attributes
    ----------
    values : (rows, cols)
        NaN where there is no answer.
    se : (rows, cols) or None
        Standard error in the same unit; None where it cannot be stated.
    reason : (rows, cols) uint8 or None
        1, 2, ... for the property's own reasons where ``values`` is NaN.
    """

    values: Array
    se: Array | None = None
    reason: NDArray[np.uint8] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """What a property of whole maps is given.

    Attributes
    ----------
    frame : RayFrame
        Faces along the rays, centre surface, status, pitch and options.
    maps : mapping of Measured
        The properties that were named with ``after``.
    noise_um : float
        Variance of the grey's integral over one um of ray.
    """

    frame: RayFrame
    maps: Mapping[str, Measured]
    noise_um: float

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Rays that meet both faces."""
        return self.frame.status == 0


RayFunction = Callable[[Rays], "Array | Measured"]
SheetFunction = Callable[[Sheet], "Array | Measured"]
Length = float | Callable[[RayOptions], float]
After = tuple[str, ...] | Callable[[RayOptions, Greys], tuple[str, ...]]
Check = Callable[[RayOptions, Greys], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Property:
    """One property; made by :func:`ray_property` and :func:`sheet_property`.

    Attributes
    ----------
    name, units, long_name : str
    kind : {"rays", "sheet"}
    function : callable
        From :class:`~planish.measure.rays.Rays`, or from :class:`Sheet`.
    halo_um : float or callable
        Rows beyond a tile that a ray's answer depends on, as a length.
    support_um : float or callable or None
        Width of what one value speaks for; None: one ray, with what the blur adds.
    reasons : tuple of str
        The property's own reasons for a missing value.
    after : tuple of str, or callable
        Properties that this one is made from, or a function from the options and the grey levels to them.
    check : callable or None
        Raises CannotMeasure, before anything is read, where something that it needs was not given.
    """

    name: str
    units: str
    long_name: str
    kind: Literal["rays", "sheet"]
    function: Callable[..., Array | Measured]
    halo_um: Length = 0.0
    support_um: Length | None = None
    reasons: tuple[str, ...] = ()
    after: After = ()
    check: Check | None = None

    def __call__(self, given: Rays | Sheet) -> Array | Measured:
        """Call the function itself."""
        return self.function(given)


_REGISTERED: dict[str, Property] = {}


def ray_property(
    name: str, *, units: str, long_name: str, halo_um: Length = 0.0, support_um: Length | None = None,
    reasons: Sequence[str] = (), check: Check | None = None,
) -> Callable[[RayFunction], Property]:  # fmt: skip
    """Register a function of rays as a property; see :class:`Property` for what the words mean.

    Raises
    ------
    CannotMeasure
        If the name is taken.
    """

    def register(function: RayFunction) -> Property:
        return _add(Property(name=name, units=units, long_name=long_name, kind="rays", function=function,
                             halo_um=halo_um, support_um=support_um, reasons=tuple(reasons), check=check))  # fmt: skip

    return register


def sheet_property(
    name: str, *, units: str, long_name: str, after: After = (), support_um: Length | None = None,
    reasons: Sequence[str] = (), check: Check | None = None,
) -> Callable[[SheetFunction], Property]:  # fmt: skip
    """Register a function of whole maps as a property.

    Raises
    ------
    CannotMeasure
        If the name is taken.
    """

    def register(function: SheetFunction) -> Property:
        return _add(Property(name=name, units=units, long_name=long_name, kind="sheet", function=function,
                             support_um=support_um, reasons=tuple(reasons), after=after, check=check))  # fmt: skip

    return register


def _add(new: Property) -> Property:
    if not new.name.isidentifier():
        raise CannotMeasure(f"'{new.name}' is no name of a property: use letters, digits and underscores.")
    old = _REGISTERED.get(new.name)
    # The same function again is a module that was loaded twice, as in a notebook.
    if old is not None and (old.function.__module__, old.function.__qualname__) != (
        new.function.__module__, new.function.__qualname__,
    ):  # fmt: skip
        raise CannotMeasure(f"There is a property '{new.name}' already ({old.long_name}). Choose another name.")
    _REGISTERED[new.name] = new
    return new


def registered() -> dict[str, Property]:
    """Return all properties by name, in the order of their registration."""
    return dict(_REGISTERED)


def find_property(name: str | Property) -> Property:
    """Return a property by name.

    Raises
    ------
    CannotMeasure
        If there is none; the message lists those there are.
    """
    if isinstance(name, Property):
        return name
    if name not in _REGISTERED:
        raise CannotMeasure(f"There is no property '{name}'. Choose from {', '.join(sorted(_REGISTERED))}.")
    return _REGISTERED[name]


def in_order(names: Sequence[str | Property], options: RayOptions, greys: Greys) -> list[Property]:
    """Return the properties and all that they are made from, each after what it needs."""
    done: dict[str, Property] = {}

    def visit(one: Property, under: tuple[str, ...]) -> None:
        if one.name in under:
            raise CannotMeasure(f"The property '{one.name}' is made from itself: {' > '.join((*under, one.name))}.")
        for needed in one.after(options, greys) if callable(one.after) else one.after:
            visit(find_property(needed), (*under, one.name))
        done.setdefault(one.name, one)

    for name in names:
        visit(find_property(name), ())
    return list(done.values())


def length_of(length: Length, options: RayOptions) -> float:
    """Value in um of a length that may depend on the options."""
    return length(options) if callable(length) else length
