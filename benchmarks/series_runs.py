"""A series of specimens of the demo's size beside single links: processor time, memory as it goes
on, the same bytes.

python -m benchmarks series_runs [--count 40] [--folder DIR] [--jobs 1]
"""

from __future__ import annotations

import filecmp
import subprocess
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.shared import children_s, folder_for, memory, options, planish, succeeded
from planish.synthetic import DEMO, make_specimen, write_instruments


def main(*arguments):
    """Print the costs; the number of runs whose bytes differ from those of a single link."""
    asked = options("series_runs", arguments, count=40, folder=None, jobs=1)
    with folder_for(asked.folder) as place:
        home = Path(place)
        table = make(home, asked.count)
        series = planish("study", table, "--out", home / "series", "--jobs", asked.jobs)
        used, held, seconds = watched(series)
        quarters = " ".join(f"{max(part):.2f}" for part in np.array_split(held, 4))
        print(
            f"{asked.count} as a series: {seconds:.0f} s, {used:.0f} s of processor time",
            flush=True,
        )
        print(f"most GB in each quarter of it: {quarters}")
        alone, differ = 0.0, 0
        for name in table.read_text(encoding="utf-8").splitlines()[1:]:
            name = name.partition(",")[0]
            files = [home / name / file for file in ("volume.tif", "image.tif")]
            out = home / "single" / "runs" / name  # as deep as in a series: paths are relative
            alone += succeeded(planish("link", *files, "--out", out)).cpu
            differ += bool(different(out, home / "series" / "runs" / name))
        print(f"as single links: {alone:.0f} s of processor time; with other bytes: {differ}")
    return differ


def make(folder, count):
    """Write specimens and their table."""
    rows = ["name,volume,image,paper,sheet"]
    for k in range(1, count + 1):
        name = f"s{k:02d}"
        if not (folder / name).exists():
            write_instruments(make_specimen(replace(DEMO, seed=k)), folder / name)
        rows.append(f"{name},{name}/volume.tif,{name}/image.tif,{'AB'[k % 2]},{(k + 1) // 2}")
    table = folder / "specimens.csv"
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return table


def watched(command):
    """Run a command; its processor time, the GB that it and all below it held, twice a second, and
    how long it took."""
    before, begun, held = children_s(), time.perf_counter(), []
    process = subprocess.Popen(command)
    while process.poll() is None:
        held.append(0.0)
        for pid in family(process.pid):
            with suppress(OSError, StopIteration):  # it has ended meanwhile
                held[-1] += memory(pid) / 1e9
        time.sleep(0.5)
    return children_s() - before, held, time.perf_counter() - begun


def family(pid):
    """A process and all below it."""
    found = [pid]
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            for child in file.read_text(encoding="ascii").split():
                found += family(int(child))
    return found


def different(a, b):
    """Files that are not the same in both folders; notes of times do not count."""
    names = set()
    for root in (a, b):
        files = (path for path in root.rglob("*") if path.is_file())
        names |= {
            path.relative_to(root).as_posix() for path in files if not path.name.startswith(".")
        }
    _, other, missing = filecmp.cmpfiles(a, b, names, shallow=False)
    return [*other, *missing]
