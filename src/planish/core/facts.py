"""What results are made of.

Frozen models that the functions of the stages return and that go into files as they are.

A number that is missing is NaN in memory and null in JSON (``Value``, ``Interval``), as JSON knows
neither NaN nor infinity. Parts of the results that no stage computes with say None in memory, too
(``Number``, ``KnownPair``).
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Iterable
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    WithJsonSchema,
)
from pydantic.json_schema import JsonSchemaValue, SkipJsonSchema
from pydantic_core import CoreSchema

from planish.core.typing import Pair, Shape


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _all_finite(values: Any) -> Any:
    if values is None or not all(map(math.isfinite, values)):
        return None
    return tuple(map(float, values))


Number = Annotated[float | None, BeforeValidator(_finite)]
KnownPair = Annotated[Pair | None, BeforeValidator(_all_finite)]


def is_known(value: float | Pair | None) -> bool:
    """Whether a number is given and finite, or both ends of an interval are."""
    if value is None:
        return False
    return all(map(math.isfinite, value if isinstance(value, tuple) else (value,)))


def _one_nan(value: Any) -> Any:
    # Always the same NaN, so that models with equal numbers are equal.
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return math.nan
    return value


def _nan_pair(values: Iterable[float | None] | None) -> Any:
    if values is None:
        return math.nan, math.nan
    return tuple(map(_one_nan, values))


def _null(value: Any) -> Any:
    return value if is_known(value) else None


_NULL = {"type": "null"}
_PAIR = {
    "type": "array",
    "maxItems": 2,
    "minItems": 2,
    "prefixItems": [{"type": "number"}, {"type": "number"}],
}
# A number that may be missing: NaN in memory; null in JSON, as is one that is infinite.
Value = Annotated[
    float,
    BeforeValidator(_one_nan),
    PlainSerializer(_null),
    WithJsonSchema({"anyOf": [{"type": "number"}, _NULL]}),
]
# Two numbers, such as the ends of an interval, that may be missing: null in JSON unless both are
# finite.
Interval = Annotated[
    Pair,
    BeforeValidator(_nan_pair),
    PlainSerializer(_null),
    WithJsonSchema({"anyOf": [_PAIR, _NULL]}),
]
# A number, or an interval, that stands beside a result in memory and in no file.
Unsaved = Annotated[SkipJsonSchema[Value], Field(exclude=True)]
UnsavedInterval = Annotated[SkipJsonSchema[Interval], Field(exclude=True)]
NULL: Any = None  # default of a value or interval: null in JSON and its schema, NaN in memory


def optional(description: str) -> Any:
    """Make a field of a model that may be missing: null in JSON and its schema."""
    return Field(default=None, description=description)


Side = Literal["top", "bottom"]
"""Side of a sheet."""

SIDES: tuple[Side, ...] = ("top", "bottom")
# What the checks leave of a figure; numbers that are withheld are None.
Trust = Literal["ok", "doubtful", "withheld"]


class ResultModel(BaseModel):
    """A frozen part of the results."""

    model_config = ConfigDict(
        arbitrary_types_allowed=True,
        extra="forbid",
        frozen=True,
        protected_namespaces=(),
        validate_default=True,
    )

    @classmethod
    def holding(cls, *models: ResultModel, **fields: Any) -> Self:
        """Make a model of those that it extends and of what they lack.

        What those do not save is left out.
        """
        saved_fields = {
            k: v for model in models for k, v in model if not type(model).model_fields[k].exclude
        }
        return cls(**saved_fields | fields)


class DescribedModel(ResultModel):
    """A part of the results whose fields are described by the texts below them."""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Put the descriptions into the schema; the sources are read for that alone."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in cls.descriptions().items():
            if name in properties:
                properties[name]["description"] = text
        return schema

    @classmethod
    def descriptions(cls) -> dict[str, str]:
        """Give the text below each field; the sources are read for it."""
        texts: dict[str, str] = {}
        for model in reversed(cls.__mro__):
            if issubclass(model, DescribedModel):
                texts |= _texts_below_fields(model)
        return texts


@cache
def _texts_below_fields(model: type) -> dict[str, str]:
    """Description of each field of a class that has one, in its own source."""
    (definition,) = ast.parse(inspect.getsource(model)).body
    statements = definition.body if isinstance(definition, ast.ClassDef) else []
    texts: dict[str, str] = {}
    for field, below in pairwise(statements):
        if not (isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr)):
            continue
        if isinstance(below.value, ast.Constant):
            words = str(below.value.value).split()  # a text of several lines is one sentence
            texts[ast.unparse(field.target)] = " ".join(words)
    return texts


class InputFile(DescribedModel):
    """A file that was read, and the hash that tells it from every other."""

    name: str
    """Name of the file or folder."""
    shape: Shape
    """Values along each axis: (z, y, x) or (y, x)."""
    dtype: str
    """Type of the values as stored."""
    bytes: int
    """Size of the file or of all files."""
    sha256: str
    """Hash of the bytes, which tells this input from every other."""
    size_um: tuple[float, ...]
    """Voxel size (z, y, x) or pixel size (y, x)."""
    size_source: str
    """Where the size was taken from, such as a log or an option."""
    size_doubt: str = ""
    """A sentence where the size may be nobody's measurement."""


