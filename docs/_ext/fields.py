"""Tables of the study file and of results.json, from the models that read and write them."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from planish.core.checks import Check
from planish.core.facts import DescribedModel
from planish.core.options import options_of
from planish.results import Results
from planish.run.study import GivenLayer, Study

_WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false"}
_PYTHON_NULL = re.compile(r"\b(None|null)\b")  # not in `null_95`
_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


# --- the study file -------------------------------------------------------------------------------


def study_page() -> str:
    """Return a table for each section of a study file."""
    layers = [("[[layers]]", GivenLayer)]
    sections: list[tuple[str, type[BaseModel]]] = [("the top level", Study), *layers]
    for name, model in sections_of(GivenLayer):
        sections.append((f"[layers.{name}]", model))
        sections += [(f"[layers.{name}.{inner}]", found) for inner, found in sections_of(model)]
    sections += [(f"[{name}]", model) for name, model in sections_of(Study)]
    return "\n\n".join(f"## {_heading(title)}\n\n{study_table(model)}" for title, model in sections)


def study_table(model: type[BaseModel]) -> str:
    """Return key, type, default, command-line option and meaning of every value of a section."""
    flags = {
        name: " ".join(f"`{flag}`" for flag in shown.flags) for name, _, shown in options_of(model)
    }
    rows = ["| Key | Type | Default | Command line | Meaning |", "|---|---|---|---|---|"]
    for name, field in model.model_fields.items():
        if any(True for _ in models_of(field.annotation)) and not field.description:
            continue  # a section with a heading of its own
        default = "needed" if field.is_required() else _toml(field.get_default())
        kind = type_words(field.annotation) + _limits(field)
        rows.append(
            f"| `{name}` | {kind} | {default} | {flags.get(name, '')} |"
            f" {_cell(field.description)} |"
        )
    return "\n".join(rows)


def _heading(title: str) -> str:
    return f"`{title}`" if title.startswith("[") else title[0].upper() + title[1:]


def sections_of(model: type[BaseModel]) -> Iterator[tuple[str, type[BaseModel]]]:
    """Give name and model of the tables that stand within a section of a study file."""
    for name, field in model.model_fields.items():
        if get_origin(field.annotation) is not tuple:
            yield from ((name, found) for found in models_of(field.annotation))


def _toml(value: Any) -> str:
    if value is None or value == ():
        return ""
    if isinstance(value, tuple):
        return f"`[{', '.join(str(v) for v in value)}]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _limits(field: FieldInfo) -> str:
    words = [
        f"{sign} {value:g}"
        for rule in field.metadata
        for key, sign in _SIGNS.items()
        if (value := getattr(rule, key, None)) is not None and math.isfinite(value)
    ]
    return f" {', '.join(words)}" if words else ""


# --- results.json ---------------------------------------------------------------------------------


def results_page() -> str:
    """Return a table for each part of the results, with the places where it stands."""
    places: dict[type[BaseModel], list[str]] = {}
    _collect(Results, "", places)
    parts = []
    for model, found in places.items():
        where = "The whole file" if model is Results else ", ".join(f"`{place}`" for place in found)
        parts.append(
            f"(results-{model.__name__.lower()})=\n##"
            f" {where}\n\n{inspect.getdoc(model)}\n\n{results_table(model)}"
        )
    return "\n\n".join(parts)


def results_table(model: type[BaseModel]) -> str:
    """Return key, type and meaning of every value of a part of the results."""
    rows = ["| Key | Type | Meaning |", "|---|---|---|"]
    for name, field in model.model_fields.items():
        meaning = _PYTHON_NULL.sub("`null`", _cell(description_of(model, name)))
        rows.append(f"| `{name}` | {type_words(field.annotation, linked=True)} | {meaning} |")
    return "\n".join(rows)


def description_of(model: type[BaseModel], name: str) -> str | None:
    """What a field of the results is, by its own words or by the text below it."""
    own_words = model.model_fields[name].description
    if own_words is None and issubclass(model, DescribedModel):
        return model.descriptions().get(name)
    return own_words


def results_models() -> list[type[BaseModel]]:
    """Every model that the results are made of."""
    places: dict[type[BaseModel], list[str]] = {}
    _collect(Results, "", places)
    assert Check in places
    return list(places)


def _collect(model: type[BaseModel], place: str, places: dict[type[BaseModel], list[str]]) -> None:
    places.setdefault(model, []).append(place)
    for name, field in model.model_fields.items():
        for inner in models_of(field.annotation):
            many = _many(field.annotation)
            _collect(inner, f"{place}.{name}{many}".lstrip("."), places)


def _many(annotation: Any) -> str:
    origins = {get_origin(part) for part in _parts(annotation)}
    return "[]" if tuple in origins else ".*" if dict in origins else ""


# --- types in words -------------------------------------------------------------------------------


def type_words(annotation: Any, *, linked: bool = False) -> str:
    """Return a type in the words of a file.

    Number, text, list of ..., with ``linked`` a link to the part.
    """
    words = [_word(part, linked=linked) for part in _parts(annotation) if part is not type(None)]
    return " or ".join(dict.fromkeys(words))


def _word(kind: Any, *, linked: bool) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in inner)
    if origin is tuple:
        if len(inner) == 2 and inner[1] is ...:
            return f"list of {_plural(type_words(inner[0], linked=linked))}"
        return f"{len(inner)} {_plural(type_words(inner[0], linked=linked))}"
    if origin is dict:
        return f"by name: {type_words(inner[1], linked=linked)}"
    if inspect.isclass(kind) and issubclass(kind, BaseModel):
        return f"[table](#results-{kind.__name__.lower()})" if linked else "table"
    return _WORDS.get(kind, "any value")


def _plural(word: str) -> str:
    return (
        f"{word}s"
        if word in {"number", "whole number"}
        else "texts"
        if word == "text"
        else word.replace("[table]", "[tables]")
    )


def _parts(annotation: Any) -> list[Any]:
    """The types that an annotation allows, without their limits."""
    if get_origin(annotation) is Annotated:
        return _parts(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [part for inner in get_args(annotation) for part in _parts(inner)]
    return [annotation]


def models_of(annotation: Any) -> Iterator[type[BaseModel]]:
    """Give the models that an annotation is made of."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_of(inner)


def _cell(text: str | None) -> str:
    return (text or "").replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
