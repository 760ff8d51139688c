"""One specimen of a series: whether it is done already, how it is done, and what became of it."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from planish.compute import Compute, run_key
from planish.core.errors import PlanishError, ResourceError
from planish.core.facts import Facts
from planish.core.files import write_whole
from planish.core.series_results import Member, MemberState
from planish.io import find_place, fingerprint
from planish.io.hashes import files_of
from planish.io.run_folder import sweep
from planish.pipeline.run import is_run, open_results
from planish.pipeline.save import run_study
from planish.series.plan import Plan, Specimen
from planish.study import RUN_TOML, Study, in_study_words, to_dict, with_paths

RUNS = "runs"
"""Folder of the runs within that of the series."""

NOTES = ".series"
"""Hidden folder of what is remembered of each specimen."""
_KILLED = (
    "Its process ended without a word, most likely because the memory was used up. Give fewer --jobs or a limit "
    "(--memory), and give the same command again."
)


class Note(Facts):
    """What is remembered of a specimen beside its run: what was asked for, and why there is no run."""

    key: str
    stamps: dict[str, str] = Field(default_factory=dict[str, str])  # an input that kept its is not hashed again
    hashes: dict[str, str] = Field(default_factory=dict[str, str])
    state: MemberState = "open"
    message: str = ""
    seconds: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A specimen that is still to be done; it can be sent to another process."""

    name: str
    study: Study
    folder: Path
    compute: Compute
    note: Note


class Outcome(Facts):
    """What became of a job."""

    state: MemberState
    message: str = ""
    seconds: float | None = None


class Book:
    """What is done of a series, kept in its folder specimen by specimen."""

    def __init__(self, home: Path, plan: Plan) -> None:
        self.home, self.plan = home, plan
        self._taken = {specimen.name.casefold() for specimen in plan.specimens}

    def open(self, specimen: Specimen, compute: Compute) -> Job | Member:
        """As :meth:`look`; a job is noted down."""
        found = self.look(specimen, compute)
        if isinstance(found, Job):
            self._write(found.folder, found.note)
        return found

    def look(self, specimen: Specimen, compute: Compute) -> Job | Member:
        """What is to be done for a specimen; what became of it where it is done, or cannot be begun.

        A specimen that was refused with the same files and options is not tried again. One that failed for want of
        memory or disk is.
        """
        try:
            study = self.plan.study(specimen)
            key, stamps, hashes = self._key(study, specimen)
        except PlanishError as error:
            return _member(specimen, state=_state_of(error), message=in_study_words(error.text))
        folder, note = self._place(specimen, key)
        if is_run(folder):
            return self.member(specimen, folder)
        if note is not None and note.state == "refused":
            return _member(specimen, state=note.state, message=note.message)
        noted = Note(key=key, stamps=stamps, hashes=hashes)
        return Job(name=specimen.name, study=study, folder=folder, compute=compute, note=noted)

    def close(self, specimen: Specimen, job: Job, outcome: Outcome) -> Member:
        """Remember what became of a job."""
        # The same words wherever the series stands.
        outcome = outcome.model_copy(update={"message": outcome.message.replace(f"{self.home}{os.sep}", "")})
        self._write(job.folder, job.note.model_copy(update=outcome.model_dump()))
        if is_run(job.folder):
            return self.member(specimen, job.folder)
        return _member(specimen, state=outcome.state, message=outcome.message)

    def member(self, specimen: Specimen, folder: Path) -> Member:
        """A specimen with its run, as its results judge it."""
        run = folder.relative_to(self.home).as_posix()
        sweep(folder)
        try:
            results = open_results(folder)
        except PlanishError as error:
            return _member(specimen, state="damaged", message=f"{error.text} Remove {run} to have it done again.")
        failed = results.spoken("fail")
        message = " ".join(f"{check.name}: {check.sentence} {check.advice}".rstrip() for check in failed)
        return _member(specimen, state="withheld" if failed else "whole", message=message, run=run)

    def seconds(self) -> list[float]:
        """What links of this series took."""
        notes = [self._note(Path(path.stem)) for path in sorted((self.home / NOTES).glob("*.json"))]
        return [note.seconds for note in notes if note and note.seconds and note.state in ("whole", "withheld")]

    def _place(self, specimen: Specimen, key: str) -> tuple[Path, Note | None]:
        """The folder of a specimen with these files and options; another where there is a run with other ones."""
        k = 1
        while True:
            name = specimen.name if k == 1 else f"{specimen.name}-{k}"
            folder = self.home / RUNS / name
            note = self._note(folder)
            free = k == 1 or name.casefold() not in self._taken
            if free and (not folder.exists() or (note is not None and note.key == key)):
                return folder, note if note is not None and note.key == key else None
            k += 1

    def _key(self, study: Study, specimen: Specimen) -> tuple[str, dict[str, str], dict[str, str]]:
        """What tells whether a run may be taken again, wherever the series was moved to."""
        paths: list[str] = []

        def without(path: str) -> str:
            paths.append(path)
            return find_place(path).name

        asked = to_dict(with_paths(study, without))
        before = self._note(self.home / RUNS / specimen.name)
        stamps = {str(k): stamp_of(Path(path)) for k, path in enumerate(paths)}
        known = {} if before is None else before.hashes
        hashes = {
            k: known[k] if before is not None and before.stamps.get(k) == stamp and k in known else _hash(Path(path))
            for (k, stamp), path in zip(stamps.items(), paths, strict=True)
        }
        return run_key(asked, list(hashes.values())), stamps, hashes

    def _note(self, folder: Path) -> Note | None:
        with suppress(OSError, ValidationError):
            return Note.model_validate_json((self.home / NOTES / f"{folder.name}.json").read_bytes())
        return None

    def _write(self, folder: Path, note: Note) -> None:
        path = self.home / NOTES / f"{folder.name}.json"
        path.parent.mkdir(exist_ok=True)
        write_whole(path, json.dumps(note.model_dump(), indent=1).encode(), over=True)


