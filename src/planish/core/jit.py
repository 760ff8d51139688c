"""Kernels compiled by numba, whose code is kept in a folder for caches: beside the program it would outlive it."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import numba
from numba.core import config
from numba.misc.appdirs import AppDirs

from planish.core.source_hash import PACKAGE, hash_sources

_CONFIG: Any = config  # its names are made when it is imported
_LOCK = Lock()  # they are those of all threads


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as ``numba.njit`` does; its code is kept in :func:`cache_folder`."""

    def compiled(function: Callable[..., Any]) -> Any:
        with _LOCK:
            previous_folder = _CONFIG.CACHE_DIR
            _CONFIG.CACHE_DIR = cache_folder(previous_folder)
            try:
                return numba.njit(**options)(function)
            finally:
                _CONFIG.CACHE_DIR = previous_folder

    return compiled


@cache
def cache_folder(numba_dir: str) -> str:
    """Give the folder for code of this installation, in NUMBA_CACHE_DIR (``numba_dir``) or the user's cache folder.

    It is another where the sources of the kernels are others: numba sees a change of a kernel's own file, but not of
    those that the kernel calls. Where no folder can be written, it is ``numba_dir``, and numba looks for one itself.
    """
    installation_prefix = f"planish-{hashlib.sha256(os.fsencode(PACKAGE)).hexdigest()[:16]}-"
    user_folder = Path(AppDirs("numba", appauthor=False).user_cache_dir)
    # The user's folder is relative where there is no home.
    base_folders = [*([Path(numba_dir)] if numba_dir else []), *([user_folder] if user_folder.is_absolute() else [])]
    for base_folder in base_folders:
        folder = base_folder / f"{installation_prefix}{hash_sources('_*kernels.py')}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        for older_folder in base_folder.glob(f"{installation_prefix}*"):
            if older_folder != folder:
                shutil.rmtree(older_folder, ignore_errors=True)
        return str(folder)
    return numba_dir
