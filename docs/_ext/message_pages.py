"""List families of messages on the site.

A family names its messages by patterns, and the messages that fit are listed.

A pattern is a line of a block ``{messages}``: the beginning of a module's path, a colon and a
space, and a regular expression that is found in the text; ``…`` in a text stands for a value.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from messages import Message, messages
from public_names import ROOT

from planish.core import errors

FOLDER = ROOT / "docs" / "reference" / "messages"
_BLOCK = re.compile(r"^```\{messages\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def of(patterns: str) -> list[Message]:
    """Return the messages that fit one of the patterns."""
    found: dict[str, Message] = {}
    for line in filter(None, map(str.strip, patterns.splitlines())):
        module, _, text = line.partition(": ")
        sought = re.compile(text)
        found |= {
            m.text: m for m in messages() if m.module.startswith(module) and sought.search(m.text)
        }
    return list(found.values())


def family(patterns: str) -> str:
    """Return a list of the messages of a family, and the exit codes that they end with."""
    found = of(patterns)
    codes = sorted({code for message in found if (code := _exit_code(message.kind)) is not None})
    ends = f"\n\n*Exit code {' or '.join(map(str, codes))}.*" if codes else ""
    return "\n".join(f"- {_as_code(message.text)}" for message in found) + ends


def families() -> Iterator[tuple[Path, str]]:
    """Give page and patterns of every family."""
    for path in sorted(FOLDER.glob("*.md")):
        for block in _BLOCK.findall(path.read_text(encoding="utf-8")):
            yield path, block


def _exit_code(kind: str) -> int | None:
    """Exit code of a kind of error; None where it is a part of another message."""
    known = getattr(errors, kind, None)
    if known is not None:
        return known.exit_code
    return 2 if kind in {"UsageError", "BadParameter"} else 5 if kind == "DiskFull" else None


def _as_code(text: str) -> str:
    fence = "``" if "`" in text else "`"
    return f"{fence}{text}{fence}"
