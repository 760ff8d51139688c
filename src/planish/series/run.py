"""A series from its plan to its runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from planish.compute import Compute
from planish.core.series_results import Member
from planish.core.threads import count_threads
from planish.series.jobs import Book, Job
from planish.series.plan import Plan, Specimen
from planish.series.workers import outcomes

Tell = Callable[[Member, float | None], None]
"""Called with each specimen that is done, and the seconds that it took; None where it was done before."""


def run_series(
    plan: Plan, out: Path, *, compute: Compute, jobs: int = 1, tell: Tell, members: dict[str, Member],
    coming: Iterable[Specimen | None] | None = None,
) -> None:  # fmt: skip
    """Do all specimens of a series that are not done, each into ``out/runs/NAME``.

    Parameters
    ----------
    plan : Plan
    out : Path
        Folder of the series, which exists.
    compute : Compute
        Memory and threads are shared out among the jobs; with a scheduler, whole specimens go to its workers.
    jobs : int
        Specimens at a time.
    tell : callable
        Called as each specimen is done.
    members : dict
        Filled as specimens come in and are done, so that it can be read after an interrupt, too.
    coming : iterable of Specimen or None, optional
        Specimens instead of those of the plan, as they appear; None for none as yet.

    Raises
    ------
    PlanishError
        If the folder cannot be written or the scheduler is lost; not for what is wrong with a specimen.
    """
    book, of = Book(out, plan), dict[str, Specimen]()
    own = share(compute, jobs)

    def opened() -> Iterator[Job | None]:
        for specimen in plan.specimens if coming is None else coming:
            if specimen is None:
                yield None
                continue
            of[specimen.name] = specimen
            found = book.open(specimen, own)
            if isinstance(found, Job):
                members[specimen.name] = specimen.member
                yield found
            else:
                members[specimen.name] = found
                tell(found, None)

    for job, outcome in outcomes(opened(), compute, jobs):
        members[job.name] = book.close(of[job.name], job, outcome)
        tell(members[job.name], outcome.seconds)


def share(compute: Compute, jobs: int) -> Compute:
    """What one job may use: on a cluster one thread, since the scheduler counts threads."""
    if compute.scheduler is not None:
        return compute.model_copy(update={"scheduler": None, "threads": compute.threads or 1})
    if jobs == 1:
        return compute
    threads = compute.threads or max(1, count_threads(None) // jobs)
    return compute.model_copy(update={"memory_bytes": compute.memory // jobs, "threads": threads})
