"""CPU time of tests: what a test uses itself, what it shares with others, and how quick the machine
is."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager


class SharedWork:
    """CPU seconds of what several tests share: their fixtures, and kernels that are compiled or
    read from the cache."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0

    @contextmanager
    def within(self) -> Iterator[None]:
        """Count what is done within; shared work within shared work counts once."""
        self._depth += 1
        before = cpu_seconds()
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                self.seconds += cpu_seconds() - before


SHARED = SharedWork()


def cpu_seconds() -> float:
    """CPU time of this process, all its threads, and its children that ended."""
    return sum(os.times()[:4])


def loop_seconds() -> float:
    """CPU seconds of a plain loop, which says how quick this machine is now."""
    start = time.process_time()
    total = 0
    for i in range(3_000_000):
        total += i * i
    return time.process_time() - start
