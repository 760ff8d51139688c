"""Families of messages: a family names its messages by patterns, and the site lists the messages that fit.

A pattern is a line of a block ``{messages}``: the beginning of a module's path, a colon and a space, and a regular
expression that is found in the text; ``…`` in a text stands for a value.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from messages import Message, messages
from public_names import ROOT

FOLDER = ROOT / "docs" / "reference" / "messages"
_EXIT = {"CannotMeasure": 3, "CannotFlatten": 3, "CannotRegister": 3, "ResourceError": 5, "UsageError": 2}
_BLOCK = re.compile(r"^```\{messages\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def of(patterns: str) -> list[Message]:
    """Return the messages that fit one of the patterns."""
    found: dict[str, Message] = {}
    for line in filter(None, map(str.strip, patterns.splitlines())):
        module, _, text = line.partition(": ")
        sought = re.compile(text)
        found |= {m.text: m for m in messages() if m.module.startswith(module) and sought.search(m.text)}
    return list(found.values())


def family(patterns: str) -> str:
    """Return a list of the messages of a family."""
    lines = [f"- {_as_code(message.text)}" for message in of(patterns)]
    return "\n".join(lines)


def families() -> Iterator[tuple[Path, str]]:
    """Give page and patterns of every family."""
    for path in sorted(FOLDER.glob("*.md")):
        for block in _BLOCK.findall(path.read_text(encoding="utf-8")):
            yield path, block


def _as_code(text: str) -> str:
    fence = "``" if "`" in text else "`"
    return f"{fence}{text}{fence}"
