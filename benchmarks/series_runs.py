"""Series of real links beside single ones: time, memory, two processes, and a watched folder.

    python -m benchmarks series_runs FOLDER [single many watch]

Twelve specimens of the demo's size: one file damaged, one image mirrored, one of another sheet, one with too few holes.
"""

from __future__ import annotations

import filecmp
import os
import shutil
import subprocess
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from benchmarks.shared import Ran, children_s, memory, planish, timed
from planish.synthetic import DEMO, make_specimen, write_instruments

COUNT = 12
WRONG = {9: "damaged", 10: "mirrored", 11: "other", 12: "few"}
_COLUMNS = "name,volume,image,paper,sheet\n"


def make(folder: Path, count: int = COUNT, *, wrong: bool = True) -> Path:
    """Write specimens and their table."""
    rows = []
    for k in range(1, count + 1):
        home = folder / f"s{k:02d}"
        if not home.exists():
            write_instruments(make_specimen(replace(DEMO, seed=k)), home)
            if wrong and k in WRONG:
                spoil(home, WRONG[k], folder)
        rows.append(f"{home.name},{home.name}/volume.tif,{home.name}/image.tif,{'AB'[k % 2]},{(k + 1) // 2}\n")
    table = folder / "specimens.csv"
    table.write_text(_COLUMNS + "".join(rows), encoding="utf-8")
    return table


