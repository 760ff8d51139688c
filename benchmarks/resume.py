"""Runs that are killed at random moments and go on, and runs on a cluster of which a worker dies: same bytes?

    python -m benchmarks resume [MVOXEL] [TIMES]

Every process is started and killed as a user, or the system, would: the command line, and kill -9.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tifffile

from benchmarks.size import DEPTH, VOXEL_UM, volume
from planish.synthetic import BurnParams, CameraParams, ScannerParams, SpecimenParams, make_specimen, write_instruments

SEED = 5
SPECIMEN = SpecimenParams(
    size_um=(2600.0, 2000.0), holes=BurnParams(pattern="irregular", count=7), scanner=ScannerParams(voxel_um=4.0),
    camera=CameraParams(pixel_um=5.0), seed=5,
)  # fmt: skip
_ENOUGH_S = 900


def main(mvoxel: int | str = 120, times: int | str = 10) -> int:
    rng = random.Random(SEED)
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        edge = round(np.sqrt(int(mvoxel) * 1e6 / DEPTH))
        stack = folder / "stack.tif"
        tifffile.imwrite(stack, volume((DEPTH, edge, edge)).values, photometric="minisblack")
        print(f"{DEPTH} x {edge} x {edge} voxels")
        importing = ["import", str(stack), "--voxel-um", str(VOXEL_UM), "--memory", "500MB"]
        store = folder / "sheet.zarr"
        whole, took = timed(importing, store)
        failed += kills("import", importing, folder, whole, took, rng, int(times))
        failed += on_cluster("import", importing, folder, whole)
        mapping = ["map", str(store), "--memory", "1GB"]
        files = write_instruments(make_specimen(SPECIMEN), folder / "specimen")
        linking = ["link", str(files.volume), str(files.image)]
        for what, arguments in (("map", mapping), ("link", linking)):
            whole, took = timed(arguments, folder / what)
            failed += kills(what, arguments, folder, whole, took, rng, int(times))
            failed += on_cluster(what, arguments, folder, whole)
    return failed


def command(arguments: list[str], out: Path) -> list[str]:
    return [sys.executable, "-m", "planish", *arguments, "--out", str(out)]


def timed(arguments: list[str], out: Path) -> tuple[dict[str, str], float]:
    start = time.perf_counter()
    done = subprocess.run(command(arguments, out), capture_output=True, text=True, check=False)
    if done.returncode not in (0, 4):
        sys.exit(done.stderr)
    return hashes(out), time.perf_counter() - start


def kills(
    what: str, arguments: list[str], folder: Path, whole: dict[str, str], took: float, rng: random.Random, times: int
) -> int:
    """Kill a command at random moments, start it again, and compare."""
    failed = 0
    rests: list[float] = []
    for k in range(times):
        out = folder / f"{what}-{k}"
        process = subprocess.Popen(command(arguments, out), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        moment = rng.uniform(0.02, 0.98) * took
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moment)
        process.kill()
        process.wait()
        start = time.perf_counter()
        if not out.exists():
            subprocess.run(command(arguments, out), capture_output=True, check=False, timeout=_ENOUGH_S)
        rests.append(time.perf_counter() - start)
        same = hashes(out) == whole
        left = [p.name for p in folder.glob(f".{out.name}*")]
        failed += not same or bool(left)
        print(f"{what}: killed after {moment:.1f} s of {took:.1f} s, went on for {rests[-1]:.1f} s, "
              f"{'same bytes' if same else 'OTHER BYTES'}{' and left ' + ', '.join(left) if left else ''}")  # fmt: skip
        shutil.rmtree(out, ignore_errors=True)
    return failed


def on_cluster(what: str, arguments: list[str], folder: Path, whole: dict[str, str]) -> int:
    """Run a command on two workers, whole and with one of them killed."""
    failed, took = 0, 0.0
    with cluster(folder) as (address, workers):
        for killed in (False, True):
            out = folder / f"{what}-cluster-{killed}"
            start = time.perf_counter()
            run = subprocess.Popen(command([*arguments, "--scheduler", address], out), stdout=subprocess.DEVNULL,
                                   stderr=subprocess.PIPE, text=True)  # fmt: skip
            how = "two workers"
            if killed:
                time.sleep(0.45 * took)
                how = f"{how}, one killed {f'after {0.45 * took:.1f} s' if run.poll() is None else 'TOO LATE'}"
                os.kill(workers[0].pid, signal.SIGKILL)
            said = run.communicate(timeout=_ENOUGH_S)[1]
            took = time.perf_counter() - start
            same = hashes(out) == whole
            failed += not same
            print(f"{what} on a cluster, {how}: {'same bytes' if same else 'OTHER BYTES'}, {took:.1f} s")
            if not same:
                print(said)
    return failed


def hashes(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers on this machine, as the README starts them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"], **quiet
    )
    worker = [*dask, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
    try:
        from distributed import Client

        with Client(address, timeout="60s", set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
