"""What results are made of: frozen models that the functions of the stages return and that go into files as they are.

A number that is missing is NaN in memory and null in JSON (``Value``, ``Interval``), as JSON knows neither NaN nor
infinity. Parts of the results that no stage computes with say None in memory, too (``Number``, ``KnownPair``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, WithJsonSchema
from pydantic.json_schema import SkipJsonSchema


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _all_finite(values: Any) -> Any:
    return None if values is None or not all(map(math.isfinite, values)) else tuple(map(float, values))


Number = Annotated[float | None, BeforeValidator(_finite)]
Pair = tuple[float, float]
KnownPair = Annotated[Pair | None, BeforeValidator(_all_finite)]


def is_known(value: float | Pair | None) -> bool:
    """Whether a number is given and finite, or both ends of an interval are."""
    return value is not None and all(map(math.isfinite, value if isinstance(value, tuple) else (value,)))


def _one_nan(value: Any) -> Any:
    # Always the same NaN, so that models with equal numbers are equal.
    return math.nan if value is None or (isinstance(value, float) and math.isnan(value)) else value


def _nan_pair(values: Iterable[float | None] | None) -> Any:
    return (math.nan, math.nan) if values is None else tuple(map(_one_nan, values))


def _null(value: Any) -> Any:
    return value if is_known(value) else None


_NULL = {"type": "null"}
_PAIR = {"type": "array", "maxItems": 2, "minItems": 2, "prefixItems": [{"type": "number"}, {"type": "number"}]}
Value = Annotated[
    float, BeforeValidator(_one_nan), PlainSerializer(_null), WithJsonSchema({"anyOf": [{"type": "number"}, _NULL]})
]
"""A number that may be missing: NaN in memory; null in JSON, as is one that is infinite."""
Interval = Annotated[
    Pair, BeforeValidator(_nan_pair), PlainSerializer(_null), WithJsonSchema({"anyOf": [_PAIR, _NULL]})
]
"""Two numbers, such as the ends of an interval, that may be missing: null in JSON unless both are finite."""
Unsaved = SkipJsonSchema[Value]
"""A number that stands beside a result in memory and, as a field with ``exclude=True``, in no file."""
NULL: Any = None
"""Default of a value or interval: null in JSON and its schema, NaN in memory."""

Side = Literal["top", "bottom"]
"""Side of a sheet."""

SIDES: tuple[Side, ...] = ("top", "bottom")

Trust = Literal["ok", "doubtful", "withheld"]
"""What the checks leave of a figure; numbers that are withheld are None."""


class Facts(BaseModel):
    """A frozen part of the results."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), validate_default=True)

    @classmethod
    def holding(cls, *parts: Facts, **more: Any) -> Self:
        """Make a model of those that it extends, without what they do not save, and of what they lack."""
        saved = {k: v for part in parts for k, v in part if not type(part).model_fields[k].exclude}
        return cls(**saved, **more)


class AtPoints(Facts):
    """What is stated at points of one size. Fields of a base that stands last come first in the file."""

    point_um: float = Field(description="Edge of a point.")


class OfLayer(Facts):
    """What is stated of one layer."""

    layer: str = Field(description="Name of the layer.")


class OfMap(OfLayer):
    """What is stated of one map of a layer."""

    map: str = Field(description="Name of the map.")