def spoil(home: Path, how: str, folder: Path) -> None:
    """Make a specimen that cannot be used."""
    volume, image = home / "volume.tif", home / "image.tif"
    if how == "damaged":
        os.truncate(volume, volume.stat().st_size // 2)
    elif how == "other":
        shutil.copyfile(folder / "s01" / "image.tif", image)
    else:
        with tifffile.TiffFile(image) as file:
            grey, tags = file.asarray(), file.pages.first.tags
            size = {name: tags[name].value for name in ("XResolution", "YResolution", "ResolutionUnit")}
        if how == "mirrored":
            grey = grey[:, ::-1]
        else:
            grey = grey.copy()
            grey[: int(0.45 * grey.shape[0])] = np.median(grey)
        tifffile.imwrite(
            image, grey, resolution=(size["XResolution"], size["YResolution"]), resolutionunit=size["ResolutionUnit"]
        )


def study(table: Path, out: Path, *more: str) -> list[str]:
    """The command of a series."""
    return planish("study", table, "--out", out, *more)


def different(a: Path, b: Path) -> list[str]:
    """Files that are not the same in both folders; notes of times do not count."""
    names = {
        p.relative_to(root).as_posix() for root in (a, b) for p in root.rglob("*")
        if p.is_file() and ".series" not in p.parts and not p.name.startswith(".")
    }  # fmt: skip
    _, other, missing = filecmp.cmpfiles(a, b, names, shallow=False)
    return sorted([*other, *missing])


def main(folder: str = "", *parts: str) -> int:
    home = Path(folder or "series-runs").absolute()
    home.mkdir(parents=True, exist_ok=True)
    for part in parts or PARTS:
        PARTS[part](home)
    return 0


def single(home: Path) -> None:
    """A series of twelve, four of which are wrong, against single links of the whole ones."""
    table, whole = make(home), home / "one"
    if not whole.exists():
        print("one process:", told(timed(study(table, whole))), flush=True)
    total = 0.0
    for k in range(1, COUNT + 1):
        if k not in WRONG:
            name, ran = linked(home, k)
            total += ran.cpu
            same = different(home / "single" / "runs" / name, whole / "runs" / name) or "same bytes"
            print(f"{name} against a single link:", same, flush=True)
    print(f"{COUNT - len(WRONG)} single links: {total:.0f} s of processor time", flush=True)


def linked(home: Path, k: int) -> tuple[str, Ran]:
    """Link one specimen alone, in a folder as deep as in a series: paths are relative."""
    name = f"s{k:02d}"
    files = [home / name / file for file in ("volume.tif", "image.tif")]
    return name, timed(planish("link", *files, "--out", home / "single" / "runs" / name))


def told(ran: Ran) -> str:
    return f"exit {ran.code}, {ran.seconds:.1f} s, {ran.cpu:.1f} s of processor time"


def many(home: Path, count: int = 40, planned: int = 200, pairs: int = 6) -> None:
    """Cost of a series beside that of its links, its memory as it goes on, and two processes against one."""
    home /= "many"
    home.mkdir(exist_ok=True)
    table = make(home, count, wrong=False)
    for k in range(count + 1, planned + 1):  # the same files once more: a plan reads no more than their heads
        shutil.copytree(home / f"s{1 + k % count:02d}", home / f"s{k:02d}", copy_function=os.link, dirs_exist_ok=True)
    wide, few = home / "planned.csv", home / "few.csv"
    rows = [f"s{k:02d},s{k:02d}/volume.tif,s{k:02d}/image.tif,A,{k}\n" for k in range(1, planned + 1)]
    wide.write_text(_COLUMNS + "".join(rows), encoding="utf-8")
    print(f"plan of {planned}:", told(timed(study(wide, home / "planned", "--dry-run"))), flush=True)
    few.write_text("".join(table.read_text(encoding="utf-8").splitlines(keepends=True)[: pairs + 1]), encoding="utf-8")
    for jobs in ("1", "2", "1", "2"):
        shutil.rmtree(home / "few", ignore_errors=True)
        ran = timed(study(few, home / "few", "--jobs", jobs, "--threads", "1"))
        print(f"{pairs} with one thread, processes {jobs}:", told(ran), flush=True)
    print("series:", watched_memory(study(table, home / "series")), flush=True)
    total = sum(linked(home, k)[1].cpu for k in range(1, count + 1))
    print(f"{count} single links: {total:.0f} s of processor time", flush=True)


def watched_memory(command: list[str]) -> str:
    """Run a series; its processor time, and the memory of it and its children as specimens were done."""
    before, process, held = children_s(), subprocess.Popen(command), list[float]()
    while process.poll() is None:
        held.append(0.0)
        for pid in family(process.pid):
            with suppress(OSError, StopIteration):  # it has ended meanwhile
                held[-1] += memory(pid) / 1e9
        time.sleep(0.5)
    most = [f"{max(part):.2f}" for part in np.array_split(held, 4)]
    return (
        f"exit {process.returncode}, {children_s() - before:.0f} s of processor time, most GB in each quarter of it: "
        f"{' '.join(most)}"
    )


def family(pid: int) -> list[int]:
    """A process and all below it."""
    children = Path(f"/proc/{pid}/task").glob("*/children")
    try:
        below = [int(one) for file in children for one in file.read_text(encoding="ascii").split()]
    except OSError:
        return [pid]
    return [pid, *(one for child in below for one in family(child))]


def watch(home: Path, count: int = 10) -> None:
    """Scans written slowly into a watched folder, two half-written, one renamed at the end."""
    source = make(home / "sources", count + 1, wrong=False).parent
    folder, out = home / "watched", home / "watch-out"
    folder.mkdir()
    plan = home / "watch.toml"
    plan.write_text("[watch]\nvolume = '{sheet}_ct.tif'\nimage = '{sheet}_img.tif'\n", encoding="utf-8")
    command = [*study(plan, out), "--watch", str(folder), "--settle", "4", "--idle", "45"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    halves = {4, 8}
    for k in range(1, count + 1):
        volume, image = (source / f"s{k:02d}" / name for name in ("volume.tif", "image.tif"))
        shutil.copyfile(image, folder / f"{k}_img.tif")
        data = volume.read_bytes()
        target = folder / (f"{k}_ct.part" if k == 6 else f"{k}_ct.tif")
        with target.open("wb") as file:
            for part in range(6):
                file.write(data[part * len(data) // 6 : (part + 1) * len(data) // 6])
                file.flush()
                time.sleep(0.5)
                if k in halves and part == 3:
                    break
        if k == 6:
            target.rename(folder / "6_ct.tif")
    _, said = process.communicate()
    whole = sorted(path.name for path in (out / "runs").iterdir())
    named = [k for k in halves if f"{k}: " in said and "tried again" in said]
    twice = [line for line in said.splitlines() if "kept" in line]
    print(f"watch: exit {process.returncode}; linked {whole}; not whole {named}; taken twice {twice}", flush=True)


PARTS = {"single": single, "many": many, "watch": watch}
