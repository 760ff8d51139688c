"""Run kinds by seeds, keep a line of each, print the tables."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.wrong import geometry, grey, sheet, slices
from benchmarks.wrong.case import Case
from benchmarks.wrong.judge import Light, figures, lights
from benchmarks.wrong.kinds import KINDS, Kind
from benchmarks.wrong.specimens import Draw, drawn
from planish.core.errors import PlanishError

_MODULES = (slices, geometry, grey, sheet)  # each enters its kinds when it is imported
_POOL = 6  # specimens of each maker and sort: kinds share them
Row = dict[str, Any]


def main(*words: str | int) -> int:
    """Judge all kinds or some; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks wrong")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("wrong"))
    parser.add_argument("--again", action="store_true", help="repeat what is there")
    parser.add_argument("--markdown", action="store_true", help="print the table of the documents")
    parser.add_argument("--report", action="store_true", help="print what is there, run nothing")
    given = parser.parse_args([str(w) for w in words])
    if unknown := [name for name in given.kinds if name not in KINDS]:
        parser.error(f"there is no kind {', '.join(unknown)}; there are {', '.join(KINDS)}")
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "wrong.jsonl"
    rows = {} if not path.exists() else {(r["kind"], r["seed"]): r for r in map(json.loads, path.open())}
    jobs = [(k, s) for s in range(given.seeds) for k in given.kinds]
    if not given.report:
        for name, seed in jobs:
            if given.again or (name, seed) not in rows:
                row = judged(KINDS[name], seed)
                rows[name, seed] = row
                with path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
                print(line_of(row), flush=True)
    return shown([rows[job] for job in jobs if job in rows], markdown=given.markdown)


def order_of(kind: Kind, seed: int) -> Draw:
    """The specimen of one kind and seed: two of five by the second maker."""
    maker = "second" if seed % 5 in (1, 3) else "planish"
    return Draw(maker=maker, seed=(crc32(kind.name.encode()) + seed) % _POOL, **kind.order)


def case_of(name: str, seed: int) -> Case:
    """The input of one kind and seed."""
    kind = KINDS[name]
    case = Case.of(drawn(order_of(kind, seed)))
    kind.change(case, np.random.default_rng([crc32(name.encode()), seed]))
    return case


def judged(kind: Kind, seed: int) -> Row:
    """Make the input, run it, compare."""
    started = time.process_time()
    case = case_of(kind.name, seed)
    made = time.process_time()
    right = case.right
    row: Row = {"kind": kind.name, "seed": seed, "maker": right.maker, "specimen": right.seed, "note": case.note}
    return row | judged_case(case) | {"made_s": round(made - started, 2), "run_s": round(time.process_time() - made, 2)}


