"""Kernels compiled by numba.

Their code is kept apart from the program, where all environments of a machine find it.
"""

import os
import shutil
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, cast

import numba
import numpy as np
from numba.core import caching, config
from numba.misc.appdirs import AppDirs

from planish.core.source_hash import PACKAGE, hash_sources

_CONFIG: Any = config  # its names are made when it is imported
_UNUSED_SECONDS = 30 * 86400.0  # code of other sources is removed after so long
njit: Any = numba.njit


class Locator:
    """Tells numba where the code of a function of this package lies."""

    def __init__(self, folder: str, function: Any, file: Path) -> None:
        self.folder = Path(folder) / ".".join(file.parent.parts)
        self.line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, file: str) -> "Locator | None":
        """Give the place.

        None for functions of others, and where no folder can be written: numba finds one.
        """
        path = Path(file).resolve()
        if not path.is_relative_to(PACKAGE) or not (folder := cache_folder(_CONFIG.CACHE_DIR)):
            return None
        return cls(folder, function, path.relative_to(PACKAGE))

    def ensure_cache_path(self) -> None:
        """Make the folder, before something is written into it."""
        self.folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Folder of the files of a function."""
        return str(self.folder)

    def get_source_stamp(self) -> str:
        """Nothing: code of other sources lies in another folder."""
        return ""

    def get_disambiguator(self) -> str:
        """Part of the name of its files."""
        return str(self.line)


@cache
def cache_folder(numba_dir: str) -> str:
    """Give the folder for code of these sources.

    It lies in NUMBA_CACHE_DIR (``numba_dir``) or the user's cache folder.

    numba would see a change of a kernel's own file, but not of those that it calls. Empty where
    none can be written.
    """
    user_folder = Path(AppDirs("numba", appauthor=False).user_cache_dir)
    base_folders = [Path(numba_dir)] if numba_dir else []
    if user_folder.is_absolute():  # it is not where there is no home
        base_folders.append(user_folder)
    for base_folder in base_folders:
        kernels_hash = hash_sources("_*kernels.py")
        folder = base_folder / f"planish-{kernels_hash}-{numba.__version__}-{np.__version__}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            os.utime(folder)
        except OSError:
            continue
        # Folders of other sources, 16 digits of their hash in the name.
        for other_folder in base_folder.glob(f"planish-{16 * '[0-9a-f]'}-*"):
            with suppress(OSError):  # another process removes it, too
                if time.time() - other_folder.stat().st_mtime > _UNUSED_SECONDS:
                    shutil.rmtree(other_folder, ignore_errors=True)
        return str(folder)
    return ""


cast("Any", caching.CacheImpl)._locator_classes.insert(0, Locator)  # they are asked in turn
