"""One specimen of a series.

Whether it is done already, what it will take, how it is done, and what became of it.
"""

import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from statistics import median

from pydantic import Field, ValidationError

from planish.core.errors import FileError, PlanishError, ResourceError
from planish.core.facts import ResultModel
from planish.core.files import as_sentence, write_whole, writing
from planish.core.memory import PROGRAM_BYTES, bytes_to_hold
from planish.io import find_place
from planish.io.hashes import files_of
from planish.io.info import describe
from planish.io.run_folder import acquire_lock, refuse_existing, sweep
from planish.run.compute import Compute, run_key
from planish.run.pipeline import run_study
from planish.run.run import is_run, open_results
from planish.run.study import RUN_TOML, Study, in_study_words, to_dict, with_paths
from planish.run.workspace import hash_of_input
from planish.series.gather import as_judged
from planish.series.plan import Plan, PlannedSpecimen
from planish.series_results import Member, MemberState

RUNS = "runs"  # folder of the runs within that of the series
NOTES = ".series"  # hidden folder of what is remembered of each specimen

# Seconds, measured on two cores: links of 11 to 160 million voxels to .2 to 160 million pixels.
_START_S = 4.0
_PER_VOXEL_S = 0.2e-6
_PER_PIXEL_S = 2.5e-6
# Bytes
_PER_COLUMN = 150
_PER_PIXEL = 110