def do(job: Job) -> Outcome:
    """Link the layers of a specimen, or map its volume; whatever goes wrong is an outcome, too."""
    begin = time.perf_counter()

    def outcome(state: MemberState, message: str = "") -> Outcome:
        return Outcome(state=state, message=message, seconds=round(time.perf_counter() - begin, 1))

    try:
        if is_run(job.folder):  # of a worker that was lost when all was written
            return outcome("whole")
        run = run_study(job.study, job.folder, compute=job.compute)
    except PlanishError as error:
        return outcome(_state_of(error), in_study_words(error.text))
    except MemoryError:
        return outcome("damaged", "The memory is used up. Give fewer --jobs, or more --memory.")
    except Exception as error:  # noqa: BLE001  one specimen stops no other
        return outcome("damaged", f"A fault of planish: {type(error).__name__}: {error}. Please report it.")
    return outcome("whole" if run.passed else "withheld")


def killed() -> Outcome:
    """Outcome of a job whose process ended again and again."""
    return Outcome(state="damaged", message=_KILLED)


def _member(specimen: Specimen, **values: Any) -> Member:
    return specimen.member.model_copy(update=values)


def _state_of(error: PlanishError) -> MemberState:
    return "damaged" if isinstance(error, ResourceError) else "refused"


def _hash(path: Path) -> str:
    """Hash of an input; what is wrong with it is said by its own reader."""
    try:
        return fingerprint(path / "results.json" if (path / RUN_TOML).is_file() else path)
    except PlanishError:
        return ""


def stamp_of(path: Path) -> str:
    """Number, size and times of change of the files of an input, those that its headers name among them."""
    files = list(path.rglob("*")) if path.is_dir() else [path]
    if not path.is_dir():
        with suppress(PlanishError):  # a header whose values are not there yet is a file like another one
            place = find_place(path)
            files = [place.path]
            files = files_of(place)
    count = size = changed = 0
    for file in files:
        with suppress(OSError):
            stat = file.stat()
            count, size, changed = count + 1, size + stat.st_size, changed + stat.st_mtime_ns
    return f"{count} {size} {changed}"
