"""Old mends, undone: do the fast and the CI tests still see the faults?

``python -m tests.mends SEED [COUNT]`` draws commits that changed the program and a test, in an
order that follows from SEED, and undoes what each did to ``src`` in a copy of this checkout.
Commits that no longer come off cleanly are passed over, as are those that changed no behaviour
(documents, formats: name them with ``--without HASH,HASH``). Then the fast and the CI tests of the
packages that the commit touched are run; one of them has to fail.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Mend(NamedTuple):
    """A commit: its hash, its subject, and the files that it changed."""

    sha: str
    subject: str
    files: tuple[str, ...]


def main(arguments: list[str]) -> int:
    """Undo one mend after the other; the exit code is the number of those that no test saw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed")
    parser.add_argument("count", type=int, nargs="?", default=12)
    parser.add_argument("--without", default="", metavar="HASH,HASH")
    parser.add_argument(
        "--only", default="", metavar="HASH,HASH", help="judge these, whatever is drawn"
    )
    given = parser.parse_args(arguments)
    passed_over = tuple(filter(None, given.without.split(",")))
    mends = [mend for mend in all_mends() if not (passed_over and mend.sha.startswith(passed_over))]
    if given.only:
        mends = [mend for mend in mends if mend.sha.startswith(tuple(given.only.split(",")))]
    random.Random(given.seed).shuffle(mends)
    judged = unseen = 0
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "planish"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(copy)], check=True)
        for mend in mends:
            if judged == given.count:
                break
            if not undo(mend, copy):
                continue
            judged += 1
            seen_by = first_failure(mend, copy)
            unseen += seen_by is None
            print(f"{mend.sha[:8]} {mend.subject}\n    seen by: {seen_by or 'NOTHING'}", flush=True)
            subprocess.run(
                ["git", "checkout", "--quiet", "--force", "HEAD", "--", "src"], cwd=copy, check=True
            )
    print(f"{judged - unseen} of {judged} seen")
    return unseen


def all_mends() -> list[Mend]:
    """All commits that changed the program and a test, newest first."""
    command = ["git", "log", "--no-merges", "--name-only", "--format=%x00%H%x01%s"]
    log = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    mends: list[Mend] = []
    for entry in log.split("\0")[1:]:
        head, _, names = entry.partition("\n")
        sha, _, subject = head.partition("\1")
        files = tuple(names.split())
        changed = {name.partition("/")[0] for name in files if name.endswith(".py")}
        if {"src", "tests"} <= changed:
            mends.append(Mend(sha, subject, files))
    return mends


def undo(mend: Mend, copy: Path) -> bool:
    """Take the commit's change of the program out of the copy, where that is possible without a
    conflict."""
    change = subprocess.run(
        ["git", "diff", f"{mend.sha}^", mend.sha, "--", "src"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout
    done = subprocess.run(
        ["git", "apply", "--reverse", "-"], cwd=copy, input=change, capture_output=True, check=False
    )
    return done.returncode == 0


def tests_of(mend: Mend) -> list[str]:
    """Folders and files with the tests of the packages that a mend touched, those that it changed
    itself first."""
    packages = {Path(name).parts[2] for name in mend.files if name.startswith("src/planish/")}
    own = [
        name
        for name in mend.files
        if name.startswith("tests/") and Path(name).name.startswith("test_")
    ]
    folders = [f"tests/{package}" for package in sorted(packages)]
    whole_line = sorted(
        path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").glob("test_*.py")
    )
    return [name for name in dict.fromkeys([*own, *folders, *whole_line]) if (ROOT / name).exists()]


def first_failure(mend: Mend, copy: Path) -> str | None:
    """Tier and name of the first test that fails."""
    environment = os.environ | {"PYTHONPATH": str(copy / "src")}
    for tier, options in (("fast", []), ("ci", ["--ci"])):
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-n",
            "2",
            "--no-header",
            "-p",
            "no:cacheprovider",
        ]
        # That a mutant no longer fits the older text is no sight of a fault.
        command += [
            "--deselect",
            "tests/test_project.py::test_every_mutant_of_the_list_fits_the_code",
        ]
        done = subprocess.run(
            [*command, *options, *tests_of(mend)],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        failures = [
            line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))
        ]
        # A fast test that was only too slow, as kernels of the copy are compiled anew, ends with 1.
        if done.returncode > 1 and not failures:
            return f"{tier}: the tests do not start"
        if failures:
            return f"{tier}: {failures[0]}"
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
