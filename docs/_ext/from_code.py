"""Sphinx extension that makes from the program what a page says about it.

This is done while the site is built.

A fenced block names what stands in its place::

    ```{public} planish.io
    ```

    ```{root} CHANGELOG.md
    ```

Links to files at the root of the checkout lead to the pages that show these files, a link that is
named by its file gets the title of the page, and one that is named by a package leads from the list
of packages to its page. Pages get the entries of the index that `docs/words.md` has for them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import api_pages
import fields
import message_pages
import program_pages
import words
from public_names import ROOT

from planish.core.parameter_words import in_terminal_words
from planish.exports import formats_table
from planish.io.other_files import OTHER_KINDS
from planish.marks.exchange import formats as files_of_marks
from planish.measure import registered
from planish.measure.registry import PROPERTIES

_BLOCK = re.compile(r"^```\{(\w+)\}[ ]*([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(((?:\.\./)*)([\w./-]+?)(#[\w-]+)?\)")
_NAMED_BY_PACKAGE = re.compile(r"\[`(planish[\w.]*)`\]\(([\w./-]*reference/api/)index\.md\)")
# A file's name helps where Markdown is read as it is; the site knows the title.
_NAMED_BY_FILE = re.compile(r"\[[\w./-]+\.md\]\(([^)#]+\.md(?:#[\w-]+)?)\)")
SHOWN = {
    "CHANGELOG.md": "changes",
    "CONTRIBUTING.md": "contributing",
    "ARCHITECTURE.md": "architecture",
    "DECISIONS.md": "decisions",
}


def expand(text: str) -> str:
    """Return a page with its blocks replaced by what they name."""

    def made(block: re.Match[str]) -> str:
        maker = _MAKERS.get(block[1])
        return maker(block[2].strip(), block[3]) if maker else block[0]

    return _BLOCK.sub(made, text)


def with_links(text: str) -> str:
    """Return a page whose links to the files that the site shows lead to their pages."""

    def led(link: re.Match[str]) -> str:
        page = SHOWN.get(link[2])
        return f"](/project/{page}.md{link[3] or ''})" if page else link[0]

    text = _NAMED_BY_PACKAGE.sub(r"[`\1`](\2\1.md)", text)
    return _NAMED_BY_FILE.sub(r"[](\1)", _LINK.sub(led, text))


def _root(name: str, _content: str) -> str:
    """Return a Markdown file at the root of the checkout, its links as from the documents."""
    text = (ROOT / name).read_text(encoding="utf-8")

    def led(link: re.Match[str]) -> str:
        inside = PurePosixPath(link[2])
        if link[2] in SHOWN or not (ROOT / inside).exists():
            return link[0]
        place = f"/{inside.relative_to('docs')}" if inside.parts[0] == "docs" else f"../../{inside}"
        return f"]({place}{link[3] or ''})"

    return _LINK.sub(led, text)


def properties_table() -> str:
    """Return name, unit, title and meaning of every map that a sheet may have."""
    always = {*PROPERTIES, "warp", "tilt"}
    rows = ["| Name | Unit | Title | Meaning |", "|---|---|---|---|"]
    rows += [
        f"| `{name}` | {known.units} | {known.long_name} |"
        f" {meaning(known.function)}{' In every run.' if name in always else ''} |"
        for name, known in sorted(registered().items())
    ]
    return "\n".join(rows)


def meaning(function: Callable[..., object]) -> str:
    """Return the first sentence of a property's function, without the number of its rule."""
    first, *_ = (inspect.getdoc(function) or "").split("\n\n")
    text = re.sub(r"^[PA]-\d+: ", "", " ".join(first.split())).replace("``", "`")
    return text[:1].upper() + text[1:]


def other_kinds_table() -> str:
    """Return what planish does not read, how it is recognised, and what to take instead."""
    rows = ["| It is | By the name | Take |", "|---|---|---|"]
    for kind in OTHER_KINDS:
        name = kind.name.partition(" ")[2].replace("|", "\\|")
        suffixes = " ".join(f"`{suffix}`" for suffix in kind.ends)
        rows.append(f"| {name} | {suffixes} | {in_terminal_words(kind.way)} |")
    return "\n".join(rows)


_MAKERS: dict[str, Callable[[str, str], str]] = {
    "packages": lambda _, __: api_pages.packages_table(),
    "public": lambda package, _: api_pages.package_page(package),
    "root": _root,
    "commands": lambda _, __: program_pages.commands(),
    "study": lambda _, __: fields.study_page(),
    "results": lambda _, __: fields.results_page(),
    "properties": lambda _, __: properties_table(),
    "exports": lambda _, __: formats_table(),
    "marksfiles": lambda _, __: files_of_marks.formats_table(),
    "otherkinds": lambda _, __: other_kinds_table(),
    "messages": lambda _, patterns: message_pages.family(patterns),
}


def _write_sources(app, _config) -> None:
    api_pages.write_sources(Path(app.srcdir) / "reference" / "api")


def _read(_app, docname: str, source: list[str]) -> None:
    source[0] = words.with_entries(docname, with_links(expand(source[0])))


def setup(app) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("config-inited", _write_sources)
    app.connect("source-read", _read)
    app.add_transform(words.EntriesOfPages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
