"""Options of the command line, made of the parameter models.

Their groups in the help; how text becomes numbers.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, reduce
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import click
from click.shell_completion import CompletionItem
from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from planish.core.annotations import kinds_of
from planish.core.annotations import words_in as literal_words
from planish.core.errors import PlanishError, StudyError
from planish.core.options import (
    Params,
    Paths,
    Shown,
    options_of,
    params_of,
    put_options,
    unit_of,
    words_in,
)
from planish.core.parameter_words import flag_of, in_terminal_words, names_in
from planish.core.tables import DECIMAL_OR_TWO
from planish.core.text import and_join
from planish.core.typing import Entries, Fields, Texts

Command = Callable[..., Any]
P = TypeVar("P", bound=Params)
PATH = click.Path(path_type=Path)


class Verb(click.Command):
    """A command whose help shows its options in groups and ends with examples."""

    def __init__(
        self, *args: Any, examples: Sequence[str] = (), can_resume: bool = False, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.examples = tuple(examples)
        self.can_resume = can_resume

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
        """Call it, unless the place of the results is not allowed.

        They must not lie in an input, nor where something stands that it does not go on with.
        """
        from planish.io.run_folder import refuse_existing, refuse_inside

        paths = {name: value for name, value in ctx.params.items() if isinstance(value, Path)}
        out = paths.pop("out", None)
        if out is not None:
            refuse_inside(out, [*paths.values()])
            if not self.can_resume:
                refuse_existing(out)
        try:
            return super().invoke(ctx)
        except PlanishError as error:
            error.args = (with_commands(error.text, ctx),)
            raise


def with_commands(text: str, ctx: click.Context) -> str:
    """Add to a text the commands with the options that it names and this command has not.

    A text names options by the words of a call, in backticks: `voxel_um`.
    """
    missing_names = {*names_in(text)} - words_of_command(ctx.command)
    if not missing_names:
        return text
    root = ctx.find_root()
    words_by_command: dict[str, set[str]] = {}
    for name, command in _commands_in(root.command, root, "planish"):
        words = words_by_command[f"'{name}'"] = words_of_command(command)
        if name in text:  # it is said already
            missing_names -= words
    while missing_names:
        # The command with most of them, and the next one that has these as well.
        shared_names = max((missing_names & words for words in words_by_command.values()), key=len)
        if not shared_names:
            break
        commands = [name for name, words in words_by_command.items() if shared_names <= words]
        flags_text = and_join(f"`{name}`" for name in names_in(text) if name in shared_names)
        verb_text = "is an option" if len(shared_names) == 1 else "are options"
        text += f" {flags_text} {verb_text} of {' and '.join(commands[:2])}."
        missing_names -= shared_names
    return text


def _commands_in(
    command: click.Command, ctx: click.Context, name: str
) -> Iterator[tuple[str, click.Command]]:
    if not isinstance(command, click.Group):
        yield name, command
        return
    for key in command.list_commands(ctx):
        inner_command = command.get_command(ctx, key)
        if inner_command is not None:
            yield from _commands_in(inner_command, ctx, f"{name} {key}")


def words_of_command(command: click.Command) -> set[str]:
    """Words of the options of a command."""
    options = [param for param in command.params if isinstance(param, click.Option)]
    flags = chain.from_iterable(option.opts for option in options)
    return {flag.removeprefix("--").replace("-", "_") for flag in flags}


class Option(click.Option):
    """An option that belongs to a group of the help."""

    def __init__(self, *args: Any, group: str = "Options", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.group = group


class Value(click.ParamType[Any]):
    """A value of a field's own type, checked by its limits.

    Commas separate numbers; with ``repeat`` one stands for all; the word none is for no number
    where any will do.
    """

    name = "value"

    def __init__(
        self, field_type: Any, metavar: str | None = None, *, repeat: bool = False
    ) -> None:
        """Read off a type how many values it takes, which words, and what stands for them.

        ``repeat`` as in the class; ``metavar``, the placeholder in the help, of the type where not
        given.
        """
        self.adapter = TypeAdapter[Any](field_type)
        self.can_repeat = repeat
        types = kinds_of(field_type)
        tuples = [get_args(t) for t in types if get_origin(t) is tuple]
        self.n_values = len(tuples[0]) if tuples else 0
        self.is_any_count = any(arguments[1:] == (...,) for arguments in tuples)
        self.words = literal_words(types)
        kinds = [*self.words]
        if tuples:
            kinds.append("N,...")
        elif float in types:
            kinds.append("NUMBER")
        elif int in types:
            kinds.append("INTEGER")
        self.metavar = metavar or "|".join(kinds) or "TEXT"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return self.metavar

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem[str]]:
        """Words that begin with what was typed."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse ``"3"`` or ``"3,1.5,1.5"``."""
        if not isinstance(value, str):
            return value
        if self.can_repeat and DECIMAL_OR_TWO.fullmatch(value.strip()):
            decimal = value.strip().replace(",", ".")
            ambiguity = f"{value!r} may be {decimal} or two numbers."
            self.fail(f"{ambiguity} Write numbers with a decimal point.", param, ctx)
        try:
            return self.adapter.validate_python(self._parts(value))
        except ValidationError as error:
            messages = [fault["msg"].removeprefix("Value error, ") for fault in error.errors()]
            reasons = "; ".join(dict.fromkeys(messages))
            self.fail(f"{value!r} is not {self.metavar}: {reasons}.", param, ctx)

    def _parts(self, value: str) -> str | list[str]:
        """The texts of a value's numbers; the text itself of a single one."""
        if not self.n_values:
            return value
        if self.is_any_count and value.strip().casefold() == "none":
            return []
        parts = [part.strip() for part in value.split(",")]
        if self.can_repeat and len(parts) == 1:
            return parts * self.n_values
        return parts


