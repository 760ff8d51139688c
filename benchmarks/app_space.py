"""The sheet in space, in a real browser that draws without a graphics card: times of frames and of full detail.

    python -m benchmarks app_space RUN FOLDER

RUN is any link, such as the demo's. A copy of it with a flat map of 2000 x 1500 points is opened in the app.
"""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from benchmarks.app import opened
from planish.core.area import overviews
from planish.io.map_groups import write_tree

ROWS, COLS, PITCH_UM = 1500, 2000, 10.0
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
CANVAS = "canvas.space"


def large(run: Path, folder: Path) -> Path:
    """Copy a run and give it a flat map of three million points."""
    shutil.copytree(run, folder)
    old = xr.open_dataset(run / "maps.zarr", group="maps", engine="zarr")
    for name in ("maps", "overviews"):
        shutil.rmtree(folder / "maps.zarr" / name, ignore_errors=True)
    v, u = (PITCH_UM * np.arange(n) for n in (ROWS, COLS))
    y, x = np.meshgrid(v, u, indexing="ij")
    noise = np.random.default_rng(1).standard_normal((ROWS, COLS))
    values = {
        "projected_u": 0.98 * x, "projected_v": 0.99 * y, "volume_x": 0.98 * x, "volume_y": 0.99 * y,
        "volume_z": 500 + 0 * x, "warp": 300 * np.sin(x / 2600) * np.cos(y / 4000) + 0.5 * noise,
        "coating_top": 15 + 5 * np.sin(x / 90) * np.sin(y / 70) + noise, "thickness": 100 + noise,
    }  # fmt: skip
    hole = np.hypot(x - 8000, y - 6000) < 120
    maps = {k: (("v", "u"), np.where(hole, np.nan, a), dict(old[k].attrs)) for k, a in values.items()}
    data = xr.Dataset({**maps, "valid": (("v", "u"), ~hole)}, coords={"v": v, "u": u}, attrs=old.attrs)
    groups = {"maps": data} | {f"overviews/maps/{k}": one for k, one in enumerate(overviews(data), 1)}
    write_tree(folder / "maps.zarr", groups)
    return folder


def shown(page: Any) -> dict[str, str]:
    """What the canvas says of the last frame."""
    return page.locator(CANVAS).evaluate("canvas => ({...canvas.dataset})")


def until_full(page: Any) -> float:
    """Seconds until all that the screen can show is drawn."""
    begin = time.perf_counter()
    while shown(page).get("detail") != "full" and time.perf_counter() - begin < 30:
        time.sleep(0.02)
    return time.perf_counter() - begin


def measure(page: Any) -> None:
    """Open the tab, turn the sheet, come nearer, let go."""
    begin = time.perf_counter()
    page.get_by_role("tab", name="Flattening").click()
    page.locator(f"{CANVAS}[data-triangles]").wait_for(timeout=30_000)
    print(f"first frame after {time.perf_counter() - begin:.2f} s", flush=True)
    print(f"full detail after {until_full(page):.2f} s more: {shown(page)['triangles']} triangles", flush=True)
    time.sleep(4)  # the levels between are made meanwhile
    box = page.locator(CANVAS).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for far in ("far", "near"):
        page.mouse.move(x, y)
        page.mouse.down()
        frames = []
        for k in range(40):
            page.mouse.move(x + 5 * k, y + 2 * k)
            time.sleep(0.05)
            now = shown(page)
            frames.append((float(now["milliseconds"]), int(now["triangles"])))
        page.mouse.up()
        slow = sorted(ms for ms, _ in frames)
        print(
            f"{far}: frames of {slow[len(slow) // 2]:.0f} ms (median), {slow[-1]:.0f} ms at most, with "
            f"{min(n for _, n in frames)} to {max(n for _, n in frames)} triangles; full detail "
            f"{until_full(page):.2f} s after it stood still: {shown(page)['triangles']} triangles", flush=True,
        )  # fmt: skip
        for _ in range(6):
            page.locator(CANVAS).press("+")
        until_full(page)
        time.sleep(2)


def main(run: str, folder: str) -> int:
    home = Path(folder) / "three-million"
    if not home.exists():
        large(Path(run), home)
    with opened(home, *SOFTWARE) as (page, url, _):
        page.goto(url)
        measure(page)
    return 0
