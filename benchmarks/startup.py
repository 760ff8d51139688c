"""What it takes to start: help, a look at a file, the demo's link and relink warm, and the demo on
a machine that compiles first.

``python -m benchmarks startup [TIMES [COLD [OLDER]]]``

Times by the clock for ``planish --help`` (.25 s) and ``planish info`` of a TIFF (.55 s), processor
time for the demo's link with everything compiled (7.5 s), and for the link of the mapped run of its
volume (relink); medians. With COLD, 1, the demo whole with an empty cache of compiled functions,
once, and what of it is not there with a full one. With OLDER, the folder ``src`` of another
checkout, its relink of the same specimen in turn with that of this one, and the ratio (.6). What a
module costs is in ``python -X importtime -m planish VERB``.
"""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
from pathlib import Path

from benchmarks.shared import planish, succeeded

_LIMITS = {"--help": 0.25, "info": 0.55, "link": 7.5}
_RATIO = 0.6
_SOURCES = Path(__file__).parents[1] / "src"


def main(times=5, cold=0, older=""):
    """Print the times; 1 where one is above its limit."""
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        succeeded(planish("demo", "--out", folder / "demo"))
        specimen = folder / "demo" / "specimen"
        volume, image = specimen / "volume.tif", specimen / "image.tif"
        for what, arguments in (
            ("--help", ("--help",)),
            ("info", ("info", volume)),
            ("link", ("link", volume, image, "-o", folder / "run")),
        ):
            taken = []
            for _ in range(times):
                shutil.rmtree(folder / "run", ignore_errors=True)
                ran = succeeded(planish(*arguments))
                taken.append(ran.cpu if what == "link" else ran.seconds)
            failed |= told(what, taken)
        failed |= relinked(folder, volume, image, times, older)
        if cold:
            for words in ("empty", "full"):
                cache = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
                used = succeeded(planish("demo", "--out", folder / words), env=cache).cpu
                print(f"demo with {words} cache: {used:.1f} s of the processor", flush=True)
    return int(failed)


def relinked(folder, volume, image, times, older):
    """Link mapped runs of the volume, by this code and the older one in turn; True above a
    limit."""
    sources = {"relink": _SOURCES} | ({"older": Path(older).absolute()} if older else {})
    codes = {name: os.environ | {"PYTHONPATH": str(path)} for name, path in sources.items()}
    taken = {name: [] for name in codes}
    for name, code in codes.items():
        succeeded(planish("map", volume, "-o", folder / f"{name}-map"), env=code)
    # The first of each finds files and functions that the system does not hold yet.
    for turn in range(times + 1):
        for name, code in codes.items():
            shutil.rmtree(folder / "run", ignore_errors=True)
            arguments = planish("link", folder / f"{name}-map", image, "-o", folder / "run")
            used = succeeded(arguments, env=code).cpu
            taken[name] += [used] if turn else []
    failed = told("relink", taken["relink"])
    if older:
        told("older", taken["older"])
        ratio = statistics.median(taken["relink"]) / statistics.median(taken["older"])
        print(f"relink over the older one: {ratio:.2f}; limit {_RATIO}", flush=True)
        failed |= ratio > _RATIO
    return failed


def told(what, taken):
    """Print a median and its range; True where it is above its limit."""
    median, limit = statistics.median(taken), _LIMITS.get(what)
    said = f"; limit {limit}" if limit else ""
    print(f"{what:7} {median:6.2f} s ({min(taken):.2f} to {max(taken):.2f}){said}", flush=True)
    return limit is not None and median > limit
