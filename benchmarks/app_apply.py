"""Apply in the app: processor time of a new run with one mark excluded, and how long a click takes meanwhile.

    python -m benchmarks app_apply [--rows 1900] [--folder DIR] [--run RUN]

Two runs: the demo's, and a specimen whose image has so many rows and 4/3 as many columns (1900 x 2533: 4.8 million
pixels); or RUN alone, of which a copy is worked on. Times of the process that makes the run are given from the moment
at which Apply is asked for, and with what it loads before; the machine's load stands beside them.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.app import WATCH, opened, until
from benchmarks.large_image import specimen
from benchmarks.size import folder_for
from planish.app.changes import change_of
from planish.app.server import create_app
from planish.app.session import Session

_TICK = os.sysconf("SC_CLK_TCK")


def main(*arguments: str | int) -> int:
    parser = argparse.ArgumentParser(prog="app_apply")
    parser.add_argument("--rows", type=int, default=1900)
    parser.add_argument("--folder", type=Path, default=None, help="where runs are made, and kept for the next time")
    parser.add_argument("--run", type=Path, default=None)
    asked = parser.parse_args([str(a) for a in arguments])
    with folder_for(asked.folder) as folder:
        for run in [asked.run] if asked.run is not None else made(Path(folder), asked.rows):
            measure(run)
    return 0


def made(folder: Path, rows: int) -> list[Path]:
    """Both runs, made where they are not there yet."""
    demo, large = folder / "demo", folder / f"run-{rows}"
    if not demo.exists():
        planish("demo", "--out", demo)
    if not large.exists():
        planish("link", *specimen(rows, rows * 4 // 3, folder / f"image-{rows}"), "--out", large)
    return [demo / "run", large]


def planish(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "planish", *map(str, arguments)], check=False, capture_output=True)


def measure(run: Path) -> None:
    """Exclude the first mark, apply, and click meanwhile."""
    session = Session.open(run)
    app = create_app(session, token="token", hosts=["127.0.0.1:1"])
    applying, first = app.state.applying, session.state.of(None)[0]
    try:
        before = _of_children()
        session.change(change_of(f'{{"do": "use", "id": "{first.id}", "used": false}}'))
        while applying._warm_process is None:
            time.sleep(0.05)
        loading = _settled(applying._warm_process.pid)
        load, begun, clicks = os.getloadavg()[0], time.perf_counter(), list[float]()
        applying.start()
        used = True
        while applying.progress.state == "working":
            used, at = not used, time.perf_counter()
            session.change(
                change_of(f'{{"do": "use", "id": "{session.state.of(None)[1].id}", "used": {str(used).lower()}}}')
            )
            app.state.live.shown(session.state.first_layer)
            clicks.append(time.perf_counter() - at)
            time.sleep(0.2)
        wall, end = time.perf_counter() - begun, applying.progress
    finally:
        applying.close()
        session.close()
    whole = _of_children() - before
    image = session.results.layers[-1]
    print(f"{run}: {end.state}; {whole - loading:.1f} s of processor time, {whole:.1f} s with loading, "
          f"{wall:.1f} s by the clock, load {load:.1f} on {os.cpu_count()} processors", flush=True)  # fmt: skip
    usual, longest = 1e3 * statistics.median(clicks), 1e3 * max(clicks)
    print(f"  {len(clicks)} clicks on {image.source.name} meanwhile: median {usual:.0f} ms, longest {longest:.0f} ms")
    if end.run is not None:
        shutil.rmtree(end.run)
    shutil.rmtree(run / "edits")
    in_browser(run)


def in_browser(run: Path) -> None:
    """Apply in a browser, and exclude and include a mark meanwhile: how long each click takes to be seen."""
    with opened(run) as (page, url, _):
        page.goto(url)
        boxes = page.locator("table[aria-label=Marks] tbody input")
        boxes.first.click()
        page.wait_for_timeout(9000)  # until the process waits that will make the run
        page.evaluate(WATCH)
        page.get_by_role("button", name="Apply", exact=True).click()
        found: list[float] = []
        report = page.get_by_role("link", name=re.compile("report"))
        while not report.count():
            boxes.nth(1).click()
            until(page, "clicked.rows")
            found.append(page.evaluate("clicked")["rows"])
            page.wait_for_timeout(300)
    usual, longest, load = statistics.median(found), max(found), os.getloadavg()[0]
    print(f"  {len(found)} clicks in the browser: median {usual:.0f} ms to the screen, longest {longest:.0f} ms; "
          f"load {load:.1f}", flush=True)  # fmt: skip
    shutil.rmtree(run.with_name(f"{run.name}-2"))
    shutil.rmtree(run / "edits")


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _settled(pid: int) -> float:
    """Processor time of a process once it waits."""

    def used() -> float:
        parts = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(parts[11]) + int(parts[12])) / _TICK

    before = -1.0
    while (now := used()) != before:
        before = now
        time.sleep(1.0)
    return now
