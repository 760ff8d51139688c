"""Options, each of which is one field of a parameter model.

The field makes the study file, the command line and the Python default.

A stage keeps its options in its ``params.py``::

    class SurfaceParams(Params):
        cutoff_um: float = option(
            400.0, gt=0, help="Wavelength of the centre surface that its smoothing halves."
        )

The study is put together of these models, ``planish.cli`` makes click options of the same fields,
and functions take the model as ``params``. A field that no command shows has ``cli=None``.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from planish.core.annotations import models_in
from planish.core.errors import StudyError
from planish.core.parameter_words import flag_of


class Params(BaseModel):
    """Frozen options of one stage; unknown names are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


P = TypeVar("P", bound=Params)


def _in_tuple(value: Any) -> Any:
    if isinstance(value, str):
        return (value,)
    return value


Names = Annotated[tuple[str, ...], BeforeValidator(_in_tuple)]
"""Several names; one may stand without brackets."""


def params_of(model: type[P], options: P | Mapping[str, Any] | None, call_name: str = "") -> P:
    """Options of a function.

    Its model, or a dict with some of its fields, or the words of the command line for them.

    StudyError if it is something else, or has fields that are unknown or out of range; all faults
    are named.
    """
    if options is None or isinstance(options, model):
        return options or model()
    if not isinstance(options, Mapping):
        raise StudyError(
            f"{call_name} takes options as {model.__name__} or as a dict, and {options!r} was"
            f" given. Its options are {', '.join(model.model_fields)}."
        )
    from planish.core.parameter_faults import fault_texts

    paths_by_word = words_in(model)
    tables = dict[str, Any]()
    put_options(tables, paths_by_word, options)
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        faults_text = "; ".join(fault_texts(error, model, as_words(paths_by_word)))
        prefix = f"{call_name}: " if call_name else ""
        suffix = "" if faults_text.endswith("?") else "."
        raise StudyError(f"{prefix}{faults_text}{suffix}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Appearance of a field on the command line.

    ``flags`` such as ``("--cutoff-um",)``; ``metavar``, the placeholder of the value, where the
    type does not say it; ``repeat``, whether one number stands for all of a tuple.
    """

    flags: tuple[str, ...]
    metavar: str | None = None
    repeat: bool = False


def option(
    default: Any = ...,
    *,
    help: str,
    cli: str | None = "",
    metavar: str | None = None,
    repeat: bool = False,
    **limits: Any,
) -> Any:
    """Make a field of a :class:`Params` model; without a default it is required.

    ``help`` is one sentence: what it is, with its unit and when it is needed. ``cli`` is the flag
    of the command line, such as ``"--property"``: made of the field's name where empty, none where
    None; ``metavar`` and ``repeat`` as in :class:`Shown`. ``limits`` are ``gt``, ``ge``, ``lt``,
    ``le``, ``min_length`` ..., as for :func:`pydantic.Field`.
    """
    extra: Any = None
    if cli is not None:
        extra = {"planish": {"flags": cli, "metavar": metavar, "repeat": repeat}}
    return Field(default, description=help, json_schema_extra=extra, **limits)


def options_of(model: type[Params]) -> Iterator[tuple[str, FieldInfo, Shown]]:
    """Give name, field and appearance of every field of a model that the command line shows."""
    for name, field in model.model_fields.items():
        extra: Any = field.json_schema_extra
        if extra is not None:
            flag = extra["planish"]["flags"] or flag_of(name)
            yield name, field, Shown(**extra["planish"] | {"flags": (flag,)})


Paths = dict[str, tuple[str, ...]]  # by the word of an option: the names of the fields to it


def words_in(model: type[Params], *outer_names: str) -> Paths:
    """Words of a call for the options of a model, and where each stands in it.

    The word is ``label_air`` for ``--label-air``.
    """
    paths_by_word: Paths = {}
    for name, field, appearance in options_of(model):
        paths_by_word[appearance.flags[0][2:].replace("-", "_")] = (*outer_names, name)
        for inner_model in models_in(field.annotation):
            if issubclass(inner_model, Params):
                paths_by_word |= words_in(inner_model, *outer_names, name)
    return paths_by_word


def as_words(paths_by_word: Paths) -> Callable[[tuple[str | int, ...]], tuple[Any, None]]:
    """Name the places of mistakes by the words of a call; as they are where none has them.

    What is returned takes the keys from the model to a value, and gives the name as a key of one
    part, with no line: there is no file.
    """
    words = {path: f"`{word}`" for word, path in paths_by_word.items()}

    def word_at(loc: tuple[str | int, ...]) -> tuple[Any, None]:
        names = tuple(name for name in loc if isinstance(name, str) and name != "layers")
        if names in words:
            return (words[names],), None
        # A message about a whole table is one of options that do not fit together, which it names.
        return (() if any(path[: len(names)] == names for path in words) else names), None

    return word_at


def put_options(
    tables: dict[str, Any], paths_by_word: Paths, options: Mapping[str, Any]
) -> list[str]:
    """Put options into the tables of a model where their words stand, others as they are.

    ``tables`` is changed; ``paths_by_word`` as of :func:`words_in`, ``options`` are values by word.
    Give the words of those given twice.
    """
    duplicates: list[str] = []
    for word, value in options.items():
        *outer_names, name = paths_by_word.get(word, (word,))
        table = tables
        for outer_name in outer_names:
            table = table.setdefault(outer_name, {})
        path_to_table = (*outer_names, name)
        has_options = any(path[:-1] == path_to_table for path in paths_by_word.values())
        if value is True and has_options:
            table.setdefault(name, {})  # options of their own, which this word switches on
        elif table.get(name) is not None:
            duplicates.append(word)
        else:
            table[name] = value
    return duplicates


def option_names(model: type[Params], *names: str) -> str:
    """Name fields for a message.

    By the word of a call, or as keys of a study file where a call has none.
    """
    words = {path[0]: f"`{word}`" for word, path in words_in(model).items()}
    return " or ".join(words.get(name, f"{name} in a study file") for name in names)


_UNITS = {"_um": "um", "_deg": "deg", "_g_cm3": "g/cm3", "_g_m2": "g/m2", "_s": "s"}


def unit_of(name: str) -> str | None:
    """Unit of a field by the end of its name; None where it has none."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
