"""Pages that the program writes.

Commands, options of properties, and schema of the results.

``python docs/_ext/program_pages.py`` puts them into the docs folder of the checkout, the schema
also into the package.
"""

from __future__ import annotations

import json
from pathlib import Path

import click
from pydantic import BaseModel

from planish.cli.main import planish
from planish.measure.params import MeasureParams
from planish.results import Results
from planish.series_results import SeriesResults


def page() -> str:
    """Return the text of docs/cli.md."""
    intro = (
        "# Commands\n\nThis page is written by `python3 run.py docs` from the program's own help.\n"
    )
    sections = [intro, _section("planish", planish)]
    context = click.Context(planish)
    for name in planish.list_commands(context):
        command = planish.get_command(context, name)
        assert command is not None
        sections.append(_section(f"planish {name}", command))
        if isinstance(command, click.Group):
            sections += [
                _section(f"planish {name} {subverb}", subcommand)
                for subverb, subcommand in command.commands.items()
            ]
    return "\n".join(sections)


def _section(name: str, command: click.Command) -> str:
    # As at the terminal, where every command takes these from the group; click keeps the option
    # once it has made it.
    context = click.Context(
        command, info_name=name, terminal_width=100, help_option_names=["-h", "--help"]
    )
    return f"## {name}\n\n```\n{command.get_help(context)}\n```\n"


def with_options(text: str) -> str:
    """Return the text of docs/properties.md with the table of options as the program has them."""
    rows = ["| `[properties]` | Default | |", "|---|---|---|"]
    for name, field in MeasureParams.model_fields.items():
        default = "" if field.default in (None, ()) else field.default
        if field.annotation is float:
            default = f"{field.default:g}"
        rows.append(f"| `{name}` | {default} | {field.description} |")
    before, after = text.split("## Options\n", 1)
    table = "\n".join(rows)
    return f"{before}## Options\n\n{table}\n\n## " + after.split("\n## ", 1)[1]


def schema(results: type[BaseModel]) -> str:
    """Return the JSON schema of results.json, of a run or of a series."""
    return json.dumps(results.model_json_schema(), indent=1) + "\n"


def main() -> None:
    """Write them all."""
    docs = Path(__file__).resolve().parents[1]
    package = docs.parent / "src" / "planish"
    properties = (docs / "properties.md").read_text(encoding="utf-8")
    for path, text in (
        (docs / "cli.md", page()),
        (docs / "properties.md", with_options(properties)),
        (docs / "results.schema.json", schema(Results)),
        (docs / "series.schema.json", schema(SeriesResults)),
        (package / "core" / "results.schema.json", schema(Results)),
    ):
        path.write_text(text, encoding="utf-8", newline="\n")
        click.echo(f"{path.name} written")


if __name__ == "__main__":
    main()
