"""What the program says of itself: the help of every command, and the schemas of the results.

``python docs/_ext/program_pages.py`` writes the schemas into the docs folder of the checkout, that
of a run also into the package. The help is put into its page while the site is built.
"""

from __future__ import annotations

import json
from pathlib import Path

import click
from pydantic import BaseModel

from planish.cli.main import planish
from planish.results import Results
from planish.series_results import SeriesResults


def commands() -> str:
    """Return the help of every command, each under its name."""
    sections = [_section("planish", planish)]
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


def schema(results: type[BaseModel]) -> str:
    """Return the JSON schema of results.json, of a run or of a series."""
    return json.dumps(results.model_json_schema(), indent=1) + "\n"


def main() -> None:
    """Write the schemas."""
    docs = Path(__file__).resolve().parents[1]
    package = docs.parent / "src" / "planish"
    for path, text in (
        (docs / "results.schema.json", schema(Results)),
        (docs / "series.schema.json", schema(SeriesResults)),
        (package / "core" / "results.schema.json", schema(Results)),
    ):
        path.write_text(text, encoding="utf-8", newline="\n")
        click.echo(f"{path.name} written")


if __name__ == "__main__":
    main()
