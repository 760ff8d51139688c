"""What several benchmarks need: options, a folder, planish in processes of its own, and what these
take."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np


def options(name, words, **defaults):
    """Options of a benchmark: flags where the default is False, paths where None, else of the
    default's type."""
    parser = argparse.ArgumentParser(prog=name)
    for option, default in defaults.items():
        flag = f"--{option.replace('_', '-')}"
        if default is False:
            parser.add_argument(flag, action="store_true")
        else:
            parser.add_argument(
                flag, type=Path if default is None else type(default), default=default
            )
    return parser.parse_args([str(word) for word in words])


def folder_for(folder):
    """A folder that stays and is made where it is not there, or one that goes."""
    if folder is None:
        return tempfile.TemporaryDirectory()
    folder.mkdir(parents=True, exist_ok=True)
    return nullcontext(str(folder))


def planish(*arguments):
    """The command of a verb."""
    return [sys.executable, "-m", "planish", *map(str, arguments)]


@dataclass
class Ran:
    """How a command ended, what it took, and what it said; seconds from each stage that it names to
    the next one.

    The peak in bytes is read while it runs: what the system reports of a child begins with the size
    of the process that started it, and that has just made a specimen.
    """

    code: int = 0
    seconds: float = 0.0
    cpu: float = 0.0
    peak: float = 0.0
    said: str = ""
    stages: dict[str, float] = field(default_factory=dict)


def timed(command, **more):
    """Run a command."""
    ran, used, name = Ran(), children_s(), "start"
    begun = last = time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **more
    ) as process:
        threading.Thread(target=_follow, args=(process, ran), daemon=True).start()
        for line in process.stderr:
            now = time.perf_counter()
            ran.stages[name] = ran.stages.get(name, 0.0) + now - last
            ran.said += line
            last, name = now, line.partition(":")[0]
        ran.code = process.wait()
    now = time.perf_counter()
    ran.stages[name] = ran.stages.get(name, 0.0) + now - last
    ran.seconds, ran.cpu = now - begun, children_s() - used
    return ran


def succeeded(command, **more):
    """Run a command that has to go well, with or without a check that fails."""
    ran = timed(command, **more)
    if ran.code not in (0, 4):
        sys.exit(ran.said)
    return ran


def _follow(process, ran):
    while process.poll() is None:
        with suppress(OSError, StopIteration, ValueError):
            ran.peak = max(ran.peak, memory(process.pid, peak=True))
        time.sleep(0.2)


def children_s():
    """Processor seconds of all children that have ended."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def memory(pid="self", *, peak=False):
    """Bytes that a process holds, or held at most (Linux)."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    key = "VmHWM:" if peak else "VmRSS:"
    return 1024.0 * int(next(line for line in lines if line.startswith(key)).split()[1])


def forget_peak():
    """Set the peak of this process back to what it holds now, in bytes."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return memory()


def small_specimen(folder, holes=5):
    """Write volume and image of a small specimen."""
    from planish.synthetic import (
        BurnParams,
        CameraParams,
        ScannerParams,
        SpecimenParams,
        make_specimen,
        write_instruments,
    )

    params = SpecimenParams(
        size_um=(1300.0, 1000.0),
        holes=BurnParams(pattern="irregular", count=holes),
        seed=5,
        scanner=ScannerParams(voxel_um=4.0),
        camera=CameraParams(pixel_um=5.0),
    )
    return write_instruments(make_specimen(params), folder)


def size_of(path):
    """Bytes of a file, or of all files of a folder."""
    return sum(
        file.stat().st_size
        for file in (path.rglob("*") if path.is_dir() else [path])
        if file.is_file()
    )


def rms(values):
    """Root mean square of the finite values; NaN where there are none."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def in_parts(pool, work, count, chunk=50):
    """Do ``work(seed, count)`` in parts, each with its first number as its seed, and put the rows
    together."""
    seeds = range(0, count, chunk)
    return np.concatenate([*pool.map(work, seeds, [min(chunk, count - k) for k in seeds])])
