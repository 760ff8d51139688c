"""Pages and schema are those of the program."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from planish.cli.docs import page, schema, with_options

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_page_is_the_programs_own_help():
    assert (DOCS / "cli.md").read_text(encoding="utf-8") == page(), "run: python3 run.py docs"


def test_the_table_of_properties_options_is_that_of_the_program():
    text = (DOCS / "properties.md").read_text(encoding="utf-8")
    assert text == with_options(text), "run: python3 run.py docs"


def test_the_published_schema_is_that_of_the_results():
    assert (DOCS / "results.schema.json").read_text(encoding="utf-8") == schema(), "run: python3 run.py docs"
    packed = files("planish.core").joinpath("results.schema.json")
    assert packed.read_text(encoding="utf-8") == schema(), "run: python3 run.py docs"
