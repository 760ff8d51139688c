"""Damaged runs by the hundred: does every one end with a sentence and an exit code of its own?

    python -m benchmarks fuzz [PART] [COUNT] [CASE]

Parts: files (run.toml, results.json, marks.json), chunks (the maps of a run). Each case has its
number as its seed, so that one can be made again alone. Commands run in this process, as
`planish.cli.main`. Damaged images, volumes and marks are read in tests: `tests/io/test_damage.py`,
`tests/io/test_damage_formats.py`, `tests/marks/test_files_faults.py`.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.shared import forget_peak, memory, small_specimen
from planish.cli import main as planish

SEED = 5
ALLOWED = {0, 3, 4, 5}
_REFUSED = {3, 5}
_MOST_MIB = 512  # more than before, of a case that is refused
_MOST_S = 5.0
_ENOUGH_S = 120
_HEAD = 400  # bytes in which headers are damaged
_HUGE = (2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1, 10**9, 65535, 0, 1)
_ODD = (
    None,
    True,
    -1,
    0,
    1,
    2**31,
    2**70,
    1e308,
    -1e-300,
    float("nan"),
    float("inf"),
    "",
    "x",
    "nan",
    "../../x",
    "ä\x1b[31m",
    [],
    {},
    [1],
    [[]],
    {"a": 1},
    "9" * 5000,
)
_NUMBERS = (
    "1e999",
    "-1e308",
    "nan",
    "inf",
    "-0",
    "0",
    "99999999999999999999",
    "1e-320",
    "",
    "x",
    "0x10",
    "true",
    "[1",
)


@dataclass(kw_only=True)
class End:
    """How one command ended."""

    code: int
    said: str
    seconds: float
    mib: float
    faults: list[str] = field(default_factory=list)


def main(part="all", count=300, only=""):
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        ground = Path(name) / "ground"
        files = small_specimen(ground)
        run, image = ground / "run", Path(files.image)
        if ended(("link", str(files.volume), str(image), "--out", str(run))).code:
            sys.exit("The run that is to be damaged was not made.")
        for one in PARTS if part == "all" else [part]:
            cases = range(int(count)) if only == "" else [int(only)]
            failed += fuzzed(one, cases, run, image, show=only != "")
    return failed


def fuzzed(part, cases, run, image, *, show):
    """Run the cases of a part, print how they ended, and return how many broke the rule."""
    ends = Counter()
    failed, slowest, largest = 0, 0.0, 0.0
    for k in cases:
        place = run.with_name(f"{part}-{k}")
        # a file that is changed is made anew.
        shutil.copytree(run, place / "run", copy_function=os.link)
        what, commands = PARTS[part](random.Random(f"{SEED} {part} {k}"), place, image)
        for arguments in commands:
            before = entries(place)
            end = ended(arguments)
            if end.code in _REFUSED:
                slowest, largest = max(slowest, end.seconds), max(largest, end.mib)
                if entries(place) != before:
                    end.faults.append(f"left {', '.join(sorted(entries(place) - before)[:3])}")
            ends[f"{arguments[0]} {end.code}"] += 1
            failed += bool(end.faults)
            if end.faults or show:
                print(
                    f"{part} {k}: {what}: planish {' '.join(arguments)}: {end.code},"
                    f" {'; '.join(end.faults)}\n    {end.said}\n    again: python -m benchmarks"
                    f" fuzz {part} 1 {k}",
                    flush=True,
                )
        shutil.rmtree(place)
    how = ", ".join(f"{count} x {name}" for name, count in sorted(ends.items()))
    print(
        f"{part}: {len(cases)} cases, command and exit code: {how}; {failed} broke the rule;"
        f" refused within {slowest:.1f} s of processor time and {largest:.0f} MiB",
        flush=True,
    )
    return failed


def entries(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


# --- one command ----------------------------------------------------------------------------------


class _Hangs(BaseException):
    """A command did not end."""


def ended(arguments):
    """Run one command in this process, and compare its end with the rule."""

    def stop(*_):
        raise _Hangs

    out, err = io.StringIO(), io.StringIO()
    before, start = forget_peak(), time.process_time()
    code = -1
    signal.signal(signal.SIGALRM, stop)
    signal.alarm(_ENOUGH_S)
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("default")
            planish(list(arguments))
    except SystemExit as error:
        code = error.code or 0
    except _Hangs:
        err.write(f"did not end within {_ENOUGH_S} s")
    finally:
        signal.alarm(0)
    seconds, mib = time.process_time() - start, (memory(peak=True) - before) / 2**20
    text = err.getvalue()
    sentence = re.search(r"^planish: .*", text, re.MULTILINE | re.DOTALL)
    end = End(code=code, said=text.strip()[-600:], seconds=seconds, mib=mib)
    if code not in ALLOWED:
        end.faults.append(f"exit code {code}{_logged(text)}")
    if "Traceback" in out.getvalue() + text:
        end.faults.append("a traceback")
    if found := re.search(r"^.*\w+Warning: .*$", text, re.MULTILINE):
        end.faults.append(f"a warning of Python: {found[0][-200:]}")
    if code in _REFUSED and not sentence:
        end.faults.append("no sentence")
    if code in _REFUSED and seconds > _MOST_S:
        end.faults.append(f"{seconds:.1f} s of processor time")
    if code in _REFUSED and mib > _MOST_MIB:
        end.faults.append(f"{mib:.0f} MiB")
    return end


def _logged(text):
    """The end of the log that a fault of planish leaves, which goes."""
    found = re.search(r"The details are in (\S+\.log)", text)
    if not found:
        return ""
    log = Path(found[1])
    lines = log.read_text(encoding="utf-8").splitlines()
    log.unlink()
    places = [line.strip() for line in lines if line.startswith("  File") and "planish" in line]
    return f" ({' < '.join(re.sub(r'.*/planish/', '', place) for place in places[:-4:-1])})"


# --- damages --------------------------------------------------------------------------------------


def damaged(data, rng, *, text=False):
    """Damage a file, and say how."""
    ways = [cut, flipped, huge, moved]
    if text:
        ways += [number] * 3 + [nested]
        with contextlib.suppress(ValueError):
            json.loads(data)
            ways += [leaf] * 8
    way = rng.choice(ways)
    return way(data, rng), way.__name__


def _place(data, rng, size=1):
    """A place in the file, in half of the cases near its head."""
    last = max(len(data) - size, 0)
    return rng.randint(0, min(last, _HEAD) if rng.random() < 0.5 else last)


def cut(data, rng):
    return data[
        : rng.choice((0, _place(data, rng), _place(data, rng), len(data) - rng.randint(1, 64)))
    ]


def flipped(data, rng):
    found = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        found[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(found)


def huge(data, rng):
    """A number in the header becomes another, or one that no file has."""
    size = rng.choice((2, 4, 8))
    at = rng.randint(0, min(max(len(data) - size, 0), _HEAD)) // 2 * 2
    value = rng.choice(_HUGE) % 2 ** (8 * size)
    return data[:at] + value.to_bytes(size, rng.choice(("little", "big"))) + data[at + size :]


def moved(data, rng):
    """A piece is lost, or there twice, or foreign bytes are between."""
    at, size = _place(data, rng), rng.randint(1, 64)
    return (
        data[:at]
        + rng.choice((b"", data[at : at + size] * 2, rng.randbytes(size)))
        + data[at + size :]
    )


def number(data, rng):
    """A number of a text becomes an odd one."""
    found = [*re.finditer(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?", data)]
    for one in sorted(
        rng.sample(found, min(len(found), rng.choice((1, 1, 2)))), key=lambda m: -m.start()
    ):
        data = data[: one.start()] + rng.choice(_NUMBERS).encode() + data[one.end() :]
    return data


def nested(data, rng):
    at = _place(data, rng)
    return (
        data[:at] + rng.choice((b"[", b'{"a":', b"(")) * rng.choice((3, 5000, 200_000)) + data[at:]
    )


def leaf(data, rng):
    """Values of a JSON file become odd ones, or are lost, or have other names."""
    content = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 3))):
        places = [*_places(content)]
        if not places:
            break
        holder, key = rng.choice(places)
        way = rng.random()
        if way < 0.6:
            holder[key] = rng.choice(_ODD)
        elif way < 0.8:
            del holder[key]
        elif isinstance(holder, dict):
            holder[f"{key}x"] = holder.pop(key)
        else:
            holder.append(holder[key])
    return json.dumps(content).encode()


def _places(content):
    keys = (
        content.keys()
        if isinstance(content, dict)
        else range(len(content))
        if isinstance(content, list)
        else ()
    )
    for key in [*keys]:
        yield content, key
        yield from _places(content[key])


# --- the parts ------------------------------------------------------------------------------------


def of_files(rng, place, image):
    """A damaged file of the run, which is linked again."""
    path = place / "run" / rng.choice(("run.toml", "results.json", "marks.json"))
    what, run = changed(path, rng, text=True), str(place / "run")
    return what, (("link", run, str(image), "--out", str(place / "out")), ("info", run))


def of_chunks(rng, place, _):
    """A damaged header or chunk of the maps."""
    store, run = place / "run" / "maps.zarr", str(place / "run")
    headers = sorted(store.rglob("zarr.json"))
    if rng.random() < 0.4:
        path = store / "zarr.json" if rng.random() < 0.7 else rng.choice(headers)
    else:
        path = rng.choice(
            sorted(p for p in store.rglob("*") if p.is_file() and p.name != "zarr.json")
        )
    if rng.random() < 0.15:
        path.unlink()
        what = f"{path} removed"
    else:
        what = changed(path, rng, text=path.name == "zarr.json")
    return what, (("report", run, "--out", str(place / "page.html")), ("info", run))


def changed(path, rng, *, text):
    """Damage a file of a run, and say how."""
    data, what = damaged(path.read_bytes(), rng, text=text)
    path.unlink()
    path.write_bytes(data)
    return f"{path.name} {what}"


PARTS = {"files": of_files, "chunks": of_chunks}
