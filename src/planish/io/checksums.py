"""The lists of checksums in a store: which shards are whole, and which were lost later."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import zarr

from planish.core.files import delete, move

CHECKSUMS = "checksums.sha256"
"""List of the shards of a level with their SHA-256, in the folder of the level, as ``sha256sum -c`` reads it."""

Where = tuple[slice, slice, slice]
Array = zarr.Array[Any]


def missing_shards(path: Path) -> list[str]:
    """Return the shards that the lists of checksums name and that are not there; empty where there is no list."""
    return [name for name in _read_checksums(path) if not (path / name).is_file()]


def store_fingerprint(path: Path) -> str:
    """SHA-256 over the checksums of all shards, for which no shard is read; empty where there are no checksums."""
    listed = sorted(_read_checksums(path).items())
    if not listed:
        return ""
    # The shards hold the voxels, the metadata their size.
    meta = sorted(p for p in path.rglob("*") if p.name in ("zarr.json", ".zattrs", ".zarray"))
    listed += [(p.relative_to(path).as_posix(), hashlib.sha256(p.read_bytes()).hexdigest()) for p in meta]
    return hashlib.sha256("".join(f"{sha}  {name}\n" for name, sha in listed).encode()).hexdigest()


class ShardLists:
    """The lists of shards that are whole."""

    def __init__(self, folder: Path, ome: str) -> None:
        self.folder, self.prefix = folder.absolute(), "c/" if ome == "0.5" else ""
        self.listed = set(_read_checksums(folder))

    def names(self, level: Array, where: Where) -> list[str]:
        """Files of the shards of a block, in the folder of their level."""
        edge = level.shards or level.chunks
        z, y, x = (range(w.start // s, -(-w.stop // s)) for w, s in zip(where, edge, strict=True))
        return [f"{self.prefix}{a}/{b}/{c}" for a in z for b in y for c in x]

    def has(self, level: Array, where: Where) -> bool:
        """True if all shards of a block are listed."""
        return self.listed.issuperset(f"{level.basename}/{name}" for name in self.names(level, where))

    def add(self, level: Array, checksums: dict[str, str]) -> None:
        """List the shards of a block that was written: only after their bytes are on the disk."""
        with (self.folder / level.basename / CHECKSUMS).open("a", encoding="utf-8", newline="\n") as file:
            file.write("".join(f"{checksum}  {name}\n" for name, checksum in checksums.items()))
            file.flush()
            os.fsync(file.fileno())
        self.listed.update(f"{level.basename}/{name}" for name in checksums)

    def settle(self) -> None:
        """Sort the lists: they do not depend on the order in which blocks were written."""
        for path in self.folder.glob(f"*/{CHECKSUMS}"):
            lines = sorted(set(path.read_text(encoding="utf-8").splitlines(keepends=True)), key=lambda line: line[64:])
            part = path.with_suffix(".part")
            part.write_text("".join(lines), encoding="utf-8", newline="\n")
            move(part, path, over=True)
        for half in self.folder.rglob("*.partial"):  # of a writer that was killed
            delete(half)


def _read_checksums(folder: Path) -> dict[str, str]:
    """Shards of all levels and their checksums; a last line that was cut off does not count."""
    checksums: dict[str, str] = {}
    for path in sorted(folder.glob(f"*/{CHECKSUMS}")):
        for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
            if line.endswith("\n") and line[64:66] == "  ":
                checksums[f"{path.parent.name}/{line[66:-1]}"] = line[:64]
    return checksums