def options(
    model: type[Params], group: str, *, only: Sequence[str] = (), without: Sequence[str] = ()
) -> Command:
    """Give a command options of a model for :func:`build_params`.

    All or some, under the heading ``group``.
    """
    decorators: list[Command] = []
    for name, field, option_display in options_of(model):
        if name not in without and (not only or name in only):
            decorators.append(_option(name, field, option_display, group))
            inner_model = kinds_of(field.annotation)[0]
            if _is_params(inner_model):
                decorators.append(options(inner_model, group))
    return stack(*decorators)


def _is_params(field_type: Any) -> bool:
    """Tell whether a field is a model inside a model, which its own flag switches on."""
    return isinstance(field_type, type) and issubclass(field_type, Params)


def _none_if_empty(_context: Any, _option: Any, values: Texts) -> Texts | None:
    return values or None  # not given is other than an empty choice


def _option(name: str, field: FieldInfo, option_display: Shown, group: str) -> Command:
    """An option of a command for a field of a model, by the type of its value.

    A truth value, or a model of its own, is a flag; several texts are an option that may be given
    again; some words are a choice; all else is one value that is checked by the field's limits.
    """
    types = kinds_of(field.annotation)
    is_flag = types == [bool] or _is_params(types[0])
    help_text = in_terminal_words(field.description or "")
    if not is_flag:
        help_text += _default(field)
    settings: Entries = {"help": help_text, "group": group, "required": field.is_required()}
    option = partial(click.option, *option_display.flags, cls=Option, **settings)
    if is_flag:
        return option(is_flag=True, default=None)
    metavar = option_display.metavar
    if types == [Texts]:
        return option(multiple=True, metavar=metavar, callback=_none_if_empty)
    if len(types) == 1 and get_origin(types[0]) is Literal:
        return option(type=click.Choice(literal_words(types)))
    if not metavar and types == [float]:
        metavar = (unit_of(name) or "").upper() or None
    value_type = field.annotation
    if field.metadata:
        value_type = Annotated[field.annotation, *field.metadata]  # pyright: ignore
    return option(type=Value(value_type, metavar, repeat=option_display.repeat))


def _default(field: FieldInfo) -> str:
    """The default as the help writes it; empty where there is none."""
    default = field.get_default()
    if default in (None, (), ...) or default is PydanticUndefined:
        return ""
    values: tuple[Any, ...] = default if isinstance(default, tuple) else (default,)
    texts = [f"{value:.7g}" if isinstance(value, float) else str(value) for value in values]
    return f"  [default: {','.join(texts)}]"


def given_options(values: Fields, tables_of: Paths) -> Entries:
    """Collect the options that the command line gives in the tables where they stand.

    ``values`` by their words, None where not given; ``tables_of``: the path of each word in the
    tables. Only options with a place are collected. Wrong usage where an option belongs to a switch
    that is not given.
    """
    stated_values = {name: values[name] for name in tables_of if values.get(name) is not None}
    given_values = {name: value for name, value in stated_values.items() if value is not False}
    # A table of options is switched on by the word that stands at its own place.
    switches = {table: name for name, table in tables_of.items()}
    for name in given_values:
        switch = switches.get(tables_of[name][:-1], name)
        if switch not in given_values:
            flag = flag_of(switch)
            raise click.UsageError(f"{flag_of(name)} is an option of {flag}: give {flag} as well.")
    tables: Entries = {}
    put_options(tables, tables_of, given_values)
    return tables


def build_params(model: type[P], values: Fields, **fields: Any) -> P:
    """Build a model of ``fields`` and what the command line gives; a fault is wrong usage."""
    with wrong_usage():
        return params_of(model, fields | given_options(values, words_in(model)))


@contextmanager
def wrong_usage(prefix: str = "") -> Generator[None]:
    """Take options that mean nothing for wrong usage of the command.

    ``prefix`` begins the message.
    """
    try:
        yield
    except StudyError as error:
        raise click.UsageError(f"{prefix}{in_terminal_words(error.text)}") from error


def stack(*decorators: Command) -> Command:
    """Make one decorator of several."""

    def decorate(function: Command) -> Command:
        return reduce(lambda command, decorator: decorator(command), reversed(decorators), function)

    return decorate


strict_option = click.option(
    "--strict", is_flag=True, help="Also exit with 4 if a check asks for a look."
)
figures_option = click.option(
    "--figures",
    is_flag=True,
    help="Also write each figure of the page as SVG, and its data as CSV, into figures/.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")


def out_option(help: str, *, required: bool = True) -> Command:
    """Add the option of the place for the results, where nothing is overwritten."""
    return click.option("--out", "-o", required=required, type=PATH, help=help)


# Of a command that answers a question.
page_option = out_option(
    "Folder to make for the page and its tables; it must not exist.", required=False
)


def existing(name: str) -> Command:
    """Take a file or folder that is read; its own reader says what is wrong with it."""
    return click.argument(name, type=PATH)


def verb(*examples: str, name: str | None = None, can_resume: bool = False) -> Command:
    """Make a command of a function, named after it, with examples at the end of its help.

    ``can_resume``: where there are results of it already, it goes on with these; otherwise
    ``--out`` must not exist.
    """
    return click.command(name, cls=Verb, examples=examples, can_resume=can_resume)
