"""Certificates: what becomes of the seeds, of refusals and of limits; tables, page and record of
them."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import record
from folders import refused
from planish.core.errors import CannotRegister, InputError
from planish.validate import (
    STAGES,
    Certificate,
    Entry,
    Limit,
    certify,
    read_scenario,
    render_page,
    run_scenario,
    table,
)
from planish.validate.page import dots
from report.pages import Page, assert_alone

RECORDED = Path(__file__).with_name("recorded.toml")


@pytest.mark.nightly
def test_no_figure_is_worse_than_recorded(whole_certificate):
    """Where a change makes a figure better for good, record it: python tests/record.py FILE."""
    assert record.worse(whole_certificate, record.read_recorded(RECORDED)) == []


@pytest.mark.nightly
def test_the_small_scenario_meets_its_limits(whole_certificate):
    assert whole_certificate.passed, table.summary(whole_certificate)
    assert (len(whole_certificate.entries), len(whole_certificate.entries[0].pictures)) == (3, 4)


def made_up(values, *, limits=None, **entry):
    scenario = read_scenario("small").model_copy(update={"limits": limits or {}})
    entries = tuple(Entry(seed=k, values=v, **entry) for k, v in enumerate(values))
    return Certificate(scenario=scenario, entries=entries)


def test_the_spread_over_seeds_and_the_worst_one_decide():
    found = made_up([{"tre_p95": 1.0, "top_bias": -0.3}, {"tre_p95": 3.0, "top_bias": 0.1}]).lines()
    assert (found["tre_p95"].mean, found["tre_p95"].sd) == (2.0, pytest.approx(np.sqrt(2.0)))
    assert (found["tre_p95"].worst, found["top_bias"].worst) == (3.0, -0.3)
    assert list(found) == ["top_bias", "tre_p95"]
    limits = {
        "tre_p95": Limit(limit=2.5),
        "recall_image": Limit(least=0.9),
        "thin_dice": Limit(least=0.5),
    }
    found = made_up(
        [{"tre_p95": 1.0, "recall_image": 1.0}, {"tre_p95": 3.0, "recall_image": 1.0}],
        limits=limits,
    )
    assert {name: line.met for name, line in found.lines().items()} == {
        "tre_p95": False,
        "recall_image": True,
        "thin_dice": False,  # what could not be measured is not met
    }
    assert not found.passed
    assert "2 of 3 limits are missed" in table.summary(found)


@pytest.fixture
def no_specimen(monkeypatch):
    """Scenarios without the work: no specimen is made, no file is written."""
    files = SimpleNamespace(volume=Path("v.tif"), image=Path("i.tif"), through="z")
    monkeypatch.setattr(certify, "make_specimen", lambda _params: None)
    monkeypatch.setattr(certify, "write_instruments", lambda *_, **__: files)


@pytest.mark.usefixtures("no_specimen")
def test_every_seed_gives_an_entry_and_the_first_an_example(monkeypatch, small):
    """What the studies do with real runs, with the run and its ledger replaced."""
    check = SimpleNamespace(name="marks", sentence="7 marks agree to 33.1 um.")
    results = SimpleNamespace(checks_in=lambda state: [check] if state == "fail" else [])
    run = SimpleNamespace(results=results, groups={"linked": None})
    monkeypatch.setattr(certify, "run_study", lambda *_, **__: run)
    monkeypatch.setattr(certify, "make_ledger", lambda _both: {"tre_p95": 7.0})
    monkeypatch.setattr(
        "planish.validate.example.draw_example", lambda _both, seed: [f"maps of {seed}"]
    )
    reports = []
    found = run_scenario(small, [4, 2], progress=lambda *words: reports.append(words))
    assert ([entry.seed for entry in found.entries], found.entries[0].values) == (
        [4, 2],
        {"tre_p95": 7.0},
    )
    assert found.entries[0].failed == ("marks: 7 marks agree to 33.1 um.",)
    assert [entry.pictures for entry in found.entries] == [("maps of 4",), ()]
    assert ("small", "seed 2, 2 of 2") in reports


def test_a_specimen_that_cannot_be_made_is_named(monkeypatch, small):
    def fail(_params):
        raise ValueError("5 holes do not fit")

    monkeypatch.setattr(certify, "make_specimen", fail)
    refused(InputError, "small cannot be made: 5 holes", run_scenario, small, 1)


@pytest.mark.usefixtures("no_specimen")
def test_a_refusal_is_an_outcome(monkeypatch, small):
    def refuse(_study, _out, **_):
        raise CannotRegister("Only 2 holes were found in the volume.")

    monkeypatch.setattr(certify, "run_study", refuse)
    found = run_scenario(small, 1)
    assert (found.entries[0].refusal, found.entries[0].values) == (
        "Only 2 holes were found in the volume.",
        {},
    )
    assert not found.passed
    assert "no result" in table.verdict(found)
    assert "Only 2 holes" in render_page(found)
    assert "Only 2 holes" in table.markdown(found)


def test_failed_checks_and_notes_stand_on_the_page_with_a_row_of_dots():
    found = made_up([{"tre_p95": 1.0}], failed=("marks: 7 marks agree to 33.1 um only.",))
    assert not found.passed
    assert "a check of the run failed" in table.summary(found)
    assert "33.1" in render_page(found)
    found = replace(made_up([{"tre_p95": 1.0}]), notes=("Taken: voxels of 3 um.",))
    assert "voxels of 3 um" in render_page(found)
    assert dots((), 1.0) == ""
    text = dots((0.5, 1.0), 2.0)
    assert text.count("<circle") == 2
    # zero at the left margin, the limit at the right one, 0.5 a quarter of the way
    assert 'cx="40.5"' in text
    assert dots((-1.0, 1.0), 2.0).count('stroke-width="2"') == 2
    assert dots((0.0,), 0.0)


def test_table_of_a_certificate(certificate):
    rows = table.terminal_rows(certificate)
    assert all(len(row) == 7 for row in rows)
    assert [row[0] for row in rows if not row[0].startswith(" ")] == [
        STAGES[s] for s in STAGES if s not in ("mesh", "sections", "pair")
    ]
    assert sum(row[-1] == "met" for row in rows) == len(certificate.scenario.limits)
    text = table.markdown(certificate)
    assert text.count("\n| ") >= len(certificate.lines())
    data = json.loads(json.dumps(table.as_json(certificate), allow_nan=False))
    assert data["passed"] is True
    assert data["figures"]["tre_median"]["n"] == 3
    # where it is run leaves no trace: it can be compared with another machine's
    assert "/" not in json.dumps([entry["refusal"] for entry in data["seeds"]])


def test_the_page_needs_nothing_else(certificate):
    text = render_page(certificate)
    page = Page(text)
    assert_alone(page)
    assert (text.count("<figure"), text) == (5, render_page(certificate))
    assert table.verdict(certificate).replace("'", "&#39;") in text
    assert "{{" not in text


def test_figures_worse_than_recorded_are_named_by_size():
    old = made_up(
        [
            {"tre_p95": 1.0, "recall_image": 1.0, "r_pixel": 0.5},
            {"tre_p95": 1.2, "recall_image": 1.0},
        ]
    )
    kept = record.record(old)
    assert (kept["figures"]["tre_p95"]["mean"], record.worse(old, kept)) == (pytest.approx(1.1), [])
    # 2 sd are 0.28
    near, far = (
        made_up([{"tre_p95": 1.35, "recall_image": 1.0}]),
        made_up([{"tre_p95": 1.4, "recall_image": 0.9}]),
    )
    assert record.worse(near, kept) == []
    faults = record.worse(far, kept)
    assert [fault.split(":")[0] for fault in faults] == ["recall_image", "tre_p95"]
    better = made_up([{"tre_p95": 0.1, "recall_image": 1.0}])
    assert record.worse(better, kept) == []
    assert "now there is none" in record.worse(made_up([{"recall_image": 1.0}]), kept)[0]
    kept = record.record(made_up([{"top_bias": -0.5}, {"top_bias": -0.5}]))
    assert record.worse(made_up([{"top_bias": 0.5}]), kept) == []
    assert record.worse(made_up([{"top_bias": 0.6}]), kept) != []
