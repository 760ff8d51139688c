"""Apply in the app: processor time of a new run with one mark excluded, and how long a click takes meanwhile.

    python -m benchmarks app_apply [--rows 1900] [--folder DIR]

Two runs: the demo's, and a specimen whose image has so many rows and 4/3 as many columns (1900 x 2533: 4.8 million
pixels). Times of the process that makes the run are given from the moment
at which Apply is asked for, and with what it loads before; the machine's load stands beside them.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import time
from pathlib import Path

from benchmarks.app import WATCH, opened, until
from benchmarks.large_image import specimen
from benchmarks.shared import children_s, folder_for, options, planish, succeeded
from planish.app.changes import change_of
from planish.app.server import create_app
from planish.app.session import Session


def main(*arguments: str | int) -> int:
    asked = options("app_apply", arguments, rows=1900, folder=None)
    with folder_for(asked.folder) as folder:
        demo, large = Path(folder) / "demo", Path(folder) / f"run-{asked.rows}"
        if not demo.exists():
            succeeded(planish("demo", "--out", demo))
        if not large.exists():
            files = specimen(asked.rows, asked.rows * 4 // 3, Path(folder) / f"image-{asked.rows}")
            succeeded(planish("link", *files, "--out", large))
        for run in (demo / "run", large):
            measure(run)
    return 0


def measure(run: Path) -> None:
    """Exclude the first mark, and apply; processor time of the process that makes the run, without what it loads."""
    session = Session.open(run)
    applying = create_app(session, token="token", hosts=["127.0.0.1:1"]).state.applying
    try:
        before, first = children_s(), session.state.of(None)[0]
        session.change(change_of(f'{{"do": "use", "id": "{first.id}", "used": false}}'))
        while applying._warm_process is None:
            time.sleep(0.05)
        loading = _settled(applying._warm_process.pid)
        load, begun = os.getloadavg()[0], time.perf_counter()
        applying.start()
        while applying.progress.state == "working":
            time.sleep(0.2)
        wall, end = time.perf_counter() - begun, applying.progress
    finally:
        applying.close()
        session.close()
    whole = children_s() - before
    print(f"{run}: {end.state}; {whole - loading:.1f} s of processor time, {whole:.1f} s with loading, "
          f"{wall:.1f} s by the clock, load {load:.1f} on {os.cpu_count()} processors", flush=True)  # fmt: skip
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
        found = []
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


def _settled(pid):
    """Processor time of a process once it waits."""

    def used():
        parts = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")

    before = -1.0
    while (now := used()) != before:
        before = now
        time.sleep(1.0)
    return now
