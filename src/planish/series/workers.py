"""Jobs of a series on processes of this computer or on a cluster: a process that dies takes no other job with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Final

from planish.compute import Compute, engine
from planish.series.jobs import Job, Outcome, do, killed

_PAUSE = 1.0  # seconds until it is asked again whether there is more to do
_END: Final = object()


def outcomes(jobs: Iterable[Job | None], compute: Compute, at_once: int) -> Generator[tuple[Job, Outcome]]:
    """Give each job with its outcome as it is done.

    Parameters
    ----------
    jobs : iterable of Job or None
        Taken one by one as there is room, so they may come in while others are worked on; None for none as yet.
    compute : Compute
        With a ``scheduler``, whole jobs go to its workers, which need to see the same folders; else to processes.
    at_once : int
        Processes of this computer.

    Raises
    ------
    InputError, ResourceError
        If no scheduler answers, or it is lost.
    """
    waiting = iter(jobs)
    if compute.scheduler is not None:
        with engine(compute) as cluster:
            assert cluster.executor is not None
            yield from _worked(waiting, _Cluster(cluster.executor, cluster.at_once))
        return
    processes = _Processes(at_once)
    try:
        yield from _worked(waiting, processes)
    finally:
        processes.stop()


def _worked(waiting: Iterator[Job | None], workers: _Cluster | _Processes) -> Generator[tuple[Job, Outcome]]:
    """Keep all workers busy; give outcomes in the order in which they come."""
    busy: dict[Future[Outcome], Job] = {}
    tries: Counter[str] = Counter()
    again: deque[Job] = deque()
    more = True
    while more or busy or again:
        idle = False
        while len(busy) < workers.at_once and (more or again) and not idle:
            job = again.popleft() if again else next(waiting, _END)
            if isinstance(job, Job):
                busy[workers.start(job)] = job
            else:
                more, idle = more and job is None, job is None
        if not busy:
            if idle:
                time.sleep(_PAUSE)
            continue
        done, _ = wait(busy, timeout=_PAUSE if idle else None, return_when=FIRST_COMPLETED)
        for future in done:
            job = busy.pop(future)
            try:
                found = future.result()
            except workers.deaths:
                tries[job.name] += 1
                workers.forget(future)
                if tries[job.name] < workers.tries:
                    again.append(job)
                    continue
                found = killed()
            yield job, found


class _Cluster:
    """Workers of a dask scheduler, so many jobs at a time as these have threads. It tries lost jobs again itself."""

    tries = 1

    def __init__(self, executor: Executor, at_once: int) -> None:
        from distributed import KilledWorker

        self._executor, self.at_once = executor, at_once
        self.deaths: tuple[type[BaseException], ...] = (KilledWorker,)

    def start(self, job: Job) -> Future[Outcome]:
        return self._executor.submit(do, job)

    def forget(self, future: Future[Outcome]) -> None:
        """Nothing: the scheduler starts no worker."""


class _Processes:
    """Processes of this computer, each doing job after job; another takes its place where one ends."""

    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    tries = 2

    def __init__(self, at_once: int) -> None:
        self.at_once = at_once
        self._free: list[ProcessPoolExecutor] = []
        self._used: dict[Future[Outcome], ProcessPoolExecutor] = {}

    def start(self, job: Job) -> Future[Outcome]:
        done = [future for future in self._used if future.done()]
        self._free += [self._used.pop(future) for future in done]
        while self._free:
            pool = self._free.pop()
            try:
                future = pool.submit(do, job)
            except BrokenProcessPool:  # it ended while it had nothing to do
                continue
            self._used[future] = pool
            return future
        # Never by fork: threads of numerical libraries do not survive it, and Windows has none.
        pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)
        future = pool.submit(do, job)
        self._used[future] = pool
        return future

    def forget(self, future: Future[Outcome]) -> None:
        self._used.pop(future).shutdown(wait=False)

    def stop(self) -> None:
        """End all: idle ones by themselves; busy ones leave their job, which goes on from there the next time."""
        for future, pool in self._used.items():
            if not future.done():
                for process in list((pool._processes or {}).values()):  # pyright: ignore[reportPrivateUsage]
                    process.terminate()
        for pool in (*self._free, *self._used.values()):
            pool.shutdown(wait=False, cancel_futures=True)


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one, and end where that is gone: nobody waits any more.

    Terminated, a process leaves its job as a single run does at Ctrl-C, and its libraries give their locks back.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
