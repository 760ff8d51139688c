"""What results are made of: frozen models whose missing numbers are None, as JSON knows neither NaN nor infinity."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _all_finite(values: Any) -> Any:
    return None if values is None or not all(map(math.isfinite, values)) else tuple(map(float, values))


Number = Annotated[float | None, BeforeValidator(_finite)]
Pair = tuple[float, float]
KnownPair = Annotated[Pair | None, BeforeValidator(_all_finite)]
Side = Literal["top", "bottom"]
"""Side of a sheet."""

SIDES: tuple[Side, ...] = ("top", "bottom")

Trust = Literal["ok", "doubtful", "withheld"]
"""What the checks leave of a figure; numbers that are withheld are None."""


class Facts(BaseModel):
    """A frozen part of the results."""

    model_config = ConfigDict(extra="forbid", frozen=True, from_attributes=True, protected_namespaces=())

    @classmethod
    def of(cls, *sources: object, **own: Any) -> Self:
        """Take what is not given from objects of stages, the first that has an attribute of the field's name."""
        found = {k: getattr(s, k) for s in reversed(sources) for k in cls.model_fields if hasattr(s, k)}
        return cls.model_validate(found | own)
