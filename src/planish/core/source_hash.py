"""The sources of the package as a hash: a version alone does not say which code made a result."""

import hashlib
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
