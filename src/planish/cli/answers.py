"""The ending of a command that answers one question: its tables and sentences, or JSON."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from planish.cli.console import sentence, table
from planish.core.facts import ResultModel
from planish.core.numbers import in_ascii


def show_answer(
    answer: ResultModel,
    tables: Mapping[str, Sequence[Mapping[str, str]]],
    sentences: Sequence[str],
    *,
    page: Path | None,
    as_json: bool,
) -> None:
    """Print an answer as tables by their headings and sentences, or as JSON, and name its page."""
    if as_json:
        click.echo(answer.model_dump_json(indent=2))
    else:
        for heading, rows in tables.items():
            table(heading, [*rows[0]], [[*row.values()] for row in rows])
        for text in sentences:
            sentence(in_ascii(text))
    if page is not None:
        click.echo(f"page: {page}", err=as_json)
