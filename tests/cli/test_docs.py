from pathlib import Path

from planish.cli.docs import page


def test_the_page_is_the_programs_own_help():
    path = Path(__file__).resolve().parents[2] / "docs" / "cli.md"
    assert path.read_text(encoding="utf-8") == page(), "run: python3 run.py docs"
