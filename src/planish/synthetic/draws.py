"""Streams of random numbers by name, ranges of parameters, and specimens whose parameters are drawn from them."""

from __future__ import annotations

from dataclasses import field, fields, is_dataclass, replace
from typing import Any, ClassVar
from zlib import crc32

import numpy as np


def stream(seed: int, *names: str) -> np.random.SeedSequence:
    """Random numbers of their own for every name: a nuisance that is switched off does not change the others."""
    return np.random.SeedSequence(seed, spawn_key=tuple(crc32(name.encode()) for name in names))


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of a :func:`stream`."""
    return np.random.default_rng(stream(seed, *names))


class Strict:
    """A table in a scenario file with a key that is no field is refused."""

    __slots__ = ()
    __pydantic_config__: ClassVar = {"extra": "forbid"}


def drawn(default: Any, low: float = 0.0, high: float = 0.0, *, of: tuple[Any, ...] = ()) -> Any:
    """Make a dataclass field with a range: evenly between two numbers (whole ones where both are), or one ``of``."""
    return field(default=default, metadata={"range": of or (low, high), "choice": bool(of)})


def draw_params(params: Any) -> Any:
    """Draw every field with a range by the seed of ``params``; all others stay."""
    return _draw(params, generator(params.seed, "draws"))


def _draw(params: Any, rng: np.random.Generator) -> Any:
    changes: dict[str, Any] = {}
    for parameter in fields(params):
        if is_dataclass(getattr(params, parameter.name)):
            changes[parameter.name] = _draw(getattr(params, parameter.name), rng)
        elif "range" in parameter.metadata:
            limits = parameter.metadata["range"]
            if parameter.metadata["choice"]:
                changes[parameter.name] = limits[int(rng.integers(len(limits)))]
            elif all(isinstance(limit, int) for limit in limits):
                changes[parameter.name] = int(rng.integers(limits[0], limits[1] + 1))
            else:
                changes[parameter.name] = float(rng.uniform(*limits))
    return replace(params, **changes)
