"""Run kinds by seeds, keep a line of each, print the tables."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import Counter
from pathlib import Path
from zlib import crc32

import numpy as np

from benchmarks.wrong import geometry, grey, sheet, slices
from benchmarks.wrong.case import Case
from benchmarks.wrong.judge import covers, figures
from benchmarks.wrong.kinds import KINDS
from benchmarks.wrong.specimens import Draw, drawn
from planish.core.errors import PlanishError

_MODULES = (slices, geometry, grey, sheet)  # each enters its kinds when it is imported
_POOL = 6  # specimens of each maker and sort: kinds share them


def main(*words):
    """Judge all kinds or some; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks wrong")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="NAME")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("wrong"))
    given = parser.parse_args([str(w) for w in words])
    jobs = {
        f"{name} {seed}": (KINDS[name], seed) for seed in range(given.seeds) for name in given.kinds
    }
    return shown(done(given.out / "wrong.jsonl", jobs, judged))


def done(path, jobs, judge):
    """Do what has no line in a file yet, and give the lines of all jobs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = {}
    if path.exists():
        rows = {f"{row['kind']} {row['seed']}": row for row in map(json.loads, path.open())}
    for name in [name for name in jobs if name not in rows]:
        rows[name] = judge(*jobs[name])
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[name]) + "\n")
        print(line_of(rows[name]), flush=True)
    return [rows[name] for name in jobs]


def order_of(kind, seed):
    """The specimen of one kind and seed: two of five by the second maker."""
    maker = "second" if seed % 5 in (1, 3) else "planish"
    return Draw(maker=maker, seed=(crc32(kind.name.encode()) + seed) % _POOL, **kind.order)


def case_of(name, seed):
    """The input of one kind and seed."""
    kind = KINDS[name]
    case = Case.of(drawn(order_of(kind, seed)))
    kind.change(case, np.random.default_rng([crc32(name.encode()), seed]))
    return case


def judged(kind, seed):
    """Make the input, run it, compare."""
    started = time.process_time()
    case = case_of(kind.name, seed)
    return row_of(kind.name, seed, case, case.note, started)


def row_of(name, seed, case, note, started):
    """Run a case that has been made since ``started``: refusal, or figures and checks that do not
    pass."""
    made, right = time.process_time(), case.right
    row = {"kind": name, "seed": seed, "maker": right.maker, "specimen": right.seed, "note": note}
    row |= judged_case(case)
    return row | {"made_s": round(made - started, 2), "run_s": round(time.process_time() - made, 2)}


def judged_case(case):
    """Refusal, or figures and checks of a run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            run = case.run()
        except PlanishError as error:
            return {"refused": str(error)}
        except Exception as error:  # noqa: BLE001 - a crash is a finding
            return {"crash": f"{type(error).__name__}: {error}"}
        found = figures(case, run)
    return {
        "figures": {f.name: [_short(f.error), _short(f.stated)] for f in found},
        "wrong": [f.name for f in found if f.wrong],
        "lights": lights(run),
    }


def lights(run):
    """State, name, sentence and figures of each check that does not pass."""
    return [[c.state, c.name, c.sentence, list(c.figures)] for c in run.checks if c.state != "pass"]


def silent_of(row):
    """Wrong figures that nothing warned of; a run that failed is not silent, an ``unknown`` counts
    where it answers."""
    spoken = row.get("lights", ())
    answer = KINDS[row["kind"]].answer if row["kind"] in KINDS else ""
    if any(state == "fail" or (answer and name == answer) for state, name, *_ in spoken):
        return []
    heard = [named for state, _, _, named in spoken if state == "look"]
    return [
        figure
        for figure in row.get("wrong", ())
        if not any(covers(named, figure) for named in heard)
    ]


def _short(value):
    return round(float(value), 3) if np.isfinite(value) else None


def worst_of(row):
    """The figure that is wrong by the most, in um where there is one."""
    found = [
        (v[0], name, v[1])
        for name in row.get("wrong", ())
        if (v := row["figures"][name])[0] is not None
    ]
    if not found:
        return "of nature" if row.get("wrong") else ""
    error, name, stated = max(found, key=lambda k: (k[1] != "correlation", k[0]))
    return f"{name} {error:.3g} (stated {stated or 0:.2g})"


def line_of(row):
    """One run in one line."""
    if "refused" in row:
        said = "refused: " + row["refused"][:90]
    elif "crash" in row:
        said = "CRASH " + row["crash"][:90]
    else:
        silent = silent_of(row)
        state = (
            "SILENT " + ", ".join(silent)
            if silent
            else "wrong, said"
            if row["wrong"]
            else "not wrong"
        )
        said = f"{state}; {worst_of(row)}; " + "; ".join(f"{k[0]} {k[1]}" for k in row["lights"])
    name = f"{row['kind']} {row['seed']} ({row['maker'][0]}{row['specimen']})"
    return f"{name} {row['note']}: {said}  [{row['run_s']:.1f} s]"


def shown(rows):
    """Print a line a kind, and the totals; 1 where a goal is missed."""
    missed = []
    total = silent = 0
    lines = []
    for name, kind in KINDS.items():
        own = [row for row in rows if row["kind"] == name]
        if not own:
            continue
        wrong = [row for row in own if row.get("wrong")]
        quiet = [row for row in own if silent_of(row)]
        said = Counter(end for end in ("refused", "crash") for row in own if end in row)
        said.update(
            f"{state} `{check}`" for row in own for state, check, *_ in row.get("lights", ())
        )
        worst = max((worst_of(row) for row in quiet or wrong), key=_size, default="")
        mark = " (cannot be seen)" if kind.hidden else " (grave)" if kind.grave else ""
        heard = ", ".join(f"{what} {n}" for what, n in said.most_common(3))
        lines.append(
            (f"{kind.title}{mark}", str(len(own)), str(len(wrong)), str(len(quiet)), worst, heard)
        )
        if kind.hidden or name == "right":
            continue
        total, silent = total + len(own), silent + len(quiet)
        if len(quiet) > 0.2 * len(own) or said["crash"]:
            missed.append(name)
    print(
        "| What was wrong | Runs | Wrong | Silent | Largest error (stated) / um | What was said |"
    )
    print("|---|---:|---:|---:|---|---|")
    for row in lines:
        print(f"| {' | '.join(row)} |")
    if total:
        share = 100 - 100 * silent / total
        print(
            f"\n{total} runs of {len(lines)} kinds; silent {silent}, {share:.1f} % are not silent"
        )
        print(f"silent in more than one of five: {', '.join(missed) or 'none'}")
        grave = [r for r in rows if KINDS[r["kind"]].grave and r.get("wrong")]
        ends = [r for r in grave if any(k[0] == "fail" for k in r["lights"])]
        print(f"grave kinds, wrong and not refused: {len(grave)}; ended with fail: {len(ends)}")
        spent = sum(r["run_s"] + r["made_s"] for r in rows) / 60
        print(f"CPU: {spent:.1f} min, median run {np.median([r['run_s'] for r in rows]):.1f} s")
    return int(bool(missed) or silent > 0.05 * total)


def _size(text):
    words = text.split()
    return next((float(w) for w in words if w.replace(".", "").replace("e+", "").isdigit()), 0.0)
