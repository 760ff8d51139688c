"""The project's own files agree with each other: version, locks, citation."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import planish

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILD = ["hatchling", "editables"]  # run.py installs this folder without build isolation


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def locked(name: str) -> dict[str, set[str]]:
    """Versions of each package in a lock."""
    versions: dict[str, set[str]] = {}
    for package, version in re.findall(r"^([\w.-]+)==(\S+)", read(f"requirements/{name}"), flags=re.MULTILINE):
        versions.setdefault(package, set()).add(version)
    return versions


def names(requirements: list[str]) -> set[str]:
    # Upper and lower case, and the signs between words, make no difference in the name of a package.
    return {re.sub(r"[-_.]+", "-", re.split(r"[\[<>=]", r)[0]).lower() for r in requirements}


def test_locks_hold_everything_that_pyproject_names() -> None:
    run = names([*PROJECT["dependencies"], *BUILD])
    assert run <= locked("run.lock").keys()
    assert run | names(PROJECT["optional-dependencies"]["dev"]) <= locked("dev.lock").keys()


def test_dev_lock_holds_the_run_lock_in_the_same_versions() -> None:
    dev = locked("dev.lock")
    assert {package: dev.get(package) for package in locked("run.lock")} == locked("run.lock")


@pytest.mark.parametrize("name", ["run.lock", "dev.lock"])
def test_locks_hold_names_versions_and_hashes_only(name: str) -> None:
    line = re.compile(r"[\w.-]+==[\w.]+( ; [\w .<>='!()*]+)? \\|    --hash=sha256:[0-9a-f]{64}( \\)?")
    assert [text for text in read(f"requirements/{name}").splitlines() if not line.fullmatch(text)] == []


def test_citation_and_changelog_name_the_version() -> None:
    assert f"\nversion: {planish.__version__}\n" in read("CITATION.cff")
    assert f"\n## [{planish.__version__}]" in read("CHANGELOG.md")
