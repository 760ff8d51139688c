from pathlib import Path

from planish.cli.docs import page, with_options


def test_the_page_is_the_programs_own_help():
    path = Path(__file__).resolve().parents[2] / "docs" / "cli.md"
    assert path.read_text(encoding="utf-8") == page(), "run: python3 run.py docs"


def test_the_table_of_properties_options_is_that_of_the_program():
    path = Path(__file__).resolve().parents[2] / "docs" / "properties.md"
    text = path.read_text(encoding="utf-8")
    assert text == with_options(text), "run: python3 run.py docs"