def judged_case(case: Case) -> Row:
    """Refusal, or figures and lights of a run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            run = case.run()
        except PlanishError as error:
            return {"refused": str(error)}
        except Exception as error:  # noqa: BLE001 - a crash is a finding
            return {"crash": f"{type(error).__name__}: {error}"}
        found, spoken = figures(case, run), lights(run)
    wrong = [f for f in found if f.wrong]
    return {
        "figures": {f.name: [_short(f.error), _short(f.stated)] for f in found},
        "wrong": [f.name for f in wrong],
        "lights": [[k.state, k.name, k.sentence, list(k.figures)] for k in spoken],
    }


def silent_of(row: Row) -> list[str]:
    """Wrong figures that nothing warned of; a run that failed is not silent, an ``unknown`` counts where it answers."""
    kind = KINDS.get(row["kind"])
    spoken = [
        Light(name=name, state=state, sentence="", figures=tuple(on)) for state, name, _, on in row.get("lights", ())
    ]
    if any(light.state == "fail" for light in spoken):
        return []
    if kind is not None and any(k.name == kind.answer for k in spoken):
        return []
    heard = [k for k in spoken if k.state == "look"]
    return [name for name in row.get("wrong", ()) if not any(k.covers(name) for k in heard)]


def _short(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def worst_of(row: Row) -> str:
    """The figure that is wrong by the most, in um where there is one."""
    found = [(v[0], name, v[1]) for name in row.get("wrong", ()) if (v := row["figures"][name])[0] is not None]
    if not found:
        return "of nature" if row.get("wrong") else ""
    error, name, stated = max(found, key=lambda k: (k[1] != "correlation", k[0]))
    return f"{name} {error:.3g} (stated {stated or 0:.2g})"


def line_of(row: Row) -> str:
    """One run in one line."""
    if "refused" in row:
        said = "refused: " + row["refused"][:90]
    elif "crash" in row:
        said = "CRASH " + row["crash"][:90]
    else:
        silent = silent_of(row)
        state = "SILENT " + ", ".join(silent) if silent else "wrong, said" if row["wrong"] else "not wrong"
        said = f"{state}; {worst_of(row)}; " + "; ".join(f"{k[0]} {k[1]}" for k in row["lights"])
    name = f"{row['kind']} {row['seed']} ({row['maker'][0]}{row['specimen']})"
    return f"{name} {row['note']}: {said}  [{row['run_s']:.1f} s]"


def shown(rows: list[Row], *, markdown: bool = False) -> int:
    """Print a line a kind, and the totals; 1 where a goal is missed."""
    by_kind = {name: [r for r in rows if r["kind"] == name] for name in KINDS}
    missed: list[str] = []
    total = silent = 0
    lines = [("kind", "runs", "wrong", "silent", "worst error", "said by")]
    for name, own in by_kind.items():
        if not own:
            continue
        kind = KINDS[name]
        wrong = [r for r in own if r.get("wrong")]
        quiet = [r for r in own if silent_of(r)]
        crashes = [r for r in own if "crash" in r]
        said = Counter("refused" for r in own if "refused" in r)
        said.update(f"{state} *{check}*" for r in own for state, check, *_ in r.get("lights", ()))
        worst = max((worst_of(r) for r in quiet or wrong), key=_size, default="")
        mark = " (cannot be seen)" if kind.hidden else " (grave)" if kind.grave else ""
        counts = (str(len(own)), str(len(wrong)), str(len(quiet)))
        heard = ", ".join(f"{what} {n}" for what, n in said.most_common(5)) + (
            f", CRASH {len(crashes)}" if crashes else ""
        )
        lines.append((f"{kind.title if markdown else name}{mark}", *counts, worst, heard))
        if kind.hidden or name == "right":
            continue
        total, silent = total + len(own), silent + len(quiet)
        if len(own) - len(quiet) < 0.8 * len(own) or crashes:
            missed.append(name)
    if markdown:
        lines.insert(1, ("---",) * 6)
        print("\n".join(f"| {' | '.join(row)} |" for row in lines))
    else:
        for name, *counts, worst, heard in lines:
            print(f"{name:34s} {' '.join(f'{c:>6s}' for c in counts)}  {worst:44s} {heard}")
    if total:
        share = 100 - 100 * silent / total
        print(f"\n{total} runs of {len(lines) - 1} kinds; silent {silent}, {share:.1f} % are not silent")
        print(f"silent in more than one of five: {', '.join(missed) or 'none'}")
        grave = [r for r in rows if KINDS[r["kind"]].grave and r.get("wrong")]
        ends = [r for r in grave if any(k[0] == "fail" for k in r["lights"])]
        print(f"grave kinds, wrong and not refused: {len(grave)}; ended with fail: {len(ends)}")
        spent, runs = sum(r["run_s"] + r["made_s"] for r in rows) / 60, [r["run_s"] for r in rows]
        print(f"CPU: {spent:.1f} min, median run {np.median(runs):.1f} s")
    return int(bool(missed) or silent > 0.05 * total)


def _size(text: str) -> float:
    words = text.split()
    return next((float(w) for w in words if w.replace(".", "").replace("e+", "").isdigit()), 0.0)
