"""What a property is, and the list of them.

A property is a function of rays, or of whole maps, with a name, a unit and its reasons.

::

    @ray_property("ash", units="1", long_name="Share of bright matter")
    def ash(rays):
        bright, _ = rays.beyond(rays.bottom, rays.top, 150.0)
        return bright / (rays.top - rays.bottom)

A function returns an array (rows, cols), NaN where it has no answer, or a :class:`Measured` that
carries a standard error and reasons beside it. A name with ``{side}`` in it makes two properties,
top and bottom, and every function of theirs is also given ``side``. A module with properties of
planish's own becomes known by its entry in the table in :mod:`planish.measure.params`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, update_wrapper
from importlib import import_module
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, TypeVar

import numpy as np

from planish.core.axial import has_axes
from planish.core.errors import CannotMeasure, InputError
from planish.core.facts import SIDES, Side
from planish.core.older_names import renamed
from planish.core.plugins import find_plugin, plugins
from planish.core.typing import Bools, Codes, Entries, Floats, Texts
from planish.measure.greys import Greys
from planish.measure.options import Common

if TYPE_CHECKING:
    import xarray as xr

    from planish.measure.rays import RayFrame, Rays

P = ParamSpec("P")
T = TypeVar("T")


PROPERTIES = {
    "coating_top": "Coating thickness, top side",
    "coating_bottom": "Coating thickness, bottom side",
    "base_thickness": "Base thickness",
    "thickness": "Sheet thickness",
    "topography_top": "Topography, top side",
    "topography_bottom": "Topography, bottom side",
    "base_surface_top": "Surface of the base, top side",
    "base_surface_bottom": "Surface of the base, bottom side",
}
"""The properties that the faces alone give."""

LENGTHS = {
    "coating_top": ("top", "interface_top"),
    "coating_bottom": ("interface_bottom", "bottom"),
    "base_thickness": ("interface_top", "interface_bottom"),
    "thickness": ("top", "bottom"),
    "half_thickness_top": ("top", "centre"),
    "half_thickness_bottom": ("centre", "bottom"),
}
"""Upper and lower end of each length along a ray."""

OF_FACES = ("half_thickness_top", "half_thickness_bottom", "half_thickness_difference")
"""Further maps that the faces alone give as well, of labels too."""

HEIGHTS = {
    "topography_top": "top",
    "topography_bottom": "bottom",
    "base_surface_top": "interface_top",
    "base_surface_bottom": "interface_bottom",
}
"""The surface whose height above its own form a property is."""

NEGATIVE_CONTROLS = ("warp", "tilt")
"""Maps of the pose in the scanner, not of the paper: r with one shows no property."""

SUMS = (
    ("thickness", "coating_top", "coating_bottom", "base_thickness"),
    ("coating_difference", "coating_top", "coating_bottom"),
    ("half_thickness_difference", "half_thickness_top", "half_thickness_bottom"),
    ("thickness", "half_thickness_top", "half_thickness_bottom"),
)
"""Each map is the sum of the others, or their difference: given all but one, that one says nothing
new."""

_LAYERS = ("coating_top", "coating_bottom", "base_thickness")
PARTS: dict[str, Texts] = {
    "thickness": (*_LAYERS, "half_thickness_top", "half_thickness_bottom"),
    "base_thickness": ("base_surface_top", "base_surface_bottom"),
    "coating_difference": ("coating_top", "coating_bottom"),
    # Of waves that the centre surface follows both halves have the same.
    "half_thickness_difference": ("topography_top", "topography_bottom"),
    "thickness_envelope": ("thickness",),
    "absorption": ("thickness",),
    "absorption_base": ("base_thickness",),
    "grammage": ("thickness",),
    "apparent_density": ("grammage",),
    "filler_weight": ("filler", "base_thickness"),
    "fibre_anisotropy": ("fibre_cos2", "fibre_sin2"),
    "ink_depth_90": ("ink_depth_50",),
    "ink_depth_95": ("ink_depth_90",),
}
"""The maps that each map of planish's own contains, some of them in some waves only."""

