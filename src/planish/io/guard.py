"""Guard the border to the decoders.

Their failures become one error, and nothing larger than the memory is asked for.
"""

import ctypes
import logging
import os
import stat
import threading
import warnings
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any

from planish.core.errors import FileError, PlanishError, ResourceError
from planish.core.files import check_exists
from planish.core.memory import FREE_SHARE, UNKNOWN_BYTES
from planish.core.threads import control_groups

RECALL_ON_DATA_ACCESS = 0x400000  # of winnt.h, which the module stat does not name


class _Quiet:
    """Keep other libraries' log lines and warnings away from the user while any thread is reading.

    Filters of warnings and switches of loggers belong to the whole process. Threads that set and
    reset them in turn would leave them as another thread had found them, so the first one in sets
    them and the last one out resets them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._undo = ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside > 1:
                return
            self._undo.enter_context(warnings.catch_warnings())
            warnings.simplefilter("ignore")
            for name in ("tifffile", "SurfaceTopography", "PIL", "h5py"):
                log = logging.getLogger(name)
                self._undo.callback(setattr, log, "disabled", log.disabled)
                log.disabled = True

    def __exit__(self, *_raised: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._undo.close()


quiet = _Quiet()


@contextmanager
def reading(path: Path) -> Generator[None]:
    """Turn whatever a decoder raises into one FileError, and silence its log lines and warnings."""
    try:
        with quiet:
            yield
    except PlanishError:
        raise
    except MemoryError as error:
        raise ResourceError(
            f"{path.name} does not fit into the memory. Crop or bin it, or add memory."
        ) from error
    except PermissionError as error:
        raise FileError(
            f"{path.name} may not be read. Give yourself the right to read it."
        ) from error
    except OSError as error:
        if not _is_in_cloud(path):
            raise _undecodable(path, error) from error
        raise FileError(
            f"{path.name} is in a cloud and not on this computer. Download it first: right-click,"
            " Always keep on this device."
        ) from error
    except Exception as error:  # broken files make the decoders raise almost every type there is
        raise _undecodable(path, error) from error


def reason_of(error: Exception) -> str:
    """What an error of another library says, in short: some hold the whole file."""
    return " ".join(str(error).split())[:160] or type(error).__name__


def _undecodable(path: Path, error: Exception) -> FileError:
    return FileError(
        f"{path.name} cannot be decoded ({reason_of(error)}). It is damaged or of a rare kind: copy"
        " or export it again."
    )


def _is_in_cloud(path: Path) -> bool:
    """True for a placeholder of a file that Windows has to fetch from a server."""
    with suppress(OSError):
        marks = getattr(path.stat(), "st_file_attributes", 0)
        return bool(marks & (stat.FILE_ATTRIBUTE_OFFLINE | RECALL_ON_DATA_ACCESS))
    return False


def size_of_file(path: Path) -> int:
    """Bytes of a file that is there and not empty."""
    check_exists(path)
    if not path.is_file():
        raise FileError(f"{path.name} is not a file. Give one image file.")
    with reading(path):
        size = path.stat().st_size
    if size == 0:
        raise FileError(f"{path.name} is empty (0 bytes). Copy or export it again.")
    return size


@contextmanager
def open_bytes(path: Path) -> Generator[BufferedReader]:
    """Open a file that is there and not empty; what decoders raise becomes a FileError."""
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        yield file


def head_of(path: Path, most: int) -> bytes:
    """First bytes of a file that is there and not empty."""
    with open_bytes(path) as file:
        return file.read(most)


def check_blown_up(path: Path, *, decoded_bytes: int, stored_bytes: int) -> None:
    """Refuse compressed data that claim far more than so few bytes can hold."""
    # Deflate ends at 1032, LZW at about 1400, noisy scans far below. Small images do no harm:
    # constant ones pass.
    if decoded_bytes > 16 * 2**20 and decoded_bytes > 2000 * stored_bytes:
        raise FileError(
            f"{path.name} claims {decoded_bytes} bytes of image in {stored_bytes} stored bytes,"
            " more than 2000 to 1. It is damaged: copy or export it again."
        )


def check_memory(path: Path, *, needed_bytes: int, limit_bytes: int | None) -> None:
    """Refuse what does not fit into the memory before it is asked for."""
    limit = memory_limit(limit_bytes)
    if needed_bytes > limit:
        raise ResourceError(
            f"{path.name} needs {needed_bytes / 2**30:.3g} GiB of memory, {limit / 2**30:.3g} GiB"
            " may be used. Crop or bin it, or store a volume uncompressed as one BigTIFF, which is"
            " read in place."
        )


def memory_limit(limit_bytes: int | None) -> int:
    """Bytes that one file may fill where no limit is given."""
    return default_memory_limit() if limit_bytes is None else limit_bytes


def default_memory_limit() -> int:
    """Bytes that one file may fill: three quarters of the memory that is free, or can be freed."""
    available_bytes = 0
    with suppress(OSError):
        meminfo = Path("/proc/meminfo").read_text(encoding="ascii", errors="replace")
        for line in meminfo.splitlines():
            if line.startswith("MemAvailable:"):
                available_bytes = int(line.split()[1]) * 1024
    if not available_bytes and os.name == "nt":
        available_bytes = _available_on_windows(getattr(ctypes, "windll").kernel32)  # noqa: B009
    if not available_bytes:
        try:
            available_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        except (AttributeError, ValueError, OSError):
            available_bytes = UNKNOWN_BYTES
    return int(FREE_SHARE * min(available_bytes, _control_group_limit_bytes()))


class _MemoryStatus(ctypes.Structure):
    """MEMORYSTATUSEX of sysinfoapi.h."""

    _fields_ = (
        ("length", ctypes.c_uint32),
        ("load", ctypes.c_uint32),
        *(
            (name, ctypes.c_uint64)
            for name in ("all", "available", "all_page", "page", "all_own", "own", "extended")
        ),
    )


def _available_on_windows(kernel: Any) -> int:
    status = _MemoryStatus(length=ctypes.sizeof(_MemoryStatus))
    available_bytes = kernel.GlobalMemoryStatusEx(ctypes.byref(status)) and int(status.available)
    return available_bytes or UNKNOWN_BYTES


def _control_group_limit_bytes(
    membership_file: Path = Path("/proc/self/cgroup"), groups_folder: Path = Path("/sys/fs/cgroup")
) -> int:
    """Least memory limit of the control groups of the process (containers, batch systems).

    A huge number if none.
    """
    limits = [2**62]
    folders = [(groups_folder, False), (groups_folder / "memory", True)]
    folders += control_groups("memory", membership_file, groups_folder)
    for folder, is_version_1 in folders:
        with suppress(OSError):
            name = "memory.limit_in_bytes" if is_version_1 else "memory.max"
            text = (folder / name).read_text(encoding="ascii", errors="replace").strip()
            if text.isdigit():
                limits.append(int(text))
    return min(limits)