class Note(ResultModel):
    """What is remembered of a specimen beside its run.

    That is what was asked for, and why there is no run.
    """

    key: str
    # An input that kept its is not hashed again.
    stamps: dict[str, str] = Field(default_factory=dict[str, str])
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What one specimen will take; None where there is nothing to do."""

    words: str
    seconds: float | None = None
    memory_bytes: float = 0.0
    disk_bytes: float = 0.0


@contextmanager
def series_folder(out: Path) -> Generator[None]:
    """Make the folder of a series, or go on with one, and keep others out of it meanwhile.

    FileError where something else stands or works there.
    """
    if out.exists() and not (out / NOTES).is_dir():
        if (out / RUN_TOML).is_file():
            raise FileError(f"{out} is a run. Give the series a folder of its own with `out`.")
        refuse_existing(out)
    with writing(out):
        (out / NOTES).mkdir(parents=True, exist_ok=True)
        lock = acquire_lock(out / NOTES / "lock", out)
    try:
        yield
    finally:
        lock.release()


class SeriesState:
    """What is done of a series, kept in its folder specimen by specimen."""

    def __init__(self, home: Path, plan: Plan) -> None:
        self.home = home
        self.plan = plan
        self._reserved = {specimen.name.casefold() for specimen in plan.specimens}

    def open(self, specimen: PlannedSpecimen, compute: Compute) -> Job | Member:
        """As :meth:`look`; a job is noted down."""
        job = self.look(specimen, compute)
        if isinstance(job, Job):
            self._write(job.folder, job.note)
        return job

    def look(self, specimen: PlannedSpecimen, compute: Compute) -> Job | Member:
        """Give the job that is to be done for a specimen; nothing is written.

        Where it is done, or cannot be begun, the member says what became of it.

        One refused with the same files and options is not tried again; one that lacked memory or
        disk is.
        """
        try:
            study = self.plan.study(specimen)
            note = self._note_of(study, specimen)
        except PlanishError as error:
            return specimen.member.model_copy(update=_reason_of(error))
        folder, old_note = self._place_of(specimen, note)
        if is_run(folder):
            return self.member(specimen, folder)
        if old_note is not None and old_note.state == "refused":
            return _without_run(specimen, old_note)
        return Job(name=specimen.name, study=study, folder=folder, compute=compute, note=note)

    def _place_of(self, specimen: PlannedSpecimen, note: Note) -> tuple[Path, Note | None]:
        """Folder of a specimen's run, and what is noted of a run there with the same key.

        NAME, or NAME-2 and so on where an earlier run of something else, which has another key, has
        that name; None where nothing is noted yet.
        """
        name = specimen.name
        k = 1
        while True:
            folder = self.home / RUNS / name
            old_note = self._read(folder)
            if old_note is not None and old_note.key != note.key:
                old_note = None
            # NAME-2 may be what another specimen is called.
            is_free = name == specimen.name or name.casefold() not in self._reserved
            if is_free and (old_note is not None or not folder.exists()):
                return folder, old_note
            k += 1
            name = f"{specimen.name}-{k}"

    def close(self, specimen: PlannedSpecimen, job: Job, note: Note) -> Member:
        """Remember what became of a job."""
        # The same words wherever the series stands.
        message = in_study_words(note.message.replace(f"{self.home}{os.sep}", ""))
        note = note.model_copy(update={"message": message})
        self._write(job.folder, note)
        if is_run(job.folder):
            return self.member(specimen, job.folder)
        return _without_run(specimen, note)

    def member(self, specimen: PlannedSpecimen, folder: Path) -> Member:
        """A specimen with its run, as its results judge it."""
        run = folder.relative_to(self.home).as_posix()
        sweep(folder)
        try:
            results = open_results(folder)
        except PlanishError as error:
            message = f"{in_study_words(error.text)} Remove {run} to have it done again."
            return specimen.member.model_copy(update={"state": "damaged", "message": message})
        return as_judged(specimen.member.model_copy(update={"run": run}), results)

    def estimate(self, specimen: PlannedSpecimen, compute: Compute) -> Estimate:
        """Say what a specimen will take, or why nothing is to be done; nothing is written.

        Time is that of specimens which are done, or goes by the size of the files; memory is that
        of the program, the largest volume and the images.
        """
        job = self.look(specimen, compute)
        if not isinstance(job, Job):
            return Estimate(words="kept" if job.run is not None else f"{job.state}: {job.message}")
        voxels = pixels = columns = volume_bytes = 0.0
        try:
            for layer in job.study.layers:
                if layer.kind == "run":  # mapped already
                    continue
                header = describe(layer.path, values=False)
                size = float(prod(header["shape"]))
                if layer.kind == "image":
                    pixels += size
                else:
                    voxels += size
                    columns += size ** (2 / 3)  # as many as a cube of so many voxels has
                    volume_bytes = max(volume_bytes, bytes_to_hold(header["bytes"]))
        except PlanishError as error:
            return Estimate(words=f"refused: {error.text}")
        by_size_s = _START_S + _PER_VOXEL_S * voxels + _PER_PIXEL_S * pixels
        pixel_bytes = _PER_PIXEL * pixels
        return Estimate(
            words="to do",
            seconds=self._usual_s() or by_size_s,
            memory_bytes=PROGRAM_BYTES + min(compute.for_work, volume_bytes + pixel_bytes),
            disk_bytes=_PER_COLUMN * columns + pixel_bytes,
        )

    def _usual_s(self) -> float | None:
        """Median time of the specimens that are done, where these are three or more."""
        notes = [self._read(Path(path.stem)) for path in (self.home / NOTES).glob("*.json")]
        done_notes = [note for note in notes if note and note.state in ("whole", "withheld")]
        seconds = [note.seconds for note in done_notes if note.seconds]
        return median(seconds) if len(seconds) >= 3 else None

    def _note_of(self, study: Study, specimen: PlannedSpecimen) -> Note:
        """What tells whether a run may be taken again, wherever the series was moved to.

        The key of a note is made of the options, with names in place of paths, and of the hashes of
        all files. A file whose stamp is the earlier one keeps its hash and is not read.
        """
        paths: list[str] = []

        def without(path: str) -> str:
            """Leave the name of a path alone, and note the path down."""
            paths.append(path)
            return find_place(path).name

        options = to_dict(with_paths(study, without))
        old = self._read(self.home / RUNS / specimen.name) or Note(key="")
        stamps = {str(number): stamp_of(Path(path)) for number, path in enumerate(paths)}
        hashes: dict[str, str] = {}
        for (k, stamp), path in zip(stamps.items(), paths, strict=True):
            is_kept = k in old.hashes and old.stamps.get(k) == stamp
            hashes[k] = old.hashes[k] if is_kept else hash_of_input(path)
        key = run_key(options, list(hashes.values()))
        return Note(key=key, stamps=stamps, hashes=hashes)

    def _read(self, folder: Path) -> Note | None:
        path = self.home / NOTES / f"{folder.name}.json"
        with suppress(OSError, ValidationError):
            return Note.model_validate_json(path.read_bytes())
        return None

    def _write(self, folder: Path, note: Note) -> None:
        path = self.home / NOTES / f"{folder.name}.json"
        path.parent.mkdir(exist_ok=True)
        write_whole(path, json.dumps(note.model_dump(), indent=1).encode(), over=True)


def do(job: Job) -> Note:
    """Link the layers of a specimen, or map its volume; whatever goes wrong is noted, too.

    Gives the note of the job with state, message and seconds.
    """
    begin = time.perf_counter()
    outcome = {"state": "damaged", "message": ""}
    try:
        # Of a worker that was lost when all was written, there is a run.
        is_done = is_run(job.folder)
        has_passed = is_done or run_study(job.study, job.folder, compute=job.compute).passed
        outcome["state"] = "whole" if has_passed else "withheld"
    except PlanishError as error:
        outcome = _reason_of(error)
    except MemoryError:
        outcome["message"] = "The memory is used up. Give fewer jobs, or more memory."
    except Exception as error:  # noqa: BLE001  one specimen stops no other
        outcome["message"] = as_sentence(error, str(job.folder), "").text
    seconds = round(time.perf_counter() - begin, 1)
    return job.note.model_copy(update={**outcome, "seconds": seconds})


# State and message of a job whose process ended again and again
KILLED = {
    "state": "damaged",
    "message": (
        "Its process ended without a word, most likely because the memory was used up. Give fewer"
        " jobs or a limit of the memory, and give the same command again."
    ),
}


def _reason_of(error: PlanishError) -> dict[str, str]:
    """State and message of a specimen that an error ended; one that lacked memory may try again."""
    state = "damaged" if isinstance(error, ResourceError) else "refused"
    return {"state": state, "message": in_study_words(error.text)}


def _without_run(specimen: PlannedSpecimen, note: Note) -> Member:
    return specimen.member.model_copy(update={"state": note.state, "message": note.message})


def stamp_of(path: Path) -> str:
    """Give the number, size and times of change of the files of an input, as one text.

    Files that its headers name are among them, and those of a folder.
    """
    if path.is_dir():
        files = list(path.rglob("*"))
    else:
        files = [path]
        # a header whose values are not there yet is a file like another one.
        with suppress(PlanishError):
            place = find_place(path)
            files = [place.path]
            files = files_of(place)
    count = size = changed_ns = 0
    for file in files:
        with suppress(OSError):
            stat = file.stat()
            count += 1
            size += stat.st_size
            changed_ns += stat.st_mtime_ns
    return f"{count} {size} {changed_ns}"
