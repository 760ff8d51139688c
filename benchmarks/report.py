"""Put what benchmarks print into docs/benchmarks.md.

``python -m benchmarks report flattening peers`` runs that benchmark and renews its part of the
page, which stands between ``<!-- flattening peers -->`` and ``<!-- end -->``: the table where the
part is one, else all that was printed.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
PARTS = re.compile(r"^<!-- ([^\n]+) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)


def renewed(text, name, printed):
    """The page with what a benchmark printed in its part."""

    def part(found):
        if found[1] != name:
            return found[0]
        content = f"```\n{printed.strip()}\n```"
        if found[2].startswith("|"):
            content = "\n".join(line for line in printed.splitlines() if line.startswith("|"))
        return f"<!-- {name} -->\n{content}\n<!-- end -->"

    return PARTS.sub(part, text)


def main(*words):
    """Run one benchmark and renew its part; the exit code is that of the benchmark."""
    name = " ".join(str(word) for word in words)
    text = PAGE.read_text(encoding="utf-8")
    parts = [found[1] for found in PARTS.finditer(text)]
    if name not in parts:
        print(f"The page has no part '{name}'. Choose one of: {', '.join(parts)}.")
        return 1
    command = [sys.executable, "-m", "benchmarks", *name.split()]
    done = subprocess.run(
        command, cwd=PAGE.parents[1], stdout=subprocess.PIPE, text=True, check=False
    )
    _title, _, printed = done.stdout.partition("\n")
    PAGE.write_text(renewed(text, name, printed), encoding="utf-8", newline="\n")
    return done.returncode
