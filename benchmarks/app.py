"""The app with two layers of 14 592 x 10 944: first view, clicks, zoom, brush, r, memory.

    python -m benchmarks app [--folder DIR] [--rows 10944] [--cols 14592]

Not below 7000 x 9400. The run is written as a link of two images would be, and served by ``planish
view``; Chromium clicks. Times are on the clock, from the act to the screen, beside the machine's
load.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile
import xarray as xr
from scipy import ndimage

from benchmarks.shared import folder_for, memory, options, planish
from planish.core.grid import Grid
from planish.io.map_groups import write_tree
from planish.io.map_store import StoredMaps, map_tiles
from planish.run import link

PIXEL_UM = 1.37
_SMALL = 900  # pixels a side of the images of which the run is made that is then given large maps
_REPEATS = 5
_FREE = 4  # pairs from which on every model has a residual
_WINDOW = {"width": 1366, "height": 768}
_TABLE = "table[aria-label=Marks]"
_SIDE, _MAPS = ("two",), ("Left map", "Right map")


def main(*arguments):
    asked = options("app", arguments, folder=None, rows=10944, cols=14592)
    with folder_for(asked.folder) as folder:
        run = Path(folder) / f"run-{asked.rows}"
        if not run.exists():
            make_run(run, (asked.rows, asked.cols), Path(folder))
        measure(run)
    return 0


def make_run(run, shape, folder):
    """Link two small images, and give the run maps of the size that is asked for."""
    rng = np.random.default_rng(18)
    inputs = [folder / f"{name}.tif" for name in ("one", "two")]
    yy, xx = np.indices((_SMALL, _SMALL))
    texture = ndimage.gaussian_filter(rng.normal(size=(_SMALL, _SMALL)), 3) * 60
    for path in inputs:
        grey = 180 + texture + rng.normal(0, 4, texture.shape)
        for y, x in ((200, 220), (180, 700), (720, 240), (650, 660), (430, 480), (300, 520)):
            grey[np.hypot(yy - y, xx - x) < 75] = 12
        size = (1e4 / PIXEL_UM, 1e4 / PIXEL_UM)
        grey = grey.clip(0, 255).astype(np.uint8)
        tifffile.imwrite(path, grey, resolution=size, resolutionunit="CENTIMETER")
    link(f"one={inputs[0]}", f"two={inputs[1]}", out=run)
    shutil.rmtree(run / "maps.zarr")
    sink, grid = StoredMaps(run / "maps.zarr"), Grid.regular(shape, PIXEL_UM)
    for k, name in enumerate(("one", "two")):
        for tile in map_tiles(shape):
            sink.add(f"layers/{name}", grid, tile, _maps(tile, grid, k, rng))
    if not sink.stored:  # small enough to have stayed in memory
        groups = {f"layers/{name}": sink.group(f"layers/{name}") for name in ("one", "two")}
        write_tree(run / "maps.zarr", groups)


def _maps(tile, grid, k, rng):
    """A tile of a layer: what both layers share, and noise of their own."""
    part = grid.part(tile.rows, tile.cols)
    wave = np.sin(part.y_um[:, None] / 130) * np.cos(part.x_um / 90) + np.sin(
        (part.y_um[:, None] + part.x_um) / 37
    )
    image = (120 + 20 * wave + rng.normal(0, 12, part.shape)).astype(np.float32)
    valid = np.hypot(part.y_um[:, None] % 4000 - 2000, part.x_um % 4000 - 2000) > 150
    found = {
        "image": (
            ("y", "x"),
            image,
            {"units": "1", "long_name": f"Grey value, uncalibrated {k + 1}"},
        ),
        "valid": (("y", "x"), valid, {"long_name": "Measured"}),
    }
    return xr.Dataset(found, coords=part.coords)


@contextmanager
def opened(run):
    """An empty page of a browser, the address of a run in the app, and the process that serves
    it."""
    from playwright.sync_api import sync_playwright

    shutil.rmtree(run / "edits", ignore_errors=True)  # marks of the last time
    command = planish("view", run, "--json", "--no-browser")
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        url = json.loads(server.stdout.readline())["url"]
        path = os.environ.get("PLANISH_CHROMIUM") or shutil.which("chromium") or "/usr/bin/chromium"
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
            yield browser.new_page(viewport=_WINDOW), url, server.pid
            browser.close()
    finally:
        server.terminate()
        server.wait()


def measure(run):
    """Serve the run and print the times."""
    with opened(run) as (page, url, server):
        say("first view of the page", _times(page, _SIDE, 1, lambda: page.goto(url)))
        clicks(page)
        maps = page.get_by_role("tab", name="Maps", exact=True)
        say("first view of the maps", _times(page, _MAPS, 1, maps.click))
        page.get_by_text(re.compile("Scatter of [0-9]+ points")).wait_for(timeout=120_000)
        spots = iter(np.random.default_rng(1).uniform(3000, 9000, (_REPEATS, 2)).round().tolist())
        say(
            "jump to full zoom, both maps",
            _times(page, _MAPS, _REPEATS, lambda: _jump(page, *next(spots))),
        )
        ranges = iter([f"{100 + k}, {130 + k}" for k in range(_REPEATS)])
        brush = "Brush one/image"
        say(
            "brush to repaint, both maps",
            _times(page, _MAPS, _REPEATS, lambda: _set(page, brush, next(ranges))),
        )
        page.get_by_role("button", name="Clear selection").click()
        begun = time.perf_counter()
        _set(page, "Region, um", "2000, 2000, 6000, 5000")
        page.get_by_text(re.compile(r"^n \d+; r ")).wait_for(timeout=120_000)
        print(f"r of a region of 4 x 3 mm at full resolution: {time.perf_counter() - begun:.2f} s")
        print(
            f"peak memory of the server: {memory(server, peak=True) / 1e6:.0f} MB; load"
            f" {os.getloadavg()[0]:.1f}"
        )


def clicks(page):
    """Set thirty marks by hand, and say how long each click took to be seen as a residual."""
    page.evaluate(_WATCH)
    page.get_by_label("Move views together").uncheck()
    for view in ("one", "two"):
        _set(page, f"{view}, um per screen pixel", "5")
    rng = np.random.default_rng(2)
    places = iter(
        rng.permutation(
            [(x, y) for x in range(2500, 17500, 1900) for y in range(2300, 12500, 1700)]
        )
    )
    model = page.get_by_label("Model", exact=True)
    for name, count in (("similarity", 20), ("auto", _REPEATS), ("tps", _REPEATS)):
        model.select_option(name)
        page.wait_for_timeout(500)
        shown, followed = [], []
        for _ in range(count):
            at = next(places) + rng.uniform(-200, 200, 2)
            for view, (x, y) in (("one", at), ("two", at + rng.normal(scale=3, size=2))):
                _set(page, f"{view} centre, um", f"{x:.2f}, {y:.2f}")
                until(page, "!document.querySelector('[aria-busy=true]')")
                _click(page, view)
            if page.locator(f"{_TABLE} tbody tr").count() < _FREE:
                page.wait_for_timeout(500)
                continue
            until(page, "clicked.rows && (!clicked.follows || clicked.followed)")
            page.wait_for_timeout(300)
            found = page.evaluate("clicked")
            shown.append(found["rows"])
            followed.append(found["followed"])
        say(f"click to residuals, {name}", [ms / 1000 for ms in shown], digits=3)
        if any(followed):
            say(f"... {name} itself", [ms / 1000 for ms in followed], digits=3)
    print(f"{page.locator(f'{_TABLE} tbody tr').count()} marks")


def until(page, truth):
    """Wait until an expression is true; the content policy forbids the wait of playwright."""
    end = time.perf_counter() + 30
    while not page.evaluate(truth):
        if time.perf_counter() > end:
            raise TimeoutError(f"not true after 30 s: {truth}")
        time.sleep(0.005)


def _click(page, view):
    box = page.get_by_role("application", name=view, exact=True).bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


# Milliseconds from the last click to the frame after the table had another row or residual, and to
# the one after the chosen model's own fit was there.
_WATCH = """() => {
  window.clicked = {};
  let begun = 0;
  const table = document.querySelector("table[aria-label=Marks] tbody");
  const text = () => [...table.rows].map((row) => row.cells[6].textContent).join();
  const painted = (then) => requestAnimationFrame(() => setTimeout(then));
  let before = "";
  window.addEventListener("click", (event) => {
    if (!event.target.closest("[role=application], tbody")) return;
    before = text();
    begun = event.timeStamp;
    window.clicked = { rows: 0, followed: 0, follows: false };
  }, true);
  new MutationObserver(() => {
    const now = text();
    if (!begun || now === before || now.endsWith("\u2013")) return;
    before = now;
    const { clicked } = window;
    clicked.follows = document.querySelector(".fit").textContent.includes("follows");
    painted(() => {
      const ms = performance.now() - begun;
      if (!clicked.rows) clicked.rows = ms;
      else clicked.followed = ms;
    });
  }).observe(
    document.querySelector("#panel-marks"),
    { childList: true, characterData: true, subtree: true },
  );
}"""


def _times(page, names, count, act):
    """Seconds from each of some acts until the views show something else and load nothing any
    more."""
    found = []
    for _ in range(count):
        before, begun = page.evaluate(_SHOWN, list(names)), time.perf_counter()
        act()
        while True:
            now = page.evaluate(_SHOWN, list(names))
            if all(now) and all(a != b for a, b in zip(now, before, strict=True)):
                break
            if time.perf_counter() > begun + 60:
                raise TimeoutError(f"{names} do not show it after 60 s")
            time.sleep(0.005)
        found.append(time.perf_counter() - begun)
    return found


def say(what, seconds, *, digits=2):
    print(
        f"{what}: {', '.join(f'{one:.{digits}f}' for one in seconds)} s (load"
        f" {os.getloadavg()[0]:.1f})",
        flush=True,
    )


def _set(page, label, text):
    field = page.get_by_label(label, exact=True)
    field.fill(text)
    field.press("Enter")


def _jump(page, x_um, y_um):
    _set(page, "Left map, um per screen pixel", str(PIXEL_UM))
    _set(page, "Left map centre, um", f"{x_um}, {y_um}")


# Of each view: 0 while it loads, else a sum of its pixels; its canvas is that of OpenLayers.
_SHOWN = """names => names.map(name => {
  const element = document.querySelector(`[role=application][aria-label="${name}"]`);
  const canvas = element?.querySelector("canvas");
  if (!canvas || !canvas.width || element.getAttribute("aria-busy") !== "false") return 0;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let sum = 0;
  for (let i = 0; i < data.length; i += 97) sum = (31 * sum + data[i]) % 1000000007;
  return sum;
})"""
