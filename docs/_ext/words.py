"""Put words of readers into the search.

`docs/words.md` leads from words that laboratories use to the pages that answer them.

Each of these words becomes an entry of the index on its page, or on the section that the link
names. The search of the site ranks such an entry before pages that only contain the word. Sphinx
drops the entries of pages that a build leaves as they are, so `run.py docs` builds all of them.
"""

from __future__ import annotations

import re
from functools import cache

from docutils import nodes
from public_names import ROOT
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

ROW = re.compile(
    r"^\| (?P<words>[^|]+) \| [^|]+ \|"
    r" \[[^\]]+\]\((?P<page>[\w/-]+)\.md(?:#(?P<section>[\w-]+))?\) \|$"
)
_HEADING = re.compile(r"^#{1,4} (.+)$", re.MULTILINE)


@cache
def entries() -> dict[str, dict[str, list[str]]]:
    """Words by page and section; the section of a whole page is empty."""
    found: dict[str, dict[str, list[str]]] = {}
    for line in (ROOT / "docs" / "words.md").read_text(encoding="utf-8").splitlines():
        if row := ROW.match(line):
            words = found.setdefault(row["page"], {}).setdefault(row["section"] or "", [])
            words += row["words"].split(", ")
    return found


def with_entries(page: str, text: str) -> str:
    """Return the text of a page with its words' entries behind the headings that they lead to."""
    sections = dict(entries().get(page, {}))

    def behind(heading: re.Match[str]) -> str:
        slug = re.sub(r"[^\w -]", "", heading[1].lower()).replace(" ", "-")
        words = sections.pop("", []) + sections.pop(slug, [])
        # The mark makes it the main entry, which the search ranks.
        marked = ", ".join(f"! {word}" for word in words)
        return f"{heading[0]}\n\n```{{index}} {marked}\n```\n" if words else heading[0]

    text = _HEADING.sub(behind, text)
    if sections:
        raise ValueError(
            f"docs/words.md names sections that {page}.md does not have: {', '.join(sections)}"
        )
    return text


class EntriesOfPages(SphinxTransform):
    """Let entries of a whole page lead to its top, as a hit of the page does.

    The search then lists the page once.
    """

    default_priority = 800  # before the entries are gathered

    def apply(self, **_options: object) -> None:
        """Take the target off the main entries behind the title of the page."""
        for node in self.document.findall(addnodes.index):
            if node.parent is not None and isinstance(node.parent.parent, nodes.document):
                node["entries"] = [
                    (*entry[:2], "", *entry[3:]) if entry[3] else entry for entry in node["entries"]
                ]