for _side in SIDES:
    PARTS.update(
        {
            f"half_thickness_{_side}": (f"topography_{_side}", *_LAYERS),
            f"topography_{_side}": (f"roughness_{_side}",),
            f"roughness_{_side}": (f"base_surface_{_side}", f"coating_{_side}"),
            f"coating_{_side}_sum": (f"coating_{_side}",),
            f"coating_{_side}_envelope": (f"coating_{_side}",),
            f"coating_absorption_{_side}": (f"coating_{_side}",),
            f"coat_weight_{_side}": (f"coating_{_side}",),
        }
    )


def shared_parts(a: str, b: str, maps: xr.Dataset) -> Texts:
    """Return the largest of ``maps`` with values that two maps both contain by construction.

    Each contains itself.
    """
    of_b = {*_contents(b)}
    common = dict.fromkeys(name for name in _contents(a) if name in of_b and name in maps)
    from planish.core.bands import thinned  # here, so that help waits for no xarray

    shared = [name for name in common if np.isfinite(thinned(maps[name])[1][0]).any()]
    inner = {part for name in shared for part in _contents(name)[1:]}
    return tuple(name for name in shared if name not in inner)


def _contents(name: str) -> list[str]:
    """Give a map and all that it contains, with repetitions."""
    contents = [name]
    for part in PARTS.get(name, ()):
        contents += _contents(part)
    return contents


