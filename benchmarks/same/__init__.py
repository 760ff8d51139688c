"""Whether two commits give the same: every array and number of what each of them does, on this
machine, in one call.

    python -m benchmarks same OLD [PART ...] [--new DIR] [--folder DIR] [--reuse] [--list]

OLD is a commit; it is checked out into a worktree with an environment of its own (its locks, the
network). The other side is this checkout with the environment that runs this, or DIR with its
sources. Both do the same parts, each on one core, with one version number and the same specimens,
which OLD makes; runs of earlier versions are made by these versions. Compared are arrays with
types, coordinates and attributes, numbers of results, marks, tables, exit codes and pages;
differences are named by place and size. KEYS says which keys of results got another name, EXPECTED
which differences are meant. It ends with 1 where there are others. Linux only.

``--folder`` keeps worktrees, environments and results. ``--reuse`` takes the results of OLD from
there, where they were made on this machine by these parts.
"""

from __future__ import annotations

import argparse
import fnmatch
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.same.difference import differences
from benchmarks.same.parts import PARTS, Side
from benchmarks.shared import folder_for

_ROOT = Path(__file__).resolve().parents[2]
_HERE = Path(__file__).parent
_FORMER = {"0.1.0": "53637cb", "0.2.0": "9ab4fc1"}  # the last commit of each version's own results
_MOST_LINES = 20  # of one part

KEYS = {
    "evidence[].ceiling": "evidence[].attenuation_limit",
    "evidence[].ceiling_noise": "evidence[].attenuation_limit_noise",
    "evidence[].ceiling_both": "evidence[].attenuation_limit_both",
    "evidence[].second_opinion": "evidence[].conley_interval",
    "evidence[].twice": "evidence[].agreement",
    "evidence[].kubelka_munk.silence": "evidence[].kubelka_munk.reason",
    "evidence[].light_spread.silence": "evidence[].light_spread.reason",
    "evidence[].partial.silence": "evidence[].partial.reason",
    "evidence[].reliability[].silence": "evidence[].reliability[].reason",
    "layers[].registration.lag.silence": "layers[].registration.lag.reason",
    "mottle[].silence": "mottle[].reason",
}
"""Keys of results that got another name: old -> new, with ``[]`` for an index."""

_CODE = "which code made a run is noted since 0.3.0"
EXPECTED = (
    ("*.json:code", _CODE),
    ("exports/all-crate/ro-crate-metadata.json:*", f"size and hash of results.json: {_CODE}"),
    (
        "design/specimen/truth/parameters.json:parameters.*",
        "a base of fibres, a film and section gains are parameters",
    ),
    ("*.json:*.remedy", "what a check asks to be set is a field of its own"),
    ("*.json:*.size_doubt", "a size by a default resolution is doubted"),
    ("*marks.json:*.origin_um.*", "marks of a run say where its map begins"),
    ("*-info.json:notes", "info says what was assumed to read a volume"),
    ("*.json:*.ceiling_sentence", "the page words the limit that attenuation sets"),
    ("*.zarr:*.format", "stores of maps say their format"),
    ("*results.json:format", "the format rises"),
    ("*.zarr:*.long_name", "grey values of an image are called uncalibrated"),
    ("*topography*", "topography is the face about its own form"),
    ("*base_surface*", "the interface about its own form is a map"),
    ("*half_thickness*", "what topography was is the half thickness"),
    ("*roughness*", "roughness is that of the face itself, up to the border"),
    ("*.zarr:*._FillValue", "what is NaN is missing without being told"),
    ("*.json:*.coefficient_of_variation", "properties have a coefficient of variation"),
    ("*.json:*.negative_control", "the pose in the scanner is called a negative control"),
    ("*.json:*.p_of_table", "Holm leaves the negative control out"),
    ("*figures.csv:*", "the negative control is called one"),
    ("*.json:*.partial.*", "maps that contain each other are named, with r of the map alone"),
    ("*.json:*.thin.*.standard_error*", "the standard error of a thin share counts neighbours"),
    ("*.json:*.thin.*.warning", "a thin share that rests on noise is said to"),
    ("*:*fibre_angle*", "angles of an axis are averaged as such"),
    ("*.json:*.period_deg", "angles of an axis say so"),
    ("*:*porosity*", "porosity without the grey of a wall is doubtful, and states that grey"),
    ("*-info.json:run_bytes", "info counts the memory that a run reckons with"),
    ("former/*-info.json:warning", "runs of 0.2.0 are named by their format"),
    *(
        (f"former/{what}", "runs of 0.2.0 are opened")
        for what in ("0.2.0[-.]*", "07-correlate.json:*", "commands.json:*")
    ),
)
"""Differences that are meant: a pattern of ``PART/PLACE``, and why."""


def main(*arguments):
    """Print what differs, part by part; 1 where something does that is not meant."""
    parser = argparse.ArgumentParser(prog="same")
    parser.add_argument("old", nargs="?", help="commit to compare with")
    parser.add_argument("parts", nargs="*", metavar="PART", help="all where none is named")
    parser.add_argument(
        "--new", type=Path, default=_ROOT, help="checkout to compare; this one where not given"
    )
    parser.add_argument("--folder", type=Path, default=None, help="where all is made, and kept")
    parser.add_argument(
        "--reuse", action="store_true", help="take results of OLD that --folder holds"
    )
    parser.add_argument("--list", action="store_true", dest="listed", help="name the parts and end")
    asked = parser.parse_intermixed_args([str(a) for a in arguments])
    if asked.listed or asked.old is None:
        print("\n".join(f"{name:14} {part.title}" for name, part in PARTS.items()))
        return 0
    names = asked.parts or list(PARTS)
    if unknown := set(names) - set(PARTS):
        sys.exit(f"There is no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}.")
    commit = _git("rev-parse", "--short=10", f"{asked.old}^{{commit}}")
    with folder_for(asked.folder) as place:
        return compare(Path(place).resolve(), commit, asked.new.resolve(), names, reuse=asked.reuse)


