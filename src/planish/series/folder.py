"""The folder of a series: one writer at a time, and its pages."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from planish.core.errors import FileError
from planish.core.files import writing
from planish.io.run_folder import acquire_lock, refuse_existing
from planish.series.jobs import NOTES


@contextmanager
def series_folder(out: Path) -> Generator[None]:
    """Make the folder of a series, or go on with one; nobody else writes there meanwhile.

    Raises
    ------
    FileError
        If something else stands there, it cannot be written, or another process is at work on it.
    """
    if not (out / NOTES).is_dir():
        if out.exists():
            if out.is_dir() and (out / "run.toml").is_file():
                raise FileError(f"{out} is a run. Give the series a folder of its own with --out.")
            refuse_existing(out)
        with writing(out):
            (out / NOTES).mkdir(parents=True)
    with writing(out):
        lock = acquire_lock(out / NOTES / "lock", out)
    try:
        yield
    finally:
        lock.release()
