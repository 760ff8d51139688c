"""Threads: as many as asked for, or as the process may use; counted in a run of its own process."""

import json
import os
import subprocess
import sys
import threading

import pytest

from planish.core import threads as module
from planish.core.threads import (
    available,
    count_threads,
    limit_threads,
    map_threads,
    read_ahead,
    thread_pool,
)

# What a run starts is noted where threads start; zarr's event loop and its one worker are its own.
CHILD = """
import json, os, sys, threading
how, out, *arguments = sys.argv[1:]
if how == "64":
    os.cpu_count = lambda: 64
    os.sched_getaffinity = lambda _pid: set(range(64))
else:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
names, start = [], threading.Thread.start
def noted(thread):
    names.append(thread.name)
    start(thread)
threading.Thread.start = noted
before = []
from planish.cli import main
# Linear algebra and Arrow, which pandas looks for, start threads when imported.
import numpy, pandas, scipy.linalg
before = len(os.listdir("/proc/self/task"))
try:
    main(arguments)
finally:
    most = len(os.listdir("/proc/self/task")) - before
    with open(out, "w") as file:
        json.dump({"names": names, "more": most}, file)
"""


@pytest.mark.nightly  # two links, each in a process of its own
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system has no affinity")
@pytest.mark.parametrize(("how", "asked"), [("64", ["--threads", "1"]), ("one", [])])
def test_a_run_on_one_thread_starts_no_second(specimen_files, tmp_path, how, asked):
    out = tmp_path / "threads.json"
    command = [
        sys.executable,
        "-c",
        CHILD,
        how,
        out,
        "link",
        *specimen_files,
        "--out",
        tmp_path / "run",
        *asked,
    ]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 4), done.stderr
    found = json.loads(out.read_text())
    others = [name for name in found["names"] if not name.startswith("zarr")]
    assert others == []
    assert len([name for name in found["names"] if name.startswith("zarr_pool")]) <= 1
    assert found["more"] <= 2


def test_pools_follow_the_setting_and_give_it_back():
    before = count_threads()
    with limit_threads(1):
        assert (count_threads(), count_threads(3)) == (1, 3)
        with thread_pool() as pool:
            assert pool.submit(threading.get_ident).result() == threading.get_ident()
            with pytest.raises(ZeroDivisionError):
                pool.submit(lambda: 1 / 0).result()
        with limit_threads(None):
            assert count_threads() == 1
        assert map_threads(pow, range(5), [2] * 5) == [0, 1, 4, 9, 16]
    assert count_threads() == before
    assert "TIFFFILE_NUM_THREADS" not in os.environ
    assert map_threads(pow, range(5), [2] * 5, number=3) == [0, 1, 4, 9, 16]


def test_a_pool_of_one_works_item_by_item():
    done: list[int] = []
    with thread_pool(1) as pool:
        for k in pool.map(lambda n: done.append(n) or n, range(3)):
            assert done[-1] == k


def test_threads_are_eight_at_most_unless_given_or_limited_by_python(monkeypatch):
    monkeypatch.setattr(module, "available", lambda: 64)
    assert (count_threads(), count_threads(20)) == (8, 20)
    monkeypatch.setenv("PYTHON_CPU_COUNT", "3")
    assert available() == 3


@pytest.mark.parametrize(
    ("groups", "files", "expected"),
    [
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000", "a/cpu.max": "150000 100000"}, 2),
        ("0::/outside\n", {"cpu.max": "50000 100000"}, 1),
        (
            "5:cpu,cpuacct:/a\n",
            {"cpu/a/cpu.cfs_quota_us": "400000", "cpu/a/cpu.cfs_period_us": "100000"},
            4,
        ),
        (
            "5:cpu,cpuacct:/a\n",
            {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"},
            64,
        ),
        ("0::/a\n", {}, 64),
    ],
)
def test_limits_of_containers(tmp_path, monkeypatch, groups, files, expected):
    own = tmp_path / "cgroup"
    own.write_text(groups)
    for name, text in files.items():
        place = tmp_path / "fs" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text + "\n")
    quotas = module._quotas
    monkeypatch.setattr(module, "_quotas", lambda *_: quotas(own, tmp_path / "fs"))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    assert available() == expected


@pytest.mark.parametrize("number", [1, 2, 5])
def test_the_next_item_is_read_ahead_in_order(number):
    with limit_threads(number):
        assert [*read_ahead(lambda k: k**2, range(7))] == [k**2 for k in range(7)]
        assert [*read_ahead(str, [])] == []
        begun = []
        parts = read_ahead(lambda k: begun.append(k) or k, range(9))
        assert next(parts) == 0
        assert len(begun) <= 2  # no more than the next one is held
        parts.close()


def test_an_error_in_reading_ahead_comes_where_the_item_is_asked_for():
    parts = read_ahead(lambda k: 1 // (2 - k), range(4))
    assert [next(parts), next(parts)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(parts)
