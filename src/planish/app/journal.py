"""The journal of a session holds one line per change.

A line is on the disk before anybody is told that the change was made.
"""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from planish.core.errors import FileError, ResourceError
from planish.core.files import write_failure, writing

FORMAT = "planish journal 1"
LOCK = ".lock"


class InUse(FileError):
    """Another process writes this journal."""


class Journal:
    """Lines of JSON that are appended, each forced to the disk, and never changed.

    The first line says what the file is. The end of a line that a killed process did not finish is
    dropped. Nothing is written before the first change. ``subject`` is what the changes are made
    to, such as the hash of a run's results.

    With ``write`` lines will be appended, which at most one process can: InUse where another one
    does. FileError where it cannot be read, is damaged, or is of another subject; with ``write``
    also where it cannot be written.
    """

    def __init__(self, path: Path, *, subject: str, write: bool) -> None:
        """Read what was written before; with ``write``, keep others out."""
        self.path = path
        self.subject = subject
        self._lock = None
        if write:
            with writing(path):
                path.parent.mkdir(exist_ok=True)
                lock = FileLock(path.parent / LOCK)
                try:
                    lock.acquire(timeout=0)
                except Timeout as error:
                    raise InUse(
                        f"{path.parent.parent} is open in another planish view, which may change"
                        " it. Close that one, or open this one with `read_only`."
                    ) from error
            self._lock = lock
        try:
            try:
                data = path.read_bytes() if path.exists() else b""
            except OSError as error:
                raise FileError(
                    f"{path} cannot be read: {os.strerror(error.errno or 0)}."
                ) from error
            self._end_byte = data.rfind(b"\n") + 1
            self.lines = _lines(data[: self._end_byte], path, subject)
            if write and self._end_byte < len(data):
                with writing(path), path.open("r+b") as file:
                    file.truncate(self._end_byte)
        except BaseException:
            self.close()
            raise

    def append(self, line: bytes) -> None:
        """Write one line, JSON without line ends.

        It is on the disk when this returns, or nothing of it is.

        ResourceError where the disk is full; FileError where it cannot be written otherwise, or was
        opened to be read.
        """
        if self._lock is None:
            raise FileError(f"{self.path} is read only here. Nothing was changed.")
        is_new = self._end_byte == 0
        header = b""
        if is_new:
            header = json.dumps({"format": FORMAT, "of": self.subject}).encode() + b"\n"
        data = header + line + b"\n"
        try:
            with self.path.open("ab" if is_new else "r+b", buffering=0) as file:
                try:
                    file.truncate(self._end_byte)  # what an earlier failure may have left
                    file.seek(self._end_byte)
                    _write_all(file, data)
                    os.fsync(file.fileno())
                except BaseException:
                    with suppress(OSError):
                        file.truncate(self._end_byte)
                    raise
            if is_new and os.name != "nt":  # Windows keeps the names of files by itself
                descriptor = os.open(self.path.parent, os.O_RDONLY)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)
        except OSError as error:
            fault = write_failure(error, self.path)
            error_type = FileError
            reason = fault.text.removesuffix(".")
            if isinstance(fault, ResourceError):
                error_type = ResourceError
                reason = "the disk is full"
            raise error_type(
                f"The change could not be saved and was not made: {reason}. Free some space, then"
                " do it again."
            ) from error
        self._end_byte += len(data)
        self.lines.append(line)

    def close(self) -> None:
        """Let others write; a folder without a journal is removed."""
        if self._lock is not None:
            self._lock.release()
            if not self.path.exists():
                with suppress(OSError):
                    (self.path.parent / LOCK).unlink(missing_ok=True)
                    self.path.parent.rmdir()
            self._lock = None


def _lines(data: bytes, path: Path, subject: str) -> list[bytes]:
    """Lines of the changes in a journal; FileError where it is another file, or damaged."""
    first_line, *lines = data.splitlines() or [b""]
    if not first_line:
        return []
    header = _json_object(first_line)
    if header.get("format") != FORMAT:
        raise FileError(
            f"{path} is no journal of this planish ({FORMAT!r}). Rename it to begin anew."
        )
    if header.get("of") != subject:
        raise FileError(
            f"{path} holds changes of something else than what lies beside it. Rename it to begin"
            " anew."
        )
    for k, line in enumerate(lines, 2):
        if not _json_object(line):
            raise FileError(
                f"{path} is damaged in line {k} of {len(lines) + 1}. Cut the file before this line"
                " to keep the changes that were made until then."
            )
    return lines


def _json_object(line: bytes) -> Mapping[str, Any]:
    try:
        parsed: Any = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return parsed if isinstance(parsed, dict) else {}  # pyright: ignore[reportUnknownVariableType]


def _write_all(file: Any, data: bytes) -> None:
    """Write all of it: a disk that fills up takes the first part of a write without a word."""
    remaining = memoryview(data)
    while remaining:
        remaining = remaining[file.write(remaining) :]
