"""What it takes to start: help, a look at a file, the demo's link warm, and the demo on a machine
that compiles first.

``python -m benchmarks startup [TIMES [COLD]]``

Times by the clock for ``planish --help`` (.25 s) and ``planish info`` of a TIFF (.55 s), processor
time for the demo's link with everything compiled (7.5 s); medians. With COLD, 1, the demo whole
with an empty cache of compiled functions, once, and what of it is not there with a full one. What a
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


def main(times=5, cold=0):
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
            median = statistics.median(taken)
            print(
                f"{what:7} {median:6.2f} s ({min(taken):.2f} to {max(taken):.2f}); limit"
                f" {_LIMITS[what]}"
            )
            failed |= median > _LIMITS[what]
        if cold:
            for words in ("empty", "full"):
                cache = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
                used = succeeded(planish("demo", "--out", folder / words), env=cache).cpu
                print(f"demo with {words} cache: {used:.1f} s of the processor", flush=True)
    return int(failed)
