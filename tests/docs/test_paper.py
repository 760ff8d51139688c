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
        for t in ("Summary", "Statement of need", "State of the field", "References")
        if t not in titles
    ] == []
    assert len(body.split()) < 1000
    entries = re.findall(
        r"^@\w+\{(\w+),", (PAPER / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert (len(entries), set(re.findall(r"@(\w+)", TEXT))) == (len(set(entries)), set(entries))
