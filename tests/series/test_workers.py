"""Jobs on workers: all busy, lost ones once more, late ones waited for."""

from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from planish.run import Compute, Study
from planish.series import jobs, workers


class Death(Exception):
    """A worker ended."""


class Workers:
    """Does jobs at once; those of a name that is doomed die so many times."""

    deaths = (Death,)
    tries = 2

    def __init__(self, at_once, **doomed):
        self.at_once, self.doomed, self.begun = at_once, doomed, list[str]()

    def start(self, job):
        self.begun.append(job.name)
        future: Future[jobs.Note] = Future()
        if self.doomed.get(job.name, 0):
            self.doomed[job.name] -= 1
            future.set_exception(Death())
        else:
            future.set_result(job.note.model_copy(update={"state": "whole", "seconds": 1.0}))
        return future

    def forget(self, future):
        assert future.exception() is not None


STUDY = Study.model_validate({"layers": [{"name": "sheet", "volume": {"path": "v.tif"}}]})


def job(name):
    return jobs.Job(
        name=name, study=STUDY, folder=Path(name), compute=Compute(), note=jobs.Note(key=name)
    )


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_every_job_has_one_outcome(at_once, monkeypatch):
    monkeypatch.setattr(workers, "_PAUSE", 0.001)
    slow: Iterator[jobs.Job | None] = iter(
        [job("a"), None, job("b"), None, None, job("c"), job("d")]
    )
    pool = Workers(at_once, b=1, d=5)
    found = [(one.name, outcome.state) for one, outcome in workers._run_jobs(slow, pool)]
    assert sorted(found) == [("a", "whole"), ("b", "whole"), ("c", "whole"), ("d", "damaged")]
    assert sorted(pool.begun) == ["a", "b", "b", "c", "d", "d"]


def test_jobs_are_taken_as_there_is_room():
    taken: list[str] = []

    def coming():
        for name in "abc":
            taken.append(name)
            yield job(name)

    done = workers._run_jobs(coming(), Workers(1))
    next(done)
    assert taken == ["a"]