def face_length(faces: Mapping[str, Floats], name: str) -> Floats:
    """A length, um, from the signed distances of the faces and interfaces along the rays."""
    upper_face, lower_face = LENGTHS[name]
    centre = np.zeros(faces["top"].shape)
    return faces.get(upper_face, centre) - faces.get(lower_face, centre)


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Values of a property with what is known of them."""

    values: Floats  #: (rows, cols); NaN where there is no answer
    #: standard error (rows, cols) in the same unit; NaN where it cannot be stated.
    se: Floats | float = np.nan
    #: (rows, cols): 1, 2, ... of the property's own where ``values`` is NaN.
    reason: Codes | int = 0

    def times(self, factor: float) -> Measured:
        """Return the same in another unit."""
        return Measured(values=self.values * factor, se=self.se * abs(factor))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """What a property of whole maps is given."""

    frame: RayFrame  #: faces along the rays, centre surface, status, pitch and parameters
    maps: Mapping[str, Measured]  #: the properties that were named with ``after``

    @property
    def params(self) -> Common:
        """Options of the measurement; ``params.of(Options)`` are those of one property."""
        return self.frame.params

    @property
    def valid(self) -> Bools:
        """Rays that meet both faces."""
        return self.frame.status == 0

    def mean(self, values: Floats) -> float:
        """Mean over the valid rays."""
        is_measured = self.valid & np.isfinite(values)
        return float(np.mean(values[is_measured], dtype=np.float64))


def cached(function: Callable[Concatenate[Rays, P], T]) -> Callable[Concatenate[Rays, P], T]:
    """Work out once for the same rays what several properties share."""

    def cached_function(rays: Rays, /, *args: P.args, **kwargs: P.kwargs) -> T:
        key = repr((function.__name__, args, kwargs))
        return rays.cached(key, lambda: function(rays, *args, **kwargs))

    return cached_function


# Functions of a property are given all options of the measurement, and name the model of their own.
Length = float | Callable[[Any], float]
After = Texts | Callable[..., Texts]
Check = Callable[..., object]
When = Callable[[Any, Greys], bool] | Callable[[Any, Greys, Side], bool]
Answer = Callable[..., "Floats | Measured"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Property:
    """One property; made by :func:`ray_property` and :func:`sheet_property`."""

    name: str
    units: str
    long_name: str
    kind: Literal["rays", "sheet"]
    function: Answer  #: of :class:`~planish.measure.rays.Rays`, or of :class:`Sheet`
    halo_um: Length = 0.0  #: rows beyond a tile that a ray's answer depends on, as a length
    #: width of what one value speaks for; at least one ray, with what the blur adds.
    support_um: Length = 0.0
    reasons: Texts = ()  #: the property's own reasons for a missing value
    #: properties that this is made from, or a function from parameters and grey levels to them.
    after: After = ()
    #: Of parameters and grey levels; CannotMeasure, before anything is read, where a number is
    #: missing.
    check: Check | None = None
    #: Of parameters and grey levels: whether it is measured without being named, as its numbers
    #: are given.
    when: Callable[..., bool] | None = None
    together: Texts = ()  #: properties that are measured with it where it is named
    attrs: dict[str, float] = field(default_factory=dict[str, float])  #: further ones of its map
    stated: Texts = ()  #: options that its map states where they are given
    #: Whether 0 means none of it, as of lengths and masses: what has a coefficient of variation.
    #: Heights about a form, differences, angles and parts of a direction have no such zero.
    has_true_zero: bool = True

    @property
    def origin(self) -> tuple[str, str]:
        """Module of its function, and the name there."""
        return self.function.__module__, self.function.__qualname__


_REGISTERED: dict[str, Property] = {}


def _registers(kind: Literal["rays", "sheet"]):
    def register(
        name: str,
        *,
        units: str,
        long_name: str,
        support_um: Length = 0.0,
        check: Check | None = None,
        when: When | None = None,
        halo_um: Length = 0.0,
        **more: Any,
    ) -> Callable[[Answer], Property]:
        """Register a function of rays or maps, explained by :class:`Property`.

        CannotMeasure if the name is taken.
        """
        return lambda function: _add(
            Property(
                name=name,
                units=units,
                long_name=long_name,
                kind=kind,
                function=function,
                support_um=support_um,
                check=check,
                when=when,
                halo_um=halo_um,
                **more,
            )
        )

    return register


ray_property = _registers("rays")
sheet_property = _registers("sheet")


def _add(added: Property) -> Property:
    """Register a property, or those of both sides where its name has ``{side}`` in it.

    Returns it, or that of the bottom side. CannotMeasure if its name is none or is taken.
    """
    if "{side}" in added.name:
        return [_add(_of_side(added, side)) for side in SIDES][-1]
    if not added.name.isidentifier():
        raise CannotMeasure(
            f"'{added.name}' is no name of a property: use letters, digits and underscores."
        )
    has_axes(added.name, added.attrs.get("period_deg"))  # which refuses other periods
    old = _REGISTERED.get(added.name)
    # The same function again is a module that was loaded twice, as in a notebook.
    if old is not None and old.origin != added.origin:
        raise CannotMeasure(
            f"There is a property '{added.name}' already ({old.long_name}), of the module"
            f" {old.origin[0]}; {added.origin[0]} gives it as well. Choose"
            " another name."
        )
    _REGISTERED[added.name] = added
    return added


def _of_side(template: Property, side: Side) -> Property:
    """Make the property of one side: its name in the texts, and the side given to functions."""
    formatted = {key: getattr(template, key).format(side=side) for key in ("name", "long_name")}
    bound_functions: Entries = {}
    for key in ("function", "after", "check", "when"):
        function = getattr(template, key)
        if callable(function):
            bound_functions[key] = update_wrapper(partial(function, side=side), function)
    return replace(template, **formatted, **bound_functions)


def registered() -> dict[str, Property]:
    """Return all properties by name, in the order of their registration."""
    import_module("planish.measure.params")  # registers planish's own
    return dict(_REGISTERED)


def property_names() -> list[str]:
    """Return the names of all properties; modules of other packages are not imported."""
    return sorted({*registered(), *(plugin.name for plugin in plugins("property"))})


def find_property(name: str | Property) -> Property:
    """Return a property by name, of another package where planish has none.

    CannotMeasure if there is none: the message lists those there are.
    """
    if isinstance(name, Property):
        return name
    if name not in _REGISTERED and (plugin := find_plugin("property", name)):
        plugin.load(Property)
    if name not in _REGISTERED:
        raise CannotMeasure(
            f"There is no property '{name}'. Choose from {', '.join(property_names())}."
            f"{renamed(name)} A package of your own can add one."
        )
    return _REGISTERED[name]


def has_true_zero(name: str) -> bool:
    """Whether a map has a coefficient of variation by its kind; nothing says so of others' maps."""
    prop = registered().get(name)
    return prop is not None and prop.has_true_zero


