"""How many threads may be used: one setting, which every pool of planish asks.

No result depends on it.
"""

import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Item = TypeVar("Item")
MOST = 8  # threads that are used at most where no number is given: more of them wait for the memory
_ENVIRONMENT_VARIABLES = (
    "TIFFFILE_NUM_THREADS",
    "TIFFFILE_NUM_IOTHREADS",
    "ZARR_THREADING__MAX_WORKERS",
    "ZARR_ASYNC__CONCURRENCY",
)
_limits: list[int] = []


@contextmanager
def limit_threads(number: int | None) -> Generator[int]:
    """Limit all pools, also of libraries, to ``number`` threads.

    None, unless set: :func:`available`, at most 8.
    """
    count = count_threads(number)
    _limits.append(count)
    try:
        with _limited_libraries(count):
            yield count
    finally:
        _limits.pop()


def count_threads(number: int | None = None) -> int:
    """Return how many threads may run.

    ``number``, or what :func:`limit_threads` set, or what is available.
    """
    if number is not None:
        return max(1, number)
    if _limits:
        return _limits[-1]
    return min(available(), MOST)


@contextmanager
def thread_pool(number: int | None = None) -> Generator[Executor]:
    """Give an executor of :func:`count_threads` threads.

    For one, an executor that works in the calling thread.
    """
    count = count_threads(number)
    pool = ThreadPoolExecutor(count) if count > 1 else _CallingThread()
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def map_threads(
    work: Callable[..., T], *items: Iterable[Any], number: int | None = None
) -> list[T]:
    """Call ``work`` on every item and return what it gives, in order."""
    with thread_pool(number) as pool:
        return list(pool.map(work, *items))


def read_ahead(read: Callable[[Item], T], items: Iterable[Item]) -> Iterator[T]:
    """Give what ``read`` gives of each item, in order.

    The next one is read while the caller works on one.
    """
    with thread_pool() as pool:
        coming: list[Future[T]] = []
        for item in items:
            coming.append(pool.submit(read, item))
            if len(coming) > 1:
                yield coming.pop(0).result()
        yield from (future.result() for future in coming)


def available() -> int:
    """Processors that this process may use.

    ``PYTHON_CPU_COUNT`` if it is set; else those of its affinity (``taskset``), and no more than
    its control group's share of time (containers, batch systems).
    """
    setting = os.environ.get("PYTHON_CPU_COUNT", "")
    if setting.isdigit() and int(setting) > 0:
        return int(setting)
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        count = len(os.sched_getaffinity(0))
    return max(1, min([count, *_quotas(Path("/proc/self/cgroup"), Path("/sys/fs/cgroup"))]))


def control_groups(
    controller: str, membership_file: Path, groups_folder: Path
) -> Iterator[tuple[Path, bool]]:
    """Folders of the control groups of the process, outwards (containers, batch systems).

    True for version 1.
    """
    try:
        lines = membership_file.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        if line.count(":") < 2:
            continue
        _, controllers, group_path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        roots = [groups_folder]
        if controllers:
            roots = [groups_folder / controller, groups_folder / controllers]
        # Inside a container the path may be the one outside: the group's own files then lie at the
        # top.
        folder = Path(group_path.lstrip("/"))
        for root in roots:
            for subfolder in (folder, *folder.parents):
                yield root / subfolder, bool(controllers)


def _quotas(membership_file: Path, groups_folder: Path) -> list[int]:
    """Processors whose time the control groups of the process may take, each rounded up."""
    quotas: list[int] = []
    for folder, is_version_1 in control_groups("cpu", membership_file, groups_folder):
        file_names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if is_version_1 else ("cpu.max",)
        files = [folder / name for name in file_names]
        with suppress(OSError, ValueError):  # not there, or "max"
            contents = [file.read_text(encoding="ascii", errors="replace") for file in files]
            limit, period = map(int, " ".join(contents).split())
            if limit > 0 and period > 0:
                quotas.append(-(-limit // period))
    return quotas


@contextmanager
def _limited_libraries(count: int) -> Generator[None]:
    """Limit the threads in which tifffile and zarr pack and unpack.

    Of those that are imported, and of those that will be.

    zarr keeps its pool once it has one, and a thread for its event loop whatever is asked for.
    """
    previous_values = {name: os.environ.get(name) for name in _ENVIRONMENT_VARIABLES}
    os.environ.update(dict.fromkeys(_ENVIRONMENT_VARIABLES, str(count)))
    tiff: Any = getattr(sys.modules.get("tifffile"), "TIFF", None)
    if tiff is not None:
        tiff.MAXWORKERS = tiff.MAXIOWORKERS = count
    config: Any = getattr(sys.modules.get("zarr"), "config", None)
    try:
        with (
            config.set({"threading.max_workers": count, "async.concurrency": count})
            if config
            else nullcontext()
        ):
            yield
    finally:
        for name, value in previous_values.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _CallingThread(Executor):
    """An executor that does the work where it is handed in."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  # it is raised where the result is asked for
            future.set_exception(error)
        return future

    def map(self, fn: Callable[..., T], *iterables: Iterable[Any], **_: Any) -> Iterator[T]:
        return map(fn, *iterables)