def compare(folder, commit, new, names, *, reuse):
    """Do the parts on both sides at the same time, and print their differences."""
    begun, home = time.monotonic(), folder / commit
    tree = worktree(folder, commit)
    python = environment(tree)
    make_inputs(home, tree, python)
    cores = sorted(os.sched_getaffinity(0))
    sides = (
        Side(python=python, source=tree / "src", home=home / "old", core=cores[0]),
        Side(python=Path(sys.executable), source=new / "src", home=home / "new", core=cores[-1]),
    )
    print(
        f"old: {commit}; new: {new.name} at"
        f" {_git('-C', str(new), 'rev-parse', '--short=10', 'HEAD')}",
        flush=True,
    )
    # Each side does one part at a time.
    with ThreadPoolExecutor(1) as old_pool, ThreadPoolExecutor(1) as new_pool:
        pairs = [
            (
                old_pool.submit(_done, sides[0], name, reuse),
                new_pool.submit(_done, sides[1], name, False),
            )
            for name in names
        ]
        failed = sum(
            _reported(name, home, [k.result() for k in pair])
            for name, pair in zip(names, pairs, strict=True)
        )
    print(
        f"{len(names)} parts, {failed} with differences that are not meant;"
        f" {time.monotonic() - begun:.0f} s"
    )
    return int(failed > 0)


def _done(side, name, reuse):
    """Do a part, unless it is there; say how long it took."""
    mark = side.home / f"{name}.done"
    stamp = _stamp(name)
    if reuse and mark.is_file() and mark.read_text(encoding="utf-8") == stamp:
        return "kept"
    mark.unlink(missing_ok=True)
    begun = time.monotonic()
    try:
        side.do(name)
    except Exception as error:  # noqa: BLE001  a part that breaks is a difference, and stops no other
        (side.folder / "broken.json").write_text(f'"{type(error).__name__}"', encoding="utf-8")
        return f"{type(error).__name__}: {error}"
    mark.write_text(stamp, encoding="utf-8")
    return f"{time.monotonic() - begun:.0f} s"


def _reported(name, home, seconds):
    """Print the differences of a part; whether some are not meant."""
    lines = {"differs": [], "meant": []}
    for place, what in differences(home / "old" / name, home / "new" / name, KEYS):
        why = next(
            (why for pattern, why in EXPECTED if fnmatch.fnmatchcase(f"{name}/{place}", pattern)),
            None,
        )
        lines["differs" if why is None else "meant"].append(
            f"{place}: {what}" + (f" ({why})" if why else "")
        )
    heads = ", ".join(f"{len(rows)} {word}" for word, rows in lines.items() if rows) or "same"
    print(f"{name}: {heads}; old {seconds[0]}, new {seconds[1]}")
    for word, rows in lines.items():
        for row in rows[:_MOST_LINES]:
            print(f"  {word}: {row}")
        if len(rows) > _MOST_LINES:
            print(f"  {word}: and {len(rows) - _MOST_LINES} more")
    sys.stdout.flush()
    return bool(lines["differs"])


# --- what both sides need --------------------


def worktree(folder, commit):
    """A checkout of a commit."""
    tree = folder / "trees" / commit
    if not (tree / "src").is_dir():
        _git("worktree", "prune")
        _git("worktree", "add", "--force", "--detach", str(tree), commit)
    return tree


def environment(tree):
    """The interpreter of a checkout's own environment, made as its run.py makes it."""
    code = "import run; run.set_up('dev.lock'); print(run.PYTHON)"
    made = subprocess.run(
        [sys.executable, "-c", code], cwd=tree, check=True, capture_output=True, text=True
    )
    return Path(made.stdout.splitlines()[-1])


def make_inputs(home, tree, python):
    """Specimens by the old side, and runs of earlier versions by these versions."""
    inputs, partial = home / "inputs", home / "inputs.partial"
    if inputs.is_dir():
        return
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    bare = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    script = [str(python), str(_HERE / "inputs.py"), str(partial)]
    subprocess.run(script, check=True, env=bare | {"PYTHONPATH": str(tree / "src")})
    for version, commit in _FORMER.items():
        former = worktree(home.parent, commit)
        command = [str(python), "-m", "planish", "demo", "--out", str(partial / "former" / version)]
        subprocess.run(
            command, check=True, capture_output=True, env=bare | {"PYTHONPATH": str(former / "src")}
        )
    partial.rename(inputs)


def _stamp(name):
    """What the results of the old side depend on beside its commit: the part, its inputs, and the
    processor."""
    texts = "".join(
        [
            repr(PARTS[name]),
            *((_HERE / k).read_text() for k in ("parts.py", "inputs.py", "driver.py")),
        ]
    )
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    processor = model[1] if model else platform.processor()
    return f"{platform.node()} {processor} {hashlib.sha256(texts.encode()).hexdigest()}\n"


def _git(*arguments):
    done = subprocess.run(
        ["git", "-C", str(_ROOT), *arguments], check=False, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"git {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout.strip()
