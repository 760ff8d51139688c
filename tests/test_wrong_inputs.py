"""Inputs with something wrong in them: what a run says, by which check, and how it ends.

A short form of ``python -m benchmarks wrong``; each was once met, ended with 0 and said nothing.
"""

from __future__ import annotations

import re

import pytest
from benchmarks.wrong.table import case_of

from planish.cli.show import finish

MET = [  # kind, seed, state, check, what its sentence says
    ("second-sheet", 0, "fail", "second sheet", "second sheet"),
    ("exchanged-z", 0, "fail", "slices along z", "not in order"),
    ("repeated-z", 0, "look", "slices along z", "cop|repeat"),
    ("missing-z", 0, "look", "slices along z", "missing"),
    ("repeated-xy", 0, "look", "slices along x", "cop|repeat"),
    ("blocks-xy", 0, "fail", "slices along y", "not in order|missing"),
    ("spacing-z-10-steep", 0, "look", "scale through the sheet", "10"),
    ("spacing-z-50-steep", 0, "fail", "scale through the sheet", "z"),
    ("hand", 0, "fail", "side and specimen", "bottom"),
    ("bottom-mirror", 0, "fail", "side and specimen", "bottom"),
    ("other-specimen", 0, "look", "side and specimen", "nothing"),
    ("two-images", 0, "look", "side and specimen", "nothing"),
    ("clipped", 0, "look", "clipp|grey", "clipped"),
    ("clipped-12-bit", 0, "look", "clipp|grey", "clipped"),
    ("clipped-float", 0, "look", "clipp|grey", "clipped"),
    ("dust", 0, "look", "dust|particles", "mm"),
    ("few-voxels", 1, "look", "voxels", "voxels"),
]


@pytest.mark.study
@pytest.mark.parametrize(("kind", "seed", "state", "check", "says"), MET, ids=lambda k: str(k))
def test_what_was_met_is_said(kind, seed, state, check, says, tmp_path, capsys):
    run = case_of(kind, seed).run()
    found = [c for c in run.checks if c.state == state and re.search(check, c.name)]
    assert found, [(c.state, c.name, c.sentence) for c in run.checks if c.state != "pass"]
    assert any(re.search(says, c.sentence) for c in found), [c.sentence for c in found]
    assert all(c.advice and c.figures for c in found)
    assert finish(run, tmp_path, as_json=False) == (4 if run.results.state == "fail" else 0)
    assert found[0].sentence in capsys.readouterr().err
