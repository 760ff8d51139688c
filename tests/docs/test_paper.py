"""The paper has the parts that the journal asks for, and cites what its bibliography holds."""

import re
from pathlib import Path

PAPER = Path(__file__).resolve().parents[2] / "paper"
TEXT = (PAPER / "paper.md").read_text(encoding="utf-8")


def test_the_paper_has_its_parts_and_cites_its_bibliography():
    head, body = re.fullmatch(r"---\n(.*?)\n---\n(.*)", TEXT, re.DOTALL).groups()
    assert [
        key
        for key in ("title:", "tags:", "authors:", "affiliations:", "bibliography: paper.bib")
        if key not in head
    ] == []
    titles = re.findall(r"^# (.+)$", body, re.MULTILINE)
    assert [
        t
        for t in (
            "Summary",
            "Statement of need",
            "State of the field",
            "Software design",
            "Research impact statement",
            "AI usage disclosure",
            "Acknowledgements",
            "References",
        )
        if t not in titles
    ] == []
    assert 750 <= len(body.split()) <= 1750  # what the journal asks for
    entries = re.findall(
        r"^@\w+\{(\w+),", (PAPER / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert (len(entries), set(re.findall(r"@(\w+)", TEXT))) == (len(set(entries)), set(entries))


def test_figures_of_the_paper_stand_where_its_table_says():
    """The page that a command's output was put into still has the figure."""
    docs = PAPER.parent / "docs"
    for figures, page in (
        (("1.5, 4.0", "2.2, 2.1", "+0.01, 0.42", "117 µm", "300 (", "0 of 24"), "accuracy.md"),
        (("250 µm of expansion",), "benchmarks.md"),
        (("59 ways", "280 runs", "16 are silent"), "benchmarks.md"),
    ):
        text = (docs / page).read_text(encoding="utf-8")
        assert [figure for figure in figures if figure not in text] == []
