"""``planish explore``: a run as one page that is opened without planish, server or network."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planish.app.exploring.maps import MapsOfPage, maps_of
from planish.app.exploring.page import render
from planish.app.exploring.slices import BUDGET, Stack, stack_of
from planish.compute import Compute, Progress, silent
from planish.core.files import write_whole
from planish.core.threads import limit_threads
from planish.exports import ExportSource
from planish.io.run_folder import refuse_existing, refuse_inside

LARGEST = 12_000_000
"""Bytes that no page exceeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Explored:
    """A page that was written: its size, what it holds, and what was left out of it in words."""

    path: Path
    bytes: int
    maps: int
    slices: int
    notes: tuple[str, ...]


def explore(
    run: str | Path, out: str | Path, *, compute: Compute | None = None, progress: Progress = silent
) -> Explored:  # fmt: skip
    """Write the maps of a run, their scatter and its slices as one HTML file with a cursor that links them.

    Parameters
    ----------
    run : path
        Folder of a run.
    out : path
        The file to write.
    compute : Compute, optional
        What may be used.
    progress : callable, optional
        Called with the name of a step and a few words.

    Raises
    ------
    FileError
        If ``run`` is no run or damaged, or ``out`` exists or cannot be written.
    InputError
        If the run holds no maps.

    Notes
    -----
    The volume is read where it stands unchanged; otherwise the page has the slices that the run keeps, and says so. No
    page is larger than 12 MB: maps are averaged and slices left out where they would take more.
    """
    compute, out = compute or Compute(), Path(out)
    refuse_existing(out)
    source = ExportSource.of(run)
    refuse_inside(out, [run])
    with limit_threads(compute.threads):
        progress("maps", str(run))
        maps = maps_of(source)
        sheets = dict.fromkeys(group.sheet for group in maps.groups if group.sheet)
        layers, budget = map(source.results.layer, sheets), BUDGET // max(len(sheets), 1)
        read = (stack_of(source, layer, budget, compute, progress) for layer in layers)
        stacks = [stack for stack in read if stack is not None]
        notes = _notes(maps, stacks)
        page = render(source.results, maps, stacks, notes).encode()
    assert len(page) <= LARGEST
    write_whole(out, page)
    return Explored(
        path=out, bytes=len(page), maps=len(maps.maps), slices=sum(len(stack.at_um) for stack in stacks), notes=notes
    )


def _notes(maps: MapsOfPage, stacks: list[Stack]) -> tuple[str, ...]:
    """Say what the page holds, and what was left out of it, with ASCII units."""
    down, across = maps.grid.pixel_um
    size = f"{across:.4g} um" if abs(down - across) < 1e-6 * across else f"{across:.4g} x {down:.4g} um"
    rows, cols = maps.grid.shape
    pixels = f"{cols} x {rows} pixels of {size}"
    if maps.halvings:
        pixels += f": means of {2**maps.halvings} x {2**maps.halvings} pixels of the run, to keep the page small"
    else:
        pixels += ", as in the run"
    notes = [f"Maps: {pixels}."]
    several = len(stacks) > 1
    notes += [f"{f'{stack.sheet}: ' if several else ''}{stack.note[:1].upper()}{stack.note[1:]}." for stack in stacks]
    without = sorted({group.sheet for group in maps.groups if group.sheet} - {stack.sheet for stack in stacks})
    if without:
        notes.append(f"No slices of {' and '.join(without)}: its surfaces are not in this run.")
    elif not stacks:
        notes.append("No slices: the run does not say where its pixels lie in a volume.")
    return tuple(notes)
