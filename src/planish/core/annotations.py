"""The types, and the models, that the annotation of a field allows."""

from collections.abc import Iterable, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel


def kinds_of(annotation: Any) -> list[Any]:
    """The types that an annotation allows, without None and without the limits."""
    if get_origin(annotation) is Annotated:
        return kinds_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for alternative in get_args(annotation) for kind in kinds_of(alternative)]
    if annotation is type(None):
        return []
    return [annotation]


def words_in(kinds: Iterable[Any]) -> list[str]:
    """The words that some types allow."""
    return [str(word) for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]


def models_in(annotation: Any) -> Sequence[type[BaseModel]]:
    """Models that a field may hold, as they are, optional, or several of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    arguments = ()
    if get_origin(annotation) in (Union, UnionType, Annotated, tuple, list):
        arguments = get_args(annotation)
    return [model for argument in arguments for model in models_in(argument)]
