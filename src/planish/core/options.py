"""Options: each is one field of a parameter model and makes the study file, the command line and the Python default.

A stage keeps its options in its ``params.py``::

    class SurfaceParams(Params):
        cutoff_um: float = option(400.0, gt=0, help="Wavelength of the centre surface that its smoothing halves.")

The study is put together of these models, ``planish.cli`` makes click options of the same fields, and functions take
the model as ``params``. A field that no command shows has ``cli=None``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from planish.core.errors import InputError


class Params(BaseModel):
    """Frozen options of one stage; unknown names are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


P = TypeVar("P", bound=Params)


def params_of(model: type[P], options: P | Mapping[str, Any] | None, call: str) -> P:
    """Options of a function: its model, or a dict with some of its fields, or the words of the command line for them.

    Raises
    ------
    InputError
        If it is something else, or has fields that are unknown or out of range; all faults are named.
    """
    if options is None or isinstance(options, model):
        return options or model()
    if not isinstance(options, Mapping):
        raise InputError(
            f"{call} takes options as {model.__name__} or as a dict, and {options!r} was given. Its options are "
            f"{', '.join(model.model_fields)}."
        )
    from planish.core.mistakes import mistakes

    try:
        return model.model_validate(by_field(model, options))
    except ValidationError as error:
        flags = {name: shown.flags[0] for name, _, shown in options_of(model)}
        faults = "; ".join(
            mistakes(error, model, lambda loc: ((flags.get(str(loc[0]), loc[0]), *loc[1:]) if loc else (), None))
        )
        raise InputError(f"{call}: {faults.removesuffix('?')}{'?' if faults.endswith('?') else '.'}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Appearance of a field on the command line.

    ``flags`` such as ``("--cutoff-um",)``; ``metavar``, the placeholder of the value, where the type does not say it;
    ``repeat``, whether one number stands for all of a tuple.
    """

    flags: tuple[str, ...]
    metavar: str | None = None
    repeat: bool = False


_FROM_NAME = "from the name"


def option(
    default: Any = ..., *, help: str, cli: str | None = _FROM_NAME, metavar: str | None = None, repeat: bool = False,
    **limits: Any,
) -> Any:  # fmt: skip
    """Make a field of a :class:`Params` model.

    Parameters
    ----------
    default : value
        Where the field is not given; without one the field is required.
    help : str
        One sentence: what it is, with its unit and when it is needed.
    cli : str or None
        Flags of the command line, ``"--property"`` or ``"--out -o"``; made of the field's name where not given, none
        where None.
    metavar, repeat
        As in :class:`Shown`.
    **limits
        ``gt``, ``ge``, ``lt``, ``le``, ``min_length`` ..., as for :func:`pydantic.Field`.
    """
    extra: dict[str, Any] = {"cli": cli, "metavar": metavar, "repeat": repeat}
    return Field(default, description=help, json_schema_extra={"planish": extra}, **limits)


def options_of(model: type[Params]) -> Iterator[tuple[str, FieldInfo, Shown]]:
    """Give name, field and appearance of every field of a model that the command line shows."""
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        noted: Any = extra.get("planish") if isinstance(extra, dict) else None
        if noted is None or noted["cli"] is None:
            continue
        flags = f"--{name.replace('_', '-')}" if noted["cli"] == _FROM_NAME else str(noted["cli"])
        yield name, field, Shown(flags=tuple(flags.split()), metavar=noted["metavar"], repeat=noted["repeat"])


def by_field(model: type[Params], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options by the names of their fields, where the command line has another word: ``maps`` for ``property``."""
    words = {flag[2:].replace("-", "_"): name for name, _, shown in options_of(model) for flag in shown.flags}
    return {words.get(word, word): value for word, value in options.items()}


def option_names(model: type[Params], *names: str) -> str:
    """Name fields for a message: by their flag, or as keys of a study file where the command line has none."""
    flags = {name: shown.flags[0] for name, _, shown in options_of(model)}
    return " or ".join(flags.get(name, f"{name} in a study file") for name in names)


_UNITS = {"_um": "um", "_deg": "deg", "_g_cm3": "g/cm3", "_g_m2": "g/m2", "_s": "s"}


def unit_of(name: str) -> str | None:
    """Unit of a field by the end of its name; None where it has none."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)


def kinds_of(annotation: Any) -> list[Any]:
    """The types that an annotation allows, without None and without the limits."""
    if get_origin(annotation) is Annotated:
        return kinds_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [part for inner in get_args(annotation) for part in kinds_of(inner)]
    return [] if annotation is type(None) else [annotation]
