"""Sentences of a document as a reader meets them: without code, tables, headings and addresses."""

import re

# Words that a sentence does not end behind.
_SHORT = re.compile(r"\b(e\.g|i\.e|etc|cf|al|vs|Eq|Fig|No|approx|resp|[A-Z])\.(?=\s)")


def sentences(text, *, template=False):
    """Return the sentences of a Markdown page, or of a template of HTML."""
    paragraphs = _of_template(text) if template else _of_markdown(text)
    found = []
    for paragraph in paragraphs:
        plain = _SHORT.sub(
            lambda short: short[1].replace(".", "") + "", " ".join(paragraph.split())
        )
        found += [
            part.strip() for part in re.split(r"(?<=[.!?])[\"')]*\s+(?=[\"'(]?[A-Z0-9`])", plain)
        ]
    return [sentence for sentence in found if len(words(sentence)) > 2]


def words(sentence):
    """Return the words of a sentence; a number with its unit sign, a name in code and a formula
    count as one."""
    return re.findall(r"[^\W_][\w.,'°%µ/·^-]*", sentence)


def prose(text):
    """Return a page without code, addresses, pictures and generated parts; tables and headings
    stay."""
    text = re.sub(r"^(`{3,}|~{3,}).*?^\1[ ]*$", "\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->|^---\n.*?^---$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"`[^`\n]+`", "Code", text)


def _of_markdown(text):
    text = prose(text)
    # Tables, headings, anchors.
    text = re.sub(r"^\s*(\||#|\(\w+-\w+\)=).*$", "\n", text, flags=re.MULTILINE)
    # Every point of a list begins anew.
    text = re.sub(r"^\s*([-*]|\d+\.)\s+", "\n\n", text, flags=re.MULTILINE)
    return re.split(r"\n\s*\n", re.sub(r"[*_]{1,3}(?=\S)|(?<=\S)[*_]{1,3}", "", text))


def _of_template(text):
    text = re.sub(r"<(style|script).*?</\1>|\{#.*?#\}", " ", text, flags=re.DOTALL)
    text = re.sub(r"\{%.*?%\}", " ", text, flags=re.DOTALL)
    text = re.sub(r"\{\{.*?\}\}", "7", text, flags=re.DOTALL)
    parts = re.split(
        r"</?(?:p|h\d|li|td|th|div|section|figcaption|dt|dd|summary|title|tr|table|br)\b[^>]*>",
        text,
    )
    return [re.sub(r"<[^>]*>", "", part) for part in parts]


def pages(root):
    """Return every document that is read: pages of the site, those at the root, and templates of
    the report."""
    docs = [path for path in (root / "docs").rglob("*.md") if "_build" not in path.parts]
    templates = list((root / "src" / "planish" / "report" / "templates").glob("*.j2"))
    return sorted([*docs, *root.glob("*.md"), root / "paper" / "paper.md", *templates])
