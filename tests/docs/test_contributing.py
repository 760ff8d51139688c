"""The diffs of CONTRIBUTING are those of the code as it is."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DIFFS = re.findall(
    r"^### (.*?)\n.*?```diff\n(.*?)```",
    (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
    re.DOTALL | re.MULTILINE,
)


def test_nine_ways_are_shown():
    assert len(DIFFS) == 9


@pytest.mark.skipif(shutil.which("git") is None, reason="git applies the diffs")
@pytest.mark.parametrize(("name", "diff"), DIFFS, ids=[name for name, _ in DIFFS])
def test_a_way_applies_to_the_code(name, diff):
    command = ["git", "apply", "--check", "-"]
    done = subprocess.run(
        command, cwd=ROOT, input=diff, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{name}: {done.stderr}"