def check_maps(params: Common, *, labels: bool = False) -> None:
    """Refuse maps that no sheet can have with these parameters, before a volume is read.

    Parameters
    ----------
    params : MeasureParams
    labels : bool
        Whether the volume holds labels, in which there are no grey values.

    Raises
    ------
    CannotMeasure
        If a map is unknown, or needs a number that is not given whether the sheet is coated or not.
    InputError
        If a map of labels needs grey values.
    """
    coated, uncoated = _coated_and_uncoated()
    for name in params.maps:
        if labels and name not in OF_FACES:
            raise InputError(
                f"`property={name}`: measured in grey values; a volume of labels has none. Leave it"
                " out."
            )
        try:
            in_order([name], params, coated)
        except CannotMeasure as fault:
            try:
                in_order([name], params, uncoated)
            except CannotMeasure:
                raise fault from None


def possible_maps(params: Common) -> list[str]:
    """Return the names of the maps that a sheet may have with these parameters.

    Which sides are coated is not known yet.
    """
    further_names = [name for greys in _coated_and_uncoated() for name in chosen(params, greys)]
    return list(dict.fromkeys([*PROPERTIES, *further_names]))


def _coated_and_uncoated() -> tuple[Greys, Greys]:
    uncoated = Greys(
        air=0.0,
        base=1.0,
        coating_top=np.nan,
        coating_bottom=np.nan,
        noise=0.01,
        polarity=1.0,
        blur_um=1.0,
        padding=np.nan,
    )
    return replace(uncoated, coating_top=2.0, coating_bottom=2.0), uncoated


def chosen(params: Common, greys: Greys) -> list[str]:
    """Return the names of the maps to measure.

    Those that cost nothing, those whose numbers are given, and those asked for.
    """
    names = [
        prop.name
        for prop in registered().values()
        if prop.when is not None and prop.when(params, greys)
    ]
    names += params.maps
    names += [companion for name in params.maps for companion in find_property(name).together]
    return list(dict.fromkeys(names))


def in_order(names: Sequence[str | Property], params: Common, greys: Greys) -> list[Property]:
    """Return the properties and all that they are made from, each after what it needs.

    ``params`` and ``greys`` decide what some of them are made from.

    Raises
    ------
    CannotMeasure
        If one is unknown, made from itself, or needs a number that is not given.
    """
    ordered: dict[str, Property] = {}

    def visit(prop: Property, ancestors: Texts) -> None:
        """Put a property behind those that it is made from; ``ancestors`` are made from it."""
        if prop.name in ancestors:
            path_text = " > ".join((*ancestors, prop.name))
            raise CannotMeasure(f"The property '{prop.name}' is made from itself: {path_text}.")
        needed_names = prop.after(params, greys) if callable(prop.after) else prop.after
        for needed_name in needed_names:
            visit(find_property(needed_name), (*ancestors, prop.name))
        ordered.setdefault(prop.name, prop)

    for name in names:
        visit(find_property(name), ())
    for prop in ordered.values():
        if prop.check is not None:
            prop.check(params, greys)
    return list(ordered.values())


def length_of(length: Length, params: Common) -> float:
    """Value in um of a length that may depend on the parameters."""
    return length(params) if callable(length) else length
