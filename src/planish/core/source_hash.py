"""Which sources a result was made with: a version alone does not say it. And whom to tell of it."""

import hashlib
import subprocess
from functools import cache
from pathlib import Path

from planish import __version__

PACKAGE = Path(__file__).resolve().parents[1]  # folder of the package


@cache
def hash_sources(pattern: str = "*.py") -> str:
    """Give the first 16 hex digits of a hash of the package's files, their names and bytes."""
    digest = hashlib.sha256()
    for name, path in sorted(
        (path.relative_to(PACKAGE).as_posix(), path) for path in PACKAGE.rglob(pattern)
    ):
        content = path.read_bytes()
        digest.update(f"{name}\n{len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


def is_this_code(version: str, source_hash: str) -> bool:
    """Return True if a version and a hash of sources are those of this program."""
    return version == __version__ and source_hash == hash_sources()


@cache
def find_commit() -> str:
    """Commit of the checkout that runs, with ``+`` where files of the package differ from it.

    Empty where the package lies in no checkout, or git is missing.
    """
    if PACKAGE.parent.name != "src" or not (PACKAGE.parents[1] / ".git").exists():
        return ""
    command = ["git", "--no-optional-locks", "status", "--porcelain=v2", "--branch", "."]
    try:
        done = subprocess.run(command, cwd=PACKAGE, capture_output=True, check=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return ""
    lines = done.stdout.decode(errors="replace").splitlines()
    head = lines[0].removeprefix("# branch.oid ")
    has_changes = any(not line.startswith("#") for line in lines)
    return f"{head}+" if has_changes else head


def report_to() -> str:
    """To whom a fault is reported: the address ``Issues`` of the project's metadata.

    Where it has none, whoever runs the installation.
    """
    from importlib import metadata  # here, so that a look at a file waits for none of it

    try:
        urls = metadata.metadata("planish").get_all("Project-URL") or []
    except metadata.PackageNotFoundError:
        urls = []
    addresses = [url.removeprefix("Issues, ") for url in urls if url.startswith("Issues, ")]
    return f"at {addresses[0]}" if addresses else "to whoever runs this installation"