class ThinFacts(DescribedModel):
    """Shares of a coating that are thinner than some limits."""

    thinner_than_um: tuple[float, ...]
    """Limits of the thickness."""
    share: tuple[Number, ...] = Field(
        description=(
            "Share of the area that is thinner, for each limit; at 0 the uncovered area ratio: the"
            " share of the area without any coating."
        )
    )
    standard_error: tuple[Number, ...] = ()
    """Standard error of each share, of the sheet by this field."""
    support_um: float
    """Size of the region that one value of the thickness stands for."""
    warning: str | None
    """Set where the noise alone makes columns thin."""

    @property
    def uncovered_area_ratio(self) -> tuple[float | None, float | None]:
        """Share of the area without any coating, with its standard error; None where not stated."""
        share_by_um = dict(zip(self.thinner_than_um, self.share, strict=True))
        error_by_um = dict(zip(self.thinner_than_um, self.standard_error, strict=False))
        return share_by_um.get(0.0), error_by_um.get(0.0) or None


class RoughnessFacts(DescribedModel):
    """Areal roughness numbers (ISO 25178-2) of one face, or the reason why there are none."""

    sa: Number = None
    """Mean absolute height, um."""
    sq: Number = None
    """Root mean square height, um."""
    ssk: Number = None
    """Skewness of the heights."""
    sku: Number = None
    """Kurtosis of the heights."""
    sz: Number = None
    """Highest less lowest height, um; grows with the field."""
    sdq: Number = None
    """Root mean square slope."""
    n: int | None = None
    """Columns with a height."""
    s_filter_um: Number = None
    """Shorter waves were left out."""
    l_filter_um: Number = None
    """Longer waves were left out."""
    reason: str | None = None
    """Why there are no numbers; None where there are."""


class TwoSidesFacts(DescribedModel):
    """Top against bottom."""

    coating_difference_um: Number = None
    """Mean coating of the top less that of the bottom."""
    coating_sd_ratio: Number = None
    """Standard deviation of the top's coating over that of the bottom's."""
    coating_correlation: Number = None
    """r of both coatings."""
    coating_n: int | None = None
    """Columns with both coatings."""
    half_thickness_difference_um: Number = None
    """Mean height above the centre surface, top less bottom."""
    half_thickness_sd_ratio: Number = None
    """Standard deviation of the top's over the bottom's."""
    half_thickness_correlation: Number = None
    """r of both, outward heights."""
    half_thickness_n: int | None = None
    """Columns with both."""
    topography_difference_um: Number = None
    """Mean topography of the top less that of the bottom: each is about its own form."""
    topography_sd_ratio: Number = None
    """Standard deviation of the top's topography over that of the bottom's."""
    topography_correlation: Number = None
    """r of both topographies, outward heights."""
    topography_n: int | None = None
    """Columns with both topographies."""


class ProfileFacts(DescribedModel):
    """Mean of some properties over the depth of the base.

    The depth is 0 at the bottom interface and 1 at the top one.
    """

    depth: tuple[float, ...]
    """Middle of each layer of the base."""
    values: dict[str, tuple[Number, ...]]
    """Mean of each property in each layer."""


class SheetNumbers(DescribedModel):
    """What describes a sheet and is no map; keyed by side."""

    thin: dict[Side, ThinFacts]
    """Thin and uncovered shares of the coating, by side."""
    roughness: dict[Side, RoughnessFacts] = {}
    """Roughness of the face, by side."""
    roughness_about_centre: dict[Side, RoughnessFacts] = {}
    """Of heights above the centre surface, as runs up to format 3 have it."""
    form_um: Number = optional(
        "Nesting index of the form, a Gaussian regression of second order, above which topographies"
        " and surfaces of the base lie."
    )
    two_sides: TwoSidesFacts
    """Top against bottom."""
    profiles: ProfileFacts | None = None
    """Porosity and filler over the depth, where their maps were measured."""


class HoleTiltFacts(DescribedModel):
    """What the holes of a sheet look like through its thickness."""

    through: int
    """Holes that are seen on both sides."""
    closed: int
    """Holes that are closed on the other side."""
    unclear: int
    """Holes whose other side is open but not round, or not known."""
    other_side_only: int
    """Holes that are seen on the other side only."""
    offset_count: int
    """Holes that the offset rests on."""
    offset_um: tuple[Number, Number]
    """Median offset from the top's rims to the bottom's, along x and y."""
    offset_spread_um: tuple[Number, Number]
    """Robust standard deviation of it from hole to hole."""
    offset_error_um: tuple[Number, Number]
    """Standard error of the median."""
    to_face_um: Pair = (0.0, 0.0)
    """What was added to the places in the layer to have them at the face."""
    tilt_deg: tuple[Number, Number] | None = None
    """The same offset as an angle, along x and y."""
    side: Side
    """Side whose rims were used."""
    sentence: str
    """The same in words."""
