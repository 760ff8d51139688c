"""What it takes to start: help, a look at a file, the demo's link warm, and the demo on a machine that compiles first.

``python -m benchmarks startup [TIMES [COLD]]``

Times by the clock for ``planish --help`` (.25 s) and ``planish info`` of a TIFF (.55 s), processor time for the demo's
link with everything compiled (7.5 s); medians. With COLD, 1, the demo whole with an empty cache of compiled functions,
once, and what of it is not there with a full one. What a module costs is in ``python -X importtime -m planish VERB``.
"""

from __future__ import annotations

import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_LIMITS = {"--help": 0.25, "info": 0.55, "link": 7.5}


def _run(arguments: list[str], cache: Path | None = None) -> tuple[float, float]:
    """Seconds by the clock and of the processor."""
    environment = os.environ if cache is None else os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "planish", *arguments], env=environment, capture_output=True, text=True
    )
    took, now = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 4):
        sys.exit(done.stderr)
    return took, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime


def main(times: int = 5, cold: int = 0) -> int:
    """Print the times; 1 where one is above its limit."""
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _run(["demo", "--out", str(folder / "demo")])
        specimen = folder / "demo" / "specimen"
        volume, image = specimen / "volume.tif", specimen / "image.tif"
        for what, arguments in (
            ("--help", ["--help"]),
            ("info", ["info", str(volume)]),
            ("link", ["link", str(volume), str(image), "-o", str(folder / "run")]),
        ):
            taken: list[float] = []
            for _ in range(times):
                shutil.rmtree(folder / "run", ignore_errors=True)
                taken.append(_run(arguments)[what == "link"])
            median = statistics.median(taken)
            print(f"{what:7} {median:6.2f} s ({min(taken):.2f} to {max(taken):.2f}); limit {_LIMITS[what]}")
            failed |= median > _LIMITS[what]
        if cold:
            for words in ("empty", "full"):
                used = _run(["demo", "--out", str(folder / words)], folder / "cache")[1]
                print(f"demo with {words} cache: {used:.1f} s of the processor", flush=True)
    return int(failed)
