"""Find new scans of a folder as they appear.

They are pairs of files that are whole and have stood still for a while.
"""

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pydantic import Field

from planish.core.errors import InputError, PlanishError
from planish.core.options import Params
from planish.core.tables import naming_faults
from planish.io import find_place
from planish.io.info import describe
from planish.series.jobs import stamp_of
from planish.series.plan import Plan, PlannedSpecimen, checked_name

_FACTOR = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")


class WatchParams(Params):
    """How the files of a folder pair."""

    volume: str = Field(
        description="Name of a volume with its factors in braces, such as {sheet}_ct.tif."
    )
    image: str | None = Field(
        default=None, description="Name of its image, such as {sheet}_img.tif."
    )


def watch_params(plan: Plan) -> WatchParams:
    """The patterns of a plan; InputError where they are missing or do not fit together.

    Volume and image have the same factors, by which their files pair; each stands in the name of a
    volume once.
    """
    example = "[watch] with volume = '{sheet}_ct.tif' and image = '{sheet}_img.tif'"
    if not plan.watch:
        raise InputError(
            f"`watch` needs to know how files pair. Write a table {example} into the study."
        )
    with naming_faults("The study", f"Needed: {example}.", error=InputError, key_prefix=("watch",)):
        params = WatchParams.model_validate(plan.watch)
    names = _FACTOR.findall(params.volume)
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"watch.volume {params.volume!r} needs each factor once, in braces. Needed: {example}."
        )
    if params.image is not None and sorted(set(_FACTOR.findall(params.image))) != sorted(names):
        raise InputError(
            f"watch.image {params.image!r} needs the factors of watch.volume. Needed: {example}."
        )
    return params


def _specimens_in(folder: Path, params: WatchParams) -> Iterator[PlannedSpecimen]:
    """Specimens whose files are all in a folder, in the order of their names.

    The name of a volume gives the factors, and these the name of its image and of the specimen.
    """
    place = find_place(params.volume)
    texts = _FACTOR.split(str(place.path))  # of a name, every second one is a factor
    for k, text in enumerate(texts):
        texts[k] = f"(?P<{text}>[^/\\\\]+?)" if k % 2 else re.escape(text)
    pattern = re.compile("".join(texts))
    for entry in sorted(folder.iterdir()):
        match = pattern.fullmatch(entry.name)
        if match is None:
            continue
        factors = match.groupdict()
        # A volume may be a part of a file, FILE:PART.
        files = [Path(f"{entry}:{place.part}") if place.part else entry]
        if params.image:
            files.append(folder / params.image.format(**factors))
        if all(image.exists() for image in files[1:]):
            name = checked_name("-".join(factors.values()))
            paths = tuple(str(file.absolute()) for file in files)
            yield PlannedSpecimen(name=name, files=paths, factors=factors)


def watched(
    plan: Plan,
    folder: Path,
    *,
    settle_s: float,
    idle_s: float | None,
    tell: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[PlannedSpecimen | None]:
    """Give specimens as their files are whole; None where there is none as yet.

    A file is taken when it has not changed for ``settle_s`` and its own reader finds it complete.
    One that is not complete is named once, and tried again when it changes.

    Parameters
    ----------
    plan : Plan
        Says how the files pair.
    folder : path
        Folder that is watched.
    settle_s : float
        Seconds that files have to stand still.
    idle_s : float, optional
        Seconds without a new specimen after which it ends; default: never.
    tell : callable
        Called with a text about files that are not complete.
    clock : callable
        Gives seconds.

    Yields
    ------
    PlannedSpecimen or None

    Raises
    ------
    InputError
        If the plan says nothing of files, or something that does not fit together.
    """
    params = watch_params(plan)
    # Name of a specimen that was taken or refused -> stamp of its files.
    judged_stamps: dict[str, str] = {}
    since: dict[str, tuple[str, float]] = {}  # stamp of files, and when it was first seen
    last = clock()  # when the last specimen was given
    while True:
        has_new = False
        for specimen in _specimens_in(folder, params):
            name = specimen.name
            files = [*map(Path, specimen.files)]
            stamp = " ".join(map(stamp_of, files))
            earlier_stamp, seen_s = since.get(name, ("", 0.0))
            if earlier_stamp != stamp:
                since[name] = (stamp, clock())
                continue
            if clock() - seen_s < settle_s or judged_stamps.get(name) == stamp:
                continue
            judged_stamps[name] = stamp
            fault = _incomplete(files)
            if fault:
                tell(f"{name}: {fault} It is tried again when the file changes.")
                continue
            has_new = True
            last = clock()
            yield specimen
        if not has_new:
            if idle_s is not None and clock() - last >= idle_s:
                return
            yield None


def _incomplete(files: list[Path]) -> str | None:
    """Why one of some files is not complete, as its reader says; None where all are."""
    for file in files:
        try:
            if not describe(file)["shape"]:
                return f"{file.name} holds nothing."
        except PlanishError as error:
            return error.text
    return None
