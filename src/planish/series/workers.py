"""A plan's jobs on processes of this computer or on a cluster.

A process that dies takes no other job with it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from planish.core.threads import count_threads
from planish.run.compute import Compute, engine
from planish.series.jobs import KILLED, Job, Note, SeriesState, do
from planish.series.plan import Plan, PlannedSpecimen
from planish.series_results import Member

# Called with each specimen that is done, and the seconds that it took; None where it was done
# before
Tell = Callable[[Member, float | None], None]
_PAUSE = 1.0  # seconds until it is asked again whether there is more to do
_END: Final = object()


def run_series(
    plan: Plan,
    out: Path,
    *,
    compute: Compute,
    jobs: int = 1,
    tell: Tell,
    members: dict[str, Member],
    coming: Iterable[PlannedSpecimen | None] | None = None,
) -> None:
    """Do all specimens of a series that are not done, each into ``out/runs/NAME``; ``out`` exists.

    Memory and threads are shared out among ``jobs`` specimens at a time; with a scheduler, whole
    specimens go to its workers. ``members`` is filled as specimens come in and are done, so that it
    can be read after an interrupt, too. ``coming`` gives specimens instead of those of the plan, as
    they appear; None for none as yet. What is wrong with a specimen raises nothing; a folder that
    cannot be written, or a scheduler that is lost, does.
    """
    state = SeriesState(out, plan)
    specimens: dict[str, PlannedSpecimen] = {}
    job_compute = _compute_of_job(compute, jobs)

    def open_jobs() -> Iterator[Job | None]:
        """Jobs of the specimens as they come; those that are done already are told at once."""
        for specimen in plan.specimens if coming is None else coming:
            if specimen is None:
                yield None
                continue
            specimens[specimen.name] = specimen
            job = state.open(specimen, job_compute)
            members[specimen.name] = specimen.member if isinstance(job, Job) else job
            if isinstance(job, Job):
                yield job
            else:
                tell(job, None)

    with _workers(compute, jobs) as workers:
        for job, note in _run_jobs(open_jobs(), workers):
            members[job.name] = state.close(specimens[job.name], job, note)
            tell(members[job.name], note.seconds)


def _compute_of_job(compute: Compute, jobs: int) -> Compute:
    """What one of ``jobs`` jobs at a time may use."""
    if compute.scheduler is not None:  # one thread, since the scheduler counts threads
        changes = {"scheduler": None, "threads": compute.threads or 1}
    elif jobs > 1:
        threads = compute.threads or max(1, count_threads(None) // jobs)
        changes = {"memory_bytes": compute.memory // jobs, "threads": threads}
    else:
        return compute
    return compute.model_copy(update=changes)


@contextmanager
def _workers(compute: Compute, jobs: int) -> Generator[_Cluster | _Processes]:
    """Workers of the scheduler, or as many processes as jobs; the latter end with the context."""
    if compute.scheduler is not None:
        with engine(compute) as cluster:
            assert cluster.executor is not None
            yield _Cluster(cluster.executor, cluster.at_once)
        return
    processes = _Processes(jobs)
    try:
        yield processes
    finally:
        processes.stop()


def _run_jobs(
    jobs: Iterator[Job | None], workers: _Cluster | _Processes
) -> Generator[tuple[Job, Note]]:
    """Keep all workers busy with jobs, taken as there is room (None: none as yet).

    Give outcomes as they come. A job whose process was lost is tried as often as the workers say,
    and then noted as killed.
    """
    running: dict[Future[Note], Job] = {}
    tries: Counter[str] = Counter()
    retries: deque[Job] = deque()
    while True:
        # The last thing that came: a job, None, or _END where there are no more jobs.
        coming = _END
        while len(running) < workers.at_once:
            coming = retries.popleft() if retries else next(jobs, _END)
            if not isinstance(coming, Job):
                break
            running[workers.start(coming)] = coming
        if not running:
            if coming is _END:
                return
            time.sleep(_PAUSE)
        for job, note in _ended(running, workers, is_idle=coming is None):
            tries[job.name] += 1
            if note is not None:
                yield job, note
            elif tries[job.name] < workers.tries:
                retries.append(job)
            else:
                yield job, job.note.model_copy(update=KILLED)


def _ended(
    running: dict[Future[Note], Job], workers: _Cluster | _Processes, *, is_idle: bool
) -> Iterator[tuple[Job, Note | None]]:
    """Jobs that end, taken off those that run; without a note where one was lost.

    At least one is waited for. With an idle worker that is not for long: there may be more to do.
    """
    timeout_s = _PAUSE if is_idle else None
    finished, _ = wait(running, timeout=timeout_s, return_when=FIRST_COMPLETED)
    for future in finished:
        note = None
        try:
            note = future.result()
        except workers.deaths:
            workers.forget(future)
        yield running.pop(future), note


class _Cluster:
    """Workers of a dask scheduler, so many jobs at a time as these have threads.

    It tries lost jobs again itself.
    """

    tries = 1

    def __init__(self, executor: Executor, at_once: int) -> None:
        from distributed import KilledWorker

        self._executor = executor
        self.at_once = at_once
        self.deaths: tuple[type[BaseException], ...] = (KilledWorker,)

    def start(self, job: Job) -> Future[Note]:
        return self._executor.submit(do, job)

    def forget(self, future: Future[Note]) -> None:
        """Nothing: the scheduler starts no worker."""


class _Processes:
    """Processes of this computer, each doing job after job.

    Another takes its place where one ends.
    """

    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    tries = 2

    def __init__(self, at_once: int) -> None:
        self.at_once = at_once
        self._free: list[ProcessPoolExecutor] = []
        self._used: dict[Future[Note], ProcessPoolExecutor] = {}

    def start(self, job: Job) -> Future[Note]:
        """Begin a job in a process that is free, or in a new one."""
        # A process is free again when its job is done.
        self._free += [self._used.pop(future) for future in [*self._used] if future.done()]
        # Never by fork: threads of numerical libraries do not survive it, and Windows has none.
        spawn_context = multiprocessing.get_context("spawn")
        while True:
            if self._free:
                pool = self._free.pop()
            else:
                pool = ProcessPoolExecutor(1, mp_context=spawn_context, initializer=_begin)
            with suppress(BrokenProcessPool):  # it ended while it had nothing to do
                future = pool.submit(do, job)
                self._used[future] = pool
                return future

    def forget(self, future: Future[Note]) -> None:
        self._used.pop(future).shutdown(wait=False)

    def stop(self) -> None:
        """End all: idle ones by themselves.

        Busy ones leave their job, which goes on from there the next time.
        """
        for future, pool in self._used.items():
            if not future.done():
                for process in list((pool._processes or {}).values()):  # pyright: ignore[reportPrivateUsage]
                    process.terminate()
        for pool in (*self._free, *self._used.values()):
            pool.shutdown(wait=False, cancel_futures=True)


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one, and end where that is gone.

    Nobody waits any more then.

    Terminated, a process leaves its job as a single run does at Ctrl-C, and its libraries give
    their locks back.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
