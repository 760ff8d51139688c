"""Options of the command line, made of the parameter models; their groups in the help; how text becomes numbers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import click
from click.shell_completion import CompletionItem
from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from planish.core.errors import StudyError
from planish.core.options import (
    Params,
    Shown,
    flag_of,
    kinds_of,
    options_of,
    params_of,
    put_options,
    unit_of,
    words_in,
)

Command = Callable[..., Any]
P = TypeVar("P", bound=Params)
PATH = click.Path(path_type=Path)


class Verb(click.Command):
    """A command whose help shows its options in groups and ends with examples."""

    def __init__(self, *args: Any, examples: Sequence[str] = (), goes_on: bool = False, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.examples, self.goes_on = tuple(examples), goes_on

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the names of their groups."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                groups.setdefault(getattr(param, "group", "Options"), []).append(record)
        for name in sorted(groups, key=lambda name: name == "Options"):  # which come last
            with formatter.section(name):
                formatter.write_dl(groups[name])
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"  {line}\n")

    def invoke(self, ctx: click.Context) -> Any:
        """Call it, unless the results would lie in an input, or where something stands that it does not go on with."""
        from planish.io.run_folder import refuse_existing, refuse_inside

        if isinstance(out := ctx.params.get("out"), Path):
            inputs = [value for name, value in ctx.params.items() if name != "out" and isinstance(value, Path)]
            refuse_inside(out, inputs)
            if not self.goes_on:
                refuse_existing(out)
        return super().invoke(ctx)


class Option(click.Option):
    """An option that belongs to a group of the help."""

    def __init__(self, *args: Any, group: str = "Options", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.group = group


class Value(click.ParamType[Any]):
    """A value of a field's own type, checked by its limits.

    Several numbers are separated by commas; one stands for all of them where ``repeat`` is set, and the word none for
    no number where any count will do.
    """

    name = "value"

    def __init__(self, kind: Any, metavar: str | None = None, *, repeat: bool = False) -> None:
        self.adapter, self.repeat = TypeAdapter[Any](kind), repeat
        parts = kinds_of(kind)
        tuples = [get_args(part) for part in parts if get_origin(part) is tuple]
        self.count, self.any_count = len(tuples[0]) if tuples else 0, any(kinds[1:] == (...,) for kinds in tuples)
        self.words = [str(word) for part in parts if get_origin(part) is Literal for word in get_args(part)]
        number = ["N,..."] if tuples else ["NUMBER"] if float in parts else ["INTEGER"] if int in parts else []
        self.metavar = metavar or "|".join([*self.words, *number]) or "TEXT"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return self.metavar

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:  # noqa: ARG002
        """Words that begin with what was typed."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse ``"3"`` or ``"3,1.5,1.5"``."""
        if not isinstance(value, str):
            return value
        parts: Any = [part.strip() for part in value.split(",")] if self.count else value
        if self.any_count and value.strip().casefold() == "none":
            parts = []
        if self.repeat and len(parts) == 1:
            parts = parts * self.count
        try:
            return self.adapter.validate_python(parts)
        except ValidationError as error:
            reasons = "; ".join(dict.fromkeys(e["msg"].removeprefix("Value error, ") for e in error.errors()))
            self.fail(f"{value!r} is not {self.metavar}: {reasons}.", param, ctx)


def options(model: type[Params], group: str, *, only: Sequence[str] = (), without: Sequence[str] = ()) -> Command:
    """Give a command all options of a model, or some; :func:`build_params` makes the model of their values.

    ``group`` is the heading in the help; ``only`` and ``without`` are names of fields.
    """
    decorators: list[Command] = []
    for name, field, shown in options_of(model):
        if name not in without and (not only or name in only):
            decorators.append(_option(name, field, shown, group))
            if _is_model(inner := kinds_of(field.annotation)[0]):
                decorators.append(options(inner, group))
    return stack(*decorators)


def _is_model(kind: Any) -> bool:
    """Tell whether a field is a model inside a model, which its own flag switches on."""
    return isinstance(kind, type) and issubclass(kind, Params)


def _or_none(_context: Any, _option: Any, values: tuple[str, ...]) -> tuple[str, ...] | None:
    return values or None  # not given is other than an empty choice


def _option(name: str, field: FieldInfo, shown: Shown, group: str) -> Command:
    kinds = kinds_of(field.annotation)
    how: dict[str, Any] = {"help": field.description, "cls": Option, "group": group, "required": field.is_required()}
    if kinds == [bool] or _is_model(kinds[0]):
        return click.option(*shown.flags, is_flag=True, default=None, **how)
    default = field.get_default()
    if default not in (None, (), ...) and default is not PydanticUndefined:
        values: tuple[Any, ...] = default if isinstance(default, tuple) else (default,)
        texts = (f"{value:.7g}" if isinstance(value, float) else str(value) for value in values)
        how["help"] += f"  [default: {','.join(texts)}]"
    if kinds == [tuple[str, ...]]:
        how["callback"] = _or_none
        return click.option(*shown.flags, multiple=True, metavar=shown.metavar, **how)
    if len(kinds) == 1 and get_origin(kinds[0]) is Literal:
        return click.option(*shown.flags, type=click.Choice([str(v) for v in get_args(kinds[0])]), **how)
    unit = (unit_of(name) or "").upper() or None if kinds == [float] else None
    kind = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation  # pyright: ignore
    return click.option(*shown.flags, type=Value(kind, shown.metavar or unit, repeat=shown.repeat), **how)


def given_options(values: Mapping[str, Any], places: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Collect the options that the command line gives, of those with a place, in the tables where they stand."""
    words = {word: value for word in places if (value := values.get(word)) is not None and value is not False}
    for word in words:
        switch = next((outer for outer, place in places.items() if place == places[word][:-1]), word)
        if switch not in words:
            option, needed = flag_of(word), flag_of(switch)
            raise click.UsageError(f"{option} is an option of {needed}: give {needed} as well.")
    tables: dict[str, Any] = {}
    put_options(tables, places, words)
    return tables


def build_params(model: type[P], values: Mapping[str, Any], **more: Any) -> P:
    """Build a model of ``more`` and what the command line gives; a fault is wrong usage."""
    with wrong_usage():
        return params_of(model, more | given_options(values, words_in(model)))


@contextmanager
def wrong_usage(start: str = "") -> Generator[None]:
    """Take options that mean nothing for wrong usage of the command; ``start`` begins the message."""
    try:
        yield
    except StudyError as error:
        raise click.UsageError(f"{start}{error.text}") from error


def stack(*parts: Command) -> Command:
    """Make one decorator of several."""

    def decorate(function: Command) -> Command:
        return reduce(lambda command, part: part(command), reversed(parts), function)

    return decorate


strict_option = click.option("--strict", is_flag=True, help="End with 4 also where a check asks for a look.")
figures_option = click.option(
    "--figures", is_flag=True, help="Also write each figure of the page as SVG, and its data as CSV, into figures/."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")


def out_option(help: str, *, required: bool = True) -> Command:
    """Add the option of the place for the results, where nothing is overwritten."""
    return click.option("--out", "-o", required=required, type=PATH, help=help)


def existing(name: str) -> Command:
    """Take a file or folder that is read; its own reader says what is wrong with it."""
    return click.argument(name, type=PATH)


def verb(*examples: str, name: str | None = None, goes_on: bool = False) -> Command:
    """Make a command of a function, by whose name it is called, with examples at the end of its help.

    ``goes_on``: where there are results of it already, it goes on with these; otherwise ``--out`` must not exist.
    """
    return click.command(name, cls=Verb, examples=examples, goes_on=goes_on)
