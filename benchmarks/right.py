"""Does planish stay quiet where nothing is wrong?

Right specimens of two makers and two instruments, and real volumes.

``python -m benchmarks right [--count 60] [--out FOLDER]``

Goal: no check fails, each looks in at most 5 %, at least 80 % of the runs have neither. Half of the
sheets are laid fibre by fibre: coated, uncoated, on film, in resin, as a volume and as sections.
Drawn are the paper, slopes to 60 degrees, 4 to 30 holes, the voxel, the scanner's artefacts, a
stack or slices across the sheet or serial sections. The light is even and diffuse.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tifffile

from benchmarks.wrong.case import Case
from benchmarks.wrong.specimens import Draw, drawn
from benchmarks.wrong.table import done, lights, row_of
from planish.core.errors import PlanishError
from planish.run.build import map_sheet
from planish.run.compute import Compute

_DATA = Path(
    os.environ.get("PLANISH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
)
# Path, part (y, x) of it, and options.
_REAL = {
    "letter": (
        "letterpacket_ct/volume_zyx_uint8.tif",
        (slice(0, 30), slice(0, 30)),
        {
            "volume": {"voxel_um": (1.0, 1.0, 1.0), "through": "y"},
            "surface": {"seed_um": (8.0, 9.0, 3.0), "cutoff_um": 12.0, "rim_um": 2.0},
        },
    ),
    "battery": (
        "battery_sector_right",
        None,
        {
            "volume": {"voxel_um": (1.0, 1.0, 1.0), "through": "x"},
            "surface": {"sheet_grey": (100.0, 255.0)},
        },
    ),
}
# Kinds of benchmarks.paper by the tens and the units of a specimen's number.
_FIBRES = tuple(
    dict(zip((0, 2, 4, 6, 9), kinds, strict=True))
    for kinds in (
        ("coated", "coated", "coated", "resin", "calendered"),
        ("film", "coated", "coated", "coated", "bulky"),
        ("resin", "calendered", "film", "resin", "coated"),
        ("coated", "coated", "resin", "coated", "calendered"),
        ("calendered", "film", "coated", "resin", "bulky"),
        ("coated", "coated", "bulky", "coated", "film"),
    )
)


def order_of(k):
    """The k-th specimen and its instrument."""
    rng, unit = np.random.default_rng([3, k]), k % 10
    is_second, large, steep = unit in (1, 3, 5, 7), unit in (3, 4, 8), unit in (5, 8)
    slope = None
    if steep:  # to 60 degrees; the sheet of the second maker is round and small
        slope = float(np.tan(np.deg2rad(rng.uniform(28, 45 if is_second else 60))))
    holes = round(np.exp(rng.uniform(np.log(4), np.log(22 if large else 9))))
    draw = Draw(
        maker="second" if is_second else "planish",
        seed=100 + k,
        large=large,
        coated=k % 15 != 9,
        steep=steep,
        fibres="" if is_second or steep else _FIBRES[k // 10 % 6][unit],
        holes=26 if k % 20 == 4 else holes,
        slope=slope,
    )
    return draw, {2: "scanner", 6: "sections"}.get(unit, "stack")


def main(*words):
    """Run all, print which checks spoke; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks right")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--out", type=Path, default=Path("wrong"))
    given = parser.parse_args([str(w) for w in words])
    jobs = {f"right {k}": ("right", k) for k in range(given.count - len(_REAL))}
    jobs |= {f"{name} 0": (name, 0) for name in _REAL}
    return _shown(done(given.out / "right.jsonl", jobs, _judged))


def _judged(name, k):
    if name in _REAL:
        return _real(name)
    started = time.process_time()
    draw, instrument = order_of(k)
    case = Case.of(drawn(draw))
    case.instrument = instrument
    right = case.right
    slopes = np.gradient(right.columns[..., 2], right.voxel_um)
    degrees = np.rad2deg(np.arctan(np.hypot(*slopes).max()))
    note = f"{instrument}, {right.note}, {len(right.holes)} holes, {degrees:.0f} deg"
    return row_of(name, k, case, note, started)


def _real(name):
    """A measured volume, as far as it is at hand: mapped, without an image."""
    place, part, options = _REAL[name]
    row = {
        "kind": name,
        "seed": 0,
        "maker": "real",
        "specimen": 0,
        "note": place,
        "figures": {},
        "wrong": [],
        "lights": [],
        "made_s": 0.0,
    }
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if not (_DATA / place).exists():
                return row | {"refused": "data are absent", "run_s": 0.0}
            with TemporaryDirectory() as folder:
                path = _DATA / place
                if part is not None:
                    path = Path(folder, "part.tif")
                    tifffile.imwrite(
                        path, tifffile.imread(_DATA / place)[:, *part], metadata={"axes": "ZYX"}
                    )
                run = map_sheet(path, compute=Compute(threads=1), **options)
            row["lights"] = lights(run)
        except PlanishError as error:
            row["refused"] = str(error)
    return row | {"run_s": round(time.process_time() - started, 2)}


def _shown(rows):
    runs = [r for r in rows if "lights" in r and "refused" not in r]
    spoken = Counter()
    for r in runs:
        spoken.update({(state, name) for state, name, *_ in r["lights"]})
    print(
        f"\n{len(rows)} right inputs: {len(runs)} runs, {sum('refused' in r for r in rows)}"
        f" refused, {sum('crash' in r for r in rows)} crashed"
    )
    for (state, name), n in sorted(spoken.items(), key=lambda k: (k[0][0], -k[1])):
        print(f"  {state:8s} {name:34s} {n:3d}  {100 * n / len(runs):.0f} %")
    quiet = sum(all(k[0] not in ("look", "fail") for k in r["lights"]) for r in runs)
    wrong = Counter(name for r in runs for name in r["wrong"])
    print(f"without look or fail: {quiet} of {len(runs)} ({100 * quiet / max(len(runs), 1):.0f} %)")
    print(f"figures wrong by the rule of 'wrong': {dict(wrong)}")
    for name in (
        "position",
        "coating_top map",
        "base_thickness map",
        "coating_top",
        "base_thickness",
        "correlation",
    ):
        pairs = np.array(
            [r["figures"][name] for r in runs if None not in r["figures"].get(name, [None])]
        )
        if len(pairs):
            print(
                f"  {name:20s} error: median {np.median(pairs[:, 0]):.2f}, largest"
                f" {pairs[:, 0].max():.2f}; stated: median {np.median(pairs[:, 1]):.2f}"
            )
    asked = [r for r in runs if r["kind"] == "right"]
    for name in sorted({k[1] for r in asked for k in r["lights"] if k[0] == "unknown"}):
        n = sum(any(k[:2] == ["unknown", name] for k in r["lights"]) for r in asked)
        print(f"  an answer of '{name}' in {100 * (1 - n / len(asked)):.0f} %")
    bad = any(
        state == "fail" or n > 0.05 * len(runs)
        for (state, _), n in spoken.items()
        if state in ("look", "fail")
    )
    return int(bad or quiet < 0.8 * len(runs))
