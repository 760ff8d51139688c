"""Series of real links: killed and resumed, on one process, two, and dask workers; four of twelve cannot be used.

    python -m benchmarks series_runs FOLDER [single kill processes cluster watch | many]

Twelve specimens of the demo's size: one file damaged, one image mirrored, one of another sheet, one with too few holes.
"""

from __future__ import annotations

import filecmp
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from planish.synthetic import DEMO, make_specimen, write_instruments

COUNT = 12
WRONG = {9: "damaged", 10: "mirrored", 11: "other", 12: "few"}
_COLUMNS = "name,volume,image,paper,sheet\n"


def make(folder: Path, count: int = COUNT, *, wrong: bool = True) -> Path:
    """Write specimens and their table."""
    rows: list[str] = []
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
    return [sys.executable, "-m", "planish", "study", str(table), "--out", str(out), *more]


def different(a: Path, b: Path) -> list[str]:
    """Files that are not the same in both folders; notes of times do not count."""
    names = {
        p.relative_to(root).as_posix() for root in (a, b) for p in root.rglob("*")
        if p.is_file() and ".series" not in p.parts and not p.name.startswith(".")
    }  # fmt: skip
    _, other, missing = filecmp.cmpfiles(a, b, names, shallow=False)
    return sorted([*other, *missing])


def timed(command: list[str]) -> tuple[int, float, float]:
    """Exit code, seconds, and seconds of processor time with children."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.returncode, time.perf_counter() - begin, cpu


def killed(table: Path, out: Path, times: int, *more: str, pause_s: float = 12.0) -> int:
    """Kill a series and its children so many times, then let it end; its exit code."""
    rng = np.random.default_rng(2)
    for _ in range(times):
        process = subprocess.Popen(study(table, out, *more), stderr=subprocess.DEVNULL)
        time.sleep(float(rng.uniform(0.6, 1.4)) * pause_s)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    return subprocess.run(study(table, out, *more), check=False).returncode


def main(folder: str = "", *parts: str) -> int:
    home = Path(folder or "series-runs").absolute()
    home.mkdir(parents=True, exist_ok=True)
    if parts == ("many",):
        return many(home / "many")
    table = make(home)
    whole = home / "one"
    if not whole.exists():
        code, seconds, cpu = timed(study(table, whole))
        print(f"one process: exit {code}, {seconds:.0f} s, {cpu:.0f} s of processor time", flush=True)
    for k in range(1, COUNT + 1):
        name, alone = f"s{k:02d}", home / "single" / "runs" / f"s{k:02d}"  # as deep as in a series: paths are relative
        if k not in WRONG and "single" in parts and not alone.exists():
            files = [str(home / name / file) for file in ("volume.tif", "image.tif")]
            subprocess.run([sys.executable, "-m", "planish", "link", *files, "--out", str(alone)], check=True)
            print(f"{name} against a single link:", different(alone, whole / "runs" / name) or "same bytes", flush=True)
    if "kill" in parts:
        code = killed(table, home / "killed", 5)
        print(f"killed 5 times: exit {code},", different(whole, home / "killed") or "same bytes", flush=True)
    if "processes" in parts:
        code = killed(table, home / "two", 2, "--jobs", "2")
        print(f"two processes: exit {code},", different(whole, home / "two") or "same bytes", flush=True)
    if "watch" in parts:
        print("watch:", watch(home), flush=True)
    if "cluster" in parts:
        print("cluster:", cluster(table, home, whole), flush=True)
    return 0


def many(home: Path, count: int = 40, planned: int = 200, pairs: int = 6) -> int:
    """Cost of a series beside that of its links, its memory as it goes on, and two processes against one."""
    home.mkdir(exist_ok=True)
    table = make(home, count, wrong=False)
    for k in range(count + 1, planned + 1):  # the same files once more: a plan reads no more than their heads
        (home / f"s{k:02d}").mkdir(exist_ok=True)
        for file in ("volume.tif", "image.tif"):
            target = home / f"s{k:02d}" / file
            if not target.exists():
                os.link(home / f"s{1 + k % count:02d}" / file, target)
    wide = home / "planned.csv"
    rows = [f"s{k:02d},s{k:02d}/volume.tif,s{k:02d}/image.tif,A,{k}\n" for k in range(1, planned + 1)]
    wide.write_text(_COLUMNS + "".join(rows), encoding="utf-8")
    code, seconds, cpu = timed([*study(wide, home / "planned"), "--dry-run"])
    print(f"plan of {planned}: exit {code}, {seconds:.1f} s, {cpu:.1f} s of processor time", flush=True)
    few = home / "few.csv"
    few.write_text("".join(table.read_text(encoding="utf-8").splitlines(keepends=True)[: pairs + 1]), encoding="utf-8")
    for jobs in ("1", "2", "1", "2"):
        shutil.rmtree(home / "few", ignore_errors=True)
        code, seconds, cpu = timed(study(few, home / "few", "--jobs", jobs, "--threads", "1"))
        print(f"{pairs} with one thread, processes {jobs}: exit {code}, {seconds:.1f} s, cpu {cpu:.1f} s", flush=True)
    print("series:", watched_memory(study(table, home / "series")), flush=True)
    total = 0.0
    for k in range(1, count + 1):
        name, alone = f"s{k:02d}", home / "single" / "runs" / f"s{k:02d}"
        files = [str(home / name / file) for file in ("volume.tif", "image.tif")]
        total += timed([sys.executable, "-m", "planish", "link", *files, "--out", str(alone)])[2]
    print(f"{count} single links: {total:.0f} s of processor time", flush=True)
    return 0


def watched_memory(command: list[str]) -> str:
    """Run a series; its processor time, and the memory of it and its children as specimens were done."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process, held = subprocess.Popen(command), list[float]()
    while process.poll() is None:
        held.append(sum(resident_gb(pid) for pid in family(process.pid)))
        time.sleep(0.5)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    most = [f"{max(part):.2f}" for part in np.array_split(held, 4)]
    return f"exit {process.returncode}, {cpu:.0f} s of processor time, most GB in each quarter of it: {' '.join(most)}"


def family(pid: int) -> list[int]:
    """A process and all below it."""
    children = Path(f"/proc/{pid}/task").glob("*/children")
    try:
        below = [int(one) for file in children for one in file.read_text(encoding="ascii").split()]
    except OSError:
        return [pid]
    return [pid, *(one for child in below for one in family(child))]


def resident_gb(pid: int) -> float:
    """Memory that a process holds now, 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 1e9
    except OSError:
        return 0.0


def cluster(table: Path, home: Path, whole: Path) -> str:
    """The series on two dask workers, one of which is killed."""
    address = "tcp://127.0.0.1:18786"
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "18786",
         "--no-dashboard"], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    command = [
        sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--host", "127.0.0.1",
        "--no-dashboard", "--no-nanny", "--memory-limit", "0",
    ]  # fmt: skip
    workers = [subprocess.Popen(command, stderr=subprocess.DEVNULL) for _ in range(2)]
    try:
        time.sleep(8)
        process = subprocess.Popen(study(table, home / "cluster", "--scheduler", address))
        time.sleep(25)
        workers[0].kill()
        code = process.wait()
    finally:
        for one in (*workers, scheduler):
            one.kill()
            one.wait()
    return f"exit {code}, {different(whole, home / 'cluster') or 'same bytes'}"


def watch(home: Path, count: int = 10) -> str:
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
    return f"exit {process.returncode}; linked {whole}; named as not whole {named}; taken twice {twice}"
